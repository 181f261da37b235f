//! Checks that the schemas list the keys and words that the reader knows, each at its place, and vice versa. The reader's keys and words
//! are recorded while it reads documents that contain every map, and every key with words, once.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::*;
use crate::finding::PathStep;
use crate::{Files, Finding, Fleet, Project, Source, compile, read_fleet_within, read_world};
use downbeat_reader::known::{self, Known};

/// Documents that together contain every map of a scenario. They need not be valid.
const SCENARIOS: [&str; 5] = [
    "
scenario: all keys
fleet: fleet.yaml
variables: {v: 1}
include: [{file: arm.yaml, as: left, parameters: {side: 1}}]
moves:
  lift: {doc: Lifts., parameters: {to: 1}, tracks: {d: [{at: 0s, to: $to, ease: linear}]}}
  lifts: {play: [{move: lift, parameters: {to: 2}, tracks: {e: [{at: 0s, to: 1}]}, devices: {d: c}, scale: 1, mirror: true,
    reverse: true, repeat: 2, duration: 1s, at: 1s, delay: 1s}]}
sequences: {greet: {doc: Greets., parameters: {to: 1}, cues: [{cue: inner}]}}
roles: {leader: arm}
formations:
  spots: {points: [[0, 0, 1]], at: [0, 0, 0], rotate: 90, scale: 1}
  row: {line: {spacing: 1, length: 1}, rotate: [0, 0, 90]}
  ring: {circle: {radius: 1, spacing: 1}}
  block: {grid: {spacing: 1, columns: 1, rows: 1}}
  geese: {v: {spacing: 1, angle: 60}}
  ball: {sphere: {radius: 1}}
  word: {text: GO, size: 2}
  logo: {svg: logo.svg, size: 2}
  statue: {cloud: statue.ply, size: 2}
paths:
  way: {points: [[0, 0, 0], [1, 0, 0], [1, 1, 0]], closed: true, rotate: 90, scale: 2}
  lap: {circle: {radius: 1}}
tempo: [{at: bar 1, bpm: 120, signature: 4/4}]
signature: 4/4
zones: {table: auto}
order: given
off_grid: snap
start_tolerance: 1ms
lead: 1s
stop_condition: {pending: none, running: 2s}
on_failure: {default: stop, then: end}
on_doubt: start
at_end: {home: 9s}
require: {all_or_none: strict, spread_p50: below 1ms, spread_p99: at most 5ms, spread_max: below 9ms, starts: above 99.9%, finishes: at least 99%, closest: above 0.3m}
acts:
  - act: one
    wait: {for: operator, timeout: 1s, otherwise: end}
    next: end
    on_failure: stop
    on_doubt: withdraw
    zones: [lift]
    order: auto
    tempo: 120
    signature: 4/4
    cues:
      - {cue: first, robots: arm, tracks: {d: [{at: 0s, to: 1}]}}
      - cue: every
        at: 0s
        after: first
        with: first
        before: last
        end_by: 9s
        duration: 2s
        robots: arm
        move: lift
        parameters: {to: 2}
        tracks: {e: [{at: 0s, to: 1}, {at: 1s, to: 2}]}
        devices: {d: c}
        mirror: {about: 1, devices: [e]}
        scale: {by: 1, about: 1, devices: [e]}
        reverse: false
        repeat: {for: 3s}
        canon: 1s
        overrides: {arm: {move: lift, parameters: {to: 2}, tracks: {e: [{at: 0s, to: 1}]}, devices: {d: c},
          mirror: true, scale: 1, reverse: true, repeat: {until: 9s}, delay: 1s}}
        uses: table
        apart: first
        stop_condition: 1s
        off_grid: refuse
        tolerance: 1
        read: {s: 0s}
        form: {to: ring, least: longest, spare: stay, thin: evenly}
        over: 2s
      - {cue: played, sequence: greet, parameters: {to: 2}}
  - {act: two, wait: {time: '19:30:00'}, cues: [{cue: last, robots: arm, turn: {by: 90, about: [0, 0]}, grow: 2, shift: [0, 0, 1], along: {path: way, laps: 2, turning: true, follow: false}, over: 2s}]}
  - {act: three, wait: {sensor: arm/s, above: 1, below: 2, within: [0, 1]}, cues: [{cue: last}]}
  - {act: four, wait: done, cues: [{cue: last}]}
",
    "
scenario: all movements
cues:
  - robots: arm
    tracks:
      a: {control: position, tolerance: 1, max_steps: 2, keyframes: [{at: 0s, to: 1, ease: smooth}]}
      b: {spline: [{at: 0s, to: 1}, {at: 1s, to: 2}]}
      c: {polynomial: [{for: 1s, coefficients: [1]}]}
      d: {wave: {amplitude: 1, period: 1s, phase: 0, center: 0, for: 1s}}
      e: {travel: {from: 0, speed: 1, acceleration: 1, for: 1s}}
      f: {samples: {file: a.csv, time: t, value: v, time_unit: ms, scale: 1, ease: step}}
      g: {formula: t / 1s, for: 1s}
",
    "
scenario: patterns
cues:
  - robots: arm
    canon: {step: 1s, speed: 1, over: 1s, by: x, seed: 1, direction: outward}
    repeat: {times: 2, every: 1s}
    tracks: {d: [{at: 0s, to: {from: 1, to: 2, across: group, by: index, seed: 1, direction: inward, ease: smooth}}]}
",
    "
scenario: an include
include: shared.yaml
cues: [{cue: mark}]
",
    "
scenario: another wave
cues:
  - {robots: arm, tracks: {d: {wave: {amplitude: 1, frequency: 1, for: 1s}}}}
",
];

