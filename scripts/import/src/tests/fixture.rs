//! Fixtures of the Open Fixture Library: the channels of a mode, and the ranges and default values of their devices.

use proptest::prelude::*;

use super::fixture_of;
use downbeat_yaml::source::Source;
use urrcp::{ControlType, Device, InitializationBlock, Interpolation, Limits};

use crate::{DescriptionOutcome, fixture};

fn converted_text(text: &str, mode: Option<&str>) -> DescriptionOutcome {
    fixture(&Source { name: "acme/light.json".into(), text: text.to_owned() }, mode, None)
}

fn text_of(name: &str) -> String {
    String::from_utf8(fixture_of(name)).unwrap()
}

fn block_of(outcome: &DescriptionOutcome) -> InitializationBlock {
    let text = &outcome.files[0].text;
    serde_yaml::from_str(text).unwrap_or_else(|error| panic!("{error}:\n{text}"))
}

#[track_caller]
fn converted(name: &str, mode: Option<&str>) -> (InitializationBlock, DescriptionOutcome) {
    let outcome = converted_text(&text_of(name), mode);
    assert_eq!(outcome.findings, []);
    let block = block_of(&outcome);
    assert_eq!(block.devices.len(), outcome.devices);
    (block, outcome)
}

/// Returns a text of a block, or an empty text.
fn written(text: Option<&impl ToString>) -> String {
    text.map(ToString::to_string).unwrap_or_default()
}

/// Returns each device with its channels, such as `pan [1,2]`.
fn channels(block: &InitializationBlock) -> Vec<String> {
    let channel = |device: &Device| serde_json::to_string(device.channel.as_ref().unwrap()).unwrap();
    block.devices.iter().map(|device| format!("{} {}", device.id, channel(device))).collect()
}

fn limits<'b>(block: &'b InitializationBlock, id: &str) -> &'b Limits {
    block.device(id).unwrap().available_control_types.limits(ControlType::Position).unwrap()
}

/// The range, the granularity and the largest error of a device.
fn numbers(block: &InitializationBlock, id: &str) -> [f64; 4] {
    let limits = limits(block, id);
    [limits.min_value, limits.max_value, limits.granularity, limits.max_error.unwrap()]
}

/// Returns the lines of comments above a device.
fn comment(outcome: &DescriptionOutcome, id: &str) -> String {
    let lines: Vec<&str> = outcome.files[0].text.lines().collect();
    let device = lines.iter().position(|line| *line == format!("  - id: {id}")).unwrap();
    let comment = lines[..device].iter().rev().take_while(|line| line.starts_with("  # "));
    comment.map(|line| &line[4..]).collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join(" ")
}

#[test]
fn each_channel_of_a_mode_becomes_a_device() {
    let (block, _) = converted("par.json", None);
    assert_eq!(channels(&block), ["dimmer 1", "red 2", "green 3", "blue 4", "strobe 5"]);
    assert_eq!(
        (block.id.as_str(), written(block.name.as_ref())),
        ("led-par-7-10-w", "LED PAR 7×10 W".to_owned())
    );
    assert_eq!(written(block.manufacture.as_ref()), "acme");
    assert_eq!(written(block.version.as_ref()), "2026-11-30");
    let (basic, _) = converted("spot.json", Some("6ch"));
    assert_eq!(
        channels(&basic),
        ["pan 1", "tilt 2", "shutter 3", "dimmer 4", "color-wheel 5", "gobo-wheel 6"],
        "a mode without fine channels"
    );
}

