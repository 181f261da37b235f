//! Searches for changes that make an impossible group movement possible. A hint contains only changes that were tried successfully.

use std::collections::HashMap;

use urrcp::{ControlType, Span};

use super::Ground;
use crate::duration::written;
use crate::ensemble::{
    self, Action, Axis, Dancer, DancerMovement, Fault, Form, GroupTask, Sweep, Target, Together,
    WrittenFormation,
};
use crate::fleet::limits_of;
use crate::formation::{Formation, Point};
use crate::scenario::Cue;
use crate::shown::shortened;
use crate::transit::Required;

/// Maximum number of robots in all trials together, because the duration of a trial grows at least quadratically.
const ROBOTS_MAX: usize = 600;
/// Durations to try, as multiples of the given duration.
const LONGER: [f64; 5] = [1.25, 1.5, 2.0, 3.0, 4.0];
/// Sizes to try, as multiples of the smallest size that might suffice.
const LARGER: [f64; 5] = [1.0, 1.1, 1.25, 1.5, 2.0];
/// Sizes to try, as multiples of the largest size that might fit.
const SMALLER: [f64; 4] = [1.0, 0.97, 0.9, 0.75];
/// Distance beyond a device's limits that is ignored as a rounding error, in the unit of the device.
const ROUNDING: f64 = 1e-6;

/// A search for changes that make the movement of a group possible.
pub(super) struct Fixes<'f> {
    cue: &'f Cue,
    group: &'f Together,
    dancers: &'f [Dancer<'f>],
    ground: Ground<'f>,
    /// Number of remaining trials.
    left: usize,
}

