//! The transport of messages, and the disk of the scheduler's machine.

use fastrand::Rng;
use urrcp::Span;

use super::{millis, one_in};

/// The transport of messages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Network {
    /// As with TCP: in order, and lossless while the connection persists.
    Stream,
    /// As with datagrams: messages are lost, duplicated and reordered with these probabilities.
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
    /// Time until written data survives a power failure.
    pub sync: Span,
    /// Maximum size of the journal in bytes.
    pub capacity: Option<usize>,
    /// Whether the scheduler's process ends because its machine loses power.
    pub loses_power: bool,
}

pub(super) fn draw_network(rng: &mut Rng) -> Network {
    match rng.u8(0..10) {
        0..=5 => Network::Stream,
        _ => Network::Datagram { loss: rng.f64() * rng.f64() * 0.2, double: rng.f64() * 0.1 },
    }
}

/// Smallest and largest one-way delay, and the probability of a much longer one.
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
