//! Computes the movements of each robot in a cue: turns its tracks into steps on its devices.

mod group;

use std::borrow::Cow;
use std::cell::OnceCell;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use urrcp::{ControlParameters, ControlType, Device, Limits, RobotId, Span};

use super::cast::{Cast, Member, Members};
use super::schedule::CueTime;
use super::segment::{Excess, Segment, Steps, TrackSteps};
use super::vectors::{self, Thinned};
use super::{check_motion, check_values};
use crate::budget::{Budget, STEPS_MAX, USES_MAX};
use crate::composed::is_same;
use crate::fields::Reader;
use crate::finding::{Code, Place, SharedFault, names, one_of};
use crate::fleet::{RateLimits, settable_limits};
use crate::motion::{Actuator, Curve, Fits, Played, Stretch};
use crate::plan::PlannedReading;
use crate::scenario::{Cue, Motion, OffGrid, Reading, Track, Vectors};
use crate::shown::shortened;

/// Largest number of steps that findings report exactly, even if it exceeds the capacity of the device.
const TOLD_MAX: usize = 1_000_000;

pub(super) use group::Ground;

/// A bound, in units of a device, that exceeds every value of a compiled movement.
const FAR: f64 = 1e9;
/// Maximum number of tolerances that are tried before a hint suggests one.
const TOLERANCES_MAX: usize = 16;

/// Collects the movements of all cues of an act.
pub(super) struct Performer<'c, 'a> {
    findings: &'c mut Reader,
    cast: &'c Cast<'a>,
    fits: &'c mut Fits,
    /// Time by which every cue must have ended.
    horizon: Span,
    /// Segments of each device, sorted by (robot, device).
    pub(super) segments: std::collections::BTreeMap<(usize, usize), Vec<Segment>>,
    pub(super) readings: Vec<PlannedReading>,
    /// Robots for which a movement is missing because of an error, so that their positions are unknown.
    pub(super) incomplete: HashSet<usize>,
    /// Budget for the steps of all movements of the act. Robots that share a movement count once.
    steps: Budget,
    /// Budget for the segments in `segments`.
    uses: Budget,
}

/// Robots of one kind that play the same movement in a cue.
struct Alike {
    movement: usize,
    members: Vec<Member>,
}

/// Robots that have the same device under a certain name.
struct Class<'a> {
    index: usize,
    device: &'a Device,
    limits: RateLimits,
    members: Vec<Member>,
}

/// A track on a device of one or more robots.
pub(super) struct OnDevice<'p> {
    pub(super) cue: &'p Cue,
    pub(super) track: &'p Track,
    pub(super) device: &'p Device,
    pub(super) robots: &'p [usize],
    pub(super) cast: &'p Cast<'p>,
    ids: OnceCell<Arc<[RobotId]>>,
}

/// A movement that does not stay within its tolerance with at most `most` steps.
struct TooFew {
    most: usize,
    /// The number of steps that the movement needs; at most `most` if that many steps are possible, but too inaccurate.
    needed: usize,
    /// The largest error with `most` steps, and its time.
    worst: f64,
    worst_at: Span,
    allowed: f64,
}

/// A fault in the movement of a device.
pub(super) struct Fault {
    pub(super) code: Code,
    pub(super) place: Place,
    /// Size of the fault. If several faults have the same place and limit, only the largest one is described.
    pub(super) size: f64,
    /// The first part of the message, up to and including a phrase such as `position of `elbow` on `arm-1``.
    pub(super) said: String,
    pub(super) expected: String,
    pub(super) hint: Option<String>,
}

impl<'p> OnDevice<'p> {
    fn new(
        cue: &'p Cue,
        track: &'p Track,
        device: &'p Device,
        robots: &'p [usize],
        cast: &'p Cast<'p>,
    ) -> Self {
        Self { cue, track, device, robots, cast, ids: OnceCell::new() }
    }

    /// Returns the ids of the robots. They are created once, and all faults share them.
    fn ids(&self) -> Arc<[RobotId]> {
        self.ids.get_or_init(|| self.cast.ids(self.robots)).clone()
    }

    /// Describes what moves, for example `position of `elbow` on `arm-1``.
    pub(super) fn who(&self, control_type: ControlType) -> String {
        format!("{control_type} of `{}` on {}", self.device.id, self.cast.names(self.robots))
    }

