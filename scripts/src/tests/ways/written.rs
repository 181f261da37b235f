//! Writes a drawn show as the text of a scenario.

use super::{Act, Cue, Lease, ROBOTS, SENSOR, Show, Target, Waits, Word};

impl Target {
    fn yaml(self) -> String {
        match self {
            Self::Act(act) => name(act),
            Self::End => "end".to_owned(),
            Self::Nowhere => "nowhere".to_owned(),
        }
    }
}

impl Word {
    const fn yaml(self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Home => "home",
            Self::Without => "without",
        }
    }
}

pub(super) fn name(act: usize) -> String {
    format!("act-{act}")
}

impl Cue {
    pub(in crate::tests) fn yaml(&self) -> String {
        let robots: Vec<&str> = self.robots.iter().map(|robot| ROBOTS[*robot]).collect();
        let keyframe = |(at, to): &(i64, f64)| format!("{{at: {at}ms, to: {to}}}");
        let keyframes: Vec<String> = self.keyframes.iter().map(keyframe).collect();
        let control = if self.by_speed { "control: speed, " } else { "" };
        format!(
            "{{robots: [{}], at: {}ms, tracks: {{{}: {{{control}keyframes: [{}]}}}}}}",
            robots.join(", "),
            self.at,
            self.kind().name,
            keyframes.join(", ")
        )
    }
}

impl Act {
    fn head(&self, index: usize) -> String {
        let mut head = format!("act: {}", name(index));
        let waits = match self.waits {
            Waits::Done => "for: done".to_owned(),
            Waits::Operator => "for: operator".to_owned(),
            Waits::Time => "time: \"19:30\"".to_owned(),
            Waits::Above(above) => format!("sensor: b/{SENSOR}, above: {above}"),
            Waits::Nothing => "sensor: b/nose, above: 1".to_owned(),
        };
        let otherwise = self.otherwise.map(|target| format!(", timeout: 9s, otherwise: {}", target.yaml()));
        head.push_str(&format!(", wait: {{{waits}{}}}", otherwise.unwrap_or_default()));
        head.push_str(&self.next.map_or(String::new(), |next| format!(", next: {}", next.yaml())));
        let words =
            self.words.iter().map(|(robot, word)| (ROBOTS[*robot].to_owned(), word.yaml().to_owned()));
        let default = self.default.map(|word| ("default".to_owned(), word.yaml().to_owned()));
        let then = self.then.map(|then| ("then".to_owned(), name(then)));
        let rules: Vec<String> =
            words.chain(default).chain(then).map(|(key, value)| format!("{key}: {value}")).collect();
        if !rules.is_empty() {
            head.push_str(&format!(", on_failure: {{{}}}", rules.join(", ")));
        }
        head
    }
}

impl Show {
    /// Returns the lines of the scenario before the first act.
    fn head(&self) -> Vec<String> {
        let mut lines = vec!["scenario: s".to_owned()];
        lines.push(format!("off_grid: {}", if self.snap { "snap" } else { "refuse" }));
        lines.extend(match self.lease {
            Lease::Usual => None,
            Lease::None => Some("stop_condition: {running: none}".to_owned()),
            Lease::Of(lease) => Some(format!("stop_condition: {{running: {lease}ms}}")),
        });
        lines.extend(self.default.map(|word| format!("on_failure: {}", word.yaml())));
        lines.push("acts:".to_owned());
        lines
    }

    pub(in crate::tests) fn yaml(&self) -> String {
        let mut lines = self.head();
        for (index, act) in self.acts.iter().enumerate() {
            lines.push(format!("  - {{{}, cues: [", act.head(index)));
            lines.extend(act.cues.iter().map(|cue| format!("      {},", cue.yaml())));
            lines.push("    ]}".to_owned());
        }
        lines.join("\n") + "\n"
    }

    pub(in crate::tests) fn line_of_act(&self, act: usize) -> usize {
        self.head().len() + 1 + self.acts[..act].iter().map(|act| act.cues.len() + 2).sum::<usize>()
    }

    pub(in crate::tests) fn line_of_cue(&self, act: usize, cue: usize) -> usize {
        self.line_of_act(act) + 1 + cue
    }
}
