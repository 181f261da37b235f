//! Compares with all ways to hold a value, on movements small enough for an exhaustive search.

use proptest::prelude::*;

use super::*;

/// A grid with the values -3 to 3. Its limits are not multiples of the granularity.
const GRID: Grid = Grid { min: -3.4, max: 3.3, granularity: 1.0 };
const CLOSE: f64 = 1e-9;
const MS: i64 = 1_000_000;

/// A parabola over some milliseconds, with coefficients per millisecond. It is constant if only the first coefficient is nonzero.
#[derive(Clone, Debug)]
struct Part {
    begin: i64,
    length: i64,
    c: [f64; 3],
}

impl Part {
    fn is_level(&self) -> bool {
        self.c[1] == 0.0 && self.c[2] == 0.0
    }

    fn at(&self, ms: f64) -> f64 {
        self.c[0] + ms * (self.c[1] + ms * self.c[2])
    }

    fn end(&self) -> f64 {
        self.at(self.length as f64)
    }

    /// Returns the times at which the parabola has the given value, in order.
    fn meets(&self, value: f64) -> Vec<f64> {
        let [a, b, c] = [self.c[0] - value, self.c[1], self.c[2]];
        let roots = if c == 0.0 {
            vec![-a / b]
        } else {
            let root = (b * b - 4.0 * a * c).sqrt();
            vec![(-b - root) / (2.0 * c), (-b + root) / (2.0 * c)]
        };
        roots.into_iter().filter(|ms| *ms > 0.0 && *ms < self.length as f64).collect()
    }

    /// Returns times that divide the part so that, within each interval, each grid value is either always or never within the tolerance.
    fn cuts(&self, tolerance: f64) -> Vec<f64> {
        let borders = (-3..=3).flat_map(|value| [-tolerance, tolerance].map(|off| f64::from(value) + off));
        let mut cuts: Vec<f64> = borders.flat_map(|border| self.meets(border)).collect();
        cuts.extend([0.0, self.length as f64]);
        cuts.sort_by(f64::total_cmp);
        cuts
    }
}

#[derive(Clone, Debug)]
struct Case {
    parts: Vec<Part>,
    ends: Ends,
    /// Factor by which the given bounds exceed the true rates.
    loose: f64,
}

impl Case {
    fn written(&self) -> f64 {
        self.parts[self.parts.len() - 1].end()
    }

    fn fewest(&self, tolerance: f64) -> Result<Fit, f64> {
        self.fewest_of(tolerance, usize::MAX)
    }

    fn fewest_of(&self, tolerance: f64, most: usize) -> Result<Fit, f64> {
        let value = |part: usize, at: i64| {
            let part = &self.parts[part];
            part.at((at - part.begin * MS) as f64 / MS as f64)
        };
        let mut movement = Movement::new(&value, tolerance);
        for (index, part) in self.parts.iter().enumerate() {
            let until = (part.begin + part.length) * MS;
            if part.is_level() {
                movement.stay(part.c[0], until);
                continue;
            }
            let slope = part.c[1].abs().max((part.c[1] + 2.0 * part.c[2] * part.length as f64).abs());
            let rates =
                Rates { slope: 1e3 * slope * self.loose, curvature: 2e6 * part.c[2].abs() * self.loose };
            movement.follow(index, until, rates);
        }
        movement.fewest(Some(&GRID), self.ends, self.written(), most)
    }

