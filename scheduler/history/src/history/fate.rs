//! How an act ended, by its report and by what was told or written down.

use serde::Serialize;
use serde_json::Value;
use urrcp::{Server, Timestamp};

/// What became of an act.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Fate {
    /// All its robots but those that were left out did all their steps.
    Played,
    /// It had begun, and ended before its time.
    Stopped,
    /// Nothing of it began.
    Withdrawn,
    /// It had begun, and a robot has not said how it went on.
    Unknown,
    /// Its end is not known.
    Open,
}

impl Fate {
    /// By the report of an act, as it is in JSON; without one the act has not ended, as far as is known.
    pub(crate) fn of(report: Option<&Value>) -> Self {
        let Some(report) = report else { return Self::Open };
        let robots = report["robots"].as_array().into_iter().flatten();
        let (left_out, taking_part): (Vec<&Value>, Vec<&Value>) =
            robots.partition(|robot| robot["left_out"] == true);
        let scripts = |robots: &[&Value]| -> Vec<Value> {
            robots.iter().flat_map(|robot| robot["devices"].as_array().cloned().unwrap_or_default()).collect()
        };
        let began =
            |script: &Value| script["started_at"].is_string() || script["steps_done"].as_u64() > Some(0);
        let scripts_left = scripts(&taking_part);
        let is = |state: &'static str| move |script: &Value| script["state"] == state;
        if !scripts_left.is_empty() && scripts_left.iter().all(is("ended")) {
            return Self::Played;
        }
        if !scripts_left.iter().chain(&scripts(&left_out)).any(began) {
            return if scripts_left.iter().any(is("unknown")) { Self::Unknown } else { Self::Withdrawn };
        }
        if scripts_left.iter().any(is("unknown")) { Self::Unknown } else { Self::Stopped }
    }
}

/// The fate of an act as text, from its report as JSON.
#[must_use]
pub fn fate_text(report: &Value) -> &'static str {
    match Fate::of(Some(report)) {
        Fate::Played => "played",
        Fate::Stopped => "stopped on the way",
        Fate::Withdrawn => "withdrawn before anything moved",
        Fate::Unknown | Fate::Open => "its end is not known",
    }
}

/// When an act was over, or everything was being stopped, after it was sent at `sent`.
pub(crate) fn over(
    told: &[(Timestamp<Server>, Value)],
    name: &str,
    number: u32,
    sent: Timestamp<Server>,
) -> Option<Timestamp<Server>> {
    let ends = |value: &Value| match (value["progress"].as_str(), value["record"].as_str()) {
        (Some("stopping"), _) | (_, Some("stopping" | "ended")) => true,
        (Some("act_ended"), _) => value["act"] == name,
        (_, Some("act_ended")) => value["report"]["number"] == number,
        _ => false,
    };
    told.iter().find(|(at, value)| *at >= sent && ends(value)).map(|(at, _)| *at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn robot(left_out: bool, states: &[&str]) -> Value {
        let script = |state: &&str| json!({"state": state, "steps_done": u32::from(!["accepted", "unknown"].contains(state))});
        json!({"left_out": left_out, "devices": states.iter().map(script).collect::<Vec<_>>()})
    }

    #[test]
    fn an_act_is_played_only_if_all_that_were_not_left_out_did_all_their_steps() {
        let fate = |robots: &[Value]| Fate::of(Some(&json!({ "robots": robots })));
        assert_eq!(fate(&[robot(false, &["ended", "ended"]), robot(true, &["failed"])]), Fate::Played);
        assert_eq!(fate(&[robot(false, &["ended", "failed"])]), Fate::Stopped);
        assert_eq!(fate(&[robot(false, &["accepted"]), robot(false, &["accepted"])]), Fate::Withdrawn);
        assert_eq!(fate(&[robot(false, &["ended", "unknown"])]), Fate::Unknown);
        assert_eq!(fate(&[robot(true, &["started"])]), Fate::Stopped);
        assert_eq!(Fate::of(None), Fate::Open);
        assert_eq!(Fate::of(Some(&json!("nonsense"))), Fate::Withdrawn);
    }
}
