//! Formats differences as text for people.

use downbeat_mission::report::{DeviceState, Outcome};
use downbeat_scripts::shown::shown;
use downbeat_scripts::{Closest, counted};
use serde_json::Value;
use urrcp::Span;

use super::acts::{ActDifferences, CueDifference, PATH};
use super::runs::{Figure, RunAct, RunRobot, ScriptDifferences};
use super::scripts::DeviceDifferences;
use super::steps::{Largest, ShownStep, StepDifference, StepDifferences};
use super::{Change, PlanDifferences, Presence, RunDifferences};
use downbeat_show::table::{Rows, wrapped};

/// Maximum number of rows per table; further rows are only counted. The JSON output contains all.
const ROWS_MAX: usize = 20;

/// Formats the differences between two plans, in lines of at most `columns` characters.
pub fn plan_text(found: &PlanDifferences, columns: usize) -> String {
    let hash = |hash: urrcp::ContentHash| hash.to_string()[..12].to_owned();
    if found.same {
        return format!("the plans are the same: {}\n", hash(found.hash.a));
    }
    let mut text = Text { lines: String::new(), columns };
    text.say(&format!("the plans differ: {} and {}", hash(found.hash.a), hash(found.hash.b)));
    if let Some(Change { a, b }) = &found.scenario {
        text.say(&format!("scenario: {} → {}", shown(a), shown(b)));
    }
    text.names("robots added", &found.robots_added);
    text.names("robots removed", &found.robots_removed);
    for act in &found.acts {
        text.act(act);
    }
    text.lines
}

/// Formats the differences between two missions, in lines of at most `columns` characters.
pub fn run_text(found: &RunDifferences, columns: usize) -> String {
    if found.same {
        return "the same\n".to_owned();
    }
    let mut text = Text { lines: "the runs differ\n".to_owned(), columns };
    let name = |name: &Option<String>| name.clone().unwrap_or_else(|| "not known".to_owned());
    if let Some(Change { a, b }) = &found.scenario {
        text.say(&format!("scenario: {} → {}", shown(&name(a)), shown(&name(b))));
    }
    if let Some(Change { a, b }) = &found.outcome {
        text.say(&format!("outcome: {} → {}", outcome(a.as_ref()), outcome(b.as_ref())));
    }
    text.names("robots left out only in the first run", &found.dropped_removed);
    text.names("robots left out only in the second run", &found.dropped_added);
    let mut rows = Rows::new(&["failure", "robot", "reason"], usize::MAX);
    let failures = found.failures.removed.iter().map(|failure| ("only in the first", failure));
    let failures = failures.chain(found.failures.added.iter().map(|failure| ("only in the second", failure)));
    text.table(failures, &mut rows, "failure", |(only, failure)| {
        vec![only.to_owned(), failure.robot.clone(), failure.text.clone()]
    });
    for act in &found.acts {
        text.played(act);
    }
    text.lines
}

struct Text {
    lines: String,
    columns: usize,
}

impl Text {
    fn say(&mut self, sentence: &str) {
        self.lines += &wrapped(sentence, self.columns);
    }

    fn names<T: ToString>(&mut self, what: &str, names: &[T]) {
        if names.is_empty() {
            return;
        }
        let listed: Vec<String> =
            names.iter().take(ROWS_MAX).map(|name| shown(&name.to_string()).into_owned()).collect();
        let more = match names.len().saturating_sub(ROWS_MAX) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        self.say(&format!("{what}: {}{more}", listed.join(", ")));
    }

    fn table<T>(
        &mut self,
        items: impl Iterator<Item = T>,
        rows: &mut Rows,
        what: &str,
        row: impl Fn(T) -> Vec<String>,
    ) {
        let mut items = items.fuse();
        items.by_ref().take(ROWS_MAX).for_each(|item| rows.add(row(item)));
        if rows.is_empty() {
            return;
        }
        self.lines += &rows.text(self.columns);
        match items.count() {
            0 => {}
            more => self.say(&format!("  ... and {}", counted(more, &format!("more {what}")))),
        }
    }

