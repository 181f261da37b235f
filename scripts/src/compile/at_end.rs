//! Implements `at_end: home`: after each transition to the end, an act moves devices to their default values.

use std::collections::HashMap;

use urrcp::{ControlType, Device, DeviceId, Interpolation, RobotId, Span};

use super::cast::{Cast, Rest};
use super::poses::{self, DeviceWay, settable, unused_name};
use crate::duration::written;
use crate::fields::Reader;
use crate::finding::{Code, Finding};
use crate::fleet::Fleet;
use crate::motion::Easing;
use crate::plan::{Act, Positions, Way};
use crate::render::counted;
use crate::scenario::{AtEnd, Scenario};

const NAME: &str = "home";
/// The shortest duration that is computed for an act that moves devices home, in seconds.
const OVER_MIN: f64 = 1.0;
/// The duration of a linear movement of a device without a speed limit, in seconds.
const OVER_WITHOUT_LIMITS: f64 = 5.0;
/// Maximum number of acts that `at_end` adds. Each of them is compiled separately, for the whole fleet.
const HOMES_MAX: usize = 32;
/// Margin that is added to the shortest duration within the limits, as a fraction of it: on a grid, some steps are faster than the smooth
/// movement.
const SLACK: f64 = 0.02;

/// Positions in which acts leave devices. Keys are indices of acts.
#[derive(Default)]
pub(super) struct Rests {
    /// Positions after a regular end of the act.
    pub(super) ended: HashMap<usize, Rest>,
    /// Positions after a timeout of the act's wait, if the mission ends then.
    pub(super) timed_out: HashMap<usize, Rest>,
}

/// Adds an act that moves devices home for each set of positions in which the mission may end.
pub(super) fn go_home(
    findings: &mut Reader,
    scenario: &Scenario,
    cast: &Cast<'_>,
    fleet: &Fleet,
    acts: &mut Vec<Act>,
    rests: &Rests,
) {
    let Some(at_end) = &scenario.at_end else { return };
    let before = findings.found.len();
    let mut homes = Homes { at_end, scenario, cast, fleet, known: Vec::new() };
    for act in 0..acts.len() {
        let ends = [(acts[act].next, &rests.ended), (acts[act].on_timeout, &rests.timed_out)];
        let [next, on_timeout] = ends.map(|(way, rests)| match (way, rests.get(&act)) {
            (Way::End, Some(rest)) => homes.way(findings, acts, act, rest).unwrap_or(way),
            _ => way,
        });
        (acts[act].next, acts[act].on_timeout) = (next, on_timeout);
        if findings.found.len() > before {
            return;
        }
    }
    if homes.known.is_empty() && findings.errors() == 0 {
        let message = "`at_end: home` moves nothing".to_owned();
        let expected = "a device that the scenario moves and whose description has a `default_value`";
        findings.add(Code::NothingToDo, at_end.place.clone(), message, expected, None);
    }
}

/// The acts that `at_end` adds, each with its movements.
struct Homes<'a> {
    at_end: &'a AtEnd,
    scenario: &'a Scenario,
    cast: &'a Cast<'a>,
    fleet: &'a Fleet,
    known: Vec<(Homecoming, usize)>,
}

