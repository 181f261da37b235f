//! The names in reports and recordings must match the lists in their schema and in the documents exactly. The lists come from the types
//! themselves, so a new variant fails here until it is listed everywhere.

use std::collections::BTreeSet;

use downbeat_fleet::fleet::LatencySource;
use serde::de::{DeserializeOwned, Deserializer, Error, Visitor};
use serde_json::Value;
use strum::VariantNames;

use crate::report::{
    ActReport, ActRobot, DeviceReport, DeviceState, Outcome, RobotReport, SCHEMA, StopState,
};
use crate::requirements::Judgement;
use crate::robot_state::Standing;
use crate::{
    ActFate, Check, Claim, ClockMode, FailureKind, Greeting, LeadTime, Progress, Record, SkewBudget, Slow,
    TransferReport, Verdict,
};

const CHECKS: &str = "/$defs/preflight/properties/rows/items/properties/checks/items/prefixItems";

/// The lists of variants in the schema, by their JSON pointers, each with the names of the type's variants.
fn listed_in_schema() -> Vec<(String, &'static [&'static str])> {
    let at = |pointer: &str| format!("/$defs/{pointer}");
    vec![
        (at("outcome"), Outcome::VARIANTS),
        (at("device/properties/state"), DeviceState::VARIANTS),
        (at("stop"), StopState::VARIANTS),
        (at("robot/properties/standing"), Standing::VARIANTS),
        (at("robot/properties/clock_mode"), &CLOCK_MODES),
        (at("robot/properties/latency_differs/items/properties/from"), &LATENCY_SOURCES),
        (at("failure/properties/failure"), FailureKind::VARIANTS),
        (at("failure/properties/claim"), Claim::VARIANTS),
        (at("failure/properties/slow"), Slow::VARIANTS),
        (at("preflight/properties/greeting"), Greeting::VARIANTS),
        (at("course/properties/fate"), ActFate::VARIANTS),
        (at("transfer"), TransferReport::VARIANTS),
        (at("judged/properties/result"), Judgement::VARIANTS),
        (format!("{CHECKS}/0"), Check::VARIANTS),
        (format!("{CHECKS}/1/properties/verdict"), Verdict::VARIANTS),
    ]
}

/// The clock modes. They must be listed by hand, because the type is from another crate. If it gains a variant, this list does not
/// compile.
const CLOCK_MODES: [&str; 2] = [clock_mode(ClockMode::Ntp), clock_mode(ClockMode::Measured)];

const fn clock_mode(mode: ClockMode) -> &'static str {
    match mode {
        ClockMode::Ntp => "ntp",
        ClockMode::Measured => "measured",
    }
}

/// The latency sources, listed by hand for the same reason as `CLOCK_MODES`.
const LATENCY_SOURCES: [&str; 3] = [
    latency_source(LatencySource::Fleet),
    latency_source(LatencySource::File),
    latency_source(LatencySource::Robot),
];

const fn latency_source(source: LatencySource) -> &'static str {
    match source {
        LatencySource::Fleet => "fleet",
        LatencySource::File => "file",
        LatencySource::Robot => "robot",
    }
}

fn schema() -> Value {
    serde_json::from_str(SCHEMA).unwrap()
}

/// Collects the words that a part of the schema permits. For an object with one required key, these are that key or the values of its
/// `state`.
fn words(schema: &Value, found: &mut BTreeSet<String>) {
    let text = |word: &Value| word.as_str().map(str::to_owned);
    found.extend(schema["enum"].as_array().into_iter().flatten().filter_map(text));
    found.extend(schema.get("const").and_then(text));
    schema["anyOf"].as_array().into_iter().flatten().for_each(|form| words(form, found));
    match (&schema["properties"]["state"], &schema["properties"]) {
        (Value::Null, Value::Object(keys)) => found.extend(keys.keys().cloned()),
        (state, _) => {
            if !state.is_null() {
                words(state, found);
            }
        }
    }
}

