//! Robots that fall silent, and links that stall or break for a moment, while real processes play. A certain failure has consequences in
//! time, and an uncertain one harms nothing.

use std::time::Duration;

use serde_json::Value;

use stage::play::{CHAIN, LONG, Play, SHORT, SOON};
use stage::{Ended, Robot, Via, epoch_nanos, held_up, sleep_until};

fn failed_robots(report: &Value) -> Vec<&str> {
    let failures = report["failures"].as_array().unwrap();
    failures.iter().map(|failure| failure["robot"].as_str().unwrap()).collect()
}

/// A show of one script that lasts forty seconds: ten times as long as it takes to notice silence and to handle it.
const FORTY_SECONDS: Play = Play { steps: 200, every_ms: 200, ..LONG };

/// Freezes the second of two robots as soon as both play. Checks that the first one stops within `within`, which is before the end of its
/// script.
#[track_caller]
fn check_that_silence_is_noticed(play: &Play, within: Duration) {
    let stage = play.stage(&[Via::Direct, Via::Direct]);
    let running =
        stage.begin(&["run", "play.yaml", "--format", "json", "--patience", "2s"], 0..stage.robots.len(), 2);
    stage.robots[1].freeze();
    let frozen = epoch_nanos();
    let ended = running.ended();
    let last = stage.robots[0].sets().last().unwrap().at;
    let after = Duration::from_nanos(u64::try_from(last - frozen).unwrap_or(0));
    assert!(after < within, "its partner still moved {after:?} later\n{ended}");
    let report = ended.report();
    assert_eq!(report["outcome"], "failed", "{ended}");
    assert_eq!(failed_robots(&report), ["r1"], "{ended}");
    assert_eq!(report["robots"][0]["stop"]["state"], "confirmed", "{ended}");
    assert_eq!(ended.code, Some(4), "{ended}");
}

#[test]
fn robot_frozen_during_play_fails_when_its_lease_expires() {
    check_that_silence_is_noticed(&FORTY_SECONDS, Duration::from_secs(21));
}

#[test]
fn frozen_robot_without_a_lease_is_detected_before_its_script_ends() {
    check_that_silence_is_noticed(&Play { running: "none", ..FORTY_SECONDS }, Duration::from_secs(35));
}

#[test]
fn robot_killed_before_start_prevents_start_of_all_others() {
    std::thread::scope(|scope| {
        for before in [400, 300, 200, 150, 100, 70_i64] {
            scope.spawn(move || check_that_none_starts(before * 1_000_000));
        }
    });
}

#[track_caller]
fn check_that_none_starts(before: i64) {
    let mut stage = SHORT.stage(&[Via::Direct; 3]);
    let mut running = stage.start(&["run", "play.yaml", "--lead", "1s", "--patience", "1s"]);
    let start = running.start();
    sleep_until(start - before);
    stage.robots[1].kill();
    let struck = (start - epoch_nanos()) / 1_000_000;
    let ended = running.ended();
    // A machine that was too busy to kill it in time proves nothing.
    if struck < 40 {
        return;
    }
    let moved: Vec<_> = stage.robots.iter().filter(|robot| !robot.sets().is_empty()).map(|r| &r.id).collect();
    assert!(moved.is_empty(), "killed {struck} ms before the start, and {moved:?} moved\n{ended}");
    assert!(ended.out.contains("play: not started") && ended.code != Some(0), "{ended}");
}

/// Checks that a show is played to its end although the link of the first robot stalls for 0.6 s. The lease is 2 s.
#[track_caller]
fn check_that_a_pause_of_the_link_is_survived(play: &Play) {
    let stage = play.stage(&[Via::Proxy, Via::Direct]);
    let running = stage.begin(&["run", "play.yaml", "--format", "json"], [0], 2);
    let link = stage.robots[0].link.as_ref().unwrap();
    link.freeze();
    std::thread::sleep(Duration::from_millis(600));
    link.open();
    let ended = running.ended();
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!(ended.report()["outcome"], "done", "{ended}");
    stage.robots.iter().for_each(|robot| play.was_played_by(robot));
}

