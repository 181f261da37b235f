//! `downbeat import`: it turns other programs' files into a scenario that passes `downbeat check`.

use stage::session::{Ran, Session, program, root};

fn fixture(name: &str) -> String {
    root().join("tests/fixtures/import").join(name).display().to_string()
}

fn import(session: &Session, args: &[&str]) -> Ran {
    session.run(&[&["import"], args].concat())
}

/// Imports a text, and checks the exit code and the finding. Nothing is written to standard output.
#[track_caller]
fn check(format: &str, text: impl AsRef<[u8]>, code: i32, parts: &[&str]) {
    let session = Session::new();
    session.file("test.csv", text);
    let ran = import(&session, &[format, "test.csv"]);
    ran.says(code, parts);
    assert_eq!(ran.out(), "", "nothing is half imported");
}

#[track_caller]
fn check_csv(text: &str, parts: &[&str]) {
    let session = Session::new();
    session.file("test.csv", text);
    import(&session, &["csv", "test.csv", "--time-unit", "s", "--map", "arm/a=a"]).says(1, parts);
}

/// Imports into a folder, runs `downbeat check` on the written scenario, and expects `figures` in its output.
#[track_caller]
fn check_round_trip(args: &[&str], figures: &str) {
    let session = Session::new();
    import(&session, &[args, &["--output", "out"]].concat()).says(0, &["wrote out/scenario.yaml"]);
    session.run(&["check", "out/scenario.yaml"]).says(0, &[figures]);
}

#[test]
fn polynomial_pieces_import_as_valid_scenario() {
    let swap = fixture("swap");
    check_round_trip(&["crazyswarm", &swap], "no errors, 2 robots, 8 devices, ");
    check_round_trip(&["crazyswarm", &swap, "--rate", "50"], "1712 steps, 4.25 s");
    let session = Session::new();
    let ran = import(&session, &["crazyswarm", &swap, "--robots", "left,right"]);
    ran.says(
        0,
        &[
            "# Imported from crazyswarm swap.",
            "scenario: swap",
            "robots: left",
            "x:\n        polynomial:\n          - {for: 250ms, coefficients: [",
        ],
    );
    let sampled = import(&session, &["crazyswarm", &swap, "--rate", "4"]);
    sampled.says(0, &["- {at: 250ms, to: -3.300855}", "leave out --rate to keep the curves"]);
}

/// Returns all numbers of a line.
fn numbers(line: &str, separators: &[char]) -> Vec<f64> {
    line.split(separators).filter_map(|cell| cell.trim().parse().ok()).collect()
}

#[test]
fn imported_curve_keeps_coefficients_of_its_file() {
    let file = fixture("swap/pp1.csv");
    let text = std::fs::read_to_string(&file).unwrap();
    let written = import(&Session::new(), &["crazyswarm", &file]).out();
    let mut pieces: Vec<Vec<f64>> = Vec::new();
    for axis in 0..4 {
        for line in text.lines().skip(1) {
            let cells = numbers(line, &[',']);
            let mut own = cells[1 + 8 * axis..9 + 8 * axis].to_vec();
            while own.len() > 1 && own.last() == Some(&0.0) {
                own.pop();
            }
            pieces.push(own);
        }
    }
    let lines = written.lines().filter_map(|line| line.trim().strip_prefix("- {for: 250ms, coefficients: "));
    let found: Vec<_> = lines.map(|line| numbers(line, &['[', ']', '}', ','])).collect();
    assert_eq!(found, pieces);
}

#[test]
fn curve_steps_stay_within_tolerance() {
    let session = Session::new();
    import(&session, &["crazyswarm", &fixture("swap"), "--output", "out"]).says(0, &[]);
    let plan = session.run(&["plan", "out/scenario.yaml", "--format", "json"]);
    plan.says(0, &[]);
    let worst = largest(&plan.json(), "worst_error");
    assert!(worst > 0.0 && worst <= 0.001 + 1e-9, "{worst}");
}

/// Returns the largest number under a key, anywhere in a document.
fn largest(node: &serde_json::Value, key: &str) -> f64 {
    let inner = |value: &serde_json::Value| largest(value, key);
    match node {
        serde_json::Value::Array(items) => items.iter().map(inner).fold(0.0, f64::max),
        serde_json::Value::Object(entries) => {
            let own = entries.get(key).and_then(serde_json::Value::as_f64).unwrap_or(0.0);
            entries.values().map(inner).fold(own, f64::max)
        }
        _ => 0.0,
    }
}

