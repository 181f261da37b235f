//! Tests pages for a browser. They show the same as the command line, for any kind of name. A page is written completely or not at all.
//! Other tests, in `viewer/test/`, open pages in a browser.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Command;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::read::GzDecoder;
use serde_json::Value;

use stage::session::{Ran, Session, program, root};

/// Runs the program in the folder of the project, whose `fleet.yaml` is the demo fleet.
fn downbeat(args: &[&str]) -> Ran {
    Ran(Command::new(program()).args(args).current_dir(root()).output().unwrap())
}

/// The data that a page contains.
pub struct Page {
    pub mission: Value,
    columns: Vec<u8>,
}

impl Page {
    pub fn read(path: &Path) -> Self {
        let html = fs::read_to_string(path).unwrap();
        let marked = html.split_once("type=\"application/octet-stream\">").unwrap().1;
        let packed = STANDARD.decode(marked.split_once('<').unwrap().0).unwrap();
        let mut bytes = Vec::new();
        GzDecoder::new(packed.as_slice()).read_to_end(&mut bytes).unwrap();
        let (length, rest) = bytes.split_at(4);
        let (json, columns) = rest.split_at(u32::from_le_bytes(length.try_into().unwrap()) as usize);
        Self { mission: serde_json::from_slice(json).unwrap(), columns: columns.to_vec() }
    }

    /// Returns the numbers of a column of the page's data. The code that decodes them is independent of the program.
    pub fn numbers(&self, column: &Value) -> Vec<f64> {
        let mut bytes = self.columns[column["at"].as_u64().unwrap() as usize..].iter().copied();
        let scale = 10.0_f64.powi(column["decimals"].as_i64().unwrap() as i32);
        let trend = column["order"] == 2;
        let (mut last, mut before) = (0_i64, 0_i64);
        let mut next = || {
            let (mut shift, mut zigzag) = (0, 0_u64);
            for byte in bytes.by_ref() {
                zigzag |= u64::from(byte & 0x7f) << shift;
                shift += 7;
                if byte < 0x80 {
                    break;
                }
            }
            let difference = (zigzag >> 1) as i64 ^ -((zigzag & 1) as i64);
            let expected = if trend { last + before } else { last };
            before = expected + difference - last;
            last = expected + difference;
            last as f64 / scale
        };
        (0..column["n"].as_u64().unwrap()).map(|_| next()).collect()
    }

    /// Returns the lane (the values over time) of a device in a plan.
    fn lane(&self, plan: usize, robot: &str, device: &str) -> &Value {
        let robots = self.mission["robots"].as_array().unwrap();
        let index = robots.iter().position(|known| known["id"] == robot).unwrap();
        let devices = robots[index]["devices"].as_array().unwrap();
        let device = devices.iter().position(|known| known["id"] == device).unwrap();
        let lanes = self.mission["plans"][plan]["lanes"].as_array().unwrap();
        lanes.iter().find(|lane| lane["robot"] == index && lane["device"] == device).unwrap()
    }

    /// Returns the steps of a device's first script: the milliseconds since the start of the act, and the value.
    fn steps(&self, robot: &str, device: &str) -> Vec<(f64, f64)> {
        let script = &self.lane(0, robot, device)["scripts"][0];
        let start = script["start"].as_f64().unwrap();
        let times = self.numbers(&script["steps"]["t"]).into_iter().map(|at| start + at);
        times.zip(self.numbers(&script["steps"]["v"])).collect()
    }
}

fn in_folder(name: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name).display().to_string();
    (folder, path)
}

const SWAP: &str = "scripts/examples/swap.yaml";

