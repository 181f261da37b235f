//! Musical time: beats and bars, and how long they last.
//!
//! A tempo counts beats a minute; a beat is the lower number of the time signature, a bar has as many beats as the upper
//! one says. Bars and beats count from 1.

use std::sync::Arc;

use urrcp::Span;

/// Tempo and time signature from some bar on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Section {
    /// In bars from the beginning, 0 for bar 1.
    pub(crate) bar: f64,
    pub(crate) beats_a_minute: f64,
    pub(crate) beats_a_bar: f64,
}

/// The tempo of a whole act.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tempo(Vec<Anchored>);

#[derive(Clone, Copy, Debug, PartialEq)]
struct Anchored {
    section: Section,
    /// Where it begins, in beats and in milliseconds.
    beat: f64,
    millis: f64,
}

impl Section {
    fn beat_millis(&self) -> f64 {
        60_000.0 / self.beats_a_minute
    }
}

impl Tempo {
    /// From sections in order of their bars, the first at bar 1.
    pub(crate) fn new(sections: &[Section]) -> Self {
        let mut anchored: Vec<Anchored> = Vec::with_capacity(sections.len());
        for &section in sections {
            let (beat, millis) = anchored.last().map_or((0.0, 0.0), |last| {
                let beats = (section.bar - last.section.bar) * last.section.beats_a_bar;
                (last.beat + beats, last.millis + beats * last.section.beat_millis())
            });
            anchored.push(Anchored { section, beat, millis });
        }
        Self(anchored)
    }

    fn changes(&self) -> bool {
        self.0.len() > 1
    }

    /// The section that holds where `key` has reached `value`.
    fn section(&self, key: impl Fn(&Anchored) -> f64, value: f64) -> Option<&Anchored> {
        let after = self.0.partition_point(|section| key(section) <= value);
        self.0.get(after.saturating_sub(1))
    }

    /// The time of a position, both counted from the beginning.
    fn position(&self, bar: f64, beat: f64) -> Option<f64> {
        let section = self.section(|s| s.section.bar, bar)?;
        self.millis_of_beat(section.beat + (bar - section.section.bar) * section.section.beats_a_bar + beat)
    }

    fn millis_of_beat(&self, beat: f64) -> Option<f64> {
        let section = self.section(|s| s.beat, beat)?;
        Some(section.millis + (beat - section.beat) * section.section.beat_millis())
    }

    fn beat_of_millis(&self, millis: f64) -> Option<f64> {
        let section = self.section(|s| s.millis, millis)?;
        Some(section.beat + (millis - section.millis) / section.section.beat_millis())
    }
}

/// How beats are counted at the place that is being read.
#[derive(Clone, Debug, Default)]
pub(crate) struct Music {
    pub(crate) tempo: Option<Arc<Tempo>>,
    /// When the cue begins, where that is fixed.
    pub(crate) start: Option<Span>,
}

/// Why a musical time has no length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unmusical {
    WithoutTempo,
    StartNotFixed,
    Position,
}

impl Unmusical {
    pub(crate) fn message(self, text: &str) -> String {
        match self {
            Self::WithoutTempo => format!("`{text}` is musical time, and the scenario has no tempo"),
            Self::StartNotFixed => format!("how long `{text}` lasts depends on when the cue begins"),
            Self::Position => format!("`{text}` is a position in the music, not a length"),
        }
    }

    pub(crate) const fn hint(self) -> &'static str {
        match self {
            Self::WithoutTempo => "add `tempo: 120` (beats a minute) at the top of the scenario",
            Self::StartNotFixed => {
                "the tempo changes: give the cue a fixed `at`, or write the length in seconds"
            }
            Self::Position => "write a length such as `3 beats`, or `1 bar 2 beats`",
        }
    }
}

impl Music {
    /// A length such as `4 beats` or `1 bar 2 beats`; `None` if the text is nothing of the kind.
    pub(crate) fn span(&self, text: &str) -> Option<Result<Span, Unmusical>> {
        if position(text).is_some() {
            return Some(Err(Unmusical::Position));
        }
        let (bars, beats) = length(text)?;
        Some(self.length(bars, beats))
    }

