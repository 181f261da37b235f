//! Checks for bodies that come too close to each other, leave their allowed space, or move too fast.

use std::collections::{HashMap, HashSet};

use urrcp::Span;

use super::Times;
use super::cast::{Cast, Positions};
use super::check_formations::differing;
use super::conflict::told;
use super::courses::{Poses, Scripts, Standing};
use crate::ensemble::{self, Action};
use crate::fields::Reader;
use crate::finding::{Code, Place, SharedFault, robots_named};
use crate::plan::{DeviceUse, Requirements, RobotPlan};
use crate::scenario::Act;
use crate::space::{
    Body, BodyUse, Closest, DUST, DrivenPath, DrivenPoint, InSpace, Knot, Mover, Path, Peak, Solid, closest,
    depth, first_contact, furthest_out,
};

/// Maximum number of consecutive knots that are omitted when a path is simplified for drawing.
const LEFT_OUT_MAX: usize = 200;
/// Rounding error of the distance between two balls, in metres.
const ROUNDING: f64 = 1e-9;

/// Expectation and hint of a finding about bodies that are driven by speeds (`DRIVEN`) and about all others (`PLACED`).
const DRIVEN: (&str, &str) = (
    "a speed for each device in `drive`, and previous acts that end with these speeds at 0",
    "end every act that leads here with all speeds of the drive at 0, and control these devices only by speed",
);
const PLACED: (&str, &str) = (
    "a known position for each device in `body`",
    "add keyframes at the beginning, add a `default_value`, or control these devices by position",
);

/// An act with the scripts of its robots and the positions at its start.
pub(super) struct Stage<'a> {
    pub(super) cast: &'a Cast<'a>,
    pub(super) requirements: &'a Requirements,
    pub(super) act: &'a Act,
    pub(super) times: &'a Times,
    pub(super) robots: &'a [RobotPlan],
    pub(super) devices: &'a [DeviceUse],
    pub(super) positions: &'a Positions<'a>,
    /// Robots with a missing movement, in this act or earlier: their bodies are not checked.
    pub(super) incomplete: &'a HashSet<usize>,
    pub(super) standing: &'a Standing<'a>,
}

/// Checks an act. Returns the movements of its bodies, and the final poses of the bodies that are driven by speeds.
pub(super) fn check(findings: &mut Reader, stage: &Stage<'_>) -> (InSpace, Poses) {
    let fleet = stage.cast.fleet;
    let bodies = fleet.robots.iter().enumerate();
    let bodies = bodies.filter(|(robot, _)| !stage.incomplete.contains(robot));
    let bodies: Vec<(usize, &Body)> =
        bodies.filter_map(|(i, robot)| Some((i, robot.body.as_ref()?))).collect();
    let (mut in_space, mut left) = (InSpace::default(), Poses::new());
    if bodies.is_empty() {
        return (in_space, left);
    }
    let (cues, scripts) = (Cues::of(stage), Scripts::of(stage));
    let mut unknown = Vec::new();
    let mut paths: Vec<(usize, Path, Solid)> = Vec::new();
    for (robot, body) in bodies {
        let Some(course) = stage.course(&scripts, robot, body) else {
            unknown.extend(scripts.plays(stage.cast.id(robot)).then_some((robot, None)));
            continue;
        };
        in_space.bodies.push(rates(findings, stage, &cues, robot, body, course.peaks));
        left.extend(course.end.map(|end| (robot, end)));
        let path = Path::of(&course.axes, !stage.positions.is_first());
        if path.known_from() > 0.0 && scripts.plays(stage.cast.id(robot)) {
            unknown.push((robot, Some(path.known_from())));
        }
        if body.drive.is_some() {
            in_space.driven.push(DrivenPath { robot: stage.cast.id(robot).clone(), points: drawn(&path) });
        }
        paths.push((robot, path, Solid::of(body, course.margin)));
    }
    if fleet.space.is_checked() || stage.requirements.closest.is_some() {
        tell_unknown(findings, stage, &unknown);
    }
    in_space.unknown = unknown.iter().map(|(robot, _)| stage.cast.id(*robot).clone()).collect();
    let ends = paths.iter().map(|(_, path, _)| path.ends()).fold(0.0, f64::max);
    let depth = depth(paths.iter().map(|(_, path, _)| path.knots().len()).max().unwrap_or(0));
    let movers: Vec<(usize, Mover)> =
        paths.into_iter().map(|(robot, path, solid)| (robot, Mover::new(path, solid, ends, depth))).collect();
    volumes(findings, stage, &cues, &movers, ends, depth);
    in_space.closest = pairs(findings, stage, &cues, &movers);
    (in_space, left)
}

