//! What `downbeat check` reports for wrong input: place, cause, expected input, and fix.

use stage::session::Session;

/// Returns a scenario with one keyframe track, whose keyframes are `keyframes`.
fn scenario(keyframes: &str) -> String {
    format!("scenario: test\ncues:\n  - at: 0s\n    robots: arms\n    tracks:\n      shoulder:\n{keyframes}")
}

#[track_caller]
fn check(yaml: impl AsRef<[u8]>, code: i32, parts: &[&str]) {
    let session = Session::new();
    session.file("test.yaml", yaml);
    session.run(&["check", "test.yaml"]).says(code, parts);
}

#[test]
fn valid_scenario_passes_with_summary() {
    check(
        scenario("        - {at: 0s, to: 45}\n        - {at: 1s, to: 0}\n"),
        0,
        &["no errors, 2 robots, 2 devices, 4 steps, 1 s"],
    );
}

#[test]
fn cue_without_robots_is_reported() {
    let yaml = scenario("        - {at: 0s, to: 45}\n").replace("robots: arms", "robots: []");
    check(yaml, 1, &["DB0016", "the list of robots is empty"]);
}

#[test]
fn all_findings_are_reported_at_once_in_file_order() {
    let session = Session::new();
    let yaml = "scenario: test\nled: 2s\ncues:\n  - at: soon\n    robots: nobody\n    tracks: {elbow: [{at: 0s, to: x}]}\n  - at: 1s\n    robots: left\n    tracks: {elbow: [{at: 0s, to: 1}]}\n";
    session.file("test.yaml", yaml);
    let json = session.run(&["check", "test.yaml", "--format", "json"]).json();
    let findings: Vec<_> = json["findings"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| (f["code"].as_str().unwrap().to_owned(), f["line"].as_u64().unwrap()))
        .collect();
    let expected = [("DB0004", 2), ("DB0007", 4), ("DB0008", 5), ("DB0003", 6), ("DB0009", 9)];
    assert_eq!(findings, expected.map(|(code, line)| (code.to_owned(), line)));
}

#[test]
fn fleet_file_errors_are_reported_with_their_lines() {
    let session = Session::new();
    session.file("test.yaml", scenario("        - {at: 0s, to: 45}\n"));
    session.file("fleet.yaml", "robots:\n  left: {init: missing.yaml, address: sim}\n  right: {init: arm.yaml, address: 'udp://x'}\ngroups:\n  left: [right]\n  all: [middle]\n");
    session.run(&["check", "test.yaml"]).says(
        2,
        &[
            "DB0001",
            "fleet.yaml:2:16",
            "DB0020",
            "`udp://x` is not an address",
            "DB0019",
            "DB0008",
            "no robot or group `middle` in the fleet",
        ],
    );
}

#[test]
fn invalid_initialization_block_is_reported_in_its_own_file() {
    let session = Session::new();
    session.file("test.yaml", scenario("        - {at: 0s, to: 45}\n"));
    session.file("arm.yaml", stage::session::ARM.replace("granularity: 0.5}", "granularity: 0}"));
    session
        .run(&["check", "test.yaml"])
        .says(1, &["DB0018", "arm.yaml:", "granularity 0, for `position` of the device `shoulder`"]);
}

/// Runs `check` with an address space of 200 MB.
#[track_caller]
fn check_in_little_memory(session: &Session, code: i32, parts: &[&str]) {
    check_in_memory(session, 204_800, code, parts);
}

#[track_caller]
fn check_in_memory(session: &Session, kilobytes: u32, code: i32, parts: &[&str]) {
    let line = format!("ulimit -v {kilobytes}; exec {} check test.yaml", stage::session::program());
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", &line]).current_dir(session.path(""));
    stage::session::Ran(shell.output().unwrap()).says(code, parts);
}