    fn act(&mut self, act: &ActDifferences) {
        let title = match act.act.as_str() {
            "" => "the only act".to_owned(),
            name => format!("act {}", shown(name)),
        };
        self.lines += "\n";
        if act.presence != Presence::Changed {
            let cues = counted(act.cues.len(), "cue");
            let devices = counted(act.devices.len(), "device");
            self.say(&format!("{title}: {}, with {cues} and {devices}", word(act.presence)));
            return;
        }
        let moved = act.place.as_ref().map(|Change { a, b }| format!("place {a} → {b}"));
        let lasts = act.duration_ms.as_ref().map(|Change { a, b }| format!("lasts {a} → {b}"));
        let told: Vec<String> = moved.into_iter().chain(lasts).collect();
        match (act.act.is_empty(), told.is_empty()) {
            (true, true) => {}
            (true, false) => self.say(&told.join(", ")),
            (false, true) => self.say(&title),
            (false, false) => self.say(&format!("{title}: {}", told.join(", "))),
        }
        self.names("robots added", &act.robots_added);
        self.names("robots removed", &act.robots_removed);
        for setting in &act.settings {
            let Change { a, b } = &setting.change;
            if setting.setting.starts_with(PATH) {
                self.say(&format!("{}: another one", shown(&setting.setting)));
                continue;
            }
            self.say(&format!("{}: {} → {}", shown(&setting.setting), value(a), value(b)));
        }
        if let Some(Change { a, b }) = &act.closest {
            let verdict = a.as_ref().zip(b.as_ref()).map_or("", |(a, b)| verdict(a.distance, b.distance));
            self.say(&format!(
                "closest approach: {} → {}{verdict}",
                closest(a.as_ref()),
                closest(b.as_ref())
            ));
        }
        for Change { a, b } in &act.bodies {
            let Some(robot) = a.as_ref().or(b.as_ref()).map(|body| &body.robot) else { continue };
            let speed = |body: &Option<downbeat_scripts::BodyUse>| {
                body.as_ref().map_or_else(
                    || "none".to_owned(),
                    |body| format!("{} m/s, {} m/s2", number(body.speed), number(body.acceleration)),
                )
            };
            self.say(&format!("body of {}: at most {} → {}", shown(robot.as_str()), speed(a), speed(b)));
        }
        self.table(
            act.cues.iter(),
            &mut Rows::new(&["cue", "change", "start", "duration", "slack", "critical"], 2),
            "cue",
            cue_row,
        );
        self.table(
            act.devices.iter(),
            &mut Rows::new(&["device", "change", "start", "steps", "added", "removed", "changed"], 2),
            "device",
            device_row,
        );
        let first = act.devices.iter().filter(|device| device.presence == Presence::Changed);
        self.steps(
            first.map(|device| (device.name(), device.unit.as_deref().unwrap_or_default(), &device.steps)),
        );
        for (what, readings) in [("added", &act.readings_added), ("removed", &act.readings_removed)] {
            let names: Vec<String> = readings
                .iter()
                .map(|reading| format!("{}/{} at {}", reading.robot, reading.sensor, reading.at))
                .collect();
            self.names(&format!("readings {what}"), &names);
        }
    }

