//! Units in the headers of tables, and their conversion.

/// The unit of joints in ROS (REP 103) and Webots: radians for joints that turn, metres for joints that slide.
pub(super) const OF_JOINTS: &str = "rad or m";

/// Returns the factor that converts values from one unit to another; `None` unless both are units of the same quantity.
pub(super) fn factor(from: &str, to: &str) -> Option<f64> {
    let (to_kind, to_size) = known(to)?;
    let from = match (from, to_kind) {
        (OF_JOINTS, "angle") => "rad",
        (OF_JOINTS, "length") => "m",
        _ => from,
    };
    let (from_kind, from_size) = known(from)?;
    (from_kind == to_kind).then_some(from_size / to_size)
}

/// Returns the size of a full turn in a unit of angles, such as 360 for `deg`; `None` for other units.
pub(super) fn turn(unit: &str) -> Option<f64> {
    match (factor(unit, "deg"), factor(unit, "rad")) {
        (Some(1.0), _) => Some(360.0),
        (_, Some(1.0)) => Some(std::f64::consts::TAU),
        _ => None,
    }
}

/// Splits a header such as `x[m]` or `x (m)` into name and unit.
pub(super) fn name_and_unit(header: &str) -> (&str, &str) {
    let header = header.trim();
    let square = header.strip_suffix(']').and_then(|rest| rest.split_once('['));
    match square.or_else(|| header.strip_suffix(')').and_then(|rest| rest.split_once('('))) {
        Some((name, unit)) => (name.trim(), unit.trim()),
        None => (header, ""),
    }
}

fn known(unit: &str) -> Option<(&'static str, f64)> {
    Some(match unit {
        "m" => ("length", 1.0),
        "cm" => ("length", 0.01),
        "mm" => ("length", 0.001),
        "rad" => ("angle", 1.0),
        "deg" | "degree" | "degrees" | "°" => ("angle", std::f64::consts::PI / 180.0),
        "s" | "sec" => ("time", 1.0),
        "ms" => ("time", 0.001),
        "us" => ("time", 1e-6),
        "ns" => ("time", 1e-9),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_the_same_kind_are_convertible() {
        assert_eq!(factor("cm", "mm"), Some(10.0));
        assert!(factor("rad", "deg").is_some_and(|f| (f - 57.295_779_513).abs() < 1e-9));
        assert_eq!(factor("rad", "m"), None);
        assert_eq!((factor(OF_JOINTS, "rad"), factor(OF_JOINTS, "mm")), (Some(1.0), Some(1_000.0)));
        assert_eq!(factor(OF_JOINTS, "deg"), factor("rad", "deg"));
        assert_eq!(factor(OF_JOINTS, "%"), None);
        assert_eq!(name_and_unit(" x[mm] "), ("x", "mm"));
        assert_eq!(name_and_unit("x (mm)"), ("x", "mm"));
        assert_eq!(name_and_unit("t"), ("t", ""));
    }
}