/// A fleet file that contains every map. The descriptions of its robots are those of other tests.
const FLEET: &str = "
ntp: pool.ntp.org
handshake: full
identity: anna.pem
revoked: revoked.pem
zenoh: zenoh.json5
insecure: false
latency: latency.yaml
space: {distance: 1, keep_in: {x: [0, 1], y: [0, 1], z: [0, 1]}, keep_out: {pillar: {x: [0, 1]}}}
robots:
  thrift:
    init: FINDINGS/../../../processes/thrift/tank.json
    address: thrift://192.0.2.7:9090
    devices:
      left: {control_type: speed, granularity: 1, unit: deg, max_number_of_steps: 9, interpolation: hold,
        min_value: 0, max_value: 1, default_value: 0, max_error: 1, script_queue: 2}
    body: {urdf: arm.urdf, end: hand, devices: {elbow: left}, drive: {speed: left, turn: left}}
  rover:
    init: FINDINGS/robots/rover.yaml
    address: sim
    robot_id: another
    limits: {wheel: {speed: 1, acceleration: 1}}
    clock: measured
    wake_up: 1ms
    latency: {wheel: {median: 41ms, spread: 3ms}}
    encoding: json
    body: {x: {device: wheel, scale: 1, offset: 1}, y: wheel, z: 1, yaw: 0, radius: 1, size: [1, 1, 1], speed: 1, acceleration: 1,
      joints: [{device: wheel, value: 0, scale: 1, offset: 0, axis: -z, at: [0, 0, 1], rpy: [0, 0, 0], kind: prismatic, radius: 1}],
      tip: [0, 0, 1],
      drive: {left: wheel, right: {device: wheel, scale: 1}, wheel_radius: 1, track: 1, start: [0, 0, 0]}}
    require: {range: {above: 1, below: 2, within: [0, 1]}}
    simulate: {clock_offset: 1ms, drift: 5ppm, jitter: 1us, ntp_error: none, delay: [0ms, 1ms], fault: refuse,
      readings: {range: 1}, moves: {wheel: {latency: 1ms, spread: 1ms, time_constant: 1ms, sensor: range, noise: 0, delay: 1ms}}}
    calibrate: {wheel: {sensor: range, from: 0, by: 1, taken: request, sensor_delay: 1ms, visible: 0.1}}
groups: {all: [rover]}
";

/// Objects of a schema that have user-defined keys besides the listed ones. Their keys are not compared.
const FREE_KEYS: [&str; 1] = ["/$defs/on_failure/anyOf/1"];

/// A part of a schema with its JSON pointer.
type SchemaPart<'s> = (String, &'s Value);

/// Returns the possible forms of a value: follows references, and returns one form for each alternative.
fn forms<'s>(root: &'s Value, (pointer, schema): SchemaPart<'s>) -> Vec<SchemaPart<'s>> {
    if let Some(reference) = schema["$ref"].as_str() {
        let pointer = reference.trim_start_matches('#').to_owned();
        let target = root.pointer(&pointer).unwrap_or_else(|| panic!("{reference} leads nowhere"));
        return forms(root, (pointer, target));
    }
    let mut all = vec![(pointer.clone(), schema)];
    for word in ["anyOf", "oneOf"] {
        for (index, form) in schema[word].as_array().into_iter().flatten().enumerate() {
            if form.get("required").is_none() || form.get("type").is_some() {
                all.extend(forms(root, (format!("{pointer}/{word}/{index}"), form)));
            }
        }
    }
    all
}

/// Returns the parts of a schema that describe values one step further down than the parts `above`.
fn below<'s>(root: &'s Value, above: &[SchemaPart<'s>], step: &PathStep) -> Vec<SchemaPart<'s>> {
    let inner = |(pointer, schema): &SchemaPart<'s>| {
        let (at, inner) = match step {
            PathStep::Index(_) => (format!("{pointer}/items"), schema.get("items")?),
            PathStep::Key(key, _) => match schema["properties"].get(key) {
                Some(inner) => (format!("{pointer}/properties/{key}"), inner),
                None => (format!("{pointer}/additionalProperties"), schema.get("additionalProperties")?),
            },
        };
        Some((at, inner))
    };
    above.iter().filter_map(inner).flat_map(|part| forms(root, part)).collect()
}

/// The lists of keys or words in a schema, by JSON pointer.
type Lists = BTreeMap<String, BTreeSet<String>>;

