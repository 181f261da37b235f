//! Compiles a scenario for a fleet to a choreography, and checks the choreography against the declarations of each robot.
//!
//! The stages for an act are `cast` (the robots of a cue), `schedule` (the times of the cues), `perform` (the steps of each device for
//! each cue) and `join` (one chain of scripts per device). Then follows a stage for all acts: [`downbeat_plan::compensate`] (commands
//! ahead of motions). `check_*` contain the rules, `acts` the graph of acts.

mod acts;
mod ahead;
mod at_end;
mod cast;
mod check_formations;
mod check_motion;
mod check_refill;
mod check_require;
mod check_safety;
mod check_space;
mod check_values;
mod conflict;
mod courses;
mod cut;
mod join;
mod jumps;
mod outline;
mod overlap;
mod perform;
pub(crate) mod poses;
mod schedule;
mod segment;
mod vectors;

use std::collections::{BTreeMap, HashMap, HashSet};

use urrcp::Span;

use crate::budget::{Budget, KNOTS_MAX, STEPS_MAX};
use crate::fields::Reader;
use crate::files::Files;
use crate::finding::{Code, Finding, Severity};
use crate::fleet::{Fleet, devices_of};
use crate::identify::{Document, mistaken_by_keys};
use crate::keys::Keys;
use crate::locate::locate;
use crate::plan::{Act, Choreography, Plan, Way, compensate};
use crate::scenario::{self, Documents, Scenario, ScenarioKeys};
use crate::source::Source;

use cast::Cast;
use join::Joined;
use jumps::Passages;

pub use outline::{Gap, Moment, Outline, WrittenAct, WrittenCue, WrittenRelation, outline};

/// Result of compiling a scenario.
#[derive(Clone, Debug)]
pub struct Compiled {
    /// The compiled choreography; `None` if there are errors.
    pub choreography: Option<Choreography>,
    /// All errors and warnings, in the order of the files.
    pub findings: Vec<Finding>,
}

/// Reads, checks and compiles a scenario for a fleet.
#[must_use]
pub fn compile(source: &Source, fleet: &Fleet, files: &dyn Files) -> Compiled {
    let documents = match scenario::documents(source, files) {
        Ok(documents) => documents,
        Err(findings) => return Compiled { choreography: None, findings },
    };
    let root = documents.nodes.first();
    let mistaken =
        root.and_then(|root| mistaken_by_keys(source, root, Document::Scenario, ScenarioKeys::NAMES));
    if let Some(mistaken) = mistaken {
        return Compiled { choreography: None, findings: vec![mistaken] };
    }
    let mut reader = Reader::default();
    reader.knots = Budget::new(knots_max(fleet));
    let scenario = scenario::read(&mut reader, &documents, files, fleet);
    let Documents { sources, nodes, .. } = documents;
    drop(nodes);
    let readable = reader.found.is_empty();
    let mut compiler = Compiler { scenario: scenario.unwrap_or_default(), findings: reader };
    let choreography = compiler.choreography(fleet, readable);
    let findings = locate(&sources, compiler.findings.finish());
    let sound = findings.iter().all(|finding| finding.severity == Severity::Warning);
    Compiled { choreography: choreography.filter(|_| sound), findings }
}

/// Returns the maximum number of knots in a scenario; it is higher if a device accepts very long scripts.
fn knots_max(fleet: &Fleet) -> usize {
    let devices = fleet.robots.iter().flat_map(devices_of);
    let longest = devices.map(perform::capacity).max().unwrap_or(0);
    longest.clamp(KNOTS_MAX, 2 * KNOTS_MAX)
}

/// Number of robots, summed over cues, after which times of further acts are not computed ahead. These times would all be kept until the
/// first act is created.
const MEMBERS_AHEAD_MAX: usize = 1_000_000;

struct Compiler {
    scenario: Scenario,
    findings: Reader,
}

