//! Scenarios through the complete program: the language, its findings, real choreographies.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod findings;
mod language;
mod real_scenarios;
