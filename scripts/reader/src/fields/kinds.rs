//! Kinds of values that many keys have in common.

use super::keys::{Item, Kind, Naming};
use super::{BY_WORDS, DIRECTION_WORDS, SpreadKeys};
use crate::{named, schema, words};

/// The kind of any text.
pub static TEXT: Kind = schema!({"type": "string"});
/// The kind of literal numbers.
pub static PLAIN_NUMBER: Kind = schema!({"type": "number"});
/// The kind of literal numbers above 0.
pub static POSITIVE: Kind = schema!({"type": "number", "exclusiveMinimum": 0});
/// The kind of maps that spread a value over the robots of a cue, so that each robot gets its own.
pub static SPREAD: Kind = SpreadKeys::KIND;
/// The kind of the literals `true` and `false`.
pub static BOOLEAN: Kind = schema!({"type": "boolean"});

/// The kind of the name of another file.
pub static FILE: Kind = Kind::Name(Naming::Uses(Item::File), &TEXT);

named! {
    /// A name.
    pub static NAME = schema!({"type": ["string", "number"]});

    /// A name, or a list of names.
    pub static NAMES = Kind::AnyOf(&[&NAME, &Kind::List(&NAME, 0..=usize::MAX)]);

    /// The value of a variable or parameter: `$name`, or `-$name` for its negative.
    pub static VARIABLE = schema!({"type": "string", "pattern": "^-?\\$\\w[\\w-]*$"});

    /// A calculation: `$a + 5`, `2 * $height`, `sin(360 * $index / $count)`, `8s / 4`, `if($index < 3, 10, 20)`. `$index` is the number
    /// of the robot in the cue, from 0; `$count` is the number of robots in the cue.
    pub static EXPRESSION = schema!({"type": "string", "pattern": "[$(*/%+<>=]|.\\s*-|^-?pi$|^not "});

    /// A duration with its unit: `200us`, `250ms`, `1.5s`, `1m30s`, `2h`, `00:01:30`; with a tempo also `3 beats`, `1 bar 2 beats`.
    pub static TIME = Kind::AnyOf(&[
        &schema!({
            "type": "string",
            "pattern": "^\\s*((\\d+(\\.\\d+)?(h|m|min|s|ms|us))+|\\d+:[0-5]\\d:[0-5]\\d(\\.\\d+)?)\\s*$"
        }),
        &schema!({
            "type": "string",
            "pattern": "^\\s*(\\d+(\\.\\d+)?\\s+beats?|\\d+(\\.\\d+)?\\s+bars?(\\s+\\d+(\\.\\d+)?\\s+beats?)?)\\s*$"
        }),
        &VARIABLE,
        &EXPRESSION,
        &SpreadKeys::KIND,
    ]);

    /// A number in the device's unit, a variable or an expression.
    pub static NUMBER = Kind::AnyOf(&[&PLAIN_NUMBER, &VARIABLE, &EXPRESSION, &SpreadKeys::KIND]);

    /// `true` or `false`.
    pub static TRUTH = Kind::AnyOf(&[&BOOLEAN, &EXPRESSION]);

    /// x, y and z in metres.
    pub static PLACE = Kind::List(&NUMBER, 3..=3);

    /// A number, a time or an expression.
    pub static SPREAD_END = Kind::AnyOf(&[&PLAIN_NUMBER, &TIME]);

    /// The criterion that orders the robots: their number (default), a coordinate of their place, their distance from a point, or chance.
    pub static BY = Kind::AnyOf(&[&words!(BY_WORDS), &PLACE]);

    /// Which robots are first: those at the beginning (default), at the end, in the middle, at both ends.
    pub static DIRECTION = words!(DIRECTION_WORDS);
}
