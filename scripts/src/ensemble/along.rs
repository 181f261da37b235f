//! A group that moves along a path: as a rigid formation, or as a line in which each robot follows the one before it.

use std::sync::Arc;

use super::{Course, Dancer, Fault, Ground};
use crate::formation::{Point, SAME, metres_between};
use crate::motion::{Along, Carried, Path};

/// Maximum number of points of the path. The points of all laps count, and so do the places of the robots that follow.
pub(crate) const POINTS_MAX: usize = 10_000;

/// A path, with the position on it at which each robot begins.
pub(super) struct Carrier {
    path: Arc<Path>,
    /// Distance that each robot travels along the path, in metres.
    length: f64,
    turning: bool,
    /// Position along the path at which each robot begins, in metres.
    begins: Vec<f64>,
}

impl Carrier {
    /// Returns the movements of a robot along x, y and z.
    pub(super) fn carried(&self, robot: usize) -> [Carried; 3] {
        [Along::X, Along::Y, Along::Z].map(|along| Carried {
            path: self.path.clone(),
            along,
            gain: 1.0,
            from: self.begins[robot],
            length: self.length,
            turning: self.turning && along != Along::Z,
        })
    }

    pub(super) const fn is_turning(&self) -> bool {
        self.turning
    }

    /// Whether the path leads up or down anywhere.
    pub(super) fn climbs(&self) -> bool {
        self.path.bounds(Along::Z).0 > 0.0
    }
}

/// Returns the path along which `course` moves the group.
pub(super) fn carrier(course: &Course, dancers: &[Dancer<'_>], ground: Ground<'_>) -> Result<Carrier, Fault> {
    let written = ground.paths.get(&course.path).ok_or(Fault::UnknownPath)?;
    let path = written.path.as_ref().ok_or(Fault::ToldElsewhere)?;
    let laps = course.laps.unwrap_or(1);
    if laps > 1 && !path.is_closed() {
        return Err(Fault::OpenLaps(laps));
    }
    if course.turning && !path.has_heading() {
        return Err(Fault::NoHeading);
    }
    if course.follow {
        return trail(path, laps, dancers);
    }
    let count = path.points().len() * laps as usize;
    if count > POINTS_MAX {
        return Err(Fault::TooManyPoints(count));
    }
    let length = path.length() * f64::from(laps);
    Ok(Carrier { path: path.clone(), length, turning: course.turning, begins: vec![0.0; dancers.len()] })
}

/// Returns a path that leads through the places of all robots, from the last to the first, and then along the given path.
fn trail(path: &Path, laps: u32, dancers: &[Dancer<'_>]) -> Result<Carrier, Fault> {
    let own = path.points();
    let mut trail: Vec<Point> = dancers.iter().rev().map(|dancer| dancer.from).collect();
    let count = own.len() * laps as usize;
    if count + trail.len() > POINTS_MAX {
        return Err(Fault::TooManyPoints(count + trail.len()));
    }
    let Some(last) = dancers.len().checked_sub(1) else { return Err(Fault::Unmoved) };
    if let Some(index) = (0..last).find(|index| metres_between(trail[*index], trail[index + 1]) < SAME) {
        return Err(Fault::SamePlace { behind: last - index, ahead: last - index - 1 });
    }
    let leader = dancers[0].from;
    let ahead = own.iter().cycle().take(count + usize::from(path.is_closed())).skip(1);
    trail.extend(
        ahead.map(|point| -> Point {
            std::array::from_fn(|axis| leader[axis] + (point[axis] - own[0][axis]))
        }),
    );
    let path = Path::through(&trail, false)
        .map_err(|turns| Fault::TurnsBack { dancer: last.saturating_sub(turns.point) })?;
    let begins: Vec<f64> = (0..=last).map(|robot| path.far_of(last - robot)).collect();
    let length = path.length() - begins[0];
    Ok(Carrier { path: Arc::new(path), length, turning: false, begins })
}
