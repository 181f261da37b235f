//! Missions that were played, read from their journals and recordings.

mod fate;
mod late;

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use mcap::MessageStream;
use mcap::read::Options;
use serde::Serialize;
use serde_json::Value;
use urrcp::{
    ControlType, InitializationBlock, Interpolation, Message, Millis, RequestId, Robot, RobotId, Server,
    Span, Status, Timestamp,
};

use downbeat_mission::report::{ActFate, ActReport, Outcome};
use downbeat_mission::{Failure, Progress, Promise, Record, promised_name};
use downbeat_runtime::journal::{self, Unreadable, VERSION};
use downbeat_runtime::recording::{ClockOffset, PlannedValue, ReportedValue, VERSION_KEY};

pub use self::fate::fate_text;
pub(crate) use self::fate::{Fate, over};
pub(crate) use self::late::LateSteps;

/// The first bytes of every MCAP file.
const MCAP_MAGIC: &[u8] = b"\x89MCAP";

/// Number of bytes to read from the start of a file to determine its kind.
const FIRST_BYTES: u64 = 16;

/// The data of a past mission, as read from its journal or recording.
#[derive(Clone, Debug, Default)]
pub struct History {
    /// The scenario's name; `None` if it is not known.
    pub scenario: Option<String>,
    /// The kind of file that the data was read from.
    pub source: HistorySource,
    /// The reason why the file is incomplete; `None` if it is complete.
    pub cut_off: Option<String>,
    /// The recorded decisions of the mission, with their times.
    pub records: Vec<(Timestamp<Server>, Record)>,
    /// The messages to the operator, with their times; empty for a journal.
    pub(crate) told: Vec<(Timestamp<Server>, Progress)>,
    /// The report with which the mission ended, in the form of `--format json`; `None` for a journal, and if the recording lacks its end.
    ended_with: Option<Value>,
    pub(crate) robots: Vec<KnownRobot>,
    /// What each topic of the recording is about; `None` for topics that contain no known data of a robot.
    routes: HashMap<String, Option<Route>>,
}

/// The robot and device that a topic of a recording concerns, and the kind of data in the topic.
#[derive(Clone, Debug)]
struct Route {
    robot: usize,
    device: String,
    kind: TopicKind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TopicKind {
    Request,
    Response,
    Clock,
    Planned,
    Reported,
}

/// The kind of file that a mission was read from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HistorySource {
    /// The journal, which contains only decisions.
    #[default]
    Journal,
    /// A recording, which also contains messages, values and clock measurements.
    Recording,
}

/// The known data of a robot in a past mission.
#[derive(Clone, Debug)]
pub(crate) struct KnownRobot {
    pub(crate) id: RobotId,
    pub(crate) init: Option<InitializationBlock>,
    /// The planned steps of scripts with their due times, by device and request id.
    pub(crate) planned: BTreeMap<(String, String), Vec<PlannedStep>>,
    /// The values that the robot reported, with their arrival times, by device.
    pub(crate) reported: BTreeMap<String, Vec<(Timestamp<Server>, f64)>>,
    /// The clock measurements. Each consists of its time, the clock offset in milliseconds, and the round trip in milliseconds.
    pub(crate) clock: Vec<(Timestamp<Server>, f64, f64)>,
    /// The questions that the robot answered with its timestamps, each with its answer.
    pub(crate) exchanges: Vec<Exchange>,
    /// The recorded send times of unanswered questions, by the kind of the question and the timestamp that it contains.
    open: HashMap<(Question, Timestamp<Server>), VecDeque<Timestamp<Server>>>,
    /// When the last response of the robot was received.
    heard: Option<Timestamp<Server>>,
    /// The readings of sensors with their arrival times, by device.
    pub(crate) readings: BTreeMap<String, Vec<(Timestamp<Server>, f64)>>,
    /// The late steps that the robot reported, by request id.
    pub(crate) late: BTreeMap<String, LateSteps>,
}