impl<'f> Fixes<'f> {
    pub(super) fn of(
        cue: &'f Cue,
        group: &'f Together,
        dancers: &'f [Dancer<'f>],
        ground: Ground<'f>,
    ) -> Self {
        Self { cue, group, dancers, ground, left: ROBOTS_MAX / dancers.len().max(1) }
    }

    /// Returns a hint that lists all changes that were found to resolve the fault, one of each kind.
    pub(super) fn hint(mut self, fault: &Fault) -> Option<String> {
        let changes = match fault {
            Fault::TooShort { seconds, .. } => vec![self.longer(&[seconds / self.seconds()])],
            Fault::Crowded { distance, required, .. } if *distance > 0.0 => {
                vec![self.larger((required + self.stepped()) / distance)]
            }
            Fault::Blocked(blocked) => match blocked.required {
                Required::AtEnd { end, least } if end > 0.0 => {
                    vec![self.larger((least + self.stepped()) / end)]
                }
                Required::AtEnd { .. } => return None,
                _ => vec![self.longer(&LONGER), self.larger(1.05), self.by_way_of()],
            },
            _ => return None,
        };
        let changes: Vec<String> = changes.into_iter().flatten().collect();
        match changes.as_slice() {
            [] => None,
            [only] => Some(only.clone()),
            several => Some(format!("one of these is enough: {}", several.join("; "))),
        }
    }

    /// Suggests a change that keeps the ends of the movements within the limits of the devices.
    pub(super) fn within_limits(mut self, ways: &[DancerMovement]) -> Option<String> {
        match &self.group.action {
            Action::Form(Form { to: Target::Formation(_), .. }) => {
                let middle = self.formation()?.0.placing.middle_on_stage();
                let part = self.part_within(ways, |_, axis| middle[axis]).filter(|part| *part > 0.0)?;
                self.smaller(part)
            }
            Action::Sweep(sweep) if sweep.turns == 0.0 && sweep.along.is_none() => {
                let part =
                    self.part_within(ways, |dancer, axis| dancer.from[axis]).filter(|part| *part >= 0.0)?;
                let less = |value: f64| rounded(value, f64::trunc);
                match (sweep.grow == 1.0, sweep.shift == [0.0; 3]) {
                    (true, false) => {
                        let [x, y, z] = sweep.shift.map(|along| less(along * part));
                        Some(format!("use at most `shift: [{x}, {y}, {z}]`"))
                    }
                    (false, true) => Some(format!("use at most `grow: {}`", grown(sweep, part))),
                    _ => None,
                }
            }
            _ => None,
        }
    }

    /// Returns the distance, in metres, by which the deviations of steps may bring two bodies closer to each other.
    fn stepped(&self) -> f64 {
        let error = |dancer: &Dancer<'_>| {
            let axes = dancer.axes.iter().map(|axis| axis.error(self.cue.tolerance).powi(2));
            axes.sum::<f64>().sqrt()
        };
        2.0 * self.dancers.iter().map(error).fold(0.0, f64::max)
    }

    fn seconds(&self) -> f64 {
        self.group.over.as_millis_f64() / 1_000.0
    }

    /// Returns the largest share of all movements that ends within the limits of all devices; 1 if the whole movements do. The share of a
    /// movement counts from the coordinate that `from` returns. `None` if the share is not finite.
    fn part_within(&self, ways: &[DancerMovement], from: impl Fn(&Dancer<'_>, usize) -> f64) -> Option<f64> {
        let mut least = 1.0f64;
        for (dancer, moved) in self.dancers.iter().zip(ways) {
            let end = moved.end();
            for (axis, to) in end.into_iter().enumerate() {
                let Some([low, high]) = ends(&dancer.axes[axis]) else { continue };
                let (from, bound) = (from(dancer, axis), if to > high { high } else { low });
                if to > high || to < low {
                    least = least.min((bound - from) / (to - from));
                }
            }
        }
        least.is_finite().then_some(least)
    }

    /// Returns the target formation, the key that defines its size, and the size.
    fn formation(&self) -> Option<(&'f Formation, &'static str, f64)> {
        let Action::Form(Form { to: Target::Formation(name), .. }) = &self.group.action else { return None };
        let written = self.ground.of_scenario.formations.get(name)?;
        let (key, size) = written.size;
        Some((written.formation.as_ref()?, key, size))
    }

    /// Suggests a sufficient size of the formation, at least `factor` times the written one, and more time if that is needed.
    fn larger(&mut self, factor: f64) -> Option<String> {
        self.resized(&LARGER.map(|more| factor * more), f64::ceil, |edit| format!("use {edit}"))
    }

    /// Suggests a size of the formation that fits, at most `part` of the written one.
    fn smaller(&mut self, part: f64) -> Option<String> {
        self.resized(&SMALLER.map(|factor| part * factor), f64::floor, |edit| format!("use at most {edit}"))
    }

    fn resized(
        &mut self,
        factors: &[f64],
        round: fn(f64) -> f64,
        told: impl Fn(&str) -> String,
    ) -> Option<String> {
        let (_, key, size) = self.formation()?;
        for factor in factors {
            let new = rounded(size * factor, round);
            if let Some(over) = self.tried(new / size) {
                return Some(if over == self.group.over {
                    told(&format!("`{key}: {new}`"))
                } else {
                    format!("{} with `over: {}`", told(&format!("`{key}: {new}`")), written(over))
                });
            }
        }
        None
    }

    /// Returns the time within which the group can take the formation at `factor` times its size. This is the given time or, if that is
    /// too short, the shortest sufficient one.
    fn tried(&mut self, factor: f64) -> Option<Span> {
        let mut over = self.group.over;
        for _ in 0..2 {
            match self.ways(factor, over)? {
                Ok(()) => return Some(over),
                Err(Fault::TooShort { seconds, .. }) => over = up(seconds),
                Err(_) => return None,
            }
        }
        None
    }

    /// Suggests a duration that suffices, among the multiples `factors` of the given duration.
    fn longer(&mut self, factors: &[f64]) -> Option<String> {
        let overs = factors.iter().map(|factor| up(self.seconds() * factor)).collect::<Vec<_>>();
        let over = overs.into_iter().find(|over| matches!(self.ways(1.0, *over), Some(Ok(()))))?;
        Some(format!("use `over: {}`", written(over)))
    }

    /// Suggests another formation that the group can take first, and from which it can then make the movement.
    fn by_way_of(&mut self) -> Option<String> {
        let (target, _) = self.target()?;
        let mut names: Vec<&String> = self.ground.of_scenario.formations.keys().collect();
        names.sort_unstable();
        names.into_iter().filter(|name| **name != target).find_map(|name| {
            let first = self.to(name);
            let there = self.trial(&first, self.dancers, self.ground.of_scenario.formations)?.ok()?;
            let between: Vec<Dancer<'_>> =
                self.dancers.iter().zip(&there).map(|(dancer, moved)| at(dancer, moved.end())).collect();
            self.trial(self.group, &between, self.ground.of_scenario.formations)?.ok()?;
            Some(format!(
                "form `{0}` on the way: add a cue with `form: {0}` and the same `over` before this one",
                shortened(name)
            ))
        })
    }

    fn target(&self) -> Option<(String, &'f Form)> {
        match &self.group.action {
            Action::Form(form @ Form { to: Target::Formation(name), .. }) => Some((name.clone(), form)),
            Action::Form(form) => Some((String::new(), form)),
            Action::Sweep(_) => None,
        }
    }

    fn to(&self, name: &str) -> Together {
        let mut together = self.group.clone();
        if let Action::Form(form) = &mut together.action {
            form.to = Target::Formation(name.to_owned());
        }
        together
    }

    /// Tries the group's movement in the time `over`, with the formation scaled by `factor`. `None` if no trials are left.
    fn ways(&mut self, factor: f64, over: Span) -> Option<Result<(), Fault>> {
        let together = Together { over, ..self.group.clone() };
        let mut formations: HashMap<String, WrittenFormation> = HashMap::new();
        if let Some((name, _)) = self.target()
            && let Some(written) = self.ground.of_scenario.formations.get(&name)
        {
            let mut written = written.clone();
            if let Some(formation) = &mut written.formation {
                formation.placing = formation.placing.scaled(factor);
            }
            formations.insert(name, written);
        }
        Some(self.trial(&together, self.dancers, &formations)?.map(drop))
    }

    fn trial(
        &mut self,
        together: &Together,
        dancers: &[Dancer<'_>],
        formations: &HashMap<String, WrittenFormation>,
    ) -> Option<Result<Vec<DancerMovement>, Fault>> {
        self.left = self.left.checked_sub(1)?;
        let ground = ensemble::Ground { formations, ..self.ground.of_scenario };
        let asked = GroupTask { together, tolerance: self.cue.tolerance };
        let ways = ensemble::ways(asked, dancers, ground);
        Some(ways.and_then(|ways| if self.are_within(&ways) { Ok(ways) } else { Err(Fault::ToldElsewhere) }))
    }

    /// Whether all movements of the group end within the limits of its devices.
    pub(super) fn are_within(&self, ways: &[DancerMovement]) -> bool {
        self.dancers.iter().zip(ways).all(|(dancer, moved)| {
            let within = |(axis, to): (&Axis<'_>, f64)| {
                ends(axis).is_none_or(|[low, high]| to >= low - ROUNDING && to <= high + ROUNDING)
            };
            dancer.axes.iter().zip(moved.end()).all(within)
        })
    }
}

/// Returns the `grow` factor for a sweep that grows or shrinks by only the share `part` of the written change.
fn grown(sweep: &Sweep, part: f64) -> f64 {
    let factor = 1.0 + (sweep.grow - 1.0) * part;
    rounded(factor, if sweep.grow > 1.0 { f64::floor } else { f64::ceil })
}

/// Returns a copy of a robot that begins at another place.
fn at<'d>(dancer: &Dancer<'d>, from: Point) -> Dancer<'d> {
    let Dancer { robot, delay, body, axes, .. } = *dancer;
    Dancer { robot, delay, body, axes, from }
}

