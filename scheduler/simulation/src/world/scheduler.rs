//! The scheduler's process in a simulated world with faults. It runs the main loop of every mission. Its journal is the real
//! implementation, on a simulated disk that is slow, fills up and loses power.

use std::collections::{BTreeMap, VecDeque};

use downbeat_robot::LinkId;
use urrcp::{Message, RobotId, Server, SessionId, Span, Timestamp};

use super::{BEGIN, HistoryDetail, Item, World, options, participants, session};
use crate::{Drawn, Fault, Happened};
use downbeat_mission::drive::{self, Filed, LinkNumber, QueueFull, Urgency};
use downbeat_mission::{
    Cause, Event, Fate, Greeting, Kept, Mission, Outcome, Progress, Promise, Record, Rest, RobotIndex,
    ended_acts,
};
use downbeat_rehearsal::world::Virtual;
use downbeat_runtime::journal::simulated::SimulatedDisk;
use downbeat_runtime::journal::{
    Contents, Journal, Opened, OpenedKeys, OpenedRobot, OperatorChoices, WAITING_MAX, append_all,
};

/// State of the scheduler's process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Process {
    Running,
    Gone,
    /// Another process is about to resume the mission.
    TakenUp(Intention),
}

/// The command that an operator runs after the process of a mission has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Intention {
    /// The operator runs `downbeat resume`.
    Resume,
    /// The operator runs `downbeat stop`.
    Stop,
}

/// A fault that occurs after a number of further actions of the scheduler's process.
#[derive(Clone, Copy, Debug)]
struct PendingFault {
    actions: u32,
    burnt: SchedulerFault,
}

/// What happens to the scheduler's process when a fault occurs between two of its actions.
#[derive(Clone, Copy, Debug)]
pub(super) enum SchedulerFault {
    Dies { resumed_after: Option<Span> },
    Stalls { lasts: Span },
}

pub(super) struct Scheduler {
    pub(super) process: Process,
    /// Number of the current scheduler process. Events that an earlier process has scheduled are ignored.
    life: u32,
    pub(super) paused_until: Timestamp<Server>,
    /// Whether the process, after a pause, handles an expired timer before received events.
    pub(super) timers_first: bool,
    /// Events that have arrived, but that the process has not handled yet.
    arrived: VecDeque<drive::Happened>,
    /// The link that the process uses to each robot; `None` if it has none.
    links: Vec<Option<LinkId>>,
    /// The newest connection attempt to each robot, which replaces earlier attempts.
    attempts: Vec<Option<LinkId>>,
    /// The journal; `None` only while another process takes over the mission.
    journal: Option<Journal<SimulatedDisk>>,
    /// Records that wait to be written to the disk, with their times.
    unwritten: VecDeque<(Timestamp<Server>, Record)>,
    /// Messages that the process could not send at the instant at which it stalled between two actions. It sends them when it continues.
    unsent: Vec<(usize, LinkId, Message)>,
    /// Whether the process stalled between two actions of one instant, and has to perform the remaining ones when it continues.
    stalls_in_act: bool,
    disk: DiskState,
    pub(super) disk_stands_still_until: Timestamp<Server>,
    fuse: Option<PendingFault>,
    /// By how much the clock of the scheduler's machine is ahead of the true time.
    pub(super) clock_of_machine: Span,
    /// By how much the process's own clock is ahead of the true time. The process adopted the clock of the machine at its start.
    pub(super) ahead: Span,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DiskState {
    Idle,
    Syncing,
    /// The disk has failed, and the mission has been informed.
    Lost,
    /// Nothing is written to the disk until the mission ends, because a process that withdraws the mission does not wait for the disk.
    Unused,
}

fn opened(robot: RobotId) -> OpenedRobot {
    OpenedRobot { robot, own_id: None, address: "soak".to_owned(), init: None, limits: BTreeMap::new() }
}

impl Scheduler {
    pub(super) fn new(drawn: &Drawn) -> Self {
        let mut journal = on(SimulatedDisk::with_capacity(drawn.disk.capacity));
        let opened = Opened {
            key: None,
            session: session().unwrap_or_else(unreachable_session),
            pid: 0,
            name: None,
            scenario: "soak".into(),
            fleet: "soak".into(),
            folder: None,
            project: None,
            asked: OperatorChoices::default(),
            plan_hash: None,
            fixed: downbeat_mission::FixedStarts::default(),
            greeting: Greeting::Full,
            clock_offset: Span::ZERO,
            keys: OpenedKeys::default(),
            robots: drawn.robots.iter().map(|robot| opened(robot.block.id.clone())).collect(),
        };
        if let Some(Err(error)) = journal.as_mut().map(|journal| journal.begin(BEGIN, &opened)) {
            tracing::debug!("{error}");
        }
        Self {
            process: Process::Running,
            life: 0,
            paused_until: BEGIN,
            timers_first: false,
            arrived: VecDeque::new(),
            links: vec![None; drawn.robots.len()],
            attempts: vec![None; drawn.robots.len()],
            journal,
            unwritten: VecDeque::new(),
            unsent: Vec::new(),
            stalls_in_act: false,
            disk: DiskState::Idle,
            disk_stands_still_until: BEGIN,
            fuse: None,
            clock_of_machine: Span::ZERO,
            ahead: Span::ZERO,
        }
    }

