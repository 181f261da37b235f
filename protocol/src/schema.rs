//! The JSON Schema (2020-12) of the messages, generated from their types. This file covers the types that implement their serialization
//! manually; the other types derive their schema. `docs/protocol.md` states the rules that a schema cannot express, such as unique ids
//! and the order of steps.

use std::borrow::Cow;

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde_json::Value;

use crate::content_hash::ContentHash;
use crate::control_type::ControlType;
use crate::error::ErrorCode;
use crate::limits::{CONTROL_VALUES_MAX, OFFSET_MS_MAX, STRING_CHARS_MAX};
use crate::message::{
    ControlRequest, ControlTypes, Limits, Message, Script, ScriptParameters, SensorParameters, Status,
    StatusValue, Step, StopCondition,
};
use crate::text::{DeviceId, Label, RequestId, RobotId, SessionId};
use crate::time::{Millis, Timestamp};

/// Returns the JSON Schema of all messages; `$defs` contains the schema of each message.
///
/// ```
/// let schema = urrcp::message_schema();
/// assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
/// assert_eq!(schema["$id"], "urn:urrcp:messages:1.0");
/// assert!(schema["$defs"]["ControlRequest"].is_object());
/// ```
#[must_use]
pub fn message_schema() -> Value {
    let settings = SchemaSettings::draft2020_12().for_deserialize();
    let mut schema = settings.into_generator().into_root_schema_for::<Message>();
    schema.insert("$id".to_owned(), SCHEMA_ID.into());
    schema.to_value()
}

/// The identifier of the schema, with the version of the protocol.
const SCHEMA_ID: &str = "urn:urrcp:messages:1.0";

/// Regular expression for the control types that a script step may use.
const MOTION: &str = "^(position|speed|acceleration|custom_(0|[1-9][0-9]{0,9}))$";

/// Regular expression for the keys `control_value_2` to `control_value_256`.
const FURTHER_VALUES: &str = "^control_value_([2-9]|[1-9][0-9]|1[0-9][0-9]|2[0-4][0-9]|25[0-6])$";

macro_rules! schema_of {
    ($type:ty, $name:literal, |$generator:ident| $schema:expr) => {
        impl JsonSchema for $type {
            fn schema_name() -> Cow<'static, str> {
                $name.into()
            }

            fn json_schema($generator: &mut SchemaGenerator) -> Schema {
                $schema
            }
        }
    };
}

macro_rules! string_schemas {
    ($($type:ty, $name:literal, $least:literal, $description:literal;)*) => {
        $(schema_of!($type, $name, |_generator| json_schema!({
            "description": $description,
            "type": "string",
            "minLength": $least,
            "maxLength": STRING_CHARS_MAX,
        }));)*
    };
}

string_schemas! {
    RobotId, "RobotId", 1, "Identifies a robot uniquely.";
    DeviceId, "DeviceId", 1, "Identifies a device among the devices of its robot.";
    RequestId, "RequestId", 0, "Links each response to the request that it answers.";
    SessionId, "SessionId", 1, "Identifies one run of a scheduler.";
    Label, "Label", 0, "Human-readable text.";
    Status, "Status", 0, "Accepted, Started, OK, Failed, Provide, or a value from a later version of the protocol.";
    ErrorCode, "ErrorCode", 0, "Machine-readable kind of failure.";
}

impl<C> JsonSchema for Timestamp<C> {
    fn schema_name() -> Cow<'static, str> {
        "Timestamp".into()
    }

    fn json_schema(_generator: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "An RFC 3339 timestamp with up to nine fractional digits.",
            "type": "string",
            "format": "date-time",
            "pattern": "^[0-9]{4}-[0-9]{2}-[0-9]{2}[Tt ][0-9]{2}:[0-9]{2}:[0-9]{2}(\\.[0-9]+)?([Zz]|[+-][0-9]{2}:[0-9]{2})$",
        })
    }
}

schema_of!(Millis, "Millis", |_generator| json_schema!({
    "description": "Milliseconds; fractions are allowed.",
    "type": "number",
    "minimum": 0,
    "maximum": OFFSET_MS_MAX,
}));

schema_of!(ContentHash, "ContentHash", |_generator| json_schema!({
    "description": "The SHA-256 hash of the canonical JSON of control_value.",
    "type": "string",
    "pattern": "^[0-9A-Fa-f]{64}$",
}));

schema_of!(ControlType, "ControlType", |_generator| json_schema!({
    "description": "How a device is controlled.",
    "type": "string",
    "pattern": "^(position|speed|acceleration|script|sensor|custom_(0|[1-9][0-9]{0,9}))$",
}));

schema_of!(StopCondition, "StopCondition", |generator| {
    let millis = generator.subschema_for::<Millis>();
    let limit = generator.subschema_for::<Option<Millis>>();
    json_schema!({
        "description": "Milliseconds of server silence after which the device stops; null means no limit.",
        "anyOf": [
            millis,
            {"type": "object", "properties": {"pending": limit, "running": limit}},
        ],
    })
});

