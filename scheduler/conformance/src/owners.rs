//! Checks of the session that owns a robot: other sessions cannot command the robot, reports follow the session's connection, and silence
//! ends the session.

use urrcp::{ControlRequest, ErrorCode, SessionId, Span, Status};

use super::identity::claim;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::trial::{LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 3] = [
    Requirement {
        name: "session-stop",
        number: "core-66",
        demands: "A stop from a session that does not own the robot, or without a session, is refused with `busy` and does not end or cancel any command.",
        section: "Sessions and connections (D)",
        check: session_stop,
    },
    Requirement {
        name: "session-silence",
        number: "core-67",
        demands: "A silent session that holds no commands keeps the robot for 5 s while its connection is open, and no longer.",
        section: "Sessions and connections (D)",
        check: session_silence,
    },
    Requirement {
        name: "reports-follow",
        number: "reports-5",
        demands: "Reports go to the connection on which the session last sent a message, regardless of the connection on which the command arrived.",
        section: "Reports (D)",
        check: reports_follow,
    },
];

/// Creates a session with an unused id.
pub(super) fn session(trial: &Trial) -> Result<SessionId, Unmet> {
    let name = format!("{}/session", trial.fresh_id());
    SessionId::new(name).map_err(|error| not_applicable(error.to_string()))
}

pub(super) fn of(session: &SessionId, request: ControlRequest) -> ControlRequest {
    ControlRequest { session: Some(session.clone()), ..request }
}

fn session_stop(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let (ours, theirs) = (session(trial)?, session(trial)?);
    let mut stranger = trial.connect()?;
    let mut line = trial.connect_second()?;
    let ticket = line.held(&of(&ours, trial.pending(actor)))?;
    let stop = || trial.cancel(actor);
    let ahead = Some(trial.stamp() + Span::from_millis(200));
    let stops = [stop(), of(&theirs, stop()), of(&theirs, ControlRequest { timestamp: ahead, ..stop() })];
    let refused = stops.iter().try_for_each(|stop| stranger.refuses(stop, ErrorCode::Busy));
    line.listen(trial.soon(100), |line| line.asked(ticket).heard.len() > 1)?;
    let more = line.asked(ticket).heard.get(1).map(|more| {
        differs(&line.asked(ticket).text, &more.text, "nothing: only the owning session may stop the command")
    });
    let own = line.ask(&of(&ours, stop()))?;
    line.answer(own)?;
    refused?;
    more.map_or(Ok(()), Err)?;
    // The timestamp of a stop that was refused must not invalidate earlier commands.
    let again = line.held(&of(&ours, trial.pending(actor)));
    let own = line.ask(&of(&ours, stop()))?;
    line.answer(own)?;
    again.map(drop).map_err(|unmet| {
        unmet.within(|why| format!("another session's stop with a later timestamp was refused: {why}"))
    })?;
    pass()
}

/// Period of silence after which a session without held commands (accepted, not yet ended) loses the robot.
const SILENCE: Span = Span::from_millis(5_000);

fn session_silence(trial: &Trial) -> Checked {
    let (ours, theirs) = (session(trial)?, session(trial)?);
    let mut first = trial.connect()?;
    let before = trial.now();
    let (sent, taken) = claim(trial, &mut first, &ours)?;
    if taken.message.status != Status::Ok {
        return Err(differs(&sent, &taken.text, "status `OK`: the robot is free"));
    }
    trial.pause(Span::from_millis(4_000))?;
    let mut second = trial.connect_second()?;
    let (sent, early) = claim(trial, &mut second, &theirs)?;
    let silent = trial.now() - before;
    if early.message.status == Status::Ok && silent < SILENCE {
        let expected = format!("`Failed` with `busy`: `{ours}` has been silent for only {silent}");
        return Err(differs(&sent, &early.text, &expected));
    }
    loop {
        let silent = trial.now() - taken.at;
        let (sent, answer) = claim(trial, &mut second, &theirs)?;
        if answer.message.status == Status::Ok {
            return Ok(format!("the robot was free after {silent} of silence"));
        }
        if silent > SILENCE + trial.slack() {
            let expected = format!("`OK`: `{ours}` has been silent for {silent} and holds no commands");
            return Err(differs(&sent, &answer.text, &expected));
        }
        trial.pause(Span::from_millis(50))?;
    }
}

fn reports_follow(trial: &Trial) -> Checked {
    trial.reporting()?;
    let ours = session(trial)?;
    for route in [&[0, 1][..], &[0, 1, 0]] {
        // If the session used the connection only after the command had begun, the test shows nothing.
        let heard_in_time = follows(trial, &ours, route, 500.0)?;
        if !heard_in_time {
            follows(trial, &ours, route, 1_000.0)?;
        }
    }
    pass()
}

/// Sends a command on the first connection of `route`, then a message on each of the others in order. Checks that the reports on the
/// command arrive on the last connection. Returns `false` if the command started too early for this check.
fn follows(trial: &Trial, session: &SessionId, route: &[usize], millis: f64) -> Result<bool, Unmet> {
    let actor = trial.actor()?;
    let first = trial.connect()?;
    let mut lines = [first, trial.connect_second()?];
    let (from, to) = (route[0], route[route.len() - 1]);
    let starts = trial.now() + Span::from_millis_f64(millis);
    let command = of(session, trial.set(actor, actor.rest)).starting_in(millis).leased(LEASE_MS);
    let mut ticket = lines[from].held(&command)?;
    for on in &route[1..] {
        claim(trial, &mut lines[*on], session)?;
    }
    let in_time = trial.now() + Span::from_millis(50) < starts;
    if to != from {
        let asked = lines[from].asked(ticket).clone();
        ticket = lines[to].expect_for(&asked);
    }
    for status in [Status::Started, Status::Ok] {
        let until = trial.patience() + Span::from_millis_f64(millis);
        let report = lines[to].report(ticket, &status, until);
        match report {
            Err(Unmet::Failed(why)) if in_time => {
                let heard = if to == from { "the first connection again" } else { "the second connection" };
                return Err(Unmet::Failed(format!(
                    "the session last sent a message on {heard}, but no report arrived there: {why}"
                )));
            }
            Err(Unmet::Failed(_)) => return Ok(false),
            other => other.map(drop)?,
        }
    }
    // All commands have ended, including those whose end was reported on another connection.
    lines.into_iter().for_each(Line::cut);
    Ok(true)
}
