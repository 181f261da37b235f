//! Reads Biovision motion capture files, `.bvh`: a skeleton of joints with channels, then one line of values per frame.

use downbeat_yaml::finding::Code;
use downbeat_yaml::render::counted;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::input::Input;
use super::sink::{Sink, Spot};
use super::{DeviceMotion, Keyframe, Motion, RobotMotion, keyframes};

/// Maximum nesting depth of joints.
const DEPTH_MAX: usize = 200;
/// Minimum duration of a frame, in seconds.
const PERIOD_MIN_S: f64 = 1e-5;
/// Maximum number of channels in total, and maximum number of channels per joint.
const CHANNELS_MAX: usize = 1_000;
const JOINT_CHANNELS_MAX: f64 = 6.0;
const CHANNELS: [&str; 6] = ["Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation"];

/// A reader of the words of a file, with their positions.
#[derive(Clone, Copy)]
struct Words<'a> {
    text: &'a str,
    /// Byte offset of the end of the last word read.
    at: usize,
    /// The number of the current line, counted from 1; `line_start` is the line's byte offset.
    line: usize,
    line_start: usize,
    /// Byte offset of the start of the last word read; `width` is its length in bytes.
    start: usize,
    width: usize,
}

impl<'a> Words<'a> {
    fn new(text: &'a str) -> Self {
        Self { text, at: 0, line: 1, line_start: 0, start: 0, width: 0 }
    }

    fn next(&mut self) -> Option<&'a str> {
        let rest = self.text[self.at..].trim_start();
        let start = self.text.len() - rest.len();
        for (place, _) in self.text[self.at..start].match_indices('\n') {
            (self.line, self.line_start) = (self.line + 1, self.at + place + 1);
        }
        let width = rest.find(char::is_whitespace).unwrap_or(rest.len());
        (self.start, self.width, self.at) = (start, width, start + width);
        (width > 0).then(|| &rest[..width])
    }

    /// Reads the rest of the line as one name, because names may contain spaces.
    fn rest(&mut self) -> &'a str {
        let rest = self.text[self.at..].lines().next().unwrap_or("");
        self.at += rest.len();
        rest.trim()
    }

    fn spot(&self) -> Spot<'a> {
        let text = self.text[self.line_start..].lines().next().unwrap_or("");
        let start = (self.start - self.line_start).min(text.len());
        Spot { line: self.line, text, start, width: self.width.min(text.len() - start) }
    }
}

/// An error: its code, its message, and the expected value.
type Wrong = (Code, String, String);

/// Reads one file, which contains the motion of one robot in one scene.
pub(super) fn read(input: &Input, source: &Source, sink: &mut Sink) -> Vec<Motion> {
    let mut words = Words::new(&source.text);
    match read_file(&mut words, sink) {
        Ok((mut devices, period_s)) => {
            let frames = devices.first().map_or(0, |device| device.keyframes.len());
            sink.note(format!(
                "{}: {frames} frames, one every {period_s} s; the skeleton's offsets and end sites are ignored",
                source.name
            ));
            for device in &mut devices {
                device.keyframes.iter_mut().for_each(|keyframe| keyframe.value += 0.0);
            }
            let robot = RobotMotion { robot: input.robot.clone(), devices };
            vec![Motion { scene: input.scene.clone(), robot }]
        }
        Err((code, message, expected)) => {
            sink.found(source, words.spot(), code, message, expected, None);
            Vec::new()
        }
    }
}

fn read_file(words: &mut Words<'_>, sink: &mut Sink) -> Result<(Vec<DeviceMotion>, f64), Wrong> {
    expect(words, "HIERARCHY")?;
    let mut devices = skeleton(words)?;
    expect(words, "Frames:")?;
    let frames = number(words, "the number of frames")?;
    if !(1.0..=1e9).contains(&frames) || frames.fract() != 0.0 {
        return Err((Code::ImportShape, format!("{frames} frames"), "a whole number of at least 1".into()));
    }
    if !sink.has_room_for(frames * devices.len() as f64) {
        let message = format!("{frames} frames of {} channels", devices.len());
        return Err((Code::ImportLimit, message, "at most 2000000 values".into()));
    }
    let stated = *words;
    expect(words, "Frame")?;
    expect(words, "Time:")?;
    let period_s = number(words, "the duration of a frame")?;
    if !(PERIOD_MIN_S..=1_000.0).contains(&period_s) {
        return Err((Code::ImportTime, format!("a frame lasts {period_s} s"), "0.00001 s to 1000 s".into()));
    }
    let found = read_frames(words, frames, period_s, &mut devices)?;
    if found != frames {
        *words = stated;
        let message = format!("the file states `Frames: {frames}`, but contains {found}");
        return Err((Code::ImportShape, message, format!("`Frames: {found}`, or as many frames as stated")));
    }
    Ok((devices, period_s))
}

