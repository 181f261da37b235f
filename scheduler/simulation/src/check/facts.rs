//! Orders the events of a run by act, robot and script, so that the invariants can be checked.

use std::collections::{HashMap, HashSet};

use downbeat_plan::{Act, Choreography, DeviceScript};
use downbeat_robot::set_log::LogEntry;
use urrcp::{Command, ControlRequest, Message, RequestId, RobotId, Server, Span, Timestamp};

use super::cause::{Cause, Hit, hits_of};
use crate::{Drawn, Fault, Happened, Names, Network, Ran};
use downbeat_mission::{Progress, Promise, PromisedScript, Record, SkewBudget, promised_name};

/// Maximum time until the mission notices that a clock was set. If a link loses answers, only the next inquiry, one second later, shows
/// the change.
const SEEN_AFTER: Span = Span::from_millis(1_100);

/// The events of a run in a form that the checks of the invariants need.
pub(super) struct Facts<'a> {
    pub(super) ran: &'a Ran,
    /// The acts that were sent, in order.
    pub(super) acts: Vec<SentAct<'a>>,
    /// The faults, in order of their start.
    pub(super) hits: Vec<Hit>,
    /// For each robot: when the mission left it out; `None` if it did not.
    pub(super) dropped: Vec<Option<Timestamp<Server>>>,
    /// The instants at which stops of all robots began.
    pub(super) stopping: Vec<Timestamp<Server>>,
    /// By how much the clock of the scheduler's process was ahead of the true time. Each value applies from its instant on.
    ahead: Vec<(Timestamp<Server>, Span)>,
    planned: Vec<(Timestamp<Server>, &'a Choreography)>,
}

/// An act that was sent.
pub(super) struct SentAct<'a> {
    pub(super) promise: &'a Promise,
    /// The act as the scheduler had planned it.
    pub(super) written: &'a Act,
    /// When the act was promised (recorded before it was sent).
    pub(super) at: Timestamp<Server>,
    /// By how much the clock of the process that promised the act was ahead of the true time. The times in `promise` are already
    /// converted to true time.
    pub(super) ahead: Span,
    /// Whether a process that resumed the mission did not know this act, and promised another act with the same number.
    pub(super) superseded: bool,
    /// Whether the act was withdrawn and prepared again with another number.
    pub(super) repeated: bool,
    /// The skew budget (the predicted differences between the robots' starts) that was reported to the operator before the act was sent.
    pub(super) skew: Option<&'a SkewBudget>,
    /// The decision of the act, as reported to the operator; `None` if it was not decided.
    pub(super) decided: Option<Decision>,
    /// When the commitment was first recorded.
    pub(super) committed: Option<Timestamp<Server>>,
    /// When the operator was informed that all robots had answered the commitment.
    pub(super) answered: Option<Timestamp<Server>>,
    pub(super) scripts: Vec<SentScript<'a>>,
}

/// The decision of an act, as reported to the operator.
#[derive(Clone, Copy)]
pub(super) struct Decision {
    /// The point of no return: the latest instant at which the scheduler withdraws the act because of a failure.
    pub(super) no_return: Timestamp<Server>,
    /// Length of the interval before the act's start in which the mission may notice a robot's sudden silence too late.
    pub(super) doubt: Span,
}

/// A script of an act that was sent, and what the robot did with it.
pub(super) struct SentScript<'a> {
    pub(super) robot: usize,
    pub(super) promised: &'a PromisedScript,
    /// The time that was added to the script's timestamp for the robot's clock, according to the journal.
    pub(super) shift: Span,
    /// The shift in the first request that arrived with this script. Set only if the robot's clock is measured and the script is not the
    /// first one of its device.
    pub(super) arrived_shift: Option<Span>,
    /// The script in the choreography; `None` if the choreography has no such script.
    pub(super) written: Option<&'a DeviceScript>,
    /// Time from the script's start to the first movement: zero if the device moves linearly to the first value.
    pub(super) starts_after: Span,
    /// The robot's log entries for this script, in order.
    pub(super) log: Vec<&'a LogEntry>,
}

