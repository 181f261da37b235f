//! The ways in which a robot fails a mission.

use downbeat_fleet::sensor_range::SensorRange;
use serde::{Deserialize, Serialize, Serializer};
use urrcp::{ControlError, DeviceId, ErrorCode, RobotId, Span};

use super::claim::Claim;
use crate::clock::ClockDoubt;

/// A robot failed the mission.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Failure {
    /// Which robot.
    pub robot: RobotId,
    /// What happened.
    #[serde(flatten)]
    pub kind: FailureKind,
}

impl Serialize for Failure {
    /// With what people read of it.
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

/// Ways for a robot to fail the mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "failure", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum FailureKind {
    /// The link broke or could not be made.
    #[error("link down: {reason}")]
    LinkDown {
        /// What the system or the robot gave as the reason.
        reason: String,
    },
    /// It sends far more than it was asked for. It is connected to again only to be stopped.
    #[error(
        "flooding: {messages} messages and {bytes} bytes came on its link, far more than it was asked for; in this mission it is connected to again only to be stopped"
    )]
    Flooding {
        /// Messages that came on the link that was closed for it.
        messages: u64,
        /// Bytes that came on it.
        bytes: u64,
    },
    /// Its answers take so long, or leave its clock so uncertain, that all others would have to wait for it.
    #[error("the link to it is too slow: {slow}; use a faster or steadier link, and check its clock")]
    TooSlow {
        /// What is too slow, and what is possible.
        #[serde(flatten)]
        slow: Slow,
    },
    /// It sent what is no message, or one out of place.
    #[error("garbled: {reason}")]
    Garbled {
        /// What is wrong.
        reason: String,
    },
    /// Another robot answers at its address. Nothing is sent to that one.
    #[error("another robot answers at its address: it calls itself `{told}`, expected `{expected}`")]
    AnotherRobot {
        /// What the robot that is meant calls itself.
        expected: RobotId,
        /// What the other one calls itself.
        told: RobotId,
    },
    /// It did not answer in time.
    #[error("silent: no {awaited} within {within}{}", remedy_of_silence(awaited))]
    Silent {
        /// What was awaited.
        awaited: String,
        /// For how long.
        #[serde(rename = "within_ms")]
        within: Span,
    },
    /// Its availability check failed.
    #[error("not available: {error}{}", remedy_of_busy(error))]
    NotAvailable {
        /// Its own reason.
        error: ControlError,
    },
    /// It speaks another version of the protocol.
    #[error("it speaks URRCP `{version}`, expected version 1")]
    WrongVersion {
        /// What it calls it.
        version: String,
    },
    /// Its own description does not fit the plan.
    #[error("does not fit the plan: {reason}")]
    Unfit {
        /// Where it differs.
        reason: String,
    },
    /// Its link is too slow for one of the scripts that its device has no room for at first.
    #[error(
        "script {} of `{device}`{} cannot be sent in time: there is room for it {} before its start, and on this link it takes {needed}; use fewer steps, or a robot that holds more scripts (`script_queue`)",
        script + 1, act.as_ref().map(|act| format!(" in the act `{act}`")).unwrap_or_default(), (*time).max(Span::ZERO)
    )]
    NoTimeToSend {
        /// Of the robot.
        device: DeviceId,
        /// In which act; `None` where the only one has no name.
        act: Option<String>,
        /// Which script of this device in this act, from 0.
        script: usize,
        /// How long before its start there is room for it; negative: after that.
        #[serde(rename = "time_ms")]
        time: Span,
        /// What a round trip and what the robot does take at least.
        #[serde(rename = "needed_ms")]
        needed: Span,
    },
    /// Its clock is further off than the scenario tolerates, or not known well enough.
    #[error("{}", clock_text(*offset, *uncertainty, *tolerance))]
    Clock {
        /// Robot minus server.
        #[serde(rename = "offset_ms")]
        offset: Span,
        /// Of the offset.
        #[serde(rename = "uncertainty_ms")]
        uncertainty: Span,
        /// The scenario's start_tolerance.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// Its devices begin to move at instants that vary by more than the scenario tolerates.
    #[error(
        "the latency of its devices varies by +-{spread}, the scenario tolerates {tolerance} with the clocks: measure it again with \
         `downbeat calibrate`, or raise start_tolerance"
    )]
    LatencySpread {
        /// 95 % of the motions begin within the latency ± this.
        #[serde(rename = "spread_ms")]
        spread: Span,
        /// The scenario's start_tolerance.
        #[serde(rename = "tolerance_ms")]
        tolerance: Span,
    },
    /// A sensor does not read what the fleet file requires.
    #[error("`{sensor}` reads {reading}, the fleet file requires {range}", reading = reading.map_or_else(|| "nothing".to_owned(), |r| r.to_string()))]
    Requirement {
        /// Which sensor.
        sensor: DeviceId,
        /// What it read.
        reading: Option<f64>,
        /// What is required.
        range: SensorRange,
    },
    /// A device stands where its first keyframe does not expect it.
    #[error(
        "device `{device}` is at {reading}, {}",
        match act {
            None => format!("its first keyframe expects {expected}: move it there with `run --approach 5s`, or put the first keyframe later"),
            Some(act) => format!("its first keyframe in the act `{act}` expects {expected}: move it there in an earlier act, or put that keyframe later"),
        }
    )]
    Position {
        /// Which device.
        device: DeviceId,
        /// Where it stands.
        reading: f64,
        /// Where it should.
        expected: f64,
        /// The act before which the mission found this; `None` if an approach before the mission could have moved the device there.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        act: Option<String>,
    },
    /// It says of a script what cannot be true.
    #[error("device `{device}` reports what cannot be: {claim}")]
    Claim {
        /// Which device.
        device: DeviceId,
        /// What it says, and what is possible.
        #[serde(flatten)]
        claim: Claim,
    },
    /// It refused or ended a script.
    #[error("device `{device}`: {error}")]
    Script {
        /// Which device.
        device: DeviceId,
        /// The robot's reason.
        error: ControlError,
    },
    /// The robot was not there when the mission began, and took no part in it until its end.
    #[error("it never joined: {reason}")]
    NeverJoined {
        /// The reason, for people.
        reason: String,
    },
}