    /// Returns the fewest steps by brute force: tries all values in all intervals in which each is either always or never within the
    /// tolerance.
    fn by_trying(&self, tolerance: f64) -> Option<usize> {
        let last_is_near =
            self.ends.last.is_none_or(|last| (last - self.written()).abs() <= tolerance + CLOSE);
        if !last_is_near {
            return None;
        }
        let values: Vec<f64> = (-3..=3).map(f64::from).collect();
        // The fewest steps that end with each value.
        let mut fewest: Option<Vec<Option<usize>>> = None;
        for part in &self.parts {
            for pair in part.cuts(tolerance).windows(2).filter(|pair| pair[1] - pair[0] > CLOSE) {
                let level = part.at(f64::midpoint(pair[0], pair[1]));
                let serves = |value: f64| (value - level).abs() <= tolerance + CLOSE;
                let anew = |value: f64| match &fewest {
                    None => self.ends.first.is_none_or(|first| first == value).then_some(1),
                    Some(before) => before.iter().flatten().min().map(|least| least + 1),
                };
                let stays = |k: usize| fewest.as_ref().and_then(|before| before[k]);
                let with = |(k, value): (usize, &f64)| {
                    stays(k).into_iter().chain(anew(*value)).min().filter(|_| serves(*value))
                };
                fewest = Some(values.iter().enumerate().map(with).collect());
            }
        }
        let fewest = fewest?;
        let ends = |(steps, value): (&Option<usize>, &f64)| {
            steps.map(|steps| steps + usize::from(self.ends.last.is_some_and(|last| last != *value)))
        };
        fewest.iter().zip(&values).filter_map(ends).min()
    }

    /// Returns the largest error of steps, among many times, and the largest change of the movement per nanosecond.
    fn played(&self, steps: &[(f64, f64)]) -> (f64, f64) {
        let mut worst: f64 = 0.0;
        let mut steep: f64 = 0.0;
        for part in &self.parts {
            let begin = part.begin as f64;
            let mut times: Vec<f64> = (0..=128).map(|k| part.length as f64 * f64::from(k) / 128.0).collect();
            times.extend(steps.iter().flat_map(|step| [step.0 - begin - 1e-6, step.0 - begin]));
            for ms in times.into_iter().filter(|ms| *ms > 0.0 && *ms < part.length as f64) {
                let held = steps.iter().rfind(|step| step.0 <= begin + ms + 1e-9).unwrap().1;
                worst = worst.max((held - part.at(ms)).abs());
                steep = steep.max((part.c[1] + 2.0 * part.c[2] * ms).abs() * 1e-6);
            }
        }
        (worst, steep)
    }
}

/// Multiples of 1/8, so that values can meet a tolerance exactly.
fn eighths(range: std::ops::Range<i32>) -> impl Strategy<Value = f64> {
    range.prop_map(|eighths| f64::from(eighths) / 8.0)
}

fn cases() -> impl Strategy<Value = Case> {
    let part = (
        1i64..6,
        eighths(-24..25),
        any::<bool>(),
        prop::option::weighted(0.7, (eighths(-20..21), eighths(-4..5))),
    );
    let end = || prop::option::weighted(0.6, -3i32..4);
    let loose = prop_oneof![Just(1.0), Just(7.0)];
    (prop::collection::vec(part, 1..6), end(), any::<bool>(), loose).prop_map(
        |(drawn, first, last, loose)| {
            let mut parts: Vec<Part> = Vec::new();
            for (length, value, jumps, bends) in drawn {
                let before = parts.last().map(|part| (part.begin + part.length, part.end()));
                let (begin, meets) = before.unwrap_or((0, value));
                let (b, c) = bends.unwrap_or_default();
                parts.push(Part { begin, length, c: [if jumps { value } else { meets }, b, c] });
            }
            let end = parts[parts.len() - 1].end();
            let last = last.then(|| end.round().clamp(-3.0, 3.0));
            Case { parts, ends: Ends { first: first.map(f64::from), last }, loose }
        },
    )
}

