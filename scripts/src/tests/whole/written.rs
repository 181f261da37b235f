//! Writes a drawn show as the text of a scenario.

use std::collections::HashMap;
use std::ops::Range;

use super::super::verified::EVERY;
use super::spread::Each;
use super::{Canon, Cue, DEVICES, Lag, NAMES, ROBOTS, SENSOR, Show, Tempo, When, Word};

/// Name of the cue that plays a sequence.
pub(super) const SEQUENCE: &str = "q";
/// Name of the file that contains the moves; `COPY` is the prefix that the moves have in the scenario.
const INCLUDED: &str = "moves.yaml";
const COPY: &str = "lib.";

fn quarters(value: i64) -> String {
    (value as f64 / 4.0).to_string()
}

fn beats(quarters: i64) -> String {
    format!("{} beats", self::quarters(quarters))
}

fn name(cue: usize) -> String {
    format!("c{cue}")
}

impl Lag {
    fn yaml(self, sign: char) -> String {
        let signed = |millis: i64| if millis < 0 { format!("-{}ms", -millis) } else { format!("{millis}ms") };
        match self {
            Self::None => String::new(),
            Self::One(millis) if millis < 0 => {
                let other = if sign == '+' { '-' } else { '+' };
                format!(" {other} {}ms", -millis)
            }
            Self::One(millis) => format!(" {sign} {millis}ms"),
            Self::Range(least, largest) => format!(" {sign} {}..{}", signed(least), signed(largest)),
            Self::Beats(quarters) => format!(" {sign} {} beats", quarters as f64 / 4.0),
        }
    }
}

impl Canon {
    fn yaml(self) -> String {
        match self {
            Self::Even(step) => format!("{step}ms"),
            Self::Growing(gap) => format!("$index * {gap}ms"),
            Self::Backward(step) => format!("{{step: {step}ms, direction: backward}}"),
            Self::Outward(step) => format!("{{step: {step}ms, direction: outward}}"),
            Self::Inward(step) => format!("{{direction: inward, step: {step}ms}}"),
            Self::Ranked(step) => format!("{{step: {step}ms, by: x}}"),
            Self::Speed(quarters) => format!("{{speed: {}, by: x}}", quarters as f64 / 4.0),
            Self::Over(millis) => format!("{{over: {millis}ms}}"),
        }
    }
}