    /// Schedules a fault that occurs after the process has performed `actions` more actions.
    pub(super) fn light_fuse(&mut self, actions: u32, burnt: SchedulerFault) {
        if self.is_running() {
            self.fuse.get_or_insert(PendingFault { actions, burnt });
        }
    }

    /// Returns when the process handles the events that it could not handle at once, if any.
    pub(super) fn wakes(&self) -> Option<Timestamp<Server>> {
        let has_work = !self.arrived.is_empty() || self.stalls_in_act;
        (has_work && self.process == Process::Running).then_some(self.paused_until)
    }

    pub(super) fn is_running(&self) -> bool {
        self.process == Process::Running
    }

    /// Returns the id under which robots know a link. No two scheduler processes use the same id.
    fn id_of(&self, link: LinkNumber) -> LinkId {
        LinkId((u64::from(self.life) << 32) | link.0)
    }

    /// Returns the number of a link in the current scheduler process; `None` if an earlier process created the link.
    fn number_of(&self, link: LinkId) -> Option<LinkNumber> {
        (link.0 >> 32 == u64::from(self.life)).then_some(LinkNumber(link.0 & 0xffff_ffff))
    }
}

/// Opens the journal on a simulated disk, which may be truncated at any point.
fn on(disk: SimulatedDisk) -> Option<Journal<SimulatedDisk>> {
    Journal::on(disk, "journal".into()).ok()
}

#[expect(clippy::expect_used, reason = "a constant below every limit")]
fn unreachable_session() -> SessionId {
    SessionId::new("s").expect("a constant below every limit")
}

impl World {
    /// Ends the scheduler's process. Data that the journal's thread had not passed to the operating system is lost. If the power fails,
    /// data that was not synced may be lost in part.
    pub(super) fn kill_scheduler(&mut self) {
        if !self.scheduler.is_running() {
            return;
        }
        let side = &mut self.scheduler;
        side.process = Process::Gone;
        side.life += 1;
        side.fuse = None;
        side.arrived.clear();
        side.unwritten.clear();
        side.unsent.clear();
        side.stalls_in_act = false;
        if let Some(journal) = side.journal.take() {
            let mut disk = journal.into_disk();
            let synced = disk.synced();
            if self.drawn.disk.loses_power {
                let survive = self.rng.usize(0..=disk.at_risk());
                disk.lose_power(survive);
            }
            side.journal = on(disk);
            let read =
                side.journal.as_ref().and_then(Journal::contents).map_or(0, |contents| contents.kept.whole());
            if read < synced {
                self.note(Happened::Forgotten(synced - read));
            }
        }
        for robot in 0..self.robots.len() {
            if let Some(link) = self.scheduler.links[robot].take() {
                let at = self.kernel.now + self.drawn.delay.1;
                self.kernel.put(at, Item::RobotLinkDown { robot, link });
            }
        }
    }

    /// Ends the scheduler's process. An operator may notice that and run `resume`.
    pub(super) fn crash_scheduler(&mut self, fault: Fault, resumed_after: Option<Span>) {
        if !self.scheduler.is_running() {
            return;
        }
        self.kill_scheduler();
        if let Fault::SchedulerCrashAmid { .. } = fault {
            self.note(Happened::Fault(fault));
        }
        if let Some(after) = resumed_after {
            self.kernel.put(self.kernel.now + after, Item::Resume);
        }
    }

