//! A mission in virtual time: the same loop, mission machine and robot machines as in a real mission; time jumps from event to event. The
//! network has the delays of the fleet file and loses nothing; trials draw networks that do.
//!
//! A virtual operator gives the go whenever an act waits and no other act plays. Every dry run ends: a loop of acts is played a fixed
//! number of times, and an act whose condition never occurs is given up ([`Cut`]).

mod circumstances;
mod operator;
mod spread;
mod watch;
mod world;

use downbeat_robot::set_log::LogEntry;
use downbeat_robot::simulated::SimulatedRobot;
use downbeat_scripts::{Choreography, SensorRange, Wait};
use urrcp::{DeviceId, RobotId, Server, Span, Timestamp};

pub(crate) use self::circumstances::{Circumstances, Stream, mixed};
use self::operator::VirtualOperator;
pub use self::spread::ActStarts;
pub use self::watch::Watched;
use self::world::VirtualWorld;
use downbeat_mission::drive::{at_once, drive};
use downbeat_mission::report::Report;
use downbeat_mission::{MissingParticipant, Mission, MissionOptions, Participant, Progress};

/// Start of virtual time if no act waits for a time: 2026-01-01T00:00:00Z.
pub const BEGIN: Timestamp<Server> = Timestamp::from_nanos(1_767_225_600_000_000_000);
/// Virtual time starts this long before the first time that an act waits for, plus this long for every act.
const BEFORE_TIME: Span = Span::from_millis(60_000);
/// Number of times that a loop through all acts is played, unless [`MissionOptions::acts_max`] overrides it.
pub const ROUNDS: u32 = 3;

/// The result of a mission in virtual time.
#[derive(Debug)]
pub struct Played {
    /// The report, as after a real mission.
    pub report: Report,
    /// The values that each robot set, in the order of the mission's robots; empty unless logs are kept.
    pub logs: Vec<Vec<LogEntry>>,
    /// Number of scripts that really began, for each act that has ended, in order.
    pub starts: Vec<ActStarts>,
    /// Why the virtual operator ended the mission prematurely.
    pub cut: Option<Cut>,
}

/// The mission was stopped because an act waited for an event that does not occur in virtual time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Name of the act.
    pub act: String,
    /// The awaited event, for people.
    pub awaits: String,
}

impl Played {
    /// The values that a robot set.
    #[must_use]
    pub fn log_of(&self, robot: &RobotId) -> Option<&[LogEntry]> {
        let index = self.report.robots.iter().position(|row| row.robot == *robot)?;
        self.logs.get(index).map(Vec::as_slice)
    }
}

/// Whether to keep the values that every robot sets: about 250 bytes per step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Logs {
    /// Only data for the report is evaluated.
    #[default]
    Dropped,
    /// Everything is kept, for example for a picture.
    Kept,
    /// The audience receives everything, and nothing is kept.
    Watched,
}

/// Observes a dry run while it plays.
pub trait Audience {
    /// Receives a message for the operator.
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress);

    /// Another second of virtual time has begun.
    fn second(&mut self, now: Timestamp<Server>);

    /// Receives a value that a robot has set; only called if values are kept or watched.
    fn set(&mut self, _robot: usize, _entry: &LogEntry) {}
}

impl Audience for () {
    fn told(&mut self, _: Timestamp<Server>, _: &Progress) {}

    fn second(&mut self, _: Timestamp<Server>) {}
}

/// A choreography about to be played in virtual time.
#[derive(Debug)]
pub struct Rehearsal {
    mission: Mission,
    robots: Vec<SimulatedRobot>,
    begin: Timestamp<Server>,
    logs: Logs,
    circumstances: Circumstances,
}

impl Rehearsal {
    /// Creates a rehearsal with simulated robots in the order of the participants. Devices begin where the first act expects them. Each
    /// sensor that an act waits for gives a reading that satisfies the act.
    ///
    /// # Errors
    /// A robot of the choreography has no participant.
    pub fn new(
        choreography: Choreography,
        participants: Vec<Participant>,
        options: MissionOptions,
        mut robots: Vec<SimulatedRobot>,
    ) -> Result<Self, MissingParticipant> {
        let begin = begin_of(&choreography, &options);
        for act in &choreography.acts {
            let Wait::Sensor { robot, sensor, range } = &act.wait else { continue };
            let whose = participants.iter().position(|participant| participant.id.as_str() == robot);
            if let (Some(index), Ok(sensor)) = (whose, sensor.parse()) {
                robots[index].set_reading(sensor, reading_within(*range));
            }
        }
        let first = choreography.acts.get(options.first_act).into_iter().flat_map(|act| &act.plan.robots);
        for planned in first {
            let whose = participants.iter().position(|participant| participant.id == planned.robot);
            let Some(index) = whose else { continue };
            for (device, position) in planned.first_positions() {
                robots[index].place(device, position);
            }
        }
        let mission = Mission::new(choreography, participants, options, begin)?;
        Ok(Self::of(mission, robots, begin))
    }

