use urrcp::{ControlType, Interpolation, RobotType};

use super::*;

const TANK: &str = include_str!("tank.json");

fn source(text: &str) -> Source {
    Source { name: "tank.json".into(), text: text.into() }
}

#[track_caller]
fn check_finding(text: &str, says: &str, line: usize) {
    let findings = init_of(&source(text)).unwrap_err();
    let found = findings.iter().any(|finding| finding.message.contains(says) && finding.line == line);
    assert!(found, "`{says}` at line {line} is missing in {findings:#?}");
}

#[test]
fn thrift_robot_description_becomes_a_block_that_accepts_scripts() {
    let block = init_of(&source(TANK)).unwrap();
    assert_eq!((block.id.as_str(), block.robot_type), ("tank-1", Some(RobotType::Transport)));
    let left = block.device("left").unwrap();
    assert_eq!((left.default_value, left.interpolation), (Some(0.0), Interpolation::Hold));
    let limits = left.available_control_types.limits(ControlType::Position).unwrap();
    assert_eq!((limits.min_value, limits.max_value, limits.granularity), (-100.0, 100.0, 0.1));
    assert_eq!(left.available_control_types.script().unwrap().max_number_of_steps, 1_000);
    let battery = block.device("battery").unwrap().available_control_types.sensor().unwrap();
    assert_eq!((battery.min_value, battery.max_value), (0.0, 14.0));
}

#[test]
fn block_written_as_init_file_is_read_back_unchanged() {
    let block = init_of(&source(TANK)).unwrap();
    assert_eq!(init_of(&source(&init_text(&block))).unwrap(), block);
}

#[test]
fn faults_of_a_description_are_reported_with_their_lines() {
    check_finding(&TANK.replace("\"id\": \"tank-1\",", ""), "has no `id`", 1);
    check_finding(
        &TANK.replace(
            "set_device_double_value\", \"default_value\": 0, \"min_value\": -100",
            "spin\", \"min_value\": -100",
        ),
        "unknown call `spin`",
        11,
    );
    check_finding(
        &TANK.replace("\"min_value\": 0, \"max_value\": 14", "\"min_value\": 0"),
        "`battery` has no `max_value`",
        17,
    );
    check_finding(
        &TANK.replace("\"default_value\": 0", "\"default_value\": 400"),
        "the `default_value` of `left` is outside the range from -100 to 100",
        9,
    );
    check_finding(&TANK.replace("\"max_value\": 100", "\"max_value\": \"much\""), "`much`", 11);
    check_finding("{\"id\": \"a\", \"api_version\": \"1\", \"devices\": {}}", "device", 1);
}

#[test]
fn device_without_room_for_command_or_step_is_reported_at_its_key() {
    let block = |queue: u32, steps: u32| {
        format!(
            "id: r\napi_version: \"1\"\ndevices:\n- id: d\n  default_value: 0\n  script_queue: {queue}\n  available_control_types:\n    \
             position: {{min_value: 0, max_value: 9, granularity: 1}}\n    script:\n      max_number_of_steps: {steps}\n"
        )
    };
    assert!(init_of(&source(&block(1, 1))).is_ok());
    for (text, found, line) in [
        (block(0, 1), "script_queue is 0, for the device `d`", 6),
        (block(1, 0), "max_number_of_steps is 0, for `script` of the device `d`", 10),
    ] {
        let findings = init_of(&source(&text)).unwrap_err();
        let [finding] = findings.as_slice() else { panic!("{findings:#?}") };
        assert_eq!((finding.message.as_ref(), finding.line), (found, line));
        assert_eq!(finding.expected, "at least 1");
    }
}

#[test]
fn default_granularity_is_power_of_ten_with_at_least_1000_steps() {
    let block = |range: &str| {
        init_of(&source(&format!("{{id: a, api_version: 1, devices: {{d: {{{range}}}}}}}"))).unwrap()
    };
    for (range, expected) in [
        ("min_value: 0, max_value: 1", 0.001),
        ("min_value: 0, max_value: 180", 0.1),
        ("min_value: -32768, max_value: 32767", 10.0),
        ("min_value: 5, max_value: 5", 0.001),
    ] {
        let block = block(range);
        let limits = block.devices[0].available_control_types.limits(ControlType::Position).unwrap();
        assert!((limits.granularity - expected).abs() < 1e-12, "{range}: {}", limits.granularity);
    }
}

const SHORT: &str = "id: r
api_version: \"1\"
devices:
  - id: arm
    name: arm
    available_control_types:
      position: {min_value: -90, max_value: 90, granularity: 0.5, max_error: 0.25}
      script: {max_number_of_steps: 8}
  - id: leg
    name: leg
    available_control_types:
      position: {min_value: 0, max_value: 45, granularity: 1}
      speed: {min_value: -9, max_value: 9, granularity: 1}
      script: {max_number_of_steps: 8, control_types: [speed], granularity: 3}
";

