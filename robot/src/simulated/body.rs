//! The body behind a device of a simulated robot: it follows what is set with a latency and a lag, and a sensor shows it with noise and
//! a delay. Without one, a device is where it was told to be at once.

use std::collections::VecDeque;

use urrcp::{ControlType, DeviceId, RequestId, Span, Timestamp};

use super::True;
use crate::device::Motion;
use crate::robot::SetValue;

/// How a body follows its device.
#[derive(Clone, Debug, PartialEq)]
pub struct Moves {
    /// The device that is driven, by position.
    pub device: DeviceId,
    /// From the instant at which a value is set to the first motion.
    pub latency: Span,
    /// 95 % of all movements begin within `latency` ± this.
    pub spread: Span,
    /// Of the first-order lag with which it follows from then on; zero is none.
    pub time_constant: Span,
    /// The sensor that shows where the body is.
    pub sensor: DeviceId,
    /// Standard deviation of what the sensor shows, in its unit.
    pub noise: f64,
    /// How long the sensor takes to answer. The value is taken when it is asked.
    pub delay: Span,
}

/// Movements that a body has not begun: more than a device with the shortest step has within the longest latency.
const PIECES_MAX: usize = 16_384;
/// Standard deviations of a normal distribution within which 95 % of it lie.
const WITHIN_95: f64 = 1.96;

/// What the body is told, from an instant on: a value, or a way to one.
#[derive(Clone, Copy, Debug)]
struct Piece {
    begins: Timestamp<True>,
    from: f64,
    to: f64,
    lasts: Span,
}

impl Piece {
    fn value(self, now: Timestamp<True>) -> f64 {
        let since = now - self.begins;
        if since >= self.lasts {
            return self.to;
        }
        self.from + (self.to - self.from) * (since.as_millis_f64() / self.lasts.as_millis_f64()).max(0.0)
    }

    /// Its change a millisecond, until it has arrived.
    fn slope(self, now: Timestamp<True>) -> f64 {
        let moves = now - self.begins < self.lasts;
        if moves { (self.to - self.from) / self.lasts.as_millis_f64() } else { 0.0 }
    }

    /// When its slope changes, or the next piece begins.
    fn ends(self) -> Timestamp<True> {
        self.begins + self.lasts
    }
}

/// A body and where it is.
#[derive(Clone, Debug)]
pub(super) struct MovedBody {
    pub(super) moves: Moves,
    /// What the sensor can show.
    range: (f64, f64),
    /// Where it is before anything is set.
    at_first: f64,
    rng: fastrand::Rng,
    current: Option<Piece>,
    coming: VecDeque<Piece>,
    /// Where it is, and when.
    at: Option<(Timestamp<True>, f64)>,
    /// The latency of the movement under way, and the request behind it.
    movement: Option<(Option<RequestId>, Span)>,
}

impl MovedBody {
    pub(super) const fn new(moves: Moves, range: (f64, f64), at_first: f64, rng: fastrand::Rng) -> Self {
        Self { moves, range, at_first, rng, current: None, coming: VecDeque::new(), at: None, movement: None }
    }

    /// Sets the initial position of its device.
    pub(super) const fn place(&mut self, position: f64) {
        self.at_first = position;
    }

    /// Its device was told something.
    pub(super) fn told(&mut self, now: Timestamp<True>, set: &SetValue) {
        let (control_type, from, to, lasts) = match &set.motion {
            Motion::Set(setpoint) | Motion::Rest(setpoint) | Motion::Default(setpoint) => {
                (setpoint.control_type, setpoint.value, setpoint.value, Span::ZERO)
            }
            Motion::Ramp { control_type, from, to, until }
            | Motion::Slow { control_type, from, to, until } => {
                (*control_type, *from, *to, (*until - set.due).max(Span::ZERO))
            }
        };
        if control_type != ControlType::Position {
            return;
        }
        let begins = now + self.latency_of(set);
        // What is set later counts from when it is there, as in a queue of commands.
        let begins = self.coming.back().map_or(begins, |last| begins.max(last.begins));
        if self.coming.len() >= PIECES_MAX {
            self.coming.pop_front();
        }
        // A body that has never been read begins where its first way does; a value that is set says nothing of what was before.
        let before = if lasts > Span::ZERO { from } else { self.at_first };
        self.at.get_or_insert((now, before));
        self.coming.push_back(Piece { begins, from, to, lasts });
    }

    /// All steps of a movement have the same one.
    fn latency_of(&mut self, set: &SetValue) -> Span {
        match &self.movement {
            Some((request, latency)) if request.is_some() && *request == set.request_id => *latency,
            _ => {
                let deviation = self.moves.spread.as_millis_f64() / WITHIN_95;
                let drawn = Span::from_millis_f64(deviation * normal(&mut self.rng));
                let latency = (self.moves.latency + drawn).max(Span::ZERO);
                self.movement = Some((set.request_id.clone(), latency));
                latency
            }
        }
    }

    /// Where it is; at `rest` before anything was ever set.
    fn position(&mut self, now: Timestamp<True>, rest: f64) -> f64 {
        let (mut then, mut position) = self.at.unwrap_or((now, rest));
        loop {
            let next = self.coming.front().map(|piece| piece.begins).filter(|begins| *begins <= now);
            let until = next.unwrap_or(now);
            if let Some(piece) = self.current {
                let corner = piece.ends();
                if corner > then && corner < until {
                    position = self.followed(piece, position, then, corner);
                    then = corner;
                }
                position = self.followed(piece, position, then, until);
            }
            then = until;
            if next.is_none() {
                break;
            }
            self.current = self.coming.pop_front();
        }
        self.at = Some((now.max(then), position));
        position
    }

    /// The answer of a first-order lag to a line: `u(t) - slope * T`, and what is left of the distance to that.
    fn followed(&self, piece: Piece, position: f64, from: Timestamp<True>, to: Timestamp<True>) -> f64 {
        let constant = self.moves.time_constant.as_millis_f64();
        if constant <= 0.0 {
            return piece.value(to);
        }
        let behind = piece.slope(from) * constant;
        let left = position - (piece.value(from) - behind);
        let begin = piece.value(from) + piece.slope(from) * (to - from).as_millis_f64();
        begin - behind + left * (-(to - from).as_millis_f64() / constant).exp()
    }

    /// What its sensor shows. Before anything was ever set, the body is at `rest`.
    pub(super) fn shown(&mut self, now: Timestamp<True>, rest: f64) -> f64 {
        let position = self.position(now, rest);
        let noise = self.moves.noise * normal(&mut self.rng);
        (position + noise).max(self.range.0).min(self.range.1)
    }
}

/// Of the standard normal distribution, by the method of Box and Muller (A note on the generation of random normal deviates, 1958).
fn normal(rng: &mut fastrand::Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.f64()).cos()
}
