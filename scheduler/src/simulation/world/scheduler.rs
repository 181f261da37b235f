//! The scheduler's process in a simulated world: the loop of every mission meets what goes wrong here. Its journal is the real
//! one, on a disk that is slow, runs full, and loses power.

use std::collections::VecDeque;

use downbeat_robot::LinkId;
use urrcp::{Message, RobotId, Server, SessionId, Span, Timestamp};

use super::{BEGIN, Item, LASTS_MAX, World, options, participants, session};
use crate::drive::{self, Filed, LinkNumber, QueueFull, Urgency};
use crate::journal::simulated::SimulatedDisk;
use crate::journal::{Asked, Fate, Journal, Kept, Opened, OpenedRobot};
use crate::mission::{Event, Greeting, Mission, Progress, Record};
use crate::simulation::{Drawn, Happened};

/// Whether the process is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Process {
    Running,
    Gone,
    /// Another one is about to take up what it left.
    TakenUp,
}

pub(super) struct Scheduler {
    pub(super) process: Process,
    /// Counts the lives of the process: what was under way for an earlier one is lost.
    life: u32,
    pub(super) paused_until: Timestamp<Server>,
    /// What has arrived and is not taken yet.
    arrived: VecDeque<drive::Happened>,
    /// The links as the process sees them.
    links: Vec<Option<LinkId>>,
    /// `None` only while it changes hands.
    journal: Option<Journal<SimulatedDisk>>,
    /// Records that wait for the disk.
    unwritten: VecDeque<(Timestamp<Server>, Record)>,
    disk: DiskState,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DiskState {
    Idle,
    Syncing,
    /// The mission has been told.
    Lost,
}

fn opened(robot: RobotId) -> OpenedRobot {
    OpenedRobot { robot, address: "soak".to_owned(), init: None }
}

impl Scheduler {
    pub(super) fn new(drawn: &Drawn) -> Self {
        let mut journal = on(SimulatedDisk::with_capacity(drawn.disk.capacity));
        let opened = Opened {
            session: session().unwrap_or_else(unreachable_session),
            pid: 0,
            scenario: "soak".into(),
            fleet: "soak".into(),
            folder: None,
            asked: Asked::default(),
            greeting: Greeting::Full,
            clock_offset: Span::ZERO,
            robots: drawn.robots.iter().map(|robot| opened(robot.block.id.clone())).collect(),
        };
        if let Some(Err(error)) = journal.as_mut().map(|journal| journal.begin(BEGIN, &opened)) {
            tracing::debug!("{error}");
        }
        Self {
            process: Process::Running,
            life: 0,
            paused_until: BEGIN,
            arrived: VecDeque::new(),
            links: vec![None; drawn.robots.len()],
            journal,
            unwritten: VecDeque::new(),
            disk: DiskState::Idle,
        }
    }

    /// When it takes what has arrived, if it could not do so at once.
    pub(super) fn wakes(&self) -> Option<Timestamp<Server>> {
        (!self.arrived.is_empty() && self.process == Process::Running).then_some(self.paused_until)
    }

    pub(super) fn is_running(&self) -> bool {
        self.process == Process::Running
    }

    /// The link as robots know it: no two lives of the process share one.
    fn id_of(&self, link: LinkNumber) -> LinkId {
        LinkId((u64::from(self.life) << 32) | link.0)
    }

    /// The number of a link that this life of the process has made.
    fn number_of(&self, link: LinkId) -> Option<LinkNumber> {
        (link.0 >> 32 == u64::from(self.life)).then_some(LinkNumber(link.0 & 0xffff_ffff))
    }
}

/// The journal on a simulated disk, which takes every cut.
fn on(disk: SimulatedDisk) -> Option<Journal<SimulatedDisk>> {
    Journal::on(disk, "journal".into()).ok()
}

#[expect(clippy::expect_used, reason = "a constant below every limit")]
fn unreachable_session() -> SessionId {
    SessionId::new("s").expect("a constant below every limit")
}

impl World {
    /// The process dies. What its journal's thread had not handed to the system is lost; where the power fails, what was not
    /// synced may be torn as well.
    pub(super) fn kill_scheduler(&mut self) {
        if !self.scheduler.is_running() {
            return;
        }
        let side = &mut self.scheduler;
        side.process = Process::Gone;
        side.life += 1;
        side.arrived.clear();
        side.unwritten.clear();
        if let Some(journal) = side.journal.take() {
            let mut disk = journal.into_disk();
            if self.drawn.disk.loses_power {
                let survive = self.rng.usize(0..=disk.at_risk());
                disk.lose_power(survive);
            }
            side.journal = on(disk);
        }
        for robot in 0..self.robots.len() {
            if let Some(link) = self.scheduler.links[robot].take() {
                let at = self.now + self.drawn.delay.1;
                self.put(at, Item::RobotLinkDown { robot, link });
            }
        }
    }

    /// Waits until another process takes the mission up, if one will, and returns what it makes of the journal.
    pub(super) fn taken_up(&mut self) -> Option<Mission> {
        while self.items.values().any(|item| matches!(item, Item::Resume)) {
            let next = self.next_instant().filter(|_| !self.hung)?;
            self.step(next);
            if self.scheduler.process == Process::TakenUp {
                self.scheduler.process = Process::Running;
                return Some(self.mission_by_journal());
            }
        }
        None
    }

    pub(super) fn resume(&mut self) {
        let kept = self.scheduler.journal.as_ref().and_then(Journal::kept);
        if !self.scheduler.is_running() && kept.is_some_and(|kept| kept.outcome.is_none()) {
            self.scheduler.process = Process::TakenUp;
        }
    }