    /// Reports a fault of the device on these robots.
    pub(super) fn add(&self, findings: &mut Reader, control_type: ControlType, fault: Fault) {
        let Fault { code, place, size, said, expected, hint } = fault;
        // All coordinates of a group share one cause, and so do all cues with the same formation.
        let cause = match self.cue.group.as_ref().filter(|group| group.place == place) {
            Some(group) => group.formation().map_or_else(|| format!("{place:?}"), str::to_owned),
            None => format!("{place:?} {} {expected}", self.device.id),
        };
        findings.add_shared(SharedFault {
            code,
            cause,
            size,
            device: self.device.id.to_string(),
            robots: self.ids(),
            place,
            message: [format!("{said}{control_type} of `{}` on ", self.device.id), String::new()],
            expected,
            hint,
        });
    }
}

impl<'c, 'a> Performer<'c, 'a> {
    pub(super) fn new(
        findings: &'c mut Reader,
        cast: &'c Cast<'a>,
        fits: &'c mut Fits,
        horizon: Span,
    ) -> Self {
        let (segments, readings) = (std::collections::BTreeMap::new(), Vec::new());
        let (steps, uses) = (Budget::new(STEPS_MAX), Budget::new(USES_MAX));
        let incomplete = HashSet::new();
        Self { findings, cast, fits, horizon, segments, readings, incomplete, steps, uses }
    }

    /// Number of steps created so far, counted as steps with one value.
    pub(super) const fn steps_taken(&self) -> usize {
        self.steps.most() - self.steps.left()
    }

    pub(super) fn cue(&mut self, cue: &Cue, members: &Members, time: &CueTime) {
        let mut alike: Vec<Alike> = Vec::new();
        let mut index_of: HashMap<(usize, usize), usize> = HashMap::new();
        for member in &members.all {
            let key = (member.movement, self.cast.kind(member.robot));
            let at = *index_of.entry(key).or_insert_with(|| {
                alike.push(Alike { movement: key.0, members: Vec::new() });
                alike.len() - 1
            });
            alike[at].members.push(*member);
        }
        let name: Arc<str> = cue.name.as_str().into();
        self.missing_devices(cue, &alike);
        let mut movements: Vec<usize> = alike.iter().map(|group| group.movement).collect();
        movements.sort_unstable();
        movements.dedup();
        for movement in movements {
            let groups: Vec<&Alike> = alike.iter().filter(|group| group.movement == movement).collect();
            self.movement(cue, &name, &groups, time);
        }
        self.readings(cue, members, time);
    }

    /// Reports each device that a movement needs but some of its robots lack. A device is reported only once, even if robots of several
    /// kinds lack it.
    fn missing_devices(&mut self, cue: &Cue, alike: &[Alike]) {
        let mut missing: Vec<(&Track, Vec<&Alike>)> = Vec::new();
        let mut index_of: HashMap<&Place, usize> = HashMap::new();
        for group in alike {
            let first = group.members[0];
            for track in &cue.movement_of(&first).tracks {
                if self.cast.device(first.robot, &track.device).is_some() {
                    continue;
                }
                let at = *index_of.entry(&track.place).or_insert_with(|| {
                    missing.push((track, Vec::new()));
                    missing.len() - 1
                });
                missing[at].1.push(group);
            }
        }
        for (track, groups) in missing {
            let members = groups.iter().flat_map(|group| &group.members);
            let robots: Vec<usize> = members.map(|member| member.robot).collect();
            self.incomplete.extend(&robots);
            let known = || self.cast.devices(robots[0]).iter().map(|device| device.id.as_str());
            let after = track.device.rsplit(['/', '.']).next().unwrap_or_default();
            let hint = if known().any(|known| known == after) {
                Some(format!(
                    "list the robot under `robots`, and write only the device here: `{}`",
                    shortened(after)
                ))
            } else {
                self.findings.did_you_mean(&track.device, known())
            };
            let expected = one_of(known());
            // The track may belong to a move that several cues play.
            self.findings.add_shared(SharedFault {
                code: Code::UnknownDevice,
                cause: format!("{:?} {expected}", track.place),
                size: 0.0,
                device: String::new(),
                robots: robots.iter().map(|robot| self.cast.id(*robot).clone()).collect(),
                place: track.place.clone(),
                message: [String::new(), format!(" has|have no device `{}`", shortened(&track.device))],
                expected,
                hint,
            });
        }
    }