#[test]
fn act_of_one_script_survives_a_link_stall_shorter_than_its_lease() {
    check_that_a_pause_of_the_link_is_survived(&Play { script: 24, ..CHAIN });
}

#[test]
fn act_of_three_scripts_survives_a_link_stall_shorter_than_its_lease() {
    check_that_a_pause_of_the_link_is_survived(&CHAIN);
}

#[test]
fn act_of_three_held_scripts_survives_a_link_stall() {
    check_that_a_pause_of_the_link_is_survived(&Play { queue: 3, ..CHAIN });
}

/// Checks that a script is sent again after the request that contains this value was lost. The link is down for 50 ms.
#[track_caller]
fn check_that_a_lost_script_is_sent_again(value: u32) {
    let stage = CHAIN.stage(&[Via::Proxy, Via::Direct]);
    let link = stage.robots[0].link.as_ref().unwrap();
    link.lose(&format!("\"control_value\":{value}}}"), Duration::from_millis(50));
    // There is time before the start to connect again, however busy this machine is.
    let ended = stage.run(&["run", "play.yaml", "--format", "json", "--lead", "3s"]);
    assert_eq!(link.lines_lost(), 1, "nothing was lost\n{ended}");
    assert_eq!(ended.code, Some(0), "{ended}");
    stage.robots.iter().for_each(|robot| CHAIN.was_played_by(robot));
    let others: Vec<_> = stage.robots[0].log().into_iter().filter(|entry| entry.motion != "set").collect();
    assert!(others.is_empty(), "asking moved or stopped it: {others:?}");
}

#[test]
fn script_lost_with_the_link_during_play_is_resent_and_cancels_nothing() {
    check_that_a_lost_script_is_sent_again(17);
}

#[test]
fn script_lost_with_the_link_during_preparation_is_resent() {
    check_that_a_lost_script_is_sent_again(9);
}

#[test]
fn brief_link_interruptions_during_play_cancel_nothing() {
    let stage = CHAIN.stage(&[Via::Proxy, Via::Direct]);
    let running = stage.start(&["run", "play.yaml", "--format", "json"]);
    let link = stage.robots[0].link.as_ref().unwrap();
    for values in [3, 8, 15] {
        stage.robots[0].await_sets(values, SOON);
        link.interrupt();
        std::thread::sleep(Duration::from_millis(50));
        link.open();
    }
    let ended = running.ended();
    assert_eq!(ended.code, Some(0), "{ended}");
    stage.robots.iter().for_each(|robot| CHAIN.was_played_by(robot));
}

#[test]
fn connection_reset_during_handshake_is_retried_within_patience() {
    let stage = SHORT.stage(&[Via::Proxy, Via::Direct]);
    stage.robots[0].link.as_ref().unwrap().reset_first(1);
    let ended = stage.run(&["run", "play.yaml", "--format", "json", "--patience", "5s"]);
    assert_eq!(ended.code, Some(0), "{ended}");
    stage.robots.iter().for_each(|robot| SHORT.was_played_by(robot));
}

/// Checks that a mission is played although the first robot does not support the part of the protocol with these keys.
#[track_caller]
fn check_that_it_plays_without(keys: &'static [&'static str]) {
    let stage = CHAIN.stage(&[Via::Proxy, Via::Direct]);
    stage.robots[0].link.as_ref().unwrap().leave_out(keys);
    let ended = stage.run(&["run", "play.yaml", "--format", "json"]);
    assert_eq!(ended.code, Some(0), "{ended}");
    stage.robots.iter().for_each(|robot| CHAIN.was_played_by(robot));
}

#[test]
fn robot_that_does_not_echo_request_ids_plays_all_its_scripts() {
    check_that_it_plays_without(&["request_id", "content_hash", "inquiry"]);
}

#[test]
fn robot_without_inquiry_responses_plays_all_its_scripts() {
    check_that_it_plays_without(&["inquiry"]);
}

