//! The world file: the conditions of a simulated mission. Links delay and lose messages, and are interrupted; clocks deviate; robots die,
//! stall, or refuse movements; sensors show readings; the operator hesitates. Each of these is fixed or random. `docs/world.md` describes
//! the keys.

mod amount;
mod incident;
mod link;
mod outside;

use std::path::Path;

use urrcp::RobotId;

use crate::fleet::Fleet;
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys::{Declaration, Item, Kind, Naming};
use downbeat_reader::{keys, schema};
use downbeat_yaml::composed::{composed, is_same};
use downbeat_yaml::finding::{Code, Finding, Place};
use downbeat_yaml::identify::{self, Document};
use downbeat_yaml::locate::locate;
use downbeat_yaml::node::{self, Node};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;
use downbeat_yaml::tags::foreign_tags;

pub use amount::Between;
use incident::IncidentKeys;
pub use incident::{Incident, Trouble};
use link::LinkKeys;
pub use link::{Delay, Interruptions, LinkWorld, QUANTILES};
use outside::{ClockKeys, OperatorKeys};
pub use outside::{ClockWorld, OperatorWorld, Reading, SensorWorld};

keys! {
    /// The conditions of a mission.
    pub(crate) struct WorldKeys {
        /// A name for this world.
        #[required]
        world: kinds::NAME,
        /// The links, by robot, by group, or `all`.
        links: Kind::NameKeys(Naming::Uses(Item::Robot), &Kind::Entries(&LinkKeys::KIND)),
        /// The clocks, by robot, by group, or `all`.
        clocks: Kind::NameKeys(Naming::Uses(Item::Robot), &Kind::Entries(&ClockKeys::KIND)),
        /// The readings of sensors, by ROBOT/SENSOR.
        sensors: Kind::NameKeys(Naming::Uses(Item::RobotDevice), &Kind::Entries(&outside::READING)),
        /// How the operator behaves.
        operator: Kind::AnyOf(&[&schema!({"type": "null"}), &OperatorKeys::KIND]),
        /// What goes wrong.
        incidents: Kind::List(&IncidentKeys::KIND, 0..=usize::MAX),
    }
}

/// The name of an entry that applies to all robots without an entry of their own or of their group.
const ALL: &str = "all";

/// The conditions of a simulated mission.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct World {
    /// The name of the world.
    pub name: String,
    /// The link of each robot, in the order of the fleet file. `None` if the settings of the fleet file apply.
    pub links: Vec<Option<LinkWorld>>,
    /// The clock of each robot, in the order of the fleet file. `None` if the settings of the fleet file apply.
    pub clocks: Vec<Option<ClockWorld>>,
    /// The readings of sensors, each with its robot and sensor.
    pub sensors: Vec<SensorWorld>,
    /// The behaviour of the operator. `None` if the operator gives the go (the signal to start) after 1 s.
    pub operator: Option<OperatorWorld>,
    /// The incidents, in the order of the file.
    pub incidents: Vec<Incident>,
}

/// Returns the declaration of the keys of world files.
#[must_use]
pub fn world_keys() -> &'static Declaration {
    WorldKeys::declaration()
}

/// Reads a world file for a fleet and for the acts of a choreography. Returns all findings together, and the world only if there are no
/// findings.
#[must_use]
pub fn read_world(path: &Path, fleet: &Fleet, acts: &[&str]) -> (Option<World>, Vec<Finding>) {
    match Source::read(path) {
        Ok(source) => world_of(&source, fleet, acts),
        Err(finding) => (None, vec![finding]),
    }
}

/// Like [`read_world`], but reads the given text.
#[must_use]
pub fn world_of(source: &Source, fleet: &Fleet, acts: &[&str]) -> (Option<World>, Vec<Finding>) {
    let document = match node::parse(source) {
        Ok(document) => document,
        Err(finding) => return (None, vec![finding]),
    };
    if let Some(mistaken) = identify::mistaken(source, &document, Document::World) {
        return (None, vec![mistaken]);
    }
    let tags = foreign_tags(source);
    if !tags.is_empty() {
        return (None, tags);
    }
    let mut reader = WorldReader { findings: Reader::default(), fleet, acts };
    let world = reader.world(&At::document(&document, 0));
    let findings = locate(std::slice::from_ref(source), reader.findings.finish());
    (world.filter(|_| findings.is_empty()), findings)
}

struct WorldReader<'a> {
    findings: Reader,
    fleet: &'a Fleet,
    acts: &'a [&'a str],
}

