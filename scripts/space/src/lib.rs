//! Bodies of robots in space.
//!
//! | module | |
//! |---|---|
//! | [`space`] | closest approaches, volumes and speeds of moving bodies, including arms and driving robots |
//! | [`formation`] | places for groups of bodies |
//! | [`transit`] | assignment of places to bodies, and routes to these places that keep the bodies apart |

pub mod formation;
pub mod space;
pub mod transit;