    /// Compiles the tracks of one movement. Each track is compiled once for all robots with the same device.
    fn movement(&mut self, cue: &Cue, name: &Arc<str>, groups: &[&Alike], time: &CueTime) {
        let first = &groups[0].members[0];
        for track in &cue.movement_of(first).tracks {
            for class in self.classes(track, groups) {
                let robots: Vec<usize> = class.members.iter().map(|member| member.robot).collect();
                let on = OnDevice::new(cue, track, class.device, &robots, self.cast);
                let part = if self.uses.is_overdrawn() { None } else { self.part(&on, time.stretch) };
                let Some(part) = part.filter(|_| self.used(cue, class.members.len())) else {
                    self.incomplete.extend(robots);
                    continue;
                };
                let part = Arc::new(part);
                for member in class.members {
                    let segment = Segment {
                        begin: time.start + member.delay + time.stretch.of(track.starts),
                        cue: name.clone(),
                        stop_condition: cue.stop_condition,
                        part: part.clone(),
                    };
                    self.segments.entry((member.robot, class.index)).or_default().push(segment);
                }
            }
        }
    }

    /// Whether the budget has room for one more movement of `robots` robots. Reports the first cue that exceeds the budget.
    fn used(&mut self, cue: &Cue, robots: usize) -> bool {
        let told = self.uses.is_overdrawn();
        let sound = self.uses.take(robots);
        if !sound && !told {
            let most = self.uses.most();
            let message = format!(
                "with the cue `{}`, the act moves devices more than {most} times",
                shortened(&cue.name)
            );
            let hint = Some("split the act or the scenario into several".to_owned());
            self.findings.add(Code::TooMuch, cue.place.clone(), message, format!("at most {most}"), hint);
        }
        sound
    }

