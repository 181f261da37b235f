//! Bodies of robots in space.
//!
//! | module | |
//! |---|---|
//! | [`space`] | closest approaches, volumes and speeds of moving bodies; arms and driving robots |
//! | [`formation`] | places for groups of bodies |
//! | [`transit`] | a place for each body, and routes there that keep the bodies apart |

pub mod formation;
pub mod space;
pub mod transit;
