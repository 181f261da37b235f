//! Checks that the robots of a fleet are distinct and protected: unique addresses and ids, and no unprotected network connections.

use std::collections::{BTreeMap, HashMap};
use std::hash::Hash;

use super::FleetRobot;
use crate::address::Address;
use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::composed::{composed, is_same};
use downbeat_yaml::finding::{Code, SharedFault, robots_named};

/// Maximum number of robots whose Zenoh keys differ only in the last word. With more robots, the handshake takes considerably longer than
/// if their keys were divided into several groups (docs/zenoh.md).
const ROBOTS_AT_A_PLACE_MAX: usize = 1_000;

/// Reports robots without protection: anyone who can send messages to them can move them.
pub(super) fn none_open(findings: &mut Reader, robots: &At<'_>, fleet: &[FleetRobot]) {
    for robot in fleet.iter().filter(|robot| robot.address.is_open()) {
        findings.add_shared(SharedFault {
            code: Code::OpenNetwork,
            cause: String::new(),
            size: 0.0,
            device: String::new(),
            robots: [robot.id.clone()].into(),
            place: robots.place().of_key(robot.id.as_str()).of_key("address"),
            message: [
                String::new(),
                " would be moved over plain TCP, so anyone on the network could do the same".to_owned(),
            ],
            expected: "a `tls://` or `hmac://` address, with keys created by `downbeat keys`".to_owned(),
            hint: Some("if the robots are on an isolated network, write `insecure: true` at the top of the fleet file".into()),
        });
    }
}

/// Reports robots with the same address or the same id, because they cannot be distinguished.
pub(super) fn one_place_each(findings: &mut Reader, robots: &At<'_>, fleet: &[FleetRobot]) {
    let at = |robot: &FleetRobot, key| robots.place().of_key(robot.id.as_str()).of_key(key);
    let places = fleet.iter().map(|robot| (robot, robot.address.places()));
    for group in with_something_in_common(places) {
        let [first, second, others @ ..] = group.as_slice() else { continue };
        let is_reached =
            |robot: &FleetRobot| (at(robot, "address"), format!("`{}` at {}", robot.id, robot.address));
        findings.add_related(
            Code::OneAddress,
            vec![is_reached(second), is_reached(first)],
            format!("{} have the same address", several(first, second, others)),
            "a different address for each robot",
            Some("change the address of all but one of them".to_owned()),
        );
    }
    let ids = fleet
        .iter()
        .filter_map(|robot| Some((robot, vec![composed(robot.init.as_ref()?.id.as_str()).into_owned()])));
    for group in with_something_in_common(ids) {
        let [first, second, others @ ..] = group.as_slice() else { continue };
        let Some(own_id) = second.init.as_ref().map(|init| &init.id) else { continue };
        let all = if others.is_empty() { "both" } else { "all" };
        // The `robot_id` of one robot may equal the name of the other one.
        let named = if is_same(own_id.as_str(), second.id.as_str()) { first } else { second };
        findings.add(
            Code::NameTwice,
            at(named, "robot_id"),
            format!("{} would {all} have the id `{own_id}`", several(first, second, others)),
            "a different id for each robot",
            Some("set `robot_id` to the `id` that the robot itself declares".to_owned()),
        );
    }
}

/// Groups robots by shared keys. A robot joins the group in which one of its keys already occurs, or else starts a new group.
fn with_something_in_common<'a, K: Eq + Hash>(
    robots: impl Iterator<Item = (&'a FleetRobot, Vec<K>)>,
) -> Vec<Vec<&'a FleetRobot>> {
    let mut groups: Vec<Vec<&FleetRobot>> = Vec::new();
    let mut group_of: HashMap<K, usize> = HashMap::new();
    for (robot, keys) in robots {
        let known = keys.iter().find_map(|key| group_of.get(key).copied());
        let group = known.unwrap_or_else(|| {
            groups.push(Vec::new());
            groups.len() - 1
        });
        groups[group].push(robot);
        for key in keys {
            group_of.entry(key).or_insert(group);
        }
    }
    groups
}

fn several(first: &FleetRobot, second: &FleetRobot, others: &[&FleetRobot]) -> String {
    match others {
        [] => format!("`{}` and `{}`", first.id, second.id),
        _ => {
            let all = [first, second].into_iter().chain(others.iter().copied()).collect::<Vec<_>>();
            robots_named(all.iter().map(|robot| robot.id.as_str()))
        }
    }
}

/// Reports more than `ROBOTS_AT_A_PLACE_MAX` robots whose Zenoh keys differ only in the last word. Zenoh routers compare each newly
/// declared key with all such keys.
pub(super) fn none_crowded(findings: &mut Reader, robots: &At<'_>, fleet: &[FleetRobot]) {
    let mut crowds: BTreeMap<&str, Vec<&FleetRobot>> = BTreeMap::new();
    for robot in fleet {
        if let Address::Zenoh { key } = &robot.address {
            let place = key.rsplit_once('/').map_or("", |(place, _)| place);
            crowds.entry(place).or_default().push(robot);
        }
    }
    for (place, crowd) in crowds {
        let Some(first) = crowd.get(ROBOTS_AT_A_PLACE_MAX) else { continue };
        let within = if place.is_empty() { String::new() } else { format!("{place}/") };
        findings.add(
            Code::CrowdedPlace,
            robots.place().of_key(first.id.as_str()).of_key("address"),
            format!("{} robots have keys directly below `zenoh:{within}...`", crowd.len()),
            format!("at most {ROBOTS_AT_A_PLACE_MAX} robots whose keys differ only in the last word"),
            Some(format!("add a word to their keys, as in `zenoh:{within}row-1/{}`", first.id)),
        );
    }
}