#[test]
fn coarse_and_fine_channels_are_one_device() {
    let (block, outcome) = converted("spot.json", Some("Extended"));
    let expected = [
        "pan [1,2]",
        "tilt [3,4]",
        "pan-tilt-speed 6",
        "color-wheel 8",
        "gobo-wheel 9",
        "shutter 10",
        "dimmer [12,11]",
        "zoom 13",
        "focus 14",
        "color-temperature 15",
        "program 16",
        "program-speed 17",
        "reserved 18",
    ];
    assert_eq!(channels(&block), expected);
    for part in [
        "left out 1 unused channel",
        "at most 16 bits: `Tilt fine^2`",
        "as with the default values of these: `program-speed (Speed / Sensitivity)`",
        "middle of the range: `pan`",
        "opposite sign, because they fall in the file: `tilt`",
        "100 % is the lowest value in the file: `color-temperature`",
    ] {
        assert!(outcome.notes.iter().any(|note| note.contains(part)), "{part}: {:?}", outcome.notes);
    }
}

#[test]
fn ranges_have_the_resolution_of_their_channels() {
    let (fine, outcome) = converted("spot.json", Some("Extended"));
    let (coarse, _) = converted("spot.json", Some("Basic"));
    // 540 / 65535 is 0.00824, 540 / 255 is 2.118.
    assert_eq!(numbers(&fine, "pan"), [-270.0, 270.0, 0.001, 0.0042]);
    assert_eq!(numbers(&coarse, "pan"), [-270.0, 270.0, 1.0, 1.1]);
    assert_eq!(numbers(&fine, "tilt"), [-125.0, 125.0, 0.001, 0.002]);
    assert_eq!(numbers(&fine, "dimmer"), [0.0, 100.0, 0.001, 0.00077]);
    assert_eq!(numbers(&coarse, "dimmer"), [0.0, 100.0, 0.1, 0.2]);
    assert_eq!(numbers(&fine, "zoom"), [10.0, 50.0, 0.1, 0.079]);
    assert_eq!(numbers(&fine, "color-temperature"), [0.0, 100.0, 0.1, 0.2]);
    assert_eq!(numbers(&fine, "shutter"), [0.0, 255.0, 1.0, 0.5]);
    assert_eq!(numbers(&fine, "reserved"), [0.0, 255.0, 1.0, 0.5]);
    let unit = |id: &str| written(fine.device(id).unwrap().unit.as_ref());
    assert_eq!([unit("pan"), unit("dimmer"), unit("shutter")], ["deg", "%", ""]);
    assert_eq!(comment(&outcome, "color-temperature"), "0 % is 8000 K, 100 % is 2700 K");
    let linear = fine.devices.iter().filter(|device| device.interpolation == Interpolation::Linear);
    let linear: Vec<_> = linear.map(|device| device.id.as_str()).collect();
    assert_eq!(linear, ["pan", "tilt", "dimmer", "zoom", "focus", "color-temperature"]);
    assert!(fine.devices.iter().all(|device| device.script_queue == 2));
    let script = |device: &Device| device.available_control_types.script().unwrap().max_number_of_steps;
    assert!(fine.devices.iter().all(|device| script(device) == 512));
    let limit = "# limits: {pan: {speed: SPEED}, tilt: {speed: SPEED}}";
    assert!(outcome.files[1].text.contains(limit), "{}", outcome.files[1].text);
}

#[test]
fn default_values_are_those_of_the_file_on_the_grid() {
    let (fine, _) = converted("spot.json", Some("Extended"));
    let default = |id: &str| fine.device(id).unwrap().default_value.unwrap();
    assert_eq!(default("pan"), 0.0, "50%");
    assert_eq!(default("tilt"), 0.49, "128 of 255 is 0.502 of the range");
    assert_eq!((default("dimmer"), default("shutter")), (100.0, 10.0));
    assert_eq!((default("zoom"), default("focus")), (10.0, 0.0), "unknown: the value closest to 0");
    for device in fine.devices.iter() {
        assert!(limits(&fine, device.id.as_str()).on_grid(device.default_value.unwrap()), "{}", device.id);
    }
    // 32768 of 65535 is in the middle, and 128 of 255 in a mode without the fine channel.
    let text = text_of("spot.json").replace("\"defaultValue\": 65535", "\"defaultValue\": 32768");
    let of_mode = |mode| block_of(&converted_text(&text, Some(mode))).device("dimmer").unwrap().default_value;
    assert_eq!((of_mode("Extended"), of_mode("Basic")), (Some(50.001), Some(50.2)));
}

