//! The commands that judge a scenario's requirements: they exit with code 1 if a requirement is not met.

use serde_json::{Value, json};

use stage::session::{Ran, Session};

/// Creates a show of two moving arms with these requirements. Their bodies are balls; the distance from `left` to `right` decreases from
/// 1.8 m to 1.755 m.
fn session(require: &str) -> Session {
    let session = Session::new();
    session.file(
        "fleet.yaml",
        "robots:
  left: {init: arm.yaml, address: sim, body: {x: {device: shoulder, scale: 0.001}, radius: 0.1}}
  right: {init: arm.yaml, address: sim, body: {x: 2, radius: 0.1}, simulate: {ntp_error: 3ms}}
groups: {arms: [left, right]}\n",
    );
    session.file(
        "show.yaml",
        format!(
            "scenario: show\nrequire: {require}\ncues: [{{robots: arms, tracks: {{shoulder: [{{at: 1s, to: 45}}]}}}}]\n"
        ),
    );
    session
}

fn results(ran: &Ran) -> Vec<(String, String)> {
    let document = ran.json();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let judged = document["requirements"].as_array().unwrap();
    judged.iter().map(|judged| (text(&judged["requirement"]), text(&judged["result"]))).collect()
}

#[test]
fn dry_run_reports_each_requirement_as_met_or_unknown_with_reason() {
    let session = session(
        "{spread_p99: below 5ms, spread_max: at most 5ms, finishes: at least 99 %, closest: above 1.7m}",
    );
    let ran = session.run(&["dry-run", "show.yaml"]);
    ran.says(
        0,
        &[
            "spread_p99",
            "not known",
            "at least 99%",
            "1.755 m",
            "--trials",
            "no requirement is known to be unmet; the result is unknown for 2",
        ],
    );
    let ran = session.run(&["dry-run", "show.yaml", "--format", "json"]);
    let expected =
        [("spread_p99", "not_known"), ("spread_max", "met"), ("finishes", "not_known"), ("closest", "met")];
    assert_eq!(results(&ran), expected.map(|(name, result)| (name.to_owned(), result.to_owned())));
    let errors: Vec<_> = stage::schema::validator("report")
        .iter_errors(&ran.json())
        .map(|error| format!("{error} at {}", error.instance_path))
        .collect();
    assert_eq!(errors, Vec::<String>::new());
}

#[test]
fn too_large_spread_fails_completed_dry_run() {
    let session = session("{spread_max: below 500us}");
    session.run(&["dry-run", "show.yaml"]).says(1, &["show: done", "NOT MET", "below 0.5 ms", "1 of 1"]);
}

#[test]
fn unmet_distance_fails_check_plan_and_dry_run_but_not_mission() {
    let session = session("{spread_p50: below 9ms, closest: above 1.9m}");
    let ran = session.run(&["check", "show.yaml"]);
    ran.says(1, &["DB0056", "show.yaml:2:43", "within 1.755 m", "NOT MET", "1 of 1 requirements NOT met"]);
    assert_eq!(session.run(&["check", "show.yaml", "--format", "json"]).json()["ok"], json!(false));
    let plan = session.run(&["plan", "show.yaml", "--format", "json"]);
    assert_eq!((plan.code(), results(&plan)), (1, vec![("closest".to_owned(), "not_met".to_owned())]));
    session.run(&["dry-run", "show.yaml"]).says(1, &["1 of 2 requirements NOT met, 1 unknown"]);
    session.play(&["run", "show.yaml"]).says(0, &["DB0056", "show: done"]);
}

#[test]
fn distance_is_unknown_if_body_position_is_unknown_or_body_is_omitted() {
    let session = session("{closest: above 1.7m}");
    let only = session.run(&["dry-run", "show.yaml", "--only", "left", "--format", "json"]);
    assert_eq!((only.code(), results(&only)), (0, vec![("closest".to_owned(), "not_known".to_owned())]));
    let arm =
        std::fs::read_to_string(session.path("arm.yaml")).unwrap().replace("    default_value: 0\n", "");
    session.file("arm.yaml", arm);
    let ran = session.run(&["check", "show.yaml"]);
    ran.says(0, &["DB0055", "closest", "not known"]);
}

#[test]
fn absent_requirements_are_not_shown() {
    let session = session("{}");
    let ran = session.run(&["dry-run", "show.yaml", "--format", "json"]);
    assert_eq!(ran.json().get("requirements"), None);
    assert!(!session.run(&["dry-run", "show.yaml"]).text().contains("requirement"));
}