impl Homes<'_> {
    /// Returns the transition from `act`, which leaves devices in the positions `rest`, to an act that moves them home. Adds this act if
    /// no earlier one is suitable. `None` if nothing has to move, or after a finding.
    fn way(&mut self, findings: &mut Reader, acts: &mut Vec<Act>, act: usize, rest: &Rest) -> Option<Way> {
        let home = Homecoming::from(findings, self.at_end, self.cast, &acts[act].name, rest)?;
        let rule = |act: &Act| (act.on_failure.default, act.on_failure.robots.clone(), act.on_doubt);
        let same =
            |(other, index): &&(Homecoming, usize)| *other == home && rule(&acts[*index]) == rule(&acts[act]);
        if let Some((_, index)) = self.known.iter().find(same) {
            return Some(Way::Act(*index));
        }
        if self.known.len() == HOMES_MAX {
            let message = format!(
                "the mission may end with more than {HOMES_MAX} different combinations of device positions"
            );
            let hint = Some(
                "reduce the number of acts that lead to the end, or add one act that follows all of them"
                    .to_owned(),
            );
            let expected = format!("at most {HOMES_MAX}");
            findings.add(Code::TooMuch, self.at_end.place.clone(), message, expected, hint);
            return None;
        }
        let mut added = self.compiled(findings, &home)?;
        poses::name_like(&mut added, unused_name(NAME, acts), &self.scenario.name, &acts[act]);
        acts.push(added);
        self.known.push((home, acts.len() - 1));
        Some(Way::Act(acts.len() - 1))
    }

    fn compiled(&self, findings: &mut Reader, home: &Homecoming) -> Option<Act> {
        let place = || self.at_end.place.clone();
        if let Some(over) = self.at_end.over.filter(|over| *over < home.needed) {
            let needed = written(tenths_of_a_second(home.needed.as_millis_f64() / 1_000.0));
            let message = format!(
                "the return home lasts {}, but the limits of the devices require at least {needed}",
                written(over)
            );
            let hint =
                Some(format!("write `at_end: {{home: {needed}}}`, or `at_end: home` for the shortest time"));
            findings.add(Code::TooFast, place(), message, format!("{needed} or more"), hint);
            return None;
        }
        let ways: Vec<_> = home
            .devices
            .iter()
            .map(|moved| {
                let (robot, device, [from, to]) = moved;
                DeviceWay { robot, device, from: *from, to: *to }
            })
            .collect();
        let over = self.at_end.over.unwrap_or(home.over);
        let standing = poses::standing(self.fleet, &home.positions());
        let compiled = poses::compiled("at_end", &ways, &standing, over);
        let tell = |errors: Vec<Finding>| {
            for error in errors {
                let message =
                    format!("during the return home, which lasts {}: {}", written(over), error.message);
                let hint = "allow more time, as in `at_end: {home: 10s}`, or add an act that moves the devices home one after another";
                findings.add(error.code, place(), message, error.expected, Some(hint.to_owned()));
            }
        };
        compiled.map_err(tell).ok()
    }
}

/// The devices that move home, and the duration of their movement.
#[derive(PartialEq)]
struct Homecoming {
    devices: Vec<(RobotId, DeviceId, [f64; 2])>,
    over: Span,
    /// The shortest duration that the limits of the devices permit.
    needed: Span,
}

impl Homecoming {
    /// Creates the movements home. `None` if nothing has to move, or if the position of a device is unknown.
    fn from(findings: &mut Reader, at_end: &AtEnd, cast: &Cast<'_>, act: &str, rest: &Rest) -> Option<Self> {
        let mut left: Vec<_> = rest.iter().collect();
        left.sort_unstable_by_key(|(device, _)| **device);
        let (mut devices, mut over, mut needed, mut unknown) = (Vec::new(), OVER_MIN, 0.0_f64, Vec::new());
        for ((robot, index), left) in left {
            let device = &cast.devices(*robot)[*index];
            let is_position = device.primary_control_type() == Some(ControlType::Position);
            let Some(to) = device.default_value.filter(|_| is_position) else { continue };
            let Some(from) = left.certainly() else {
                unknown.push(format!("`{}/{}`", cast.id(*robot), device.id));
                continue;
            };
            let (from, to) = (settable(device, from), settable(device, to));
            if from != to {
                let shortest = shortest(cast, *robot, device, (to - from).abs());
                needed = needed.max(shortest.unwrap_or(0.0));
                // If the device has no limit, a linear one has an unknown speed, and a lamp may change immediately.
                let usual = if device.interpolation == Interpolation::Linear {
                    OVER_WITHOUT_LIMITS
                } else {
                    OVER_MIN
                };
                over = over.max(shortest.map_or(usual, |seconds| seconds * (1.0 + SLACK)));
            }
            devices.push((cast.id(*robot).clone(), device.id.clone(), [from, to]));
        }
        if let [first, others @ ..] = unknown.as_slice() {
            let others = match others.len() {
                0 => String::new(),
                others => format!(" and {}", counted(others, "other device")),
            };
            let message = format!("the position of {first}{others} after the act `{act}` is unknown");
            let hint =
                "move it in this act, because its position depends on which acts came before".to_owned();
            findings.add(
                Code::UnknownBeginning,
                at_end.place.clone(),
                message,
                "one position for each device",
                Some(hint),
            );
            return None;
        }
        let moves = devices.iter().any(|(.., [from, to])| from != to);
        let needed = Span::from_millis_f64(needed * 1_000.0);
        moves.then_some(Self { devices, over: tenths_of_a_second(over), needed })
    }

    fn positions(&self) -> Positions {
        let mut positions = Positions::new();
        for (robot, device, [from, _]) in &self.devices {
            positions.entry(robot.clone()).or_default().insert(device.clone(), *from);
        }
        positions
    }
}

/// Rounds up to tenths of a second, which are easy to read.
fn tenths_of_a_second(seconds: f64) -> Span {
    Span::from_millis_f64((seconds * 10.0).ceil() * 100.0)
}

