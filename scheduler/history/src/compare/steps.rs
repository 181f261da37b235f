//! The differences between the steps of a device in two plans, or in two recordings.

use serde::Serialize;
use urrcp::{ControlType, Setpoint, Span, StopCondition};

use super::Change;

/// The steps of a device in an act, from all its scripts in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Movement {
    pub(super) steps: Vec<TimedStep>,
    /// Whether the device interpolates linearly between steps instead of holding each value.
    pub(super) linear: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct TimedStep {
    /// Time from the act's start.
    pub(super) at: Span,
    pub(super) setpoint: Setpoint,
    pub(super) lease: Option<StopCondition>,
    /// Whether the step ends a script. The device holds its value until the next script.
    pub(super) ends: bool,
}

/// The differences between the steps of a device.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct StepDifferences {
    /// The number of steps on each side; `None` if the numbers are equal.
    pub(crate) count: Option<Change<usize>>,
    pub(crate) added: usize,
    pub(crate) removed: usize,
    /// Number of steps that have the same time on both sides, but a different value, control type or lease.
    pub(crate) value_changed: usize,
    /// Number of steps that have the same value on both sides, but a different time.
    pub(crate) time_changed: usize,
    /// Number of paired steps that differ in time and value. Steps are paired in order if both sides have equally many left before the
    /// next common time.
    pub(crate) both_changed: usize,
    /// The time by which all steps are later on the second side; negative if they are earlier. `None` unless the steps are otherwise
    /// equal.
    pub(crate) shifted_by_ms: Option<Span>,
    pub(crate) largest: Option<Largest>,
    /// The steps that differ, in order of time.
    pub(crate) steps: Vec<StepDifference>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct StepDifference {
    pub(crate) a: Option<ShownStep>,
    pub(crate) b: Option<ShownStep>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct ShownStep {
    /// Time from the act's start.
    pub(crate) at_ms: Span,
    pub(crate) control_type: ControlType,
    pub(crate) values: Vec<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) stop_condition: Option<StopCondition>,
}

/// The point in time at which two movements are furthest apart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Largest {
    /// Time from the act's start.
    pub(crate) at_ms: Span,
    /// Index of the value within a step, from 1.
    pub(crate) value: usize,
    pub(crate) a: f64,
    pub(crate) b: f64,
}

impl Largest {
    pub(crate) fn difference(&self) -> f64 {
        (self.a - self.b).abs()
    }
}

impl StepDifferences {
    /// The first step that differs; `None` if no step differs.
    pub(crate) fn first(&self) -> Option<&StepDifference> {
        self.steps.first()
    }

    pub(crate) fn changed(&self) -> usize {
        self.value_changed + self.time_changed + self.both_changed
    }

    fn note(&mut self, a: Option<&TimedStep>, b: Option<&TimedStep>) {
        match (a, b) {
            (Some(_), None) => self.removed += 1,
            (None, Some(_)) => self.added += 1,
            (Some(a), Some(b)) if a.at == b.at => self.value_changed += 1,
            (Some(a), Some(b)) if a.setpoint == b.setpoint => self.time_changed += 1,
            (Some(_), Some(_)) => self.both_changed += 1,
            (None, None) => return,
        }
        self.steps.push(StepDifference { a: a.map(TimedStep::shown), b: b.map(TimedStep::shown) });
    }
}

impl TimedStep {
    fn shown(&self) -> ShownStep {
        ShownStep {
            at_ms: self.at,
            control_type: self.setpoint.control_type,
            values: self.setpoint.values().collect(),
            stop_condition: self.lease,
        }
    }

    fn is_same(&self, other: &Self) -> bool {
        self.at == other.at && self.is_same_but_for_time(other)
    }

    fn is_same_but_for_time(&self, other: &Self) -> bool {
        self.setpoint == other.setpoint && self.lease == other.lease
    }
}

/// Compares two movements step by step. Skips the steps at the start that are equal, then the steps at the end that are equal except for
/// a shift in time. Among the remaining steps, those that are due at the same time correspond.
pub(super) fn compare(a: &Movement, b: &Movement) -> StepDifferences {
    let mut found = StepDifferences {
        count: Change::of(a.steps.len(), b.steps.len()),
        largest: largest(a, b),
        ..StepDifferences::default()
    };
    let (mut left, mut right) = (a.steps.as_slice(), b.steps.as_slice());
    let same = left.iter().zip(right).take_while(|(a, b)| a.is_same(b)).count();
    (left, right) = (&left[same..], &right[same..]);
    let shift = left.last().zip(right.last()).map_or(Span::ZERO, |(a, b)| b.at - a.at);
    let alike = |(a, b): &(&TimedStep, &TimedStep)| b.at - a.at == shift && a.is_same_but_for_time(b);
    let end = left.iter().rev().zip(right.iter().rev()).take_while(alike).count();
    let (left, left_end) = left.split_at(left.len() - end);
    let (right, right_end) = right.split_at(right.len() - end);
    if same == 0 && left.is_empty() && right.is_empty() && end > 0 {
        found.shifted_by_ms = Some(shift);
    }
    by_time(left, right, &mut found);
    if shift != Span::ZERO {
        left_end.iter().zip(right_end).for_each(|(a, b)| found.note(Some(a), Some(b)));
    }
    found
}

