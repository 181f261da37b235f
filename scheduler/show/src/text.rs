//! Formats reports and plans as tables for people.

use std::collections::{BTreeMap, BTreeSet};

use anstyle::{AnsiColor, Style};
use downbeat_scripts::shown::shown;
use downbeat_scripts::{Act, Choreography, Plan, Repetition, RobotPlan, counted};
use urrcp::{DeviceId, Latency, RobotId, Span};

use super::local::{date_and_time, time_as_of, time_of_day};
use super::reading::reading_text;
use super::table::{Rows, wrapped};
use super::{brief, course_lines, requirements_table};
use downbeat_mission::report::{ActReport, HostWakeUp, Outcome, Report, RobotReport, StopState};
use downbeat_mission::{
    AfterFailure, Check, Failure, FailureKind, Greeting, MotionReport, MotionSpread, NOT_STRICT, Preflight,
    PreflightRow, SkewBudget, TransferReport, Verdict,
};

/// Style of failures. It is removed if the output is not a terminal.
const RED: Style = AnsiColor::Red.on_default().bold();

/// Text for a robot that was not stopped, because another mission drives it and it holds no commands of this mission.
pub const TAKEN_OVER: &str =
    "not stopped: another mission now drives it, and no commands of this mission are left on it";

/// Maximum number of device ids in one line.
const DEVICES_NAMED_MAX: usize = 6;

/// How much of a report to print.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// A few lines, and the robots that did not execute everything that was planned.
    Brief,
    /// A row per robot and act, and the figures of clocks, leases and scripts.
    Full,
}

/// The number of columns that stands for unlimited width, for files and pipes.
pub const UNBOUNDED: usize = usize::MAX;

/// Appends a sentence that begins on a new line. Escapes it, because parts of it may come from outside, for example from a robot.
fn say(text: &mut String, columns: usize, sentence: &str) {
    text.push_str(&wrapped(&shown(sentence), columns));
}

fn or_dash<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| value.to_string())
}

fn signed(span: Span) -> String {
    if span >= Span::ZERO { format!("+{span}") } else { span.to_string() }
}

/// Formats an act in at most `columns` columns: its cues with their times, and a row per device.
#[must_use]
pub fn plan_table(act: &Act, columns: usize) -> String {
    let cues = cue_table(act);
    let header = ["robot", "device", "scripts", "steps", "at least", "budget", "worst error", "at"];
    let mut rows = Rows::new(&header, 2);
    for device in &act.devices {
        rows.add([
            device.robot.to_string(),
            device.device.to_string(),
            device.scripts.to_string(),
            device.steps.to_string(),
            device.at_least.to_string(),
            device.budget.to_string(),
            format!("{:.4}", device.worst_error),
            device.worst_at.to_string(),
        ]);
    }
    let (cues, rows) = (cues.text(columns), rows.text(columns) + &unlimited_line(act));
    let closest = act.in_space.closest.as_ref().map_or_else(String::new, |closest| {
        let [a, b] = &closest.robots;
        format!("closest approach: `{a}` and `{b}`, {:.3} m at {}\n", closest.distance, closest.at)
    });
    let latencies = latencies_table(act, columns);
    format!("{}\n{cues}\n{rows}\n{closest}{latencies}", act_line(act))
}

/// Returns a table with the times of each cue. If any cue is repeated, it also contains the length of each repetition.
fn cue_table(act: &Act) -> Rows {
    let is_repeated = act.cues.iter().any(|cue| cue.repetition.is_some());
    let is_noted = act.cues.iter().any(|cue| cue.text.note.is_some());
    let titles = [("cue", true), ("note", is_noted), ("start", true), ("end", true), ("slack", true)];
    let titles = titles.into_iter().chain([("repeated", is_repeated)]).filter(|(_, is_shown)| *is_shown);
    let titles: Vec<_> = titles.map(|(title, _)| title).collect();
    let mut rows = Rows::new(&titles, if is_noted { 2 } else { 1 });
    for cue in &act.cues {
        let note = is_noted.then(|| cue.text.note.clone().unwrap_or_default());
        let times = [cue.start, cue.end, cue.slack].map(|time| time.to_string());
        let repeated = is_repeated.then(|| cue.repetition.map_or_else(|| "-".to_owned(), repetition_text));
        let first = [cue.name.clone()].into_iter().chain(note);
        rows.add(first.chain(times).chain(repeated));
    }
    rows
}

