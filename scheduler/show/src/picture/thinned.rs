//! Reduces the number of points of a line without changing its appearance.

/// Keeps the first, the lowest, the highest and the last point of each column of `column` pixels. A line through these points covers the
/// same pixels as a line through all points. No spike is lost (Jugel, Jerzak, Hackenbroich and Markl, M4, VLDB 2014). `points` must be in
/// ascending order of x.
pub(super) fn thinned(points: &[(f64, f64)], column: f64) -> Vec<(f64, f64)> {
    let of = |point: &(f64, f64)| (point.0 / column).floor();
    points.chunk_by(|a, b| of(a) == of(b)).flat_map(extremes).collect()
}

fn extremes(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let by_value = |a: &usize, b: &usize| points[*a].1.total_cmp(&points[*b].1);
    let least = (0..points.len()).min_by(by_value);
    let largest = (0..points.len()).max_by(by_value);
    let mut kept: Vec<_> =
        [Some(0), least, largest, points.len().checked_sub(1)].into_iter().flatten().collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|index| points[index]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_points_are_unchanged_and_many_keep_extremes_in_order() {
        let few = [(0.0, 1.0), (1.5, 3.0), (2.5, 2.0)];
        assert_eq!(thinned(&few, 1.0), few);
        let many: Vec<_> = (0..1_000).map(|index| (f64::from(index) / 100.0, 5.0)).collect();
        let mut spikes = many.clone();
        (spikes[341].1, spikes[777].1) = (9.0, 1.0);
        let kept = thinned(&spikes, 1.0);
        assert!(kept.len() <= 40, "{}", kept.len());
        assert!(kept.contains(&(3.41, 9.0)) && kept.contains(&(7.77, 1.0)), "{kept:?}");
        assert!(kept.is_sorted_by(|a, b| a.0 < b.0), "{kept:?}");
        assert_eq!(thinned(&[], 1.0), []);
    }

    #[test]
    fn first_and_last_point_of_each_column_are_kept() {
        let points: Vec<_> = (0..500).map(|i| (f64::from(i) / 50.0, f64::from(i * 37 % 101))).collect();
        let kept = thinned(&points, 1.0);
        for column in 0..10 {
            let within = |points: &[(f64, f64)]| {
                let points: Vec<_> =
                    points.iter().filter(|p| p.0.floor() == f64::from(column)).copied().collect();
                (points[0], points[points.len() - 1])
            };
            assert_eq!(within(&kept), within(&points));
        }
    }
}
