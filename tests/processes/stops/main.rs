//! Stops, and robots that fall silent.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod removed;
mod silence;
mod stop_command;
mod stops;
