//! What a journal or a recording has kept of a mission that was played.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use mcap::MessageStream;
use serde::Deserialize;
use serde_json::Value;
use urrcp::{InitializationBlock, RobotId, Server, Timestamp};

use crate::journal::{self, Unreadable};

/// The first bytes of every MCAP file.
const MCAP_MAGIC: &[u8] = b"\x89MCAP";

/// What is left of a mission.
#[derive(Clone, Debug, Default)]
pub struct History {
    /// The scenario's name, if it is known.
    pub scenario: Option<String>,
    /// Where it comes from.
    pub source: HistorySource,
    /// Where the file stops being whole, if it does.
    pub cut_off: Option<String>,
    /// What was decided, as in the journal.
    pub records: Vec<(Timestamp<Server>, Value)>,
    /// What the operator was told.
    pub(super) told: Vec<(Timestamp<Server>, Value)>,
    pub(super) robots: Vec<KnownRobot>,
}

/// What kind of file it was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HistorySource {
    /// The journal: decisions alone.
    #[default]
    Journal,
    /// A recording: also messages, values and clocks.
    Recording,
}

/// What is known of a robot.
#[derive(Clone, Debug)]
pub(super) struct KnownRobot {
    pub(super) id: RobotId,
    pub(super) init: Option<InitializationBlock>,
    /// Steps of scripts when they are due: by device and request.
    pub(super) planned: BTreeMap<(String, String), Vec<PlannedStep>>,
    /// What it said of its devices, when that arrived.
    pub(super) reported: BTreeMap<String, Vec<(Timestamp<Server>, f64)>>,
    /// Offset and round trip of each exchange, in milliseconds.
    pub(super) clock: Vec<(Timestamp<Server>, f64, f64)>,
}

/// A step of a script.
#[derive(Clone, Debug)]
pub(super) struct PlannedStep {
    pub(super) due: Timestamp<Server>,
    pub(super) value: f64,
    pub(super) control: String,
}

/// A file of which no mission can be shown.
#[derive(Debug, thiserror::Error)]
pub enum NoHistory {
    /// It cannot be read.
    #[error("cannot read `{}`: {error}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// It is neither a journal nor a recording.
    #[error(
        "`{}` is neither a recording nor a journal; give a file that `downbeat run --record FILE` has written, or the \
         folder of a mission", path.display()
    )]
    Unknown {
        /// Which file.
        path: PathBuf,
    },
}

impl History {
    /// Reads a journal, a mission's folder, or a recording, as far as it is whole.
    ///
    /// # Errors
    /// [`NoHistory`] where nothing can be read of it.
    pub fn read(path: &Path) -> Result<Self, NoHistory> {
        let path = if path.is_dir() { path.join("journal") } else { path.to_path_buf() };
        let bytes = fs::read(&path).map_err(|error| NoHistory::Io { path: path.clone(), error })?;
        if bytes.starts_with(MCAP_MAGIC) {
            return Ok(Self::of_recording(&bytes));
        }
        match journal::records(&bytes, &path) {
            Ok(records) => Ok(Self::of_journal(records)),
            Err(Unreadable::Io { path, error }) => Err(NoHistory::Io { path, error }),
            Err(Unreadable::NoBegin { path }) => Err(NoHistory::Unknown { path }),
        }
    }

    fn of_journal(records: journal::Records) -> Self {
        let robots = records.opened.robots;
        let cut_off = records.torn.map(|torn| match torn.whole_after {
            0 => format!("its last line, {}, is cut off", torn.line),
            whole => format!("line {} is damaged; {whole} whole lines behind it are left out", torn.line),
        });
        Self {
            scenario: records.opened.name,
            source: HistorySource::Journal,
            cut_off,
            records: records.all,
            told: Vec::new(),
            robots: robots.into_iter().map(|robot| KnownRobot::new(robot.robot, robot.init)).collect(),
        }
    }

