//! Formats the result of every act of the scenario as lines for people.

use downbeat_scripts::counted;

use downbeat_mission::report::{ActCourse, ActFate, Report};

/// Maximum number of acts to list in full. If there are more, acts that were played exactly once are only counted.
const LISTED_MAX: usize = 20;

/// Returns one line per act. Returns no lines if the scenario has only one act, because the rest of the report covers it.
#[must_use]
pub fn course_lines(report: &Report) -> Vec<String> {
    if report.course.len() < 2 {
        return Vec::new();
    }
    let usual = |act: &&ActCourse| act.fate == ActFate::Played && act.played == 1;
    let brief = report.course.len() > LISTED_MAX;
    let listed = report.course.iter().filter(|act| !(brief && usual(act)));
    let mut lines: Vec<String> = listed.map(line).collect();
    if brief {
        let played = report.course.iter().filter(usual).count();
        lines.insert(0, format!("{} of {} were played once", played, counted(report.course.len(), "act")));
    }
    lines
}

fn line(act: &ActCourse) -> String {
    match (act.played, &act.fate) {
        (0 | 1, ActFate::Played) | (0, _) => format!("act `{}`: {}", act.act, act.fate),
        (times, ActFate::Played) => format!("act `{}`: played {times} times", act.act),
        (times, fate) => {
            format!("act `{}`: played {}, then {fate}", act.act, counted(times as usize, "time"))
        }
    }
}
