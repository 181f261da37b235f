//! The differences between two plans, act by act.

use std::collections::BTreeMap;

use downbeat_scripts::{Act, BodyUse, Choreography, Closest, Fleet, PlannedCue, PlannedReading, Way};
use serde::Serialize;
use serde_json::{Value, json};
use urrcp::{Command, ContentHash, RobotId, Span};

use super::scripts::{DeviceDifferences, Devices, devices};
use super::{Change, Presence, matched, out_of_order};

/// The differences between two plans.
#[derive(Clone, Debug, Serialize)]
pub struct PlanDifferences {
    /// Whether the plans are equal, that is, their hashes match.
    pub same: bool,
    /// The hash of each plan, computed over all content that is compared.
    pub(crate) hash: Both<ContentHash>,
    pub(crate) scenario: Option<Change<String>>,
    /// Robots that play in the second plan, but in no act of the first.
    pub(crate) robots_added: Vec<RobotId>,
    pub(crate) robots_removed: Vec<RobotId>,
    /// The acts that differ, in the order of the second plan, followed by the acts that only the first plan has.
    pub(crate) acts: Vec<ActDifferences>,
}

/// A value of the first plan, `a`, and the corresponding value of the second plan, `b`. The values may be equal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Both<T> {
    pub(crate) a: T,
    pub(crate) b: T,
}

/// An act that differs between two plans. If an act is added or removed, all its cues and scripts also count as added or removed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct ActDifferences {
    /// The name of the act; empty if the scenario does not define acts.
    pub(crate) act: String,
    pub(crate) presence: Presence,
    /// The position of the act in each plan, counted from 1. `None` if the act has not moved relative to the other acts.
    pub(crate) place: Option<Change<usize>>,
    pub(crate) duration_ms: Option<Change<Span>>,
    pub(crate) settings: Vec<Setting>,
    pub(crate) robots_added: Vec<RobotId>,
    pub(crate) robots_removed: Vec<RobotId>,
    /// The cues that differ, in order of time.
    pub(crate) cues: Vec<CueDifference>,
    /// The devices that differ, ordered by the time of their first difference.
    pub(crate) devices: Vec<DeviceDifferences>,
    pub(crate) readings_added: Vec<PlannedReading>,
    pub(crate) readings_removed: Vec<PlannedReading>,
    pub(crate) closest: Option<Change<Option<Closest>>>,
    /// The robots whose bodies have different maximum speeds or accelerations in the two plans. A value is `None` if only the other plan
    /// has the body.
    pub(crate) bodies: Vec<Change<Option<BodyUse>>>,
}

/// A setting of an act whose value differs; keys and values are as in the JSON of `downbeat plan`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Setting {
    pub(crate) setting: String,
    #[serde(flatten)]
    pub(crate) change: Change<Value>,
}

/// A cue that differs between two plans.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct CueDifference {
    pub(crate) cue: String,
    pub(crate) presence: Presence,
    /// Time from the act's start to the start of the cue in the second plan. If only the first plan has the cue, the time in that plan.
    pub(crate) at_ms: Span,
    pub(crate) start_ms: Option<Change<Span>>,
    pub(crate) duration_ms: Option<Change<Span>>,
    pub(crate) slack_ms: Option<Change<Span>>,
    pub(crate) critical: Option<Change<bool>>,
}

/// Compares two plans, each with the fleet that it was compiled for.
pub fn plans(a: (&Choreography, &Fleet), b: (&Choreography, &Fleet)) -> PlanDifferences {
    let hash = Both { a: hash(a.0), b: hash(b.0) };
    let acts = if hash.a == hash.b { Vec::new() } else { acts(a, b) };
    let playing = |choreography: &Choreography| -> Vec<RobotId> {
        let mut robots: Vec<RobotId> = choreography.acts.iter().flat_map(robots_of).cloned().collect();
        robots.sort();
        robots.dedup();
        robots
    };
    let (in_a, in_b) = (playing(a.0), playing(b.0));
    PlanDifferences {
        same: hash.a == hash.b,
        hash,
        scenario: Change::of(a.0.scenario.clone(), b.0.scenario.clone()),
        robots_added: without(&in_b, &in_a),
        robots_removed: without(&in_a, &in_b),
        acts,
    }
}

fn without<T: Clone + PartialEq>(all: &[T], others: &[T]) -> Vec<T> {
    all.iter().filter(|one| !others.contains(one)).cloned().collect()
}