fn repetition_text(Repetition { times, length, every }: Repetition) -> String {
    let apart = if every == length { String::new() } else { format!(", every {every}") };
    format!("{times} x {length}{apart}")
}

/// Returns a line that names the devices whose speed is not checked because no limit is known.
fn unlimited_line(act: &Act) -> String {
    let all = || act.devices.iter().filter(|used| used.is_unlimited);
    let devices: BTreeSet<&str> = all().map(|used| used.device.as_str()).collect();
    let robots: BTreeSet<&str> = all().map(|used| used.robot.as_str()).collect();
    if devices.is_empty() {
        return String::new();
    }
    let names: Vec<_> =
        devices.iter().take(DEVICES_NAMED_MAX).map(|name| format!("`{}`", shown(name))).collect();
    let more = match devices.len() - names.len() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let (names, robots) = (names.join(", "), counted(robots.len(), "robot"));
    format!(
        "speeds are not checked for {names}{more} of {robots}: their limits are unknown; add `limits` to the fleet file\n"
    )
}

/// Returns a line with the name and the size of an act.
pub(super) fn act_line(act: &Act) -> String {
    let lead_in = match act.lead_in {
        Span::ZERO => String::new(),
        lead_in => format!(", first commands sent {lead_in} before the motions"),
    };
    format!("{}: {}{lead_in}", shown(&act.plan.scenario), plan_figures(act))
}

/// Returns a table of the latencies that are compensated, with the source of each.
fn latencies_table(act: &Act, columns: usize) -> String {
    let mut rows = Rows::new(&["robot", "device", "latency", "spread", "from"], 2);
    for (robot, devices) in &act.latencies {
        for (device, known) in devices {
            let Latency { median, spread } = known.latency;
            let (median, spread) = (median.to_string(), format!("±{spread}"));
            rows.add([robot.to_string(), device.to_string(), median, spread, known.from.to_string()]);
        }
    }
    if act.latencies.is_empty() { String::new() } else { rows.text(columns) }
}

/// Returns a sentence with the number of devices whose latency is compensated. Returns `None` if there are none.
#[must_use]
pub fn latencies_text(choreography: &Choreography) -> Option<String> {
    let known = choreography.acts.iter().flat_map(|act| &act.latencies);
    let known: BTreeMap<_, _> = known
        .flat_map(|(robot, devices)| devices.iter().map(move |(device, of)| ((robot, device), of)))
        .collect();
    let largest = known.values().map(|of| of.latency.median).max()?;
    let mut from: Vec<_> = known.values().map(|of| of.from).collect();
    from.sort_unstable();
    let counts = from.chunk_by(|a, b| a == b).map(|same| format!("{} from the {}", same.len(), same[0]));
    let counts: Vec<_> = counts.collect();
    Some(format!(
        "latency compensated for {}, up to {largest} ({})",
        counted(known.len(), "device"),
        counts.join(", ")
    ))
}

/// Returns the total duration of the acts on the main line, which begins with the first act and follows the key `next` of each act.
#[must_use]
pub fn main_duration(choreography: &Choreography) -> Span {
    let acts = choreography.main_line().into_iter().map(|act| choreography.acts[act].duration());
    acts.fold(Span::ZERO, |sum, duration| sum + duration)
}

/// Returns the size of a choreography in one line, for example its numbers of robots and steps.
#[must_use]
pub fn choreography_figures(choreography: &Choreography) -> String {
    if let [act] = choreography.acts.as_slice() {
        return plan_figures(act);
    }
    let plans = || choreography.acts.iter().map(|act| &act.plan);
    let robots: std::collections::BTreeSet<_> =
        plans().flat_map(|plan| &plan.robots).map(|robot| robot.robot.as_str()).collect();
    let steps: usize = plans().map(steps_of).sum();
    format!(
        "{}, {}, {}, {} on the main line",
        counted(choreography.acts.len(), "act"),
        counted(robots.len(), "robot"),
        counted(steps, "step"),
        main_duration(choreography)
    )
}

