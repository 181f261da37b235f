//! The real environment of a mission: links and timers of tokio, the thread of the journal, the file of the recording.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};
use urrcp::{Message, RobotId, Server, Span, Timestamp};

use super::Keep;
use super::watch::Watches;
use crate::journal::{Journal, News, Writer};
use crate::link::{Endpoint, Link, OfRobot, SharedAllowance, SharedScripts, Waiting};
use crate::recording::{Recorder, Recording};
use crate::server_clock::{NtpWatch, ServerClock};
use crate::stop_lane::{Before, Operator, Passage, StopLane};
use downbeat_mission::clock::NtpState;
use downbeat_mission::drive::{Filed, Happened, LinkNumber, QueueFull, Urgency, World};
use downbeat_mission::{Event, Mission, Progress, Record, RobotIndex};

/// Maximum number of events that may wait for the mission. While this many wait, links send no further events.
const EVENTS_MAX: usize = 65_536;

/// Number of scripts per device that another process may have sent. The responses to them are permitted in addition to the link's
/// reserve.
const SCRIPTS_HELD: usize = 16;

pub(super) struct RealWorld<T> {
    clock: ServerClock,
    endpoints: Vec<Endpoint>,
    /// For each robot, the state that all links to it share.
    of_robots: Vec<OfRobot>,
    ids: Arc<[RobotId]>,
    links: Vec<Option<Link>>,
    events: mpsc::Sender<Waiting>,
    happened: mpsc::Receiver<Waiting>,
    operator: mpsc::Receiver<Operator>,
    /// The channels for pending answers to `go` commands, oldest first.
    unanswered: VecDeque<oneshot::Sender<Result<String, String>>>,
    ntp: Option<NtpWatch>,
    tell: T,
    journal: FileJournal,
    recording: Option<Recorder>,
    stop_lane: Option<StopLane>,
    watches: Watches,
}

enum FileJournal {
    None,
    Written(Writer),
    /// The thread of the journal could not be started, for the contained reason.
    Lost(String),
}

/// The robots of a mission, in its order, and how they are reached.
pub(super) struct Reached {
    pub(super) ids: Vec<RobotId>,
    pub(super) endpoints: Vec<Endpoint>,
    /// The scripts that each robot and others receive.
    pub(super) shared: Vec<SharedScripts>,
    pub(super) before: Before,
}

impl<T: FnMut(Timestamp<Server>, &Progress)> RealWorld<T> {
    pub(super) fn new(
        robots: Reached,
        clock: ServerClock,
        operator: mpsc::Receiver<Operator>,
        tell: T,
        keep: Keep,
    ) -> Self {
        let Reached { ids, endpoints, shared, before } = robots;
        let (events, happened) = mpsc::channel(EVENTS_MAX);
        let mut stop_lane = keep.stop_lane;
        if let Some(lane) = &mut stop_lane {
            lane.guard(&endpoints, &before, clock, &events);
        }
        let journal = keep.journal.map_or(FileJournal::None, |journal| match Writer::start(journal) {
            Ok(writer) => FileJournal::Written(writer),
            Err(error) => FileJournal::Lost(format!("cannot start a thread for the journal: {error}")),
        });
        Self {
            clock,
            links: endpoints.iter().map(|_| None).collect(),
            of_robots: of_robots(shared, &before),
            endpoints,
            ids: ids.into(),
            events,
            happened,
            operator,
            unanswered: VecDeque::new(),
            ntp: keep.ntp,
            tell,
            journal,
            recording: keep.recording,
            stop_lane,
            watches: keep.watches,
        }
    }

    /// Drops the links, gives their tasks a moment to write queued messages, and waits for the disk. Returns the mission's resources.
    pub(super) async fn finish(self) -> Keep {
        if let Some(lane) = &self.stop_lane {
            lane.let_go();
        }
        drop(self.links);
        tokio::time::sleep(Duration::from_millis(20)).await;
        let journal: Option<Journal> = match self.journal {
            FileJournal::Written(writer) => writer.finish().await,
            FileJournal::None | FileJournal::Lost(_) => None,
        };
        let (recording, ntp, stop_lane) = (self.recording, self.ntp, self.stop_lane);
        Keep { journal, recording, ntp, stop_lane, watches: self.watches }
    }

