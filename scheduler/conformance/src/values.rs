//! Checks of the values that a robot declares for its devices, and of the values that it accepts.

use urrcp::{Command, ControlType, DeviceId, ErrorCode, Message, Script, Setpoint, Status, Step, encode};

use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 11] = [
    Requirement {
        name: "range",
        number: "core-6",
        demands: "The values min_value and max_value are accepted; values beyond them are refused with `out_of_range`.",
        section: "Refusing",
        check: range,
    },
    Requirement {
        name: "granularity",
        number: "core-7",
        demands: "A value that is not a multiple of the granularity is refused with `off_granularity`.",
        section: "Refusing",
        check: granularity,
    },
    Requirement {
        name: "script-range",
        number: "script-1",
        demands: "A script with one step out of range or off the grid is refused as a whole.",
        section: "Refusing",
        check: script_range,
    },
    Requirement {
        name: "granularity-decimal",
        number: "core-8",
        demands: "Multiples of the granularity are accepted although decimal text rounds them, such as 0.3 with a granularity of 0.1.",
        section: "Initialization",
        check: granularity_decimal,
    },
    Requirement {
        name: "script-narrower",
        number: "script-2",
        demands: "A script whose value lies within the limits of its control type but not within the narrower limits of scripts is refused.",
        section: "Refusing",
        check: script_narrower,
    },
    Requirement {
        name: "unknown-device",
        number: "core-9",
        demands: "A request to a device that the robot does not have is refused with `unknown_device`.",
        section: "Refusing",
        check: unknown_device,
    },
    Requirement {
        name: "unsupported-control-type",
        number: "core-10",
        demands: "A control type that the device does not support is refused with `unsupported_control_type`, and the device's pending commands end with `Failed` and `cancelled`.",
        section: "Refusing",
        check: unsupported_control_type,
    },
    Requirement {
        name: "unknown-control-type",
        number: "core-11",
        demands: "A control type that the protocol does not define is treated as one that the device does not support, whatever its control_value is, including a list or a string.",
        section: "Refusing",
        check: unknown_control_type,
    },
    Requirement {
        name: "script-control-types",
        number: "script-3",
        demands: "A script with a step of a control type that scripts may not use is refused with `unsupported_control_type`.",
        section: "Refusing",
        check: script_control_types,
    },
    Requirement {
        name: "sensor",
        number: "sensor-1",
        demands: "A sensor request is answered with `Provide` and a reading from min_value to max_value, within max_delay.",
        section: "Sensors",
        check: sensor,
    },
    Requirement {
        name: "sensor-not-a-sensor",
        number: "core-12",
        demands: "A sensor request to a device that is not a sensor is refused with `unsupported_control_type`.",
        section: "Sensors",
        check: sensor_not_a_sensor,
    },
];

/// Checks that the device accepts a value for a later start. Cancels the command at once, so that nothing moves.
fn takes(trial: &Trial, line: &mut Line, value: f64) -> Result<(), Unmet> {
    let actor = trial.actor()?;
    line.held(&trial.set(actor, value).starting_in(LATER_MS).leased(LEASE_MS))?;
    let cancel = line.ask(&trial.cancel(actor))?;
    line.answer(cancel).map(drop)
}

fn range(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let [below, above] = actor.beyond()?;
    let [low, high] = actor.edges();
    takes(trial, &mut line, low)?;
    takes(trial, &mut line, high)?;
    for value in [below, above] {
        let request = trial.set(actor, value).starting_in(LATER_MS).leased(LEASE_MS);
        line.refuses(&request, ErrorCode::OutOfRange)?;
    }
    Ok(format!("`{}` accepted {low} and {high}, and refused {below} and {above}", actor.device.id))
}

/// Returns a value between two multiples of the granularity.
fn off_grid(trial: &Trial) -> Result<f64, Unmet> {
    let actor = trial.actor()?;
    actor.beyond()?;
    let half = actor.limits.granularity / 2.0;
    let between = [actor.rest + half, actor.rest - half].into_iter();
    between.into_iter().find(|v| actor.limits.contains(*v) && !actor.limits.on_grid(*v)).ok_or_else(|| {
        not_applicable(format!(
            "no value of `{}` lies between two multiples of its granularity",
            actor.device.id
        ))
    })
}

