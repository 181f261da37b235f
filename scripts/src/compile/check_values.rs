//! Values against the limits and the grid of the device.

use std::collections::HashSet;

use urrcp::{ControlType, Limits, Span};

use super::perform::{OnDevice, snaps};
use crate::fields::Reader;
use crate::finding::{Code, Place};
use crate::fleet::limits_of;
use crate::motion::{Curve, Knot, Shape};
use crate::scenario::{Track, Vectors};

/// How many places of one way between two knots are looked at.
const SAMPLES: u32 = 128;

/// The place of an item of a track's list; of the list where the item has none.
pub(super) fn item_place(track: &Track, item: u32) -> Place {
    track.item(item).2
}

fn value_place(track: &Track, item: u32) -> Place {
    match track.item(item) {
        (_, None, list) => list,
        (_, Some(_), place) => place.of_key("to"),
    }
}

/// A number without the dust of its multiplication.
pub(super) fn tidy(value: f64) -> f64 {
    let rounded = (value * 1e9).round() / 1e9;
    if rounded.is_finite() { rounded } else { value }
}

/// Checks every value; where the cue says so, moves values to the grid. What the device is set to at each knot, nothing if
/// that is what is written.
pub(super) fn check(
    findings: &mut Reader,
    on: &OnDevice<'_>,
    control_type: ControlType,
    curve: &Curve,
) -> Vec<f64> {
    let limits: Vec<&Limits> = limits_of(on.device, control_type).collect();
    let mut set = Vec::new();
    if limits.is_empty() {
        return set;
    }
    // Repeated movements come from the same items again and again.
    let (mut seen, mut ways) = (HashSet::new(), HashSet::new());
    for index in 0..curve.knots.len() {
        let knot = curve.knots[index];
        let sound = limits.iter().all(|limits| limits.contains(knot.to) && limits.on_grid(knot.to));
        if !sound {
            let first = seen.insert((knot.item, knot.to.to_bits()));
            let beyond = |limits: &&&Limits| {
                // What rounding to the grid takes back is none.
                let nearest = limits.nearest(knot.to);
                let rounded = snaps(on.cue) && knot.shape.is_written() && limits.contains(nearest);
                !limits.contains(knot.to) && !rounded
            };
            if let Some(broken) = limits.iter().find(beyond) {
                if first {
                    out_of_range(findings, on, control_type, &knot, broken);
                }
            } else if let Some(broken) =
                limits.iter().find(|limits| knot.shape.is_written() && !limits.on_grid(knot.to))
            {
                match snaps(on.cue) {
                    true => {
                        if set.is_empty() {
                            set.extend(curve.knots.iter().map(|knot| knot.to));
                        }
                        set[index] = snap(findings, on, control_type, &knot, broken, first);
                    }
                    false if first => off_grid(findings, on, control_type, &knot, broken),
                    false => {}
                }
            }
        }
        if let Shape::Function { index: function, gain, offset, .. } = knot.shape
            && index > 0
            && ways.insert((function, gain.to_bits(), offset.to_bits()))
        {
            reaches(findings, on, control_type, curve, index, &limits);
        }
    }
    set
}

fn out_of_range(
    findings: &mut Reader,
    on: &OnDevice<'_>,
    control_type: ControlType,
    knot: &Knot,
    limits: &Limits,
) {
    let value = tidy(knot.to);
    let which = named(on.track, knot.item);
    let message = format!("{which}{value} lies outside the limits for {}", on.who(control_type));
    let expected = format!("{} to {}", limits.min_value, limits.max_value);
    let nearest = limits.nearest_settable(value);
    let hint = in_radians(on, knot.to, limits)
        .unwrap_or_else(|| format!("the nearest value that it can take is {}", tidy(nearest)));
    findings.add(Code::OutOfRange, value_place(on.track, knot.item), message, expected, Some(hint));
}

/// A hint for degrees where the device takes radians.
fn in_radians(on: &OnDevice<'_>, value: f64, limits: &Limits) -> Option<String> {
    let unit = on.device.unit.as_ref()?.to_string();
    let radians = limits.nearest(value.to_radians());
    let fits = matches!(unit.as_str(), "rad" | "radian" | "radians") && limits.contains(radians);
    fits.then(|| format!("the unit of `{}` is rad: {value} degrees are {}", on.device.id, tidy(radians)))
}

