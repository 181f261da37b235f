//! Orders the robots of a cue by their index, by their place in space, or at random. Also reads values that are spread over these robots:
//! `{from: 0, to: 90, across: group}`.

use std::sync::Arc;

use urrcp::RobotId;

use super::{At, Reader, Robot};
use crate::{keys, kinds, words};
use downbeat_motion::chance::{drawn, share};
use downbeat_motion::exact::{Fraction, sum, to_f64};
use downbeat_motion::motion::Easing;
use downbeat_space::space::Coordinate;
use downbeat_yaml::finding::{Code, Pending, names};
use downbeat_yaml::node::Node;

/// The number of nanometres per metre. Places are compared as whole nanometres.
const UNITS_A_METRE: f64 = 1e9;
/// Largest absolute value of coordinates and distances, in metres. Larger ones are clamped to it.
const FARTHEST: f64 = 1e8;
/// Maximum number of robots that a finding about unknown positions lists.
const NAMED_MAX: usize = 8;

keys! {
    /// An individual number or time for each robot of the cue, from the first to the last.
    pub(crate) struct SpreadKeys as "spread" {
        /// The value of the first robot, and of a single robot.
        #[required]
        from: kinds::SPREAD_END,
        /// The value of the last robot.
        #[required]
        to: kinds::SPREAD_END,
        /// The robots of the cue.
        #[required]
        across: words!(ACROSS_WORDS),
        by: kinds::BY,
        /// For `by: random`: another number gives another order.
        seed: kinds::NUMBER,
        direction: kinds::DIRECTION,
        /// How the values grow from robot to robot. Default: linear.
        ease: words!(Easing::WORDS),
    }
}

/// The robots of the cue that is being read.
#[derive(Debug, Default)]
pub struct Group {
    /// The indices of the robots in the fleet, in the order of the cue.
    pub robots: Vec<usize>,
    /// All robots of the fleet.
    pub fleet: Vec<Standing>,
    /// For each order that was used, the computed positions of the robots in it, from 0 to 1.
    shares: Vec<(Across, Arc<[Fraction]>)>,
}

/// A robot with its place in space.
#[derive(Debug)]
pub struct Standing {
    /// The id of the robot.
    pub id: RobotId,
    /// The coordinates x, y and z; `None` if the robot has no body.
    pub axes: Option<[Axis; 3]>,
}

/// One coordinate of a robot's place.
#[derive(Debug)]
pub struct Axis {
    /// The device that sets the coordinate, or its fixed value.
    pub of: Coordinate,
    /// The position of the robot on this axis.
    pub at: Whereabouts,
}

/// The position of a robot on an axis at the start of a cue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Whereabouts {
    /// The position in metres.
    Known(f64),
    /// The position is not known.
    Unknown,
    /// A previous cue moved the robot as part of a group, and the robot's route does not exist or is not known. In most cases, the
    /// compiler reports the cause.
    Lost,
}

/// How the robots of a cue are ordered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Across {
    /// The criterion by which the robots are ordered.
    pub by: By,
    direction: Direction,
}

/// The criterion by which the robots are ordered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum By {
    /// The index of the robot in the cue.
    #[default]
    Index,
    /// A coordinate of the robot's place: 0 for x, 1 for y, 2 for z.
    Axis(usize),
    /// The distance of the robot from a point given in metres.
    Point([f64; 3]),
    /// A random order; the number is its seed.
    Random(f64),
}

/// Which robots come first in an order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Direction {
    #[default]
    Forward,
    Backward,
    /// The robots in the middle come first.
    Outward,
    /// The robots at both ends come first.
    Inward,
}

const ACROSS_WORDS: [(&str, ()); 1] = [("group", ())];
pub(crate) const BY_WORDS: [(&str, Word); 5] = [
    ("index", Word::Index),
    ("x", Word::Axis(0)),
    ("y", Word::Axis(1)),
    ("z", Word::Axis(2)),
    ("random", Word::Random),
];
pub(crate) const DIRECTION_WORDS: [(&str, Direction); 4] = [
    ("forward", Direction::Forward),
    ("backward", Direction::Backward),
    ("outward", Direction::Outward),
    ("inward", Direction::Inward),
];
const EXPECTED_POINT: &str = "a point in metres, such as [0, 0, 1.5]";

#[derive(Clone, Copy)]
pub(crate) enum Word {
    Index,
    Axis(usize),
    Random,
}