    fn classes(&self, track: &Track, groups: &[&Alike]) -> Vec<Class<'a>> {
        let mut classes: Vec<Class<'a>> = Vec::new();
        for group in groups {
            let robot = group.members[0].robot;
            let devices = self.cast.devices(robot);
            let Some(index) = devices.iter().position(|device| is_same(device.id.as_str(), &track.device))
            else {
                continue;
            };
            let (device, limits) = (&devices[index], self.cast.given_limits(robot, &devices[index]));
            let same = |class: &&mut Class<'a>| {
                class.index == index && class.limits == limits && *class.device == *device
            };
            match classes.iter_mut().find(same) {
                Some(class) => class.members.extend(&group.members),
                None => classes.push(Class { index, device, limits, members: group.members.clone() }),
            }
        }
        classes
    }

    fn part(&mut self, on: &OnDevice<'_>, stretch: Stretch) -> Option<TrackSteps> {
        if self.steps.is_overdrawn() {
            return None;
        }
        let control_type = self.control_type(on)?;
        let curve = match &on.track.motion {
            Motion::Vectors(vectors) => return self.vectors(on, control_type, vectors, stretch),
            Motion::Curve(curve) => curve,
        };
        if let ControlType::Custom(_) = control_type
            && !matches!(
                on.device.available_control_types.get(control_type),
                Some(ControlParameters::Custom(_))
            )
        {
            return None;
        }
        let curve = stretched(curve, stretch, on.track.starts);
        let curve = curve.as_ref();
        let limits = settable_limits(on.device, control_type);
        let actuator =
            Actuator::new(on.device, control_type, limits.as_ref(), room(on.device, self.steps.left()));
        let before = self.findings.errors();
        let set = check_values::check(self.findings, on, control_type, curve);
        let played = Played::new(curve, set);
        let sound = self.findings.errors() == before;
        let factor_max = check_motion::check(self.findings, on, control_type, &played.as_set());
        self.check_beginning(on, &actuator, curve);
        curve.knots.first()?;
        let part = self.fitted(on, &actuator, &played, sound)?;
        Some(TrackSteps { factor_max, ..part })
    }

    /// Fits steps to a movement: as few as the tolerance permits or, if the track sets a number of steps, those with the least error.
    /// Values that are already reported as invalid (`sound` is `false`) cause no further findings.
    fn fitted(
        &mut self,
        on: &OnDevice<'_>,
        actuator: &Actuator<'_>,
        played: &Played<'_>,
        sound: bool,
    ) -> Option<TrackSteps> {
        let own = actuator.tolerance();
        // A movement outside the limits cannot be approximated by steps within them, and finding the best approximation takes long.
        let widened = actuator.limits.map(|limits| Limits { min_value: -FAR, max_value: FAR, ..*limits });
        let unlimited = Actuator { limits: widened.as_ref(), ..*actuator };
        let actuator = if sound { actuator } else { &unlimited };
        let thinned = on.track.tolerance.is_some() || on.track.steps_max.is_some();
        let mut tolerance = on.track.tolerance.unwrap_or(own);
        let mut fitted = actuator.steps(played, tolerance, thinned, self.fits);
        let steps_max = on.track.steps_max.map(|most| most as usize);
        if let Some(most) = steps_max {
            (tolerance, fitted) = actuator.least_error(played, tolerance, most, self.fits);
        }
        if !self.taken(on, fitted.steps.len(), fitted.steps.len()) {
            return None;
        }
        if let Some(most) = steps_max {
            let allowed = on.track.tolerance.unwrap_or(own);
            if fitted.steps.len() > most || fitted.worst > allowed * (1.0 + 1e-9) {
                let (worst, worst_at) = (fitted.worst, fitted.worst_at);
                self.too_few_steps(on, TooFew { most, needed: fitted.steps.len(), worst, worst_at, allowed });
            }
        } else if let Some(needed) = fitted.needed.filter(|_| sound) {
            let needed = self.enough(actuator, played, thinned, needed);
            let device = on.device.id.to_string();
            let grid = format!("the {} grid of `{device}` on ", actuator.control_type);
            self.findings.add_shared(SharedFault {
                code: Code::ToleranceTooTight,
                cause: format!("{:?} {device} {tolerance}", on.track.place),
                size: needed,
                device,
                robots: on.ids(),
                place: on.track.place.clone(),
                message: [grid, format!(" is too coarse to follow the movement within {tolerance}")],
                expected: format!("a tolerance of {needed} or more"),
                hint: Some(format!("add `tolerance: {needed}` to the track, if this error is acceptable")),
            });
        }
        Some(TrackSteps {
            control_type: actuator.control_type,
            // That a movement has no first value is already reported.
            moves_from_anywhere: actuator.moves_from_anywhere(played.curve)
                || actuator.lacks_beginning(played.curve),
            length: played.curve.length(),
            at_least: fitted.at_least,
            worst: fitted.worst,
            worst_at: fitted.worst_at,
            tolerance,
            factor_max: f64::INFINITY,
            excess: Excess::of(on.track),
            items: on.track.items,
            place: on.track.place.clone(),
            steps: Steps::One(fitted.steps),
        })
    }

    /// Returns a tolerance, at least `needed`, within which steps can follow the movement. With a larger tolerance, the movement is
    /// sampled less densely, which may require an even larger tolerance.
    fn enough(&mut self, actuator: &Actuator<'_>, played: &Played<'_>, thinned: bool, needed: f64) -> f64 {
        let mut tolerance = rounded_up(needed);
        for _ in 0..TOLERANCES_MAX {
            let Some(more) = actuator.steps(played, tolerance, thinned, self.fits).needed else { break };
            tolerance = rounded_up(more.max(tolerance * 1.001));
        }
        tolerance
    }

    /// Whether the budget has room for a movement of `steps` steps, which take as much memory as `size` steps with one value.
    fn taken(&mut self, on: &OnDevice<'_>, steps: usize, size: usize) -> bool {
        let (place, capacity) = (on.track.place.clone(), capacity(on.device));
        if steps > capacity.max(TOLD_MAX) {
            let message = format!(
                "the movement of `{}` on {} needs more than {} steps",
                on.device.id,
                on.cast.names(on.robots),
                steps - 1
            );
            let expected = format!("at most {capacity} steps (max_number_of_steps, script_queue)");
            let hint = Some("repeat it less often, or allow a larger error with `tolerance`".to_owned());
            self.findings.add(Code::TooManySteps, place, message, expected, hint);
            return false;
        }
        let sound = self.steps.take(size);
        if !sound {
            let most = self.steps.most();
            let message = format!("with this movement, the act has more than {most} steps");
            let hint = Some("split the scenario into several scenarios".to_owned());
            self.findings.add(Code::TooMuch, place, message, format!("at most {most}"), hint);
        }
        sound
    }

    fn too_few_steps(&mut self, on: &OnDevice<'_>, fault: TooFew) {
        let TooFew { most, needed, worst, worst_at, allowed } = fault;
        let place = on.track.place.clone();
        if needed > most {
            let message = format!("the movement needs at least {needed} steps");
            let hint = Some("allow more steps, or remove keyframes".to_owned());
            self.findings.add(
                Code::ToleranceTooTight,
                place,
                message,
                format!("at most {most} (max_steps)"),
                hint,
            );
            return;
        }
        let worst = rounded_up(worst);
        let message = format!("with {most} steps, the movement is off by {worst} at {worst_at}");
        let whose = match on.track.tolerance {
            Some(_) => "the track's `tolerance`".to_owned(),
            None => format!("`max_error` of `{}`", on.device.id),
        };
        let expected = format!("at most {allowed} ({whose})");
        let hint = Some(match on.track.tolerance {
            Some(_) => format!("allow more steps, or a `tolerance` of {worst}"),
            None => format!("allow more steps, or add `tolerance: {worst}` to the track"),
        });
        self.findings.add(Code::ToleranceTooTight, place, message, expected, hint);
    }

    fn check_beginning(&mut self, on: &OnDevice<'_>, actuator: &Actuator<'_>, curve: &Curve) {
        let Some(first) = curve.knots.first().filter(|_| actuator.lacks_beginning(curve)) else { return };
        let place = check_values::item_place(on.track, first.item);
        let message =
            format!("device `{}` has to move to its first keyframe from an unknown value", on.device.id);
        let hint = Some("add a keyframe at 0s before it, or use `ease: step`".to_owned());
        self.findings.add(Code::UnknownBeginning, place, message, "a keyframe at 0s", hint);
    }

    fn control_type(&mut self, on: &OnDevice<'_>) -> Option<ControlType> {
        let (track, device) = (on.track, on.device);
        let available = device.script_control_types();
        let several = matches!(track.motion, Motion::Vectors(_));
        let custom = || available.iter().copied().find(|t| matches!(t, ControlType::Custom(_)));
        let control_type = track
            .control
            .or_else(|| if several { custom() } else { device.primary_control_type().or_else(custom) });
        if let Some(control_type) = control_type.filter(|t| available.contains(t)) {
            return Some(control_type);
        }
        let what = match (device.available_control_types.script(), control_type) {
            (None, _) => "scripts".to_owned(),
            (Some(_), Some(control_type)) => format!("{control_type} in scripts"),
            (Some(_), None) if several => "several values at once".to_owned(),
            (Some(_), None) => "movements".to_owned(),
        };
        let available: Vec<_> = available.iter().map(ToString::to_string).collect();
        let message =
            format!("device `{}` of {} does not support {what}", device.id, on.cast.names(on.robots));
        let named = names(available.iter().map(String::as_str));
        let (expected, hint) = match (available.is_empty(), device.available_control_types.script()) {
            (true, None) => (
                "a device that supports scripts".to_owned(),
                Some(
                    "if it supports scripts, declare `script` under its `available_control_types`".to_owned(),
                ),
            ),
            (true, Some(_)) => (
                "a device with `position`, `speed` or `acceleration` in addition to `script`".to_owned(),
                Some(
                    "add the control type that its scripts set, such as `position`, to its `available_control_types`"
                        .to_owned(),
                ),
            ),
            (false, _) => (
                format!("a control type that its scripts support: {named}"),
                several.then(|| "write one number in each keyframe, as in `to: 45`".to_owned()),
            ),
        };
        self.findings.add(Code::ControlType, track.place.clone(), message, expected, hint);
        None
    }

    fn vectors(
        &mut self,
        on: &OnDevice<'_>,
        control_type: ControlType,
        vectors: &Vectors,
        stretch: Stretch,
    ) -> Option<TrackSteps> {
        if !matches!(control_type, ControlType::Custom(_))
            && vectors.iter().any(|vector| vector.values.len() > 1)
        {
            let message = format!("several values for {}", on.who(control_type));
            let expected = "one value per keyframe: only custom_N accepts several";
            self.findings.add(Code::WrongType, on.track.list.clone(), message, expected, None);
            return None;
        }
        let size = 3 * vectors.len() + vectors.values().len() / 2;
        if !self.taken(on, vectors.len(), size) {
            return None;
        }
        check_values::check_inherited(self.findings, on, vectors);
        let Thinned { steps, worst, worst_at } = vectors::thinned(on, vectors, stretch);
        let (most, allowed) = (on.track.steps_max.map(|most| most as usize), vectors::tolerance(on));
        if let Some(most) = most.filter(|most| steps.len() > *most || worst > allowed) {
            self.too_few_steps(on, TooFew { most, needed: steps.len(), worst, worst_at, allowed });
        }
        Some(TrackSteps {
            control_type,
            length: steps.last().map_or(Span::ZERO, |last| last.at),
            at_least: steps.len(),
            worst,
            worst_at,
            moves_from_anywhere: false,
            tolerance: 0.0,
            factor_max: f64::INFINITY,
            excess: Excess::of(on.track),
            items: on.track.items,
            place: on.track.place.clone(),
            steps: Steps::Several(steps),
        })
    }

    fn check_late(&mut self, reading: &Reading, last: Span) {
        if last > self.horizon {
            let message = format!("`{}` is read at {last}", shortened(&reading.sensor));
            let expected = format!("at most {}", self.horizon);
            let hint = Some("read it earlier".to_owned());
            self.findings.add(Code::TooMuch, reading.place.clone(), message, expected, hint);
        }
    }

    fn readings(&mut self, cue: &Cue, members: &Members, time: &CueTime) {
        for reading in &cue.readings {
            if !self.used(cue, members.all.len()) {
                return;
            }
            self.check_late(reading, time.start + members.delay + reading.at);
            let mut without = Vec::new();
            for member in &members.all {
                let sensor = self.cast.device(member.robot, &reading.sensor);
                match sensor.filter(|device| device.available_control_types.sensor().is_some()) {
                    Some(device) => self.readings.push(PlannedReading {
                        robot: self.cast.id(member.robot).clone(),
                        sensor: device.id.clone(),
                        at: time.start + member.delay + reading.at,
                    }),
                    None => without.push(member.robot),
                }
            }
            if !without.is_empty() {
                unknown_sensor(
                    self.findings,
                    self.cast,
                    &without,
                    ("", &reading.sensor),
                    &reading.key_place(),
                );
            }
        }
    }
}

