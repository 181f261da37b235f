//! Requirements, and the possible results of their checks.

use serde::Serialize;

use super::trial::Trial;

/// A requirement that the protocol imposes on robots, with the check for it.
#[derive(Clone, Copy, Debug)]
pub struct Requirement {
    /// The name of the requirement, as in the option `--only`.
    pub name: &'static str,
    /// The number of the demand: the profile of the protocol that contains it, and its number within the profile.
    pub number: &'static str,
    /// The requirement in one sentence.
    pub demands: &'static str,
    /// The section of `docs/protocol.md` that states the requirement.
    pub section: &'static str,
    pub(super) check: fn(&Trial) -> Checked,
}

/// The result of a check: a note for people, possibly empty, or the reason why the robot did not pass.
pub(super) type Checked = Result<String, Unmet>;

/// Why a robot did not pass the check of a requirement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Unmet {
    /// The robot violates the requirement. Contains the sent, the received and the expected message.
    Failed(String),
    /// The robot does not declare a capability that the check needs.
    NotApplicable(String),
    /// The operator interrupted the check.
    Interrupted,
}

impl Requirement {
    /// Whether `text` is the name or the number of the requirement.
    #[must_use]
    pub fn is_called(&self, text: &str) -> bool {
        self.name == text || self.number == text
    }
}

impl Unmet {
    /// Rewrites the reason if this is a failure, to add context.
    pub(super) fn within(self, tell: impl FnOnce(String) -> String) -> Self {
        match self {
            Self::Failed(why) => Self::Failed(tell(why)),
            other => other,
        }
    }
}

/// Whether a robot meets a requirement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The robot meets the requirement.
    Pass,
    /// The robot violates the requirement, or stopped responding during the check.
    Fail,
    /// The robot does not declare a capability that the check needs.
    NotApplicable,
}

impl Verdict {
    /// Returns the verdict as short text for people.
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
    /// The name of the requirement.
    pub requirement: &'static str,
    /// The number of the demand.
    pub number: &'static str,
    /// The result of the check.
    pub verdict: Verdict,
    /// After a failure: the sent, the received and the expected message. After a pass: the measurement, if any.
    pub why: String,
    /// Duration of the check in milliseconds.
    pub millis: u64,
}

/// Returns a pass without a note.
pub(super) fn pass() -> Checked {
    Ok(String::new())
}

/// Creates a failure in the standard wording: the sent, the received and the expected message.
pub(super) fn differs(sent: &str, came: &str, expected: &str) -> Unmet {
    Unmet::Failed(format!("sent {}; received {}; expected {expected}", shown(sent), shown(came)))
}

pub(super) fn not_applicable(why: impl Into<String>) -> Unmet {
    Unmet::NotApplicable(why.into())
}

/// Maximum number of characters of a quoted line.
const SHOWN_CHARS_MAX: usize = 400;

/// Quotes a line in a sentence. A long line is cut and followed by its length.
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
        let all = super::super::requirements;
        let mut names: Vec<_> = all().flat_map(|r| [r.name, r.number]).collect();
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
    fn long_line_is_cut_between_characters_and_shows_its_length() {
        let line = "\u{44f}".repeat(500);
        let text = shown(&line);
        assert!(text.ends_with("... (1000 bytes)"), "{text}");
        assert_eq!(text.chars().filter(|c| *c == '\u{44f}').count(), SHOWN_CHARS_MAX);
    }
}
