//! Checks that devices do not jump between cues, or after a transition into an act.

use std::collections::HashMap;

use urrcp::{ControlType, Device, Interpolation, RobotId, Span};

use super::cast::Cast;
use super::segment::{Segment, Steps};
use crate::duration::seconds;
use crate::fields::Reader;
use crate::finding::{Code, SharedFault};
use crate::fleet::limits_of;
use crate::motion::Value;
use crate::plan::{Act, FailurePolicy, OnFailure, Wait, Way};
use crate::scenario::{self, Items};

/// The position of a device when a cue begins.
pub(super) struct Position {
    pub(super) value: f64,
    /// Time at which the device arrived at this position.
    pub(super) since: Span,
    pub(super) whence: String,
    /// Whether a movement has left the device at this position. Otherwise, only the device's description states the position.
    pub(super) is_sure: bool,
}

/// A device that moves to a position.
pub(super) struct Mover<'a> {
    pub(super) robot: &'a RobotId,
    pub(super) device: &'a Device,
    /// The device's largest speed under position control; `None` if unlimited.
    pub(super) speed: Option<f64>,
}

/// The first segment of a device in an act.
pub(super) struct First {
    pub(super) robot: usize,
    /// Index of the device in the robot's list of devices.
    pub(super) index: usize,
    pub(super) segment: Segment,
}

impl Mover<'_> {
    /// Checks the first value of a movement against the position `from` of the device. Returns the largest permitted show speed factor
    /// (speed of the show relative to the file): at a higher show speed, devices move to their first keyframes faster.
    pub(super) fn arrives(&self, findings: &mut Reader, segment: &Segment, from: &Position) -> f64 {
        let unlimited = f64::INFINITY;
        let Steps::One(values) = &segment.part.steps else { return unlimited };
        let Some(first) = values.first() else { return unlimited };
        // Segments that overlap the previous one, and values that the device cannot take, are already reported.
        let is_settable =
            |value| limits_of(self.device, ControlType::Position).all(|own| own.contains(value));
        if segment.start() < from.since || !is_settable(from.value) || !is_settable(first.to) {
            return unlimited;
        }
        let way = (first.to - from.value).abs();
        if segment.part.moves_from_anywhere {
            return self.check_way_there(findings, segment, from, first);
        }
        if way > segment.part.tolerance.max(1e-9) {
            self.jump(findings, segment, from, first);
        }
        unlimited
    }

    /// Returns the code for a jump. A jump of a device with limited speed is an error. It is only a warning if the position comes from
    /// the device's description alone, as at the beginning of the mission.
    fn code_of(&self, from: &Position) -> Code {
        if from.is_sure && self.speed.is_some() { Code::TooFast } else { Code::Jump }
    }

    fn jump(&self, findings: &mut Reader, segment: &Segment, position: &Position, first: &Value) {
        let at = segment.begin + first.at;
        let (device, to, from) = (&self.device.id, first.to, position.value);
        let whence = &position.whence;
        let needed = self.speed.map(|speed| seconds((to - from).abs() / speed));
        let items = match self.device.interpolation {
            Interpolation::Linear => segment.part.items,
            Interpolation::Hold => Items::Whole,
        };
        let hint = match (items, needed) {
            (Items::Keyframes, Some(needed)) => {
                format!(
                    "move the first keyframe to {needed} or later, so that the device has time to reach it"
                )
            }
            (Items::Keyframes, None) => {
                "move the first keyframe to a time after 0s, so that the device has time to reach it"
                    .to_owned()
            }
            (_, Some(needed)) => format!("move it there in an earlier cue, which takes at least {needed}"),
            (_, None) => "move it there in an earlier cue".to_owned(),
        };
        let expected = match items {
            Items::Keyframes => format!("a first keyframe with the value {from}, or a time later than 0s"),
            _ => format!("a movement that starts at {from}"),
        };
        let end = format!(" has to jump from {from}, {whence}, to {to} at {at}");
        findings.add_shared(SharedFault {
            code: self.code_of(position),
            cause: format!("{:?}\n{from} {to} {whence}", segment.part.place),
            size: (to - from).abs(),
            device: device.to_string(),
            robots: [self.robot.clone()].into(),
            place: segment.part.place.clone(),
            message: [format!("`{device}` of "), end],
            expected,
            hint: Some(hint),
        });
    }

    /// Checks the movement from the device's position to a first keyframe that is later than 0s. Returns the largest permitted show speed
    /// factor, like [`Self::arrives`].
    fn check_way_there(
        &self,
        findings: &mut Reader,
        segment: &Segment,
        position: &Position,
        first: &Value,
    ) -> f64 {
        let (from, length) = (position.value, first.at.as_millis_f64() / 1_000.0);
        let needed = (first.to - from).abs() / length;
        let Some(speed) = self.speed else { return f64::INFINITY };
        // `run` asks the robots for positions that come from descriptions alone.
        let factor = if position.is_sure { speed / needed } else { f64::INFINITY };
        if needed <= speed * (1.0 + 1e-6) {
            return factor;
        }
        let end = format!(
            " has only {} to move from {from} to its first keyframe, {}: this requires a speed of {needed:.4}",
            first.at, first.to
        );
        findings.add_shared(SharedFault {
            code: self.code_of(position),
            cause: format!("{:?}\n{from} {} way", segment.part.place, first.to),
            size: needed,
            device: self.device.id.to_string(),
            robots: [self.robot.clone()].into(),
            place: segment.part.place.clone(),
            message: [format!("`{}` of ", self.device.id), end],
            expected: format!("at most {speed}"),
            hint: Some(format!("move the first keyframe to {} or later", seconds(length * needed / speed))),
        });
        factor
    }
}