impl Compiler {
    /// Creates the choreography. `readable` states whether everything could be read; only then can references be checked.
    fn choreography(&mut self, fleet: &Fleet, readable: bool) -> Option<Choreography> {
        let scenario = std::mem::take(&mut self.scenario);
        let cast = Cast::new(fleet, &scenario.roles);
        cast.check_roles(&mut self.findings);
        let ways = acts::ways(&mut self.findings, &scenario.acts, &cast, readable);
        let horizon = scenario.horizon();
        let mut known = self.first_times(&scenario, &cast).into_iter();
        let mut fits = ahead::fits(&timed(&scenario, known.as_slice()), &cast, horizon);
        let (mut rests, mut poses) = (at_end::Rests::default(), HashMap::new());
        let mut incomplete = HashSet::new();
        let mut room = Budget::new(STEPS_MAX);
        let mut acts = Vec::with_capacity(scenario.acts.len());
        let (mut first_movements, mut moved) = (Vec::new(), Vec::new());
        let others: Vec<_> = (0..ways.len()).map(|index| cast::OtherWays::into(&ways, index)).collect();
        for (index, (act, ways)) in scenario.acts.iter().zip(ways).enumerate() {
            let before = cast::leading_to(&acts, index);
            let positions = cast::Positions::after(fleet, &before, &rests.ended, index == 0, others[index]);
            let times = known.next().unwrap_or_else(|| self.times(act, &cast, horizon));
            let mut performer = perform::Performer::new(&mut self.findings, &cast, &mut fits, horizon);
            for ((cue, members), time) in act.cues.iter().zip(&times.members).zip(&times.times) {
                performer.cue(cue, members, time);
            }
            if times.consistent {
                let ground = perform::Ground { of_scenario: scenario.ground(fleet), positions: &positions };
                performer.groups(act, &times.members, &times.times, ground);
            }
            let (segments, readings) = (performer.segments, performer.readings);
            incomplete.extend(performer.incomplete);
            // If times contradict each other, cues would seem to overlap.
            if !times.consistent {
                acts.push(None);
                first_movements.push(Vec::new());
                moved.push(HashMap::new());
                continue;
            }
            let Joined { robots, devices, rest, places, first } =
                join::join(&mut self.findings, &scenario, &cast, segments, &mut room);
            first_movements.push(first);
            moved.push(places);
            let stage = check_space::Stage {
                cast: &cast,
                requirements: &scenario.requirements,
                act,
                times: &times,
                robots: &robots,
                devices: &devices,
                positions: &positions,
                incomplete: &incomplete,
                standing: &courses::Standing::after((index > 0).then_some(before.as_slice()), &poses),
            };
            let (in_space, left) = check_space::check(&mut self.findings, &stage);
            poses.insert(index, left);
            if scenario.at_end.is_some() && ways.on_timeout == Way::End {
                rests.timed_out.insert(index, positions.left_by(HashMap::new()));
            }
            rests.ended.insert(index, positions.left_by(rest));
            let title = match act.name.as_str() {
                "" => scenario.name.clone(),
                name => format!("{}, {name}", scenario.name),
            };
            let plan = Plan {
                scenario: title,
                start_tolerance: scenario.start_tolerance,
                lead: scenario.lead,
                stop_condition: scenario.stop_condition,
                robots,
            };
            acts.push(Some(Act {
                name: act.name.clone(),
                plan,
                lead_in: Span::ZERO,
                latencies: BTreeMap::new(),
                cues: schedule::planned(act, &times.times),
                devices,
                in_space,
                readings,
                wait: ways.wait,
                timeout: act.wait.timeout,
                on_timeout: ways.on_timeout,
                next: ways.next,
                on_failure: ways.on_failure,
                on_doubt: act.on_doubt,
            }));
        }
        check_formations::check(&mut self.findings, &scenario, fleet);
        check_safety::check(&mut self.findings, &scenario, &acts);
        // If the times of an act contradict each other, the final positions of its devices are unknown.
        let mut acts: Vec<Act> = acts.into_iter().collect::<Option<_>>()?;
        let passages = Passages::of(&acts, &cast);
        let entries = jumps::Entries { acts: &scenario.acts, first: &first_movements, moved: &moved };
        let factors = jumps::check_entries(&mut self.findings, &cast, &passages, entries);
        limit_entries(&mut acts, &cast, &factors);
        compensate::compensate(&mut acts, fleet);
        at_end::go_home(&mut self.findings, &scenario, &cast, fleet, &mut acts, &rests);
        let choreography = Choreography {
            scenario: scenario.name.clone(),
            acts,
            requirements: scenario.requirements.clone(),
        }
        .with_shared_scripts();
        check_require::check(&mut self.findings, &scenario, &choreography);
        check_refill::check(&mut self.findings, &scenario, &cast, &choreography);
        Some(choreography)
    }

