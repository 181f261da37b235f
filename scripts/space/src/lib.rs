//! Bodies of robots in space.
//!
//! | module | |
//! |---|---|
//! | [`space`] | closest approaches, volumes and speeds of moving bodies; arms and robots that drive |
//! | [`formation`] | places for groups of bodies |
//! | [`transit`] | which body takes which place, and ways there that keep apart |

pub mod formation;
pub mod space;
pub mod transit;
