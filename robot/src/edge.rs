//! An edge: a robot's state machine with its hardware. It uses the host's clock and reaches the hardware through a driver's mailbox.

use std::sync::Arc;

use urrcp::{Robot as RobotClock, Span, Timestamp};

use crate::clock::{HostClock, HostTime};
use crate::device::Motion;
use crate::driver::{Demand, Mailbox, News, PlanNews, Sampled, Wanted};
use crate::hardware::SensorReading;
use crate::ids::LinkId;
use crate::outgoing::Outgoing;
use crate::robot::{Input, Output, Robot, SetValue};
use crate::set_log::LogEntry;

/// A robot's state machine, and the mailbox that leads to its hardware.
pub(crate) struct Edge {
    machine: Robot,
    mailbox: Arc<Mailbox>,
    /// Number of the last driver connection that was reported to the state machine.
    connection: u64,
    outputs: Vec<Output>,
    wanted: Vec<Wanted>,
    leaving: Vec<Outgoing>,
    log: Vec<LogEntry>,
}

impl Edge {
    /// Creates an edge for a state machine. The driver behind the mailbox has not connected to its hardware yet.
    pub(crate) fn new(machine: Robot, mailbox: Arc<Mailbox>) -> Self {
        Self {
            machine: machine.confirmed_by_its_driver(),
            mailbox,
            connection: 0,
            outputs: Vec::new(),
            wanted: Vec::new(),
            leaving: Vec::new(),
            log: Vec::new(),
        }
    }

    pub(crate) fn mailbox(&self) -> Arc<Mailbox> {
        Arc::clone(&self.mailbox)
    }

    pub(crate) const fn machine(&self) -> &Robot {
        &self.machine
    }

    /// Releases the robot if the session that owns it has ended.
    pub(crate) fn look(&mut self, now: Timestamp<HostTime>) {
        self.machine.release_if_over(now.assume_clock());
    }

    pub(crate) fn is_idle(&self) -> bool {
        self.leaving.is_empty() && self.machine.is_idle()
    }

    /// Returns when [`Edge::advance`] is next due.
    pub(crate) fn next_wakeup(&self) -> Option<Timestamp<HostTime>> {
        self.machine.next_wakeup().map(Timestamp::assume_clock)
    }

    /// Handles an input that reached the robot at `now`.
    pub(crate) fn receive(&mut self, now: Timestamp<HostTime>, link: LinkId, input: Input) {
        self.check_hardware(now);
        self.tell(now, |machine, now, out| machine.handle(now, link, input, out));
    }

    /// Executes everything due at or before `now`, and returns the outgoing messages.
    pub(crate) fn advance(&mut self, now: Timestamp<HostTime>, out: &mut Vec<Outgoing>) {
        self.check_hardware(now);
        self.tell(now, Robot::advance);
        out.append(&mut self.leaving);
    }

    /// Executes the movements due at or before `now`. The reports about them are sent with the next [`Edge::advance`].
    pub(crate) fn advance_movements(&mut self, now: Timestamp<HostTime>) {
        self.check_hardware(now);
        self.tell(now, Robot::advance_movements);
    }

    /// Checks whether the edge was delayed and, if a start is near, whether the hardware answers. Called before any other work.
    fn check_hardware(&mut self, now: Timestamp<HostTime>) {
        let mailbox = Arc::clone(&self.mailbox);
        self.tell(now, |machine, now, out| {
            machine.check_hardware(now, || mailbox.silence().map(Span::from), out);
        });
    }

    /// Brings moving hardware to rest because the edge ends.
    pub(crate) fn shut_down(&mut self, now: Timestamp<HostTime>) {
        self.tell(now, Robot::shut_down);
    }

