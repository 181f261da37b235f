//! Records a mission in an MCAP file, which Foxglove and other programs can open: requests and responses, planned and reported values,
//! clock offsets, decisions. All messages are JSON; `docs/recording.md` lists the topics.

mod recorder;

use std::collections::HashMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use downbeat_scripts::{Attempt, Refusal};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use urrcp::{
    Command, ControlRequest, ControlResponse, ControlType, Message, RequestId, RobotId, Server, Span, Status,
    StatusValue, Timestamp,
};

use crate::journal::VERSION;
use downbeat_mission::clock::ClockSample;
use downbeat_mission::session;
use downbeat_mission::{Progress, Record};

pub use recorder::Recorder;

/// The error for a recording that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the recording {}: {}", path.display(), why(path, error))]
pub struct RecordingError {
    /// The path of the recording.
    pub path: PathBuf,
    /// The error of the MCAP writer, or of the operating system below it.
    pub error: McapError,
}

impl RecordingError {
    /// Returns the reason of the failure, without the path of the file.
    #[must_use]
    pub fn reason(&self) -> String {
        reason(&self.error)
    }
}

/// Returns the reason of the failure. For an error of the operating system, also returns what to do about it.
fn why(path: &Path, error: &McapError) -> String {
    match error {
        McapError::Io(error) => Refusal::of(Attempt::Write(path), error).to_string(),
        other => other.to_string(),
    }
}

/// Returns the error message of the operating system or of the MCAP writer.
fn reason(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        other => other.to_string(),
    }
}

/// Interval between flushes to the file. If the process is killed, the file lacks at most the messages of this time.
const FLUSH_EVERY: Span = Span::from_millis(1_000);

/// A recording file that is being written.
pub struct Recording {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: HashMap<String, u16>,
    sequence: u32,
    /// When the written data was last flushed to the file.
    flushed: Timestamp<Server>,
    /// The first failure, or `None`. Nothing is written after a failure.
    failed: Option<McapError>,
}

impl std::fmt::Debug for Recording {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recording").field("path", &self.path).finish_non_exhaustive()
    }
}

/// The kind of a topic. It determines the JSON Schema of the topic's messages.
#[derive(Clone, Copy)]
enum TopicKind {
    Message,
    Value,
    Clock,
    Record,
    Progress,
}

impl TopicKind {
    const fn name(self) -> &'static str {
        match self {
            Self::Message => "urrcp.Message",
            Self::Value => "downbeat.Value",
            Self::Clock => "downbeat.Clock",
            Self::Record => "downbeat.Record",
            Self::Progress => "downbeat.Progress",
        }
    }

    fn schema(self) -> Value {
        match self {
            Self::Message => json!({"type": "object", "minProperties": 1, "maxProperties": 1}),
            Self::Value => json!({"type": "object", "properties": {
                "value": {"type": "number"}, "control_type": {"type": "string"},
                "request_id": {"type": "string"}, "status": {"type": "string"}}}),
            Self::Clock => json!({"type": "object", "properties": {
                "offset_ms": {"type": "number"}, "delay_ms": {"type": "number"}}}),
            Self::Record => json!({"type": "object", "properties": {"record": {"type": "string"}}}),
            Self::Progress => json!({"type": "object", "properties": {"progress": {"type": "string"}}}),
        }
    }
}

/// The key of a channel's metadata that contains the [version](crate::journal::VERSION) of the recording.
pub const VERSION_KEY: &str = "downbeat_version";

/// A planned value of a script. The message's timestamp is the time at which the value is due.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedValue {
    /// The value in the device's unit.
    pub value: f64,
    /// The control type of the value, such as a position or a speed.
    pub control_type: ControlType,
    /// The id of the request that contained the script. `None` if the request has no id.
    pub request_id: Option<RequestId>,
}

/// A value that a robot reported for a device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReportedValue {
    /// The value in the device's unit.
    pub value: f64,
    /// The status in the robot's response. It is `Provide` if the value is a sensor reading.
    pub status: Status,
    /// The id of the request that the robot responded to. `None` if the response contains no id.
    pub request_id: Option<RequestId>,
}

/// A measurement of a robot's clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockOffset {
    /// Robot time minus server time.
    #[serde(rename = "offset_ms")]
    pub offset: Span,
    /// Round-trip time of the measurement, without the robot's processing time.
    #[serde(rename = "delay_ms")]
    pub delay: Span,
}

impl Recording {
    /// Creates the recording file.
    ///
    /// # Errors
    /// Returns [`RecordingError`] if the file cannot be written.
    pub fn create(path: &Path) -> Result<Self, RecordingError> {
        let open = || -> Result<_, McapError> {
            let file = BufWriter::new(File::create(path)?);
            let options = WriteOptions::new().compression(None).profile("").library("downbeat");
            Writer::with_options(file, options)
        };
        match open() {
            Ok(writer) => Ok(Self {
                path: path.to_path_buf(),
                writer,
                channels: HashMap::new(),
                sequence: 0,
                flushed: Timestamp::from_nanos(0),
                failed: None,
            }),
            Err(error) => Err(RecordingError { path: path.to_path_buf(), error }),
        }
    }