    fn of(mut mission: Mission, robots: Vec<SimulatedRobot>, begin: Timestamp<Server>) -> Self {
        let acts = u32::try_from(mission.choreography().acts.len()).unwrap_or(u32::MAX);
        mission.bound_acts(acts.saturating_mul(ROUNDS));
        Self { mission, robots, begin, logs: Logs::Dropped, circumstances: Circumstances::default() }
    }

    /// Sets the reading of a sensor. Returns `false` if the robot does not participate or has no such sensor.
    pub fn set_reading(&mut self, robot: &RobotId, sensor: &DeviceId, value: f64) -> bool {
        let index = self.mission.robot_ids().position(|id| id == robot);
        let has = |index: &usize| {
            let device = self.robots[*index].robot().block().device(sensor.as_str());
            device.is_some_and(|device| device.available_control_types.sensor().is_some())
        };
        let index = index.filter(has);
        index.map(|index| self.robots[index].set_reading(sensor.clone(), value)).is_some()
    }

    /// Draws the circumstances of the mission for the instant at which it begins.
    pub(crate) fn meets(self, draw: impl FnOnce(Timestamp<Server>) -> Circumstances) -> Self {
        let circumstances = draw(self.begin);
        Self { circumstances, ..self }
    }

    /// Sets whether to keep the values that every robot sets.
    #[must_use]
    pub fn with_logs(self, logs: Logs) -> Self {
        Self { logs, ..self }
    }

    /// Plays to the end.
    #[must_use]
    pub fn play(self) -> Played {
        self.play_before(&mut ())
    }

    /// Plays to the end before an audience.
    #[must_use]
    pub fn play_before(self, audience: &mut impl Audience) -> Played {
        let Self { mut mission, robots, begin, logs, circumstances } = self;
        let operator = VirtualOperator::new(mission.choreography());
        let ids = mission.robot_ids().cloned().collect();
        let mut world = VirtualWorld::new(robots, ids, begin, (operator, circumstances), logs, audience);
        let report = at_once(drive(&mut mission, &mut world));
        // A virtual process is never killed.
        let mut report = report.unwrap_or_else(|| Report::as_left(&mut mission, begin));
        report.true_spread = world.true_spread();
        report.true_end_spread = world.true_end_spread();
        let starts = world.take_starts();
        let (logs, cut) = world.end();
        Played { report, logs, starts, cut }
    }
}

/// The start of virtual time: early enough to play all acts before the first one that waits for a time, but not hours before.
fn begin_of(choreography: &Choreography, options: &MissionOptions) -> Timestamp<Server> {
    let times = choreography.acts.iter().filter_map(|act| match act.wait {
        Wait::Instant(at) => Some(at),
        Wait::TimeOfDay(time) => Some(options.zone.next(BEGIN, time).unwrap_or_else(|skipped| skipped.at)),
        Wait::Done | Wait::Operator | Wait::Sensor { .. } => None,
    });
    let before =
        choreography.acts.iter().fold(BEFORE_TIME, |sum, act| sum + act.plan.duration() + BEFORE_TIME);
    times.min().map_or(BEGIN, |first| first - before)
}

/// A reading within the range and away from its edges.
fn reading_within(range: SensorRange) -> f64 {
    match range {
        SensorRange::Above(bound) => bound + bound.abs().max(1.0) / 100.0,
        SensorRange::Below(bound) => bound - bound.abs().max(1.0) / 100.0,
        SensorRange::Within(least, largest) => f64::midpoint(least, largest),
    }
}

/// Plays a mission that begins at [`BEGIN`] to its end, with simulated robots in the order of the mission's. The server's clock is the
/// true clock.
#[must_use]
pub fn play(mission: Mission, robots: Vec<SimulatedRobot>) -> Played {
    Rehearsal::of(mission, robots, BEGIN).with_logs(Logs::Kept).play()
}

/// The number of the act to which a request belongs: ids end with act, robot and script.
#[must_use]
pub fn act_of(request_id: &str) -> Option<u32> {
    request_id.rsplit('/').nth(2)?.parse().ok()
}

#[cfg(test)]
mod tests;