/// The four timestamps of a question and its answer, as in RFC 5905, section 8.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exchange {
    /// T1: departure of the question.
    pub(crate) sent: Timestamp<Server>,
    /// T2: arrival of the question at the robot.
    pub(crate) robot_received: Timestamp<Robot>,
    /// T3: departure of the robot's answer.
    pub(crate) robot_sent: Timestamp<Robot>,
    /// T4: arrival of the answer.
    pub(crate) received: Timestamp<Server>,
}

/// Maximum time from the departure of a message until it was recorded, unless the machine was busy. Older versions recorded a message
/// only after they had passed it to its link, which may have sent it at once.
const NOTED_WITHIN: Span = Span::from_millis(1);

/// The kinds of questions that a robot answers with its timestamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Question {
    Availability,
    Inquiry,
}

/// A script step that was sent to a robot.
#[derive(Clone, Debug)]
pub(crate) struct PlannedStep {
    pub(crate) due: Timestamp<Server>,
    pub(crate) value: f64,
    pub(crate) control_type: ControlType,
}

/// Why no mission can be read from a file.
#[derive(Debug, thiserror::Error)]
pub enum NoHistory {
    /// The file cannot be read.
    #[error("cannot read `{}`: {error}", path.display())]
    Io {
        /// The path of the file.
        path: PathBuf,
        /// The error that the operating system reports.
        error: io::Error,
    },
    /// The file is neither a journal nor a recording.
    #[error(
        "`{}` is neither a recording nor a journal; expected a file that `downbeat run --record FILE` wrote, or the \
         folder of a mission", path.display()
    )]
    Unknown {
        /// The path of the file.
        path: PathBuf,
    },
    /// The file was written by another version of Downbeat.
    #[error(
        "`{}` has {}, expected version {VERSION}; use the version of Downbeat that wrote it",
        path.display(), found.map_or_else(|| "no version".to_owned(), |found| format!("version {found}"))
    )]
    OtherVersion {
        /// The path of the file.
        path: PathBuf,
        /// The version of the file; `None` if it states none.
        found: Option<u32>,
    },
}

/// An event of a mission: a message to the operator or, if only the journal is available, a record of the journal.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Happened<'a> {
    Told(&'a Progress),
    Recorded(&'a Record),
}

/// An act of a past mission that has ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EndedAct<'a> {
    pub(crate) report: &'a ActReport,
    pub(crate) fate: &'a ActFate,
    /// Whether the act was withdrawn (cancelled before its start) in order to be prepared again.
    pub(crate) again: bool,
}

/// The report of a past mission, as far as it is known.
#[derive(Debug, Serialize)]
pub struct HistoryReport<'a> {
    /// The scenario's name.
    pub scenario: Option<&'a str>,
    /// The outcome of the mission; `None` if its end is not known.
    pub outcome: Option<&'a Outcome>,
    /// The planned start of the first act; `None` if no act was sent.
    pub start: Option<Timestamp<Server>>,
    /// The largest spread of an act: the time between the starts of its first and its last robot. `None` if it is not known.
    #[serde(rename = "spread_ms")]
    pub spread: Option<Span>,
    /// The reports of the acts that have ended, without attempts that were withdrawn and repeated.
    pub acts: Vec<&'a ActReport>,
    /// The results of each robot over all acts, in the form of the report of `run`; empty for a journal, and if the recording lacks its
    /// end.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    pub robots: &'a [Value],
    /// The failures of robots, in order of time.
    pub failures: Vec<&'a Failure>,
}

