//! Kinds of values that several keys of fleet files and world files have in common. They are literal values, without variables.

use downbeat_reader::keys::{Item, Kind, Naming};
pub(crate) use downbeat_reader::kinds::{BOOLEAN, FILE, NAME, PLAIN_NUMBER, POSITIVE, TEXT};
use downbeat_reader::{named, schema};

/// The name of a device.
pub(crate) static DEVICE: Kind = Kind::Name(Naming::Uses(Item::Device), &NAME);
/// A whole number of at least 1.
pub(crate) static COUNT: Kind = schema!({"type": "integer", "minimum": 1});

named! {
    /// A duration with its unit: `200us`, `250ms`, `1.5s`, `1m30s`, `2h`, `00:01:30`.
    pub(crate) static TIME = schema!({
        "type": "string",
        "pattern": "^\\s*((\\d+(\\.\\d+)?(h|m|min|s|ms|us))+|\\d+:[0-5]\\d:[0-5]\\d(\\.\\d+)?)\\s*$"
    });

    /// The same with a sign: `-5ms`.
    pub(crate) static SIGNED_TIME =
        schema!({"type": "string", "pattern": "^\\s*[-+]?(\\d+(\\.\\d+)?(h|m|min|s|ms|us))+\\s*$"});

    /// x, y and z.
    pub(crate) static VECTOR = Kind::List(&PLAIN_NUMBER, 3..=3);
}