fn granularity(trial: &Trial) -> Checked {
    let (actor, value) = (trial.actor()?, off_grid(trial)?);
    let mut line = trial.connect()?;
    let request = trial.set(actor, value).starting_in(LATER_MS).leased(LEASE_MS);
    line.refuses(&request, ErrorCode::OffGranularity)?;
    pass()
}

fn script_range(trial: &Trial) -> Checked {
    let (actor, between) = (trial.scripted()?, off_grid(trial));
    let mut line = trial.connect()?;
    let later = |value: f64| {
        let steps = [(0.0, actor.rest), (100.0, value), (200.0, actor.rest)];
        trial.script(actor, &steps).starting_in(LATER_MS).leased(LEASE_MS)
    };
    let [_, above] = actor.beyond()?;
    line.refuses(&later(above), ErrorCode::OutOfRange)?;
    if let Ok(between) = between {
        line.refuses(&later(between), ErrorCode::OffGranularity)?;
    }
    pass()
}

/// Number of multiples of the granularity on each side of zero that are tried.
const MULTIPLES: i32 = 12;

fn granularity_decimal(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    actor.beyond()?;
    let mut line = trial.connect()?;
    let multiples =
        (-MULTIPLES..=MULTIPLES).map(|n| actor.limits.nearest(f64::from(n) * actor.limits.granularity));
    let mut tried = 0;
    for value in multiples.filter(|value| actor.limits.contains(*value)) {
        takes(trial, &mut line, value)?;
        tried += 1;
    }
    Ok(format!("{tried} multiples of {}", actor.limits.granularity))
}

fn script_narrower(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let [low, high] = actor.edges();
    let setpoint = |value| Setpoint::new(actor.control_type, value);
    let fits = |value: &f64| actor.device.check(&setpoint(*value)).is_ok();
    let granularity = actor.limits.granularity;
    let near = [actor.rest + granularity, actor.rest - granularity].map(|value| actor.limits.nearest(value));
    let mut line = trial.connect()?;
    let mut tried = 0;
    for value in [low, high].into_iter().chain(near).filter(fits) {
        let Err(refusal) = actor.device.check_in_script(&setpoint(value)) else { continue };
        let script = trial.script(actor, &[(0.0, value)]).starting_in(LATER_MS).leased(LEASE_MS);
        line.refuses(&script, refusal.code)?;
        takes(trial, &mut line, value)?;
        tried += 1;
    }
    if tried == 0 {
        return Err(not_applicable("scripts have the limits of their control type"));
    }
    pass()
}

fn unknown_device(trial: &Trial) -> Checked {
    let block = trial.block()?;
    let names = (0..).map(|n| format!("no-such-device-{n}"));
    let name = names.into_iter().find(|name| block.device(name).is_none()).unwrap_or_default();
    let device = DeviceId::new(&name).map_err(|error| not_applicable(error.to_string()))?;
    let mut line = trial.connect()?;
    let command = Command::Set(Setpoint::new(ControlType::Position, 0.0));
    let ticket = line.ask(&trial.request(&device, command).starting_in(LATER_MS).leased(LEASE_MS))?;
    let answer = line.refused(ticket, &[ErrorCode::UnknownDevice])?;
    if answer.message.device_id == device {
        pass()
    } else {
        Err(differs(&line.asked(ticket).text, &answer.text, "the device_id of the request"))
    }
}

fn unsupported_control_type(trial: &Trial) -> Checked {
    lacking(trial, &trial.actor()?.lacks().to_string(), "0")
}

fn unknown_control_type(trial: &Trial) -> Checked {
    let mut note = pass();
    for value in ["0", "[1,2]", "\"forwards\""] {
        note = Ok(lacking(trial, "no_such_control", value)?);
    }
    note
}