impl History {
    /// The known part of the report: the name, the outcome and the reports of the acts that have ended.
    #[must_use]
    pub fn report(&self) -> HistoryReport<'_> {
        let acts: Vec<&ActReport> =
            self.ended_acts().filter(|act| !act.again).map(|act| act.report).collect();
        HistoryReport {
            scenario: self.scenario.as_deref(),
            outcome: self.outcome(),
            start: self.promises().next().map(|(_, promise)| promise.start),
            spread: acts.iter().filter_map(|act| act.spread).max(),
            acts,
            robots: self
                .ended_with
                .as_ref()
                .and_then(|report| report["robots"].as_array())
                .map_or(&[], Vec::as_slice),
            failures: self.failures(),
        }
    }

    /// The report as JSON for the page: the acts of the whole mission, and everything else that the mission itself reported at its end.
    pub(crate) fn whole_report(&self) -> Option<Value> {
        let mut report = serde_json::to_value(self.report()).ok()?;
        let known = report.as_object_mut()?;
        for (key, value) in self.ended_with.iter().filter_map(Value::as_object).flatten() {
            known.entry(key.clone()).or_insert_with(|| value.clone());
        }
        Some(report)
    }

    /// The error bound of a robot's clock in milliseconds, as the mission reported it, or else half of the shortest round trip. 0 if the
    /// file contains neither.
    pub(crate) fn clock_uncertainty(&self, robot: &str) -> f64 {
        let rows = self.ended_with.as_ref().and_then(|report| report["robots"].as_array());
        let row = rows.into_iter().flatten().find(|row| row["robot"] == robot);
        let reported = row.and_then(|row| row["clock"]["uncertainty_ms"].as_f64());
        let known = self.robots.iter().find(|known| known.id.as_str() == robot);
        let halves = known.into_iter().flat_map(|known| &known.clock).map(|(_, _, delay)| delay / 2.0);
        reported.or_else(|| halves.reduce(f64::min)).unwrap_or_default()
    }

    /// The time of the last entry of the file; `None` if the file has no entries.
    pub(crate) fn known_until(&self) -> Option<Timestamp<Server>> {
        let happened = self.told.iter().map(|(at, _)| *at).chain(self.records.iter().map(|(at, _)| *at));
        happened.chain(self.robots.iter().filter_map(|robot| robot.heard)).max()
    }

    /// The outcome of the mission; `None` if its end is not known.
    pub(crate) fn outcome(&self) -> Option<&Outcome> {
        self.records.iter().rev().find_map(|(_, record)| match record {
            Record::Ended { outcome } => Some(outcome),
            _ => None,
        })
    }

    /// Returns the acts that were promised (recorded before they were sent), each with the time of its record.
    pub(crate) fn promises(&self) -> impl Iterator<Item = (Timestamp<Server>, &Promise)> {
        self.records.iter().filter_map(|(at, record)| match record {
            Record::Prepared(promise) => Some((*at, promise)),
            _ => None,
        })
    }

    pub(crate) fn ended_acts(&self) -> impl DoubleEndedIterator<Item = EndedAct<'_>> {
        self.records.iter().filter_map(|(_, record)| match record {
            Record::ActEnded { report, over, again, .. } => {
                Some(EndedAct { report, fate: &over.fate, again: *again })
            }
            _ => None,
        })
    }

    /// All events of the mission, in order of time.
    pub(crate) fn happened(&self) -> impl Iterator<Item = (Timestamp<Server>, Happened<'_>)> {
        let told = self.told.iter().map(|(at, told)| (*at, Happened::Told(told)));
        let records = if self.told.is_empty() { &self.records[..] } else { &[] };
        told.chain(records.iter().map(|(at, record)| (*at, Happened::Recorded(record))))
    }

    /// Reads the intact part of a mission from its journal, its folder or a recording.
    ///
    /// # Errors
    /// [`NoHistory`] if nothing can be read.
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
            Err(Unreadable::OtherVersion { path, found }) => {
                Err(NoHistory::OtherVersion { path, found: Some(found) })
            }
        }
    }

    fn of_journal(records: journal::Records) -> Self {
        let robots = records.opened.robots;
        let cut_off = records.torn.map(|torn| match torn.whole_after {
            0 => format!("its last line, line {}, is incomplete", torn.line),
            1 => format!("line {} is damaged; 1 complete line after it is ignored", torn.line),
            whole => format!("line {} is damaged; {whole} complete lines after it are ignored", torn.line),
        });
        Self {
            scenario: records.opened.name,
            source: HistorySource::Journal,
            cut_off,
            records: records.all,
            told: Vec::new(),
            ended_with: None,
            robots: robots.into_iter().map(|robot| KnownRobot::new(robot.robot, robot.init)).collect(),
            routes: HashMap::new(),
        }
    }

    /// The failures of robots, in order of time.
    pub(crate) fn failures(&self) -> Vec<&Failure> {
        let failure = |(_, happened)| match happened {
            Happened::Told(Progress::Failed(failure)) | Happened::Recorded(Record::Failed(failure)) => {
                Some(failure)
            }
            _ => None,
        };
        self.happened().filter_map(failure).collect()
    }

    fn of_recording(bytes: &[u8], path: &Path) -> Result<Self, NoHistory> {
        let mut history = Self { source: HistorySource::Recording, ..Self::default() };
        match MessageStream::new_with_options(bytes, Options::ValidateChunkCrcs.into()) {
            Ok(messages) => match history.take_all(messages) {
                Ok(()) => {}
                Err(OtherVersion(found)) => {
                    return Err(NoHistory::OtherVersion { path: path.to_path_buf(), found });
                }
            },
            Err(error) => history.cut_off = Some(format!("nothing can be read: {error}")),
        }
        let empty = history.records.is_empty() && history.told.is_empty() && history.robots.is_empty();
        if empty && history.cut_off.is_none() {
            return Err(NoHistory::Unknown { path: path.to_path_buf() });
        }
        history.scenario = history.first_name();
        Ok(history)
    }

    /// Whether `path` is a folder, a journal or a recording. Inspects the first bytes of a file.
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

    /// Creates a history from `records`.
    #[cfg(test)]
    pub(crate) fn of_records(records: Vec<(Timestamp<Server>, Record)>) -> Self {
        Self { records, ..Self::default() }
    }

    /// Whether a device interpolates linearly between steps, according to the robot's description.
    pub(crate) fn is_linear(&self, robot: &str, device: &str) -> bool {
        let robot = self.robots.iter().find(|known| known.id.as_str() == robot);
        let mut devices = robot.into_iter().flat_map(|robot| &robot.init).flat_map(|init| &init.devices);
        devices.any(|known| known.id.as_str() == device && known.interpolation == Interpolation::Linear)
    }

    /// The steps of a request to a device in order of time, each with its value and its control type. Only recordings contain steps.
    pub(crate) fn steps_of(
        &self,
        robot: &str,
        device: &str,
        request: &str,
    ) -> Vec<(Timestamp<Server>, f64, ControlType)> {
        let robot = self.robots.iter().find(|known| known.id.as_str() == robot);
        let key = (device.to_owned(), request.to_owned());
        let steps = robot.and_then(|robot| robot.planned.get(&key)).into_iter().flatten();
        let mut steps: Vec<_> = steps.map(|step| (step.due, step.value, step.control_type)).collect();
        // Repeated messages are recorded repeatedly.
        steps.sort_by_key(|(due, ..)| *due);
        steps.dedup();
        steps
    }

    /// Whether no data of a mission could be read.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.records.is_empty() && self.told.is_empty()
    }

    /// Reads messages up to the first unreadable message.
    fn take_all(&mut self, messages: MessageStream<'_>) -> Result<(), OtherVersion> {
        for (count, message) in messages.enumerate() {
            let taken = match message {
                Ok(message) if is_ours(&message) => {
                    let version = version_of(&message);
                    if version != Some(VERSION) {
                        return Err(OtherVersion(version));
                    }
                    self.take(&message)
                }
                Ok(_) => Ok(()),
                Err(error) => Err(error.to_string()),
            };
            if let Err(error) = taken {
                self.cut_off = Some(format!("after {count} messages: {error}"));
                break;
            }
        }
        Ok(())
    }

    /// Determines the scenario's name from the first request id: the part before the first `@` or `/`. `None` if no script was promised.
    fn first_name(&self) -> Option<String> {
        let id = self.promises().next()?.1.scripts.first()?.request_id.as_str();
        Some(id.split(['@', '/']).next()?.to_owned())
    }

    fn take(&mut self, message: &mcap::Message<'_>) -> Result<(), String> {
        let topic = message.channel.topic.as_str();
        let at = Timestamp::from_nanos(i64::try_from(message.log_time).unwrap_or(i64::MAX));
        let damaged = |error| format!("a message on {topic} is damaged: {error}");
        match topic {
            "/mission/decisions" => {
                self.records.push((at, serde_json::from_slice(&message.data).map_err(damaged)?));
            }
            "/mission/progress" => {
                self.told.push((at, serde_json::from_slice(&message.data).map_err(damaged)?));
            }
            "/mission/report" => {
                self.ended_with = Some(serde_json::from_slice(&message.data).map_err(damaged)?)
            }
            topic => self.take_of_robot(topic, at, &message.data).map_err(damaged)?,
        }
        Ok(())
    }

    fn take_of_robot(
        &mut self,
        topic: &str,
        at: Timestamp<Server>,
        data: &[u8],
    ) -> Result<(), serde_json::Error> {
        if !self.routes.contains_key(topic) {
            let route = self.route(topic);
            self.routes.insert(topic.to_owned(), route);
        }
        let Some(Route { robot, device, kind }) = self.routes.get(topic).and_then(Option::as_ref) else {
            return Ok(());
        };
        let robot = &mut self.robots[*robot];
        match kind {
            TopicKind::Request => robot.is_asked(at, &serde_json::from_slice(data)?),
            TopicKind::Response => robot.says(at, serde_json::from_slice(data)?),
            TopicKind::Clock => {
                let ClockOffset { offset, delay } = serde_json::from_slice(data)?;
                robot.clock.push((at, offset.as_millis_f64(), delay.as_millis_f64()));
            }
            TopicKind::Planned => robot.plans(device.clone(), at, serde_json::from_slice(data)?),
            TopicKind::Reported => {
                let reported: ReportedValue = serde_json::from_slice(data)?;
                robot.reported.entry(device.clone()).or_default().push((at, reported.value));
                if reported.status == Status::Provide {
                    robot.readings.entry(device.clone()).or_default().push((at, reported.value));
                }
            }
        }
        Ok(())
    }

    fn route(&mut self, topic: &str) -> Option<Route> {
        let (of_robot, kind) = topic.strip_prefix("/robots/")?.rsplit_once('/')?;
        let (kind, id) = match kind {
            "requests" => (TopicKind::Request, of_robot),
            "responses" => (TopicKind::Response, of_robot),
            "clock" => (TopicKind::Clock, of_robot),
            "planned" => (TopicKind::Planned, self.named(of_robot)),
            "reported" => (TopicKind::Reported, self.named(of_robot)),
            _ => return None,
        };
        let device = of_robot.get(id.len() + 1..).unwrap_or_default().to_owned();
        let robot = self.robot(id.parse().ok()?);
        Some(Route { robot, device, kind })
    }

    /// Determines which part of a topic is the robot id. Ids may contain slashes, so this takes the longest id of a known robot that the
    /// topic begins with. The robot is usually known, because its own messages precede those of its devices.
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
        let (heard, late) = (None, BTreeMap::new());
        Self { id, init, planned, reported, clock, exchanges, open, heard, readings, late }
    }

    /// Stores the send time of a request if the robot may answer it with timestamps.
    fn is_asked(&mut self, at: Timestamp<Server>, request: &Message) {
        let question = match request {
            Message::AvailabilityRequest(request) => (Question::Availability, request.timestamp),
            Message::Inquiry(inquiry) => (Question::Inquiry, inquiry.timestamp),
            _ => return,
        };
        if let (kind, Some(own)) = question {
            self.open.entry((kind, own)).or_default().push_back(at);
        }
    }

    /// Stores a robot's description, or evaluates an answer with timestamps.
    fn says(&mut self, at: Timestamp<Server>, response: Message) {
        self.heard = self.heard.max(Some(at));
        match response {
            Message::ControlResponse(answer) => {
                if let Some(request) = answer.request_id {
                    self.is_late(at, &request, answer.late_steps, answer.late_ms_max);
                }
            }
            Message::AvailabilityResponse(answer) => {
                let own = answer.originate_timestamp;
                self.answers(Question::Availability, own, answer.receive_timestamp, answer.timestamp, at);
            }
            Message::InquiryResponse(answer) => {
                for request in answer.requests {
                    self.is_late(at, &request.request_id, request.late_steps, request.late_ms_max);
                }
                let own = answer.originate_timestamp;
                self.answers(Question::Inquiry, own, answer.receive_timestamp, answer.timestamp, at);
            }
            Message::InitializationBlock(block) => self.init = Some(block),
            _ => {}
        }
    }

    /// Stores how many steps of a request were late. `None` if the robot does not report it.
    fn is_late(
        &mut self,
        at: Timestamp<Server>,
        request: &RequestId,
        steps: Option<u32>,
        most: Option<Millis>,
    ) {
        if let Some(steps) = steps {
            let name = promised_name(request.as_str()).to_owned();
            self.late.entry(name).or_default().report(at, steps, most.map(Millis::span));
        }
    }

    /// Pairs an answer with its question. The send time is the timestamp in the question or, if it was recorded more than `NOTED_WITHIN`
    /// later, the time of the record minus `NOTED_WITHIN`.
    fn answers(
        &mut self,
        question: Question,
        own: Option<Timestamp<Server>>,
        robot_received: Timestamp<Robot>,
        robot_sent: Timestamp<Robot>,
        received: Timestamp<Server>,
    ) {
        let Some(own) = own else { return };
        let Entry::Occupied(mut open) = self.open.entry((question, own)) else { return };
        let sent = open.get_mut().pop_front().map(|noted| own.max(noted + -NOTED_WITHIN));
        if open.get().is_empty() {
            open.remove();
        }
        let exchange = |sent| Exchange { sent, robot_received, robot_sent, received };
        self.exchanges.extend(sent.map(exchange));
    }

    fn plans(&mut self, device: String, due: Timestamp<Server>, step: PlannedValue) {
        let request = step.request_id.as_ref().map_or("", RequestId::as_str);
        let request = promised_name(request).to_owned();
        let PlannedValue { value, control_type, .. } = step;
        self.planned.entry((device, request)).or_default().push(PlannedStep { due, value, control_type });
    }
}

