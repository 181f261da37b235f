//! The locations of a scenario's cues and their relations, for a view that shows a plan next to its files.

use std::borrow::Cow;

use serde::Serialize;
use urrcp::{RobotId, Span};

use super::cast::Cast;
use super::knots_max;
use crate::budget::Budget;
use crate::fields::Reader;
use crate::files::Files;
use crate::finding::Place;
use crate::fleet::Fleet;
use crate::locate::lines_of;
use crate::scenario::{self, Act, Anchor, Cue, Documents, Relation};
use crate::source::Source;

/// The cues of a scenario, with their locations in its files.
#[derive(Clone, Debug, Default)]
pub struct Outline {
    /// The scenario, then its included files in the order in which they were read.
    pub sources: Vec<Source>,
    /// Acts in the order of the file.
    pub acts: Vec<WrittenAct>,
}

/// The cues of an act as written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WrittenAct {
    /// Name of the act; empty if the scenario has no acts of its own.
    pub name: String,
    /// Cues of the act in the order of the file.
    pub cues: Vec<WrittenCue>,
}

/// A cue as written, with its lines in the file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WrittenCue {
    /// Ids of the cue's robots, in the cue's order.
    pub robots: Vec<RobotId>,
    /// Index of the file in [`Outline::sources`].
    pub source: usize,
    /// First line of the cue, from 1.
    pub first_line: usize,
    /// Last line of the cue, from 1.
    pub last_line: usize,
    /// Constraints between this cue and other cues or the act.
    pub relations: Vec<WrittenRelation>,
}

/// A relation of a cue, for display.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WrittenRelation {
    /// Text of the relation, for example `after the end of raise + 500 ms`.
    pub text: String,
    /// Index, within the act, of the other cue; `None` if the relation refers to the act itself.
    pub cue: Option<usize>,
    /// The relation as an inequality of two instants; `None` if it refers to the act itself.
    #[serde(skip)]
    pub gap: Option<Gap>,
}

/// An inequality: the time from `from` to `to` is at least `least` and, if `most` is set, at most `most`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The reference instant.
    pub from: Moment,
    /// The constrained instant.
    pub to: Moment,
    /// Least time from `from` to `to`; negative if `to` may come first.
    pub least: Span,
    /// Largest time from `from` to `to`; `None` if there is no upper bound.
    pub most: Option<Span>,
}

/// The start or the end of a cue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// Start of the cue with this index in its act.
    StartOf(usize),
    /// End of the cue with this index in its act.
    EndOf(usize),
}

impl Moment {
    /// Returns the index of the cue in its act.
    #[must_use]
    pub const fn cue(self) -> usize {
        match self {
            Self::StartOf(cue) | Self::EndOf(cue) => cue,
        }
    }
}

/// Returns the outline of a scenario. If the scenario does not compile, the outline contains the readable parts.
#[must_use]
pub fn outline(source: &Source, fleet: &Fleet, files: &dyn Files) -> Outline {
    let Ok(documents) = scenario::documents(source, files) else { return Outline::default() };
    let mut reader = Reader::default();
    reader.knots = Budget::new(knots_max(fleet));
    let Some(scenario) = scenario::read(&mut reader, &documents, files, fleet) else {
        return Outline::default();
    };
    let Documents { sources, .. } = documents;
    let cast = Cast::new(fleet, &scenario.roles);
    let places: Vec<&Place> = scenario.acts.iter().flat_map(|act| &act.cues).map(|cue| &cue.place).collect();
    let mut lines = lines_of(&sources, &places).into_iter();
    let mut acts = Vec::with_capacity(scenario.acts.len());
    for act in &scenario.acts {
        let written = |(own, (cue, (first_line, last_line))): (usize, (&Cue, (usize, usize)))| {
            let members = cast.members(&mut reader, cue, scenario.horizon()).all;
            WrittenCue {
                robots: members.iter().map(|member| cast.id(member.robot).clone()).collect(),
                source: usize::from(cue.place.file),
                first_line,
                last_line,
                relations: cue.relations.iter().map(|relation| relation.written(act, own)).collect(),
            }
        };
        let cues = act.cues.iter().zip(lines.by_ref()).enumerate().map(written).collect();
        acts.push(WrittenAct { name: act.name.clone(), cues });
    }
    Outline { sources: sources.into_iter().map(Cow::into_owned).collect(), acts }
}

