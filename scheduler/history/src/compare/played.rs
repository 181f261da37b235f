//! The acts of a mission that was played, as far as its journal or its recording tells.

use std::collections::BTreeMap;

use serde_json::Value;
use urrcp::{Setpoint, Span, Timestamp};

use super::steps::{Movement, TimedStep};
use crate::history::History;

/// An act that was sent, or skipped.
#[derive(Debug)]
pub(super) struct PlayedAct<'a> {
    pub(super) name: String,
    /// How often an act of this name came before.
    pub(super) before: usize,
    pub(super) fate: String,
    pub(super) report: Option<&'a Value>,
    /// By robot and device, in order of time.
    pub(super) scripts: BTreeMap<(String, String), Vec<SentScript>>,
}

/// A script that a robot was sent.
#[derive(Clone, Debug)]
pub(super) struct SentScript {
    /// From the act's start, in milliseconds.
    pub(super) start: f64,
    pub(super) content_hash: String,
    request: String,
    /// When the act starts, by the clock with which its steps are recorded.
    origin: Timestamp<urrcp::Server>,
}

impl SentScript {
    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.start.to_bits() == other.start.to_bits() && self.content_hash == other.content_hash
    }
}

pub(super) fn acts(history: &History) -> Vec<PlayedAct<'_>> {
    let mut names: BTreeMap<u64, String> = BTreeMap::new();
    let mut acts: Vec<PlayedAct<'_>> = Vec::new();
    for (_, record) in &history.records {
        let index = record["act"].as_u64();
        match record["record"].as_str() {
            Some("prepared") => {
                let ended = ended(history, &record["number"]);
                // An attempt that was withdrawn, and repeated.
                if ended.is_some_and(|ended| ended["again"] == true) {
                    continue;
                }
                let name = ended.and_then(|ended| ended["report"]["act"].as_str()).map(str::to_owned);
                let name = name.or_else(|| told_name(history, record));
                let name = name.unwrap_or_else(|| unnamed(index, &names));
                names.extend(index.map(|index| (index, name.clone())));
                acts.push(PlayedAct {
                    before: acts.iter().filter(|act| act.name == name).count(),
                    name,
                    fate: fate(ended),
                    report: ended.map(|ended| &ended["report"]),
                    scripts: scripts(history, record),
                });
            }
            Some("act_skipped") => {
                let name = unnamed(index, &names);
                acts.push(PlayedAct {
                    before: acts.iter().filter(|act| act.name == name).count(),
                    name,
                    fate: fate(Some(record)),
                    report: None,
                    scripts: BTreeMap::new(),
                });
            }
            _ => {}
        }
    }
    acts
}

/// The record of the end of the act of this number. After a crash there may be several; the last one counts.
fn ended<'a>(history: &'a History, number: &Value) -> Option<&'a Value> {
    let of_act = |record: &&Value| record["record"] == "act_ended" && record["report"]["number"] == *number;
    history.records.iter().map(|(_, record)| record).rfind(of_act)
}

fn told_name(history: &History, record: &Value) -> Option<String> {
    let sent = |told: &&Value| told["progress"] == "preparing" && told["timestamp"] == record["timestamp"];
    let told = history.told().iter().map(|(_, told)| told).find(sent)?;
    Some(told["act"].as_str()?.to_owned())
}

fn unnamed(index: Option<u64>, names: &BTreeMap<u64, String>) -> String {
    match index {
        Some(index) => {
            names.get(&index).cloned().unwrap_or_else(|| format!("act {}", index.saturating_add(1)))
        }
        None => "an act".to_owned(),
    }
}

fn fate(record: Option<&Value>) -> String {
    let fate = record.and_then(|record| record["fate"].as_str());
    fate.map_or_else(|| "its end is not known".to_owned(), |fate| fate.replace('_', " "))
}

fn scripts(history: &History, record: &Value) -> BTreeMap<(String, String), Vec<SentScript>> {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let start: Option<Timestamp<urrcp::Server>> = serde_json::from_value(record["start"].clone()).ok();
    let translated: Vec<_> = history.of_kind("translated").collect();
    let mut scripts: BTreeMap<_, Vec<SentScript>> = BTreeMap::new();
    for script in record["scripts"].as_array().into_iter().flatten() {
        let translated = translated.iter().rfind(|(_, record)| record["request_id"] == script["request_id"]);
        let shift = translated.map_or(script, |(_, record)| record)["shift_ms"].as_f64();
        let shift = Span::from_millis_f64(shift.unwrap_or_default());
        scripts.entry((text(&script["robot"]), text(&script["device"]))).or_default().push(SentScript {
            start: script["start"].as_f64().unwrap_or_default(),
            content_hash: text(&script["content_hash"]),
            request: text(&script["request_id"]),
            origin: start.unwrap_or(Timestamp::from_nanos(0)) + shift,
        });
    }
    for scripts in scripts.values_mut() {
        scripts.sort_by(|a, b| a.start.total_cmp(&b.start));
    }
    scripts
}

/// The steps of a device as a recording has them; `None` where it has not all of them.
pub(super) fn movement(
    history: &History,
    robot: &str,
    device: &str,
    scripts: &[SentScript],
) -> Option<Movement> {
    let mut steps = Vec::new();
    for script in scripts {
        let of_script = history.steps_of(robot, device, &script.request);
        if of_script.is_empty() {
            return None;
        }
        let count = of_script.len();
        for (index, (due, value, control)) in of_script.into_iter().enumerate() {
            let setpoint = Setpoint::new(control.parse().ok()?, value);
            steps.push(TimedStep {
                at: due - script.origin,
                setpoint,
                lease: None,
                ends: index + 1 == count,
            });
        }
    }
    Some(Movement { steps, linear: history.is_linear(robot, device) })
}
