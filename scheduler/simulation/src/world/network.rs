//! What becomes of messages on their way, and of links.

use downbeat_robot::{Input, LinkId};
use urrcp::{Command, ControlRequest, Inquiry, Message, Server, Span, Timestamp};

use super::{CONNECT_FAILS, Item, Machine, World};
use crate::{Connections, Happened, Lie, Network};
use downbeat_mission::{Event, Loss};

/// About what messages have in bytes: each, each step of a script, each request that is named.
const MESSAGE_BYTES: usize = 220;
const STEP_BYTES: usize = 60;
const NAME_BYTES: usize = 70;

/// From the scheduler, and to it.
const THERE: usize = 0;
const BACK: usize = 1;

impl World {
    /// When a message arrives, or that it is lost.
    fn travel(&mut self, robot: usize, way: usize, message: &Message) -> Option<Timestamp<Server>> {
        let (least, largest) = self.drawn.delay;
        let mut delay = Span::from_nanos(self.rng.i64(least.as_nanos()..=largest.as_nanos()));
        if self.rng.f64() < self.drawn.tail {
            delay += largest * self.rng.i64(1..=20);
        }
        let (usual, takes) = self.transmission(robot, message);
        let side = &mut self.robots[robot];
        if let Some((by, _)) = side.lags.filter(|(_, until)| self.now < *until) {
            delay += by;
        }
        let arrival = match self.drawn.network {
            Network::Stream => {
                let sent = self.now.max(side.busy[way]) + takes;
                side.busy[way] = sent;
                // What a stream carries into a partition comes out of it at its end.
                let arrival = (sent.max(side.blocked_until[way]) + delay).max(side.last[way]);
                side.last[way] = arrival;
                arrival
            }
            Network::Datagram { loss, .. } => {
                if self.now < side.blocked_until[way] || self.rng.f64() < loss {
                    self.note(Happened::Lost(robot));
                    return None;
                }
                let sent = self.now.max(side.busy[way]) + takes;
                side.busy[way] = sent;
                sent + delay
            }
        };
        let travelled = arrival - self.now;
        // Waiting behind other messages for a link as it usually is, is nothing that goes wrong.
        let queued = if takes == usual && side.slow.is_none() { side.busy[way] - self.now } else { usual };
        let queued = queued.max(Span::ZERO);
        if travelled > largest + queued {
            self.note(Happened::Slow(robot, travelled));
        }
        if queued > Span::ZERO {
            self.note(Happened::Queued(robot, queued));
        }
        if queued > Span::ZERO && is_stop(message) {
            self.note(Happened::StopQueued(robot, queued));
        }
        Some(arrival)
    }

    /// How long it takes to put a message on the link, as it usually is and as it is now.
    fn transmission(&self, robot: usize, message: &Message) -> (Span, Span) {
        let usual = self.drawn.robots[robot].bandwidth;
        let slow = self.robots[robot].slow.filter(|(_, until)| self.now < *until).map(|(slow, _)| slow);
        if usual.is_none() && slow.is_none() {
            return (Span::ZERO, Span::ZERO);
        }
        let bytes = i64::try_from(bytes_of(message)).unwrap_or(i64::MAX);
        let takes = |bandwidth: u32| Span::from_nanos(bytes * 1_000_000_000 / i64::from(bandwidth.max(1)));
        let usual = usual.map(takes).unwrap_or_default();
        (usual, slow.map_or(usual, takes))
    }

    fn doubled(&mut self) -> bool {
        match self.drawn.network {
            Network::Stream => false,
            Network::Datagram { double, .. } => self.rng.f64() < double,
        }
    }

