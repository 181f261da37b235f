//! Parses the bytes of standard MIDI files: chunks, tracks and their events. Every byte is read, or reported with its position.

use super::malformed::Malformed;

/// How ticks are converted to time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Timing {
    /// The number of ticks per beat.
    Beats(f64),
    /// The number of frames per second, and the number of ticks per frame.
    Frames(f64, f64),
}

/// An event of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event<'a> {
    /// A message on one MIDI channel (1 to 16): the status byte with its channel bits cleared, and two data bytes. The second data byte
    /// is 0 if the message has only one.
    Channel {
        channel: u8,
        status: u8,
        data: [u8; 2],
    },
    Meta {
        kind: u8,
        data: &'a [u8],
    },
    Exclusive,
}

/// What a MIDI file contains besides its events.
#[derive(Debug)]
pub(super) struct Song {
    pub(super) timing: Timing,
    /// Number of messages without a status byte that directly follow a meta event or an exclusive message. They reuse the last status
    /// before it.
    pub(super) resumed: usize,
    /// Descriptions, for the user, of the parts of the file that were skipped.
    pub(super) passed_over: Vec<String>,
}

const HEADER: usize = 14;
const CHUNK: usize = 8;
const END_OF_TRACK: u8 = 0x2f;

/// Reads all tracks in order, and passes each event with its tick to `take`. Ticks count from the start of each track.
pub(super) fn read<'a>(bytes: &'a [u8], mut take: impl FnMut(u64, Event<'a>)) -> Result<Song, Malformed> {
    let bytes = unwrapped(bytes);
    let (timing, tracks, length) = header(bytes)?;
    let mut song = Song { timing, resumed: 0, passed_over: Vec::new() };
    let (mut at, mut found) = (CHUNK + length, 0);
    while at < bytes.len() {
        if found == tracks {
            let rest = downbeat_yaml::render::counted(bytes.len() - at, "byte");
            song.passed_over.push(format!("{rest} after the last track"));
            break;
        }
        let begin = at + CHUNK;
        let (Some(name), Some(length)) = (bytes.get(at..at + 4), number(bytes, at + 4, 4)) else {
            let end = bytes.len();
            return Err(format!(
                "the file is cut off at byte {end}, within the {CHUNK}-byte header of the chunk at byte {at}"
            )
            .into());
        };
        let is_track = name == b"MTrk";
        found += usize::from(is_track);
        let Some(end) = begin.checked_add(length).filter(|end| *end <= bytes.len()) else {
            let what = if is_track { format!("track {found}") } else { "a chunk".to_owned() };
            let (end, left) = (bytes.len(), bytes.len() - begin);
            return Err(format!(
                "the file is cut off at byte {end}: {what}, which starts at byte {begin}, has only {left} of {length} bytes"
            ).into());
        };
        if is_track {
            Track { bytes: &bytes[..end], at: begin, number: found, status: None, interrupted: false }
                .read(&mut song, &mut take)?;
        } else {
            song.passed_over.push(format!("the chunk `{}`", name.escape_ascii()));
        }
        at = end;
    }
    if found == tracks {
        Ok(song)
    } else {
        Err(format!(
            "the header states {}, but the file has {found}",
            downbeat_yaml::render::counted(tracks, "track")
        )
        .into())
    }
}

/// Returns the MIDI file inside a RIFF container (RMID), or `bytes` unchanged if there is no such container.
fn unwrapped(bytes: &[u8]) -> &[u8] {
    let is_riff = bytes.starts_with(b"RIFF") && bytes.get(8..16) == Some(b"RMIDdata");
    if is_riff { bytes.get(20..).unwrap_or_default() } else { bytes }
}

/// Parses the header of the file. Returns the timing, the number of tracks, and the length of the header in bytes.
fn header(bytes: &[u8]) -> Result<(Timing, usize, usize), Malformed> {
    if !bytes.starts_with(b"MThd") {
        return Err(not_midi(bytes));
    }
    let part = |at, width| number(bytes, at, width);
    let (Some(length), Some(format), Some(tracks), Some(division)) =
        (part(4, 4), part(8, 2), part(10, 2), part(12, 2))
    else {
        return Err(
            format!("the file is cut off at byte {}, within its {HEADER}-byte header", bytes.len()).into()
        );
    };
    if length < HEADER - CHUNK {
        return Err(
            format!("the header has {length} bytes, but must have at least {}", HEADER - CHUNK).into()
        );
    }
    if format == 2 && tracks > 1 {
        return Err("format 2, in which each track is a separate song, is not supported: save each track as a separate file".into());
    }
    let low = (division & 0xff) as f64;
    let timing = match (division >> 8, division) {
        (_, 0) => return Err("the header states 0 ticks per beat".into()),
        (0..0x80, ticks) => Timing::Beats(ticks as f64),
        _ if low == 0.0 => return Err("the header states 0 ticks per frame".into()),
        (0xe8, _) => Timing::Frames(24.0, low),
        (0xe7, _) => Timing::Frames(25.0, low),
        (0xe3, _) => Timing::Frames(30_000.0 / 1_001.0, low),
        (0xe2, _) => Timing::Frames(30.0, low),
        (rate, _) => {
            return Err(format!(
                "the header states {} SMPTE frames per second, which is not supported",
                256 - rate
            )
            .into());
        }
    };
    Ok((timing, tracks, length))
}