/// What makes a link too slow.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "slow", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Slow {
    /// Its round trips.
    #[error("a round trip takes {round_trip}, at most {longest} is possible")]
    RoundTrip {
        /// What its link keeps to nearly always.
        #[serde(rename = "round_trip_ms")]
        round_trip: Span,
        /// The longest that is taken.
        #[serde(rename = "longest_ms")]
        longest: Span,
    },
    /// The lease before the start that the act would need because of it.
    #[error(
        "the act would need a lease of {lease} before its start, at most {longest} is possible, because a round trip to it takes {round_trip} and its clock lets it start up to {early} early or {late} late"
    )]
    Lease {
        /// The lease that would be needed.
        #[serde(rename = "lease_ms")]
        lease: Span,
        /// The longest that is given.
        #[serde(rename = "longest_ms")]
        longest: Span,
        /// Of its link.
        #[serde(rename = "round_trip_ms")]
        round_trip: Span,
        /// How much earlier than planned it may start.
        #[serde(rename = "early_ms")]
        early: Span,
        /// How much later.
        #[serde(rename = "late_ms")]
        late: Span,
    },
}

/// A program that never says what it is may be no robot.
fn remedy_of_silence(awaited: &str) -> &'static str {
    match awaited {
        "initialization block" => "; check that the program at its address is a robot that speaks URRCP",
        _ => "",
    }
}

fn remedy_of_busy(error: &ControlError) -> &'static str {
    match error.code {
        ErrorCode::Busy => {
            "; wait for its end, or end it with `downbeat stop` on the machine where it runs; an operator with the role `seize` takes robots with a `tls://` or `hmac://` address by `downbeat run --seize`"
        }
        _ => "",
    }
}

/// A clock that is off is a matter of NTP; one that is only poorly known is a matter of the link.
fn clock_text(offset: Span, uncertainty: Span, tolerance: Span) -> String {
    match ClockDoubt::of(offset, uncertainty) {
        ClockDoubt::Clock => format!(
            "clock off by {offset} (+-{uncertainty}), the scenario tolerates {tolerance}: check the robot's NTP, or raise start_tolerance"
        ),
        ClockDoubt::Path => format!(
            "clock known only to +-{uncertainty} (offset {offset}) because the delay of its link varies, the scenario tolerates {tolerance}: use a steadier link, or raise start_tolerance"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The kind that stands behind another one in the enumeration: a new kind has to find its place here.
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
    fn a_failure_of_every_kind_keeps_to_the_schema_of_reports_and_is_read_back() {
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
    fn only_what_would_help_is_advised() {
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
