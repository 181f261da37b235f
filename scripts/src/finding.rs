//! What a user did wrong: a code, a place, what was found and expected, how to mend it.

use serde::Serialize;

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Nothing can be run.
    Error,
    /// It runs, but look at it.
    Warning,
}

macro_rules! codes {
    ($($variant:ident = $text:literal, $title:literal;)*) => {
        /// The kinds of findings. Codes are stable: a number is never used again for something else.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Code {
            $(#[doc = $title] $variant,)*
        }

        impl Code {
            /// All codes, in order.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// As it is printed, `DB0007`.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$variant => $text,)* }
            }

            /// What it means, in a few words.
            #[must_use]
            pub const fn title(self) -> &'static str {
                match self { $(Self::$variant => $title,)* }
            }
        }
    };
}

codes! {
    Unreadable = "DB0001", "a file cannot be read";
    Syntax = "DB0002", "a text is not YAML";
    WrongType = "DB0003", "a value is of another kind than expected";
    UnknownKey = "DB0004", "a key that is not known here";
    DuplicateKey = "DB0005", "a key stands twice";
    MissingKey = "DB0006", "a key is missing";
    BadDuration = "DB0007", "a time cannot be read";
    UnknownRobot = "DB0008", "no robot or group of this name";
    UnknownDevice = "DB0009", "the robot has no such device";
    ControlType = "DB0010", "the device cannot be controlled this way";
    OutOfRange = "DB0011", "a value lies outside the device's limits";
    OffGranularity = "DB0012", "a value lies off the device's grid";
    TooManySteps = "DB0013", "a script is longer than the device takes";
    TimeOrder = "DB0014", "keyframes are not in order of time";
    Overlap = "DB0015", "two cues move one device at the same time";
    NothingToDo = "DB0016", "nothing to do";
    ListedTwice = "DB0017", "a robot is listed twice";
    InitializationBlock = "DB0018", "an initialization block is not valid";
    NameClash = "DB0019", "a group bears the name of a robot";
    UnknownWord = "DB0020", "a word that is not known here";
    UnknownBeginning = "DB0021", "a movement without a beginning";
    ImportTable = "DB0060", "a table of another shape than its format has";
    ImportNumber = "DB0061", "an imported value is no finite number";
    ImportTime = "DB0062", "imported times that do not go forward";
    TimesCollide = "DB0063", "two imported times fall into one millisecond";
    ForeignTag = "DB0064", "a tag of another program";
    TooManyPieces = "DB0065", "a trajectory has more pieces than the robot holds";
    ImportShape = "DB0066", "lists of an imported motion that do not fit together";
    ImportNames = "DB0067", "imported robots, devices or scenes that cannot be named so";
    ImportLimit = "DB0068", "an import is larger than its limit";
    FileExists = "DB0069", "a file is there already";
}

impl Serialize for Code {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Which kind.
    pub code: Code,
    /// How bad.
    pub severity: Severity,
    /// The file, as the user named it.
    pub file: String,
    /// Line, from 1; 0 where the finding concerns the file as a whole.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// How many characters it concerns.
    pub width: usize,
    /// What was found, naming robot, device and step.
    pub message: String,
    /// What was expected.
    pub expected: String,
    /// How to mend it.
    pub hint: Option<String>,
    /// The offending line.
    pub source_line: String,
}

impl Finding {
    /// Whether a file could not be read at all.
    #[must_use]
    pub fn is_unreadable(&self) -> bool {
        self.code == Code::Unreadable
    }

    pub(crate) fn about_file(
        code: Code,
        file: &str,
        message: String,
        expected: &str,
        hint: Option<String>,
    ) -> Self {
        Self {
            code,
            severity: Severity::Error,
            file: file.to_owned(),
            line: 0,
            column: 0,
            width: 0,
            message,
            expected: expected.to_owned(),
            hint,
            source_line: String::new(),
        }
    }
}

/// A finding that knows its place only as a path into the tree.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pending {
    pub(crate) code: Code,
    pub(crate) place: Place,
    pub(crate) message: String,
    pub(crate) expected: String,
    pub(crate) hint: Option<String>,
}

/// A place in a file: a node, or the key that leads to it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Place {
    pub(crate) path: Vec<Part>,
    pub(crate) key: bool,
}

/// One step into the tree. Occurrences count equal keys of one map from 0.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Part {
    Key(String, usize),
    Index(usize),
}

/// The name most like a wrong one, as a hint.
pub(crate) fn did_you_mean<'a>(wrong: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
    // Long names are compared by their beginning, so that a huge one costs nothing.
    let wrong: String = wrong.chars().take(64).collect();
    let scored = known.into_iter().take(10_000).map(|name| (strsim::damerau_levenshtein(&wrong, name), name));
    let (distance, name) = scored.min_by_key(|(distance, _)| *distance)?;
    (distance <= 2.max(wrong.chars().count() / 3)).then(|| format!("did you mean `{name}`?"))
}

/// A list of names for a message, shortened.
pub(crate) fn names<'a>(all: impl IntoIterator<Item = &'a str>) -> String {
    let all: Vec<_> = all.into_iter().map(|name| format!("`{name}`")).collect();
    match all.len() {
        0 => "none".to_owned(),
        1..=12 => all.join(", "),
        n => format!("{} and {} more", all[..10].join(", "), n - 10),
    }
}
