//! What crosses crates: sessions at a terminal, real processes, whole fleets, documents.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod conformance;
mod diagnostics;
mod display;
mod documents;
mod edges;
mod encodings;
mod examples;
mod findings;
mod hostile;
mod import;
mod import_real;
mod language;
mod missions;
mod ntp;
mod output;
mod processes;
mod real_scenarios;
mod refills;
mod robots;
mod schema;
mod session;
mod silence;
mod terminal;
mod thrift_robot;
mod told;
mod vectors;
