//! Reads recordings of ROS in the format MCAP: the positions of all topics of type `sensor_msgs/JointState`, in CDR (ROS 2) or in the
//! encoding of ROS 1.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::Read;

use mcap::records::{ChunkHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use urrcp::Span;

use downbeat_yaml::finding::{Code, names};
use downbeat_yaml::render::counted;

use super::input::Input;
use super::malformed::Malformed;
use super::sink::Sink;
use super::units::OF_JOINTS;
use super::{DeviceMotion, Keyframe, Motion, RobotMotion, keyframes};

const SCHEMAS: [&str; 2] = ["sensor_msgs/msg/JointState", "sensor_msgs/JointState"];
/// Maximum unpacked size of a chunk and of all chunks, and maximum window of their compression, in bytes.
const CHUNK_BYTES_MAX: u64 = 32 << 20;
const ALL_BYTES_MAX: u64 = 512 << 20;
const WINDOW_MAX: u64 = 8 << 20;
/// Maximum number of joints of a message, and maximum length of a joint's name in bytes.
const JOINTS_MAX: usize = 1_000;
const NAME_BYTES_MAX: usize = 1_024;
/// Maximum number of topics of a recording.
const TOPICS_MAX: usize = 10_000;

/// The encoding of a message.
#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Cdr,
    Ros1,
}

/// The recorded positions of one topic.
struct Topic {
    name: String,
    encoding: Encoding,
    joints: Vec<String>,
    by_name: HashMap<String, usize>,
    /// For each joint, its positions with their times in nanoseconds.
    positions: Vec<Vec<(u64, f64)>>,
    empty: usize,
    unstamped: usize,
}

#[derive(Default)]
struct Recording {
    schemas: HashMap<u16, String>,
    topics: BTreeMap<u16, Topic>,
    others: BTreeSet<String>,
    count: usize,
    left: u64,
    more: bool,
}

/// Reads one file, which contains one robot per topic, in one scene.
pub(super) fn read(input: &Input, name: &str, bytes: &[u8], sink: &mut Sink) -> Vec<Motion> {
    let mut recording = Recording { left: ALL_BYTES_MAX, ..Recording::default() };
    if let Err(fault) = recording.read(bytes, sink) {
        sink.about(name, Code::Unreadable, fault.to_string(), "an MCAP recording", None);
        return Vec::new();
    }
    let mut topics: Vec<Topic> = recording.topics.into_values().collect();
    topics.retain(|topic| topic.positions.iter().any(|positions| !positions.is_empty()));
    if topics.is_empty() {
        let others = names(recording.others.iter().take(12).map(String::as_str));
        let expected = "a topic of sensor_msgs/JointState, as CDR or ROS 1, with positions";
        let hint = Some(format!("it contains {others}")).filter(|_| !others.is_empty());
        sink.about(
            name,
            Code::NothingToDo,
            "the recording contains no joint positions".into(),
            expected,
            hint.as_deref(),
        );
        return Vec::new();
    }
    if !recording.others.is_empty() {
        let others = names(recording.others.iter().take(12).map(String::as_str));
        let count = downbeat_yaml::render::counted(recording.others.len(), "other topic");
        sink.note(format!("{name}: left out {count}: {others}"));
    }
    let first = topics.iter().flat_map(Topic::times).min().unwrap_or(0);
    sink.note(format!(
        "{name}: times are counted from the first message; velocities and efforts are ignored"
    ));
    let single = topics.len() == 1;
    let mut motions = Vec::new();
    for topic in topics {
        let robot = if single { input.robot.clone() } else { topic.name.trim_start_matches('/').to_owned() };
        let devices = topic.devices(first, name, sink);
        motions.push(Motion { scene: input.scene.clone(), robot: RobotMotion { robot, devices } });
    }
    motions
}