#[test]
fn time_unit_is_read_from_header_or_requested() {
    let session = Session::new();
    let millis = ["Time [msec]", "time (ms)", "t_ms", "t/ms", "timeMs", "milliseconds"];
    for header in millis {
        session.file("log.csv", format!("{header},a\n0,1\n95750,2\n"));
        import(&session, &["csv", "log.csv", "--time", "1", "--map", "arm/a=a"]).says(0, &["at: 95750ms"]);
    }
    for header in ["t", "t [jiffies]", "sec.nsec"] {
        session.file("log.csv", format!("{header},a\n0,1\n2,2\n"));
        let args = ["csv", "log.csv", "--time", "1", "--map", "arm/a=a"];
        import(&session, &args)
            .says(1, &["DB0062", "log.csv:1:1", "the unit of the times is unknown", "--time-unit s"]);
        import(&session, &[&args[..], &["--time-unit", "min"]].concat()).says(0, &["at: 120s"]);
        import(&session, &[&args[..], &["--time-unit", "4fps"]].concat()).says(0, &["at: 500ms"]);
        import(&session, &[&args[..], &["--time-unit", "furlongs"]].concat()).says(2, &["hh:mm:ss"]);
    }
}

#[test]
fn imported_drone_show_passes_check() {
    let show = fixture("two_drones.skyc");
    check_round_trip(&["skybrush", &show], "no errors, 2 robots, 9 devices, ");
    import(&Session::new(), &["skybrush", &fixture("cheering.json")])
        .says(2, &["DB0001", "this is not a ZIP archive"]);
}

#[test]
fn motions_and_lights_from_other_tools_import_as_valid_scenarios() {
    check_round_trip(
        &["webots", &fixture("hand_high.motion")],
        "no errors, 1 robot, 3 devices, 18 steps, 6 s",
    );
    check_round_trip(&["bvh", &fixture("nod.bvh")], "no errors, 1 robot, 9 devices, 549 steps, 2 s");
    check_round_trip(&["midi", &fixture("beat.mid")], "no errors, 1 robot, 3 devices, 22 steps, 3.929 s");
    check_round_trip(&["mcap", &fixture("arm.mcap")], "no errors, 1 robot, 2 devices, 202 steps, 2 s");
    let star = fixture("star.fseq");
    check_round_trip(
        &["fseq", &star, "--map", "star/lamp=1,2,3"],
        "no errors, 1 robot, 1 device, 41 steps, 1 s",
    );
    import(&Session::new(), &["webots", &star, "--map", "a/b=c"])
        .says(2, &["--map applies only to csv and fseq"]);
}

#[test]
fn imported_urdf_becomes_robot_usable_in_scenario() {
    let session = Session::new();
    let urdf = fixture("06-flexible.urdf");
    import(&session, &["urdf", &urdf])
        .says(0, &["id: visual", "  - id: gripper_extension", "min_value: -0.38", "8 devices"]);
    import(&session, &["urdf", &urdf, "--kind", "r2d2", "--output", "out"])
        .says(0, &["wrote out/robots/r2d2.yaml"]);
    session.file("out/scenario.yaml", "scenario: s\nfleet: fleet.yaml\ncues:\n  - robots: r2d2\n    tracks: {gripper_extension: [{at: 0s, to: 0}, {at: 500ms, to: -0.3}]}\n");
    session.run(&["check", "out/scenario.yaml"]).says(1, &["0.6", "0.5"]);
    session.file("out/scenario.yaml", "scenario: s\nfleet: fleet.yaml\ncues:\n  - robots: r2d2\n    tracks: {gripper_extension: [{at: 0s, to: 0}, {at: 1s, to: -0.3}]}\n");
    session.run(&["check", "out/scenario.yaml"]).says(0, &["no errors"]);
    let json = import(&session, &["urdf", &urdf, "--format", "json"]).json();
    assert_eq!((&json["devices"], json["text"].is_string()), (&8.into(), true));
    import(&session, &["urdf", &urdf, &urdf]).says(2, &["one file at a time"]);
}

