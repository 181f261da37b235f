//! Generates any message that the protocol allows.

use proptest::collection::{btree_map, vec};
use proptest::num::f64::{NORMAL, SUBNORMAL, ZERO};
use proptest::option;
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::{
    AvailabilityRequest, AvailabilityResponse, Command, ControlError, ControlRequest, ControlResponse,
    ControlType, DeviceId, DeviceReport, ErrorCode, InitializationBlock, InitializationRequest, Inquiry,
    InquiryResponse, Label, Limits, Message, Millis, RequestId, RequestReport, RequestState, RevocationList,
    Script, SessionId, Setpoint, Status, StatusValue, Step, StopCondition, Timestamp,
};

/// Generates any message.
pub(super) fn message() -> impl Strategy<Value = Message> {
    prop_oneof![
        availability_request().prop_map(Message::AvailabilityRequest),
        availability_response().prop_map(Message::AvailabilityResponse),
        option::of(timestamp())
            .prop_map(|timestamp| Message::InitializationRequest(InitializationRequest { timestamp })),
        initialization_block().prop_map(Message::InitializationBlock),
        control_request().prop_map(Message::ControlRequest),
        control_response().prop_map(Message::ControlResponse),
        inquiry().prop_map(Message::Inquiry),
        inquiry_response().prop_map(Message::InquiryResponse),
    ]
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        NORMAL | SUBNORMAL | ZERO,
        (-90_000i32..90_000).prop_map(|thousandths| f64::from(thousandths) / 1_000.0),
        any::<i32>().prop_map(f64::from),
    ]
}

fn text() -> impl Strategy<Value = String> {
    "\\PC{1,24}"
}

fn timestamp<C>() -> impl Strategy<Value = Timestamp<C>> {
    (-9_000_000_000_000_000_000i64..9_000_000_000_000_000_000).prop_map(Timestamp::from_nanos)
}

fn millis() -> impl Strategy<Value = Millis> {
    prop_oneof![0.0..1e11, (0u32..100_000).prop_map(f64::from)].prop_map(|ms| Millis::new(ms).unwrap())
}

fn stop_condition() -> impl Strategy<Value = StopCondition> {
    prop_oneof![
        millis().prop_map(StopCondition::both),
        (option::of(millis()), option::of(millis()))
            .prop_map(|(pending, running)| StopCondition { pending, running }),
    ]
}

fn setpoint() -> impl Strategy<Value = Setpoint> {
    let control_type = prop_oneof![
        Just(ControlType::Position),
        Just(ControlType::Speed),
        Just(ControlType::Acceleration),
        any::<u32>().prop_map(ControlType::Custom),
    ];
    (control_type, number(), vec(number(), 0..4)).prop_map(|(control_type, value, more)| Setpoint {
        control_type,
        value,
        more: more.into(),
    })
}

fn script() -> impl Strategy<Value = Script> {
    vec((millis(), setpoint(), option::weighted(0.1, stop_condition())), 0..20).prop_map(|steps| {
        let step = |(offset, setpoint, stop_condition)| Step { offset, setpoint, stop_condition };
        let mut steps: Vec<Step> = steps.into_iter().map(step).collect();
        steps.sort_by(|a, b| a.offset.get().total_cmp(&b.offset.get()));
        Script::new(steps).unwrap()
    })
}

fn control_request() -> impl Strategy<Value = ControlRequest> {
    let command = prop_oneof![
        setpoint().prop_map(Command::Set),
        script().prop_map(Command::Script),
        Just(Command::ReadSensor),
        Just(Command::Unknown(Label::new("torque").unwrap())),
    ];
    let extras = (option::of(text()), any::<bool>(), option::of(text()), any::<bool>());
    let limits = (option::of(stop_condition()), option::of(timestamp()));
    let times = (option::of(timestamp()), option::of(millis()), limits);
    (text(), command, times, extras).prop_map(|(device, command, times, extras)| {
        let (timestamp, time_offset_to_start, (stop_condition, pending_until)) = times;
        let (request_id, hashed, session, home) = extras;
        ControlRequest {
            timestamp,
            time_offset_to_start,
            stop_condition,
            pending_until,
            request_id: request_id.map(|id| RequestId::new(id).unwrap()),
            content_hash: hashed.then(|| command.content_hash()),
            session: session.map(|id| SessionId::new(id).unwrap()),
            home,
            ..ControlRequest::immediate(DeviceId::new(device).unwrap(), command)
        }
    })
}

