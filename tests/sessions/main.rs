//! Texts that people read, compared whole with approved ones.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod diagnostics;
mod mistakes;