#[test]
fn dry_run_page_matches_report_steps_and_cues_of_command_line() {
    let (_folder, path) = in_folder("swap.html");
    let report = downbeat(&["dry-run", SWAP, "--format", "json", "--html", &path]).json();
    let planned = downbeat(&["plan", SWAP, "--format", "json"]).json();
    let page = Page::read(Path::new(&path));
    assert_eq!(page.mission["report"], report);
    let (plan, act) = (&page.mission["plans"][0], &planned["acts"][0]);
    assert_eq!(plan["closest"]["distance"], act["closest"]["distance_m"]);
    for (shown, told) in plan["cues"].as_array().unwrap().iter().zip(act["cues"].as_array().unwrap()) {
        for (on_page, in_plan) in [("name", "name"), ("start", "start"), ("end", "end"), ("slack", "slack")] {
            let equal = shown[on_page].as_f64() == told[in_plan].as_f64()
                && (shown[on_page].is_number() || shown[on_page] == told[in_plan]);
            assert!(equal, "{on_page}: {shown} {told}");
        }
    }
    let requests = act["robots"]["cf2"].as_array().unwrap();
    let x = requests.iter().find(|request| request["control_request"]["device_id"] == "x").unwrap();
    let told: Vec<(f64, f64)> = x["control_request"]["control_value"]
        .as_array()
        .unwrap_or_else(|| panic!("{x}"))
        .iter()
        .map(|step| (step["time_offset_to_start"].as_f64().unwrap(), step["control_value"].as_f64().unwrap()))
        .collect();
    assert_eq!(page.steps("cf2", "x"), told);
}

#[test]
fn act_played_alone_has_its_own_source_lines() {
    let (_folder, path) = in_folder("bow.html");
    let meeting = "scripts/examples/meeting.yaml";
    downbeat(&["dry-run", meeting, "--act", "bow", "--html", &path]).says(0, &[]);
    let page = Page::read(Path::new(&path));
    let source = page.mission["sources"][0]["text"].as_str().unwrap();
    let cues = page.mission["plans"][0]["cues"].as_array().unwrap();
    let first_line = |cue: &Value| source.lines().nth(cue["first_line"].as_u64().unwrap() as usize - 1);
    for cue in cues {
        let name = format!("cue: {}", cue["name"].as_str().unwrap());
        assert!(first_line(cue).unwrap().contains(&name), "{cue}: {:?}", first_line(cue));
    }
    assert_eq!(cues.len(), 2);
}

#[test]
fn speed_controlled_body_moves_on_page() {
    let (_folder, path) = in_folder("meeting.html");
    downbeat(&["dry-run", "scripts/examples/meeting.yaml", "--html", &path]).says(0, &[]);
    let page = Page::read(Path::new(&path));
    let robots = page.mission["robots"].as_array().unwrap();
    let rover = robots.iter().find(|robot| robot["id"] == "rover-1").unwrap();
    let driven = rover["devices"][rover["body"]["x"]["device"].as_u64().unwrap() as usize].clone();
    assert_eq!((&driven["id"], &driven["default"]), (&"x of its drive".into(), &0.0.into()));
    let x = page.steps("rover-1", "x of its drive");
    let y = page.steps("rover-1", "y of its drive");
    // The rover starts at (0, -4), comes 1.5 m closer and goes back.
    assert_eq!((x[0], y[0]), ((0.0, 0.0), (0.0, -4.0)));
    assert!(x.len() < 200 && x.windows(2).all(|pair| pair[0].0 <= pair[1].0), "{x:?}");
    assert!(x.iter().any(|(_, x)| *x > 0.5), "{x:?}");
}

#[test]
fn same_seed_produces_same_page() {
    let (folder, _) = in_folder("");
    let page = |name: &str, seed: &str| {
        let path = folder.path().join(name);
        downbeat(&["dry-run", SWAP, "--seed", seed, "--html", path.to_str().unwrap()]).says(0, &[]);
        fs::read(path).unwrap()
    };
    assert!(page("a.html", "7") == page("b.html", "7"));
    assert!(page("a.html", "7") != page("b.html", "8"));
}