/// Returns the choreographies that the mission reported after stops, each with the time of the report. They include the acts that were
/// planned after the stop.
fn planned_after_stops(ran: &Ran) -> Vec<(Timestamp<Server>, &Choreography)> {
    let planned = ran.history.iter().filter_map(|(at, happened)| {
        let Happened::Told(told) = happened else { return None };
        match &**told {
            Progress::GoingHome { choreography, .. } | Progress::Approaching { choreography, .. } => {
                Some((*at, &**choreography))
            }
            _ => None,
        }
    });
    planned.collect()
}

/// Returns the request id under which a script was promised to a robot. If a device had no room for a script, the script is sent again
/// under another id. This happens only with robots that neither report nor answer inquiries, because the mission has to guess when their
/// devices have room.
fn promised_name_of<'n>(ran: &Ran, robot: usize, id: &'n str) -> &'n str {
    let block = &ran.drawn.robots[robot].block;
    if block.reports || block.inquiry { id } else { promised_name(id) }
}

impl<'a> Facts<'a> {
    pub(super) fn of(ran: &'a Ran) -> Self {
        let mut logs: HashMap<&str, Vec<&LogEntry>> = HashMap::new();
        for (robot, log) in ran.logs.iter().enumerate() {
            for entry in log {
                if let Some(id) = entry.request_id.as_deref() {
                    logs.entry(promised_name_of(ran, robot, id)).or_default().push(entry);
                }
            }
        }
        let mut facts = Self {
            ran,
            acts: Vec::new(),
            hits: hits_of(ran),
            dropped: vec![None; ran.drawn.robots.len()],
            stopping: Vec::new(),
            ahead: ahead_of(ran),
            planned: planned_after_stops(ran),
        };
        for (at, record) in &ran.records {
            facts.take(*at, record, &logs);
        }
        facts.take_words();
        facts.take_shifts(&logs);
        facts
    }

    fn take(&mut self, at: Timestamp<Server>, record: &'a Record, logs: &HashMap<&str, Vec<&'a LogEntry>>) {
        match record {
            Record::Prepared(promise) => {
                // Numbers ascend, unless the disk of a process that died has lost promises.
                let before = self.acts.iter_mut().filter(|act| act.promise.number >= promise.number);
                before.for_each(|act| act.superseded = true);
                let Some(written) = self.choreography_at(at).acts.get(promise.act.get()) else { return };
                let scripts = promise.scripts.iter().filter_map(|script| self.sent(written, script, logs));
                self.acts.push(SentAct {
                    promise,
                    written,
                    at,
                    ahead: self.ahead_at(at),
                    superseded: false,
                    repeated: false,
                    skew: None,
                    decided: None,
                    committed: None,
                    answered: None,
                    scripts: scripts.collect(),
                });
            }
            Record::Committed { number } => {
                let act = self.acts.iter_mut().rfind(|act| act.promise.number == *number);
                act.into_iter().for_each(|act| act.committed = act.committed.or(Some(at)));
            }
            Record::ActEnded { report, again: true, .. } => {
                let act = self.acts.iter_mut().rfind(|act| act.promise.number == report.number);
                act.into_iter().for_each(|act| act.repeated = true);
            }
            Record::Translated { request_id, shift } => {
                let scripts = self.acts.iter_mut().flat_map(|act| &mut act.scripts);
                let named = scripts.filter(|script| script.promised.request_id == *request_id);
                named.for_each(|script| script.shift = *shift);
            }
            Record::Dropped { robot } => {
                if let Some(robot) = self.index_of(robot) {
                    self.dropped[robot].get_or_insert(at);
                }
            }
            Record::Stopping { .. } => self.stopping.push(at),
            _ => {}
        }
    }

