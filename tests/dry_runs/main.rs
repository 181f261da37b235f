//! Tests dry runs: their pictures, pages, certificates and trials. Nothing runs in real time.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod bound;
mod brief;
mod certificates;
mod compare;
mod drift;
mod local_times;
mod page;
mod picture;
mod require;
mod trials;
