//! Checks the files that are generated from the declarations of keys: the schemas, the tables of keys in the documentation, and a
//! dictionary for the fuzzer. `DOWNBEAT_BLESS=1` rewrites these files.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use serde_json::Value;

use super::maps::{all_maps, collect};
use crate::keys::{Declaration, Key, Kind};
use crate::{fleet, scenario};
use downbeat_fleet::world::world_keys;

/// A JSON document whose objects keep their order.
enum Json {
    Object(Vec<(String, Json)>),
    Array(Vec<Json>),
    Leaf(Value),
}

impl Json {
    fn text(text: &str) -> Self {
        Self::Leaf(text.into())
    }

    fn texts<'a>(texts: impl IntoIterator<Item = &'a str>) -> Self {
        Self::Array(texts.into_iter().map(Self::text).collect())
    }

    /// Parses the part of a schema that a declaration contains as text.
    fn parse(text: &str) -> Self {
        let value = serde_json::from_str(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        Self::of(value)
    }

    fn of(value: Value) -> Self {
        match value {
            Value::Object(map) => {
                let sorted: BTreeMap<_, _> = map.into_iter().collect();
                Self::Object(sorted.into_iter().map(|(key, value)| (key, Self::of(value))).collect())
            }
            Value::Array(items) => Self::Array(items.into_iter().map(Self::of).collect()),
            leaf => Self::Leaf(leaf),
        }
    }

    fn write(&self, indent: usize, out: &mut String) {
        let line = |out: &mut String, index: usize, more: usize| {
            out.push_str(if index == 0 { "\n" } else { ",\n" });
            out.push_str(&" ".repeat(indent + more));
        };
        match self {
            Self::Object(entries) if !entries.is_empty() => {
                out.push('{');
                for (index, (key, value)) in entries.iter().enumerate() {
                    line(out, index, 1);
                    write!(out, "{}: ", Value::from(key.as_str())).unwrap();
                    value.write(indent + 1, out);
                }
                write!(out, "\n{}}}", " ".repeat(indent)).unwrap();
            }
            Self::Array(items) if !items.is_empty() => {
                out.push('[');
                for (index, item) in items.iter().enumerate() {
                    line(out, index, 1);
                    item.write(indent + 1, out);
                }
                write!(out, "\n{}]", " ".repeat(indent)).unwrap();
            }
            Self::Object(_) => out.push_str("{}"),
            Self::Array(_) => out.push_str("[]"),
            Self::Leaf(value) => write!(out, "{value}").unwrap(),
        }
    }
}

/// Joins the lines of a doc comment up to the first empty line.
fn summary(doc: &[&str]) -> String {
    let lines: Vec<&str> = doc.iter().map(|line| line.trim()).skip_while(|line| line.is_empty()).collect();
    let end = lines.iter().position(|line| line.is_empty()).unwrap_or(lines.len());
    lines[..end].join(" ")
}

/// A schema with its definitions.
#[derive(Default)]
struct Definitions {
    found: Vec<(String, Json)>,
}

impl Definitions {
    fn reference(&mut self, name: &str, define: impl FnOnce(&mut Self) -> Vec<(String, Json)>) -> Json {
        if !self.found.iter().any(|(known, _)| known == name) {
            let index = self.found.len();
            self.found.push((name.to_owned(), Json::Object(Vec::new())));
            self.found[index].1 = Json::Object(define(self));
        }
        Json::Object(vec![("$ref".to_owned(), Json::text(&format!("#/$defs/{name}")))])
    }

    fn of_kind(&mut self, kind: &'static Kind) -> Json {
        let object = |entries: Vec<(&str, Json)>| {
            Json::Object(entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect())
        };
        match kind {
            Kind::Named { name, doc, kind } => self.reference(&name.to_lowercase(), |definitions| {
                described(definitions.of_kind(kind), &summary(doc))
            }),
            Kind::Keys(of) => match of().definition {
                Some(name) => self.reference(name, |definitions| definitions.of_map(of(), None, None)),
                None => Json::Object(self.of_map(of(), None, None)),
            },
            Kind::KeysOf(of, kind) => Json::Object(self.of_map(of(), Some(kind), None)),
            Kind::KeysAnd(of, kind) => Json::Object(self.of_map(of(), None, Some(kind))),
            Kind::Entries(kind) => {
                object(vec![("type", Json::text("object")), ("additionalProperties", self.of_kind(kind))])
            }
            Kind::SomeEntries(kind) => object(vec![
                ("type", Json::text("object")),
                ("additionalProperties", self.of_kind(kind)),
                ("minProperties", Json::Leaf(1.into())),
            ]),
            Kind::List(kind, count) => {
                let mut list = vec![("type", Json::text("array")), ("items", self.of_kind(kind))];
                let bounds = [("minItems", *count.start(), 0), ("maxItems", *count.end(), usize::MAX)];
                let bounds = bounds.into_iter().filter(|(_, bound, none)| bound != none);
                list.extend(bounds.map(|(word, bound, _)| (word, Json::Leaf(bound.into()))));
                object(list)
            }
            Kind::Tuple(kinds) => {
                let kinds: Vec<Json> = kinds.iter().map(|kind| self.of_kind(kind)).collect();
                let count = || Json::Leaf(kinds.len().into());
                let (least, most) = (count(), count());
                object(vec![
                    ("type", Json::text("array")),
                    ("minItems", least),
                    ("maxItems", most),
                    ("prefixItems", Json::Array(kinds)),
                ])
            }
            Kind::Words(words) => object(vec![("enum", Json::texts(words.iter().copied()))]),
            Kind::Name(_, kind) | Kind::NameKeys(_, kind) => self.of_kind(kind),
            Kind::AnyOf(kinds) => {
                object(vec![("anyOf", Json::Array(kinds.iter().map(|kind| self.of_kind(kind)).collect()))])
            }
            Kind::Schema(json) => Json::parse(json),
        }
    }

