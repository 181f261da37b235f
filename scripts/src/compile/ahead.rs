//! Fits ahead: curves that are followed by as few steps as possible take nearly all the time of a scenario that has many, and do
//! not depend on each other. They are fitted on all processors; the act by act way through the cues then finds them done.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use urrcp::Span;

use super::cast::{Cast, Members};
use super::perform::Performer;
use super::schedule::CueTime;
use crate::budget::STEPS_MAX;
use crate::fields::Reader;
use crate::motion::Fits;
use crate::scenario::{Cue, Motion};

/// Fewer ways to fit are done sooner than threads are started.
const WAYS_MIN: usize = 500;
/// More may be more than is ever made of them.
const WAYS_MAX: usize = 1_000_000;
/// Most threads.
const THREADS_MAX: usize = 16;

/// A cue with all that decides its steps.
pub(super) struct Timed<'a> {
    pub(super) cue: &'a Cue,
    pub(super) members: &'a Members,
    pub(super) time: &'a CueTime,
}

/// Ways of a cue between two knots that have to be fitted.
fn ways(cue: &Cue) -> usize {
    let movements = std::iter::once(&cue.movement).chain(cue.overrides.iter().map(|(_, movement)| movement));
    let movements = movements.chain(&cue.own);
    let fitted = movements.flat_map(|movement| &movement.tracks).filter_map(|track| match &track.motion {
        Motion::Curve(curve) => {
            let thinned = track.tolerance.is_some() || track.steps_max.is_some();
            Some(curve.knots.iter().filter(|knot| thinned || knot.shape.is_fitted()).count())
        }
        Motion::Vectors(_) => None,
    });
    fitted.sum()
}

/// What the cues need, fitted by as many threads as there are processors; nothing where that would not pay.
pub(super) fn fits(cues: &[Timed<'_>], cast: &Cast<'_>, horizon: Span) -> Fits {
    let mut wanted: Vec<(usize, &Timed<'_>)> = cues.iter().map(|timed| (ways(timed.cue), timed)).collect();
    wanted.retain(|(ways, _)| *ways > 0);
    let all = wanted.iter().map(|(ways, _)| *ways).fold(0, usize::saturating_add);
    let threads = thread::available_parallelism().map_or(1, usize::from).min(THREADS_MAX).min(wanted.len());
    if threads < 2 || !(WAYS_MIN..=WAYS_MAX).contains(&all) {
        return Fits::default();
    }
    // The longest first, so that none of them is left to the end.
    wanted.sort_by_key(|(ways, _)| std::cmp::Reverse(*ways));
    let (next, steps) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let work = || {
        let mut fits = Fits::default();
        while let Some((_, timed)) = wanted.get(next.fetch_add(1, Ordering::Relaxed)) {
            // What is found is found again, in order.
            let mut findings = Reader::default();
            let mut performer = Performer::new(&mut findings, cast, &mut fits, horizon);
            performer.cue(timed.cue, timed.members, timed.time);
            if steps.fetch_add(performer.steps_taken(), Ordering::Relaxed) > STEPS_MAX {
                break;
            }
        }
        fits
    };
    thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
        let mut fits = work();
        others.into_iter().filter_map(|other| other.join().ok()).for_each(|other| fits.extend(other));
        fits
    })
}
