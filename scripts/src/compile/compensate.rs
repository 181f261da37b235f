//! Actuation latency: each device is commanded earlier by the time that it takes to move, so that motions begin when they are
//! written. Where a script would then begin before its act, the act's motions begin later by its `lead_in`.
//!
//! Before, a script's start is when its motion begins; after, when it is commanded. [`Act::moves_at`] is the way back.

use std::collections::{BTreeMap, HashMap};

use urrcp::{Millis, Span};

use crate::fleet::Fleet;
use crate::plan::{Act, DeviceScript, Way};

/// Compensates what the fleet says of its devices in acts that are not compensated yet.
pub(super) fn compensate(acts: &mut [Act], fleet: &Fleet) {
    if fleet.robots.iter().all(|robot| robot.mission.latencies.is_empty()) {
        return;
    }
    let robots: HashMap<_, _> = fleet.robots.iter().map(|robot| (&robot.id, robot)).collect();
    for act in &mut *acts {
        for planned in &act.plan.robots {
            let Some(robot) = robots.get(&planned.robot) else { continue };
            let known = planned.scripts.iter().filter_map(|script| {
                let latency = robot.mission.latencies.get(&script.device)?;
                Some((script.device.clone(), *latency))
            });
            let known: BTreeMap<_, _> = known.collect();
            if !known.is_empty() {
                act.latencies.insert(planned.robot.clone(), known);
            }
        }
    }
    apply(acts);
}

/// Compensates the latencies that the acts know.
pub(crate) fn apply(acts: &mut [Act]) {
    for (act, lead_in) in lead_ins(acts).into_iter().enumerate() {
        shift(&mut acts[act], lead_in);
        acts[act].lead_in = lead_in;
        each_script(&mut acts[act], |script, median| {
            script.start = moved(script.start, lead_in - median);
        });
    }
}

/// Takes the compensation back: starts of scripts are those of their motions again.
pub(crate) fn undo(act: &mut Act) {
    let lead_in = std::mem::take(&mut act.lead_in);
    each_script(act, |script, median| script.start = moved(script.start, median - lead_in));
    shift(act, Span::ZERO - lead_in);
}

/// The least for each act with which none of its scripts begins before it, and none of its motions before those of an act that
/// leads to it have ended: a device with a long latency still moves when its commands have ended.
fn lead_ins(acts: &[Act]) -> Vec<Span> {
    let mut lead_ins: Vec<Span> = acts.iter().map(needed).collect();
    for act in acts {
        let next = if let Way::Act(next) = act.next { Some(next) } else { None };
        for following in next.into_iter().chain(act.on_failure.then) {
            if let Some(lead_in) = lead_ins.get_mut(following) {
                *lead_in = (*lead_in).max(tail(act));
            }
        }
    }
    lead_ins
}

fn needed(act: &Act) -> Span {
    let early = scripts(act).map(|(script, median)| median - script.start.span());
    early.max().unwrap_or_default().max(Span::ZERO)
}

/// How much later the last motion of an act ends than its last command.
fn tail(act: &Act) -> Span {
    let ends = |script: &DeviceScript| script.start.span() + script.duration();
    let motions = scripts(act).map(|(script, _)| ends(script)).max();
    let commands = scripts(act).map(|(script, median)| ends(script) - median).max();
    motions.zip(commands).map_or(Span::ZERO, |(motions, commands)| motions - commands)
}

/// All scripts, each with the latency of its device.
fn scripts(act: &Act) -> impl Iterator<Item = (&DeviceScript, Span)> {
    act.plan.robots.iter().flat_map(|robot| {
        robot.scripts.iter().map(|script| (script, act.latency_of(&robot.robot, &script.device)))
    })
}

fn each_script(act: &mut Act, mut change: impl FnMut(&mut DeviceScript, Span)) {
    let mut robots = std::mem::take(&mut act.plan.robots);
    for robot in &mut robots {
        for script in &mut robot.scripts {
            change(script, act.latency_of(&robot.robot, &script.device));
        }
    }
    act.plan.robots = robots;
}

/// What stays as it is keeps its number, to the last digit.
fn moved(start: Millis, by: Span) -> Millis {
    if by == Span::ZERO { start } else { Millis::from_span(start.span() + by) }
}

/// Everything that is on the time of motions.
fn shift(act: &mut Act, by: Span) {
    for cue in &mut act.cues {
        (cue.start, cue.end) = (cue.start + by, cue.end + by);
    }
    for reading in &mut act.readings {
        reading.at += by;
    }
    for used in &mut act.devices {
        used.worst_at += by;
    }
    if let Some(closest) = &mut act.in_space.closest {
        closest.at += by;
    }
    for point in act.in_space.driven.iter_mut().flat_map(|path| &mut path.points) {
        point.at += by;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use urrcp::Latency;

    use super::*;
    use crate::fleet::{DeviceLatency, LatencySource};
    use crate::{Choreography, NoFiles, Source, compile};

    const SCENARIO: &str = "
scenario: s
acts:
  - act: one
    next: two
    cues:
      - {cue: all, at: 0s, robots: [a, b, c], tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 45}]}}
      - {cue: later, after: all, robots: [b], tracks: {d: [{at: 0s, to: 45}, {at: 300ms, to: 10}]}}
  - act: two
    cues:
      - {cue: last, at: 40ms, robots: [a], tracks: {d: [{at: 0s, to: 45}, {at: 1s, to: 0}]}}
