//! Findings: the mistakes of a user. Each has a code, a place, a description of the fault, the expected value, and a hint how to fix it.

mod shared_fault;

use std::sync::Arc;

use serde::Serialize;

pub use shared_fault::{Affected, SharedFault};

use crate::shown::shortened;

/// The severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The scenario cannot run.
    Error,
    /// The scenario can run, but the user should check the finding.
    Warning,
}

macro_rules! codes {
    ($($variant:ident = $text:literal, $severity:ident, $title:literal;)*) => {
        /// The kind of a finding, with a code such as `DB0007`. Codes are stable: a number is never reused.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum Code {
            $(#[doc = $title] $variant,)*
        }

        impl Code {
            /// All codes, in the order of their numbers.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// Returns the code as it is printed, such as `DB0007`.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$variant => $text,)* }
            }

            /// Returns a short description of this kind of finding.
            #[must_use]
            pub const fn title(self) -> &'static str {
                match self { $(Self::$variant => $title,)* }
            }

            /// Returns whether findings of this kind are errors, which prevent the scenario from running, or warnings.
            #[must_use]
            pub const fn severity(self) -> Severity {
                match self { $(Self::$variant => Severity::$severity,)* }
            }
        }
    };
}

codes! {
    Unreadable = "DB0001", Error, "a file cannot be read";
    Syntax = "DB0002", Error, "a file is not valid YAML";
    WrongType = "DB0003", Error, "a value has the wrong type";
    UnknownKey = "DB0004", Error, "an unknown key";
    DuplicateKey = "DB0005", Error, "a key appears twice";
    MissingKey = "DB0006", Error, "a key is missing";
    BadDuration = "DB0007", Error, "an invalid time";
    UnknownRobot = "DB0008", Error, "no robot or group of this name";
    UnknownDevice = "DB0009", Error, "the robot has no such device";
    ControlType = "DB0010", Error, "the device cannot be controlled this way";
    OutOfRange = "DB0011", Error, "a value lies outside the device's limits";
    OffGranularity = "DB0012", Error, "a value lies off the device's grid";
    TooManySteps = "DB0013", Error, "a script is longer than the device takes";
    TimeOrder = "DB0014", Error, "keyframes are not in order of time";
    Overlap = "DB0015", Error, "two cues move one device at the same time";
    NothingToDo = "DB0016", Error, "nothing to do";
    ListedTwice = "DB0017", Error, "a robot is listed twice";
    InitializationBlock = "DB0018", Error, "an initialization block is not valid";
    NameClash = "DB0019", Error, "a group or a role with a name that is already in use";
    UnknownWord = "DB0020", Error, "an unknown word";
    UnknownBeginning = "DB0021", Error, "a movement from an unknown position";
    UnknownCue = "DB0022", Error, "no cue of this name";
    UnknownMove = "DB0023", Error, "no move of this name";
    Variable = "DB0024", Error, "a variable without a value";
    Music = "DB0025", Error, "beats and bars without a tempo";
    Conflict = "DB0026", Error, "times that contradict each other";
    NoOrder = "DB0027", Error, "no order found for cues that exclude each other";
    UnknownZone = "DB0028", Error, "no zone of this name";
    Unreachable = "DB0029", Error, "an act that is never reached";
    DeadEnd = "DB0030", Error, "acts that never reach the end";
    UnknownAct = "DB0031", Error, "no act of this name";
    TooFast = "DB0032", Error, "a movement that is too fast for the device";
    TooSudden = "DB0033", Error, "a movement with too much acceleration for the device";
    Jump = "DB0034", Warning, "a device that has to jump";
    LeftInMotion = "DB0035", Warning, "a device is left in motion at the end";
    LeaseTooLong = "DB0036", Warning, "a lease that is longer than its scripts";
    NoRobot = "DB0037", Error, "a cue without robots";
    Snapped = "DB0038", Warning, "a value was rounded to the device's grid";
    QueueTooShort = "DB0039", Error, "more scripts than the device's queue holds";
    ToleranceTooTight = "DB0040", Error, "an error larger than allowed";
    BadMotion = "DB0041", Error, "an invalid movement";
    Include = "DB0042", Error, "an included file that cannot be read";
    NameTwice = "DB0043", Error, "a name is used twice";
    UnknownSensor = "DB0044", Error, "the robot has no such sensor";
    TooMuch = "DB0045", Error, "a limit is exceeded";
    BadData = "DB0046", Error, "a data file cannot be used";
    NoTimeToSend = "DB0047", Error, "no time to send the next script";
    LittleTimeToSend = "DB0048", Warning, "little time to send the next script";
    ActHasToWait = "DB0049", Warning, "an act that cannot follow immediately";
    OneAddress = "DB0050", Error, "two robots have the same address";
    NeedsHandshake = "DB0051", Error, "a key that needs the handshake";
    TooClose = "DB0052", Error, "two bodies closer than allowed";
    OutOfSpace = "DB0053", Error, "a body outside its allowed space";
    BodyTooFast = "DB0054", Error, "a body faster than allowed";
    PlaceUnknown = "DB0055", Warning, "a body at an unknown position";
    Unmet = "DB0056", Warning, "a requirement that is not met";
    OutsideProject = "DB0057", Error, "a file outside the project";
    OpenNetwork = "DB0058", Error, "a robot that anyone on the network can move";
    StaleLatency = "DB0059", Warning, "a latency of an unknown robot or device";
    ImportTable = "DB0060", Error, "a table that does not match its format";
    ImportNumber = "DB0061", Error, "an imported value is not a finite number";
    ImportTime = "DB0062", Error, "imported times that do not increase";
    TimesCollide = "DB0063", Error, "two imported values at the same time";
    ForeignTag = "DB0064", Error, "a tag of another program";
    TooManyPieces = "DB0065", Error, "a trajectory has more pieces than the robot holds";
    ImportShape = "DB0066", Error, "an imported motion with an inconsistent structure";
    ImportNames = "DB0067", Error, "imported robots, devices or scenes with names that are not allowed";
    ImportLimit = "DB0068", Error, "an import is larger than its limit";
    FileExists = "DB0069", Error, "a file already exists";
    Expression = "DB0070", Error, "an expression without a value";
    NearPlaces = "DB0071", Warning, "places of a formation that are too close to each other";
    NotInGroup = "DB0072", Error, "a robot that cannot move in a group";
    PlacesCount = "DB0073", Error, "more or fewer robots than places";
    NoWayPast = "DB0074", Error, "bodies that cannot pass each other";
    UnknownFormation = "DB0075", Error, "no formation of this name";
    PlaysItself = "DB0076", Error, "a move, a sequence or a file that uses itself";
    UnknownSequence = "DB0077", Error, "no sequence of this name";
    WrongKind = "DB0078", Error, "a value of a different kind than its parameter";
    UnknownPath = "DB0079", Error, "no path of this name";
    CrowdedPlace = "DB0080", Warning, "too many robots under one key prefix of a Zenoh network";
    IgnoredKey = "DB0081", Warning, "an ignored key in the description of a robot";
}

