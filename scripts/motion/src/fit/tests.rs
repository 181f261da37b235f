//! Compares with all possible steps, on curves small enough for an exhaustive search.

use proptest::prelude::*;

use super::*;

const GRID: Grid = Grid { min: -3.0, max: 3.0, granularity: 1.0 };
const CLOSE: f64 = 1e-9;

/// The least error with each number of steps, by trying all sets of sample times and all values of `GRID`.
struct BruteForce<'a> {
    curve: Samples<'a>,
    ends: Ends,
    /// The least error; the index is the number of steps.
    least: Vec<f64>,
}

impl<'a> BruteForce<'a> {
    fn new(curve: Samples<'a>, ends: Ends) -> Self {
        let mut all = Self { curve, ends, least: vec![f64::INFINITY; curve.times.len() + 1] };
        let first = ends.first.map_or((-3..=3).map(f64::from).collect(), |value| vec![value]);
        first.into_iter().for_each(|value| all.extend(&mut vec![(0, value)], 0.0));
        all
    }

    fn last(&self) -> usize {
        self.curve.times.len() - 1
    }

    fn extend(&mut self, steps: &mut Vec<(usize, f64)>, worst: f64) {
        let from = steps[steps.len() - 1];
        self.finish(steps, worst);
        for sample in from.0 + 1..self.curve.times.len() {
            for value in (-3..=3).map(f64::from).chain(self.ends.last.filter(|_| sample == self.last())) {
                let piece = self.piece(from, (sample, value));
                steps.push((sample, value));
                self.extend(steps, worst.max(piece));
                steps.pop();
            }
        }
    }

    /// Records the steps if they are a complete solution.
    fn finish(&mut self, steps: &[(usize, f64)], worst: f64) {
        let end = steps[steps.len() - 1];
        let at_end = end.0 == self.last();
        let prescribed = self.ends.last.is_none_or(|value| at_end && value == end.1);
        if prescribed && at_end {
            let tail = self.piece(end, (self.last(), end.1));
            self.least[steps.len()] = self.least[steps.len()].min(worst.max(tail));
        }
    }

    fn piece(&self, from: (usize, f64), to: (usize, f64)) -> f64 {
        let Samples { times, values, slack, .. } = self.curve;
        let off = |k: usize| {
            let part =
                if k > from.0 { (times[k] - times[from.0]) / (times[to.0] - times[from.0]) } else { 0.0 };
            (from.1 * (1.0 - part) + to.1 * part - values[k]).abs() + slack + self.curve.gap(k)
        };
        (from.0..=to.0).map(off).fold(0.0, f64::max)
    }

    fn fewest(&self, tolerance: f64) -> Option<usize> {
        self.least.iter().position(|least| *least <= tolerance + CLOSE)
    }

    fn least_error(&self, budget: usize) -> f64 {
        self.least[..=budget.min(self.last() + 1)].iter().copied().fold(f64::INFINITY, f64::min)
    }
}

#[derive(Clone, Debug)]
struct Case {
    times: Vec<f64>,
    values: Vec<f64>,
    slack: f64,
    gaps: Vec<f64>,
    ends: Ends,
}

impl Case {
    fn curve(&self) -> Samples<'_> {
        Samples { times: &self.times, values: &self.values, slack: self.slack, gaps: &self.gaps }
    }

    fn brute_force(&self) -> BruteForce<'_> {
        BruteForce::new(self.curve(), self.ends)
    }

    fn fewest(&self, tolerance: f64) -> Result<Fit, Unfit> {
        fewest(&self.curve(), &GRID, tolerance, self.ends)
    }

    fn least_error(&self, budget: usize) -> Result<Fit, Unfit> {
        least_error(&self.curve(), &GRID, budget, self.ends)
    }
}

/// Multiples of 1/8, so that values can meet a tolerance exactly.
fn eighths(range: std::ops::Range<i32>) -> impl Strategy<Value = f64> {
    range.prop_map(|eighths| f64::from(eighths) / 8.0)
}

