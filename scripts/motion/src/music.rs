//! Musical time: beats and bars, and how long they last.
//!
//! A tempo counts beats per minute. The lower number of the time signature is the note value of a beat; the upper number is the number of
//! beats per bar. Bars and beats are counted from 1. Musical time is kept exactly, because a beat is rarely a whole number of
//! nanoseconds.

use std::sync::Arc;

use urrcp::Span;

use crate::exact::{Beginning, Exact, Fraction, decimal, sum, to_f64, within};

const MINUTE: Span = Span::from_millis(60_000);

/// Tempo and time signature, from a given bar on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// The first bar, counted from 0: 0 is bar 1.
    pub bar: u32,
    /// The tempo, in beats per minute.
    pub beats_a_minute: Fraction,
    /// The number of beats per bar.
    pub beats_a_bar: u8,
}

/// The tempo of a whole act, which may change at bars.
#[derive(Clone, Debug, PartialEq)]
pub struct Tempo(Vec<Anchored>);

#[derive(Clone, Copy, Debug, PartialEq)]
struct Anchored {
    section: Section,
    /// The start of the section, in beats and as a time (`at`).
    beat: Fraction,
    at: Exact,
}

impl Section {
    /// The duration of a number of beats.
    fn beats(&self, beats: Fraction) -> Exact {
        Exact::from(MINUTE).times(beats).times(self.beats_a_minute.recip())
    }

    /// Converts bars to beats.
    fn bars(&self, bars: Fraction) -> Fraction {
        bars * i128::from(self.beats_a_bar)
    }
}

impl Tempo {
    /// Creates a tempo from sections in order of their bars; the first section starts at bar 1.
    pub fn new(sections: &[Section]) -> Self {
        let mut anchored: Vec<Anchored> = Vec::with_capacity(sections.len());
        for &section in sections {
            let (beat, at) = anchored.last().map_or((Fraction::ZERO, Exact::ZERO), |last| {
                let beats = last.section.bars(whole(section.bar - last.section.bar));
                (sum(last.beat, beats), last.at.plus(last.section.beats(beats)))
            });
            anchored.push(Anchored { section, beat, at });
        }
        Self(anchored)
    }

    fn changes(&self) -> bool {
        self.0.len() > 1
    }

    /// Returns the last section whose `key` is at most `value`.
    fn section<T: PartialOrd>(&self, key: impl Fn(&Anchored) -> T, value: T) -> Option<&Anchored> {
        let after = self.0.partition_point(|section| key(section) <= value);
        self.0.get(after.saturating_sub(1))
    }

    /// Returns the time of a position, counted from the beginning of the first bar.
    fn position(&self, bar: u32, beat: Fraction) -> Option<Exact> {
        let section = self.section(|s| s.section.bar, bar)?;
        let bars = section.section.bars(whole(bar - section.section.bar));
        self.time_of_beat(sum(sum(section.beat, bars), beat))
    }

    fn time_of_beat(&self, beat: Fraction) -> Option<Exact> {
        let section = self.section(|s| s.beat, beat)?;
        Some(section.at.plus(section.section.beats(sum(beat, -section.beat))))
    }

    fn beat_of_time(&self, at: Exact) -> Option<Fraction> {
        let section = self.section(|s| s.at, at)?;
        let beats = at.minus(section.at).divided_by(section.section.beats(whole(1)))?;
        Some(sum(section.beat, beats))
    }
}

fn whole(number: u32) -> Fraction {
    Fraction::from_integer(i128::from(number))
}

/// The context that gives beats their meaning: the tempo and the start of the cue that is being read.
#[derive(Clone, Debug, Default)]
pub struct Music {
    /// The tempo; `None` if the scenario has no tempo.
    pub tempo: Option<Arc<Tempo>>,
    /// The start of the cue, if it is fixed.
    pub start: Beginning,
}

/// The reason why a musical time has no length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoMusicalLength {
    /// The scenario has no tempo.
    WithoutTempo,
    /// The cue begins at a time that is not fixed.
    StartNotFixed,
    /// The value is a position in the music, not a length.
    Position,
}

impl NoMusicalLength {
    /// The message of the finding about the musical time `text`.
    pub fn message(self, text: &str) -> String {
        match self {
            Self::WithoutTempo => format!("`{text}` is a musical time, but the scenario has no tempo"),
            Self::StartNotFixed => format!("the length of `{text}` depends on the start time of the cue"),
            Self::Position => format!("`{text}` is a position in the music, not a length"),
        }
    }

    /// How to fix the mistake.
    pub const fn hint(self) -> &'static str {
        match self {
            Self::WithoutTempo => "add `tempo: 120` (beats per minute) at the top of the scenario",
            Self::StartNotFixed => {
                "the tempo changes: give the cue a fixed `at`, or write the length in seconds"
            }
            Self::Position => "write a length such as `3 beats`, or `1 bar 2 beats`",
        }
    }
}

impl Music {
    /// Parses a length such as `4 beats` or `1 bar 2 beats`; `None` if the text is not such a length.
    pub fn span(&self, text: &str) -> Option<Result<Exact, NoMusicalLength>> {
        if position(text).is_some() {
            return Some(Err(NoMusicalLength::Position));
        }
        let (bars, beats) = length(text)?;
        Some(self.length(bars, beats))
    }

