//! Missions in virtual time, with the machine and the loop of a real show.
//!
//! | module | |
//! |---|---|
//! | [`dry_run`] | one mission on simulated robots |
//! | [`trials`] | many of them, each with different delays, losses and clocks |
//! | [`certificate`] | a plan that was played against faults |

pub mod certificate;
pub mod dry_run;
pub mod trials;
