//! Movements of devices over time.
//!
//! | module | |
//! |---|---|
//! | [`motion`] | knots and the course between successive knots: easings, splines, polynomials, formulas, paths |
//! | [`fit`] | the fewest steps that follow a curve, or the smallest error for a given number of steps |
//! | [`expression`] | expressions with units, and formulas over time |
//! | [`exact`], [`music`] | exact fractions; beats, bars and tempos |
//! | [`chance`] | random numbers that are the same on every machine |

pub mod chance;
pub mod exact;
pub mod expression;
pub mod fit;
pub mod motion;
pub mod music;
