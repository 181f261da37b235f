//! The robots' processes in a simulated world, their messages, and the hardware behind them.

use std::collections::BTreeSet;

use downbeat_robot::set_log::{LogEntry, MotionKind};
use downbeat_robot::simulated::{Outgoing, SimulatedRobot};
use downbeat_robot::{Input, LinkId};
use urrcp::{
    AvailabilityRequest, AvailabilityResponse, Command, ContentHash, ControlRequest, ControlResponse,
    ControlType, InitializationBlock, Message, Millis, Proof, Role, Script, Server, SessionId, Setpoint,
    Span, Status, Step, Timestamp,
};

use super::{BEGIN, Item, Machine, World};
use crate::braking::Braking;
use crate::{Connections, DrawnRobot, Hands, Happened, Lie, Names};
use downbeat_mission::Loss;
use downbeat_rehearsal::world::Path;

/// Time after which a driver considers hardware lost that has stopped answering without closing its connection.
const HARDWARE_GIVEN_UP: Span = Span::from_millis(2_000);
/// Minimum time that an edge needs to notice that its hardware has died without closing its connection.
const DEATH_KNOWN: Span = Span::from_millis(200);
/// First id of the links of other sessions. It is far from the ids of the scheduler's links.
const FOREIGN: u64 = 1 << 63;
/// Added to the id of another session's link if the peer is an operator that seizes a robot.
const SEIZES: u64 = 1 << 62;
/// Name of the operator that seizes a robot.
pub(crate) const SEIZED_BY: &str = "eva";
/// Time from sending another session's script to its start, in milliseconds.
const FOREIGN_AHEAD: f64 = 80.0;

/// The process that answers at a robot's address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Who {
    Itself,
    Stranger,
    /// Another process with the robot's id.
    Twin,
}

pub(super) struct RobotSide {
    pub(super) who: Who,
    pub(super) runs_on: Machine,
    /// The connection to the scheduler that the robot reads, if any.
    pub(super) link: Option<LinkId>,
    /// A connection that the robot will read once the current one has ended, with the messages received on it.
    pub(super) waiting: Option<(LinkId, Vec<Message>)>,
    pub(super) path: Path,
    /// The instant until which dead connections, which carry no messages, persist.
    pub(super) dead_until: Timestamp<Server>,
    /// Connections that no longer carry messages.
    pub(super) dead: BTreeSet<LinkId>,
    pub(super) log: Vec<LogEntry>,
    /// How the robot's devices came to rest.
    pub(super) brakings: Vec<Braking>,
    /// The log of another robot that answered at this robot's address.
    pub(super) log_of_stranger: Vec<LogEntry>,
    pub(super) clock_steps: Span,
    /// The current reading of the robot's sensor; `None` until it is set.
    pub(super) reading: Option<f64>,
    hardware_dead_since: Option<Timestamp<Server>>,
    /// Request ids of scripts that the robot began although its hardware was dead.
    pub(super) starts_of_dead: Vec<String>,
}

impl RobotSide {
    pub(super) fn new(path: Path) -> Self {
        Self {
            who: Who::Itself,
            runs_on: Machine::Up,
            link: None,
            waiting: None,
            path,
            dead_until: BEGIN,
            dead: BTreeSet::new(),
            log: Vec::new(),
            brakings: Vec::new(),
            log_of_stranger: Vec::new(),
            clock_steps: Span::ZERO,
            reading: None,
            hardware_dead_since: None,
            starts_of_dead: Vec::new(),
        }
    }

    fn collect(&mut self, machine: &mut SimulatedRobot, who: Who) {
        let log = machine.take_log();
        if log.is_empty() {
            return;
        }
        if who == Who::Itself {
            self.brakings.extend(brakings(machine, &log));
        }
        let foreign = |entry: &LogEntry| entry.request_id.as_deref() == Some("foreign");
        let entries = log.into_iter().filter(|entry| !foreign(entry));
        match who {
            Who::Itself => {
                let before = self.log.len();
                self.log.extend(entries);
                self.note_starts_of_dead(before);
            }
            Who::Stranger => self.log_of_stranger.extend(entries),
            Who::Twin => {}
        }
    }
}

