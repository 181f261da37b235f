//! Joins findings if the same mistake, such as a misspelt name, occurs at several places of a file.

use std::collections::HashMap;

use crate::finding::{Code, Finding, Related};

/// Maximum number of line numbers that a message lists.
const LISTED_MAX: usize = 5;

/// The beginning of every hint for a decimal comma, in numbers and in times.
const DECIMAL_POINT: &str = "write a decimal point";

/// Joins findings about the same mistake into the first one. Its message names the lines of the other findings, and its related places
/// list them for editors. Each finding is paired with a text about the uses through which its place was read, which is appended to its
/// message.
pub(super) fn join(findings: Vec<(Finding, String)>) -> Vec<Finding> {
    let mut first: HashMap<Mistake, usize> = HashMap::new();
    let mut joined: Vec<Finding> = Vec::with_capacity(findings.len());
    for (mut finding, uses) in findings {
        if let Some(mistake) = Mistake::of(&finding) {
            if let Some(known) = first.get(&mistake) {
                joined[*known].related.push(repeat(finding));
                continue;
            }
            first.insert(mistake, joined.len());
        }
        finding.message.push_str(&uses);
        joined.push(finding);
    }
    for finding in &mut joined {
        let repeats = finding.related.iter().filter(|place| place.is_repeat);
        let lines = repeats.map(|place| place.line).collect();
        finding.message.push_str(&others(finding.line, lines));
    }
    joined
}

/// Converts a finding to a related place, for the first finding about the same mistake.
fn repeat(finding: Finding) -> Related {
    let Finding { line, column, width, source_line, .. } = finding;
    Related { line, column, width, message: "the same mistake".to_owned(), source_line, is_repeat: true }
}

/// The parts of a finding that must be equal for two findings to be about the same mistake.
#[derive(PartialEq, Eq, Hash)]
struct Mistake {
    code: Code,
    message: String,
    expected: String,
    hint: Option<String>,
    /// The line and column of each related place after the first, such as the definition of a variable in the value.
    definitions: Vec<(usize, usize)>,
}

impl Mistake {
    /// Returns the mistake that a finding is about. `None` if the finding is not joined with others, because it involves several places
    /// or has a separate cause at each place.
    fn of(finding: &Finding) -> Option<Self> {
        let Finding { code, message, expected, hint, .. } = finding;
        let hint = hint.as_deref();
        let definitions =
            || finding.related.iter().skip(1).map(|place| (place.line, place.column)).collect::<Vec<_>>();
        if hint.is_some_and(|hint| hint.starts_with(DECIMAL_POINT)) {
            let (message, expected) = (String::new(), String::new());
            let hint = Some(DECIMAL_POINT.to_owned());
            return Some(Self { code: Code::WrongType, message, expected, hint, definitions: definitions() });
        }
        let (message, hint) = match code {
            // Two numbers may be wrong for different reasons.
            Code::WrongType if hint.is_none() => (message.clone(), None),
            // The same wrong notation of a time or a number is one mistake.
            Code::BadDuration | Code::WrongType => (any_number(message), hint.map(any_number)),
            Code::UnknownKey if message.starts_with("unknown key") => {
                (of_no_owner(message).to_owned(), hint.map(any_number))
            }
            Code::UnknownKey => (any_number(message), hint.map(any_number)),
            Code::InitializationBlock => (of_no_owner(message).to_owned(), hint.map(str::to_owned)),
            Code::OutOfRange | Code::OffGranularity => {
                (of_any_keyframe(message).to_owned(), hint.map(str::to_owned))
            }
            Code::ControlType
            | Code::UnknownAct
            | Code::UnknownCue
            | Code::UnknownDevice
            | Code::UnknownFormation
            | Code::UnknownMove
            | Code::UnknownPath
            | Code::UnknownRobot
            | Code::UnknownSensor
            | Code::UnknownSequence
            | Code::UnknownWord
            | Code::UnknownZone
            | Code::Variable
            | Code::WrongKind => (message.clone(), hint.map(str::to_owned)),
            _ => return None,
        };
        (finding.line > 0).then(|| Self {
            code: *code,
            message,
            expected: expected.clone(),
            hint,
            definitions: definitions(),
        })
    }
}

/// Replaces each number in a text by `#`.
fn any_number(text: &str) -> String {
    let is_digit = |c: char| c.is_ascii_digit() || c == '.';
    let mut plain = String::with_capacity(text.len());
    for c in text.chars() {
        match is_digit(c) {
            true if plain.ends_with('#') => {}
            true => plain.push('#'),
            false => plain.push(c),
        }
    }
    plain
}

/// Removes the name of the robot, or of the device in an initialization block, from the end of a message.
fn of_no_owner(message: &str) -> &str {
    let ends = [" in robot `", ", for `", ", for the device `"];
    let end = ends.iter().filter_map(|begin| message.find(begin)).min();
    &message[..end.unwrap_or(message.len())]
}