#[test]
fn name_cannot_inject_markup_into_page() {
    let session = Session::new();
    let evil = "</script><script>alert(1)</script> \u{202e}";
    session.file("robot.yaml", "id: r\napi_version: \"1\"\ndevices:\n  - id: x\n    available_control_types:\n      position: {min_value: 0, max_value: 9, granularity: 1, max_error: 1}\n      script: {min_value: 0, max_value: 9, granularity: 1, max_error: 1, max_number_of_steps: 9, control_types: [position]}\n");
    session.file("fleet.yaml", "robots: {r: {init: robot.yaml, address: sim}}\n");
    let written = format!("\"{}\"", evil.replace('\u{202e}', "\\u202e"));
    session.file("show.yaml", format!("scenario: {written}\ncues: [{{cue: {written}, robots: r, tracks: {{x: [{{at: 0s, to: 1}}, {{at: 1s, to: 2}}]}}}}]\n"));
    session.run(&["dry-run", "show.yaml", "--html", "show.html"]).says(0, &[]);
    let html = fs::read_to_string(session.path("show.html")).unwrap();
    assert!(!html.contains("alert(1)"), "the name is in the page as it is");
    assert_eq!(Page::read(&session.path("show.html")).mission["scenario"], evil);
}

#[test]
fn failed_page_write_is_reported_and_leaves_no_partial_file() {
    let (folder, path) = in_folder("show.html");
    fs::write(&path, "before").unwrap();
    let within = folder.path().join("no/such/folder/show.html");
    downbeat(&["dry-run", SWAP, "--html", within.to_str().unwrap()])
        .says(2, &["cannot write", "the folder does not exist"]);
    downbeat(&["dry-run", SWAP, "--html", &path]).says(0, &[]);
    assert!(fs::read_to_string(&path).unwrap().starts_with("<!doctype html>"));
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["show.html"], "nothing else is left");
}

#[test]
fn page_never_overwrites_its_source_and_writes_through_links() {
    let (folder, path) = in_folder("target.html");
    fs::write(&path, "before").unwrap();
    let link = folder.path().join("link.html");
    std::os::unix::fs::symlink(&path, &link).unwrap();
    downbeat(&["dry-run", SWAP, "--html", link.to_str().unwrap()]).says(0, &[]);
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert!(fs::read_to_string(&path).unwrap().starts_with("<!doctype html>"));
    let text = fs::read_to_string(root().join(SWAP)).unwrap();
    downbeat(&["dry-run", SWAP, "--html", SWAP])
        .says(2, &["the output would overwrite its own source", "choose another name"]);
    downbeat(&["dry-run", SWAP, "--html", "-"]).says(2, &["`-` is not a file"]);
    assert_eq!(fs::read_to_string(root().join(SWAP)).unwrap(), text);
}

const SHOW: &str = "scenario: show\ncues:\n  - cue: rise\n    robots: arms\n    tracks: {shoulder: [{at: 0s, to: 0}, {at: 1s, to: 45}]}\n";

#[test]
fn withdrawn_act_is_not_shown_as_played() {
    let session = Session::new();
    let fleet = "robots:\n  left: {init: arm.yaml, address: sim}\n  right: {init: arm.yaml, address: sim, simulate: {fault: refuse}}\ngroups: {arms: [left, right]}\n";
    session.file("fleet.yaml", fleet).file("show.yaml", SHOW);
    session.run(&["dry-run", "show.yaml", "--html", "dry.html"]).says(1, &[]);
    session.play(&["run", "show.yaml", "--record", "show.mcap"]).says(1, &[]);
    session
        .run(&["report", "show.mcap", "--html", "run.html"])
        .says(0, &["show: ", "withdrawn before anything moved", "right: "]);
    for page in ["dry.html", "run.html"] {
        let mission = Page::read(&session.path(page)).mission;
        let act = &mission["acts"][0];
        assert_eq!(act["fate"], "withdrawn", "{page}");
        assert!(act["over"].as_f64().unwrap() < act["start"].as_f64().unwrap(), "{page}: {act}");
        let failures = mission["report"]["failures"].as_array().unwrap();
        assert!(failures.iter().any(|failure| failure["robot"] == "right" && failure["text"].is_string()));
    }
}

/// Plays and records a mission. Returns the session, which contains the recording and the journal.
fn recorded() -> Session {
    let session = Session::new();
    let (example, fleet) = (root().join(SWAP), root().join("fleet.yaml"));
    let (example, fleet) = (example.display().to_string(), fleet.display().to_string());
    session.play(&["run", &example, "--fleet", &fleet, "--record", "swap.mcap"]).says(0, &["done"]);
    session
}