    /// The choreography, including all acts that were planned after stops.
    pub(super) fn choreography(&self) -> &'a Choreography {
        self.planned.last().map_or(&self.ran.drawn.choreography, |(_, choreography)| choreography)
    }

    fn choreography_at(&self, at: Timestamp<Server>) -> &'a Choreography {
        let planned = self.planned.iter().rfind(|(planned_at, _)| *planned_at <= at);
        planned.map_or(&self.ran.drawn.choreography, |(_, choreography)| choreography)
    }

    fn sent(
        &self,
        act: &'a Act,
        promised: &'a PromisedScript,
        logs: &HashMap<&str, Vec<&'a LogEntry>>,
    ) -> Option<SentScript<'a>> {
        let of_robot = act.plan.robots.iter().find(|robot| robot.robot == promised.robot);
        let scripts = of_robot.map(|robot| robot.scripts.as_slice()).unwrap_or_default();
        let same = |written: &&DeviceScript| {
            written.device == promised.device && written.start.get() == promised.start.get()
        };
        let robot = self.index_of(&promised.robot)?;
        let written = scripts.iter().find(same);
        let device = self.drawn().robots[robot].block.device(promised.device.as_str());
        let interpolation = device.map(|device| device.interpolation).unwrap_or_default();
        Some(SentScript {
            robot,
            promised,
            shift: promised.shift,
            arrived_shift: None,
            written,
            starts_after: written.map_or(Span::ZERO, |written| written.script.until_started(interpolation)),
            log: logs.get(promised.request_id.as_str()).cloned().unwrap_or_default(),
        })
    }

    /// Stores the shift with which each script first arrived, if it may differ from the shift of the act. Only scripts after the first
    /// one of a device may differ.
    fn take_shifts(&mut self, logs: &HashMap<&str, Vec<&'a LogEntry>>) {
        let mut sent: HashMap<_, _> = HashMap::new();
        for (at, happened) in &self.ran.history {
            match happened {
                Happened::AtRobot(robot, Message::ControlRequest(request)) => {
                    if let Some((id, timestamp)) =
                        request.request_id.as_ref().map(RequestId::as_str).zip(request.timestamp)
                    {
                        sent.entry(self.promised_name(*robot, id)).or_insert((*robot, timestamp));
                    }
                }
                // A robot that restarts forgets scripts that have not begun, so their next arrival counts as the first.
                Happened::Back(back) => sent.retain(|id, (robot, _)| {
                    let began = |entry: &&LogEntry| entry.true_ns < at.as_nanos();
                    robot != back || logs.get(*id).is_some_and(|log| log.iter().any(began))
                }),
                _ => {}
            }
        }
        for act in &mut self.acts {
            let mut devices = HashSet::new();
            for script in &mut act.scripts {
                if devices.insert((script.robot, &script.promised.device))
                    || script.promised.shift == Span::ZERO
                {
                    continue;
                }
                let timestamp = sent.get(script.promised.request_id.as_str());
                script.arrived_shift = timestamp.map(|(_, at)| *at - act.promise.timestamp.assume_clock());
            }
        }
    }

    /// Stores the content of the messages to the operator about the acts. The times in these messages are by the clock of the process
    /// that sent them.
    fn take_words(&mut self) {
        for (at, happened) in &self.ran.history {
            let Happened::Told(progress) = happened else { continue };
            let ahead = self.ahead_at(*at);
            let mut acts = self.acts.iter_mut().filter(|act| act.at <= *at);
            match &**progress {
                Progress::Preparing { timestamp, skew, .. } => {
                    let act = acts.rfind(|act| act.promise.timestamp + ahead == *timestamp);
                    act.into_iter().for_each(|act| act.skew = skew.as_ref());
                }
                Progress::Decided { start, no_return, doubt, .. } => {
                    // The start is by the clock of the process that promised the act, even if another process reports it.
                    let act = acts.rfind(|act| act.promise.start + act.ahead == *start);
                    act.into_iter().for_each(|act| {
                        let no_return = *no_return - act.ahead;
                        act.decided = Some(Decision { no_return, doubt: *doubt });
                    });
                }
                Progress::Committed { act: name, window: Some(_) } => {
                    let act = acts.rfind(|act| act.written.name == *name);
                    act.into_iter().for_each(|act| act.answered = act.answered.or(Some(*at)));
                }
                _ => {}
            }
        }
    }

    /// Whether a process that resumed the mission may not know the clock offset with which this script was sent. That is possible if the
    /// robot's clock is measured and the act has an earlier script for the same device.
    pub(super) fn offset_may_be_lost(&self, act: &SentAct<'_>, script: &SentScript<'_>) -> bool {
        let is_before = |other: &SentScript<'_>| {
            other.robot == script.robot
                && other.promised.device == script.promised.device
                && other.promised.start < script.promised.start
        };
        let taken_up = |(at, happened): &(Timestamp<Server>, Happened)| {
            *at >= act.at && matches!(happened, Happened::TakenUp(_))
        };
        script.promised.shift != Span::ZERO
            && act.scripts.iter().any(is_before)
            && self.ran.history.iter().any(taken_up)
    }

    /// Returns by how much the clock of the scheduler's process was ahead of the true time.
    pub(super) fn ahead_at(&self, at: Timestamp<Server>) -> Span {
        self.ahead.iter().rev().find(|(from, _)| *from <= at).map_or(Span::ZERO, |(_, ahead)| *ahead)
    }

    pub(super) const fn drawn(&self) -> &'a Drawn {
        &self.ran.drawn
    }

    /// Whether the robot does not lie and no other process answers in its place.
    pub(super) fn honest(&self, robot: usize) -> bool {
        self.drawn().robots[robot].lie.is_none() && !self.has_twin(robot)
    }

    /// Whether the robot's confirmations of stops are reliable. The robot must not lie. If another process may have answered in its
    /// place, answers to inquiries must show which scripts that process lacks.
    pub(super) fn rests_as_reported(&self, robot: usize) -> bool {
        let drawn = &self.drawn().robots[robot];
        let is_known = drawn.block.inquiry && drawn.names == Names::Echoed;
        drawn.lie.is_none() && (is_known || !self.has_twin(robot))
    }

    /// Whether another process with the id of the robot answered in its place.
    pub(super) fn has_twin(&self, robot: usize) -> bool {
        self.drawn()
            .faults
            .iter()
            .any(|(_, fault)| matches!(fault, Fault::Twin { robot: of, .. } if *of == robot))
    }

    /// Whether the robot reports how many steps of a script it has completed, and how many of them were late.
    pub(super) fn counts_steps(&self, robot: usize) -> bool {
        let drawn = &self.drawn().robots[robot];
        drawn.names == Names::Echoed || drawn.block.inquiry
    }

    /// Returns the request id under which a script was promised to a robot.
    pub(super) fn promised_name<'n>(&self, robot: usize, id: &'n str) -> &'n str {
        promised_name_of(self.ran, robot, id)
    }

    pub(super) fn index_of(&self, id: &RobotId) -> Option<usize> {
        self.drawn().robots.iter().position(|robot| robot.block.id == *id)
    }

    pub(super) fn name(&self, robot: usize) -> &'a RobotId {
        &self.drawn().robots[robot].block.id
    }

    /// Whether the robot's clock was set during the run, so that true times cannot be computed from it.
    pub(super) fn clock_was_set(&self, robot: usize) -> bool {
        self.hits.iter().any(|hit| hit.cause == Cause::ClockSet && hit.is_of(robot))
    }

    /// Whether another process of the scheduler resumed the mission.
    pub(super) fn was_taken_up(&self) -> bool {
        self.taken_up().next().is_some()
    }

    /// Returns when other processes of the scheduler took over the mission, and whether they resumed or withdrew it.
    pub(super) fn taken_up(&self) -> impl DoubleEndedIterator<Item = (Timestamp<Server>, &'static str)> + '_ {
        self.ran.history.iter().filter_map(|(at, happened)| match happened {
            Happened::TakenUp(how) => Some((*at, *how)),
            _ => None,
        })
    }

    /// Whether another process resumed the mission before this act had ended.
    pub(super) fn was_resumed(&self, act: &SentAct<'_>) -> bool {
        let ended = self.ended(act);
        self.taken_up().any(|(at, _)| at >= act.at && ended.is_none_or(|ended| at < ended))
    }

    /// Returns when the end of the act was last recorded. If the disk had lost the record of the end, the next process records it again.
    pub(super) fn ended(&self, act: &SentAct<'_>) -> Option<Timestamp<Server>> {
        self.ran.records.iter().rev().find_map(|(at, record)| match record {
            Record::ActEnded { report, .. } if report.number == act.promise.number && *at >= act.at => {
                Some(*at)
            }
            _ => None,
        })
    }

    /// Whether a control request that satisfies a condition reached a robot.
    pub(super) fn reached(
        &self,
        robot: usize,
        is_meant: impl Fn(Timestamp<Server>, &ControlRequest) -> bool,
    ) -> bool {
        self.ran.history.iter().any(|(at, happened)| match happened {
            Happened::AtRobot(of, Message::ControlRequest(request)) => *of == robot && is_meant(*at, request),
            _ => false,
        })
    }

    /// Whether a record written at an instant was certainly on the disk when the scheduler's process ended, so that the next process read
    /// it. This assumes that a sync in progress is completed first.
    pub(super) fn was_kept(&self, at: Timestamp<Server>) -> bool {
        let crashes = self.hits.iter().filter(|hit| hit.cause == Cause::SchedulerCrash && hit.from >= at);
        let Some(ended) = crashes.map(|hit| hit.from).min() else { return true };
        let disk = &self.drawn().disk;
        let by = at + disk.sync * 2;
        let stalls = self.hits.iter().any(|hit| hit.cause == Cause::Disk && hit.overlaps(at, by));
        disk.capacity.is_none() && !stalls && by < ended
    }

    /// The events of the run between two instants, both included.
    pub(super) fn between(
        &self,
        from: Timestamp<Server>,
        until: Timestamp<Server>,
    ) -> &'a [(Timestamp<Server>, Happened)] {
        let history = &self.ran.history;
        let first = history.partition_point(|(at, _)| *at < from);
        let end = history.partition_point(|(at, _)| *at <= until);
        &history[first..end.max(first)]
    }

    /// Whether a robot received a message that asks for its clock reading at or after `since`, early enough for the answer to arrive
    /// before `by`.
    pub(super) fn was_asked(&self, robot: usize, since: Timestamp<Server>, by: Timestamp<Server>) -> bool {
        self.asked(robot, since, by).next().is_some()
    }

    /// Returns when messages that ask for a clock reading reached a robot. `since` and `by` have the same meaning as for `was_asked`.
    pub(super) fn asked(
        &self,
        robot: usize,
        since: Timestamp<Server>,
        by: Timestamp<Server>,
    ) -> impl Iterator<Item = Timestamp<Server>> {
        let drawn = self.drawn();
        let until = match drawn.network {
            Network::Stream => by - drawn.delay.1 - drawn.robots[robot].slow,
            Network::Datagram { .. } => by - SEEN_AFTER,
        };
        self.between(since, until).iter().filter_map(move |(at, happened)| match happened {
            Happened::AtRobot(r, Message::Inquiry(_) | Message::AvailabilityRequest(_)) => {
                (*r == robot).then_some(*at)
            }
            _ => None,
        })
    }

    /// Whether the scheduler died after it had sent a stop to one device of a robot, but not to another. This was before an act that was
    /// not committed. The robot accepts no inquiries, so no inquiry could shorten the lease of the other device in advance. The first
    /// stop renewed that lease.
    pub(super) fn was_stopped_in_part(&self, act: &SentAct<'_>, robot: usize) -> bool {
        let cancel = |message: &Message| match message {
            Message::ControlRequest(request) => {
                matches!(&request.command, Command::Script(script) if script.is_empty())
            }
            _ => false,
        };
        let was_on_its_way = |crash: &Hit| {
            let after = self.between(crash.from, crash.from + self.drawn().delay.1 * 2).iter();
            after.into_iter().any(|(_, happened)| {
                matches!(happened, Happened::AtRobot(r, message) if *r == robot && cancel(message))
            })
        };
        let before_it = |hit: &&Hit| hit.from >= act.at && hit.from <= act.promise.start;
        let mut crashes = self.hits.iter().filter(|hit| hit.cause == Cause::SchedulerCrash).filter(before_it);
        act.committed.is_none() && !self.drawn().robots[robot].block.inquiry && crashes.any(was_on_its_way)
    }

    /// Returns the arrival times of the scheduler's messages that renew the leases of a robot. A request for the robot's description does
    /// not renew leases, because any server may send it.
    pub(super) fn heard(&self, robot: usize) -> impl Iterator<Item = Timestamp<Server>> + '_ {
        self.ran.history.iter().filter_map(move |(at, happened)| match happened {
            Happened::AtRobot(_, Message::InitializationRequest(_)) => None,
            Happened::AtRobot(r, _) if *r == robot => Some(*at),
            _ => None,
        })
    }
}