/// Pairs the steps that differ. Steps at the same time correspond. Between two such times, steps with equal values correspond, in order.
fn by_time(mut left: &[TimedStep], mut right: &[TimedStep], found: &mut StepDifferences) {
    while !left.is_empty() || !right.is_empty() {
        let (until_left, until_right) = next_common(left, right);
        between(&left[..until_left], &right[..until_right], found);
        (left, right) = (&left[until_left..], &right[until_right..]);
        if let (Some((a, rest_left)), Some((b, rest_right))) = (left.split_first(), right.split_first()) {
            if !a.is_same(b) {
                found.note(Some(a), Some(b));
            }
            (left, right) = (rest_left, rest_right);
        }
    }
}

/// Returns the number of steps on each side before the next time at which both sides have a step.
fn next_common(left: &[TimedStep], right: &[TimedStep]) -> (usize, usize) {
    let (mut i, mut j) = (0, 0);
    while let Some((a, b)) = left.get(i).zip(right.get(j)) {
        match a.at.cmp(&b.at) {
            std::cmp::Ordering::Equal => return (i, j),
            std::cmp::Ordering::Less => i += 1,
            std::cmp::Ordering::Greater => j += 1,
        }
    }
    (left.len(), right.len())
}

fn between(mut left: &[TimedStep], mut right: &[TimedStep], found: &mut StepDifferences) {
    while let (Some((a, rest_left)), Some((b, rest_right))) = (left.split_first(), right.split_first()) {
        let alike = a.is_same_but_for_time(b);
        if alike || left.len() == right.len() {
            found.note(Some(a), Some(b));
            (left, right) = (rest_left, rest_right);
        } else if left.len() > right.len() {
            found.note(Some(a), None);
            left = rest_left;
        } else {
            found.note(None, Some(b));
            right = rest_right;
        }
    }
    left.iter().for_each(|a| found.note(Some(a), None));
    right.iter().for_each(|b| found.note(None, Some(b)));
}

/// Finds the point at which two movements are furthest apart. Both are straight between consecutive steps, so this is at a step or right
/// before one.
fn largest(a: &Movement, b: &Movement) -> Option<Largest> {
    let mut best: Option<Largest> = None;
    let (mut of_a, mut of_b) = (Cursor::new(a), Cursor::new(b));
    let (mut i, mut j) = (0, 0);
    loop {
        let times = [a.steps.get(i).map(|step| step.at), b.steps.get(j).map(|step| step.at)];
        let Some(at) = times.into_iter().flatten().min() else { return best };
        consider(&mut best, at, of_a.before(at).as_ref(), of_b.before(at).as_ref());
        while a.steps.get(i).is_some_and(|step| step.at == at) {
            i += 1;
        }
        while b.steps.get(j).is_some_and(|step| step.at == at) {
            j += 1;
        }
        (of_a.passed, of_b.passed) = (i, j);
        consider(&mut best, at, of_a.at_step(at).as_ref(), of_b.at_step(at).as_ref());
    }
}

type Values = (ControlType, Vec<f64>);

fn consider(best: &mut Option<Largest>, at: Span, a: Option<&Values>, b: Option<&Values>) {
    let Some((a, b)) = a.zip(b) else { return };
    if a.0 != b.0 {
        return;
    }
    for (index, (a, b)) in a.1.iter().zip(&b.1).enumerate() {
        let here = Largest { at_ms: at, value: index + 1, a: *a, b: *b };
        let least = best.map_or(0.0, |best| best.difference());
        if here.difference() > least {
            *best = Some(here);
        }
    }
}

/// A position in a movement that advances with time.
struct Cursor<'a> {
    movement: &'a Movement,
    /// Number of steps whose time has passed.
    passed: usize,
}

impl<'a> Cursor<'a> {
    const fn new(movement: &'a Movement) -> Self {
        Self { movement, passed: 0 }
    }

