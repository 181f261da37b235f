//! Missions that were played, read from their journals and recordings.

mod fate;

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use mcap::MessageStream;
use mcap::read::Options;
use serde::Deserialize;
use serde_json::{Value, json};
use urrcp::{InitializationBlock, Interpolation, Robot, RobotId, Server, Span, Timestamp};

use downbeat_mission::promised_name;
use downbeat_runtime::journal::{self, Unreadable};

pub use self::fate::fate_text;
pub(crate) use self::fate::{Fate, over};

/// The first bytes of every MCAP file.
const MCAP_MAGIC: &[u8] = b"\x89MCAP";

/// As many as tell what kind of file it is.
const FIRST_BYTES: u64 = 16;

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
    pub(crate) told: Vec<(Timestamp<Server>, Value)>,
    pub(crate) robots: Vec<KnownRobot>,
    /// Of each topic, what it is about.
    routes: HashMap<String, Option<Route>>,
}

/// What the messages of a topic are about.
#[derive(Clone, Debug)]
struct Route {
    robot: usize,
    device: String,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Request,
    Response,
    Clock,
    Planned,
    Reported,
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
pub(crate) struct KnownRobot {
    pub(crate) id: RobotId,
    pub(crate) init: Option<InitializationBlock>,
    /// Steps of scripts when they are due: by device and request.
    pub(crate) planned: BTreeMap<(String, String), Vec<PlannedStep>>,
    /// What it said of its devices, when that arrived.
    pub(crate) reported: BTreeMap<String, Vec<(Timestamp<Server>, f64)>>,
    /// Offset and round trip of each exchange, in milliseconds.
    pub(crate) clock: Vec<(Timestamp<Server>, f64, f64)>,
    /// Questions that it has answered with its times.
    pub(crate) exchanges: Vec<Exchange>,
    /// When questions that it has not answered yet were sent, by their name and own timestamp.
    open: HashMap<(&'static str, Timestamp<Server>), VecDeque<Timestamp<Server>>>,
    /// What its sensors read, by device, when that arrived.
    pub(crate) readings: BTreeMap<String, Vec<(Timestamp<Server>, f64)>>,
}

/// A question and its answer: the four times of RFC 5905, section 8.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exchange {
    /// T1: when the question left.
    pub(crate) sent: Timestamp<Server>,
    /// T2: when the robot had it.
    pub(crate) robot_received: Timestamp<Robot>,
    /// T3: when the robot answered.
    pub(crate) robot_sent: Timestamp<Robot>,
    /// T4: when the answer arrived.
    pub(crate) received: Timestamp<Server>,
}

/// Earlier recordings noted a message once it had been handed to its link, which may have sent it by then: so much earlier it had
/// not left, unless the machine was busy.
const NOTED_WITHIN: Span = Span::from_millis(1);

/// Messages that carry the times of an exchange: the question, and its answer.
const QUESTIONS: [(&str, &str); 2] =
    [("availability_request", "availability_response"), ("inquiry", "inquiry_response")];

/// A step of a script.
#[derive(Clone, Debug)]
pub(crate) struct PlannedStep {
    pub(crate) due: Timestamp<Server>,
    pub(crate) value: f64,
    pub(crate) control: String,
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
    /// The known part of the report: the name, the outcome and the reports of the acts that have ended.
    #[must_use]
    pub fn report(&self) -> Value {
        let ended = self.records.iter().filter(|(_, record)| record["record"] == "act_ended");
        // Attempts that were withdrawn and repeated are not acts of a report.
        let ended = ended.filter(|(_, record)| record["again"] != true);
        let acts: Vec<&Value> = ended.map(|(_, record)| &record["report"]).collect();
        let spread = acts.iter().filter_map(|act| act["spread_ms"].as_f64()).reduce(f64::max);
        let outcome = self.records.iter().rev().find(|(_, record)| record["record"] == "ended");
        json!({
            "scenario": self.scenario,
            "outcome": outcome.map(|(_, record)| &record["outcome"]),
            "start": self.of_kind("prepared").next().map(|(_, record)| &record["start"]),
            "spread_ms": spread,
            "acts": acts,
            // Neither kind of file states the totals of each robot over all acts.
            "robots": null,
            "failures": self.failures(),
        })
    }