    /// Records a message sent to a robot. The key of the session is omitted from the message.
    pub fn sent(&mut self, at: Timestamp<Server>, robot: &RobotId, message: Message) {
        let message = session::without_key(message);
        self.put(&format!("/robots/{robot}/requests"), TopicKind::Message, at, at, &message);
        if let Message::ControlRequest(request) = &message {
            self.planned(at, robot, request);
        }
    }

    /// Records the values of a script, each at the time at which it is due.
    fn planned(&mut self, at: Timestamp<Server>, robot: &RobotId, request: &ControlRequest) {
        let (Command::Script(script), Some(start)) = (&request.command, request.starts_at()) else { return };
        let topic = format!("/robots/{robot}/{}/planned", request.device_id);
        for step in script.steps() {
            let value = PlannedValue {
                value: step.setpoint.value,
                control_type: step.setpoint.control_type,
                request_id: request.request_id.clone(),
            };
            self.put(&topic, TopicKind::Value, start + step.offset.span(), at, &value);
        }
    }

    /// Records a message received from a robot.
    pub fn received(&mut self, at: Timestamp<Server>, robot: &RobotId, message: &Message) {
        self.put(&format!("/robots/{robot}/responses"), TopicKind::Message, at, at, message);
        match message {
            Message::AvailabilityResponse(answer) => {
                let (sent, received) = (answer.originate_timestamp, answer.receive_timestamp);
                let sample =
                    sent.map(|sent| ClockSample::from_exchange(sent, received, answer.timestamp, at));
                self.clock(at, robot, sample);
            }
            Message::InquiryResponse(answer) => {
                let (sent, received) = (answer.originate_timestamp, answer.receive_timestamp);
                let sample =
                    sent.map(|sent| ClockSample::from_exchange(sent, received, answer.timestamp, at));
                self.clock(at, robot, sample);
            }
            Message::ControlResponse(response) => self.reported(at, robot, response),
            _ => {}
        }
    }

    /// Records a measurement of the robot's clock. `None` if the response does not state when its request was sent.
    fn clock(&mut self, at: Timestamp<Server>, robot: &RobotId, sample: Option<ClockSample>) {
        let Some(sample) = sample else { return };
        let value = ClockOffset { offset: sample.offset, delay: sample.delay };
        self.put(&format!("/robots/{robot}/clock"), TopicKind::Clock, at, at, &value);
    }

    fn reported(&mut self, at: Timestamp<Server>, robot: &RobotId, response: &ControlResponse) {
        let StatusValue::Number(value) = response.status_value else { return };
        let value =
            ReportedValue { value, status: response.status.clone(), request_id: response.request_id.clone() };
        self.put(
            &format!("/robots/{robot}/{}/reported", response.device_id),
            TopicKind::Value,
            at,
            at,
            &value,
        );
    }

    /// Records an entry that the mission writes to its journal.
    pub fn record(&mut self, at: Timestamp<Server>, record: &Record) {
        self.put("/mission/decisions", TopicKind::Record, at, at, record);
    }

    /// Records a progress report to the operator.
    pub fn progress(&mut self, at: Timestamp<Server>, progress: &Progress) {
        self.put("/mission/progress", TopicKind::Progress, at, at, progress);
    }

    fn put(
        &mut self,
        topic: &str,
        kind: TopicKind,
        log: Timestamp<Server>,
        published: Timestamp<Server>,
        value: &impl Serialize,
    ) {
        if self.failed.is_none()
            && let Err(error) = self.try_put(topic, kind, log, published, value)
        {
            tracing::error!("the recording ends here: {error}");
            self.failed = Some(error);
        }
    }

    fn try_put(
        &mut self,
        topic: &str,
        kind: TopicKind,
        log: Timestamp<Server>,
        published: Timestamp<Server>,
        value: &impl Serialize,
    ) -> Result<(), McapError> {
        let channel_id = match self.channels.get(topic) {
            Some(id) => *id,
            None => {
                let schema = kind.schema().to_string();
                let schema = self.writer.add_schema(kind.name(), "jsonschema", schema.as_bytes())?;
                let version = [(VERSION_KEY.to_owned(), VERSION.to_string())].into();
                let id = self.writer.add_channel(schema, topic, "json", &version)?;
                self.channels.insert(topic.to_owned(), id);
                id
            }
        };
        let data = serde_json::to_vec(value).map_err(std::io::Error::from)?;
        self.sequence = self.sequence.wrapping_add(1);
        let nanos = |at: Timestamp<Server>| u64::try_from(at.as_nanos()).unwrap_or(0);
        let header = MessageHeader {
            channel_id,
            sequence: self.sequence,
            log_time: nanos(log),
            publish_time: nanos(published),
        };
        self.writer.write_to_known_channel(&header, &data)?;
        // If the process is killed, only the last second is missing in the file.
        if published - self.flushed >= FLUSH_EVERY {
            self.flushed = published;
            self.writer.flush()?;
        }
        Ok(())
    }

    /// Writes the end of the file and closes it.
    ///
    /// # Errors
    /// Returns [`RecordingError`], also for an earlier failure.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        let failed = match self.failed.take() {
            Some(error) => Some(error),
            None => self.writer.finish().err(),
        };
        failed.map_or(Ok(()), |error| Err(RecordingError { path: self.path, error }))
    }
}