    /// Describes a map. `values` is the kind of all its values, if they share one. `others` is the kind of values of other keys, if such
    /// keys are allowed.
    fn of_map(
        &mut self,
        map: &'static Declaration,
        values: Option<&'static Kind>,
        others: Option<&'static Kind>,
    ) -> Vec<(String, Json)> {
        let mut object = vec![("type".to_owned(), Json::text("object"))];
        object = described(Json::Object(object), &summary(map.doc));
        let property = |key: &'static Key| {
            let of_kind = self.of_kind(values.unwrap_or(key.kind));
            let default = key.default().map(|default| format!(" Default: {default}.")).unwrap_or_default();
            (key.name.to_owned(), Json::Object(described(of_kind, &format!("{}{default}", summary(key.doc)))))
        };
        object.push(("properties".to_owned(), Json::Object(map.keys.iter().map(property).collect())));
        let required: Vec<&str> = map.keys.iter().filter(|key| key.required).map(|key| key.name).collect();
        if !required.is_empty() {
            object.push(("required".to_owned(), Json::texts(required)));
        }
        let others = others.map_or(Json::Leaf(false.into()), |kind| self.of_kind(kind));
        object.push(("additionalProperties".to_owned(), others));
        if let Some(Json::Object(also)) = map.also.map(Json::parse) {
            object.extend(also);
        }
        object
    }
}

/// Adds a description to the schema of an object, unless the description is empty.
fn described(schema: Json, text: &str) -> Vec<(String, Json)> {
    let Json::Object(mut entries) = schema else { panic!("a schema is an object") };
    if !text.is_empty() {
        let position = entries.len().min(1);
        entries.insert(position, ("description".to_owned(), Json::text(text)));
    }
    entries
}

fn schema_text(root: &'static Declaration, id: &str, title: &str) -> String {
    let mut definitions = Definitions::default();
    let map = definitions.of_map(root, None, None);
    let head = [("$schema", "https://json-schema.org/draft/2020-12/schema"), ("$id", id), ("title", title)];
    let mut schema: Vec<_> = head.map(|(key, text)| (key.to_owned(), Json::text(text))).into();
    schema.extend(map);
    schema.push(("$defs".to_owned(), Json::Object(definitions.found)));
    let mut text = String::new();
    Json::Object(schema).write(0, &mut text);
    text.push('\n');
    text
}

/// Collects the words that values of a kind may be.
fn words_of(kind: &'static Kind, words: &mut BTreeSet<&'static str>) {
    match kind {
        Kind::Words(all) => words.extend(*all),
        Kind::Entries(kind)
        | Kind::SomeEntries(kind)
        | Kind::List(kind, _)
        | Kind::KeysAnd(_, kind)
        | Kind::Name(_, kind)
        | Kind::NameKeys(_, kind) => {
            words_of(kind, words);
        }
        Kind::Tuple(kinds) | Kind::AnyOf(kinds) => kinds.iter().for_each(|kind| words_of(kind, words)),
        Kind::Named { kind, name, .. } if !["TIME", "NUMBER", "SPREAD_END"].contains(name) => {
            words_of(kind, words);
        }
        _ => {}
    }
}

/// Returns the keys and words of scenarios and their included files, in the format of the fuzzer.
fn dictionary() -> String {
    let mut maps = Vec::new();
    [scenario::scenario_keys(), scenario::included_keys()]
        .into_iter()
        .for_each(|root| collect(root, &mut maps));
    let mut words = BTreeSet::new();
    let mut keys = BTreeSet::new();
    for key in maps.iter().flat_map(|map| map.keys) {
        keys.insert(key.name);
        words_of(key.kind, &mut words);
    }
    let keys = keys.iter().map(|key| format!("\"{key}: \"\n"));
    keys.chain(words.iter().map(|word| format!("\"{word}\"\n"))).collect()
}