schema_of!(Step, "Step", |generator| {
    let offset = generator.subschema_for::<Millis>();
    let stop_condition = generator.subschema_for::<Option<StopCondition>>();
    json_schema!({
        "description": "One step of a script. Its offset counts from the start of the script and is not less than that of the previous step.",
        "type": "object",
        "properties": {
            "time_offset_to_start": offset,
            "control_type": {
                "type": "string",
                "pattern": MOTION,
            },
            "control_value": {"type": "number"},
            "stop_condition": stop_condition,
        },
        "patternProperties": {(FURTHER_VALUES): {"type": ["number", "null"]}},
        "required": ["time_offset_to_start", "control_type", "control_value"],
        "propertyNames": {"anyOf": [
            {"pattern": FURTHER_VALUES},
            {"not": {"pattern": "^control_value_"}},
        ]},
    })
});

schema_of!(Script, "Script", |generator| {
    let step = generator.subschema_for::<Step>();
    json_schema!({"description": "Steps in chronological order. An empty list cancels commands.", "type": "array", "items": step})
});

schema_of!(StatusValue, "StatusValue", |generator| {
    let script = generator.subschema_for::<Script>();
    json_schema!({
        "description": "The accepted value or script, or the reading; null on failure.",
        "anyOf": [{"type": ["number", "null"]}, script],
    })
});

schema_of!(ControlRequest, "ControlRequest", |generator| {
    let script = generator.subschema_for::<Script>();
    let mut keys = ControlRequestKeys::json_schema(generator);
    keys.insert("description".into(), "Drives, reads or stops one device.".into());
    keys.insert(
        "patternProperties".into(),
        serde_json::json!({(FURTHER_VALUES): {"type": ["number", "null"]}}),
    );
    let of_script = serde_json::json!({"properties": {"control_type": {"const": "script"}}});
    let of_sensor = serde_json::json!({"properties": {"control_type": {"const": "sensor"}}});
    let of_motion = serde_json::json!({"properties": {"control_type": {"pattern": MOTION}}});
    keys.insert(
        "allOf".into(),
        serde_json::json!([
            {"propertyNames": {"anyOf": [{"pattern": FURTHER_VALUES}, {"not": {"pattern": "^control_value_"}}]}},
            {
                "if": of_script,
                "then": {
                    "properties": {"control_value": script},
                    "required": ["control_value"],
                    "propertyNames": {"not": {"pattern": "^control_value_"}},
                },
                "else": {
                    "if": of_motion,
                    "then": {"properties": {"control_value": {"type": "number"}}, "required": ["control_value"]},
                    // For an unknown control type, the value may be anything.
                    "else": {
                        "if": of_sensor,
                        "then": {"properties": {"control_value": {"type": ["number", "array", "null"]}}},
                    },
                },
            },
        ]),
    );
    keys
});

/// The keys of a control request that do not depend on its control type.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "only its schema is used")]
struct ControlRequestKeys {
    /// When the server sent the request. All requests of one act (a part of a show whose robots start together) have the same timestamp.
    timestamp: Option<Timestamp<crate::time::Server>>,
    /// Milliseconds from `timestamp` to the start. If it is omitted, the command starts on receipt.
    time_offset_to_start: Option<Millis>,
    /// The id of the device that the request addresses.
    device_id: DeviceId,
    /// The lease of the command: how long the server may be silent before the device stops. If it is omitted, the silence is unlimited.
    stop_condition: Option<StopCondition>,
    /// The instant by the robot's clock at which the robot drops the command if it has not started.
    pending_until: Option<Timestamp<crate::time::Robot>>,
    /// The id that every response to this request repeats.
    request_id: Option<RequestId>,
    /// The hash of `control_value`, which the robot checks and repeats in its response.
    content_hash: Option<ContentHash>,
    /// The session (one run of a scheduler) of the sender.
    session: Option<SessionId>,
    /// With an empty script: whether the device goes to its default state instead of coming to rest where it is.
    home: Option<bool>,
    /// The name of one of the device's control types. The robot treats an unknown name like a control type that the device lacks.
    control_type: Label,
}

schema_of!(ControlTypes, "ControlTypes", |generator| {
    let motion = generator.subschema_for::<Limits>();
    let script = generator.subschema_for::<ScriptParameters>();
    let sensor = generator.subschema_for::<SensorParameters>();
    json_schema!({
        "description": "Maps each control type to its parameters.",
        "type": "object",
        "properties": {
            "position": motion, "speed": motion, "acceleration": motion, "script": script, "sensor": sensor,
        },
        "patternProperties": {"^custom_(0|[1-9][0-9]{0,9})$": {
            "type": "object",
            "properties": {"at_rest": {
                "description": "The values that the device takes when a command ends early: one number for all values, or a list with one number for each.",
                "anyOf": [
                    {"type": "number"},
                    {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": CONTROL_VALUES_MAX},
                ],
            }},
        }},
        "additionalProperties": false,
    })
});
