//! Tests that the documents match the program.

use std::process::Command;

use downbeat_robot::{Input, LinkId, Output, Robot};
use urrcp::Timestamp;

use stage::schema::validator;
use stage::session::{Ran, Session, program, root};

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Returns the contents of the code blocks whose first line is `opening`.
fn blocks(text: &str, opening: &str) -> Vec<String> {
    let mut blocks = Vec::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if line.trim() == opening {
            blocks.push(
                lines
                    .by_ref()
                    .take_while(|line| line.trim() != "```")
                    .map(|line| format!("{line}\n"))
                    .collect(),
            );
        }
    }
    blocks
}

/// Returns the scenarios that a document shows.
pub fn scenarios_of(document: &str) -> Vec<String> {
    blocks(&read(document), "```yaml scenario")
}

/// Returns the name and content of each code block that opens with "```yaml file NAME". These are files that the scenarios of the
/// document use.
fn files(text: &str) -> Vec<(String, String)> {
    let openings = text.lines().filter(|line| line.starts_with("```yaml file "));
    openings
        .map(|opening| {
            let name = opening.trim_start_matches("```yaml file ").trim().to_owned();
            (name, blocks(text, opening.trim()).concat())
        })
        .collect()
}

#[test]
fn every_scenario_in_documents_passes_check() {
    for page in ["docs/scenario.md", "docs/cookbook.md"] {
        let document = read(page);
        let scenarios = blocks(&document, "```yaml scenario");
        assert!(!scenarios.is_empty(), "{page} shows no scenario");
        for scenario in scenarios {
            let session = Session::new();
            session.file("test.yaml", &scenario);
            for (name, content) in files(&document) {
                session.file(&name, content);
            }
            let fleet = root().join("fleet.yaml");
            let ran = session.run(&["check", "test.yaml", "--fleet", fleet.to_str().unwrap()]);
            assert_eq!(ran.code(), 0, "{page}\n{scenario}\n{}", ran.text());
        }
    }
}

#[test]
fn readme_excerpt_matches_scenario_lines() {
    const OPENING: &str = "```yaml excerpt scripts/examples/sky.yaml";
    let scenario = read("scripts/examples/sky.yaml");
    let excerpts = blocks(&read("README.md"), OPENING);
    assert_eq!(excerpts.len(), 1, "README.md has no block that opens with {OPENING}");
    for line in excerpts[0].lines().filter(|line| !line.trim_start().starts_with('#')) {
        let without_comment = line.split("  # ").next().unwrap().trim_end();
        assert!(scenario.lines().any(|line| line == without_comment), "`{without_comment}`");
    }
}

#[test]
fn table_of_findings_lists_every_code_with_title() {
    let table = read("docs/findings.md");
    for code in downbeat_scripts::Code::ALL {
        let row = format!("| {} | {} |", code.as_str(), code.title());
        assert!(table.contains(&row), "`{row}` is missing in docs/findings.md");
    }
}

#[test]
fn every_import_format_has_documentation_row_and_fuzzer_seed() {
    let document = read("docs/import.md");
    let seeds = root().join("fuzz/seeds/import");
    let byte = |word: &str| {
        let seed = seeds.join(word);
        let bytes = std::fs::read(&seed).unwrap_or_else(|error| panic!("{}: {error}", seed.display()));
        usize::from(bytes[0])
    };
    for (index, facts) in downbeat_import::ImportFormat::ALL.iter().enumerate() {
        let row = format!("\n| `{}` | ", facts.word);
        assert!(document.contains(&row), "docs/import.md has no row of `{}`", facts.word);
        assert_eq!(
            byte(facts.word),
            index,
            "the first byte of the seed `{}` is the place of its format",
            facts.word
        );
    }
    let motions = downbeat_import::ImportFormat::ALL.len();
    for (index, word) in (motions..).zip(["urdf", "fixture"]) {
        assert!(document.contains(&format!("\n| `{word}` | ")), "docs/import.md has no row of `{word}`");
        assert_eq!(byte(word), index, "the first byte of the seed `{word}`");
    }
}

