//! Values against the limits and the grid of the device.

use std::collections::HashSet;

use urrcp::{ControlType, Limits, Span};

use super::perform::{Fault, OnDevice, snaps};
use crate::fields::Reader;
use crate::finding::{Code, Part, Place};
use crate::fleet::limits_of;
use crate::motion::{Curve, Knot, Shape};
use crate::scenario::{Change, Changed, Track, Vectors};
use crate::shown::shortened;

/// How many places of one way between two knots are looked at.
const SAMPLES: u32 = 128;
/// Parts of a granularity that are no difference where both values are printed alike.
const DUST: f64 = 1e-3;

/// The place of an item of a track's list; of the list where the item has none.
pub(super) fn item_place(track: &Track, item: u32) -> Place {
    track.item(item).2
}

/// The place of the way to an item: of the parameter on which that depends, if there is one.
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

/// A number without the dust of its multiplication, and without a sign of zero.
pub(super) fn tidy(value: f64) -> f64 {
    let rounded = (value * 1e9).round() / 1e9 + 0.0;
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
    let [mut snapped, mut refused] = [OffGrid::default(), OffGrid::default()];
    for index in 0..curve.knots.len() {
        let knot = curve.knots[index];
        let sound = limits.iter().all(|limits| is_settable(limits, knot.to));
        if !sound {
            let first = seen.insert((knot.item, knot.to.to_bits()));
            let beyond = |limits: &&&Limits| {
                // What rounding to the grid takes back is none.
                let may_round =
                    snaps(on.cue) || !knot.shape.is_written() || Moved::of(&knot, limits).is_dust();
                let nearest = if may_round { limits.nearest(knot.to) } else { knot.to };
                !limits.contains(knot.to) && !limits.contains(nearest)
            };
            if let Some(broken) = limits.iter().find(beyond) {
                if first {
                    out_of_range(findings, on, control_type, (curve, &knot), broken);
                }
            } else if let Some(broken) =
                limits.iter().find(|limits| knot.shape.is_written() && !is_settable(limits, knot.to))
            {
                let moved = Moved::of(&knot, broken);
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
    (curve, knot): (&Curve, &Knot),
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
            format!("`{parameter}` makes it {value}: the nearest that it can take is {nearest}")
        }
        Some((parameter, _)) => {
            let most = if value > limits.max_value { "at most" } else { "at least" };
            format!("`{parameter}` makes it {value}: give a value that makes it {most} {nearest}")
        }
        None => in_radians(on, knot.to, limits)
            .unwrap_or_else(|| format!("the nearest value that it can take is {nearest}")),
    };
    let place = value_place(on.track, knot.item);
    let fault = Fault { code: Code::OutOfRange, place, size, said, expected, hint: Some(hint) };
    on.add(findings, control_type, fault);
}

/// How far a value is outside the limits.
fn beyond(limits: &Limits, value: f64) -> f64 {
    (value - limits.max_value).max(limits.min_value - value)
}

/// The name of the parameter that is given at a place.
fn parameter(place: &Place) -> Option<&str> {
    match place.path.last()? {
        Part::Key(name, _) => Some(name),
        Part::Index(_) => None,
    }
}

fn between(limits: &Limits) -> String {
    format!("{} to {}", limits.min_value, limits.max_value)
}

/// The change of the cue without which the value would lie within the limits.
fn blamed<'t>(track: &'t Track, value: f64, limits: &Limits) -> Option<&'t Changed> {
    let sound = |changed: &&Changed| limits.contains(limits.nearest(changed.undone(value)));
    track.changed.as_ref().filter(sound)
}

/// How the change is to be written so that the whole movement keeps to the limits.
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
            (changed.factor > 0.0 && factor > 0.0).then(|| format!("a factor of at most {factor} fits"))
        }
        Change::Mirror => {
            let (least, most) =
                (values().fold(f64::INFINITY, f64::min), values().fold(-f64::INFINITY, f64::max));
            let middle = tidy(f64::midpoint(least, most));
            Some(format!(
                "it fits if mirrored about its middle: `{{about: {middle}, devices: [{}]}}`",
                on.track.device
            ))
        }
    }
}

/// A figure for people that is no larger than the number: three digits.
fn rounded_down(value: f64) -> f64 {
    let scale = 10f64.powf(2.0 - value.abs().log10().floor());
    let rounded = (value * scale + 1e-6).floor() / scale;
    if rounded.is_finite() { tidy(rounded) } else { value }
}

/// A hint for degrees where the device takes radians.
fn in_radians(on: &OnDevice<'_>, value: f64, limits: &Limits) -> Option<String> {
    let unit = on.device.unit.as_ref()?.to_string();
    let radians = limits.nearest(value.to_radians());
    let fits = matches!(unit.as_str(), "rad" | "radian" | "radians") && limits.contains(radians);
    fits.then(|| format!("the unit of `{}` is rad: {value} degrees are {}", on.device.id, tidy(radians)))
}

