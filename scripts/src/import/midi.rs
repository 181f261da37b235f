//! Standard MIDI files: what each note, controller and wheel of each channel is set to, and when.

use std::collections::BTreeMap;

use midly::{MetaMessage, MidiMessage, PitchBend, Smf, Timing, TrackEventKind};
use urrcp::Span;

use crate::finding::Code;

use super::input::Input;
use super::sink::Sink;
use super::{Course, DeviceMotion, Keyframe, Motion, RobotMotion, keyframes};

/// Microseconds of a beat where the file says no tempo.
const BEAT_US: f64 = 500_000.0;
/// Most events of a file.
const EVENTS_MAX: usize = 2_000_000;

/// What is set, in the order in which devices are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum What {
    Note(u8),
    Controller(u8),
    Pressure,
    PressureOf(u8),
    Bend,
    Program,
}

/// A value of a channel at a tick.
struct Set {
    tick: u64,
    channel: u8,
    what: What,
    value: f64,
}

/// Everything of a file that matters here.
#[derive(Default)]
struct Read {
    sets: Vec<Set>,
    /// Ticks and microseconds a beat from there on.
    tempi: Vec<(u64, f64)>,
    end: u64,
    exclusive: usize,
    texts: usize,
    other: usize,
}

/// Reads one file: one robot in one scene.
pub(super) fn read(input: &Input, name: &str, bytes: &[u8], sink: &mut Sink) -> Vec<Motion> {
    let (timing, read) = match read_events(bytes) {
        Ok(read) => read,
        Err((code, message)) => {
            sink.about(name, code, message, "a standard MIDI file", None);
            return Vec::new();
        }
    };
    if read.sets.is_empty() {
        let expected = "at least one note or controller";
        sink.about(name, Code::NothingToDo, "the file sets nothing".into(), expected, None);
        return Vec::new();
    }
    let Some(devices) = devices(&read, timing, name, sink) else { return Vec::new() };
    note(&read, timing, name, sink);
    vec![Motion { scene: input.scene.clone(), robot: RobotMotion { robot: input.robot.clone(), devices } }]
}

fn read_events(bytes: &[u8]) -> Result<(Timing, Read), (Code, String)> {
    let unreadable = |message: String| (Code::Unreadable, message);
    // An event takes at least two bytes, and tens of them in memory.
    if bytes.len() > 2 * EVENTS_MAX {
        return Err((
            Code::ImportLimit,
            format!("the file has {} bytes, the limit is {}", bytes.len(), 2 * EVENTS_MAX),
        ));
    }
    if names_no_frame_rate(bytes) {
        return Err(unreadable("this is not a MIDI file: invalid smpte fps".to_owned()));
    }
    let smf = Smf::parse(bytes).map_err(|error| unreadable(format!("this is not a MIDI file: {error}")))?;
    if matches!(smf.header.format, midly::Format::Sequential) && smf.tracks.len() > 1 {
        return Err(unreadable("the tracks are songs of their own (format 2): save them one a file".into()));
    }
    let mut read = Read::default();
    for track in &smf.tracks {
        let mut tick = 0_u64;
        for event in track {
            tick += u64::from(event.delta.as_int());
            read.add(tick, &event.kind);
        }
        read.end = read.end.max(tick);
    }
    read.sets.sort_by_key(|set| set.tick);
    read.tempi.sort_by_key(|(tick, _)| *tick);
    Ok((smf.header.timing, read))
}

/// The one rate of frames, -128, that midly 0.5 negates without a look, in any header: it reads those behind the first as well.
fn names_no_frame_rate(bytes: &[u8]) -> bool {
    bytes.windows(13).any(|header| header.starts_with(b"MThd") && header[12] == 0x80)
}

impl Read {
    fn add(&mut self, tick: u64, kind: &TrackEventKind<'_>) {
        match kind {
            TrackEventKind::Midi { channel, message } => {
                let (what, value) = what(message);
                self.sets.push(Set { tick, channel: channel.as_int() + 1, what, value });
            }
            TrackEventKind::Meta(MetaMessage::Tempo(us)) => {
                self.tempi.push((tick, f64::from(us.as_int().max(1))));
            }
            TrackEventKind::Meta(MetaMessage::EndOfTrack) => {}
            TrackEventKind::Meta(
                MetaMessage::Text(_)
                | MetaMessage::Lyric(_)
                | MetaMessage::Marker(_)
                | MetaMessage::CuePoint(_)
                | MetaMessage::TrackName(_)
                | MetaMessage::InstrumentName(_)
                | MetaMessage::Copyright(_),
            ) => self.texts += 1,
            TrackEventKind::Meta(_) => self.other += 1,
            TrackEventKind::SysEx(_) | TrackEventKind::Escape(_) => self.exclusive += 1,
        }
    }
}

fn what(message: &MidiMessage) -> (What, f64) {
    let value = |value: midly::num::u7| f64::from(value.as_int());
    match *message {
        MidiMessage::NoteOn { key, vel } => (What::Note(key.as_int()), value(vel)),
        MidiMessage::NoteOff { key, .. } => (What::Note(key.as_int()), 0.0),
        MidiMessage::Aftertouch { key, vel } => (What::PressureOf(key.as_int()), value(vel)),
        MidiMessage::Controller { controller, value: set } => {
            (What::Controller(controller.as_int()), value(set))
        }
        MidiMessage::ProgramChange { program } => (What::Program, value(program)),
        MidiMessage::ChannelAftertouch { vel } => (What::Pressure, value(vel)),
        MidiMessage::PitchBend { bend: PitchBend(bend) } => (What::Bend, f64::from(bend.as_int()) - 8_192.0),
    }
}

/// The seconds of a tick, along the changes of tempo; asked for in order.
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
            Timing::Metrical(beat) => self.beat_us / f64::from(beat.as_int().max(1)) / 1e6,
            Timing::Timecode(rate, frame) => 1.0 / f64::from(rate.as_f32()) / f64::from(frame.max(1)),
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
        let values = crate::counted(replaced, "value");
        sink.note(format!("{name}: left out {values} that another replaces at the same time"));
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

fn note(read: &Read, timing: Timing, name: &str, sink: &mut Sink) {
    let tempi = crate::counted(read.tempi.len(), "tempo");
    sink.note(match timing {
        Timing::Metrical(_) if read.tempi.is_empty() => {
            format!("{name}: no tempo is stated: 120 beats a minute")
        }
        Timing::Metrical(_) => format!("{name}: times follow {tempi} of the file"),
        Timing::Timecode(rate, _) => format!("{name}: times are frames, {} a second", rate.as_f32()),
    });
    sink.note(format!(
        "{name}: a note is its velocity while it sounds, and 0 else; how fast it is let go is left out"
    ));
    for (count, what) in [
        (read.exclusive, "system exclusive message"),
        (read.texts, "text"),
        (read.other, "signature or other mark"),
    ] {
        if count > 0 {
            sink.note(format!("{name}: left out {}", crate::counted(count, what)));
        }
    }
}