impl Group {
    /// Creates the initial group, before any cue is read: it has no robots of the fleet.
    pub fn of(fleet: Vec<Standing>) -> Self {
        Self { fleet, ..Self::default() }
    }

    /// The number of robots in the cue.
    pub fn count(&self) -> usize {
        self.robots.len()
    }

    /// Sets the robots of the cue that is read next, as indices in the fleet.
    pub fn enter(&mut self, robots: Vec<usize>) {
        self.robots = robots;
        self.shares.clear();
    }
}

impl Axis {
    /// Marks the position on this axis as lost, unless the coordinate is fixed.
    pub fn lose(&mut self) {
        if matches!(self.of, Coordinate::Device { .. }) {
            self.at = Whereabouts::Lost;
        }
    }
}

impl Standing {
    /// Returns the coordinates of the robot in metres; `None` unless all three are known.
    pub fn metres(&self) -> Option<[f64; 3]> {
        let known = |axis: &Axis| match axis.at {
            Whereabouts::Known(metres) => Some(metres),
            Whereabouts::Unknown | Whereabouts::Lost => None,
        };
        let [x, y, z] = self.axes.as_ref()?.each_ref().map(known);
        Some([x?, y?, z?])
    }

    fn is_lost(&self) -> bool {
        self.axes.iter().flatten().any(|axis| axis.at == Whereabouts::Lost)
    }

    /// Returns the coordinates of the robot in nanometres; `None` unless all three are known.
    fn place(&self) -> Option<[i128; 3]> {
        Some(self.metres()?.map(nanometres))
    }
}

#[expect(clippy::cast_possible_truncation, reason = "clamped")]
fn nanometres(metres: f64) -> i128 {
    (metres.clamp(-FARTHEST, FARTHEST) * UNITS_A_METRE).round() as i128
}

#[expect(clippy::cast_precision_loss, reason = "rounded to the nanometre again")]
fn distance(place: [i128; 3], point: [f64; 3]) -> i128 {
    let square = |(a, b): (i128, f64)| ((a - nanometres(b)) as f64 / UNITS_A_METRE).powi(2);
    nanometres(place.into_iter().zip(point).map(square).sum::<f64>().sqrt())
}

impl Across {
    /// Reads an order of robots from the keys `by`, `seed` and `direction`.
    pub fn read(
        reader: &mut Reader,
        by: Option<At<'_>>,
        seed: Option<At<'_>>,
        direction: Option<At<'_>>,
    ) -> Option<Self> {
        let direction = direction.map_or(Some(Direction::default()), |at| reader.word(&at, &DIRECTION_WORDS));
        let read_seed = seed.and_then(|at| reader.number(&at, "a number"));
        let by = match by {
            None => Some(By::Index),
            Some(at) if matches!(at.node, Node::List(_)) => point(reader, &at).map(By::Point),
            Some(at) => match reader.word(&at, &BY_WORDS)? {
                Word::Index => Some(By::Index),
                Word::Axis(axis) => Some(By::Axis(axis)),
                Word::Random if seed.is_none() => {
                    let hint = Some("add a seed with any number: `seed: 7`".to_owned());
                    reader.add(Code::MissingKey, at.place(), "`random` needs a seed", "a key `seed`", hint);
                    None
                }
                Word::Random => read_seed.map(By::Random),
            },
        };
        if let (Some(at), Some(by)) = (seed, by)
            && !matches!(by, By::Random(_))
        {
            let message = "`seed` has no effect without `by: random`";
            reader.add(Code::UnknownKey, at.key_place(), message, "`by: random` next to `seed`", None);
        }
        Some(Self { by: by?, direction: direction? })
    }

    /// Returns the distance of each robot of the cue from the first one in this order. It is in metres if the robots are ordered by
    /// place, in positions if by index, and from 0 to 1 if at random.
    pub fn along(self, reader: &mut Reader, at: &At<'_>) -> Option<Vec<Fraction>> {
        let own = self.own(reader, at)?;
        let metres = matches!(self.by, By::Axis(_) | By::Point(_));
        let unit = |value: i128| Fraction::new(value, if metres { 1_000_000_000 } else { 1 });
        Some(match self.by {
            By::Random(_) => {
                let part = |value: i128| Fraction::new(value >> 11, 1 << 53);
                self.directed(&own.into_iter().map(part).collect::<Vec<_>>())
            }
            _ => self.directed(&own.into_iter().map(unit).collect::<Vec<_>>()),
        })
    }

