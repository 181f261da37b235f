//! What a person sees at the terminal of a mission.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod commands;
mod discover;
mod display;
mod jog;
mod output;
