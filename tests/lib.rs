//! What crosses crates: sessions at a terminal, real processes, whole fleets, documents.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod claims;
mod commands;
mod compiled;
mod conformance;
mod copied;
mod course;
mod diagnostics;
mod display;
mod documents;
mod edges;
mod encodings;
mod examples;
mod export;
mod findings;
mod first_steps;
mod help;
mod hold;
mod hostile;
mod identity;
mod import;
mod import_real;
mod language;
mod large_show;
mod missions;
mod mistakes;
mod ntp;
mod output;
mod picture;
mod preflight;
mod processes;
mod real_scenarios;
mod realtime;
mod refills;
mod robots;
mod schema;
mod session;
mod silence;
mod stop_command;
mod stops;
mod terminal;
mod thrift_robot;
mod tied;
mod told;
mod vectors;
