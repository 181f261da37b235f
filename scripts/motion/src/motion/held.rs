//! Steps of a device that holds its value, for a movement that consists of steps. One held value can replace several successive levels (a
//! run). Always taking the longest run gives the fewest runs.

/// For each of a level's values, the lowest and the highest value at that index in the levels of a run.
#[derive(Clone, Debug)]
struct Ranges(Vec<(f64, f64)>);

/// A run: values that are held from one level until the next run, and replace the levels in between.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Index of the first level that the run replaces.
    pub first: usize,
    pub values: Vec<f64>,
    /// The largest difference between a held value and a level of the run.
    pub worst: f64,
}

/// Finds the fewest runs whose values are within the tolerance of all their levels. A level without a value on the grid within the
/// tolerance is a separate run.
///
/// All levels have the same number of values. `grid` returns the nearest value that the device can take.
pub fn runs<'l>(
    levels: impl Iterator<Item = &'l [f64]>,
    grid: impl Fn(f64) -> f64,
    tolerance: f64,
) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    let mut ranges = Ranges(Vec::new());
    for (index, level) in levels.enumerate() {
        let longer = ranges.with(level);
        let (values, worst) = longer.held(&grid);
        let dust = 64.0 * f64::EPSILON * level.iter().fold(tolerance, |most, value| most.max(value.abs()));
        match runs.last_mut().filter(|_| worst <= tolerance + dust) {
            Some(run) => {
                (run.values, run.worst) = (values, worst);
                ranges = longer;
            }
            None => {
                ranges = Ranges(level.iter().map(|value| (*value, *value)).collect());
                let (values, worst) = ranges.held(&grid);
                runs.push(Run { first: index, values, worst });
            }
        }
    }
    runs
}

impl Ranges {
    fn with(&self, level: &[f64]) -> Self {
        let range = |(k, value): (usize, &f64)| match self.0.get(k) {
            Some((low, high)) => (value.min(*low), value.max(*high)),
            None => (*value, *value),
        };
        Self(level.iter().enumerate().map(range).collect())
    }

    /// Returns the grid values nearest to the middles of the ranges, and the largest distance of such a value from a level.
    fn held(&self, grid: &impl Fn(f64) -> f64) -> (Vec<f64>, f64) {
        let values: Vec<f64> = self.0.iter().map(|(low, high)| grid(f64::midpoint(*low, *high))).collect();
        let off = |(value, (low, high)): (&f64, &(f64, f64))| (value - low).max(high - value);
        let worst = values.iter().zip(&self.0).map(off).fold(0.0, f64::max);
        (values, worst)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Returns the fewest runs of successive levels, each replaced by one whole number, by trying all cuts.
    fn fewest(levels: &[f64], tolerance: f64) -> usize {
        let serves =
            |part: &[f64]| (-9..=9).any(|v| part.iter().all(|l| (l - f64::from(v)).abs() <= tolerance));
        let cuts = |mask: u32| {
            let mut parts: Vec<Vec<f64>> = vec![Vec::new()];
            for (k, level) in levels.iter().enumerate() {
                if k > 0 && mask & (1 << (k - 1)) != 0 {
                    parts.push(Vec::new());
                }
                parts.last_mut().unwrap().push(*level);
            }
            parts
        };
        let all = (0..1u32 << (levels.len() - 1)).map(cuts);
        all.filter(|parts| parts.iter().all(|part| serves(part))).map(|parts| parts.len()).min().unwrap()
    }

    proptest! {
        #[test]
        fn runs_are_as_few_as_possible(levels in prop::collection::vec(-6i32..7, 1..9), tolerance in 1i32..9) {
            let tolerance = f64::from(tolerance) / 2.0;
            let levels: Vec<f64> = levels.into_iter().map(|level| f64::from(level) / 2.0).collect();
            let found = runs(levels.chunks(1), f64::round, tolerance);
            prop_assert_eq!(found.len(), fewest(&levels, tolerance));
            prop_assert!(found.iter().all(|run| run.worst <= tolerance));
        }
    }
}