/// Collects every list of keys and words in a schema.
fn listed(pointer: &str, schema: &Value, lists: &mut Lists) {
    match schema {
        Value::Object(map) => {
            if let Some(Value::Object(properties)) = map.get("properties") {
                lists.insert(pointer.to_owned(), properties.keys().cloned().collect());
            }
            if let Some(Value::Array(words)) = map.get("enum") {
                lists.insert(pointer.to_owned(), words.iter().filter_map(text).collect());
            }
            map.iter().for_each(|(key, inner)| listed(&format!("{pointer}/{key}"), inner, lists));
        }
        Value::Array(items) => {
            for (index, inner) in items.iter().enumerate() {
                listed(&format!("{pointer}/{index}"), inner, lists);
            }
        }
        _ => {}
    }
}

fn text(value: &Value) -> Option<String> {
    value.as_str().map(str::to_owned)
}

/// Returns the lists of permitted keys and words that the reader has used to check files. Each list is stored under the place in the schema
/// that describes it.
fn known(root: &Value, recorded: Vec<Known>) -> Lists {
    let mut lists = Lists::new();
    for known in recorded {
        let (kind, place, known) = match known {
            Known::Keys(place, keys) => ("properties", place, keys),
            Known::Words(place, words) => ("enum", place, words),
        };
        // The schema does not describe included files.
        if place.file != 0 {
            continue;
        }
        let mut parts = forms(root, (String::new(), root));
        for step in &place.path {
            parts = below(root, &parts, step);
        }
        // If several forms have lists, selects the form that was read.
        let same = |schema: &Value| match &schema[kind] {
            Value::Object(keys) => known.iter().all(|key| keys.contains_key(*key)),
            _ => true,
        };
        let listing = || parts.iter().filter(|(_, schema)| schema.get(kind).is_some());
        let described = listing().find(|(_, schema)| same(schema)).or_else(|| listing().next());
        let (pointer, _) = described.unwrap_or_else(|| {
            panic!("the schema lists no {kind} where the reader knows {known:?}: {place:?}")
        });
        lists.entry(pointer.clone()).or_default().extend(known.into_iter().map(str::to_owned));
    }
    lists
}

#[track_caller]
fn check(of: Schema, recorded: Vec<Known>) {
    let root: Value = serde_json::from_str(schema(of)).unwrap();
    let mut listed_by_schema = Lists::new();
    listed("", &root, &mut listed_by_schema);
    let known_by_reader = known(&root, recorded);
    for (pointer, list) in &listed_by_schema {
        let reader = known_by_reader.get(pointer);
        let free = FREE_KEYS.contains(&pointer.as_str());
        assert!(
            free || reader == Some(list),
            "{of:?}{pointer}: the schema lists {list:?}, the reader knows {reader:?}"
        );
    }
}

#[test]
fn scenario_schema_matches_its_reader() {
    let known = known::while_reading(|| {
        for text in SCENARIOS {
            let _compiled =
                compile(&Source { name: "all.yaml".into(), text: text.to_owned() }, &fleet(), &OneFile);
        }
    });
    check(Schema::Scenario, known);
}

/// A source of files that returns the same file for every name.
struct OneFile;

impl Files for OneFile {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        Ok(Source { name: name.to_owned(), text: "parameters: {side: 1}\n".to_owned() })
    }
}

fn fleet() -> Fleet {
    Fleet { robots: vec![crate::tests::robot()], ..Fleet::default() }
}

#[test]
fn fleet_schema_matches_its_reader() {
    let findings = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/sessions/findings/folder");
    let text = FLEET.replace("FINDINGS", findings);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fleet.yaml");
    std::fs::write(&path, &text).unwrap();
    // The URDF is in the repository.
    let project = Project::within(std::path::Path::new("/")).unwrap();
    let known = known::while_reading(|| drop(read_fleet_within(&path, &project)));
    check(Schema::Fleet, known);
}

/// A world that contains every map. It need not be valid.
const WORLD: &str = "
world: all keys
links:
  all: {delay: {from: 1ms, to: 2ms}, jitter: 1ms, loss: 1%, resent_after: 200ms, interruptions: [{every: 9s, lasts: 1s}]}
  arm: {delay: {least: 1ms, p50: 2ms, p90: 3ms, p99: 4ms, largest: 5ms}}
clocks: {all: {offset: {from: -1ms, to: 1ms}, drift: {from: 1ppm, to: 2ppm}, error: 1ms}}
sensors: {arm/s: {from: 1, to: 2}, arm/t: [[0s, 1]]}
operator: {go_after: 1s, never: 0.1}
incidents:
  - {robot: arm, what: dies, act: one, at: 1s, back_after: 2s, probability: 10%}
  - {robot: all, what: stalls, lasts: 1s}
";

#[test]
fn world_schema_matches_its_reader() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("world.yaml");
    std::fs::write(&path, WORLD).unwrap();
    let known = known::while_reading(|| drop(read_world(&path, &fleet(), &["one"])));
    check(Schema::World, known);
}