/// Joins all lines of a doc comment, with all of its paragraphs, into one line.
fn whole(doc: &[&str]) -> String {
    let lines: Vec<&str> = doc.iter().map(|line| line.trim()).filter(|line| !line.is_empty()).collect();
    lines.join(" ")
}

/// Writes the rows of a table of keys. The keys of a map within a value follow the key of that value, as in `form.to`.
fn rows(map: &Declaration, prefix: &str, table: &mut String) {
    for key in map.keys {
        let mut text = whole(key.doc);
        if text.is_empty() {
            text = match key.kind {
                Kind::Named { doc, .. } => whole(doc),
                Kind::Keys(of) => whole(of().doc),
                _ => text,
            };
        }
        let mut words = BTreeSet::new();
        words_of(key.kind, &mut words);
        words.retain(|word| !text.contains(&format!("`{word}`")));
        if !words.is_empty() {
            let words: Vec<String> = words.iter().map(|word| format!("`{word}`")).collect();
            write!(text, " Words: {}.", words.join(", ")).unwrap();
        }
        let default = if key.required { "required" } else { key.default().unwrap_or_default() };
        writeln!(table, "| `{prefix}{}` | {text} | {default} |", key.name).unwrap();
        if let Some(inner) = inner(key.kind) {
            rows(inner, &format!("{prefix}{}.", key.name), table);
        }
    }
}

/// Returns the map that values of this kind contain, unless it also occurs in other kinds.
fn inner(kind: &Kind) -> Option<&'static Declaration> {
    match kind {
        Kind::Keys(of) => {
            Some(of()).filter(|map| map.definition.is_none_or(|name| name == "require" || name == "included"))
        }
        Kind::KeysAnd(of, _) => Some(of()),
        Kind::Named { kind, name, .. } if !["TIME", "NUMBER"].contains(name) => inner(kind),
        Kind::List(kind, _) | Kind::Name(_, kind) | Kind::NameKeys(_, kind) => inner(kind),
        Kind::AnyOf(kinds) => kinds.iter().find_map(|kind| inner(kind)),
        _ => None,
    }
}

/// Inserts into a document a table of keys for each map, between the comments that mark its place.
fn with_tables(document: &str, maps: &[(&str, &Declaration)]) -> String {
    let mut document = document.to_owned();
    for (name, map) in maps {
        let mark = format!("<!-- keys of {name}: generated -->\n");
        let from = document.find(&mark).unwrap_or_else(|| panic!("no {mark}")) + mark.len();
        let until = from + document[from..].find("<!-- end of keys -->").unwrap();
        let mut table = "\n| key | | default |\n|---|---|---|\n".to_owned();
        rows(map, "", &mut table);
        document.replace_range(from..until, &(table + "\n"));
    }
    document
}

/// Compares a file of the repository with the generated text; with `DOWNBEAT_BLESS=1`, writes the file instead.
#[track_caller]
fn check(path: &str, generated: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path);
    if std::env::var_os("DOWNBEAT_BLESS").is_some() {
        std::fs::write(&path, generated).unwrap();
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == generated,
        "{} is not what the declarations of keys say: DOWNBEAT_BLESS=1 cargo test -p downbeat-scripts --lib generated",
        path.display()
    );
}

#[test]
fn schemas_are_generated_from_keys() {
    let (scenario, fleet, world) = (scenario::scenario_keys(), fleet::fleet_keys(), world_keys());
    let of = |root, name: &str| {
        schema_text(root, &format!("urn:downbeat:{name}.json"), &format!("Downbeat {name}"))
    };
    check("scripts/src/schema/scenario.json", &of(scenario, "scenario"));
    check("scripts/src/schema/fleet.json", &of(fleet, "fleet"));
    check("scripts/src/schema/world.json", &of(world, "world"));
}

#[test]
fn fuzzer_dictionary_is_generated_from_keys() {
    check("fuzz/keys.dict", &dictionary());
}

#[test]
fn key_tables_are_generated_from_keys() {
    let path = "docs/scenario.md";
    let document =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)).unwrap();
    let maps = all_maps();
    let map = |first: &str, second: &str| {
        let found = maps.iter().find(|map| map.keys[0].name == first && map.keys[1].name == second);
        *found.unwrap_or_else(|| panic!("no map begins with `{first}` and `{second}`"))
    };
    let tables = [
        ("a scenario", map("scenario", "fleet")),
        ("an act", map("act", "cues")),
        ("a cue", map("cue", "at")),
        ("an entry of play", map("move", "parameters")),
    ];
    check(path, &with_tables(&document, &tables));
}

#[test]
fn every_key_is_documented() {
    let is_described =
        |key: &Key| !key.doc.is_empty() || matches!(key.kind, Kind::Named { .. } | Kind::Keys(_));
    for map in all_maps() {
        let silent: Vec<&str> =
            map.keys.iter().filter(|key| !is_described(key)).map(|key| key.name).collect();
        assert_eq!(silent, Vec::<&str>::new(), "without documentation: {}", summary(map.doc));
    }
}
