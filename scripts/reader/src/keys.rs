//! The keys of a map, each of which is declared once: its name, and whether it is required. [`Reader::keys`](crate::fields::Reader::keys)
//! reads a map into the struct that [`keys!`](crate::keys!) makes, whose fields have the values that the file gives.

use crate::fields::At;

/// The keys that one kind of map may have, as [`keys!`](crate::keys!) declares them.
pub trait Keys<'a>: Sized {
    /// Their names as they are written.
    const NAMES: &'static [&'static str];
    /// Whether each of them is required.
    const REQUIRED: &'static [bool];

    /// From their values, in the order of the names.
    fn of(values: Vec<Option<At<'a>>>) -> Self;
}

/// Declares a struct with a field for each key of a map. A key that is a word of Rust is written as in `r#move`.
///
/// ```
/// use downbeat_reader::keys::Keys;
///
/// downbeat_reader::keys! {
///     /// A turn of several robots.
///     struct TurnKeys {
///         #[required]
///         by,
///         r#for,
///     }
/// }
/// assert_eq!(TurnKeys::NAMES, ["by", "for"]);
/// ```
#[macro_export]
macro_rules! keys {
    ($(#[$doc:meta])* $visible:vis struct $name:ident { $($(#[$($attribute:tt)*])* $key:ident),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy)]
        $visible struct $name<'a> { $($visible $key: Option<$crate::fields::At<'a>>,)* }

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

/// A name in Rust as it is written in files.
#[doc(hidden)]
#[must_use]
pub const fn written(name: &'static str) -> &'static str {
    match name.as_bytes() {
        [b'r', b'#', ..] => name.split_at(2).1,
        _ => name,
    }
}