#[test]
fn imported_light_becomes_robot_usable_in_scenario() {
    let session = Session::new();
    let spot = fixture("spot.json");
    import(&session, &["fixture", &spot, "--mode", "18ch"]).says(
        0,
        &["id: stage-spot-150", "  - id: pan\n", "channel: [1, 2]", "min_value: -270", "13 devices"],
    );
    import(&session, &["fixture", &spot, "--mode", "Extended", "--kind", "spot", "--output", "out"])
        .says(0, &["wrote out/robots/spot.yaml"]);
    let scenario = |value: &str| {
        format!(
            "scenario: s\nfleet: fleet.yaml\ncues:\n  - robots: spot\n    tracks:\n      pan: [{{at: 0s, to: 0}}, {{at: 3s, to: {value}}}]\n      shutter: [{{at: 0s, to: 10}}]\n"
        )
    };
    session.file("out/scenario.yaml", scenario("271"));
    session.run(&["check", "out/scenario.yaml"]).says(1, &["DB0011", "-270 to 270"]);
    session.file("out/scenario.yaml", scenario("-270"));
    session.run(&["check", "out/scenario.yaml"]).says(0, &["no errors"]);
    let json = import(&session, &["fixture", &spot, "--mode", "6ch", "--format", "json"]).json();
    assert_eq!((&json["devices"], json["text"].is_string()), (&6.into(), true));
    import(&session, &["fixture", &spot, &spot]).says(2, &["fixture takes one file at a time"]);
    import(&session, &["urdf", &spot, "--mode", "6ch"]).says(2, &["--mode applies only to fixture"]);
}

#[test]
fn clock_times_are_accepted_only_if_unambiguous() {
    let session = Session::new();
    let args = ["csv", "log.csv", "--time", "t", "--map", "arm/a=a"];
    session.file("log.csv", "t,a\n00:00:000,1\n01:02:345,2\n");
    import(&session, &args).says(0, &["at: 62345ms"]);
    session.file("log.csv", "t,a\n00:00:00.000,1\n01:00:01.500,2\n");
    import(&session, &args).says(0, &["at: 3601500ms"]);
    session.file("log.csv", "t,a\n00:00:00,1\n00:01:30,2\n");
    import(&session, &args).says(1, &["DB0062", "hh:mm:ss or mm:ss:ms", "--time-unit"]);
    import(&session, &[&args[..], &["--time-unit", "mm:ss:ms"]].concat()).says(0, &["at: 1030ms"]);
    session.file("log.csv", "t,a\n00:00:00.5,1\n00:61:30.0,2\n");
    import(&session, &args).says(1, &["DB0061", "log.csv:3:1", "the time is `00:61:30.0`"]);
}

#[test]
fn each_csv_of_drone_show_becomes_robot_with_lamp() {
    let session = Session::new();
    std::fs::create_dir(session.path("show")).unwrap();
    for drone in [1, 2, 10] {
        let text = format!(
            "Time [msec],x [m],y [m],z [m],Red,Green,Blue\n0,{drone},0,0,0,0,0\n500,{drone},0,1,255,0,0\n1000,{drone},0,2,255,0,0\n1500,{drone},1,2,0,0,255\n"
        );
        session.file(&format!("show/Drone {drone}.csv"), text);
    }
    let maps = ["--map", "x=x", "--map", "y=y", "--map", "z=z", "--map", "lamp=Red,Green,Blue"];
    let args = [&["csv", "show", "--time", "Time"][..], &maps].concat();
    let ran = import(&session, &args);
    let all = [
        "imported 3 files as one robot each",
        "3 robots, 1 scene",
        "- cue: Drone 1\n",
        "- {at: 500ms, to: [255, 0, 0]}",
    ];
    ran.says(0, &all);
    ran.says(0, &["left out 1 line in which `lamp` of `Drone 2` does not change"]);
    assert!(ran.out().find("- cue: Drone 2\n") < ran.out().find("- cue: Drone 10\n"));
    assert!(!ran.out().contains("at: 1s, to: [255, 0, 0]"));
    import(&session, &[&args[..], &["--output", "out"]].concat()).says(0, &[]);
    session
        .run(&["check", "out/scenario.yaml"])
        .says(0, &["no errors, 3 robots, 12 devices, 45 steps, 1.5 s"]);
    import(&session, &[&args[..6], &["--map", "arm/y=y"]].concat())
        .says(2, &["name a robot in every --map, or in none"]);
}