/// A transition from one act to another.
struct Passage {
    to: usize,
    by: By,
}

#[derive(Clone, Copy, PartialEq)]
enum By {
    /// The previous act has ended.
    Next,
    /// The wait of the previous act timed out, so that act moved nothing.
    Timeout,
    /// The previous act failed, and all devices went to their default state.
    Home,
    /// The previous act has ended without the robots that failed. If only one robot can be left out, it is `only`; that robot never takes
    /// this transition.
    Without { only: Option<usize> },
}

/// All transitions after which device positions are at least partially known.
pub(super) struct Passages(Vec<Vec<Passage>>);

impl Passages {
    /// Returns the transitions between the acts `acts`.
    pub(super) fn of(acts: &[Act], cast: &Cast<'_>) -> Self {
        let robots = participants(acts, cast);
        let of = |act: &Act| {
            let to = |way: Way| if let Way::Act(to) = way { Some(to) } else { None };
            let mut passages: Vec<Passage> = [(to(act.next), By::Next), (to(act.on_timeout), By::Timeout)]
                .into_iter()
                .filter_map(|(to, by)| Some(Passage { to: to?, by }))
                .collect();
            if let Some(to) = act.on_failure.then {
                passages.extend(after_failure(&act.on_failure, &robots, cast).map(|by| Passage { to, by }));
            }
            passages
        };
        Self(acts.iter().map(of).collect())
    }
}

/// Returns the transitions that may follow a failure of one of these robots; each leaves the devices of the other robots in another
/// state.
fn after_failure(policy: &FailurePolicy, robots: &[usize], cast: &Cast<'_>) -> impl Iterator<Item = By> {
    let rules: HashMap<&RobotId, OnFailure> =
        policy.robots.iter().map(|(robot, rule)| (robot, *rule)).collect();
    let rule = |robot: usize| rules.get(cast.id(robot)).copied().unwrap_or(policy.default);
    let home = robots.iter().any(|robot| rule(*robot) == OnFailure::Home).then_some(By::Home);
    let mut left_out = robots.iter().copied().filter(|robot| rule(*robot) == OnFailure::Without);
    let without = left_out.next().map(|first| match left_out.next() {
        None => By::Without { only: Some(first) },
        Some(_) => By::Without { only: None },
    });
    home.into_iter().chain(without)
}

/// Returns the robots that take part in the mission: those that the acts move, and those whose sensors the acts read.
fn participants(acts: &[Act], cast: &Cast<'_>) -> Vec<usize> {
    let moved = acts.iter().flat_map(|act| &act.plan.robots).map(|planned| &planned.robot);
    let read = acts.iter().flat_map(|act| &act.readings).map(|reading| &reading.robot);
    let mut robots: Vec<usize> = moved.chain(read).filter_map(|robot| cast.index(robot)).collect();
    robots.extend(acts.iter().filter_map(|act| match &act.wait {
        Wait::Sensor { robot, .. } => cast.index(&robot.parse().ok()?),
        _ => None,
    }));
    robots.sort_unstable();
    robots.dedup();
    robots
}

/// Final positions of the devices that an act moves, by (robot, device); `None` for a device that is not left at a position.
pub(super) type FinalPositions = HashMap<(usize, usize), Option<f64>>;

/// A possible position of a device when an act begins, and what left the device there.
#[derive(Clone, Copy, PartialEq)]
struct Place {
    value: f64,
    left_by: LeftBy,
}

#[derive(Clone, Copy, PartialEq)]
enum LeftBy {
    /// Nothing has moved the device yet.
    Beginning,
    Act(usize),
    /// A failure of the act with this index has left the device at its default value.
    Failure(usize),
}