/// Omits knots of a path that are not needed for drawing: each line replaces knots that are all close to it.
fn drawn(path: &Path) -> Vec<DrivenPoint> {
    let pose = |knot: &Knot| [knot.place.base[0], knot.place.base[1], knot.place.base[3]];
    let point = |knot: &Knot| DrivenPoint { at: span(knot.at), pose: pose(knot) };
    let close = |from: &Knot, to: &Knot, left_out: &Knot| {
        let share = if to.at > from.at { (left_out.at - from.at) / (to.at - from.at) } else { 0.0 };
        let off = |i: usize| {
            let (from, to) = (pose(from)[i], pose(to)[i]);
            (from + share * (to - from) - pose(left_out)[i]).abs()
        };
        (0..3).all(|i| off(i) <= DrivenPath::DRAWN)
    };
    let knots = path.knots();
    let mut points: Vec<DrivenPoint> = knots.first().map(point).into_iter().collect();
    let mut kept = 0;
    for next in 2..knots.len() {
        let left_out = &knots[kept + 1..next];
        if left_out.len() >= LEFT_OUT_MAX
            || !left_out.iter().all(|knot| close(&knots[kept], &knots[next], knot))
        {
            kept = next - 1;
            points.push(point(&knots[kept]));
        }
    }
    points.extend(knots.iter().skip(1).last().map(point));
    points
}

impl Stage<'_> {
    fn id(&self, robot: usize) -> &str {
        self.cast.id(robot).as_str()
    }

    /// Returns the distance, in metres, by which the device grids may bring two bodies of the same formation closer to each other. Each
    /// device contributes one grid step: half of it for its place, half for its steps. The movements into a formation already allow for
    /// all other deviations.
    fn by_grids(&self, cues: [Option<usize>; 2], robots: [usize; 2]) -> f64 {
        let [Some(cue), Some(other)] = cues else { return 0.0 };
        let group = self.act.cues[cue].group.as_ref().filter(|_| cue == other);
        if !group.is_some_and(|group| matches!(group.action, Action::Form(_))) {
            return 0.0;
        }
        let coarseness = |robot: usize| {
            let body = self.cast.fleet.robots[robot].body.as_ref();
            body.map_or(0.0, |body| ensemble::coarseness(body, self.cast.devices(robot)))
        };
        robots.map(coarseness).iter().sum()
    }
}

/// The cues of each robot, in order of the robot's start times.
struct Cues<'a> {
    act: &'a Act,
    of_robot: HashMap<usize, Vec<(Span, usize)>>,
}

impl<'a> Cues<'a> {
    fn of(stage: &Stage<'a>) -> Self {
        let mut of_robot: HashMap<usize, Vec<(Span, usize)>> = HashMap::new();
        let Times { members, times, .. } = stage.times;
        for (cue, (members, time)) in members.iter().zip(times).enumerate() {
            for member in &members.all {
                of_robot.entry(member.robot).or_default().push((time.start + member.delay, cue));
            }
        }
        of_robot.values_mut().for_each(|cues| cues.sort());
        Self { act: stage.act, of_robot }
    }

    /// Returns the cue that a robot plays at the time `at` or, between cues, has played last; `None` before its first cue.
    fn at(&self, robot: usize, at: Span) -> Option<usize> {
        let cues = self.of_robot.get(&robot)?;
        cues[..cues.partition_point(|(begin, _)| *begin <= at)].last().map(|(_, cue)| *cue)
    }

    fn place(&self, cue: Option<usize>) -> Place {
        cue.map_or_else(|| self.act.place.clone(), |cue| self.act.cues[cue].robots_place.clone())
    }

    /// Returns the place of a cue in the file, and a description of what the robot does there.
    fn line(&self, robot: &str, cue: Option<usize>) -> (Place, String) {
        let what = match cue {
            Some(cue) => format!("`{robot}` in the cue `{}`", self.act.cues[cue].name),
            None => format!("`{robot}` is already there when the act starts"),
        };
        (self.place(cue), what)
    }
}