/// A value with the nearest one on the grid.
#[derive(Clone, Copy)]
struct Moved {
    item: u32,
    from: f64,
    to: f64,
    granularity: f64,
    /// The largest error that the device allows by itself.
    allowed: f64,
}

impl Moved {
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

    /// Whether both are printed alike: doubles of a computation are seldom exactly the decimal numbers that they stand for.
    fn is_dust(&self) -> bool {
        tidy(self.from) == tidy(self.to) && self.off() <= DUST * self.granularity
    }

    fn fault(&self, on: &OnDevice<'_>, code: Code, others: &str) -> Fault {
        // As many digits as tell both apart.
        let digits = |value: f64| if tidy(self.from) == tidy(self.to) { value } else { tidy(value) };
        let [from, to, off] = [self.from, self.to, self.off()].map(digits);
        Fault {
            code,
            place: value_place(on.track, self.item),
            size: self.off(),
            said: format!("{}{from} becomes {to}, {off} off{others}, for ", named(on.track, self.item)),
            expected: format!("a multiple of {}", self.granularity),
            hint: None,
        }
    }
}

/// Reports a value that is further off the grid than max_error allows. Returns whether it is.
fn is_too_far(findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType, moved: Moved) -> bool {
    let allowed = on.track.tolerance.unwrap_or(moved.allowed).max(0.0);
    if moved.off() <= allowed {
        return false;
    }
    let fault = Fault {
        expected: format!("at most {allowed} off (max_error)"),
        hint: Some("write a value on the grid, or allow more with `tolerance`".to_owned()),
        ..moved.fault(on, Code::ToleranceTooTight, "")
    };
    on.add(findings, control_type, fault);
    true
}

/// The values of a track that are off the grid. They are one finding.
#[derive(Default)]
struct OffGrid {
    furthest: Option<Moved>,
    count: usize,
}

impl OffGrid {
    fn add(&mut self, moved: Moved) {
        self.count += 1;
        if self.furthest.is_none_or(|furthest| moved.off() > furthest.off()) {
            self.furthest = Some(moved);
        }
    }

    /// Warns that the values are moved to the grid.
    fn report(self, findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType) {
        let Some(furthest) = self.furthest else { return };
        let others = match self.count {
            1 => String::new(),
            count => format!(", the most of {count} values off the grid"),
        };
        on.add(findings, control_type, furthest.fault(on, Code::Snapped, &others));
    }

    /// Reports the values as an error.
    fn refuse(self, findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType, limits: &[&Limits]) {
        let Some(furthest) = self.furthest else { return };
        let Moved { item, from, granularity, .. } = furthest;
        let around =
            [(from / granularity).floor(), (from / granularity).ceil()].map(|n| tidy(n * granularity));
        let nearest = match around.map(|value| limits.iter().all(|limits| limits.contains(value))) {
            [true, true] => format!("the nearest values on the grid are {} and {}", around[0], around[1]),
            _ => format!("the nearest value on the grid is {}", tidy(furthest.to)),
        };
        let snap = "`off_grid: snap` at the top of the scenario takes the nearest everywhere";
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

/// `keyframe 3: `, counted from 1, where the file has items.
pub(super) fn named(track: &Track, item: u32) -> String {
    match track.item(item) {
        (_, None, _) => String::new(),
        (items, Some(own), place) => match (track.given(item), place.path.as_slice()) {
            (Some(_), [Part::Key(kind, _), Part::Key(name, _), ..]) if kind == "moves" => {
                format!("{} {} of the move `{}`: ", items.one(), own + 1, shortened(name))
            }
            _ => format!("{} {}: ", items.one(), own + 1),
        },
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
    let Some((by, value, s, limits)) = worst else { return };
    let (before, knot) = (&curve.knots[index - 1], &curve.knots[index]);
    // A way that goes no further than its ends has their fault.
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
        (true, _) => "make it smaller, or let the group begin elsewhere".to_owned(),
        (false, u32::MAX) => fitting(curve, limits),
        (false, _) => "make it smaller, for example by `scale`".to_owned(),
    };
    let fault =
        Fault { code: Code::OutOfRange, place, size: by, said, expected: between(limits), hint: Some(hint) };
    on.add(findings, control_type, fault);
}

/// How a movement without items comes to lie within the limits: higher or lower, or smaller.
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
            "its values span {}, and the limits {room}: make it {part} times as large",
            figure(span)
        );
    }
    if limits.min_value > least {
        format!("move it up by {}", figure(limits.min_value - least))
    } else {
        format!("move it down by {}", figure(most - limits.max_value))
    }
}

/// A number to four decimals, without zeros at its end.
fn figure(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
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
