//! Tests that facts agree that are stated in several places. These are the keys of messages and files in schemas, documents, test vectors
//! and the fuzzer's dictionaries. The schemas are the reference; unit tests compare the schemas with the parser.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

use stage::session::{program, root};

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn schema(of: &str) -> Value {
    let printed = Command::new(program()).args(["schema", of]).output().unwrap().stdout;
    serde_json::from_slice(&printed).unwrap()
}

/// Returns the names of all keys of a definition in the schema.
fn keys(schema: &Value, definition: &str) -> BTreeSet<String> {
    let properties = schema["$defs"][definition]["properties"].as_object();
    properties.unwrap_or_else(|| panic!("no {definition}")).keys().cloned().collect()
}

fn required(schema: &Value, definition: &str) -> BTreeSet<String> {
    let names = schema["$defs"][definition]["required"].as_array();
    names.into_iter().flatten().map(|name| name.as_str().unwrap().to_owned()).collect()
}

/// Returns the parts of `text` in backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// Tables in `docs/protocol.md`. Each entry has the section, the first cell of the table's head and the definition in the schema. The
/// last field has the keys that the schema lists elsewhere, because they depend on other keys.
const TABLES: [(&str, &str, &str, &[&str]); 11] = [
    ("## Availability", "`availability_request`", "AvailabilityRequest", &[]),
    ("## Availability", "`availability_response`", "AvailabilityResponse", &[]),
    ("## Initialization", "`initialization_block`", "InitializationBlock", &[]),
    ("## Initialization", "device", "Device", &[]),
    ("## Control request", "key", "ControlRequest", &["control_value", "control_value_2"]),
    ("## Control request", "step of a script", "Step", &["control_value_2"]),
    // `status_value` is required of a robot, but servers accept a response without it.
    ("## Control response", "key", "ControlResponse", &["status_value"]),
    ("## Inquiry", "`inquiry`", "Inquiry", &[]),
    ("## Inquiry", "`inquiry_response`", "InquiryResponse", &[]),
    ("## Inquiry", "entry of `requests`", "RequestReport", &[]),
    ("## Inquiry", "entry of `devices`", "DeviceReport", &[]),
];

/// Returns the keys that a table lists, each with its cell in the column `required`.
fn table(document: &str, section: &str, head: &str) -> BTreeMap<String, String> {
    let lines = document.lines().skip_while(|line| !line.starts_with(section));
    let lines = lines.skip_while(|line| !line.starts_with(&format!("| {head} | type |"))).skip(2);
    let rows = lines.take_while(|line| line.starts_with('|'));
    rows.flat_map(|row| {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        quoted(cells[1]).map(|key| (key.to_owned(), cells[3].to_owned())).collect::<Vec<_>>()
    })
    .collect()
}

#[test]
fn protocol_tables_list_keys_of_schema() {
    let (schema, document) = (schema("protocol"), read("docs/protocol.md"));
    let described: BTreeSet<&str> = TABLES.iter().map(|(_, _, definition, _)| *definition).collect();
    for (section, head, definition, apart) in TABLES {
        let listed = table(&document, section, head);
        let names: BTreeSet<String> = listed.keys().cloned().collect();
        let mut known = keys(&schema, definition);
        known.extend(apart.iter().map(|key| (*key).to_owned()));
        assert_eq!(names, known, "docs/protocol.md, table `{head}` of {section}");
        let yes = listed.iter().filter(|(_, required)| *required == "yes").map(|(key, _)| key.clone());
        let yes: BTreeSet<String> = yes.filter(|key| !apart.contains(&key.as_str())).collect();
        let needed = required(&schema, definition);
        let needed = needed.into_iter().filter(|key| !apart.contains(&key.as_str())).collect();
        assert_eq!(yes, needed, "docs/protocol.md, what `{head}` of {section} requires");
    }
    // A definition without a table of its own is described in the table of control types, or in a sentence.
    for (definition, described_by_name) in schema["$defs"].as_object().unwrap() {
        let Some(keys) = described_by_name["properties"].as_object() else { continue };
        if !described.contains(definition.as_str()) {
            for key in keys.keys() {
                assert!(
                    document.contains(key.as_str()),
                    "docs/protocol.md does not name `{key}` of {definition}"
                );
            }
        }
    }
}

