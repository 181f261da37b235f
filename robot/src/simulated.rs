//! A simulated robot: the real state machine with a simulated clock, a simulated link and simulated faults. Like the state machine, it
//! does no I/O and reads no clock.

use std::cell::Cell;
use std::collections::{BTreeMap, HashMap, VecDeque};

use urrcp::{
    Command, ControlError, ControlResponse, ControlType, DEVICES_MAX, DeviceId, Encoding, ErrorCode,
    InitializationBlock, Message, Robot as RobotClock, Span, Status, Timestamp,
};

use crate::device::MotionLimits;
use crate::hardware::ReadingId;
use crate::ids::LinkId;
use crate::robot::{Input, Output, Robot};
use crate::set_log::LogEntry;
use crate::tolerance::SILENCE_MAX;
#[cfg(all(test, feature = "host"))]
use crate::tolerance::Tolerance;

use body::MovedBody;

pub use crate::outgoing::Outgoing;
pub use body::Moves;

mod body;

/// Marker type for true time: the one clock of a simulated world. On a host, this is the host's clock.
#[derive(Clone, Copy, Debug)]
pub enum True {}

/// Properties in which a simulated robot deviates from a perfect one.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Offset of the robot's raw clock from true time.
    pub clock_offset: Span,
    /// Drift of the robot's raw clock relative to true time, in parts per million. Positive if the clock runs fast.
    pub drift_ppm: f64,
    /// Maximum random error of the times in the robot's responses to availability requests and inquiries.
    pub jitter: Span,
    /// Maximum error of the robot's clock after NTP has corrected its raw clock. `None`: the robot uses its raw clock without NTP.
    pub ntp_error: Option<Span>,
    /// Minimum and maximum delay of a message in either direction. `None`: no delay.
    pub delay: Option<(Span, Span)>,
    /// Fault of the robot, if any.
    pub fault: Option<Fault>,
    /// How the bodies (the simulated moving parts) of the robot follow its devices. A body that is not listed follows its device at once.
    pub moves: Vec<Moves>,
    /// Limits for movements to rest and to the default state, by device. A limit applies only if it is lower than the one that the device
    /// declares.
    pub limits: BTreeMap<DeviceId, MotionLimits>,
    /// Seed of the robot's random numbers.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            clock_offset: Span::ZERO,
            drift_ppm: 0.0,
            jitter: Span::ZERO,
            ntp_error: Some(Span::ZERO),
            delay: None,
            fault: None,
            moves: Vec::new(),
            limits: BTreeMap::new(),
            seed: 0,
        }
    }
}

/// A fault of a simulated robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The robot refuses every script with `busy`.
    Refuse,
    /// The robot neither executes nor answers control requests.
    Silent,
    /// The robot closes the link right after it has accepted a script, and is unreachable afterwards.
    Disconnect,
}

/// Simulated hardware that a robot's state machine drives.
#[derive(Clone, Debug, Default)]
struct SimulatedHardware {
    /// Time since which the hardware neither acts nor answers. `None`: the hardware works.
    dead_since: Option<Timestamp<True>>,
    readings: HashMap<DeviceId, f64>,
}

impl SimulatedHardware {
    fn silence(&self, now: Timestamp<True>) -> Option<Span> {
        let silence = now - self.dead_since?;
        (silence > SILENCE_MAX.into()).then_some(silence)
    }
}

#[derive(Clone, Debug)]
enum InFlight {
    In(LinkId, Input),
    Out(Outgoing),
}

type LaneId = (LinkId, Direction);

/// State of one direction of one link. Messages keep their order, as with TCP. The entry is removed once no message is in flight.
#[derive(Clone, Debug)]
struct Lane {
    last: Timestamp<True>,
    travelling: usize,
    /// Whether the link is being closed because too many messages were in flight. It accepts no further messages.
    closing: bool,
}

/// Maximum number of messages in flight in one direction of one link: enough for a request to each device of the largest robot, and the
/// reports on these requests.
const TRAVELLING_MAX: usize = 4 * DEVICES_MAX;
/// Maximum drift of a simulated clock in either direction, in parts per million. It exceeds the drift of any real clock, but is so low
/// that the clock still runs forward.
const DRIFT_PPM_MAX: f64 = 100_000.0;

