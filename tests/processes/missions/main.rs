//! Missions on robots as processes.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod again;
mod agree;
mod claims;
mod course;
mod encodings;
mod large_show;
mod local_times;
mod missions;
mod preflight;
mod processes;
mod refills;
mod rest;
mod resumed;
mod start_poses;
mod told;
mod undecided;
