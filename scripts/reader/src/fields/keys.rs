//! Declarations of the keys that each kind of map may have. Each key is declared once, with its name, its meaning, its values, and
//! whether it is required. [`keys!`](crate::keys!) generates a struct with a field per key, into which
//! [`Reader::keys`](crate::fields::Reader::keys) reads a map. The schemas, the tables of keys in the documentation, and the dictionary of
//! the fuzzer are generated from the same declarations, so they always match the reader.

use std::ops::RangeInclusive;

use super::At;

/// The keys that one kind of map may have, declared by [`keys!`](crate::keys!).
pub trait Keys<'a>: Sized {
    /// The names of the keys in files.
    const NAMES: &'static [&'static str];
    /// For each key, whether it is required.
    const REQUIRED: &'static [bool];

    /// Creates the struct from the values of the keys, in the order of [`Self::NAMES`].
    fn of(values: Vec<Option<At<'a>>>) -> Self;
}

/// The declaration of one kind of map and its keys.
#[derive(Debug)]
pub struct Declaration {
    /// The name of the map's definition in the JSON schema. `None` if the schema describes the map wherever it is used.
    pub definition: Option<&'static str>,
    /// The description of the map, line by line.
    pub doc: &'static [&'static str],
    /// The keys of the map, in the order in which messages list them.
    pub keys: &'static [Key],
    /// A fragment of JSON schema with further constraints, such as keys that exclude each other; `None` if there are none.
    pub also: Option<&'static str>,
}

/// The declaration of a key of a map.
#[derive(Debug)]
pub struct Key {
    /// The name of the key in a file.
    pub name: &'static str,
    /// The description of the key, line by line; empty if its kind describes it. Lines after an empty line appear only in the
    /// documentation.
    pub doc: &'static [&'static str],
    /// The default value is the only item that is `Some`; the key has no default if all items are `None`.
    pub default: &'static [Option<&'static str>],
    /// Whether the key is required.
    pub required: bool,
    /// The values that the key accepts.
    pub kind: &'static Kind,
}

impl Key {
    /// The default value of the key, if it has one.
    #[must_use]
    pub fn default(&self) -> Option<&'static str> {
        self.default.iter().copied().flatten().next()
    }
}

