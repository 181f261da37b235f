//! The virtual driver of a mission: the same mission machine and the same robot machines, time jumps from event to event.
//!
//! At one instant robots go first, in the order of the mission, then what they sent reaches the mission, then the mission's
//! own timers: the order of the real driver. The network is perfect but for what the robots are told to do wrong; for
//! one that is not, see `simulation/`.

use std::collections::{HashMap, HashSet};

use downbeat_robot::simulated::{Outgoing, SimulatedRobot, True};
use downbeat_robot::{Input, LinkId, LogEntry};
use downbeat_scripts::{Choreography, SensorRange, Wait};
use urrcp::{DeviceId, RobotId, Server, Span, Timestamp};

use crate::mission::{
    Action, Event, Loss, MissingParticipant, Mission, MissionOptions, Participant, Progress,
};
use crate::report::{ActReport, Report};

/// When virtual time begins where no act waits for an earlier instant: 2026-01-01T00:00:00Z.
pub const BEGIN: Timestamp<Server> = Timestamp::from_nanos(1_767_225_600_000_000_000);
/// So long before the first instant that an act waits for virtual time begins.
const BEFORE_INSTANT: Span = Span::from_millis(60_000);
/// So long after an act has begun to wait for the operator he says go.
const OPERATOR_THINKS: Span = Span::from_millis(1_000);

/// What a mission did in virtual time.
#[derive(Debug)]
pub struct Played {
    /// As after a real mission.
    pub report: Report,
    /// What each robot set, in the order of the mission's robots.
    pub logs: Vec<Vec<LogEntry>>,
    /// What the operator would have seen.
    pub progress: Vec<(Timestamp<Server>, Progress)>,
}

impl Played {
    /// What a robot set.
    #[must_use]
    pub fn log_of(&self, robot: &RobotId) -> Option<&[LogEntry]> {
        let index = self.report.robots.iter().position(|row| row.robot == *robot)?;
        self.logs.get(index).map(Vec::as_slice)
    }
}

/// A choreography about to be played in virtual time.
#[derive(Debug)]
pub struct Rehearsal {
    mission: Mission,
    robots: Vec<SimulatedRobot>,
    begin: Timestamp<Server>,
}

impl Rehearsal {
    /// With simulated robots in the order of the participants. Sensors that an act waits for read what it waits for.
    ///
    /// # Errors
    /// A robot of the choreography that has no participant.
    pub fn new(
        choreography: Choreography,
        participants: Vec<Participant>,
        options: MissionOptions,
        mut robots: Vec<SimulatedRobot>,
    ) -> Result<Self, MissingParticipant> {
        let instants = choreography.acts.iter().filter_map(|act| match act.wait {
            Wait::Instant(at) => Some(at - BEFORE_INSTANT),
            _ => None,
        });
        let begin = instants.min().unwrap_or(BEGIN);
        for act in &choreography.acts {
            let Wait::Sensor { robot, sensor, range } = &act.wait else { continue };
            let whose = participants.iter().position(|participant| participant.id.as_str() == robot);
            if let (Some(index), Ok(sensor)) = (whose, sensor.parse()) {
                robots[index].set_reading(sensor, reading_within(*range));
            }
        }
        let mission = Mission::new(choreography, participants, options, begin)?;
        Ok(Self { mission, robots, begin })
    }

    /// Lets a sensor read this. `false` where the robot takes no part, or has no such sensor.
    pub fn set_reading(&mut self, robot: &RobotId, sensor: &DeviceId, value: f64) -> bool {
        let index = self.mission.robots().iter().position(|state| state.id == *robot);
        let has = |index: &usize| {
            let device = self.robots[*index].robot().block().device(sensor.as_str());
            device.is_some_and(|device| device.available_control_types.sensor().is_some())
        };
        let index = index.filter(has);
        index.map(|index| self.robots[index].set_reading(sensor.clone(), value)).is_some()
    }

    /// Plays to the end.
    #[must_use]
    pub fn play(self) -> Played {
        play_from(self.mission, self.robots, self.begin)
    }
}

/// A reading that will do: not at the edge of what will.
fn reading_within(range: SensorRange) -> f64 {
    match range {
        SensorRange::Above(bound) => bound + bound.abs().max(1.0) / 100.0,
        SensorRange::Below(bound) => bound - bound.abs().max(1.0) / 100.0,
        SensorRange::Within(least, largest) => f64::midpoint(least, largest),
    }
}

/// Plays a mission that begins at [`BEGIN`] to its end with simulated robots in the order of the mission's. The server's
/// clock is the true one.
#[must_use]
pub fn play(mission: Mission, robots: Vec<SimulatedRobot>) -> Played {
    play_from(mission, robots, BEGIN)
}

fn play_from(mission: Mission, robots: Vec<SimulatedRobot>, begin: Timestamp<Server>) -> Played {
    let mut world = World {
        links: vec![LinkId(0); robots.len()],
        open: vec![true; robots.len()],
        due: Vec::new(),
        go: None,
        mission,
        robots,
        progress: Vec::new(),
        recorded: 0,
    };
    for robot in 0..world.robots.len() {
        world.tell_mission(begin, Event::LinkUp { robot });
    }
    let mut now = begin;
    let mut report = loop {
        world.advance_robots(now);
        world.reconnect(now);
        if world.go.take_if(|at| now >= *at).is_some() {
            world.tell_mission(now, Event::Go);
        }
        let due = world.mission.advance(now);
        world.perform(now, due);
        if let Some(report) = Report::of(&world.mission) {
            break report;
        }
        match world.next_wakeup() {
            Some(next) => now = now.max(next),
            // Nothing will ever happen again: no robot and no timer is due.
            None => break Report::as_left(&mut world.mission, now),
        }
    };
    let logs: Vec<_> = world.robots.iter_mut().map(SimulatedRobot::take_log).collect();
    let spreads = report.acts.iter().filter_map(|act| true_spread(&world.mission, act, &logs));
    report.true_spread = spreads.max();
    Played { report, logs, progress: world.progress }
}

