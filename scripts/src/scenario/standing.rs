//! The places of the robots in space while cues are read, in the order of the file.

use std::collections::HashMap;

use urrcp::ControlType;

use super::library::Library;
use super::{Cue, Motion, Track};
use crate::composed::is_same;
use crate::ensemble::{self, Dancer, GroupTask, Rehearsed, Together};
use crate::fields::{Axis, Group, Standing, Whereabouts};
use crate::fleet::{Fleet, FleetRobot, devices_of};
use crate::space::Coordinate;

/// Returns all robots of the fleet at their places before the first cue.
pub(super) fn at_first(fleet: &Fleet) -> Group {
    let standing = |robot: &FleetRobot| Standing { id: robot.id.clone(), axes: axes(robot) };
    Group::of(fleet.robots.iter().map(standing).collect())
}

/// Moves the robots to their places after a cue. Returns the movements of the cue's group, if all its starting places are known.
pub(super) fn leave(group: &mut Group, library: &Library<'_>, cue: &Cue) -> Option<Rehearsed> {
    let rehearsed = cue.group.as_ref().and_then(|together| rehearse(group, library, cue, together));
    let mut overridden = HashMap::new();
    for (name, movement) in &cue.overrides {
        let robots = library.robots(std::slice::from_ref(name));
        overridden.extend(robots.into_iter().map(|robot| (robot, movement)));
    }
    for (index, robot) in group.robots.iter().enumerate() {
        let Some(axes) = group.fleet.get_mut(*robot).and_then(|robot| robot.axes.as_mut()) else {
            continue;
        };
        let own = cue.own_of.get(index).copied().flatten().and_then(|own| cue.own.get(own));
        let movement = own.or_else(|| overridden.get(robot).copied()).unwrap_or(&cue.movement);
        for track in &movement.tracks {
            axes.iter_mut().for_each(|axis| follow(axis, track));
        }
    }
    rehearsed
}

/// Moves each robot of a group to the end of its movement. If the movement is unknown, the robot's place is unknown afterwards.
fn rehearse(group: &mut Group, library: &Library<'_>, cue: &Cue, together: &Together) -> Option<Rehearsed> {
    let asked = GroupTask { together, tolerance: cue.tolerance };
    let dancers = dancers(group, library, cue);
    let ways = dancers.as_ref().map(|dancers| ensemble::ways(asked, dancers, library.ground()));
    for robot in &group.robots {
        let axes = group.fleet.get_mut(*robot).and_then(|robot| robot.axes.as_mut());
        axes.into_iter().flatten().for_each(Axis::lose);
    }
    let (dancers, ways) = (dancers?, ways?);
    for (dancer, moved) in dancers.iter().zip(ways.iter().flatten()) {
        let Some(axes) = group.fleet.get_mut(dancer.robot).and_then(|robot| robot.axes.as_mut()) else {
            continue;
        };
        for ((axis, settable), end) in axes.iter_mut().zip(&dancer.axes).zip(moved.end()) {
            axis.at = Whereabouts::Known(settable.nearest(end));
        }
    }
    Some(Rehearsed::new(&dancers, ways))
}

/// Returns the robots of a cue as a group; `None` if a starting place is unknown.
fn dancers<'a>(group: &Group, library: &'a Library<'_>, cue: &Cue) -> Option<Vec<Dancer<'a>>> {
    let dancer = |(index, robot): (usize, &usize)| {
        let known = &library.ground().fleet.robots[*robot];
        let body = known.body.as_ref()?;
        let axes = ensemble::axes(body, devices_of(known))?;
        let from = group.fleet.get(*robot)?.metres()?;
        Some(Dancer { robot: *robot, delay: cue.canon.delay(index), body, axes, from })
    };
    group.robots.iter().enumerate().map(dancer).collect()
}

fn follow(axis: &mut Axis, track: &Track) {
    let Coordinate::Device { device, scale, offset } = &axis.of else { return };
    if !is_same(device.as_str(), &track.device) {
        return;
    }
    axis.at = match (&track.motion, track.control) {
        (Motion::Curve(curve), None | Some(ControlType::Position)) => curve
            .knots
            .last()
            .map_or(Whereabouts::Unknown, |last| Whereabouts::Known(offset + scale * last.to)),
        _ => Whereabouts::Unknown,
    };
}

/// Returns the place of a robot's body in its default state; `None` if it has no body in space.
fn axes(robot: &FleetRobot) -> Option<[Axis; 3]> {
    let [x, y, z, _] = &robot.body.as_ref()?.coordinates;
    let axis = |coordinate: &Coordinate| {
        let metres = match coordinate {
            Coordinate::Fixed(metres) => Some(*metres),
            Coordinate::Device { device, scale, offset } => {
                let known = devices_of(robot).iter().find(|known| known.id == *device);
                known.and_then(|known| known.default_value).map(|value| offset + scale * value)
            }
        };
        Axis { of: coordinate.clone(), at: metres.map_or(Whereabouts::Unknown, Whereabouts::Known) }
    };
    Some([x, y, z].map(axis))
}
