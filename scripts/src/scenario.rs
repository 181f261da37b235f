//! The scenario file: cues with their times, robots and tracks. Names are resolved against the fleet in `plan`.

use std::path::PathBuf;

use urrcp::{ControlType, Millis, Span, StopCondition};

use crate::fields::{At, Findings};
use crate::finding::{Code, Place};
use crate::motion::Easing;
use crate::node::{self, Node};
use crate::source::Source;

/// Largest allowed spread of starts where the scenario names none.
const START_TOLERANCE: Span = Span::from_millis(10);
/// Running lease where the scenario names none: two seconds of silence.
const RUNNING_LEASE_MS: f64 = 2_000.0;

/// A choreography as it is written.
#[derive(Clone, Debug)]
pub(crate) struct Scenario {
    pub(crate) name: String,
    pub(crate) start_tolerance: Span,
    pub(crate) lead: Option<Span>,
    pub(crate) stop_condition: StopCondition,
    pub(crate) cues: Vec<Cue>,
}

/// Some robots move some devices from some time on.
#[derive(Clone, Debug)]
pub(crate) struct Cue {
    pub(crate) name: String,
    pub(crate) at: Span,
    /// Names of robots and groups, each with its place.
    pub(crate) robots: Vec<(String, Place)>,
    pub(crate) stop_condition: Option<StopCondition>,
    pub(crate) tracks: Vec<Track>,
}

/// The movement of one device.
#[derive(Clone, Debug)]
pub(crate) struct Track {
    pub(crate) device: String,
    pub(crate) control: Option<ControlType>,
    pub(crate) keyframes: Vec<Keyframe>,
    pub(crate) place: Place,
}

/// A value at a time, and the way there.
#[derive(Clone, Debug)]
pub(crate) struct Keyframe {
    /// From the cue's start.
    pub(crate) at: Span,
    pub(crate) to: f64,
    pub(crate) easing: Option<Easing>,
    /// Of the keyframe; its value stands under `to`.
    pub(crate) place: Place,
}

/// The fleet file that a scenario names, relative to the scenario's own folder.
#[must_use]
pub fn fleet_named_by(source: &Source) -> Option<PathBuf> {
    let Ok(Node::Map(entries)) = node::parse(source) else { return None };
    entries.into_iter().find_map(|(key, node)| match node {
        Node::Text(path) if key == "fleet" => Some(PathBuf::from(path)),
        _ => None,
    })
}

/// Reads the tree of a scenario. What is wrong is left out and found.
pub(crate) fn read(findings: &mut Findings, document: &Node) -> Option<Scenario> {
    let at = At::document(document);
    let known = ["scenario", "fleet", "start_tolerance", "lead", "stop_condition", "cues"];
    let required = ["scenario", "cues"];
    let [name, fleet, tolerance, lead, stop_condition, cues] =
        findings.map(&at, "the scenario", known, &required)?;
    fleet.and_then(|at| findings.text(&at, "the path of a fleet file"));
    let name = name.and_then(|at| findings.name(&at, "the scenario's name")).unwrap_or_default();
    let default = StopCondition { pending: None, running: Millis::new(RUNNING_LEASE_MS).ok() };
    let mut scenario = Scenario {
        name,
        start_tolerance: tolerance.and_then(|at| findings.duration(&at)).unwrap_or(START_TOLERANCE),
        lead: lead.and_then(|at| findings.duration(&at)),
        stop_condition: stop_condition.and_then(|at| lease(findings, &at, default)).unwrap_or(default),
        cues: Vec::new(),
    };
    if let Some(cues) = cues {
        let items = findings.list(&cues, "a list of cues");
        if items.is_empty() && matches!(cues.node, Node::List(_)) {
            findings.add(
                Code::NothingToDo,
                cues.place(),
                "the scenario has no cues",
                "at least one cue",
                None,
            );
        }
        for (index, item) in items.iter().enumerate() {
            let cue = cue(findings, item, index, scenario.stop_condition);
            scenario.cues.extend(cue);
        }
    }
    Some(scenario)
}

fn cue(findings: &mut Findings, at: &At<'_>, index: usize, lease_default: StopCondition) -> Option<Cue> {
    let known = ["cue", "at", "robots", "stop_condition", "tracks"];
    let [name, start, robots, stop_condition, tracks] =
        findings.map(at, "a cue", known, &["at", "robots", "tracks"])?;
    let name = name.and_then(|at| findings.name(&at, "the cue's name"));
    let start = start.and_then(|at| findings.duration(&at));
    let robots = robots.map(|at| robot_names(findings, &at)).unwrap_or_default();
    let stop_condition = stop_condition.and_then(|at| lease(findings, &at, lease_default));
    let tracks = tracks.map(|at| read_tracks(findings, &at)).unwrap_or_default();
    Some(Cue {
        name: name.unwrap_or_else(|| format!("cue {}", index + 1)),
        at: start?,
        robots,
        stop_condition,
        tracks,
    })
}

