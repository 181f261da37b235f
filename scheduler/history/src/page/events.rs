//! What happened, in words: what the operator was told, or what the journal says where nobody knows what was told.

use serde_json::Value;
use urrcp::{RobotId, Server, Timestamp};

use super::document::MissionEvent;
use super::planned::Places;
use super::played::{Epoch, Told};

/// The keys that say what something is: of what the operator was told, and of the journal.
const KINDS: [&str; 2] = ["progress", "record"];

/// What was told as JSON, as recordings have it.
pub(super) fn values(told: &[Told]) -> Vec<(Timestamp<Server>, Value)> {
    told.iter().filter_map(|(at, progress)| Some((*at, serde_json::to_value(progress).ok()?))).collect()
}

pub(super) fn of_values(
    values: &[(Timestamp<Server>, Value)],
    places: &Places,
    epoch: Epoch,
) -> Vec<MissionEvent> {
    let event = |(at, value): &(Timestamp<Server>, Value)| {
        let kind = KINDS.iter().find_map(|key| value[key].as_str())?;
        let text = sentence(kind, value)?;
        let robot = value["robot"].as_str().and_then(|id| id.parse::<RobotId>().ok());
        let robot = robot.and_then(|robot| places.robot(&robot));
        Some(MissionEvent { at: epoch.millis(*at), kind: kind.to_owned(), robot, text })
    };
    values.iter().filter_map(event).collect()
}

/// Nothing for what happens often and is on the page otherwise.
fn sentence(kind: &str, value: &Value) -> Option<String> {
    let text = |key: &str| value[key].as_str().unwrap_or_default();
    let act = || match (value["act"].as_str(), value["number"].as_u64()) {
        (Some(name), _) => name.to_owned(),
        (None, Some(number)) => format!("act {}", number + 1),
        (None, None) => "an act".to_owned(),
    };
    Some(match kind {
        "begun" => "the mission has begun".to_owned(),
        "connected" => "all robots are connected".to_owned(),
        "greeted" | "checked" => "all robots are checked".to_owned(),
        "waiting" => format!("{} waits for {}", act(), text("awaits")),
        "preparing" | "prepared" => format!("{} is sent", act()),
        "accepted" => "has accepted all its scripts".to_owned(),
        "decided" => format!("{} is decided: all robots have accepted", act()),
        "committed" if value["record"].is_string() => format!("the commitment of {} is written down", act()),
        "committed" => format!("{} is committed: every lease reaches over its start", act()),
        "finished" => "has ended all its scripts".to_owned(),
        "at_rest" | "stop_confirmed" => "has confirmed its stop".to_owned(),
        "act_skipped" => format!("{} is not played: {}", act(), text("fate").replace('_', " ")),
        "going_home" => format!("{} moves the robots at rest to their default positions", act()),
        "at_home" => "no device has to move to its default position".to_owned(),
        "approaching" => {
            format!("{} moves the robots at rest to the first positions of {}", act(), text("to"))
        }
        "not_home" => format!("the robots stay where they are: {}", text("reason")),
        "not_approached" => format!("{} is not played: {}", act(), text("reason")),
        "act_ended" => {
            let name = value["report"]["act"].as_str().map_or_else(act, str::to_owned);
            if value["again"] == true { withdrawn(&name) } else { format!("{name} has ended") }
        }
        "act_withdrawn" => withdrawn(&act()),
        "failed" => text("text").to_owned(),
        "link_lost" => format!("its link is lost: {}", text("reason")),
        "reattached" => "is back on its link".to_owned(),
        "dropped" => "is left out from here on".to_owned(),
        "ntp_lost" => "the NTP server does not answer".to_owned(),
        "ntp_back" => "the NTP server answers again".to_owned(),
        "journal_written_again" => "the journal was removed or replaced, and is written again".to_owned(),
        "journal_lost" => text("reason").to_owned(),
        "stopping" => match value["reason"].as_str() {
            Some(reason) => format!("everything is being stopped: {reason}"),
            None => "everything is being stopped".to_owned(),
        },
        "ended" => "the mission has ended".to_owned(),
        _ => return None,
    })
}

fn withdrawn(act: &str) -> String {
    format!("{act} was withdrawn before anything moved, and is prepared again")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn told(value: Value) -> Option<String> {
        let events = of_values(
            &[(Timestamp::from_nanos(0), value)],
            &Places::default(),
            Epoch(Timestamp::from_nanos(0)),
        );
        events.into_iter().next().map(|event| event.text)
    }

    #[test]
    fn what_was_told_and_what_the_journal_says_read_alike() {
        let sent = Some("act 2 is sent".to_owned());
        assert_eq!(told(json!({"record": "prepared", "number": 1, "act": 1})), sent);
        assert_eq!(told(json!({"progress": "preparing", "act": "act 2"})), sent);
        assert_eq!(
            told(json!({"progress": "failed", "robot": "r", "text": "silent"})),
            Some("silent".to_owned())
        );
        assert_eq!(told(json!({"progress": "heard", "robot": "r"})), None);
        let approach = json!({"progress": "approaching", "act": "approach", "to": "bow"});
        let moves = "approach moves the robots at rest to the first positions of bow";
        assert_eq!(told(approach).as_deref(), Some(moves));
    }
}