#[test]
fn protocol_document_lists_every_error_code_and_enumerated_value() {
    let document = read("docs/protocol.md");
    let errors = document.split_once("### Errors").unwrap().1.split_once("\n## ").unwrap().0;
    let rows = errors.lines().filter(|line| line.starts_with("| `"));
    let listed: BTreeSet<&str> = rows.flat_map(|row| quoted(row.split('|').nth(1).unwrap())).collect();
    assert_eq!(listed, urrcp::ErrorCode::WORDS.iter().copied().collect(), "docs/protocol.md, Errors");
    for (definition, schema) in schema("protocol")["$defs"].as_object().unwrap() {
        for word in schema["oneOf"].as_array().into_iter().flatten().filter_map(|form| form["const"].as_str())
        {
            assert!(
                document.contains(&format!("`{word}`")),
                "docs/protocol.md does not name `{word}` of {definition}"
            );
        }
    }
}

/// Collects the keys that a message contains, each with the name of the schema definition that it belongs to.
fn note(root: &Value, schema: &Value, message: &Value, found: &mut BTreeSet<(String, String)>) {
    if let Some(reference) = schema["$ref"].as_str() {
        let definition = reference.rsplit('/').next().unwrap();
        if let (Value::Object(map), true) = (message, root["$defs"][definition]["properties"].is_object()) {
            found.extend(map.keys().map(|key| (definition.to_owned(), key.clone())));
        }
        return note(root, &root["$defs"][definition], message, found);
    }
    for form in
        ["anyOf", "oneOf", "allOf"].iter().flat_map(|word| schema[word].as_array().into_iter().flatten())
    {
        note(root, form, message, found);
        note(root, &form["then"], message, found);
    }
    match message {
        Value::Object(map) => {
            map.iter().for_each(|(key, value)| note(root, &schema["properties"][key], value, found))
        }
        Value::Array(items) => items.iter().for_each(|item| note(root, &schema["items"], item, found)),
        _ => {}
    }
}

fn message(name: &str) -> Value {
    serde_json::from_str(&read(&format!("tests/vectors/{name}"))).unwrap_or_else(|e| panic!("{name}: {e}"))
}

#[test]
fn vectors_cover_every_key_of_every_message() {
    let schema = schema("protocol");
    let mut found = BTreeSet::new();
    for entry in std::fs::read_dir(root().join("tests/vectors/valid")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if let Ok(message) = serde_json::from_str(&read(&format!("tests/vectors/valid/{name}"))) {
            note(&schema, &schema, &message, &mut found);
        }
    }
    note(&schema, &schema, &message("robot.json"), &mut found);
    let definitions = schema["$defs"].as_object().unwrap();
    for definition in definitions.keys().filter(|name| definitions[*name]["properties"].is_object()) {
        for key in keys(&schema, definition) {
            let known = found.contains(&(definition.clone(), key.clone()));
            assert!(known, "no vector in tests/vectors/valid has `{key}` of {definition}");
        }
    }
}

#[test]
fn full_vectors_contain_every_key() {
    let schema = schema("protocol");
    // `home` is valid only in an empty script.
    for (name, kind, definition, apart) in [
        ("control-request-every-key", "control_request", "ControlRequest", "home"),
        ("initialization-block-full", "initialization_block", "InitializationBlock", ""),
        ("inquiry-every-key", "inquiry", "Inquiry", ""),
    ] {
        let message = message(&format!("valid/{name}.json"));
        let written: BTreeSet<String> = message[kind].as_object().unwrap().keys().cloned().collect();
        let missing: Vec<_> = keys(&schema, definition)
            .into_iter()
            .filter(|key| !written.contains(key) && key != apart)
            .collect();
        assert_eq!(missing, Vec::<String>::new(), "tests/vectors/valid/{name}.json");
    }
}

/// Collects the keys and enum words of a schema, each with the JSON pointer to the subschema that lists it.
fn names(pointer: &str, schema: &Value, found: &mut Vec<(String, String)>) {
    match schema {
        Value::Object(map) => {
            let keys = map.get("properties").and_then(Value::as_object);
            found.extend(
                keys.into_iter().flat_map(|keys| keys.keys()).map(|key| (pointer.to_owned(), key.clone())),
            );
            let words = map.get("enum").and_then(Value::as_array).into_iter().flatten();
            found.extend(words.filter_map(Value::as_str).map(|word| (pointer.to_owned(), word.to_owned())));
            map.iter().for_each(|(key, inner)| names(&format!("{pointer}/{key}"), inner, found));
        }
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, inner)| names(&format!("{pointer}/{i}"), inner, found));
        }
        _ => {}
    }
}

