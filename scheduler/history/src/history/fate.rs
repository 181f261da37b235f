//! Determines how and when an act ended, from its report and from messages or records.

use downbeat_mission::report::{ActReport, ActRobot, DeviceReport, DeviceState};
use downbeat_mission::{ActNumber, Progress, Record};
use serde::Serialize;
use urrcp::{Server, Timestamp};

use super::Happened;

/// How an act of a mission ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Fate {
    /// All robots of the act except those that were left out completed all their steps.
    Played,
    /// The act began and ended prematurely.
    Stopped,
    /// No script of the act began.
    Withdrawn,
    /// The act began, and a robot has not reported the end of its scripts.
    Unknown,
    /// The act has no report, so its end is not known.
    Open,
}

impl Fate {
    /// Determines the fate from the report of an act; without a report, the act is still open.
    pub(crate) fn of(report: Option<&ActReport>) -> Self {
        let Some(report) = report else { return Self::Open };
        let (left_out, taking_part): (Vec<&ActRobot>, Vec<&ActRobot>) =
            report.robots.iter().partition(|robot| robot.left_out);
        let scripts_left: Vec<&DeviceReport> = scripts(&taking_part).collect();
        let is_unknown = |script: &&DeviceReport| script.state == DeviceState::Unknown;
        if !scripts_left.is_empty() && scripts_left.iter().all(|script| script.state == DeviceState::Ended) {
            return Self::Played;
        }
        let began = |script: &DeviceReport| script.started_at.is_some() || script.steps_done > 0;
        if !scripts_left.iter().copied().chain(scripts(&left_out)).any(began) {
            return if scripts_left.iter().any(is_unknown) { Self::Unknown } else { Self::Withdrawn };
        }
        if scripts_left.iter().any(is_unknown) { Self::Unknown } else { Self::Stopped }
    }
}

fn scripts<'a>(robots: &[&'a ActRobot]) -> impl Iterator<Item = &'a DeviceReport> {
    robots.iter().flat_map(|robot| &robot.devices)
}

/// Describes how an act ended, according to its report.
#[must_use]
pub fn fate_text(report: &ActReport) -> &'static str {
    match Fate::of(Some(report)) {
        Fate::Played => "played",
        Fate::Stopped => "stopped before its end",
        Fate::Withdrawn => "withdrawn before anything moved",
        Fate::Unknown | Fate::Open => "outcome unknown",
    }
}

/// Returns when the act that was sent at `sent` ended, or when a stop of all robots began, whichever came first. `None` if neither
/// happened.
pub(crate) fn over<'a>(
    mut happened: impl Iterator<Item = (Timestamp<Server>, Happened<'a>)>,
    name: &str,
    number: ActNumber,
    sent: Timestamp<Server>,
) -> Option<Timestamp<Server>> {
    let ends = |happened: Happened<'_>| match happened {
        Happened::Told(Progress::Stopping { .. })
        | Happened::Recorded(Record::Stopping { .. } | Record::Ended { .. }) => true,
        Happened::Told(Progress::ActEnded { act }) => act == name,
        Happened::Recorded(Record::ActEnded { report, .. }) => report.number == number,
        Happened::Told(_) | Happened::Recorded(_) => false,
    };
    happened.find(|(at, happened)| *at >= sent && ends(*happened)).map(|(at, _)| at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_records::{device, report};

    fn robot(left_out: bool, states: &[DeviceState]) -> ActRobot {
        let script = |state: &DeviceState| {
            let begun = !matches!(state, DeviceState::Accepted | DeviceState::Unknown);
            DeviceReport { steps_done: u32::from(begun), ..device("d", *state) }
        };
        ActRobot { robot: "r".parse().unwrap(), left_out, devices: states.iter().map(script).collect() }
    }

    #[test]
    fn act_is_played_only_if_all_remaining_robots_completed_their_steps() {
        use DeviceState::{Accepted, Ended, Failed, Started, Unknown};
        let fate =
            |robots: &[ActRobot]| Fate::of(Some(&ActReport { robots: robots.to_vec(), ..report("one", 0) }));
        assert_eq!(fate(&[robot(false, &[Ended, Ended]), robot(true, &[Failed])]), Fate::Played);
        assert_eq!(fate(&[robot(false, &[Ended, Failed])]), Fate::Stopped);
        assert_eq!(fate(&[robot(false, &[Accepted]), robot(false, &[Accepted])]), Fate::Withdrawn);
        assert_eq!(fate(&[robot(false, &[Ended, Unknown])]), Fate::Unknown);
        assert_eq!(fate(&[robot(true, &[Started])]), Fate::Stopped);
        assert_eq!(Fate::of(None), Fate::Open);
    }
}
