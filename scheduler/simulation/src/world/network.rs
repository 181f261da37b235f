//! Transports messages between the scheduler and the robots, and tracks the state of links.

use downbeat_robot::{Input, LinkId};
use fastrand::Rng;
use urrcp::{Command, ControlRequest, Inquiry, Message, Server, Span, Timestamp};

use super::{BEGIN, CONNECT_FAILS, HistoryDetail, Item, Machine, World};
use crate::{Connections, Direction, Drawn, DrawnRobot, Happened, Lie, Network};
use downbeat_fleet::world::{Between, Delay, LinkWorld};
use downbeat_mission::{Event, Loss};
use downbeat_rehearsal::world::{Conditions, Path, Transport, Travel};

/// Creates the network path to a robot, without partitions and other faults.
pub(super) fn path(drawn: &Drawn, robot: &DrawnRobot, rng: &mut Rng) -> Path {
    let (least, largest) = drawn.delay;
    let transport = match drawn.network {
        Network::Stream => Transport::Held,
        Network::Datagram { loss, double } => Transport::Datagram { loss, double },
    };
    let link = LinkWorld::with_delay(Delay::Between(Between { least, largest }));
    let conditions = Conditions { link, transport, tail: Some(drawn.tail), bandwidth: robot.bandwidth };
    Path::new(conditions, rng, BEGIN)
}

impl World {
    /// Returns when a message arrives; `None` if it is lost.
    fn travel(&mut self, robot: usize, way: Direction, message: &Message) -> Option<Timestamp<Server>> {
        let path = &mut self.robots[robot].path;
        let Some(travel) = path.travel(&mut self.rng, self.kernel.now, way, Some(message)) else {
            self.note(Happened::Lost(robot));
            return None;
        };
        let Travel { arrives, queued } = travel;
        let travelled = arrives - self.kernel.now;
        if travelled > self.drawn.delay.1 + queued {
            self.note(Happened::Slow(robot, travelled));
        }
        if queued > Span::ZERO {
            self.note(Happened::Queued(robot, queued));
        }
        if queued > Span::ZERO && is_stop(message) {
            self.note(Happened::StopQueued(robot, queued));
        }
        Some(arrives)
    }

    /// Returns when a message arrives at a robot or the scheduler, once per copy: a datagram may be lost or arrive twice.
    fn arrivals(
        &mut self,
        robot: usize,
        way: Direction,
        message: Message,
    ) -> impl Iterator<Item = (Timestamp<Server>, Message)> + use<> {
        let doubled = self.robots[robot].path.doubles(&mut self.rng);
        let twin = if doubled { self.travel(robot, way, &message) } else { None };
        let twin = twin.map(|at| (at, message.clone()));
        let arrives = self.travel(robot, way, &message);
        twin.into_iter().chain(arrives.map(|at| (at, message)))
    }

    /// Delivers a message to a robot if the robot currently reads this connection.
    pub(super) fn arrive_at_robot(&mut self, robot: usize, link: LinkId, message: Message) {
        let side = &mut self.robots[robot];
        if let Some((_, unread)) = side.waiting.as_mut().filter(|(waiting, _)| *waiting == link) {
            return unread.push(message);
        }
        if side.link != Some(link) || self.kernel.robots.get(robot).is_none() {
            return self.refuse_stray(robot, link);
        }
        if let Some(later) = self.kernel.robots.stalls_until(robot, self.kernel.now) {
            return self.kernel.put(later, Item::ToRobot { robot, link, message: Box::new(message) });
        }
        let forgets = self.drawn.robots[robot].lie == Some(Lie::NeverMoves);
        if self.detail == HistoryDetail::Trace {
            self.note(Happened::AtRobot(robot, message.clone()));
        } else if !forgets {
            self.note(Happened::AtRobot(robot, brief(&message)));
        }
        self.receive(robot, link, Input::Message(message));
    }

    /// Passes an input to a robot if its process runs.
    pub(super) fn receive(&mut self, robot: usize, link: LinkId, input: Input) {
        let now = self.kernel.now.assume_clock();
        self.kernel.robots.change(robot, |machine| machine.receive(now, link, input));
    }

    /// Resets a connection that the robot's operating system does not know when a message arrives on it, as after a restart.
    fn refuse_stray(&mut self, robot: usize, link: LinkId) {
        let side = &self.robots[robot];
        if side.runs_on == Machine::Up && side.link != Some(link) && self.drawn.network == Network::Stream {
            self.link_breaks(robot, link, self.kernel.now, Loss::Closed, "connection reset");
        }
    }

