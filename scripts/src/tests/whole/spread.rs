//! Numbers that differ between the robots of a cue.

use num_rational::Ratio;

use super::PLACES;

/// A number that may differ between the robots of a cue, in the unit in which it is drawn.
#[derive(Clone, Copy, Debug)]
pub(super) enum Each {
    Same(i64),
    /// The expression from + by * share, where the share depends on the robot.
    Expression {
        from: i64,
        by: i64,
        share: Share,
    },
    Spread {
        from: i64,
        to: i64,
        by: By,
        direction: Direction,
        ease: Ease,
    },
}

/// The part of an expression that depends on the robot's index.
#[derive(Clone, Copy, Debug)]
pub(super) enum Share {
    Index,
    Part,
    Left,
    /// A random number for each robot, from this seed.
    Random(u64),
}

#[derive(Clone, Copy, Debug)]
pub(super) enum By {
    Index,
    X,
    /// The distance from a point on the x axis; contains the x coordinate in millimetres.
    Point(i64),
    Random(u64),
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Direction {
    Forward,
    Backward,
    Outward,
    Inward,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Ease {
    Linear,
    Smooth,
    Cubic,
    Step,
}

impl Each {
    pub(super) fn differs(self) -> bool {
        !matches!(self, Self::Same(_))
    }

    /// Returns the number with a constant added for all robots.
    pub(super) fn plus(self, more: i64) -> Self {
        match self {
            Self::Same(value) => Self::Same(value + more),
            Self::Expression { from, by, share } => Self::Expression { from: from + more, by, share },
            Self::Spread { from, to, by, direction, ease } => {
                Self::Spread { from: from + more, to: to + more, by, direction, ease }
            }
        }
    }

    /// Returns an upper bound for the number over at most four robots; not valid if `by` is negative.
    pub(super) fn most(self) -> i64 {
        match self {
            Self::Same(value) => value,
            Self::Expression { from, by, .. } => from + 4 * by,
            Self::Spread { from, to, .. } => from.max(to),
        }
    }

    /// Returns the value for the robot at `index` in the list `robots`.
    pub(super) fn of(self, robots: &[usize], index: usize) -> Ratio<i128> {
        let whole = |value: i64| Ratio::from_integer(i128::from(value));
        match self {
            Self::Same(value) => whole(value),
            Self::Expression { from, by, share } => {
                let (number, count) = (index as i128, robots.len() as i128);
                whole(from)
                    + whole(by)
                        * match share {
                            Share::Index => Ratio::from_integer(number),
                            Share::Part => Ratio::new(number, count),
                            Share::Left => Ratio::from_integer(count - number),
                            Share::Random(seed) => random(seed, index),
                        }
            }
            Self::Spread { from, to, by, direction, ease } => {
                let part = match by {
                    By::Random(seed) => random(seed, index),
                    _ => part(by, direction, robots, index),
                };
                whole(from) + whole(to - from) * eased(ease, part)
            }
        }
    }

    /// Returns the number as text for a scenario, with the text `base` before it and the unit after each constant.
    pub(super) fn yaml(self, base: &str, unit: impl Fn(i64) -> String) -> String {
        match self {
            Self::Same(value) => format!("{base}{}", unit(value)),
            Self::Expression { from, by, share } => {
                let share = match share {
                    Share::Index => "$index".to_owned(),
                    Share::Part => "$index / $count".to_owned(),
                    Share::Left => "($count - $index)".to_owned(),
                    Share::Random(seed) => format!("random({seed}, $index)"),
                };
                format!("\"{base}{} + {} * {share}\"", unit(from), unit(by))
            }
            Self::Spread { from, to, by, direction, ease } => {
                let by = match by {
                    By::Index => String::new(),
                    By::X => ", by: x".to_owned(),
                    By::Point(x) => format!(", by: [{}, 0, 0]", x as f64 / 1_000.0),
                    By::Random(seed) => format!(", by: random, seed: {seed}"),
                };
                let direction = match direction {
                    Direction::Forward => "",
                    Direction::Backward => ", direction: backward",
                    Direction::Outward => ", direction: outward",
                    Direction::Inward => ", direction: inward",
                };
                let ease = match ease {
                    Ease::Linear => "",
                    Ease::Smooth => ", ease: smooth",
                    Ease::Cubic => ", ease: cubic",
                    Ease::Step => ", ease: step",
                };
                let (from, to) = (unit(from), unit(to));
                format!("{{from: {base}{from}, to: {base}{to}, across: group{by}{direction}{ease}}}")
            }
        }
    }
}

/// Returns the position of a robot between the first robot and the last one, from 0 to 1.
fn part(by: By, direction: Direction, robots: &[usize], index: usize) -> Ratio<i128> {
    // Positions are doubled, so that the middle is a whole number.
    let place = |(number, robot): (usize, &usize)| {
        2 * match by {
            By::X => PLACES[*robot],
            By::Point(x) => (PLACES[*robot] - i128::from(x)).abs(),
            By::Index | By::Random(_) => number as i128,
        }
    };
    let places: Vec<i128> = robots.iter().enumerate().map(place).collect();
    let (first, last) = (places.iter().copied().min(), places.iter().copied().max());
    let middle = (first.unwrap_or(0) + last.unwrap_or(0)) / 2;
    let along = |place: &i128| match direction {
        Direction::Forward => *place,
        Direction::Backward => -place,
        Direction::Outward => (place - middle).abs(),
        Direction::Inward => -(place - middle).abs(),
    };
    let ways: Vec<i128> = places.iter().map(along).collect();
    let (least, most) = (ways.iter().min().copied(), ways.iter().max().copied());
    let (least, most) = (least.unwrap_or(0), most.unwrap_or(0));
    if least == most { Ratio::from_integer(0) } else { Ratio::new(ways[index] - least, most - least) }
}

fn eased(ease: Ease, s: Ratio<i128>) -> Ratio<i128> {
    let whole = Ratio::from_integer;
    match ease {
        Ease::Linear => s,
        Ease::Smooth => s * s * s * (whole(10) - whole(15) * s + whole(6) * s * s),
        Ease::Cubic => s * s * (whole(3) - whole(2) * s),
        Ease::Step => s.floor(),
    }
}

/// Returns a random number: SplitMix64, applied to the seed and then to the index.
fn random(seed: u64, index: usize) -> Ratio<i128> {
    let next = |state: u64, number: u64| {
        let mut z = state.wrapping_add(number).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    Ratio::new(i128::from(next(next(0, seed), index as u64) >> 11), 1 << 53)
}
