//! Metrics and health of a mission. The mission's loop writes the numbers, for a few robots at a time. The endpoint's thread reads them.

use std::collections::VecDeque;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

use downbeat_robot::figures::Distribution;
use urrcp::{RobotId, Server, Span, Timestamp};

use super::exposition::{Page, Source};
use super::health::{Checked, Health};
use super::host::number;
use super::names::{self, FAILURE_KINDS, Metric};
use crate::mission::figures::{PhaseName, RobotFigures};
use crate::mission::{Failure, Mission, Progress, RobotIndex};
use crate::run::watch::Watch;
use crate::server_clock::ServerClock;

/// Interval between two updates of the numbers of all robots.
const LOOK_EVERY: Span = Span::from_millis(500);
/// Interval between the parts of an update, each of which covers a few robots.
const PART_EVERY: Span = Span::from_millis(5);
/// Number of robots per part of an update: at least the first value, and at least all robots divided by the second value. A part of 100
/// robots takes the loop about 20 us.
const PART: (usize, usize) = (32, 100);
/// If the mission's loop makes no iteration for this long, it is considered stalled. It iterates at least every half second.
const STANDS_STILL: Span = Span::from_millis(3_000);

const PHASES: [&str; 5] = ["starting", "greeting", "performing", "stopping", "ended"];
const STAGES: [&str; 3] = ["waiting", "preparing", "playing"];

/// A floating-point number that one thread writes and another reads.
#[derive(Debug)]
struct Number(AtomicU64);

impl Number {
    const fn new(value: f64) -> Self {
        Self(AtomicU64::new(value.to_bits()))
    }

    fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }

    fn set(&self, value: f64) {
        self.0.store(value.to_bits(), Ordering::Relaxed);
    }

    /// Sets a counter, but never decreases it, even if the mission learns that fewer events occurred.
    fn raise(&self, count: u64) {
        self.set(self.get().max(number(count)));
    }

    fn add_one(&self) {
        self.set(self.get() + 1.0);
    }
}

/// The metrics of each robot, in the order of the robot's numbers in [`Numbers::robots`].
static CELLS: [&Metric; 15] = [
    &names::R_LINKED,
    &names::R_TAKES_PART,
    &names::R_OFFSET,
    &names::R_UNCERTAINTY,
    &names::R_ROUND_TRIP,
    &names::R_SENT,
    &names::R_ACCEPTED,
    &names::R_STARTED,
    &names::R_FAILED,
    &names::R_STEPS,
    &names::R_LATE,
    &names::R_START_ERROR,
    &names::R_RETRIES,
    &names::R_RECONNECTS,
    &names::R_UNCONFIRMED,
];

/// The numbers of a mission, which the mission's loop writes and the endpoint reads.
#[derive(Debug)]
struct Numbers {
    clock: ServerClock,
    /// Time of the loop's latest iteration, in nanoseconds on the server's clock. 0 before the first iteration.
    turned_at: AtomicI64,
    /// The mission's phase, as an index in [`PHASES`].
    phase: AtomicU64,
    greeted: AtomicU64,
    lateness: Distribution,
    rounds_late: Number,
    acts: [Number; STAGES.len()],
    acts_played: Number,
    skew_budget: Number,
    tolerance: Number,
    spread: Number,
    start_error: Distribution,
    window: Number,
    journal: Distribution,
    failures: [Number; FAILURE_KINDS.len()],
    stops: Number,
    links_lost: Number,
    robots: Vec<(RobotId, [Number; CELLS.len()])>,
}

/// The metrics of one mission, as the endpoint reads them.
#[derive(Clone, Debug)]
pub(crate) struct MissionMetrics(Arc<Numbers>);

impl MissionMetrics {
    /// Creates the metrics of a mission that has not begun. `robots` are in the mission's order.
    pub(crate) fn new(clock: ServerClock, robots: impl Iterator<Item = RobotId>) -> Self {
        let cell = |metric: &Metric| match metric.kind {
            names::MetricKind::Counter => Number::new(0.0),
            names::MetricKind::Gauge | names::MetricKind::Histogram => Number::new(f64::NAN),
        };
        Self(Arc::new(Numbers {
            clock,
            turned_at: AtomicI64::new(0),
            phase: AtomicU64::new(0),
            greeted: AtomicU64::new(0),
            lateness: Distribution::default(),
            rounds_late: Number::new(0.0),
            acts: std::array::from_fn(|_| Number::new(0.0)),
            acts_played: Number::new(0.0),
            skew_budget: Number::new(f64::NAN),
            tolerance: Number::new(f64::NAN),
            spread: Number::new(f64::NAN),
            start_error: Distribution::default(),
            window: Number::new(f64::NAN),
            journal: Distribution::default(),
            failures: std::array::from_fn(|_| Number::new(0.0)),
            stops: Number::new(0.0),
            links_lost: Number::new(0.0),
            robots: robots.map(|robot| (robot, CELLS.map(cell))).collect(),
        }))
    }

