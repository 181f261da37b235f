//! Compensation for latencies: commands are earlier than motions, and the motions relate to each other as written.

use std::collections::BTreeMap;

use downbeat_plan::compensate::undo;
use proptest::prelude::*;
use urrcp::{Latency, Span};

use super::robot;
use crate::{Act, Choreography, DeviceLatency, Fleet, LatencySource, NoFiles, RobotPlan, Source, compile};

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

/// Compiles a show for the robots `a`, `b` and `c`, whose latencies are given in nanoseconds; `None` for an unknown latency.
fn compiled(latencies: [Option<i64>; 3]) -> Choreography {
    let delayed = |(name, nanos): (&str, Option<i64>)| {
        let mut robot = robot();
        robot.id = name.parse().unwrap();
        let latency = Latency { median: Span::from_nanos(nanos?), spread: Span::ZERO };
        let latency = DeviceLatency { latency, from: LatencySource::Fleet, lag: None };
        robot.mission.latencies = BTreeMap::from([("d".parse().unwrap(), latency)]);
        Some(robot)
    };
    let plain = |name: &str| {
        let mut robot = robot();
        robot.id = name.parse().unwrap();
        robot
    };
    let robots = ["a", "b", "c"].into_iter().zip(latencies);
    let robots = robots.map(|of| delayed(of).unwrap_or_else(|| plain(of.0))).collect();
    let fleet = Fleet { robots, ..Fleet::default() };
    let source = Source { name: "s.yaml".to_owned(), text: SCENARIO.to_owned() };
    let compiled = compile(&source, &fleet, &NoFiles);
    compiled.choreography.unwrap_or_else(|| panic!("{:?}", compiled.findings))
}

fn starts(act: &Act) -> Vec<Span> {
    act.plan.robots.iter().flat_map(|robot| &robot.scripts).map(|script| script.start.span()).collect()
}

fn motions(act: &Act) -> Vec<Span> {
    let of = |robot: &RobotPlan| {
        robot.scripts.iter().map(|script| act.moves_at(&robot.robot, script)).collect::<Vec<_>>()
    };
    act.plan.robots.iter().flat_map(of).collect()
}

#[test]
fn slowest_device_is_commanded_first_so_all_move_together() {
    let ms = Span::from_millis;
    let acts = compiled([Some(60_000_000), Some(20_000_000), None]).acts;
    assert_eq!(acts[0].lead_in, ms(60));
    assert_eq!(starts(&acts[0]), [ms(0), ms(40), ms(60)]);
    assert_eq!(motions(&acts[0]), [ms(60); 3]);
    assert_eq!((acts[0].cues[0].start, acts[0].cues[1].start), (ms(60), ms(1_060)));
    // The second act's only cue is 40 ms after its start, so the missing 20 ms suffice.
    assert_eq!((acts[1].lead_in, starts(&acts[1])), (ms(20), vec![ms(0)]));
}

#[test]
fn act_waits_for_motions_that_outlast_their_commands() {
    // `b` ends the first act 300 ms after the others, and moves for another 90 ms.
    let acts = compiled([None, Some(90_000_000), None]).acts;
    assert_eq!(acts[1].lead_in, Span::from_millis(90));
    let ends = acts[0].plan.duration();
    let last_motion = motions(&acts[0])[1] + Span::from_millis(1_300);
    assert!(ends + motions(&acts[1])[0] >= last_motion, "{ends} {last_motion}");
}

#[test]
fn zero_or_missing_latencies_change_nothing() {
    let plain = compiled([None; 3]);
    let mut zero = compiled([Some(0); 3]);
    zero.acts.iter_mut().for_each(|act| act.latencies.clear());
    assert_eq!(plain, zero);
    assert!(plain.acts.iter().all(|act| act.lead_in == Span::ZERO));
}

#[test]
fn latencies_are_unchanged_at_half_speed() {
    let fleet = Fleet::default();
    let slow = compiled([Some(60_000_000), None, None]).at_speed(0.5, &fleet).unwrap();
    let ms = Span::from_millis;
    assert_eq!(slow.acts[0].lead_in, ms(60));
    assert_eq!(motions(&slow.acts[0]), [ms(60); 3]);
    assert_eq!(slow.acts[0].cues[1].start, ms(2_060));
    // The cue is 80 ms after the start of the act, which is enough for a latency of 60 ms.
    assert_eq!((slow.acts[1].lead_in, motions(&slow.acts[1])), (ms(0), vec![ms(80)]));
}

proptest! {
    #[test]
    fn compensated_motions_keep_their_written_relations(
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
