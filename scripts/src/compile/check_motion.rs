//! Checks the speed and acceleration of a movement against the limits of its device.

use std::collections::{HashMap, HashSet};

use urrcp::{ControlType, Interpolation, Span};

use super::check_values::{item_place, named, tidy, way_place};
use super::perform::{Fault, OnDevice};
use crate::duration;
use crate::fields::Reader;
use crate::finding::Code;
use crate::motion::{Between, Curve, Easing, Knot, Shape};

/// Factor by which a speed or acceleration may exceed its limit because of rounding errors.
const DUST: f64 = 1.0 + 1e-6;

/// Checks the first and second derivative in each section (part between two knots).
///
/// In a section with linear motion, the device moves at the section's mean speed. Where two such sections meet, the acceleration is the
/// change of speed divided by the mean of their lengths (the second divided difference).
///
/// Returns the largest show speed factor (speed of the show relative to the file) at which the movement stays within these limits.
pub(super) fn check(
    findings: &mut Reader,
    on: &OnDevice<'_>,
    control_type: ControlType,
    curve: &Curve,
) -> f64 {
    jumps(findings, on, control_type, curve);
    let limits = on.cast.limits(on.robots[0], on.device, control_type);
    let mut factor_max = f64::INFINITY;
    if limits.speed.is_none() && limits.acceleration.is_none() {
        return factor_max;
    }
    let mut seen = HashSet::new();
    let mut before: Option<(f64, f64)> = None;
    let peaks = curve.peaks();
    for index in 1..curve.knots.len() {
        let (last, knot) = (&curve.knots[index - 1], &curve.knots[index]);
        let seconds = (knot.at - last.at).as_millis_f64() / 1_000.0;
        if seconds <= 0.0 {
            before = None;
            continue;
        }
        let (speed, mut acceleration) = curve.peak_rates(index, &peaks);
        let linear = matches!(knot.shape, Shape::Own | Shape::Sampled(Between::Own | Between::Linear));
        let own = ((knot.to - last.to) / seconds, seconds);
        if let (true, Some((speed_before, seconds_before))) = (linear, before) {
            acceleration = (own.0 - speed_before).abs() / ((own.1 + seconds_before) / 2.0);
        }
        before = linear.then_some(own);
        let names = match control_type {
            ControlType::Speed => ["an acceleration", "a jerk"],
            _ => ["a speed", "an acceleration"],
        };
        let asked = [
            Rate { code: Code::TooFast, name: names[0], found: speed, limit: limits.speed },
            Rate { code: Code::TooSudden, name: names[1], found: acceleration, limit: limits.acceleration },
        ];
        factor_max = asked.iter().map(|rate| rate.factor_max(control_type)).fold(factor_max, f64::min);
        let broken: Vec<Rate> = asked
            .into_iter()
            .filter(|rate| rate.is_broken() && seen.insert((rate.code, knot.item)))
            .collect();
        if !broken.is_empty() {
            too_much(findings, on, control_type, [last, knot], &broken);
        }
    }
    factor_max
}

/// A derivative of a movement, with the device's limit on it.
struct Rate {
    code: Code,
    name: &'static str,
    found: f64,
    limit: Option<f64>,
}

impl Rate {
    fn is_broken(&self) -> bool {
        self.limit.is_some_and(|limit| self.found > limit * DUST)
    }

    /// Returns the largest show speed factor (speed of the show relative to the file) at which the rate stays within its limit. Speeds
    /// are proportional to the factor, accelerations to its square.
    fn factor_max(&self, control_type: ControlType) -> f64 {
        let room = self.limit.filter(|_| self.found > 0.0).map_or(f64::INFINITY, |limit| limit / self.found);
        let is_speed = control_type == ControlType::Position && self.code == Code::TooFast;
        if is_speed { room } else { room.sqrt() }
    }

    /// Returns the factor by which the movement must be longer to stay within the limit.
    fn longer(&self) -> f64 {
        let over = self.limit.map_or(1.0, |limit| self.found / limit);
        if self.code == Code::TooFast { over } else { over.sqrt() }
    }
}

