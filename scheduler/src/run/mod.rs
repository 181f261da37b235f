//! The real driver of a mission: takes events from links, performs actions, sleeps until the next wake-up.

pub mod control;

use std::time::Duration;

use tokio::sync::mpsc;
use urrcp::{Server, Timestamp};

use crate::journal::Journal;
use crate::link::{Endpoint, Link, LinkEvent};
use crate::mission::{Action, Event, Mission, Progress};
use crate::recording::Recording;
use crate::report::Report;
use crate::server_clock::{NtpState, NtpWatch, ServerClock};

/// Events that may wait for the mission; links wait beyond that.
const EVENTS_MAX: usize = 65_536;

/// What the operator asks for while a mission runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operator {
    /// Let the act begin that waits for it.
    Go,
    /// Stop all robots and wait for their confirmation.
    Stop,
    /// Leave at once.
    Leave,
}

/// What is kept of a mission on disk.
#[derive(Debug, Default)]
pub struct Keep {
    /// What was promised to whom.
    pub journal: Option<Journal>,
    /// Everything that was said.
    pub recording: Option<Recording>,
    /// Follows NTP while the mission goes on.
    pub ntp: Option<NtpWatch>,
}

/// Runs a mission to its end. `endpoints` stand in the order of the mission's robots.
pub async fn run(
    mission: Mission,
    endpoints: Vec<Endpoint>,
    clock: ServerClock,
    operator: mpsc::Receiver<Operator>,
    tell: impl FnMut(Timestamp<Server>, &Progress),
) -> Report {
    let mut keep = Keep::default();
    run_and_keep(mission, endpoints, clock, operator, tell, &mut keep).await
}

/// As [`run`], with a journal or a recording.
pub async fn run_and_keep(
    mut mission: Mission,
    endpoints: Vec<Endpoint>,
    clock: ServerClock,
    mut operator: mpsc::Receiver<Operator>,
    tell: impl FnMut(Timestamp<Server>, &Progress),
    keep: &mut Keep,
) -> Report {
    let mut ntp = keep.ntp.take();
    let (events, mut happened) = mpsc::channel::<LinkEvent>(EVENTS_MAX);
    let mut driver = Driver {
        links: Vec::with_capacity(endpoints.len()),
        endpoints,
        clock,
        events,
        tell,
        keep,
        broken: false,
        recorded: 0,
    };
    for robot in 0..driver.endpoints.len() {
        let link = driver.open(robot, Duration::ZERO);
        driver.links.push(link);
    }
    loop {
        if let Some(report) = Report::of(&mission) {
            flush(driver.links).await;
            return report;
        }
        let wakeup = mission.next_wakeup().map(|at| tokio::time::Instant::from_std(clock.instant_of(at)));
        let actions = tokio::select! {
            biased;
            asked = operator.recv() => match asked {
                Some(Operator::Stop) => mission.handle(clock.now(), Event::StopRequested),
                Some(Operator::Go) => mission.handle(clock.now(), Event::Go),
                Some(Operator::Leave) | None => {
                    flush(driver.links).await;
                    return Report::as_left(&mut mission, clock.now());
                }
            },
            Some((at, event)) = happened.recv() => {
                driver.note(at, &mission, &event);
                mission.happened(at, clock.now(), event)
            },
            state = next_state(&mut ntp) => mission.handle(clock.now(), Event::ServerTime(state)),
            () = sleep_until(wakeup) => Vec::new(),
        };
        driver.perform(&mut mission, actions);
        // Timers come after the events of the same instant, and an event may have made one due.
        let due = mission.advance(clock.now());
        driver.perform(&mut mission, due);
    }
}

async fn next_state(ntp: &mut Option<NtpWatch>) -> NtpState {
    match ntp {
        Some(watch) => watch.next().await,
        None => std::future::pending().await,
    }
}

async fn sleep_until(wakeup: Option<tokio::time::Instant>) {
    match wakeup {
        Some(wakeup) => tokio::time::sleep_until(wakeup).await,
        None => std::future::pending().await,
    }
}

struct Driver<'a, T> {
    links: Vec<Link>,
    endpoints: Vec<Endpoint>,
    clock: ServerClock,
    events: mpsc::Sender<LinkEvent>,
    tell: T,
    keep: &'a mut Keep,
    /// The journal takes nothing any more.
    broken: bool,
    recorded: u64,
}

impl<T: FnMut(Timestamp<Server>, &Progress)> Driver<'_, T> {
    fn open(&self, robot: usize, after: Duration) -> Link {
        Link::open(robot, self.endpoints[robot].clone(), self.clock, self.events.clone(), after)
    }

    fn note(&mut self, at: Timestamp<Server>, mission: &Mission, event: &Event) {
        if let (Event::Received { robot, message }, Some(recording)) = (event, &mut self.keep.recording) {
            recording.received(at, mission.robot_id(*robot), message);
        }
    }

    fn perform(&mut self, mission: &mut Mission, actions: Vec<Action>) {
        let mut unwritten = None;
        let before = self.recorded;
        for action in actions {
            let now = self.clock.now();
            match action {
                // What is not written down is not promised.
                Action::Send { urgent: false, .. } if unwritten.is_some() => {}
                Action::Send { robot, message, urgent } => {
                    if let Some(recording) = &mut self.keep.recording {
                        recording.sent(now, mission.robot_id(robot), &message);
                    }
                    self.links[robot].send(message, urgent);
                }
                Action::Reconnect { robot, after } => {
                    self.links[robot] = self.open(robot, after.to_duration());
                }
                Action::Record(record) => {
                    if let Some(recording) = &mut self.keep.recording {
                        recording.record(now, &record);
                    }
                    let written =
                        self.keep.journal.as_mut().map_or(Ok(0), |journal| {
                            journal.append(now, &record).and_then(|()| journal.sync())
                        });
                    self.recorded += u64::from(record.is_durable());
                    unwritten = written.err().or(unwritten);
                }
                Action::Tell(progress) => {
                    if let Some(recording) = &mut self.keep.recording {
                        recording.progress(now, &progress);
                    }
                    (self.tell)(now, &progress);
                }
            }
        }
        if self.recorded > before && !self.broken && unwritten.is_none() {
            let on_disk = mission.handle(self.clock.now(), Event::Recorded { count: self.recorded });
            self.perform(mission, on_disk);
        }
        if let Some(reason) = unwritten.filter(|_| !self.broken) {
            self.broken = true;
            tracing::error!("{reason}");
            let stopping = mission.handle(self.clock.now(), Event::JournalLost { reason });
            self.perform(mission, stopping);
        }
    }
}

/// Lets go of the links and gives their tasks a moment to write what is queued.
async fn flush(links: Vec<Link>) {
    drop(links);
    tokio::time::sleep(Duration::from_millis(20)).await;
}
