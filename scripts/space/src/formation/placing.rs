//! The scale and rotation of a shape about its middle, and the position of this middle on the stage.

use super::Point;

/// The transformation of a shape from its own frame to the stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placing {
    /// Centre of scaling and rotation, in the shape's frame.
    middle: Point,
    /// Position of `middle` on the stage, in metres.
    at: Point,
    /// Rows of the rotation matrix, multiplied by the scale factor.
    rows: [Point; 3],
}

impl Default for Placing {
    fn default() -> Self {
        Self { middle: [0.0; 3], at: [0.0; 3], rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] }
    }
}

impl Placing {
    /// Creates a placing that leaves the shape unchanged. Later scaling and rotation are about the point `middle`.
    pub fn about(middle: Point) -> Self {
        Self { middle, at: middle, ..Self::default() }
    }

    /// Moves the middle of the shape to a position on the stage, in metres.
    pub fn moved(self, at: Point) -> Self {
        Self { at, ..self }
    }

    /// Sets the rotation and the scale factor. The rotation is roll, pitch and yaw in degrees about fixed axes, as in URDF.
    pub fn turned(self, rpy: Point, factor: f64) -> Self {
        let ([sr, sp, sy], [cr, cp, cy]) = (rpy.map(sine), rpy.map(cosine));
        let rows = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ];
        Self { rows: rows.map(|row| row.map(|part| part * factor)), ..self }
    }

    /// Scales by a further factor about the middle.
    pub fn scaled(self, factor: f64) -> Self {
        Self { rows: self.rows.map(|row| row.map(|part| part * factor)), ..self }
    }

    /// Returns the position of the shape's middle on the stage, in metres.
    pub const fn middle_on_stage(&self) -> Point {
        self.at
    }

    /// Returns the position of a point of the shape on the stage.
    pub fn of(&self, point: Point) -> Point {
        let from_middle: Point = std::array::from_fn(|axis| point[axis] - self.middle[axis]);
        std::array::from_fn(|axis| {
            let row = &self.rows[axis];
            // Adding zero removes the sign of negative zeros.
            self.at[axis]
                + (0.0 + row[0] * from_middle[0] + row[1] * from_middle[1] + row[2] * from_middle[2])
        })
    }
}

/// Returns the sine of an angle in degrees. It is exact at quarter turns, so that upright shapes have round coordinates.
fn sine(degrees: f64) -> f64 {
    match degrees.rem_euclid(360.0) {
        0.0 | 180.0 => 0.0,
        90.0 => 1.0,
        270.0 => -1.0,
        within => within.to_radians().sin(),
    }
}

fn cosine(degrees: f64) -> f64 {
    sine(degrees.rem_euclid(360.0) + 90.0)
}

/// Returns the middle of the bounding box of points, and the lengths of its sides.
pub fn middle_of(points: &[Point]) -> (Point, Point) {
    let extreme = |axis: usize, pick: fn(f64, f64) -> f64| {
        points.iter().map(|point| point[axis]).reduce(pick).unwrap_or(0.0)
    };
    let least: Point = std::array::from_fn(|axis| extreme(axis, f64::min));
    let most: Point = std::array::from_fn(|axis| extreme(axis, f64::max));
    (
        std::array::from_fn(|axis| f64::midpoint(least[axis], most[axis])),
        std::array::from_fn(|axis| most[axis] - least[axis]),
    )
}
