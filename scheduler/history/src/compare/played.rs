//! The acts of a past mission, according to its journal or its recording.

use std::collections::{BTreeMap, HashMap};

use downbeat_mission::report::{ActFate, ActReport};
use downbeat_mission::{ActIndex, Promise, Record};
use urrcp::{ContentHash, Millis, RequestId, Server, Setpoint, Span, Timestamp};

use super::steps::{Movement, TimedStep};
use crate::history::History;

/// An act that a past mission sent or skipped.
#[derive(Debug)]
pub(super) struct PlayedAct<'a> {
    pub(super) name: String,
    /// Number of earlier acts of the mission with the same name.
    pub(super) before: usize,
    pub(super) fate: String,
    pub(super) report: Option<&'a ActReport>,
    /// The scripts that were sent, by robot and device, in order of time.
    pub(super) scripts: BTreeMap<(String, String), Vec<SentScript>>,
}

/// A script that was sent to a robot.
#[derive(Clone, Debug)]
pub(super) struct SentScript {
    /// Time from the act's start to the start of the script.
    pub(super) start: Millis,
    pub(super) content_hash: ContentHash,
    request: RequestId,
    /// The start of the act by the robot's clock, in which the due times of the script's steps are recorded.
    origin: Timestamp<Server>,
}

impl SentScript {
    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.start == other.start && self.content_hash == other.content_hash
    }
}

pub(super) fn acts(history: &History) -> Vec<PlayedAct<'_>> {
    let mut names: BTreeMap<ActIndex, String> = BTreeMap::new();
    let mut acts: Vec<PlayedAct<'_>> = Vec::new();
    for (_, record) in &history.records {
        match record {
            Record::Prepared(promise) => {
                // After a crash, the journal may contain several ends of the act; the last one applies.
                let ended = history.ended_acts().rfind(|ended| ended.report.number == promise.number);
                // Skips an attempt that was withdrawn and repeated.
                if ended.is_some_and(|ended| ended.again) {
                    continue;
                }
                let name = ended.map(|ended| ended.report.act.clone());
                let name = name.or_else(|| history.told_name(promise.timestamp).map(str::to_owned));
                let name = name.unwrap_or_else(|| unnamed(promise.act, &names));
                names.insert(promise.act, name.clone());
                acts.push(PlayedAct {
                    before: acts.iter().filter(|act| act.name == name).count(),
                    name,
                    fate: fate(ended.map(|ended| ended.fate)),
                    report: ended.map(|ended| ended.report),
                    scripts: scripts(history, promise),
                });
            }
            Record::ActSkipped(over) => {
                let name = unnamed(over.act, &names);
                acts.push(PlayedAct {
                    before: acts.iter().filter(|act| act.name == name).count(),
                    name,
                    fate: fate(Some(&over.fate)),
                    report: None,
                    scripts: BTreeMap::new(),
                });
            }
            _ => {}
        }
    }
    acts
}

fn unnamed(index: ActIndex, names: &BTreeMap<ActIndex, String>) -> String {
    names.get(&index).cloned().unwrap_or_else(|| format!("act {}", index.get().saturating_add(1)))
}

fn fate(fate: Option<&ActFate>) -> String {
    fate.map_or_else(|| "outcome unknown".to_owned(), ToString::to_string)
}

fn scripts(history: &History, promise: &Promise) -> BTreeMap<(String, String), Vec<SentScript>> {
    let translated: HashMap<&RequestId, Span> = history
        .records
        .iter()
        .filter_map(|(_, record)| match record {
            Record::Translated { request_id, shift } => Some((request_id, *shift)),
            _ => None,
        })
        .collect();
    let mut scripts: BTreeMap<_, Vec<SentScript>> = BTreeMap::new();
    for script in &promise.scripts {
        let shift = translated.get(&script.request_id).copied().unwrap_or(script.shift);
        let device = (script.robot.to_string(), script.device.to_string());
        scripts.entry(device).or_default().push(SentScript {
            start: script.start,
            content_hash: script.content_hash,
            request: script.request_id.clone(),
            origin: promise.start + shift,
        });
    }
    for scripts in scripts.values_mut() {
        scripts.sort_by_key(|script| script.start.span());
    }
    scripts
}

/// Returns the steps of a device in an act, from a recording; `None` if the recording lacks any of them.
pub(super) fn movement(
    history: &History,
    robot: &str,
    device: &str,
    scripts: &[SentScript],
) -> Option<Movement> {
    let mut steps = Vec::new();
    for script in scripts {
        let of_script = history.steps_of(robot, device, script.request.as_str());
        if of_script.is_empty() {
            return None;
        }
        let count = of_script.len();
        for (index, (due, value, control)) in of_script.into_iter().enumerate() {
            let setpoint = Setpoint::new(control, value);
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