impl Cue {
    fn yaml(
        &self,
        index: usize,
        csvs: &mut HashMap<String, String>,
        moves: &mut String,
        by_include: bool,
    ) -> String {
        let mut yaml = format!("cue: {}, robots: {}", name(index), NAMES[self.who].0);
        match self.when {
            When::Free => {}
            When::At(millis) => yaml.push_str(&format!(", at: {millis}ms")),
            When::Each(millis, gap) => yaml.push_str(&format!(", at: {millis}ms + $index * {gap}ms")),
            When::Between(least, largest) => yaml.push_str(&format!(", at: {least}ms..{largest}ms")),
            When::Bar(bar) => yaml.push_str(&format!(", at: bar {bar}")),
            When::EndBy(millis) => yaml.push_str(&format!(", end_by: {millis}ms")),
        }
        for (word, key, sign) in
            [(Word::After, "after", '+'), (Word::With, "with", '+'), (Word::Before, "before", '-')]
        {
            let all = self.relations.iter().filter(|relation| relation.word == word);
            let all: Vec<String> = all
                .map(|relation| {
                    let end = match relation.end {
                        None => "",
                        Some(true) => "end of ",
                        Some(false) => "start of ",
                    };
                    format!("\"{end}{}{}\"", name(relation.other), relation.lag.yaml(sign))
                })
                .collect();
            if !all.is_empty() {
                yaml.push_str(&format!(", {key}: [{}]", all.join(", ")));
            }
        }
        if let Some((least, largest)) = self.stretch {
            let duration =
                if least == largest { format!("{least}ms") } else { format!("{least}ms..{largest}ms") };
            yaml.push_str(&format!(", duration: {duration}"));
        }
        yaml.push_str(&self.canon.map_or(String::new(), |canon| format!(", canon: {}", canon.yaml())));
        if let Some((robot, millis)) = self.late {
            yaml.push_str(&format!(", overrides: {{{}: {{delay: {millis}ms}}}}", ROBOTS[robot]));
        }
        yaml.push_str(&self.zone.map_or(String::new(), |zone| format!(", uses: z{zone}")));
        yaml.push_str(&self.apart.map_or(String::new(), |other| format!(", apart: {}", name(other))));
        if !self.reads.is_empty() {
            let times: Vec<String> = self.reads.iter().map(|millis| format!("{millis}ms")).collect();
            yaml.push_str(&format!(", read: {{{SENSOR}: [{}]}}", times.join(", ")));
        }
        if let Some((by, about)) = self.scale {
            let by = by.yaml("", quarters);
            yaml.push_str(&match about {
                0 => format!(", scale: {by}"),
                _ => format!(", scale: {{by: {by}, about: {about}}}"),
            });
        }
        yaml.push_str(&self.change.yaml.replace(EVERY, &self.every()));
        let csv = format!("{}.csv", csvs.len());
        csvs.insert(csv.clone(), self.movement.csv.clone());
        let wish = self.tolerance.map_or(String::new(), |tolerance| format!("tolerance: {tolerance}, "));
        let tracks = |some: Range<usize>| {
            let written = match &self.beats {
                Some(_) => self.keyframes(some, by_include && self.by_move),
                None => self.movement.yaml.replace("c.csv", &csv),
            };
            format!("{{{}: {{{wish}{written}}}}}", DEVICES[self.device].0)
        };
        let all = 0..self.beats.as_ref().map_or(0, Vec::len);
        if !self.by_move {
            yaml.push_str(&format!(", tracks: {}", tracks(all)));
            return yaml;
        }
        let own = format!("m{}", csvs.len());
        let copy = if by_include { COPY } else { "" };
        let given = |name: &str, value: &str| format!("{name}: {value}");
        let unset = |name: &str, _: &str| format!("{name}: ~");
        let passed = |name: &str, _: &str| format!("{name}: ${name}");
        let outer = match self.parameters {
            Some(true) => self.needed(all.clone(), given),
            _ => self.needed(all.clone(), unset),
        };
        if self.parameters == Some(false) {
            yaml.push_str(&format!(", {}move: {copy}{own}", self.needed(all.clone(), given)));
        } else {
            yaml.push_str(&format!(", move: {copy}{own}"));
        }
        if !self.composed {
            moves.push_str(&format!("  {own}: {{{outer}tracks: {}}}\n", tracks(all)));
            return yaml;
        }
        let parts = match self.halves() {
            Some([one, other]) => vec![("one", one), ("other", other)],
            None => vec![("inner", all)],
        };
        let play = parts
            .iter()
            .map(|(name, part)| format!("{{{}move: {own} {name}}}", self.needed(part.clone(), passed)));
        moves.push_str(&format!("  {own}: {{{outer}play: [{}]}}\n", play.collect::<Vec<_>>().join(", ")));
        for (name, part) in parts {
            let parameters = self.needed(part.clone(), unset);
            moves.push_str(&format!("  {own} {name}: {{{parameters}tracks: {}}}\n", tracks(part)));
        }
        yaml
    }

    /// Returns the text of the interval between repetitions: the length of the longest movement plus the pause.
    fn every(&self) -> String {
        let longest = match &self.beats {
            Some(keyframes) => beats(keyframes[keyframes.len() - 1].0.most()),
            None => format!("{}ms", self.movement.ways[self.movement.ways.len() - 1].end),
        };
        self.pause.yaml(&format!("{longest} + "), |millis| format!("{millis}ms"))
    }

    /// Writes a range of the keyframes in beats. Their times are relative to the first keyframe of the range.
    fn keyframes(&self, some: Range<usize>, in_units: bool) -> String {
        let keyframes = self.beats.as_deref().unwrap_or_default();
        let from = keyframes[some.start].0.most();
        let is_parameter = |each: Each| self.by_move && self.parameters.is_some() && each.differs();
        let text = |index: usize| {
            let (at, to) = keyframes[index];
            let at = if is_parameter(at) { format!("$t{index}") } else { at.plus(-from).yaml("", beats) };
            let to = match (is_parameter(to), to) {
                (true, _) => format!("$p{index}"),
                (false, Each::Same(_)) if in_units => format!("{} * $unit", to.yaml("", quarters)),
                (false, _) => to.yaml("", quarters),
            };
            format!("{{at: {at}, to: {to}}}")
        };
        format!("keyframes: [{}]", some.map(text).collect::<Vec<_>>().join(", "))
    }

