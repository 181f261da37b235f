//! Checks that no two movements use a device at the same time.

use urrcp::{Device, RobotId, Span};

use super::conflict::told;
use super::segment::Segment;
use crate::duration::written;
use crate::finding::{Code, Place, SharedFault};

/// Returns the fault of a movement that begins before an earlier one has ended, or at the same instant with another value.
pub(super) fn of_segments(
    device: &Device,
    robot: &RobotId,
    segment: &Segment,
    before: &Segment,
) -> Option<SharedFault> {
    let place = segment.part.place.clone();
    if segment.start() < before.end() {
        let overlapping =
            Overlap { cue: &segment.cue, start: segment.start(), before: &before.cue, end: before.end() };
        return Some(overlapping.fault(device, robot.clone(), place));
    }
    if segment.start() > before.start() {
        return None;
    }
    let (value, other) = (segment.first_setpoint()?, before.first_setpoint()?);
    (value != other).then(|| {
        let [value, other] = [value.value, other.value];
        let (at, other_cue) = (told(segment.start()), &before.cue);
        let message = [
            format!("`{}` sets `{}` of ", segment.cue, device.id),
            format!(" to {value} at {at}, and `{other_cue}` sets it to {other} at the same time"),
        ];
        SharedFault {
            code: Code::Overlap,
            cause: format!("{}\n{}", segment.cue, before.cue),
            size: 0.0,
            device: device.id.to_string(),
            robots: [robot.clone()].into(),
            place,
            message,
            expected: "one value at a time".to_owned(),
            hint: Some(format!("start `{}` later, or remove one of the values", segment.cue)),
        }
    })
}

/// A cue that begins to move a device at `start`, while the cue `before`, or the cue itself, moves the device until `end`.
pub(super) struct Overlap<'a> {
    pub(super) cue: &'a str,
    pub(super) start: Span,
    pub(super) before: &'a str,
    pub(super) end: Span,
}

impl Overlap<'_> {
    pub(super) fn fault(&self, device: &Device, robot: RobotId, place: Place) -> SharedFault {
        let Self { cue, start, before, end } = *self;
        let later = end - start;
        let message = [
            format!("`{cue}` moves `{}` of ", device.id),
            format!(" from {} on, but `{before}` moves it until {}", told(start), told(end)),
        ];
        let (expected, hint) = if cue == before {
            (
                "one movement of a device at a time".to_owned(),
                format!("remove one of the two movements, or move one of them to a cue after `{cue}`"),
            )
        } else {
            (
                format!("a start at {} or later", told(end)),
                format!("start `{cue}` {} later, for example with `after: {before}`", written(later)),
            )
        };
        SharedFault {
            code: Code::Overlap,
            cause: format!("{cue}\n{before}"),
            size: later.as_millis_f64(),
            device: device.id.to_string(),
            robots: [robot].into(),
            place,
            message,
            expected,
            hint: Some(hint),
        }
    }
}
