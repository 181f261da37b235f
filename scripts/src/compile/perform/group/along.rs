//! A group that goes along a path: carried as one body, or each robot behind the one before it.

use std::sync::Arc;

use super::{Dancer, Ground, Performer};
use crate::compile::check_formations::SAME;
use crate::finding::{Code, one_of};
use crate::formation::{Point, metres_between};
use crate::motion::{Along, Carried, Path};
use crate::node::shortened;
use crate::render::counted;
use crate::scenario::{Course, Together};

/// Most points of all laps together, and of the robots that follow.
const POINTS_MAX: usize = 10_000;

/// A path on which every robot has its place.
pub(super) struct Carrier {
    path: Arc<Path>,
    /// How far each robot goes, in metres.
    length: f64,
    turning: bool,
    /// How far along the path each robot begins, in metres.
    begins: Vec<f64>,
}

impl Carrier {
    /// x, y and z of a robot.
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

    /// Whether it leads up or down.
    pub(super) fn climbs(&self) -> bool {
        self.path.bounds(Along::Z).0 > 0.0
    }
}

impl Performer<'_, '_> {
    /// The path of a group that goes along one.
    pub(super) fn carrier(
        &mut self,
        group: &Together,
        course: &Course,
        dancers: &[Dancer<'_>],
        ground: &Ground<'_>,
    ) -> Option<Carrier> {
        let name = shortened(&course.path);
        let Some(written) = ground.paths.get(&course.path) else {
            let mut known: Vec<&str> = ground.paths.keys().map(String::as_str).collect();
            known.sort_unstable();
            let hint = self.findings.did_you_mean(&course.path, known.iter().copied());
            let expected = match known.is_empty() {
                true => "a path that is defined under `paths`".to_owned(),
                false => one_of(known),
            };
            let message = format!("no path `{name}`");
            self.findings.add(Code::UnknownPath, course.place.clone(), message, expected, hint);
            return None;
        };
        // What is wrong with a path is told where it stands.
        let path = written.path.as_ref()?;
        let laps = course.laps.unwrap_or(1);
        if laps > 1 && !path.is_closed() {
            let message = format!("{laps} laps of `{name}`, which does not end where it begins");
            let hint = Some("write `closed: true` for the path".to_owned());
            self.findings.add(Code::WrongType, course.place.clone(), message, "a closed path for laps", hint);
            return None;
        }
        if course.turning && !path.has_heading() {
            let message = format!("`{name}` leads straight up or down, where it has no heading");
            let expected = "a path without upright parts, or no `turning`";
            self.findings.add(Code::WrongType, course.place.clone(), message, expected, None);
            return None;
        }
        if course.follow {
            return self.trail(group, course, path, laps, dancers);
        }
        let length = path.length() * f64::from(laps);
        let begins = vec![0.0; dancers.len()];
        Some(Carrier { path: path.clone(), length, turning: course.turning, begins })
    }

    /// The way through the places of all robots, from the last to the first, and then along the path.
    fn trail(
        &mut self,
        group: &Together,
        course: &Course,
        path: &Path,
        laps: u32,
        dancers: &[Dancer<'_>],
    ) -> Option<Carrier> {
        let last = dancers.len() - 1;
        let mut trail: Vec<Point> = dancers.iter().rev().map(|dancer| dancer.from).collect();
        let (leader, own) = (dancers[0].from, path.points());
        let count = own.len() * laps as usize;
        if count + trail.len() > POINTS_MAX {
            let message = format!(
                "{} of {} robots and a path with its laps",
                counted(count + trail.len(), "point"),
                trail.len()
            );
            let expected = format!("at most {POINTS_MAX} points");
            self.findings.add(Code::TooMuch, course.place.clone(), message, expected, None);
            return None;
        }
        let same = (0..last).find(|index| metres_between(trail[*index], trail[index + 1]) < SAME);
        if let Some(index) = same {
            let [behind, ahead] =
                [last - index, last - index - 1].map(|robot| self.cast.id(dancers[robot].member.robot));
            let message = format!("`{behind}` stands where `{ahead}` does, which it follows");
            self.tell_no_row(group, message);
            return None;
        }
        let ahead = own.iter().cycle().take(count + usize::from(path.is_closed())).skip(1);
        trail.extend(ahead.map(|point| -> Point {
            std::array::from_fn(|axis| leader[axis] + (point[axis] - own[0][axis]))
        }));
        match Path::through(&trail, false) {
            Ok(path) => {
                let begins: Vec<f64> = (0..=last).map(|robot| path.far_of(last - robot)).collect();
                let length = path.length() - begins[0];
                Some(Carrier { path: Arc::new(path), length, turning: false, begins })
            }
            Err(turns) => {
                let robot = self.cast.id(dancers[last.saturating_sub(turns.point)].member.robot);
                let message = format!("the way of those that follow turns back on the spot at `{robot}`");
                self.tell_no_row(group, message);
                None
            }
        }
    }

    fn tell_no_row(&mut self, group: &Together, message: String) {
        let expected =
            "robots in a row, each behind the one that is named before it, and the path ahead of the first";
        let hint = Some("name the robots in another order, or `form` a line first".to_owned());
        self.findings.add(Code::NotInGroup, group.place.clone(), message, expected, hint);
    }
}
