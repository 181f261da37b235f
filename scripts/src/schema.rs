//! JSON Schemas (2020-12) of the files that people write, for editors and for programs that write such files.

/// What a schema describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Schema {
    /// A scenario.
    Scenario,
    /// A fleet file.
    Fleet,
}

/// The schema as JSON text.
#[must_use]
pub const fn schema(of: Schema) -> &'static str {
    match of {
        Schema::Scenario => include_str!("schema/scenario.json"),
        Schema::Fleet => include_str!("schema/fleet.json"),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use serde_json::Value;

    use super::*;
    use crate::{fleet, scenario};

    fn parsed(of: Schema) -> Value {
        serde_json::from_str(schema(of)).unwrap()
    }

    /// The schema lists exactly the keys that the reader knows.
    #[track_caller]
    fn check(object: &Value, known: &[&str]) {
        let listed: BTreeSet<&str> =
            object["properties"].as_object().unwrap().keys().map(String::as_str).collect();
        assert_eq!(listed, known.iter().copied().collect());
        assert_ne!(object["additionalProperties"], Value::Bool(true));
        for (key, value) in object["properties"].as_object().unwrap() {
            let described = value.get("description").is_some() || value.get("$ref").is_some();
            assert!(described, "`{key}` has a description, its own or that of its kind");
        }
    }

    #[test]
    fn the_schemas_list_the_keys_that_are_read() {
        let of = parsed(Schema::Scenario);
        check(&of, &scenario::SCENARIO_KEYS);
        check(&of["$defs"]["cue"], &scenario::CUE_KEYS);
        check(&of["$defs"]["override"], &scenario::OVERRIDE_KEYS);
        check(&of["$defs"]["act"], &scenario::ACT_KEYS);
        check(&of["$defs"]["track"]["anyOf"][1], &scenario::TRACK_KEYS);
        check(&of["$defs"]["keyframe"], &scenario::KEYFRAME_KEYS);
        check(&of["$defs"]["wait"]["anyOf"][1], &scenario::WAIT_KEYS);
        let track = &of["$defs"]["track"]["anyOf"][1]["properties"];
        check(&track["wave"], &scenario::WAVE_KEYS);
        check(&track["travel"], &scenario::TRAVEL_KEYS);
        check(&track["samples"], &scenario::SAMPLES_KEYS);
        let of = parsed(Schema::Fleet);
        check(&of, &fleet::FLEET_KEYS);
        check(&of["$defs"]["device"], &crate::init::DEVICE_KEYS);
        check(&of["$defs"]["robot"], &fleet::ROBOT_KEYS);
        check(&of["$defs"]["simulate"], &fleet::SIMULATE_KEYS);
        check(&of["$defs"]["robot"]["properties"]["limits"]["additionalProperties"], &fleet::LIMIT_KEYS);
    }
}