fn steps_of(plan: &Plan) -> usize {
    let scripts = plan.robots.iter().flat_map(|robot| &robot.scripts);
    scripts.map(|script| script.script.steps().len()).sum()
}

/// Returns the size of an act's plan in one line, for example its numbers of robots and steps.
#[must_use]
fn plan_figures(act: &Act) -> String {
    let plan = &act.plan;
    let devices = |robot: &RobotPlan| {
        let mut devices: Vec<_> = robot.scripts.iter().map(|script| &script.device).collect();
        devices.dedup();
        devices.len()
    };
    format!(
        "{}, {}, {}, {}",
        counted(plan.robots.len(), "robot"),
        counted(plan.robots.iter().map(devices).sum(), "device"),
        counted(steps_of(plan), "step"),
        act.duration()
    )
}

/// Whether the readings, problems and predictions of a preflight follow its tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PreflightDetails {
    /// The details follow the tables.
    Shown,
    /// Only the tables are shown.
    Hidden,
}

/// Returns the preflight checks as tables with a row per robot and a column per check, and the details if they are requested.
#[must_use]
pub fn preflight_table(preflight: &Preflight, details: PreflightDetails, columns: usize) -> String {
    // Each of the two tables contains half of the checks, so that a row fits a terminal of 80 columns.
    let (who, how) = Check::ALL.split_at(Check::ALL.len().div_ceil(2));
    let tables = [who, how].map(|checks| checks_table(preflight, checks, columns));
    let mut text = tables.join("\n");
    let shows_details = details == PreflightDetails::Shown;
    if shows_details {
        text.push_str(&readings_table(preflight, columns));
        let wrong = preflight.rows.iter().flat_map(wrong_lines);
        wrong.for_each(|line| say(&mut text, columns, &line));
        // If only the clocks contribute to the prediction, the table already contains it.
        if let Some(skew) = preflight.skew.as_ref().filter(|skew| skew.predicted != skew.clocks) {
            say(&mut text, columns, &budget_text(skew));
        }
    }
    for after in preflight.after_failures.iter().filter(|_| shows_details) {
        say(&mut text, columns, &after_failure_text(after));
    }
    if preflight.greeting == Greeting::Skip {
        let asks = "with `handshake: skip`, the identities of the robots are not checked; `downbeat fleet ping` checks them";
        say(&mut text, columns, asks);
    }
    text
}

fn after_failure_text(after: &AfterFailure) -> String {
    let acts: Vec<_> = after.acts.iter().map(|act| format!("`{act}`")).collect();
    let home = after.home.then(|| "move to their default positions".to_owned());
    let then = after.then.as_ref().map(|then| {
        if after.home {
            format!("play `{then}`")
        } else {
            format!("move to the first positions of `{then}` and play it")
        }
    });
    let moves: Vec<_> = home.into_iter().chain(then).collect();
    format!("after a failure in {}, robots may {}", acts.join(", "), moves.join(", and then "))
}

fn checks_table(preflight: &Preflight, checks: &[Check], columns: usize) -> String {
    let titles: Vec<_> = std::iter::once("robot").chain(checks.iter().map(|check| check.title())).collect();
    let mut rows = Rows::new(&titles, 1);
    for row in &preflight.rows {
        let verdicts = row.checks.iter().filter(|(check, _)| checks.contains(check));
        let cells = verdicts.map(|(_, verdict)| match verdict {
            Verdict::Pass(seen) => seen.clone(),
            Verdict::Warning(_) => "warning".to_owned(),
            Verdict::Failure(_) => "FAILURE".to_owned(),
            Verdict::NotChecked => "-".to_owned(),
        });
        rows.add(std::iter::once(row.robot.to_string()).chain(cells));
    }
    rows.text(columns).replace("FAILURE", &format!("{RED}FAILURE{RED:#}"))
}

