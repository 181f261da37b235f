//! Functions of s from 0 to 1 that no easing describes: polynomials and waves.

use std::f64::consts::TAU;

use crate::expression::Formula;

/// A function of s from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Function {
    /// c0 + c1 s + c2 s^2 + ...
    Polynomial(Box<[f64]>),
    /// sin(2 pi (cycles s + phase)); the phase in turns.
    Sine {
        cycles: f64,
        phase: f64,
    },
    Formula(Box<FormulaPart>),
}

/// What lies between two times of a formula.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FormulaPart {
    pub(crate) formula: Formula,
    /// In seconds.
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Bounds of its first two derivatives, a second.
    pub(crate) slope_max: f64,
    pub(crate) curvature_max: f64,
}

impl FormulaPart {
    fn length(&self) -> f64 {
        self.to - self.from
    }
}

impl Function {
    pub(crate) fn at(&self, s: f64) -> f64 {
        match self {
            Self::Polynomial(coefficients) => horner(coefficients, s),
            Self::Sine { cycles, phase } => (TAU * (cycles * s + phase)).sin(),
            // Its ends exactly: behind them the formula may jump.
            Self::Formula(part) if s >= 1.0 => part.formula.at(part.to),
            Self::Formula(part) => part.formula.at((part.from + part.length() * s).min(part.to)),
        }
    }

    /// A bound of the first derivative. For polynomials the sum of |k c_k|, which may exceed the largest slope.
    pub(crate) fn slope_max(&self) -> f64 {
        match self {
            Self::Polynomial(coefficients) => weighted(coefficients, |k| k),
            Self::Sine { cycles, .. } => TAU * cycles,
            Self::Formula(part) => part.slope_max * part.length(),
        }
    }

    /// The largest first and second derivative among many samples; of a wave its bounds.
    pub(crate) fn peak_rates(&self) -> (f64, f64) {
        if let Self::Formula(part) = self {
            let (slope, curvature) = part.formula.peak_rates(part.from, part.to);
            return (slope * part.length(), curvature * part.length().powi(2));
        }
        let Self::Polynomial(coefficients) = self else { return (self.slope_max(), self.curvature_max()) };
        let slope = derivative(coefficients);
        let curvature = derivative(&slope);
        let largest = |coefficients: &[f64]| {
            let at = |i: u32| horner(coefficients, f64::from(i) / 256.0).abs();
            (0..=256).map(at).fold(0.0, f64::max)
        };
        (largest(&slope), largest(&curvature))
    }

    /// A bound of the second derivative.
    pub(crate) fn curvature_max(&self) -> f64 {
        match self {
            Self::Polynomial(coefficients) => weighted(coefficients, |k| k * (k - 1.0)),
            Self::Sine { cycles, .. } => (TAU * cycles).powi(2),
            Self::Formula(part) => part.curvature_max * part.length().powi(2),
        }
    }
}

fn horner(coefficients: &[f64], s: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * s + c)
}

#[expect(clippy::cast_precision_loss, reason = "a polynomial has a handful of coefficients")]
fn derivative(coefficients: &[f64]) -> Vec<f64> {
    coefficients.iter().enumerate().skip(1).map(|(k, c)| k as f64 * c).collect()
}

#[expect(clippy::cast_precision_loss, reason = "a polynomial has a handful of coefficients")]
fn weighted(coefficients: &[f64], weight: impl Fn(f64) -> f64) -> f64 {
    coefficients.iter().enumerate().map(|(k, c)| (weight(k as f64) * c).abs()).sum()
}