fn robot_names(findings: &mut Findings, at: &At<'_>) -> Vec<(String, Place)> {
    let expected = "a robot, a group or a list of them";
    let Node::List(items) = at.node else {
        return findings.name(at, expected).map(|name| (name, at.place())).into_iter().collect();
    };
    if items.is_empty() {
        findings.add(Code::NothingToDo, at.place(), "the cue is for no robot", expected, None);
    }
    let items = findings.list(at, expected);
    items.iter().filter_map(|item| Some((findings.name(item, expected)?, item.place()))).collect()
}

/// `2s` for both, or a map of pending and running, each a time or `none`.
fn lease(findings: &mut Findings, at: &At<'_>, default: StopCondition) -> Option<StopCondition> {
    let Node::Map(_) = at.node else {
        return findings.duration(at).map(|span| StopCondition::both(Millis::from_span(span)));
    };
    let [pending, running] = findings.map(at, "`stop_condition`", ["pending", "running"], &[])?;
    let mut limit = |at: Option<At<'_>>, default: Option<Millis>| match at {
        None => default,
        Some(at) if matches!(at.node, Node::Text(text) if text == "none") => None,
        Some(at) => findings.duration(&at).map(Millis::from_span),
    };
    Some(StopCondition { pending: limit(pending, default.pending), running: limit(running, default.running) })
}

fn read_tracks(findings: &mut Findings, at: &At<'_>) -> Vec<Track> {
    let entries = findings.entries(at, "device to its keyframes");
    if entries.is_empty() && matches!(at.node, Node::Map(_)) {
        findings.add(Code::NothingToDo, at.place(), "the cue moves no device", "at least one track", None);
    }
    entries.iter().filter_map(|(device, at)| track(findings, device, at)).collect()
}

fn track(findings: &mut Findings, device: &str, at: &At<'_>) -> Option<Track> {
    let (control, keyframes) = match at.node {
        Node::Map(_) => {
            let known = ["control", "keyframes"];
            let [control, keyframes] = findings.map(at, "a track", known, &["keyframes"])?;
            let control = control.and_then(|at| control_type(findings, &at));
            (control, read_keyframes(findings, &keyframes?))
        }
        _ => (None, read_keyframes(findings, at)),
    };
    Some(Track { device: device.to_owned(), control, keyframes, place: at.key_place() })
}

fn control_type(findings: &mut Findings, at: &At<'_>) -> Option<ControlType> {
    let expected = "position, speed, acceleration or custom_N";
    let text = findings.text(at, expected)?;
    let parsed = text.parse().ok().filter(|t| !matches!(t, ControlType::Script | ControlType::Sensor));
    if parsed.is_none() {
        let message = format!("`{}` is no control type for keyframes", node::shortened(text));
        findings.add(Code::UnknownWord, at.place(), message, expected, None);
    }
    parsed
}

fn read_keyframes(findings: &mut Findings, at: &At<'_>) -> Vec<Keyframe> {
    let items = findings.list(at, "a list of keyframes such as {at: 1s, to: 45}");
    if items.is_empty() && matches!(at.node, Node::List(_)) {
        findings.add(
            Code::NothingToDo,
            at.place(),
            "the track has no keyframes",
            "at least one keyframe",
            None,
        );
    }
    let keyframes: Vec<_> = items.iter().filter_map(|item| keyframe(findings, item)).collect();
    for pair in keyframes.windows(2) {
        if pair[1].at <= pair[0].at {
            let mut place = pair[1].place.clone();
            place.path.push(crate::finding::Part::Key("at".into(), 0));
            let message = format!("the keyframe at {} stands after the one at {}", pair[1].at, pair[0].at);
            let hint =
                Some("keyframes of one track stand in order, each later than the one before".to_owned());
            findings.add(Code::TimeOrder, place, message, format!("a time after {}", pair[0].at), hint);
        }
    }
    keyframes
}

fn keyframe(findings: &mut Findings, at: &At<'_>) -> Option<Keyframe> {
    let known = ["at", "to", "ease"];
    let [time, to, ease] = findings.map(at, "a keyframe", known, &["at", "to"])?;
    let time = time.and_then(|at| findings.duration(&at));
    let to = to.and_then(|at| findings.number(&at, "a finite number"));
    let easing = ease.and_then(|at| findings.word(&at, &Easing::WORDS));
    Some(Keyframe { at: time?, to: to?, easing, place: at.place() })
}