/// Converts seconds to a time that is rounded to the millisecond for display.
fn span(seconds: f64) -> Span {
    Span::from_millis_f64((seconds * 1_000.0).round())
}

/// Compares the largest speed and acceleration of a body with its limits.
fn rates(
    findings: &mut Reader,
    stage: &Stage<'_>,
    cues: &Cues<'_>,
    robot: usize,
    body: &Body,
    peaks: [Option<Peak>; 2],
) -> BodyUse {
    let limits =
        [(body.speed, "moves|move at", "m/s"), (body.acceleration, "accelerates|accelerate at", "m/s²")];
    for (peak, (limit, moves, unit)) in peaks.into_iter().zip(limits) {
        let (Some(Peak { from, to, rate }), Some(limit)) = (peak, limit) else { continue };
        if rate <= limit * DUST {
            continue;
        }
        let said = format!(" {moves} {rate:.3} {unit} from {} to {}", told(span(from)), told(span(to)));
        let place = cues.place(cues.at(robot, span(from)));
        let expected = format!("at most {limit} {unit}");
        findings.add_shared(SharedFault {
            code: Code::BodyTooFast,
            cause: format!("{place:?} {expected}"),
            size: rate / limit,
            device: String::new(),
            robots: [stage.cast.id(robot).clone()].into(),
            place,
            message: [String::new(), said],
            expected,
            hint: Some("allow more time for the movement, or use a shorter path".to_owned()),
        });
    }
    let [speed, acceleration] = peaks.map(|peak| peak.map_or(0.0, |peak| peak.rate));
    BodyUse { robot: stage.cast.id(robot).clone(), speed, acceleration }
}

/// Reports robots whose bodies have an unknown position. A single warning lists all robots whose positions become known at the same time.
fn tell_unknown(findings: &mut Reader, stage: &Stage<'_>, unknown: &[(usize, Option<f64>)]) {
    let is_driven =
        |robot: usize| stage.cast.fleet.robots[robot].body.as_ref().is_some_and(|body| body.drive.is_some());
    let mut told_already: Vec<(Option<f64>, bool)> = Vec::new();
    for (robot, from) in unknown {
        let driven = is_driven(*robot);
        if told_already.contains(&(*from, driven)) {
            continue;
        }
        told_already.push((*from, driven));
        let alike = unknown.iter().filter(|(other, at)| at == from && is_driven(*other) == driven);
        let robots: Vec<&str> = alike.map(|(robot, _)| stage.id(*robot)).collect();
        let are = if robots.len() == 1 { "is" } else { "are" };
        let until =
            from.map_or_else(|| "in this act".to_owned(), |from| format!("before {}", told(span(from))));
        let message = format!(
            "{} {are} at an unknown position {until}, so collisions and allowed spaces are not checked during this time",
            robots_named(robots.into_iter())
        );
        let (expected, hint) = if driven { DRIVEN } else { PLACED };
        findings.add(Code::PlaceUnknown, stage.act.place.clone(), message, expected, Some(hint.to_owned()));
    }
}

fn volumes(
    findings: &mut Reader,
    stage: &Stage<'_>,
    cues: &Cues<'_>,
    movers: &[(usize, Mover)],
    ends: f64,
    depth: u32,
) {
    let space = &stage.cast.fleet.space;
    for (robot, mover) in movers {
        let Some(out) = space.keep_in.as_ref().and_then(|volume| furthest_out(mover, volume)) else {
            continue;
        };
        let at = span(out.at);
        let place = cues.place(cues.at(*robot, at));
        findings.add_shared(SharedFault {
            code: Code::OutOfSpace,
            cause: format!("{place:?} keep_in"),
            size: out.distance,
            device: String::new(),
            robots: [stage.cast.id(*robot).clone()].into(),
            place,
            message: [
                String::new(),
                format!(
                    " leaves|leave the allowed space (`keep_in`) by {:.3} m at {}",
                    out.distance,
                    told(at)
                ),
            ],
            expected: "the whole body within `keep_in`".to_owned(),
            hint: Some("move it elsewhere, or make `keep_in` larger".to_owned()),
        });
    }
    for (name, volume) in &space.keep_out {
        let (solid, place) = Solid::of_volume(volume);
        let closed = Mover::new(Path::resting(place, ends), solid, ends, depth);
        for (robot, mover) in movers {
            let Some(at) = first_contact(mover, &closed) else { continue };
            let at = span(at);
            let place = cues.place(cues.at(*robot, at));
            findings.add_shared(SharedFault {
                code: Code::OutOfSpace,
                cause: format!("{place:?} {name}"),
                size: -at.as_millis_f64(),
                device: String::new(),
                robots: [stage.cast.id(*robot).clone()].into(),
                place,
                message: [String::new(), format!(" enters|enter `{name}` at {}", told(at))],
                expected: format!("no body in `{name}`"),
                hint: Some("move it around the volume, or change `keep_out`".to_owned()),
            });
        }
    }
}

