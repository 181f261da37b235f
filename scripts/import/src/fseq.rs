//! Reads light sequences of xLights and Falcon Player, `.fseq` version 2. Each frame has one byte per channel.

use std::io::Read;

use urrcp::Span;

use downbeat_yaml::finding::Code;
use downbeat_yaml::shown::shortened;

use super::input::Input;
use super::malformed::Malformed;
use super::sink::Sink;
use super::{Course, DeviceMotion, ImportOptions, Keyframe, Motion, by_robot};

const HEADER: usize = 32;
/// Maximum window of a compressed block, and maximum total unpacked size, in bytes.
const WINDOW_MAX: u64 = 8 << 20;
const ALL_BYTES_MAX: u64 = 1 << 30;
/// Maximum number of channels that are mapped.
const CHANNELS_MAX: usize = 100_000;

/// The parts of a file's header that the import uses.
struct Header {
    data: usize,
    channels: usize,
    frames: usize,
    step_ms: i64,
    packed: Packed,
    blocks: Vec<usize>,
    /// The ranges of channels in each frame: the first channel, counted from 0, and the number of channels.
    ranges: Vec<(usize, usize)>,
    variables: Vec<String>,
}

impl Header {
    /// Returns the start time of a frame. Frames are counted from 0.
    fn begin(&self, frame: usize) -> Span {
        Span::from_millis(i64::try_from(frame).unwrap_or(i64::MAX).saturating_mul(self.step_ms))
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Packed {
    Plain,
    Zstd,
    Zlib,
}

/// A device to which channels are mapped, with the indices of its bytes in each frame.
struct Mapped {
    robot: String,
    motion: DeviceMotion,
    places: Vec<usize>,
    last: Vec<u8>,
}

/// Reads one file, which contains the motions of all mapped robots in one scene.
pub(super) fn read(
    input: &Input,
    name: &str,
    bytes: &[u8],
    options: &ImportOptions,
    sink: &mut Sink,
) -> Vec<Motion> {
    let read = read_header(bytes).map_err(|fault| (Code::Unreadable, fault)).and_then(|header| {
        let mut mapped = mapped(&header, input, options).map_err(|fault| (Code::ImportNames, fault))?;
        let frames =
            read_frames(bytes, &header, &mut mapped, sink).map_err(|fault| (Code::ImportShape, fault))?;
        Ok((header, mapped, frames))
    });
    match read {
        Ok((header, mapped, frames)) => {
            note(&header, &mapped, name, frames, sink);
            by_robot(&input.scene, mapped.into_iter().map(|mapped| (mapped.robot, mapped.motion)))
        }
        Err((code, fault)) => {
            let expected = "an xLights sequence (FSEQ version 2), with its channels mapped as in --map robot/device=1,2,3";
            sink.about(name, code, fault.to_string(), expected, None);
            Vec::new()
        }
    }
}

fn number(bytes: &[u8], at: usize, width: usize) -> Result<usize, Malformed> {
    let part = bytes
        .get(at..at + width)
        .ok_or_else(|| format!("unexpected end of the file at byte {}", bytes.len()))?;
    Ok(part.iter().rev().fold(0, |sum, byte| (sum << 8) | usize::from(*byte)))
}

fn read_header(bytes: &[u8]) -> Result<Header, Malformed> {
    match bytes.get(..4) {
        // The first versions of the format begin with FSEQ.
        Some(b"PSEQ" | b"FSEQ") => {}
        Some(b"ESEQ") => {
            return Err(
                "the file is an effect sequence (ESEQ) of one model: save the whole sequence as FSEQ".into(),
            );
        }
        Some(start) if start.starts_with(b"<") => {
            return Err(
                "the file is an xLights sequence that is not rendered (XML): import the rendered FSEQ file"
                    .into(),
            );
        }
        _ => return Err("this is not an FSEQ file: it does not begin with PSEQ".into()),
    }
    let (minor, major) = (number(bytes, 6, 1)?, number(bytes, 7, 1)?);
    if major != 2 {
        return Err(
            format!("version {major}.{minor} of FSEQ is not supported: save the file as version 2").into()
        );
    }
    let kind = number(bytes, 20, 1)?;
    let packed = match kind & 15 {
        0 => Packed::Plain,
        1 => Packed::Zstd,
        2 => Packed::Zlib,
        other => return Err(format!("unknown compression {other}").into()),
    };
    let blocks = ((kind >> 4) << 8) | number(bytes, 21, 1)?;
    let ranges = HEADER + 8 * blocks;
    let count = number(bytes, 22, 1)?;
    let block = |index: usize| number(bytes, HEADER + 8 * index + 4, 4);
    let range =
        |index: usize| Ok((number(bytes, ranges + 6 * index, 3)?, number(bytes, ranges + 6 * index + 3, 3)?));
    let header = Header {
        data: number(bytes, 4, 2)?,
        channels: number(bytes, 10, 4)?,
        frames: number(bytes, 14, 4)?,
        step_ms: number(bytes, 18, 1)? as i64,
        packed,
        blocks: (0..blocks).map(block).collect::<Result<_, Malformed>>()?,
        ranges: (0..count).map(range).collect::<Result<_, Malformed>>()?,
        variables: variables(bytes, ranges + 6 * count, number(bytes, 4, 2)?),
    };
    check(&header)?;
    Ok(header)
}

fn check(header: &Header) -> Result<(), Malformed> {
    let Header { channels, frames, step_ms, .. } = *header;
    if channels == 0 || frames == 0 || step_ms == 0 {
        return Err(
            format!("invalid header: {channels} channels, {frames} frames, {step_ms} ms per frame").into()
        );
    }
    let sum: usize = header.ranges.iter().map(|(_, count)| count).sum();
    if !header.ranges.is_empty() && sum != channels {
        return Err(
            format!("the channel ranges have {sum} channels in total, but the file has {channels}").into()
        );
    }
    if (frames as u64).saturating_mul(channels as u64) > ALL_BYTES_MAX {
        return Err(format!(
            "{frames} frames of {channels} channels exceed the limit of {ALL_BYTES_MAX} bytes"
        )
        .into());
    }
    Ok(())
}

/// Returns the two-letter names of the file's variable headers.
fn variables(bytes: &[u8], mut at: usize, end: usize) -> Vec<String> {
    let mut names = Vec::new();
    while at + 4 <= end.min(bytes.len()) && names.len() < 100 {
        let length = usize::from(bytes[at]) | usize::from(bytes[at + 1]) << 8;
        if length < 4 {
            break;
        }
        names.push(String::from_utf8_lossy(&bytes[at + 2..at + 4]).into_owned());
        at += length;
    }
    names
}

fn mapped(header: &Header, input: &Input, options: &ImportOptions) -> Result<Vec<Mapped>, Malformed> {
    if options.columns.is_empty() {
        return Err(format!("none of the {} channels is mapped to a device", header.channels).into());
    }
    let mut mapped = Vec::new();
    for (target, channels) in &options.columns {
        for (target, channels) in spread(target, channels)? {
            let (robot, device) = target.split_once('/').unwrap_or((&input.robot, &target));
            let places: Result<Vec<usize>, Malformed> =
                channels.iter().map(|channel| place(header, *channel)).collect();
            let course = if channels.len() == 1 { Course::Held } else { Course::Several(Vec::new()) };
            let motion = DeviceMotion { device: device.to_owned(), course, ..DeviceMotion::default() };
            mapped.push(Mapped { robot: robot.to_owned(), motion, places: places?, last: Vec::new() });
        }
    }
    let all: usize = mapped.iter().map(|mapped| mapped.places.len()).sum();
    if all > CHANNELS_MAX {
        return Err(format!("{all} channels are mapped, but the limit is {CHANNELS_MAX}").into());
    }
    Ok(mapped)
}

/// Expands a target and its channels: `lamp=1,2,3` remains unchanged; `px*=1-300/3` becomes `px1=1,2,3`, `px2=4,5,6` and so on.
fn spread(target: &str, channels: &str) -> Result<Vec<(String, Vec<usize>)>, Malformed> {
    let wrong = || {
        Malformed::from(format!(
            "`{}` is not a list of channels: write 1,2,3, or, if the device name contains a star, a range such as 1-300/3",
            shortened(channels)
        ))
    };
    let number =
        |text: &str| text.trim().parse::<usize>().ok().filter(|number| *number > 0).ok_or_else(wrong);
    if !target.contains('*') {
        let channels: Result<Vec<usize>, Malformed> = channels.split(',').map(number).collect();
        return Ok(vec![(target.to_owned(), channels?)]);
    }
    let (range, width) = channels
        .replace('*', "")
        .split_once('/')
        .map(|(range, width)| (range.to_owned(), number(width)))
        .ok_or_else(wrong)?;
    let (first, last) = range.split_once('-').ok_or_else(wrong)?;
    let (first, last, width) = (number(first)?, number(last)?, width?);
    if last < first || last - first >= CHANNELS_MAX || (last - first + 1) % width != 0 {
        return Err(format!(
            "channels {first} to {last} cannot be divided evenly into devices of {width} channels"
        )
        .into());
    }
    let device = |index: usize| {
        let from = first + index * width;
        (target.replace('*', &(index + 1).to_string()), (from..from + width).collect())
    };
    Ok((0..(last - first + 1) / width).map(device).collect())
}

/// Returns the index of the byte that a channel has in each frame. Channels are counted from 1.
fn place(header: &Header, channel: usize) -> Result<usize, Malformed> {
    let mut before = 0;
    for (first, count) in &header.ranges {
        if (first + 1..=first + count).contains(&channel) {
            return Ok(before + channel - 1 - first);
        }
        before += count;
    }
    let whole = header.ranges.is_empty() && channel <= header.channels;
    if whole { Ok(channel - 1) } else { Err(format!("the file has no channel {channel}").into()) }
}

fn read_frames(
    bytes: &[u8],
    header: &Header,
    mapped: &mut [Mapped],
    sink: &mut Sink,
) -> Result<usize, Malformed> {
    let data = bytes.get(header.data..).ok_or("the file ends before the frame data")?;
    let mut frames = Frames { header, mapped, index: 0, partial: Vec::new(), sink };
    if header.packed == Packed::Plain {
        frames.feed(data)?;
        return frames.finish();
    }
    let mut at = 0_usize;
    for length in header.blocks.iter().filter(|length| **length > 0) {
        let end = at.saturating_add(*length);
        let block = data.get(at..end).ok_or_else(|| {
            format!("the file ends within a block that should end at byte {}", header.data + end)
        })?;
        at = end;
        match header.packed {
            Packed::Zstd => {
                let decoder = ruzstd::decoding::StreamingDecoder::new_with_max_window_size(block, WINDOW_MAX);
                frames.unpack(decoder.map_err(|error| format!("a block cannot be unpacked: {error}"))?)?;
            }
            _ => frames.unpack(flate2::read::ZlibDecoder::new(block))?,
        }
    }
    frames.finish()
}

/// Assembles frames from data that arrive in pieces of any size.
struct Frames<'a> {
    header: &'a Header,
    mapped: &'a mut [Mapped],
    index: usize,
    partial: Vec<u8>,
    sink: &'a mut Sink,
}

impl Frames<'_> {
    fn unpack(&mut self, mut from: impl Read) -> Result<(), Malformed> {
        let mut buffer = vec![0; 64 << 10];
        while self.index < self.header.frames {
            let count =
                from.read(&mut buffer).map_err(|error| format!("a block cannot be unpacked: {error}"))?;
            if count == 0 {
                break;
            }
            self.feed(&buffer[..count])?;
        }
        Ok(())
    }

