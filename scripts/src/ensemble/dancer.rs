//! A robot of a group, with the devices that are coordinates of its body.

use urrcp::{ControlType, Device, Limits, Span};

use crate::fleet::{Fleet, limits_of};
use crate::formation::Point;
use crate::motion::nearest_on_grid;
use crate::space::{Body, Coordinate};
use crate::transit;

/// A coordinate of a body: fixed, or moved by a device.
#[derive(Clone, Copy)]
pub(crate) enum Axis<'a> {
    Fixed(f64),
    Moved {
        /// Index of the device in the robot's list of devices.
        index: usize,
        device: &'a Device,
        /// Metres per unit of the device.
        scale: f64,
        offset: f64,
    },
}

impl<'a> Axis<'a> {
    fn limits(&self) -> Option<impl Iterator<Item = &'a Limits>> {
        match self {
            Self::Fixed(_) => None,
            Self::Moved { device, .. } => Some(limits_of(device, ControlType::Position)),
        }
    }

    /// Returns the position nearest to `metres` to which the device can be set, in metres.
    pub(crate) fn nearest(&self, metres: f64) -> f64 {
        match *self {
            Self::Fixed(value) => value,
            Self::Moved { scale, offset, .. } => {
                let value = (metres - offset) / scale;
                let limits = self.limits().and_then(|mut limits| limits.next());
                offset + scale * limits.map_or(value, |limits| nearest_on_grid(limits, value))
            }
        }
    }

    /// Returns the device's default position in metres.
    pub(super) fn home(&self) -> Option<f64> {
        match *self {
            Self::Fixed(value) => Some(value),
            Self::Moved { device, scale, offset, .. } => {
                device.default_value.map(|value| offset + scale * value)
            }
        }
    }

    /// Returns three numbers: the metres per unit of the device, the coordinate of its zero in metres, and its granularity. `None` for a
    /// fixed coordinate.
    pub(super) fn grid(&self) -> Option<[f64; 3]> {
        let Self::Moved { scale, offset, .. } = *self else { return None };
        let limits = self.limits().and_then(|mut limits| limits.next());
        Some([scale, offset, limits.map_or(0.0, |limits| limits.granularity)])
    }

    /// Returns the permitted error of the device's steps, in metres: `tolerance` or, by default, the error that the device permits.
    pub(crate) fn error(&self, tolerance: Option<f64>) -> f64 {
        let Self::Moved { scale, .. } = self else { return 0.0 };
        let own = |limits: &Limits| limits.max_error.unwrap_or(0.0).max(limits.granularity);
        scale.abs() * tolerance.unwrap_or_else(|| self.most(own))
    }

    /// Returns a tolerance for the device's steps, in the unit of the device. It uses only the share `error_share` of the permitted
    /// error, but is at least as large as the device's grid requires.
    pub(crate) fn tolerance(&self, tolerance: Option<f64>, error_share: f64) -> Option<f64> {
        let Self::Moved { scale, .. } = self else { return tolerance };
        if error_share >= 1.0 {
            return tolerance;
        }
        let error = self.error(tolerance) / scale.abs();
        Some((error * error_share).max(self.most(|limits| limits.granularity)).min(error))
    }

    fn most(&self, value: impl Fn(&Limits) -> f64) -> f64 {
        self.limits().into_iter().flatten().map(value).fold(0.0, f64::max)
    }

    /// Returns the smallest and the largest coordinate that the device can reach, in metres.
    pub(super) fn ends(&self) -> Option<[f64; 2]> {
        let Self::Moved { scale, offset, .. } = *self else { return None };
        let all = self.limits()?;
        let (least, most) = all.fold((f64::NEG_INFINITY, f64::INFINITY), |(least, most), limits| {
            (least.max(limits.min_value), most.min(limits.max_value))
        });
        let ends = [offset + scale * least, offset + scale * most];
        Some(if scale < 0.0 { [ends[1], ends[0]] } else { ends })
    }
}

/// A robot of a group, with the place at which it begins.
pub(crate) struct Dancer<'a> {
    /// Index of the robot in the fleet.
    pub(crate) robot: usize,
    /// Delay of the robot's start after the start of the cue.
    pub(crate) delay: Span,
    pub(crate) body: &'a Body,
    pub(crate) axes: [Axis<'a>; 3],
    /// Position of the robot's body when it begins, in metres.
    pub(crate) from: Point,
}

impl Dancer<'_> {
    /// Returns the delay of the robot's start, since the start of the cue, in seconds.
    pub(super) fn delay_seconds(&self) -> f64 {
        self.delay.as_millis_f64() / 1_000.0
    }

    /// Returns the index of the robot, the delay of its start in seconds, and its place at its start.
    pub(super) fn begin(&self) -> (usize, f64, Point) {
        (self.robot, self.delay_seconds(), self.from)
    }

    /// Returns the largest distance, in metres, from a required place at which the grids of the robot's devices may leave it. See
    /// [`coarseness`].
    pub(super) fn coarseness(&self) -> f64 {
        coarseness_of(&self.axes)
    }

    /// Whether the robot's height is fixed.
    pub(super) const fn is_flat(&self) -> bool {
        matches!(self.axes[2], Axis::Fixed(_))
    }

    /// Returns the robot's limits of speed and acceleration along each axis and in total.
    pub(super) fn limits(&self, fleet: &Fleet) -> transit::Limits {
        let of_axis = |axis: &Axis<'_>| {
            let Axis::Moved { device, scale, .. } = axis else { return [f64::INFINITY; 2] };
            let given = fleet.robots[self.robot].limits.get(device.id.as_str()).copied().unwrap_or_default();
            let limits = given.or_declared(device, ControlType::Position);
            [limits.speed, limits.acceleration]
                .map(|limit| limit.map_or(f64::INFINITY, |limit| limit * scale.abs()))
        };
        let body = [self.body.speed, self.body.acceleration].map(|limit| limit.unwrap_or(f64::INFINITY));
        transit::Limits { axes: self.axes.each_ref().map(of_axis), body }
    }
}

/// Returns the largest distance, in metres, from a required place at which the grids of a body's devices may leave the body.
pub(crate) fn coarseness(body: &Body, devices: &[Device]) -> f64 {
    axes(body, devices).map_or(0.0, |axes| coarseness_of(&axes))
}

fn coarseness_of(axes: &[Axis<'_>; 3]) -> f64 {
    let grids = axes.iter().filter_map(Axis::grid);
    grids.map(|[scale, _, granularity]| scale * granularity).fold(0.0, f64::hypot)
}

/// Returns the coordinates x, y and z of a body; `None` if x or y is not a device, or if the body is driven by speeds.
pub(crate) fn axes<'a>(body: &Body, devices: &'a [Device]) -> Option<[Axis<'a>; 3]> {
    if body.drive.is_some() {
        return None;
    }
    let axis = |coordinate: &Coordinate| match coordinate {
        Coordinate::Fixed(value) => Some(Axis::Fixed(*value)),
        Coordinate::Device { device, scale, offset } => {
            let index = devices.iter().position(|other| other.id == *device)?;
            Some(Axis::Moved { index, device: &devices[index], scale: *scale, offset: *offset })
        }
    };
    let [x, y, z, _] = &body.coordinates;
    let axes = [axis(x)?, axis(y)?, axis(z)?];
    axes[..2].iter().all(|axis| matches!(axis, Axis::Moved { .. })).then_some(axes)
}
