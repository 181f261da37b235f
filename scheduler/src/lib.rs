//! Downbeat: makes many robots start together and stay together.
//!
//! A plan compiled by `downbeat-scripts` goes through the mission machine (`mission`), which one loop (`drive`) runs either in
//! real time over links to robots (`run`, `link`) or in virtual time with simulated ones (`dry_run`, `simulation`). What
//! happened ends in a `report`. `cli` is the only room that prints.

pub mod cli;
pub mod clock;
pub mod conformance;
pub mod drive;
pub mod dry_run;
pub mod fleet;
pub mod journal;
pub mod link;
pub mod mission;
pub mod open_files;
pub mod recording;
pub mod report;
pub mod run;
pub mod server_clock;
pub mod signals;
pub mod simulation;
pub mod stop_lane;

/// The examples of the README are compiled with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