#[test]
fn hostile_files_are_reported_clearly_in_little_memory() {
    let session = Session::new();
    session.file("test.yaml", "");
    check_in_little_memory(&session, 1, &["DB0002", "the file is empty"]);

    let mut bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n".to_owned();
    for level in 1..10 {
        let aliases = vec![format!("*a{}", level - 1); 9].join(", ");
        bomb.push_str(&format!("a{level}: &a{level} [{aliases}]\n"));
    }
    session.file("test.yaml", bomb);
    check_in_little_memory(
        &session,
        1,
        &["DB0045", "the aliases up to here expand to more than 250000 values", "test.yaml:6:"],
    );

    session.file("test.yaml", "[".repeat(10_000));
    check_in_little_memory(&session, 1, &["DB0002", "recursion limit"]);

    session.file("test.yaml", [0u8, 159, 146, 150, 255, 0, 7]);
    check_in_little_memory(&session, 2, &["DB0001", "not a text file"]);

    std::fs::File::create(session.path("test.yaml")).unwrap().set_len(200_000_000).unwrap();
    check_in_little_memory(&session, 2, &["DB0001", "200000000 bytes, but the limit is 67108864"]);

    session.file("test.yaml", "scenario: a\n---\nscenario: b\n");
    check_in_little_memory(&session, 1, &["DB0002", "more than one document"]);

    session.file("test.yaml", "cues: !!python/tuple [1, 2]\nscenario: x\n");
    check_in_little_memory(&session, 1, &["DB00"]);
}

#[test]
fn short_text_that_expands_enormously_is_rejected_in_bounded_memory() {
    let session = Session::new();
    let kilobytes = 1_500_000;
    let repeated = |times: u32, keyframes: &str| {
        let yaml = scenario(keyframes).replace("robots: arms", &format!("robots: arms\n    repeat: {times}"));
        session.file("test.yaml", yaml);
    };
    repeated(
        7_000_000,
        "        - {at: 0s, to: 0}\n        - {at: 1ms, to: 1}\n        - {at: 2ms, to: 0}\n",
    );
    check_in_memory(
        &session,
        kilobytes,
        1,
        &["DB0045", "7000000 repetitions add 13999998 keyframes", "at most 10000000 across all cues"],
    );
    repeated(
        4_900_000,
        "        - {at: 0s, to: 0}\n        - {at: 1ms, to: 1}\n        - {at: 2ms, to: 0}\n",
    );
    check_in_memory(&session, kilobytes, 1, &["DB0013", "more than 1000000 steps", "at most 8 steps"]);
    let wave =
        "        tolerance: 0.5\n        wave: {amplitude: 45, center: 45, frequency: 1000, for: 10s}\n";
    repeated(1_000, wave);
    check_in_memory(&session, kilobytes, 1, &["DB0013", "at most 8 steps"]);

    let keyframes: Vec<_> = (0..2_000).map(|i| format!("{{at: {i}ms, to: {}}}", i % 3)).collect();
    let cues = "  - {at: 0s, robots: left, move: m}\n".repeat(10_000);
    let keyframes = keyframes.join(", ");
    session.file(
        "test.yaml",
        format!("scenario: test\nmoves: {{m: {{tracks: {{shoulder: [{keyframes}]}}}}}}\ncues:\n{cues}"),
    );
    check_in_memory(&session, kilobytes, 1, &["DB0045", "with this movement", "test.yaml:5004:"]);
}

#[test]
fn missing_files_are_named() {
    let session = Session::new();
    session.run(&["check", "nowhere.yaml"]).says(2, &["DB0001", "nowhere.yaml"]);
    session.file("test.yaml", scenario("        - {at: 0s, to: 45}\n"));
    session.run(&["check", "test.yaml", "--fleet", "none.yaml"]).says(2, &["DB0001", "none.yaml", "--fleet"]);
    session.run(&["check"]).says(2, &["Usage"]);
}