#[test]
fn comments_list_the_capabilities_with_their_ranges() {
    let (_, outcome) = converted("spot.json", Some("Extended"));
    let comment = |id: &str| comment(&outcome, id);
    assert_eq!(comment("shutter"), "0-9 closed, 10-19 open, 20-255 strobe random 1Hz to 20Hz");
    assert_eq!(
        comment("color-wheel"),
        "0-9 open, 10-19 Red, 20-29 Blue, 30-255 wheel rotation slow CW to fast CW"
    );
    assert_eq!(
        comment("gobo-wheel"),
        "0-63 open, 64-127 gobo 2, 128-191 Stars, 192-255 shake Stars slow to fast"
    );
    assert_eq!(
        comment("program-speed"),
        "`Speed / Sensitivity` while `Program` has its default value, effect speed slow to fast"
    );
    assert_eq!(comment("pan-tilt-speed"), "pan tilt speed fast to slow");
    assert_eq!(comment("tilt"), "with the opposite sign");
    assert_eq!(comment("dimmer"), "");
    assert_eq!(comment("reserved"), "no function");
}

#[test]
fn template_channels_are_repeated_for_pixels_and_groups() {
    let (columns, outcome) = converted("batten.json", Some("Pixels by column"));
    let expected =
        ["strobe 1", "red-1-1 2", "red-1-2 4", "red-2-1 6", "red-2-2 8", "red-3-1 10", "red-3-2 12"];
    assert_eq!(channels(&columns), expected);
    assert_eq!(written(columns.manufacture.as_ref()), "example-lights");
    assert_eq!(comment(&outcome, "red-2-1"), "red (warmer)", "a channel of its own instead of the template");
    let (names, outcome) = converted("batten.json", Some("Pixels by name"));
    let names = channels(&names);
    assert_eq!((names.len(), names[1].as_str(), names[7].as_str()), (12, "red-1-2 2", "blue-1-2 8"));
    assert_eq!(comment(&outcome, "blue-1-2"), "blue off to bright (of (1, 2))");
    let (rows, _) = converted("batten.json", Some("Rows"));
    assert_eq!(channels(&rows), ["red-top [1,2]", "red-bottom [3,4]", "red-master [5,6]"]);
    let (two, _) = converted("batten.json", Some("Two"));
    assert_eq!(channels(&two), ["blue-master 1", "blue-3-2 2", "red-1-1 3"]);
}

#[test]
fn ids_are_unique() {
    let text = text_of("par.json")
        .replace("\"Red\": {", "\"Dimmer!\": {")
        .replace("[\"Dimmer\", \"Red\"", "[\"Dimmer\", \"Dimmer!\"");
    let block = block_of(&converted_text(&text, None));
    assert_eq!(channels(&block)[..2], ["dimmer 1", "dimmer-2 2"]);
}

#[test]
fn mode_must_be_named_if_there_are_several() {
    let outcome = converted_text(&text_of("spot.json"), None);
    let shown = downbeat_yaml::render::render(&outcome.findings, false);
    for part in
        ["the fixture has 2 modes", "one mode: `Basic` (6 channels), `Extended` (18 channels)", "--mode NAME"]
    {
        assert!(shown.contains(part), "{shown}");
    }
    let outcome = converted_text(&text_of("spot.json"), Some("Extendet"));
    let shown = downbeat_yaml::render::render(&outcome.findings, false);
    assert!(shown.contains("no mode `Extendet`") && shown.contains("did you mean `Extended`?"), "{shown}");
}