/// Whether the message belongs to a topic of Downbeat.
fn is_ours(message: &mcap::Message<'_>) -> bool {
    ["/mission/", "/robots/"].iter().any(|prefix| message.channel.topic.starts_with(prefix))
}

/// The version in a recording's metadata; `None` if the metadata states none.
fn version_of(message: &mcap::Message<'_>) -> Option<u32> {
    message.channel.metadata.get(VERSION_KEY)?.parse().ok()
}

/// The error that a recording has an unsupported version. Contains that version; `None` if the recording states none.
struct OtherVersion(Option<u32>);

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes a recording with `metadata` and a single record: the end of a mission.
    fn recording(path: &Path, metadata: &BTreeMap<String, String>) {
        let mut writer = mcap::Writer::new(std::fs::File::create(path).unwrap()).unwrap();
        let channel_id = writer.add_channel(0, "/mission/decisions", "json", metadata).unwrap();
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        let record = serde_json::to_vec(&Record::Ended { outcome: Outcome::Done }).unwrap();
        writer.write_to_known_channel(&header, &record).unwrap();
        writer.finish().unwrap();
    }

    #[test]
    fn recording_of_another_version_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("show.mcap");
        let version = |version: u32| [(VERSION_KEY.to_owned(), version.to_string())].into();
        recording(&path, &version(VERSION));
        assert_eq!(History::read(&path).unwrap().outcome(), Some(&Outcome::Done));
        for (metadata, version) in [(version(VERSION + 1), Some(VERSION + 1)), (BTreeMap::new(), None)] {
            recording(&path, &metadata);
            let error = History::read(&path).unwrap_err();
            assert!(matches!(error, NoHistory::OtherVersion { found, .. } if found == version), "{error}");
        }
    }

    #[test]
    fn script_resent_under_another_name_is_planned_once() {
        let mut robot = KnownRobot::new("r".parse().unwrap(), None);
        for name in ["s/1/0/0/0", "s/1/0/0/0+1", "s/1/0/0/0+2"] {
            let request_id = Some(name.parse().unwrap());
            let step = PlannedValue { value: 1.0, control_type: ControlType::Position, request_id };
            robot.plans("d".to_owned(), Timestamp::from_nanos(5), step);
        }
        let planned: Vec<_> = robot.planned.into_keys().collect();
        assert_eq!(planned, [("d".to_owned(), "s/1/0/0/0".to_owned())]);
    }
}