#[test]
fn columns_are_mapped_by_pattern_and_ignored_columns_are_reported() {
    let session = Session::new();
    session.file("log.csv", "t [s],channel 1,channel 2,note\n0,1,350,5\n1,2,10,6\n");
    let args = ["csv", "log.csv", "--map", "arm/ch*=channel *", "--unwrap", "ch2=360", "--hold", "ch1"];
    import(&session, &args).says(
        0,
        &[
            "ch1:\n        - {at: 0s, to: 1, ease: step}",
            "ch2:\n        - {at: 0s, to: 350}\n        - {at: 1s, to: 370}",
            "ignored 1 column without a mapping: `note`",
            "`ch2` continues past 360: 1 turn",
        ],
    );
    import(&session, &["csv", "log.csv", "--map", "arm/ch*=canal *"])
        .says(1, &["DB0060", "no column `canal *`"]);
    import(&session, &["csv", "log.csv", "--map", "arm/ch*=note"]).says(1, &["DB0060", "no column `note`"]);
}

#[test]
fn lone_star_maps_remaining_columns_with_robots_from_their_names() {
    let session = Session::new();
    session.file(
        "show.csv",
        "Time [ms],a/x [m],a/Red,a/Green,a/Blue,b/x [m],b/lid.rx [deg]\n0,0,1,2,3,4,5\n500,1,2,3,4,5,6\n",
    );
    let args = ["csv", "show.csv", "--time", "Time [ms]", "--map", "*=*"];
    let lamp = ["--map", "*/lamp=*/Red,*/Green,*/Blue", "--output", "out"];
    import(&session, &[&args[..], &lamp].concat()).says(0, &["2 robots, 1 scene, 8 steps"]);
    let text = std::fs::read_to_string(session.path("out/scenario.yaml")).unwrap();
    assert!(text.contains("lamp:\n        - {at: 0s, to: [1, 2, 3]}"), "{text}");
    assert!(text.contains("lid.rx:\n        - {at: 0s, to: 5}"), "{text}");
    assert!(!text.contains("Red"), "{text}");
    session.run(&["check", "out/scenario.yaml"]).says(0, &["no errors, 2 robots, 4 devices"]);
}

#[test]
fn table_with_too_many_columns_has_only_that_finding() {
    let session = Session::new();
    let header: Vec<String> = (0..40_000).map(|index| format!("ch{index}")).collect();
    let row = vec!["1"; 40_000].join(",");
    session.file("wide.csv", format!("t [s],{}\n0,{row}\n1,{row}\n", header.join(",")));
    let ran = import(&session, &["csv", "wide.csv", "--map", "r/a*=ch*"]);
    ran.says(1, &["DB0068", "up to 40000 devices", "at most 10000 robots with up to 1000 devices each"]);
    assert!(!ran.text().contains("ignored"), "{}", ran.text());
    let ran = import(&session, &["csv", "wide.csv", "--map", "r/a*=chan*"]);
    assert!(!ran.text().contains("ignored"), "{}", ran.text());
}

#[test]
fn json_with_millions_of_short_values_is_rejected() {
    let text = |count: usize| format!("{{\"keyframes\": [{}1]}}", "1,".repeat(count));
    check(
        "bitbots",
        text(3_000_000),
        1,
        &["DB0068", "the file has too many values, separated by 3000000 commas", "at most 1000000 values"],
    );
    check("bitbots", text(10_000), 1, &["DB0003", "found the number 1"]);
}

#[test]
fn folders_become_acts_in_numerical_order_or_are_joined() {
    let session = Session::new();
    let sequence = fixture("sequence");
    let ran = import(&session, &["crazyswarm", &sequence]);
    ran.says(
        0,
        &["2 scenes for each of 2 robots, sorted by number", "  - act: scene 9\n    cues:\n      - cue: cf1"],
    );
    assert!(ran.out().find("act: scene 9") < ran.out().find("act: scene 18"));
    check_round_trip(&["crazyswarm", &sequence, "--join"], "2 robots, 8 devices");
}

#[test]
fn trajectory_with_more_pieces_than_robot_can_hold_is_reported() {
    let session = Session::new();
    let traj0 = fixture("traj0.csv");
    import(&session, &["crazyswarm", &traj0]).says(
        1,
        &[
            "DB0065",
            "traj0.csv:33:1",
            "has 32 pieces",
            "at most 31 pieces",
            "4 KB of memory for pieces of 132 bytes each",
        ],
    );
    import(&session, &["crazyswarm", &traj0, "--max-pieces", "32"])
        .says(0, &["note: ", "`x` jumps by 0.2943 m where two pieces meet"]);
}