    /// Counts an action of the process. Returns whether the process performs it; `false` if the process ends before the action.
    fn acts(&mut self) -> bool {
        match &mut self.scheduler.fuse {
            Some(PendingFault { actions: 0, burnt: SchedulerFault::Dies { resumed_after } }) => {
                let resumed_after = *resumed_after;
                self.crash_scheduler(Fault::SchedulerCrashAmid { actions: 0, resumed_after }, resumed_after);
            }
            Some(PendingFault { actions: 0, burnt: SchedulerFault::Stalls { lasts } }) => {
                let lasts = *lasts;
                self.stall_in_act(lasts);
            }
            Some(fuse) => fuse.actions -= 1,
            None => {}
        }
        self.scheduler.is_running()
    }

    /// Stalls the scheduler's process between two actions of one instant.
    fn stall_in_act(&mut self, lasts: Span) {
        self.note(Happened::Fault(Fault::SchedulerPauseAmid { actions: 0, lasts }));
        let side = &mut self.scheduler;
        (side.fuse, side.stalls_in_act) = (None, true);
        side.paused_until = side.paused_until.max(self.kernel.now + lasts);
        side.timers_first = self.drawn.seed.is_multiple_of(2);
    }

    /// Performs the actions that remained when the process had stalled between two actions.
    fn finish_acting(&mut self) {
        if std::mem::take(&mut self.scheduler.stalls_in_act) {
            for (robot, link, message) in std::mem::take(&mut self.scheduler.unsent) {
                self.send_to_robot(robot, link, message);
            }
            self.begin_writing();
        }
    }

    /// Waits until another process takes over the mission, and returns the mission that this process reads from the journal. `None` if no
    /// process will do so.
    pub(super) fn taken_up(&mut self) -> Option<Mission> {
        let takes_up = |item: &Item| matches!(item, Item::Resume | Item::Fault(Fault::StopByJournal));
        while self.kernel.agenda.items().any(takes_up) {
            let next = self.next_instant().filter(|_| !self.hung)?;
            self.step(next);
            if let Process::TakenUp(intention) = self.scheduler.process {
                self.scheduler.process = Process::Running;
                return Some(self.mission_by_journal(intention));
            }
        }
        None
    }

    pub(super) fn resume(&mut self) {
        self.take_up(Intention::Resume);
    }

    /// Simulates `downbeat stop`: asks the scheduler of a running mission to stop, or withdraws a mission whose process has ended.
    pub(super) fn stop_by_journal(&mut self) {
        if self.scheduler.is_running() {
            self.tell(Event::StopRequested { rest: Rest::InPlace, by: None })
        } else {
            self.take_up(Intention::Stop)
        }
    }

    fn take_up(&mut self, intention: Intention) {
        let contents = self.scheduler.journal.as_ref().and_then(Journal::contents);
        let is_open = contents.is_some_and(|contents| contents.kept.outcome.is_none());
        if self.scheduler.process == Process::Gone && is_open {
            self.scheduler.process = Process::TakenUp(intention);
        }
    }

    /// Reads the mission from the journal, as `downbeat resume` and `downbeat stop` do.
    fn mission_by_journal(&mut self, intention: Intention) -> Mission {
        let side = &mut self.scheduler;
        side.ahead = side.clock_of_machine;
        side.paused_until = self.kernel.now;
        let now = self.kernel.now + side.ahead;
        let bytes = self.scheduler.journal.as_mut().and_then(|journal| journal.bytes().ok());
        let bytes = bytes.unwrap_or_default();
        let contents = self.scheduler.journal.as_ref().and_then(Journal::contents);
        let kept = contents.map(|contents| &contents.kept);
        let (participants, options) = (participants(&self.drawn), options(&self.drawn));
        let choreography = self.drawn.choreography.clone();
        let goes_on = |kept: &&Kept| intention == Intention::Resume && kept.fate() == Fate::Resume;
        let resumed = kept.filter(goes_on).and_then(|kept| {
            let (participants, ended) = (participants.clone(), ended_acts(&bytes));
            Mission::resume(choreography, participants, options.clone(), kept, ended, now).ok()
        });
        let left = contents.map(Contents::left).unwrap_or_default();
        let how = if resumed.is_some() { "resumed" } else { "withdrawn" };
        self.scheduler.disk = if resumed.is_some() { DiskState::Idle } else { DiskState::Unused };
        let cause = match (intention, kept.map(|kept| (kept, kept.fate()))) {
            (Intention::Resume, Some((kept, Fate::Withdraw(why)))) => kept.ending(why),
            _ => Cause { outcome: Outcome::Stopped, reason: Outcome::Stopped.to_string() },
        };
        self.note(Happened::TakenUp(how));
        resumed.unwrap_or_else(|| {
            let name = "soak".to_owned();
            Mission::withdraw(name, participants, options, &left, cause, Rest::InPlace, now)
        })
    }

