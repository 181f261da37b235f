//! All maps that files may contain, with their declared keys.

use std::collections::BTreeSet;

use crate::keys::{Declaration, Kind};
use crate::scenario::{included_keys, scenario_keys};
use downbeat_fleet::fleet::{fleet_keys, latency_keys};
use downbeat_fleet::world::world_keys;

/// Returns every map with declared keys once, in the order in which the maps are found, starting from the files that users write.
#[must_use]
pub fn all_maps() -> Vec<&'static Declaration> {
    let roots = [scenario_keys(), included_keys(), fleet_keys(), latency_keys(), world_keys()];
    let mut maps = Vec::new();
    roots.into_iter().for_each(|root| collect(root, &mut maps));
    maps
}

/// Adds a map and all maps within its values.
pub(super) fn collect(map: &'static Declaration, maps: &mut Vec<&'static Declaration>) {
    if !maps.iter().any(|known| std::ptr::eq(*known, map)) {
        maps.push(map);
        map.keys.iter().for_each(|key| collect_from(key.kind, maps, &mut BTreeSet::new()));
    }
}

/// Adds the maps within values of this kind. `named` contains the enclosing kinds, because times contain spreads, which contain times.
fn collect_from(
    kind: &'static Kind,
    maps: &mut Vec<&'static Declaration>,
    named: &mut BTreeSet<&'static str>,
) {
    match kind {
        Kind::Named { name, kind, .. } => {
            if named.insert(name) {
                collect_from(kind, maps, named);
            }
        }
        Kind::Keys(of) => collect(of(), maps),
        Kind::KeysOf(of, kind) | Kind::KeysAnd(of, kind) => {
            collect(of(), maps);
            collect_from(kind, maps, named);
        }
        Kind::Entries(kind)
        | Kind::SomeEntries(kind)
        | Kind::List(kind, _)
        | Kind::Name(_, kind)
        | Kind::NameKeys(_, kind) => {
            collect_from(kind, maps, named);
        }
        Kind::Tuple(kinds) | Kind::AnyOf(kinds) => {
            kinds.iter().for_each(|kind| collect_from(kind, maps, named));
        }
        Kind::Words(_) | Kind::Schema(_) => {}
    }
}
