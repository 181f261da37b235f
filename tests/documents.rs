//! The documents tell the truth about the program.

use std::process::Command;

use crate::session::{PROGRAM, Ran, Session, root};

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// The blocks of a document that open with this line.
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

/// The scenarios that a document shows.
pub fn scenarios_of(document: &str) -> Vec<String> {
    blocks(&read(document), "```yaml scenario")
}

/// Blocks that open with "```yaml file NAME": files that the scenarios of the document use.
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
fn every_scenario_in_the_documents_is_sound() {
    for document in ["docs/scenario.md", "README.md"] {
        let scenarios = blocks(&read(document), "```yaml scenario");
        assert!(!scenarios.is_empty(), "{document} shows no scenario");
        for scenario in scenarios {
            let session = Session::new();
            session.file("test.yaml", &scenario);
            for (name, content) in files(&read(document)) {
                session.file(&name, content);
            }
            let fleet = root().join("fleet.yaml");
            let ran = session.run(&["check", "test.yaml", "--fleet", fleet.to_str().unwrap()]);
            assert_eq!(ran.code(), 0, "{document}:\n{scenario}\n{}", ran.text());
        }
    }
}

#[test]
fn the_table_of_findings_lists_every_code_with_its_title() {
    let table = read("docs/findings.md");
    for code in downbeat_scripts::Code::ALL {
        let row = format!("| {} | {} |", code.as_str(), code.title());
        assert!(table.contains(&row), "`{row}` is missing in docs/findings.md");
    }
}

#[test]
fn the_messages_in_the_protocol_document_are_messages() {
    let document = read("docs/protocol.md");
    let messages: Vec<_> = blocks(&document, "```json");
    assert!(messages.len() >= 6, "all six messages are shown");
    for text in messages {
        let message: urrcp::Message = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}:\n{text}"));
        let mut line = Vec::new();
        urrcp::encode(&message, &mut line);
        assert_eq!(String::from_utf8(line).unwrap(), text, "shown as it travels");
    }
}

#[test]
fn every_command_of_the_readme_exists() {
    for line in read("README.md").lines().filter(|line| line.starts_with("downbeat ")) {
        let words: Vec<_> = line
            .split_whitespace()
            .skip(1)
            .take_while(|word| !word.starts_with('-') && !word.contains('.'))
            .collect();
        let help = Ran(Command::new(PROGRAM).args(&words).arg("--help").output().unwrap());
        assert_eq!(help.code(), 0, "{line}");
    }
}