/// A robot's state machine with a simulated clock, a delayed link and faults. All times in its methods are true times.
#[derive(Clone, Debug)]
pub struct SimulatedRobot {
    robot: Robot,
    settings: Settings,
    ntp_residue: Span,
    rng: fastrand::Rng,
    epoch: Option<Timestamp<True>>,
    /// Cache: an instant on the robot's clock, and the same instant on the true clock. Until it is reached, this instant is converted
    /// again and again.
    shown: Cell<Option<(Timestamp<RobotClock>, Timestamp<True>)>>,
    /// Cache: an instant on the true clock, and the same instant on the robot's clock.
    read: Cell<Option<(Timestamp<True>, Timestamp<RobotClock>)>>,
    /// Cache: time of the next wake-up. The outer `None`: not computed since the last change. The inner `None`: there is no wake-up.
    wakes: Cell<Option<Option<Timestamp<True>>>>,
    /// Messages in flight with their arrival times, ordered by arrival time, and then by sending time.
    in_flight: VecDeque<(Timestamp<True>, LaneId, InFlight)>,
    /// State of those directions of links that have messages in flight. Few have.
    lanes: Vec<(LaneId, Lane)>,
    log: Vec<LogEntry>,
    outputs: Vec<Output>,
    /// Whether the robot has closed its links permanently.
    gone: bool,
    /// The robot's hardware. `None`: the state machine simulates its devices without hardware.
    hands: Option<SimulatedHardware>,
    bodies: Vec<MovedBody>,
}

impl SimulatedRobot {
    /// Creates a robot at rest. Its description states that it understands all encodings of this crate and answers inquiries.
    #[must_use]
    pub fn new(block: InitializationBlock, settings: Settings) -> Self {
        let mut rng = fastrand::Rng::with_seed(settings.seed);
        let ntp_residue = draw_symmetric(&mut rng, settings.ntp_error.unwrap_or_default());
        let bodies = bodies(&block, &settings);
        let block = block.and_understands(Encoding::MessagePack).and_answers_inquiries();
        Self {
            robot: Robot::new(block).with_limits(&settings.limits),
            settings,
            ntp_residue,
            rng,
            epoch: None,
            shown: Cell::new(None),
            read: Cell::new(None),
            wakes: Cell::new(None),
            in_flight: VecDeque::new(),
            lanes: Vec::new(),
            log: Vec::new(),
            outputs: Vec::new(),
            gone: false,
            hands: None,
            bodies,
        }
    }

    /// Sets the maximum delays that the robot tolerates.
    #[cfg(all(test, feature = "host"))]
    pub(crate) fn tolerating(self, tolerance: Tolerance) -> Self {
        Self { robot: self.robot.tolerating(tolerance), ..self }
    }

    /// Creates a robot that drives simulated hardware, which is connected at `now`.
    #[must_use]
    pub fn with_hardware(block: InitializationBlock, settings: Settings, now: Timestamp<True>) -> Self {
        let mut robot = Self::new(block, settings);
        robot.robot = Robot::driven(robot.robot.block().clone()).with_limits(&robot.settings.limits);
        robot.hands = Some(SimulatedHardware::default());
        robot.hardware_found(now);
        robot
    }

    /// Makes the hardware stop answering. The connection to it stays open.
    pub fn hardware_dies(&mut self, now: Timestamp<True>) {
        if let Some(hands) = &mut self.hands {
            hands.dead_since.get_or_insert(now);
        }
    }

    /// Ends the connection to the hardware.
    pub fn hardware_lost(&mut self, now: Timestamp<True>, reason: &str) {
        self.hardware_dies(now);
        if self.hands.is_some() {
            self.robot.hardware_lost(self.robot_from_true(now), reason, &mut self.outputs);
            self.perform(now);
        }
    }

    /// Connects the hardware, or connects it again.
    pub fn hardware_found(&mut self, now: Timestamp<True>) {
        if let Some(hands) = &mut self.hands {
            hands.dead_since = None;
            self.robot.hardware_found(self.robot_from_true(now), &mut self.outputs);
            self.perform(now);
        }
    }

    /// Returns the robot's state machine.
    #[must_use]
    pub const fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Sets the position that a device has before the first command.
    pub fn place(&mut self, device: &DeviceId, position: f64) {
        self.robot.place(device, position);
        for body in self.bodies.iter_mut().filter(|body| body.moves.device == *device) {
            body.place(position);
        }
    }

    /// Sets the reading of a sensor.
    pub fn set_reading(&mut self, sensor: DeviceId, reading: f64) {
        if let Some(hands) = &mut self.hands {
            hands.readings.insert(sensor.clone(), reading);
        }
        self.robot.set_reading(sensor, reading);
    }