    /// Returns the rank of each robot in this order, counted from 0. Robots at the same position share a rank.
    pub fn ranks(self, reader: &mut Reader, at: &At<'_>) -> Option<Vec<usize>> {
        let own = self.own(reader, at)?;
        let mut sorted = own.clone();
        sorted.sort_unstable();
        sorted.dedup();
        let rank = |value: &i128| sorted.partition_point(|other| other < value);
        let ranks: Vec<_> = own.iter().map(|value| Fraction::from_integer(rank(value) as i128)).collect();
        let whole = |rank: &Fraction| usize::try_from(rank.to_integer()).unwrap_or_default();
        Some(self.directed(&ranks).iter().map(whole).collect())
    }

    /// Returns the integer by which each robot of the cue is ordered: its index, a random number, or nanometres.
    fn own(self, reader: &mut Reader, at: &At<'_>) -> Option<Vec<i128>> {
        let Group { robots, fleet, .. } = &reader.group;
        let count = robots.len();
        match self.by {
            By::Index => Some((0..count as i128).collect()),
            By::Random(seed) => {
                #[expect(clippy::cast_precision_loss, reason = "fewer robots than 2^53")]
                let one = |index: usize| i128::from(drawn(&[seed, index as f64]));
                Some((0..count).map(one).collect())
            }
            By::Axis(_) | By::Point(_) => {
                let one = |robot: &usize| {
                    let place = fleet.get(*robot)?.place()?;
                    Some(match self.by {
                        By::Point(point) => distance(place, point),
                        By::Axis(axis) => place[axis],
                        _ => 0,
                    })
                };
                let found: Vec<Option<i128>> = robots.iter().map(one).collect();
                let without = robots.iter().zip(&found).filter(|(_, place)| place.is_none());
                let without: Vec<&Standing> = without.filter_map(|(robot, _)| fleet.get(*robot)).collect();
                if without.is_empty() {
                    return Some(found.into_iter().flatten().collect());
                }
                let pending = no_place(at, &without);
                if without.iter().all(|robot| robot.is_lost()) {
                    reader.add_unless_others(pending);
                    return Some(vec![0; count]);
                }
                let Pending { code, place, message, expected, hint, .. } = pending;
                reader.add(code, place, message, expected, hint);
                None
            }
        }
    }

    fn directed(self, all: &[Fraction]) -> Vec<Fraction> {
        let (Some(least), Some(most)) = (all.iter().min().copied(), all.iter().max().copied()) else {
            return Vec::new();
        };
        let half = Fraction::new_raw(1, 2);
        let middle = sum(least, most) * half;
        let apart = |value: &Fraction| {
            let apart = sum(*value, -middle);
            if apart < Fraction::ZERO { -apart } else { apart }
        };
        let nearest = all.iter().map(apart).min().unwrap_or_default();
        let farthest = sum(most, -middle);
        let one = |value: &Fraction| match self.direction {
            Direction::Forward => sum(*value, -least),
            Direction::Backward => sum(most, -*value),
            Direction::Outward => sum(apart(value), -nearest),
            Direction::Inward => sum(farthest, -apart(value)),
        };
        all.iter().map(one).collect()
    }

    /// Returns the position of each robot in this order, from 0 (first) to 1 (last).
    fn shares(self, reader: &mut Reader, at: &At<'_>) -> Option<Arc<[Fraction]>> {
        if let Some((_, known)) = reader.group.shares.iter().find(|(across, _)| *across == self) {
            return Some(known.clone());
        }
        let shares: Arc<[Fraction]> = match self.by {
            By::Random(seed) => {
                #[expect(clippy::cast_precision_loss, reason = "fewer robots than 2^53")]
                let one = |index: usize| {
                    let (part, whole) = share(&[seed, index as f64]);
                    Fraction::new(part.into(), whole.into())
                };
                (0..reader.group.robots.len()).map(one).collect()
            }
            _ => parts(&self.along(reader, at)?).into(),
        };
        reader.group.shares.push((self, shares.clone()));
        Some(shares)
    }
}

/// Divides each value by the largest one. If the largest one is 0, all results are 0.
pub fn parts(all: &[Fraction]) -> Vec<Fraction> {
    let most = all.iter().max().copied().unwrap_or_default();
    let part = |value: &Fraction| if most == Fraction::ZERO { Fraction::ZERO } else { *value / most };
    all.iter().map(part).collect()
}