impl Code {
    /// Returns the explanation of this code in `findings.md`: what the finding means, why it matters, and how to fix it.
    #[must_use]
    pub fn explanation(self) -> &'static str {
        let heading = format!("## {}", self.as_str());
        let text = EXPLANATIONS;
        let Some(begin) = text.find(&heading) else { return self.title() };
        let body = &text[begin + heading.len()..];
        let body = body.split_once('\n').map_or("", |(_, body)| body);
        body.split("\n## ").next().unwrap_or(body).trim()
    }
}

/// The documentation page from which the program prints the explanations of codes.
const EXPLANATIONS: &str = include_str!("findings.md");

impl Serialize for Code {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

/// One mistake of a user.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The code for the kind of mistake.
    pub code: Code,
    /// Whether the finding is an error, which prevents the scenario from running, or a warning.
    pub severity: Severity,
    /// The name of the file that contains the mistake, as the user wrote the name.
    pub file: String,
    /// Line of the finding, counted from 1; 0 if the finding concerns the file as a whole.
    pub line: usize,
    /// Column in characters, counted from 1.
    pub column: usize,
    /// The number of characters that the finding concerns. 0 if the line is not shown, because it may be confidential.
    pub width: usize,
    /// A description of the fault. It names the robot, device and step, if the fault concerns them.
    pub message: String,
    /// The expected value or form.
    pub expected: String,
    /// How to fix the fault; `None` if there is no hint.
    pub hint: Option<String>,
    /// The text of the line with the fault.
    pub source_line: String,
    /// Places that explain the finding, in the order of the explanation, followed by other places with the same mistake.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub related: Vec<Related>,
}