    /// A message reaches the robot's machine, if that reads this connection.
    pub(super) fn arrive_at_robot(&mut self, robot: usize, link: LinkId, message: Message) {
        let side = &mut self.robots[robot];
        if let Some((_, unread)) = side.waiting.as_mut().filter(|(waiting, _)| *waiting == link) {
            return unread.push(message);
        }
        if side.link != Some(link) || side.machine.is_none() {
            return self.refuse_stray(robot, link);
        }
        if self.now < side.paused_until {
            let later = side.paused_until;
            return self.put(later, Item::ToRobot { robot, link, message: Box::new(message) });
        }
        let forgets = self.drawn.robots[robot].lie == Some(Lie::NeverMoves);
        if self.verbose {
            self.note(Happened::AtRobot(robot, message.clone()));
        } else if !forgets {
            self.note(Happened::AtRobot(robot, brief(&message)));
        }
        if let Some(machine) = &mut self.robots[robot].machine {
            machine.receive(self.now.assume_clock(), link, Input::Message(message));
        }
    }

    /// A system answers what comes on a connection that it does not know, as after a restart, by resetting it.
    fn refuse_stray(&mut self, robot: usize, link: LinkId) {
        let side = &self.robots[robot];
        if side.runs_on == Machine::Up && side.link != Some(link) && self.drawn.network == Network::Stream {
            self.link_breaks(robot, link, self.now, (Loss::Closed, "connection reset"));
        }
    }

    pub(super) fn answer(&mut self, robot: usize, link: LinkId, message: Message) {
        if self.robots[robot].link != Some(link) || self.is_dead(robot, link) {
            return;
        }
        let put = |world: &mut Self, at, message| {
            let event = Box::new(Event::Received { robot, message });
            world.put(at, Item::ToScheduler { robot, link, event });
        };
        if self.doubled()
            && let Some(at) = self.travel(robot, BACK, &message)
        {
            put(self, at, message.clone());
        }
        if let Some(at) = self.travel(robot, BACK, &message) {
            put(self, at, message);
        }
    }

    pub(super) fn send_to_robot(&mut self, robot: usize, link: LinkId, message: Message) {
        if self.verbose {
            self.note(Happened::ToRobot(robot, message.clone()));
        }
        if self.is_dead(robot, link) {
            return;
        }
        if self.doubled()
            && let Some(at) = self.travel(robot, THERE, &message)
        {
            self.put(at, Item::ToRobot { robot, link, message: Box::new(message.clone()) });
        }
        if let Some(at) = self.travel(robot, THERE, &message) {
            self.put(at, Item::ToRobot { robot, link, message: Box::new(message) });
        }
    }

    /// Whether a connection carries nothing any more.
    fn is_dead(&mut self, robot: usize, link: LinkId) -> bool {
        let dead = self.robots[robot].dead.contains(&link);
        if dead {
            self.note(Happened::Lost(robot));
        }
        dead
    }

    /// The scheduler finds that a connection has ended, as soon as word of it can come through.
    pub(super) fn link_breaks(
        &mut self,
        robot: usize,
        link: LinkId,
        at: Timestamp<Server>,
        (loss, reason): (Loss, &str),
    ) {
        if self.robots[robot].dead.contains(&link) {
            return;
        }
        let event = Box::new(Event::LinkDown { robot, loss, reason: reason.to_owned() });
        let at = at.max(self.robots[robot].blocked_until[BACK]).max(self.robots[robot].last[BACK]);
        self.put(at + self.drawn.delay.1, Item::ToScheduler { robot, link, event });
    }

    /// Connections that carry nothing are found broken.
    pub(super) fn dead_links_end(&mut self, robot: usize) {
        if self.now < self.robots[robot].dead_until {
            return;
        }
        for link in std::mem::take(&mut self.robots[robot].dead) {
            self.link_breaks(robot, link, self.now, (Loss::Closed, "connection reset"));
            self.robot_link_down(robot, link);
        }
    }