/// Checks that the robot refuses a command whose control type the device lacks, and ends the commands that the device holds.
fn lacking(trial: &Trial, control_type: &str, value: &str) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let pending = line.held(&trial.pending(actor))?;
    let command = Command::Set(Setpoint::new(ControlType::Position, 0.0));
    let request = trial.request(&actor.device.id, command).starting_in(LATER_MS).leased(LEASE_MS);
    let id = request.request_id.as_ref().map(ToString::to_string);
    let mut text = Vec::new();
    encode(&Message::ControlRequest(request), &mut text);
    // Replaces only the control type and the value in the text, because no Rust type can represent them.
    let named = format!("\"control_type\":\"{control_type}\"");
    let valued = format!("\"control_value\":{value}");
    let text = String::from_utf8_lossy(&text).replace("\"control_type\":\"position\"", &named);
    let text = text.replace("\"control_value\":0", &valued);
    let ticket = line.ask_text(id, actor.device.id.as_str(), &text)?;
    line.refused(ticket, &[ErrorCode::UnsupportedControlType])?;
    if !trial.reports() {
        return Ok("refused; without `reports`, it is unknown whether the device went to its default state"
            .to_owned());
    }
    line.failure(pending, ErrorCode::Cancelled, trial.patience()).map_err(|unmet| unmet.within(|why| format!(
            "the control type `{}` was refused, but the device must also go to its default state, which ends its commands: {why}",
            control_type
        )))?;
    pass()
}

fn script_control_types(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let usable = actor.device.script_control_types();
    let own = actor.device.available_control_types.iter().map(|(t, _)| t);
    let unlisted =
        own.filter(|t| !matches!(t, ControlType::Script | ControlType::Sensor)).find(|t| !usable.contains(t));
    let setpoint = match unlisted {
        Some(t) => Setpoint::new(
            t,
            actor.device.available_control_types.limits(t).map_or(0.0, |l| l.nearest_settable(0.0)),
        ),
        None => Setpoint::new(actor.lacks(), 0.0),
    };
    let step = Step { offset: urrcp::Millis::ZERO, setpoint, stop_condition: None };
    let script = Script::new(vec![step]).unwrap_or_default();
    let request = trial.request(&actor.device.id, Command::Script(script));
    let mut line = trial.connect()?;
    line.refuses(&request.starting_in(LATER_MS).leased(LEASE_MS), ErrorCode::UnsupportedControlType)?;
    pass()
}

fn sensor(trial: &Trial) -> Checked {
    let wanted = trial.options().device.as_deref();
    let mut sensors =
        trial.block()?.devices.iter().filter_map(|d| Some((d, d.available_control_types.sensor()?)));
    let preferred = sensors.clone().find(|(device, _)| Some(device.id.as_str()) == wanted);
    let Some((device, parameters)) = preferred.or_else(|| sensors.next()) else {
        return Err(not_applicable("the robot has no sensor"));
    };
    let mut line = trial.connect()?;
    // Measures the round trip.
    line.availability()?;
    let ticket = line.ask(&trial.request(&device.id, Command::ReadSensor))?;
    let answer = line.answer(ticket)?;
    let sent = line.asked(ticket).text.clone();
    let reading = match (&answer.message.status, &answer.message.status_value) {
        (Status::Provide, urrcp::StatusValue::Number(reading)) => *reading,
        _ => return Err(differs(&sent, &answer.text, "status `Provide` with a number as status_value")),
    };
    if !(reading >= parameters.min_value && reading <= parameters.max_value) {
        let expected = format!("a reading from {} to {}", parameters.min_value, parameters.max_value);
        return Err(differs(&sent, &answer.text, &expected));
    }
    let took = answer.at - line.asked(ticket).sent;
    let limit = parameters.max_delay.map(urrcp::Span::from_millis_f64);
    let allowed = limit.map(|limit| limit + trial.slack());
    if let Some(allowed) = allowed.filter(|allowed| took > *allowed) {
        return Err(differs(
            &sent,
            &format!("{} after {took}", answer.text),
            &format!("an answer within {allowed}, which is max_delay plus a round trip and the tolerance"),
        ));
    }
    Ok(format!("`{}` reads {reading}", device.id))
}

fn sensor_not_a_sensor(trial: &Trial) -> Checked {
    let block = trial.block()?;
    let chosen = trial.actor().ok().map(|actor| &actor.device);
    let mut devices = chosen.into_iter().chain(&block.devices);
    let Some(device) = devices.find(|d| d.available_control_types.sensor().is_none()) else {
        return Err(not_applicable("every device is a sensor"));
    };
    let mut line = trial.connect()?;
    line.refuses(&trial.request(&device.id, Command::ReadSensor), ErrorCode::UnsupportedControlType)?;
    pass()
}