fn cases() -> impl Strategy<Value = Case> {
    // Gaps between pieces that do not quite meet: none, tiny, or large.
    let gap = prop_oneof![4 => Just(0.0), 1 => Just(1.0 / 1024.0), 1 => eighths(0..4)];
    let samples = prop::collection::vec((1i32..5, eighths(-28..28), gap), 1..8);
    let end = || prop::option::weighted(0.3, -3i32..4);
    (samples, eighths(0..2), end(), end()).prop_map(|(samples, slack, first, last)| {
        let mut now = 0;
        let times = samples.iter().map(|(after, ..)| {
            now += after;
            f64::from(now)
        });
        let times: Vec<_> = times.collect();
        let last = if times.len() == 1 { first } else { last };
        let ends = Ends { first: first.map(f64::from), last: last.map(f64::from) };
        let values = samples.iter().map(|(_, value, _)| *value).collect();
        let gaps = samples.iter().map(|(.., gap)| *gap).collect();
        Case { times, values, slack, gaps, ends }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn fewest_steps_match_brute_force(case in cases(), tolerance in eighths(0..24)) {
        let all = case.brute_force();
        match (case.fewest(tolerance), all.fewest(tolerance)) {
            (Ok(fit), Some(fewest)) => {
                prop_assert_eq!(fit.steps.len(), fewest);
                prop_assert_eq!(fit.at_least, fewest);
                prop_assert!(fit.worst <= tolerance + CLOSE);
                prop_assert!(fit.worst <= all.least_error(fewest) + tolerance / 100.0 + CLOSE);
                for bound in [steps_at_least(&case.curve(), tolerance), lower_bound(&case.curve(), tolerance)] {
                    prop_assert!(bound.is_some_and(|bound| bound <= fewest));
                }
            }
            (Err(Unfit::Tolerance { smallest, at }), None) => {
                let least = all.least_error(usize::MAX);
                prop_assert!((smallest - least).abs() <= 2e-6 * least.max(1.0), "{} {}", smallest, least);
                prop_assert!(case.times.contains(&at));
                prop_assert!(case.fewest(smallest).is_ok());
            }
            (fit, fewest) => prop_assert!(false, "{:?}, but {:?} steps are fewest", fit, fewest),
        }
    }

    #[test]
    fn least_error_matches_brute_force(case in cases(), budget in 0usize..7) {
        let least = case.brute_force().least_error(budget);
        match case.least_error(budget) {
            Ok(fit) => {
                prop_assert!(fit.steps.len() <= budget);
                prop_assert!((fit.worst - least).abs() <= 2e-6 * least.max(1.0), "{} {}", fit.worst, least);
                let tighter = case.fewest(fit.worst * 0.99 - 2e-6);
                prop_assert!(tighter.is_err() || tighter.is_ok_and(|tighter| tighter.steps.len() > budget));
            }
            Err(error) => {
                let too_few = matches!(error, Unfit::Budget { needed } if needed > budget);
                prop_assert!(too_few, "{:?}", error);
                prop_assert!(least.is_infinite());
            }
        }
    }
}

/// Returns the fewest steps within the tolerance at all samples. Steps have values from -1 to 1, and are at samples or halfway between
/// them.
fn fewest_anywhere(curve: &Samples, tolerance: f64) -> Option<usize> {
    let between = curve.times.windows(2).map(|pair| f64::midpoint(pair[0], pair[1]));
    let mut times: Vec<f64> = curve.times.iter().copied().chain(between).collect();
    times.sort_by(f64::total_cmp);
    let follows = |steps: &[(f64, f64)], at: f64| {
        let after = steps.iter().position(|step| step.0 > at);
        let before = steps[after.unwrap_or(steps.len()) - 1];
        after.map_or(before.1, |after| {
            let after = steps[after];
            before.1 + (after.1 - before.1) * (at - before.0) / (after.0 - before.0)
        })
    };
    let mut fewest: Option<usize> = None;
    for choice in 0..4u32.pow(times.len() as u32) {
        let value = |k: usize| (choice / 4u32.pow(k as u32)) % 4;
        let set = (0..times.len()).filter(|k| value(*k) > 0);
        let steps: Vec<_> = set.map(|k| (times[k], f64::from(value(k)) - 2.0)).collect();
        let ends = value(0) > 0 && value(times.len() - 1) > 0;
        if !ends || fewest.is_some_and(|known| steps.len() >= known) {
            continue;
        }
        let off = |k: usize| (follows(&steps, curve.times[k]) - curve.values[k]).abs();
        if (0..curve.times.len()).all(|k| off(k) <= tolerance + CLOSE) {
            fewest = Some(steps.len());
        }
    }
    fewest
}

proptest! {
    #[test]
    fn steps_between_samples_are_never_fewer_than_the_bound(
        samples in prop::collection::vec((1i32..4, eighths(-12..12)), 2..5),
        tolerance in eighths(0..12),
    ) {
        let times: Vec<_> = samples.iter().scan(0, |now, (after, _)| { *now += after; Some(f64::from(*now)) }).collect();
        let values: Vec<_> = samples.iter().map(|(_, value)| *value).collect();
        let curve = Samples { times: &times, values: &values, slack: 0.0, gaps: &[] };
        if let Some(fewest) = fewest_anywhere(&curve, tolerance) {
            prop_assert!(steps_at_least(&curve, tolerance).unwrap() <= fewest);
        }
    }
}

/// Returns the fewest straight pieces through all gaps (the ranges of allowed values). Each piece is extended for as long as one line can
/// pass all its gaps; each pair of gaps bounds the slope.
fn pieces_by_pairs(curve: &Samples, room: f64) -> usize {
    let Samples { times, values, .. } = *curve;
    let passes = |start: usize, end: usize| {
        let (mut flattest, mut steepest) = (f64::NEG_INFINITY, f64::INFINITY);
        for (a, b) in (start..=end).flat_map(|b| (start..b).map(move |a| (a, b))) {
            let (rise, duration) = (values[b] - values[a], times[b] - times[a]);
            flattest = flattest.max((rise - 2.0 * room) / duration);
            steepest = steepest.min((rise + 2.0 * room) / duration);
        }
        flattest <= steepest + CLOSE
    };
    let (mut start, mut pieces) = (0, 0);
    while start + 1 < times.len() {
        start = (start + 1..times.len()).take_while(|end| passes(start, *end)).last().unwrap();
        pieces += 1;
    }
    pieces
}

/// A random walk whose changes are a few granularities of a fine grid.
fn walks() -> impl Strategy<Value = (Vec<f64>, Vec<f64>)> {
    prop::collection::vec(-16i32..17, 1..200).prop_map(|changes| {
        let values = changes.iter().scan(0, |value, change| {
            *value += change;
            Some(f64::from(*value) / 8.0)
        });
        ((0..changes.len()).map(|i| i as f64 * 10.0).collect(), values.collect())
    })
}

proptest! {
    #[test]
    fn lower_bound_is_the_fewest_straight_pieces((times, values) in walks(), room in eighths(0..80)) {
        let curve = Samples { times: &times, values: &values, slack: 0.0, gaps: &[] };
        prop_assert_eq!(lower_bound(&curve, room), Some(pieces_by_pairs(&curve, room) + 1));
    }

    #[test]
    fn fine_grid_keeps_the_tolerance_and_the_bound((times, values) in walks(), room in eighths(1..80)) {
        let curve = Samples { times: &times, values: &values, slack: 0.25, gaps: &[] };
        let grid = Grid { min: -1e4, max: 1e4, granularity: 1e-4 };
        let tolerance = room + 0.25;
        let fit = fewest(&curve, &grid, tolerance, Ends::default()).unwrap();
        prop_assert!(fit.worst <= tolerance + CLOSE);
        prop_assert!(fit.at_least <= fit.steps.len() && fit.at_least >= lower_bound(&curve, tolerance).unwrap());
        let again = least_error(&curve, &grid, fit.steps.len(), Ends::default()).unwrap();
        // The guarantee of `least_error` for thinned values.
        let (off, off_again) = (fit.worst - curve.slack, again.worst - curve.slack);
        prop_assert!(again.steps.len() <= fit.steps.len());
        prop_assert!(off_again <= (off + grid.granularity) * 17.0 / 16.0 + 1e-5, "{} {}", off, off_again);
        prop_assert!(lower_bound(&curve, again.worst + CLOSE).unwrap() <= fit.steps.len());
    }

    #[test]
    fn arbitrary_numbers_never_panic(
        times in prop::collection::vec(any::<f64>(), 0..5),
        values in prop::collection::vec(any::<f64>(), 0..5),
        (slack, min, max, granularity) in any::<(f64, f64, f64, f64)>(),
        (tolerance, first, last, budget) in any::<(f64, Option<f64>, Option<f64>, usize)>(),
    ) {
        never_panics(&times, &values, slack, Grid { min, max, granularity }, tolerance, Ends { first, last }, budget);
        let times: Vec<_> = (0..values.len()).map(|i| i as f64).collect();
        let (grid, ends) = (Grid { min: -max.abs(), max: max.abs(), granularity: granularity.abs() }, Ends { first, last });
        never_panics(&times, &values, slack.abs().min(1.0), grid, tolerance, ends, budget);
        let tame: Vec<_> = values.iter().map(|value| value.clamp(-1e100, 1e100)).collect();
        never_panics(&times, &tame, 0.0, grid, tolerance.abs(), Ends::default(), budget);
    }
}

fn never_panics(
    times: &[f64],
    values: &[f64],
    slack: f64,
    grid: Grid,
    tolerance: f64,
    ends: Ends,
    budget: usize,
) {
    let curve = Samples { times, values, slack, gaps: &[] };
    let _ = lower_bound(&curve, tolerance);
    for tolerance in [tolerance, f64::INFINITY, f64::NAN] {
        if let Ok(fit) = fewest(&curve, &grid, tolerance, ends) {
            assert!(fit.worst.is_finite() && !tolerance.is_nan());
        }
    }
    let _ = least_error(&curve, &grid, budget, ends);
}

#[test]
fn fit_of_long_curve_is_at_most_one_step_above_its_bound() {
    let times: Vec<_> = (0..20_000).map(f64::from).collect();
    let values: Vec<_> = times.iter().map(|time| 40.0 * (time / 3_000.0).sin()).collect();
    let curve = Samples { times: &times, values: &values, slack: 0.0, gaps: &[] };
    let grid = Grid { min: -90.0, max: 90.0, granularity: 0.5 };
    let fit = fewest(&curve, &grid, 2.0, Ends::default()).unwrap();
    assert!(fit.worst <= 2.0 + CLOSE && fit.steps.len() <= fit.at_least + 1, "{fit:?}");
}
