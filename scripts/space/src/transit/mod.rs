//! Moves a group of bodies from their places to the places of a formation without collisions.
//!
//! `assignment` determines which body takes which place: `auction` finds the least sum of distances, and `bottleneck` the least longest
//! distance. Both have the places in the k-d tree of `columns`. `way` describes the movement of one body, `approach` finds how close two
//! bodies come to each other, and `crossing` combines them. Lengths are in metres, times in seconds. This module does not depend on
//! robots and devices.

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
pub use way::Route;