    /// Adds a table with the first and the largest step difference of each device.
    fn steps<'a>(&mut self, devices: impl Iterator<Item = (String, &'a str, &'a StepDifferences)>) {
        let differing = devices.filter(|(_, _, steps)| steps.first().is_some());
        self.table(
            differing,
            &mut Rows::new(&["device", "first difference", "largest difference"], usize::MAX),
            "device",
            |(name, unit, steps)| {
                vec![
                    name,
                    steps.first().map_or_else(dash, |step| first(step, unit)),
                    steps.largest.as_ref().map_or_else(dash, |largest| self::largest(largest, unit)),
                ]
            },
        );
    }

    fn played(&mut self, act: &RunAct) {
        self.lines += "\n";
        let time = if act.time > 1 { format!(", time {}", act.time) } else { String::new() };
        let title = format!("act {}{time}", shown(&act.act));
        if act.presence != Presence::Changed {
            let only = if act.presence == Presence::Added { "second" } else { "first" };
            self.say(&format!("{title}: only in the {only} run"));
            return;
        }
        self.say(&title);
        if let Some(Change { a, b }) = &act.fate {
            self.say(&format!("{} → {}", shown(a), shown(b)));
        }
        if let Some(spread) = &act.spread_ms {
            self.say(&format!("spread: {}", figure(spread)));
        }
        self.table(
            act.robots.iter(),
            &mut Rows::new(&["robot", "start error", "steps done", "late steps", "other"], 1),
            "robot",
            robot_row,
        );
        self.table(
            act.scripts.iter(),
            &mut Rows::new(&["other script", "change", "start", "steps", "added", "removed", "changed"], 2),
            "script",
            script_row,
        );
        let steps = act.scripts.iter().filter_map(|script| Some((script.name(), script.steps.as_ref()?)));
        self.steps(steps.map(|(name, steps)| (name, "", steps)));
    }
}

impl DeviceDifferences {
    fn name(&self) -> String {
        format!("{}/{}", self.robot, self.device)
    }
}

impl ScriptDifferences {
    fn name(&self) -> String {
        format!("{}/{}", self.robot, self.device)
    }
}

pub(super) const fn word(presence: Presence) -> &'static str {
    match presence {
        Presence::Changed => "changed",
        Presence::Added => "added",
        Presence::Removed => "removed",
    }
}

fn dash() -> String {
    "-".to_owned()
}

pub(super) fn change<T: ToString>(change: Option<&Change<T>>) -> String {
    change.map_or_else(dash, |Change { a, b }| format!("{} → {}", a.to_string(), b.to_string()))
}

fn cue_row(cue: &CueDifference) -> Vec<String> {
    let moved = cue.presence == Presence::Changed && cue.start_ms.is_some();
    let start = match cue.presence {
        Presence::Changed => change(cue.start_ms.as_ref()),
        _ => cue.at_ms.to_string(),
    };
    vec![
        cue.cue.clone(),
        if moved { "moved" } else { word(cue.presence) }.to_owned(),
        start,
        change(cue.duration_ms.as_ref()),
        change(cue.slack_ms.as_ref()),
        cue.critical
            .as_ref()
            .map_or_else(dash, |critical| if critical.b { "now" } else { "no longer" }.to_owned()),
    ]
}

fn device_row(device: &DeviceDifferences) -> Vec<String> {
    let what = match device.presence {
        Presence::Changed => {
            let shifted = device.steps.shifted_by_ms.map(|by| format!("all steps later by {by}"));
            let shifted = shifted.or_else(|| device.divided.then(|| "divided differently".to_owned()));
            let leases = device.leases.as_ref().map(|_| "other leases".to_owned());
            let only_used = device.steps.steps.is_empty() && device.used.is_some();
            let fitted = || only_used.then(|| "different error or budget".to_owned());
            shifted.or(leases).or_else(fitted).unwrap_or_else(|| "changed".to_owned())
        }
        other => word(other).to_owned(),
    };
    let start = change(device.start_ms.as_ref().map(start_text).as_ref());
    [vec![device.name(), what, start], counts(&device.steps)].concat()
}

fn start_text(start: &Change<urrcp::Millis>) -> Change<Span> {
    Change { a: start.a.span(), b: start.b.span() }
}

fn counts(steps: &StepDifferences) -> Vec<String> {
    let [added, removed, changed] =
        [steps.added, steps.removed, steps.changed()].map(|count| count.to_string());
    vec![change(steps.count.as_ref()), added, removed, changed]
}

pub(super) fn script_row(script: &ScriptDifferences) -> Vec<String> {
    let start = script.start_ms.as_ref();
    let start =
        start.map(|start| Change { a: Span::from_millis_f64(start.a), b: Span::from_millis_f64(start.b) });
    let counts =
        script.steps.as_ref().map_or_else(|| vec!["not known".to_owned(), dash(), dash(), dash()], counts);
    [vec![script.name(), word(script.presence).to_owned(), change(start.as_ref())], counts].concat()
}

