//! README, docs, schemas, examples and vectors are true.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod documents;
mod examples;
mod first_steps;
mod help;
mod layers;
mod promises;
mod schema;
mod tied;
mod vectors;