impl RobotSide {
    /// Stores the scripts that the robot began although its hardware was dead, according to the log entries from index `from` on.
    fn note_starts_of_dead(&mut self, from: usize) {
        let Some(since) = self.hardware_dead_since else { return };
        let known = (since + DEATH_KNOWN).as_nanos();
        let starts = |entry: &&LogEntry| entry.step == Some(0) && entry.is_set();
        let dead = self.log[from..].iter().filter(starts).filter(|entry| entry.true_ns > known);
        self.starts_of_dead.extend(dead.filter_map(|entry| entry.request_id.clone()));
    }
}

/// Determines how the devices of a robot that still slow down come to rest. Considers the last log entry of each device and control type.
fn brakings(machine: &SimulatedRobot, log: &[LogEntry]) -> Vec<Braking> {
    let slow = |(_, entry): &(usize, &LogEntry)| entry.motion == MotionKind::Slow;
    let is_last = |(index, entry): &(usize, &LogEntry)| {
        let mut later = log[index + 1..].iter();
        !later.any(|later| later.device == entry.device && later.control_type == entry.control_type)
    };
    let value =
        |entry: &LogEntry, control_type, at| machine.robot().value(entry.device.as_str(), control_type, at);
    let last = log.iter().enumerate().filter(slow).filter(is_last);
    last.filter_map(|(_, entry)| Braking::of(entry, |of, at| value(entry, of, at))).collect()
}

/// Creates the simulated robot for a new process. Its clock has drifted since the start of the mission, whether or not a process ran.
pub(super) fn machine(
    drawn: &DrawnRobot,
    block: InitializationBlock,
    now: Timestamp<Server>,
) -> SimulatedRobot {
    let mut settings = drawn.settings.clone();
    let drifted = (now - BEGIN).as_millis_f64() * settings.drift_ppm * 1e-6;
    settings.clock_offset += Span::from_millis_f64(drifted);
    match drawn.hands {
        Hands::Own => SimulatedRobot::new(block, settings),
        Hands::Hardware => SimulatedRobot::with_hardware(block, settings, now.assume_clock()),
    }
}

impl World {
    /// Moves the log of the values that a robot has set into the results.
    pub(super) fn collect(&mut self, robot: usize) {
        let hidden = self.hidden(robot);
        let side = &mut self.robots[robot];
        self.kernel.robots.change(hidden, |machine| side.collect(machine, Who::Itself));
        let who = side.who;
        self.kernel.robots.change(robot, |machine| side.collect(machine, who));
    }

    /// Ends the process that answers at a robot's address. Returns `false` if no process ran.
    pub(super) fn robot_dies(&mut self, robot: usize, runs_on: Machine) -> bool {
        self.collect(robot);
        if self.kernel.robots.end(robot).is_none() {
            return false;
        }
        let side = &mut self.robots[robot];
        side.runs_on = runs_on;
        let links = [side.link.take(), side.waiting.take().map(|(link, _)| link)];
        if runs_on == Machine::Up {
            for link in links.into_iter().flatten() {
                self.link_breaks(
                    robot,
                    link,
                    self.kernel.now,
                    Loss::Closed,
                    "the robot closed the connection",
                );
            }
        }
        true
    }

    /// Starts a process at a robot's address.
    pub(super) fn robot_begins(&mut self, robot: usize, block: InitializationBlock) {
        let drawn = &self.drawn.robots[robot];
        let who = if block.id == drawn.block.id { Who::Itself } else { Who::Stranger };
        let mut machine = machine(drawn, block, self.kernel.now);
        // A new process first searches for its hardware, which is present here.
        self.robots[robot].hardware_dead_since = None;
        self.collect(robot);
        let side = &mut self.robots[robot];
        machine.step_clock(side.clock_steps);
        if let (Some(reading), Ok(eye)) = (side.reading, "eye".parse()) {
            machine.set_reading(eye, reading);
        }
        (side.who, side.runs_on) = (who, Machine::Up);
        self.kernel.robots.begin(robot, machine);
    }

    /// Returns the index at which a robot's own process is stored while a twin answers at its address.
    const fn hidden(&self, robot: usize) -> usize {
        self.robots.len() + robot
    }

