//! Tests with real networks and job shops: those in the fixtures and, if `DOWNBEAT_DATA` is set, those of the complete data set in that
//! folder.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde_json::Value;
use urrcp::Span;

use super::*;

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures")
}

/// Reads a bound in the notation of the data files: a number or "inf" for none.
fn bound(value: &Value) -> Option<Span> {
    value.as_f64().map(Span::from_millis_f64)
}

struct Real {
    network: Network,
    events: Vec<Event>,
}

/// Reads a network in either of the two file formats. Skips probability distributions, which have no bounds.
fn read(path: &Path) -> Real {
    let json: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let mut network = Network::new();
    let mut events: HashMap<String, Event> = HashMap::new();
    let mut list = Vec::new();
    let mut event = |network: &mut Network, name: &Value| {
        *events.entry(name.to_string()).or_insert_with(|| {
            list.push(network.event());
            list[list.len() - 1]
        })
    };
    let origin = network.origin();
    for node in json["nodes"].as_array().into_iter().flatten() {
        let at = event(&mut network, &node["node_id"]);
        network.constrain(origin, at, bound(&node["min_domain"]), bound(&node["max_domain"]));
    }
    for constraint in json["constraints"].as_array().into_iter().flatten() {
        let from = event(&mut network, &constraint["first_node"]);
        let to = event(&mut network, &constraint["second_node"]);
        network.constrain(from, to, bound(&constraint["min_duration"]), bound(&constraint["max_duration"]));
    }
    for constraint in json["instances"].as_array().into_iter().flatten().flat_map(|instance| {
        instance
            .as_object()
            .into_iter()
            .flat_map(|named| named.values())
            .flat_map(|list| list.as_array().unwrap())
    }) {
        let from = event(&mut network, &constraint["start_event_name"]);
        let to = event(&mut network, &constraint["end_event_name"]);
        let properties = &constraint["properties"];
        network.constrain(from, to, bound(&properties["lb"]), bound(&properties["ub"]));
    }
    Real { network, events: list }
}

fn json_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(json_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "json") {
            files.push(path);
        }
    }
    files
}

/// Checks that the network is consistent, and that a deadline one nanosecond before an event's earliest time is reported as a
/// contradiction.
fn check(path: &Path) {
    let real = read(path);
    let schedule = real.network.solve().unwrap_or_else(|conflict| panic!("{}: {conflict:?}", path.display()));
    let moved = real.events.iter().filter(|event| schedule.time(**event) > Span::ZERO);
    for &event in moved {
        let mut tightened = real.network.clone();
        let latest = schedule.time(event) - Span::from_nanos(1);
        let deadline = tightened.constrain(tightened.origin(), event, None, Some(latest));
        let conflict = tightened.solve().unwrap_err();
        assert!(conflict.chain.iter().any(|link| link.constraint == Some(deadline)), "{conflict:?}");
        assert_eq!(conflict.excess, Span::from_nanos(1));
        assert!(conflict.corrections.iter().any(|correction| {
            conflict.chain[correction.link].constraint == Some(deadline) && correction.by == conflict.excess
        }));
    }
}

#[test]
fn real_networks_are_consistent_and_too_tight_deadlines_are_explained() {
    for path in json_files(&fixtures().join("stn")) {
        check(&path);
    }
    let Some(data) = std::env::var_os("DOWNBEAT_DATA") else { return };
    let all = json_files(&Path::new(&data).join("heatlab-dream-stn"));
    assert_eq!(all.len(), 26);
    for path in all {
        check(&path);
    }
}

/// Reads a job shop with an optional deadline, and its proven optimum; times are in milliseconds.
fn shop(name: &str, deadline: Option<i64>) -> (Network, Vec<Task>, i64) {
    let text = std::fs::read_to_string(fixtures().join("jobshop/instances.json")).unwrap();
    let all: Value = serde_json::from_str(&text).unwrap();
    let shop = &all[name];
    let mut network = Network::new();
    let mut tasks = Vec::new();
    let rows =
        shop["duration_matrix"].as_array().unwrap().iter().zip(shop["machines_matrix"].as_array().unwrap());
    for (durations, machines) in rows {
        let mut last = network.origin();
        for (duration, machine) in durations.as_array().unwrap().iter().zip(machines.as_array().unwrap()) {
            let (start, end) = (network.event(), network.event());
            let duration = Span::from_millis(duration.as_i64().unwrap());
            network.constrain(start, end, Some(duration), Some(duration));
            network.constrain(last, start, Some(Span::ZERO), None);
            tasks.push(Task { start, end, zone: usize::try_from(machine.as_u64().unwrap()).unwrap() });
            last = end;
        }
        network.constrain(network.origin(), last, None, deadline.map(Span::from_millis));
    }
    (network, tasks, shop["metadata"]["optimum"].as_i64().unwrap())
}

#[test]
fn optimum_of_ft06_is_found_and_earlier_deadline_is_not_met() {
    let found = |deadline| {
        let (network, tasks, _) = shop("ft06", deadline);
        order(&network, &tasks, Effort { moves: 5_000, ..Effort::default() })
    };
    for deadline in [None, Some(55)] {
        let Ordering::Found(found) = found(deadline) else { panic!("55 is possible") };
        assert_eq!(found.makespan, Span::from_millis(55));
        assert_eq!(found.schedule.makespan(), Span::from_millis(55));
    }
    assert_eq!(
        found(Some(54)),
        Ordering::NotFound,
        "54 is impossible, and the search does not claim to prove it"
    );
    let Ordering::Infeasible(Some(_)) = found(Some(50)) else { panic!("one machine alone takes longer") };
}

#[test]
fn every_order_gives_each_machine_one_task_at_a_time() {
    for name in ["la01", "ft10"] {
        let (network, tasks, optimum) = shop(name, None);
        let Ordering::Found(found) = order(&network, &tasks, Effort { moves: 500, ..Effort::default() })
        else {
            panic!("always possible");
        };
        assert!(found.makespan >= Span::from_millis(optimum) && found.at_least <= Span::from_millis(optimum));
        for sequence in &found.sequences {
            for pair in sequence.windows(2) {
                let (before, after) = (&tasks[pair[0]], &tasks[pair[1]]);
                assert!(found.schedule.time(before.end) <= found.schedule.time(after.start));
            }
        }
    }
}
