//! Formats a run for people: one line per event, in order of time.

use std::fmt::Write;

use urrcp::{Command, Message, Server, Timestamp};

use super::{Drawn, Happened, Ran};
use downbeat_rehearsal::dry_run::BEGIN;

/// Formats the full trace of a run: the drawn mission, the events, the values that the robots set, and the violations.
#[must_use]
pub fn trace(ran: &Ran) -> String {
    let mut text = what_was_drawn(&ran.drawn);
    for (at, line) in events(ran) {
        let _infallible = writeln!(text, "{:>12.3} ms  {line}", (at - BEGIN).as_millis_f64());
    }
    if let Some(report) = &ran.report {
        let _infallible = writeln!(
            text,
            "{}",
            downbeat_show::report_text(report, downbeat_show::Detail::Full, downbeat_show::UNBOUNDED)
        );
    }
    for violation in super::judge(ran).violations {
        let _infallible = writeln!(text, "VIOLATED {violation}");
    }
    text
}

fn what_was_drawn(drawn: &Drawn) -> String {
    let mut text = String::new();
    let _infallible = writeln!(
        text,
        "seed {}: {} robots, {} acts, {:?}, delay {} to {}, tail {:.3}",
        drawn.seed,
        drawn.robots.len(),
        drawn.choreography.acts.len(),
        drawn.network,
        drawn.delay.0,
        drawn.delay.1,
        drawn.tail
    );
    let disk = &drawn.disk;
    let _infallible = writeln!(
        text,
        "  disk: syncs within {}, {}{}",
        disk.sync,
        disk.capacity.map_or("has room".to_owned(), |bytes| format!("is full after {bytes} bytes")),
        if disk.loses_power { ", loses power with its machine" } else { "" }
    );
    for (index, robot) in drawn.robots.iter().enumerate() {
        let _infallible = writeln!(
            text,
            "  r{index}: {} devices, clock {:?} offset {} drift {:.1} ppm, answers after {}, reports {}{}",
            robot.block.devices.len(),
            robot.clock,
            robot.settings.clock_offset,
            robot.settings.drift_ppm,
            robot.slow,
            robot.block.reports,
            robot.lie.map(|lie| format!(", lies: {lie:?}")).unwrap_or_default()
        );
    }
    for act in &drawn.choreography.acts {
        let _infallible = writeln!(
            text,
            "  {}: {} robots, {}, on_failure {:?}, then {:?}, running lease {:?}",
            act.name,
            act.plan.robots.len(),
            act.plan.duration(),
            act.on_failure.default,
            act.on_failure.then,
            act.plan.stop_condition.running
        );
    }
    text
}

/// Returns one line for each event, record and set value, in order of time.
fn events(ran: &Ran) -> Vec<(Timestamp<Server>, String)> {
    let mut lines: Vec<(Timestamp<Server>, String)> = Vec::new();
    lines.extend(ran.history.iter().filter_map(|(at, happened)| Some((*at, line(happened)?))));
    lines.extend(ran.records.iter().map(|(at, record)| {
        let json = serde_json::to_string(record).unwrap_or_default();
        (*at, format!("record   {}", json.chars().take(700).collect::<String>()))
    }));
    for (robot, log) in ran.logs.iter().enumerate() {
        lines.extend(log.iter().map(|entry| {
            let id = entry.request_id.as_deref().unwrap_or("-");
            let line = format!(
                "r{robot} {:<8} {} = {} step {:?} of {id}",
                entry.motion, entry.device, entry.value, entry.step
            );
            (Timestamp::from_nanos(entry.true_ns), line)
        }));
    }
    lines.sort_by_key(|(at, _)| *at);
    lines
}

fn line(happened: &Happened) -> Option<String> {
    Some(match happened {
        Happened::ToRobot(robot, message) => format!("  -> r{robot}  {}", told(message)),
        Happened::AtRobot(robot, message) => format!("  => r{robot}  {}", told(message)),
        Happened::FromRobot(robot, message) => format!("  <= r{robot}  {}", told(message.as_ref()?)),
        Happened::Lost(robot) => format!("lost     a message to or from r{robot}"),
        Happened::Queued(..) => return None,
        Happened::StopQueued(robot, lasts) => format!("queued   a stop for r{robot} waits for {lasts}"),
        Happened::Slow(robot, lasts) => format!("slow     a message to or from r{robot} takes {lasts}"),
        Happened::Fault(fault) => format!("FAULT    {fault:?}"),
        Happened::Back(robot) => format!("back     r{robot}"),
        Happened::Seized(robot) => format!("seized   r{robot}"),
        Happened::LinkUp(robot) => format!("link up  r{robot}"),
        Happened::LinkDown(robot) => format!("link down r{robot}"),
        Happened::Forgotten(bytes) => format!("FORGOTTEN {bytes} bytes of the journal"),
        Happened::TakenUp(how) => format!("taken up {how}"),
        Happened::Told(progress) => {
            let json = serde_json::to_string(progress).unwrap_or_default();
            format!("told     {}", json.chars().take(700).collect::<String>())
        }
        Happened::Stuck(due) => format!("STUCK    {due}"),
    })
}

fn told(message: &Message) -> String {
    match message {
        Message::AvailabilityRequest(_) => "availability?".to_owned(),
        Message::AvailabilityResponse(response) => format!("available: {}", response.status),
        Message::InitializationRequest(_) => "who are you?".to_owned(),
        Message::InitializationBlock(block) => format!("I am {}", block.id),
        Message::ControlRequest(request) => {
            let what = match &request.command {
                Command::Script(script) if script.is_empty() => "cancel".to_owned(),
                Command::Script(script) => format!("script of {} steps", script.steps().len()),
                Command::Set(_) => "set".to_owned(),
                Command::ReadSensor | Command::Unknown(_) => "request".to_owned(),
            };
            format!(
                "{what} {} {:?}",
                request.device_id,
                request.request_id.as_ref().map(urrcp::RequestId::as_str)
            )
        }
        Message::ControlResponse(response) => format!(
            "{} {} {:?} {}",
            response.status,
            response.device_id,
            response.request_id.as_ref().map(urrcp::RequestId::as_str),
            response.error.as_ref().map(ToString::to_string).unwrap_or_default()
        ),
        Message::Inquiry(inquiry) => {
            let lease = inquiry.pending_lease.map(|lease| format!(", lease {}", lease.span()));
            let until = inquiry
                .pending_until
                .map(|until| format!(", until {}", until.assume_clock::<Server>() - BEGIN));
            let limits = lease.into_iter().chain(until).collect::<String>();
            format!("what became of {} requests?{limits}", inquiry.requests.len())
        }
        Message::InquiryResponse(response) => {
            let state = |report: &urrcp::RequestReport| format!("{} {:?}", report.request_id, report.state);
            format!(
                "{}: {}",
                response.status,
                response.requests.iter().map(state).collect::<Vec<_>>().join(", ")
            )
        }
        _ => "another message".to_owned(),
    }
}
