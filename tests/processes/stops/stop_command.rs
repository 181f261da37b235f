//! `downbeat stop` and `downbeat go` with real processes: both commands work whatever has happened to files, journals and schedulers.

use std::io::{Seek, SeekFrom, Write};
use std::time::{Duration, Instant};

use rustix::process::Signal;

use stage::quiet::{await_that, stays};
use stage::{Ended, Running, Stage, Via, epoch_nanos, nanos, one_device, sleep_until};

/// Template of a scenario that lasts half a minute, without a lease and with a step every 300 ms.
const PLAYS: &str = "scenario: NAME
start_tolerance: 1s
stop_condition: STOP
cues:
  - cue: up
    robots: ROBOTS
    at: 0s
    tracks:
      d: [STEPS]
";

fn plays(name: &str, robots: &str) -> String {
    let steps = steps(100, 300);
    let plays = PLAYS.replace("NAME", name).replace("ROBOTS", robots);
    plays.replace("STOP", "{running: none}").replace("STEPS", &steps)
}

/// Returns `count` keyframes as YAML, one every `millis` milliseconds.
fn steps(count: u32, millis: u32) -> String {
    let steps = (0..count).map(|step| format!("{{at: {}ms, to: {step}}}", step * millis));
    steps.collect::<Vec<_>>().join(", ")
}

/// Returns a stage with this number of robots, each a process of its own, and a scenario for all of them.
fn stage(robots: usize) -> Stage {
    let mut stage = Stage::new();
    stage.file("robot.yaml", one_device(2, 100, 200)).file("long.yaml", plays("long", "all"));
    for _ in 0..robots {
        stage.robot("robot.yaml", Via::Direct);
    }
    stage
}

/// Starts a mission, and kills its scheduler while all robots play.
fn cut_off(robots: usize) -> Stage {
    let stage = stage(robots);
    let mut mission = stage.begin(&["run", "long.yaml"], 0..robots, 2);
    mission.process.kill();
    stage
}

/// Checks that no robot sets further values of its script, whose steps are 300 ms apart.
#[track_caller]
fn all_rest(stage: &Stage) {
    stage.await_rest();
    stays(Duration::from_millis(1_000), || sets(stage));
}

/// Returns the number of script values that each robot has set.
fn sets(stage: &Stage) -> Vec<usize> {
    stage.robots.iter().map(|robot| robot.sets().len()).collect()
}

#[track_caller]
fn says(ended: &Ended, code: i32, parts: &[&str]) {
    let text = format!("{}{}", ended.out, ended.told);
    assert_eq!(ended.code, Some(code), "{text}");
    parts.iter().for_each(|part| assert!(text.contains(part), "`{part}` is missing in:\n{text}"));
}

const BOTH: [&str; 2] = ["r0: stop confirmed", "r1: stop confirmed"];

#[test]
fn later_of_two_nearly_simultaneous_stops_takes_effect() {
    for delay in [0, 10, 30, 80] {
        let stage = stage(2);
        let mut mission = stage.begin(&["run", "long.yaml"], [0, 1], 2);
        // The mission cannot end before the second stop arrives.
        stage.robots[1].freeze();
        let first = stage.start(&["stop"]);
        mission.line("stopping all robots");
        std::thread::sleep(Duration::from_millis(delay));
        let home = stage.start(&["stop", "--home"]);
        mission.line("stopped by the operator; then home");
        stage.robots[1].thaw();
        says(&home.ended(), 0, &["r0: default state confirmed", "r1: default state confirmed"]);
        says(&first.ended(), 0, &[]);
        assert_eq!(mission.ended().code, Some(3));
    }
}

#[test]
fn robot_removed_from_the_fleet_file_is_stopped_after_a_crash() {
    let stage = cut_off(2);
    let fleet = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
    let without: String =
        fleet.lines().filter(|line| !line.contains("r1:")).map(|line| format!("{line}\n")).collect();
    stage.file("fleet.yaml", without.replace("[r0, r1]", "[r0]"));
    says(&stage.run(&["stop"]), 0, &BOTH);
    all_rest(&stage);
    says(&stage.run(&["missions"]), 0, &["none was cut off"]);
}

