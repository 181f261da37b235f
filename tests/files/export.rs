//! `downbeat export`: other tools receive exactly the content of the scenario, and importing the exported file restores the scenario.

use stage::session::{Session, root};

fn fixture(name: &str) -> String {
    root().join("tests/fixtures/import").join(name).display().to_string()
}

fn rows(text: &str) -> Vec<Vec<f64>> {
    text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect()
}

#[test]
fn drone_show_survives_csv_export_and_import() {
    let session = Session::new();
    session.run(&["import", "skybrush", &fixture("two_drones.skyc"), "--output", "show"]).says(0, &[]);
    let args = ["export", "drone-csv", "show/scenario.yaml", "--fleet", "show/fleet.yaml", "--output", "csv"];
    session
        .run(&[&args[..], &["--rate", "4"]].concat())
        .says(0, &["wrote csv/Drone 1.csv", "left out `yaw`"]);
    let text = std::fs::read_to_string(session.path("csv/Drone 2.csv")).unwrap();
    assert!(
        text.starts_with(
            "Time [msec],x [m],y [m],z [m],Red,Green,Blue\n0,3.000000,0.000000,0.000000,128,128,128\n"
        ),
        "{text}"
    );
    let drone = rows(&text);
    // Up in 2 s, across in 8 s, down in 2 s; the show lasts 16.75 s.
    for (row, expected) in
        [(4, [1_000.0, 3.0, 0.0, 2.0]), (24, [6_000.0, 3.0, 3.0, 4.0]), (66, [16_500.0, 3.0, 6.0, 0.0])]
    {
        assert!(
            drone[row].iter().zip(expected).all(|(found, value)| (found - value).abs() < 2e-3),
            "{:?}",
            drone[row]
        );
    }
    let maps = ["--map", "x=x", "--map", "y=y", "--map", "z=z", "--map", "lamp=Red,Green,Blue"];
    let back = [&["import", "csv", "csv", "--time", "Time", "--output", "back"][..], &maps].concat();
    session.run(&back).says(0, &["imported 2 files as one robot each"]);
    session.run(&["check", "back/scenario.yaml"]).says(0, &["no errors, 2 robots, 8 devices"]);
    session.run(&args).says(2, &["DB0069", "--force"]);
}

#[test]
fn joints_survive_trajectory_export_and_import() {
    let session = Session::new();
    session.file("move.yaml", "scenario: move\ncues:\n  - robots: left\n    tracks: {shoulder: [{at: 0s, to: 0}, {at: 1500ms, to: 45.5}, {at: 2s, to: 30}]}\n");
    session
        .run(&["export", "joint-trajectory", "move.yaml", "--output", "out"])
        .says(0, &["wrote out/left.yaml"]);
    let text = std::fs::read_to_string(session.path("out/left.yaml")).unwrap();
    assert!(text.contains("joint_names: [shoulder]\n"), "{text}");
    assert!(text.contains("- {positions: [45.5], time_from_start: {sec: 1, nanosec: 500000000}}"), "{text}");
    session
        .run(&["import", "joint-trajectory", "out/left.yaml"])
        .says(0, &["- {at: 0s, to: 0}", "- {at: 1500ms, to: 45.5}", "- {at: 2s, to: 30}"]);
    session
        .run(&["export", "drone-csv", "move.yaml", "--output", "csv"])
        .says(1, &["needs robots with the devices `x`, `y` and `z`"]);
}