/// The values that a key accepts.
#[derive(Debug)]
pub enum Kind {
    /// A kind that several keys share. A schema defines it once, under its name in lower case.
    Named {
        /// The name of the kind.
        name: &'static str,
        /// The description of the kind, line by line.
        doc: &'static [&'static str],
        /// The values that the kind accepts.
        kind: &'static Self,
    },
    /// A map with declared keys.
    Keys(fn() -> &'static Declaration),
    /// A map with declared keys whose values are all of one kind.
    KeysOf(fn() -> &'static Declaration, &'static Self),
    /// A map with declared keys, and with further keys that the user chooses. The values of the further keys are of one kind.
    KeysAnd(fn() -> &'static Declaration, &'static Self),
    /// A map from names that the user chooses to values of one kind.
    Entries(&'static Self),
    /// A map like `Entries` with at least one entry.
    SomeEntries(&'static Self),
    /// A list of values of one kind, whose length is in the range.
    List(&'static Self, RangeInclusive<usize>),
    /// A list of fixed length: one value of each kind, in this order.
    Tuple(&'static [&'static Self]),
    /// One of the given words.
    Words(&'static [&'static str]),
    /// Texts that name items; lists of such texts, too.
    Name(Naming, &'static Self),
    /// Maps whose keys name items, except for declared keys.
    NameKeys(Naming, &'static Self),
    /// One of several kinds.
    AnyOf(&'static [&'static Self]),
    /// Values that are described by this JSON schema.
    Schema(&'static str),
}

/// A kind of item that a name refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Item {
    /// A robot, a group or a role.
    Robot,
    /// A device of a robot.
    Device,
    /// A robot and one of its devices, separated by a slash.
    RobotDevice,
    /// A move.
    Move,
    /// A sequence of cues.
    Sequence,
    /// A cue; the name may be part of a relation, such as `start of raise + 1s`.
    Cue,
    /// An act.
    Act,
    /// A zone.
    Zone,
    /// A formation.
    Formation,
    /// A path through space.
    Path,
    /// A variable.
    Variable,
    /// A parameter of a move, a sequence or an included file.
    Parameter,
    /// Another file, relative to the folder of its own file.
    File,
}

/// The role of a name: whether it defines an item or uses one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Naming {
    /// The name defines an item.
    Defines(Item),
    /// The name refers to an item.
    Uses(Item),
}

impl Naming {
    /// The kind of item that is named.
    #[must_use]
    pub const fn item(self) -> Item {
        match self {
            Self::Defines(item) | Self::Uses(item) => item,
        }
    }
}

/// Returns the words of a table that [`Reader::word`](crate::fields::Reader::word) uses.
#[must_use]
pub const fn words<T, const N: usize>(table: &[(&'static str, T); N]) -> [&'static str; N] {
    let mut words = [""; N];
    let mut index = 0;
    while index < N {
        words[index] = table[index].0;
        index += 1;
    }
    words
}

/// The [`Kind`] of a value that is one of the words of a table.
#[macro_export]
macro_rules! words {
    ($table:expr) => {
        $crate::keys::Kind::Words(const { &$crate::keys::words(&$table) })
    };
}

/// The [`Kind`] of a value that only a JSON schema describes.
#[macro_export]
macro_rules! schema {
    ($json:tt) => {
        $crate::keys::Kind::Schema(stringify!($json))
    };
}

/// Declares kinds that several keys share.
#[macro_export]
macro_rules! named {
    ($($(#[doc = $doc:literal])* $visible:vis static $name:ident = $kind:expr;)*) => {
        $($(#[doc = $doc])*
        $visible static $name: $crate::keys::Kind =
            $crate::keys::Kind::Named { name: stringify!($name), doc: &[$($doc),*], kind: &$kind };)*
    };
}

/// Declares a struct with a field for each key of a map. A key that is a keyword of Rust is written with `r#`, such as `r#move`.
///
/// ```
/// use downbeat_reader::keys::Keys;
/// use downbeat_reader::kinds;
///
/// downbeat_reader::keys! {
///     /// A turn of several robots.
///     pub struct TurnKeys as "turn" {
///         /// How far.
///         #[required]
///         by: kinds::NUMBER,
///         /// How long the turn lasts.
///         #[default("1s")]
///         r#for: kinds::TIME,
///     }
///     also {"maxProperties": 2}
/// }
/// assert_eq!(TurnKeys::NAMES, ["by", "for"]);
/// assert_eq!(TurnKeys::declaration().keys[1].default(), Some("1s"));
/// ```
#[macro_export]
macro_rules! keys {
    (
        $(#[doc = $doc:literal])*
        $visible:vis struct $name:ident $(as $definition:literal)? {
            $($(#[$($attribute:tt)*])* $key:ident: $kind:expr),* $(,)?
        }
        $(also $also:tt)?
    ) => {
        $(#[doc = $doc])*
        #[derive(Clone, Copy)]
        $visible struct $name<'a> { $($visible $key: Option<$crate::fields::At<'a>>,)* }

        impl $name<'_> {
            /// The kind of a value that is a map with these keys.
            $visible const KIND: $crate::keys::Kind = $crate::keys::Kind::Keys(Self::declaration);

            /// Returns the declaration of the keys.
            $visible fn declaration() -> &'static $crate::keys::Declaration {
                static DECLARATION: $crate::keys::Declaration = $crate::keys::Declaration {
                    definition: $crate::optional!($($definition)?),
                    doc: &[$($doc),*],
                    keys: &[$($crate::keys::Key {
                        name: $crate::keys::written(stringify!($key)),
                        doc: &[$($crate::doc_of!($($attribute)*)),*],
                        default: &[$($crate::default_of!($($attribute)*)),*],
                        required: $($crate::is_required!($($attribute)*) ||)* false,
                        kind: &$kind,
                    }),*],
                    also: $crate::optional!($(stringify!($also))?),
                };
                &DECLARATION
            }
        }

        impl<'a> $crate::keys::Keys<'a> for $name<'a> {
            const NAMES: &'static [&'static str] = &[$($crate::keys::written(stringify!($key))),*];
            const REQUIRED: &'static [bool] = &[$($($crate::is_required!($($attribute)*) ||)* false),*];

            fn of(values: Vec<Option<$crate::fields::At<'a>>>) -> Self {
                let mut values = values.into_iter();
                Self { $($key: values.next().flatten()),* }
            }
        }
    };
}

/// Expands to `Some` of its argument, or to `None` without an argument.
#[doc(hidden)]
#[macro_export]
macro_rules! optional {
    () => {
        None
    };
    ($value:expr) => {
        Some($value)
    };
}

/// Expands to `true` if the attribute of a key is `required`.
#[doc(hidden)]
#[macro_export]
macro_rules! is_required {
    (required) => {
        true
    };
    ($($other:tt)*) => {
        false
    };
}

/// Expands to `Some` of the default if the attribute of a key is `default`, otherwise to `None`.
#[doc(hidden)]
#[macro_export]
macro_rules! default_of {
    (default($default:literal)) => {
        Some($default)
    };
    ($($other:tt)*) => {
        None
    };
}

/// Expands to the line of documentation if the attribute of a key is `doc`, otherwise to an empty text.
#[doc(hidden)]
#[macro_export]
macro_rules! doc_of {
    (doc = $doc:literal) => {
        $doc
    };
    ($($other:tt)*) => {
        ""
    };
}

/// Converts the name of a key in Rust to its name in files: removes the prefix `r#`.
#[doc(hidden)]
#[must_use]
pub const fn written(name: &'static str) -> &'static str {
    match name.as_bytes() {
        [b'r', b'#', ..] => name.split_at(2).1,
        _ => name,
    }
}
