//! Routes for a whole group: an assignment without detours if its sum is close to the least one, otherwise delays and arcs.

use super::approach::{Approach, SLACK, closest, may_meet, meet};
use super::assignment::{Assignment, Cheapest, Least, Price, Ways};
use super::way::{CURVATURE, Route, SLOPE};
use crate::formation::{Point, ROUNDING, metres_between, pairs_within};
use downbeat_yaml::budget::Budget;

/// Prices to try one after another, as powers of the distances: each number is the exponent minus 1, in sixteenths. The least sum of
/// squares keeps straight routes apart if starts and places are far enough from each other (Turpin, Michael and Kumar, Int. J. Robotics
/// Research 33, 2014).
const SIXTEENTHS: [u8; 5] = [0, 1, 2, 6, 16];
/// Like [`SIXTEENTHS`], for large groups: fewer prices, the most promising ones first.
const SIXTEENTHS_OF_LARGE: [u8; 3] = [0, 16, 6];
/// Largest number of bodies in a group that is not large.
const LARGE: usize = 300;
/// Largest permitted ratio of an assignment's sum of distances to the least sum.
const TOTAL_MAX: f64 = 1.01;
/// Number of parts into which the duration is divided for delays.
const DELAY_PARTS: u8 = 8;
/// Longest wait of a body before or after its movement, in parts of the duration ([`DELAY_PARTS`]).
const WAITS_MAX: u8 = 5;
/// Maximum number of layers of arcs above, and below, the straight route.
const LAYERS_MAX: u8 = 4;
/// Maximum number of passes over all routes on which bodies come too close.
const ROUNDS_MAX: usize = 40;
/// Maximum number of pairs that the search for detours checks. For larger groups, the limit is [`PAIRS_PER_BODY_MAX`] per body.
const PAIRS_MAX: usize = 5_000_000;
const PAIRS_PER_BODY_MAX: usize = 2_000;
/// Rounding error of a distance, in metres, and of a ratio of distances.
const DUST: f64 = 1e-9;

/// Limits of a body's speed and acceleration, in m/s and m/s²; infinite for no limit.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Largest speed and acceleration along each of x, y and z.
    pub axes: [[f64; 2]; 3],
    /// Largest speed and acceleration in any direction.
    pub body: [f64; 2],
}

impl Limits {
    /// Returns the shortest time in which the body can take a route, in seconds.
    fn time_for(&self, way: &Route) -> f64 {
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

/// A body on its way to a place.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    /// Start of the body, in metres.
    pub from: Point,
    /// This body's share of the least distance between its middle and that of another body, in metres: half of the required distance
    /// plus its own radius.
    pub keep: f64,
    /// Possible deviation of the body's steps from its route, in metres.
    pub error: f64,
    /// Possible deviation of the body's last place because of the grids of its devices, in metres.
    pub rounding: f64,
    /// Earliest start of the body's movement, in seconds.
    pub begin: f64,
    /// Limits of the body's speed and acceleration.
    pub limits: Limits,
    /// Range of heights in which the body may fly an arc, in metres; `None` if it cannot change its height.
    pub heights: Option<[f64; 2]>,
}

/// The destinations of bodies.
pub enum Goals<'a> {
    /// Each body moves to the place at its own index.
    Own(&'a [Point]),
    /// Each body moves to one of the places in the first list; surplus bodies move to the place at their own index in the second list.
    Any(&'a [Point], &'a [Point]),
}

/// The task of a group: to move all bodies to their places without collisions.
pub struct Crossing<'a> {
    /// Bodies that take part.
    pub bodies: &'a [Body],
    /// Destinations of the bodies.
    pub goals: Goals<'a>,
    /// The quantity that the assignment minimizes.
    pub least: Least,
    /// Time that each body has for its movement, in seconds.
    pub over: f64,
}