    /// Queues an event for the scheduler, which handles it as soon as it can.
    pub(super) fn tell(&mut self, event: Event) {
        let at = self.kernel.now + self.scheduler.ahead;
        self.scheduler.arrived.push_back(drive::Happened::Event { at, event: Box::new(event) });
    }

    pub(super) fn tell_on_link(&mut self, robot: usize, link: LinkId, event: Event) {
        self.arrive_at_scheduler(robot, link, Box::new(event));
    }

    pub(super) fn arrive_at_scheduler(&mut self, robot: usize, link: LinkId, event: Box<Event>) {
        if let Some(link) = self.scheduler.number_of(link).filter(|_| self.scheduler.is_running()) {
            let at = self.kernel.now + self.scheduler.ahead;
            self.scheduler.arrived.push_back(drive::Happened::OnLink {
                at,
                robot: robot.into(),
                link,
                event,
            });
        }
    }

    /// Begins to write all waiting records to the disk.
    fn begin_writing(&mut self) {
        let side = &mut self.scheduler;
        let Some(journal) = &mut side.journal else { return };
        if side.disk != DiskState::Idle || side.unwritten.is_empty() || side.stalls_in_act {
            return;
        }
        // A failure to append is ignored here, because the sync reports it again.
        let _broken = append_all(journal, side.unwritten.drain(..));
        side.disk = DiskState::Syncing;
        let (at, life) = (self.kernel.now + self.drawn.disk.sync, side.life);
        self.kernel.put(at, Item::Synced { life });
    }

    pub(super) fn synced(&mut self, life: u32) {
        let side = &mut self.scheduler;
        if life != side.life || !side.is_running() {
            return;
        }
        if self.kernel.now < side.disk_stands_still_until {
            let later = side.disk_stands_still_until;
            return self.kernel.put(later, Item::Synced { life });
        }
        let Some(journal) = &mut side.journal else { return };
        let (disk, event) = match journal.sync() {
            Ok(count) => (DiskState::Idle, Event::Recorded { count }),
            Err(broken) => (DiskState::Lost, Event::JournalLost { reason: broken.to_string() }),
        };
        side.disk = disk;
        self.tell(event);
        self.begin_writing();
    }

    /// Adds an event that the scheduler handles to the history, if the trace and the checks need it.
    fn note_taken(&mut self, happened: &drive::Happened) {
        let (drive::Happened::OnLink { event, .. } | drive::Happened::Event { event, .. }) = happened else {
            return;
        };
        if let drive::Happened::OnLink { robot, link, .. } = happened
            && self.scheduler.links[robot.get()].is_some_and(|current| current != self.scheduler.id_of(*link))
        {
            // The event is the end of a connection that was replaced and is no longer used.
            return;
        }
        match &**event {
            Event::LinkUp { robot } => self.note(Happened::LinkUp(robot.get())),
            Event::LinkDown { robot, .. } => self.note(Happened::LinkDown(robot.get())),
            Event::Received { robot, message } => {
                let message = (self.detail == HistoryDetail::Trace).then(|| message.clone());
                self.note(Happened::FromRobot(robot.get(), message));
            }
            _ => {}
        }
    }
}

impl drive::World for World {
    fn now(&self) -> Timestamp<Server> {
        self.kernel.now + self.scheduler.ahead
    }

