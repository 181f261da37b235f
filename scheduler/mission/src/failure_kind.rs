//! The ways in which a robot can fail in a mission.

use downbeat_fleet::sensor_range::SensorRange;
use serde::{Deserialize, Serialize, Serializer};
use urrcp::{ControlError, DeviceId, ErrorCode, RobotId, Span};

use super::claim::Claim;
use crate::clock::ClockDoubt;

/// A failure of a robot.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Failure {
    /// Id of the robot.
    pub robot: RobotId,
    /// The kind of failure.
    #[serde(flatten)]
    pub kind: FailureKind,
}

impl Serialize for Failure {
    /// Serializes the failure with its text for users.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Written<'a> {
            robot: &'a RobotId,
            #[serde(flatten)]
            kind: &'a FailureKind,
            text: String,
        }
        Written { robot: &self.robot, kind: &self.kind, text: self.kind.to_string() }.serialize(serializer)
    }
}

/// The kind of a robot's failure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "failure", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum FailureKind {
    /// The link broke or could not be made.
    #[error("link down: {reason}")]
    LinkDown {
        /// The reason given by the system or the robot.
        reason: String,
    },
    /// The robot sends far more messages than requested. The mission reconnects to it only to stop it.
    #[error(
        "flooding: the robot sent {messages} messages and {bytes} bytes, far more than requested; for the rest of this mission, it is reconnected only to be stopped"
    )]
    Flooding {
        /// Number of messages received on the link before it was closed for this reason.
        messages: u64,
        /// Number of bytes received on the link.
        bytes: u64,
    },
    /// The robot's answers are too slow, or leave its clock too uncertain: all others would have to wait for it.
    #[error(
        "the link to the robot is too slow: {slow}; use a faster or steadier link, and check the robot's clock"
    )]
    TooSlow {
        /// The value that is too slow, and the longest accepted value.
        #[serde(flatten)]
        slow: Slow,
    },
    /// The robot sent bytes that are not a message, or a message at the wrong time.
    #[error("garbled: {reason}")]
    Garbled {
        /// The fault in the bytes or the message.
        reason: String,
    },
    /// Another robot answers at the robot's address. Nothing is sent to that other robot.
    #[error("another robot answers at its address: its id is `{told}`, expected `{expected}`")]
    AnotherRobot {
        /// The id by which the intended robot identifies itself.
        expected: RobotId,
        /// The id by which the other robot identifies itself.
        told: RobotId,
    },
    /// The robot did not answer in time.
    #[error("silent: no {awaited} within {within}{}", remedy_of_silence(awaited))]
    Silent {
        /// The awaited answer or report.
        awaited: String,
        /// The time allowed for the answer or report.
        #[serde(rename = "within_ms")]
        within: Span,
    },
    /// The robot's availability check failed.
    #[error("not available: {error}{}", remedy_of_busy(error))]
    NotAvailable {
        /// The robot's reason.
        error: ControlError,
    },
    /// The robot speaks another version of the protocol.
    #[error("URRCP version `{version}` is not supported, expected version 1")]
    WrongVersion {
        /// The version, as the robot states it.
        version: String,
    },
    /// The robot's own description does not fit the plan.
    #[error("does not fit the plan: {reason}")]
    Unfit {
        /// The difference between the description and the plan.
        reason: String,
    },
    /// The robot's link is too slow for a script that must be sent while the act plays, because its device initially has no room for it.
    #[error(
        "script {} of `{device}`{} cannot be sent in time: the robot has room for it only {} before its start, but sending takes {needed}; use fewer steps, or a robot that holds more scripts (`script_queue`)",
        script + 1, act.as_ref().map(|act| format!(" in act `{act}`")).unwrap_or_default(), (*time).max(Span::ZERO)
    )]
    NoTimeToSend {
        /// Id of the device.
        device: DeviceId,
        /// Name of the act; `None` for a single act without a name.
        act: Option<String>,
        /// Index of the script among the scripts of this device in this act, starting at 0.
        script: usize,
        /// How long before the script's start the device has room for it; negative if it has room only after that start.
        #[serde(rename = "time_ms")]
        time: Span,
        /// The minimum time to send the script: a round trip and the robot's processing.
        #[serde(rename = "needed_ms")]
        needed: Span,
    },
    /// The robot's clock is further off than the scenario tolerates, or is not known precisely enough.
    #[error("{}", clock_text(*offset, *uncertainty, *tolerance))]
    Clock {
        /// The robot's clock minus the server's.
        #[serde(rename = "offset_ms")]
        offset: Span,
        /// Uncertainty of the offset.
        #[serde(rename = "uncertainty_ms")]
        uncertainty: Span,
        /// The scenario's `start_tolerance`.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// The robot's devices begin to move at instants that vary by more than the scenario tolerates.
    #[error(
        "the latency of its devices varies by +-{spread}, but the scenario tolerates only {tolerance}, including clock errors: measure the latency again with \
         `downbeat calibrate`, or raise start_tolerance"
    )]
    LatencySpread {
        /// 95 % of the motions begin within the device's latency ± this time.
        #[serde(rename = "spread_ms")]
        spread: Span,
        /// The scenario's `start_tolerance`.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// A sensor reads a value that the fleet file does not permit.
    #[error("`{sensor}` reads {reading}, but the fleet file requires {range}", reading = reading.map_or_else(|| "nothing".to_owned(), |r| r.to_string()))]
    Requirement {
        /// Id of the sensor.
        sensor: DeviceId,
        /// The value; `None` without a reading.
        reading: Option<f64>,
        /// The range that the fleet file requires.
        range: SensorRange,
    },
    /// A device is not at the position at which its first keyframe expects it.
    #[error(
        "device `{device}` is at {reading}, {}",
        match act {
            None => format!("but its first keyframe expects {expected}: move it there with `run --approach 5s`, or put the first keyframe later"),
            Some(act) => format!("but its first keyframe in the act `{act}` expects {expected}: move it there in an earlier act, or put that keyframe later"),
        }
    )]
    Position {
        /// Id of the device.
        device: DeviceId,
        /// The position of the device.
        reading: f64,
        /// The expected position.
        expected: f64,
        /// The act before which the mission found the device there; `None` if an approach before the mission could have moved the device
        /// to the expected position.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        act: Option<String>,
    },
    /// The robot's statement about a script is impossible.
    #[error("device `{device}` sent an impossible report: {claim}")]
    Claim {
        /// Id of the device.
        device: DeviceId,
        /// The impossible statement, and the possible values.
        #[serde(flatten)]
        claim: Claim,
    },
    /// The robot refused or ended a script.
    #[error("device `{device}`: {error}")]
    Script {
        /// Id of the device.
        device: DeviceId,
        /// The robot's reason.
        error: ControlError,
    },
    /// The robot was missing when the mission began, and took no part in it until its end.
    #[error("it never joined: {reason}")]
    NeverJoined {
        /// The reason why the robot did not join, as text for users.
        reason: String,
    },
}

