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

pub(crate) use actuator::{Actuator, Fits, Played, Value, nearest_on_grid};
pub(crate) use curve::{Between, Curve, Knot, Shape, Stretch};
pub(crate) use easing::Easing;
pub(crate) use function::{Carried, FormulaPart, Function, Swept};
pub(crate) use held::runs;
pub(crate) use path::{Along, Path};
pub(crate) use spline::spline;