/// Determines by how much the scheduler's clock was ahead of the true time. Each process adopts the clock of its machine at its start,
/// and keeps its own clock afterwards.
fn ahead_of(ran: &Ran) -> Vec<(Timestamp<Server>, Span)> {
    let mut of_machine = Span::ZERO;
    let mut ahead = Vec::new();
    for (at, happened) in &ran.history {
        match happened {
            Happened::Fault(Fault::ServerClockStep { by }) => of_machine += *by,
            Happened::TakenUp(_) => ahead.push((*at, of_machine)),
            _ => {}
        }
    }
    ahead
}

impl<'a> SentAct<'a> {
    /// Whether this is the last attempt to play the act.
    pub(super) const fn counts(&self) -> bool {
        !self.superseded && !self.repeated
    }

    /// The scripts of the act for one robot.
    pub(super) fn of(&self, robot: usize) -> impl Iterator<Item = &SentScript<'a>> {
        self.scripts.iter().filter(move |script| script.robot == robot)
    }

    /// The robots of the act, each once.
    pub(super) fn robots(&self) -> Vec<usize> {
        let mut robots: Vec<_> = self.scripts.iter().map(|script| script.robot).collect();
        robots.sort_unstable();
        robots.dedup();
        robots
    }

    /// When a robot should start; `None` if it has no script in the act.
    pub(super) fn first_start(&self, robot: usize) -> Option<Timestamp<Server>> {
        self.of(robot).map(|script| self.start_of(script)).min()
    }

    /// When a robot should first move; `None` if it has no script in the act. A device that does not move linearly waits for the first
    /// step of its script.
    pub(super) fn first_movement(&self, robot: usize) -> Option<Timestamp<Server>> {
        self.of(robot).map(|script| self.start_of(script) + script.starts_after).min()
    }

    /// Returns the previous script of the act for the same device, if any.
    pub(super) fn before(&self, script: &SentScript<'_>) -> Option<&SentScript<'a>> {
        let ahead = |other: &&SentScript<'_>| {
            other.promised.device == script.promised.device
                && other.promised.start.get() < script.promised.start.get()
        };
        self.of(script.robot)
            .filter(ahead)
            .max_by(|a, b| a.promised.start.get().total_cmp(&b.promised.start.get()))
    }

    /// Whether a robot completed all its steps of the act.
    pub(super) fn is_whole_on(&self, robot: usize) -> bool {
        self.of(robot).all(|script| script.steps_set() == script.steps_written())
    }

    /// Returns the time from the start of the act to the start of its last script.
    pub(super) fn starts_within(&self) -> Span {
        self.promise.scripts.iter().map(|script| script.start.span()).max().unwrap_or_default()
    }

    /// Returns the planned start of a script, in true time.
    pub(super) fn start_of(&self, script: &SentScript<'_>) -> Timestamp<Server> {
        self.promise.start + script.promised.start.span()
    }

    /// Returns the planned start of a script by the clock of the process that promised it. Messages to robots and reports contain this
    /// time.
    pub(super) fn start_as_told(&self, script: &SentScript<'_>) -> Timestamp<Server> {
        self.start_of(script) + self.ahead
    }

    /// Returns the instant from which a robot's silence may be noticed too late, as reported at the decision. Without a decision, returns
    /// the instant one pending lease before the start.
    pub(super) fn doubtful_from(&self) -> Timestamp<Server> {
        self.promise.start - self.decided.map_or(self.promise.lease, |decided| decided.doubt)
    }
}

impl<'a> SentScript<'a> {
    /// Returns the log entries for the steps of the script that the robot performed, in order.
    pub(super) fn steps(&self) -> impl Iterator<Item = &'a LogEntry> + '_ {
        self.log.iter().copied().filter(|entry| entry.is_set() && entry.step.is_some())
    }

    /// Returns the number of distinct steps of the script that the robot performed.
    pub(super) fn steps_set(&self) -> usize {
        let mut steps: Vec<_> = self.steps().filter_map(|entry| entry.step).collect();
        steps.sort_unstable();
        steps.dedup();
        steps.len()
    }

    pub(super) fn steps_written(&self) -> usize {
        self.written.map_or(0, |written| written.script.steps().len())
    }

    /// Whether the script moved its device.
    pub(super) fn began(&self) -> bool {
        !self.log.is_empty()
    }
}
