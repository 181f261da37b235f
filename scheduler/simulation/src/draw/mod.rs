//! Draws a mission from a seed: a fleet, a choreography, the environment, and the faults with their times.

mod choreography;
mod faults;
mod fleet;
mod hours;
mod kind;
mod network;
mod rates;
mod sensors;
mod staged;
mod times;
mod together;
mod twins;
mod unusual;

use downbeat_plan::{Act, Choreography, Wait};
use downbeat_rehearsal::dry_run::BEGIN;
use fastrand::Rng;
use urrcp::Span;

use downbeat_mission::Join;

pub(crate) use choreography::{BEGINS_AT, BRIGHT};
pub use faults::Fault;
pub(crate) use fleet::stranger;
pub use fleet::{Connections, DrawnRobot, Hands, Lie, Names};
use hours::Longest;
pub use kind::FaultKind;
pub use network::{DrawnDisk, Network};
pub(crate) use sensors::shows_within;
pub use times::ClockChange;
pub(crate) use times::zone;

/// A mission as drawn from a seed.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// The seed from which the mission is drawn.
    pub seed: u64,
    /// How the network transports messages.
    pub network: Network,
    /// Smallest and largest one-way delay of a message.
    pub delay: (Span, Span),
    /// The probability that a message takes up to twenty times as long as usual.
    pub tail: f64,
    /// Each robot's description, behaviour and clock.
    pub robots: Vec<DrawnRobot>,
    /// The choreography that is played.
    pub choreography: Choreography,
    /// For each act, when the operator's go or the sensor reading that the act waits for occurs: the time from the announcement of the
    /// wait. `None`: never.
    pub comes_after: Vec<Option<Span>>,
    /// How the mission treats a robot that is absent at first.
    pub join: Join,
    /// Whether the mission can plan acts after a stop, for example to send all robots home together. Otherwise, each robot goes home on
    /// its own.
    pub plans_transfers: bool,
    /// The number of acts after which no further act begins. `None`: unlimited.
    pub acts_max: Option<u32>,
    /// The faults in order of time, each with its time from the start of the mission.
    pub faults: Vec<(Span, Fault)>,
    /// The disk that contains the scheduler's journal.
    pub disk: DrawnDisk,
    /// Index of the mission's clock change in the table of clock changes. `None`: the clocks show UTC.
    pub clock_change: Option<usize>,
    /// When the operator stops a mission that has not ended, as the time since its start. `None`: never.
    pub ends_at: Option<Span>,
}

impl Drawn {
    /// Returns the maximum duration of the mission if each act is played once: the sum of the durations of all acts and waits.
    #[must_use]
    pub fn lasts(&self) -> Span {
        let acts = self.choreography.acts.iter();
        let waits = |act: &Act| match act.wait {
            Wait::Instant(at) => act.plan.duration() + (at - BEGIN),
            _ => act.plan.duration() + act.timeout.unwrap_or_default(),
        };
        acts.map(waits).fold(Span::ZERO, |sum, act| sum + act)
    }

    /// Returns this mission without timed faults and with an unlimited disk. The network is unchanged, and robots still lie.
    #[must_use]
    pub fn without_faults(mut self) -> Self {
        self.faults.clear();
        self.disk.capacity = None;
        self
    }
}

/// Number by which seeds are divided to determine their family of missions. A seed belongs to a family if the remainder equals the
/// constant of that family.
pub(crate) const FAMILIES: u64 = 50;
/// Family of missions with combinations of events that rarely occur by chance.
const TOGETHER: u64 = 12;
/// Family of missions in which the operator sends the robots home.
const SENT_HOME: u64 = 37;
/// Family of missions with unusual acts, movements and robots.
const UNUSUAL: u64 = 32;
/// Family of missions in which a fault of a certain kind occurs at a certain stage.
const STAGED: u64 = 38;
/// Family of missions with devices that are driven by their speed or have a limited acceleration.
pub(crate) const RATES: u64 = 40;

/// Family of missions in which acts wait for a time of day around a clock change.
pub(crate) const TIMES: u64 = 30;

/// Family of missions that last for hours or days. Only one in ten seeds with this remainder lasts for hours, and one in a hundred for
/// days, because each takes as long to simulate as hundreds or thousands of others.
const HOURS: u64 = 29;
const HOURS_ONE_IN: u64 = 10;
const DAYS_ONE_IN: u64 = 100;

/// Family of missions in which sensors show the positions of devices that follow their commands with a lag.
pub(crate) const SENSORS: u64 = 21;

/// Family of missions in which another process answers in place of a robot, with the robot's id. A seed belongs to it if the seed modulo
/// `TWINS_EVERY` equals this constant.
pub(crate) const TWINS: u64 = 33;
pub(crate) const TWINS_EVERY: u64 = 100;

/// One in this many missions has devices that may not start at the positions that the first act expects.
const MISPLACED_ONE_IN: u64 = 40;

fn millis(rng: &mut Rng, least: i64, largest: i64) -> Span {
    Span::from_micros(rng.i64(least * 1_000..=largest * 1_000))
}

