//! The place of a body at one moment: the coordinates of its base, and the values of its joints.

/// The coordinates of a body at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// x, y and z in metres, and yaw in radians.
    pub base: [f64; 4],
    /// Values of the joints, in radians or, for a sliding joint, in metres; empty for a body without joints.
    pub joints: Box<[f64]>,
}

impl Place {
    /// Creates the place of a body without joints.
    pub fn of(base: [f64; 4]) -> Self {
        Self { base, joints: Box::default() }
    }

    /// Creates a place from x, y, z, yaw and the joints, in this order.
    pub(super) fn from_values(values: &[f64]) -> Self {
        Self { base: std::array::from_fn(|i| values[i]), joints: values[4..].into() }
    }

    /// Whether `values` are the coordinates of this place: x, y, z, yaw and the joints.
    pub(super) fn has(&self, values: &[f64]) -> bool {
        self.base == values[..4] && *self.joints == values[4..]
    }

    /// Interpolates linearly between this place and another one of the same body; `share` is 0 here and 1 there.
    pub(super) fn towards(&self, other: &Self, share: f64) -> Self {
        let mixed = |from: f64, to: f64| from + share * (to - from);
        Self {
            base: std::array::from_fn(|i| mixed(self.base[i], other.base[i])),
            joints: self.joints.iter().zip(&other.joints).map(|(from, to)| mixed(*from, *to)).collect(),
        }
    }
}