impl WorldReader<'_> {
    fn world(&mut self, at: &At<'_>) -> Option<World> {
        let WorldKeys { world, links, clocks, sensors, operator, incidents } =
            self.findings.keys(at, "the world file")?;
        let name = world.and_then(|at| self.findings.name(&at, "a name for this world"));
        let links =
            links.map(|at| self.per_robot(&at, "a map from each robot or group to its link", link::read));
        let clocks = clocks.map(|at| {
            self.per_robot(&at, "a map from each robot or group to its clock", outside::read_clock)
        });
        let robots = self.fleet.robots.len();
        Some(World {
            name: name.unwrap_or_default(),
            links: links.unwrap_or_else(|| vec![None; robots]),
            clocks: clocks.unwrap_or_else(|| vec![None; robots]),
            sensors: sensors.map(|at| self.sensors(&at)).unwrap_or_default(),
            operator: operator.and_then(|at| outside::read_operator(&mut self.findings, &at)),
            incidents: incidents.map(|at| self.incidents(&at)).unwrap_or_default(),
        })
    }

    /// Reads a map whose keys are robots, groups, or `all`. A robot's own entry takes precedence over an entry of its group, which takes
    /// precedence over `all`. If several groups contain the robot, the last entry applies.
    fn per_robot<T: Clone>(
        &mut self,
        at: &At<'_>,
        expected: &str,
        read: impl Fn(&mut Reader, &At<'_>, &str) -> Option<T>,
    ) -> Vec<Option<T>> {
        let mut found: Vec<(u8, Option<T>)> = vec![(0, None); self.fleet.robots.len()];
        for (name, at) in self.findings.entries(at, expected) {
            let named = self.named(name);
            let Some((rank, robots)) = named else {
                self.unknown_robot(name, at.key_place());
                continue;
            };
            let Some(value) = read(&mut self.findings, &at, name) else { continue };
            for robot in robots {
                if rank >= found[robot].0 {
                    found[robot] = (rank, Some(value.clone()));
                }
            }
        }
        found.into_iter().map(|(_, value)| value).collect()
    }

    /// Returns the rank of a name (3 for a robot, 2 for a group, 1 for `all`) and the indices of the robots that it denotes.
    fn named(&self, name: &str) -> Option<(u8, Vec<usize>)> {
        let robots = &self.fleet.robots;
        let of = |id: &RobotId| robots.iter().position(|robot| robot.id == *id);
        if let Some(index) = robots.iter().position(|robot| is_same(robot.id.as_str(), name)) {
            return Some((3, vec![index]));
        }
        if let Some(group) = self.fleet.groups.get(composed(name).as_ref()) {
            return Some((2, group.iter().filter_map(of).collect()));
        }
        (name == ALL).then(|| (1, (0..robots.len()).collect()))
    }

    fn unknown_robot(&mut self, name: &str, place: Place) {
        let robots = self.fleet.robots.iter().map(|robot| robot.id.as_str());
        let known: Vec<&str> =
            robots.chain(self.fleet.groups.keys().map(String::as_str)).chain([ALL]).collect();
        let hint = self.findings.did_you_mean(name, known.iter().copied());
        let message = format!("no robot or group `{}` in the fleet", shortened(name));
        let expected = downbeat_yaml::finding::one_of(known);
        self.findings.add(Code::UnknownRobot, place, message, expected, hint);
    }

    fn sensors(&mut self, at: &At<'_>) -> Vec<SensorWorld> {
        let mut sensors = Vec::new();
        for (name, at) in self.findings.entries(at, "a map from each ROBOT/SENSOR to its reading") {
            let reading = outside::read_reading(&mut self.findings, &at);
            let Some((robot, sensor)) = name.split_once('/') else {
                let message = format!("`{}` does not name a robot and a sensor", shortened(name));
                let expected = "ROBOT/SENSOR, such as rover-1/range";
                self.findings.add(Code::WrongType, at.key_place(), message, expected, None);
                continue;
            };
            let found = self.fleet.robots.iter().find(|known| is_same(known.id.as_str(), robot));
            let Some(robot) = found else {
                self.unknown_robot(robot, at.key_place());
                continue;
            };
            let sensor = robot
                .init
                .as_ref()
                .and_then(|init| crate::fleet::sensor(&mut self.findings, sensor, &at, init));
            sensors.extend(sensor.zip(reading).map(|(sensor, reading)| SensorWorld {
                robot: robot.id.clone(),
                sensor,
                reading,
            }));
        }
        sensors
    }

    fn incidents(&mut self, at: &At<'_>) -> Vec<Incident> {
        let items = self.findings.list(at, "a list of incidents");
        items.iter().filter_map(|at| self.incident(at)).collect()
    }

    fn incident(&mut self, at: &At<'_>) -> Option<Incident> {
        let keys: IncidentKeys<'_> = self.findings.keys(at, "an incident")?;
        let robots = keys.robot.and_then(|at| {
            let name = self.findings.name(&at, "a robot or group")?;
            let named = self.named(&name);
            if named.is_none() {
                self.unknown_robot(&name, at.place());
            }
            Some(named?.1)
        });
        let act = keys.act.and_then(|at| {
            let name = self.findings.name(&at, "the name of an act")?;
            if !self.acts.contains(&name.as_str()) {
                let hint = self.findings.did_you_mean(&name, self.acts.iter().copied());
                let message = format!("no act `{}`", shortened(&name));
                let expected = match self.acts {
                    [] => "no `act`, because the scenario has no acts".to_owned(),
                    acts => downbeat_yaml::finding::one_of(acts.iter().copied()),
                };
                self.findings.add(Code::UnknownAct, at.place(), message, expected, hint);
            }
            Some(name)
        });
        incident::read(&mut self.findings, at, &keys, robots?, act)
    }
}

/// Whether a map is written as `null`, which means that it has no entries.
fn is_null(at: &At<'_>) -> bool {
    *at.node == Node::Null
}

#[cfg(test)]
mod tests;