#[test]
fn robots_may_have_missing_waypoints() {
    check_round_trip(&["waypoints", &fixture("waypoints.csv")], "3 robots, 9 devices, 24 steps, 4 s");
    let ran = import(&Session::new(), &["waypoints", &fixture("waypoints.csv")]);
    ran.says(0, &["`cf2` has 2 waypoints, but other robots have up to 3"]);
}

#[test]
fn humanoid_keyframes_are_held_for_pauses_and_missing_joints() {
    let cheering = fixture("cheering.json");
    check_round_trip(&["bitbots", &cheering], "1 robot, 20 devices, 240 steps, 12 s");
    let json = import(&Session::new(), &["bitbots", &cheering, "--format", "json"]).json();
    assert_eq!(
        (&json["steps"], &json["held"], &json["duration_ms"]),
        (&240.into(), &120.into(), &12_000.into())
    );
    assert!(json["notes"][0].as_str().unwrap().ends_with("cheering.json: held 6 pauses"));
    import(&Session::new(), &["bitbots", &fixture("turning_front_left.json")]).says(
        0,
        &[
            "joints missing from the first keyframe move to their first value from the start: `RShoulderPitch`, `RShoulderRoll`",
        ],
    );
}

#[test]
fn each_motion_in_file_becomes_scene() {
    let motions = fixture("tiago_motions_no-arm.yaml");
    check_round_trip(&["play-motion2", &motions, "--join"], "1 robot, 3 devices, 17 steps, 24 s");
    check_round_trip(&["play-motion2", &motions, "--only", "head_tour"], "2 devices, 16 steps, 21 s");
    import(&Session::new(), &["play-motion2", &motions, "--only", "head_tuor"])
        .says(1, &["DB0067", "no scene `head_tuor`", "did you mean `head_tour`?"]);
}

#[test]
fn joint_trajectory_velocities_define_cubic_curves() {
    let session = Session::new();
    let yaml = "joint_names: [elbow]\npoints:\n- {positions: [0], velocities: [0], time_from_start: 0}\n- {positions: [1], velocities: [0], time_from_start: {sec: 1, nanosec: 0}}\n";
    session.file("move.yaml", yaml);
    let straight = import(&session, &["joint-trajectory", "move.yaml"]);
    straight.says(
        0,
        &[
            "the path between points is a cubic curve through their positions and velocities",
            "the robot must be at this point before the start",
        ],
    );
    straight.says(0, &["polynomial:\n          - {for: 1s, coefficients: [0, 0, 3, -2]}"]);
    session
        .file("late.yaml", yaml.replace("time_from_start: 0}", "time_from_start: 0.5, accelerations: [1]}"));
    let late = import(&session, &["joint-trajectory", "late.yaml"]);
    late.says(0, &["velocities are ignored", "ignored accelerations and efforts of 1 point"]);
    let curved = import(&session, &["joint-trajectory", "move.yaml", "--rate", "4"]);
    curved.says(0, &["- {at: 250ms, to: 0.15625}", "- {at: 500ms, to: 0.5}", "- {at: 750ms, to: 0.84375}"]);
    session.file("move.json", "{\"joint_names\": [\"elbow\"], \"points\": [{\"positions\": [0.5], \"time_from_start\": {\"secs\": 1, \"nsecs\": 500000000}}]}");
    import(&session, &["joint-trajectory", "move.json"]).says(0, &["- {at: 1500ms, to: 0.5}"]);
}

#[test]
fn any_csv_can_be_read_through_column_map() {
    let session = Session::new();
    session.file("log.csv", "ms;elbow[rad];x\n0;0.5;1\n100;;2\n200;1.5;3\n");
    let args = ["csv", "log.csv", "--time", "ms", "--map", "arm/elbow=elbow", "--map", "arm/x=3"];
    let scaled = ["--scale", "x=0.001", "--scale", "elbow=2"];
    import(&session, &[&args[..], &scaled].concat()).says(
        0,
        &[
            "`elbow` of `arm` moves straight through 1 empty cell",
            "{at: 200ms, to: 3}",
            "{at: 200ms, to: 0.003}",
        ],
    );
    import(&session, &["csv", "log.csv", "--time", "sm", "--map", "arm/x=x"])
        .says(1, &["DB0060", "log.csv:1:1", "no column `sm`", "did you mean `ms`?"]);
    import(&session, &["csv", "log.csv"]).says(2, &["add --map"]);
}

