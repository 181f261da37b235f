//! The keys of a map, each of which is declared once: its name, what it means, which values it takes, and whether it is required.
//! [`Reader::keys`](crate::fields::Reader::keys) reads a map into the struct that [`keys!`](crate::keys!) makes, whose fields have the
//! values that the file gives. The schemas, the tables of keys in the documentation and the dictionary of the fuzzer are generated from
//! the same declarations, so that they cannot differ from the reader.

use std::ops::RangeInclusive;

use super::At;

/// The keys that one kind of map may have, as [`keys!`](crate::keys!) declares them.
pub trait Keys<'a>: Sized {
    /// Their names in files.
    const NAMES: &'static [&'static str];
    /// Whether each of them is required.
    const REQUIRED: &'static [bool];

    /// From their values, in the order of the names.
    fn of(values: Vec<Option<At<'a>>>) -> Self;
}

/// A declared map.
#[derive(Debug)]
pub struct Declaration {
    /// The name under which a schema defines it. `None`: where it is used.
    pub definition: Option<&'static str>,
    /// What it is, line by line.
    pub doc: &'static [&'static str],
    /// Its keys, in the order in which messages list them.
    pub keys: &'static [Key],
    /// What else holds of its keys, such as which of them exclude each other: part of a JSON schema.
    pub also: Option<&'static str>,
}

/// A declared key.
#[derive(Debug)]
pub struct Key {
    /// Its name in a file.
    pub name: &'static str,
    /// What it means, line by line. Empty if its kind says that. Only the documentation has what follows an empty line.
    pub doc: &'static [&'static str],
    /// What holds without it.
    pub default: &'static [Option<&'static str>],
    /// Whether it has to be there.
    pub required: bool,
    /// Which values it takes.
    pub kind: &'static Kind,
}

impl Key {
    /// What holds without it, if something does.
    #[must_use]
    pub fn default(&self) -> Option<&'static str> {
        self.default.iter().copied().flatten().next()
    }
}

/// Which values a key takes.
#[derive(Debug)]
pub enum Kind {
    /// A kind that several keys share. A schema defines it once, under its name in small letters.
    Named {
        /// Its name.
        name: &'static str,
        /// What it is, line by line.
        doc: &'static [&'static str],
        /// Which values it takes.
        kind: &'static Self,
    },
    /// A map with declared keys.
    Keys(fn() -> &'static Declaration),
    /// The same, and all values are of one kind.
    KeysOf(fn() -> &'static Declaration, &'static Self),
    /// The same, and other keys, which are names of the user, with values of one kind.
    KeysAnd(fn() -> &'static Declaration, &'static Self),
    /// A map from names of the user to values of one kind.
    Entries(&'static Self),
    /// The same with one entry or more.
    SomeEntries(&'static Self),
    /// A list of that many values of one kind.
    List(&'static Self, RangeInclusive<usize>),
    /// A list with one value of each kind.
    Tuple(&'static [&'static Self]),
    /// One of these words.
    Words(&'static [&'static str]),
    /// One of several kinds.
    AnyOf(&'static [&'static Self]),
    /// What a JSON schema says of it.
    Schema(&'static str),
}

/// The words of a table from which [`Reader::word`](crate::fields::Reader::word) reads one.
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

/// The [`Kind`] of a value of which only a schema says what it is.
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

/// Declares a struct with a field for each key of a map. A key that is a word of Rust is written as in `r#move`.
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
            /// A map with these keys.
            $visible const KIND: $crate::keys::Kind = $crate::keys::Kind::Keys(Self::declaration);

            /// The keys, with what is declared of them.
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

/// A value that may be left out.
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

/// Whether an attribute of a key is `required`.
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

/// The default in an attribute of a key.
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

/// The line of documentation in an attribute of a key.
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

/// The name in files of a name in Rust.
#[doc(hidden)]
#[must_use]
pub const fn written(name: &'static str) -> &'static str {
    match name.as_bytes() {
        [b'r', b'#', ..] => name.split_at(2).1,
        _ => name,
    }
}