/// The distance that two bodies must keep, from middle to middle, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Required {
    /// The distance that bodies must keep, plus the distances by which the steps of both bodies may deviate from their paths.
    Apart(f64),
    /// The distance between the bodies' starts or ends, which is smaller than the distance that bodies must keep.
    AsAtEnds(f64),
    /// The ends of two bodies are closer to each other than permitted.
    AtEnd {
        /// Distance between the ends.
        end: f64,
        /// Minimum distance between the ends.
        least: f64,
    },
}

impl Required {
    /// Returns the distance below which two routes are rejected, in metres.
    fn metres(self) -> f64 {
        let (Self::Apart(metres) | Self::AsAtEnds(metres) | Self::AtEnd { least: metres, .. }) = self;
        metres - DUST
    }
}

/// Two bodies that cannot pass each other.
#[derive(Clone, Debug)]
pub struct Blocked {
    /// Indices of the two bodies.
    pub pair: [usize; 2],
    /// Time at which the bodies are closest, in seconds.
    pub at: f64,
    /// Distance at that time, from middle to middle, in metres.
    pub distance: f64,
    /// Distance that the bodies must keep.
    pub required: Required,
    /// Number of pairs of bodies that come too close.
    pub pairs: usize,
}

/// The reason why no routes were found.
#[derive(Clone, Debug)]
pub enum Refused {
    /// A body cannot move so far in the given duration.
    TooShort {
        /// Index of the body.
        body: usize,
        /// The shortest duration that suffices for all bodies, in seconds.
        seconds: f64,
    },
    /// Two bodies cannot pass each other.
    Blocked(Blocked),
}

/// Tolerance factor for rounding errors in the computed time.
const ENOUGH: f64 = 1.0 + 1e-9;

/// Routes that keep all bodies apart, with the permitted deviation of each body's steps, in metres. The deviation is less than
/// [`Body::error`] for bodies that begin or end close to each other.
#[derive(Clone, Debug)]
pub struct Crossed {
    pub ways: Vec<Route>,
    pub errors: Vec<f64>,
}

