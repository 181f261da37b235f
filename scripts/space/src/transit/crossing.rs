//! Routes for a whole group: the assignment that needs no detour if it is nearly the shortest, otherwise delays and arcs.

use super::approach::{Approach, SLACK, closest, may_meet, meet};
use super::assignment::{Assignment, Cheapest, Least, Price, Ways};
use super::way::{CURVATURE, SLOPE, Way};
use crate::formation::{Point, ROUNDING, metres_between, pairs_within};
use downbeat_yaml::budget::Budget;

/// Prices tried one after another, as powers of the distances: the number of sixteenths by which the exponent exceeds 1. The least sum of
/// squares keeps straight routes apart if starts and places are far enough from each other (Turpin, Michael and Kumar, Int. J. Robotics
/// Research 33, 2014).
const SIXTEENTHS: [u8; 5] = [0, 1, 2, 6, 16];
/// Fewer prices for larger groups, the most promising ones first.
const SIXTEENTHS_OF_LARGE: [u8; 3] = [0, 16, 6];
/// Groups with more bodies than this are large.
const LARGE: usize = 300;
/// Largest permitted ratio of the sum of all distances to the least sum.
const TOTAL_MAX: f64 = 1.01;
/// Number of parts into which the time is divided for delays.
const DELAY_PARTS: u8 = 8;
/// Maximum number of these parts that a body waits.
const WAITS_MAX: u8 = 5;
/// Maximum number of layers above and below the straight route.
const LAYERS_MAX: u8 = 4;
/// Maximum number of passes over all routes that come too close.
const ROUNDS_MAX: usize = 40;
/// Maximum number of pairs that the search for detours checks; in larger groups, the second limit applies per body.
const PAIRS_MAX: usize = 5_000_000;
const PAIRS_PER_BODY_MAX: usize = 2_000;
/// Rounding error of a distance, in metres.
const DUST: f64 = 1e-9;

/// Limits of a body, in metres per second and per second squared; infinite if there is no limit.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Speed and acceleration along x, y and z.
    pub axes: [[f64; 2]; 3],
    /// Speed and acceleration in any direction.
    pub body: [f64; 2],
}

impl Limits {
    /// Returns the shortest time for a route, in seconds.
    fn time_for(&self, way: &Way) -> f64 {
        let time = |reach: f64, lift: f64, [speed, acceleration]: [f64; 2]| {
            let bend = CURVATURE * (reach + 4.0 * lift) + SLOPE * SLOPE * 8.0 * lift;
            (SLOPE * (reach + 4.0 * lift) / speed).max((bend / acceleration).sqrt())
        };
        let (vector, lift) = (way.vector().map(f64::abs), way.lift.abs());
        let lifts = [0.0, 0.0, lift];
        let axes = (0..3).map(|axis| time(vector[axis], lifts[axis], self.axes[axis]));
        let [x, y, z] = vector;
        axes.fold(time(x.hypot(y).hypot(z), lift, self.body), f64::max)
    }
}

/// A body in transit.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    /// The start of the body, in metres.
    pub from: Point,
    /// The distance that another body keeps from its middle, in metres: half of the required distance plus its own radius.
    pub keep: f64,
    /// Possible deviation of its steps, in metres.
    pub error: f64,
    /// Possible deviation of its last place because of the grids of its devices, in metres.
    pub rounding: f64,
    /// The beginning of its time, in seconds.
    pub begin: f64,
    /// Limits of its speed and acceleration.
    pub limits: Limits,
    /// Range of heights for an arc; `None` if it cannot change its height.
    pub heights: Option<[f64; 2]>,
}

/// The destinations of bodies.
pub enum Goals<'a> {
    /// Each body moves to the place with its own index.
    Own(&'a [Point]),
    /// Each body moves to one of the first places; surplus bodies move to their place in the second list.
    Any(&'a [Point], &'a [Point]),
}

/// The task of a group.
pub struct Crossing<'a> {
    /// The bodies that take part.
    pub bodies: &'a [Body],
    /// The destinations of the bodies.
    pub goals: Goals<'a>,
    /// The quantity to minimize.
    pub least: Least,
    /// The time for each body, in seconds.
    pub over: f64,
}

/// The distance that two bodies must keep, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Required {
    /// The regular distance, including the deviation of their steps.
    Apart(f64),
    /// The distance of their starts or ends, which is smaller than the regular distance.
    AsAtEnds(f64),
    /// The ends of two bodies are closer to each other than permitted.
    AtEnd {
        /// The distance between their ends.
        end: f64,
        /// The minimum distance between them.
        least: f64,
    },
}