    fn note(&mut self, note: impl FnOnce(&mut Recording, &[RobotId]) + Send + 'static) {
        if let Some(recorder) = &mut self.recording {
            let ids = Arc::clone(&self.ids);
            recorder.note(move |recording| note(recording, &ids));
        }
    }

    fn note_received(&mut self, happened: &Happened) {
        let (Happened::OnLink { at, event, .. } | Happened::Event { at, event }) = happened else { return };
        if let (Event::LinkUp { robot }, Some(lane)) = (&**event, &self.stop_lane) {
            lane.reached(*robot);
        }
        if let (Event::Received { robot, message }, Some(_)) = (&**event, &self.recording) {
            let (at, robot, message) = (*at, *robot, message.clone());
            self.note(move |recording, ids| recording.received(at, &ids[robot.get()], &message));
        }
    }

    /// Returns the next event before `until`. If several are ready, follows the order of precedence that all environments of a mission
    /// use.
    async fn happens(&mut self, until: Option<Timestamp<Server>>) -> Option<Happened> {
        tokio::select! {
            biased;
            word = self.operator.recv() => match word {
                Some(Operator::Stop { rest, by }) => self.event(Event::StopRequested { rest, by }),
                Some(Operator::Go { act, by, answer }) => {
                    self.unanswered.push_back(answer);
                    self.event(Event::Go { act, by })
                }
                Some(Operator::Leave) | None => Some(Happened::Left),
            },
            news = next_news(&mut self.journal) => self.recorded(match news {
                News::Recorded(count) => Event::Recorded { count },
                News::WrittenAgain => Event::JournalWrittenAgain,
                News::Lost(reason) => Event::JournalLost { reason },
            }),
            Some(Waiting { happened, .. }) = self.happened.recv() => {
                self.note_received(&happened);
                Some(happened)
            }
            state = next_state(&mut self.ntp) => self.event(Event::ServerTime(state)),
            () = wait_until(self.clock, until) => None,
        }
    }

    fn recorded(&mut self, event: Event) -> Option<Happened> {
        if let Event::Recorded { count } = event {
            let now = self.clock.now();
            self.watches.each(|watch| watch.recorded(now, count));
        }
        self.event(event)
    }

    fn event(&self, event: Event) -> Option<Happened> {
        Some(Happened::Event { at: self.clock.now(), event: Box::new(event) })
    }
}

impl<T: FnMut(Timestamp<Server>, &Progress)> World for RealWorld<T> {
    fn now(&self) -> Timestamp<Server> {
        self.clock.now()
    }

    async fn next(&mut self, until: Option<Timestamp<Server>>) -> Option<Happened> {
        if let Some(lane) = &self.stop_lane {
            lane.turned();
        }
        if self.watches.is_empty() {
            return self.happens(until).await;
        }
        let due = until.filter(|due| self.watches.turns_by().is_none_or(|by| *due <= by));
        let until = due.or_else(|| self.watches.turns_by());
        let sleeps = due.filter(|due| *due > self.clock.now());
        let happened = self.happens(until).await;
        if let (None, Some(due)) = (&happened, sleeps) {
            let late = self.clock.now() - due;
            self.watches.each(|watch| watch.woke(late));
        }
        happened
    }

    fn turned(&mut self, mission: &Mission) {
        if !self.watches.is_empty() {
            let now = self.clock.now();
            self.watches.each(|watch| watch.turned(now, mission));
        }
    }

