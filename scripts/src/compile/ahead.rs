//! Fits curves ahead of the compilation of acts. Fitting curves with as few steps as possible takes nearly all the compile time of a
//! scenario with many curves. The fits do not depend on each other, so they run on all processors. The pass through the cues, act by
//! act, then uses the results.

use std::borrow::Cow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use urrcp::Span;

use super::cast::{Cast, Member, Members};
use super::perform::Performer;
use super::schedule::CueTime;
use crate::budget::STEPS_MAX;
use crate::fields::Reader;
use crate::motion::Fits;
use crate::scenario::{Cue, Motion, Movement};

/// Minimum number of curve sections for fitting on several threads: with fewer, starting threads takes longer than fitting.
pub(super) const WAYS_MIN: usize = 500;
/// Maximum number of curve sections that are fitted ahead: with more, some fits might never be used.
const WAYS_MAX: usize = 1_000_000;
/// Maximum number of threads for fitting.
const THREADS_MAX: usize = 16;

/// A cue with everything that determines its steps.
pub(super) struct Timed<'a> {
    pub(super) cue: &'a Cue,
    pub(super) members: &'a Members,
    pub(super) time: &'a CueTime,
}

/// Robots of a cue that share a movement. `ways` is the number of sections of the movement (parts between two knots) that must be fitted.
struct Share<'a> {
    timed: &'a Timed<'a>,
    members: Cow<'a, Members>,
    ways: usize,
}

/// Returns the number of sections (parts between two knots) of these movements that must be fitted.
fn ways<'m>(movements: impl Iterator<Item = &'m Movement>) -> usize {
    let fitted = movements.flat_map(|movement| &movement.tracks).filter_map(|track| match &track.motion {
        Motion::Curve(curve) => {
            let thinned = track.tolerance.is_some() || track.steps_max.is_some();
            Some(curve.knots.iter().filter(|knot| thinned || knot.shape.is_fitted()).count())
        }
        Motion::Vectors(_) => None,
    });
    fitted.sum()
}

/// Splits a cue into shares: one for the cue or, if robots have their own movements, one for each movement.
fn shares<'a>(timed: &'a Timed<'a>) -> Vec<Share<'a>> {
    let Timed { cue, members, .. } = *timed;
    if cue.own.is_empty() {
        let movements = std::iter::once(&cue.movement).chain(cue.overrides.iter().map(|(_, own)| own));
        return vec![Share { timed, members: Cow::Borrowed(members), ways: ways(movements) }];
    }
    let mut all = members.all.clone();
    all.sort_by_key(|member| member.movement);
    let share = |alike: &[Member]| Share {
        timed,
        members: Cow::Owned(Members { all: alike.to_vec(), ..Members::default() }),
        ways: alike.first().map_or(0, |first| ways(std::iter::once(cue.movement_of(first)))),
    };
    all.chunk_by(|a, b| a.movement == b.movement).map(share).collect()
}

/// Fits the curves of all cues on as many threads as there are processors. Returns no fits if this would not save time.
pub(super) fn fits(cues: &[Timed<'_>], cast: &Cast<'_>, horizon: Span) -> Fits {
    let mut wanted: Vec<Share<'_>> = cues.iter().flat_map(shares).collect();
    wanted.retain(|share| share.ways > 0);
    let all = wanted.iter().map(|share| share.ways).fold(0, usize::saturating_add);
    if !(WAYS_MIN..=WAYS_MAX).contains(&all) {
        return Fits::default();
    }
    // The share with the most sections comes first, so that no long share remains until the end.
    wanted.sort_by_key(|share| std::cmp::Reverse(share.ways));
    let steps = AtomicUsize::new(0);
    together(&wanted, |share, fits| {
        // Findings are discarded here; the later pass reports them in order.
        let mut findings = Reader::default();
        let mut performer = Performer::new(&mut findings, cast, fits, horizon);
        performer.cue(share.timed.cue, &share.members, share.timed.time);
        steps.fetch_add(performer.steps_taken(), Ordering::Relaxed) <= STEPS_MAX
    })
}

/// Distributes tasks over several threads until a task returns `false`, and merges the fits of all threads. Returns no fits if there is
/// only one processor.
pub(super) fn together<T: Sync>(tasks: &[T], task: impl Fn(&T, &mut Fits) -> bool + Sync) -> Fits {
    let threads = thread::available_parallelism().map_or(1, usize::from).min(THREADS_MAX).min(tasks.len());
    if threads < 2 {
        return Fits::default();
    }
    let next = AtomicUsize::new(0);
    let work = || {
        let mut fits = Fits::default();
        while let Some(one) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
            if !task(one, &mut fits) {
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