impl Required {
    /// Returns the distance below which routes are rejected.
    fn metres(self) -> f64 {
        let (Self::Apart(metres) | Self::AsAtEnds(metres) | Self::AtEnd { least: metres, .. }) = self;
        metres - DUST
    }
}

/// Two bodies that cannot pass each other.
#[derive(Clone, Debug)]
pub struct Blocked {
    /// Their indices.
    pub pair: [usize; 2],
    /// The time at which they are closest, in seconds.
    pub at: f64,
    /// From middle to middle, in metres.
    pub distance: f64,
    /// The required distance, in metres.
    pub required: Required,
    /// Number of pairs that come too close.
    pub pairs: usize,
}

/// The reason why there are no routes.
#[derive(Clone, Debug)]
pub enum Refused {
    /// The time is too short for a body.
    TooShort {
        /// Index of the body.
        body: usize,
        /// The shortest time that suffices for all bodies, in seconds.
        seconds: f64,
    },
    /// Two bodies cannot pass each other.
    Blocked(Blocked),
}

/// Tolerance factor for rounding errors in the computed time.
const ENOUGH: f64 = 1.0 + 1e-9;

/// Routes that keep all bodies apart, with the permitted deviation of the steps of each body, in metres. The latter is less than the
/// body's `error` if two bodies begin or end close to each other.
#[derive(Clone, Debug)]
pub struct Crossed {
    pub ways: Vec<Way>,
    pub errors: Vec<f64>,
}

/// Finds routes that keep all bodies apart, in their order.
///
/// # Errors
/// The time is too short, or no route was found on which certain bodies can pass each other.
pub fn cross(crossing: &Crossing<'_>) -> Result<Crossed, Refused> {
    let mut best: Option<(Vec<Way>, Vec<Near>)> = None;
    let mut needed = (0, f64::INFINITY);
    for goals in crossing.candidates() {
        let ways = crossing.straight(&goals);
        let times = crossing.bodies.iter().zip(&ways).map(|(body, way)| body.limits.time_for(way));
        let (body, seconds) =
            times.enumerate().fold((0, 0.0), |most, time| if time.1 > most.1 { time } else { most });
        if seconds > crossing.over * ENOUGH {
            if seconds < needed.1 {
                needed = (body, seconds);
            }
            continue;
        }
        let near = crossing.near(&ways, None);
        if near.is_empty() {
            return Ok(crossing.crossed(ways));
        }
        if best.as_ref().is_none_or(|(_, known)| near.len() < known.len()) {
            best = Some((ways, near));
        }
    }
    let Some((mut ways, near)) = best else {
        let (body, seconds) = needed;
        return Err(Refused::TooShort { body, seconds });
    };
    match crossing.detours(&mut ways, near) {
        None => Ok(crossing.crossed(ways)),
        Some(blocked) => Err(Refused::Blocked(blocked)),
    }
}

/// Returns the distances between the starts and between the ends of two bodies, in metres.
fn ends(a: &Way, b: &Way) -> [f64; 2] {
    [metres_between(a.from, b.from), metres_between(a.to, b.to)]
}

/// Two bodies that come too close.
#[derive(Clone, Copy, Debug)]
struct Near {
    pair: [usize; 2],
    approach: Approach,
}

