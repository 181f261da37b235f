//! Trajectories of polynomial pieces: p(t) = sum of c_i t^i, where t starts at the beginning of the piece.

use super::keyframes;

/// Axes of a quadrotor's trajectory, with their units.
pub(super) const AXES: [(&str, &str); 4] = [("x", "m"), ("y", "m"), ("z", "m"), ("yaw", "rad")];
/// Number of coefficients of a polynomial of degree 7.
pub(super) const COEFFICIENTS: usize = 8;

/// One polynomial piece of a trajectory.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub(super) duration_s: f64,
    /// The coefficients for each axis, starting with the constant.
    pub(super) coefficients: [[f64; COEFFICIENTS]; AXES.len()],
}

/// A trajectory of consecutive polynomial pieces.
#[derive(Clone, Debug, Default)]
pub(super) struct Trajectory {
    pieces: Vec<Piece>,
    /// The start of each piece and the end of the last one, in seconds.
    bounds_s: Vec<f64>,
}

impl Trajectory {
    pub(super) fn new(pieces: Vec<Piece>) -> Self {
        let mut bounds_s = vec![0.0];
        let mut end = 0.0;
        for piece in &pieces {
            end += piece.duration_s;
            bounds_s.push(end);
        }
        Self { pieces, bounds_s }
    }

    /// Returns the pieces of one axis. Leaves out the highest powers of each piece if their coefficients are 0.
    pub(super) fn pieces_of(&self, axis: usize) -> Vec<super::Piece> {
        let piece = |piece: &Piece| {
            let own = &piece.coefficients[axis];
            let needed = own.iter().rposition(|c| *c != 0.0).map_or(1, |last| last + 1);
            super::Piece {
                length: keyframes::span(piece.duration_s).unwrap_or_default(),
                coefficients: own[..needed].iter().map(|c| c + 0.0).collect(),
            }
        };
        self.pieces.iter().map(piece).collect()
    }

    pub(super) fn bounds_s(&self) -> &[f64] {
        &self.bounds_s
    }

    pub(super) fn duration_s(&self) -> f64 {
        self.bounds_s.last().copied().unwrap_or(0.0)
    }

    /// Returns the value of an axis at a time. At a boundary between pieces, returns the value of the later piece. The value is constant
    /// before and after the trajectory.
    pub(super) fn value(&self, axis: usize, at_s: f64) -> f64 {
        let begun = self.bounds_s.partition_point(|bound| *bound <= at_s);
        let index = begun.saturating_sub(1).min(self.pieces.len().saturating_sub(1));
        let Some(piece) = self.pieces.get(index) else { return 0.0 };
        let local = (at_s - self.bounds_s[index]).clamp(0.0, piece.duration_s);
        horner(&piece.coefficients[axis], local)
    }

    /// Returns the largest jump between two consecutive pieces: its axis, its time in seconds, and its size.
    pub(super) fn largest_jump(&self) -> Option<(usize, f64, f64)> {
        let jumps = self.pieces.windows(2).enumerate().flat_map(|(index, pair)| {
            (0..AXES.len()).map(move |axis| {
                let end = horner(&pair[0].coefficients[axis], pair[0].duration_s);
                (axis, self.bounds_s[index + 1], (pair[1].coefficients[axis][0] - end).abs())
            })
        });
        jumps.max_by(|a, b| a.2.total_cmp(&b.2))
    }
}

fn horner(coefficients: &[f64], t: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * t + c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trajectory_consists_of_its_pieces_in_sequence() {
        let piece = |duration_s, x: [f64; 2]| {
            let mut coefficients = [[0.0; COEFFICIENTS]; AXES.len()];
            coefficients[0][..2].copy_from_slice(&x);
            Piece { duration_s, coefficients }
        };
        let trajectory = Trajectory::new(vec![piece(0.5, [1.0, 2.0]), piece(1.0, [2.25, -1.0])]);
        let values: Vec<_> = [0.0, 0.25, 0.5, 1.5, 9.0].iter().map(|t| trajectory.value(0, *t)).collect();
        assert_eq!(values, [1.0, 1.5, 2.25, 1.25, 1.25]);
        assert_eq!(trajectory.largest_jump(), Some((0, 0.5, 0.25)));
    }
}