#[test]
fn messages_in_protocol_document_are_valid() {
    let document = read("docs/protocol.md");
    let mut messages: Vec<_> = blocks(&document, "```json");
    for exchange in blocks(&document, "```exchange") {
        messages.extend(exchange.lines().map(|line| format!("{}\n", &line[19..])));
    }
    let validator = validator("protocol");
    let mut kinds = std::collections::BTreeSet::new();
    for text in messages {
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        kinds.extend(json.as_object().unwrap().keys().cloned());
        assert!(validator.is_valid(&json), "{text}");
        let message: urrcp::Message = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}:\n{text}"));
        let mut line = Vec::new();
        urrcp::encode(&message, &mut line);
        assert_eq!(String::from_utf8(line).unwrap(), text, "shown as it travels");
    }
    assert_eq!(kinds.len(), 8, "every message is shown");
}

/// Parses a time of day in an exchange of messages that a document shows. The date is that of all examples.
fn instant(time: &str) -> Timestamp<urrcp::Robot> {
    serde_json::from_str(&format!("\"2026-11-20T{time}Z\"")).unwrap_or_else(|e| panic!("{time}: {e}"))
}

/// Advances the robot to `until` and wakes it at each time that it requested. Appends the messages that it sends to `said`.
fn advance(robot: &mut Robot, until: Timestamp<urrcp::Robot>, said: &mut Vec<String>) {
    while let Some(at) = robot.next_wakeup().filter(|at| *at <= until) {
        let mut out = Vec::new();
        robot.advance(at, &mut out);
        note(at, out, said);
    }
}

fn note(at: Timestamp<urrcp::Robot>, out: Vec<Output>, said: &mut Vec<String>) {
    for output in out {
        let Output::Send { link, message } = output else { continue };
        let arrow = if link == LinkId(1) { "<-" } else { "<=" };
        let mut line = Vec::new();
        urrcp::encode(&message, &mut line);
        let text = String::from_utf8(line).unwrap();
        said.push(format!("{} {arrow} {}", &at.to_string()[11..26], text.trim_end()));
    }
}

#[test]
fn exchanges_in_protocol_document_match_robot_behaviour() {
    let document = read("docs/protocol.md");
    let block = blocks(&document, "```json").into_iter().find_map(|text| match serde_json::from_str(&text) {
        Ok(urrcp::Message::InitializationBlock(block)) => Some(block),
        _ => None,
    });
    let exchanges = blocks(&document, "```exchange");
    assert!(exchanges.len() >= 6, "found {}", exchanges.len());
    for exchange in exchanges {
        let mut robot = Robot::new(block.clone().unwrap());
        let (mut said, mut told) = (Vec::new(), Vec::new());
        for line in exchange.lines() {
            let at = instant(&line[..15]);
            advance(&mut robot, at, &mut said);
            let link = match &line[16..18] {
                "->" => LinkId(1),
                "=>" => LinkId(2),
                _ => {
                    told.push(line.to_owned());
                    continue;
                }
            };
            let message = serde_json::from_str(&line[19..]).unwrap_or_else(|e| panic!("{e}: {line}"));
            let mut out = Vec::new();
            robot.handle(at, link, Input::Message(message), &mut out);
            note(at, out, &mut said);
        }
        assert_eq!(told.join("\n"), said.join("\n"));
    }
}

#[test]
fn hashes_in_protocol_document_match_their_values() {
    let document = read("docs/protocol.md");
    let mut hashes = 0;
    for text in blocks(&document, "```json") {
        let Ok(urrcp::Message::ControlRequest(request)) = serde_json::from_str(&text) else { continue };
        let Some(stated) = request.content_hash else { continue };
        assert_eq!(stated, request.command.content_hash());
        hashes += 1;
    }
    assert_eq!(hashes, 2);
}