    fn of_recording(bytes: &[u8]) -> Self {
        let mut history = Self { source: HistorySource::Recording, ..Self::default() };
        let messages = match MessageStream::new(bytes) {
            Ok(messages) => messages,
            Err(error) => {
                history.cut_off = Some(format!("nothing can be read: {error}"));
                return history;
            }
        };
        for (count, message) in messages.enumerate() {
            match message {
                Ok(message) => history.take(&message),
                Err(error) => {
                    history.cut_off = Some(format!("after {count} messages: {error}"));
                    break;
                }
            }
        }
        history.scenario = history.first_name();
        history
    }

    /// The scenario's name is the session's, up to the `@`.
    fn first_name(&self) -> Option<String> {
        let prepared = |(_, record): &&(_, Value)| record["record"] == "prepared";
        let id = self.records.iter().find(prepared)?.1["scripts"][0]["request_id"].as_str()?.to_owned();
        Some(id.split(['@', '/']).next()?.to_owned())
    }

    fn take(&mut self, message: &mcap::Message<'_>) {
        let Ok(value) = serde_json::from_slice::<Value>(&message.data) else { return };
        let at = Timestamp::from_nanos(i64::try_from(message.log_time).unwrap_or(i64::MAX));
        match message.channel.topic.as_str() {
            "/mission/decisions" => self.records.push((at, value)),
            "/mission/progress" => self.told.push((at, value)),
            topic => self.take_of_robot(topic, at, &value),
        }
    }

    fn take_of_robot(&mut self, topic: &str, at: Timestamp<Server>, value: &Value) {
        let Some((of_robot, kind)) = topic.strip_prefix("/robots/").and_then(|rest| rest.rsplit_once('/'))
        else {
            return;
        };
        let robot = match kind {
            "requests" | "responses" | "clock" => of_robot,
            _ => self.named(of_robot),
        };
        let device = of_robot.get(robot.len() + 1..).unwrap_or_default().to_owned();
        let Ok(robot) = robot.parse() else { return };
        let robot = self.robot(robot);
        match kind {
            "responses" => robot.says(value),
            "clock" => {
                let figures = value["offset_ms"].as_f64().zip(value["delay_ms"].as_f64());
                robot.clock.extend(figures.map(|(offset, delay)| (at, offset, delay)));
            }
            "planned" => robot.plans(device, at, value),
            "reported" => {
                let reported = robot.reported.entry(device).or_default();
                reported.extend(value["value"].as_f64().map(|value| (at, value)));
            }
            _ => {}
        }
    }

    /// The robot whose device this is: names may have slashes, and a robot is spoken to before its devices are.
    fn named<'t>(&self, of_robot: &'t str) -> &'t str {
        let begins = |id: &str| of_robot.strip_prefix(id).is_some_and(|rest| rest.starts_with('/'));
        let known = self.robots.iter().map(|robot| robot.id.as_str()).filter(|id| begins(id));
        let length = known.map(str::len).max().or_else(|| of_robot.find('/')).unwrap_or(of_robot.len());
        &of_robot[..length]
    }

    fn robot(&mut self, id: RobotId) -> &mut KnownRobot {
        let index = self.robots.iter().position(|robot| robot.id == id).unwrap_or_else(|| {
            self.robots.push(KnownRobot::new(id, None));
            self.robots.len() - 1
        });
        &mut self.robots[index]
    }
}

impl KnownRobot {
    fn new(id: RobotId, init: Option<InitializationBlock>) -> Self {
        let (planned, reported) = (BTreeMap::new(), BTreeMap::new());
        Self { id, init, planned, reported, clock: Vec::new() }
    }

    /// It describes itself.
    fn says(&mut self, response: &Value) {
        let block = &response["initialization_block"];
        if let Ok(block) = InitializationBlock::deserialize(block) {
            self.init = Some(block);
        }
    }

    fn plans(&mut self, device: String, due: Timestamp<Server>, step: &Value) {
        let Some(value) = step["value"].as_f64() else { return };
        let request = step["request_id"].as_str().unwrap_or_default().to_owned();
        let control = step["control_type"].as_str().unwrap_or_default().to_owned();
        self.planned.entry((device, request)).or_default().push(PlannedStep { due, value, control });
    }
}