#[test]
fn duplicate_and_decreasing_times_are_reported() {
    // The times of moveit's issue 3583.
    let times = ["0", "0.076080427", "0.207295897", "0.331884750", "0.372734245", "0.372734245"];
    let points: String =
        times.iter().map(|t| format!("- {{positions: [1], time_from_start: {t}}}\n")).collect();
    let text = format!("joint_names: [a]\npoints:\n{points}");
    check("joint-trajectory", text, 1, &["DB0063", "test.csv:8:37", "point 6: duplicate time 0.372734245 s"]);
    check_csv("t,a\n0.3727,1\n0.37270,2\n", &["DB0063", "test.csv:3:1", "duplicate time 0.3727 s"]);
    check_csv(
        "t,a\n2,1\n1,2\n",
        &["DB0062", "test.csv:3:1", "the time 1 s is earlier than the previous time, 2 s"],
    );
    let still = r#"{"keyframes": [{"duration": 0, "pause": 0, "goals": {"a": 1}}]}"#;
    check("bitbots", still, 1, &["DB0063", "test.csv:1:29", "keyframe 1 has a duration of 0"]);
}

#[test]
fn all_errors_in_a_table_are_reported_at_once() {
    let text = "id,x[m],y[m],z[m],t[s]\n1,0,nan,1,0\n1,0,1\n1,zero,1,1,2\n1,inf,1,1,-3\n";
    let parts = [
        "DB0061",
        "test.csv:2:5",
        "`y` is NaN",
        "DB0060",
        "test.csv:3:6",
        "line 3 has 3 columns, not 5",
        "test.csv:4:3",
        "`x` is the text `zero`",
        "`x` is inf",
        "DB0062",
        "the time is -3 s",
        "5 errors",
    ];
    check("waypoints", text, 1, &parts);
    check(
        "waypoints",
        "id,x[m],y[m],z[K],t[s]\n",
        1,
        &["DB0060", "test.csv:1:14", "column 4 of the header is `z[K]`"],
    );
    check("crazyswarm", "a,b\n1,2\n", 1, &["DB0060", "test.csv:1:1", "expected `duration`"]);
    check("crazyswarm", [0u8, 159, 146, 150], 2, &["DB0001", "not a text file"]);
    for format in ["crazyswarm", "waypoints"] {
        check(format, "", 1, &["DB0060", "the file is empty"]);
    }
    for format in ["joint-trajectory", "play-motion2", "bitbots"] {
        check(format, "", 1, &["DB0002", "the file is empty", "docs/import.md"]);
    }
    let junk = format!("id,x[m],y[m],z[m],t[s]\n{}", "a\n".repeat(5_000));
    check("waypoints", junk, 1, &["more than 100 findings", "101 errors"]);
}

#[test]
fn errors_in_yaml_and_json_are_reported_with_line_numbers() {
    let lists =
        "motions:\n  up:\n    joints: [a, b]\n    positions: [1, 2, 3]\n    times_from_start: [1, 2]\n";
    check(
        "play-motion2",
        lists,
        1,
        &["DB0066", "test.csv:4:16", "3 positions for 2 joints at 2 times", "2 x 2 = 4"],
    );
    let tags = "joint_names: !!python/tuple [a]\npoints: [{positions: [!degrees 90], time_from_start: 1}]\n";
    check(
        "joint-trajectory",
        tags,
        1,
        &["DB0064", "test.csv:1:14", "`!python/tuple`", "`!degrees`", "2 errors"],
    );
    let infinite = "joint_names: [a]\npoints: [{positions: [.inf], time_from_start: 1}]\n";
    check("joint-trajectory", infinite, 1, &["DB0061", "test.csv:2:23", "a finite number"]);
    check("bitbots", "{\"keyframes\": [{\"goals\": {}}]}", 1, &["DB0006", "keyframe 1 has no `duration`"]);
}