/// Returns the smallest and the largest coordinate that an axis can reach, in metres.
fn ends(axis: &Axis<'_>) -> Option<[f64; 2]> {
    let Axis::Moved { device, scale, offset, .. } = *axis else { return None };
    let all = limits_of(device, ControlType::Position).map(|limits| [limits.min_value, limits.max_value]);
    let [low, high] = all.reduce(|a, b| [a[0].max(b[0]), a[1].min(b[1])])?;
    let ends = [offset + scale * low, offset + scale * high];
    Some(if scale < 0.0 { [ends[1], ends[0]] } else { ends })
}

/// Rounds seconds up to two decimals.
pub(super) fn up(seconds: f64) -> Span {
    Span::from_millis_f64((seconds * 100.0 - 1e-6).ceil() * 10.0)
}

/// Rounds a value to three significant digits with `round`.
fn rounded(value: f64, round: fn(f64) -> f64) -> f64 {
    let scale = 10f64.powf(2.0 - value.abs().log10().floor());
    // A number that already has three digits remains unchanged, regardless of its last bit.
    let near = (value * scale).round();
    let scaled = if (near - value * scale).abs() < 1e-6 { near } else { round(value * scale) };
    let rounded = (scaled / scale * 1e9).round() / 1e9 + 0.0;
    if rounded.is_finite() { rounded } else { value + 0.0 }
}
