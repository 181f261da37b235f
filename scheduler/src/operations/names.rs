//! The definitions of all metrics: name with unit, kind, label and help text. `docs/operations.md` contains the same table.

/// The definition of a metric on the metrics page.
#[derive(Debug)]
pub(super) struct Metric {
    pub(super) name: &'static str,
    pub(super) kind: MetricKind,
    /// The name of the label. Empty for a metric with a single value.
    pub(super) label: &'static str,
    pub(super) help: &'static str,
}

/// The kind of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MetricKind {
    /// The value can increase and decrease.
    Gauge,
    /// The value only increases.
    Counter,
    /// The observed values are counted in buckets.
    Histogram,
}

macro_rules! metrics {
    ($($metric:ident $kind:ident $name:literal $label:literal $help:literal;)*) => {
        $(
            pub(super) static $metric: Metric = Metric { name: $name, kind: MetricKind::$kind, label: $label, help: $help };
        )*
        /// All metrics, in the order of `docs/operations.md`.
        #[cfg(test)]
        pub(super) static ALL: &[&Metric] = &[$(&$metric,)*];
    };
}

metrics! {
    BUILD_INFO Gauge "downbeat_build_info" "version" "Always 1; the label is the version of the program.";
    MISSION_PHASE Gauge "downbeat_mission_phase" "phase" "1 for the current phase of the mission: starting, greeting, performing, stopping or ended.";
    LOOP_AGE Gauge "downbeat_mission_loop_age_seconds" "" "Time since the last iteration of the mission loop.";
    LOOP_LATENESS Histogram "downbeat_mission_loop_lateness_seconds" "" "Wake-up delay of the mission loop.";
    ROUNDS_LATE Counter "downbeat_mission_lease_rounds_late_total" "" "Lease renewal rounds that were more than 100 ms late.";
    ACTS Gauge "downbeat_mission_acts" "stage" "Acts by state: waiting, preparing (until their start) or playing.";
    ACTS_PLAYED Counter "downbeat_mission_acts_played_total" "" "Acts that were played to their end, including repetitions.";
    ROBOTS Gauge "downbeat_mission_robots" "link" "Robots of the mission by the state of their link: up or down.";
    SKEW_BUDGET Gauge "downbeat_mission_skew_budget_seconds" "" "Predicted start spread of the last act that was prepared.";
    START_TOLERANCE Gauge "downbeat_mission_start_tolerance_seconds" "" "Start spread that the scenario tolerates for the last act that was prepared.";
    START_SPREAD Gauge "downbeat_mission_start_spread_seconds" "" "Largest minus smallest start error of the last act that has ended, by the clocks of the robots.";
    START_ERROR Histogram "downbeat_mission_start_error_seconds" "" "Absolute start errors that robots reported, by their own clocks.";
    COMMIT_WINDOW Gauge "downbeat_mission_commitment_window_seconds" "" "Time from the last commitment to its last answer.";
    JOURNAL_SYNC Histogram "downbeat_mission_journal_sync_seconds" "" "Time until a durable record handed to the journal was on the disk.";
    FAILURES Counter "downbeat_mission_failures_total" "kind" "Failures of robots by kind, as in reports.";
    STOPS Counter "downbeat_mission_stops_total" "" "How often the mission has stopped its robots.";
    LINKS_LOST Counter "downbeat_mission_links_lost_total" "" "Links that broke while the mission continued.";
    R_LINKED Gauge "downbeat_robot_link_up" "robot" "1 if the link to the robot is up and the robot has identified itself.";
    R_TAKES_PART Gauge "downbeat_robot_takes_part" "robot" "1 if the robot takes part in the mission.";
    R_OFFSET Gauge "downbeat_robot_clock_offset_seconds" "robot" "Clock of the robot minus that of the server.";
    R_UNCERTAINTY Gauge "downbeat_robot_clock_uncertainty_seconds" "robot" "Maximum difference between the measured and the true offset.";
    R_ROUND_TRIP Gauge "downbeat_robot_round_trip_seconds" "robot" "Current round-trip time, without outliers.";
    R_SENT Counter "downbeat_robot_scripts_sent_total" "robot" "Scripts that were sent to the robot.";
    R_ACCEPTED Counter "downbeat_robot_scripts_accepted_total" "robot" "Scripts that the robot has accepted.";
    R_STARTED Counter "downbeat_robot_scripts_started_total" "robot" "Scripts that the robot has started.";
    R_FAILED Counter "downbeat_robot_scripts_failed_total" "robot" "Scripts that the robot has refused or ended early, including those that were withdrawn or stopped.";
    R_STEPS Counter "downbeat_robot_steps_done_total" "robot" "Steps that the robot has reported as done.";
    R_LATE Counter "downbeat_robot_steps_late_total" "robot" "Steps that the robot has reported as more than a millisecond late.";
    R_START_ERROR Gauge "downbeat_robot_start_error_seconds" "robot" "Largest absolute start error over all acts: actual minus planned start by the clock of the robot.";
    R_RETRIES Counter "downbeat_robot_requests_repeated_total" "robot" "Requests that were sent again.";
    R_RECONNECTS Counter "downbeat_robot_reconnects_total" "robot" "Number of times that the link was re-established.";
    R_UNCONFIRMED Gauge "downbeat_robot_stop_unconfirmed" "robot" "1 while a stop that was sent to the robot is not confirmed.";
    H_REALTIME Gauge "downbeat_host_realtime_scheduling" "" "1 if the thread that moves robots runs under real-time scheduling.";
    H_WAKE_UP Histogram "downbeat_host_wake_up_lateness_seconds" "" "Wake-up delay of the thread that moves robots.";
    H_REFUSALS Counter "downbeat_host_refusals_total" "reason" "Number of times that peers were refused, throttled or disconnected.";
    H_HELD Gauge "downbeat_host_commands_held" "robot" "Scripts and single commands that the robot holds: waiting for their start, or running.";
    H_STARTED Counter "downbeat_host_commands_started_total" "robot" "Scripts and single commands that have started.";
    H_ENDED Counter "downbeat_host_commands_ended_total" "robot" "Scripts and single commands that have completed.";
    H_FAILED Counter "downbeat_host_commands_failed_total" "robot" "Scripts and single commands that ended early, or were held but never started.";
    H_STEPS Counter "downbeat_host_steps_set_total" "robot" "Steps of scripts that were set.";
    H_LATE Counter "downbeat_host_steps_late_total" "robot" "Steps of completed scripts that were more than a millisecond late.";
    H_CONNECTIONS Gauge "downbeat_host_connections" "robot" "Open connections to the robot.";
    H_HARDWARE Gauge "downbeat_host_hardware_answers" "robot" "1 if the hardware of the robot responds, or if it has none.";
}

/// The names of all kinds of failures, as in reports.
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
    fn document_lists_every_metric_with_kind_label_and_help() {
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
    fn metric_names_end_with_unit_and_counters_with_total() {
        for metric in ALL {
            assert_eq!(
                metric.name.ends_with("_total"),
                metric.kind == MetricKind::Counter,
                "{}",
                metric.name
            );
            assert!(
                metric.kind != MetricKind::Histogram || metric.name.ends_with("_seconds"),
                "{}",
                metric.name
            );
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