    /// What `downbeat resume` does.
    fn mission_by_journal(&mut self) -> Mission {
        let kept = self.scheduler.journal.as_ref().and_then(Journal::kept);
        let participants = participants(&self.drawn);
        let choreography = self.drawn.choreography.clone();
        let resumed = kept.filter(|kept| kept.fate() == Fate::Resume).and_then(|kept| {
            Mission::resume(choreography, participants.clone(), options(), kept, self.now).ok()
        });
        let left = kept.map(Kept::left).unwrap_or_default();
        self.scheduler.disk = DiskState::Idle;
        self.scheduler.paused_until = self.now;
        self.note(Happened::TakenUp(if resumed.is_some() { "resumed" } else { "withdrawn" }));
        resumed.unwrap_or_else(|| Mission::withdraw(participants, options(), &left, self.now))
    }

    /// Something for the scheduler, which takes it when it can.
    pub(super) fn tell(&mut self, event: Event) {
        let event = Box::new(event);
        self.scheduler.arrived.push_back(drive::Happened::Event { at: self.now, event });
    }

    pub(super) fn tell_on_link(&mut self, robot: usize, link: LinkId, event: Event) {
        self.arrive_at_scheduler(robot, link, Box::new(event));
    }

    pub(super) fn arrive_at_scheduler(&mut self, robot: usize, link: LinkId, event: Box<Event>) {
        if let Some(link) = self.scheduler.number_of(link).filter(|_| self.scheduler.is_running()) {
            self.scheduler.arrived.push_back(drive::Happened::OnLink { at: self.now, robot, link, event });
        }
    }

    /// Hands the disk all that waits for it.
    fn begin_writing(&mut self) {
        let side = &mut self.scheduler;
        let Some(journal) = &mut side.journal else { return };
        if side.disk != DiskState::Idle || side.unwritten.is_empty() {
            return;
        }
        for (at, record) in side.unwritten.drain(..) {
            // A failure is found again by the sync.
            let _broken = journal.append(at, &record);
        }
        side.disk = DiskState::Syncing;
        let (at, life) = (self.now + self.drawn.disk.sync, side.life);
        self.put(at, Item::Synced { life });
    }

    pub(super) fn synced(&mut self, life: u32) {
        let side = &mut self.scheduler;
        if life != side.life || !side.is_running() {
            return;
        }
        let Some(journal) = &mut side.journal else { return };
        let (disk, event) = match journal.sync() {
            Ok(count) => (DiskState::Idle, Event::Recorded { count }),
            Err(reason) => (DiskState::Lost, Event::JournalLost { reason }),
        };
        side.disk = disk;
        self.tell(event);
        self.begin_writing();
    }

    /// Keeps what the trace and the checks want to know of.
    fn note_taken(&mut self, happened: &drive::Happened) {
        let (drive::Happened::OnLink { event, .. } | drive::Happened::Event { event, .. }) = happened else {
            return;
        };
        match &**event {
            Event::LinkUp { robot } => self.note(Happened::LinkUp(*robot)),
            Event::LinkDown { robot, .. } => self.note(Happened::LinkDown(*robot)),
            Event::Received { robot, message } => {
                let message = self.verbose.then(|| message.clone());
                self.note(Happened::FromRobot(*robot, message));
            }
            _ => {}
        }
    }
}

impl drive::World for World {
    fn now(&self) -> Timestamp<Server> {
        self.now
    }

    async fn next(&mut self, until: Option<Timestamp<Server>>) -> Option<drive::Happened> {
        loop {
            if !self.scheduler.is_running() || self.hung {
                return Some(drive::Happened::Killed);
            }
            let can_take = self.now >= self.scheduler.paused_until;
            if can_take && let Some(happened) = self.scheduler.arrived.pop_front() {
                self.note_taken(&happened);
                return Some(happened);
            }
            let until = until.map(|until| until.max(self.scheduler.paused_until).max(self.now));
            match (self.next_instant(), until) {
                (Some(next), until) if until.is_none_or(|until| next <= until) => self.step(next),
                (_, Some(until)) => {
                    self.pass(until);
                    return None;
                }
                // Nothing will ever happen again, and the mission has not ended.
                (_, None) => self.hung = true,
            }
            self.hung |= self.now > BEGIN + LASTS_MAX;
        }
    }

    fn connect(&mut self, robot: usize, link: LinkNumber, after: Span) {
        let link = self.scheduler.id_of(link);
        self.scheduler.links[robot] = None;
        self.put(self.now + after, Item::Connect { robot, link });
    }

    fn send(
        &mut self,
        robot: usize,
        link: LinkNumber,
        message: Message,
        _: Urgency,
    ) -> Result<(), QueueFull> {
        self.send_to_robot(robot, self.scheduler.id_of(link), &message);
        Ok(())
    }

    fn cut(&mut self, robot: usize, _: LinkNumber) {
        if let Some(link) = self.scheduler.links[robot].take() {
            self.put(self.now + self.drawn.delay.1, Item::RobotLinkDown { robot, link });
        }
    }

    fn write(&mut self, at: Timestamp<Server>, record: Record) -> Filed {
        self.records.push((at, record.clone()));
        self.scheduler.unwritten.push_back((at, record));
        self.begin_writing();
        Filed::Waiting
    }

    fn tell(&mut self, _: Timestamp<Server>, progress: Progress) {
        let often = matches!(progress, Progress::Heard { .. } | Progress::Reading { .. });
        if self.verbose || !often {
            self.note(Happened::Told(Box::new(progress)));
        }
    }
}

impl World {
    /// The process sees this link from now on; an older one is forgotten.
    pub(super) fn links_to(&mut self, robot: usize, link: LinkId) -> bool {
        let lives = self.scheduler.is_running() && self.scheduler.number_of(link).is_some();
        if lives {
            self.scheduler.links[robot] = Some(link);
        }
        lives
    }
}
