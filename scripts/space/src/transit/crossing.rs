//! Ways for a whole group: the assignment that needs no detour if it is nearly the shortest, otherwise delays and arcs.

use super::approach::{Approach, SLACK, closest, may_meet, meet};
use super::assignment::{Assignment, Cheapest, Least, Price, Ways};
use super::way::{CURVATURE, SLOPE, Way};
use crate::formation::{Point, ROUNDING, metres_between, pairs_within};
use downbeat_yaml::budget::Budget;

/// Prices that are tried one after another, as powers of the ways: sixteenths by which the exponents are above 1. The least sum of squares keeps straight ways apart if
/// starts and places are far enough from each other (Turpin, Michael and Kumar, Int. J. Robotics Research 33, 2014).
const SIXTEENTHS: [u8; 5] = [0, 1, 2, 6, 16];
/// Fewer prices for larger groups, the most promising ones first.
const SIXTEENTHS_OF_LARGE: [u8; 3] = [0, 16, 6];
/// Groups with more bodies are large.
const LARGE: usize = 300;
/// How much longer than the least the sum of all ways may be.
const TOTAL_MAX: f64 = 1.01;
/// A delay is so many of these parts of the time.
const DELAY_PARTS: u8 = 8;
/// Most parts of the time that a body waits.
const WAITS_MAX: u8 = 5;
/// Most layers above and below the straight way.
const LAYERS_MAX: u8 = 4;
/// How often all ways that come too close are looked at.
const ROUNDS_MAX: usize = 40;
/// Most pairs that the search for detours checks, and in larger groups for each body.
const PAIRS_MAX: usize = 5_000_000;
const PAIRS_PER_BODY_MAX: usize = 2_000;
/// What rounding may take from a distance, in metres.
const DUST: f64 = 1e-9;

/// How fast a body may be, in metres a second and a second squared; infinite if there is no limit.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Speed and acceleration along x, y and z.
    pub axes: [[f64; 2]; 3],
    /// In all directions together.
    pub body: [f64; 2],
}

impl Limits {
    /// The shortest time for a way, in seconds.
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

/// A body that takes part.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    /// The start of the body, in metres.
    pub from: Point,
    /// The distance that another body keeps from its middle, in metres: half of what is required between both, and its own radius.
    pub keep: f64,
    /// By how much its steps may be off, in metres.
    pub error: f64,
    /// By how much the grids of its devices may move its last place, in metres.
    pub rounding: f64,
    /// When its time begins, in seconds.
    pub begin: f64,
    /// How fast it may be.
    pub limits: Limits,
    /// Between which heights it can fly an arc; none if it cannot change its height.
    pub heights: Option<[f64; 2]>,
}

/// Where bodies go.
pub enum Goals<'a> {
    /// Each to the place with its own index.
    Own(&'a [Point]),
    /// Each to one of these; bodies that are left over go to their place in the second list.
    Any(&'a [Point], &'a [Point]),
}

/// What is asked.
pub struct Crossing<'a> {
    /// The bodies that take part.
    pub bodies: &'a [Body],
    /// The destinations of the bodies.
    pub goals: Goals<'a>,
    /// The quantity to minimize.
    pub least: Least,
    /// How long each body has, in seconds.
    pub over: f64,
}

/// The distance that two bodies have to keep, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Required {
    /// With what their steps may be off.
    Apart(f64),
    /// As far apart as where they begin or end, which is less than that.
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
    /// Ways that come closer than this at some time are refused.
    fn metres(self) -> f64 {
        let (Self::Apart(metres) | Self::AsAtEnds(metres) | Self::AtEnd { least: metres, .. }) = self;
        metres - DUST
    }
}

/// Two bodies for which there is no way past each other.
#[derive(Clone, Debug)]
pub struct Blocked {
    /// Their indices.
    pub pair: [usize; 2],
    /// When they are closest, in seconds.
    pub at: f64,
    /// From middle to middle, in metres.
    pub distance: f64,
    /// What is required between them, in metres.
    pub required: Required,
    /// How many pairs come too close.
    pub pairs: usize,
}