    /// Returns the watcher that writes these metrics in the mission's loop.
    pub(crate) fn watch(&self) -> MissionWatch {
        let now = self.0.clock.now();
        MissionWatch {
            numbers: Arc::clone(&self.0),
            next: 0,
            part_at: now,
            filed: VecDeque::new(),
            recorded: 0,
        }
    }
}

/// The watcher that writes the numbers of a mission, in the mission's loop.
#[derive(Debug)]
pub(crate) struct MissionWatch {
    numbers: Arc<Numbers>,
    /// The index of the first robot in the next part of the update.
    next: usize,
    part_at: Timestamp<Server>,
    /// For each record that is not on the disk yet, the time at which it was sent to the journal.
    filed: VecDeque<Timestamp<Server>>,
    recorded: u64,
}

impl MissionWatch {
    fn look_at_mission(&self, mission: &Mission) {
        let numbers = &self.numbers;
        numbers.rounds_late.raise(mission.rounds_held_up());
        numbers.acts.iter().zip(mission.act_stages()).for_each(|(acts, count)| acts.set(number(count)));
        let played: u64 = mission.fates().iter().map(|act| u64::from(act.played)).sum();
        numbers.acts_played.raise(played);
        if let Some(spread) = mission.act_reports().0.back().and_then(|act| act.spread) {
            numbers.spread.set(seconds(spread));
        }
        let phase = match mission.phase_name() {
            PhaseName::Greeting => 1,
            PhaseName::Performing => 2,
            PhaseName::Stopping => 3,
            PhaseName::Ended => 4,
        };
        numbers.phase.store(phase, Ordering::Relaxed);
    }

    fn look_at_robots(&self, mission: &Mission, robots: std::ops::Range<usize>) {
        for robot in robots {
            let cells = &self.numbers.robots[robot].1;
            for ((cell, metric), value) in
                cells.iter().zip(CELLS).zip(values(&mission.figures_of(RobotIndex::new(robot))))
            {
                match metric.kind {
                    names::MetricKind::Counter => cell.set(cell.get().max(value)),
                    names::MetricKind::Gauge | names::MetricKind::Histogram => cell.set(value),
                }
            }
        }
    }

    fn failed(&self, failure: &Failure) {
        let kind = serde_json::to_value(&failure.kind).ok();
        let named = kind.as_ref().and_then(|kind| kind.get("failure")?.as_str());
        let index = FAILURE_KINDS.iter().position(|kind| Some(*kind) == named);
        index.into_iter().for_each(|index| self.numbers.failures[index].add_one());
    }
}

/// Returns the values of a robot's metrics, in the order of [`CELLS`].
fn values(robot: &RobotFigures) -> [f64; CELLS.len()] {
    let (totals, clock) = (&robot.totals, robot.clock.as_ref());
    let flag = |is: bool| f64::from(u8::from(is));
    let known = |span: Option<Span>| span.map_or(f64::NAN, seconds);
    [
        flag(robot.is_linked),
        flag(robot.takes_part),
        known(clock.map(|clock| clock.offset)),
        known(clock.map(|clock| clock.uncertainty)),
        known(clock.map(|_| robot.round_trip)),
        number(totals.sent as u64),
        number(totals.accepted as u64),
        number(totals.started as u64),
        number(totals.failed as u64),
        number(totals.steps_done),
        number(totals.late_steps),
        known(totals.start_error),
        f64::from(totals.retries),
        f64::from(totals.reconnects),
        flag(robot.awaits_stop),
    ]
}

fn seconds(span: Span) -> f64 {
    span.as_millis_f64() / 1e3
}

impl Watch for MissionWatch {
    fn told(&mut self, _: Timestamp<Server>, progress: &Progress) {
        let numbers = &self.numbers;
        match progress {
            Progress::Greeted { .. } => numbers.greeted.store(1, Ordering::Relaxed),
            Progress::Preparing { skew: Some(skew), .. } => {
                numbers.skew_budget.set(seconds(skew.predicted));
                numbers.tolerance.set(seconds(skew.tolerance));
            }
            Progress::Committed { window: Some(window), .. } => numbers.window.set(seconds(*window)),
            Progress::Started { error: Some(error), .. } => numbers.start_error.add(error.abs()),
            Progress::Failed(failure) => self.failed(failure),
            Progress::LinkLost { .. } => numbers.links_lost.add_one(),
            Progress::Stopping { .. } => numbers.stops.add_one(),
            _ => {}
        }
    }

