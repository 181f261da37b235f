//! Tests of complete charts, and of charts of any width.

use downbeat_scripts::{Choreography, DeviceScript, Plan, RobotPlan};
use urrcp::{ControlType, Millis, Script, Setpoint, Step, StopCondition};

use super::*;

fn cue(name: &str, times: [i64; 3], critical: bool) -> PlannedCue {
    let [start, end, slack] = times.map(Span::from_millis);
    PlannedCue {
        name: name.to_owned(),
        start,
        end,
        slack,
        critical,
        repetition: None,
        text: Default::default(),
    }
}

/// Returns the plan of an arm that reaches these values at these times, given as pairs of milliseconds and value.
fn arm(steps: &[(f64, f64)]) -> RobotPlan {
    let step = |(at, to): &(f64, f64)| {
        Step::new(Millis::new(*at).unwrap(), Setpoint::new(ControlType::Position, *to))
    };
    let script = DeviceScript {
        device: "elbow".parse().unwrap(),
        start: Millis::new(0.0).unwrap(),
        stop_condition: StopCondition::default(),
        script: Script::new(steps.iter().map(step).collect()).unwrap(),
        rest: Span::ZERO,
    };
    RobotPlan { robot: "arm-1".parse().unwrap(), scripts: vec![script] }
}

fn act(cues: Vec<PlannedCue>, robots: Vec<RobotPlan>) -> Act {
    let plan = Plan {
        scenario: "show".to_owned(),
        start_tolerance: Span::ZERO,
        lead: None,
        stop_condition: StopCondition::default(),
        robots,
    };
    let mut act = Choreography::of_plan(plan).acts.remove(0);
    act.cues = cues;
    act
}

fn plain(text: &str) -> String {
    anstream::adapter::strip_str(text).to_string()
}

#[track_caller]
fn check(act: &Act, columns: usize, expected: &str) {
    let text = plain(&gantt(act, &[], columns));
    assert_eq!(text, expected, "\n{text}");
}

#[test]
fn cues_are_drawn_as_bars_with_slack_and_marks_in_order_of_start() {
    let cues = vec![
        cue("wave", [2_000, 4_000, 0], true),
        cue("nod", [0, 1_000, 1_500], false),
        cue("raise", [0, 2_000, 0], true),
        cue("go", [2_000, 2_000, 0], true),
    ];
    let robot = arm(&[(0.0, 0.0), (1_000.0, 10.0), (3_000.0, 10.0), (4_000.0, 0.0)]);
    check(
        &act(cues, vec![robot]),
        48,
        "show: 1 robot, 1 device, 4 steps, 4 s
cue     ┊0 s      ┊1 s      ┊2 s      ┊3 s
nod     ━━━━━━━━━━···············     ┊
raise * ━━━━━━━━━━━━━━━━━━━━┊         ┊
wave  * ┊         ┊         ━━━━━━━━━━━━━━━━━━━━
go    * ┊         ┊         ◆         ┊
robot   ┊0 s      ┊1 s      ┊2 s      ┊3 s
arm-1   ━━━━━━━━━━┊         ┊         ━━━━━━━━━━
━ playing or moving, · slack: how much later it
  could start, ◆ mark, * critical path:
  determines when the act ends

",
    );
}

#[test]
fn chart_fits_any_terminal_and_shows_every_cue() {
    let name = |index: i64| format!("{index} \u{1b}[2J 舞台 {}", "long ".repeat(20));
    let cues =
        (0..300).map(|index| cue(&name(index), [index * 7, index * 9, index], index % 3 == 0)).collect();
    let act = act(cues, vec![arm(&[(0.0, 0.0), (9_000.0, 1.0)])]);
    for columns in [20, 21, 33, 80, 300] {
        let text = plain(&gantt(&act, &[], columns));
        assert!(text.lines().all(|line| line.width() <= columns), "{columns}\n{text}");
        assert!(!text.contains('\u{1b}'), "{text}");
        for index in 0..300 {
            assert!(text.contains(&format!("\n{index} ")), "{columns}: no {index}\n{text}");
        }
        assert_eq!(text.matches("\ncue").count(), 8, "the ruler is repeated");
    }
}

#[test]
fn empty_acts_and_zero_width_terminals_are_drawn() {
    for columns in [0, 1, 5, 20, UNBOUNDED] {
        for cues in [vec![], vec![cue("", [0, 0, 0], false)], vec![cue("late", [9, 9, 9], true)]] {
            for robots in [vec![], vec![arm(&[])], vec![arm(&[(0.0, 1.0)])]] {
                let text = gantt(&act(cues.clone(), robots), &[], columns);
                assert!(text.contains("show"), "{text}");
            }
        }
    }
    let text = plain(&gantt(&act(vec![cue("go", [0, 90_000, 0], true)], vec![]), &[], UNBOUNDED));
    assert!(text.lines().all(|line| line.width() <= 80) && text.contains("┊1:00"), "{text}");
}