fn wrong_lines(row: &PreflightRow) -> Vec<String> {
    let wrong = row.checks.iter().filter_map(|(check, verdict)| match verdict {
        // The reason may already start with the title of the check.
        Verdict::Warning(why) | Verdict::Failure(why) if why.starts_with(check.title()) => {
            Some(format!("{}: {why}", row.robot))
        }
        Verdict::Warning(why) | Verdict::Failure(why) => {
            Some(format!("{} {}: {why}", row.robot, check.title()))
        }
        Verdict::Pass(_) | Verdict::NotChecked => None,
    });
    wrong.collect()
}

/// Returns a table of sensor readings and device positions, one row each.
fn readings_table(preflight: &Preflight, columns: usize) -> String {
    let mut rows = Rows::new(&["robot", "device", "reads", "expected"], 2);
    for row in &preflight.rows {
        for reading in &row.readings {
            let unit = reading.unit.as_ref().map(|unit| format!(" {unit}")).unwrap_or_default();
            let read = match (reading.reading, &reading.why) {
                (Some(value), _) => format!("{}{unit}", reading_text(value)),
                (None, Some(why)) => format!("nothing: {why}"),
                (None, None) => "nothing".to_owned(),
            };
            let expected = reading.expected.as_ref().map(|expected| format!("{expected}{unit}"));
            rows.add([row.robot.to_string(), reading.device.to_string(), read, or_dash(expected)]);
        }
    }
    if rows.is_empty() { String::new() } else { format!("\n{}\n", rows.text(columns)) }
}

/// Returns sentences for people that state how a mission ended and why.
#[must_use]
pub fn ending_text(report: &Report, columns: usize) -> String {
    let mut text = String::new();
    say(&mut text, columns, &format!("{}: {}", report.scenario, outcome_text(&report.outcome)));
    if let Some(because) = &report.because {
        say(&mut text, columns, &format!("  {because}"));
    }
    let stayed = "the robots stayed where they came to rest";
    let home = report.home.as_ref().and_then(|home| transfer_sentence(home, "default", stayed));
    let approach = report.approach.as_ref();
    let stayed = "the act after the failure was not played";
    let approach = approach.and_then(|approach| transfer_sentence(approach, "first", stayed));
    for sentence in home.into_iter().chain(approach) {
        say(&mut text, columns, &format!("  {sentence}"));
    }
    text
}

/// Returns a sentence about a transfer, an act that moves devices to given positions after a stop. The sentence contains only facts that
/// the list of acts does not contain. Returns `None` if there are none.
fn transfer_sentence(transfer: &TransferReport, position: &str, stayed: &str) -> Option<String> {
    match transfer {
        TransferReport::Planned { without, .. } if without.is_empty() => None,
        TransferReport::Planned { act, without } => {
            let stayed: Vec<_> = without.iter().map(|robot| format!("`{robot}`")).collect();
            Some(format!("robots that did not take part in `{act}`: {}", stayed.join(", ")))
        }
        TransferReport::NothingToMove => {
            Some(format!("all devices were already in their {position} positions"))
        }
        TransferReport::NotPlanned { reason } => Some(format!("{stayed}: {reason}")),
    }
}