/// Why there are no ways.
#[derive(Clone, Debug)]
pub enum Refused {
    /// The shortest time that would do for all bodies, and the body that needs it.
    TooShort {
        /// Index of the body.
        body: usize,
        /// The time, in seconds.
        seconds: f64,
    },
    /// Two bodies cannot pass each other.
    Blocked(Blocked),
}

/// A time that is enough but for the rounding of its computation is enough.
const ENOUGH: f64 = 1.0 + 1e-9;

/// Ways that keep all bodies apart, and by how much the steps of each may be off, in metres: by less than its error where two bodies
/// begin or end close to each other.
#[derive(Clone, Debug)]
pub struct Crossed {
    pub ways: Vec<Way>,
    pub errors: Vec<f64>,
}

/// Finds ways that keep all bodies apart, in their order.
///
/// # Errors
/// There is too little time, or there are bodies for which no way past each other is found.
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

/// How far apart two bodies begin and end, in metres.
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
    /// The goals of all bodies, for one assignment after another.
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
            // The price of the first is the way itself.
            let optimum = *optimum.get_or_insert(total * proven);
            (self.least == Least::Longest || total <= optimum * TOTAL_MAX).then_some(goals)
        });
        Box::new(candidates)
    }

    fn straight(&self, goals: &[Point]) -> Vec<Way> {
        let way = |(body, goal): (&Body, &Point)| Way::straight(body.from, *goal, body.begin, self.over);
        self.bodies.iter().zip(goals).map(way).collect()
    }

    /// What has to be between the middles of two bodies. Where they begin or end closer, the way between cannot help it.
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

    /// The least distance between two bodies, in metres.
    fn least(&self, a: usize, b: usize) -> f64 {
        self.bodies[a].keep + self.bodies[b].keep
    }

    /// The same with what their steps may be off.
    fn apart(&self, a: usize, b: usize) -> f64 {
        self.least(a, b) + self.bodies[a].error + self.bodies[b].error + SLACK
    }

    /// What is between the ends of two bodies beyond what they keep is shared by the errors of both.
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

    /// The farthest that a body and its error reach, in metres.
    fn reach_max(&self) -> f64 {
        self.bodies.iter().map(|body| body.keep + body.error).fold(0.0, f64::max)
    }

    /// The pairs that come too close, in their order; only those of bodies that have `changed` if that is given.
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

    /// How many others come too close to a body, counted up to so many.
    fn conflicts(&self, ways: &[Way], body: usize, most: usize) -> usize {
        let others = (0..ways.len()).filter(|other| *other != body);
        let too_close = |other: &usize| {
            // What is required is never more than that.
            may_meet(&ways[body], &ways[*other], self.apart(body, *other))
                && meet(&ways[body], &ways[*other], self.required(ways, body, *other).metres())
        };
        others.filter(too_close).take(most).count()
    }

    /// Delays single bodies or leads them in an arc until all keep apart; otherwise the pair that comes closest. Each that comes too
    /// close to others takes the way on which it does to the fewest (Minton et al., Artificial Intelligence 58, 1992).
    fn detours(&self, ways: &mut [Way], mut near: Vec<Near>) -> Option<Blocked> {
        let mut room = Budget::new(PAIRS_MAX.max(PAIRS_PER_BODY_MAX * ways.len()));
        let mut fewest = (near.clone(), ways.to_vec());
        let ends_close =
            |near: &Near| matches!(self.required(ways, near.pair[0], near.pair[1]), Required::AtEnd { .. });
        // No detour helps where two end too close.
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

    /// Leads a body on the way on which it comes too close to the fewest others. In later rounds one that is no better will do as well,
    /// another one in each round: so a body leaves a place from which no single step leads on.
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

    /// Other ways to the same place: later or earlier within its time, then over or below the others, then both.
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
            // An arc is that much higher over its middle half at least.
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