    fn turned(&mut self, now: Timestamp<Server>, mission: &Mission) {
        self.numbers.turned_at.store(now.as_nanos(), Ordering::Relaxed);
        if now < self.part_at {
            return;
        }
        if self.next == 0 {
            self.look_at_mission(mission);
        }
        let all = self.numbers.robots.len();
        let end = (self.next + PART.0.max(all / PART.1)).min(all);
        self.look_at_robots(mission, self.next..end);
        (self.next, self.part_at) = if end < all { (end, now + PART_EVERY) } else { (0, now + LOOK_EVERY) };
    }

    fn turns_by(&self) -> Option<Timestamp<Server>> {
        Some(self.part_at)
    }

    fn woke(&mut self, late: Span) {
        self.numbers.lateness.add(late);
    }

    fn filed(&mut self, at: Timestamp<Server>) {
        self.filed.push_back(at);
    }

    fn recorded(&mut self, at: Timestamp<Server>, count: u64) {
        while self.recorded < count
            && let Some(filed) = self.filed.pop_front()
        {
            self.recorded += 1;
            self.numbers.journal.add(at - filed);
        }
    }

    fn ended(&mut self, _: Timestamp<Server>, mission: &Mission) {
        self.look_at_robots(mission, 0..self.numbers.robots.len());
        self.look_at_mission(mission);
        self.numbers.phase.store(4, Ordering::Relaxed);
    }
}

impl Source for MissionMetrics {
    fn write(&self, page: &mut Page) {
        let numbers = &*self.0;
        page.state(&names::MISSION_PHASE, &PHASES, numbers.phase());
        if let Some(age) = numbers.loop_age() {
            page.one(&names::LOOP_AGE, seconds(age));
        }
        page.distribution(&names::LOOP_LATENESS, &numbers.lateness);
        page.one(&names::ROUNDS_LATE, numbers.rounds_late.get());
        page.each(&names::ACTS, STAGES.into_iter().zip(numbers.acts.iter().map(Number::get)));
        page.one(&names::ACTS_PLAYED, numbers.acts_played.get());
        let up = numbers.robots.iter().filter(|(_, cells)| cells[0].get() == 1.0).count();
        let links = [("up", up), ("down", numbers.robots.len() - up)];
        page.each(&names::ROBOTS, links.into_iter().map(|(link, count)| (link, number(count as u64))));
        for (metric, value) in [
            (&names::SKEW_BUDGET, &numbers.skew_budget),
            (&names::START_TOLERANCE, &numbers.tolerance),
            (&names::START_SPREAD, &numbers.spread),
        ] {
            page.known(metric, value.get());
        }
        page.distribution(&names::START_ERROR, &numbers.start_error);
        page.known(&names::COMMIT_WINDOW, numbers.window.get());
        page.distribution(&names::JOURNAL_SYNC, &numbers.journal);
        page.each(&names::FAILURES, FAILURE_KINDS.into_iter().zip(numbers.failures.iter().map(Number::get)));
        page.one(&names::STOPS, numbers.stops.get());
        page.one(&names::LINKS_LOST, numbers.links_lost.get());
        for (index, metric) in CELLS.iter().enumerate() {
            page.each(metric, numbers.robots.iter().map(|(id, cells)| (id.as_str(), cells[index].get())));
        }
    }
}

impl Numbers {
    fn phase(&self) -> &'static str {
        let phase = usize::try_from(self.phase.load(Ordering::Relaxed)).unwrap_or(0);
        PHASES.get(phase).copied().unwrap_or(PHASES[0])
    }

    /// Returns the time since the loop's latest iteration. `None` before the first iteration.
    fn loop_age(&self) -> Option<Span> {
        let turned_at = self.turned_at.load(Ordering::Relaxed);
        (turned_at != 0).then(|| (self.clock.now() - Timestamp::from_nanos(turned_at)).max(Span::ZERO))
    }

    fn checked(&self) -> Checked {
        let phase = self.phase();
        let is_ended = phase == "ended";
        let alive = match self.loop_age().filter(|_| !is_ended) {
            None => Ok(format!("mission: {phase}")),
            Some(age) if age <= STANDS_STILL => {
                Ok(format!("mission: {phase}, last loop iteration {age} ago"))
            }
            Some(age) => Err(format!("mission: {phase}, its loop has been stalled for {age}")),
        };
        let is_ready = phase == "performing" && self.greeted.load(Ordering::Relaxed) == 1;
        let ready = if is_ready { alive.clone() } else { Err(format!("mission: {phase}")) };
        Checked { alive, ready }
    }
}

impl Health for MissionMetrics {
    fn now(&self) -> Pin<Box<dyn Future<Output = Checked> + Send + '_>> {
        Box::pin(std::future::ready(self.0.checked()))
    }
}