fn off_grid(
    findings: &mut Reader,
    on: &OnDevice<'_>,
    control_type: ControlType,
    knot: &Knot,
    limits: &Limits,
) {
    let (value, granularity) = (knot.to, limits.granularity);
    let message = format!(
        "{}{} lies off the grid for {}",
        named(on.track, knot.item),
        tidy(value),
        on.who(control_type)
    );
    let around = [(value / granularity).floor(), (value / granularity).ceil()].map(|n| tidy(n * granularity));
    let nearest = match around.map(|value| limits.contains(value)) {
        [true, true] => format!("the nearest values on the grid are {} and {}", around[0], around[1]),
        _ => format!("the nearest value on the grid is {}", tidy(limits.nearest_settable(value))),
    };
    let hint = format!("{nearest}; `off_grid: snap` takes the nearest everywhere");
    let expected = format!("a multiple of {granularity}");
    findings.add(Code::OffGranularity, value_place(on.track, knot.item), message, expected, Some(hint));
}

/// The nearest value on the grid, with a warning; an error where it is further off than max_error allows.
fn snap(
    findings: &mut Reader,
    on: &OnDevice<'_>,
    control_type: ControlType,
    knot: &Knot,
    limits: &Limits,
    first: bool,
) -> f64 {
    let nearest = limits.nearest_settable(knot.to);
    let error = (nearest - knot.to).abs();
    let allowed = on.track.tolerance.or(limits.max_error).unwrap_or(limits.granularity).max(0.0);
    if !first {
        return nearest;
    }
    let place = value_place(on.track, knot.item);
    let (value, nearest_shown, error_shown) = (tidy(knot.to), tidy(nearest), tidy(error));
    let message = format!(
        "{}{value} becomes {nearest_shown}, {error_shown} off, for {}",
        named(on.track, knot.item),
        on.who(control_type)
    );
    if error <= allowed {
        findings.add(Code::Snapped, place, message, format!("a multiple of {}", limits.granularity), None);
    } else {
        let hint = Some("write a value on the grid, or allow more with `tolerance`".to_owned());
        findings.add(
            Code::ToleranceTooTight,
            place,
            message,
            format!("at most {allowed} off (max_error)"),
            hint,
        );
    }
    nearest
}

/// `keyframe 3: `, counted from 1, where the file has items.
pub(super) fn named(track: &Track, item: u32) -> String {
    match track.item(item) {
        (_, None, _) => String::new(),
        (items, Some(item), _) => format!("{} {}: ", items.one(), item + 1),
    }
}

/// A function may go beyond the values at its ends.
fn reaches(
    findings: &mut Reader,
    on: &OnDevice<'_>,
    control_type: ControlType,
    curve: &Curve,
    index: usize,
    limits: &[&Limits],
) {
    let (from, to) = (curve.knots[index - 1].at, curve.knots[index].at);
    let mut worst: Option<(f64, f64, f64, &Limits)> = None;
    for sample in 0..=SAMPLES {
        let s = f64::from(sample) / f64::from(SAMPLES);
        let value = curve.value(index, s);
        for limits in limits {
            let beyond = (value - limits.max_value).max(limits.min_value - value);
            // What rounding to the grid takes back is none.
            if beyond > limits.granularity / 2.0 && worst.is_none_or(|(known, ..)| beyond > known) {
                worst = Some((beyond, value, s, limits));
            }
        }
    }
    if let Some((_, value, s, limits)) = worst {
        let at = from + Span::from_millis_f64((to - from).as_millis_f64() * s);
        let message = format!(
            "{}the movement reaches {:.4} at {at}, outside the limits for {}",
            named(on.track, curve.knots[index].item),
            value,
            on.who(control_type)
        );
        let expected = format!("{} to {}", limits.min_value, limits.max_value);
        let hint = match on.cue.group {
            Some(_) => "make it smaller, or let the group begin elsewhere",
            None => "make it smaller, for example by `scale`",
        };
        let hint = Some(hint.to_owned());
        findings.add(
            Code::OutOfRange,
            item_place(on.track, curve.knots[index].item),
            message,
            expected,
            hint,
        );
    }
}

/// Values of custom_N are bounded by what the script inherits, if by anything.
pub(super) fn check_inherited(findings: &mut Reader, on: &OnDevice<'_>, vectors: &Vectors) {
    let Some(script) = on.device.available_control_types.script() else { return };
    for vector in vectors.iter() {
        for value in vector.values {
            if !script.limits.contains(*value) {
                let message = format!(
                    "{}{value} lies outside the limits for scripts of `{}` on {}",
                    named(on.track, vector.item),
                    on.device.id,
                    on.cast.names(on.robots)
                );
                let expected = format!("{} to {}", script.limits.min_value, script.limits.max_value);
                let place = value_place(on.track, vector.item);
                findings.add(Code::OutOfRange, place, message, expected, None);
            }
        }
    }
}