    async fn next(&mut self, until: Option<Timestamp<Server>>) -> Option<drive::Happened> {
        loop {
            if !self.scheduler.is_running() || self.hung || self.is_promised {
                return Some(drive::Happened::Killed);
            }
            let can_take = self.kernel.now >= self.scheduler.paused_until;
            if can_take {
                self.finish_acting();
            }
            if can_take && std::mem::take(&mut self.scheduler.timers_first) {
                let expired = until.is_some_and(|until| until <= self.kernel.now + self.scheduler.ahead);
                if expired {
                    return None;
                }
            }
            if can_take && let Some(happened) = self.scheduler.arrived.pop_front() {
                self.note_taken(&happened);
                return Some(happened);
            }
            let ahead = self.scheduler.ahead;
            let until =
                until.map(|until| (until - ahead).max(self.scheduler.paused_until).max(self.kernel.now));
            match (self.next_instant(), until) {
                (Some(next), until) if until.is_none_or(|until| next <= until) => self.step(next),
                (_, Some(until)) => {
                    self.pass(until);
                    return None;
                }
                // No further event will ever occur, and the mission has not ended.
                (_, None) => self.hung = true,
            }
            self.hung |= self.kernel.now > self.lasts_until;
        }
    }

    fn connect(&mut self, robot: RobotIndex, link: LinkNumber, after: Span) {
        let robot = robot.get();
        if !self.acts() {
            return;
        }
        let link = self.scheduler.id_of(link);
        self.scheduler.links[robot] = None;
        self.scheduler.attempts[robot] = Some(link);
        let at = self.kernel.now.max(self.scheduler.paused_until) + after;
        self.kernel.put(at, Item::Connect { robot, link });
    }

    fn send(
        &mut self,
        robot: RobotIndex,
        link: LinkNumber,
        message: Message,
        _: Urgency,
    ) -> Result<(), QueueFull> {
        if self.acts() {
            let link = self.scheduler.id_of(link);
            if self.scheduler.stalls_in_act {
                self.scheduler.unsent.push((robot.get(), link, message));
            } else {
                self.send_to_robot(robot.get(), link, message);
            }
        }
        Ok(())
    }

    fn cut(&mut self, robot: RobotIndex, _: LinkNumber) {
        let robot = robot.get();
        if let Some(link) = self.scheduler.links[robot].take() {
            let at = self.kernel.now.max(self.scheduler.paused_until) + self.drawn.delay.1;
            self.kernel.put(at, Item::RobotLinkDown { robot, link });
        }
    }

    fn write(&mut self, at: Timestamp<Server>, record: Record) -> Filed {
        if !self.acts() {
            return Filed::Waiting;
        }
        if let Record::Prepared(promise) = &record {
            self.is_promised |= self.last_act.is_some_and(|last| promise.number >= last);
        }
        self.records.push((at - self.scheduler.ahead, by_true_time(record.clone(), self.scheduler.ahead)));
        let side = &mut self.scheduler;
        if side.disk == DiskState::Unused {
            return Filed::AtOnce;
        }
        if side.unwritten.len() >= WAITING_MAX {
            return Filed::Lost("the journal's disk is too slow".to_owned());
        }
        side.unwritten.push_back((at, record));
        self.begin_writing();
        Filed::Waiting
    }

    fn tell(&mut self, _: Timestamp<Server>, progress: Progress) {
        if !self.scheduler.is_running() {
            return;
        }
        self.hears(&progress);
        let often = matches!(progress, Progress::Heard { .. } | Progress::Reading { .. });
        if self.detail == HistoryDetail::Trace || !often {
            self.note(Happened::Told(Box::new(progress)));
        }
    }
}

/// Converts the times of a promise from the clock of the process that made it to the true time.
fn by_true_time(record: Record, ahead: Span) -> Record {
    match record {
        Record::Prepared(promise) => Record::Prepared(Promise {
            timestamp: promise.timestamp - ahead,
            start: promise.start - ahead,
            ..promise
        }),
        other => other,
    }
}

impl World {
    /// Makes the process use `link` to a robot instead of an older link. Returns `false` if the link is obsolete or the process does not
    /// run.
    pub(super) fn links_to(&mut self, robot: usize, link: LinkId) -> bool {
        let is_newest = self.scheduler.attempts[robot] == Some(link);
        let lives = self.scheduler.is_running() && self.scheduler.number_of(link).is_some() && is_newest;
        if lives {
            self.scheduler.links[robot] = Some(link);
        }
        lives
    }
}