fn status() -> impl Strategy<Value = Status> {
    prop_oneof![
        Just(Status::Ok),
        Just(Status::Accepted),
        Just(Status::Started),
        Just(Status::Provide),
        Just(Status::Failed),
        Just(Status::Other(Label::new("Resting").unwrap())),
    ]
}

fn error() -> impl Strategy<Value = Option<ControlError>> {
    let code =
        prop_oneof![Just(ErrorCode::Late), Just(ErrorCode::Other(Label::new("out_of_paint").unwrap()))];
    option::of((code, text()).prop_map(|(code, message)| ControlError::new(code, message)))
}

fn control_response() -> impl Strategy<Value = ControlResponse> {
    let value = prop_oneof![
        Just(StatusValue::Null),
        number().prop_map(StatusValue::Number),
        script().prop_map(StatusValue::Script),
    ];
    let counts = (option::of(any::<u32>()), option::of(any::<u32>()), option::of(millis()));
    (timestamp(), text(), status(), value, option::of(text()), option::of(timestamp()), counts, error())
        .prop_map(|(timestamp, device, status, status_value, request, event_timestamp, counts, error)| {
            ControlResponse {
                timestamp,
                device_id: DeviceId::new(device).unwrap(),
                status,
                status_value,
                content_hash: request.as_ref().map(|_| Command::ReadSensor.content_hash()),
                request_id: request.map(|id| RequestId::new(id).unwrap()),
                event_timestamp,
                steps_done: counts.0,
                late_steps: counts.1,
                late_ms_max: counts.2,
                error,
            }
        })
}

fn availability_request() -> impl Strategy<Value = AvailabilityRequest> {
    let strategy = (option::of(timestamp()), option::of(text()), any::<bool>(), option::of(text()));
    strategy.prop_map(|(timestamp, session, seize, revocation_list)| {
        let session = session.map(|id| SessionId::new(id).unwrap());
        AvailabilityRequest { timestamp, session, seize, revocation_list }
    })
}

fn availability_response() -> impl Strategy<Value = AvailabilityResponse> {
    let list =
        (0..1_u64 << 53, option::of(text())).prop_map(|(number, refused)| RevocationList { number, refused });
    (option::of(timestamp()), timestamp(), timestamp(), status(), error(), option::of(list)).prop_map(
        |(originate_timestamp, receive_timestamp, timestamp, status, error, revocation_list)| {
            AvailabilityResponse {
                originate_timestamp,
                receive_timestamp,
                timestamp,
                status,
                error,
                revocation_list,
            }
        },
    )
}

fn inquiry() -> impl Strategy<Value = Inquiry> {
    let names = (vec(text(), 0..4), vec(text(), 0..4));
    let limits = (option::of(millis()), option::of(timestamp()));
    (option::of(timestamp()), option::of(text()), names, limits).prop_map(
        |(timestamp, session, (requests, devices), (pending_lease, pending_until))| Inquiry {
            timestamp,
            session: session.map(|id| SessionId::new(id).unwrap()),
            requests: requests.into_iter().map(|id| RequestId::new(id).unwrap()).collect(),
            devices: devices.into_iter().map(|id| DeviceId::new(id).unwrap()).collect(),
            pending_lease,
            pending_until,
        },
    )
}