#[test]
fn link_that_accepts_and_closes_repeatedly_is_abandoned() {
    let mut stage = FORTY_SECONDS.stage(&[Via::Proxy, Via::Direct]);
    let running = stage.begin(&["run", "play.yaml", "--format", "json", "--patience", "2s"], [0], 3);
    // Its proxy continues to listen.
    stage.robots[0].kill();
    let ended = running.ended();
    let set = stage.robots[1].sets().len();
    assert!(set < 180, "its partner set {set} values of 200\n{ended}");
    assert_eq!(failed_robots(&ended.report()), ["r0"], "{ended}");
}

/// Returns the lead of an act: the time from sending its scripts to its start, in milliseconds.
fn lead(act: &Value) -> f64 {
    act["lead"].as_object().unwrap().values().filter_map(Value::as_f64).sum()
}

#[test]
fn link_pause_does_not_delay_following_acts() {
    let stage = LONG.stage(&[Via::Proxy, Via::Direct]);
    let act = |act: u32, length: u32| {
        let track = format!("{{d: [{{at: 0s, to: {act}}}, {{at: {length}ms, to: {}}}]}}", act + 10);
        format!("  - act: act-{act}\n    cues:\n      - {{at: 0s, robots: all, tracks: {track}}}\n")
    };
    let acts: String = [(1, 4_000), (2, 400), (3, 400)].map(|(number, length)| act(number, length)).concat();
    let head = "scenario: play\nstart_tolerance: 1s\nstop_condition: {running: 6s}\nacts:\n";
    stage.file("play.yaml", format!("{head}{acts}"));
    let play = || {
        let running = stage.begin(&["run", "play.yaml", "--format", "json"], [0], 1);
        let link = stage.robots[0].link.as_ref().unwrap();
        link.freeze();
        std::thread::sleep(Duration::from_secs(2));
        link.open();
        running.ended()
    };
    let ended = held_up::played(play, Ended::said);
    assert_eq!(ended.code, Some(0), "{ended}");
    let leads: Vec<f64> = ended.report()["acts"].as_array().unwrap().iter().map(lead).collect();
    // The first act was prepared before the pause: the length of its lead shows how busy this machine is.
    let bound = leads[0] + 2_000.0;
    assert!(leads.iter().all(|lead| *lead < bound), "leads of {leads:?} ms\n{ended}");
}

/// Plays two acts. `lose` disables the first robot during the first act, when the second act has already been sent. Checks that no robot
/// plays an act twice.
#[track_caller]
fn check_that_no_act_is_played_twice(lose: fn(&mut Robot)) {
    let mut stage = Play { queue: 2, ..LONG }.stage(&[Via::Proxy, Via::Direct, Via::Direct]);
    let act = |act: u32, length: u32| {
        let track = format!("{{d: [{{at: 0s, to: {act}}}, {{at: {length}ms, to: {}}}]}}", act + 1);
        format!("  - act: act-{act}\n    cues:\n      - {{at: 0s, robots: all, tracks: {track}}}\n")
    };
    let head =
        "scenario: play\nstart_tolerance: 1s\non_failure: without\nstop_condition: {running: 600ms}\nacts:\n";
    stage.file("play.yaml", format!("{head}{}{}", act(1, 900), act(3, 3_000)));
    let running = stage.start(&["run", "play.yaml", "--format", "json", "--patience", "1s"]);
    // The second act is committed about 70 ms before the end of the first, whose end is never reported.
    stage.await_record(r#""record":"committed","number":1"#);
    lose(&mut stage.robots[0]);
    let ended = running.ended();
    for robot in &stage.robots[1..] {
        assert_eq!(robot.values("d"), [1.0, 2.0, 3.0, 4.0], "{}\n{ended}", robot.id);
    }
    assert_eq!(ended.report()["outcome"], "done_without", "{ended}");
}

#[test]
fn no_act_is_played_twice_when_a_robot_with_unknown_act_end_is_left_out() {
    check_that_no_act_is_played_twice(|robot| robot.link.as_ref().unwrap().interrupt());
}

#[test]
fn no_act_is_played_twice_when_a_frozen_robot_is_left_out() {
    check_that_no_act_is_played_twice(|robot| robot.freeze());
}

#[test]
fn no_act_is_played_twice_when_a_killed_robot_is_left_out() {
    check_that_no_act_is_played_twice(Robot::kill);
}