    fn feed(&mut self, mut data: &[u8]) -> Result<(), Malformed> {
        let width = self.header.channels;
        if !self.partial.is_empty() {
            let take = (width - self.partial.len()).min(data.len());
            self.partial.extend_from_slice(&data[..take]);
            data = &data[take..];
            if self.partial.len() < width {
                return Ok(());
            }
            let frame = std::mem::take(&mut self.partial);
            self.frame(&frame)?;
        }
        let mut frames = data.chunks_exact(width);
        for frame in frames.by_ref() {
            self.frame(frame)?;
        }
        self.partial.extend_from_slice(frames.remainder());
        Ok(())
    }

    fn frame(&mut self, frame: &[u8]) -> Result<(), Malformed> {
        if self.index == self.header.frames {
            return Ok(());
        }
        let at = self.header.begin(self.index);
        self.index += 1;
        for mapped in &mut *self.mapped {
            mapped.add(at, frame);
        }
        let all = || {
            self.mapped
                .iter()
                .map(|mapped| mapped.motion.keyframes.len() * mapped.places.len())
                .sum::<usize>()
        };
        if !self.index.is_multiple_of(64) || self.sink.has_room_for(all() as f64) {
            Ok(())
        } else {
            Err("the mapped channels change more than 2000000 times".into())
        }
    }

