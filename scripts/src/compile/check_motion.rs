//! Speed and acceleration of a movement against what the device can do.

use std::collections::HashSet;

use urrcp::{ControlType, Interpolation};

use super::check_values::{item_place, tidy};
use super::perform::OnDevice;
use crate::fields::Reader;
use crate::finding::Code;
use crate::motion::{Curve, Shape};

/// What rounding may add to a rate.
const DUST: f64 = 1.0 + 1e-6;

/// Checks the first and second derivative on every way between two knots.
///
/// A way that the device moves linearly has its mean speed; where two such ways meet, the acceleration is the change of
/// speed over the mean of their lengths (the second divided difference).
pub(super) fn check(findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType, curve: &Curve) {
    jumps(findings, on, control_type, curve);
    let limits = on.cast.limits(on.robots[0], on.device, control_type);
    if limits.speed.is_none() && limits.acceleration.is_none() {
        return;
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
        let linear = matches!(knot.shape, Shape::Own | Shape::Sampled);
        let own = ((knot.to - last.to) / seconds, seconds);
        if let (true, Some((speed_before, seconds_before))) = (linear, before) {
            acceleration = (own.0 - speed_before).abs() / ((own.1 + seconds_before) / 2.0);
        }
        before = linear.then_some(own);
        let names = match control_type {
            ControlType::Speed => ["an acceleration", "a jerk"],
            _ => ["a speed", "an acceleration"],
        };
        let checks =
            [(limits.speed, speed, Code::TooFast), (limits.acceleration, acceleration, Code::TooSudden)];
        for ((limit, found, code), name) in checks.into_iter().zip(names) {
            let Some(limit) = limit.filter(|limit| found > limit * DUST) else { continue };
            if !seen.insert((code, knot.item)) {
                continue;
            }
            let message = format!(
                "{}from {} to {} in {} needs {name} of {:.4}, for {}",
                if knot.item == u32::MAX { String::new() } else { format!("keyframe {}: ", knot.item) },
                tidy(last.to),
                tidy(knot.to),
                knot.at - last.at,
                found,
                on.who(control_type)
            );
            let longer = if code == Code::TooFast { found / limit } else { (found / limit).sqrt() };
            let hint = format!("give it {:.3} s instead of {seconds} s, or less way", seconds * longer);
            findings.add(
                code,
                item_place(on.track, knot.item),
                message,
                format!("at most {limit}"),
                Some(hint),
            );
        }
    }
}

/// Where a device that moves linearly is told to be at two places at once: a movement that is repeated and does not end as
/// it begins, or pieces that do not meet. Told once for each track.
fn jumps(findings: &mut Reader, on: &OnDevice<'_>, control_type: ControlType, curve: &Curve) {
    if on.device.interpolation != Interpolation::Linear || control_type != ControlType::Position {
        return;
    }
    let own = on.device.available_control_types.limits(control_type);
    let small = own.map_or(0.0, |limits| limits.max_error.unwrap_or(0.0).max(limits.granularity));
    let jump = curve
        .knots
        .windows(2)
        .find(|pair| pair[0].at == pair[1].at && (pair[1].to - pair[0].to).abs() > small);
    if let Some([before, after]) = jump {
        let message = format!(
            "the movement jumps from {} to {} at {}, for {}",
            tidy(before.to),
            tidy(after.to),
            after.at,
            on.who(control_type)
        );
        let hint = Some("let what is repeated end where it begins, and pieces meet".to_owned());
        findings.add(Code::Jump, item_place(on.track, after.item), message, "a movement without jumps", hint);
    }
}