#[test]
fn invalid_fixtures_are_refused_with_the_place() {
    #[track_caller]
    fn check(text: &str, parts: &[&str]) {
        let outcome = converted_text(text, Some("5-channel"));
        let shown = downbeat_yaml::render::render(&outcome.findings, false);
        assert!(outcome.files.is_empty() && parts.iter().all(|part| shown.contains(part)), "{shown}");
        assert_eq!(outcome.notes, [""; 0], "no notes about a block that is not written");
    }
    let par = text_of("par.json");
    let with = |from: &str, to: &str| {
        assert!(par.contains(from), "{from}");
        par.replacen(from, to, 1)
    };
    check("", &["DB0002"]);
    check("scenario: show\n", &["DB0002", "light.json:1:1", "a JSON document"]);
    check("[]", &["DB0003", "found a list", "a fixture of the Open Fixture Library"]);
    check("{\"robots\": 1}", &["DB0066", "this is no fixture"]);
    check(
        "{\"name\": \"A\",\n\"redirectTo\": \"acme/new-light\", \"reason\": \"FixtureRenamed\"}",
        &[
            "DB0066",
            "light.json:2:15",
            "redirects to the fixture `acme/new-light`",
            "import `acme/new-light.json`",
        ],
    );
    check(
        &with("\"Blue\", \"Strobe\"]", "\"Bleu\", \"Strobe\"]"),
        &["DB0066", "light.json:18:74", "unknown channel `Bleu`", "did you mean `Blue`"],
    );
    check(&with("\"Green\", \"Blue\"", "\"Blue\", \"Blue\""), &["DB0067", "`Blue` appears twice"]);
    check(&with("\"Green\": {", "\"Red\": {"), &["DB0005", "duplicate key `Red`"]);
    check(&with("[10, 255]", "[10, 256]"), &["DB0003", "a whole number from 0 to 255"]);
    check(&with("[10, 255]", "[255, 10]"), &["DB0066", "begins at 255 and ends at 10"]);
    check(&with("\"dmxRange\": [0, 9], ", ""), &["DB0006", "has no `dmxRange`"]);
    check(&with("\"type\": \"Intensity\"", "\"kind\": 1"), &["DB0006", "has no `type`"]);
    check(&with("\"capability\": {\"type\": \"Intensity\"}", ""), &["DB0006", "has no capabilities"]);
    check(
        &with("\"color\": \"Red\"", "\"angleStart\": \"1e999deg\""),
        &["DB0061", "`angleStart` is `1e999deg`"],
    );
    check(
        &with("[\"Dimmer\", \"Red\", \"Green\", \"Blue\", \"Strobe\"]", "[null]"),
        &["DB0016", "has no channels"],
    );
    check(&with("[\"Dimmer\",", "[4,"), &["DB0003", "found the number 4"]);
    check(
        &with("[\"Dimmer\"", &format!("[{}\"Dimmer\"", "null,".repeat(508))),
        &["DB0068", "has 513 channels", "at most 512"],
    );
    check(&format!("{{\"a\": {}", "[".repeat(100_000)), &["DB0002", "recursion limit"]);
    check(&" ".repeat(3 << 20), &["DB0068", "3145728 bytes"]);
    check(&with("\"5-channel\"", &format!("\"{}\"", "m".repeat(1_001))), &["DB0067", "has 1001 bytes"]);
    check(&with("\"Red\": {", &format!("\"{}\": {{", "r".repeat(1_001))), &["DB0067", "has 1001 bytes"]);
    let many = "{\"dmxRange\": [0, 9], \"type\": \"Effect\"},".repeat(1_000);
    check(
        &with("\"capabilities\": [", &format!("\"capabilities\": [{many}")),
        &["DB0068", "1002 capabilities"],
    );
    let kind = fixture(&Source { name: "a.json".into(), text: par.clone() }, None, Some(""));
    assert_eq!(kind.findings[0].code.as_str(), "DB0067");
}