/// Formats the report for people in at most `columns` columns: the outcome, the failures, and the important figures.
#[must_use]
pub fn report_text(report: &Report, detail: Detail, columns: usize) -> String {
    let mut text = ending_text(report, columns);
    if let Some(acts_max) = report.acts_max_reached {
        let acts = counted(acts_max as usize, "act");
        let sentence =
            format!("  ended because the limit of {acts} was reached; another act would have followed");
        say(&mut text, columns, &sentence);
    }
    let alone = matches!(report.outcome, Outcome::Ready | Outcome::NotReady);
    if let Some(preflight) = report.preflight.as_ref().filter(|_| alone) {
        text.push_str(&preflight_table(preflight, PreflightDetails::Shown, columns));
        let wake_up = report.wake_up.iter().flat_map(HostWakeUp::sentences);
        wake_up.for_each(|sentence| say(&mut text, columns, &sentence));
        return text;
    }
    for line in course_lines(report) {
        say(&mut text, columns, &format!("  {line}"));
    }
    for failure in &report.failures {
        say(&mut text, columns, &format!("  {}: {}", failure.robot, failure.kind));
    }
    for robot in report.robots.iter().filter(|robot| robot.failures_omitted > 0) {
        say(&mut text, columns, &format!("  {}: {} more failures", robot.robot, robot.failures_omitted));
    }
    let sentences = match detail {
        Detail::Brief => {
            if report.robots.iter().any(|robot| brief::deviates(&robot)) && !report.acts.is_empty() {
                text.push_str(&robots_table(report.robots.iter().filter(brief::deviates), report, columns));
            }
            brief::sentences(report).into_iter().chain(remarks(report)).collect()
        }
        Detail::Full => {
            if report.acts.len() > 1 {
                text.push_str(&acts_table(report, columns));
            }
            if !report.acts.is_empty() {
                text.push_str(&robots_table(report.robots.iter(), report, columns));
            }
            full_sentences(report)
        }
    };
    sentences.iter().for_each(|sentence| say(&mut text, columns, sentence));
    text.push_str(&requirements_table(&report.requirements, columns));
    text
}

/// Returns the outcome as text, with local times.
fn outcome_text(outcome: &Outcome) -> String {
    match outcome {
        Outcome::StartTooSoon { start, safe_start } => format!(
            "not sent: the start at {} has passed or is too soon; the earliest safe start was {}",
            date_and_time(*start),
            time_as_of(*safe_start, *start)
        ),
        Outcome::LeadTooShort { lead, needed, safe_start } => format!(
            "not sent: the lead of {lead} is too short, because this fleet needs {} ({} to prepare, {} lease, {} margin); \
             the earliest safe start was {}",
            needed.total(),
            needed.prepare,
            needed.lease,
            needed.margin,
            date_and_time(*safe_start)
        ),
        other => other.to_string(),
    }
}

fn acts_table(report: &Report, columns: usize) -> String {
    let header = ["act", "start", "gap", "lead", "predicted spread", "spread", "margin left", "window"];
    let mut rows = Rows::new(&header, 2);
    let first = report.acts.first().map(|act| act.start);
    for act in &report.acts {
        rows.add([
            act.act.clone(),
            time_as_of(act.start, first.unwrap_or(act.start)),
            or_dash(act.gap),
            act.lead.total().to_string(),
            or_dash(act.skew.as_ref().map(|skew| skew.predicted)),
            or_dash(act.spread),
            or_dash(act.margin_left),
            or_dash(act.window),
        ]);
    }
    rows.text(columns)
}

fn prepared_again(act: &ActReport) -> Option<String> {
    let times = (act.prepared_again > 0).then(|| counted(act.prepared_again as usize, "time"))?;
    Some(format!("withdrawn {times} before anything moved, and prepared again: this machine was too slow"))
}

fn budget_text(skew: &SkewBudget) -> String {
    let parts = skew.parts();
    format!("predicted start spread at most {}, {} allowed{parts}", skew.predicted, skew.tolerance)
}

fn act_sentences(act: &ActReport) -> Vec<String> {
    let lead = act.lead;
    let mut sentences = vec![format!(
        "planned start {}, {} after sending ({} to prepare, {} lease, {} margin)",
        date_and_time(act.start),
        lead.total(),
        lead.prepare,
        lead.lease,
        lead.margin
    )];
    if let Some(skew) = &act.skew {
        sentences.push(budget_text(skew));
    }
    if let (Some(margin), Some(window)) = (act.margin_left, act.window) {
        sentences.push(format!(
            "the last robot accepted {margin} before the decision; all robots confirmed the start within {window}"
        ));
    }
    sentences
}

fn robots_table<'a>(
    robots: impl Iterator<Item = &'a RobotReport>,
    report: &Report,
    columns: usize,
) -> String {
    let header = ["robot", "accepted", "scripts started", "start error", "steps", "clock offset", "known to"];
    let mut rows = Rows::new(&header, 1);
    for robot in robots {
        rows.add([
            robot.robot.to_string(),
            if robot.accepted { "yes" } else { "no" }.to_owned(),
            format!("{}/{}{}", robot.started, robot.scripts, claimed(report, robot)),
            or_dash(robot.start_error.map(signed)),
            steps(robot),
            or_dash(robot.clock.map(|clock| signed(clock.offset))),
            or_dash(robot.clock.map(|clock| format!("+-{}", clock.uncertainty))),
        ]);
    }
    rows.text(columns)
}