fn request_report() -> impl Strategy<Value = RequestReport> {
    let state = prop_oneof![
        Just(RequestState::Unknown),
        Just(RequestState::Held),
        Just(RequestState::Running),
        Just(RequestState::Ended),
    ];
    let times = (option::of(timestamp()), option::of(timestamp()));
    let counts = (option::of(any::<u32>()), option::of(any::<u32>()), option::of(millis()));
    (text(), state, any::<bool>(), times, counts, error()).prop_map(
        |(id, state, hashed, times, counts, error)| RequestReport {
            request_id: RequestId::new(id).unwrap(),
            state,
            content_hash: hashed.then(|| Command::ReadSensor.content_hash()),
            start_timestamp: times.0,
            event_timestamp: times.1,
            steps_done: counts.0,
            late_steps: counts.1,
            late_ms_max: counts.2,
            error,
        },
    )
}

fn inquiry_response() -> impl Strategy<Value = InquiryResponse> {
    let device = (text(), any::<u32>(), option::of(number())).prop_map(|(id, room, position)| DeviceReport {
        device_id: DeviceId::new(id).unwrap(),
        room,
        position,
    });
    let lists = (vec(request_report(), 0..4), vec(device, 0..4));
    (availability_response(), lists).prop_map(|(said, (requests, devices))| InquiryResponse {
        originate_timestamp: said.originate_timestamp,
        receive_timestamp: said.receive_timestamp,
        timestamp: said.timestamp,
        status: said.status,
        error: said.error,
        requests,
        devices,
    })
}

/// Generates the parameters of a custom control type: any JSON.
fn parameters() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        number().prop_map(Value::from),
        text().prop_map(Value::from),
    ];
    let value = leaf.prop_recursive(3, 12, 4, |inner| {
        prop_oneof![
            vec(inner.clone(), 0..4).prop_map(Value::from),
            btree_map(text(), inner, 0..4).prop_map(|map| Value::Object(map.into_iter().collect())),
        ]
    });
    btree_map(text(), value, 0..3).prop_map(|map| Value::Object(map.into_iter().collect()))
}

fn initialization_block() -> impl Strategy<Value = InitializationBlock> {
    let limits =
        (number(), number(), number(), option::of(number())).prop_map(|(a, b, granularity, error)| {
            let (min, max) = (a.min(b), a.max(b));
            let granularity = if granularity == 0.0 { 1.0 } else { granularity.abs() };
            // With a bound as the granularity, the limits always contain a multiple: the bound itself.
            let granularity =
                if Limits::new(min, max, granularity).is_ok() { granularity } else { max.abs() };
            let mut limits = json!({"min_value": min, "max_value": max, "granularity": granularity});
            if let Some(error) = error {
                limits["max_error"] = error.abs().into();
            }
            limits
        });
    let device = (text(), limits, parameters(), option::of(any::<bool>()), any::<u32>()).prop_map(
        |(name, limits, custom, default, steps)| {
            let default_value =
                default.map(|upper| limits[if upper { "max_value" } else { "min_value" }].clone());
            let mut script = limits.clone();
            script["max_number_of_steps"] = steps.into();
            let sensor = json!({"min_value": 0, "max_value": 0.1, "max_delay": 2.5});
            let types = json!({"speed": limits, "script": script, "sensor": sensor, "custom_7": custom});
            let channels = [json!(null), json!(5), json!([5, 6]), json!([1, [2, 3], 4])];
            let channel = &channels[(steps % 4) as usize];
            json!({"name": name, "default_value": default_value, "interpolation": "linear",
                "script_queue": steps, "latency": default.map(|_| f64::from(steps % 16_001) / 1.6),
                "latency_spread": default.and_then(|upper| upper.then_some(steps % 100)),
                "channel": channel,
                "available_control_types": types})
        },
    );
    (text(), option::of(text()), any::<bool>(), vec(device, 1..4)).prop_map(|(id, name, reports, devices)| {
        let mut block = json!({"id": id, "name": name, "api_version": "1", "type": "Transport",
            "reports": reports, "inquiry": !reports, "encodings": ["msgpack", "smoke signals"], "devices": devices});
        for (number, device) in block["devices"].as_array_mut().unwrap().iter_mut().enumerate() {
            device["id"] = format!("d{number}").into();
        }
        serde_json::from_value(block).unwrap()
    })
}
