//! The keys of a map as a struct: each key is written once and read by its name, not by its position. And the keys of a cue, which
//! hints about other maps need as well.

/// Declares a struct with a field for each key of a map, and the list of these keys for [`Reader::map`]($crate::fields::Reader::map).
#[macro_export]
macro_rules! keys {
    ($(#[$doc:meta])* $name:ident, $list:ident { $($key:ident),* $(,)? }) => {
        const $list: [&str; [$(stringify!($key)),*].len()] = [$(stringify!($key)),*];

        $(#[$doc])*
        struct $name<'a> {
            $($key: Option<At<'a>>,)*
        }

        impl<'a> $name<'a> {
            /// From the values that the reader found, in the order of the list.
            const fn of([$($key),*]: [Option<At<'a>>; $list.len()]) -> Self {
                Self { $($key),* }
            }
        }
    };
}

/// The keys of a cue.
pub const CUE_KEYS: [&str; 31] = [
    "cue",
    "at",
    "after",
    "with",
    "before",
    "end_by",
    "duration",
    "robots",
    "move",
    "sequence",
    "parameters",
    "tracks",
    "devices",
    "mirror",
    "scale",
    "reverse",
    "repeat",
    "canon",
    "overrides",
    "uses",
    "apart",
    "stop_condition",
    "off_grid",
    "tolerance",
    "read",
    "form",
    "turn",
    "grow",
    "shift",
    "along",
    "over",
];
