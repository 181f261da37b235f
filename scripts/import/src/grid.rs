//! Determines the range and the grid of the values in imported files, for robots whose own limits are not known.

/// The step size of common servos, in degrees: they have 4096 steps per turn.
const SERVO_STEP_DEG: f64 = 360.0 / 4096.0;
/// If at least this fraction of the values consists of multiples of the servo step, the device is assumed to be a servo.
const SERVO_SHARE: f64 = 0.9;
/// Minimum and maximum number of decimal digits of a grid.
const DIGITS_MIN: i32 = 3;
const DIGITS_MAX: i32 = 9;
/// Largest deviation from a grid, in steps, that counts as a rounding error.
const TOLERANCE: f64 = 1e-6;

/// The range of a device's values, and the grid (the step size) that they have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid {
    pub(super) min: f64,
    pub(super) max: f64,
    pub(super) granularity: f64,
    /// Whether all values are multiples of the granularity.
    pub(super) complete: bool,
}

/// Returns the range of the values, rounded outward, and the coarsest grid that contains them.
pub(super) fn grid_of(values: &[f64], unit: &str) -> Grid {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (min, max) = outward(least, most);
    let on_servo = values.iter().filter(|value| on_grid(**value, SERVO_STEP_DEG)).count();
    let moving = values.iter().any(|value| *value != 0.0 && on_grid(*value, SERVO_STEP_DEG));
    if unit == "deg" && moving && on_servo as f64 >= SERVO_SHARE * values.len() as f64 {
        return Grid { min, max, granularity: SERVO_STEP_DEG, complete: on_servo == values.len() };
    }
    let decimal =
        (DIGITS_MIN..=DIGITS_MAX).find(|digits| values.iter().all(|v| on_grid(*v, 10_f64.powi(-digits))));
    let granularity = 10_f64.powi(-decimal.unwrap_or(DIGITS_MAX));
    Grid { min, max, granularity, complete: decimal.is_some() }
}

/// Returns the range of curves, rounded outward, and a grid that is fine enough for their unit.
pub(super) fn of_curves(bounds: &[f64], unit: &str) -> Grid {
    let least = bounds.iter().copied().fold(f64::INFINITY, f64::min);
    let most = bounds.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (min, max) = outward(least, most);
    let granularity = match unit {
        "m" | "rad" => 0.001,
        "cm" | "deg" => 0.1,
        "mm" => 1.0,
        _ => 10_f64.powf((max - min).log10().round() - 3.0),
    };
    Grid { min, max, granularity, complete: true }
}

/// Whether a value is a multiple of the granularity, except for rounding.
pub(super) fn on_grid(value: f64, granularity: f64) -> bool {
    let steps = value / granularity;
    (steps - steps.round()).abs() <= TOLERANCE
}

/// Rounds a range outward, to two significant digits of its width. An empty range becomes at least one unit wide.
fn outward(least: f64, most: f64) -> (f64, f64) {
    if least >= most || !least.is_finite() || !most.is_finite() {
        return (least.floor() - 1.0, most.ceil() + 1.0);
    }
    let digits = (most - least).log10().floor() - 1.0;
    let digits = digits.clamp(-12.0, 300.0);
    // Powers of ten from 1 are exact, but their inverses are not: divide by the power instead.
    if digits < 0.0 {
        let scale = 10_f64.powf(-digits).round();
        ((least * scale).floor() / scale, (most * scale).ceil() / scale)
    } else {
        let step = 10_f64.powf(digits).round();
        ((least / step).floor() * step, (most / step).ceil() * step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn range_is_rounded_outward() {
        let grid = grid_of(&[-3.6678, -3.01], "m");
        assert_eq!((grid.min, grid.max, grid.granularity), (-3.67, -3.01, 1e-4));
        assert_eq!((grid_of(&[0.0, 0.0], "rad").min, grid_of(&[0.0], "rad").max), (-1.0, 1.0));
    }

    #[test]
    fn servo_steps_are_recognised_despite_some_outliers() {
        let mut values: Vec<f64> = (0..95).map(|n| f64::from(n) * SERVO_STEP_DEG).collect();
        values.push(45.0);
        let grid = grid_of(&values, "deg");
        assert_eq!((grid.granularity, grid.complete), (SERVO_STEP_DEG, true));
        values.push(12.34);
        assert!(!grid_of(&values, "deg").complete);
    }
}
