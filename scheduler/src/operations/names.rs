//! Every metric: its name with the unit, its kind, its label and what it says. `docs/operations.md` has the same table.

/// A metric, as it is exposed.
#[derive(Debug)]
pub(super) struct Metric {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    /// Empty: there is one value.
    pub(super) label: &'static str,
    pub(super) help: &'static str,
}

/// How the values of a metric are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Goes up and down.
    Gauge,
    /// Only goes up.
    Counter,
    /// Is sorted into classes.
    Histogram,
}

macro_rules! metrics {
    ($($metric:ident $kind:ident $name:literal $label:literal $help:literal;)*) => {
        $(
            pub(super) static $metric: Metric = Metric { name: $name, kind: Kind::$kind, label: $label, help: $help };
        )*
        /// All of them, in the order of the documents.
        #[cfg(test)]
        pub(super) static ALL: &[&Metric] = &[$(&$metric,)*];
    };
}

metrics! {
    BUILD_INFO Gauge "downbeat_build_info" "version" "Always 1; the label is the version of the program.";
    MISSION_PHASE Gauge "downbeat_mission_phase" "phase" "1 for the phase in which the mission is: starting, greeting, performing, stopping or ended.";
    LOOP_AGE Gauge "downbeat_mission_loop_age_seconds" "" "Time since the loop of the mission last turned.";
    LOOP_LATENESS Histogram "downbeat_mission_loop_lateness_seconds" "" "How late the loop of the mission woke for what was due.";
    ROUNDS_LATE Counter "downbeat_mission_lease_rounds_late_total" "" "Rounds of questions, which renew leases, that came more than 100 ms late.";
    ACTS Gauge "downbeat_mission_acts" "stage" "Acts that wait, are prepared up to their start, or play: waiting, preparing or playing.";
    ACTS_PLAYED Counter "downbeat_mission_acts_played_total" "" "Acts that were played to their end, as often as they were.";
    ROBOTS Gauge "downbeat_mission_robots" "link" "Robots of the mission whose link stands (up), or does not (down).";
    SKEW_BUDGET Gauge "downbeat_mission_skew_budget_seconds" "" "Predicted spread of the starts of the last act that was prepared.";
    START_TOLERANCE Gauge "downbeat_mission_start_tolerance_seconds" "" "What the scenario tolerates as the spread of starts of that act.";
    START_SPREAD Gauge "downbeat_mission_start_spread_seconds" "" "Largest minus smallest start error of the last act that has ended, by the clocks of the robots.";
    START_ERROR Histogram "downbeat_mission_start_error_seconds" "" "Size of the start errors that robots reported, by their own clocks.";
    COMMIT_WINDOW Gauge "downbeat_mission_commitment_window_seconds" "" "Time from the last commitment to its last answer.";
    JOURNAL_SYNC Histogram "downbeat_mission_journal_sync_seconds" "" "Time from handing a durable record to the journal until it was on the disk.";
    FAILURES Counter "downbeat_mission_failures_total" "kind" "Failures of robots, by their kind as in reports.";
    STOPS Counter "downbeat_mission_stops_total" "" "How often the mission has stopped its robots.";
    LINKS_LOST Counter "downbeat_mission_links_lost_total" "" "Links that broke while the mission went on.";
    R_LINKED Gauge "downbeat_robot_link_up" "robot" "1 if the link to the robot stands and the robot has said which one it is.";
    R_TAKES_PART Gauge "downbeat_robot_takes_part" "robot" "1 if the robot takes part in the mission.";
    R_OFFSET Gauge "downbeat_robot_clock_offset_seconds" "robot" "Clock of the robot minus that of the server.";
    R_UNCERTAINTY Gauge "downbeat_robot_clock_uncertainty_seconds" "robot" "The true offset lies within this of the measured one.";
    R_ROUND_TRIP Gauge "downbeat_robot_round_trip_seconds" "robot" "How long round trips take now, without single outliers.";
    R_SENT Counter "downbeat_robot_scripts_sent_total" "robot" "Scripts that the robot was sent.";
    R_ACCEPTED Counter "downbeat_robot_scripts_accepted_total" "robot" "Scripts that the robot has accepted.";
    R_STARTED Counter "downbeat_robot_scripts_started_total" "robot" "Scripts that the robot has started.";
    R_FAILED Counter "downbeat_robot_scripts_failed_total" "robot" "Scripts that the robot has refused or ended early, also because they were withdrawn or stopped.";
    R_STEPS Counter "downbeat_robot_steps_done_total" "robot" "Steps that the robot says it has done.";
    R_LATE Counter "downbeat_robot_steps_late_total" "robot" "Steps that came more than a millisecond late, as the robot says.";
    R_START_ERROR Gauge "downbeat_robot_start_error_seconds" "robot" "Start error of largest size over all acts: actual minus planned start by the clock of the robot.";
    R_RETRIES Counter "downbeat_robot_requests_repeated_total" "robot" "Requests that were sent again.";
    R_RECONNECTS Counter "downbeat_robot_reconnects_total" "robot" "How often the link was made again.";
    R_UNCONFIRMED Gauge "downbeat_robot_stop_unconfirmed" "robot" "1 while a stop was sent to the robot and is not confirmed.";
    H_REALTIME Gauge "downbeat_host_realtime_scheduling" "" "1 if the thread that moves robots runs under real-time scheduling.";
    H_WAKE_UP Histogram "downbeat_host_wake_up_lateness_seconds" "" "How late the thread that moves robots woke for what was due.";
    H_REFUSALS Counter "downbeat_host_refusals_total" "reason" "How often peers were refused, slowed down or hung up on.";
    H_HELD Gauge "downbeat_host_commands_held" "robot" "Scripts and single commands that the robot holds: they wait for their start, or run.";
    H_STARTED Counter "downbeat_host_commands_started_total" "robot" "Scripts and single commands that have started.";
    H_ENDED Counter "downbeat_host_commands_ended_total" "robot" "Scripts and single commands that have come to their end.";
    H_FAILED Counter "downbeat_host_commands_failed_total" "robot" "Scripts and single commands that ended early, or never started although they were held.";
    H_STEPS Counter "downbeat_host_steps_set_total" "robot" "Steps of scripts that were set.";
    H_LATE Counter "downbeat_host_steps_late_total" "robot" "Steps that came more than a millisecond late, of scripts that have come to their end.";
    H_CONNECTIONS Gauge "downbeat_host_connections" "robot" "Connections that the robot has.";
    H_HARDWARE Gauge "downbeat_host_hardware_answers" "robot" "1 if the hardware behind the robot answers, or if it has none.";
}

