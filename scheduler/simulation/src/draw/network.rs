//! Draws the network, and the disk of the scheduler's machine.

use fastrand::Rng;
use urrcp::Span;

use super::{millis, one_in};

/// How the network transports messages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Network {
    /// The network works like TCP: messages arrive in order, and none is lost while the connection persists.
    Stream,
    /// The network works like UDP: messages may be lost, duplicated and reordered.
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
    /// Time from writing data until the data survives a power failure.
    pub sync: Span,
    /// Maximum size of the journal in bytes. `None`: unlimited.
    pub capacity: Option<usize>,
    /// Whether the machine loses power when the scheduler's process ends.
    pub loses_power: bool,
}

pub(super) fn draw_network(rng: &mut Rng) -> Network {
    match rng.u8(0..10) {
        0..=5 => Network::Stream,
        _ => Network::Datagram { loss: rng.f64() * rng.f64() * 0.2, double: rng.f64() * 0.1 },
    }
}

/// Draws the smallest and largest one-way delay, and the probability of a much longer delay.
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