#[test]
fn stop_after_a_crash_uses_the_addresses_that_received_the_scripts() {
    let mut stage = cut_off(2);
    let old = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
    // From now on, another robot, at rest, has the address in the file.
    stage.robot("robot.yaml", Via::Direct);
    let fleet = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
    let address = |id: &str| {
        let line = fleet.lines().find(|line| line.contains(&format!("{id}:"))).unwrap();
        line.split('"').nth(1).unwrap().to_owned()
    };
    stage.file("fleet.yaml", old.replace(&address("r1"), &address("r2")));
    let refused = stage.run(&["resume"]);
    says(
        &refused,
        1,
        &[
            "the scripts of robot `r1` were sent to",
            "but its address in the fleet file is now",
            "`downbeat stop`",
        ],
    );
    says(&stage.run(&["stop"]), 0, &BOTH);
    all_rest(&stage);
}

#[test]
fn stop_after_a_crash_requires_no_fleet_file() {
    for broken in [None, Some("robots: [")] {
        let stage = cut_off(2);
        match broken {
            None => std::fs::remove_file(stage.path("fleet.yaml")).unwrap(),
            Some(text) => drop(stage.file("fleet.yaml", text)),
        }
        std::fs::remove_file(stage.path("long.yaml")).unwrap();
        says(&stage.run(&["resume"]), 2, &["`downbeat stop`"]);
        says(&stage.run(&["stop"]), 0, &BOTH);
        all_rest(&stage);
    }
}

#[test]
fn mission_with_an_unconfirmed_robot_can_be_stopped_again() {
    let stage = cut_off(2);
    stage.robots[1].freeze();
    let first = stage.run(&["stop", "--patience", "1s"]);
    says(
        &first,
        4,
        &["r0: stop confirmed", "r1: stop NOT confirmed; it has no lease, so it will not stop by itself"],
    );
    stage.robots[1].thaw();
    says(&stage.run(&["stop"]), 0, &BOTH);
    all_rest(&stage);
    says(&stage.run(&["stop"]), 2, &["no mission is running or was cut off"]);
}

#[test]
fn second_stop_joins_an_earlier_stop_that_waits_for_a_robot() {
    let stage = cut_off(2);
    stage.robots[1].freeze();
    let first = stage.start(&["stop", "--patience", "30s"]);
    await_that("the first stop", || stage.run(&["missions"]).out.contains("running"));
    // There is one listening socket, and one more for each accepted connection.
    await_that("its socket", || control_sockets(&stage) == 1);
    let second = stage.start(&["stop", "--patience", "30s"]);
    await_that("the second stop", || control_sockets(&stage) == 2);
    // Longer than a mission may stall.
    std::thread::sleep(Duration::from_secs(4));
    stage.robots[1].thaw();
    for stop in [first, second] {
        let ended = stop.ended();
        says(&ended, 0, &BOTH);
        assert!(!ended.told.contains("SIGTERM") && !ended.told.contains("directly"), "{ended}");
    }
    all_rest(&stage);
}

/// Returns the number of open control sockets of this stage's missions.
fn control_sockets(stage: &Stage) -> usize {
    let state = stage.path("state").to_str().unwrap().to_owned();
    let sockets = std::fs::read_to_string("/proc/net/unix").unwrap();
    sockets.lines().filter(|line| line.contains(&state) && line.ends_with("/control")).count()
}