/// A place that is related to a finding, with an explanation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Related {
    /// Line of the place, counted from 1.
    pub line: usize,
    /// Column in characters, counted from 1.
    pub column: usize,
    /// The number of characters that the place covers.
    pub width: usize,
    /// The explanation of this place.
    pub message: String,
    /// The text of the line that contains the place.
    pub source_line: String,
    /// Whether this place has the same mistake as the finding. The message of the finding then already names the line of this place.
    #[serde(skip)]
    pub is_repeat: bool,
}

impl Finding {
    /// Returns the places that explain the finding, without other places that have the same mistake.
    pub fn chain(&self) -> impl Iterator<Item = &Related> {
        self.related.iter().filter(|place| !place.is_repeat)
    }

    /// Whether the fault concerns access to a file instead of its content: the file cannot be read or written, or already exists.
    #[must_use]
    pub fn is_about_access(&self) -> bool {
        matches!(self.code, Code::Unreadable | Code::Include | Code::OutsideProject | Code::FileExists)
    }

    /// Creates a finding that concerns a file as a whole.
    pub fn about_file(code: Code, file: &str, message: String, expected: &str, hint: Option<String>) -> Self {
        Self {
            code,
            severity: code.severity(),
            file: file.to_owned(),
            line: 0,
            column: 0,
            width: 0,
            message,
            expected: expected.to_owned(),
            hint,
            source_line: String::new(),
            related: Vec::new(),
        }
    }
}

/// A finding whose place is only known as a path in the tree, not yet as a line and column.
#[derive(Clone, Debug, PartialEq)]
pub struct Pending {
    /// The code of the finding.
    pub code: Code,
    /// The place that the user must edit.
    pub place: Place,
    /// A description of the fault.
    pub message: String,
    /// The expected value or form.
    pub expected: String,
    /// How to fix the fault; `None` if there is no hint.
    pub hint: Option<String>,
    /// The hint if the value is written in block style (without brackets). `None` if `hint` applies to block style as well.
    pub hint_in_block: Option<String>,
    /// Related places, each with an explanation.
    pub related: Vec<(Place, String)>,
    /// The robots that the finding concerns, which further faults can extend. `None` if the finding cannot be extended.
    pub affected: Option<Box<Affected>>,
}

/// A place in a file: a node, or the key that leads to it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Place {
    /// The number of the file: 0 for the scenario, then one for each include, in reading order.
    pub file: u16,
    /// The keys and indices that lead from the root of the file to the place.
    pub path: Vec<PathStep>,
    /// Whether the place is the key that leads to the node, instead of the node itself.
    pub key: bool,
    /// The part of the text at this place; `None` for the whole text.
    pub within: Option<Within>,
    /// The use through which this place was read, if it belongs to an item that is used elsewhere, such as a move.
    pub used: Option<Arc<Use>>,
}

/// A use of an item that is defined elsewhere: a move, a sequence or a file.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Use {
    /// The item that is used, as named in messages: `the move `wave``.
    pub what: String,
    /// The item that uses it, such as another move, if that has a name.
    pub by: Option<String>,
    /// The place of the use. That place may itself have been read through another use.
    pub place: Place,
}

/// A part of a text. The whole text is kept because it is needed to find the part in the file.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Within {
    /// The whole text.
    pub text: Box<str>,
    /// The index of the first character of the part, counted from 0.
    pub from: usize,
    /// The number of characters of the part.
    pub width: usize,
}

impl Place {
    /// Returns the place of an entry or item of the node at this place.
    pub fn below(&self, part: PathStep) -> Self {
        let mut path = self.path.clone();
        path.push(part);
        Self { file: self.file, path, key: false, within: None, used: self.used.clone() }
    }

    /// Returns the place of the value of `key` in the map at this place.
    pub fn of_key(&self, key: &str) -> Self {
        self.below(PathStep::Key(key.to_owned(), 0))
    }
}

/// One step on the path from the root of a tree to a node.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum PathStep {
    /// A key of a map, and its number among equal keys in the map, counted from 0.
    Key(String, usize),
    /// The index of an item in a list, counted from 0.
    Index(usize),
}

/// Returns a hint that suggests the known name that is most similar to `wrong`. `None` if no name is similar enough.
pub fn did_you_mean<'a>(wrong: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    nearest(wrong, known, &mut 10_000)
}

