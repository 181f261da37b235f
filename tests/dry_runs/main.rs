//! Dry runs, their pictures, pages, certificates and trials: no real time.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod certificates;
mod compare;
mod page;
mod picture;
mod require;
mod trials;