#[test]
fn times_beyond_message_limits_are_reported_at_their_source() {
    let track = "tracks: {shoulder: [{at: 0s, to: 0}, {at: 1s, to: 45}]}";
    let cue = |keys: &str| format!("scenario: test\ncues:\n  - {{cue: a, at: 0s, robots: arms, {keys}}}\n");
    let found = |keys: &str, parts: &[&str]| {
        check(cue(&format!("{keys}, {track}")), 1, &[&["DB0045", "1 error,"], parts].concat());
    };
    found(
        "canon: 99999000s",
        &[
            "test.yaml:3:43",
            "the last of 2 robots starts 99999000 s",
            "at most 99996400 s",
            "use a canon of at most 99996400 s",
        ],
    );
    found("duration: 99999999s", &["test.yaml:3:5", "ends at 99999999 s", "reduce `duration`"]);
    found("overrides: {left: {delay: 99999999s}}", &["test.yaml:3:5", "ends at 100000000 s"]);
    check(
        cue("repeat: 4000000, tracks: {shoulder: [{at: 0s, to: 0}, {at: 1m, to: 0}]}"),
        1,
        &["DB0045", "4000000 repetitions of a movement of 60 s last 240000000 s", "at most 100000000 s"],
    );
    check(
        cue(
            "tracks: {shoulder: {polynomial: [{for: 60000000s, coefficients: [0]}, {for: 60000000s, coefficients: [0]}]}}",
        ),
        1,
        &["DB0045", "the movement lasts 120000000 s", "split it into several movements"],
    );
    check(
        format!("{}  - {{at: 99999000s, robots: left, {track}}}\n", cue(track)),
        1,
        &[
            "DB0045",
            "test.yaml:4:5",
            "the cue `cue 2` starts at 99999000 s",
            "shorten the cues and pauses before it",
        ],
    );
    check(
        format!("{}tempo: 1\nsignature: 255/4\n", cue(track))
            .replace("at: 0s, robots", "at: bar 1000000, robots"),
        1,
        &["DB0007", "`bar 1000000` is too long", "at most 100000000 s"],
    );
    check(format!("lead: 99999999s\n{}", cue(track)), 1, &["DB0045", "test.yaml:1:7", "at most 10000000 s"]);
    let many: String = (0..200)
        .map(|i| {
            format!("  - {{cue: c{i}, after: c{}, robots: left, duration: 99999999s, {track}}}\n", i - 1)
        })
        .collect();
    check(
        format!("scenario: test\ncues:\n{}", many.replace("after: c-1", "at: 0s")),
        1,
        &["DB0045", "the cue `c0` starts at 0 ms and ends at 99999999 s", "1 error,"],
    );
    let shared: String = (0..200)
        .map(|i| format!("  - {{cue: c{i}, uses: z, robots: left, duration: 90000000s, {track}}}\n"))
        .collect();
    check(
        format!("scenario: test\nzones: {{z: auto}}\ncues:\n{shared}"),
        1,
        &["DB0045", "add up to more than the automatic ordering supports", "1 error,"],
    );
}

#[test]
fn suggestions_are_limited_for_ten_thousand_wrong_names() {
    let session = Session::new();
    let all = |line: &dyn Fn(usize) -> String| (0..10_000).map(line).collect::<String>();
    let robots = all(&|i| format!("  robot-{i:05}: {{init: arm.yaml, address: sim}}\n"));
    session.file("fleet.yaml", format!("robots:\n{robots}"));
    let tracks = "tracks: {shoulder: [{at: 0s, to: 0}]}";
    let names = [
        ("DB0008", all(&|i| format!("  - {{at: 0s, robots: robto-{i:05}, {tracks}}}\n")), String::new()),
        (
            "DB0022",
            all(&|i| format!("  - {{cue: c{i:05}, after: d{i:05}, robots: robot-{i:05}, {tracks}}}\n")),
            String::new(),
        ),
        (
            "DB0023",
            all(&|i| format!("  - {{at: 0s, robots: robot-{i:05}, move: mvoe{i:05}}}\n")),
            format!("moves:\n{}", all(&|i| format!("  move{i:05}: {{{tracks}}}\n"))),
        ),
        (
            "DB0024",
            all(&|i| format!("  - {{at: $vra{i:05}, robots: robot-{i:05}, {tracks}}}\n")),
            format!("variables:\n{}", all(&|i| format!("  var{i:05}: 1\n"))),
        ),
    ];
    for (code, cues, library) in names {
        session.file("test.yaml", format!("scenario: test\n{library}cues:\n{cues}"));
        let ran = session.run(&["check", "test.yaml"]);
        ran.says(
            1,
            &[code, "00 errors,", "did you mean", "(at most 1000 findings of this severity are shown)"],
        );
        // Comparing every name with every other one would take 20 s.
        let hints = ran.text().matches("did you mean").count();
        assert!(hints <= 200, "{code}: {hints} hints");
    }
}

