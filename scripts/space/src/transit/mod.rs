//! How a group of bodies gets from where it is to the places of a formation without a collision.
//!
//! `assignment` says which body takes which place: `auction` finds the least sum of ways, `bottleneck` the shortest longest way, both
//! with the places in the k-d tree of `columns`. `way` says how one body moves, `approach` how close two come to each other,
//! `crossing` puts the three together. Lengths are in metres, times in seconds. Nothing here knows of robots and devices.

mod approach;
mod assignment;
mod auction;
mod bottleneck;
mod columns;
mod crossing;
#[cfg(test)]
mod tests;
mod way;

pub use assignment::Least;
pub use crossing::{Blocked, Body, Crossing, Goals, Limits, Refused, Required, cross};
pub use way::Way;