fn one_in(rng: &mut Rng, count: u8) -> bool {
    rng.u8(0..count) == 0
}

/// Draws a mission from a seed.
#[must_use]
pub fn draw(seed: u64) -> Drawn {
    let rng = &mut Rng::with_seed(seed);
    let drawn = draw_mission(rng, seed);
    match seed % FAMILIES {
        TOGETHER => together::bring_together(rng, drawn),
        SENT_HOME => send_home(rng, drawn),
        UNUSUAL => unusual::reshape(rng, drawn),
        STAGED => staged::stage_faults(rng, drawn, seed / FAMILIES),
        RATES => rates::drive_by_rates(rng, drawn),
        TIMES => times::wait_for_times(rng, drawn),
        HOURS if (seed / FAMILIES).is_multiple_of(DAYS_ONE_IN) => {
            hours::last_longer(rng, drawn, Longest::TwoDays)
        }
        HOURS if (seed / FAMILIES).is_multiple_of(HOURS_ONE_IN) => {
            hours::last_longer(rng, drawn, Longest::FourHours)
        }
        SENSORS => sensors::show_positions(rng, drawn),
        _ if seed % TWINS_EVERY == TWINS => twins::answer_by_twins(rng, drawn, seed / TWINS_EVERY),
        _ => drawn,
    }
}

/// Draws an ordinary mission, which belongs to no family.
fn draw_mission(rng: &mut Rng, seed: u64) -> Drawn {
    let network = network::draw_network(rng);
    let (delay, tail) = network::draw_delay(rng);
    let show = if one_in(rng, 100) { fleet::Show::Large } else { fleet::Show::Small };
    let count = rng.usize(2..=5);
    let mut robots: Vec<DrawnRobot> = (0..count).map(|index| fleet::draw_robot(rng, index, show)).collect();
    if network != Network::Stream {
        // Robots that omit request ids from their responses are reached only by streams.
        robots.iter_mut().for_each(|robot| robot.names = Names::Echoed);
    }
    let join = if one_in(rng, 12) { Join::NextAct } else { Join::Refuse };
    if join == Join::NextAct {
        // At least one robot is present from the start, because otherwise no act could begin.
        robots[count - 1].there_from = millis(rng, 500, 6_000);
    }
    let mut choreography = choreography::draw_choreography(rng, &robots, show);
    if !seed.is_multiple_of(MISPLACED_ONE_IN) {
        choreography::begin_where_devices_are(&mut choreography, &robots);
    }
    let comes_after = draw_what_comes(rng, &choreography);
    let disk = network::draw_disk(rng);
    let drawn = Drawn {
        seed,
        network,
        delay,
        tail,
        robots,
        choreography,
        comes_after,
        join,
        acts_max: None,
        plans_transfers: !seed.is_multiple_of(4),
        faults: Vec::new(),
        disk,
        clock_change: None,
        ends_at: None,
    };
    let faults = faults::draw_faults(rng, &drawn);
    Drawn { faults, ..drawn }
}

/// Adds a command of the operator that sends all robots home while acts play. A second command may follow soon afterwards.
fn send_home(rng: &mut Rng, mut drawn: Drawn) -> Drawn {
    for device in drawn.robots.iter_mut().flat_map(|robot| robot.block.devices.iter_mut()) {
        device.default_value.get_or_insert(BEGINS_AT);
    }
    if one_in(rng, 2) {
        drawn.faults.clear();
    }
    let at = millis(rng, 600, 3_000);
    drawn.faults.push((at, Fault::Home));
    if one_in(rng, 2) {
        let then = if one_in(rng, 2) { Fault::Stop } else { Fault::Home };
        drawn.faults.push((at + millis(rng, 0, 1_500), then));
    }
    drawn.faults.sort_by_key(|(at, _)| *at);
    drawn
}

/// Draws when the events that acts wait for occur: in time, too late, or never.
fn draw_what_comes(rng: &mut Rng, choreography: &Choreography) -> Vec<Option<Span>> {
    let comes = choreography.acts.iter().map(|act| {
        let waits = matches!(act.wait, Wait::Operator | Wait::Sensor { .. });
        let timeout = act.timeout.filter(|_| waits)?;
        match rng.u8(0..10) {
            0 => None,
            1 => Some(timeout + millis(rng, -20, 500)),
            _ => Some(Span::from_nanos(rng.i64(0..=timeout.as_nanos()))),
        }
    });
    comes.collect()
}

/// Plays every `every`-th seed from `first` up to, but not including, `below`. Counts the situations that the missions reach, and fails
/// if a mission violates an invariant.
#[cfg(test)]
fn reached((first, below): (u64, u64), every: u64) -> std::collections::BTreeMap<crate::Situation, usize> {
    let mut reached = std::collections::BTreeMap::new();
    for seed in (first..below).step_by(every as usize) {
        let verdict = crate::judge(&crate::run(seed));
        assert_eq!(verdict.violations, [], "seed {seed}");
        for situation in verdict.situations {
            *reached.entry(situation).or_insert(0) += 1;
        }
    }
    reached
}