/// Returns the shortest duration of a smooth movement over `distance` within the device's limits, in seconds. `None` if it has no limit.
fn shortest(cast: &Cast<'_>, robot: usize, device: &Device, distance: f64) -> Option<f64> {
    let limits = cast.limits(robot, device, ControlType::Position);
    let by_speed = limits.speed.map(|speed| Easing::Smooth.slope_max() * distance / speed);
    let by_acceleration = limits
        .acceleration
        .map(|acceleration| (Easing::Smooth.curvature_max() * distance / acceleration).sqrt());
    by_speed.into_iter().chain(by_acceleration).reduce(f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Address;
    use crate::compile::{Compiled, compile};
    use crate::files::NoFiles;
    use crate::fleet::FleetRobot;
    use crate::plan::{OnDoubt, OnFailure};
    use crate::source::Source;

    fn compiled(text: &str) -> Compiled {
        let block = serde_json::from_str(poses::ARM).unwrap();
        let robots = vec![FleetRobot::new("arm".parse().unwrap(), Address::Simulated, Some(block))];
        let fleet = Fleet { robots, ..Fleet::default() };
        compile(
            &Source { name: "show.yaml".into(), text: format!("scenario: show\n{text}") },
            &fleet,
            &NoFiles,
        )
    }

    fn acts(text: &str) -> Vec<Act> {
        let compiled = compiled(text);
        compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings)).acts
    }

    /// Returns the first and the last value of a device in an act, and the offset of the last value.
    fn moved(act: &Act, device: &str) -> Option<([f64; 2], Span)> {
        let script = act.plan.robots[0].scripts.iter().find(|script| script.device.as_str() == device)?;
        let steps = script.script.steps();
        Some(([&steps[0], &steps[steps.len() - 1]].map(|step| step.setpoint.value), script.script.duration()))
    }

    const CUES: &str = "cues: [{at: 0s, robots: arm, tracks: {joint: [{at: 0s, to: 0}, {at: 4s, to: 80, ease: smooth}], lamp: [{at: 0s, to: 50}]}}]";

    #[test]
    fn only_devices_moved_by_scenario_return_home() {
        let acts = acts(&format!("at_end: home\nstart_tolerance: 20ms\n{CUES}"));
        assert_eq!(
            acts.iter().map(|act| (act.name.as_str(), act.next)).collect::<Vec<_>>(),
            [("", Way::Act(1)), ("home", Way::End)]
        );
        let home = &acts[1];
        // 1.875 * 80 / 60 = 2.5 s, plus 2 %.
        assert_eq!(moved(home, "joint"), Some(([80.0, 0.0], Span::from_millis(2_600))));
        assert_eq!(moved(home, "lamp").unwrap().0, [50.0, 0.0]);
        assert_eq!(moved(home, "still"), None);
        assert_eq!(home.plan.start_tolerance, Span::from_millis(20));
    }

    #[test]
    fn home_duration_is_kept_or_refused_on_its_line_if_too_short() {
        let long = acts(&format!("at_end: {{home: 9s}}\n{CUES}"));
        assert_eq!(moved(&long[1], "joint"), Some(([80.0, 0.0], Span::from_millis(9_000))));
        let short = compiled(&format!("at_end: {{home: 1s}}\n{CUES}")).findings;
        let [finding] = short.as_slice() else { panic!("{short:#?}") };
        assert_eq!((finding.code, finding.line), (Code::TooFast, 2));
        assert!(
            finding.message.contains("lasts 1s, but the limits of the devices require at least 2.5s"),
            "{finding:?}"
        );
    }

    const WAYS: &str = "acts:
  - {act: high, wait: {for: operator, timeout: 9s, otherwise: low}, cues: [{at: 0s, robots: arm, tracks: {joint: [{at: 2s, to: 60}]}}], next: NEXT}
  - {act: low, cues: [{at: 0s, robots: arm, tracks: {joint: [{at: 2s, to: -20}], lamp: [{at: 0s, to: 9}]}}], next: LAST}