pub(super) fn robot_row(robot: &RunRobot) -> Vec<String> {
    let mut other = Vec::new();
    if robot.presence != Presence::Changed {
        other.push(word(robot.presence).to_owned());
    }
    if let Some(left_out) = &robot.left_out {
        other.push(if left_out.b { "left out" } else { "no longer left out" }.to_owned());
    }
    for change in &robot.states {
        let Change { a, b } = &change.states;
        other.push(format!("{}: {} → {}", change.device, words(a), words(b)));
    }
    vec![
        robot.robot.clone(),
        robot.start_error_ms.as_ref().map_or_else(dash, figure),
        change(robot.steps_done.as_ref()),
        change(robot.late_steps.as_ref()),
        if other.is_empty() { dash() } else { other.join("; ") },
    ]
}

pub(super) fn figure(figure: &Figure) -> String {
    let shown = |value: Option<f64>| {
        value.map_or_else(|| "not known".to_owned(), |value| Span::from_millis_f64(value).to_string())
    };
    let verdict = match figure.better {
        Some(true) => ", better",
        Some(false) => ", worse",
        None => "",
    };
    format!("{} → {}{verdict}", shown(figure.a), shown(figure.b))
}

fn closest(closest: Option<&Closest>) -> String {
    closest.map_or_else(
        || "not known".to_owned(),
        |Closest { robots: [one, other], at, distance }| {
            let (one, other) = (shown(one.as_str()), shown(other.as_str()));
            format!("{} m at {at} ({one}, {other})", number(*distance))
        },
    )
}

fn verdict(a: f64, b: f64) -> &'static str {
    match a.total_cmp(&b) {
        std::cmp::Ordering::Less => ": better, they stay further apart",
        std::cmp::Ordering::Greater => ": worse, they come closer",
        std::cmp::Ordering::Equal => "",
    }
}

fn step(step: &ShownStep, unit: &str) -> String {
    let values: Vec<String> = step.values.iter().map(|value| number(*value)).collect();
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    format!("{}{unit} at {}", values.join(" "), step.at_ms)
}

fn first(difference: &StepDifference, unit: &str) -> String {
    let shown = |side: Option<&ShownStep>| side.map_or_else(|| "no step".to_owned(), |side| step(side, unit));
    format!("{} → {}", shown(difference.a.as_ref()), shown(difference.b.as_ref()))
}

fn largest(largest: &Largest, unit: &str) -> String {
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let which = if largest.value > 1 { format!(" (value {})", largest.value) } else { String::new() };
    let (a, b) = (number(largest.a), number(largest.b));
    format!("{}{unit} at {}: {a} → {b}{which}", number(largest.difference()), largest.at_ms)
}

/// Formats a number with at most six decimals.
fn number(value: f64) -> String {
    ((value * 1e6).round() / 1e6).to_string()
}

fn value(value: &Value) -> String {
    match value {
        Value::Null => "none".to_owned(),
        Value::String(text) => shown(text).into_owned(),
        other => shown(&other.to_string()).into_owned(),
    }
}

fn words(states: &[DeviceState]) -> String {
    states.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
}

pub(super) fn outcome(outcome: Option<&Outcome>) -> String {
    outcome.map_or_else(|| "not known".to_owned(), |outcome| shown(&outcome.to_string()).into_owned())
}

/// A difference between two plans or missions in words, for a list.
pub(crate) struct Entry {
    /// The act that the difference belongs to, if any.
    pub(crate) act: Option<String>,
    /// Time of the difference from the act's start, if it has a time.
    pub(crate) at: Option<Span>,
    pub(crate) device: Option<(urrcp::RobotId, urrcp::DeviceId)>,
    pub(crate) subject: String,
    pub(crate) text: String,
}

