//! Tests that README, docs, schemas, examples and test vectors match the program.
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
