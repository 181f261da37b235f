//! Checks values against the limits and the grid of their device.

use std::collections::HashSet;

use urrcp::{ControlType, Limits, Span};

use super::perform::{Fault, OnDevice, snaps};
use crate::fields::Reader;
use crate::finding::{Code, PathStep, Place};
use crate::fleet::limits_of;
use crate::motion::{Curve, Knot, Shape};
use crate::scenario::{Change, Changed, Track, Vectors};
use crate::shown::shortened;

/// Number of samples in a section between two knots.
const SAMPLES: u32 = 128;
/// Share of the granularity: a deviation up to this share is ignored if both values are printed alike.
const DUST: f64 = 1e-3;

/// Returns the place of an item in a track's list; if the item has no place of its own, that of the list.
pub(super) fn item_place(track: &Track, item: u32) -> Place {
    track.item(item).2
}

/// Returns the place of the section that leads to an item or, if the section depends on an argument, the place of the argument.
pub(super) fn way_place(track: &Track, item: u32) -> Place {
    track.given(item).cloned().unwrap_or_else(|| item_place(track, item))
}

fn value_place(track: &Track, item: u32) -> Place {
    match (track.given(item), track.item(item)) {
        (Some(given), _) => given.clone(),
        (None, (_, None, list)) => list,
        (None, (_, Some(_), place)) => place.of_key("to"),
    }
}

/// Returns a value without the rounding errors of a multiplication and without the sign of zero.
pub(super) fn tidy(value: f64) -> f64 {
    let rounded = (value * 1e9).round() / 1e9 + 0.0;
    if rounded.is_finite() { rounded } else { value }
}

