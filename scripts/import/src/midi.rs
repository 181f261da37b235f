//! Reads standard MIDI files: the values of the notes, controllers and wheels of each channel, with their times.

use std::collections::BTreeMap;

use urrcp::Span;

use downbeat_yaml::finding::Code;

use super::input::Input;
use super::sink::Sink;
use super::standard_midi::{self, Event, Song, Timing};
use super::{Course, DeviceMotion, Keyframe, Motion, RobotMotion, keyframes};

/// Duration of a beat, in microseconds, if the file does not state a tempo.
const BEAT_US: f64 = 500_000.0;
/// Maximum number of messages to the user about parts of a file that are not tracks.
const PASSED_OVER_MAX: usize = 20;
/// Maximum number of MIDI events of a file.
const EVENTS_MAX: usize = 2_000_000;

/// The kind of value that a MIDI message sets. Devices are written in the order of these variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum What {
    Note(u8),
    Controller(u8),
    Pressure,
    PressureOf(u8),
    Bend,
    Program,
}

/// A value that a MIDI message sets on a channel at a tick.
struct Set {
    tick: u64,
    channel: u8,
    what: What,
    value: f64,
}

/// The parts of a file that the import uses.
#[derive(Default)]
struct Read {
    sets: Vec<Set>,
    /// Tempo changes: the tick, and the microseconds per beat from that tick on.
    tempi: Vec<(u64, f64)>,
    exclusive: usize,
    texts: usize,
    other: usize,
}

/// Reads one file, which contains the motion of one robot in one scene.
pub(super) fn read(input: &Input, name: &str, bytes: &[u8], sink: &mut Sink) -> Vec<Motion> {
    let (song, read) = match read_events(bytes) {
        Ok(read) => read,
        Err((code, message)) => {
            let hint = message.contains("cut off").then_some("copy or export the file again");
            sink.about(name, code, message, "a standard MIDI file", hint);
            return Vec::new();
        }
    };
    if read.sets.is_empty() {
        let expected = "at least one note or controller";
        sink.about(
            name,
            Code::NothingToDo,
            "the file has no notes or controller values".into(),
            expected,
            None,
        );
        return Vec::new();
    }
    let Some(devices) = devices(&read, song.timing, name, sink) else { return Vec::new() };
    note(&read, &song, name, sink);
    vec![Motion { scene: input.scene.clone(), robot: RobotMotion { robot: input.robot.clone(), devices } }]
}

fn read_events(bytes: &[u8]) -> Result<(Song, Read), (Code, String)> {
    // An event takes at least two bytes in the file, but tens of bytes in memory.
    if bytes.len() > 2 * EVENTS_MAX {
        return Err((
            Code::ImportLimit,
            format!("the file has {} bytes, but the limit is {}", bytes.len(), 2 * EVENTS_MAX),
        ));
    }
    let mut read = Read::default();
    let song = standard_midi::read(bytes, |tick, event| read.add(tick, event));
    let song = song.map_err(|fault| (Code::Unreadable, fault.to_string()))?;
    read.sets.sort_by_key(|set| set.tick);
    read.tempi.sort_by_key(|(tick, _)| *tick);
    Ok((song, read))
}

impl Read {
    fn add(&mut self, tick: u64, event: Event<'_>) {
        match event {
            Event::Channel { channel, status, data } => {
                let (what, value) = what(status, data);
                self.sets.push(Set { tick, channel, what, value });
            }
            Event::Meta { kind: 0x51, data: [a, b, c] } => {
                let us = u32::from_be_bytes([0, *a, *b, *c]);
                self.tempi.push((tick, f64::from(us.max(1))));
            }
            Event::Meta { kind: 1..=15, .. } => self.texts += 1,
            Event::Meta { .. } => self.other += 1,
            Event::Exclusive => self.exclusive += 1,
        }
    }
}

/// Returns the kind of value that a MIDI channel message sets, and the value.
fn what(status: u8, [first, second]: [u8; 2]) -> (What, f64) {
    let value = f64::from(second);
    match status {
        0x80 => (What::Note(first), 0.0),
        0x90 => (What::Note(first), value),
        0xa0 => (What::PressureOf(first), value),
        0xb0 => (What::Controller(first), value),
        0xc0 => (What::Program, f64::from(first)),
        0xd0 => (What::Pressure, f64::from(first)),
        _ => (What::Bend, value * 128.0 + f64::from(first) - 8_192.0),
    }
}