/// The section of the documents that describes each part of a schema. Each entry has the schema, the beginning of the part's JSON
/// pointer, the document and the heading. The first matching entry is used.
const SECTIONS: [(&str, &str, &str, &str); 29] = [
    ("scenario", "/$defs/keyframe/properties/ease", "docs/scenario.md", "### Movements"),
    ("scenario", "/$defs/keyframe", "docs/scenario.md", "### A track"),
    ("scenario", "/$defs/point", "docs/scenario.md", "### A track"),
    ("scenario", "/$defs/piece", "docs/scenario.md", "### A track"),
    ("scenario", "/$defs/track", "docs/scenario.md", "### A track"),
    ("scenario", "/$defs/move", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/lease", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/tempo", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/order", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/off_grid", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/failure_word", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/on_", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/require", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/act", "docs/scenario.md", "### An act"),
    ("scenario", "/$defs/wait", "docs/scenario.md", "### An act"),
    ("scenario", "/$defs/cue", "docs/scenario.md", "### A cue"),
    ("scenario", "/$defs/formation", "docs/scenario.md", "### A formation"),
    ("scenario", "/$defs/path", "docs/scenario.md", "### A path"),
    ("scenario", "/$defs/by", "docs/scenario.md", "### Patterns over a group"),
    ("scenario", "/$defs/canon", "docs/scenario.md", "### Patterns over a group"),
    ("scenario", "/$defs/direction", "docs/scenario.md", "### Patterns over a group"),
    ("scenario", "/$defs/spread", "docs/scenario.md", "### Patterns over a group"),
    ("scenario", "/$defs/included", "docs/scenario.md", "### The scenario"),
    ("scenario", "/$defs/override", "docs/scenario.md", "### Moves, and what"),
    ("scenario", "/$defs/", "docs/scenario.md", "### Moves, and what"),
    ("scenario", "", "docs/scenario.md", "### The scenario"),
    ("fleet", "/$defs/device", "docs/edge.md", "## Thrift robots"),
    ("fleet", "/$defs/robot/properties/clock", "docs/scenario.md", "### The fleet file"),
    ("fleet", "", "docs/scenario.md", "### The fleet file"),
];

/// Returns the words of all code in a section, in backticks or in code blocks.
fn code(document: &str, heading: &str) -> BTreeSet<String> {
    let from = match document.rfind(&format!("\n{heading}")) {
        Some(from) => &document[from + 1..],
        None => panic!("no section `{heading}`"),
    };
    let next = from[3..].find("\n## ").into_iter().chain(from[3..].find("\n### ")).min();
    let until = next.map_or(from.len(), |at| at + 3);
    let (mut text, mut in_block) = (String::new(), false);
    for line in from[..until].lines() {
        match (line.starts_with("```"), in_block) {
            (true, _) => in_block = !in_block,
            (false, true) => text.push_str(line),
            (false, false) => quoted(line).for_each(|word| {
                text.push_str(word);
                text.push(' ');
            }),
        }
        text.push('\n');
    }
    text.split(|c: char| !c.is_alphanumeric() && c != '_').map(str::to_owned).collect()
}

#[test]
fn reference_names_every_key_and_value_in_its_section() {
    for of in ["scenario", "fleet"] {
        let mut found = Vec::new();
        names("", &schema(of), &mut found);
        for (pointer, name) in found {
            let section = SECTIONS.iter().find(|(which, at, ..)| *which == of && pointer.starts_with(at));
            let (_, _, document, heading) = section.unwrap();
            // Directions such as `-x` are words with a sign.
            let word = name.trim_start_matches('-');
            let known = code(&format!("\n{}", read(document)), heading).contains(word);
            assert!(known, "{document}, section `{heading}`, does not name `{name}` of {of}.json{pointer}");
        }
    }
}

#[test]
fn fuzzer_dictionaries_contain_every_key() {
    for (dictionary, of) in [("fuzz/urrcp.dict", "protocol"), ("fuzz/keys.dict", "scenario")] {
        let words: BTreeSet<String> =
            read(dictionary).split(|c: char| !c.is_alphanumeric() && c != '_').map(str::to_owned).collect();
        let mut found = Vec::new();
        names("", &schema(of), &mut found);
        let missing: BTreeSet<_> =
            found.into_iter().map(|(_, name)| name).filter(|name| !words.contains(name)).collect();
        assert_eq!(missing, BTreeSet::new(), "{dictionary} lacks keys or words of {of}");
    }
}
