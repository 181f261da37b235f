//! Experiments that take seconds, on a machine that may stall for a moment. An experiment is repeated if a stall explains its failure.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Minimum stall of this process that explains a failure. Shorter stalls explain none, because a simulated robot still starts a command
/// that is up to 50 ms late.
const EXPLAINS: Duration = Duration::from_millis(40);
const MOST_TRIES: usize = 8;

/// Repeats an experiment, at most eight times, until its result is right or no stall of this process explains a wrong result. Returns the
/// last result.
///
/// A wrong result without a stall is returned immediately. Intermittent faults of the experiment itself are therefore detected.
pub fn undisturbed<T>(experiment: impl Fn() -> T, right: impl Fn(&T) -> bool) -> T {
    settled(|| watched(&experiment), right)
}

fn settled<T>(mut attempt: impl FnMut() -> (T, Duration), right: impl Fn(&T) -> bool) -> T {
    for _ in 1..MOST_TRIES {
        let (found, longest) = attempt();
        if right(&found) || longest < EXPLAINS {
            return found;
        }
    }
    attempt().0
}

/// Runs the experiment. Returns its result and the longest time for which this process was stalled.
fn watched<T>(experiment: impl Fn() -> T) -> (T, Duration) {
    const NAP: Duration = Duration::from_millis(2);
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watch = scope.spawn(|| {
            let mut longest = Duration::ZERO;
            while !over.load(Ordering::Relaxed) {
                let asleep = Instant::now();
                std::thread::sleep(NAP);
                longest = longest.max(asleep.elapsed().saturating_sub(NAP));
            }
            longest
        });
        let found = experiment();
        over.store(true, Ordering::Relaxed);
        (found, watch.join().unwrap())
    })
}

#[test]
fn wrong_result_is_retried_only_if_a_stall_explains_it() {
    let (short, long) = (EXPLAINS / 2, EXPLAINS * 2);
    let tries = |standstills: &[Duration], right: usize| {
        let mut count = 0;
        let attempt = || {
            let longest = standstills.get(count).copied().unwrap_or(long);
            count += 1;
            (count, longest)
        };
        settled(attempt, |found| *found == right)
    };
    assert_eq!(tries(&[short], 1), 1);
    assert_eq!(tries(&[long, long, long], 3), 3);
    assert_eq!(tries(&[long, short], 3), 2);
    assert_eq!(tries(&[], 100), MOST_TRIES);
}
