//! Acts that the mission prepares again because this machine was too slow to start them.

use rustix::process::Signal;

use stage::play::{CHAIN, Play, SHORT};
use stage::{Running, Stage, Via, sleep_until};

/// Suspends the scheduler while it should commit the next act (the step that makes its start final).
fn stalls(running: &mut Running) {
    let start = running.start();
    sleep_until(start - 250_000_000);
    running.process.signal(Signal::STOP);
    sleep_until(start + 200_000_000);
    running.process.signal(Signal::CONT);
}

#[track_caller]
fn plays_again(running: Running, act: &str) {
    let ended = running.ended();
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(ended.told.contains(&format!("`{act}` is prepared again")), "{ended}");
    let reported = "before anything moved, and prepared again";
    assert!(ended.out.split_whitespace().collect::<Vec<_>>().join(" ").contains(reported), "{ended}");
}

#[test]
fn scheduler_stall_at_commitment_delays_the_start_of_all_robots() {
    let stage = SHORT.stage(&[Via::Direct; 3]);
    let mut running = stage.start(&["run", "play.yaml", "--lead", "1s"]);
    stalls(&mut running);
    plays_again(running, "play");
    stage.robots.iter().for_each(|robot| SHORT.was_played_by(robot));
}

#[test]
fn report_matches_logs_of_robots_sent_home_during_repeated_preparation() {
    let mut stage = SHORT.stage(&[]);
    let device =
        stage::one_device(1, 200, 200).replace("    name: d\n", "    name: d\n    default_value: 5\n");
    stage.file("robot.yaml", device);
    for _ in 0..3 {
        stage.robot("robot.yaml", Via::Direct);
    }
    let mut running = stage.start(&["run", "play.yaml", "--lead", "1s"]);
    stalls(&mut running);
    let stopped = stage.run(&["stop", "--home"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    let ended = running.ended();
    assert_eq!(ended.code, Some(3), "{ended}");
    for robot in &stage.robots {
        assert!(ended.out.contains(&format!("{}: default state confirmed", robot.id)), "{ended}");
        assert!(robot.log().is_empty(), "{} is at its default position: {:?}", robot.id, robot.log());
    }
}

/// Returns a stage with two acts of three seconds each, without a pause between them.
fn two_acts() -> Stage {
    let stage = Play { script: 20, ..CHAIN }.stage(&[Via::Direct; 3]);
    let track = |from: u32| {
        let keyframes = (0..15).map(|step| format!("{{at: {}ms, to: {}}}", step * 200, from + step));
        keyframes.collect::<Vec<_>>().join(", ")
    };
    let act = |name: &str, from: u32| {
        format!("  - {{act: {name}, cues: [{{at: 0s, robots: all, tracks: {{d: [{}]}}}}]}}\n", track(from))
    };
    let acts = act("one", 1) + &act("two", 16);
    stage.file(
        "play.yaml",
        format!("scenario: play\nstart_tolerance: 1s\nstop_condition: {{running: 3s}}\nacts:\n{acts}"),
    );
    stage
}

#[test]
fn scheduler_stall_before_an_act_does_not_stop_a_playing_act() {
    let stage = two_acts();
    let mut running = stage.start(&["run", "play.yaml"]);
    running.start();
    stalls(&mut running);
    plays_again(running, "two");
    let planned: Vec<f64> = (1..=30).map(f64::from).collect();
    stage.robots.iter().for_each(|robot| assert_eq!(robot.values("d"), planned, "{}", robot.id));
}
