//! Movements: the course of a track over time, in any notation, and its conversion to steps of a device.
//!
//! `curve` is the common form of all movements. `easing` and `function` are the courses between two values, and `path` is a route through
//! space. `actuator` creates the steps of a device.

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
