//! Computes the movement of each body in an act: from the scripts of its coordinate devices, or from the speeds that drive it.

use std::collections::HashMap;

use urrcp::{ControlType, DeviceId, Millis, RobotId, Script};

use super::check_space::Stage;
use crate::plan::{DeviceScript, DeviceUse, RobotPlan};
use crate::space::{Axis, Body, Coordinate, Drive, Peak, Played, Pose, Solid, Steering, peaks};

/// The movement of a body in an act.
pub(super) struct Course {
    /// Movements of x, y, z and yaw, then of the body's joints.
    pub(super) axes: Vec<Axis>,
    /// Distance by which the body's points may deviate from the movement `axes`, in metres.
    pub(super) margin: f64,
    /// The largest speed and the largest acceleration of the centre of the body.
    pub(super) peaks: [Option<Peak>; 2],
    /// Final pose of a body that is driven by speeds and stationary at the end; `None` for other bodies.
    pub(super) end: Option<Pose>,
}

/// Final poses of bodies that are driven by speeds. Keys are indices of robots; unknown poses are missing.
pub(super) type Poses = HashMap<usize, Pose>;

/// Poses at the start of an act, for bodies that are driven by speeds instead of positions.
pub(super) struct Standing<'a> {
    /// Final poses of the preceding acts; `None` for the first act.
    before: Option<Vec<&'a Poses>>,
}

impl<'a> Standing<'a> {
    /// Creates the poses after the acts `before`, which precede this one; `None` for the first act.
    pub(super) fn after(before: Option<&[usize]>, poses: &'a HashMap<usize, Poses>) -> Self {
        Self { before: before.map(|before| before.iter().filter_map(|act| poses.get(act)).collect()) }
    }

    /// Returns the pose of a robot if it is the same after every preceding act.
    fn of(&self, robot: usize, drive: &Drive) -> Option<Pose> {
        let Some(before) = &self.before else { return Some(Pose::at(drive.start)) };
        let (first, others) = before.split_first()?;
        let pose = first.get(&robot).copied();
        others.iter().all(|other| other.get(&robot).copied() == pose).then_some(pose).flatten()
    }
}

/// The scripts of each robot in an act.
pub(super) struct Scripts<'a> {
    of_robot: HashMap<&'a RobotId, &'a RobotPlan>,
    used: HashMap<(&'a RobotId, &'a DeviceId), &'a DeviceUse>,
    /// End of the act's last script, in seconds.
    ends: f64,
}

impl<'a> Scripts<'a> {
    pub(super) fn of(stage: &Stage<'a>) -> Self {
        let of_robot = stage.robots.iter().map(|plan| (&plan.robot, plan)).collect();
        let used = stage.devices.iter().map(|used| ((&used.robot, &used.device), used)).collect();
        let all = stage.robots.iter().flat_map(|plan| &plan.scripts);
        let end = |script: &DeviceScript| (script.start.span() + script.duration()).as_millis_f64() / 1_000.0;
        Self { of_robot, used, ends: all.map(end).fold(0.0, f64::max) }
    }

    /// Whether the robot has scripts in the act. A robot without scripts may be absent.
    pub(super) fn plays(&self, robot: &RobotId) -> bool {
        self.of_robot.contains_key(robot)
    }

    /// Returns a device's scripts with their start times, and their largest deviation from the written movement.
    fn of_device(&self, robot: &RobotId, device: &DeviceId) -> (Vec<(Millis, &'a Script)>, f64) {
        let scripts = self.of_robot.get(robot).into_iter().flat_map(|plan| &plan.scripts);
        let error = self.used.get(&(robot, device)).map_or(0.0, |used| used.worst_error);
        let scripts = scripts.filter(|script| script.device == *device);
        (scripts.map(|script| (script.start, &script.script)).collect(), error)
    }
}

impl Stage<'_> {
    /// Returns the movement of a body; `None` if one of its coordinates is never known.
    pub(super) fn course(&self, scripts: &Scripts<'_>, robot: usize, body: &Body) -> Option<Course> {
        let position = |coordinate| self.axis(scripts, robot, coordinate, ControlType::Position);
        let joints: Option<Vec<Axis>> = body.joints.iter().map(|joint| position(&joint.value)).collect();
        let joints = joints?;
        let [x, y, z, yaw] = &body.coordinates;
        let mut course = match &body.drive {
            Some(drive) => {
                let largest: Vec<f64> = joints.iter().map(Axis::largest).collect();
                let lever = Solid::of(body, 0.0).lever(&largest);
                self.driven(scripts, robot, drive, lever, position(z)?)?
            }
            None => {
                let axes = vec![position(x)?, position(y)?, position(z)?, position(yaw)?];
                Course { margin: 0.0, peaks: peaks(&axes), axes, end: None }
            }
        };
        course.axes.extend(joints);
        Some(course)
    }

    fn driven(
        &self,
        scripts: &Scripts<'_>,
        robot: usize,
        drive: &Drive,
        lever: f64,
        z: Axis,
    ) -> Option<Course> {
        let signals = match &drive.steering {
            Steering::Wheels { left, right, .. } => [left, right],
            Steering::Twist { speed, turn } => [speed, turn],
        };
        let [first, second] = signals.map(|signal| self.axis(scripts, robot, signal, ControlType::Speed));
        let start = self.standing.of(robot, drive)?;
        let driven = drive.path(start, &[first?, second?], scripts.ends, lever)?;
        let [x, y, yaw] = driven.axes;
        Some(Course { axes: vec![x, y, z, yaw], margin: driven.margin, peaks: driven.peaks, end: driven.end })
    }

    fn axis(
        &self,
        scripts: &Scripts<'_>,
        robot: usize,
        coordinate: &Coordinate,
        control_type: ControlType,
    ) -> Option<Axis> {
        let Coordinate::Device { device, .. } = coordinate else {
            return Axis::of(coordinate, &Played::default());
        };
        let index = self.cast.devices(robot).iter().position(|other| other.id == *device)?;
        let (scripts, error) = scripts.of_device(self.cast.id(robot), device);
        let interpolation = self.cast.devices(robot)[index].interpolation;
        let begin = match control_type {
            ControlType::Speed => self.positions.of_speed(robot, index),
            _ => self.positions.of(robot, index),
        };
        Axis::of(coordinate, &Played { scripts: &scripts, control_type, interpolation, begin, error })
    }
}
