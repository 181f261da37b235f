//! Movements: what a track does over time, however it was written, and how it becomes steps of a device, `path` a way through space.
//!
//! `curve` holds the one form that all movements share, `easing` and `function` the ways between two values, `actuator` the
//! steps of a device, `path` a way through space.

mod actuator;
mod curve;
mod easing;
mod function;
mod held;
mod path;
mod spline;

pub use actuator::{Actuator, Fits, Played, Value, nearest_on_grid};
pub use curve::{Between, Curve, Knot, Shape, Stretch};
pub use easing::Easing;
pub use function::{Carried, FormulaPart, Function, Swept};
pub use held::runs;
pub use path::{Along, Path};
pub use spline::spline;