/// Finds routes that keep all bodies apart. The routes are in the order of the bodies.
///
/// # Errors
/// Returns the reason if the duration is too short, or if no route was found on which certain bodies can pass each other.
pub fn cross(crossing: &Crossing<'_>) -> Result<Crossed, Refused> {
    let mut best: Option<(Vec<Route>, Vec<Near>)> = None;
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
fn ends(a: &Route, b: &Route) -> [f64; 2] {
    [metres_between(a.from, b.from), metres_between(a.to, b.to)]
}

/// Two bodies that come too close, with their closest approach.
#[derive(Clone, Copy, Debug)]
struct Near {
    pair: [usize; 2],
    approach: Approach,
}

impl Crossing<'_> {
    /// Returns candidate assignments one after another, each as the goals of all bodies.
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
            // The first price is the distance itself, so its sum gives the optimum.
            let optimum = *optimum.get_or_insert(total * proven);
            (self.least == Least::Longest || total <= optimum * TOTAL_MAX).then_some(goals)
        });
        Box::new(candidates)
    }

    fn straight(&self, goals: &[Point]) -> Vec<Route> {
        let way = |(body, goal): (&Body, &Point)| Route::straight(body.from, *goal, body.begin, self.over);
        self.bodies.iter().zip(goals).map(way).collect()
    }

    /// Returns the required distance between the middles of two bodies. If the bodies begin or end closer to each other, a smaller
    /// distance is required.
    fn required(&self, ways: &[Route], a: usize, b: usize) -> Required {
        let [begin, end] = ends(&ways[a], &ways[b]);
        let [least, apart] = [self.least(a, b), self.apart(a, b)];
        let rounding = ROUNDING + self.bodies[a].rounding + self.bodies[b].rounding;
        match begin.min(end) {
            _ if end < least - rounding => Required::AtEnd { end, least },
            closest if closest < apart => Required::AsAtEnds(closest),
            _ => Required::Apart(apart),
        }
    }

    /// Returns the least permitted distance between the middles of two bodies, in metres.
    fn least(&self, a: usize, b: usize) -> f64 {
        self.bodies[a].keep + self.bodies[b].keep
    }

    /// Returns the least permitted distance plus the deviations of both bodies' steps, in metres.
    fn apart(&self, a: usize, b: usize) -> f64 {
        self.least(a, b) + self.bodies[a].error + self.bodies[b].error + SLACK
    }

    /// Reduces the permitted errors of bodies that begin or end close to each other: each gets half of the amount by which their distance
    /// exceeds the least permitted one.
    fn crossed(&self, ways: Vec<Route>) -> Crossed {
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

    /// Returns the largest sum of a body's `keep` and `error`, in metres.
    fn reach_max(&self) -> f64 {
        self.bodies.iter().map(|body| body.keep + body.error).fold(0.0, f64::max)
    }

    /// Returns the pairs of bodies that come too close, in order of their indices. With `changed`, returns only pairs with a changed
    /// body.
    fn near(&self, ways: &[Route], changed: Option<&[bool]>) -> Vec<Near> {
        let mut order: Vec<usize> = (0..ways.len()).collect();
        let bounds: Vec<[Point; 2]> = ways.iter().map(Route::bounds).collect();
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

    /// Returns the number of other bodies that come too close to `body`; stops counting at `most`.
    fn conflicts(&self, ways: &[Route], body: usize, most: usize) -> usize {
        let others = (0..ways.len()).filter(|other| *other != body);
        let too_close = |other: &usize| {
            // The required distance never exceeds `apart`.
            may_meet(&ways[body], &ways[*other], self.apart(body, *other))
                && meet(&ways[body], &ways[*other], self.required(ways, body, *other).metres())
        };
        others.filter(too_close).take(most).count()
    }

    /// Delays single bodies or leads them in arcs until all bodies keep apart. If that fails, returns the closest pair. Each body that
    /// comes too close to others takes the route with the fewest conflicts (Minton et al., Artificial Intelligence 58, 1992).
    fn detours(&self, ways: &mut [Route], mut near: Vec<Near>) -> Option<Blocked> {
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

    /// Leads a body along the route on which it comes too close to the fewest others. Later rounds also accept a route with as many
    /// conflicts, a different one in each round, so that bodies leave local minima.
    fn avoid(&self, ways: &mut [Route], body: usize, round: usize, room: &mut Budget) {
        let mut best = ways[body];
        let mut fewest = self.conflicts(ways, body, usize::MAX);
        let straight = Route::straight(best.from, best.to, self.bodies[body].begin, self.over);
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

    /// Returns other routes of a body to the same place: first shifted in time, then above or below the others, then both.
    fn alternatives(&self, straight: &Route, index: usize) -> Vec<Route> {
        let body = &self.bodies[index];
        let mut windows = vec![(straight.begin, straight.length)];
        for parts in 1..=WAITS_MAX {
            let wait = straight.length * f64::from(parts) / f64::from(DELAY_PARTS);
            windows.push((straight.begin + wait, straight.length - wait));
            windows.push((straight.begin, straight.length - wait));
        }
        let mut lifts = vec![0.0];
        for layer in 1..=LAYERS_MAX {
            // In its middle half, an arc is at least 3/4 of its height away from the straight route.
            let height = 2.0 * (body.keep + body.error) * f64::from(layer) * 4.0 / 3.0;
            lifts.extend([height, -height]);
        }
        let within = |way: &Route| {
            let [least, most] = way.bounds();
            way.lift == 0.0 || body.heights.is_some_and(|[low, high]| least[2] >= low && most[2] <= high)
        };
        let ways = lifts.iter().flat_map(|lift| {
            windows.iter().map(|(begin, length)| Route {
                begin: *begin,
                length: *length,
                lift: *lift,
                ..*straight
            })
        });
        ways.filter(|way| body.limits.time_for(way) <= way.length * ENOUGH && within(way)).collect()
    }
}