#[test]
fn devices_missing_on_robot_are_reported() {
    let session = Session::new();
    session.file("log.csv", "t[s],a\n0,1\n1,2\n");
    import(&session, &["csv", "log.csv", "--map", "left/sholder=a", "--init", "arm.yaml"])
        .says(1, &["DB0009", "`arm` has no device `sholder`", "did you mean `shoulder`?"]);
    import(
        &session,
        &["csv", "log.csv", "--map", "left/shoulder=a", "--init", "arm.yaml", "--output", "out"],
    )
    .says(0, &["the unit of `shoulder` is unknown, so deg is assumed"]);
    assert_eq!(std::fs::read_to_string(session.path("out/robots/arm.yaml")).unwrap(), stage::session::ARM);
    session.run(&["check", "out/scenario.yaml"]).says(0, &["1 robot, 1 device, 2 steps, 1 s"]);
    import(&session, &["csv", "log.csv", "--map", "left/shoulder=a", "--init", "none.yaml"])
        .says(2, &["DB0001"]);
}

#[test]
fn import_with_off_grid_values_requests_snapping() {
    let session = Session::new();
    session.file("log.csv", "t[s],a\n0,1\n1,2.25\n");
    let args = ["csv", "log.csv", "--map", "left/shoulder=a"];
    import(&session, &[&args[..], &["--init", "arm.yaml"]].concat()).says(0, &["\noff_grid: snap"]);
    assert!(!import(&session, &args).out().contains("off_grid"));
}

#[test]
fn existing_files_are_not_overwritten_without_force() {
    let session = Session::new();
    let swap = fixture("swap");
    let args = ["crazyswarm", swap.as_str(), "--output", "out"];
    import(&session, &args).says(0, &[]);
    session.file("out/fleet.yaml", "mine");
    import(&session, &args).says(2, &["DB0069", "out/scenario.yaml", "out/fleet.yaml", "--force"]);
    assert_eq!(std::fs::read_to_string(session.path("out/fleet.yaml")).unwrap(), "mine");
    import(&session, &[&args[..], &["--force"]].concat()).says(0, &[]);
    assert!(std::fs::read_to_string(session.path("out/fleet.yaml")).unwrap().contains("cf1"));
    let left = std::fs::read_dir(session.path("out")).unwrap().count();
    assert_eq!(left, 3, "no temporary files stay");
    session.file("blocked", "");
    import(&session, &["crazyswarm", &swap, "--output", "blocked"]).says(2, &["DB0001", "cannot write"]);
}

#[test]
fn imports_beyond_size_limits_are_rejected() {
    let session = Session::new();
    let long = std::fs::read_to_string(fixture("swap/pp1.csv")).unwrap().replacen("0.250000", "9000000", 1);
    session.file("long.csv", long);
    import(&session, &["crazyswarm", "long.csv", "--rate", "1000"])
        .says(1, &["DB0068", "at most 2000000 keyframes"]);
    std::fs::File::create(session.path("huge.csv")).unwrap().set_len(200_000_000).unwrap();
    let line = format!("ulimit -v 204800; exec {} import waypoints huge.csv", program());
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", &line]).current_dir(session.path(""));
    Ran(shell.output().unwrap()).says(2, &["DB0001", "200000000 bytes, but the limit is 67108864"]);
}

#[test]
fn wrong_usage_is_reported() {
    let session = Session::new();
    import(&session, &["crazyswarm"]).says(2, &["Usage"]);
    import(&session, &["skyblush", "x"]).says(2, &["crazyswarm", "waypoints", "csv"]);
    import(&session, &["crazyswarm", "none.csv"]).says(2, &["DB0001", "none.csv"]);
    import(&session, &["crazyswarm", "none.csv", "--rate", "0"]).says(2, &["0.001 to 1000 Hz"]);
    import(&session, &["waypoints", &fixture("waypoints.csv"), "--robots", "a,b"])
        .says(1, &["DB0067", "2 names for 3 robots"]);
    import(&session, &["--help"]).says(0, &["Examples:", "downbeat import crazyswarm pp*.csv"]);
}

/// Returns the waypoints of two drones that fly towards each other until `gap` meters separate them.
fn two_routes(gap: f64) -> String {
    format!("id,x[m],y[m],z[m],t[s]\n1,0,0,1,0\n1,1,0,1,4\n2,{0},0,1,0\n2,{1},0,1,4\n", 2.0, 1.0 + gap)
}