    /// The values right before the time `at`; `None` before the first step. All steps before `at` must have passed.
    fn before(&self, at: Span) -> Option<Values> {
        let last = self.movement.steps.get(self.passed.checked_sub(1)?)?;
        let next = self.movement.steps.get(self.passed).filter(|_| self.movement.linear && !last.ends);
        let values = last.setpoint.values();
        let Some(next) = next.filter(|next| next.setpoint.control_type == last.setpoint.control_type) else {
            return Some((last.setpoint.control_type, values.collect()));
        };
        let part = (at - last.at).as_millis_f64() / (next.at - last.at).as_millis_f64();
        let way = values.zip(next.setpoint.values());
        let reached = way.map(|(from, to)| if part >= 1.0 { to } else { from + (to - from) * part });
        Some((last.setpoint.control_type, reached.collect()))
    }

    /// The values at the time `at`, including the steps that are due exactly then.
    fn at_step(&self, at: Span) -> Option<Values> {
        let last = self.movement.steps.get(self.passed.checked_sub(1)?)?;
        if last.at == at {
            Some((last.setpoint.control_type, last.setpoint.values().collect()))
        } else {
            self.before(at)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn movement(points: &[(i64, f64)]) -> Movement {
        let step = |(at, value): &(i64, f64)| TimedStep {
            at: Span::from_millis(*at),
            setpoint: Setpoint::new(ControlType::Position, *value),
            lease: None,
            ends: false,
        };
        Movement { steps: points.iter().map(step).collect(), linear: true }
    }

    /// Compares two movements and checks the numbers of differences. `expected` contains the numbers of added and removed steps, and of
    /// steps with a changed value, a changed time, or both.
    #[track_caller]
    fn check(a: &[(i64, f64)], b: &[(i64, f64)], expected: [usize; 5]) -> StepDifferences {
        let found = compare(&movement(a), &movement(b));
        let StepDifferences { added, removed, value_changed, time_changed, both_changed, .. } = found;
        assert_eq!([added, removed, value_changed, time_changed, both_changed], expected, "{found:?}");
        assert_eq!(found.steps.len(), expected.iter().sum::<usize>());
        found
    }

    const RISE: [(i64, f64); 4] = [(0, 0.0), (100, 10.0), (200, 20.0), (300, 30.0)];

    #[test]
    fn equal_movements_do_not_differ() {
        let found = check(&RISE, &RISE, [0; 5]);
        assert_eq!((found.largest, found.shifted_by_ms, found.first()), (None, None, None));
    }

    #[test]
    fn each_change_is_counted_by_its_kind() {
        check(&RISE, &[(0, 0.0), (100, 11.0), (200, 20.0), (300, 30.0)], [0, 0, 1, 0, 0]);
        check(&RISE, &[(0, 0.0), (110, 10.0), (200, 20.0), (300, 30.0)], [0, 0, 0, 1, 0]);
        check(&RISE, &[(0, 0.0), (110, 11.0), (200, 20.0), (300, 30.0)], [0, 0, 0, 0, 1]);
        check(&RISE, &[(0, 0.0), (100, 10.0), (300, 30.0)], [0, 1, 0, 0, 0]);
        check(&RISE, &[(0, 0.0), (50, 5.0), (100, 10.0), (200, 20.0), (300, 30.0)], [1, 0, 0, 0, 0]);
        check(&RISE, &[], [0, 4, 0, 0, 0]);
    }

    #[test]
    fn later_end_is_a_time_change_and_not_a_removal_and_addition() {
        let found = check(&RISE, &[(0, 0.0), (100, 10.0), (250, 20.0), (350, 30.0)], [0, 0, 0, 2, 0]);
        assert_eq!(found.shifted_by_ms, None);
        let later = RISE.map(|(at, value)| (at + 100, value));
        let found = check(&RISE, &later, [0, 0, 0, 4, 0]);
        assert_eq!(found.shifted_by_ms, Some(Span::from_millis(100)));
    }

    #[test]
    fn largest_difference_may_be_at_a_step_of_either_movement() {
        let (a, b) = (movement(&[(0, 0.0), (100, 100.0)]), movement(&[(0, 0.0), (50, 20.0), (100, 100.0)]));
        let expected = Some(Largest { at_ms: Span::from_millis(50), value: 1, a: 50.0, b: 20.0 });
        assert_eq!(largest(&a, &b), expected);
    }

    #[test]
    fn largest_difference_may_be_immediately_before_a_jump() {
        let mut a = movement(&[(0, 0.0), (100, 50.0)]);
        let mut b = movement(&[(0, 0.0), (100, 60.0)]);
        (a.linear, b.linear) = (false, true);
        let found = largest(&a, &b).unwrap();
        assert_eq!((found.a, found.b), (0.0, 60.0), "it jumps from 0 to 50 where the other arrives at 60");
    }
}