/// Lists all differences between two plans, act by act.
pub(crate) fn entries(found: &PlanDifferences) -> Vec<Entry> {
    let mut all = Vec::new();
    let plain = |subject: &str, text: String| Entry {
        act: None,
        at: None,
        device: None,
        subject: subject.to_owned(),
        text,
    };
    all.extend(found.scenario.as_ref().map(|scenario| plain("scenario", change(Some(scenario)))));
    for (robots, word) in [(&found.robots_added, "added"), (&found.robots_removed, "removed")] {
        all.extend(robots.iter().map(|robot| plain(robot.as_str(), word.to_owned())));
    }
    for act in &found.acts {
        let of_act = |entry: Entry| Entry { act: Some(act.act.clone()), ..entry };
        all.extend(entries_of(act).into_iter().map(of_act));
    }
    all
}

fn entries_of(act: &ActDifferences) -> Vec<Entry> {
    let at_start = |subject: &str, text: String| Entry {
        act: None,
        at: Some(Span::ZERO),
        device: None,
        subject: subject.to_owned(),
        text,
    };
    let name = if act.act.is_empty() { "the only act" } else { &act.act };
    if act.presence != Presence::Changed {
        return vec![at_start(name, word(act.presence).to_owned())];
    }
    let mut all = Vec::new();
    all.extend(act.place.as_ref().map(|place| at_start(name, format!("place {}", change(Some(place))))));
    all.extend(
        act.duration_ms.as_ref().map(|lasts| at_start(name, format!("lasts {}", change(Some(lasts))))),
    );
    for setting in act.settings.iter().filter(|setting| !setting.setting.starts_with(PATH)) {
        let Change { a, b } = &setting.change;
        all.push(at_start(&setting.setting, format!("{} → {}", value(a), value(b))));
    }
    if let Some(Change { a, b }) = &act.closest {
        let verdict = a.as_ref().zip(b.as_ref()).map_or("", |(a, b)| verdict(a.distance, b.distance));
        let text = format!("{} → {}{verdict}", closest(a.as_ref()), closest(b.as_ref()));
        let at = b.as_ref().or(a.as_ref()).map(|closest| closest.at);
        all.push(Entry { at, ..at_start("closest approach", text) });
    }
    let mut timed: Vec<Entry> =
        act.cues.iter().map(cue_entry).chain(act.devices.iter().map(device_entry)).collect();
    timed.sort_by_key(|entry| entry.at);
    all.extend(timed);
    all
}

fn cue_entry(cue: &CueDifference) -> Entry {
    let figure = |name: &str, figure: Option<&Change<Span>>| {
        figure.map(|figure| format!("{name} {}", change(Some(figure))))
    };
    let critical = cue
        .critical
        .as_ref()
        .map(|critical| if critical.b { "now critical" } else { "no longer critical" }.to_owned());
    let figures = [
        (cue.presence != Presence::Changed).then(|| word(cue.presence).to_owned()),
        figure("start", cue.start_ms.as_ref()),
        figure("duration", cue.duration_ms.as_ref()),
        figure("slack", cue.slack_ms.as_ref()),
        critical,
    ];
    let text = figures.into_iter().flatten().collect::<Vec<_>>().join(", ");
    Entry { act: None, at: Some(cue.at_ms), device: None, subject: cue.cue.clone(), text }
}

fn device_entry(device: &DeviceDifferences) -> Entry {
    let unit = device.unit.as_deref().unwrap_or_default();
    let steps = &device.steps;
    let counted = format!("{} added, {} removed, {} changed", steps.added, steps.removed, steps.changed());
    let counted = (!steps.steps.is_empty()).then(|| format!("steps: {counted}"));
    let most = steps.largest.as_ref().map(|largest| format!("most by {}", self::largest(largest, unit)));
    let what = device_row(device)[1].clone();
    let text = std::iter::once(what).chain(counted).chain(most).collect::<Vec<_>>().join("; ");
    let at = steps.largest.map(|largest| largest.at_ms).or_else(|| Some(device.at()));
    let place = (device.robot.clone(), device.device.clone());
    Entry { act: None, at, device: Some(place), subject: device.name(), text }
}