fn journal(session: &Session) -> PathBuf {
    let mut missions = fs::read_dir(session.path("state")).unwrap().map(|entry| entry.unwrap().path());
    missions.find_map(|folder| Some(folder.join("journal")).filter(|journal| journal.exists())).unwrap()
}

#[test]
fn recorded_mission_is_shown_with_its_steps_and_starts() {
    let session = recorded();
    let report = session.run(&["report", "swap.mcap", "--html", "swap.html", "--format", "json"]).json();
    assert_eq!(report["outcome"], "done");
    let page = Page::read(&session.path("swap.html"));
    for (key, value) in report.as_object().unwrap() {
        assert_eq!(page.mission["report"][key], *value, "{key}");
    }
    // The recording ends with the report of the mission, so the results of each robot are known.
    let robots = report["robots"].as_array().unwrap();
    assert_eq!(robots.len(), page.mission["robots"].as_array().unwrap().len());
    for robot in robots {
        assert_eq!(robot["steps_done"], robot["steps_planned"], "{robot}");
        assert!(robot["clock"]["uncertainty_ms"].as_f64().unwrap() > 0.0, "{robot}");
        assert_eq!(robot["stop"]["state"], "not_sent", "{robot}");
    }
    assert!(page.mission["known_until"].as_f64() >= page.mission["acts"][0]["end"].as_f64());
    assert_eq!(page.mission["kind"], "recording");
    let (_folder, path) = in_folder("swap.html");
    downbeat(&["dry-run", SWAP, "--html", &path]).says(0, &[]);
    let rehearsed = Page::read(Path::new(&path));
    for device in ["x", "y", "z", "yaw"] {
        let close =
            |(at, value): (f64, f64), (then, other): (f64, f64)| (at - then).abs() < 0.01 && value == other;
        let (played, planned) = (page.steps("cf5", device), rehearsed.steps("cf5", device));
        assert_eq!(played.len(), planned.len());
        assert!(played.iter().zip(&planned).all(|(a, b)| close(*a, *b)), "{played:?} {planned:?}");
    }
    let (swap, fleet) =
        (root().join(SWAP).display().to_string(), root().join("fleet.yaml").display().to_string());
    let with = ["report", "swap.mcap", "--html", "with.html", "--fleet", &fleet, "--scenario"];
    session.run(&[&with[..], &[&swap]].concat()).says(0, &["swap: done"]);
    let with_scenario = Page::read(&session.path("with.html"));
    assert_eq!(
        with_scenario.mission["plans"], rehearsed.mission["plans"],
        "cues, lanes and the closest approach"
    );
    assert_eq!(with_scenario.mission["robots"], rehearsed.mission["robots"], "bodies");
    let other = root().join("scripts/examples/tank.yaml").display().to_string();
    session
        .run(&[&with[..], &[&other]].concat())
        .says(2, &["the scenario is not the one that was played", "`cf1/x`"]);
    let act = &page.mission["acts"][0];
    // On a slow machine, the commit may come after the last moment at which a stop is still in time.
    for phases in [["sent", "decided", "committed", "start"], ["sent", "decided", "no_return", "start"]] {
        let at = phases.map(|phase| act[phase].as_f64().unwrap());
        assert!(at.windows(2).all(|pair| pair[0] < pair[1]), "{phases:?}: {at:?}");
    }
    let started = act["robots"].as_array().unwrap().iter().filter(|robot| robot["started"].is_number());
    assert_eq!(started.count(), 6);
}