#[test]
fn mission_with_a_permanently_lost_robot_can_be_forgotten() {
    let mut stage = cut_off(1);
    stage.robots[0].kill();
    let missions = stage.run(&["missions", "--format", "json"]);
    let missions: serde_json::Value = serde_json::from_str(&missions.out).unwrap();
    let name = missions[0]["mission"].as_str().unwrap();
    let args = ["stop", name, "--forget", "--patience", "500ms"];
    let forgotten = "forgotten: the mission is considered ended, although r0 has not confirmed its stop";
    says(&stage.run(&args), 4, &["r0: stop NOT confirmed", forgotten]);
    says(&stage.run(&["stop"]), 2, &["no mission is running or was cut off"]);
}

#[test]
fn old_journals_are_not_read_regardless_of_length() {
    let stage = cut_off(1);
    let folder = |named: &str| stage.path("state").join(named);
    let cut_off = std::fs::read_dir(stage.path("state")).unwrap().next().unwrap().unwrap().path();
    let journal = std::fs::read(cut_off.join("journal")).unwrap();
    let begin = journal.split_inclusive(|byte| *byte == b'\n').next().unwrap();
    for old in ["a", "b", "c"] {
        // Larger than the memory: most of it is a hole in the file.
        std::fs::create_dir(folder(old)).unwrap();
        let mut file = std::fs::File::create(folder(old).join("journal")).unwrap();
        file.write_all(begin).unwrap();
        file.set_len(1 << 36).unwrap();
        file.seek(SeekFrom::End(0)).unwrap();
        let ended = br#"{"at":"2026-11-20T19:00:00.000000000Z","record":"ended","outcome":"done"}"#;
        file.write_all(format!("\n{:08x} ", crc32fast::hash(ended)).as_bytes()).unwrap();
        file.write_all(ended).unwrap();
        file.write_all(b"\n").unwrap();
    }
    says(&stage.run(&["stop", "--patience", "30s"]), 0, &["r0: stop confirmed"]);
    // The next mission removes them.
    stage.run(&["run", "long.yaml", "--lead", "1ms"]);
    let left = ["a", "b", "c"].iter().filter(|old| folder(old).exists()).count();
    assert!(left <= 1, "only the newest may be this long");
}

#[test]
fn lease_of_an_unreachable_robot_is_reported() {
    let stage = stage(1);
    stage.file("long.yaml", plays("long", "all").replace("{running: none}", "{running: 20s}"));
    let mut mission = stage.begin(&["run", "long.yaml"], [0], 2);
    mission.process.kill();
    stage.robots[0].freeze();
    says(&stage.run(&["stop", "--patience", "500ms"]), 4, &["r0: stop NOT confirmed; its lease ends at"]);
    stage.robots[0].thaw();
}

#[test]
fn simulated_robot_lost_with_its_scheduler_is_not_reported_as_confirmed() {
    let mut stage = stage(1);
    let fleet = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
    let with = fleet
        .replace("groups:\n  all: [r0]", "  s: {init: robot.yaml, address: sim}\ngroups:\n  all: [r0, s]");
    stage.file("fleet.yaml", with);
    let mut mission = stage.begin(&["run", "long.yaml"], [0], 2);
    mission.process.kill();
    let simulated = "s: was simulated in the scheduler's own process";
    says(&stage.run(&["stop"]), 0, &["r0: stop confirmed", simulated]);
    stage.robots.clear();
}

#[test]
fn stop_ends_immediately_if_all_robots_died_with_their_scheduler() {
    let stage = stage(0);
    stage.file("fleet.yaml", "robots: {s: {init: robot.yaml, address: sim}}\n");
    stage.file("long.yaml", plays("long", "s"));
    let mut mission = stage.start_until(&["run", "long.yaml"], "starting `");
    mission.process.kill();
    says(&stage.run(&["stop"]), 0, &["s: was simulated in the scheduler's own process"]);
    says(&stage.run(&["stop"]), 2, &["no mission is running or was cut off"]);
}

