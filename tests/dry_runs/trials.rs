//! World files (the links, clocks and incidents of a network) and trials (many dry runs in such a world), as a user sees them. The tests
//! check output, exit codes, and mistakes in world files.

use serde_json::Value;

use stage::session::Session;

const WORLD: &str = "world: friday
links: {all: {delay: 0.5ms, jitter: 0.3ms}}
clocks: {arms: {error: 1ms}}
incidents: [{robot: left, what: refuses, probability: 20%}]
";

fn session(require: &str) -> Session {
    let session = Session::new();
    session.file(
        "fleet.yaml",
        "robots: {left: {init: arm.yaml, address: sim}, right: {init: arm.yaml, address: sim}}
groups: {arms: [left, right]}\n",
    );
    session.file(
        "show.yaml",
        format!("scenario: show\n{require}start_tolerance: 20ms\ncues: [{{robots: arms, tracks: {{shoulder: [{{at: 1s, to: 45}}]}}}}]\n"),
    );
    session.file("world.yaml", WORLD);
    session
}

const TRIALS: [&str; 7] =
    ["dry-run", "show.yaml", "--world", "world.yaml", "--trials", "100", "--format=json"];

#[test]
fn trials_report_start_probability_and_reasons_for_failure() {
    let session = session("");
    let ran = session.run(&TRIALS[..6]);
    ran.says(0, &["100 trials in the world `friday`, seed 0: show", "start", "busy", "weakest robot: left"]);
    let results = session.run(&TRIALS).json();
    let (starts, aborts) = (&results["starts"]["count"], &results["aborts"]["count"]);
    assert_eq!(starts.as_u64().unwrap() + aborts.as_u64().unwrap(), 100);
    assert!((5..=40).contains(&aborts.as_u64().unwrap()), "{aborts}");
    assert_eq!(results["each"].as_array().unwrap().len(), 100);
    assert_eq!(results["weakest_robot"], "left");
}

#[test]
fn same_seed_prints_same_output_and_different_seed_differs() {
    let session = session("");
    let printed = |seed: &str| session.run(&[&TRIALS[..], &["--seed", seed]].concat()).out();
    assert_eq!(printed("7"), printed("7"));
    assert_ne!(printed("7"), printed("8"));
}

#[test]
fn failed_trial_can_be_replayed_alone_with_page() {
    let session = session("");
    let results = session.run(&TRIALS).json();
    let of = |outcome: &str| {
        let each = results["each"].as_array().unwrap();
        let trial = each.iter().find(|trial| trial["outcome"] == outcome).unwrap();
        (trial["trial"].to_string(), trial["spread_ms"].clone())
    };
    let again = |trial: &str| {
        session.run(&[
            "dry-run",
            "show.yaml",
            "--world",
            "world.yaml",
            "--trial",
            trial,
            "--html",
            "t.html",
            "--format=json",
        ])
    };
    let (done, spread) = of("done");
    let ran = again(&done);
    assert_eq!((ran.code(), &ran.json()["true_spread_ms"]), (0, &spread));
    let (failed, _) = of("not_started");
    let ran = again(&failed);
    assert_eq!((ran.code(), &ran.json()["outcome"]), (1, &Value::from("not_started")));
    assert!(session.path("t.html").is_file());
}

#[test]
fn trial_requirements_determine_exit_code() {
    let strict = session("require: {finishes: above 99%, spread_p99: below 5ms}\n");
    strict.run(&TRIALS[..6]).says(1, &["finishes", "NOT MET", "1 of 2 requirements NOT met"]);
    let mild = session("require: {finishes: above 50%, spread_p99: below 5ms}\n");
    mild.run(&TRIALS[..6]).says(0, &["finishes", "met", "spread_p99"]);
}

#[test]
fn trials_without_world_use_conditions_of_fleet_file() {
    let session = session("");
    let ran = session.run(&["dry-run", "show.yaml", "--trials", "20"]);
    ran.says(0, &["20 trials in the world of the fleet file", "100 %"]);
}

#[test]
fn mistakes_in_world_are_reported_with_their_position() {
    let session = session("");
    session.file(
        "world.yaml",
        "world: w\nlinks:\n  lefty: {delay: 1ms}\n  right: {delay: -3ms, loss: 150%}\nincidents: [{robot: left, what: dies, act: second}]\n",
    );
    let ran = session.run(&TRIALS[..6]);
    ran.says(
        1,
        &[
            "world.yaml:3:3",
            "no robot or group `lefty` in the fleet",
            "did you mean `left`?",
            "world.yaml:4:18",
            "found `150%`",
            "a probability from 0% to 100%",
            "no act `second`",
        ],
    );
    session.run(&["dry-run", "show.yaml", "--world", "none.yaml"]).says(2, &["none.yaml"]);
    session
        .run(&["dry-run", "show.yaml", "--world", "fleet.yaml"])
        .says(1, &["this is a fleet file, not a world file"]);
    session.run(&["dry-run", "show.yaml", "--trials", "0"]).says(2, &["--trials"]);
}

#[test]
fn invalid_world_files_are_refused_with_message() {
    let session = session("");
    for (content, says) in [
        (b"\xff\xfe\x00binary".as_slice(), "UTF-8"),
        (b"", "world"),
        (b"[1, 2]", "world"),
        (b"world: w\nlinks: [", "world.yaml:2"),
    ] {
        session.file("world.yaml", content);
        let ran = session.run(&TRIALS[..6]);
        assert!([1, 2].contains(&ran.code()) && ran.text().contains(says), "{says}: {}", ran.text());
    }
}