/// Returns the planned sensor readings in `all` that have no counterpart in `others`.
fn beyond(all: &[PlannedReading], others: &[PlannedReading]) -> Vec<PlannedReading> {
    let pairs = matched(all, others, |reading| (&reading.robot, &reading.sensor, reading.at));
    pairs.into_iter().filter_map(|(one, other)| one.filter(|_| other.is_none()).cloned()).collect()
}

fn robots_of(act: &Act) -> impl Iterator<Item = &RobotId> {
    act.plan.robots.iter().map(|robot| &robot.robot)
}

fn acts(a: (&Choreography, &Fleet), b: (&Choreography, &Fleet)) -> Vec<ActDifferences> {
    let place = |choreography: &Choreography, act: &Act| {
        choreography.acts.iter().position(|other| std::ptr::eq(other, act)).unwrap_or_default()
    };
    // The acts are in the order of the second plan.
    let pairs = matched(&b.0.acts, &a.0.acts, |act| act.name.as_str());
    let common: Vec<usize> = pairs
        .iter()
        .filter_map(|(in_b, in_a)| Some(place(a.0, (*in_a)?)).filter(|_| in_b.is_some()))
        .collect();
    let side = |act, (choreography, fleet)| Side { act, choreography, fleet };
    let mut moved = out_of_order(&common).into_iter();
    let mut all = Vec::new();
    for (in_b, in_a) in pairs {
        let is_moved = in_a.is_some() && in_b.is_some() && moved.next().unwrap_or_default();
        let mut found = act(in_a.map(|act| side(act, a)), in_b.map(|act| side(act, b)));
        if let Some((old, new)) = in_a.zip(in_b).filter(|_| is_moved) {
            found.place = Some(Change { a: place(a.0, old) + 1, b: place(b.0, new) + 1 });
        }
        if !found.is_empty() {
            all.push(found);
        }
    }
    all
}

/// An act of one of the two plans.
#[derive(Clone, Copy)]
struct Side<'a> {
    act: &'a Act,
    choreography: &'a Choreography,
    fleet: &'a Fleet,
}

fn act(a: Option<Side<'_>>, b: Option<Side<'_>>) -> ActDifferences {
    let (act_a, act_b) = (a.map(|side| side.act), b.map(|side| side.act));
    let cues = |act: Option<&Act>| act.map_or_else(Vec::new, |act| act.cues.clone());
    let robots = |act: Option<&Act>| act.into_iter().flat_map(robots_of).cloned().collect::<Vec<_>>();
    let readings = |act: Option<&Act>| act.map_or_else(Vec::new, |act| act.readings.clone());
    let closest = |act: Option<&Act>| act.and_then(self::closest);
    let bodies = |act: Option<&Act>| act.map_or_else(Vec::new, |act| act.in_space.bodies.clone());
    let settings = |side: Option<Side<'_>>| side.map(|side| settings(side.act, side.choreography));
    let (in_a, in_b) = (robots(act_a), robots(act_b));
    let (read_a, read_b) = (readings(act_a), readings(act_b));
    let (empty, no_fleet) = (empty_act(), Fleet::default());
    let none = || Devices::of(&empty, &no_fleet);
    let both = act_a.zip(act_b);
    ActDifferences {
        act: act_b.or(act_a).map(|act| act.name.clone()).unwrap_or_default(),
        presence: Presence::of(act_a, act_b),
        place: None,
        duration_ms: both.and_then(|(a, b)| Change::of(a.plan.duration(), b.plan.duration())),
        settings: settings(a).zip(settings(b)).map_or_else(Vec::new, |(a, b)| changed(a, &b)),
        robots_added: without(&in_b, &in_a),
        robots_removed: without(&in_a, &in_b),
        cues: self::cues(&cues(act_a), &cues(act_b)),
        devices: match (a.map(used), b.map(used)) {
            (Some(a), Some(b)) => devices(&a, &b),
            (Some(a), None) => devices(&a, &none()),
            (None, Some(b)) => devices(&none(), &b),
            (None, None) => Vec::new(),
        },
        readings_added: beyond(&read_b, &read_a),
        readings_removed: beyond(&read_a, &read_b),
        closest: Change::of(closest(act_a), closest(act_b)),
        bodies: matched(&bodies(act_a), &bodies(act_b), |body| &body.robot)
            .into_iter()
            .filter_map(|(a, b)| Change::of(a.cloned(), b.cloned()))
            .collect(),
    }
}