/// Passes all records that concern messages to `take`. Other records are not parsed, because the library panics on some invalid ones.
fn records(
    mut bytes: &[u8],
    options: LinearReaderOptions,
    mut take: impl FnMut(Record<'_>) -> Result<(), Malformed>,
) -> Result<(), Malformed> {
    // Without this limit, the library uses any length that a record states.
    let mut reader = LinearReader::new_with_options(options.with_record_length_limit(bytes.len()));
    while let Some(event) = reader.next_event() {
        match event.map_err(|error| error.to_string())? {
            LinearReadEvent::ReadRequest(wanted) => {
                let (now, rest) = bytes.split_at(wanted.min(bytes.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                bytes = rest;
            }
            LinearReadEvent::Record { data, opcode } => {
                if matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK) {
                    take(mcap::parse_record(opcode, data).map_err(|error| error.to_string())?)?;
                }
            }
        }
    }
    Ok(())
}

impl Recording {
    fn read(&mut self, bytes: &[u8], sink: &mut Sink) -> Result<(), Malformed> {
        let options = LinearReaderOptions::default().with_emit_chunks(true);
        records(bytes, options, |record| {
            match record {
                Record::Chunk { header, data } => self.chunk(&header, &data, sink)?,
                other => self.record(other, sink)?,
            }
            if self.more {
                Err("the limit of 2000000 positions is exceeded; split the recording".into())
            } else {
                Ok(())
            }
        })
        .map_err(|error| format!("the recording cannot be read: {error}").into())
    }

    fn chunk(&mut self, header: &ChunkHeader, data: &[u8], sink: &mut Sink) -> Result<(), Malformed> {
        let most = CHUNK_BYTES_MAX.min(self.left);
        let plain = match header.compression.as_str() {
            "" => data.to_vec(),
            "zstd" => unpacked(zstd(data)?, most)?,
            "lz4" => unpacked(lz4_flex::frame::FrameDecoder::new(data), most)?,
            other => {
                return Err(format!(
                    "the chunk compression {other} is not supported; convert the recording with `mcap recover --compression zstd`"
                ).into());
            }
        };
        if plain.len() as u64 > most {
            return Err(format!("an unpacked chunk has more than {most} bytes").into());
        }
        self.left -= plain.len() as u64;
        let options = LinearReaderOptions::default().with_skip_start_magic(true).with_skip_end_magic(true);
        records(&plain, options, |record| if self.more { Ok(()) } else { self.record(record, sink) })
            .map_err(|error| format!("in a chunk: {error}").into())
    }

    fn record(&mut self, record: Record<'_>, sink: &Sink) -> Result<(), Malformed> {
        match record {
            Record::Schema { header, .. } => drop(self.schemas.insert(header.id, header.name)),
            Record::Channel(channel) => self.channel(channel)?,
            Record::Message { header, data } => {
                if let Some(topic) = self.topics.get_mut(&header.channel_id) {
                    self.count += topic.message(&data, header.log_time)?;
                    self.more = !sink.has_room_for(self.count as f64);
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn channel(&mut self, channel: mcap::records::Channel) -> Result<(), Malformed> {
        let schema = self.schemas.get(&channel.schema_id).map_or("", String::as_str);
        let encoding = match channel.message_encoding.as_str() {
            "cdr" => Some(Encoding::Cdr),
            "ros1" => Some(Encoding::Ros1),
            _ => None,
        };
        if self.topics.len() + self.others.len() >= TOPICS_MAX {
            return Err(format!("the recording has more than {TOPICS_MAX} topics").into());
        }
        match encoding.filter(|_| SCHEMAS.contains(&schema)) {
            None => drop(self.others.insert(channel.topic)),
            Some(encoding) => {
                let topic = || Topic {
                    name: channel.topic.clone(),
                    encoding,
                    joints: Vec::new(),
                    by_name: HashMap::new(),
                    positions: Vec::new(),
                    empty: 0,
                    unstamped: 0,
                };
                self.topics.entry(channel.id).or_insert_with(topic);
            }
        }
        Ok(())
    }
}

/// Returns a reader that unpacks a compressed chunk.
fn zstd(data: &[u8]) -> Result<impl Read, Malformed> {
    let decoder = ruzstd::decoding::StreamingDecoder::new_with_max_window_size(data, WINDOW_MAX);
    decoder.map_err(|error| format!("a chunk cannot be unpacked: {error}").into())
}

fn unpacked(packed: impl Read, most: u64) -> Result<Vec<u8>, Malformed> {
    let mut plain = Vec::new();
    let read = packed.take(most + 1).read_to_end(&mut plain);
    read.map_err(|error| format!("a chunk cannot be unpacked: {error}"))?;
    Ok(plain)
}

impl Topic {
    fn times(&self) -> impl Iterator<Item = u64> {
        self.positions.iter().flatten().map(|(at_ns, _)| *at_ns)
    }

    /// Adds a message, and returns the number of positions that it contains.
    fn message(&mut self, data: &[u8], log_time: u64) -> Result<usize, Malformed> {
        let state = JointState::read(data, self.encoding)
            .map_err(|error| format!("a message of `{}`: {error}", self.name))?;
        if state.positions.is_empty() {
            self.empty += 1;
            return Ok(0);
        }
        if state.positions.len() != state.names.len() {
            let (names, positions) = (state.names.len(), state.positions.len());
            return Err(format!(
                "a message of `{}` has {} for {}",
                self.name,
                counted(positions, "position"),
                counted(names, "joint")
            )
            .into());
        }
        self.unstamped += usize::from(state.stamp == 0);
        let at_ns = if state.stamp == 0 { log_time } else { state.stamp };
        let count = state.positions.len();
        for (name, value) in state.names.into_iter().zip(state.positions) {
            if !value.is_finite() {
                return Err(format!(
                    "a message of `{}` has the invalid position {value} for the joint `{}`",
                    self.name,
                    downbeat_yaml::shown::shortened(&name)
                )
                .into());
            }
            let joint = match self.by_name.get(&name) {
                Some(joint) => *joint,
                None => self.join(name)?,
            };
            self.positions[joint].push((at_ns, value + 0.0));
        }
        Ok(count)
    }

    fn join(&mut self, name: String) -> Result<usize, Malformed> {
        if self.joints.len() == JOINTS_MAX {
            return Err(format!("`{}` has more than {JOINTS_MAX} joints", self.name).into());
        }
        self.by_name.insert(name.clone(), self.joints.len());
        self.joints.push(name);
        self.positions.push(Vec::new());
        Ok(self.joints.len() - 1)
    }

    fn devices(self, first: u64, file: &str, sink: &mut Sink) -> Vec<DeviceMotion> {
        let topic = &self.name;
        let mut replaced = 0_usize;
        let mut devices = Vec::new();
        for (joint, mut positions) in self.joints.into_iter().zip(self.positions) {
            positions.sort_by_key(|(at_ns, _)| *at_ns);
            let mut keyframes: Vec<Keyframe> = Vec::with_capacity(positions.len());
            for (at_ns, value) in positions {
                let at = Span::from_nanos(i64::try_from(at_ns - first).unwrap_or(i64::MAX));
                match keyframes.last_mut().filter(|last| last.at == at) {
                    Some(last) => {
                        replaced += 1;
                        last.value = value;
                    }
                    None => keyframes.push(Keyframe { at, value }),
                }
            }
            if keyframes.last().is_some_and(|last| keyframes::seconds(last.at) > keyframes::SECONDS_MAX) {
                let message = format!("`{topic}` lasts longer than {} s", keyframes::SECONDS_MAX);
                sink.about(file, Code::ImportTime, message, "timestamps of a single recording", None);
            }
            devices.push(DeviceMotion {
                device: joint,
                unit: OF_JOINTS.to_owned(),
                keyframes,
                ..DeviceMotion::default()
            });
        }
        if replaced > 0 {
            let positions = counted(replaced, "position");
            let later = if replaced == 1 { "a later one" } else { "later ones" };
            sink.note(format!(
                "{file}: `{topic}`: left out {positions}, replaced by {later} at the same time"
            ));
        }
        if self.empty > 0 {
            let messages = counted(self.empty, "message");
            sink.note(format!("{file}: `{topic}`: left out {messages} without positions"));
        }
        if self.unstamped > 0 {
            let messages = counted(self.unstamped, "message");
            sink.note(format!(
                "{file}: `{topic}`: {messages} without a timestamp, so the time of recording is used instead"
            ));
        }
        devices
    }
}

/// The parts of a message that the import uses.
struct JointState {
    /// The timestamp in nanoseconds; 0 if the message has none.
    stamp: u64,
    names: Vec<String>,
    positions: Vec<f64>,
}

impl JointState {
    fn read(data: &[u8], encoding: Encoding) -> Result<Self, Malformed> {
        let mut bytes = match encoding {
            Encoding::Ros1 => Bytes { data, at: 0, big: false, aligned: false },
            Encoding::Cdr => {
                let body = data.get(4..).ok_or("the message ends within its header")?;
                match data[1] {
                    kind @ (0 | 1) if data[0] == 0 => {
                        Bytes { data: body, at: 0, big: kind == 0, aligned: true }
                    }
                    kind => return Err(format!("unknown CDR encoding {kind}").into()),
                }
            }
        };
        if encoding == Encoding::Ros1 {
            // Skips the sequence number.
            bytes.u32()?;
        }
        let (seconds, nanos) = (bytes.u32()?, bytes.u32()?);
        bytes.text()?;
        let count = bytes.count(JOINTS_MAX)?;
        let names = (0..count).map(|_| bytes.text()).collect::<Result<_, _>>()?;
        let count = bytes.count(JOINTS_MAX)?;
        let positions = (0..count).map(|_| bytes.f64()).collect::<Result<_, _>>()?;
        Ok(Self { stamp: u64::from(seconds) * 1_000_000_000 + u64::from(nanos), names, positions })
    }
}

/// A reader of consecutive numbers and texts. In CDR, each number is aligned to its size.
struct Bytes<'a> {
    data: &'a [u8],
    at: usize,
    big: bool,
    aligned: bool,
}

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        if self.aligned {
            self.at = self.at.next_multiple_of(N);
        }
        let part = self.data.get(self.at..self.at + N).and_then(|part| <[u8; N]>::try_from(part).ok());
        self.at += N;
        let mut part = part.ok_or_else(|| "the message ends too early".to_owned())?;
        if self.big {
            part.reverse();
        }
        Ok(part)
    }

    fn u32(&mut self) -> Result<u32, Malformed> {
        self.take().map(u32::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, Malformed> {
        self.take().map(f64::from_le_bytes)
    }

    fn count(&mut self, most: usize) -> Result<usize, Malformed> {
        let count = self.u32()? as usize;
        if count > most { Err(format!("{count} entries, but the limit is {most}").into()) } else { Ok(count) }
    }

    fn text(&mut self) -> Result<String, Malformed> {
        let length = self.count(NAME_BYTES_MAX)?;
        let part =
            self.data.get(self.at..self.at + length).ok_or("the message ends in the middle of a text")?;
        self.at += length;
        let part = part.strip_suffix(&[0]).unwrap_or(part);
        String::from_utf8(part.to_vec()).map_err(|_| "a name is not valid UTF-8".into())
    }
}
