//! Checks of the session that owns a robot: what claims the robot, what remains permitted to others, and how long ownership lasts.

use urrcp::{AvailabilityRequest, Command, ControlRequest, ErrorCode, Message, Span, Status};

use super::identity::claim;
use super::ids::is_busy_for;
use super::owners::{of, session};
use super::requirement::{Checked, Requirement, differs, not_applicable, pass};
use super::stopping::cancels;
use super::trial::Trial;
use downbeat_runtime::link::Security;

pub(super) const ALL: [Requirement; 7] = [
    Requirement {
        name: "session-ask",
        number: "core-68",
        demands: "While a session owns the robot, requests for availability without a session are answered with `OK`, and initialization requests with the block.",
        section: "Sessions and connections (D)",
        check: ask,
    },
    Requirement {
        name: "session-sensor",
        number: "sensor-2",
        demands: "Any server may read a sensor, whichever session owns the robot, and a reading claims nothing.",
        section: "Sensors",
        check: sensor,
    },
    Requirement {
        name: "session-refused",
        number: "core-69",
        demands: "A control request claims the free robot for its session, even if a later check refuses it.",
        section: "Refusing",
        check: refused,
    },
    Requirement {
        name: "session-each-time",
        number: "core-70",
        demands: "A control request without a session is refused with `busy`, even on a connection that has named the session that owns the robot.",
        section: "Sessions and connections (D)",
        check: each_time,
    },
    Requirement {
        name: "session-two-links",
        number: "core-71",
        demands: "A session may send its control requests on another connection than the one on which it claimed the robot.",
        section: "Sessions and connections (D)",
        check: two_links,
    },
    Requirement {
        name: "session-holds",
        number: "core-72",
        demands: "A session whose connection is closed keeps the robot while the robot holds a command.",
        section: "Sessions and connections (D)",
        check: holds,
    },
    Requirement {
        name: "seize-plain",
        number: "core-73",
        demands: "A peer that has not proven its roles cannot seize the robot: the request is refused, and the owner's commands stay held.",
        section: "Seizing (D)",
        check: seize_plain,
    },
];

fn ask(trial: &Trial) -> Checked {
    let ours = session(trial)?;
    let mut other = trial.connect()?;
    let mut owner = trial.connect_second()?;
    claim(trial, &mut owner, &ours)?;
    other.availability()?;
    other.initialization()?;
    pass()
}

fn sensor(trial: &Trial) -> Checked {
    let sensors = trial.block()?.devices.iter();
    let Some(sensor) = sensors.clone().find(|device| device.available_control_types.sensor().is_some())
    else {
        return Err(not_applicable("the robot has no sensor"));
    };
    let (reader, ours) = (session(trial)?, session(trial)?);
    let mut stranger = trial.connect()?;
    let mut owner = trial.connect_second()?;
    let read = of(&reader, trial.request(&sensor.id, Command::ReadSensor));
    let ticket = stranger.ask(&read)?;
    stranger.answer(ticket)?;
    let (sent, answer) = claim(trial, &mut owner, &ours)?;
    if answer.message.status != Status::Ok {
        return Err(differs(&sent, &answer.text, "status `OK`: the other session has only read a sensor"));
    }
    let ticket = stranger.ask(&trial.request(&sensor.id, Command::ReadSensor))?;
    let answer = stranger.answer(ticket)?;
    if answer.message.status == Status::Provide {
        return pass();
    }
    Err(differs(&stranger.asked(ticket).text, &answer.text, "status `Provide`: any server may read a sensor"))
}

fn refused(trial: &Trial) -> Checked {
    let (ours, theirs) = (session(trial)?, session(trial)?);
    let mut stranger = trial.connect()?;
    let mut line = trial.connect_second()?;
    let refusable = trial.refusable(trial.actor()?);
    line.refuses(&of(&ours, refusable.request), refusable.code)?;
    is_busy_for(trial, &mut stranger, &theirs, &ours)?;
    pass()
}

fn each_time(trial: &Trial) -> Checked {
    let ours = session(trial)?;
    let mut line = trial.connect()?;
    claim(trial, &mut line, &ours)?;
    line.refuses(&trial.pending(trial.actor()?), ErrorCode::Busy)?;
    pass()
}

fn two_links(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let ours = session(trial)?;
    let mut first = trial.connect()?;
    let mut second = trial.connect_second()?;
    claim(trial, &mut first, &ours)?;
    second.held(&of(&ours, trial.pending(actor)))?;
    cancels(trial, &mut second, &of(&ours, trial.cancel(actor)))?;
    pass()
}

fn holds(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let (ours, theirs) = (session(trial)?, session(trial)?);
    let mut line = trial.connect()?;
    let mut stranger = trial.connect_second()?;
    line.held(&of(&ours, trial.pending(actor)))?;
    line.cut();
    trial.pause(Span::from_millis(300))?;
    is_busy_for(trial, &mut stranger, &theirs, &ours)?;
    let mut again = trial.connect()?;
    cancels(trial, &mut again, &of(&ours, trial.cancel(actor)))?;
    pass()
}

fn seize_plain(trial: &Trial) -> Checked {
    if !matches!(trial.options().security, Security::Plain) {
        return Err(not_applicable("peers of this robot prove their roles"));
    }
    let actor = trial.actor()?;
    let (ours, theirs) = (session(trial)?, session(trial)?);
    let mut stranger = trial.connect()?;
    let mut owner = trial.connect_second()?;
    let kept = owner.held(&of(&ours, trial.pending(actor)))?;
    let seize = AvailabilityRequest { session: Some(theirs), seize: true, ..AvailabilityRequest::default() };
    let sent = stranger.say(&Message::AvailabilityRequest(seize))?;
    let answer = stranger.other(trial.patience())?;
    let refused = answer.as_ref().is_some_and(|answer| {
        matches!(&answer.message, Message::AvailabilityResponse(response) if response.status == Status::Failed)
    });
    if !refused {
        let came = answer.map_or_else(|| "nothing".to_owned(), |answer| answer.text);
        return Err(differs(&sent, &came, "status `Failed`: nothing is proven on this connection"));
    }
    owner.stays_held(kept, 50, "another peer, without a proven role, requested to seize the robot")?;
    let stop: ControlRequest = of(&ours, trial.cancel(actor));
    cancels(trial, &mut owner, &stop)?;
    pass()
}