/// The reason why a robot's link is too slow, with the measured and the permitted value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "slow", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Slow {
    /// The robot's round trips are too long.
    #[error("a round trip takes {round_trip}, expected at most {longest}")]
    RoundTrip {
        /// The round trip of the robot's link, without rare outliers.
        #[serde(rename = "round_trip_ms")]
        round_trip: Span,
        /// The longest accepted round trip.
        #[serde(rename = "longest_ms")]
        longest: Span,
    },
    /// Because of the robot's link, the act would need too long a lease before its start.
    #[error(
        "the act would need a lease of {lease} before the start, but at most {longest} is possible: a round trip takes {round_trip}, and the robot's clock may start it {early} early or {late} late"
    )]
    Lease {
        /// The lease that the act would need.
        #[serde(rename = "lease_ms")]
        lease: Span,
        /// The longest permitted lease.
        #[serde(rename = "longest_ms")]
        longest: Span,
        /// The round trip of the robot's link.
        #[serde(rename = "round_trip_ms")]
        round_trip: Span,
        /// How much earlier than planned the robot may start.
        #[serde(rename = "early_ms")]
        early: Span,
        /// How much later than planned the robot may start.
        #[serde(rename = "late_ms")]
        late: Span,
    },
}

/// Returns a hint for users about a program that never identifies itself: it may not be a robot.
fn remedy_of_silence(awaited: &str) -> &'static str {
    match awaited {
        "initialization block" => "; check that the program at its address is a robot that speaks URRCP",
        _ => "",
    }
}

fn remedy_of_busy(error: &ControlError) -> &'static str {
    match error.code {
        ErrorCode::Busy => {
            "; wait until that other mission ends, or end it with `downbeat stop` on the machine where it runs; an operator with the role `seize` can take over robots with a `tls://` or `hmac://` address with `downbeat run --seize`"
        }
        _ => "",
    }
}

