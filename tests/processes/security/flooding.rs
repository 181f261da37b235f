//! Missions with a robot that sends far more than was requested, or sends answers to requests that were never sent.

use std::net::TcpListener;
use std::time::{Duration, Instant};

use serde_json::Value;

use stage::play::{Play, SHORT};
use stage::raw::{Flood, Floods, Raw};
use stage::{Ended, Stage, Via};

/// Memory limit of the scheduler's process in megabytes, whatever a robot sends.
const MEGABYTES_MAX: u64 = 200;

/// Starts a stage with this number of robots as processes, and adds the robots `further` to the fleet file, each with its port.
fn stage(play: &Play, robots: usize, further: &[(&str, u16)]) -> Stage {
    let stage = play.stage(&vec![Via::Direct; robots]);
    let mut fleet = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
    for (id, port) in further {
        let row = format!("  {id}: {{init: robot.yaml, address: \"tcp://127.0.0.1:{port}\"}}\n");
        fleet = fleet.replacen("robots:\n", &format!("robots:\n{row}"), 1);
        fleet = fleet.replacen("all: [", &format!("all: [{id}, "), 1);
    }
    stage.file("fleet.yaml", fleet);
    stage
}

/// Runs a command to its end. Returns its result, its peak memory usage in megabytes, and its duration.
fn watched(stage: &Stage, args: &[&str]) -> (Ended, u64, Duration) {
    let began = Instant::now();
    let mut run = stage.start(args);
    let mut peak = 0;
    while run.process.0.try_wait().unwrap().is_none() {
        // The last reading: before it becomes the program, the process is a copy of this one.
        peak = Some(run.process.memory()).filter(|now| *now > 0).unwrap_or(peak);
        std::thread::sleep(Duration::from_millis(10));
    }
    (run.ended(), peak, began.elapsed())
}

fn failures_of<'a>(report: &'a Value, robot: &str) -> Vec<&'a Value> {
    let failures = report["failures"].as_array().unwrap();
    failures.iter().filter(|failure| failure["robot"] == robot).collect()
}

#[test]
#[expect(clippy::print_stdout, reason = "prints its figures with --nocapture")]
fn flooding_robot_is_named_and_costs_neither_memory_nor_time() {
    // It accepts connections and sends nothing, so that the others must wait until patience ends.
    let mute = TcpListener::bind("127.0.0.1:0").unwrap();
    let mute = ("mute", mute.local_addr().map(|at| (mute, at.port())).unwrap());
    for flood in Flood::ALL {
        let raw = Raw::start("raw", Floods::WhenAvailable, flood);
        let stage = stage(&SHORT, 2, &[("raw", raw.port), (mute.0, mute.1.1)]);
        let (ended, peak, took) = watched(&stage, &["preflight", "play.yaml", "--format", "json"]);
        let report = ended.report();
        println!(
            "{flood:?}: {peak} MB, {took:?}, a report of {} bytes, {} bytes sent",
            ended.out.len(),
            raw.flooded()
        );
        assert!(peak < MEGABYTES_MAX, "{flood:?}: {peak} MB");
        assert!(took < Duration::from_secs(35), "{flood:?}: patience of 5 s took {took:?}");
        assert!(ended.out.len() < 200_000, "{flood:?}: a report of {} bytes", ended.out.len());
        let flooding = failures_of(&report, "raw");
        let named = flooding.iter().filter(|failure| failure["failure"] == "flooding").count();
        assert_eq!(named, 1, "{flood:?}: {ended}");
        for robot in ["r0", "r1"] {
            assert!(failures_of(&report, robot).is_empty(), "{flood:?}: {ended}");
        }
        assert_eq!(failures_of(&report, "mute").len(), 1, "{flood:?}: {ended}");
    }
}

#[test]
#[expect(clippy::print_stdout, reason = "prints its figures with --nocapture")]
fn robot_flooding_during_play_is_left_out_and_reconnected_only_to_stop() {
    let play = Play { steps: 30, on_failure: "without", ..SHORT };
    for flood in Flood::ALL {
        let raw = Raw::start("raw", Floods::AfterStarting(Duration::from_millis(500)), flood);
        let stage = stage(&play, 5, &[("raw", raw.port)]);
        let (ended, peak, _) = watched(&stage, &["run", "play.yaml", "--format", "json"]);
        let report = ended.report();
        println!("{flood:?}: {peak} MB, a report of {} bytes, {} bytes sent", ended.out.len(), raw.flooded());
        assert!(peak < MEGABYTES_MAX, "{flood:?}: {peak} MB");
        let failures = report["failures"].as_array().unwrap();
        assert!(failures.iter().all(|failure| failure["robot"] == "raw"), "{ended}");
        let first = match flood {
            // It reports that it is not available, and that takes precedence.
            Flood::Failures => "not_available",
            _ => "flooding",
        };
        assert_eq!(failures[0]["failure"], first, "{ended}");
        assert!(raw.connections() <= 3, "it was connected to again and again");
        let requests = raw.heard("control_request");
        let script = &requests[0];
        // The scheduler sends a script again if its acceptance takes long.
        let stops: Vec<_> =
            requests.iter().filter(|request| request["request_id"] != script["request_id"]).collect();
        assert!(script["control_value"].as_array().is_some_and(|steps| !steps.is_empty()), "{script}");
        let stop = |request: &&Value| request["control_value"].as_array().is_some_and(Vec::is_empty);
        assert!(!stops.is_empty() && stops.iter().all(stop), "{stops:?}");
        assert!(raw.flooded() < 64 * 1024 * 1024, "{} bytes", raw.flooded());
        stage.robots.iter().for_each(|robot| play.was_played_by(robot));
        let starts: Vec<_> = stage.robots.iter().map(|robot| robot.sets()[0].at).collect();
        let spread = starts.iter().max().unwrap() - starts.iter().min().unwrap();
        // A robot does not start a command that is late by more than 50 ms; this is forty times as much.
        assert!(spread < 2_000_000_000, "{spread} ns");
    }
}

