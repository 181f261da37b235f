//! Writes compact SVG path data: coordinates are in tenths of a pixel, and each point is relative to the previous one.

use std::fmt::Write;

/// Writes the data of one path. Rounding errors do not accumulate, because the output is the difference of rounded points.
#[derive(Default)]
pub(super) struct Pen {
    data: String,
    /// The last written point in tenths of a pixel. `None` before the first point.
    at: Option<(i64, i64)>,
}

impl Pen {
    /// Returns the path data of a line through these points.
    pub(super) fn line(points: &[(f64, f64)]) -> String {
        let mut pen = Self::default();
        for point in points {
            match pen.at {
                None => pen.write("M", *point),
                Some(_) => pen.write(if pen.data.contains('l') { " " } else { "l" }, *point),
            }
        }
        pen.data
    }

    /// Returns the path data of a stroke of zero length at each of these points. With round line caps, each stroke is a dot.
    pub(super) fn dots(points: &[(f64, f64)]) -> String {
        let mut pen = Self::default();
        for point in points {
            pen.write(if pen.at.is_none() { "M" } else { "m" }, *point);
            pen.data.push_str("h0");
        }
        pen.data
    }

    fn write(&mut self, command: &str, point: (f64, f64)) {
        let to = (tenths(point.0), tenths(point.1));
        let from = self.at.replace(to).unwrap_or_default();
        let (right, down) = (text(to.0 - from.0), text(to.1 - from.1));
        let command = if command == " " && right.starts_with('-') { "" } else { command };
        let space = if down.starts_with('-') { "" } else { " " };
        let _infallible = write!(self.data, "{command}{right}{space}{down}");
    }
}

#[expect(clippy::cast_possible_truncation, reason = "pictures are some thousand pixels wide")]
fn tenths(pixels: f64) -> i64 {
    (pixels * 10.0).round() as i64
}

fn text(tenths: i64) -> String {
    let (sign, whole, part) = (if tenths < 0 { "-" } else { "" }, tenths.abs() / 10, tenths.abs() % 10);
    match (whole, part) {
        (_, 0) => format!("{sign}{whole}"),
        (0, _) => format!("{sign}.{part}"),
        _ => format!("{sign}{whole}.{part}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::thinned::thinned;
    use super::*;

    #[test]
    fn points_are_encoded_as_short_relative_coordinates() {
        let points = [(1.0, 2.04), (1.55, 1.0), (0.0, 1.0), (10.0, 13.3)];
        assert_eq!(Pen::line(&points), "M1 2l.6-1-1.6 0 10 12.3");
        assert_eq!(Pen::dots(&points), "M1 2h0m.6-1h0m-1.6 0h0m10 12.3h0");
        assert_eq!((Pen::line(&[]), Pen::dots(&[])), (String::new(), String::new()));
    }

    #[test]
    fn hundred_thousand_steps_take_less_than_two_megabytes() {
        let lane: Vec<_> =
            (0..2_500).map(|step| (f64::from(step) * 0.72, f64::from(step * 37 % 221) / 10.0)).collect();
        let lane = Pen::line(&thinned(&lane, 1.0)).len() + Pen::dots(&thinned(&lane, 2.0)).len();
        assert!(40 * lane < 2_000_000, "{} bytes", 40 * lane);
    }

    #[test]
    fn rounding_errors_do_not_accumulate() {
        let points: Vec<_> = (0..1_000).map(|index| (f64::from(index) * 0.04, 0.0)).collect();
        let line = Pen::line(&points);
        let right: f64 = line[1..].split(['l', ' ']).step_by(2).map(|x| x.parse::<f64>().unwrap()).sum();
        assert!((right - 39.96).abs() < 0.06, "{right}");
    }
}
