//! Tests of scenarios with the complete program: the scenario language, the findings of `downbeat check`, and real choreographies.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod findings;
mod language;
mod real_scenarios;