/// Returns the error message for a file that does not begin with `MThd`. It quotes the first bytes if they are text.
fn not_midi(bytes: &[u8]) -> Malformed {
    let begin = &bytes[..bytes.len().min(4)];
    match begin {
        [] => "the file is empty".into(),
        _ if begin.iter().all(|byte| byte.is_ascii_graphic() || byte.is_ascii_whitespace()) => {
            format!("this is not a MIDI file: found `{}` at byte 0, expected `MThd`", begin.escape_ascii())
                .into()
        }
        _ => "this is not a MIDI file: it does not begin with `MThd`".into(),
    }
}

/// Parses a big-endian number of `width` bytes at the offset `at`; `None` if the file ends before.
fn number(bytes: &[u8], at: usize, width: usize) -> Option<usize> {
    let part = bytes.get(at..at + width)?;
    Some(part.iter().fold(0, |sum, byte| (sum << 8) | usize::from(*byte)))
}

struct Track<'a> {
    /// The bytes of the file up to the end of the track.
    bytes: &'a [u8],
    at: usize,
    /// The number of the track, counted from 1.
    number: usize,
    /// The status of the previous channel message (running status). The next message may omit its status if it is the same.
    status: Option<u8>,
    /// Whether a meta event or an exclusive message has followed the last status byte.
    interrupted: bool,
}

impl<'a> Track<'a> {
    fn read(mut self, song: &mut Song, take: &mut impl FnMut(u64, Event<'a>)) -> Result<(), Malformed> {
        let mut tick = 0_u64;
        while self.at < self.bytes.len() {
            tick += self.variable()? as u64;
            let event = self.event(song)?;
            if matches!(event, Event::Meta { kind: END_OF_TRACK, .. }) {
                break;
            }
            take(tick, event);
        }
        if self.at < self.bytes.len() {
            let rest = downbeat_yaml::render::counted(self.bytes.len() - self.at, "byte");
            song.passed_over.push(format!("{rest} after the end of track {}", self.number));
        }
        Ok(())
    }

    fn event(&mut self, song: &mut Song) -> Result<Event<'a>, Malformed> {
        let at = self.at;
        let first = self.byte()?;
        let status = match first {
            0xff => {
                let kind = self.byte()?;
                self.interrupted = true;
                return Ok(Event::Meta { kind, data: self.data()? });
            }
            0xf0 | 0xf7 => {
                self.interrupted = true;
                self.data()?;
                return Ok(Event::Exclusive);
            }
            0xf1.. => {
                return Err(
                    self.wrong(at, &format!("the status byte {first:#04x} is not valid in a MIDI file"))
                );
            }
            0x80.. => {
                self.interrupted = false;
                first
            }
            _ => {
                self.at = at;
                // According to the standard, such an event ends the running status. But many programs continue it, and the byte has no
                // other meaning.
                song.resumed += usize::from(std::mem::take(&mut self.interrupted));
                self.status.ok_or_else(|| {
                    self.wrong(at, &format!("missing status byte before the value {first:#04x}"))
                })?
            }
        };
        self.status = Some(status);
        let (status, channel) = (status & 0xf0, (status & 0x0f) + 1);
        let second = if matches!(status, 0xc0 | 0xd0) { None } else { Some(()) };
        let data = [self.value()?, second.map_or(Ok(0), |()| self.value())?];
        Ok(Event::Channel { channel, status, data })
    }

    fn wrong(&self, at: usize, message: &str) -> Malformed {
        format!("track {}, byte {at}: {message}", self.number).into()
    }

    fn byte(&mut self) -> Result<u8, Malformed> {
        let byte = self.bytes.get(self.at).copied();
        self.at += usize::from(byte.is_some());
        byte.ok_or_else(|| self.wrong(self.at, "the track ends within an event"))
    }

    /// Reads a data byte of a message.
    fn value(&mut self) -> Result<u8, Malformed> {
        match self.byte()? {
            value @ 0..0x80 => Ok(value),
            other => Err(self.wrong(
                self.at - 1,
                &format!("unexpected byte {other:#04x} within a message, expected a value below 0x80"),
            )),
        }
    }

    /// Reads a variable-length number: seven bits per byte, most significant first.
    fn variable(&mut self) -> Result<usize, Malformed> {
        let begin = self.at;
        let mut sum = 0;
        for _ in 0..4 {
            let byte = self.byte()?;
            sum = (sum << 7) | usize::from(byte & 0x7f);
            if byte < 0x80 {
                return Ok(sum);
            }
        }
        Err(self.wrong(begin, "a variable-length number has more than four bytes"))
    }

    /// Reads a length, then that many bytes, and returns the bytes.
    fn data(&mut self) -> Result<&'a [u8], Malformed> {
        let (begin, length) = (self.at, self.variable()?);
        let data = self.bytes.get(self.at..self.at + length);
        self.at += data.map_or(0, <[u8]>::len);
        data.ok_or_else(|| {
            self.wrong(begin, &format!("a message of {length} bytes extends beyond the end of the track"))
        })
    }
}