/// Converts ticks to seconds across tempo changes. Ticks must be queried in ascending order.
struct Clock<'a> {
    timing: Timing,
    tempi: &'a [(u64, f64)],
    next: usize,
    at: (u64, f64),
    beat_us: f64,
}

impl Clock<'_> {
    fn seconds(&mut self, tick: u64) -> f64 {
        while let Some((at, beat_us)) = self.tempi.get(self.next).filter(|(at, _)| *at <= tick) {
            self.at = (*at, self.after(*at));
            (self.beat_us, self.next) = (*beat_us, self.next + 1);
        }
        self.after(tick)
    }

    fn after(&self, tick: u64) -> f64 {
        let ticks = (tick - self.at.0) as f64;
        let seconds = match self.timing {
            Timing::Beats(ticks) => self.beat_us / ticks / 1e6,
            Timing::Frames(rate, ticks) => 1.0 / rate / ticks,
        };
        self.at.1 + ticks * seconds
    }
}

fn devices(read: &Read, timing: Timing, name: &str, sink: &mut Sink) -> Option<Vec<DeviceMotion>> {
    let mut clock = Clock { timing, tempi: &read.tempi, next: 0, at: (0, 0.0), beat_us: BEAT_US };
    let mut devices: BTreeMap<(u8, What), Vec<Keyframe>> = BTreeMap::new();
    let mut replaced = 0_usize;
    for set in &read.sets {
        let at_s = clock.seconds(set.tick);
        let Some(at) = keyframes::span(at_s) else {
            let expected = format!("at most {} s", keyframes::SECONDS_MAX);
            sink.about(name, Code::ImportTime, format!("the file lasts {at_s} s"), &expected, None);
            return None;
        };
        let own = devices.entry((set.channel, set.what)).or_default();
        if own.is_empty() && at > Span::ZERO && matches!(set.what, What::Note(_)) {
            own.push(Keyframe { at: Span::ZERO, value: 0.0 });
        }
        match own.last_mut().filter(|last| last.at == at) {
            Some(last) => {
                replaced += usize::from(last.value != set.value);
                last.value = set.value;
            }
            None => own.push(Keyframe { at, value: set.value }),
        }
    }
    if replaced > 0 {
        let values = downbeat_yaml::render::counted(replaced, "value");
        sink.note(format!("{name}: left out {values}, replaced by another value at the same time"));
    }
    let device = |((channel, what), keyframes): ((u8, What), Vec<Keyframe>)| DeviceMotion {
        device: device_name(channel, what),
        keyframes,
        course: Course::Held,
        ..DeviceMotion::default()
    };
    Some(devices.into_iter().map(device).collect())
}

fn device_name(channel: u8, what: What) -> String {
    match what {
        What::Note(key) => format!("ch{channel}-note{key}"),
        What::Controller(number) => format!("ch{channel}-cc{number}"),
        What::Pressure => format!("ch{channel}-pressure"),
        What::PressureOf(key) => format!("ch{channel}-pressure{key}"),
        What::Bend => format!("ch{channel}-bend"),
        What::Program => format!("ch{channel}-program"),
    }
}

fn note(read: &Read, song: &Song, name: &str, sink: &mut Sink) {
    let tempi = downbeat_yaml::render::counted(read.tempi.len(), "tempo");
    sink.note(match song.timing {
        Timing::Beats(_) if read.tempi.is_empty() => {
            format!("{name}: the file does not state a tempo, so 120 beats per minute are assumed")
        }
        Timing::Beats(_) => format!("{name}: times are computed from {tempi} in the file"),
        Timing::Frames(rate, _) => format!("{name}: times are counted in frames, {rate:.2} per second"),
    });
    sink.note(format!(
        "{name}: the value of a note is its velocity while it sounds, otherwise 0; release velocities are ignored"
    ));
    for (count, what) in [
        (read.exclusive, "system exclusive message"),
        (read.texts, "text event"),
        (read.other, "other meta event"),
    ] {
        if count > 0 {
            sink.note(format!("{name}: left out {}", downbeat_yaml::render::counted(count, what)));
        }
    }
    if song.resumed > 0 {
        let events = downbeat_yaml::render::counted(song.resumed, "event");
        sink.note(format!(
            "{name}: {events} continued a running status after a meta event or a system exclusive message"
        ));
    }
    for part in song.passed_over.iter().take(PASSED_OVER_MAX) {
        sink.note(format!("{name}: left out {part}"));
    }
}
