//! Describes the events of a mission in words: from the messages to the operator or, without those, from the journal.

use downbeat_mission::report::ActFate;
use downbeat_mission::{ActNumber, Progress, Record};
use urrcp::{RobotId, Server, Timestamp};

use super::document::MissionEvent;
use super::planned::Places;
use super::played::{Epoch, TimedProgress};
use crate::history::Happened;

/// Describes the events of a mission from the messages to the operator.
pub(super) fn of_told(told: &[TimedProgress], places: &Places, epoch: Epoch) -> Vec<MissionEvent> {
    of_happened(told.iter().map(|(at, told)| (*at, Happened::Told(told))), places, epoch)
}

pub(super) fn of_happened<'a>(
    happened: impl Iterator<Item = (Timestamp<Server>, Happened<'a>)>,
    places: &Places,
    epoch: Epoch,
) -> Vec<MissionEvent> {
    let event = |(at, happened)| {
        let (kind, robot, text) = match happened {
            Happened::Told(progress) => told(progress)?,
            Happened::Recorded(record) => recorded(record)?,
        };
        let robot = robot.and_then(|robot| places.robot(robot));
        Some(MissionEvent { at: epoch.millis(at), kind: kind.to_owned(), robot, text })
    };
    happened.filter_map(event).collect()
}

/// The kind of an event, the robot that it concerns, and its text.
type Event<'a> = (&'static str, Option<&'a RobotId>, String);

/// Describes a message to the operator; `None` for frequent messages that the page shows elsewhere.
fn told(progress: &Progress) -> Option<Event<'_>> {
    let of_mission = |kind, text: String| Some((kind, None, text));
    match progress {
        Progress::Connected { .. } => of_mission("connected", "all robots are connected".to_owned()),
        Progress::Greeted { .. } => of_mission("greeted", CHECKED.to_owned()),
        Progress::Waiting { act, awaits, .. } => of_mission("waiting", format!("{act} waits for {awaits}")),
        Progress::Preparing { act, .. } => of_mission("preparing", sent(act)),
        Progress::Accepted { robot } => {
            Some(("accepted", Some(robot), "has accepted all its scripts".to_owned()))
        }
        Progress::Decided { act, .. } => of_mission("decided", decided(act)),
        Progress::Committed { act, .. } => {
            of_mission("committed", format!("{act} is committed: all robots have confirmed its start"))
        }
        Progress::Finished { robot, .. } => {
            Some(("finished", Some(robot), "has ended all its scripts".to_owned()))
        }
        Progress::AtRest { robot } => Some(("at_rest", Some(robot), AT_REST.to_owned())),
        Progress::ActSkipped { act, fate } => of_mission("act_skipped", skipped(act, fate)),
        Progress::ActEnded { act } => of_mission("act_ended", format!("{act} has ended")),
        Progress::ActWithdrawn { act } => of_mission("act_withdrawn", withdrawn(act)),
        Progress::GoingHome { act, .. } => {
            of_mission("going_home", format!("{act} moves the robots at rest to their default positions"))
        }
        Progress::AtHome => of_mission("at_home", "no device has to move to its default position".to_owned()),
        Progress::Approaching { act, to, .. } => of_mission(
            "approaching",
            format!("{act} moves the robots at rest to the first positions of {to}"),
        ),
        Progress::NotHome { reason } => {
            of_mission("not_home", format!("the robots stay where they are: {reason}"))
        }
        Progress::NotApproached { act, reason } => {
            of_mission("not_approached", format!("{act} is not played: {reason}"))
        }
        Progress::Failed(failure) => Some(("failed", Some(&failure.robot), failure.kind.to_string())),
        Progress::LinkLost { robot, reason, .. } => {
            Some(("link_lost", Some(robot), format!("its link was lost: {reason}")))
        }
        Progress::Reattached { robot } => Some(("reattached", Some(robot), "has reconnected".to_owned())),
        Progress::Dropped { robot } => Some(("dropped", Some(robot), LEFT_OUT.to_owned())),
        Progress::NtpLost { .. } => of_mission("ntp_lost", "the NTP server does not answer".to_owned()),
        Progress::NtpBack { .. } => of_mission("ntp_back", "the NTP server answers again".to_owned()),
        Progress::JournalWrittenAgain => of_mission(
            "journal_written_again",
            "the journal was removed or replaced and has been restored".to_owned(),
        ),
        Progress::JournalLost { reason } => of_mission("journal_lost", reason.clone()),
        Progress::Stopping { reason, .. } => of_mission("stopping", format!("{STOPPING}: {reason}")),
        Progress::Started { .. } | Progress::Heard { .. } | Progress::Reading { .. } => None,
    }
}

