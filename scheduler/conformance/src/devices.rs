//! Checks that each device has its own commands, stops, leases and queue, while request ids belong to the robot.

use urrcp::{Command, ControlRequest, DeviceId, ErrorCode, Inquiry, RequestId, Script, Setpoint, Span};

use super::actor::Actor;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, pass};
use super::stopping::cancels;
use super::trial::{LATER_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 7] = [
    Requirement {
        name: "devices-stop",
        number: "core-41",
        demands: "A stop of one device, with or without a start or `home: true`, does not end commands of another device.",
        section: "Cancelling (D)",
        check: stop,
    },
    Requirement {
        name: "devices-lease",
        number: "core-42",
        demands: "The end of a command's lease does not end commands of another device.",
        section: "The lease",
        check: lease,
    },
    Requirement {
        name: "devices-unsupported",
        number: "core-43",
        demands: "A control type that one device lacks does not end commands of another device.",
        section: "Refusing",
        check: unsupported,
    },
    Requirement {
        name: "devices-at-once",
        number: "core-44",
        demands: "Commands of two devices may overlap, and each device holds as many as its script_queue, whatever the others hold.",
        section: "Refusing",
        check: at_once,
    },
    Requirement {
        name: "devices-take-back",
        number: "core-45",
        demands: "A stop with a timestamp takes back only requests for its own device.",
        section: "Cancelling (D)",
        check: take_back,
    },
    Requirement {
        name: "devices-request-id",
        number: "core-46",
        demands: "A request_id that was used for one device is a repetition when it arrives for another one.",
        section: "Asked twice (D)",
        check: request_id,
    },
    Requirement {
        name: "stop-any-device",
        number: "core-47",
        demands: "An empty script is answered with `OK` by every device, also by one without scripts.",
        section: "Cancelling (D)",
        check: any_device,
    },
];

/// Maximum number of devices that are stopped one after the other, because a robot may have thousands.
const STOPPED_MAX: usize = 20;

/// Ends what the second device holds: the end of a check brings only the first device to rest.
fn rests(trial: &Trial, line: &mut Line, second: &Actor) -> Checked {
    cancels(trial, line, &trial.cancel(second))?;
    pass()
}

fn stop(trial: &Trial) -> Checked {
    let (first, second) = (trial.actor()?, trial.second()?);
    let mut line = trial.connect()?;
    let kept = line.held(&trial.pending(second))?;
    let now = trial.cancel(first);
    let later = ControlRequest { timestamp: Some(trial.stamp()), ..trial.cancel(first) };
    let home = ControlRequest { home: true, ..trial.cancel(first) };
    for stop in [now, later.starting_in(LATER_MS - 5_000.0), home] {
        let ended = line.held(&trial.pending(first))?;
        cancels(trial, &mut line, &stop)?;
        line.ends(ended, ErrorCode::Cancelled)?;
        line.stays_held(kept, 50, "the stop was for another device")?;
    }
    rests(trial, &mut line, second)
}

fn lease(trial: &Trial) -> Checked {
    let (first, second) = (trial.actor()?, trial.second()?);
    let mut line = trial.connect()?;
    let kept = line.held(&trial.pending(second).leased(LATER_MS))?;
    let runs = first.in_script && trial.reports();
    for running in [false, true].into_iter().filter(|running| runs || !running) {
        let request = if running {
            trial.there_and_back(first, 4_000.0).starting_in(100.0)
        } else {
            trial.pending(first)
        };
        let lost = line.held(&request.leased(300.0))?;
        line.listen(trial.soon(300) + trial.slack(), |line| !line.asked(lost).is_held())?;
        line.ends(lost, ErrorCode::LinkLost)?;
        line.stays_held(kept, 50, "the lease that ended was that of another device's command")?;
    }
    rests(trial, &mut line, second)
}

fn unsupported(trial: &Trial) -> Checked {
    let (first, second) = (trial.actor()?, trial.second()?);
    let mut line = trial.connect()?;
    let kept = line.held(&trial.pending(second))?;
    let lacking = Command::Set(Setpoint::new(first.lacks(), 0.0));
    let lacking = trial.request(&first.device.id, lacking).starting_in(LATER_MS);
    line.refuses(&lacking, ErrorCode::UnsupportedControlType)?;
    line.stays_held(kept, 50, "the control type was refused for another device")?;
    rests(trial, &mut line, second)
}

fn at_once(trial: &Trial) -> Checked {
    let (first, second) = (trial.actor()?, trial.second()?);
    let mut line = trial.connect()?;
    let begins = trial.pending(first);
    let queue = first.device.script_queue.min(3);
    for n in 0..queue {
        let request = ControlRequest { timestamp: begins.timestamp, ..trial.pending(first) };
        line.held(&request.starting_in(LATER_MS + 500.0 * f64::from(n)))?;
    }
    let at_once = ControlRequest { timestamp: begins.timestamp, ..trial.pending(second) };
    line.held(&at_once).map_err(|unmet| {
        unmet
            .within(|why| format!("another device holds as many commands as it can, at the same time: {why}"))
    })?;
    if trial.block()?.inquiry {
        has_own_room(
            &mut line,
            [first, second].map(|actor| actor.device.id.clone()).to_vec(),
            [first.device.script_queue - queue, second.device.script_queue - 1],
        )?;
    }
    rests(trial, &mut line, second)
}

fn has_own_room(line: &mut Line, devices: Vec<DeviceId>, rooms: [u32; 2]) -> Result<(), Unmet> {
    let inquired = line.inquire(&Inquiry { devices, ..Inquiry::default() })?;
    if inquired.response.devices.iter().map(|device| device.room).eq(rooms) {
        return Ok(());
    }
    let [first, second] = rooms;
    Err(inquired.differs(&format!("room {first} and {second}: each device counts only its own commands")))
}

fn take_back(trial: &Trial) -> Checked {
    let (first, second) = (trial.actor()?, trial.second()?);
    let mut line = trial.connect()?;
    let earlier = trial.pending(second);
    let stop = Some(trial.stamp() + Span::from_micros(1));
    cancels(trial, &mut line, &ControlRequest { timestamp: stop, ..trial.cancel(first) })?;
    line.held(&earlier).map_err(|unmet| {
        unmet.within(|why| format!("a stop of another device has a later timestamp: {why}"))
    })?;
    rests(trial, &mut line, second)
}

fn request_id(trial: &Trial) -> Checked {
    let (first, second) = (trial.actor()?, trial.second()?);
    let mut line = trial.connect()?;
    let request = trial.pending(first);
    line.held(&request)?;
    let again = ControlRequest { request_id: request.request_id, ..trial.pending(second) };
    let ticket = line.ask(&again)?;
    let answer = line.answer(ticket)?;
    if answer.message.device_id == first.device.id {
        return pass();
    }
    let expected = format!("the answer for `{}` again, which has used this request_id", first.device.id);
    let wrong = differs(&line.asked(ticket).text, &answer.text, &expected);
    rests(trial, &mut line, second)?;
    Err(wrong)
}

fn any_device(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    for device in trial.block()?.devices.iter().take(STOPPED_MAX) {
        let stop = trial.request(&device.id, Command::Script(Script::cancel()));
        let stop =
            ControlRequest { timestamp: None, request_id: RequestId::new(trial.fresh_id()).ok(), ..stop };
        let ticket = line.ask(&stop)?;
        let answer = line.answer(ticket)?;
        if answer.message.status != urrcp::Status::Ok {
            let expected = "status `OK`: every device accepts an empty script";
            return Err(differs(&line.asked(ticket).text, &answer.text, expected));
        }
    }
    pass()
}