    pub(crate) fn of_kind<'a>(
        &'a self,
        kind: &'a str,
    ) -> impl Iterator<Item = &'a (Timestamp<Server>, Value)> {
        self.records.iter().filter(move |(_, record)| record["record"] == *kind)
    }

    /// Reads a journal, a mission's folder, or a recording, as far as it is whole.
    ///
    /// # Errors
    /// [`NoHistory`] where nothing can be read of it.
    pub fn read(path: &Path) -> Result<Self, NoHistory> {
        let journal = path.join("journal");
        let path = match path.is_dir() {
            true if !journal.exists() => return Err(NoHistory::Unknown { path: path.to_path_buf() }),
            true => journal,
            false => path.to_path_buf(),
        };
        let mut bytes = Vec::new();
        let read = downbeat_scripts::open(&path).and_then(|mut file| file.read_to_end(&mut bytes));
        read.map_err(|error| NoHistory::Io { path: path.clone(), error })?;
        if bytes.starts_with(MCAP_MAGIC) {
            return Self::of_recording(&bytes, &path);
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
            routes: HashMap::new(),
        }
    }

    /// The failures of robots, in order.
    pub(crate) fn failures(&self) -> Vec<&Value> {
        let (all, kind) = match self.source {
            HistorySource::Recording => (&self.told, "progress"),
            HistorySource::Journal => (&self.records, "record"),
        };
        all.iter().map(|(_, value)| value).filter(|value| value[kind] == "failed").collect()
    }

    fn of_recording(bytes: &[u8], path: &Path) -> Result<Self, NoHistory> {
        let mut history = Self { source: HistorySource::Recording, ..Self::default() };
        match MessageStream::new_with_options(bytes, Options::ValidateChunkCrcs.into()) {
            Ok(messages) => history.take_all(messages),
            Err(error) => history.cut_off = Some(format!("nothing can be read: {error}")),
        }
        let empty = history.records.is_empty() && history.told.is_empty() && history.robots.is_empty();
        if empty && history.cut_off.is_none() {
            return Err(NoHistory::Unknown { path: path.to_path_buf() });
        }
        history.scenario = history.first_name();
        Ok(history)
    }

    /// Whether a file is what is left of a mission, by its first bytes: a recording, a journal, or a folder.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn is_at(path: &Path) -> io::Result<bool> {
        if path.is_dir() {
            return Ok(true);
        }
        let mut first = Vec::new();
        downbeat_scripts::open(path)?.take(FIRST_BYTES).read_to_end(&mut first)?;
        let sum = first.split_at_checked(8).filter(|(sum, _)| sum.iter().all(u8::is_ascii_hexdigit));
        Ok(first.starts_with(MCAP_MAGIC) || sum.is_some_and(|(_, line)| line.starts_with(b" {")))
    }

    /// A journal of these records.
    #[cfg(test)]
    pub(crate) fn of_records(records: Vec<(Timestamp<Server>, Value)>) -> Self {
        Self { records, ..Self::default() }
    }

    /// What the operator was told; nothing in a journal.
    pub(crate) fn told(&self) -> &[(Timestamp<Server>, Value)] {
        &self.told
    }

    /// How a device goes from step to step, as its robot described it.
    pub(crate) fn is_linear(&self, robot: &str, device: &str) -> bool {
        let robot = self.robots.iter().find(|known| known.id.as_str() == robot);
        let mut devices = robot.into_iter().flat_map(|robot| &robot.init).flat_map(|init| &init.devices);
        devices.any(|known| known.id.as_str() == device && known.interpolation == Interpolation::Linear)
    }

    /// The steps that a request asks of a device, in order of time, each with its value and its control type. Only recordings have
    /// them.
    pub(crate) fn steps_of(
        &self,
        robot: &str,
        device: &str,
        request: &str,
    ) -> Vec<(Timestamp<Server>, f64, &str)> {
        let robot = self.robots.iter().find(|known| known.id.as_str() == robot);
        let key = (device.to_owned(), request.to_owned());
        let steps = robot.and_then(|robot| robot.planned.get(&key)).into_iter().flatten();
        let mut steps: Vec<_> = steps.map(|step| (step.due, step.value, step.control.as_str())).collect();
        // What is sent again is written down again.
        steps.sort_by_key(|(due, ..)| *due);
        steps.dedup();
        steps
    }

    /// Whether anything of a mission could be read.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.records.is_empty() && self.told.is_empty()
    }

    fn take_all(&mut self, messages: MessageStream<'_>) {
        for (count, message) in messages.enumerate() {
            let taken = match message {
                Ok(message) => self.take(&message),
                Err(error) => Err(error.to_string()),
            };
            if let Err(error) = taken {
                self.cut_off = Some(format!("after {count} messages: {error}"));
                break;
            }
        }
    }

    /// The scenario's name is the session's, up to the `@`.
    fn first_name(&self) -> Option<String> {
        let prepared = |(_, record): &&(_, Value)| record["record"] == "prepared";
        let id = self.records.iter().find(prepared)?.1["scripts"][0]["request_id"].as_str()?.to_owned();
        Some(id.split(['@', '/']).next()?.to_owned())
    }

    fn take(&mut self, message: &mcap::Message<'_>) -> Result<(), String> {
        let topic = message.channel.topic.as_str();
        if !topic.starts_with("/mission/") && !topic.starts_with("/robots/") {
            return Ok(());
        }
        let value = serde_json::from_slice::<Value>(&message.data);
        let value = value.map_err(|error| format!("a message on {topic} is damaged: {error}"))?;
        let at = Timestamp::from_nanos(i64::try_from(message.log_time).unwrap_or(i64::MAX));
        match topic {
            "/mission/decisions" => self.records.push((at, value)),
            "/mission/progress" => self.told.push((at, value)),
            topic => self.take_of_robot(topic, at, &value),
        }
        Ok(())
    }

    fn take_of_robot(&mut self, topic: &str, at: Timestamp<Server>, value: &Value) {
        if !self.routes.contains_key(topic) {
            let route = self.route(topic);
            self.routes.insert(topic.to_owned(), route);
        }
        let Some(Route { robot, device, kind }) = self.routes.get(topic).and_then(Option::as_ref) else {
            return;
        };
        let robot = &mut self.robots[*robot];
        match kind {
            Kind::Request => robot.is_asked(at, value),
            Kind::Response => robot.says(at, value),
            Kind::Clock => {
                let figures = value["offset_ms"].as_f64().zip(value["delay_ms"].as_f64());
                robot.clock.extend(figures.map(|(offset, delay)| (at, offset, delay)));
            }
            Kind::Planned => robot.plans(device.clone(), at, value),
            Kind::Reported => {
                let reported = robot.reported.entry(device.clone()).or_default();
                let point = value["value"].as_f64().map(|value| (at, value));
                reported.extend(point);
                if value["status"] == "Provide" {
                    robot.readings.entry(device.clone()).or_default().extend(point);
                }
            }
        }
    }

    fn route(&mut self, topic: &str) -> Option<Route> {
        let (of_robot, kind) = topic.strip_prefix("/robots/")?.rsplit_once('/')?;
        let (kind, id) = match kind {
            "requests" => (Kind::Request, of_robot),
            "responses" => (Kind::Response, of_robot),
            "clock" => (Kind::Clock, of_robot),
            "planned" => (Kind::Planned, self.named(of_robot)),
            "reported" => (Kind::Reported, self.named(of_robot)),
            _ => return None,
        };
        let device = of_robot.get(id.len() + 1..).unwrap_or_default().to_owned();
        let robot = self.robot(id.parse().ok()?);
        Some(Route { robot, device, kind })
    }

    /// The robot whose device this is: names may have slashes, and a robot is spoken to before its devices are.
    fn named<'t>(&self, of_robot: &'t str) -> &'t str {
        let begins = |id: &str| of_robot.strip_prefix(id).is_some_and(|rest| rest.starts_with('/'));
        let known = self.robots.iter().map(|robot| robot.id.as_str()).filter(|id| begins(id));
        let length = known.map(str::len).max().or_else(|| of_robot.find('/')).unwrap_or(of_robot.len());
        &of_robot[..length]
    }

    fn robot(&mut self, id: RobotId) -> usize {
        self.robots.iter().position(|robot| robot.id == id).unwrap_or_else(|| {
            self.robots.push(KnownRobot::new(id, None));
            self.robots.len() - 1
        })
    }
}