#[test]
fn drones_too_close_to_each_other_are_reported_after_import() {
    let session = Session::new();
    session.file("near.csv", two_routes(0.22));
    import(&session, &["waypoints", "near.csv", "--output", "near"]).says(0, &[]);
    session.run(&["check", "near/scenario.yaml"]).says(1, &["DB0052", "0.220 m", "4 s"]);
    session.file("far.csv", two_routes(0.25));
    import(&session, &["waypoints", "far.csv", "--output", "far"]).says(0, &[]);
    session.run(&["check", "far/scenario.yaml"]).says(0, &["no errors, 2 robots"]);
    let fleet = std::fs::read_to_string(session.path("far/fleet.yaml")).unwrap();
    session.file("far/fleet.yaml", fleet.replace("{distance: 0.24}", "{distance: 0.3}"));
    session.run(&["check", "far/scenario.yaml"]).says(1, &["DB0052", "0.250 m"]);
    // The unit of the axes comes from the robot's own block.
    session.file(
        "robot.yaml",
        std::fs::read_to_string(session.path("far/robots/crazyflie.yaml"))
            .unwrap()
            .replace("unit: m", "unit: cm"),
    );
    import(&session, &["waypoints", "near.csv", "--init", "robot.yaml", "--output", "own"])
        .says(0, &["from m to cm"]);
    let fleet = std::fs::read_to_string(session.path("own/fleet.yaml")).unwrap();
    assert!(fleet.contains("body: {x: x, y: y, z: z}"), "{fleet}");
}

#[test]
fn printed_ros_messages_are_imported_as_scenes() {
    let session = Session::new();
    let message = |position: f64, time: u32| {
        format!(
            "header:\n  frame_id: ''\njoint_names:\n- elbow\npoints:\n- positions:\n  - {position}\n  velocities: []\n  time_from_start:\n    sec: {time}\n    nanosec: 5\n---\n"
        )
    };
    session.file("one.yaml", message(0.5, 1));
    import(&session, &["joint-trajectory", "one.yaml"]).says(0, &["cues:\n", "at: 1.000000005s, to: 0.5"]);
    session.file("two.yaml", message(0.5, 1) + &message(0.75, 2));
    import(&session, &["joint-trajectory", "two.yaml"]).says(
        0,
        &[
            "2 messages, imported as one scene each",
            "- act: message 1",
            "- act: message 2",
            "at: 2.000000005s, to: 0.75",
        ],
    );
    session.file("cut.yaml", message(0.5, 1) + &message(0.75, 2).replace("- 0.75", "- 0.75\n  - '...'"));
    import(&session, &["joint-trajectory", "cut.yaml"])
        .says(1, &["DB0061", "cut.yaml:20:5", "--full-length"]);
    session.file("states.yaml", "header:\n  frame_id: ''\nname:\n- elbow\nposition:\n- 0.5\n---\n".repeat(3));
    import(&session, &["joint-trajectory", "states.yaml"]).says(
        1,
        &["DB0006", "this is a joint state message, not a joint trajectory", "ros2 bag record", "1 error"],
    );
}

#[test]
fn files_with_equal_names_are_distinguished_by_folder() {
    let session = Session::new();
    let bytes = std::fs::read(fixture("star.fseq")).unwrap();
    for folder in ["left", "right"] {
        std::fs::create_dir(session.path(folder)).unwrap();
        session.file(&format!("{folder}/show.fseq"), &bytes);
        session.file(&format!("{folder}/one.csv"), "t [s],a\n0,1\n1,2\n");
        session.file(&format!("{folder}/two.csv"), "t [s],a\n0,3\n1,4\n");
    }
    let files = ["fseq", "left/show.fseq", "right/show.fseq"];
    let ran = import(&session, &[&files[..], &["--map", "star/dim=1"]].concat());
    ran.says(0, &["1 robot, 2 scenes", "- act: left\n", "- act: right\n"]);
    let ran = import(&session, &[&files[..], &["--map", "dim=1"]].concat());
    ran.says(0, &["2 robots, 1 scene", "named after their folders", "robots: left\n", "robots: right\n"]);
    let ran = import(&session, &["csv", "left", "right", "--map", "a=a"]);
    ran.says(0, &["2 robots, 2 scenes", "- act: left\n", "robots: one\n", "robots: two\n"]);
    import(&session, &["fseq", "left/show.fseq", "left/show.fseq", "--map", "star/dim=1"])
        .says(1, &["DB0067", "two files move the robot `star`"]);
}