    fn connect(&mut self, robot: RobotIndex, link: LinkNumber, after: Span) {
        let (endpoint, of_robot) = (self.endpoints[robot.get()].clone(), self.of_robots[robot.get()].clone());
        let (of, events, after) = ((robot, link), self.events.clone(), after.to_duration());
        let link = Link::open_beside_others(of, endpoint, of_robot, self.clock, events, after);
        if let Some(lane) = &self.stop_lane {
            lane.links(robot, &link);
        }
        self.links[robot.get()] = Some(link);
    }

    fn send(
        &mut self,
        robot: RobotIndex,
        _: LinkNumber,
        message: Message,
        urgency: Urgency,
    ) -> Result<(), QueueFull> {
        let Some(link) = &self.links[robot.get()] else { return Ok(()) };
        if self.stop_lane.as_ref().is_some_and(|lane| lane.passes(robot, &message) == Passage::Closed) {
            return Ok(());
        }
        // The time is taken before the message is sent: on a busy machine, the link may send the message long before this code continues.
        // In the recording, a later time would look like an error of the robot's clock.
        let copy = self.recording.is_some().then(|| (self.clock.now(), message.clone()));
        link.send(message, urgency)?;
        if let Some((at, message)) = copy {
            self.note(move |recording, ids| recording.sent(at, &ids[robot.get()], message));
        }
        Ok(())
    }

    fn cut(&mut self, robot: RobotIndex, _: LinkNumber) {
        if let Some(link) = self.links[robot.get()].take() {
            link.cut();
        }
    }

    fn write(&mut self, at: Timestamp<Server>, record: Record) -> Filed {
        if self.recording.is_some() {
            let record = record.clone();
            self.note(move |recording, _| recording.record(at, &record));
        }
        match &self.journal {
            FileJournal::None => Filed::AtOnce,
            FileJournal::Lost(reason) => Filed::Lost(reason.clone()),
            FileJournal::Written(writer) => {
                if record.is_durable() {
                    self.watches.each(|watch| watch.filed(at));
                }
                match writer.write(at, record) {
                    Ok(()) => Filed::Waiting,
                    Err(error) => Filed::Lost(error.to_string()),
                }
            }
        }
    }

    fn tell(&mut self, at: Timestamp<Server>, progress: Progress) {
        if let (Progress::GoingHome { .. }, Some(lane)) = (&progress, &self.stop_lane) {
            lane.goes_home();
        }
        (self.tell)(at, &progress);
        self.watches.each(|watch| watch.told(at, &progress));
        self.note(move |recording, _| recording.progress(at, &progress));
    }

    fn answer(&mut self, answer: Result<String, String>) {
        if let Some(asked) = self.unanswered.pop_front() {
            let _gone = asked.send(answer);
        }
    }
}

/// Returns the shared state of each robot. A robot may still report on scripts that another process has sent to some of its devices.
fn of_robots(shared: Vec<SharedScripts>, before: &Before) -> Vec<OfRobot> {
    let of = |(robot, shared): (usize, SharedScripts)| {
        let asked = SharedAllowance::default();
        asked.note_held(before.devices.get(robot).map_or(0, |devices| devices.len() * SCRIPTS_HELD));
        OfRobot { asked, shared, ..OfRobot::default() }
    };
    shared.into_iter().enumerate().map(of).collect()
}

async fn next_news(journal: &mut FileJournal) -> News {
    match journal {
        FileJournal::Written(writer) => writer.next().await,
        FileJournal::None | FileJournal::Lost(_) => std::future::pending().await,
    }
}

async fn next_state(ntp: &mut Option<NtpWatch>) -> NtpState {
    match ntp {
        Some(watch) => watch.next().await,
        None => std::future::pending().await,
    }
}

async fn wait_until(clock: ServerClock, until: Option<Timestamp<Server>>) {
    match until {
        // No timer is used for a time that has passed: even a due timer would fire only at the runtime's next millisecond.
        Some(at) if at <= clock.now() => {}
        Some(at) => tokio::time::sleep_until(tokio::time::Instant::from_std(clock.instant_of(at))).await,
        None => std::future::pending().await,
    }
}