#[test]
fn running_mission_with_an_unreadable_journal_is_stopped() {
    for damage in [|journal: &mut Vec<u8>| journal[15] ^= 1, |journal: &mut Vec<u8>| journal.clear()] {
        let stage = stage(1);
        let mission = stage.begin(&["run", "long.yaml"], [0], 2);
        let folder = std::fs::read_dir(stage.path("state")).unwrap().flatten().next().unwrap().path();
        let mut journal = std::fs::read(folder.join("journal")).unwrap();
        damage(&mut journal);
        std::fs::write(folder.join("journal"), journal).unwrap();
        says(&stage.run(&["missions"]), 0, &["cannot be read", "no other mission is running"]);
        let stopped = stage.run(&["stop"]);
        says(&stopped, 1, &["r0: stop confirmed"]);
        assert_eq!(mission.ended().code, Some(3));
        all_rest(&stage);
    }
}

#[test]
fn unreadable_robot_messages_are_reported_once_and_hide_no_other_robot() {
    let mut stage = cut_off(2);
    stage.robots[0].kill();
    let listener = std::net::TcpListener::bind(("127.0.0.1", stage.robots[0].port())).unwrap();
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            std::thread::spawn(move || (0..500).try_for_each(|_| stream.write_all(b"no message\n")));
        }
    });
    let stopped = stage.run(&["stop", "--patience", "1s"]);
    says(&stopped, 4, &["r0: stop NOT confirmed", "r1: stop confirmed"]);
    for said in [&stopped.out, &stopped.told] {
        assert_eq!(said.matches("r0: garbled").count(), 1, "{stopped}");
    }
}

#[test]
fn stop_without_name_stops_and_names_running_and_interrupted_missions() {
    let stage = stage(4);
    for (name, robots) in [("one", "[r0]"), ("two", "[r1]"), ("three", "[r2, r3]")] {
        stage.file(&format!("{name}.yaml"), plays(name, robots));
    }
    let mut dead = stage.begin(&["run", "one.yaml"], [0], 2);
    dead.process.kill();
    let two = stage.begin(&["run", "two.yaml"], [1], 2);
    let three = stage.begin(&["run", "three.yaml"], [2, 3], 2);
    let stopped = stage.run(&["stop"]);
    says(&stopped, 0, &["one@", "two@", "three@", "  r0: stop confirmed", "  r3: stop confirmed"]);
    all_rest(&stage);
    assert_eq!((two.ended().code, three.ended().code), (Some(3), Some(3)));
}

#[test]
fn stop_all_returns_the_worst_exit_code_and_reports_each_mission_in_json() {
    let stage = stage(2);
    stage.file("one.yaml", plays("one", "[r0]")).file("two.yaml", plays("two", "[r1]"));
    let mut one = stage.begin(&["run", "one.yaml"], [0], 2);
    one.process.kill();
    let two = stage.begin(&["run", "two.yaml"], [1], 2);
    stage.robots[0].freeze();
    let stopped = stage.run(&["stop", "--all", "--patience", "1s", "--format", "json"]);
    assert_eq!(stopped.code, Some(4), "{stopped}");
    let documents: serde_json::Value = serde_json::from_str(&stopped.out).unwrap();
    let state = |mission: &str| {
        let of = |document: &&serde_json::Value| document["mission"].as_str().unwrap().starts_with(mission);
        documents.as_array().unwrap().iter().find(of).unwrap()["report"]["robots"][0]["stop"]["state"].clone()
    };
    assert_eq!((state("one").as_str(), state("two").as_str()), (Some("unconfirmed"), Some("confirmed")));
    stage.robots[0].thaw();
    two.ended();
}

#[test]
fn robots_of_a_stalled_scheduler_are_stopped_directly() {
    let stage = stage(2);
    let mission = stage.begin(&["run", "long.yaml"], [0, 1], 2);
    mission.process.signal(Signal::STOP);
    let began = Instant::now();
    let sent = "was sent SIGTERM, so it will end if it continues";
    says(&stage.run(&["stop"]), 0, &["no answer within 1 s", sent, BOTH[0], BOTH[1]]);
    assert!(began.elapsed() < Duration::from_secs(20));
    all_rest(&stage);
    // After it continues, it does not move them again.
    mission.process.signal(Signal::CONT);
    let ended = mission.ended();
    assert_eq!(ended.code, Some(3), "{ended}");
    all_rest(&stage);
}