#[test]
fn frame_in_encoding_document_matches_its_message() {
    let document = read("docs/encoding.md");
    let [json, dump] = ["```json", "```hex"].map(|opening| blocks(&document, opening).concat());
    let digits = dump.lines().flat_map(|line| {
        let words = line.split_whitespace();
        words.take_while(|word| word.bytes().all(|byte| byte.is_ascii_hexdigit())).flat_map(str::bytes)
    });
    let digits: Vec<u8> = digits.collect();
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    let frame: Vec<u8> = digits.chunks(2).map(byte).collect();
    let message: urrcp::Message = serde_json::from_str(&json).unwrap();
    let mut written = Vec::new();
    urrcp::encode_as(urrcp::Encoding::MessagePack, &message, &mut written);
    assert_eq!(written, frame);
    let mut decoder = urrcp::Decoder::default();
    decoder.push(&frame);
    assert_eq!(decoder.next_message(), Some(Ok(message)));
}

#[test]
fn every_command_in_readme_and_cookbook_exists() {
    let pages = read("README.md") + &read("docs/cookbook.md");
    for line in pages.lines().filter(|line| line.starts_with("downbeat ")) {
        let words: Vec<_> = line
            .split_whitespace()
            .skip(1)
            .take_while(|word| !word.starts_with('-') && !word.contains('.'))
            .collect();
        let help = Ran(Command::new(program()).args(&words).arg("--help").output().unwrap());
        assert_eq!(help.code(), 0, "{line}");
    }
}

#[test]
fn every_command_is_in_readme_table() {
    let readme = read("README.md");
    let rows: String = readme.lines().filter(|line| line.starts_with("| `")).collect();
    let commands = super::help::commands();
    // A command with subcommands has no row of its own; each subcommand has one.
    let is_group = |command: &String| commands.iter().any(|other| other.starts_with(&format!("{command} ")));
    for command in commands.iter().filter(|command| !command.is_empty() && !is_group(command)) {
        assert!(rows.contains(&format!("`{command}`")), "README.md does not list `{command}`");
    }
}

#[test]
fn robot_description_in_edge_document_is_valid() {
    let descriptions = blocks(&read("docs/edge.md"), "```yaml edge");
    assert_eq!(descriptions.len(), 1);
    let session = Session::new();
    session.file("robot.yaml", &descriptions[0]);
    session.file("fleet.yaml", "robots: {tank-1: {init: robot.yaml, address: sim}}\n");
    let cue = "{cue: turn, at: 0s, robots: tank-1, tracks: {turret: [{at: 0s, to: 0}, {at: 1s, to: 45}]}, read: {turret_angle: 1s}}";
    session.file("show.yaml", format!("scenario: show\ncues:\n  - {cue}\n"));
    session.run(&["check", "show.yaml"]).says(0, &["no errors"]);
}

#[test]
fn fixture_in_lights_document_is_valid_and_can_be_addressed() {
    let descriptions = blocks(&read("docs/lights.md"), "```yaml fixture");
    assert_eq!(descriptions.len(), 1);
    let session = Session::new();
    session.file("spot.yaml", &descriptions[0]);
    session.file("fleet.yaml", "robots: {spot-1: {init: spot.yaml, address: \"sacn:1/13\"}}\n");
    let tracks = "{dimmer: [{at: 0s, to: 0}, {at: 1s, to: 100}], color: [{at: 0s, to: [255, 0, 0]}]}";
    session.file(
        "show.yaml",
        format!("scenario: show\ncues:\n  - {{cue: light, robots: spot-1, tracks: {tracks}}}\n"),
    );
    session.run(&["check", "show.yaml"]).says(0, &["no errors"]);
}

#[test]
fn every_page_is_in_book_table_of_contents() {
    let contents = read("book/SUMMARY.md");
    for entry in std::fs::read_dir(root().join("docs")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if name.ends_with(".md") {
            assert!(contents.contains(&format!("(docs/{name})")), "{name}");
        }
    }
}