    fn length(&self, bars: f64, beats: f64) -> Result<Span, Unmusical> {
        let tempo = self.tempo.as_ref().ok_or(Unmusical::WithoutTempo)?;
        let start = match (self.start, tempo.changes()) {
            (Some(start), _) => start.as_millis_f64(),
            (None, false) => 0.0,
            (None, true) => return Err(Unmusical::StartNotFixed),
        };
        let millis = || {
            let section = tempo.section(|s| s.millis, start)?;
            let beat = tempo.beat_of_millis(start)? + bars * section.section.beats_a_bar + beats;
            Some(tempo.millis_of_beat(beat)? - start)
        };
        Ok(Span::from_millis_f64(millis().unwrap_or(0.0)))
    }

    /// A position such as `bar 3 beat 2`, as time from the beginning; `None` if the text is no position.
    pub(crate) fn position(&self, text: &str) -> Option<Result<Span, Unmusical>> {
        let (bar, beat) = position(text)?;
        let Some(tempo) = self.tempo.as_ref() else { return Some(Err(Unmusical::WithoutTempo)) };
        Some(Ok(Span::from_millis_f64(tempo.position(bar, beat).unwrap_or(0.0))))
    }
}

/// `bar 3 beat 2` or `bar 3`, as bars and beats from 0.
pub(crate) fn position(text: &str) -> Option<(f64, f64)> {
    let words: Vec<_> = text.split_whitespace().collect();
    let (bar, beat) = match words.as_slice() {
        ["bar", bar] => (bar.parse::<u32>().ok()?, 1.0),
        ["bar", bar, "beat", beat] => (bar.parse::<u32>().ok()?, beat.parse::<f64>().ok()?),
        _ => return None,
    };
    ((1..=1_000_000).contains(&bar) && (1.0..=1_000.0).contains(&beat))
        .then(|| (f64::from(bar) - 1.0, beat - 1.0))
}

/// `4 beats`, `1 bar`, `1 bar 2 beats`, as bars and beats.
fn length(text: &str) -> Option<(f64, f64)> {
    let words: Vec<_> = text.split_whitespace().collect();
    let number = |word: &str| word.parse::<f64>().ok().filter(|value| *value >= 0.0 && *value <= 1e6);
    match words.as_slice() {
        [n, "beat" | "beats"] => Some((0.0, number(n)?)),
        [n, "bar" | "bars"] => Some((number(n)?, 0.0)),
        [bars, "bar" | "bars", beats, "beat" | "beats"] => Some((number(bars)?, number(beats)?)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn music(start: Option<i64>) -> Music {
        let sections = [
            Section { bar: 0.0, beats_a_minute: 120.0, beats_a_bar: 4.0 },
            Section { bar: 2.0, beats_a_minute: 60.0, beats_a_bar: 3.0 },
        ];
        Music { tempo: Some(Arc::new(Tempo::new(&sections))), start: start.map(Span::from_millis) }
    }

    #[test]
    fn positions_follow_the_changes_of_tempo_and_signature() {
        let millis = |text| music(None).position(text).unwrap().unwrap().as_millis_f64();
        assert_eq!(millis("bar 1"), 0.0);
        assert_eq!(millis("bar 1 beat 2.5"), 750.0);
        assert_eq!(millis("bar 3"), 4_000.0);
        assert_eq!(millis("bar 4 beat 2"), 8_000.0);
        assert!(music(None).position("4 beats").is_none());
    }

    #[test]
    fn a_length_across_a_change_counts_the_beats_of_both_tempos() {
        let millis = |start, text| music(Some(start)).span(text).unwrap().unwrap().as_millis_f64();
        assert_eq!(millis(0, "4 beats"), 2_000.0);
        assert_eq!(millis(3_000, "4 beats"), 3_000.0);
        assert_eq!(millis(4_000, "1 bar 1 beat"), 4_000.0);
    }

    #[test]
    fn a_length_under_changing_tempo_needs_a_fixed_start() {
        assert_eq!(music(None).span("2 beats"), Some(Err(Unmusical::StartNotFixed)));
        assert_eq!(Music::default().span("2 beats"), Some(Err(Unmusical::WithoutTempo)));
        assert_eq!(music(None).span("2 parsecs"), None);
    }
}