/// Largest minus smallest error of the first steps of an act's scripts, by true time instead of the robots' own.
fn true_spread(mission: &Mission, act: &ActReport, logs: &[Vec<LogEntry>]) -> Option<Span> {
    let index_of: HashMap<_, _> =
        mission.robots().iter().enumerate().map(|(index, robot)| (&robot.id, index)).collect();
    let mut errors = Vec::new();
    for robot in act.robots.iter().filter(|robot| !robot.left_out) {
        let log = logs.get(*index_of.get(&robot.robot)?)?;
        // A device's scripts begin in the order of the plan.
        let mut begun: HashMap<&DeviceId, usize> = HashMap::new();
        for device in &robot.devices {
            let nth = begun.entry(&device.device).or_default();
            let mut firsts = log.iter().filter(|entry| {
                let of_act = entry.request_id.as_deref().and_then(act_of) == Some(act.number);
                of_act && entry.device == device.device && entry.motion == "set" && entry.step == Some(0)
            });
            let (first, planned) = (firsts.nth(*nth)?, device.planned_start? + device.first_step);
            errors.push(Span::from_nanos(first.true_ns - planned.as_nanos()));
            *nth += 1;
        }
    }
    Some(*errors.iter().max()? - *errors.iter().min()?)
}

/// The number of the act to which a request belongs: ids end with act, robot and script.
#[must_use]
pub fn act_of(request_id: &str) -> Option<u32> {
    request_id.rsplit('/').nth(2)?.parse().ok()
}

struct World {
    mission: Mission,
    robots: Vec<SimulatedRobot>,
    /// The link by which each robot is reached now.
    links: Vec<LinkId>,
    /// Links that the robots have not closed.
    open: Vec<bool>,
    /// Links to be made anew.
    due: Vec<(Timestamp<Server>, usize)>,
    /// When the operator says go.
    go: Option<Timestamp<Server>>,
    progress: Vec<(Timestamp<Server>, Progress)>,
    recorded: u64,
}

impl World {
    fn next_wakeup(&self) -> Option<Timestamp<Server>> {
        let robots = self.robots.iter().filter_map(SimulatedRobot::next_wakeup);
        let robots = robots.map(Timestamp::assume_clock::<Server>);
        let links = self.due.iter().map(|(at, _)| *at);
        robots.chain(links).chain(self.go).chain(self.mission.next_wakeup()).min()
    }

    fn advance_robots(&mut self, now: Timestamp<Server>) {
        let mut out = Vec::new();
        for robot in 0..self.robots.len() {
            self.robots[robot].advance(now.assume_clock::<True>(), &mut out);
            for outgoing in out.drain(..) {
                let (link, event) = match outgoing {
                    Outgoing::Message { link, message } => (link, Event::Received { robot, message }),
                    Outgoing::Close { link } => {
                        let reason = "the robot closed the link".to_owned();
                        (link, Event::LinkDown { robot, loss: Loss::Closed, reason })
                    }
                };
                if self.open[robot] && link == self.links[robot] {
                    self.open[robot] = !matches!(event, Event::LinkDown { .. });
                    self.tell_mission(now, event);
                }
            }
        }
    }

    fn reconnect(&mut self, now: Timestamp<Server>) {
        let due: HashSet<usize> =
            self.due.extract_if(.., |(at, _)| now >= *at).map(|(_, robot)| robot).collect();
        for robot in 0..self.robots.len() {
            if due.contains(&robot) {
                self.links[robot] = LinkId(self.links[robot].0 + 1);
                self.open[robot] = true;
                self.tell_mission(now, Event::LinkUp { robot });
            }
        }
    }

    fn tell_mission(&mut self, now: Timestamp<Server>, event: Event) {
        let actions = self.mission.handle(now, event);
        self.perform(now, actions);
    }

    fn perform(&mut self, now: Timestamp<Server>, actions: Vec<Action>) {
        let before = self.recorded;
        self.perform_each(now, actions);
        if self.recorded > before {
            let on_disk = self.mission.handle(now, Event::Recorded { count: self.recorded });
            self.perform(now, on_disk);
        }
    }

    fn perform_each(&mut self, now: Timestamp<Server>, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Send { robot, message, .. } if self.open[robot] => {
                    self.robots[robot].receive(
                        now.assume_clock(),
                        self.links[robot],
                        Input::Message(message),
                    );
                }
                Action::Reconnect { robot, after } => self.due.push((now + after, robot)),
                Action::Send { .. } => {}
                Action::Record(record) => self.recorded += u64::from(record.is_durable()),
                Action::Tell(progress) => {
                    if matches!(progress, Progress::Waiting { .. }) {
                        self.go = Some(now + OPERATOR_THINKS);
                    }
                    self.progress.push((now, progress));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