    fn finish(self) -> Result<usize, Malformed> {
        let frames = self.header.frames;
        if self.index == frames {
            // The last frame has the same duration as all others.
            let end = self.header.begin(frames);
            self.mapped.iter_mut().for_each(|mapped| mapped.end(end));
            Ok(frames)
        } else {
            Err(format!("the file has {} frames, but its header states {frames}", self.index).into())
        }
    }
}

impl Mapped {
    /// Adds a keyframe if the values have changed since the last keyframe.
    fn add(&mut self, at: Span, frame: &[u8]) {
        let same = self.last.len() == self.places.len()
            && self.places.iter().zip(&self.last).all(|(place, value)| frame[*place] == *value);
        if !same {
            self.last.clear();
            self.last.extend(self.places.iter().map(|place| frame[*place]));
            self.end(at);
        }
    }

    /// Adds a keyframe with the latest values, even if they have not changed.
    fn end(&mut self, at: Span) {
        let values: Vec<f64> = self.last.iter().copied().map(f64::from).collect();
        self.motion.keyframes.push(Keyframe { at, value: values[0] });
        if let Course::Several(all) = &mut self.motion.course {
            all.push(values);
        }
    }
}

fn note(header: &Header, mapped: &[Mapped], name: &str, frames: usize, sink: &mut Sink) {
    let used: std::collections::HashSet<usize> =
        mapped.iter().flat_map(|mapped| &mapped.places).copied().collect();
    let left = header.channels - used.len();
    sink.note(format!(
        "{name}: {frames} frames, one every {} ms; frames without a change are left out",
        header.step_ms
    ));
    if left > 0 {
        sink.note(format!(
            "{name}: ignored {} without a mapping",
            downbeat_yaml::render::counted(left, "channel")
        ));
    }
    if !header.variables.is_empty() {
        sink.note(format!("{name}: ignored other entries of the file: {}", header.variables.join(", ")));
    }
}