/// The kinds of failures, as reports name them.
pub(super) const FAILURE_KINDS: [&str; 17] = [
    "link_down",
    "flooding",
    "too_slow",
    "garbled",
    "another_robot",
    "silent",
    "not_available",
    "wrong_version",
    "unfit",
    "no_time_to_send",
    "clock",
    "latency_spread",
    "requirement",
    "position",
    "claim",
    "script",
    "never_joined",
];

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::report::SCHEMA;

    const DOCUMENT: &str = include_str!("../../../docs/operations.md");

    #[test]
    fn the_document_lists_every_metric_with_its_kind_its_label_and_what_it_says() {
        let row = |metric: &&Metric| {
            let label = if metric.label.is_empty() { String::new() } else { format!("`{}`", metric.label) };
            let kind = format!("{:?}", metric.kind).to_lowercase();
            format!("| `{}` | {kind} | {label} | {} |", metric.name, metric.help)
        };
        let expected: Vec<String> = ALL.iter().map(row).collect();
        let listed: Vec<&str> = DOCUMENT.lines().filter(|line| line.starts_with("| `downbeat_")).collect();
        assert_eq!(listed, expected);
    }

    #[test]
    fn names_end_with_their_unit_and_counters_with_total() {
        for metric in ALL {
            assert_eq!(metric.name.ends_with("_total"), metric.kind == Kind::Counter, "{}", metric.name);
            assert!(metric.kind != Kind::Histogram || metric.name.ends_with("_seconds"), "{}", metric.name);
            assert!(metric.help.ends_with('.'), "{}", metric.name);
        }
    }

    #[test]
    fn every_kind_of_failure_is_counted() {
        let schema: serde_json::Value = serde_json::from_str(SCHEMA).unwrap();
        let listed = schema["$defs"]["failure"]["properties"]["failure"]["enum"].as_array().unwrap();
        let listed: BTreeSet<&str> = listed.iter().filter_map(serde_json::Value::as_str).collect();
        assert_eq!(listed, FAILURE_KINDS.into());
    }
}
