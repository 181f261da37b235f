//! What becomes of messages on their way, and of links.

use downbeat_robot::simulated::SimulatedRobot;
use downbeat_robot::{Input, LinkId};
use urrcp::{
    AvailabilityResponse, Command, ContentHash, ControlResponse, Inquiry, Message, Server, Span, Status, Timestamp,
};

use super::{CONNECT_FAILS, Item, Machine, World};
use crate::mission::{Event, Loss};
use crate::simulation::{Happened, Lie, Network};

impl World {
    /// What a robot that lies makes of its answer.
    pub(super) fn lie(&mut self, robot: usize, mut message: Message) -> Option<Message> {
        match (self.drawn.robots[robot].lie, &mut message) {
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
                let drawn = &self.drawn.robots[robot];
                let fresh = SimulatedRobot::new(drawn.block.clone(), drawn.settings.clone());
                self.robots[robot].collect();
                self.robots[robot].machine = Some(fresh);
            }
            _ => {}
        }
        Some(message)
    }

    /// When a message arrives, or that it is lost. `way` is 0 to the robot, 1 from it.
    pub(super) fn travel(&mut self, robot: usize, way: usize) -> Option<Timestamp<Server>> {
        let (least, largest) = self.drawn.delay;
        let mut delay = Span::from_nanos(self.rng.i64(least.as_nanos()..=largest.as_nanos()));
        if self.rng.f64() < self.drawn.tail {
            delay += largest * self.rng.i64(1..=20);
        }
        let side = &mut self.robots[robot];
        let arrival = match self.drawn.network {
            Network::Stream => {
                // What a stream carries into a partition comes out of it at its end.
                let arrival = (self.now.max(side.partitioned_until) + delay).max(side.last[way]);
                side.last[way] = arrival;
                arrival
            }
            Network::Datagram { loss, .. } => {
                if self.now < side.partitioned_until || self.rng.f64() < loss {
                    self.note(Happened::Lost(robot));
                    return None;
                }
                self.now + delay
            }
        };
        let travelled = arrival - self.now;
        if travelled > largest {
            self.note(Happened::Slow(robot, travelled));
        }
        Some(arrival)
    }

    pub(super) fn doubled(&mut self) -> bool {
        match self.drawn.network {
            Network::Stream => false,
            Network::Datagram { double, .. } => self.rng.f64() < double,
        }
    }

    pub(super) fn arrive_at_robot(&mut self, robot: usize, link: LinkId, message: Message) {
        let side = &self.robots[robot];
        if side.machine.is_none() {
            return;
        }
        if side.link != Some(link) {
            // Its system knows no such connection and says so.
            let event = Event::LinkDown { robot, loss: Loss::Closed, reason: "connection reset".to_owned() };
            return self.send_event(robot, link, event);
        }
        if self.now < side.paused_until {
            return self.put(side.paused_until, Item::ToRobot { robot, link, message: Box::new(message) });
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

    pub(super) fn answer(&mut self, robot: usize, link: LinkId, message: &Message) {
        if self.robots[robot].link != Some(link) {
            return;
        }
        for _ in 0..if self.doubled() { 2 } else { 1 } {
            if let Some(at) = self.travel(robot, 1) {
                let event = Box::new(Event::Received { robot, message: message.clone() });
                self.put(at, Item::ToScheduler { robot, link, event });
            }
        }
    }

    pub(super) fn send_event(&mut self, robot: usize, link: LinkId, event: Event) {
        let at = self.now + self.drawn.delay.1;
        self.put(at, Item::ToScheduler { robot, link, event: Box::new(event) });
    }

    pub(super) fn connect(&mut self, robot: usize, link: LinkId) {
        if !self.links_to(robot, link) {
            return;
        }
        let side = &mut self.robots[robot];
        let reachable = self.now >= side.partitioned_until;
        if !reachable || side.machine.is_none() {
            let (loss, after) = match side.runs_on {
                Machine::Up if reachable => (Loss::Refused, self.drawn.delay.1 * 2),
                Machine::Up | Machine::Down => (Loss::Unreachable, CONNECT_FAILS),
            };
            let event = Box::new(Event::LinkDown { robot, loss, reason: "no connection".to_owned() });
            let at = self.now + after;
            return self.put(at, Item::ToScheduler { robot, link, event });
        }
        if let (Some(old), Some(machine)) = (side.link.replace(link), &mut side.machine) {
            machine.receive(self.now.assume_clock(), old, Input::LinkDown);
        }
        side.last = [self.now; 2];
        self.tell_on_link(robot, link, Event::LinkUp { robot });
    }

    pub(super) fn send_to_robot(&mut self, robot: usize, link: LinkId, message: &Message) {
        if self.verbose {
            self.note(Happened::ToRobot(robot, message.clone()));
        }
        for _ in 0..if self.doubled() { 2 } else { 1 } {
            if let Some(at) = self.travel(robot, 0) {
                self.put(at, Item::ToRobot { robot, link, message: Box::new(message.clone()) });
            }
        }
    }
}

/// As much of a message as the checks need.
fn brief(message: &Message) -> Message {
    match message {
        Message::ControlRequest(request) => {
            let mut brief = request.clone();
            if !matches!(&brief.command, Command::Script(script) if script.is_empty()) {
                brief.command = Command::ReadSensor;
            }
            Message::ControlRequest(brief)
        }
        Message::Inquiry(inquiry) => {
            let Inquiry { pending_lease, pending_until, .. } = *inquiry;
            // Whether it names any is what counts: only such a one lifts the end of a lease.
            let requests = inquiry.requests.iter().take(1).cloned().collect();
            Message::Inquiry(Inquiry { requests, pending_lease, pending_until, ..Inquiry::default() })
        }
        other => other.clone(),
    }
}