impl Crossing<'_> {
    /// Returns the goals of all bodies, one assignment after another.
    fn candidates(&self) -> Box<dyn Iterator<Item = Vec<Point>> + '_> {
        let (places, spare) = match self.goals {
            Goals::Own(own) => return Box::new(std::iter::once(own.to_vec())),
            Goals::Any(places, spare) => (places, spare),
        };
        let starts: Vec<Point> = self.bodies.iter().map(|body| body.from).collect();
        let ways = Ways::between(&starts, places, spare);
        let longest = match self.least {
            Least::Total => f64::INFINITY,
            Least::Longest => ways.shortest_longest() * (1.0 + DUST),
        };
        let goals = move |assignment: Assignment| -> Vec<Point> {
            let goals = assignment.into_iter().zip(spare);
            goals.map(|(place, spare)| place.map_or(*spare, |place| places[place])).collect()
        };
        let mut optimum = None;
        let prices = if starts.len() > LARGE { &SIXTEENTHS_OF_LARGE[..] } else { &SIXTEENTHS[..] };
        let candidates = prices.iter().filter_map(move |sixteenths| {
            let Cheapest { assignment, proven } = ways.cheapest(Price { sixteenths: *sixteenths, longest });
            let goals = goals(assignment);
            let total: f64 =
                starts.iter().zip(&goals).map(|(start, goal)| metres_between(*start, *goal)).sum();
            // The first price is the distance itself.
            let optimum = *optimum.get_or_insert(total * proven);
            (self.least == Least::Longest || total <= optimum * TOTAL_MAX).then_some(goals)
        });
        Box::new(candidates)
    }

    fn straight(&self, goals: &[Point]) -> Vec<Way> {
        let way = |(body, goal): (&Body, &Point)| Way::straight(body.from, *goal, body.begin, self.over);
        self.bodies.iter().zip(goals).map(way).collect()
    }

    /// Returns the required distance between the middles of two bodies. If they begin or end closer, the route cannot avoid that.
    fn required(&self, ways: &[Way], a: usize, b: usize) -> Required {
        let [begin, end] = ends(&ways[a], &ways[b]);
        let [least, apart] = [self.least(a, b), self.apart(a, b)];
        let rounding = ROUNDING + self.bodies[a].rounding + self.bodies[b].rounding;
        match begin.min(end) {
            _ if end < least - rounding => Required::AtEnd { end, least },
            closest if closest < apart => Required::AsAtEnds(closest),
            _ => Required::Apart(apart),
        }
    }

    /// Returns the least distance between the middles of two bodies, in metres.
    fn least(&self, a: usize, b: usize) -> f64 {
        self.bodies[a].keep + self.bodies[b].keep
    }

    /// Returns this distance plus the deviations of their steps.
    fn apart(&self, a: usize, b: usize) -> f64 {
        self.least(a, b) + self.bodies[a].error + self.bodies[b].error + SLACK
    }

    /// Distributes the excess distance between the ends of two bodies over the errors of both.
    fn crossed(&self, ways: Vec<Way>) -> Crossed {
        let mut errors: Vec<f64> = self.bodies.iter().map(|body| body.error).collect();
        let (starts, ends): (Vec<Point>, Vec<Point>) = ways.iter().map(|way| (way.from, way.to)).unzip();
        let reach = 2.0 * self.reach_max() + SLACK;
        for (a, b) in pairs_within(&starts, reach).chain(pairs_within(&ends, reach)) {
            if let Required::AsAtEnds(distance) = self.required(&ways, a, b) {
                let room = ((distance - self.least(a, b)) / 2.0).max(0.0);
                errors[a] = errors[a].min(room);
                errors[b] = errors[b].min(room);
            }
        }
        Crossed { ways, errors }
    }

    /// Returns the largest radius of a body including its error, in metres.
    fn reach_max(&self) -> f64 {
        self.bodies.iter().map(|body| body.keep + body.error).fold(0.0, f64::max)
    }

    /// Returns the pairs that come too close, in their order; with `changed`, only those of changed bodies.
    fn near(&self, ways: &[Way], changed: Option<&[bool]>) -> Vec<Near> {
        let mut order: Vec<usize> = (0..ways.len()).collect();
        let bounds: Vec<[Point; 2]> = ways.iter().map(Way::bounds).collect();
        order.sort_by(|a, b| bounds[*a][0][0].total_cmp(&bounds[*b][0][0]));
        let reach_max = self.reach_max();
        let is_due = |a: usize, b: usize| changed.is_none_or(|changed| changed[a] || changed[b]);
        let mut near = Vec::new();
        for (index, &a) in order.iter().enumerate() {
            let reaches = bounds[a][1][0] + self.bodies[a].keep + self.bodies[a].error + reach_max + SLACK;
            for &b in order[index + 1..].iter().take_while(|b| bounds[**b][0][0] <= reaches) {
                let pair = [a.min(b), a.max(b)];
                if is_due(a, b) && may_meet(&ways[pair[0]], &ways[pair[1]], self.apart(a, b)) {
                    let required = self.required(ways, a, b).metres();
                    let found = closest(&ways[pair[0]], &ways[pair[1]], required);
                    near.extend(found.map(|approach| Near { pair, approach }));
                }
            }
        }
        near.sort_by_key(|near| near.pair);
        near
    }

    /// Returns the number of other bodies that come too close to a body, at most `most`.
    fn conflicts(&self, ways: &[Way], body: usize, most: usize) -> usize {
        let others = (0..ways.len()).filter(|other| *other != body);
        let too_close = |other: &usize| {
            // The required distance never exceeds this.
            may_meet(&ways[body], &ways[*other], self.apart(body, *other))
                && meet(&ways[body], &ways[*other], self.required(ways, body, *other).metres())
        };
        others.filter(too_close).take(most).count()
    }

    /// Delays single bodies or leads them in an arc until all bodies keep apart; otherwise returns the closest pair. Each body that comes
    /// too close to others takes the route on which it comes too close to the fewest (Minton et al., Artificial Intelligence 58, 1992).
    fn detours(&self, ways: &mut [Way], mut near: Vec<Near>) -> Option<Blocked> {
        let mut room = Budget::new(PAIRS_MAX.max(PAIRS_PER_BODY_MAX * ways.len()));
        let mut fewest = (near.clone(), ways.to_vec());
        let ends_close =
            |near: &Near| matches!(self.required(ways, near.pair[0], near.pair[1]), Required::AtEnd { .. });
        // No detour helps if two bodies end too close to each other.
        let rounds = if near.iter().any(ends_close) { 0 } else { ROUNDS_MAX };
        for round in 0..rounds {
            let mut crowded = vec![0usize; ways.len()];
            near.iter().flat_map(|near| near.pair).for_each(|body| crowded[body] += 1);
            let mut bodies: Vec<usize> = (0..ways.len()).filter(|body| crowded[*body] > 0).collect();
            bodies.sort_by_key(|body| (std::cmp::Reverse(crowded[*body]), *body));
            let mut changed = vec![false; ways.len()];
            for body in bodies {
                let before = ways[body];
                self.avoid(ways, body, round, &mut room);
                changed[body] = ways[body] != before;
            }
            near.retain(|near| near.pair.iter().all(|body| !changed[*body]));
            near.extend(self.near(ways, Some(&changed)));
            near.sort_by_key(|near| near.pair);
            if near.is_empty() {
                return None;
            }
            if near.len() < fewest.0.len() {
                fewest = (near.clone(), ways.to_vec());
            }
            if room.is_overdrawn() {
                break;
            }
        }
        let (near, ways) = fewest;
        let worst = near.iter().min_by(|a, b| a.approach.distance.total_cmp(&b.approach.distance))?;
        let [a, b] = worst.pair;
        Some(Blocked {
            pair: worst.pair,
            at: worst.approach.at,
            distance: worst.approach.distance,
            required: self.required(&ways, a, b),
            pairs: near.len(),
        })
    }

    /// Leads a body along the route on which it comes too close to the fewest others. In later rounds, an equally good route is accepted
    /// as well, a different one in each round, so that bodies leave local minima.
    fn avoid(&self, ways: &mut [Way], body: usize, round: usize, room: &mut Budget) {
        let mut best = ways[body];
        let mut fewest = self.conflicts(ways, body, usize::MAX);
        let straight = Way::straight(best.from, best.to, self.bodies[body].begin, self.over);
        let mut alternatives = self.alternatives(&straight, body);
        let turned = round % alternatives.len().max(1);
        alternatives.rotate_left(turned);
        for way in alternatives {
            if fewest == 0 || !room.take(ways.len()) {
                break;
            }
            let enough = if round > 1 { fewest + 1 } else { fewest };
            ways[body] = way;
            let conflicts = self.conflicts(ways, body, enough);
            if conflicts < enough && way != best {
                (best, fewest) = (way, conflicts);
            }
        }
        ways[body] = best;
    }

    /// Returns other routes to the same place: first shifted in time, then above or below the others, then both.
    fn alternatives(&self, straight: &Way, index: usize) -> Vec<Way> {
        let body = &self.bodies[index];
        let mut windows = vec![(straight.begin, straight.length)];
        for parts in 1..=WAITS_MAX {
            let wait = straight.length * f64::from(parts) / f64::from(DELAY_PARTS);
            windows.push((straight.begin + wait, straight.length - wait));
            windows.push((straight.begin, straight.length - wait));
        }
        let mut lifts = vec![0.0];
        for layer in 1..=LAYERS_MAX {
            // The middle half of an arc is at least this much higher.
            let height = 2.0 * (body.keep + body.error) * f64::from(layer) * 4.0 / 3.0;
            lifts.extend([height, -height]);
        }
        let within = |way: &Way| {
            let [least, most] = way.bounds();
            way.lift == 0.0 || body.heights.is_some_and(|[low, high]| least[2] >= low && most[2] <= high)
        };
        let ways = lifts.iter().flat_map(|lift| {
            windows.iter().map(|(begin, length)| Way {
                begin: *begin,
                length: *length,
                lift: *lift,
                ..*straight
            })
        });
        ways.filter(|way| body.limits.time_for(way) <= way.length * ENOUGH && within(way)).collect()
    }
}