#[test]
fn incomplete_recording_or_journal_is_refused_without_partial_option() {
    let session = recorded();
    let whole = fs::read(session.path("swap.mcap")).unwrap();
    session.file("cut.mcap", &whole[..whole.len() * 2 / 3]);
    session
        .run(&["report", "cut.mcap", "--html", "cut.html"])
        .says(2, &["`cut.mcap` is incomplete: after ", "--partial"]);
    assert!(!session.path("cut.html").exists());
    session
        .run(&["report", "cut.mcap", "--html", "cut.html", "--partial"])
        .says(0, &["`cut.mcap` is incomplete: after ", "swap: "]);
    assert_eq!(Page::read(&session.path("cut.html")).mission["acts"][0]["name"], "swap");
    let mut damaged = whole.clone();
    let middle = whole.len() / 2;
    damaged[middle] ^= 1;
    session.file("damaged.mcap", &damaged);
    session.run(&["report", "damaged.mcap"]).says(2, &["`damaged.mcap` is incomplete: after "]);
    session.file("none.mcap", &whole[..8]);
    session
        .run(&["report", "none.mcap", "--partial"])
        .says(2, &["use the mission's journal if it still exists"]);
    let journal = journal(&session);
    session.run(&["report", journal.parent().unwrap().to_str().unwrap()]).says(0, &["swap: done"]);
    let text = fs::read_to_string(&journal).unwrap();
    session.file("bad", text.replacen("\"checked\"", "\"chocked\"", 1));
    session.run(&["report", "bad"]).says(2, &["`bad` is incomplete: line 3 is damaged"]);
    session.run(&["report", "none"]).says(2, &["there is no such file"]);
    session.file("other", b"robots: {}\n");
    session.run(&["report", "other"]).says(2, &["neither a recording nor a journal"]);
}

const WORLD: &str = "world: a bad evening
links:
  all: {delay: 0.3ms, jitter: 0.2ms}
  cf2: {delay: 0.5ms, loss: 5%}
clocks:
  all: {error: 0.5ms}
incidents:
  - {robot: cf4, what: refuses, probability: 20%}
";

#[test]
fn trials_page_matches_command_line() {
    let (folder, path) = in_folder("trials.html");
    let world = folder.path().join("it's friday.yaml").display().to_string();
    fs::write(&world, WORLD).unwrap();
    let trials = |more: &[&str]| {
        let args = ["dry-run", SWAP, "--world", &world, "--trials", "60", "--seed", "18446744073709551615"];
        downbeat(&[args.as_slice(), more].concat())
    };
    let told = trials(&["--format", "json", "--html", &path]).json();
    let page = Page::read(Path::new(&path)).mission;
    assert_eq!((&page["kind"], &page["seed"]), (&"trials".into(), &"18446744073709551615".into()));
    let facts = told.as_object().unwrap().iter().filter(|(key, _)| !["each", "seed"].contains(&key.as_str()));
    for (key, value) in facts {
        assert_eq!(page[key], *value, "{key}");
    }

    let each = told["each"].as_array().unwrap();
    let spreads: Vec<f64> = each.iter().filter_map(|trial| trial["spread_ms"].as_f64()).collect();
    let width = page["histogram"]["width_ms"].as_f64().unwrap();
    let counts = page["histogram"]["counts"].as_array().unwrap();
    for (place, count) in counts.iter().enumerate() {
        let within = |spread: &&f64| ((place as f64 * width)..((place + 1) as f64 * width)).contains(*spread);
        assert_eq!(*count, spreads.iter().filter(within).count(), "{place}");
    }
    assert!(!spreads.is_empty() && spreads.len() < 60 && page["histogram"]["beyond"] == 0, "{page:#}");

    let reason = &page["reasons"][0];
    let number = reason["example"].to_string();
    let words: Vec<&str> =
        page["replay"].as_array().unwrap().iter().map(|word| word.as_str().unwrap()).collect();
    let again = downbeat(&[&words[1..], &["--trial", &number, "--format", "json"]].concat());
    let again: Value = serde_json::from_slice(&again.0.stdout).unwrap();
    assert_eq!(words[0], "downbeat");
    assert_eq!(again["outcome"], each[reason["example"].as_u64().unwrap() as usize]["outcome"]);
    assert_eq!(again["failures"][0]["robot"], reason["robot"]);

    let before = fs::read(&path).unwrap();
    trials(&["--html", &path]).says(0, &["60 trials"]);
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn trials_page_never_overwrites_its_world() {
    let (_folder, path) = in_folder("world.yaml");
    fs::write(&path, WORLD).unwrap();
    for count in [["--trials", "2"], ["--trial", "1"]] {
        let args = ["dry-run", SWAP, "--world", &path, "--html", &path];
        downbeat(&[args.as_slice(), &count].concat()).says(2, &["the output would overwrite", "world.yaml"]);
    }
    assert_eq!(fs::read_to_string(&path).unwrap(), WORLD);
}
