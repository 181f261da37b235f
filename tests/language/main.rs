//! Scenarios through the whole program: the language, its findings, real choreographies.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "one test measures its time")]

mod findings;
mod language;
mod real_scenarios;