#[test]
fn many_findings_on_one_long_line_use_bounded_memory() {
    let session = Session::new();
    let cue = |i: usize| {
        format!(
            "{{at: 0s, robots: nobody-{i:05}, tracks: {{shoulder: [{{at: 0s, to: 0}}, {{at: 1s, to: 0}}]}}}}"
        )
    };
    let cues: Vec<_> = (0..10_000).map(cue).collect();
    session.file("test.yaml", format!("scenario: test\ncues: [{}]\n", cues.join(", ")));
    check_in_memory(
        &session,
        500_000,
        1,
        &["1000 errors,", "test.yaml:2:8", "(at most 1000 findings of this severity are shown)"],
    );
}

#[test]
fn many_acts_with_many_zones_and_rules_use_bounded_memory() {
    let session = Session::new();
    let zones: Vec<_> = (0..5_000).map(|i| format!("z{i}")).collect();
    let rules: Vec<_> = (0..5_000).map(|i| format!("r{i}: stop")).collect();
    let fleet: String = (0..5_000).map(|i| format!("  r{i}: {{init: arm.yaml, address: sim}}\n")).collect();
    session.file("fleet.yaml", format!("robots:\n{fleet}"));
    let act = |i: usize| {
        format!(
            "  - {{act: a{i}, cues: [{{at: 0s, robots: r{i}, tracks: {{shoulder: [{{at: 0s, to: 0}}, {{at: 1s, to: 0}}]}}}}]}}\n"
        )
    };
    let acts: String = (0..2_000).map(act).collect();
    let (zones, rules) = (zones.join(", "), rules.join(", "));
    let yaml = format!("scenario: test\nzones: [{zones}]\non_failure: {{{rules}}}\nacts:\n{acts}");
    session.file("test.yaml", yaml);
    check_in_memory(
        &session,
        1_500_000,
        1,
        &["DB0045", "brings the number of failure rules for robots above the maximum", "1 error,"],
    );
}

#[test]
fn many_robots_under_one_zenoh_prefix_cause_a_warning() {
    let session = Session::new();
    let robot =
        |i: usize, place: usize| format!("  r{i}: {{init: arm.yaml, address: 'zenoh:hall/{place}/r{i}'}}\n");
    let fleet = |robots: usize, places: usize| {
        format!("robots:\n{}", (0..robots).map(|i| robot(i, i % places)).collect::<String>())
    };
    let scenario = "scenario: s\ncues: [{at: 0s, robots: r7, tracks: {shoulder: [{at: 0s, to: 45}]}}]\n";
    session.file("s.yaml", scenario).file("fleet.yaml", fleet(1_001, 1));
    let says = [
        "DB0080",
        "fleet.yaml:1002:",
        "1001 robots have keys directly below `zenoh:hall/0/...`",
        "`zenoh:hall/0/row-1/r1000`",
    ];
    session.run(&["check", "s.yaml"]).says(0, &says);
    for (robots, places) in [(1_000, 1), (1_001, 2)] {
        session.file("fleet.yaml", fleet(robots, places));
        let ran = session.run(&["check", "s.yaml"]);
        assert!(ran.code() == 0 && !ran.text().contains("DB0080"), "{}", ran.text());
    }
}

#[test]
fn device_without_script_support_is_reported_with_required_declaration() {
    let session = Session::new();
    let init = "{id: r, api_version: '1', devices: [{id: d, name: d, available_control_types: {position: {min_value: 0, max_value: 9, \
                granularity: 1}}}]}";
    let scenario = "scenario: s\ncues: [{at: 0s, robots: r, tracks: {d: [{at: 0s, to: 5}]}}]\n";
    session
        .file("r.yaml", init)
        .file("fleet.yaml", "robots: {r: {init: r.yaml, address: sim}}\n")
        .file("s.yaml", scenario);
    let ran = session.run(&["check", "s.yaml"]);
    ran.says(
        1,
        &[
            "DB0010",
            "device `d` of `r` does not support scripts",
            "expected a device that supports scripts\n",
        ],
    );
    ran.says(1, &["help: if it supports scripts, declare `script` under its `available_control_types`"]);
}
