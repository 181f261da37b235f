//! The page of trials with their combined results. Single trials are combined in a histogram, so that the page of 100,000 trials is as
//! small as that of a hundred. `viewer/src/trials.ts` is the counterpart of these types.

use serde::Serialize;
use urrcp::{RobotId, Span};

use super::document::{DocumentKind, VERSION};
use downbeat_mission::requirements::Judged;
use downbeat_rehearsal::trials::{ActResult, LeadResult, Quantiles, Reason, Results, RobotResult, Share};

/// Maximum number of columns of a histogram, not counting the column for all larger values.
const COLUMNS_MAX: i64 = 60;
/// Multiple of the 99 % quantile at which a histogram ends, so that a few outliers do not squeeze all other values into one column.
const P99S_SHOWN: i64 = 3;

#[derive(Debug, Serialize)]
pub(super) struct Tried<'a> {
    version: u32,
    program: &'static str,
    kind: DocumentKind,
    scenario: &'a str,
    world: &'a str,
    trials: usize,
    /// The seed, as text because JSON numbers in browsers have a precision of fewer than 64 bits.
    seed: String,
    /// The words of the command that replays a trial, without `--trial K`.
    replay: &'a [String],
    starts: Share,
    finishes: Share,
    aborts: Share,
    mixed: Share,
    outcomes: &'a [(String, Share)],
    spread: Option<Quantiles>,
    histogram: Option<Histogram>,
    acts: &'a [ActResult],
    lead: Option<LeadResult>,
    reasons: &'a [Reason],
    robots: &'a [RobotResult],
    weakest_robot: &'a Option<RobotId>,
    weakest_link: &'a Option<RobotId>,
    requirements: &'a [Judged],
}

/// A histogram of spreads: the number of values in each of several intervals of equal width, starting at 0. Each interval includes its
/// lower bound and excludes its upper bound.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Histogram {
    #[serde(rename = "width_ms")]
    width: Span,
    counts: Vec<usize>,
    /// Number of spreads beyond the last interval.
    beyond: usize,
}

impl<'a> Tried<'a> {
    pub(super) fn of(results: &'a Results, replay: &'a [String]) -> Self {
        let spreads: Vec<Span> = results.each.iter().filter_map(|trial| trial.spread).collect();
        Self {
            version: VERSION,
            program: super::PROGRAM,
            kind: DocumentKind::Trials,
            scenario: &results.scenario,
            world: &results.world,
            trials: results.trials,
            seed: results.seed.to_string(),
            replay,
            starts: results.starts,
            finishes: results.finishes,
            aborts: results.aborts,
            mixed: results.mixed,
            outcomes: &results.outcomes,
            spread: results.spread,
            histogram: results.spread.map(|quantiles| Histogram::of(&spreads, quantiles)),
            acts: &results.acts,
            lead: results.lead,
            reasons: &results.reasons,
            robots: &results.robots,
            weakest_robot: &results.weakest_robot,
            weakest_link: &results.weakest_link,
            requirements: &results.requirements,
        }
    }
}

impl Histogram {
    fn of(spreads: &[Span], quantiles: Quantiles) -> Self {
        let largest = quantiles.max.as_nanos();
        let end = largest.min(quantiles.p99.as_nanos().saturating_mul(P99S_SHOWN));
        let width = width(end);
        // The last column contains `end`.
        let mut counts = vec![0; usize::try_from(end / width).unwrap_or_default() + 1];
        let mut beyond = 0;
        for spread in spreads {
            let place = usize::try_from(spread.as_nanos() / width).ok();
            match place.and_then(|place| counts.get_mut(place)) {
                Some(count) => *count += 1,
                None => beyond += 1,
            }
        }
        Self { width: Span::from_nanos(width), counts, beyond }
    }
}

/// Returns the width of a column in nanoseconds: the smallest number of the form 1, 2 or 5 times a power of 10 with which [`COLUMNS_MAX`]
/// columns reach `end`.
fn width(end: i64) -> i64 {
    let powers = std::iter::successors(Some(1_i64), |power| power.checked_mul(10));
    let widths = powers.flat_map(|power| [1, 2, 5].map(|factor| power.saturating_mul(factor)));
    widths.into_iter().find(|width| end / width < COLUMNS_MAX).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn histogram(nanos: &[i64]) -> Histogram {
        let spreads: Vec<Span> = nanos.iter().copied().map(Span::from_nanos).collect();
        Histogram::of(&spreads, Quantiles::of(spreads.iter().copied()).unwrap())
    }

    #[test]
    fn value_on_a_boundary_is_counted_in_the_column_above_it() {
        let made = histogram(&[0, 99_999, 100_000, 5_900_000]);
        assert_eq!((made.width, made.counts.len()), (Span::from_nanos(100_000), 60));
        assert_eq!((made.counts[0], made.counts[1], made.counts[59], made.beyond), (2, 1, 1, 0));
    }

    #[test]
    fn outlier_does_not_merge_the_columns_of_other_trials() {
        let mut nanos: Vec<i64> = (1..=1_000).map(|trial| trial * 1_000).collect();
        nanos.push(60_000_000_000);
        let made = histogram(&nanos);
        assert_eq!(made.beyond, 1);
        assert!(made.counts.iter().filter(|count| **count > 0).count() > 15, "{made:?}");
    }

    #[test]
    fn robots_that_start_simultaneously_make_one_column() {
        assert_eq!(histogram(&[0, 0]), Histogram { width: Span::from_nanos(1), counts: vec![2], beyond: 0 });
    }

    proptest! {
        #[test]
        fn every_trial_is_counted_once(nanos in prop::collection::vec(0..i64::MAX, 1..300)) {
            let made = histogram(&nanos);
            prop_assert_eq!(made.counts.iter().sum::<usize>() + made.beyond, nanos.len());
            prop_assert!(made.counts.len() <= COLUMNS_MAX as usize);
        }
    }
}