/// Reports all limits that a section between two knots exceeds in a single finding. The finding suggests a duration that satisfies all of
/// them.
fn too_much(
    findings: &mut Reader,
    on: &OnDevice<'_>,
    control_type: ControlType,
    [last, knot]: [&Knot; 2],
    broken: &[Rate],
) {
    let Some(worst) = broken.iter().max_by(|a, b| a.longer().total_cmp(&b.longer())) else { return };
    let list = |of: fn(&Rate) -> String| broken.iter().map(of).collect::<Vec<_>>().join(" and ");
    let length = knot.at - last.at;
    let said = format!(
        "{}moving from {} to {} in {length} requires {}, for ",
        named(on.track, knot.item),
        tidy(last.to),
        tidy(knot.to),
        list(|rate| format!("{} of {:.4}", rate.name, rate.found)),
    );
    let needed = duration::seconds(length.as_millis_f64() / 1_000.0 * worst.longer());
    let hint = format!("allow {needed} instead of {}, or use a shorter path", duration::written(length));
    let fault = Fault {
        code: worst.code,
        place: way_place(on.track, knot.item),
        size: worst.longer(),
        said,
        expected: format!("at most {}", list(|rate| rate.limit.unwrap_or_default().to_string())),
        hint: Some(hint),
    };
    on.add(findings, control_type, fault);
}

/// Reports instants at which a linear device would have to be in two positions: where a repeated movement does not end where it begins,
/// or where pieces do not meet. Reports each jump once, regardless of the number of repetitions.
fn jumps(findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType, curve: &Curve) {
    if on.device.interpolation != Interpolation::Linear || control_type != ControlType::Position {
        return;
    }
    let own = on.device.available_control_types.limits(control_type);
    let small = own.map_or(0.0, |limits| limits.max_error.unwrap_or(0.0).max(limits.granularity));
    let small = on.track.tolerance.map_or(small, |tolerance| tolerance.max(small));
    let steps = curve.knots.windows(2).filter_map(|pair| Jump::of(&pair[0], &pair[1], small));
    let mut seen: HashMap<(u32, u64, u64), usize> = HashMap::new();
    let mut jumps: Vec<(Jump, usize)> = Vec::new();
    for jump in steps {
        let key = (jump.item, jump.from.to_bits(), jump.to.to_bits());
        match seen.get(&key) {
            Some(known) => jumps[*known].1 += 1,
            None => {
                seen.insert(key, jumps.len());
                jumps.push((jump, 1));
            }
        }
    }
    let limit = on.cast.limits(on.robots[0], on.device, control_type).speed;
    for (jump, times) in jumps {
        jump.tell(findings, on, control_type, limit, times);
    }
}

/// An instantaneous change of value.
struct Jump {
    from: f64,
    to: f64,
    at: Span,
    item: u32,
}

impl Jump {
    fn of(before: &Knot, after: &Knot, small: f64) -> Option<Self> {
        let (from, to, item) = (before.to, after.to, after.item);
        let at = match after.shape {
            Shape::Early | Shape::Sampled(Between::Early) => before.at,
            Shape::Eased(Easing::Step) | Shape::Sampled(Between::Step) => after.at,
            _ if before.at == after.at => after.at,
            _ => return None,
        };
        ((to - from).abs() > small).then_some(Self { from, to, at, item })
    }

    fn tell(
        &self,
        findings: &mut Reader,
        on: &OnDevice<'_>,
        control_type: ControlType,
        limit: Option<f64>,
        times: usize,
    ) {
        let (from, to, at) = (tidy(self.from), tidy(self.to), self.at);
        let often = match times {
            1 => String::new(),
            _ => format!(" and again later, {times} times in total"),
        };
        let said = format!(
            "{}the movement jumps from {from} to {to} at {at}{often}, for ",
            named(on.track, self.item)
        );
        let (code, expected, hint) = match limit {
            Some(limit) => {
                let seconds = (self.to - self.from).abs() / limit;
                let hint = format!(
                    "allow {} for the change, or use the same value before and after it",
                    duration::seconds(seconds)
                );
                (Code::TooFast, format!("a speed of at most {limit}"), hint)
            }
            None => {
                let hint = "end a repeated movement at its start value, and start each piece at the end value of the previous piece".to_owned();
                (Code::Jump, "a movement without jumps".to_owned(), hint)
            }
        };
        let (place, size) = (item_place(on.track, self.item), (self.to - self.from).abs());
        on.add(findings, control_type, Fault { code, place, size, said, expected, hint: Some(hint) });
    }
}
