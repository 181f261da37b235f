//! The environment of the checks: the robot's address and initialization block, clocks, connections and requests.

use std::cell::Cell;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use downbeat_yaml::refusal::{Attempt, Refusal};
use urrcp::{
    Command, ControlRequest, ControlResponse, DeviceId, ErrorCode, InitializationBlock, Millis, RequestId,
    Script, Server, Setpoint, Span, Status, Step, StopCondition, Timestamp,
};

use super::Options;
use super::actor::Actor;
use super::line::Line;
use super::requirement::{Unmet, not_applicable};
use super::stream::Stream;
use downbeat_runtime::link::{Security, denial};
use downbeat_runtime::server_clock::ServerClock;

/// Time in milliseconds until a start that is never reached, because the check ends earlier.
pub(super) const LATER_MS: f64 = 20_000.0;
/// Lease in milliseconds of held commands (accepted, not yet ended). It is short, so that commands that a check cannot cancel end soon.
pub(super) const LEASE_MS: f64 = 1_500.0;
/// Interval between checks for an interruption by the operator.
const SLICE: Duration = Duration::from_millis(50);

/// A request that the robot must refuse.
pub(super) struct Refusable {
    pub(super) request: ControlRequest,
    /// The error code of the refusal.
    pub(super) code: ErrorCode,
}

/// The environment of the checks.
#[derive(Debug)]
pub(super) struct Trial {
    address: SocketAddr,
    options: Options,
    clock: ServerClock,
    interrupted: Arc<AtomicBool>,
    /// Time by which the timestamps of requests are ahead of the server's clock.
    pub(super) shift: Span,
    /// Whether the robot requires a greeting (a request for availability and one for initialization) on every connection.
    pub(super) greets: bool,
    /// The robot's initialization block; `None` until the robot has sent it.
    pub(super) block: Option<InitializationBlock>,
    actor: Option<Actor>,
    /// Another device that can be moved, to check that the commands of two devices are independent.
    second: Option<Actor>,
    /// Part of the request ids that distinguishes this run from earlier ones.
    run: u64,
    next_id: Cell<u64>,
    left_held: Cell<bool>,
    /// The longest observed round trip.
    round_trip: Cell<Span>,
}

impl Trial {
    pub(super) fn new(
        address: SocketAddr,
        options: Options,
        clock: ServerClock,
        interrupted: Arc<AtomicBool>,
    ) -> Self {
        Self {
            address,
            options,
            clock,
            interrupted,
            shift: Span::ZERO,
            greets: false,
            block: None,
            actor: None,
            second: None,
            run: fastrand::u64(..),
            next_id: Cell::new(0),
            left_held: Cell::new(false),
            round_trip: Cell::new(Span::ZERO),
        }
    }

    pub(super) fn learn(&mut self, block: Option<InitializationBlock>) {
        let Options { device, custom, .. } = &self.options;
        self.actor = block.as_ref().and_then(|block| Actor::choose(block, device.as_deref(), *custom));
        self.second = block.as_ref().zip(self.actor.as_ref()).and_then(|(block, first)| first.other(block));
        self.block = block;
    }

    pub(super) const fn address(&self) -> SocketAddr {
        self.address
    }

    pub(super) const fn options(&self) -> &Options {
        &self.options
    }

    /// The current time by the server's monotonic clock.
    pub(super) fn now(&self) -> Timestamp<Server> {
        self.clock.now()
    }

    /// The current time as stated in the timestamps of requests.
    pub(super) fn stamp(&self) -> Timestamp<Server> {
        self.now() + self.shift
    }

    /// Returns the deadline for the response to a message that is sent now.
    pub(super) fn patience(&self) -> Timestamp<Server> {
        self.now() + self.options.patience
    }

    pub(super) fn soon(&self, millis: i64) -> Timestamp<Server> {
        self.now() + Span::from_millis(millis)
    }

    pub(super) fn go_on(&self) -> Result<(), Unmet> {
        if self.interrupted.load(Ordering::Relaxed) { Err(Unmet::Interrupted) } else { Ok(()) }
    }

    #[expect(clippy::disallowed_methods, reason = "a test client waits in real time")]
    pub(super) fn pause(&self, span: Span) -> Result<(), Unmet> {
        let until = self.now() + span;
        loop {
            self.go_on()?;
            let left = until - self.now();
            if left <= Span::ZERO {
                return Ok(());
            }
            std::thread::sleep(left.to_duration().min(SLICE));
        }
    }

