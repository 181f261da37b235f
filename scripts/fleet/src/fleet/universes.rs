//! Checks that the fixtures of a fleet fit into their universes: each channel belongs to one robot.

use std::collections::{BTreeMap, HashMap};

use urrcp::CHANNELS_PER_UNIVERSE;

use super::FleetRobot;
use crate::address::{Address, DEFAULT_PRIORITY, DmxAddress};
use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::{Code, Place, SharedFault};

/// A fixture, and its channels in the universe.
struct Fixture<'a> {
    robot: &'a FleetRobot,
    address: &'a DmxAddress,
    channels: Vec<u16>,
}

/// Reports fixtures whose devices cannot have their channels, and fixtures that use channels of others.
pub(super) fn one_user_each(findings: &mut Reader, robots: &At<'_>, fleet: &[FleetRobot]) {
    let mut universes: HashMap<String, Vec<Fixture<'_>>> = HashMap::new();
    let place_of = |robot: &FleetRobot| robots.place().of_key(robot.id.as_str()).of_key("address");
    for robot in fleet {
        let (Address::Dmx(address), Some(block)) = (&robot.address, &robot.init) else { continue };
        match urrcp::patch(block, address.channel) {
            Ok(patched) => {
                let channels = patched.into_iter().flat_map(|device| device.values.concat()).collect();
                universes.entry(address.universe_name()).or_default().push(Fixture {
                    robot,
                    address,
                    channels,
                });
            }
            Err(error) => findings.add_shared(SharedFault {
                code: Code::Channels,
                cause: error.to_string(),
                size: 0.0,
                device: String::new(),
                robots: [robot.id.clone()].into(),
                place: place_of(robot),
                message: [String::new(), format!(" cannot be patched: {error}")],
                expected: "channels of the init file that fit its devices and the universe".to_owned(),
                hint: Some(
                    "change `channel` in the init file, or the first channel in the address".to_owned(),
                ),
            }),
        }
    }
    let mut universes: Vec<_> = universes.into_values().collect();
    // The order of the file, which hash maps do not keep.
    universes.sort_unstable_by_key(|fixtures| place_in(fleet, &fixtures[0]));
    for fixtures in universes {
        report_shared(findings, &place_of, &fixtures);
        report_priority(findings, &place_of, &fixtures);
    }
}

fn place_in(fleet: &[FleetRobot], fixture: &Fixture<'_>) -> Option<usize> {
    fleet.iter().position(|robot| robot.id == fixture.robot.id)
}

/// Reports each fixture that uses a channel of a fixture above it in the file.
fn report_shared(findings: &mut Reader, place_of: &impl Fn(&FleetRobot) -> Place, fixtures: &[Fixture<'_>]) {
    let mut users: BTreeMap<u16, &Fixture<'_>> = BTreeMap::new();
    let last = fixtures.iter().flat_map(|fixture| &fixture.channels).max().copied().unwrap_or_default();
    for fixture in fixtures {
        let taken = fixture.channels.iter().filter_map(|channel| Some((*channel, *users.get(channel)?)));
        // Robots with equal addresses have a finding of their own.
        let is_apart = |(_, other): &(u16, &Fixture<'_>)| other.address.channel != fixture.address.channel;
        if let Some((channel, other)) = taken.filter(is_apart).min_by_key(|(channel, _)| *channel) {
            let at = |fixture: &Fixture<'_>| {
                let robot = fixture.robot;
                (place_of(robot), format!("`{}` at {}", robot.id, robot.address))
            };
            let (first, second) = (&other.robot.id, &fixture.robot.id);
            findings.add_related(
                Code::Channels,
                vec![at(fixture), at(other)],
                format!(
                    "`{first}` and `{second}` both use channel {channel} of universe {}",
                    fixture.address.universe
                ),
                "a channel for each device of each robot",
                Some(free_place(fixture, last)),
            );
        }
        for channel in &fixture.channels {
            users.entry(*channel).or_insert(fixture);
        }
    }
}

/// Returns how to move a fixture behind all others of its universe, if it fits there.
fn free_place(fixture: &Fixture<'_>, last: u16) -> String {
    let length = fixture.channels.iter().max().map_or(0, |end| end - fixture.address.channel);
    let first = last + 1;
    if first + length > CHANNELS_PER_UNIVERSE {
        return "move one of them to other channels, or to another universe".to_owned();
    }
    let moved = DmxAddress { channel: first, ..fixture.address.clone() };
    format!("channels from {first} are free: write `{moved}`")
}

/// Reports the first fixture whose priority differs from that of its universe: a source has one priority for all channels.
fn report_priority(
    findings: &mut Reader,
    place_of: &impl Fn(&FleetRobot) -> Place,
    fixtures: &[Fixture<'_>],
) {
    let priority = |fixture: &Fixture<'_>| fixture.address.priority.unwrap_or(DEFAULT_PRIORITY);
    let Some(first) = fixtures.first() else { return };
    let Some(other) = fixtures.iter().find(|fixture| priority(fixture) != priority(first)) else { return };
    let at = |fixture: &Fixture<'_>| {
        (place_of(fixture.robot), format!("`{}` with priority {}", fixture.robot.id, priority(fixture)))
    };
    findings.add_related(
        Code::Channels,
        vec![at(other), at(first)],
        format!(
            "`{}` and `{}` have different priorities in universe {}",
            first.robot.id, other.robot.id, first.address.universe
        ),
        "the same priority for all robots of a universe",
        Some("give both addresses the same `?priority=N`".to_owned()),
    );
}