    /// Returns the duration of a number of bars and beats that begin at the start of the cue.
    pub fn length(&self, bars: Fraction, beats: Fraction) -> Result<Exact, NoMusicalLength> {
        let tempo = self.tempo.as_ref().ok_or(NoMusicalLength::WithoutTempo)?;
        let start = match (self.start.0, tempo.changes()) {
            (Some(start), _) => start,
            (None, false) => Exact::ZERO,
            (None, true) => return Err(NoMusicalLength::StartNotFixed),
        };
        let time = || {
            let section = tempo.section(|s| s.at, start)?.section;
            if !tempo.changes() {
                return Some(section.beats(sum(section.bars(bars), beats)));
            }
            let beat = sum(tempo.beat_of_time(start)?, sum(section.bars(bars), beats));
            Some(tempo.time_of_beat(beat)?.minus(start))
        };
        Ok(time().unwrap_or(Exact::ZERO))
    }

    /// For a position whose beat exceeds the bar: the number of beats in that bar, and the equivalent position in a later bar. Otherwise
    /// `None`.
    pub fn beyond_bar(&self, text: &str) -> Option<(u8, String)> {
        let (written, mut beat) = position(text)?;
        let tempo = self.tempo.as_ref()?;
        let beats = |bar: u32| tempo.section(|s| s.section.bar, bar).map(|s| s.section.beats_a_bar);
        let mut bar = written;
        loop {
            let beats = i128::from(beats(bar)?);
            if beat < Fraction::from_integer(beats) {
                break;
            }
            (bar, beat) = (bar + 1, beat - beats);
        }
        let meant = format!("bar {} beat {}", bar + 1, to_f64(beat + 1));
        (bar > written).then_some((beats(written)?, meant))
    }

    /// Parses a position such as `bar 3 beat 2` and converts it to the time from the beginning of the first bar. `None` if the text is
    /// not a position.
    pub fn position(&self, text: &str) -> Option<Result<Exact, NoMusicalLength>> {
        let (bar, beat) = position(text)?;
        let Some(tempo) = self.tempo.as_ref() else { return Some(Err(NoMusicalLength::WithoutTempo)) };
        Some(Ok(tempo.position(bar, beat).unwrap_or(Exact::ZERO)))
    }
}

/// Parses `bar 3 beat 2` or `bar 3` into the bar and the beat, both counted from 0. `None` if the text is not a position.
pub fn position(text: &str) -> Option<(u32, Fraction)> {
    let words: Vec<_> = text.split_whitespace().collect();
    let (bar, beat) = match words.as_slice() {
        ["bar", bar] => (bar.parse::<u32>().ok()?, whole(1)),
        ["bar", bar, "beat", beat] => (bar.parse::<u32>().ok()?, decimal(beat)?),
        _ => return None,
    };
    ((1..=1_000_000).contains(&bar) && within(beat, 1, 1_000)).then(|| (bar - 1, beat - 1))
}

/// Parses `4 beats`, `1 bar` or `1 bar 2 beats` into bars and beats. `None` if the text is not a length.
fn length(text: &str) -> Option<(Fraction, Fraction)> {
    let words: Vec<_> = text.split_whitespace().collect();
    let number = |word: &str| decimal(word).filter(|value| within(*value, 0, 1_000_000));
    match words.as_slice() {
        [n, "beat" | "beats"] => Some((Fraction::ZERO, number(n)?)),
        [n, "bar" | "bars"] => Some((number(n)?, Fraction::ZERO)),
        [bars, "bar" | "bars", beats, "beat" | "beats"] => Some((number(bars)?, number(beats)?)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn music(start: Option<i64>) -> Music {
        let sections = [
            Section { bar: 0, beats_a_minute: whole(120), beats_a_bar: 4 },
            Section { bar: 2, beats_a_minute: whole(60), beats_a_bar: 3 },
        ];
        Music {
            tempo: Some(Arc::new(Tempo::new(&sections))),
            start: Beginning(start.map(|millis| Span::from_millis(millis).into())),
        }
    }

    #[test]
    fn positions_follow_tempo_and_signature_changes() {
        let millis = |text| music(None).position(text).unwrap().unwrap().rounded().as_millis_f64();
        assert_eq!(millis("bar 1"), 0.0);
        assert_eq!(millis("bar 1 beat 2.5"), 750.0);
        assert_eq!(millis("bar 3"), 4_000.0);
        assert_eq!(millis("bar 4 beat 2"), 8_000.0);
        assert!(music(None).position("4 beats").is_none());
    }

    #[test]
    fn length_across_tempo_change_includes_beats_of_both_tempos() {
        let millis = |start, text| music(Some(start)).span(text).unwrap().unwrap().rounded().as_millis_f64();
        assert_eq!(millis(0, "4 beats"), 2_000.0);
        assert_eq!(millis(3_000, "4 beats"), 3_000.0);
        assert_eq!(millis(4_000, "1 bar 1 beat"), 4_000.0);
    }

    #[test]
    fn length_under_changing_tempo_needs_a_fixed_start() {
        assert_eq!(music(None).span("2 beats"), Some(Err(NoMusicalLength::StartNotFixed)));
        assert_eq!(Music::default().span("2 beats"), Some(Err(NoMusicalLength::WithoutTempo)));
        assert_eq!(music(None).span("2 parsecs"), None);
    }
}