impl Relation {
    /// Describes the relation for display. `own` is the index of the cue that has the relation.
    fn written(&self, act: &Act, own: usize) -> WrittenRelation {
        let other = [&self.from, &self.to].into_iter().find_map(|anchor| match anchor {
            Anchor::StartOf(cue) | Anchor::EndOf(cue) => Some(cue),
            Anchor::Origin | Anchor::Start | Anchor::End => None,
        });
        let cue = other.and_then(|name| act.cues.iter().position(|cue| cue.name == *name));
        let moment = |anchor: &Anchor| match anchor {
            Anchor::Origin => None,
            Anchor::Start => Some(Moment::StartOf(own)),
            Anchor::End => Some(Moment::EndOf(own)),
            Anchor::StartOf(_) => cue.map(Moment::StartOf),
            Anchor::EndOf(_) => cue.map(Moment::EndOf),
        };
        let both = moment(&self.from).zip(moment(&self.to)).filter(|_| cue.is_some());
        let gap =
            both.map(|(from, to)| Gap { from, to, least: self.min.unwrap_or_default(), most: self.max });
        WrittenRelation { text: self.text(), cue, gap }
    }

    fn text(&self) -> String {
        let (least, most) = (self.min.unwrap_or_default(), self.max);
        match (&self.from, &self.to) {
            (Anchor::Origin, Anchor::Start) => format!("at {}", range(least, most)),
            (Anchor::Origin, _) => format!("ends by {}", most.unwrap_or(least)),
            (Anchor::End, to) => format!("ends before {}{}", to.told(), gap('-', least, most)),
            (from, _) if most == Some(least) => format!("with {}{}", from.told(), gap('+', least, None)),
            (from, _) => format!("after {}{}", from.told(), gap('+', least, most)),
        }
    }
}

impl Anchor {
    fn told(&self) -> String {
        match self {
            Self::StartOf(cue) => format!("the start of {cue}"),
            Self::EndOf(cue) => format!("the end of {cue}"),
            Self::Origin => "the start of the act".to_owned(),
            Self::Start => "its start".to_owned(),
            Self::End => "its end".to_owned(),
        }
    }
}

/// Formats the time between two instants, for example ` + 500 ms` or ` + 1 s to 2 s`. Returns an empty string if no time is required.
fn gap(sign: char, least: Span, most: Option<Span>) -> String {
    match (least, most) {
        (Span::ZERO, None) => String::new(),
        (least, most) => format!(" {sign} {}", range(least, most)),
    }
}

fn range(least: Span, most: Option<Span>) -> String {
    match most.filter(|most| *most != least) {
        Some(most) => format!("{least} to {most}"),
        None => least.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoFiles;

    fn outlined(text: &str) -> Vec<WrittenCue> {
        let source = Source { name: "s.yaml".into(), text: text.to_owned() };
        outline(&source, &Fleet::default(), &NoFiles).acts.remove(0).cues
    }

    #[test]
    fn cue_spans_its_first_to_last_line() {
        let text = "scenario: s\ncues:\n  - cue: a\n    at: 0s\n    robots: r\n    tracks:\n      x:\n        - {at: 0s, to: 1}\n\
                    \n  # of b\n  - {cue: b, at: 1s,\n     robots: r}\n  - cue: c\n    robots: r\n# the end\n";
        let lines: Vec<_> = outlined(text).iter().map(|cue| (cue.first_line, cue.last_line)).collect();
        assert_eq!(lines, [(3, 8), (11, 12), (13, 14)]);
    }

    #[test]
    fn relations_are_described_in_plain_words() {
        let relations = |keys: &str| {
            let text =
                format!("scenario: s\ncues:\n  - {{cue: a, robots: r}}\n  - {{cue: b, robots: r, {keys}}}\n");
            let told = |relation: &WrittenRelation| (relation.text.clone(), relation.cue);
            outlined(&text)[1].relations.iter().map(told).collect::<Vec<_>>()
        };
        let of_a = |text: &str| vec![(text.to_owned(), Some(0))];
        assert_eq!(relations("after: a"), of_a("after the end of a"));
        assert_eq!(relations("after: start of a + 500ms"), of_a("after the start of a + 500 ms"));
        assert_eq!(relations("with: a"), of_a("with the start of a"));
        assert_eq!(relations("before: a - 1s"), of_a("ends before the start of a - 1 s"));
        assert_eq!(relations("at: 2s"), [("at 2 s".to_owned(), None)]);
        assert_eq!(
            relations("at: 2s, end_by: 9s"),
            [("at 2 s".to_owned(), None), ("ends by 9 s".to_owned(), None)]
        );
    }
}