#[test]
fn unrequested_responses_are_ignored_and_delay_no_other_robot() {
    let stage = SHORT.stage(&[Via::Proxy, Via::Direct]);
    stage.robots[0].link.as_ref().unwrap().rewrite(|message| {
        for kind in ["availability_response", "inquiry_response"] {
            let Some(at) = message.get(kind).and_then(|answer| answer["originate_timestamp"].as_str()) else {
                continue;
            };
            let at: urrcp::Timestamp<urrcp::Server> = serde_json::from_value(at.into()).unwrap();
            let before = at - urrcp::Span::from_millis(60_000);
            message[kind]["originate_timestamp"] = serde_json::to_value(before).unwrap();
        }
    });
    let ended = stage.run(&["run", "play.yaml", "--patience", "2s", "--format", "json"]);
    let report = ended.report();
    assert_eq!(report["outcome"], "not_started", "{ended}");
    let failures = failures_of(&report, "r0");
    let text = failures[0]["text"].as_str().unwrap();
    assert!(
        text.contains("(answers ignored because they match no request or have impossible times: "),
        "{ended}"
    );
    assert!(failures_of(&report, "r1").is_empty(), "{ended}");
    assert!(report["robots"][0]["ignored_answers"].as_u64().unwrap() > 0, "{ended}");
    assert!(report["robots"][0]["clock"].is_null(), "{ended}");
}

/// Returns the session keys in the messages that a robot has received, each once.
fn keys(raw: &Raw) -> Vec<String> {
    let kinds = ["availability_request", "inquiry", "control_request"];
    let sessions = kinds.iter().flat_map(|kind| raw.heard(kind));
    let sessions: Vec<_> =
        sessions.filter_map(|asked| Some(asked.get("session")?.as_str()?.to_owned())).collect();
    let mut keys: Vec<String> = Vec::new();
    for key in sessions.iter().filter_map(|session| Some(session.rsplit_once('/')?.1.to_owned())) {
        if !keys.contains(&key) {
            keys.push(key);
        }
    }
    keys
}

#[test]
fn session_key_is_sent_to_robots_but_never_shown() {
    let raw = Raw::start("raw", Floods::Never, Flood::Garbage);
    let stage = stage(&SHORT, 1, &[("raw", raw.port)]);
    let record = ["--record", "play.mcap"];
    let text = stage.run(&[&["run", "play.yaml", "--log", "trace"], &record[..]].concat());
    let mut known = keys(&raw);
    assert!(known.len() == 1 && known[0].len() == 32, "{known:?} {text}");
    let json = stage.run(&["run", "play.yaml", "--format", "json"]);
    known = keys(&raw);
    assert_eq!(known.len(), 2, "every mission has a key of its own: {known:?}");
    let mission = json.report()["session"].as_str().unwrap().to_owned();
    let journal = format!("state/{mission}/journal");
    let shown: [&[&str]; 7] = [
        &["missions", "--all"],
        &["missions", "--all", "--format", "json"],
        &["report", &journal],
        &["report", &journal, "--format", "json"],
        &["report", "play.mcap", "--format", "json", "--html", "play.html"],
        &["report", &journal, "--html", "journal.html"],
        &["stop", &mission, "--format", "json"],
    ];
    let shown = shown.map(|args| stage.run(args));
    let texts = shown.iter().chain([&text, &json]).map(|ended| format!("{}{}", ended.out, ended.told));
    let files = ["play.mcap", "play.html", "journal.html"];
    let files =
        files.map(|file| String::from_utf8_lossy(&std::fs::read(stage.path(file)).unwrap()).into_owned());
    for (place, text) in texts.chain(files).enumerate() {
        assert!(known.iter().all(|key| !text.contains(key.as_str())), "{place}: {text}");
    }
    let kept = std::fs::read_to_string(stage.path(&journal)).unwrap();
    assert!(kept.lines().next().unwrap().contains(&format!("\"key\":\"{}\"", known[1])), "{kept}");
    assert_eq!(kept.matches(known[1].as_str()).count(), 1, "{kept}");
}