/// Two bodies at their closest approach.
#[derive(Clone, Copy)]
struct Pair {
    distance: f64,
    robots: [usize; 2],
    at: Span,
}

/// Pairs of bodies that come too close in the same two cues.
struct TooClose {
    cues: [Option<usize>; 2],
    worst: Pair,
    pairs: usize,
}

/// Returns the closest pair of bodies. Reports pairs that come too close once for each pair of cues.
fn pairs(
    findings: &mut Reader,
    stage: &Stage<'_>,
    cues: &Cues<'_>,
    movers: &[(usize, Mover)],
) -> Option<Closest> {
    let required = stage.cast.fleet.space.distance.unwrap_or(0.0);
    let mut best: Option<Pair> = None;
    let mut all: Vec<TooClose> = Vec::new();
    let mut index_of: HashMap<[Option<usize>; 2], usize> = HashMap::new();
    for (index, (first, a)) in movers.iter().enumerate() {
        for (second, b) in &movers[index + 1..] {
            let below = best.map_or(f64::INFINITY, |best| best.distance.max(required));
            let Some(approach) = closest(a, b, below) else { continue };
            let pair = Pair { distance: approach.distance, robots: [*first, *second], at: span(approach.at) };
            if best.is_none_or(|best| pair.distance < best.distance) {
                best = Some(pair);
            }
            let of = pair.robots.map(|robot| cues.at(robot, pair.at));
            // Bodies that rest too close to each other were already reported when they came there.
            let told_before = of == [None, None] && !stage.positions.is_first();
            let rounding = ROUNDING + stage.by_grids(of, pair.robots);
            if pair.distance >= required - rounding || told_before {
                continue;
            }
            let group = *index_of.entry(of).or_insert_with(|| {
                all.push(TooClose { cues: of, worst: pair, pairs: 0 });
                all.len() - 1
            });
            let group = &mut all[group];
            group.pairs += 1;
            if pair.distance < group.worst.distance {
                group.worst = pair;
            }
        }
    }
    all.iter().for_each(|group| group.tell(findings, stage, cues, required));
    best.map(|Pair { distance, robots, at }| Closest {
        robots: robots.map(|robot| stage.cast.id(robot).clone()),
        at,
        distance,
    })
}

impl TooClose {
    fn tell(&self, findings: &mut Reader, stage: &Stage<'_>, cues: &Cues<'_>, required: f64) {
        let expected = &format!("at least {required} m");
        let Pair { distance, robots, at } = self.worst;
        let [a, b] = robots.map(|robot| stage.id(robot));
        let what = match distance {
            0.0 => "meet".to_owned(),
            _ => format!("come within {} m of each other", differing(distance, required)[0]),
        };
        let more = match self.pairs {
            1 => String::new(),
            2 => "; 1 more pair comes too close in the same cues".to_owned(),
            pairs => format!("; {} more pairs come too close in the same cues", pairs - 1),
        };
        let message = format!("`{a}` and `{b}` {what} at {}, but {expected} is required{more}", told(at));
        let mut lines = vec![cues.line(a, self.cues[0]), cues.line(b, self.cues[1])];
        if self.cues[0] == self.cues[1] {
            lines.truncate(1);
            lines[0].1 = match self.cues[0] {
                Some(cue) => format!("both in the cue `{}`", stage.act.cues[cue].name),
                None => "both are already there when the act starts".to_owned(),
            };
        }
        let hint =
            "move one of them later or elsewhere, or reduce `distance` under `space` in the fleet file"
                .to_owned();
        findings.add_related(Code::TooClose, lines, message, expected, Some(hint));
    }
}
