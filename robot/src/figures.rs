//! Metrics of a host. The precise thread (which wakes the robots) updates them and any thread may read them; neither waits for the other.

use std::sync::atomic::{AtomicU64, Ordering};

use urrcp::Span;

use crate::counts::Counts;

/// Upper bounds of the buckets of a [`Distribution`], in microseconds. Longer durations have a separate bucket.
pub const BOUNDS_US: [u64; 14] =
    [10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 1_000_000];

/// A histogram of durations.
#[derive(Debug, Default)]
pub struct Distribution {
    classes: [AtomicU64; BOUNDS_US.len() + 1],
    sum_nanos: AtomicU64,
}

impl Distribution {
    /// Adds a duration. A negative duration counts as zero.
    pub fn add(&self, took: Span) {
        let nanos = u64::try_from(took.as_nanos()).unwrap_or(0);
        let class = BOUNDS_US.partition_point(|bound| bound * 1_000 < nanos);
        self.classes[class].fetch_add(1, Ordering::Relaxed);
        self.sum_nanos.fetch_add(nanos, Ordering::Relaxed);
    }

    /// Returns, for each bound, the number of durations that do not exceed it; the last element is the total number.
    #[must_use]
    pub fn cumulated(&self) -> [u64; BOUNDS_US.len() + 1] {
        let mut sum = 0;
        self.classes.each_ref().map(|class| {
            sum += class.load(Ordering::Relaxed);
            sum
        })
    }

    /// Returns the sum of all durations, in seconds.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "exact up to 104 days")]
    pub fn sum_seconds(&self) -> f64 {
        self.sum_nanos.load(Ordering::Relaxed) as f64 / 1e9
    }
}

/// Metrics of all robots of a host.
#[derive(Debug)]
pub struct Figures {
    robots: Vec<RobotFigures>,
    /// Distribution of the wake-up delays of the precise thread, which wakes the robots.
    pub wake_up: Distribution,
}

/// Metrics of one robot.
#[derive(Debug, Default)]
pub struct RobotFigures {
    held: AtomicU64,
    started: AtomicU64,
    ended: AtomicU64,
    failed: AtomicU64,
    late_steps: AtomicU64,
    steps: AtomicU64,
    connections: AtomicU64,
    away: AtomicU64,
}

impl Figures {
    pub(crate) fn of(robots: usize) -> Self {
        let robots = std::iter::repeat_with(RobotFigures::default).take(robots).collect();
        Self { robots, wake_up: Distribution::default() }
    }

    /// Returns the metrics of each robot, in the order of the host's robots.
    #[must_use]
    pub fn robots(&self) -> &[RobotFigures] {
        &self.robots
    }
}

impl RobotFigures {
    /// Returns the robot's command counts.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let read = |cell: &AtomicU64| cell.load(Ordering::Relaxed);
        Counts {
            held: read(&self.held),
            started: read(&self.started),
            ended: read(&self.ended),
            failed: read(&self.failed),
            late_steps: read(&self.late_steps),
        }
    }

    /// Returns the number of script steps that the robot has set.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps.load(Ordering::Relaxed)
    }

    /// Returns the number of the robot's connections, including those from within this process.
    #[must_use]
    pub fn connections(&self) -> u64 {
        self.connections.load(Ordering::Relaxed)
    }

    /// Whether the robot's hardware answers; true for a robot without hardware.
    #[must_use]
    pub fn hardware_answers(&self) -> bool {
        self.away.load(Ordering::Relaxed) == 0
    }

    pub(crate) fn note(&self, counts: Counts, hardware_answers: bool) {
        let write = |cell: &AtomicU64, value| cell.store(value, Ordering::Relaxed);
        write(&self.held, counts.held);
        write(&self.started, counts.started);
        write(&self.ended, counts.ended);
        write(&self.failed, counts.failed);
        write(&self.late_steps, counts.late_steps);
        write(&self.away, u64::from(!hardware_answers));
    }

    pub(crate) fn stepped(&self, steps: u64) {
        self.steps.fetch_add(steps, Ordering::Relaxed);
    }

    pub(crate) fn has_connections(&self, connections: u64) {
        self.connections.store(connections, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn duration_is_in_the_class_whose_bound_it_does_not_exceed() {
        let waits = Distribution::default();
        for micros in [-5, 0, 10, 11, 2_000_000] {
            waits.add(Span::from_micros(micros));
        }
        let cumulated = waits.cumulated();
        assert_eq!((cumulated[0], cumulated[1], cumulated[13], cumulated[14]), (3, 4, 4, 5));
        assert!((waits.sum_seconds() - 2.000_021).abs() < 1e-9);
    }

    #[test]
    fn counts_of_a_robot_are_read_as_they_were_recorded() {
        let figures = Figures::of(2);
        let counts = Counts { held: 1, started: 2, ended: 3, failed: 4, late_steps: 5 };
        figures.robots()[1].note(counts, false);
        figures.robots()[1].stepped(6);
        figures.robots()[1].stepped(7);
        figures.robots()[1].has_connections(8);
        let [idle, busy] = figures.robots() else { panic!("two robots") };
        assert_eq!(
            (busy.counts(), busy.steps(), busy.connections(), busy.hardware_answers()),
            (counts, 13, 8, false)
        );
        assert_eq!((idle.counts(), idle.steps(), idle.connections()), (Counts::default(), 0, 0));
        assert!(idle.hardware_answers());
        busy.note(Counts::default(), true);
        assert_eq!((busy.counts(), busy.hardware_answers()), (Counts::default(), true));
    }
}
