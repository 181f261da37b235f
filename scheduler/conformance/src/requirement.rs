//! A requirement, how a check of it ends, and how that is told.

use serde::Serialize;

use super::trial::Trial;

/// Something that the protocol demands of a robot, with the check that shows it.
#[derive(Clone, Copy, Debug)]
pub struct Requirement {
    /// Its name, as `--only` takes it.
    pub name: &'static str,
    /// One sentence: what it demands.
    pub demands: &'static str,
    /// The section of `docs/protocol.md` that says so.
    pub section: &'static str,
    pub(super) check: fn(&Trial) -> Checked,
}

/// What a check comes to: a note for people, empty where there is nothing to say, or why it was not passed.
pub(super) type Checked = Result<String, Unmet>;

/// Why a requirement was not passed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Unmet {
    /// The robot does something else: what was sent, what came, what was expected.
    Failed(String),
    /// The robot does not declare what the check needs.
    NotApplicable(String),
    /// The operator has had enough.
    Interrupted,
}

impl Unmet {
    /// A failure as one of something larger.
    pub(super) fn within(self, tell: impl FnOnce(String) -> String) -> Self {
        match self {
            Self::Failed(why) => Self::Failed(tell(why)),
            other => other,
        }
    }
}

/// How a requirement was judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The robot does what is demanded.
    Pass,
    /// It does not, or died over it.
    Fail,
    /// It does not declare what the check needs.
    NotApplicable,
}

impl Verdict {
    /// For people.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "fail",
            Self::NotApplicable => "n/a",
        }
    }
}

/// The verdict on one requirement.
#[derive(Clone, Debug, Serialize)]
pub struct Judged {
    /// The requirement's name.
    pub requirement: &'static str,
    /// How it was judged.
    pub verdict: Verdict,
    /// What was sent, what came and what was expected; for a pass what was measured, if anything.
    pub why: String,
    /// How long the check took.
    pub millis: u64,
}

/// A pass with nothing to say.
pub(super) fn pass() -> Checked {
    Ok(String::new())
}

/// A failure in the words that every one of them uses.
pub(super) fn differs(sent: &str, came: &str, expected: &str) -> Unmet {
    Unmet::Failed(format!("sent {}; came {}; expected {expected}", shown(sent), shown(came)))
}

pub(super) fn not_applicable(why: impl Into<String>) -> Unmet {
    Unmet::NotApplicable(why.into())
}

/// Characters of a line that a sentence quotes.
const SHOWN_CHARS_MAX: usize = 400;

/// A line as a sentence quotes it: the beginning of a long one, and its length.
pub(super) fn shown(line: &str) -> String {
    let line = line.trim_end();
    match line.char_indices().nth(SHOWN_CHARS_MAX) {
        None => line.to_owned(),
        Some((end, _)) => format!("{}... ({} bytes)", &line[..end], line.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_every_demand_is_one_sentence() {
        let mut names: Vec<_> = super::super::requirements().map(|requirement| requirement.name).collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
        for requirement in super::super::requirements() {
            assert!(
                requirement.demands.ends_with('.') && !requirement.demands.contains(". "),
                "{requirement:?}"
            );
        }
    }

    #[test]
    fn a_long_line_is_cut_between_characters_and_its_length_told() {
        let line = "\u{44f}".repeat(500);
        let text = shown(&line);
        assert!(text.ends_with("... (1000 bytes)"), "{text}");
        assert_eq!(text.chars().filter(|c| *c == '\u{44f}').count(), SHOWN_CHARS_MAX);
    }
}
