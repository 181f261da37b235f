//! Tests that a report is brief unless `--verbose` requests the figures of each robot.

use stage::session::{Ran, Session, root};

fn dry_run(args: &[&str]) -> Ran {
    let session = Session::new();
    let path = |name: &str| root().join(name).display().to_string();
    let (scenario, fleet) = (path("scripts/examples/swap.yaml"), path("fleet.yaml"));
    session.run(&[&["dry-run", &scenario, "--fleet", &fleet], args].concat())
}

#[test]
fn successful_mission_is_reported_in_at_most_five_lines() {
    let ran = dry_run(&[]);
    ran.says(
        0,
        &[
            "swap: done\n",
            "6 robots started within ",
            " of each other (5 ms allowed) at ",
            "432 of 432 steps played",
        ],
    );
    assert!(ran.out().lines().count() <= 5, "{}", ran.out());
    assert!(!ran.out().contains("cf1"), "{}", ran.out());
}

#[test]
fn verbose_prints_figures_per_robot() {
    for option in ["--verbose", "-v"] {
        let ran = dry_run(&[option]);
        ran.says(0, &["swap: done\n", "clock offset", "start spread ", "planned start "]);
        for robot in 1..=6 {
            assert!(ran.out().contains(&format!(" cf{robot}         yes              4/4")), "{}", ran.out());
        }
    }
}

#[test]
fn only_robots_deviating_from_plan_have_row() {
    let session = Session::new();
    session.file(
        "arm.yaml",
        "id: arm\napi_version: '1'\nreports: true\ndevices:\n  - {id: d, name: d, available_control_types: {position: {min_value: 0, max_value: 9, granularity: 1}, script: {min_value: 0, max_value: 9, granularity: 1, max_number_of_steps: 9}}}\n",
    );
    session.file(
        "fleet.yaml",
        "robots:\n  good: {init: arm.yaml, address: sim}\n  bad: {init: arm.yaml, address: sim, simulate: {fault: refuse}}\n",
    );
    session.file(
        "show.yaml",
        "scenario: show\non_failure: without\ncues: [{robots: [good, bad], tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 5}]}}]\n",
    );
    let ran = session.run(&["dry-run", "show.yaml"]);
    assert_ne!(ran.code(), 0, "{}", ran.text());
    assert!(ran.out().contains("\n bad "), "{}", ran.out());
    assert!(ran.out().contains("bad: "), "{}", ran.out());
}