/// Returns the numbers of executed and planned steps. A `+` means "at least": the results of some scripts are unknown.
fn steps(robot: &RobotReport) -> String {
    let at_least = if robot.unaccounted > 0 { "+" } else { "" };
    format!("{}{at_least}/{}", robot.steps_done, robot.steps_planned)
}

/// Returns the suffix for the robot's number of starts: `claimed` if the number relies on a claim that cannot be true, otherwise an
/// empty text.
fn claimed(report: &Report, robot: &RobotReport) -> &'static str {
    let doubted =
        |failure: &Failure| failure.robot == robot.robot && matches!(failure.kind, FailureKind::Claim { .. });
    if robot.started > 0 && report.failures.iter().any(doubted) { " claimed" } else { "" }
}

/// The report mentions that the last steps of scripts drift apart only if their spread exceeds the spread of the starts by more than
/// this.
const NOTABLE_DRIFT: Span = Span::from_millis(1);

fn full_sentences(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    if let [act] = report.acts.as_slice() {
        sentences.extend(act_sentences(act));
    }
    sentences.extend(start_sentence(report));
    sentences.extend(remarks(report));
    let apart = report.true_end_spread.filter(|ends| Some(*ends - NOTABLE_DRIFT) > report.true_spread);
    sentences.extend(apart.map(|ends| {
        format!("the last steps of the scripts are {ends} apart by the clock of the virtual world, because the robots' clocks drift")
    }));
    sentences.extend(late_steps(report));
    sentences.extend(report.robots.iter().filter(|robot| !robot.stop.is_unconfirmed()).filter_map(stop_text));
    sentences
}

fn start_sentence(report: &Report) -> Option<String> {
    let reported: Vec<_> = report.robots.iter().filter(|robot| robot.start_error.is_some()).collect();
    match (report.spread, reported.as_slice()) {
        (_, [alone]) if report.robots.len() > 1 => {
            Some(format!("only {} reported when it started", alone.robot))
        }
        (Some(spread), reported) => Some(format!(
            "start spread {spread} across {}, by the robots' own clocks, with the uncertainties shown above",
            counted(reported.len(), "robot")
        )),
        (None, _) if report.acts.is_empty() || disbelieved(report).next().is_some() => None,
        (None, _) => Some("no robot reported that it started".to_owned()),
    }
}

/// Returns the robots that claim to have started, but whose claims cannot be true.
fn disbelieved(report: &Report) -> impl Iterator<Item = &RobotReport> {
    report.robots.iter().filter(|robot| report.spread.is_none() && !claimed(report, robot).is_empty())
}

/// Returns sentences about facts that deserve attention in every report.
fn remarks(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    sentences.extend(
        report.acts.iter().filter_map(|act| Some(format!("{}{}", of_act(report, act), prepared_again(act)?))),
    );
    sentences.extend(
        disbelieved(report).map(|robot| format!("{}: its reported start time is impossible", robot.robot)),
    );
    sentences.extend(report.robots.iter().filter_map(|robot| {
        let differs = robot.latency_differs.as_ref()?;
        Some(format!("{}: {differs}", robot.robot))
    }));
    let loose = |robot: &&RobotReport| robot.pending_until == Some(false);
    sentences
        .extend(report.robots.iter().filter(loose).map(|robot| format!("{}: {NOT_STRICT}", robot.robot)));
    sentences.extend(report.acts.iter().flat_map(|act| motions(act, of_act(report, act))));
    if let Some(spread) = report.true_spread {
        sentences.push(format!("true start spread {spread}, by the clock of the virtual world"));
    }
    sentences.extend(report.robots.iter().filter_map(unaccounted));
    sentences.extend(report.robots.iter().filter(|robot| robot.stop.is_unconfirmed()).filter_map(stop_text));
    if report.journal_written_again > 0 {
        let times = counted(usize::try_from(report.journal_written_again).unwrap_or(usize::MAX), "time");
        sentences.push(format!("the journal was removed or replaced, and was restored {times}"));
    }
    if let Some(failure) = report.recording.as_ref().and_then(|recording| recording.failure.as_ref()) {
        sentences.push(format!("the recording is incomplete: {failure}"));
    }
    sentences
}