/// Like [`did_you_mean`], but makes at most `left` comparisons, and subtracts their number from `left`.
pub fn nearest<'a>(
    wrong: &str,
    known: impl IntoIterator<Item = &'a str>,
    left: &mut usize,
) -> Option<String> {
    // Only the beginning of a long name is compared, to bound the cost.
    let wrong: String = wrong.chars().take(64).collect();
    let length = wrong.chars().count();
    // In short words, a third of the letters may differ by chance.
    let near = 1.max(length / 3);
    let first = wrong.chars().next();
    let (mut written_out, mut in_other_case) = (None, None);
    let small = wrong.to_lowercase();
    let compared = known.into_iter().take(*left).inspect(|name| {
        *left -= 1;
        if name.len() <= 4 * wrong.len() && name.to_lowercase() == small {
            in_other_case.get_or_insert(*name);
        }
        if is_short_for(&wrong, name) {
            written_out.get_or_insert(*name);
        }
    });
    // The distance of two names is at least the difference of their lengths.
    let like = compared.filter(|name| name.len() <= 4 * (length + near));
    let like = like.filter(|name| name.chars().count().abs_diff(length) <= near);
    let scored = like.map(|name| (strsim::osa_distance(&wrong, name), name));
    let letters = |name: &str| {
        let mut letters: Vec<char> = name.chars().collect();
        letters.sort_unstable();
        letters
    };
    let alike = |name: &str| {
        let close = name.chars().next() == first || letters(name) == letters(&wrong);
        if close { near } else { length / 4 }
    };
    let like =
        scored.filter(|(distance, name)| *distance <= alike(name)).min_by_key(|(distance, _)| *distance);
    let like = like.map(|(_, name)| name);
    Some(did_you_mean_this(in_other_case.or(like).or(written_out)?))
}

/// Whether `name` begins with `word` or its singular, as `formations` begins with `form`, the singular of `forms`.
fn is_short_for(word: &str, name: &str) -> bool {
    let begin = word.strip_suffix('s').unwrap_or(word);
    begin.chars().count() >= 4 && name.starts_with(begin)
}

/// Returns a hint with the known name that ends with `.` and the given name, such as `lib.lift` for `lift`. `None` unless there is
/// exactly one.
pub fn within_file<'n>(name: &str, known: impl Iterator<Item = &'n str>) -> Option<String> {
    let mut ending = known.filter(|known| known.strip_suffix(name).is_some_and(|rest| rest.ends_with('.')));
    let only = ending.next().filter(|_| ending.next().is_none())?;
    Some(did_you_mean_this(only))
}

/// Returns a hint that suggests `name`.
pub fn did_you_mean_this(name: &str) -> String {
    format!("did you mean `{name}`?")
}

/// Describes what is expected in place of an unknown name: one of the names that exist.
pub fn one_of<'a>(all: impl IntoIterator<Item = &'a str>) -> String {
    match names(all).as_str() {
        "none" => "a name, but none is defined".to_owned(),
        only if !only.contains("`, `") => only.to_owned(),
        names => format!("one of {names}"),
    }
}

/// Like [`one_of`], but for a name that is defined under `moves:`, `zones:` and similar keys.
pub fn one_defined<'a>(what: &str, mut all: impl Iterator<Item = &'a str> + Clone) -> String {
    match all.clone().next() {
        None => format!("a {what} that is defined under `{what}s`"),
        Some(_) => one_of(&mut all),
    }
}

/// Maximum number of robots that a message lists in full.
const LISTED_MAX: usize = 5;

/// Lists robots for a message: `` `a`, `b` ``, or `` 12 robots (`a`, `b`, `c` and 9 more) `` if there are many.
pub fn robots_named<'a>(ids: impl ExactSizeIterator<Item = &'a str> + Clone) -> String {
    let (count, listed) = (ids.len(), ids.map(|id| format!("`{}`", shortened(id))));
    match count {
        0..=LISTED_MAX => listed.collect::<Vec<_>>().join(", "),
        _ => {
            let first: Vec<_> = listed.take(3).collect();
            format!("{count} robots ({} and {} more)", first.join(", "), count - first.len())
        }
    }
}

/// Lists names for a message: up to twelve, or the first ten and the number of further ones.
pub fn names<'a>(all: impl IntoIterator<Item = &'a str>) -> String {
    let mut all = all.into_iter();
    let first: Vec<_> = all.by_ref().take(12).map(|name| format!("`{}`", shortened(name))).collect();
    match first.len() + all.count() {
        0 => "none".to_owned(),
        1..=12 => first.join(", "),
        n => format!("{} and {} more", first[..10].join(", "), n - 10),
    }
}
