//! The body (the simulated moving part) behind a device of a simulated robot. It follows the values that are set, with a latency and a
//! lag; a sensor shows its position with noise and a delay. A device without a body reaches each commanded value at once.

use std::collections::VecDeque;

use urrcp::{ControlType, DeviceId, RequestId, Span, Timestamp};

use super::True;
use crate::device::Motion;
use crate::robot::SetValue;

/// How a body (a simulated moving part) follows its device.
#[derive(Clone, Debug, PartialEq)]
pub struct Moves {
    /// Device that moves the body. It is controlled by position.
    pub device: DeviceId,
    /// Time from setting a value to the first motion of the body.
    pub latency: Span,
    /// Spread of the latency: 95 % of all movements start within `latency` ± `spread`.
    pub spread: Span,
    /// Time constant of the first-order lag with which the body follows its target after the latency. Zero: no lag.
    pub time_constant: Span,
    /// Sensor that shows the position of the body.
    pub sensor: DeviceId,
    /// Standard deviation of the sensor's noise, in the sensor's unit.
    pub noise: f64,
    /// Time that the sensor takes to answer. The reading shows the position at the time of the request.
    pub delay: Span,
}

/// Maximum number of pending movements of a body. Even a device with the shortest steps and the longest latency has fewer.
const PIECES_MAX: usize = 16_384;
/// Number of standard deviations within which 95 % of a normal distribution lie.
const WITHIN_95: f64 = 1.96;

/// A target that the body follows from a certain instant on: a constant value, or a linear movement to a value.
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

    /// Returns the target's change per millisecond; zero once the target has arrived at its final value.
    fn slope(self, now: Timestamp<True>) -> f64 {
        let moves = now - self.begins < self.lasts;
        if moves { (self.to - self.from) / self.lasts.as_millis_f64() } else { 0.0 }
    }

    /// Returns when the target arrives at its final value, unless the next piece starts earlier.
    fn ends(self) -> Timestamp<True> {
        self.begins + self.lasts
    }
}

/// A body, its position, and its pending movements.
#[derive(Clone, Debug)]
pub(super) struct MovedBody {
    pub(super) moves: Moves,
    /// Minimum and maximum of the sensor's readings.
    range: (f64, f64),
    /// Position of the body before any value is set.
    at_first: f64,
    rng: fastrand::Rng,
    current: Option<Piece>,
    coming: VecDeque<Piece>,
    /// Time and value of the last computed position.
    at: Option<(Timestamp<True>, f64)>,
    /// Id of the request that causes the current movement, and the latency of this movement.
    movement: Option<(Option<RequestId>, Span)>,
}

impl MovedBody {
    pub(super) const fn new(moves: Moves, range: (f64, f64), at_first: f64, rng: fastrand::Rng) -> Self {
        Self { moves, range, at_first, rng, current: None, coming: VecDeque::new(), at: None, movement: None }
    }

    /// Sets the initial position of the body.
    pub(super) const fn place(&mut self, position: f64) {
        self.at_first = position;
    }

    /// Adds a movement that the body's device was commanded to make.
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
        // A later value takes effect after the earlier ones, like commands in a queue.
        let begins = self.coming.back().map_or(begins, |last| begins.max(last.begins));
        if self.coming.len() >= PIECES_MAX {
            self.coming.pop_front();
        }
        // A body that was never read starts where its first movement starts. A single value does not show the position before it.
        let before = if lasts > Span::ZERO { from } else { self.at_first };
        self.at.get_or_insert((now, before));
        self.coming.push_back(Piece { begins, from, to, lasts });
    }

    /// Returns the latency of a movement. It is the same for all steps of a request.
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

    /// Returns the position of the body at `now`, or `rest` if no value was ever set.
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

    /// Returns the position at `to` of a body that follows a linear target with a first-order lag. This is the target minus slope × time
    /// constant, plus the remaining distance to that line, which decays exponentially.
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

    /// Returns the reading of the body's sensor at `now`. If no value was ever set, the body is at `rest`.
    pub(super) fn shown(&mut self, now: Timestamp<True>, rest: f64) -> f64 {
        let position = self.position(now, rest);
        let noise = self.moves.noise * normal(&mut self.rng);
        (position + noise).max(self.range.0).min(self.range.1)
    }
}

/// Draws a number from the standard normal distribution, by the method of Box and Muller (A note on the generation of random normal
/// deviates, 1958).
fn normal(rng: &mut fastrand::Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.f64()).cos()
}
