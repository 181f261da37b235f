//! Checks of the forms of timestamps, and of offsets and periods that do not fit into small numbers.

use serde_json::json;
use urrcp::{ControlRequest, ErrorCode, Inquiry, RequestState, Server, Span, Status, Timestamp};

use super::heard::Ticket;
use super::ids::line_of;
use super::inquiries::is_at;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, pass};
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 5] = [
    Requirement {
        name: "timestamp-forms",
        number: "core-18",
        demands: "A timestamp has 0 to 9 fractional digits, and the first one counts tenths of a second; one with another offset from UTC is understood or refused with `malformed`.",
        section: "Messages (D)",
        check: timestamp_forms,
    },
    Requirement {
        name: "old-timestamp",
        number: "core-19",
        demands: "A request whose timestamp is long past and whose start is not is accepted, and its lease counts from the receipt.",
        section: "Time (D)",
        check: old_timestamp,
    },
    Requirement {
        name: "large-offsets",
        number: "core-20",
        demands: "An offset of 3,000,000,000 or 10,000,000,000 ms is understood to the millisecond, and not cut.",
        section: "Messages (D)",
        check: large_offsets,
    },
    Requirement {
        name: "large-lease",
        number: "core-21",
        demands: "A lease of more than 65,536 ms does not end early; a longer one than 24 h is kept, or refused with `out_of_range`.",
        section: "Time (D)",
        check: large_lease,
    },
    Requirement {
        name: "steps-at-once",
        number: "script-5",
        demands: "Two steps of a script may be due at the same instant.",
        section: "Control request",
        check: steps_at_once,
    },
];

const SECOND: i64 = 1_000_000_000;

/// Creates a request that the robot holds, whose timestamp is `age` old.
fn aged(trial: &Trial, age: Span) -> Result<ControlRequest, Unmet> {
    let timestamp = Some(trial.stamp() - age);
    Ok(ControlRequest { timestamp, ..trial.pending(trial.actor()?) }
        .starting_in(age.as_millis_f64() + LATER_MS))
}

/// Checks that the robot plans to start an accepted request at its time, if the robot answers inquiries.
fn is_planned(trial: &Trial, line: &mut Line, request: &ControlRequest) -> Result<(), Unmet> {
    if !trial.block()?.inquiry {
        return Ok(());
    }
    let requests = request.request_id.clone().into_iter().collect();
    let inquired = line.inquire(&Inquiry { requests, ..Inquiry::default() })?;
    let planned = inquired.response.requests.first().filter(|report| report.state == RequestState::Held);
    if planned.is_some_and(|report| is_at(report.start_timestamp, request)) {
        return Ok(());
    }
    Err(inquired.differs("state `held`, and a start_timestamp equal to timestamp + time_offset_to_start"))
}

fn cancels(trial: &Trial, line: &mut Line) -> Result<(), Unmet> {
    let cancel = line.ask(&trial.cancel(trial.actor()?))?;
    line.answer(cancel).map(drop)
}

/// An instant with the text that states it.
struct Written {
    at: Timestamp<Server>,
    text: String,
    /// Whether the robot may refuse this form.
    may_refuse: bool,
}

/// Writes instants in the last two seconds in several forms: a robot that misreads the fraction or the offset finds that the start has
/// passed, or plans a different start.
fn forms(now: Timestamp<Server>) -> Vec<Written> {
    let whole = now.as_nanos().div_euclid(SECOND) - 1;
    let with = |digits: &str| {
        let nanos = format!("{digits:0<9}").parse::<i64>().unwrap_or(0);
        let at = Timestamp::from_nanos(whole * SECOND + nanos);
        let base = at.to_string();
        let fraction = if digits.is_empty() { String::new() } else { format!(".{digits}") };
        Written { at, text: format!("{}{fraction}Z", &base[..19]), may_refuse: false }
    };
    let elsewhere = |hours: i64, offset: &str| {
        let at = Timestamp::<Server>::from_nanos(whole * SECOND);
        let local = (at + Span::from_millis(hours * 3_600_000)).to_string();
        Written { at, text: format!("{}{offset}", &local[..19]), may_refuse: true }
    };
    let mut forms: Vec<_> = ["9", "", "75", "999", "987654", "9876543", "123456789"].map(with).into();
    forms.extend([elsewhere(-2, "-02:00"), elsewhere(2, "+02:00"), elsewhere(0, "+00:00")]);
    forms
}

fn timestamp_forms(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    for Written { at, text, may_refuse } in forms(trial.stamp()) {
        let ahead = (trial.stamp() - at).as_millis_f64().ceil() + 800.0;
        let request = ControlRequest { timestamp: Some(at), ..trial.set(actor, actor.rest) };
        let request = request.starting_in(ahead).leased(LEASE_MS);
        let sent = line_of(&request).replace(&json!(at).to_string(), &json!(text).to_string());
        let id = request.request_id.as_ref().map(ToString::to_string);
        let ticket = line.ask_text(id, actor.device.id.as_str(), &sent)?;
        if may_refuse && is_refused(&mut line, ticket, &ErrorCode::Malformed)? {
            continue;
        }
        line.accepted(ticket)?;
        is_planned(trial, &mut line, &request)?;
        cancels(trial, &mut line)?;
    }
    pass()
}

/// Whether the robot refuses a request with `code`.
fn is_refused(line: &mut Line, ticket: Ticket, code: &ErrorCode) -> Result<bool, Unmet> {
    let answer = line.answer(ticket)?.message;
    Ok(answer.status == Status::Failed && answer.error.is_some_and(|error| error.code == *code))
}

fn old_timestamp(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let request = aged(trial, Span::from_millis(10_000))?;
    let ticket = line.held(&request)?;
    line.stays_held(ticket, 300, "the lease counts from the receipt, not from the timestamp")?;
    is_planned(trial, &mut line, &request)?;
    pass()
}

fn large_offsets(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    for age in [3_000_000_000, 10_000_000_000] {
        let request = aged(trial, Span::from_millis(age))?;
        let ticket = line.held(&request)?;
        line.stays_held(ticket, 50, "its start lies 20 s ahead")?;
        is_planned(trial, &mut line, &request)?;
        cancels(trial, &mut line)?;
    }
    pass()
}

fn large_lease(trial: &Trial) -> Checked {
    const DAY_MS: f64 = 86_400_000.0;
    let mut line = trial.connect()?;
    for millis in [65_536.0 + 50.0, 2_147_483_648.0 + 50.0, 4_294_967_296.0 + 50.0] {
        let ticket = line.ask(&trial.pending(trial.actor()?).leased(millis))?;
        if millis > DAY_MS && is_refused(&mut line, ticket, &ErrorCode::OutOfRange)? {
            continue;
        }
        line.accepted(ticket)?;
        line.stays_held(ticket, 150, &format!("its lease allows {millis} ms of silence"))?;
        cancels(trial, &mut line)?;
    }
    pass()
}

fn steps_at_once(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let steps = [(0.0, actor.rest), (100.0, actor.near), (100.0, actor.rest)];
    let mut line = trial.connect()?;
    line.held(&trial.script(actor, &steps).starting_in(LATER_MS).leased(LEASE_MS))?;
    pass()
}