fn point(reader: &mut Reader, at: &At<'_>) -> Option<[f64; 3]> {
    let items = reader.list(at, EXPECTED_POINT);
    let numbers: Option<Vec<f64>> = items.iter().map(|item| reader.number(item, EXPECTED_POINT)).collect();
    let numbers = numbers?;
    if let Ok(point) = <[f64; 3]>::try_from(numbers.as_slice()) {
        return Some(point);
    }
    let message = format!("found {} entries", numbers.len());
    reader.add(Code::WrongType, at.place(), message, EXPECTED_POINT, None);
    None
}

fn no_place(at: &At<'_>, without: &[&Standing]) -> Pending {
    let shown = names(without.iter().take(NAMED_MAX).map(|robot| robot.id.as_str()));
    let message = match without.len() {
        1 => format!("the position of robot {shown} is unknown"),
        count if count > NAMED_MAX => {
            format!("the positions of robots {shown} and {} more are unknown", count - NAMED_MAX)
        }
        _ => format!("the positions of robots {shown} are unknown"),
    };
    let expected = "robots with a `body` in the fleet file whose devices have a default value or are moved by a cue above this one";
    let hint = if without.iter().any(|robot| robot.axes.is_none()) {
        "add `body: {x: 1.2}` to the robot in the fleet file, or order by `index`"
    } else {
        "set the devices of the body in a cue above this one, as in `tracks: {x: [{at: 0s, to: 1}]}`, or order by `index`"
    };
    Pending {
        code: Code::MissingKey,
        place: at.place(),
        message,
        expected: expected.to_owned(),
        hint: Some(hint.to_owned()),
        related: Vec::new(),
        affected: None,
        hint_in_block: None,
    }
}

/// Whether a node is intended as a value that is spread over the robots.
pub fn is_spread(node: &Node) -> bool {
    let Node::Map(entries) = node else { return false };
    let has = |name: &str| entries.iter().any(|(key, _)| key == name);
    has("across") || (has("from") && has("to"))
}

impl Reader {
    /// Calls `read` for one robot. Returns the result, and whether it depends on the robot.
    pub fn as_robot<T>(&mut self, robot: Robot, read: impl FnOnce(&mut Self) -> T) -> (T, bool) {
        let before = self.robots.current.replace(robot);
        self.robots.asked = false;
        let found = read(self);
        self.robots.current = before;
        (found, std::mem::take(&mut self.robots.asked))
    }

    /// Reads `{from: 0, to: 90, across: group}`. Returns the text of an expression for the robot whose movement is being read.
    pub fn spread(&mut self, at: &At<'_>) -> Option<String> {
        let SpreadKeys { from, to, across, by, seed, direction, ease } = self.keys(at, "a spread")?;
        let across = across.and_then(|at| self.word(&at, &ACROSS_WORDS));
        let ease = ease.map_or(Some(Easing::Linear), |at| self.word(&at, &Easing::WORDS));
        let order = Across::read(self, by, seed, direction);
        let (from_at, to_at) = (from, to);
        let from = from_at.and_then(|at| self.written(&at));
        let to = to_at.and_then(|at| self.written(&at));
        let Some(robot) = self.robots.current else {
            let message = "a value that is spread over the robots is not supported here";
            let hint =
                Some("use it where each robot can have its own value: tracks, parameters, scale".to_owned());
            self.add(Code::WrongType, at.place(), message, "a value that all robots share", hint);
            return None;
        };
        self.robots.asked = true;
        let ((), ease, order, from, to) = (across?, ease?, order?, from?, to?);
        if let (0, Some(at)) = (robot.index, to_at)
            && !self.is_alike(&at, [&from, &to])
        {
            return None;
        }
        let shares = order.shares(self, at)?;
        let share = shares.get(robot.index).copied().unwrap_or_default();
        self.robots.results.push(to_f64(share).to_bits());
        let share = match ease {
            Easing::Linear => format!("{} / {}", share.numer(), share.denom()),
            Easing::Step => share.to_integer().to_string(),
            ease => ease.at(to_f64(share)).to_string(),
        };
        Some(format!("({from}) + (({to}) - ({from})) * {share}"))
    }

    /// Reads a number or a time, and returns it as the text of an expression.
    fn written(&mut self, at: &At<'_>) -> Option<String> {
        match self.defined(at)? {
            Node::Number(value) if value.is_finite() => Some(value.to_string()),
            Node::Text(text) => Some(text),
            _ => {
                self.wrong_type(at, "a number or a time");
                None
            }
        }
    }
}
