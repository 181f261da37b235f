//! Missions in virtual time, with the same state machine and main loop as a real show.
//!
//! | module | |
//! |---|---|
//! | [`dry_run`] | one mission on simulated robots |
//! | [`trials`] | many missions, each with different delays, losses and clocks |
//! | [`world`] | what virtual worlds consist of |
//! | [`certificate`] | the statement that a plan was played with faults |

pub mod certificate;
pub mod dry_run;
pub mod trials;
pub mod world;