#[test]
fn invalid_matrices_and_switches_are_refused() {
    #[track_caller]
    fn check(file: &str, mode: &str, from: &str, to: &str, parts: &[&str]) {
        let text = text_of(file);
        assert!(text.contains(from), "{from}");
        let outcome = converted_text(&text.replacen(from, to, 1), Some(mode));
        let shown = downbeat_yaml::render::render(&outcome.findings, false);
        assert!(outcome.files.is_empty() && parts.iter().all(|part| shown.contains(part)), "{shown}");
    }
    let batten = |from: &str, to: &str, parts: &[&str]| check("batten.json", "Two", from, to, parts);
    batten("[3, 2, 1]", "[10000, 10000, 10000]", &["DB0068", "the matrix has 1000000000000 pixels"]);
    batten("[3, 2, 1]", "[3, 2]", &["DB0003", "along x, y and z"]);
    batten("[\"Master\",", "[\"Mister\",", &["DB0066", "no pixel or group `Mister`"]);
    batten("eachPixelYXZ", "eachPixelYXX", &["DB0003", "`eachPixelABC`"]);
    batten("perChannel", "perRow", &["DB0003", "`perPixel` or `perChannel`"]);
    batten("\"Red (1, 1)\"", "\"Red (1, 9)\"", &["DB0066", "unknown channel `Red (1, 9)`"]);
    let spot = |from: &str, to: &str, parts: &[&str]| check("spot.json", "Extended", from, to, parts);
    spot(
        "\"dmxRange\": [0, 127], \"type\": \"NoFunction\"",
        "\"dmxRange\": [1, 127], \"type\": \"NoFunction\"",
        &["DB0066", "default value of `Program` selects no channel for `Speed / Sensitivity`"],
    );
    spot(
        "\"Program Speed\"}}",
        "\"Speed / Sensitivity\"}}",
        &["DB0066", "leads to more than 4 other aliases"],
    );
    spot("\"8bit\"", "\"9bit\"", &["DB0003", "`8bit`, `16bit` or `24bit`"]);
    spot("\"defaultValue\": 65535", "\"defaultValue\": 65536", &["DB0003", "0 to 65535"]);
    spot("\"50%\"", "\"101%\"", &["DB0003", "from `0%` to `100%`"]);
}

#[test]
fn comments_and_names_cannot_break_the_block() {
    let strange = "a\\u2028b\\u0000\\ufeff\\ufffe: #\\\"\\n- x";
    let text = text_of("par.json")
        .replace(
            "\"shutterEffect\": \"Open\"",
            &format!("\"shutterEffect\": \"Open\", \"comment\": \"{strange}\""),
        )
        .replace("Dimmer", strange)
        .replace("LED PAR 7×10 W", "\\u0000")
        .replace("5-channel", strange);
    let outcome = converted_text(&text, None);
    assert_eq!(outcome.findings, []);
    assert_eq!((block_of(&outcome).devices.len(), block_of(&outcome).id.as_str()), (5, "fixture"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn changed_fixtures_are_converted_or_refused(
        file in prop::sample::select(vec!["spot.json", "batten.json", "par.json"]),
        cut in any::<prop::sample::Index>(),
        length in 0_usize..12,
        put in prop::sample::select(vec!["", "0", "1e308", "\"", "null", "[]", "{}", ",", "$pixelKey", "deg", "-", "99999999"]),
        mode in prop::sample::select(vec!["Extended", "Rows", "Pixels by name", "5-channel"]),
    ) {
        let mut text: Vec<char> = text_of(file).chars().collect();
        let start = cut.index(text.len());
        let end = (start + length).min(text.len());
        text.splice(start..end, put.chars());
        let outcome = converted_text(&text.into_iter().collect::<String>(), Some(mode));
        prop_assert_eq!(outcome.files.is_empty(), !outcome.findings.is_empty());
        let _shown = downbeat_yaml::render::render(&outcome.findings, false);
        if !outcome.files.is_empty() {
            prop_assert_eq!(block_of(&outcome).devices.len(), outcome.devices);
        }
    }
}