#[test]
fn mission_without_a_socket_is_stopped_directly_and_ends() {
    let stage = stage(2);
    let mission = stage.begin(&["run", "long.yaml"], [0, 1], 2);
    for folder in std::fs::read_dir(stage.path("state")).unwrap() {
        std::fs::remove_file(folder.unwrap().path().join("control")).unwrap();
    }
    says(&stage.run(&["go"]), 1, &["no process is listening"]);
    says(&stage.run(&["stop"]), 0, &BOTH);
    all_rest(&stage);
    assert_ne!(mission.ended().code, Some(0));
}

#[test]
fn go_to_a_stalled_scheduler_fails_and_has_no_later_effect() {
    let stage = stage(1);
    stage.file("acts.yaml", ACTS.replace("STEPS", &steps(20, 200)));
    let mission = stage.start_until(&["run", "acts.yaml"], "`two` waits for the operator's go");
    mission.process.signal(Signal::STOP);
    says(&stage.run(&["go"]), 1, &["no answer within 1 s"]);
    mission.process.signal(Signal::CONT);
    let again = || stage.run(&["go", "three"]).to_string().contains("unknown act `three`");
    await_that("an answer of the scheduler", again);
    // The first step of the act would occur about 400 ms after a go.
    stays(Duration::from_millis(1_000), || sets(&stage));
    says(&stage.run(&["go", "two"]), 0, &["`two` begins"]);
    assert_eq!(mission.ended().code, Some(0));
}

const ACTS: &str = "scenario: acts
start_tolerance: 1s
acts:
  - act: one
    cues:
      - {cue: up, robots: all, at: 0s, tracks: {d: [STEPS]}}
  - act: two
    wait: operator
    cues:
      - {cue: down, robots: all, at: 0s, tracks: {d: [{at: 0s, to: 20}, {at: 400ms, to: 0}]}}
";

#[test]
fn early_go_is_refused_and_accepted_go_names_the_starting_act() {
    let stage = stage(1);
    stage.file("acts.yaml", ACTS.replace("STEPS", &steps(20, 200)));
    let mut mission = stage.begin(&["run", "acts.yaml"], [0], 2);
    says(&stage.run(&["go"]), 1, &["`two` waits until `one` has ended"]);
    says(&stage.run(&["go", "one"]), 1, &["`one` is not waiting for the operator"]);
    says(&stage.run(&["go", "three"]), 1, &["unknown act `three`"]);
    mission.line("`two` waits for the operator's go");
    // Printed once the previous act has ended, and not while it plays.
    let said = epoch_nanos();
    stage.robots[0].await_sets(20, Duration::from_secs(20));
    let sets = stage.robots[0].sets();
    assert!(sets.len() == 20 && sets.iter().all(|set| set.at <= said), "{said}: {sets:?}");
    let started = stage.run(&["go", "two", "--format", "json"]);
    let started: serde_json::Value = serde_json::from_str(&started.out).unwrap();
    assert_eq!(started["started"], "two");
    assert_eq!(mission.ended().code, Some(0));
}

#[test]
fn listing_missions_or_locking_journals_does_not_block_a_stop() {
    let stage = cut_off(2);
    let folder = std::fs::read_dir(stage.path("state")).unwrap().next().unwrap().unwrap().path();
    let foreign = std::fs::File::open(folder.join("journal")).unwrap();
    foreign.lock().unwrap();
    says(&stage.run(&["missions"]), 0, &["cut off"]);
    let over = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !over.load(std::sync::atomic::Ordering::Relaxed) {
                    stage.run(&["missions", "--all"]);
                }
            });
        }
        let stopped = stage.run(&["stop"]);
        over.store(true, std::sync::atomic::Ordering::Relaxed);
        says(&stopped, 0, &BOTH);
        assert!(!stopped.told.contains("another process"), "{stopped}");
    });
    all_rest(&stage);
    says(&stage.run(&["missions"]), 0, &["none was cut off"]);
}