/// The keys of a struct in JSON, as `Deserialize` names them.
fn keys_of<T: DeserializeOwned>() -> BTreeSet<String> {
    struct Keys<'a>(&'a mut BTreeSet<String>);

    impl<'de> Deserializer<'de> for Keys<'_> {
        type Error = serde::de::value::Error;

        fn deserialize_struct<V: Visitor<'de>>(
            self,
            _: &'static str,
            fields: &'static [&'static str],
            _: V,
        ) -> Result<V::Value, Self::Error> {
            *self.0 = set(fields);
            Err(Error::custom("only the keys are read"))
        }

        fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Self::Error> {
            Err(Error::custom("expected a struct"))
        }

        serde::forward_to_deserialize_any! {
            bool i8 i16 i32 i64 u8 u16 u32 u64 f32 f64 char str string bytes byte_buf option unit unit_struct
            newtype_struct seq tuple tuple_struct map enum identifier ignored_any
        }
    }

    let mut keys = BTreeSet::new();
    assert!(T::deserialize(Keys(&mut keys)).is_err());
    keys
}

#[test]
fn report_schema_lists_every_key_and_no_other() {
    let schema = schema();
    for (pointer, keys) in [
        ("robot", keys_of::<RobotReport>()),
        ("act", keys_of::<ActReport>()),
        ("act/properties/robots/items", keys_of::<ActRobot>()),
        ("device", keys_of::<DeviceReport>()),
        ("lead", keys_of::<LeadTime>()),
        ("skew", keys_of::<SkewBudget>()),
    ] {
        let listed = schema.pointer(&format!("/$defs/{pointer}/properties")).and_then(Value::as_object);
        let listed: BTreeSet<String> =
            listed.unwrap_or_else(|| panic!("no {pointer}")).keys().cloned().collect();
        assert_eq!(listed, keys, "schema.json, {pointer}");
    }
}

fn set(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

#[test]
fn report_schema_lists_every_kind_and_no_other() {
    let schema = schema();
    for (pointer, variants) in listed_in_schema() {
        let mut listed = BTreeSet::new();
        words(schema.pointer(&pointer).unwrap_or_else(|| panic!("no {pointer}")), &mut listed);
        assert_eq!(listed, set(variants), "schema.json{pointer}");
    }
}

#[test]
fn every_enum_in_the_report_schema_is_compared_with_a_type() {
    fn lists(pointer: &str, schema: &Value, found: &mut Vec<String>) {
        match schema {
            Value::Object(map) => {
                found.extend(map.contains_key("enum").then(|| pointer.to_owned()));
                map.iter().for_each(|(key, inner)| lists(&format!("{pointer}/{key}"), inner, found));
            }
            Value::Array(items) => {
                items
                    .iter()
                    .enumerate()
                    .for_each(|(i, inner)| lists(&format!("{pointer}/{i}"), inner, found));
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    lists("", &schema(), &mut found);
    // A test of the command line compares the words that `downbeat stop` reports for robots within a process.
    let inside = ("/properties/inside/items/properties/what".to_owned(), [].as_slice());
    let compared = [listed_in_schema(), vec![inside]].concat();
    for pointer in found {
        let known = compared.iter().any(|(compared, _)| pointer.starts_with(compared.as_str()));
        assert!(known, "schema.json{pointer} is compared with no type");
    }
}

fn document(name: &str) -> String {
    let path = format!("{}/../../docs/{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The words in backticks in the first column of the table with this header row.
fn column(document: &str, head: &str) -> BTreeSet<String> {
    let rows = document.lines().skip_while(|line| !line.starts_with(head));
    let rows = rows.take_while(|line| line.starts_with('|')).skip(2);
    let cells = rows.filter_map(|row| row.split('|').nth(1));
    cells.flat_map(|cell| cell.split('`').skip(1).step_by(2)).map(str::to_owned).collect()
}

#[test]
fn recording_document_lists_every_record_and_progress_kind() {
    let recording = document("recording.md");
    assert_eq!(column(&recording, "| `record` |"), set(Record::VARIANTS), "docs/recording.md");
    assert_eq!(column(&recording, "| `progress` |"), set(Progress::VARIANTS), "docs/recording.md");
}

#[test]
fn mission_document_names_every_outcome_script_state_and_act_fate() {
    let mission = document("mission.md");
    let named = [Outcome::VARIANTS, DeviceState::VARIANTS, ActFate::VARIANTS].concat();
    for name in named {
        assert!(mission.contains(&format!("`{name}`")), "docs/mission.md does not name `{name}`");
    }
}