#[test]
fn script_inherits_omitted_limits() {
    let block = init_of(&source(SHORT)).unwrap();
    let script = |device: &str| {
        let limits = &block.device(device).unwrap().available_control_types.script().unwrap().limits;
        (limits.min_value, limits.max_value, limits.granularity, limits.max_error)
    };
    assert_eq!(script("arm"), (-90.0, 90.0, 0.5, Some(0.25)));
    assert_eq!(script("leg"), (-9.0, 9.0, 3.0, None));
    let ambiguous = SHORT.replace(", control_types: [speed], granularity: 3", "");
    check_finding(&ambiguous, "the device's control types have different limits", 14);
    let nothing = SHORT
        .replace("      position: {min_value: -90, max_value: 90, granularity: 0.5, max_error: 0.25}\n", "");
    check_finding(&nothing, "the device has no control type to inherit it from", 7);
}

#[test]
fn all_faults_of_a_block_are_reported_at_their_positions() {
    let wrong = SHORT
        .replace("granularity: 0.5", "granularity: 0")
        .replace("max_value: 45, ", "")
        .replace("api_version: \"1\"\n", "");
    let findings = init_of(&source(&wrong)).unwrap_err();
    let places: Vec<_> = findings.iter().map(|finding| (finding.line, finding.column)).collect();
    assert_eq!(places, [(1, 1), (6, 62), (11, 7)], "{findings:#?}");
}

#[test]
fn unexpected_word_is_reported_at_its_position() {
    let wrong = SHORT.replace("api_version: \"1\"\n", "api_version: \"1\"\ntype: Humanoid\n");
    let findings = init_of(&source(&wrong)).unwrap_err();
    let places: Vec<_> = findings.iter().map(|finding| (finding.line, finding.column)).collect();
    assert_eq!(places, [(3, 7)], "{findings:#?}");
}

#[test]
fn single_fault_of_a_block_is_reported_once() {
    for (wrong, right, says, line) in [
        (
            "granularity: 0.5",
            "granularity: 0",
            "invalid granularity 0, for `position` of the device `arm`",
            7,
        ),
        ("granularity: 0.5", "granularty: 0.5", "`position` of the device `arm` has no `granularity`", 7),
        (
            "min_value: -90, max_value: 90",
            "min_value: 90, max_value: -90",
            "min_value 90 is greater than max_value -90",
            7,
        ),
        ("max_value: 90", "max_value: 90deg", "found the text `90deg`", 7),
        ("    name: leg\n", "    default_value: 99\n", "default_value 99 of device `leg`", 10),
        ("id: leg", "id: arm", "2 devices have the same id `arm`", 9),
    ] {
        let findings = init_of(&source(&SHORT.replacen(wrong, right, 1))).unwrap_err();
        let found: Vec<_> = findings.iter().map(|finding| (finding.message.as_str(), finding.line)).collect();
        assert!(
            matches!(found[..], [(message, at)] if message.starts_with(says) && at == line),
            "{found:#?}"
        );
    }
    let many: String =
        (0..32_001).map(|n| format!("  - {{id: d{n}, available_control_types: {{}}}}\n")).collect();
    let findings = init_of(&source(&format!("id: r\napi_version: \"1\"\ndevices:\n{many}"))).unwrap_err();
    assert_eq!(
        findings.iter().map(|finding| finding.message.as_str()).collect::<Vec<_>>(),
        ["found 32001 devices"]
    );
}

#[test]
fn keys_without_effect_cause_warnings() {
    let ignored = |text: &str| {
        let Init::Block(_, warnings) = Init::read(source(text)).unwrap() else { panic!("{text}") };
        warnings.into_iter().map(|found| (found.line, found.hint.unwrap_or_default())).collect::<Vec<_>>()
    };
    assert_eq!(ignored(SHORT), []);
    let queue = SHORT.replacen("{max_number_of_steps: 8}", "{max_number_of_steps: 8, script_queue: 2}", 1);
    assert_eq!(ignored(&queue), [(8, "write it next to the `id` of the device".to_owned())]);
    assert_eq!(
        ignored(&SHORT.replacen("    name: arm", "    units: deg", 1)),
        [(5, "did you mean `unit`?".to_owned())]
    );
    // Keys of the robot's own software, and keys of a custom type.
    let own = SHORT.replacen("    name: arm", "    serial: 4711\n    torque_limit: 3", 1);
    assert_eq!(
        ignored(&own.replacen(
            "      position: {min_value: -90",
            "      custom_1: {script_queue: 3}\n      position: {min_value: -90",
            1
        )),
        []
    );
}

#[test]
fn deeply_nested_description_is_refused_at_once() {
    // Without the limit, this takes hours.
    check_finding(&"{a: [".repeat(1_000_000), "recursion limit", 1);
}

#[test]
fn aliases_of_a_description_are_limited() {
    let text = |uses: usize| {
        let (values, uses) = ("1, ".repeat(5_000), "*a, ".repeat(uses));
        SHORT.replacen("id:", &format!("x: &a [{values}]\ny: [{uses}]\nid:"), 1)
    };
    assert!(init_of(&source(&text(2))).is_ok());
    let findings = init_of(&source(&text(20_000))).unwrap_err();
    assert_eq!(findings.iter().map(|finding| finding.code).collect::<Vec<_>>(), [Code::TooMuch]);
}
