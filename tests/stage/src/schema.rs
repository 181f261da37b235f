//! The JSON Schemas that Downbeat prints.

use std::process::Command;

use serde_json::Value;

use crate::session::program;

/// Returns a validator for the schema that `downbeat schema OF` prints.
pub fn validator(of: &str) -> jsonschema::Validator {
    let printed = Command::new(program()).args(["schema", of]).output().unwrap().stdout;
    let schema: Value = serde_json::from_slice(&printed).unwrap();
    jsonschema::draft202012::meta::validate(&schema).unwrap();
    jsonschema::validator_for(&schema).unwrap()
}