    /// Opens a connection. If the robot requires a greeting on every connection, sends one. Otherwise, every check would fail, and not
    /// only the check of the greeting.
    pub(super) fn connect(&self) -> Result<Line<'_>, Unmet> {
        let mut line = self.connect_silently()?;
        if self.greets {
            line.availability()?;
            line.initialization()?;
        }
        Ok(line)
    }

    /// Opens a connection without sending any message.
    pub(super) fn connect_silently(&self) -> Result<Line<'_>, Unmet> {
        self.connect_as(&self.options.security)
    }

    /// Like [`Trial::connect_silently`], but proves the identity given by `security`.
    pub(super) fn connect_as(&self, security: &Security) -> Result<Line<'_>, Unmet> {
        let connected = Stream::connect(self.address, security, self.options.patience.to_duration());
        connected.map(|stream| Line::over(self, stream)).map_err(|error| {
            let refusal = match denial(&error) {
                Some(denial) => denial,
                None => Refusal::of(Attempt::Connect, &error).to_string(),
            };
            Unmet::Failed(format!(
                "no connection to {} within {}: {refusal}",
                self.address, self.options.patience
            ))
        })
    }

    /// Whether the robot accepts a connection and responds on it. Retries until the response timeout, because the robot may be
    /// restarting.
    pub(super) fn is_alive(&self) -> bool {
        let until = self.patience();
        loop {
            if self.connect_silently().and_then(|mut line| line.availability().map(drop)).is_ok() {
                return true;
            }
            if self.now() >= until || self.pause(Span::from_millis(100)).is_err() {
                return false;
            }
        }
    }

    /// Opens an additional connection. Returns [`Unmet::NotApplicable`] if the robot serves only one.
    pub(super) fn connect_second(&self) -> Result<Line<'_>, Unmet> {
        let second = self.connect().and_then(|mut line| line.availability().map(|_| line));
        second.map_err(|unmet| match unmet {
            Unmet::Failed(why) => not_applicable(format!(
                "the robot does not serve a second connection (see `two-links`): {why}"
            )),
            other => other,
        })
    }

    pub(super) fn block(&self) -> Result<&InitializationBlock, Unmet> {
        self.block.as_ref().ok_or_else(|| {
            not_applicable("without a readable initialization block, nothing is known about the robot (see `initialization`)")
        })
    }

    /// Returns the device to move.
    pub(super) fn actor(&self) -> Result<&Actor, Unmet> {
        self.block()?;
        self.actor.as_ref().ok_or_else(|| match &self.options.device {
            Some(id) => not_applicable(format!("`{id}` has no position, speed or acceleration with a settable value")),
            None => not_applicable(
                "no device supports position, speed or acceleration; only the manufacturer knows which values of custom control types are safe: state one by `--custom VALUE`",
            ),
        })
    }

    /// Whether a device of the robot accepts scripts. If none does, the smaller limits of the profile Core apply.
    pub(super) fn accepts_scripts(&self) -> bool {
        let mut devices = self.block.iter().flat_map(|block| block.devices.iter());
        devices.any(|device| device.available_control_types.script().is_some())
    }

    /// Returns [`Unmet::NotApplicable`] if the robot may ignore the content_hash of requests.
    pub(super) fn checking_hashes(&self) -> Result<(), Unmet> {
        if self.accepts_scripts() {
            return Ok(());
        }
        Err(not_applicable("a robot without scripts may ignore content_hash"))
    }

    /// Whether the robot has a device that the checks can move.
    pub(super) const fn moves(&self) -> bool {
        self.actor.is_some()
    }

    /// Returns a second device to move.
    pub(super) fn second(&self) -> Result<&Actor, Unmet> {
        self.actor()?;
        self.second.as_ref().ok_or_else(|| not_applicable("the robot has no second device that can be moved"))
    }

    /// Creates a request that the robot must refuse, with the error code.
    pub(super) fn refusable(&self, actor: &Actor) -> Refusable {
        match actor.beyond() {
            Ok([_, above]) => Refusable {
                request: self.set(actor, above).starting_in(LATER_MS).leased(LEASE_MS),
                code: ErrorCode::OutOfRange,
            },
            Err(_) => {
                let timestamp = Some(self.stamp() - Span::from_millis(5_000));
                let late = ControlRequest { timestamp, ..self.set(actor, actor.rest) };
                Refusable { request: late.starting_in(1_000.0).leased(LEASE_MS), code: ErrorCode::Late }
            }
        }
    }

    /// Returns the device to move, if it accepts scripts.
    pub(super) fn scripted(&self) -> Result<&Actor, Unmet> {
        let actor = self.actor()?;
        if actor.in_script {
            Ok(actor)
        } else {
            Err(not_applicable(format!("`{}` does not support scripts", actor.device.id)))
        }
    }

    /// Returns [`Unmet::NotApplicable`] if the robot does not report on accepted commands.
    pub(super) fn reporting(&self) -> Result<(), Unmet> {
        if self.block()?.reports {
            Ok(())
        } else {
            Err(not_applicable("the robot does not declare `reports`, so its actions are not visible"))
        }
    }

    pub(super) fn reports(&self) -> bool {
        self.block.as_ref().is_some_and(|block| block.reports)
    }

    pub(super) fn fresh_id(&self) -> String {
        self.next_id.set(self.next_id.get() + 1);
        format!("conformance/{:x}/{}", self.run, self.next_id.get())
    }

    /// Creates a request to `device` that has the current time as its timestamp and starts on receipt.
    pub(super) fn request(&self, device: &DeviceId, command: Command) -> ControlRequest {
        ControlRequest {
            timestamp: Some(self.stamp()),
            request_id: RequestId::new(self.fresh_id()).ok(),
            ..ControlRequest::immediate(device.clone(), command)
        }
    }

    pub(super) fn set(&self, actor: &Actor, value: f64) -> ControlRequest {
        self.request(&actor.device.id, Command::Set(Setpoint::new(actor.control_type, value)))
    }

    /// Creates a request with a script. Each step is given as its offset in milliseconds and its value.
    pub(super) fn script(&self, actor: &Actor, steps: &[(f64, f64)]) -> ControlRequest {
        let step = |(millis, value): &(f64, f64)| Step {
            offset: millis_of(*millis),
            setpoint: Setpoint::new(actor.control_type, *value),
            stop_condition: None,
        };
        let script = Script::new(steps.iter().map(step).collect()).unwrap_or_default();
        self.request(&actor.device.id, Command::Script(script))
    }

    /// Creates a request with a script that moves the device slightly and back within `millis` milliseconds.
    pub(super) fn there_and_back(&self, actor: &Actor, millis: f64) -> ControlRequest {
        self.script(actor, &[(0.0, actor.rest), (millis / 2.0, actor.near), (millis, actor.rest)])
    }

    /// Creates a command that the robot holds until the end of the check: a script if the device accepts scripts, otherwise a value.
    pub(super) fn pending(&self, actor: &Actor) -> ControlRequest {
        let request =
            if actor.in_script { self.there_and_back(actor, 500.0) } else { self.set(actor, actor.rest) };
        request.starting_in(LATER_MS).leased(LEASE_MS)
    }

    /// Creates a request with the empty script, which cancels the device's commands.
    pub(super) fn cancel(&self, actor: &Actor) -> ControlRequest {
        let cancel = self.request(&actor.device.id, Command::Script(Script::cancel()));
        ControlRequest { timestamp: None, ..cancel }
    }

    pub(super) fn saw_round_trip(&self, span: Span) {
        self.round_trip.set(self.round_trip.get().max(span));
    }

    /// Returns the maximum time until the client learns of an event on the robot: the longest observed round trip plus the tolerance.
    pub(super) fn slack(&self) -> Span {
        self.round_trip.get() + self.options.tolerance
    }

    /// Records that the robot may still hold a command of a connection that was closed.
    pub(super) fn leaves_held(&self) {
        self.left_held.set(true);
    }

    /// Whether `answer`, the response to an empty script, confirms that the device is at rest. `OK` confirms it. On a device without
    /// scripts, the error that it lacks the control type also does, because the device then goes to its default state.
    pub(super) fn confirms_rest(&self, answer: &ControlResponse) -> bool {
        let scripts =
            self.actor.as_ref().is_some_and(|actor| actor.device.available_control_types.script().is_some());
        let lacking =
            answer.error.as_ref().is_some_and(|error| error.code == ErrorCode::UnsupportedControlType);
        answer.status == Status::Ok || !scripts && lacking
    }

    /// Brings the robot to rest, so that every check starts from the same state. Returns whether the robot confirmed that it is at rest.
    pub(super) fn settle(&self) -> bool {
        let Some(actor) = &self.actor else { return true };
        let until = self.patience();
        let confirmed = loop {
            let answer = self.connect().and_then(|mut line| {
                let ticket = line.ask(&self.cancel(actor))?;
                line.answer(ticket)
            });
            match answer {
                Ok(answer) if self.confirms_rest(&answer.message) => break true,
                // A session whose connection has just closed may still own the robot for a moment.
                Ok(answer)
                    if answer.message.error.as_ref().is_some_and(|error| error.code == ErrorCode::Busy) => {}
                _ => break false,
            }
            if self.now() >= until || self.pause(Span::from_millis(50)).is_err() {
                break false;
            }
        };
        if let Some(second) = &self.second {
            // A check that failed may have left a command there.
            let _answer = self.connect().and_then(|mut line| {
                let ticket = line.ask(&self.cancel(second))?;
                line.answer(ticket).map(drop)
            });
        }
        if self.left_held.replace(false) {
            let _had_enough = self.pause(Span::from_millis_f64(LEASE_MS));
        }
        confirmed
    }

    /// Brings the robot to rest at the end of the examination, even if the operator has interrupted it. Returns whether the robot
    /// confirmed that it is at rest.
    pub(super) fn settle_at_the_end(&self) -> bool {
        self.interrupted.store(false, Ordering::Relaxed);
        self.settle()
    }
}

pub(super) fn millis_of(millis: f64) -> Millis {
    Millis::from_span(Span::from_millis_f64(millis))
}

/// Sets the start and the lease of a request.
pub(super) trait Shaped {
    /// Sets the start to `millis` milliseconds after the request's timestamp.
    fn starting_in(self, millis: f64) -> Self;
    /// Sets a lease that ends the command after `millis` milliseconds of silence.
    fn leased(self, millis: f64) -> Self;
}

impl Shaped for ControlRequest {
    fn starting_in(self, millis: f64) -> Self {
        Self { time_offset_to_start: Some(millis_of(millis)), ..self }
    }

    fn leased(self, millis: f64) -> Self {
        Self { stop_condition: Some(StopCondition::both(millis_of(millis))), ..self }
    }
}
