//! Movements of devices over time.
//!
//! | module | |
//! |---|---|
//! | [`motion`] | knots and the way between two of them: easings, splines, polynomials, formulas, paths |
//! | [`fit`] | the fewest steps that follow a curve, or the least error for a number of steps |
//! | [`expression`] | expressions with units, and formulas of the time |
//! | [`exact`], [`music`] | exact fractions; beats, bars and tempos |
//! | [`chance`] | chance that is the same on every machine |

pub mod chance;
pub mod exact;
pub mod expression;
pub mod fit;
pub mod motion;
pub mod music;