/// Describes a record of the journal; `None` for records that the page does not show.
fn recorded(record: &Record) -> Option<Event<'_>> {
    let of_mission = |kind, text: String| Some((kind, None, text));
    let named = |number: ActNumber| format!("act {}", number.get() + 1);
    match record {
        Record::Begun => of_mission("begun", "the mission has begun".to_owned()),
        Record::Checked => of_mission("checked", CHECKED.to_owned()),
        Record::Prepared(promise) => of_mission("prepared", sent(&named(promise.number))),
        Record::Decided { number, .. } => of_mission("decided", decided(&named(*number))),
        Record::Committed { number } => {
            of_mission("committed", format!("the commitment of {} is recorded", named(*number)))
        }
        Record::StopConfirmed { robot } => Some(("stop_confirmed", Some(robot), AT_REST.to_owned())),
        Record::ActSkipped(over) => of_mission("act_skipped", skipped("an act", &over.fate)),
        Record::ActEnded { report, again: true, .. } => of_mission("act_ended", withdrawn(&report.act)),
        Record::ActEnded { report, .. } => of_mission("act_ended", format!("{} has ended", report.act)),
        Record::Failed(failure) => Some(("failed", Some(&failure.robot), failure.kind.to_string())),
        Record::Dropped { robot } => Some(("dropped", Some(robot), LEFT_OUT.to_owned())),
        Record::Stopping { .. } => of_mission("stopping", STOPPING.to_owned()),
        Record::Ended { .. } => of_mission("ended", "the mission has ended".to_owned()),
        Record::Go { .. } | Record::Lapsing { .. } | Record::Translated { .. } => None,
    }
}

const CHECKED: &str = "all robots have been checked";
const AT_REST: &str = "has confirmed its stop";
const LEFT_OUT: &str = "is left out from now on";
const STOPPING: &str = "everything is being stopped";

fn sent(act: &str) -> String {
    format!("{act} is sent")
}

fn decided(act: &str) -> String {
    format!("the start of {act} is decided: all robots have accepted it")
}

fn skipped(act: &str, fate: &ActFate) -> String {
    format!("{act} is {fate}")
}

fn withdrawn(act: &str) -> String {
    format!("{act} was withdrawn before anything moved, and is prepared again")
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use downbeat_mission::{Failure, FailureKind, LeadTime};
    use urrcp::Span;

    use super::*;
    use crate::test_records::prepared;

    const BEGIN: Timestamp<Server> = Timestamp::from_nanos(0);

    fn text(happened: Happened<'_>) -> Option<String> {
        let events = of_happened(std::iter::once((BEGIN, happened)), &Places::default(), Epoch(BEGIN));
        events.into_iter().next().map(|event| event.text)
    }

    #[test]
    fn progress_and_records_have_the_same_text() {
        let sent = Some("act 2 is sent".to_owned());
        let lead = LeadTime { prepare: Span::ZERO, lease: Span::ZERO, margin: Span::ZERO };
        let (act, timestamp, start, skew, slowest) = ("act 2".to_owned(), BEGIN, BEGIN, None, None);
        let preparing = Progress::Preparing { act, timestamp, start, lead, skew, slowest };
        assert_eq!(text(Happened::Recorded(&prepared(1, Vec::new()))), sent);
        assert_eq!(text(Happened::Told(&preparing)), sent);
        let kind = FailureKind::WrongVersion { version: "2".to_owned() };
        let failure = Failure { robot: "r".parse().unwrap(), kind };
        let why = Some(failure.kind.to_string());
        assert_eq!(text(Happened::Told(&Progress::Failed(failure.clone()))), why);
        assert_eq!(text(Happened::Recorded(&Record::Failed(failure))), why);
        let robot = "r".parse().unwrap();
        assert_eq!(text(Happened::Told(&Progress::Started { robot, error: None })), None);
        let (act, to, choreography) = ("approach".to_owned(), "bow".to_owned(), Arc::default());
        let moves = "approach moves the robots at rest to the first positions of bow";
        assert_eq!(
            text(Happened::Told(&Progress::Approaching { act, to, choreography })).as_deref(),
            Some(moves)
        );
    }
}
