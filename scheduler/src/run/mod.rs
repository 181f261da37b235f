//! The real driver of a mission: takes events from links, performs actions, sleeps until the next wake-up.

use std::time::Duration;

use tokio::sync::mpsc;
use urrcp::{Server, Timestamp};

use crate::link::{Endpoint, Link, LinkEvent};
use crate::mission::{Action, Event, Mission, Progress};
use crate::report::Report;
use crate::server_clock::ServerClock;

/// Events that may wait for the mission; links wait beyond that.
const EVENTS_MAX: usize = 65_536;

/// What the operator asks for while a mission runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operator {
    /// Stop all robots and wait for their confirmation.
    Stop,
    /// Leave at once.
    Leave,
}

/// Runs a mission to its end. `endpoints` stand in the order of the mission's robots.
pub async fn run(
    mut mission: Mission,
    endpoints: Vec<Endpoint>,
    clock: ServerClock,
    mut operator: mpsc::Receiver<Operator>,
    mut tell: impl FnMut(Timestamp<Server>, &Progress),
) -> Report {
    let (events, mut happened) = mpsc::channel::<LinkEvent>(EVENTS_MAX);
    let open = |(robot, endpoint)| Link::open(robot, endpoint, clock, events.clone());
    let links: Vec<Link> = endpoints.into_iter().enumerate().map(open).collect();
    loop {
        if let Some(report) = mission.report() {
            flush(links).await;
            return report;
        }
        let wakeup = mission.next_wakeup().map(|at| tokio::time::Instant::from_std(clock.instant_of(at)));
        let actions = tokio::select! {
            biased;
            asked = operator.recv() => match asked {
                Some(Operator::Stop) => mission.handle(clock.now(), Event::StopRequested),
                Some(Operator::Leave) | None => {
                    flush(links).await;
                    return mission.report_as_left();
                }
            },
            Some((at, event)) = happened.recv() => mission.handle(at, event),
            () = sleep_until(wakeup) => Vec::new(),
        };
        perform(actions, &links, &clock, &mut tell);
        // Timers come after the events of the same instant, and an event may have made one due.
        let due = mission.advance(clock.now());
        perform(due, &links, &clock, &mut tell);
    }
}

async fn sleep_until(wakeup: Option<tokio::time::Instant>) {
    match wakeup {
        Some(wakeup) => tokio::time::sleep_until(wakeup).await,
        None => std::future::pending().await,
    }
}

fn perform(
    actions: Vec<Action>,
    links: &[Link],
    clock: &ServerClock,
    tell: &mut impl FnMut(Timestamp<Server>, &Progress),
) {
    for action in actions {
        match action {
            Action::Send { robot, message } => links[robot].send(message),
            Action::Tell(progress) => tell(clock.now(), &progress),
        }
    }
}

/// Lets go of the links and gives their tasks a moment to write what is queued.
async fn flush(links: Vec<Link>) {
    drop(links);
    tokio::time::sleep(Duration::from_millis(20)).await;
}