/// Removes the number of the keyframe from a message such as `keyframe 2: 120 lies outside ...`.
fn of_any_keyframe(message: &str) -> &str {
    let rest = message.strip_prefix("keyframe ").and_then(|rest| rest.split_once(": "));
    rest.map_or(message, |(_, rest)| rest)
}

/// Returns the end of a message, which lists the lines of the other places with the same mistake. `own` is the line of the finding.
fn others(own: usize, mut lines: Vec<usize>) -> String {
    let here = lines.iter().filter(|line| **line == own).count();
    lines.retain(|line| *line != own);
    lines.dedup();
    let here = match here {
        0 => None,
        1 => Some("again on this line".to_owned()),
        more => Some(format!("{more} more times on this line")),
    };
    let list = |lines: &[usize]| lines.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let elsewhere = match lines.as_slice() {
        [] => None,
        [line] => Some(format!("on line {line}")),
        [all @ .., last] if lines.len() <= LISTED_MAX => Some(format!("on lines {} and {last}", list(all))),
        lines => Some(format!(
            "on {} other lines ({} and {} more)",
            lines.len(),
            list(&lines[..3]),
            lines.len() - 3
        )),
    };
    match (here, elsewhere) {
        (None, None) => String::new(),
        (Some(only), None) | (None, Some(only)) => format!("; the same mistake {only}"),
        (Some(here), Some(elsewhere)) => format!("; the same mistake {here} and {elsewhere}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(code: Code, line: usize, message: &str, hint: &str) -> (Finding, String) {
        let mut finding = Finding::about_file(code, "s.yaml", message.into(), "a name", Some(hint.into()));
        finding.line = line;
        (finding, String::new())
    }

    fn messages(findings: Vec<(Finding, String)>) -> Vec<String> {
        join(findings).into_iter().map(|finding| finding.message).collect()
    }

    #[test]
    fn repeated_misspelling_is_one_finding_with_all_lines() {
        let typo = |line| found(Code::UnknownMove, line, "no move `wvae`", "did you mean `wave`?");
        assert_eq!(messages(vec![typo(3)]), ["no move `wvae`"]);
        assert_eq!(messages(vec![typo(3), typo(7)]), ["no move `wvae`; the same mistake on line 7"]);
        let all = vec![typo(3), typo(3), typo(4), typo(4), typo(9)];
        let expected = "no move `wvae`; the same mistake again on this line and on lines 4 and 9";
        assert_eq!(messages(all), [expected]);
        let many = "no move `wvae`; the same mistake on 9 other lines (2, 3, 4 and 6 more)";
        assert_eq!(messages((1..11).map(typo).collect()), [many]);
    }

    #[test]
    fn joined_findings_list_other_positions_as_related() {
        let mut first = found(Code::UnknownMove, 3, "no move `wvae`", "did you mean `wave`?");
        let mut second = found(Code::UnknownMove, 7, "no move `wvae`", "did you mean `wave`?");
        (first.0.column, second.0.column, second.0.width) = (4, 9, 4);
        second.0.source_line = "move: wvae".into();
        let joined = join(vec![first, second]);
        let expected = Related {
            line: 7,
            column: 9,
            width: 4,
            message: "the same mistake".into(),
            source_line: "move: wvae".into(),
            is_repeat: true,
        };
        assert_eq!(joined[0].related, [expected]);
        let result = &crate::sarif::sarif(&joined)["runs"][0]["results"][0];
        let region = &result["relatedLocations"][0]["physicalLocation"]["region"];
        assert_eq!(*region, serde_json::json!({"startLine": 7, "startColumn": 9, "endColumn": 13}));
        // The message names the line for human readers, so the text shows only the first place.
        let text = crate::render::render(&joined, false);
        assert!(text.contains("; the same mistake on line 7") && !text.contains("move: wvae"), "{text}");
    }

    #[test]
    fn numbers_with_same_mistake_are_joined_but_names_are_not() {
        let time = |line, value| {
            found(Code::BadDuration, line, &format!("the time {value} has no unit"), &format!("`{value}s`"))
        };
        let expected = "the time 0 has no unit; the same mistake on lines 2 and 3";
        assert_eq!(messages(vec![time(1, "0"), time(2, "1.5"), time(3, "20")]), [expected]);
        let robot = |line, name| found(Code::UnknownRobot, line, &format!("no robot `{name}`"), "none");
        assert_eq!(messages(vec![robot(1, "cf1"), robot(2, "cf2")]).len(), 2);
        let missing = |line| found(Code::MissingKey, line, "a cue has no `robots`", "none");
        assert_eq!(messages(vec![missing(1), missing(2)]).len(), 2);
    }
}
