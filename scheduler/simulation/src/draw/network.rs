//! How messages travel, and the disk of the scheduler's machine.

use fastrand::Rng;
use urrcp::Span;

use super::{millis, one_in};

/// How messages travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Network {
    /// As by TCP: in order, nothing is lost as long as the connection stands.
    Stream,
    /// As by datagrams: lost, doubled and overtaken with these probabilities.
    Datagram {
        /// Probability that a message is lost.
        loss: f64,
        /// Probability that a message arrives twice.
        double: f64,
    },
}

/// The disk of the scheduler's machine.
#[derive(Clone, Copy, Debug)]
pub struct DrawnDisk {
    /// How long it takes until what was written survives a loss of power.
    pub sync: Span,
    /// The journal cannot grow beyond this many bytes.
    pub capacity: Option<usize>,
    /// When the scheduler's process ends, it is because its machine loses power.
    pub loses_power: bool,
}

pub(super) fn draw_network(rng: &mut Rng) -> Network {
    match rng.u8(0..10) {
        0..=5 => Network::Stream,
        _ => Network::Datagram { loss: rng.f64() * rng.f64() * 0.2, double: rng.f64() * 0.1 },
    }
}

/// Least and largest delay one way, and the probability of one that is much longer.
pub(super) fn draw_delay(rng: &mut Rng) -> ((Span, Span), f64) {
    let least = millis(rng, 0, 5);
    let delay = (least, least + millis(rng, 0, 20));
    (delay, if one_in(rng, 4) { rng.f64() * 0.02 } else { 0.0 })
}

pub(super) fn draw_disk(rng: &mut Rng) -> DrawnDisk {
    let sync = match rng.u8(0..3) {
        0 => Span::ZERO,
        1 => millis(rng, 0, 10),
        _ => millis(rng, 10, 300),
    };
    let capacity = one_in(rng, 20).then(|| rng.usize(1_000..12_000));
    DrawnDisk { sync, capacity, loses_power: rng.bool() }
}