    /// Handles a report from the driver's thread.
    pub(crate) fn hear(&mut self, clock: &HostClock, news: News) {
        let now = clock.now();
        match news {
            News::There { connection, latency, lookahead } => {
                self.connection = connection;
                self.machine.declare_latencies(&latency);
                self.machine.plans_ahead(&lookahead);
                self.tell(now, Robot::hardware_found);
            }
            News::Away { reason } => {
                self.tell(now, |machine, now, out| machine.hardware_failed(now, &reason, out));
            }
            News::Stale { device, late } => {
                self.tell(now, |machine, now, out| machine.value_stale(now, &device, late.into(), out));
            }
            News::Plan(news) => self.hear_of_plan(now, news),
            News::Confirmed(tickets) => {
                for ticket in tickets {
                    self.tell(now, |machine, now, out| machine.confirmed(now, ticket, out));
                }
            }
            News::Reading { id, reading } => {
                let reading = reading.map(|Sampled { value, taken }| SensorReading {
                    value,
                    taken: taken.map(|taken| clock.timestamp_at(taken).assume_clock()),
                });
                self.tell(now, |machine, now, out| machine.reading_came(now, id, reading, out));
            }
        }
    }

    /// Handles a driver's report about a script that the driver times by itself. A report that cannot be true is a fault of the driver.
    fn hear_of_plan(&mut self, now: Timestamp<HostTime>, news: PlanNews) {
        let mut untrue = None;
        self.tell(now, |machine, now, out| match news {
            PlanNews::Word { plan, at, event } => {
                untrue = machine.plan_reported(now, plan, at.assume_clock(), &event, out).err();
            }
            PlanNews::Refused { plan, first, error } => machine.plan_refused(now, plan, first, error, out),
            PlanNews::Cancelled(plan) => machine.plan_cancelled(now, plan, out),
        });
        if let Some(untrue) = untrue {
            self.mailbox.failed_by_itself(format!("the driver sent an impossible report: {untrue}"));
        }
    }

    /// Puts the requests to the hardware that were made since the last call into the mailbox.
    pub(crate) fn post(&mut self, clock: &HostClock) {
        let instant = |at: Timestamp<RobotClock>| clock.instant_of(at.assume_clock());
        let demand = Demand {
            held: !self.machine.is_idle(),
            start: self.machine.next_start(Span::ZERO).map(instant),
            next_due: self.machine.next_wakeup().map(instant),
            confirmation: self.machine.awaits_confirmation(),
        };
        let orders = self.wanted.drain(..).map(|wanted| wanted.on_clock(*clock));
        self.mailbox.post(self.connection, orders, demand);
    }

    /// Removes and returns the log entries that were made since the last call.
    pub(crate) fn take_log(&mut self) -> Vec<LogEntry> {
        std::mem::take(&mut self.log)
    }

    pub(crate) const fn has_log(&self) -> bool {
        !self.log.is_empty()
    }

    /// Calls the state machine and collects its outputs. The robot's clock is the host's clock.
    fn tell(
        &mut self,
        now: Timestamp<HostTime>,
        tell: impl FnOnce(&mut Robot, Timestamp<RobotClock>, &mut Vec<Output>),
    ) {
        tell(&mut self.machine, now.assume_clock(), &mut self.outputs);
        for output in self.outputs.drain(..) {
            match output {
                Output::Confirm { ticket, device } => self.wanted.push(Wanted::Confirm(ticket, device)),
                Output::Read { reading, sensor } => self.wanted.push(Wanted::Read(reading, sensor)),
                Output::Send { link, message } => self.leaving.push(Outgoing::Message { link, message }),
                Output::Plan(part) => self.wanted.push(Wanted::Plan(part)),
                Output::Cancel(cancel) => self.wanted.push(Wanted::Cancel(cancel)),
                Output::Played { set, at } => self.log.push(LogEntry::new(at.assume_clock(), at, set)),
                Output::Set(set) => {
                    self.wanted.extend(wanted(&self.machine, &set));
                    self.log.push(LogEntry::new(now, now.assume_clock(), set));
                }
            }
        }
    }
}

impl Drop for Edge {
    fn drop(&mut self) {
        self.mailbox.close();
    }
}

/// Returns the request to the hardware that a movement requires, if any.
fn wanted(robot: &Robot, set: &SetValue) -> Option<Wanted> {
    let key = |control_type| (set.device.clone(), control_type);
    Some(match &set.motion {
        Motion::Set(setpoint) | Motion::Rest(setpoint) | Motion::Default(setpoint) => {
            let due = set.step.map(|_| set.due);
            Wanted::Set(key(setpoint.control_type), setpoint.clone(), due)
        }
        Motion::Ramp { control_type, .. } | Motion::Slow { control_type, .. } => {
            Wanted::Follow(key(*control_type), robot.signal(set.device.as_str(), *control_type)?)
        }
    })
}