    /// Writes the parameters that a range of the keyframes needs.
    fn needed(&self, some: Range<usize>, text: impl Fn(&str, &str) -> String) -> String {
        let keyframes = self.beats.as_deref().filter(|_| self.parameters.is_some()).unwrap_or_default();
        let of = |index: usize| {
            let (at, to) = *keyframes.get(index)?;
            let at = at.differs().then(|| text(&format!("t{index}"), &at.yaml("", beats)));
            let to = to.differs().then(|| text(&format!("p{index}"), &to.yaml("", quarters)));
            Some(at.into_iter().chain(to))
        };
        let all: Vec<String> = some.filter_map(of).flatten().collect();
        if all.is_empty() { String::new() } else { format!("parameters: {{{}}}, ", all.join(", ")) }
    }

    /// Splits the keyframes of a movement in beats into two movements that meet at one of the keyframes. This requires a fixed start:
    /// otherwise, each half would be rounded to nanoseconds separately.
    fn halves(&self) -> Option<[Range<usize>; 2]> {
        let several = self.beats.as_ref().filter(|keyframes| keyframes.len() > 1);
        let keyframes = several.filter(|_| matches!(self.when, When::At(_) | When::Bar(_)))?;
        let middle = keyframes.len() / 2;
        let is_fixed = !keyframes[keyframes.len() - 1].0.differs();
        is_fixed.then_some([0..middle + 1, middle..keyframes.len()])
    }
}

impl Show {
    pub(super) fn yaml(&self, csvs: &mut HashMap<String, String>) -> String {
        let order = if self.auto { "auto" } else { "given" };
        let mut moves = String::new();
        let (mut acts, mut sequences) = (String::new(), String::new());
        for (index, act) in self.acts.iter().enumerate() {
            acts.push_str(&format!("  - act: a{index}\n    cues:\n"));
            let by_sequence = self.by_sequence && !act.iter().any(|cue| matches!(cue.when, When::Bar(_)));
            let target = if by_sequence { &mut sequences } else { &mut acts };
            if by_sequence {
                target.push_str(&format!("  s{index}:\n    cues:\n"));
            }
            for (index, cue) in act.iter().enumerate() {
                let cue = cue.yaml(index, csvs, &mut moves, self.by_include);
                target.push_str(&format!("      - {{{cue}}}\n"));
            }
            if by_sequence {
                acts.push_str(&format!("      - {{cue: {SEQUENCE}, at: 0s, sequence: s{index}}}\n"));
            }
        }
        let mut moves = if moves.is_empty() { moves } else { format!("moves:\n{moves}") };
        if self.by_include {
            let file = format!("parameters: {{one: 3}}\nvariables: {{unit: $one / 2}}\n{moves}");
            csvs.insert(INCLUDED.to_owned(), file);
            moves = format!("include: {{file: {INCLUDED}, as: lib, parameters: {{one: 2}}}}\n");
        }
        let sequences = if sequences.is_empty() { sequences } else { format!("sequences:\n{sequences}") };
        format!(
            "scenario: s\noff_grid: snap\n{}zones: {{z0: {order}, z1: given}}\nroles: {{cast: [b, c]}}\n{moves}{sequences}acts:\n{acts}",
            self.tempo_yaml()
        )
    }

    fn tempo_yaml(&self) -> String {
        let bpm = |tempo: &Tempo| format!("{}.{:02}", tempo.bpm / 100, tempo.bpm % 100);
        let signature = |tempo: &Tempo, sign: &str| {
            tempo
                .signature
                .map_or(String::new(), |(upper, lower)| format!("{sign}signature: {upper}/{lower}"))
        };
        if let [only] = self.tempos.as_slice() {
            return format!("tempo: {}\n{}\n", bpm(only), signature(only, ""));
        }
        let item = |tempo: &Tempo| {
            format!("{{at: bar {}, bpm: {}{}}}", tempo.bar, bpm(tempo), signature(tempo, ", "))
        };
        format!("tempo: [{}]\n", self.tempos.iter().map(item).collect::<Vec<_>>().join(", "))
    }
}