";

    /// Compiled for robots `a`, `b` and `c` with these latencies.
    fn compiled(latencies: [Option<i64>; 3]) -> Choreography {
        let robot = |(name, nanos): (&str, Option<i64>)| {
            let mut robot = crate::tests::robot();
            robot.id = name.parse().unwrap();
            let latency = Latency { median: Span::from_nanos(nanos?), spread: Span::ZERO };
            let latency = DeviceLatency { latency, from: LatencySource::Fleet, lag: None };
            robot.mission.latencies = BTreeMap::from([("d".parse().unwrap(), latency)]);
            Some(robot)
        };
        let plain = |name: &str| {
            let mut robot = crate::tests::robot();
            robot.id = name.parse().unwrap();
            robot
        };
        let robots = ["a", "b", "c"].into_iter().zip(latencies);
        let robots = robots.map(|of| robot(of).unwrap_or_else(|| plain(of.0))).collect();
        let fleet = Fleet { robots, ..Fleet::default() };
        let source = Source { name: "s.yaml".to_owned(), text: SCENARIO.to_owned() };
        let compiled = compile(&source, &fleet, &NoFiles);
        compiled.choreography.unwrap_or_else(|| panic!("{:?}", compiled.findings))
    }

    fn starts(act: &Act) -> Vec<Span> {
        scripts(act).map(|(script, _)| script.start.span()).collect()
    }

    fn motions(act: &Act) -> Vec<Span> {
        let of = |robot: &crate::RobotPlan| {
            robot.scripts.iter().map(|script| act.moves_at(&robot.robot, script)).collect::<Vec<_>>()
        };
        act.plan.robots.iter().flat_map(of).collect()
    }

    #[test]
    fn the_slowest_device_is_commanded_first_and_all_move_together() {
        let ms = Span::from_millis;
        let acts = compiled([Some(60_000_000), Some(20_000_000), None]).acts;
        assert_eq!(acts[0].lead_in, ms(60));
        assert_eq!(starts(&acts[0]), [ms(0), ms(40), ms(60)]);
        assert_eq!(motions(&acts[0]), [ms(60); 3]);
        assert_eq!((acts[0].cues[0].start, acts[0].cues[1].start), (ms(60), ms(1_060)));
        // Its only cue is 40 ms after the start, so the 20 ms that are missing suffice.
        assert_eq!((acts[1].lead_in, starts(&acts[1])), (ms(20), vec![ms(0)]));
    }

    #[test]
    fn an_act_waits_for_motions_that_outlast_their_commands() {
        // `b` ends the first act 300 ms after the others, and moves for 90 ms more.
        let acts = compiled([None, Some(90_000_000), None]).acts;
        assert_eq!(acts[1].lead_in, Span::from_millis(90));
        let ends = acts[0].plan.duration();
        let last_motion = motions(&acts[0])[1] + Span::from_millis(1_300);
        assert!(ends + motions(&acts[1])[0] >= last_motion, "{ends} {last_motion}");
    }

    #[test]
    fn without_latencies_or_with_latencies_of_zero_nothing_changes() {
        let plain = compiled([None; 3]);
        let mut zero = compiled([Some(0); 3]);
        zero.acts.iter_mut().for_each(|act| act.latencies.clear());
        assert_eq!(plain, zero);
        assert!(plain.acts.iter().all(|act| act.lead_in == Span::ZERO));
    }

    #[test]
    fn at_half_the_speed_latencies_stay_as_long_as_they_are() {
        let fleet = Fleet::default();
        let slow = compiled([Some(60_000_000), None, None]).at_speed(0.5, &fleet).unwrap();
        let ms = Span::from_millis;
        assert_eq!(slow.acts[0].lead_in, ms(60));
        assert_eq!(motions(&slow.acts[0]), [ms(60); 3]);
        assert_eq!(slow.acts[0].cues[1].start, ms(2_060));
        // 80 ms after the start suffice for 60 ms.
        assert_eq!((slow.acts[1].lead_in, motions(&slow.acts[1])), (ms(0), vec![ms(80)]));
    }

    proptest! {
        #[test]
        fn motions_relate_to_each_other_as_written(
            latencies in prop::array::uniform3(prop::option::of(0i64..10_000_000_000)),
        ) {
            let written = compiled([None; 3]);
            let mut compensated = compiled(latencies);
            for (act, plain) in compensated.acts.iter().zip(&written.acts) {
                let from_zero: Vec<_> = motions(act).into_iter().map(|at| at - act.lead_in).collect();
                prop_assert_eq!(from_zero, starts(plain));
                let cues: Vec<_> = act.cues.iter().map(|cue| cue.start - act.lead_in).collect();
                prop_assert_eq!(cues, plain.cues.iter().map(|cue| cue.start).collect::<Vec<_>>());
                prop_assert!(starts(act).iter().all(|start| *start >= Span::ZERO));
                let largest = latencies.iter().flatten().max().copied().unwrap_or(0);
                prop_assert!(act.lead_in <= Span::from_nanos(largest));
            }
            for act in &mut compensated.acts {
                undo(act);
                act.latencies.clear();
            }
            prop_assert_eq!(compensated, written);
        }
    }
}