#[test]
fn robot_with_all_connections_occupied_is_stopped() {
    let stage = cut_off(1);
    let fleet = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
    let address = fleet.split("tcp://").nth(1).unwrap().split('"').next().unwrap().to_owned();
    let taken: Vec<_> = (0..40).map(|_| std::net::TcpStream::connect(&address).unwrap()).collect();
    await_that("its connections", || stage.robots[0].connections() >= taken.len());
    says(&stage.run(&["stop", "--patience", "30s"]), 0, &["r0: stop confirmed"]);
    assert_eq!(taken.len(), 40);
    all_rest(&stage);
}

/// Returns the name of the only mission that was cut off (whose scheduler is gone).
fn cut_off_name(stage: &Stage) -> String {
    let missions = stage.run(&["missions", "--format", "json"]);
    let missions: serde_json::Value = serde_json::from_str(&missions.out).unwrap();
    let cut_off = |mission: &&serde_json::Value| mission["state"] == "cut off";
    let found = missions.as_array().unwrap().iter().find(cut_off);
    found.unwrap()["mission"].as_str().unwrap().to_owned()
}

/// Waits until the lease of a mission whose scheduler was killed has run out. Until then the robot belongs to that mission.
#[track_caller]
fn await_end_of_lease(stage: &Stage) {
    await_that("the end of the lease", || stage.robots[0].rests());
}

/// Returns a stage with two missions, and the name of the first one. The first mission's scheduler was killed, and the second mission now
/// drives its robot.
fn taken_over() -> (Stage, String, Running) {
    let stage = stage(1);
    let old = plays("old", "all").replace("{running: none}", "{running: 1s}");
    stage.file("old.yaml", old).file("new.yaml", plays("new", "all"));
    let mut old = stage.begin(&["run", "old.yaml"], [0], 2);
    old.process.kill();
    let name = cut_off_name(&stage);
    await_end_of_lease(&stage);
    let new = stage.begin(&["run", "new.yaml"], [0], 2);
    (stage, name, new)
}

#[test]
fn stop_names_no_lease_of_a_robot_taken_over_by_another_mission() {
    let (stage, old, new) = taken_over();
    let stopped = stage.run(&["stop", &old, "--patience", "1s"]);
    let taken = ["r0: not stopped: another mission now drives it", "r0: belongs to another session"];
    let taken = taken.map(|part| part.replace("r0: belongs", "`r0` belongs"));
    says(&stopped, 4, &[&taken[0], &taken[1]]);
    assert!(!stopped.out.contains("lease"), "{stopped}");
    let stopped = stage.run(&["stop", &old, "--patience", "1s", "--format", "json"]);
    let stop = &stopped.report()["robots"][0]["stop"];
    assert_eq!((stopped.code, stop), (Some(4), &serde_json::json!({"state": "taken_over"})), "{stopped}");
    let resumed = stage.run(&["resume", &old, "--patience", "1s"]);
    assert_ne!(resumed.code, Some(0), "{resumed}");
    says(&resumed, resumed.code.unwrap(), &["belongs to another session"]);
    assert!(!format!("{}{}", resumed.out, resumed.told).contains("its lease ends"), "{resumed}");
    // The other mission is not affected.
    let before = stage.robots[0].sets().len();
    stage.robots[0].await_sets(before + 3, Duration::from_secs(20));
    says(&stage.run(&["stop"]), 0, &["r0: stop confirmed"]);
    new.ended();
    all_rest(&stage);
}