";

    #[test]
    fn each_path_to_end_has_its_own_home_act() {
        let acts = acts(&format!("at_end: home\n{}", WAYS.replace("NEXT", "end").replace("LAST", "end")));
        let ways: Vec<_> = acts.iter().map(|act| (act.name.as_str(), act.next)).collect();
        assert_eq!(
            ways,
            [("high", Way::Act(2)), ("low", Way::Act(3)), ("home", Way::End), ("home-2", Way::End)]
        );
        assert_eq!(moved(&acts[2], "joint").unwrap().0, [60.0, 0.0]);
        assert_eq!(moved(&acts[3], "joint").unwrap().0, [-20.0, 0.0]);
    }

    #[test]
    fn position_that_depends_on_previous_acts_is_refused() {
        let last = "  - {act: last, cues: [{at: 0s, robots: arm, tracks: {still: [{at: 0s, to: 7}]}}]}\n";
        let ways = WAYS.replace("NEXT", "last").replace("LAST", "last");
        let findings = compiled(&format!("at_end: home\n{ways}{last}")).findings;
        let [finding] = findings.as_slice() else { panic!("{findings:#?}") };
        assert_eq!((finding.code, finding.line), (Code::UnknownBeginning, 2));
        assert!(
            finding.message.contains("`arm/joint` and 1 other device after the act `last`"),
            "{}",
            finding.message
        );
    }

    #[test]
    fn mission_ended_by_wait_timeout_returns_home_from_current_positions() {
        let text = format!(
            "at_end: home\nacts:\n  - {{act: one, {CUES}}}\n  - {{act: two, wait: {{for: operator, timeout: 1s, otherwise: end}}, \
             cues: [{{at: 0s, robots: arm, tracks: {{joint: [{{at: 2s, to: 0}}], lamp: [{{at: 0s, to: 0}}]}}}}]}}\n"
        );
        let acts = acts(&text);
        // Act two leaves devices at home.
        assert_eq!((acts[1].next, acts[1].on_timeout), (Way::End, Way::Act(2)));
        assert_eq!(moved(&acts[2], "joint").unwrap().0, [80.0, 0.0]);
    }

    #[test]
    fn end_with_every_device_already_home_is_refused() {
        let there = "at_end: home\ncues: [{at: 0s, robots: arm, tracks: {still: [{at: 0s, to: 0}]}}]\n";
        let findings = compiled(there).findings;
        assert_eq!(findings.iter().map(|finding| finding.code).collect::<Vec<_>>(), [Code::NothingToDo]);
    }

    #[test]
    fn home_act_keeps_failure_policy_of_last_act() {
        let acts = acts(&format!(
            "at_end: home\non_failure: {{default: without, arm: home}}\non_doubt: withdraw\n{CUES}"
        ));
        assert_eq!(acts[1].on_failure, acts[0].on_failure);
        assert_eq!(acts[1].on_doubt, OnDoubt::Withdraw);
        let then =
            "acts:\n  - {act: one, on_failure: {default: without, then: end}, CUES}\n".replace("CUES", CUES);
        let acts = super::tests::acts(&format!("at_end: home\n{then}"));
        assert_eq!((acts[1].on_failure.default, acts[1].on_failure.then), (OnFailure::Without, None));
    }

    #[test]
    fn speed_controlled_joint_has_unknown_position_at_end() {
        let track = "joint: {control: speed, keyframes: [{at: 0s, to: 20}, {at: 1s, to: 0}]}";
        let driven = format!(
            "at_end: home\ncues: [{{at: 0s, robots: arm, tracks: {{{track}, still: [{{at: 0s, to: 5}}]}}}}]\n"
        );
        let findings = compiled(&driven.replace("TRACK", track)).findings;
        assert!(findings.iter().any(|finding| finding.code == Code::UnknownBeginning), "{findings:#?}");
    }

    /// After a timeout, the act that would have moved the joint is skipped.
    #[test]
    fn skipped_act_makes_position_unknown() {
        let text = "at_end: home\nacts:
  - {act: one, wait: {for: operator, timeout: 1s, otherwise: two}, cues: [{at: 0s, robots: arm, tracks: {joint: [{at: 2s, to: 60}]}}]}
  - {act: two, cues: [{at: 0s, robots: arm, tracks: {lamp: [{at: 0s, to: 9}]}}]}\n";
        let findings = compiled(text).findings;
        let [finding] = findings.as_slice() else { panic!("{findings:#?}") };
        assert!(finding.message.contains("`arm/joint` after the act `two`"), "{finding:?}");
    }

    #[test]
    fn too_many_different_ends_are_refused_with_one_finding() {
        let act = |number: usize| {
            format!(
                "  - {{act: a{number}, wait: {{for: operator, timeout: 1s, otherwise: end}}, \
                     cues: [{{at: 0s, robots: arm, tracks: {{lamp: [{{at: 0s, to: {number}}}]}}}}]}}\n"
            )
        };
        let acts: String = (1..90).map(act).collect();
        let findings = compiled(&format!("at_end: home\nacts:\n{acts}")).findings;
        assert_eq!(findings.iter().map(|finding| finding.code).collect::<Vec<_>>(), [Code::TooMuch]);
    }
}
