//! Checks robots with arbitrary valid descriptions: each robot returns its description, and each device can be driven to its bounds and
//! stopped.

use downbeat_robot::{Input, LinkId, Output, Robot};
use urrcp::{
    Command, ControlRequest, ControlType, Device, DeviceId, InitializationBlock, InitializationRequest,
    Message, Millis, Robot as RobotClock, Script, Setpoint, Span, Step, Timestamp,
};

use crate::{BEGIN, Violation, hold};

const LINK: LinkId = LinkId(1);
/// Duration of a device's movement from one of its bounds to the other.
const WAY: Span = Span::from_millis(1_000);

/// Requests the description of a robot, and drives each of its devices from bound to bound. Checks that the robot answers each request
/// for the requested device, and that the value of a moving device is always a number.
///
/// # Errors
/// The first [`Violation`].
pub fn drive_all(block: &InitializationBlock) -> Result<(), Violation> {
    let mut robot = Robot::new(block.clone());
    let mut now = Timestamp::from_nanos(BEGIN);
    let mut out = Vec::new();
    let describe = Message::InitializationRequest(InitializationRequest::default());
    robot.handle(now, LINK, Input::Message(describe), &mut out);
    let described =
        matches!(&out[..], [Output::Send { message: Message::InitializationBlock(b), .. }] if b == block);
    hold(described, || format!("unexpected answer to an initialization request: {out:?}"))?;
    for device in &block.devices {
        for command in commands(device) {
            send(&mut robot, now, device, command)?;
            for _ in 0..4 {
                now = now + WAY / 4;
                robot.advance(now, &mut Vec::new());
                check_values(&robot, now, &device.id)?;
            }
        }
    }
    Ok(())
}

/// Returns commands for every control type of a device: a script from bound to bound and back, a stop, a value at each bound, a stop, and
/// a sensor reading.
fn commands(device: &Device) -> Vec<Command> {
    let mut commands = Vec::new();
    for (control_type, _) in device.available_control_types.iter() {
        let bounds = match device.available_control_types.limits(control_type) {
            Some(limits) => [limits.min_value, limits.max_value].map(|bound| limits.nearest_settable(bound)),
            None => [-1.0, 1.0],
        };
        let step = |(i, value): (usize, &f64)| Step {
            offset: Millis::from_span(WAY * i64::try_from(i).unwrap_or(0)),
            setpoint: Setpoint::new(control_type, *value),
            stop_condition: None,
        };
        let there_and_back = [bounds[0], bounds[1], bounds[0]];
        let script = Script::new(there_and_back.iter().enumerate().map(step).collect()).unwrap_or_default();
        let stop = Command::Script(Script::cancel());
        commands.extend([Command::Script(script), stop.clone()]);
        commands.extend(bounds.map(|bound| Command::Set(Setpoint::new(control_type, bound))));
        commands.extend([stop, Command::ReadSensor]);
    }
    commands
}

fn send(
    robot: &mut Robot,
    now: Timestamp<RobotClock>,
    device: &Device,
    command: Command,
) -> Result<(), Violation> {
    let mut out = Vec::new();
    let request = ControlRequest::immediate(device.id.clone(), command);
    robot.handle(now, LINK, Input::Message(Message::ControlRequest(request)), &mut out);
    let answered = out.iter().any(|output| is_said_of(output, &device.id));
    hold(answered, || format!("no answer from `{}`: {out:?}", device.id))?;
    let concerns = |output| {
        is_said_of(output, &device.id) || matches!(output, Output::Set(set) if set.device == device.id)
    };
    hold(out.iter().all(concerns), || {
        format!("unexpected output for a device other than `{}`: {out:?}", device.id)
    })
}

fn is_said_of(output: &Output, device: &DeviceId) -> bool {
    matches!(output, Output::Send { message: Message::ControlResponse(r), .. } if r.device_id == *device)
}

fn check_values(robot: &Robot, now: Timestamp<RobotClock>, device: &DeviceId) -> Result<(), Violation> {
    for control_type in [ControlType::Position, ControlType::Speed, ControlType::Acceleration] {
        let value = robot.value(device.as_str(), control_type, now);
        hold(value.is_none_or(f64::is_finite), || {
            format!("`{device}` has the value {value:?} for {control_type}, expected a finite number")
        })?;
    }
    Ok(())
}