/// Returns the name of the act as a prefix of a sentence. Returns an empty text if the report has only one act.
fn of_act(report: &Report, act: &ActReport) -> String {
    if report.acts.len() > 1 { format!("act `{}`: ", act.act) } else { String::new() }
}

/// Returns sentences that state when devices started moving, according to their sensors.
fn motions(act: &ActReport, of_act: String) -> Vec<String> {
    let mut sentences = Vec::new();
    for motion in &act.motions {
        let MotionReport { robot, device, error, uncertainty, unclear, .. } = motion;
        let when = match (error, uncertainty, unclear) {
            (Some(error), Some(uncertainty), _) => {
                format!("{} ±{uncertainty} relative to the plan", signed(*error))
            }
            (.., Some(unclear)) => format!("at an unknown time: {unclear}"),
            _ => "at an unknown time".to_owned(),
        };
        sentences.push(format!("{of_act}`{device}` of {robot} began to move {when}"));
    }
    sentences.extend(act.motion_spread.map(|MotionSpread { spread, uncertainty, motions }| {
        format!(
            "{of_act}motion spread {spread} ±{uncertainty} across {motions} motions, according to the sensors"
        )
    }));
    sentences
}

/// Maximum number of devices with late steps to list. Further ones are only counted.
const LATE_LISTED_MAX: usize = 10;

/// Returns sentences about the devices with late steps, those with the latest steps first.
fn late_steps(report: &Report) -> Vec<String> {
    let mut devices: BTreeMap<_, (u32, Option<Span>)> = BTreeMap::new();
    for robot in report.acts.iter().flat_map(|act| &act.robots) {
        for script in robot.devices.iter().filter(|script| script.late_steps > 0) {
            let (count, max) = devices.entry((&robot.robot, &script.device)).or_default();
            *count = count.saturating_add(script.late_steps);
            *max = script.late_max.max(*max);
        }
    }
    let mut devices: Vec<_> = devices.into_iter().collect();
    devices.sort_by_key(|(_, late)| std::cmp::Reverse(late.1));
    let omitted = devices.len().saturating_sub(LATE_LISTED_MAX);
    devices.truncate(LATE_LISTED_MAX);
    let line = |((robot, device), (count, max)): ((&RobotId, &DeviceId), (u32, Option<Span>))| {
        let worst = max.map_or_else(String::new, |max| format!(", by at most {max}"));
        format!("{robot}: {} of `{device}` more than 1 ms late{worst}", counted(count as usize, "step"))
    };
    let mut lines: Vec<_> = devices.into_iter().map(line).collect();
    if omitted > 0 {
        lines.push(format!("{} with late steps", counted(omitted, "more device")));
    }
    lines
}

fn unaccounted(robot: &RobotReport) -> Option<String> {
    let scripts = counted(robot.unaccounted, "script");
    (robot.unaccounted > 0).then(|| format!("{}: the results of {scripts} are unknown", robot.robot))
}

fn stop_text(robot: &RobotReport) -> Option<String> {
    let rest = match robot.stop {
        StopState::NotSent => return None,
        StopState::Confirmed => "stop confirmed".to_owned(),
        StopState::Home => "default state confirmed".to_owned(),
        StopState::TakenOver => TAKEN_OVER.to_owned(),
        StopState::Unconfirmed { lease_ends: Some(at) } => {
            format!("stop NOT confirmed; its lease ends at {}", time_of_day(at))
        }
        StopState::Unconfirmed { lease_ends: None } => {
            "stop NOT confirmed; it has no lease, so it will not stop by itself".to_owned()
        }
    };
    Some(format!("{}: {rest}", robot.robot))
}