    /// Computes the times of the acts in order. If the cues have very many robots, computes only the times of the first acts.
    fn first_times(&mut self, scenario: &Scenario, cast: &Cast<'_>) -> Vec<Times> {
        let mut known: Vec<Times> = Vec::new();
        let mut members = 0usize;
        let cues = scenario.acts.iter().flat_map(|act| act.cues.iter().map(|cue| (&cue.name, &act.name)));
        self.findings.act_of = cues.map(|(cue, act)| (cue.clone(), act.clone())).collect();
        for act in &scenario.acts {
            if members > MEMBERS_AHEAD_MAX {
                break;
            }
            let times = self.times(act, cast, scenario.horizon());
            members += times.members.iter().map(|members| members.all.len()).sum::<usize>();
            known.push(times);
        }
        known
    }

    /// Returns the robots in an act's cues, and the times of these cues.
    fn times(&mut self, act: &scenario::Act, cast: &Cast<'_>, horizon: Span) -> Times {
        let members: Vec<_> =
            act.cues.iter().map(|cue| cast.members(&mut self.findings, cue, horizon)).collect();
        let before = self.findings.found.len();
        let (times, consistent) = schedule::schedule(&mut self.findings, act, &members, cast, horizon);
        if act.faults > 0 {
            self.findings.keep_from(before, |code| !matches!(code, Code::Conflict | Code::NoOrder));
        }
        // If a cue could be read only in part, its times are unknown.
        Times { members, times, consistent: consistent && act.faults == 0 }
    }
}

/// Stores, for each device in an act, the largest show speed factor at which the device can reach its first keyframe in time.
fn limit_entries(acts: &mut [Act], cast: &Cast<'_>, factors: &jumps::Factors) {
    for (act, planned) in acts.iter_mut().enumerate().filter(|_| !factors.is_empty()) {
        for used in &mut planned.devices {
            let Some(robot) = cast.index(&used.robot) else { continue };
            let index = cast.devices(robot).iter().position(|device| device.id == used.device);
            let factor = index.and_then(|index| factors.get(&(act, robot, index)));
            used.entry_factor_max = factor.copied().unwrap_or(f64::INFINITY);
        }
    }
}

/// The robots and times of an act's cues, before the movements are computed.
struct Times {
    members: Vec<cast::Members>,
    times: Vec<schedule::CueTime>,
    /// Whether the times satisfy all constraints of the act.
    consistent: bool,
}

/// Returns all cues of all acts with their robots and times.
fn timed<'a>(scenario: &'a Scenario, times: &'a [Times]) -> Vec<ahead::Timed<'a>> {
    let of_act = |(act, known): (&'a scenario::Act, &'a Times)| {
        let cues = act.cues.iter().zip(&known.members).zip(&known.times);
        cues.map(|((cue, members), time)| ahead::Timed { cue, members, time })
    };
    scenario.acts.iter().zip(times).flat_map(of_act).collect()
}