    /// Whether the robot holds no command, and no message is in flight.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.in_flight.is_empty() && self.robot.is_idle()
    }

    /// Returns the robot after a restart of its process at `now`. It has forgotten everything except the readings of its sensors; its
    /// clock has continued.
    #[must_use]
    pub fn restarted(&self, now: Timestamp<True>) -> Self {
        let settings = Settings {
            clock_offset: self.settings.clock_offset + self.drifted(now),
            ..self.settings.clone()
        };
        let mut robot = Self::new(self.robot.block().clone(), settings);
        robot.ntp_residue = self.ntp_residue;
        robot.rng = self.rng.clone();
        robot.bodies.clone_from(&self.bodies);
        for (sensor, reading) in self.robot.readings() {
            robot.robot.set_reading(sensor.clone(), reading);
        }
        robot
    }

    /// Replaces the robot's fault, and returns the previous one.
    pub const fn replace_fault(&mut self, fault: Option<Fault>) -> Option<Fault> {
        std::mem::replace(&mut self.settings.fault, fault)
    }

    /// Steps the robot's clock forward or back while it runs.
    pub fn step_clock(&mut self, by: Span) {
        self.settings.clock_offset += by;
        self.ntp_residue += by;
        self.forget_times();
    }

    /// Removes and returns the log entries that were added since the last call.
    pub fn take_log(&mut self) -> Vec<LogEntry> {
        std::mem::take(&mut self.log)
    }

    /// Makes the robot available to other sessions if the session that owns it is over.
    #[cfg(feature = "host")]
    pub(crate) fn look(&mut self, now: Timestamp<True>) {
        let at = self.robot_from_true(now);
        self.robot.release_if_over(at);
    }

    #[cfg(feature = "host")]
    pub(crate) const fn has_log(&self) -> bool {
        !self.log.is_empty()
    }

    /// Sends an input to the robot at `now`; it arrives after the link's delay.
    pub fn receive(&mut self, now: Timestamp<True>, link: LinkId, input: Input) {
        if self.gone {
            return self.dispatch(now, (link, Direction::Out), InFlight::Out(Outgoing::Close { link }));
        }
        self.dispatch(now, (link, Direction::In), InFlight::In(link, input));
    }

    /// Executes everything due at or before `now`: the state machine's own events, and the arrival of messages. At the same instant, the
    /// state machine's own events come first.
    pub fn advance(&mut self, now: Timestamp<True>, out: &mut Vec<Outgoing>) {
        if self.epoch.is_none() {
            self.epoch = Some(now);
            self.forget_times();
        }
        self.look_after_hardware(now);
        self.robot.send_reports(self.robot_from_true(now), &mut self.outputs);
        self.perform(now);
        loop {
            let mine = self.due_movement(now);
            let travelling = self.next_arrival().filter(|at| *at <= now);
            match (mine, travelling) {
                (Some(mine), travelling) if travelling.is_none_or(|at| mine <= at) => {
                    self.robot.advance(self.robot_from_true(now), &mut self.outputs);
                    self.perform(now);
                }
                (_, Some(_)) => self.deliver_first(now, out),
                (_, None) => return,
            }
        }
    }

    /// Executes the movements due at or before `now`, unless a message arrives earlier. The reports about these movements are sent by the
    /// next [`SimulatedRobot::advance`].
    #[cfg(feature = "host")]
    pub(crate) fn advance_movements(&mut self, now: Timestamp<True>) {
        let travelling = self.next_arrival();
        let mine = self.due_movement(now);
        if mine.is_some_and(|mine| travelling.is_none_or(|at| mine <= at)) {
            self.robot.advance_movements(self.robot_from_true(now), &mut self.outputs);
            self.perform(now);
        }
    }

    /// Whether the state machine has work due at or before `by`. The arrival of messages does not count.
    #[cfg(feature = "host")]
    pub(crate) fn moves_by(&self, by: Timestamp<True>) -> bool {
        self.due_movement(by).is_some()
    }

    /// Checks the hardware before any other work, as a robot with real hardware does. If the hardware answers, this only executes due
    /// events.
    fn look_after_hardware(&mut self, now: Timestamp<True>) {
        if let Some(hands) = &self.hands {
            let at = self.robot_from_true(now);
            self.robot.check_hardware(at, || hands.silence(now), &mut self.outputs);
            self.perform(now);
        }
    }

    /// Whether [`SimulatedRobot::advance`] has work at `now`. True while hardware is silent, so that the hardware is checked at every
    /// opportunity.
    #[must_use]
    pub fn is_due(&self, now: Timestamp<True>) -> bool {
        let silent = self.hands.as_ref().is_some_and(|hands| hands.dead_since.is_some());
        let due = || self.next_wakeup().is_some_and(|at| at <= now);
        silent || self.epoch.is_none() || self.robot.has_reports() || due()
    }

    /// Returns the due time of the state machine's next wake-up, if that time has been reached at `now`.
    fn due_movement(&self, now: Timestamp<True>) -> Option<Timestamp<True>> {
        let due = self.robot.next_wakeup().filter(|at| *at <= self.robot_from_true(now))?;
        Some(self.true_from_robot(due))
    }

    /// Returns when [`SimulatedRobot::advance`] is next due.
    #[must_use]
    pub fn next_wakeup(&self) -> Option<Timestamp<True>> {
        if let Some(wakes) = self.wakes.get() {
            return wakes;
        }
        let mine = self.robot.next_wakeup().map(|at| self.true_from_robot(at));
        let wakes = mine.into_iter().chain(self.next_arrival()).min();
        self.wakes.set(Some(wakes));
        wakes
    }

    fn next_arrival(&self) -> Option<Timestamp<True>> {
        self.in_flight.front().map(|(at, ..)| *at)
    }

    fn deliver_first(&mut self, now: Timestamp<True>, out: &mut Vec<Outgoing>) {
        let Some((_, lane, in_flight)) = self.in_flight.pop_front() else { return };
        self.wakes.set(None);
        self.leave(lane);
        match in_flight {
            InFlight::Out(outgoing) => out.push(outgoing),
            InFlight::In(link, input) => {
                self.look_at_body(now, &input);
                if let Some(input) = self.through_fault(now, link, input) {
                    self.robot.handle(self.robot_from_true(now), link, input, &mut self.outputs);
                    self.perform(now);
                }
            }
        }
    }

    /// If the input requests the reading of a sensor that measures a body, updates this reading.
    fn look_at_body(&mut self, now: Timestamp<True>, input: &Input) {
        let (Input::Message(Message::ControlRequest(request)) | Input::Hashed(request, _)) = input else {
            return;
        };
        if request.command != Command::ReadSensor {
            return;
        }
        let at = self.robot_from_true(now);
        let body = self.bodies.iter_mut().find(|body| body.moves.sensor == request.device_id);
        let Some(body) = body else { return };
        let told = self.robot.value(body.moves.device.as_str(), ControlType::Position, at);
        let reading = body.shown(now, told.unwrap_or_default());
        let sensor = body.moves.sensor.clone();
        self.set_reading(sensor, reading);
    }

    /// Returns the delay of the sensor whose reading the message contains. `None` if the message contains no reading, or if the sensor
    /// has no delay.
    fn sensor_delay(&self, message: &Message) -> Option<Span> {
        let Message::ControlResponse(response) = message else { return None };
        let of = |body: &&MovedBody| body.moves.sensor == response.device_id && body.moves.delay > Span::ZERO;
        let body = self.bodies.iter().find(of).filter(|_| response.status == Status::Provide)?;
        Some(body.moves.delay)
    }

    /// Applies the robot's fault to an input. Returns the input unless the fault suppresses it.
    fn through_fault(&mut self, now: Timestamp<True>, link: LinkId, input: Input) -> Option<Input> {
        let (Input::Message(Message::ControlRequest(request)) | Input::Hashed(request, _)) = &input else {
            return Some(input);
        };
        match self.settings.fault {
            Some(Fault::Silent) => None,
            Some(Fault::Refuse) if is_movement(&request.command) => {
                let at = self.robot_from_true(now);
                let error = ControlError::new(ErrorCode::Busy, "simulated refusal");
                let refusal = ControlResponse::refusal(at, request, error);
                self.send(now, link, Message::ControlResponse(refusal));
                None
            }
            _ => Some(input),
        }
    }

    /// Executes the outputs of the state machine. Clears the cached time of its next wake-up, which may have changed.
    fn perform(&mut self, now: Timestamp<True>) {
        self.wakes.set(None);
        if self.outputs.is_empty() {
            return;
        }
        let mut outputs = std::mem::take(&mut self.outputs);
        for output in outputs.drain(..) {
            match output {
                // The simulated hardware takes all values at once, so no confirmation is needed.
                Output::Confirm { .. } => {}
                // Not used: the machine of a simulated robot times all scripts by itself.
                Output::Plan(_) | Output::Cancel(_) | Output::Played { .. } => {}
                Output::Read { reading, sensor } => self.hardware_reads(now, reading, &sensor),
                Output::Set(set) => {
                    let mut bodies = self.bodies.iter_mut();
                    if let Some(body) = bodies.find(|body| body.moves.device == set.device) {
                        body.told(now, &set);
                    }
                    let at = self.robot_from_true(now);
                    self.log.push(LogEntry::new(now.assume_clock(), at, set));
                }
                Output::Send { link, message } => {
                    let hangs_up = self.settings.fault == Some(Fault::Disconnect) && is_acceptance(&message);
                    self.send(now, link, message);
                    if hangs_up {
                        self.gone = true;
                        self.dispatch(now, (link, Direction::Out), InFlight::Out(Outgoing::Close { link }));
                    }
                }
            }
        }
        // Keeps the emptied vector to reuse its allocation.
        self.outputs = outputs;
    }

    /// Answers the state machine's request for a sensor reading at once, if the hardware works. A robot without hardware answers readings
    /// by itself.
    fn hardware_reads(&mut self, now: Timestamp<True>, reading: ReadingId, sensor: &DeviceId) {
        let Some(hands) = self.hands.as_ref().filter(|hands| hands.dead_since.is_none()) else { return };
        let value = hands.readings.get(sensor).copied().unwrap_or(0.0);
        let mut answers = Vec::new();
        self.robot.reading_came(self.robot_from_true(now), reading, Ok(value), &mut answers);
        for answer in answers {
            if let Output::Send { link, message } = answer {
                self.send(now, link, message);
            }
        }
    }

    fn send(&mut self, now: Timestamp<True>, link: LinkId, mut message: Message) {
        let told = match &mut message {
            Message::AvailabilityResponse(r) => Some((&mut r.receive_timestamp, &mut r.timestamp)),
            Message::InquiryResponse(r) => Some((&mut r.receive_timestamp, &mut r.timestamp)),
            _ => None,
        };
        if let Some((received, sent)) = told {
            let error = draw_symmetric(&mut self.rng, self.settings.jitter);
            *received = *received + error;
            *sent = *sent + error;
        }
        let Some(delay) = self.sensor_delay(&message) else {
            return self.dispatch(
                now,
                (link, Direction::Out),
                InFlight::Out(Outgoing::Message { link, message }),
            );
        };
        if let Message::ControlResponse(response) = &mut message {
            response.timestamp = response.timestamp + delay;
        }
        // Responses without a reading do not wait for the sensor.
        self.dispatch(
            now + delay,
            (link, Direction::OutOfSensor),
            InFlight::Out(Outgoing::Message { link, message }),
        );
    }

    /// Sends a message so that it arrives after the messages that are already in flight in this direction.
    fn dispatch(&mut self, now: Timestamp<True>, lane_id: LaneId, mut in_flight: InFlight) {
        let arrival = now + self.draw_delay();
        let place = self.lanes.iter().position(|(id, _)| *id == lane_id).unwrap_or_else(|| {
            self.lanes.push((lane_id, Lane { last: arrival, travelling: 0, closing: false }));
            self.lanes.len() - 1
        });
        let lane = &mut self.lanes[place].1;
        if lane.closing {
            return;
        }
        if lane.travelling >= TRAVELLING_MAX {
            lane.closing = true;
            in_flight = InFlight::Out(Outgoing::Close { link: lane_id.0 });
        }
        lane.last = lane.last.max(arrival);
        lane.travelling += 1;
        let arrival = lane.last;
        let behind = self.in_flight.iter().rev().take_while(|(at, ..)| *at > arrival).count();
        self.in_flight.insert(self.in_flight.len() - behind, (arrival, lane_id, in_flight));
        self.wakes.set(None);
    }

    fn leave(&mut self, lane_id: LaneId) {
        let Some(place) = self.lanes.iter().position(|(id, _)| *id == lane_id) else { return };
        let lane = &mut self.lanes[place].1;
        lane.travelling -= 1;
        if lane.travelling == 0 {
            self.lanes.swap_remove(place);
        }
    }

    fn draw_delay(&mut self) -> Span {
        let Some((least, largest)) = self.settings.delay else { return Span::ZERO };
        let width = (largest - least).as_nanos().max(0);
        (least + Span::from_nanos(self.rng.i64(0..=width))).max(Span::ZERO)
    }

    /// Returns the time on the robot's clock: its raw clock, minus the error that NTP has estimated.
    #[must_use]
    pub fn robot_from_true(&self, now: Timestamp<True>) -> Timestamp<RobotClock> {
        match self.read.get() {
            Some((when, shown)) if when == now => shown,
            _ => {
                let shown = self.compute_robot_from_true(now);
                self.read.set(Some((now, shown)));
                shown
            }
        }
    }

    /// Clears the cached times, because the robot's clock has changed.
    fn forget_times(&self) {
        self.shown.set(None);
        self.read.set(None);
        self.wakes.set(None);
    }

    fn compute_robot_from_true(&self, now: Timestamp<True>) -> Timestamp<RobotClock> {
        let error = match self.settings.ntp_error {
            Some(_) => self.ntp_residue,
            None => self.settings.clock_offset + self.drifted(now),
        };
        now.assume_clock() + error
    }

    fn drifted(&self, now: Timestamp<True>) -> Span {
        let since = self.epoch.map_or(Span::ZERO, |epoch| now - epoch);
        Span::from_millis_f64(since.as_millis_f64() * self.drift())
    }

    /// Returns the drift of the robot's clock as a fraction of true time.
    fn drift(&self) -> f64 {
        self.settings.drift_ppm.clamp(-DRIFT_PPM_MAX, DRIFT_PPM_MAX) * 1e-6
    }

    /// Returns the first true time at which the robot's clock shows `at`.
    fn true_from_robot(&self, at: Timestamp<RobotClock>) -> Timestamp<True> {
        match self.shown.get() {
            Some((shown, when)) if shown == at => when,
            _ => {
                let when = self.search_true_from_robot(at);
                self.shown.set(Some((at, when)));
                when
            }
        }
    }

    fn search_true_from_robot(&self, at: Timestamp<RobotClock>) -> Timestamp<True> {
        let mut guess: Timestamp<True> = at.assume_clock();
        if self.settings.ntp_error.is_some() {
            return guess - self.ntp_residue;
        }
        guess = guess - self.settings.clock_offset;
        let since = self.epoch.map_or(Span::ZERO, |epoch| guess - epoch);
        guess = guess - Span::from_millis_f64(since.as_millis_f64() * self.drift() / (1.0 + self.drift()));
        // Corrects the rounding to nanoseconds. The number of attempts is bounded, since at the end of time no instant may match.
        for _ in 0..8 {
            match self.compute_robot_from_true(guess) {
                shown if shown < at => guess = guess + Span::from_nanos(1),
                _ if self.compute_robot_from_true(guess - Span::from_nanos(1)) >= at => {
                    guess = guess - Span::from_nanos(1);
                }
                _ => break,
            }
        }
        guess
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Direction {
    In,
    Out,
    OutOfSensor,
}

fn bodies(block: &InitializationBlock, settings: &Settings) -> Vec<MovedBody> {
    let body = |(index, moves): (usize, &Moves)| {
        let sensor = block.device(moves.sensor.as_str()).and_then(|d| d.available_control_types.sensor());
        let range = sensor.map_or((f64::MIN, f64::MAX), |sensor| (sensor.min_value, sensor.max_value));
        // A separate random generator, so that a body does not change the robot's other random numbers.
        let seed = settings.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(index as u64 + 1);
        let device = block.device(moves.device.as_str());
        let at_first = device.and_then(|device| device.default_value).unwrap_or_default();
        MovedBody::new(moves.clone(), range, at_first, fastrand::Rng::with_seed(seed))
    };
    settings.moves.iter().enumerate().map(body).collect()
}

fn draw_symmetric(rng: &mut fastrand::Rng, largest: Span) -> Span {
    let largest = largest.abs().as_nanos();
    Span::from_nanos(rng.i64(-largest..=largest))
}

fn is_movement(command: &Command) -> bool {
    match command {
        Command::Script(script) => !script.is_empty(),
        Command::Set(_) => true,
        Command::ReadSensor | Command::Unknown(_) => false,
    }
}

fn is_acceptance(message: &Message) -> bool {
    matches!(message, Message::ControlResponse(response) if response.status == Status::Accepted)
}

#[cfg(test)]
mod body_tests;
#[cfg(test)]
mod tests;
