//! Movements: what a track does over time, however it was written, and how it becomes steps of a device.
//!
//! `curve` holds the one form that all movements share, `easing` and `function` the ways between two values, `actuator` the
//! steps of a device.

mod actuator;
mod curve;
mod easing;
mod function;
mod held;
mod spline;

pub(crate) use actuator::{Actuator, Fits, Played, Value};
pub(crate) use curve::{Between, Curve, Knot, Shape, Stretch};
pub(crate) use easing::Easing;
pub(crate) use function::{FormulaPart, Function, Swept};
pub(crate) use held::runs;
pub(crate) use spline::spline;