/// Largest show speed factors (speeds of the show relative to the file) at which devices reach their first keyframes in time, by (act,
/// robot, device). The speed limits of the devices determine these factors.
pub(super) type Factors = HashMap<(usize, usize, usize), f64>;

/// The first movements and the final positions of all acts, in the order of the acts.
#[derive(Clone, Copy)]
pub(super) struct Entries<'a> {
    pub(super) acts: &'a [scenario::Act],
    pub(super) first: &'a [Vec<First>],
    pub(super) moved: &'a [FinalPositions],
}

/// Checks the first movements of each act against the positions after each transition into the act, including returns from a later act.
pub(super) fn check_entries(
    findings: &mut Reader,
    cast: &Cast<'_>,
    passages: &Passages,
    entries: Entries<'_>,
) -> Factors {
    let Entries { acts, first, moved } = entries;
    let mut factors = Factors::new();
    let mut by_device: HashMap<(usize, usize), Vec<(usize, &Segment)>> = HashMap::new();
    for (act, first) in first.iter().enumerate() {
        for First { robot, index, segment } in first {
            by_device.entry((*robot, *index)).or_default().push((act, segment));
        }
    }
    let mut devices: Vec<_> = by_device.into_iter().collect();
    devices.sort_unstable_by_key(|(device, _)| *device);
    for ((robot, index), entries) in devices {
        let device = &cast.devices(robot)[index];
        let speed = cast.limits(robot, device, ControlType::Position).speed;
        let mover = Mover { robot: cast.id(robot), device, speed };
        let is_linear = device.interpolation == Interpolation::Linear;
        if !is_linear && speed.is_none() {
            continue;
        }
        let places = places(device, passages, moved, (robot, index));
        for (act, segment) in entries {
            if segment.part.control_type != ControlType::Position {
                continue;
            }
            for place in &places[act] {
                let whence = match place.left_by {
                    LeftBy::Beginning => "where it is when the act starts".to_owned(),
                    LeftBy::Act(by) => format!("where the act `{}` leaves it", acts[by].name),
                    LeftBy::Failure(of) => {
                        format!("its default state after a failure of the act `{}`", acts[of].name)
                    }
                };
                let is_sure = place.left_by != LeftBy::Beginning;
                let from = Position { value: place.value, since: Span::ZERO, whence, is_sure };
                let factor = mover.arrives(findings, segment, &from);
                if factor.is_finite() {
                    let known = factors.entry((act, robot, index)).or_insert(factor);
                    *known = known.min(factor);
                }
            }
        }
    }
    factors
}

/// Maximum number of distinct positions of a device at the start of an act that are checked.
const PLACES_MAX: usize = 16;

/// Returns the possible positions of a device at the start of each act.
fn places(
    device: &Device,
    Passages(passages): &Passages,
    moved: &[FinalPositions],
    key: (usize, usize),
) -> Vec<Vec<Place>> {
    let mut places: Vec<Vec<Place>> = vec![Vec::new(); moved.len()];
    let default = |left_by| device.default_value.map(|value| Place { value, left_by });
    if let Some(first) = places.first_mut() {
        first.extend(default(LeftBy::Beginning));
    }
    let mut changed: Vec<usize> = (0..moved.len()).rev().collect();
    while let Some(act) = changed.pop() {
        for passage in &passages[act] {
            let left: Vec<Place> = match (passage.by, moved[act].get(&key)) {
                (By::Home, _) => default(LeftBy::Failure(act)).into_iter().collect(),
                (By::Without { only: Some(only) }, _) if only == key.0 => continue,
                (By::Next | By::Without { .. }, Some(left)) => {
                    left.map(|value| Place { value, left_by: LeftBy::Act(act) }).into_iter().collect()
                }
                (By::Next | By::Without { .. } | By::Timeout, _) => places[act].clone(),
            };
            for place in left {
                if add(&mut places[passage.to], place) && !changed.contains(&passage.to) {
                    changed.push(passage.to);
                }
            }
        }
    }
    places
}

/// Adds a place. If a place has the same value already, a place that a movement has reached replaces the position from the device's
/// description. Returns whether `places` has changed.
fn add(places: &mut Vec<Place>, place: Place) -> bool {
    let Some(known) = places.iter_mut().find(|known| known.value == place.value) else {
        let has_room = places.len() < PLACES_MAX;
        places.extend(has_room.then_some(place));
        return has_room;
    };
    let is_surer = known.left_by == LeftBy::Beginning && place.left_by != LeftBy::Beginning;
    if is_surer {
        *known = place;
    }
    is_surer
}