impl KnownRobot {
    pub(crate) fn new(id: RobotId, init: Option<InitializationBlock>) -> Self {
        let (planned, reported, readings) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let (clock, exchanges, open) = (Vec::new(), Vec::new(), HashMap::new());
        Self { id, init, planned, reported, clock, exchanges, open, readings }
    }

    /// It is asked something that it may answer with its times.
    fn is_asked(&mut self, at: Timestamp<Server>, request: &Value) {
        for (question, _) in QUESTIONS {
            if let Ok(own) = Timestamp::deserialize(&request[question]["timestamp"]) {
                self.open.entry((question, own)).or_default().push_back(at);
            }
        }
    }

    /// It describes itself, or answers a question with its times. A question that waited on this machine counts from when it
    /// left, but no later than surely so.
    fn says(&mut self, at: Timestamp<Server>, response: &Value) {
        for (question, answer) in QUESTIONS {
            let answer = &response[answer];
            let Ok(own) = Timestamp::deserialize(&answer["originate_timestamp"]) else { continue };
            let Entry::Occupied(mut open) = self.open.entry((question, own)) else { continue };
            let sent = open.get_mut().pop_front().map(|noted| own.max(noted + -NOTED_WITHIN));
            if open.get().is_empty() {
                open.remove();
            }
            let robot_received = Timestamp::deserialize(&answer["receive_timestamp"]).ok();
            let robot_sent = Timestamp::deserialize(&answer["timestamp"]).ok();
            let times = sent.zip(robot_received.zip(robot_sent));
            self.exchanges.extend(times.map(|(sent, (robot_received, robot_sent))| Exchange {
                sent,
                robot_received,
                robot_sent,
                received: at,
            }));
        }
        let block = &response["initialization_block"];
        if let Ok(block) = InitializationBlock::deserialize(block) {
            self.init = Some(block);
        }
    }

    fn plans(&mut self, device: String, due: Timestamp<Server>, step: &Value) {
        let Some(value) = step["value"].as_f64() else { return };
        let request = promised_name(step["request_id"].as_str().unwrap_or_default()).to_owned();
        let control = step["control_type"].as_str().unwrap_or_default().to_owned();
        self.planned.entry((device, request)).or_default().push(PlannedStep { due, value, control });
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_script_that_was_sent_again_under_another_name_is_planned_once() {
        let mut robot = KnownRobot::new("r".parse().unwrap(), None);
        for name in ["s/1/0/0/0", "s/1/0/0/0+1", "s/1/0/0/0+2"] {
            let step = json!({"value": 1, "control_type": "position", "request_id": name});
            robot.plans("d".to_owned(), Timestamp::from_nanos(5), &step);
        }
        let planned: Vec<_> = robot.planned.into_keys().collect();
        assert_eq!(planned, [("d".to_owned(), "s/1/0/0/0".to_owned())]);
    }
}