    /// Starts a twin: another process with the id of a robot, at its address. The robot continues, but is unreachable.
    pub(super) fn twin_begins(&mut self, robot: usize) {
        if self.robots[robot].who != Who::Itself {
            return;
        }
        let Some(mut itself) = self.kernel.robots.end(robot) else { return };
        let side = &mut self.robots[robot];
        let links = [side.link.take(), side.waiting.take().map(|(link, _)| link)];
        let now = self.kernel.now;
        for link in links.into_iter().flatten() {
            itself.receive(now.assume_clock(), link, Input::LinkDown);
            self.link_breaks(robot, link, now, Loss::Closed, "the robot closed the connection");
        }
        self.kernel.robots.begin(self.hidden(robot), itself);
        let block = self.drawn.robots[robot].block.clone();
        self.robot_begins(robot, block);
        self.robots[robot].who = Who::Twin;
    }

    /// Advances a robot's own process while its twin answers. The messages of the process are discarded.
    pub(super) fn advance_hidden(&mut self, robot: usize) {
        let now = self.kernel.now.assume_clock();
        self.kernel.robots.change(self.hidden(robot), |machine| machine.advance(now, &mut Vec::new()));
        self.collect(robot);
    }

    pub(super) fn robot_back(&mut self, robot: usize) {
        if self.robots[robot].who != Who::Itself {
            self.robot_dies(robot, Machine::Up);
        }
        if let Some(itself) = self.kernel.robots.end(self.hidden(robot)) {
            self.kernel.robots.begin(robot, itself);
            let side = &mut self.robots[robot];
            (side.who, side.runs_on) = (Who::Itself, Machine::Up);
            return self.note(Happened::Back(robot));
        }
        if self.kernel.robots.get(robot).is_none() {
            let block = self.drawn.robots[robot].block.clone();
            self.robot_begins(robot, block);
            self.note(Happened::Back(robot));
        }
    }

    pub(super) fn advance_robot(&mut self, robot: usize) {
        let mut said = std::mem::take(&mut self.said);
        let now = self.kernel.now.assume_clock();
        self.kernel.robots.change(robot, |machine| machine.advance(now, &mut said));
        self.collect(robot);
        let is_itself = self.robots[robot].who == Who::Itself;
        for outgoing in said.drain(..) {
            if let Outgoing::Message { link, message } = outgoing {
                if link.0 & (FOREIGN | SEIZES) == FOREIGN | SEIZES && is_itself && is_taken(&message) {
                    self.note(Happened::Seized(robot));
                }
                let slow = self.drawn.robots[robot].slow;
                let message = Box::new(self.as_said(robot, message));
                self.kernel.put(self.kernel.now + slow, Item::Answer { robot, link, message });
            }
        }
        self.said = said;
    }

    /// Modifies a message of a robot that lies, or that omits fields because it does not know them.
    fn as_said(&mut self, robot: usize, mut message: Message) -> Message {
        let drawn = &self.drawn.robots[robot];
        match &mut message {
            Message::InitializationBlock(block) => block.inquiry = drawn.block.inquiry,
            Message::ControlResponse(response) if drawn.names == Names::LeftOut => {
                // The robot supports no extension at all.
                let ControlResponse { request_id, content_hash, event_timestamp, .. } = response;
                (*request_id, *content_hash, *event_timestamp) = (None, None, None);
                (response.steps_done, response.late_steps, response.late_ms_max) = (None, None, None);
            }
            _ => {}
        }
        match (drawn.lie, &mut message) {
            (Some(Lie::WrongTime(by)), Message::AvailabilityResponse(response)) => {
                let AvailabilityResponse { receive_timestamp, timestamp, .. } = response;
                *receive_timestamp = *receive_timestamp + by;
                *timestamp = *timestamp + by;
            }
            (Some(Lie::WrongHash), Message::ControlResponse(response)) if response.content_hash.is_some() => {
                response.content_hash = Some(ContentHash::of(b"something else"));
            }
            (Some(Lie::TooManySteps), Message::ControlResponse(response)) => {
                response.steps_done = response.steps_done.map(|_| u32::MAX);
            }
            (Some(Lie::TooManySteps), Message::InquiryResponse(response)) => {
                for report in &mut response.requests {
                    report.steps_done = report.steps_done.map(|_| u32::MAX);
                }
            }
            (
                Some(Lie::Forgets),
                Message::ControlResponse(ControlResponse { status: Status::Accepted, .. }),
            ) => {
                let block = drawn.block.clone();
                self.robot_begins(robot, block);
            }
            _ => {}
        }
        message
    }