    pub(super) fn answer(&mut self, robot: usize, link: LinkId, message: Message) {
        if self.robots[robot].link != Some(link) || self.is_dead(robot, link) {
            return;
        }
        for (at, message) in self.arrivals(robot, Direction::FromRobot, message) {
            let event = Box::new(Event::Received { robot: robot.into(), message });
            self.kernel.put(at, Item::ToScheduler { robot, link, event });
        }
    }

    pub(super) fn send_to_robot(&mut self, robot: usize, link: LinkId, message: Message) {
        if self.detail == HistoryDetail::Trace {
            self.note(Happened::ToRobot(robot, message.clone()));
        }
        if self.is_dead(robot, link) {
            return;
        }
        for (at, message) in self.arrivals(robot, Direction::ToRobot, message) {
            self.kernel.put(at, Item::ToRobot { robot, link, message: Box::new(message) });
        }
    }

    /// Whether a connection no longer carries messages.
    fn is_dead(&mut self, robot: usize, link: LinkId) -> bool {
        let dead = self.robots[robot].dead.contains(&link);
        if dead {
            self.note(Happened::Lost(robot));
        }
        dead
    }

    /// Informs the scheduler that a connection has ended, as soon as the network can transport this information.
    pub(super) fn link_breaks(
        &mut self,
        robot: usize,
        link: LinkId,
        at: Timestamp<Server>,
        loss: Loss,
        reason: &str,
    ) {
        if self.robots[robot].dead.contains(&link) {
            return;
        }
        let event = Box::new(Event::LinkDown { robot: robot.into(), loss, reason: reason.to_owned() });
        let at = self.robots[robot].path.end_passes(at);
        self.kernel.put(at + self.drawn.delay.1, Item::ToScheduler { robot, link, event });
    }

    /// Breaks the connections of a robot that carry no messages, once the fault is over.
    pub(super) fn dead_links_end(&mut self, robot: usize) {
        if self.kernel.now < self.robots[robot].dead_until {
            return;
        }
        for link in std::mem::take(&mut self.robots[robot].dead) {
            self.link_breaks(robot, link, self.kernel.now, Loss::Closed, "connection reset");
            self.robot_link_down(robot, link);
        }
    }

    pub(super) fn connect(&mut self, robot: usize, link: LinkId) {
        if !self.links_to(robot, link) {
            return;
        }
        let side = &mut self.robots[robot];
        if self.kernel.now < side.dead_until {
            side.dead.insert(link);
            return self.tell_on_link(robot, link, Event::LinkUp { robot: robot.into() });
        }
        let reachable = side.path.blocked_until.iter().all(|until| self.kernel.now >= *until);
        if !reachable || self.kernel.robots.get(robot).is_none() {
            let (loss, after) = match side.runs_on {
                Machine::Up if reachable => (Loss::Refused, self.drawn.delay.1 * 2),
                Machine::Up | Machine::Down => (Loss::Unreachable, CONNECT_FAILS),
            };
            let event =
                Box::new(Event::LinkDown { robot: robot.into(), loss, reason: "no connection".to_owned() });
            let at = self.kernel.now + after;
            return self.kernel.put(at, Item::ToScheduler { robot, link, event });
        }
        let one = self.drawn.robots[robot].connections == Connections::One;
        if one && side.link.is_some() {
            side.waiting = Some((link, Vec::new()));
        } else {
            self.robot_reads(robot, link);
        }
        self.tell_on_link(robot, link, Event::LinkUp { robot: robot.into() });
    }

    /// Makes a robot read the connection `link`, and closes an older connection.
    fn robot_reads(&mut self, robot: usize, link: LinkId) {
        let side = &mut self.robots[robot];
        side.path.begin(self.kernel.now);
        if let Some(old) = side.link.replace(link) {
            self.receive(robot, old, Input::LinkDown);
        }
    }

    /// Informs a robot that a connection has ended. The robot then reads the connection that has waited, if any.
    pub(super) fn robot_link_down(&mut self, robot: usize, link: LinkId) {
        let side = &mut self.robots[robot];
        side.waiting.take_if(|(waiting, _)| *waiting == link);
        if side.link != Some(link) {
            return;
        }
        side.link = None;
        let waiting = side.waiting.take();
        self.receive(robot, link, Input::LinkDown);
        if let Some((next, unread)) = waiting {
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

/// Returns a message that contains only what the checks need.
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
            // Only one request is kept: an inquiry removes the end of a lease only if it names requests.
            let requests = inquiry.requests.iter().take(1).cloned().collect();
            let brief = Inquiry { timestamp, requests, pending_lease, pending_until, ..Inquiry::default() };
            Message::Inquiry(brief)
        }
        other => other.clone(),
    }
}