/// Returns a text for users that names the cause: NTP for a clock that is off, the link for a clock that is only poorly known.
fn clock_text(offset: Span, uncertainty: Span, tolerance: Span) -> String {
    match ClockDoubt::of(offset, uncertainty) {
        ClockDoubt::Clock => format!(
            "clock off by {offset} (+-{uncertainty}), but the scenario tolerates only {tolerance}: check the robot's NTP, or raise start_tolerance"
        ),
        ClockDoubt::Path => format!(
            "clock known only to +-{uncertainty} (offset {offset}), because the delay of its link varies, but the scenario tolerates only {tolerance}: use a steadier link, or raise start_tolerance"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an example of the kind that follows `kind` in the enumeration. A new kind must be added here.
    fn after(kind: Option<&FailureKind>) -> Option<FailureKind> {
        let text = String::new;
        let id = || RobotId::new("r").unwrap();
        let device = || DeviceId::new("d").unwrap();
        let error = || ControlError::new(ErrorCode::Late, "why");
        let span = Span::ZERO;
        let Some(kind) = kind else { return Some(FailureKind::LinkDown { reason: text() }) };
        Some(match kind {
            FailureKind::LinkDown { .. } => FailureKind::Flooding { messages: 2_000, bytes: 3_000 },
            FailureKind::Flooding { .. } => {
                FailureKind::TooSlow { slow: Slow::RoundTrip { round_trip: span, longest: span } }
            }
            FailureKind::TooSlow { .. } => FailureKind::Garbled { reason: text() },
            FailureKind::Garbled { .. } => FailureKind::AnotherRobot { expected: id(), told: id() },
            FailureKind::AnotherRobot { .. } => FailureKind::Silent { awaited: text(), within: span },
            FailureKind::Silent { .. } => FailureKind::NotAvailable { error: error() },
            FailureKind::NotAvailable { .. } => FailureKind::WrongVersion { version: text() },
            FailureKind::WrongVersion { .. } => FailureKind::Unfit { reason: text() },
            FailureKind::Unfit { .. } => {
                FailureKind::NoTimeToSend { device: device(), act: None, script: 1, time: span, needed: span }
            }
            FailureKind::NoTimeToSend { .. } => {
                FailureKind::Clock { offset: span, uncertainty: span, tolerance: span }
            }
            FailureKind::Clock { .. } => FailureKind::LatencySpread { spread: span, tolerance: span },
            FailureKind::LatencySpread { .. } => {
                let range = SensorRange::Above(1.0);
                FailureKind::Requirement { sensor: device(), reading: None, range }
            }
            FailureKind::Requirement { .. } => {
                FailureKind::Position { device: device(), reading: 0.0, expected: 1.0, act: Some(text()) }
            }
            FailureKind::Position { .. } => {
                FailureKind::Claim { device: device(), claim: Claim::Steps { claimed: 2, planned: 1 } }
            }
            FailureKind::Claim { .. } => FailureKind::Script { device: device(), error: error() },
            FailureKind::Script { .. } => FailureKind::NeverJoined { reason: text() },
            FailureKind::NeverJoined { .. } => return None,
        })
    }

    #[test]
    fn every_failure_kind_matches_report_schema_and_is_read_back() {
        let kinds: Vec<_> = std::iter::successors(after(None), |kind| after(Some(kind))).collect();
        let mut schema: serde_json::Value = serde_json::from_str(crate::report::SCHEMA).unwrap();
        schema["properties"] = serde_json::json!({"failure": {"$ref": "#/$defs/failure"}});
        schema["required"] = serde_json::json!(["failure"]);
        let validator = jsonschema::validator_for(&schema).unwrap();
        let mut names = Vec::new();
        for kind in kinds {
            let failure = Failure { robot: RobotId::new("r").unwrap(), kind };
            let written = serde_json::to_value(&failure).unwrap();
            names.push(written["failure"].as_str().unwrap().to_owned());
            let document = serde_json::json!({"failure": written});
            assert!(validator.is_valid(&document), "{document}");
            assert_eq!(Failure::deserialize(&document["failure"]).unwrap(), failure);
        }
        assert_eq!(
            names,
            <FailureKind as strum::VariantNames>::VARIANTS,
            "`after` leads through every kind, in their order"
        );
    }

    #[test]
    fn only_helpful_advice_is_given() {
        let silent = |awaited: &str| {
            FailureKind::Silent { awaited: awaited.to_owned(), within: Span::from_millis(5_000) }.to_string()
        };
        assert!(silent("initialization block").contains("is a robot that speaks URRCP"));
        assert!(silent("answer").ends_with("5 s"), "{}", silent("answer"));
        let not_available =
            |code| FailureKind::NotAvailable { error: ControlError::new(code, "why") }.to_string();
        assert!(not_available(ErrorCode::Busy).contains("downbeat stop"));
        assert!(
            not_available(ErrorCode::Internal).ends_with("why"),
            "{}",
            not_available(ErrorCode::Internal)
        );
        let clock = |offset, uncertainty| {
            let span = Span::from_millis;
            FailureKind::Clock { offset: span(offset), uncertainty: span(uncertainty), tolerance: span(10) }
        };
        assert!(clock(100, 1).to_string().contains("check the robot's NTP"));
        assert!(clock(1, 100).to_string().contains("use a steadier link"));
    }
}
