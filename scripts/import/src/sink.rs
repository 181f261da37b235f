//! The messages of an import: findings with their places, and notes about the rules that the import applied.

use downbeat_reader::fields::Reader;
use downbeat_yaml::finding::{Code, Finding, Severity};
use downbeat_yaml::locate::locate;
use downbeat_yaml::source::Source;

use super::{Clearance, KEYFRAMES_MAX, Motion};

/// Maximum number of findings per file, because a file of a different format is wrong in every line.
pub(super) const FINDINGS_A_FILE_MAX: usize = 100;
/// Maximum length, in bytes, of the source line that a finding quotes.
const LINE_BYTES_MAX: usize = 4_000;

/// Collects notes and findings.
#[derive(Default)]
pub(super) struct Sink {
    pub(super) notes: Vec<String>,
    pub(super) findings: Vec<Finding>,
    /// Number of keyframes so far, which limits the size of the import.
    keyframes: usize,
    /// Number of values that repeat the previous value, because the file contains a pause or leaves a device out.
    pub(super) held: usize,
    /// The minimum distance between robots, if the files state it.
    pub(super) clearance: Option<Clearance>,
}

/// A place in a text file: part of a line.
#[derive(Clone, Copy)]
pub(super) struct Spot<'a> {
    /// The number of the line, counted from 1.
    pub(super) line: usize,
    pub(super) text: &'a str,
    /// The byte offset of the part in the line; `width` is the part's length in bytes.
    pub(super) start: usize,
    pub(super) width: usize,
}

impl Sink {
    pub(super) fn note(&mut self, text: impl Into<String>) {
        self.notes.push(text.into());
    }

    /// Adds a finding about a part of a line.
    pub(super) fn found(
        &mut self,
        source: &Source,
        spot: Spot<'_>,
        code: Code,
        message: impl Into<String>,
        expected: impl Into<String>,
        hint: Option<&str>,
    ) {
        let before = &spot.text[..spot.start];
        let inside = &spot.text[spot.start..spot.start + spot.width];
        self.push(Finding {
            code,
            severity: Severity::Error,
            file: source.name.clone(),
            line: spot.line,
            column: before.chars().count() + 1,
            width: inside.chars().count().max(1),
            message: message.into(),
            expected: expected.into(),
            hint: hint.map(str::to_owned),
            source_line: shown(spot.text, spot.start),
            related: Vec::new(),
        });
    }

    /// Adds a finding for a text that is not valid JSON, at the place of the error.
    pub(super) fn found_json(&mut self, source: &Source, error: &serde_json::Error) {
        let text = source.text.lines().nth(error.line().saturating_sub(1)).unwrap_or("");
        let start = (0..=error.column().saturating_sub(1).min(text.len())).rev();
        let start = start.into_iter().find(|start| text.is_char_boundary(*start)).unwrap_or(0);
        let message = error.to_string();
        let message = message.split(" at line ").next().unwrap_or("").to_owned();
        let spot = Spot { line: error.line(), text, start, width: 0 };
        self.found(source, spot, Code::Syntax, message, "a JSON document", None);
    }

    /// Adds a finding about a file as a whole.
    pub(super) fn about(
        &mut self,
        file: &str,
        code: Code,
        message: String,
        expected: &str,
        hint: Option<&str>,
    ) {
        self.push(Finding::about_file(code, file, message, expected, hint.map(str::to_owned)));
    }

    /// Adds findings whose places are paths in a parsed document.
    pub(super) fn located(&mut self, source: &Source, findings: Reader) {
        let mut pending = findings.found;
        pending.truncate(FINDINGS_A_FILE_MAX + 1);
        for finding in locate(std::slice::from_ref(source), pending) {
            self.push(with_short_line(finding));
        }
    }

    /// Whether a file has reached the maximum number of findings, so that further findings are not reported.
    pub(super) fn is_full(&self, source: &Source) -> bool {
        self.of(&source.name) > FINDINGS_A_FILE_MAX
    }

    /// Counts keyframes, and adds a finding if the import becomes too large.
    pub(super) fn count(&mut self, motions: &[Motion], file: &str) {
        let devices = motions.iter().flat_map(|motion| &motion.robot.devices);
        let before = self.keyframes;
        self.keyframes += devices.map(|device| device.keyframes.len()).sum::<usize>();
        if before <= KEYFRAMES_MAX && self.keyframes > KEYFRAMES_MAX {
            self.too_many(file, self.keyframes as f64);
        }
    }

    /// Adds the finding for an import that is too large.
    pub(super) fn too_many(&mut self, file: &str, keyframes: f64) {
        let message = format!("the import would have at least {keyframes:.0} keyframes");
        let expected = format!("at most {KEYFRAMES_MAX} keyframes");
        self.about(
            file,
            Code::ImportLimit,
            message,
            &expected,
            Some("use a lower --rate, or import fewer files"),
        );
    }

    /// Whether the import may have this number of additional keyframes.
    pub(super) fn has_room_for(&self, keyframes: f64) -> bool {
        self.keyframes as f64 + keyframes <= KEYFRAMES_MAX as f64
    }

    fn of(&self, file: &str) -> usize {
        self.findings.iter().rev().take_while(|finding| finding.file == file).count()
    }

    fn push(&mut self, finding: Finding) {
        match self.of(&finding.file) {
            0..FINDINGS_A_FILE_MAX => self.findings.push(finding),
            FINDINGS_A_FILE_MAX => {
                let message = format!("the file has more than {FINDINGS_A_FILE_MAX} findings");
                let hint =
                    Some("check that the file is in the selected format (see `docs/import.md`)".to_owned());
                let expected = "a file in the selected format";
                self.findings.push(Finding::about_file(finding.code, &finding.file, message, expected, hint));
            }
            _ => {}
        }
    }
}

/// Shortens the source line that a finding quotes if it is too long.
pub(super) fn with_short_line(mut finding: Finding) -> Finding {
    finding.source_line = shown(&finding.source_line, finding.column);
    finding
}

/// Returns the text of a line that a finding quotes: the whole line if it is short, otherwise its beginning. Empty if that beginning does
/// not reach `start`.
fn shown(line: &str, start: usize) -> String {
    if line.len() <= LINE_BYTES_MAX {
        return line.to_owned();
    }
    match start {
        0..LINE_BYTES_MAX => {
            let end = (0..=LINE_BYTES_MAX).rev().find(|end| line.is_char_boundary(*end)).unwrap_or(0);
            line[..end].to_owned()
        }
        _ => String::new(),
    }
}