#[test]
fn mission_warns_if_an_interrupted_mission_drove_its_robot_and_continues() {
    let stage = stage(2);
    stage.file("old.yaml", plays("old", "[r0]").replace("{running: none}", "{running: 1s}"));
    for (name, robots) in [("new", "[r0]"), ("other", "[r1]")] {
        let steps = plays(name, robots).replace(&steps(100, 300), &steps(4, 100));
        stage.file(&format!("{name}.yaml"), steps);
    }
    let mut old = stage.begin(&["run", "old.yaml"], [0], 2);
    old.process.kill();
    let warning = format!("mission `{}` was cut off and has not ended; it drove `r0`", cut_off_name(&stage));
    let other = stage.run(&["run", "other.yaml"]);
    says(&other, 0, &["other: done"]);
    assert!(!other.told.contains("was cut off"), "{other}");
    await_end_of_lease(&stage);
    let new = stage.play(&["run", "new.yaml"]);
    assert_eq!(new.told.matches(&warning).count(), 1, "{new}");
    says(&new, 0, &["new: done"]);
}

#[test]
fn second_stop_reports_the_same_lease_end() {
    let stage = stage(1);
    stage.file("long.yaml", plays("long", "all").replace("{running: none}", "{running: 2s}"));
    let mut mission = stage.begin(&["run", "long.yaml"], [0], 2);
    mission.process.kill();
    stage.robots[0].freeze();
    let stop = || stage.run(&["stop", "--patience", "500ms", "--format", "json"]);
    let ends = |ended: &Ended| ended.report()["robots"][0]["stop"]["lease_ends"].as_str().unwrap().to_owned();
    let first = ends(&stop());
    assert_eq!(ends(&stop()), first);
    sleep_until(nanos(&first) + 1_000_000);
    assert_eq!(ends(&stop()), first);
    says(&stage.run(&["stop", "--patience", "500ms"]), 4, &["r0: stop NOT confirmed; its lease ended at"]);
    stage.robots[0].thaw();
}

#[test]
fn refused_connection_is_reported_as_reason_for_an_unconfirmed_stop() {
    let mut stage = cut_off(1);
    stage.robots[0].kill();
    let stopped = stage.run(&["stop", "--patience", "1s"]);
    says(&stopped, 4, &["r0: stop NOT confirmed", "r0: link down: ", "refused"]);
    assert_eq!(stopped.out.matches("refused").count(), 1, "{stopped}");
}

#[test]
fn direct_stop_reports_only_known_facts_in_json() {
    let stage = cut_off(1);
    stage.robots[0].freeze();
    let schema: serde_json::Value = serde_json::from_str(&stage.run(&["schema", "report"]).out).unwrap();
    let schema = jsonschema::validator_for(&schema).unwrap();
    for (args, code) in [(&["--patience", "500ms"][..], 4), (&[], 0)] {
        let stopped = stage.run(&[&["stop", "--format", "json"], args].concat());
        let document = stopped.report();
        assert_eq!(stopped.code, Some(code), "{stopped}");
        assert_eq!((&document["scenario"], &document["outcome"]), (&"long".into(), &"stopped".into()));
        assert!(document["session"].as_str().unwrap().starts_with("long@"), "{document:#}");
        for unknown in ["course", "acts", "acts_omitted", "start", "spread_ms", "lead"] {
            assert!(document.get(unknown).is_none(), "{unknown}: {document:#}");
        }
        let robot = document["robots"][0].as_object().unwrap();
        assert_eq!(robot["robot"], "r0");
        for unknown in ["accepted", "started", "scripts", "steps_done", "steps_planned", "unaccounted"] {
            assert!(!robot.contains_key(unknown), "{unknown}: {document:#}");
        }
        let faults: Vec<_> =
            schema.iter_errors(&document).map(|e| format!("{}: {e}", e.instance_path)).collect();
        assert!(faults.is_empty(), "{faults:#?}\n{document:#}");
        stage.robots[0].thaw();
    }
}