fn used(side: Side<'_>) -> Devices<'_> {
    Devices::of(side.act, side.fleet)
}

/// Returns the pair of robots that come closest to each other in an act. Sorts the pair by id, so that it does not depend on the fleet
/// file.
fn closest(act: &Act) -> Option<Closest> {
    let mut closest = act.in_space.closest.clone()?;
    closest.robots.sort();
    Some(closest)
}

/// Creates an empty act. An act that only one plan has is compared with it.
fn empty_act() -> Act {
    let plan = downbeat_scripts::Plan {
        scenario: String::new(),
        start_tolerance: Span::ZERO,
        lead: None,
        stop_condition: urrcp::StopCondition::default(),
        robots: Vec::new(),
    };
    let mut acts = Choreography::of_plan(plan).acts;
    acts.remove(0)
}

impl ActDifferences {
    fn is_empty(&self) -> bool {
        let Self { act: _, presence, place, duration_ms, settings, robots_added, robots_removed, .. } = self;
        let Self { cues, devices, readings_added, readings_removed, closest, bodies, .. } = self;
        *presence == Presence::Changed
            && (place.is_none() && duration_ms.is_none() && settings.is_empty())
            && (robots_added.is_empty() && robots_removed.is_empty() && cues.is_empty() && devices.is_empty())
            && (readings_added.is_empty() && readings_removed.is_empty())
            && (closest.is_none() && bodies.is_empty())
    }
}

fn cues(a: &[PlannedCue], b: &[PlannedCue]) -> Vec<CueDifference> {
    let differing = matched(a, b, |cue| cue.name.as_str()).into_iter().filter(|(a, b)| a != b);
    let mut all: Vec<CueDifference> = differing.filter_map(|(a, b)| cue(a, b)).collect();
    all.sort_by_key(|cue| cue.at_ms);
    all
}

fn cue(a: Option<&PlannedCue>, b: Option<&PlannedCue>) -> Option<CueDifference> {
    let shown = b.or(a)?;
    let both = a.zip(b);
    // Texts for people do not affect the plan.
    if both.is_some_and(|(a, b)| PlannedCue { text: b.text.clone(), ..a.clone() } == *b) {
        return None;
    }
    Some(CueDifference {
        cue: shown.name.clone(),
        presence: Presence::of(a, b),
        at_ms: shown.start,
        start_ms: both.and_then(|(a, b)| Change::of(a.start, b.start)),
        duration_ms: both.and_then(|(a, b)| Change::of(a.end - a.start, b.end - b.start)),
        slack_ms: both.and_then(|(a, b)| Change::of(a.slack, b.slack)),
        critical: both.and_then(|(a, b)| Change::of(a.critical, b.critical)),
    })
}

/// Prefix of the settings that represent the path of a robot's body by a hash. The step differences show how the paths differ.
pub(super) const PATH: &str = "path of ";

/// Returns the properties of an act other than its cues and scripts. References to following acts are given by name.
fn settings(act: &Act, choreography: &Choreography) -> BTreeMap<String, Value> {
    let named = |index: usize| choreography.acts.get(index).map(|act| act.name.clone());
    let way = |way: Way| match way {
        Way::Act(index) => json!({ "act": named(index) }),
        other => json!(other),
    };
    let mut settings = BTreeMap::from(
        [
            ("start_tolerance_ms", json!(act.plan.start_tolerance)),
            ("lead_ms", json!(act.plan.lead)),
            ("stop_condition", json!(act.plan.stop_condition)),
            ("wait", json!(act.wait)),
            ("timeout_ms", json!(act.timeout)),
            ("on_timeout", way(act.on_timeout)),
            ("next", way(act.next)),
            ("on_failure", json!(act.on_failure.default)),
            ("on_failure.then", json!(act.on_failure.then.map(named))),
            ("on_doubt", json!(act.on_doubt)),
        ]
        .map(|(key, value)| (key.to_owned(), value)),
    );
    for (robot, rule) in &act.on_failure.robots {
        settings.insert(format!("on_failure.{robot}"), json!(rule));
    }
    // The path follows from the steps, the fleet file and the previous acts.
    for path in act.in_space.driven.iter().filter(|path| robots_of(act).any(|robot| *robot == path.robot)) {
        let points = path.points.iter().map(|point| json!([point.at, point.pose]));
        let hash = ContentHash::of(json!(points.collect::<Vec<_>>()).to_string().as_bytes());
        settings.insert(format!("{PATH}{}", path.robot), json!(hash));
    }
    settings
}

fn changed(a: BTreeMap<String, Value>, b: &BTreeMap<String, Value>) -> Vec<Setting> {
    let mut all: BTreeMap<String, Change<Value>> = BTreeMap::new();
    for (setting, value) in b {
        let before = a.get(setting).cloned().unwrap_or_default();
        all.extend(Change::of(before, value.clone()).map(|change| (setting.clone(), change)));
    }
    for (setting, value) in a {
        if !b.contains_key(&setting) {
            all.extend(Change::of(value, Value::Null).map(|change| (setting, change)));
        }
    }
    all.into_iter().map(|(setting, change)| Setting { setting, change }).collect()
}

/// Computes the SHA-256 hash of everything that is compared in a plan. It does not depend on the order of entries in the fleet file.
pub(crate) fn hash(choreography: &Choreography) -> ContentHash {
    let acts: Vec<Value> = choreography.acts.iter().map(|act| content(act, choreography)).collect();
    ContentHash::of(json!({ "scenario": choreography.scenario, "acts": acts }).to_string().as_bytes())
}

fn content(act: &Act, choreography: &Choreography) -> Value {
    let mut scripts = Vec::new();
    for robot in &act.plan.robots {
        for script in &robot.scripts {
            let hash = Command::Script(script.script.clone()).content_hash();
            let key = (&robot.robot, &script.device);
            scripts
                .push((key, json!([robot.robot, script.device, script.start, script.stop_condition, hash])));
        }
    }
    scripts.sort_by_key(|(key, _)| *key);
    let mut cues: Vec<&PlannedCue> = act.cues.iter().collect();
    cues.sort_by(|a, b| a.name.cmp(&b.name));
    let mut uses: Vec<_> = act.devices.iter().collect();
    uses.sort_by_key(|used| (&used.robot, &used.device));
    let mut bodies: Vec<_> = act.in_space.bodies.iter().collect();
    bodies.sort_by_key(|body| &body.robot);
    let mut readings: Vec<_> = act.readings.iter().collect();
    readings.sort_by_key(|reading| (&reading.robot, &reading.sensor, reading.at));
    let mut robots: Vec<&RobotId> = robots_of(act).collect();
    robots.sort();
    json!({
        "act": act.name,
        "robots": robots,
        "scripts": scripts.into_iter().map(|(_, script)| script).collect::<Vec<_>>(),
        "cues": cues,
        "devices": uses,
        "closest": closest(act),
        "bodies": bodies,
        "readings": readings,
        "settings": settings(act, choreography),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_scripts::{
        DeviceScript, DeviceUse, DrivenPath, DrivenPoint, NoFiles, OnDoubt, OnFailure, RobotPlan, Source,
        Wait, compile,
    };
    use urrcp::{ControlType, Millis, Script, Setpoint, Step, StopCondition};

    fn script(value: f64, start: f64) -> DeviceScript {
        let step = Step::new(Millis::new(5.0).unwrap(), Setpoint::new(ControlType::Position, value));
        DeviceScript {
            device: "d".parse().unwrap(),
            start: Millis::new(start).unwrap(),
            stop_condition: StopCondition::default(),
            script: Script::new(vec![step]).unwrap(),
            rest: Span::ZERO,
        }
    }

    fn robot(id: &str) -> RobotPlan {
        RobotPlan { robot: id.parse().unwrap(), scripts: vec![script(1.0, 0.0)] }
    }

    fn body(speed: f64) -> BodyUse {
        BodyUse { robot: "r".parse().unwrap(), speed, acceleration: 1.0 }
    }

    fn closest_at(distance: f64) -> Option<Closest> {
        let robots = ["r", "q"].map(|id| id.parse().unwrap());
        Some(Closest { robots, at: Span::ZERO, distance })
    }

    fn path(x: f64) -> DrivenPath {
        let points = vec![DrivenPoint { at: Span::ZERO, pose: [x, 0.0, 0.0] }];
        DrivenPath { robot: "r".parse().unwrap(), points }
    }

    fn reading(at: i64) -> PlannedReading {
        PlannedReading {
            robot: "r".parse().unwrap(),
            sensor: "s".parse().unwrap(),
            at: Span::from_millis(at),
        }
    }

    fn used(worst_error: f64) -> DeviceUse {
        DeviceUse {
            robot: "r".parse().unwrap(),
            device: "d".parse().unwrap(),
            steps: 1,
            at_least: 1,
            scripts: 1,
            budget: 8,
            worst_error,
            worst_at: Span::ZERO,
            factor_max: f64::INFINITY,
            entry_factor_max: f64::INFINITY,
            speed_max: None,
            is_unlimited: false,
        }
    }

    fn choreography() -> Choreography {
        let text = "scenario: s\nacts:\n  - {act: one, cues: [{cue: a, at: 0s}]}\n  - {act: two, cues: [{cue: b, at: 0s}]}\n";
        let source = Source { name: "s.yaml".into(), text: text.to_owned() };
        let mut choreography = compile(&source, &Fleet::default(), &NoFiles).choreography.unwrap();
        let act = &mut choreography.acts[0];
        act.plan.robots = vec![robot("r"), robot("q")];
        act.devices = vec![used(0.1)];
        act.readings = vec![reading(1)];
        act.in_space.closest = closest_at(1.0);
        act.in_space.bodies = vec![body(1.0)];
        act.in_space.driven = vec![path(1.0)];
        choreography
    }

    #[track_caller]
    fn check(change: impl FnOnce(&mut Choreography), told: bool) {
        let (a, mut b) = (choreography(), choreography());
        change(&mut b);
        let fleet = Fleet::default();
        for found in [plans((&a, &fleet), (&b, &fleet)), plans((&b, &fleet), (&a, &fleet))] {
            let listed = !found.acts.is_empty() || found.scenario.is_some();
            assert_eq!((found.same, listed), (!told, told), "{found:#?}");
        }
    }

    #[test]
    fn every_change_of_the_hash_is_listed() {
        let act = |change: fn(&mut Act)| check(|b| change(&mut b.acts[0]), true);
        check(|b| b.scenario.push('x'), true);
        check(|b| b.acts.swap(0, 1), true);
        check(|b| drop(b.acts.pop()), true);
        act(|act| act.name.push('x'));
        act(|act| act.cues[0].name.push('x'));
        act(|act| act.cues[0].start = Span::from_nanos(1));
        act(|act| act.cues[0].end = Span::from_nanos(1));
        act(|act| act.cues[0].slack = Span::from_nanos(1));
        act(|act| act.cues[0].critical ^= true);
        act(|act| act.devices = vec![used(0.2)]);
        act(|act| act.devices.clear());
        act(|act| act.in_space.closest = closest_at(0.5));
        act(|act| act.in_space.bodies = vec![body(2.0)]);
        act(|act| act.in_space.driven = vec![path(2.0)]);
        act(|act| act.readings.push(reading(2)));
        act(|act| act.readings.push(reading(1)));
        act(|act| act.wait = Wait::Operator);
        act(|act| act.timeout = Some(Span::ZERO));
        act(|act| act.on_timeout = Way::End);
        act(|act| act.next = Way::End);
        act(|act| act.on_failure.default = OnFailure::Home);
        act(|act| act.on_failure.then = Some(1));
        act(|act| act.on_failure.robots.push(("r".parse().unwrap(), OnFailure::Home)));
        act(|act| act.on_doubt = OnDoubt::Withdraw);
        act(|act| act.plan.lead = Some(Span::ZERO));
        act(|act| act.plan.start_tolerance = Span::ZERO);
        act(|act| act.plan.stop_condition = StopCondition::both(Millis::new(7.0).unwrap()));
        act(|act| drop(act.plan.robots.pop()));
        act(|act| act.plan.robots[0].scripts[0] = script(1.5, 0.0));
        act(|act| act.plan.robots[0].scripts[0] = script(1.0, 1.0));
        act(|act| act.plan.robots[0].scripts.push(script(1.0, 9.0)));
        act(|act| {
            act.plan.robots[0].scripts[0].stop_condition = StopCondition::both(Millis::new(7.0).unwrap());
        });
    }

    #[test]
    fn order_of_robots_is_not_a_difference() {
        check(|_| {}, false);
        check(|b| b.acts[0].plan.robots.swap(0, 1), false);
        check(|b| b.acts[0].in_space.closest.as_mut().unwrap().robots.reverse(), false);
    }

    #[test]
    fn next_act_is_compared_by_name_regardless_of_position() {
        let (mut a, fleet) = (choreography(), Fleet::default());
        a.acts[0].next = Way::Act(1);
        let mut b = a.clone();
        let mut between = b.acts[1].clone();
        between.name = "between".to_owned();
        b.acts.insert(1, between);
        b.acts[0].next = Way::Act(2);
        let found = plans((&a, &fleet), (&b, &fleet));
        assert_eq!(found.acts.iter().map(|act| act.act.as_str()).collect::<Vec<_>>(), ["between"]);
    }
}
