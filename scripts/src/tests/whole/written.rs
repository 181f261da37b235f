//! What is written: a drawn show as the text of a scenario.

use std::collections::HashMap;

use super::{Canon, Cue, DEVICES, Lag, NAMES, ROBOTS, SENSOR, Show, Tempo, When, Word};

/// The cue that plays a sequence.
pub(super) const SEQUENCE: &str = "q";

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
    fn yaml(&self, index: usize, csvs: &mut HashMap<String, String>, moves: &mut String) -> String {
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
        yaml.push_str(&self.change.yaml);
        let csv = format!("{}.csv", csvs.len());
        let written = self.movement.yaml.replace("c.csv", &csv);
        csvs.insert(csv, self.movement.csv.clone());
        let wish = self.tolerance.map_or(String::new(), |tolerance| format!("tolerance: {tolerance}, "));
        let tracks = format!("{{{}: {{{wish}{written}}}}}", DEVICES[self.device].0);
        if self.by_move {
            let own = format!("m{}", csvs.len());
            moves.push_str(&match self.halves() {
                _ if !self.composed => format!("  {own}: {{tracks: {tracks}}}\n"),
                None => format!("  {own}: {{play: [{{move: {own} inner}}]}}\n  {own} inner: {{tracks: {tracks}}}\n"),
                Some(halves) => {
                    let [one, other] = halves.map(|half| format!("{{{}: {{{wish}{half}}}}}", DEVICES[self.device].0));
                    format!(
                        "  {own}: {{play: [{{move: {own} one}}, {{move: {own} other}}]}}\n  {own} one: {{tracks: {one}}}\n  {own} other: {{tracks: {other}}}\n"
                    )
                }
            });
            yaml.push_str(&format!(", move: {own}"));
        } else {
            yaml.push_str(&format!(", tracks: {tracks}"));
        }
        yaml
    }

    /// The keyframes of a movement in beats as those of two, which meet at one of them. Without a fixed start each of the two
    /// would be laid on the clock by itself.
    fn halves(&self) -> Option<[String; 2]> {
        let keyframes = self.beats.as_ref().filter(|_| matches!(self.when, When::At(_) | When::Bar(_)))?;
        let middle = keyframes.len() / 2;
        let half = |keyframes: &[(i64, f64)]| {
            let from = keyframes[0].0;
            let text =
                |(at, to): &(i64, f64)| format!("{{at: {} beats, to: {to}}}", (at - from) as f64 / 4.0);
            format!("keyframes: [{}]", keyframes.iter().map(text).collect::<Vec<_>>().join(", "))
        };
        Some([half(&keyframes[..=middle]), half(&keyframes[middle..])])
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
                target.push_str(&format!("      - {{{}}}\n", cue.yaml(index, csvs, &mut moves)));
            }
            if by_sequence {
                acts.push_str(&format!("      - {{cue: {SEQUENCE}, at: 0s, sequence: s{index}}}\n"));
            }
        }
        let moves = if moves.is_empty() { moves } else { format!("moves:\n{moves}") };
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
