//! The short form of a mission's report: a few lines for the people who run the show.

use downbeat_mission::report::{ActReport, Report, RobotReport, StopState};
use downbeat_mission::{Preflight, Verdict};
use downbeat_scripts::counted;
use urrcp::{RobotId, Span};

use super::local::time_of_day;

/// Returns the most important figures of a mission, and the faults of its robots, as sentences.
pub(super) fn sentences(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    if !report.acts.is_empty() {
        sentences.push(starts(report));
        sentences.push(steps(report));
    }
    sentences.extend(late_steps(report));
    sentences.extend(confirmed_stops(report));
    sentences
}

/// Whether a robot did not execute everything that was planned. The table of the short report lists only such robots.
pub(super) fn deviates(robot: &&RobotReport) -> bool {
    !robot.accepted
        || robot.started < robot.scripts
        || robot.steps_done < robot.steps_planned
        || robot.unaccounted > 0
}

fn starts(report: &Report) -> String {
    let started = report.robots.iter().filter(|robot| robot.start_error.is_some()).count();
    let of = if started == report.robots.len() { String::new() } else { format!("{started} of ") };
    let robots = format!("{of}{}", counted(report.robots.len(), "robot"));
    let when = match report.acts.as_slice() {
        [act] => format!(" at {}", time_of_day(act.start)),
        acts => format!(" in {}", counted(acts.len(), "act")),
    };
    match report.spread {
        Some(spread) if started > 1 => {
            format!("{robots} started within {}{}{when}", rounded(spread), allowed(&report.acts))
        }
        _ if started == 0 => "no robot reported that it started".to_owned(),
        _ => format!("{robots} started{when}"),
    }
}

fn allowed(acts: &[ActReport]) -> String {
    let tolerance = acts.iter().filter_map(|act| act.skew.as_ref()).map(|skew| skew.tolerance).min();
    let allowed = tolerance.map_or_else(String::new, |tolerance| format!(" ({tolerance} allowed)"));
    format!(" of each other{allowed}")
}

fn steps(report: &Report) -> String {
    let sum = |of: fn(&RobotReport) -> u64| report.robots.iter().map(of).fold(0, u64::saturating_add);
    let is_unknown = report.robots.iter().any(|robot| robot.unaccounted > 0);
    let at_least = if is_unknown { "at least " } else { "" };
    let (done, planned) = (sum(|robot| robot.steps_done), sum(|robot| robot.steps_planned));
    let uncertainty =
        report.robots.iter().filter_map(|robot| robot.clock).map(|clock| clock.uncertainty).max();
    let clocks = uncertainty.map_or_else(String::new, |uncertainty| {
        format!("; the robots' clocks are known to within {}", rounded(uncertainty))
    });
    format!("{at_least}{done} of {planned} steps played{clocks}")
}

fn late_steps(report: &Report) -> Option<String> {
    let late = || report.robots.iter().filter(|robot| robot.late_steps > 0);
    let steps = late().map(|robot| robot.late_steps).fold(0, u64::saturating_add);
    let max = late().filter_map(|robot| robot.late_max).max();
    let max = max.map_or_else(String::new, |max| format!(", by at most {}", rounded(max)));
    let robots = counted(late().count(), "robot");
    let were = if steps == 1 { "was" } else { "were" };
    let steps = counted(usize::try_from(steps).unwrap_or(usize::MAX), "step");
    (late().count() > 0).then(|| format!("{steps} of {robots} {were} more than 1 ms late{max}"))
}

fn confirmed_stops(report: &Report) -> Option<String> {
    let of = |stop: fn(&StopState) -> bool| report.robots.iter().filter(|robot| stop(&robot.stop)).count();
    let (stopped, home) = (of(|stop| *stop == StopState::Confirmed), of(|stop| *stop == StopState::Home));
    let confirmed =
        |count, what| (count > 0).then(|| format!("{} confirmed {what}", counted(count, "robot")));
    let all: Vec<_> = [confirmed(stopped, "the stop"), confirmed(home, "the default state")]
        .into_iter()
        .flatten()
        .collect();
    (!all.is_empty()).then(|| all.join(", "))
}

/// Maximum number of robot ids in one warning.
const NAMED_MAX: usize = 3;

/// Returns the warnings of a preflight. Each warning is listed once, with the robots that it concerns.
#[must_use]
pub fn preflight_warnings(preflight: &Preflight) -> Vec<String> {
    let mut warnings: Vec<(String, Vec<&RobotId>)> = Vec::new();
    for row in &preflight.rows {
        for (check, verdict) in &row.checks {
            let Verdict::Warning(why) = verdict else { continue };
            let title = check.title();
            let why = if why.contains(title) { why.clone() } else { format!("{title}: {why}") };
            match warnings.iter_mut().find(|(known, _)| *known == why) {
                Some((_, robots)) => robots.push(&row.robot),
                None => warnings.push((why, vec![&row.robot])),
            }
        }
    }
    let named = |(why, robots): (String, Vec<&RobotId>)| {
        let names: Vec<_> = robots.iter().take(NAMED_MAX).map(|robot| format!("`{robot}`")).collect();
        let more = match robots.len() - names.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        format!("warning: {}{more}: {why}", names.join(", "))
    };
    warnings.into_iter().map(named).collect()
}

/// Formats a duration with two significant digits: in milliseconds, or in seconds from one second up.
pub fn rounded(span: Span) -> String {
    let millis = span.as_millis_f64();
    let (value, unit) = if millis.abs() < 1_000.0 { (millis, "ms") } else { (millis / 1_000.0, "s") };
    let digits = match value.abs() {
        at_least_ten if at_least_ten >= 9.95 => 0,
        at_least_one if at_least_one >= 0.995 => 1,
        at_least_a_tenth if at_least_a_tenth >= 0.0995 => 2,
        _ => 3,
    };
    format!("{value:.digits$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_from_ten_microseconds_up_have_two_significant_digits() {
        for (nanos, expected) in [
            (0, "0.000 ms"),
            (4_321, "0.004 ms"),
            (76_297, "0.076 ms"),
            (996_000, "1.0 ms"),
            (1_129_000, "1.1 ms"),
            (29_430_000, "29 ms"),
            (386_381_000, "386 ms"),
            (4_250_000_000, "4.2 s"),
            (-1_129_000, "-1.1 ms"),
        ] {
            assert_eq!(rounded(Span::from_nanos(nanos)), expected);
        }
    }
}