/// Reports a sensor that robots lack. `sensor` contains the text before the sensor's name, which suggestions repeat, and the name.
pub(super) fn unknown_sensor(
    findings: &mut Reader,
    cast: &Cast<'_>,
    robots: &[usize],
    sensor: (&str, &str),
    place: &Place,
) {
    let (ahead, sensor) = sensor;
    let devices = cast.devices(robots[0]).iter();
    let sensors: Vec<_> = devices
        .filter(|device| device.available_control_types.sensor().is_some())
        .map(|device| device.id.as_str())
        .collect();
    let message = format!("{} no sensor `{}`", cast.have(robots), shortened(sensor));
    let named: Vec<String> = sensors.iter().map(|known| format!("{ahead}{known}")).collect();
    let hint = findings.did_you_mean(&format!("{ahead}{sensor}"), named.iter().map(String::as_str));
    let expected = if sensors.is_empty() { "a robot that has sensors".to_owned() } else { one_of(sensors) };
    findings.add(Code::UnknownSensor, place.clone(), message, expected, hint);
}

/// Returns the maximum number of steps to create for a movement if the act may have `left` more steps. The maximum may exceed what the
/// device accepts, so that findings can report the actual number.
fn room(device: &Device, left: usize) -> usize {
    capacity(device).max(TOLD_MAX).min(left)
}

/// Returns a movement stretched to the length at which its cue plays it.
fn stretched(curve: &Curve, stretch: Stretch, starts: Span) -> Cow<'_, Curve> {
    if stretch.from == stretch.to {
        return Cow::Borrowed(curve);
    }
    let mut curve = curve.clone();
    curve.stretch(stretch, starts);
    Cow::Owned(curve)
}

/// Returns the number of steps that a device can hold: `max_number_of_steps` for each script of its queue.
pub(super) fn capacity(device: &Device) -> usize {
    let script = device.available_control_types.script();
    let most = script.map_or(0, |script| script.max_number_of_steps.max(1) as usize);
    most.saturating_mul(device.script_queue.max(1) as usize)
}

/// Rounds up to four significant digits, for display.
fn rounded_up(value: f64) -> f64 {
    let scale = 10f64.powf(3.0 - value.abs().log10().floor());
    let rounded = (value * scale - 1e-6).ceil() / scale;
    if rounded.is_finite() { rounded } else { value }
}

/// Whether the cue moves values to the device's grid.
pub(super) fn snaps(cue: &Cue) -> bool {
    cue.off_grid == OffGrid::Snap
}
