//! Formats the results of trials for people.

use downbeat_scripts::counted;
use downbeat_scripts::shown::within;

use downbeat_rehearsal::trials::{Quantiles, Results, Share};

use super::{requirements_table, table::Rows};

/// Maximum number of reasons, and of robots, to list. JSON contains all of them.
const LISTED_MAX: usize = 12;
/// Maximum width of an explanation in columns.
const TEXT_MAX: usize = 60;

/// Formats the results of trials in lines of about `columns` columns.
#[must_use]
pub fn trials_text(results: &Results, columns: usize) -> String {
    let mut text = format!(
        "{} in {}, seed {}: {}\n\n",
        counted(results.trials, "trial"),
        match results.world.as_str() {
            "" => "the world of the fleet file".to_owned(),
            world => format!("the world `{}`", within(world, 40)),
        },
        results.seed,
        within(&results.scenario, 40),
    );
    let mut shares = Rows::new(&["", "missions", "share", "95 % interval"], 1);
    for (what, share) in [
        ("start", &results.starts),
        ("finish as planned", &results.finishes),
        ("abort", &results.aborts),
        ("some robots start, others do not", &results.mixed),
    ] {
        shares.add([what.to_owned(), share.count.to_string(), percent(share), interval(share)]);
    }
    text += &shares.text(columns);
    text += "\n";
    let mut acts = Rows::new(&["act", "starts", "spread p50", "p99", "max", "tolerance", "beyond"], 1);
    for act in &results.acts {
        let [p50, p99, max] = cells(act.spread);
        let (starts, beyond) = (percent(&act.starts), percent(&act.beyond_tolerance));
        acts.add([act.act.clone(), starts, p50, p99, max, act.tolerance.to_string(), beyond]);
    }
    if acts.is_empty() {
        text += "no act was sent in any trial\n";
    }
    if !acts.is_empty() {
        text += &acts.text(columns);
    }
    if let Some(lead) = &results.lead {
        text += &format!(
            "\nlead: {} used; {} would have sufficed for 99 % of the decided acts, and {} for all of them",
            lead.had.p50, lead.enough.p99, lead.enough.max
        );
        if lead.undecided > 0 {
            text += &format!("; {} sent but not decided", counted(lead.undecided, "act"));
        }
        text += "\n";
    }
    text += &reasons(results, columns);
    text += &robots(results, columns);
    if !results.requirements.is_empty() {
        text += "\n";
    }
    text + &requirements_table(&results.requirements, columns)
}

fn reasons(results: &Results, columns: usize) -> String {
    if results.reasons.is_empty() {
        return String::new();
    }
    let mut rows = Rows::new(&["why", "robot", "trial", "missions", "share"], 2);
    for reason in results.reasons.iter().take(LISTED_MAX) {
        let robot = reason.robot.as_ref().map(ToString::to_string).unwrap_or_default();
        let why = within(&reason.text, TEXT_MAX).into_owned();
        let count = reason.share.count.to_string();
        rows.add([why, robot, reason.example.to_string(), count, percent(&reason.share)]);
    }
    format!("\n{}{}", rows.text(columns), more(results.reasons.len(), "reason"))
}

fn robots(results: &Results, columns: usize) -> String {
    let mut rows = Rows::new(&["robot", "fails first", "accepts p50", "p99", "max", "last", "reconnects"], 1);
    for robot in results.robots.iter().take(LISTED_MAX) {
        let [p50, p99, max] = cells(robot.accepts_within);
        let last = percent(&robot.accepts_last);
        let fails = robot.fails_first.count.to_string();
        rows.add([robot.robot.to_string(), fails, p50, p99, max, last, percent(&robot.reconnects)]);
    }
    let mut text = format!("\n{}{}", rows.text(columns), more(results.robots.len(), "robot"));
    if let Some(robot) = &results.weakest_robot {
        text += &format!("weakest robot: {robot}\n");
    }
    if let Some(robot) = &results.weakest_link {
        text += &format!("weakest link: {robot}\n");
    }
    text
}

fn more(count: usize, thing: &str) -> String {
    match count.saturating_sub(LISTED_MAX) {
        0 => String::new(),
        more => format!("and {}; --format json lists all of them\n", counted(more, &format!("more {thing}"))),
    }
}

fn cells(quantiles: Option<Quantiles>) -> [String; 3] {
    match quantiles {
        Some(Quantiles { p50, p99, max, .. }) => [p50, p99, max].map(|span| span.to_string()),
        None => [const { String::new() }; 3],
    }
}

fn percent(share: &Share) -> String {
    share.share.map_or_else(|| "none".to_owned(), |share| format!("{} %", hundredths(share)))
}

fn interval(share: &Share) -> String {
    format!("{} to {} %", hundredths(share.least), hundredths(share.largest))
}

/// Converts a share from 0 to 1 to per cent, rounded to a hundredth.
fn hundredths(share: f64) -> f64 {
    (share * 10_000.0).round() / 100.0
}