/// Checks every value of a curve, and moves values to the grid if the cue requires it. Returns the device value at each knot; empty if
/// all values remain as written.
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
    // Repetitions of a movement contain the same items.
    let (mut seen, mut ways) = (HashSet::new(), HashSet::new());
    let [mut snapped, mut refused] = [OffGrid::default(), OffGrid::default()];
    for index in 0..curve.knots.len() {
        let knot = curve.knots[index];
        let sound = limits.iter().all(|limits| is_settable(limits, knot.to));
        if !sound {
            let first = seen.insert((knot.item, knot.to.to_bits()));
            let beyond = |limits: &&&Limits| {
                // A deviation that rounding to the grid corrects is ignored.
                let may_round =
                    snaps(on.cue) || !knot.shape.is_written() || GridShift::of(&knot, limits).is_dust();
                let nearest = if may_round { limits.nearest(knot.to) } else { knot.to };
                !limits.contains(knot.to) && !limits.contains(nearest)
            };
            if let Some(broken) = limits.iter().find(beyond) {
                if first {
                    out_of_range(findings, on, control_type, curve, &knot, broken);
                }
            } else if let Some(broken) =
                limits.iter().find(|limits| knot.shape.is_written() && !is_settable(limits, knot.to))
            {
                let moved = GridShift::of(&knot, broken);
                if snaps(on.cue) || moved.is_dust() {
                    if set.is_empty() {
                        set.extend(curve.knots.iter().map(|knot| knot.to));
                    }
                    set[index] = moved.to;
                    if first && !moved.is_dust() && !is_too_far(findings, on, control_type, moved) {
                        snapped.add(moved);
                    }
                } else if first {
                    refused.add(moved);
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
    snapped.report(findings, on, control_type);
    refused.refuse(findings, on, control_type, &limits);
    set
}

fn is_settable(limits: &Limits, value: f64) -> bool {
    limits.contains(value) && limits.on_grid(value)
}

fn out_of_range(
    findings: &mut Reader,
    on: &OnDevice<'_>,
    control_type: ControlType,
    curve: &Curve,
    knot: &Knot,
    limits: &Limits,
) {
    let value = tidy(knot.to);
    let nearest = limits.nearest_settable(value);
    let size = beyond(limits, knot.to);
    let expected = between(limits);
    let said = format!("{}{value} lies outside the limits for ", named(on.track, knot.item));
    if let Some(changed) = blamed(on.track, knot.to, limits) {
        let hint = room_for(curve, changed, on, limits);
        let fault =
            Fault { code: Code::OutOfRange, place: changed.place.clone(), size, said, expected, hint };
        return on.add(findings, control_type, fault);
    }
    let given = on.track.given_as(knot.item);
    let hint = match given.and_then(|given| Some((parameter(&given.place)?, given.is_alone))) {
        Some((parameter, true)) if on.track.changed.is_none() => {
            format!("`{parameter}` sets it to {value}: the nearest possible value is {nearest}")
        }
        Some((parameter, _)) => {
            let most = if value > limits.max_value { "at most" } else { "at least" };
            format!("`{parameter}` results in {value}: use a value that results in {most} {nearest}")
        }
        None => in_radians(on, knot.to, limits)
            .unwrap_or_else(|| format!("the nearest possible value is {nearest}")),
    };
    let place = value_place(on.track, knot.item);
    let fault = Fault { code: Code::OutOfRange, place, size, said, expected, hint: Some(hint) };
    on.add(findings, control_type, fault);
}

/// Returns by how much a value exceeds the limits; negative within them.
fn beyond(limits: &Limits, value: f64) -> f64 {
    (value - limits.max_value).max(limits.min_value - value)
}

/// Returns the name of the parameter if `place` is that of a parameter's argument.
fn parameter(place: &Place) -> Option<&str> {
    match place.path.last()? {
        PathStep::Key(name, _) => Some(name),
        PathStep::Index(_) => None,
    }
}

fn between(limits: &Limits) -> String {
    format!("{} to {}", limits.min_value, limits.max_value)
}

/// Returns the change that the cue makes to the track, if the value would be within the limits without this change.
fn blamed<'t>(track: &'t Track, value: f64, limits: &Limits) -> Option<&'t Changed> {
    let sound = |changed: &&Changed| limits.contains(limits.nearest(changed.undone(value)));
    track.changed.as_ref().filter(sound)
}

/// Suggests another factor (or, for a mirrored movement, another mirror value) that keeps the whole movement within the limits.
fn room_for(curve: &Curve, changed: &Changed, on: &OnDevice<'_>, limits: &Limits) -> Option<String> {
    let values = || curve.knots.iter().map(|knot| changed.undone(knot.to));
    match changed.change {
        Change::Scale => {
            let most = |value: f64| {
                let bound = if value > changed.about { limits.max_value } else { limits.min_value };
                let most = (bound - changed.about) / (value - changed.about);
                if most.is_finite() { most } else { f64::INFINITY }
            };
            let factor = rounded_down(values().map(most).fold(f64::INFINITY, f64::min));
            (changed.factor > 0.0 && factor > 0.0).then(|| format!("use a factor of at most {factor}"))
        }
        Change::Mirror => {
            let (least, most) =
                (values().fold(f64::INFINITY, f64::min), values().fold(-f64::INFINITY, f64::max));
            let middle = tidy(f64::midpoint(least, most));
            Some(format!(
                "mirror it about its middle to stay within the limits: `{{about: {middle}, devices: [{}]}}`",
                on.track.device
            ))
        }
    }
}

/// Rounds down to three significant digits, for display.
fn rounded_down(value: f64) -> f64 {
    let scale = 10f64.powf(2.0 - value.abs().log10().floor());
    let rounded = (value * scale + 1e-6).floor() / scale;
    if rounded.is_finite() { tidy(rounded) } else { value }
}

/// Returns a hint if the value seems to be in degrees, but the device uses radians.
fn in_radians(on: &OnDevice<'_>, value: f64, limits: &Limits) -> Option<String> {
    let unit = on.device.unit.as_ref()?.to_string();
    let radians = limits.nearest(value.to_radians());
    let fits = matches!(unit.as_str(), "rad" | "radian" | "radians") && limits.contains(radians);
    fits.then(|| format!("the unit of `{}` is rad: {value} degrees are {} rad", on.device.id, tidy(radians)))
}

/// A value, with the nearest value on the device's grid.
#[derive(Clone, Copy)]
struct GridShift {
    item: u32,
    from: f64,
    to: f64,
    granularity: f64,
    /// The largest deviation from the written value that the device itself permits.
    allowed: f64,
}

impl GridShift {
    fn of(knot: &Knot, limits: &Limits) -> Self {
        Self {
            item: knot.item,
            from: knot.to,
            to: limits.nearest_settable(knot.to),
            granularity: limits.granularity,
            allowed: limits.max_error.unwrap_or(limits.granularity),
        }
    }

    fn off(&self) -> f64 {
        (self.to - self.from).abs()
    }

    /// Whether the value and the grid value are printed alike. Their difference may only be a rounding error, because few decimal numbers
    /// have an exact `f64`.
    fn is_dust(&self) -> bool {
        tidy(self.from) == tidy(self.to) && self.off() <= DUST * self.granularity
    }

    fn fault(&self, on: &OnDevice<'_>, code: Code, others: &str) -> Fault {
        // Enough digits to distinguish both values.
        let digits = |value: f64| if tidy(self.from) == tidy(self.to) { value } else { tidy(value) };
        let [from, to, off] = [self.from, self.to, self.off()].map(digits);
        Fault {
            code,
            place: value_place(on.track, self.item),
            size: self.off(),
            said: format!(
                "{}{from} is rounded to {to}, an error of {off}{others}, for ",
                named(on.track, self.item)
            ),
            expected: format!("a multiple of {}", self.granularity),
            hint: None,
        }
    }
}

/// Reports a value whose distance from the grid exceeds the permitted error. Returns whether it does.
fn is_too_far(findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType, moved: GridShift) -> bool {
    let allowed = on.track.tolerance.unwrap_or(moved.allowed).max(0.0);
    if moved.off() <= allowed {
        return false;
    }
    let fault = Fault {
        expected: format!("an error of at most {allowed} (max_error)"),
        hint: Some("write a value on the grid, or allow a larger error with `tolerance`".to_owned()),
        ..moved.fault(on, Code::ToleranceTooTight, "")
    };
    on.add(findings, control_type, fault);
    true
}

/// All values of a track that are off the grid, for a single finding.
#[derive(Default)]
struct OffGrid {
    furthest: Option<GridShift>,
    count: usize,
}

impl OffGrid {
    fn add(&mut self, moved: GridShift) {
        self.count += 1;
        if self.furthest.is_none_or(|furthest| moved.off() > furthest.off()) {
            self.furthest = Some(moved);
        }
    }

    /// Warns that the values were moved to the grid.
    fn report(self, findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType) {
        let Some(furthest) = self.furthest else { return };
        let others = match self.count {
            1 => String::new(),
            count => format!(", the largest of {count} such errors"),
        };
        on.add(findings, control_type, furthest.fault(on, Code::Snapped, &others));
    }

    /// Reports the off-grid values as an error.
    fn refuse(self, findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType, limits: &[&Limits]) {
        let Some(furthest) = self.furthest else { return };
        let GridShift { item, from, granularity, .. } = furthest;
        let around =
            [(from / granularity).floor(), (from / granularity).ceil()].map(|n| tidy(n * granularity));
        let nearest = match around.map(|value| limits.iter().all(|limits| limits.contains(value))) {
            [true, true] => format!("the nearest values on the grid are {} and {}", around[0], around[1]),
            _ => format!("the nearest value on the grid is {}", tidy(furthest.to)),
        };
        let snap = "use `off_grid: snap` at the top of the scenario to round all values to the grid";
        let (lie, hint) = match self.count {
            1 => (" lies".to_owned(), format!("{nearest}; {snap}")),
            2 => (" and 1 other value lie".to_owned(), snap.to_owned()),
            count => (format!(" and {} other values lie", count - 1), snap.to_owned()),
        };
        let fault = Fault {
            code: Code::OffGranularity,
            place: value_place(on.track, item),
            size: furthest.off(),
            said: format!("{}{}{lie} off the grid for ", named(on.track, item), tidy(from)),
            expected: format!(
                "{} of {granularity}",
                if self.count == 1 { "a multiple" } else { "multiples" }
            ),
            hint: Some(hint),
        };
        on.add(findings, control_type, fault);
    }
}

/// Returns a prefix such as `keyframe 3: `, counted from 1; empty if the file has no items.
pub(super) fn named(track: &Track, item: u32) -> String {
    match track.item(item) {
        (_, None, _) => String::new(),
        (items, Some(own), place) => match (track.given(item), place.path.as_slice()) {
            (Some(_), [PathStep::Key(kind, _), PathStep::Key(name, _), ..]) if kind == "moves" => {
                format!("{} {} of the move `{}`: ", items.one(), own + 1, shortened(name))
            }
            _ => format!("{} {}: ", items.one(), own + 1),
        },
    }
}

/// Checks the values within a section between two knots, where a function may exceed the values at its ends.
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
            // A deviation that rounding to the grid corrects is ignored.
            if beyond > limits.granularity / 2.0 && worst.is_none_or(|(known, ..)| beyond > known) {
                worst = Some((beyond, value, s, limits));
            }
        }
    }
    let Some((by, value, s, limits)) = worst else { return };
    let (before, knot) = (&curve.knots[index - 1], &curve.knots[index]);
    // A section that stays within the values at its ends has the same fault as they do.
    if by <= beyond(limits, before.to).max(beyond(limits, knot.to)) * (1.0 + 1e-9) {
        return;
    }
    let at = from + Span::from_millis_f64((to - from).as_millis_f64() * s);
    let said = format!(
        "{}the movement reaches {} at {at}, outside the limits for ",
        named(on.track, knot.item),
        figure(value)
    );
    let place = way_place(on.track, knot.item);
    let hint = match (on.cue.group.is_some(), knot.item) {
        (true, _) => "make the movement smaller, or start the group elsewhere".to_owned(),
        (false, u32::MAX) => fitting(curve, limits),
        (false, _) => "make the movement smaller, for example with `scale`".to_owned(),
    };
    let fault =
        Fault { code: Code::OutOfRange, place, size: by, said, expected: between(limits), hint: Some(hint) };
    on.add(findings, control_type, fault);
}

/// Suggests how to shift or scale a movement without items so that it stays within the limits.
fn fitting(curve: &Curve, limits: &Limits) -> String {
    let samples = (1..curve.knots.len()).flat_map(|index| {
        (0..=SAMPLES).map(move |sample| curve.value(index, f64::from(sample) / f64::from(SAMPLES)))
    });
    let (least, most) = samples
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| (least.min(value), most.max(value)));
    let room = limits.max_value - limits.min_value;
    let span = most - least;
    if span > room {
        let part = rounded_down(room / span);
        return format!(
            "the values span {}, but the limits span only {room}: scale the movement by {part}",
            figure(span)
        );
    }
    if limits.min_value > least {
        format!("increase all values by {}", figure(limits.min_value - least))
    } else {
        format!("decrease all values by {}", figure(most - limits.max_value))
    }
}

/// Rounds to four decimals.
fn figure(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}

/// Checks values of `custom_N` against the limits that the script inherits, if any. `custom_N` has no other limits.
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