/// Reads all frames. Returns the number of frames that the file contains.
fn read_frames(
    words: &mut Words<'_>,
    frames: f64,
    period_s: f64,
    devices: &mut [DeviceMotion],
) -> Result<f64, Wrong> {
    let mut frame = 0.0;
    while frame < frames {
        if words.clone().next().is_none() {
            return Ok(frame);
        }
        let at_s = frame * period_s;
        let at = keyframes::span(at_s).ok_or_else(|| {
            (
                Code::ImportTime,
                format!("frame {frame} is at {at_s} s"),
                format!("at most {} s", keyframes::SECONDS_MAX),
            )
        })?;
        for device in &mut *devices {
            let value = number(words, &format!("frame {frame}, `{}`", shortened(&device.device)))?;
            device.keyframes.push(Keyframe { at, value });
        }
        frame += 1.0;
    }
    let mut more = 0.0;
    while words.clone().next().is_some() {
        number(words, &format!("a value after {} frames", frames + more / devices.len() as f64))?;
        more += 1.0;
    }
    match more % devices.len() as f64 {
        0.0 => Ok(frames + more / devices.len() as f64),
        left => {
            let message = format!("the last frame ends after channel {left}");
            Err((
                Code::ImportShape,
                message,
                format!("{}, one for each channel", counted(devices.len(), "value")),
            ))
        }
    }
}

/// Reads the skeleton: the channels of all joints, in the order of the file, which is also the order of the values.
fn skeleton(words: &mut Words<'_>) -> Result<Vec<DeviceMotion>, Wrong> {
    let mut devices: Vec<DeviceMotion> = Vec::new();
    let mut open: Vec<String> = Vec::new();
    let mut name = String::new();
    loop {
        let word = words.next().ok_or_else(|| ended("`MOTION`"))?;
        match word.to_ascii_uppercase().as_str() {
            "ROOT" | "JOINT" => name = words.rest().to_owned(),
            "END" => name = words.rest().to_owned(),
            "{" if open.len() < DEPTH_MAX => open.push(std::mem::take(&mut name)),
            "{" => {
                let message = format!("joints are nested more than {DEPTH_MAX} levels deep");
                return Err((Code::ImportLimit, message, "a skeleton".into()));
            }
            "}" if open.pop().is_some() => {}
            "OFFSET" => (0..3).try_for_each(|_| number(words, "an offset").map(drop))?,
            "CHANNELS" => channels(words, open.last(), &mut devices)?,
            "MOTION" if open.is_empty() && !devices.is_empty() => return Ok(devices),
            _ => {
                let message = format!("unexpected `{}` in the skeleton", shortened(word));
                let expected = "ROOT, JOINT, End Site, OFFSET, CHANNELS, { and }, then MOTION";
                return Err((Code::ImportShape, message, expected.into()));
            }
        }
    }
}

fn channels(
    words: &mut Words<'_>,
    joint: Option<&String>,
    devices: &mut Vec<DeviceMotion>,
) -> Result<(), Wrong> {
    let count = number(words, "the number of channels")?;
    let Some(joint) = joint.filter(|_| (0.0..=JOINT_CHANNELS_MAX).contains(&count)) else {
        return Err((
            Code::ImportShape,
            format!("{count} channels"),
            "0 to 6 channels within a joint".into(),
        ));
    };
    let mut index = 0.0;
    while index < count {
        let word = words.next().ok_or_else(|| ended("a channel"))?;
        let Some(channel) = CHANNELS.iter().find(|channel| channel.eq_ignore_ascii_case(word)) else {
            let message = format!("the channel `{}`", shortened(word));
            return Err((Code::ImportShape, message, downbeat_yaml::finding::one_of(CHANNELS)));
        };
        let unit = if channel.ends_with("rotation") { "deg" } else { "" };
        devices.push(DeviceMotion {
            device: format!("{joint}.{channel}"),
            unit: unit.to_owned(),
            ..DeviceMotion::default()
        });
        index += 1.0;
    }
    if devices.len() > CHANNELS_MAX {
        let message = format!("the skeleton has more than {CHANNELS_MAX} channels");
        return Err((Code::ImportLimit, message, format!("at most {CHANNELS_MAX} channels")));
    }
    Ok(())
}

fn ended(expected: &str) -> Wrong {
    (Code::ImportShape, "the file ends here".into(), expected.to_owned())
}

fn expect(words: &mut Words<'_>, expected: &str) -> Result<(), Wrong> {
    let word = words.next().unwrap_or("");
    if word.eq_ignore_ascii_case(expected) {
        return Ok(());
    }
    Err((Code::ImportShape, format!("found `{}`", shortened(word)), format!("`{expected}`")))
}

fn number(words: &mut Words<'_>, what: &str) -> Result<f64, Wrong> {
    let word = words.next().ok_or_else(|| ended(what))?;
    let number = word.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| {
        (Code::ImportNumber, format!("{what} is `{}`", shortened(word)), "a finite number".to_owned())
    })
}