    pub(super) fn connect(&mut self, robot: usize, link: LinkId) {
        if !self.links_to(robot, link) {
            return;
        }
        let side = &mut self.robots[robot];
        if self.now < side.dead_until {
            side.dead.insert(link);
            return self.tell_on_link(robot, link, Event::LinkUp { robot });
        }
        let reachable = side.blocked_until.iter().all(|until| self.now >= *until);
        if !reachable || side.machine.is_none() {
            let (loss, after) = match side.runs_on {
                Machine::Up if reachable => (Loss::Refused, self.drawn.delay.1 * 2),
                Machine::Up | Machine::Down => (Loss::Unreachable, CONNECT_FAILS),
            };
            let event = Box::new(Event::LinkDown { robot, loss, reason: "no connection".to_owned() });
            let at = self.now + after;
            return self.put(at, Item::ToScheduler { robot, link, event });
        }
        let one = self.drawn.robots[robot].connections == Connections::One;
        if one && side.link.is_some() {
            side.waiting = Some((link, Vec::new()));
        } else {
            self.robot_reads(robot, link);
        }
        self.tell_on_link(robot, link, Event::LinkUp { robot });
    }

    /// The robot reads this connection from now on; an older one is closed.
    fn robot_reads(&mut self, robot: usize, link: LinkId) {
        let now = self.now;
        let side = &mut self.robots[robot];
        if let (Some(old), Some(machine)) = (side.link.replace(link), &mut side.machine) {
            machine.receive(now.assume_clock(), old, Input::LinkDown);
        }
        side.last = [now; 2];
        side.busy = [now; 2];
    }

    /// The robot sees that a connection has ended. It turns to one that waits.
    pub(super) fn robot_link_down(&mut self, robot: usize, link: LinkId) {
        let now = self.now.assume_clock();
        let side = &mut self.robots[robot];
        side.waiting.take_if(|(waiting, _)| *waiting == link);
        if side.link != Some(link) {
            return;
        }
        side.link = None;
        if let Some(machine) = &mut side.machine {
            machine.receive(now, link, Input::LinkDown);
        }
        if let Some((next, unread)) = side.waiting.take() {
            self.robot_reads(robot, next);
            for message in unread {
                self.arrive_at_robot(robot, next, message);
            }
        }
    }
}

fn is_stop(message: &Message) -> bool {
    let Message::ControlRequest(request) = message else { return false };
    matches!(&request.command, Command::Script(script) if script.is_empty())
}

fn bytes_of(message: &Message) -> usize {
    let steps = |command: &Command| match command {
        Command::Script(script) => script.steps().len(),
        _ => 0,
    };
    let more = match message {
        Message::ControlRequest(request) => STEP_BYTES * steps(&request.command),
        Message::ControlResponse(response) => match &response.status_value {
            urrcp::StatusValue::Script(script) => STEP_BYTES * script.steps().len(),
            _ => 0,
        },
        Message::Inquiry(inquiry) => NAME_BYTES * inquiry.requests.len(),
        Message::InquiryResponse(response) => 3 * NAME_BYTES * response.requests.len(),
        _ => 0,
    };
    MESSAGE_BYTES + more
}

/// As much of a message as the checks need.
fn brief(message: &Message) -> Message {
    match message {
        Message::ControlRequest(request) => {
            let cancels = is_stop(message);
            let command = if cancels { request.command.clone() } else { Command::ReadSensor };
            Message::ControlRequest(ControlRequest {
                timestamp: request.timestamp,
                time_offset_to_start: request.time_offset_to_start,
                device_id: request.device_id.clone(),
                stop_condition: request.stop_condition,
                pending_until: request.pending_until,
                request_id: request.request_id.clone(),
                content_hash: request.content_hash,
                session: request.session.clone(),
                home: request.home,
                command,
            })
        }
        Message::Inquiry(inquiry) => {
            let Inquiry { timestamp, pending_lease, pending_until, .. } = *inquiry;
            // Whether it names any is what counts: only such a one lifts the end of a lease.
            let requests = inquiry.requests.iter().take(1).cloned().collect();
            let brief = Inquiry { timestamp, requests, pending_lease, pending_until, ..Inquiry::default() };
            Message::Inquiry(brief)
        }
        other => other.clone(),
    }
}
