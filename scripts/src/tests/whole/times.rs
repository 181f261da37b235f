//! Computes all times of an act. For every order of a zone's cues, times move to satisfy the bounds between events until nothing changes.

use num_rational::Ratio;

use super::meaning::rounded;
use super::{Cue, Lag, MS, Nanos, Relation, Show, When, Word};

/// A bound (from, to, least) between two events, which requires to >= from + least.
type Bound = (usize, usize, Nanos);

/// Returns the earliest times of all events. Moves events later until all bounds are satisfied; `None` if that never ends.
fn earliest(events: usize, bounds: &[Bound]) -> Option<Vec<Nanos>> {
    let mut times = vec![0; events];
    for _ in 0..=events {
        let mut changed = false;
        for (from, to, least) in bounds {
            if times[*to] < times[*from] + least {
                times[*to] = times[*from] + least;
                changed = true;
            }
        }
        if !changed {
            return (times[0] == 0).then_some(times);
        }
    }
    None
}

/// Returns, for each event, the latest time that it can have if no event is after `end`.
fn latest(events: usize, bounds: &[Bound], end: Nanos) -> Vec<Nanos> {
    let mut times = vec![end; events];
    times[0] = 0;
    for _ in 0..=events {
        for (from, to, least) in bounds {
            times[*from] = times[*from].min(times[*to] - least);
        }
    }
    times
}

/// Returns the bounds of an act. Event 0 is the act's start; the following events are the start and the end of each cue.
fn bounds(show: &Show, act: &[Cue]) -> Vec<Bound> {
    let mut all: Vec<Bound> = Vec::new();
    let mut between = |from: usize, to: usize, least: Option<Nanos>, largest: Option<Nanos>| {
        all.extend(least.map(|least| (from, to, least)));
        all.extend(largest.map(|largest| (to, from, -largest)));
    };
    let event = |cue: usize, end: bool| 1 + 2 * cue + usize::from(end);
    for (index, cue) in act.iter().enumerate() {
        let (start, end) = (event(index, false), event(index, true));
        between(0, start, Some(0), None);
        between(0, end, Some(0), None);
        let (least, largest) = match cue.stretch {
            Some((least, largest)) => (i128::from(least) * MS, i128::from(largest) * MS),
            None => (cue.length(show), cue.length(show)),
        };
        between(start, end, Some(least + cue.delay(show)), Some(largest + cue.delay(show)));
        match cue.when {
            When::Free => {}
            When::At(millis) | When::Each(millis, _) => {
                between(0, start, Some(i128::from(millis) * MS), Some(i128::from(millis) * MS))
            }
            When::Between(least, largest) => {
                between(0, start, Some(i128::from(least) * MS), Some(i128::from(largest) * MS));
            }
            When::Bar(bar) => {
                let at = rounded(show.bar(bar));
                between(0, start, Some(at), Some(at));
            }
            When::EndBy(millis) => between(0, end, None, Some(i128::from(millis) * MS)),
        }
        for Relation { word, other, end: which, lag } in &cue.relations {
            let other = |default: bool| event(*other, which.unwrap_or(default));
            let beats = |quarters: i64| {
                show.beats(None, Ratio::from_integer(i128::from(quarters))).floor().to_integer()
            };
            let (least, largest) = match (lag, word) {
                (Lag::None, Word::With) => (0, Some(0)),
                (Lag::None, _) => (0, None),
                (Lag::One(millis), Word::With) => (i128::from(*millis) * MS, Some(i128::from(*millis) * MS)),
                (Lag::One(millis), _) => (i128::from(*millis) * MS, None),
                (Lag::Beats(quarters), Word::With) => (beats(*quarters), Some(beats(*quarters))),
                (Lag::Beats(quarters), _) => (beats(*quarters), None),
                (Lag::Range(least, largest), _) => (i128::from(*least) * MS, Some(i128::from(*largest) * MS)),
            };
            match word {
                Word::After => between(other(true), start, Some(least), largest),
                Word::With => between(other(false), start, Some(least), largest),
                Word::Before => between(end, other(false), Some(least), largest),
            }
        }
        if let Some(other) = cue.apart.filter(|other| *other != index) {
            between(event(index.min(other), true), event(index.max(other), false), Some(0), None);
        }
    }
    all
}

/// Returns bounds that let these cues of a zone follow one another, in the order of the list.
fn in_order(cues: &[usize]) -> Vec<Bound> {
    cues.windows(2).map(|pair| (2 + 2 * pair[0], 1 + 2 * pair[1], 0)).collect()
}

fn of_zone(act: &[Cue], zone: usize) -> Vec<usize> {
    (0..act.len()).filter(|cue| act[*cue].zone == Some(zone)).collect()
}

fn orders(cues: &[usize]) -> Vec<Vec<usize>> {
    if cues.len() < 2 {
        return vec![cues.to_vec()];
    }
    let mut all = Vec::new();
    for (index, first) in cues.iter().enumerate() {
        let mut rest = cues.to_vec();
        rest.remove(index);
        all.extend(orders(&rest).into_iter().map(|rest| [vec![*first], rest].concat()));
    }
    all
}

/// The times of an act's cues as the tests predict them.
#[derive(Debug)]
pub(super) struct Times {
    pub(super) starts: Vec<Nanos>,
    pub(super) ends: Vec<Nanos>,
    pub(super) slacks: Vec<Nanos>,
}

/// Returns all possible timings of an act: one for each order of the cues whose order is free. The compiler must find one of the
/// shortest.
pub(super) fn timings(show: &Show, act: &[Cue]) -> Vec<Times> {
    let mut fixed = bounds(show, act);
    fixed.extend(in_order(&of_zone(act, 1)));
    let free = of_zone(act, 0);
    let orders = if show.auto { orders(&free) } else { vec![free] };
    let events = 1 + 2 * act.len();
    let timed = |order: Vec<usize>| {
        let all = [fixed.clone(), in_order(&order)].concat();
        let times = earliest(events, &all)?;
        let end = times.iter().copied().max()?;
        let latest = latest(events, &all, end);
        let of =
            |cue: usize| (times[1 + 2 * cue], times[2 + 2 * cue], latest[1 + 2 * cue] - times[1 + 2 * cue]);
        let cues: Vec<_> = (0..act.len()).map(of).collect();
        Some(Times {
            starts: cues.iter().map(|cue| cue.0).collect(),
            ends: cues.iter().map(|cue| cue.1).collect(),
            slacks: cues.iter().map(|cue| cue.2).collect(),
        })
    };
    orders.into_iter().filter_map(timed).collect()
}
