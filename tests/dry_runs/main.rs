//! Dry runs, their pictures, pages, certificates and trials: no real time.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod bound;
mod certificates;
mod compare;
mod drift;
mod local_times;
mod page;
mod picture;
mod require;
mod trials;
