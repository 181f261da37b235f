//! Plays a mission in virtual time, with the same main loop and the same state machines of mission and robots as in a real mission. Time
//! jumps from event to event. The network has the delays of the fleet file and loses nothing; only trials draw networks that lose
//! messages.
//!
//! A virtual operator gives the go (the signal to start) whenever an act waits and no other act plays. Every dry run ends: it plays a
//! loop of acts a fixed number of times, and ends at an act whose condition never occurs ([`Cut`]).

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
use downbeat_mission::{
    ActNumber, MissingParticipant, Mission, MissionOptions, Participant, Progress, RobotIndex,
};

/// Start of virtual time if no act waits for a time: 2026-01-01T00:00:00Z.
pub const BEGIN: Timestamp<Server> = Timestamp::from_nanos(1_767_225_600_000_000_000);
/// Margin between the start of virtual time and the first time that an act waits for. Added to it are the duration of each act and, for
/// each act, another margin of this size.
const BEFORE_TIME: Span = Span::from_millis(60_000);
/// Number of times that a loop through all acts is played, unless [`MissionOptions::acts_max`] overrides it.
pub const ROUNDS: u32 = 3;

/// The result of a mission played in virtual time.
#[derive(Debug)]
pub struct Played {
    /// The report, as after a real mission.
    pub report: Report,
    /// The values that each robot set, in the order of the mission's robots; empty unless logs are kept.
    pub logs: Vec<Vec<LogEntry>>,
    /// The scripts that really started in each act that has ended, in the order of the acts.
    pub starts: Vec<ActStarts>,
    /// Why the virtual operator ended the mission prematurely; `None` if it did not.
    pub cut: Option<Cut>,
}

/// Why the virtual operator stopped a mission: an act waited for an event that does not occur in virtual time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Name of the waiting act.
    pub act: String,
    /// The event that the act waits for, described for people.
    pub awaits: String,
}

impl Played {
    /// Returns the values that `robot` set; `None` if the mission has no such robot.
    #[must_use]
    pub fn log_of(&self, robot: &RobotId) -> Option<&[LogEntry]> {
        let index = self.report.robots.iter().position(|row| row.robot == *robot)?;
        self.logs.get(index).map(Vec::as_slice)
    }
}

/// Whether to keep the values that the robots set. Each kept step takes about 250 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Logs {
    /// Values are used for the report and then dropped.
    #[default]
    Dropped,
    /// All values are kept, for example to draw them.
    Kept,
    /// The audience receives all values, and none are kept.
    Watched,
}

/// Observes a dry run while it plays.
pub trait Audience {
    /// Receives a message for the operator.
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress);

    /// Called once per second of virtual time.
    fn second(&mut self, now: Timestamp<Server>);

    /// Receives a value that the robot with the given index has set. Called only if values are kept or watched.
    fn set(&mut self, _robot: RobotIndex, _entry: &LogEntry) {}
}

impl Audience for () {
    fn told(&mut self, _: Timestamp<Server>, _: &Progress) {}

    fn second(&mut self, _: Timestamp<Server>) {}
}

/// A choreography that is ready to be played in virtual time.
#[derive(Debug)]
pub struct Rehearsal {
    mission: Mission,
    robots: Vec<SimulatedRobot>,
    begin: Timestamp<Server>,
    logs: Logs,
    circumstances: Circumstances,
}

impl Rehearsal {
    /// Creates a rehearsal with one simulated robot per participant, in the same order. At the start, devices are where the first act
    /// expects them. Each sensor that an act waits for gives a reading that satisfies the act's condition.
    ///
    /// # Errors
    /// An error if a robot of the choreography is not among the participants.
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
        let first =
            choreography.acts.get(options.first_act.get()).into_iter().flat_map(|act| &act.plan.robots);
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

    /// Returns this rehearsal with the circumstances (network, faults, sensor readings) that `draw` returns for the start time of the
    /// mission.
    pub(crate) fn meets(self, draw: impl FnOnce(Timestamp<Server>) -> Circumstances) -> Self {
        let circumstances = draw(self.begin);
        Self { circumstances, ..self }
    }

    /// Sets whether to keep the values that the robots set.
    #[must_use]
    pub fn with_logs(self, logs: Logs) -> Self {
        Self { logs, ..self }
    }

    /// Plays the mission to its end.
    #[must_use]
    pub fn play(self) -> Played {
        self.play_before(&mut ())
    }

    /// Plays the mission to its end, observed by `audience`.
    #[must_use]
    pub fn play_before(self, audience: &mut impl Audience) -> Played {
        let Self { mut mission, robots, begin, logs, circumstances } = self;
        let operator = VirtualOperator::new(mission.choreography());
        let ids = mission.robot_ids().cloned().collect();
        let mut world = VirtualWorld::new(robots, ids, begin, operator, circumstances, logs, audience);
        let report = at_once(drive(&mut mission, &mut world));
        // The fallback is for completeness: a virtual scheduler process is never killed.
        let mut report = report.unwrap_or_else(|| Report::as_left(&mut mission, begin));
        report.true_spread = world.true_spread();
        report.true_end_spread = world.true_end_spread();
        let starts = world.take_starts();
        let (logs, cut) = world.end();
        Played { report, logs, starts, cut }
    }
}

/// Returns the start of virtual time. It is early enough to play all acts before the first time that an act waits for, but not hours
/// earlier.
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

/// Returns a sensor reading within `range` and away from its limits.
fn reading_within(range: SensorRange) -> f64 {
    match range {
        SensorRange::Above(bound) => bound + bound.abs().max(1.0) / 100.0,
        SensorRange::Below(bound) => bound - bound.abs().max(1.0) / 100.0,
        SensorRange::Within(least, largest) => f64::midpoint(least, largest),
    }
}

/// Plays a mission that starts at [`BEGIN`] to its end. `robots` are in the order of the mission's robots. The server's clock shows the
/// true time.
#[must_use]
pub fn play(mission: Mission, robots: Vec<SimulatedRobot>) -> Played {
    Rehearsal::of(mission, robots, BEGIN).with_logs(Logs::Kept).play()
}

/// Returns the number of the act that a request belongs to. Request ids end with the numbers of act, robot and script.
#[must_use]
pub fn act_of(request_id: &str) -> Option<ActNumber> {
    request_id.rsplit('/').nth(2)?.parse().ok().map(ActNumber::new)
}

#[cfg(test)]
mod tests;