fn tolerances() -> impl Strategy<Value = f64> {
    prop_oneof![eighths(1..24), (1i32..3_000).prop_map(|thousandths| f64::from(thousandths) / 1_000.0 + 1e-4)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn no_choice_of_step_times_needs_fewer_steps(case in cases(), tolerance in tolerances()) {
        match (case.fewest(tolerance), case.by_trying(tolerance)) {
            (Ok(fit), Some(fewest)) => {
                prop_assert_eq!(fit.steps.len(), fewest, "{:?}", fit);
                prop_assert_eq!(fit.at_least, fewest);
                prop_assert_eq!(fit.steps[0], (0.0, case.ends.first.unwrap_or(fit.steps[0].1)));
                let last = fit.steps[fewest - 1].1;
                prop_assert_eq!(case.ends.last.unwrap_or(last), last);
                prop_assert!(fit.steps.windows(2).all(|pair| pair[0].0 < pair[1].0 && pair[0].1 != pair[1].1));
                // Allowance: one nanosecond, and a millionth of the tolerance.
                let (worst, steep) = case.played(&fit.steps);
                prop_assert!(fit.worst <= tolerance + CLOSE, "{}", fit.worst);
                prop_assert!(worst <= fit.worst + steep + 1e-6 * tolerance + CLOSE, "{} {:?}", worst, fit);
                let closer = fit.worst - 0.0101 * tolerance;
                prop_assert!(case.by_trying(closer).is_none_or(|steps| steps > fewest), "{:?}", fit);
            }
            (Err(smallest), None) => {
                prop_assert!(smallest > tolerance, "{}", smallest);
                let enough = smallest + 2e-6 * smallest.max(1.0);
                prop_assert!(case.by_trying(enough).is_some() && case.fewest(enough).is_ok(), "{}", smallest);
            }
            (fit, fewest) => prop_assert!(false, "{:?}, but {:?} steps are fewest", fit, fewest),
        }
    }

    #[test]
    fn limited_search_returns_all_steps_or_more_than_the_limit(case in cases(), tolerance in tolerances(), most in 0usize..6) {
        if let Ok(all) = case.fewest(tolerance) {
            let some = case.fewest_of(tolerance, most).unwrap();
            // A step shorter than a nanosecond may be counted here.
            prop_assert!(some.steps.len() == all.steps.len() || some.steps.len() > most && all.steps.len() >= most);
        }
    }

    #[test]
    fn arbitrary_numbers_never_panic(
        values in prop::collection::vec(any::<f64>(), 1..5),
        (min, max, granularity, tolerance) in any::<(f64, f64, f64, f64)>(),
        (first, last, written) in any::<(Option<f64>, Option<f64>, f64)>(),
        (slope, curvature) in any::<(f64, f64)>(),
    ) {
        let value = |part: usize, at: i64| values[part] + at as f64 * values[0];
        for tolerance in [tolerance, tolerance.abs(), 0.0, f64::INFINITY, f64::NAN] {
            let mut movement = Movement::new(&value, tolerance);
            for (part, level) in values.iter().enumerate() {
                movement.stay(*level, 20 * part as i64 + 10);
                movement.follow(part, 20 * part as i64 + 20, Rates { slope: slope.abs(), curvature: curvature.abs() });
            }
            for grid in [None, Some(Grid { min, max, granularity }), Some(GRID)] {
                let _ = movement.fewest(grid.as_ref(), Ends { first, last }, written, 100);
            }
        }
    }
}

#[test]
fn value_changes_within_the_nanosecond_of_the_crossing() {
    let value = |_: usize, at: i64| (at as f64 / 1e9).powi(3);
    let mut movement = Movement::new(&value, 0.5);
    movement.follow(0, 2_000_000_000, Rates { slope: 12.0, curvature: 12.0 });
    let ends = Ends { first: Some(0.0), last: Some(8.0) };
    let fit = movement.fewest(Some(&Grid { min: 0.0, max: 9.0, granularity: 1.0 }), ends, 8.0, 99).unwrap();
    let nanos: Vec<f64> = fit.steps.iter().map(|step| (step.0 * 1e6).round()).collect();
    let crossings = (1..9).map(|step| ((f64::from(step) - 0.5).cbrt() * 1e9).floor());
    assert_eq!(nanos[1..], crossings.collect::<Vec<_>>());
}
