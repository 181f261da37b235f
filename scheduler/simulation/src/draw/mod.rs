//! The mission of a seed: a fleet, a choreography, the environment, and the faults with their times.

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
pub use kind::FaultKind;
pub use network::{DrawnDisk, Network};
pub(crate) use sensors::shows_within;
pub use times::ClockChange;
pub(crate) use times::zone;

/// The mission of a seed.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// The seed from which everything here is drawn.
    pub seed: u64,
    /// The transport of messages.
    pub network: Network,
    /// Smallest and largest one-way delay.
    pub delay: (Span, Span),
    /// The probability of a delay up to twenty times as long.
    pub tail: f64,
    /// Each robot's description, behaviour and clock.
    pub robots: Vec<DrawnRobot>,
    /// The choreography that is played.
    pub choreography: Choreography,
    /// For each act, the delay from the announcement of its wait until the operator gives the go or its sensor has the awaited reading;
    /// `None`: never.
    pub comes_after: Vec<Option<Span>>,
    /// How the mission treats a robot that is absent at first.
    pub join: Join,
    /// Whether the mission can plan acts after a stop. Otherwise each robot goes home on its own.
    pub plans_transfers: bool,
    /// The number of acts after which no further act begins.
    pub acts_max: Option<u32>,
    /// The faults, in order of time.
    pub faults: Vec<(Span, Fault)>,
    /// The disk with the scheduler's journal.
    pub disk: DrawnDisk,
    /// The clock change at the scheduler's location, as an index into the table of changes. `None`: the clocks show UTC.
    pub clock_change: Option<usize>,
    /// When the operator stops a mission that has not ended.
    pub ends_at: Option<Span>,
}

impl Drawn {
    /// The maximum duration of the mission if each act begins and ends once: the sum of all acts and waits.
    #[must_use]
    pub fn lasts(&self) -> Span {
        let acts = self.choreography.acts.iter();
        let waits = |act: &Act| match act.wait {
            Wait::Instant(at) => act.plan.duration() + (at - BEGIN),
            _ => act.plan.duration() + act.timeout.unwrap_or_default(),
        };
        acts.map(waits).fold(Span::ZERO, |sum, act| sum + act)
    }

    /// The same mission without timed faults; its network and its lying robots stay.
    #[must_use]
    pub fn without_faults(mut self) -> Self {
        self.faults.clear();
        self.disk.capacity = None;
        self
    }
}

/// If a seed modulo this equals one of the following constants, its mission belongs to that family.
pub(crate) const FAMILIES: u64 = 50;
/// Several events coincide that rarely coincide by chance.
const TOGETHER: u64 = 12;
/// The operator sends the robots home.
const SENT_HOME: u64 = 37;
/// Acts, movements and robots have unusual shapes.
const UNUSUAL: u64 = 32;
/// A fault of a certain kind occurs at a certain stage.
const STAGED: u64 = 38;
/// Devices are driven by their speed, or have a limited acceleration.
pub(crate) const RATES: u64 = 40;

/// Acts wait for a time of day around a clock change.
pub(crate) const TIMES: u64 = 30;

/// Missions last for hours. Only one in ten of these seeds: each takes as long as hundreds of others.
const HOURS: u64 = 29;
const HOURS_ONE_IN: u64 = 10;

/// Sensors show the positions of devices that follow their commands with a lag.
pub(crate) const SENSORS: u64 = 21;

/// Another process answers in place of a robot, with its id. Applies if a seed modulo `TWINS_EVERY` equals this.
pub(crate) const TWINS: u64 = 33;
pub(crate) const TWINS_EVERY: u64 = 100;

/// In one out of this many missions, devices may start at a position other than that of the first act.
const MISPLACED_ONE_IN: u64 = 40;

fn millis(rng: &mut Rng, least: i64, largest: i64) -> Span {
    Span::from_micros(rng.i64(least * 1_000..=largest * 1_000))
}

fn one_in(rng: &mut Rng, count: u8) -> bool {
    rng.u8(0..count) == 0
}

/// Draws the mission of a seed.
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
        HOURS if (seed / FAMILIES).is_multiple_of(HOURS_ONE_IN) => hours::last_for_hours(rng, drawn),
        SENSORS => sensors::show_positions(rng, drawn),
        _ if seed % TWINS_EVERY == TWINS => twins::answer_by_twins(rng, drawn, seed / TWINS_EVERY),
        _ => drawn,
    }
}

/// An ordinary mission, drawn only by chance.
fn draw_mission(rng: &mut Rng, seed: u64) -> Drawn {
    let network = network::draw_network(rng);
    let (delay, tail) = network::draw_delay(rng);
    let show = if one_in(rng, 100) { fleet::Show::Large } else { fleet::Show::Small };
    let count = rng.usize(2..=5);
    let mut robots: Vec<DrawnRobot> = (0..count).map(|index| fleet::draw_robot(rng, index, show)).collect();
    if network != Network::Stream {
        // Robots whose answers are ambiguous are only reached by streams.
        robots.iter_mut().for_each(|robot| robot.names = Names::Echoed);
    }
    let join = if one_in(rng, 12) { Join::NextAct } else { Join::Refuse };
    if join == Join::NextAct {
        // Not all robots, or no robot could begin.
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

/// The operator sends all robots home while acts play, and may give a second command soon afterwards.
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

/// The delay of the awaited events: in time, too late, or never.
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

/// Plays every `every`-th seed, none of which may violate anything, and counts the situations that the missions reach.
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