    pub(super) fn hardware_dies(&mut self, robot: usize, back_after: Option<Span>, told: bool) {
        let now = self.kernel.now;
        let side = &mut self.robots[robot];
        if self.drawn.robots[robot].hands == Hands::Own {
            return;
        }
        side.hardware_dead_since.get_or_insert(now);
        let at = now.assume_clock();
        let dies = |machine: &mut SimulatedRobot| {
            if told {
                machine.hardware_lost(at, "its connection has ended");
            } else {
                machine.hardware_dies(at);
            }
        };
        if self.kernel.robots.change(robot, dies).is_none() {
            return;
        }
        if !told && back_after.is_none_or(|after| after > HARDWARE_GIVEN_UP) {
            self.kernel.put(now + HARDWARE_GIVEN_UP, Item::HardwareLost(robot));
        }
        if let Some(after) = back_after {
            self.kernel.put(now + after, Item::HardwareBack(robot));
        }
    }

    pub(super) fn hardware_lost(&mut self, robot: usize) {
        let now = self.kernel.now.assume_clock();
        self.kernel.robots.change(robot, |machine| machine.hardware_lost(now, "it does not answer"));
    }

    pub(super) fn hardware_back(&mut self, robot: usize) {
        let now = self.kernel.now.assume_clock();
        self.robots[robot].hardware_dead_since = None;
        self.kernel.robots.change(robot, |machine| machine.hardware_found(now));
    }

    /// Lets another session claim a robot and send it a script, as far as the robot permits.
    pub(super) fn foreign_session(&mut self, robot: usize, lasts: Span) {
        self.asks_for(robot, LinkId(FOREIGN + robot as u64), lasts);
    }

    /// Lets an operator with the role `seize` seize a robot and send it a script.
    pub(super) fn seize(&mut self, robot: usize, lasts: Span) {
        let link = LinkId(FOREIGN + SEIZES + robot as u64);
        if let Ok(name) = SEIZED_BY.parse() {
            let roles = [Role::Drive, Role::Seize].into_iter().collect();
            let proof = Proof { name, roles, serial: None };
            self.receive(robot, link, Input::Proven(proof));
        }
        self.asks_for(robot, link, lasts);
    }

    fn asks_for(&mut self, robot: usize, link: LinkId, lasts: Span) {
        let now = self.kernel.now;
        let seize = link.0 & SEIZES != 0;
        let one = self.drawn.robots[robot].connections == Connections::One;
        if self.kernel.robots.get(robot).is_none() || one && self.robots[robot].link.is_some() {
            return;
        }
        let session = SessionId::new("another").ok();
        let ask = AvailabilityRequest {
            timestamp: Some(now),
            session: session.clone(),
            seize,
            revocation_list: None,
        };
        self.receive(robot, link, Input::Message(Message::AvailabilityRequest(ask)));
        if let Some(request) = foreign_script(&self.drawn.robots[robot].block, now, session) {
            self.receive(robot, link, Input::Message(Message::ControlRequest(request)));
        }
        self.kernel.put(now + lasts, Item::ForeignEnd { robot, link });
    }

    /// Sets the sensor reading that an act waits for.
    pub(super) fn reads(&mut self, robot: usize, reading: f64) {
        self.robots[robot].reading = Some(reading);
        if let Ok(eye) = "eye".parse() {
            self.kernel.robots.change(robot, |machine| machine.set_reading(eye, reading));
        }
    }
}

/// Whether a robot's message confirms that it now belongs to the session that asked for it.
fn is_taken(message: &Message) -> bool {
    matches!(message, Message::AvailabilityResponse(response) if response.status == Status::Ok)
}

fn foreign_script(
    block: &InitializationBlock,
    now: Timestamp<Server>,
    session: Option<SessionId>,
) -> Option<ControlRequest> {
    let device = block.devices.first()?;
    let setpoint = match device.primary_control_type()? {
        ControlType::Position => Setpoint::new(ControlType::Position, 1.0),
        // The speed or acceleration is zero, so that no movement continues after the script.
        rate => Setpoint::new(rate, 0.0),
    };
    let step = Step { offset: Millis::ZERO, setpoint, stop_condition: None };
    let command = Command::Script(Script::new(vec![step]).ok()?);
    let mut request = ControlRequest::immediate(device.id.clone(), command);
    request.timestamp = Some(now);
    request.time_offset_to_start = Millis::new(FOREIGN_AHEAD).ok();
    request.request_id = "foreign".parse().ok();
    request.session = session;
    Some(request)
}
