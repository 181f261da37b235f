//! The circumstances of one trial: random network conditions, incidents, readings and operator behaviour, drawn from a world file.

use downbeat_mission::RobotIndex;
use downbeat_scripts::{
    Between, Delay, FleetRobot, Incident, LinkWorld, OperatorWorld, Reading, Trouble, World,
};
use fastrand::Rng;
use urrcp::{DeviceId, RobotId, Server, Span, Timestamp};

use crate::world::{Path, between};
use downbeat_runtime::fleet::WIRED;

/// The network path to a robot, with its own random generator.
#[derive(Clone, Debug)]
pub(super) struct Link {
    pub(super) path: Path,
    pub(super) rng: Rng,
}

impl Link {
    fn new(says: LinkWorld, mut rng: Rng, begin: Timestamp<Server>) -> Self {
        Self { path: Path::new(says.into(), &mut rng, begin), rng }
    }
}

/// All deviations of a trial from a perfect world. Each robot's link, each incident and the operator have their own random stream, so
/// additional draws from one stream do not change the others.
#[derive(Clone, Debug, Default)]
pub(crate) struct Circumstances {
    /// The link to each robot, by the robot's index in the mission. `None`: the robot itself delays its messages, as the fleet file
    /// specifies.
    pub(super) links: Vec<Option<Link>>,
    pub(super) incidents: Vec<Drawn>,
    /// Sensor readings, each with the time from which it applies, the robot's index, the sensor, and the value.
    pub(super) readings: Vec<(Timestamp<Server>, RobotIndex, DeviceId, f64)>,
    pub(super) operator: Option<(OperatorWorld, Rng)>,
}

/// An incident that happens in the trial, with its drawn time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Drawn {
    /// Index of the robot in the mission.
    pub(super) robot: RobotIndex,
    /// The act at whose start the time `at` begins to count. `None`: `at` counts from the start of the mission.
    pub(super) act: Option<String>,
    pub(super) at: Span,
    pub(super) mishap: Mishap,
}

/// A fault of a robot, with its randomly drawn durations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mishap {
    Dies { back_after: Option<Span> },
    Stalls { lasts: Span },
    Refuses { lasts: Option<Span> },
    LinkDown { lasts: Span },
}

/// The random streams of a trial, by purpose.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Stream {
    Robot(usize),
    Link(usize),
    Incident(usize, usize),
    Sensor(usize),
    Operator,
}

impl Stream {
    /// Creates the random generator of this stream from the seed of a trial.
    pub(crate) fn rng(self, seed: u64) -> Rng {
        let (kind, first, second) = match self {
            Self::Robot(index) => (1, index, 0),
            Self::Link(index) => (2, index, 0),
            Self::Incident(index, robot) => (3, index, robot),
            Self::Sensor(index) => (4, index, 0),
            Self::Operator => (5, 0, 0),
        };
        let mixed =
            [kind, first as u64, second as u64].iter().fold(seed, |seed, part| mixed(seed ^ mixed(*part)));
        Rng::with_seed(mixed)
    }
}

/// The output function of `SplitMix64` (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014).
pub(crate) const fn mixed(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

impl Circumstances {
    /// Draws the circumstances of a trial from `world`, for the robots of a mission that starts at `begin`. `world` refers to robots by
    /// their index in `fleet`.
    pub(crate) fn draw(
        world: &World,
        fleet: &[FleetRobot],
        robots: &[&FleetRobot],
        seed: u64,
        begin: Timestamp<Server>,
    ) -> Self {
        let in_mission = |id: &RobotId| robots.iter().position(|robot| robot.id == *id).map(RobotIndex::new);
        let in_fleet = |robot: &FleetRobot| fleet.iter().position(|known| known.id == robot.id);
        let link = |index: usize, robot: &&FleetRobot| {
            let said = in_fleet(robot).and_then(|place| world.links.get(place)?.clone());
            Link::new(said.unwrap_or_else(|| as_in_fleet(robot)), Stream::Link(index).rng(seed), begin)
        };
        let mut incidents = Vec::new();
        for (index, incident) in world.incidents.iter().enumerate() {
            for robot in &incident.robots {
                let Some(place) = fleet.get(*robot).and_then(|robot| in_mission(&robot.id)) else { continue };
                let mut rng = Stream::Incident(index, *robot).rng(seed);
                incidents.extend(happens(incident, place, &mut rng));
            }
        }
        let mut readings = Vec::new();
        for (index, sensor) in world.sensors.iter().enumerate() {
            let Some(robot) = in_mission(&sensor.robot) else { continue };
            let mut reads = |at, value| readings.push((at, robot, sensor.sensor.clone(), value));
            let mut rng = Stream::Sensor(index).rng(seed);
            match &sensor.reading {
                Reading::Drawn(reading) => reads(begin, number(&mut rng, *reading)),
                Reading::OverTime(points) => {
                    reads(begin, 0.0);
                    for (at, reading) in points {
                        let at = begin + between(&mut rng, *at);
                        reads(at, number(&mut rng, *reading));
                    }
                }
            }
        }
        Self {
            links: robots.iter().enumerate().map(|(index, robot)| Some(link(index, robot))).collect(),
            incidents,
            readings,
            operator: world.operator.clone().map(|operator| (operator, Stream::Operator.rng(seed))),
        }
    }
}

fn number(rng: &mut Rng, bounds: Between<f64>) -> f64 {
    bounds.least + rng.f64() * (bounds.largest - bounds.least)
}

/// Returns the link of a robot that the world file does not mention, with the delays from the fleet file.
fn as_in_fleet(robot: &FleetRobot) -> LinkWorld {
    let (least, largest) = robot.simulation.delay.unwrap_or(WIRED);
    LinkWorld::with_delay(Delay::Between(Between { least, largest }))
}

fn happens(incident: &Incident, robot: RobotIndex, rng: &mut Rng) -> Option<Drawn> {
    // Draws the time even if the incident does not happen, so that a different probability does not change the time.
    let happens = rng.f64() < incident.probability;
    let at = between(rng, incident.at);
    let mishap = match &incident.trouble {
        Trouble::Dies { back_after } => {
            Mishap::Dies { back_after: back_after.map(|after| between(rng, after)) }
        }
        Trouble::Stalls { lasts } => Mishap::Stalls { lasts: between(rng, *lasts) },
        Trouble::Refuses { lasts } => Mishap::Refuses { lasts: lasts.map(|lasts| between(rng, lasts)) },
        Trouble::LinkDown { lasts } => Mishap::LinkDown { lasts: between(rng, *lasts) },
    };
    happens.then(|| Drawn { robot, act: incident.act.clone(), at, mishap })
}
