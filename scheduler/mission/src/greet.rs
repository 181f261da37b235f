//! Greets all robots at once, in steps 1 to 4 of the protocol: links, availability and clocks, initialization blocks. Then reads the
//! sensors that the fleet file requires, and asks for the positions of devices.

use std::collections::BTreeMap;

use urrcp::{
    AvailabilityResponse, Command, ControlRequest, ControlResponse, DeviceId, InitializationBlock, Message,
    RequestId, Server, Span, Status, StatusValue, Timestamp,
};

use super::exchanges::Times;
use super::failure_kind::{FailureKind, Slow};
use super::latency::LatencyDiffers;
use super::lead::{self, ROUND_TRIP_LONGEST};
use super::poses::FirstUses;
use super::preflight;
use super::record::Record;
use super::robot_state::{Link, Reading, RobotState, Standing};
use super::skew::SkewBudget;
use super::{
    ClockMode, Greeting, Join, Mission, MissionSettings, Outcome, Phase, Progress, RobotIndex,
    error_of_status,
};
use downbeat_yaml::render::counted;

/// Number of timestamp exchanges with each robot before any decision.
const CLOCK_SAMPLES: u32 = 8;
/// How long, at most, clocks are sampled further while the possible start spread of the fleet exceeds the tolerance, or a link seems too
/// slow.
const SAMPLING: Span = Span::from_millis(4_000);
/// The age of a clock measurement after which the clock is checked again.
const STALE: Span = Span::from_millis(500);
/// Interval between checks whether a robot may be asked again. Questions to a robot are sent one at a time: several would delay each
/// other on a link that keeps the order of messages.
const SAMPLING_INTERVAL: Span = Span::from_millis(20);

/// The state of the checks before the first act.
#[derive(Debug)]
pub(super) struct FirstChecks {
    /// The index of each robot of the first act, in the order of the act's plan; `None` for a robot without a participant.
    pub(super) first_robots: Vec<Option<RobotIndex>>,
    /// For each robot: the first script of each device, starting with the mission's first act, and the device's largest speed in the act
    /// of that script.
    pub(super) first_uses: FirstUses,
    /// The time at which additional clock sampling ends, and the time of the next sample.
    pub(super) sampling: Option<(Timestamp<Server>, Timestamp<Server>)>,
    pub(super) preflight: Option<preflight::Preflight>,
}

/// A robot's answers during the greeting.
#[derive(Debug)]
pub(crate) struct Greeted {
    /// Whether the robot itself has sent its initialization block (its description) in this mission.
    pub(crate) introduced: bool,
    /// The latencies that the robot declares, if they differ from the compensated ones.
    pub(crate) latency_differs: Option<LatencyDiffers>,
    /// The readings that `settings.require` requires, in the order of these requirements.
    pub(crate) readings: Vec<Option<f64>>,
    /// Readings of the robot's other sensors, which are only displayed.
    pub(crate) shown: Vec<(DeviceId, Option<f64>)>,
    /// The reason why a device gave no reading, in the robot's words.
    pub(crate) unread: BTreeMap<DeviceId, String>,
}

impl Greeted {
    pub(super) fn new(settings: &MissionSettings) -> Self {
        let readings = vec![None; settings.require.len()];
        Self {
            introduced: false,
            latency_differs: None,
            readings,
            shown: Vec::new(),
            unread: BTreeMap::new(),
        }
    }
}

/// Whether a robot's round trip is longer than the longest accepted one.
fn is_too_slow(robot: &RobotState) -> bool {
    robot.standing == Standing::In && !robot.is_of_another() && robot.round_trip() > ROUND_TRIP_LONGEST
}

impl Mission {
    pub(super) fn greet(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        self.ask_availability(now, robot);
        for index in 0..self.robots[robot].settings.require.len() {
            let sensor = self.robots[robot].settings.require[index].sensor.clone();
            self.read(now, robot, sensor, Reading::Requirement(index));
        }
        if matches!(self.phase, Phase::Greeting { .. }) {
            // An earlier link may have lost the answers.
            self.robots[robot].forget_positions();
            self.read_positions(now, robot);
            self.ask_positions(now, robot);
        }
    }

    pub(super) fn availability(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        response: &AvailabilityResponse,
    ) {
        if response.status == Status::Failed {
            let error = error_of_status(response.error.as_ref());
            if self.is_to_be_seized(robot, &error) {
                return self.greeting_progress(now);
            }
            // A robot that arrives later may still be starting up. The next round asks it again.
            if self.robots[robot].standing == Standing::Absent {
                return;
            }
            return self.fail(now, robot, FailureKind::NotAvailable { error });
        }
        let times = Times {
            originate: response.originate_timestamp,
            received: response.receive_timestamp,
            answered: response.timestamp,
            arrived: self.outbox.arrived,
        };
        let Some(sample) = self.robots[robot].contact.exchanges.answered(times) else { return };
        self.is_ours(now, robot);
        self.take_times(now, robot, sample);
        self.question_reached(now, robot, response.receive_timestamp);
        match self.phase {
            Phase::Greeting { .. } if self.robots[robot].clock.samples() < CLOCK_SAMPLES => {
                self.ask_further(now, robot);
            }
            Phase::Greeting { .. } => self.greeting_progress(now),
            _ if self.robots[robot].standing == Standing::Absent => self.join_if_greeted(now, robot),
            Phase::Performing => {
                self.measure_further(now, robot);
                self.perform(now);
            }
            Phase::Stopping { .. } => self.stop_progress(now),
            Phase::Ended => {}
        }
    }

    /// Compares a robot's own description with the plan when the description arrives for the first time.
    pub(super) fn introduced(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        block: InitializationBlock,
    ) {
        if std::mem::replace(&mut self.robots[robot].greeted.introduced, true) {
            return;
        }
        if block.api_version.as_str().split('.').next() != Some("1") {
            let version = block.api_version.to_string();
            self.fail(now, robot, FailureKind::WrongVersion { version });
        }
        let unfit = self.unfit(robot, &block);
        let state = &self.robots[robot];
        let differs = LatencyDiffers::of(&self.choreography, &state.id, state.block.as_ref(), &block);
        self.robots[robot].greeted.latency_differs = differs;
        self.robots[robot].block = Some(block);
        for reason in unfit {
            self.fail(now, robot, FailureKind::Unfit { reason });
        }
        if matches!(self.phase, Phase::Greeting { .. }) {
            self.greeting_progress(now);
        }
    }

    /// Returns the reasons why a robot's own description does not allow the commands of an act.
    fn unfit(&self, robot: RobotIndex, block: &InitializationBlock) -> Vec<String> {
        let state = &self.robots[robot];
        let mut reasons = Vec::new();
        if !block.understands(state.settings.encoding) {
            let listed = block.encodings.iter().take(ENCODINGS_SHOWN);
            let listed: Vec<_> = listed.map(|listed| format!("`{listed}`")).collect();
            let listed = if listed.is_empty() { "none".to_owned() } else { listed.join(", ") };
            reasons.push(format!(
                "it does not support the encoding `{}`, which the fleet file requires (it supports, besides JSON: {listed}); \
                 use `encoding: json`, which every robot supports",
                state.settings.encoding
            ));
        }
        if self.choreography.requirements.all_or_none.is_some() && !(block.inquiry && block.pending_until) {
            reasons.push(NOT_STRICT_ENOUGH.to_owned());
        }
        let plans = self.choreography.acts.iter().flat_map(|act| &act.plan.robots);
        let scripts = plans.filter(|plan| plan.robot == state.id).flat_map(|plan| &plan.scripts);
        reasons.extend(scripts.flat_map(|script| unfit(script, block)));
        reasons.truncate(UNFIT_SHOWN);
        reasons
    }

    pub(super) fn read(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        sensor: DeviceId,
        what: Reading,
    ) {
        let session = self.options.session_name().map_or("", |session| session.as_str());
        self.robots[robot].requests.make_room_for_reading();
        let count = self.robots[robot].requests.readings_owed();
        let id = RequestId::new(format!("read/{session}/{}/{robot}/{count}", now.as_nanos() / 1_000)).ok();
        let mut request = ControlRequest::immediate(sensor.clone(), Command::ReadSensor);
        request.request_id.clone_from(&id);
        request.session = self.options.session_on_the_wire();
        if let Some(id) = id {
            self.robots[robot].requests.add_reading(id, sensor, what);
        }
        self.send(now, robot, Message::ControlRequest(request));
    }

    /// Processes the answer to a request for a sensor reading.
    pub(super) fn reading_taken(
        &mut self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        response: &ControlResponse,
        what: Reading,
    ) {
        let value = match response.status_value {
            StatusValue::Number(value) if response.status == Status::Provide => Some(value),
            _ => None,
        };
        if let (None, Some(error)) = (value, &response.error) {
            self.robots[robot].greeted.unread.insert(response.device_id.clone(), error.message.clone());
        }
        match what {
            Reading::Requirement(index) => self.robots[robot].greeted.readings[index] = value,
            Reading::Position(device) => {
                match value {
                    Some(value) => self.robots[robot].pose.read.push((device, value)),
                    None if matches!(self.phase, Phase::Greeting { .. }) => {
                        self.robots[robot].greeted.shown.push((device, None));
                    }
                    None => {}
                }
                self.acts.iter_mut().for_each(|act| act.look_again_at(None));
            }
            Reading::Shown(device) => self.robots[robot].greeted.shown.push((device, value)),
            Reading::Wait(number) => {
                let act = self.acts.iter_mut().find(|act| act.number() == number);
                let told = act.and_then(|act| act.sensor_read(value));
                told.into_iter().for_each(|told| self.tell(told));
            }
            Reading::Planned(number, index) => {
                let act = self.acts.iter_mut().find(|act| act.number() == number);
                act.into_iter().for_each(|act| act.read(index, &self.robots[robot], value));
            }
            Reading::Motion(number, index) => {
                let act = self.acts.iter_mut().find(|act| act.number() == number);
                act.into_iter().for_each(|act| act.motion_read(index, self.outbox.arrived, value));
            }
        }
        if matches!(self.phase, Phase::Greeting { .. }) {
            self.greeting_progress(now);
        }
    }

    /// Once every robot has answered or failed, checks the robots and ends the greeting.
    pub(super) fn greeting_progress(&mut self, now: Timestamp<Server>) {
        if !matches!(self.phase, Phase::Greeting { .. }) {
            return;
        }
        let full = self.options.greeting == Greeting::Full;
        let heard = |robot: &RobotState| {
            let sampled = robot.clock.samples() >= CLOCK_SAMPLES || robot.is_of_another();
            let greeted = robot.greeted.introduced && sampled && robot.has_shown_its_pose();
            let absent = robot.standing != Standing::In;
            robot.has_failed() || absent || (robot.is_up() && (!full || greeted))
        };
        if !self.robots.iter().all(heard) {
            return;
        }
        let others = self.robots.iter().any(RobotState::is_of_another);
        if others {
            // A mission that would not start must not take over a robot of another session.
            self.check_links();
            self.check_clocks(now);
            self.check_sensors();
        }
        if self.seize_others(now) || self.still_sampling(now) {
            return;
        }
        if !others {
            self.check_links();
            self.check_clocks(now);
            self.check_sensors();
            self.check_refills(now);
            self.check_strictness();
        }
        let preflight = preflight::table(self, now);
        self.greeting.preflight = Some(preflight.clone());
        let failed = self.robots.iter().any(RobotState::has_failed);
        let follows = |robot: &&RobotState| robot.settings.clock == ClockMode::Ntp && !failed;
        let offsets = self.robots.iter().filter(follows).filter_map(|robot| robot.clock.reading());
        let clock_offset_max = offsets.map(|reading| reading.offset.abs()).max();
        self.tell(Progress::Greeted { clock_offset_max, preflight });
        let nobody = self.robots.iter().all(|robot| robot.standing != Standing::In);
        match failed || nobody {
            true if self.options.preflight_only => self.refuse(Outcome::NotReady),
            true => self.refuse(Outcome::NotStarted),
            false if self.options.preflight_only => self.refuse(Outcome::Ready),
            false => {
                self.phase = Phase::Performing;
                self.record(Record::Checked);
                self.line_up_act(now, self.options.first_act);
                self.perform(now);
            }
        }
    }

    /// Refuses robots that could start a script before the commitment, if the scenario requires `all_or_none: strict`. Used with
    /// `handshake: skip`; otherwise, the robot's own description is checked.
    fn check_strictness(&mut self) {
        if self.options.greeting == Greeting::Full || self.choreography.requirements.all_or_none.is_none() {
            return;
        }
        for robot in self.robots.indices() {
            if !self.robots[robot].drops_undecided() {
                self.note_failure(robot, FailureKind::Unfit { reason: NOT_STRICT_ENOUGH.to_owned() });
            }
        }
    }

    /// Continues to sample clocks as long as that may bring the possible start spread of the fleet within the tolerance. It may also show
    /// that a robot was slow only while thousands of others connected. Returns whether the sampling continues.
    pub(super) fn still_sampling(&mut self, now: Timestamp<Server>) -> bool {
        if self.robots.iter().any(RobotState::has_failed) {
            return false;
        }
        let settled = !self.robots.indices().any(|robot| self.is_on_its_way(robot));
        let fits = settled
            && !self.robots.iter().any(is_too_slow)
            && self.skew_of_first_act(now).is_none_or(|skew| skew.fits());
        let Phase::Greeting { deadline } = self.phase else { return false };
        let until = deadline.min(now + SAMPLING);
        let (until, next) = *self.greeting.sampling.get_or_insert((until, now + SAMPLING_INTERVAL));
        let goes_on = !fits && next < until;
        if !goes_on {
            self.greeting.sampling = None;
        }
        goes_on
    }

    pub(super) fn sample_clocks(&mut self, now: Timestamp<Server>) {
        let Some((until, next)) = self.greeting.sampling.filter(|(_, next)| now >= *next) else { return };
        self.greeting.sampling = Some((until, next + SAMPLING_INTERVAL));
        let enough = self.choreography.acts[self.options.first_act.get()].plan.start_tolerance / 8;
        for robot in self.robots.indices() {
            let state = &self.robots[robot];
            let reading = state.clock.reading();
            // Clocks that are known well enough are also checked from time to time, because a clock may be set meanwhile.
            let stale = state.contact.questions.answered().is_none_or(|at| now - at > STALE);
            let unsure = stale || reading.is_none_or(|reading| reading.uncertainty > enough);
            if (unsure || is_too_slow(state)) && state.is_up() {
                self.ask_further(now, robot);
            }
            self.follow_on_its_way(now, robot);
        }
        if now >= until {
            self.greeting_progress(now);
        }
    }

    /// Asks a robot for its times again, unless an answer is pending. If every answer caused a question, a network that duplicates
    /// answers would also duplicate questions.
    pub(super) fn ask_further(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &self.robots[robot];
        let longest = lead::counted(state.round_trip()) * 3 + SAMPLING_INTERVAL;
        if state.contact.questions.last_unanswered().is_none_or(|at| now >= at + longest) {
            self.ask_availability(now, robot);
        }
    }

    pub(super) fn skew_of_first_act(&self, now: Timestamp<Server>) -> Option<SkewBudget> {
        let plan = &self.choreography.acts[self.options.first_act.get()].plan;
        SkewBudget::of_planned(plan, &self.greeting.first_robots, &self.robots, now)
    }

    /// Refuses robots whose round trips are longer than the longest accepted one, because the others would wait for them.
    pub(super) fn check_links(&mut self) {
        for index in self.robots.indices() {
            let robot = &self.robots[index];
            if is_too_slow(robot) {
                let round_trip = robot.round_trip();
                let slow = Slow::RoundTrip { round_trip, longest: ROUND_TRIP_LONGEST };
                self.note_failure(index, FailureKind::TooSlow { slow });
            }
        }
    }

    /// Refuses robots whose clock is certainly further off than the scenario tolerates. Also refuses robots whose clocks make the
    /// possible start spread of the fleet too large.
    pub(super) fn check_clocks(&mut self, now: Timestamp<Server>) {
        let tolerance = self.choreography.acts[self.options.first_act.get()].plan.start_tolerance;
        for index in self.robots.indices() {
            let robot = &self.robots[index];
            let follows = robot.settings.clock == ClockMode::Ntp && !robot.is_of_another();
            let Some(reading) = robot.clock_at(now).filter(|_| follows) else {
                continue;
            };
            let uncertainty = reading.uncertainty + self.options.server_uncertainty;
            if reading.offset.abs() - uncertainty > tolerance {
                let kind = FailureKind::Clock { offset: reading.offset, uncertainty, tolerance };
                self.note_failure(index, kind);
            }
        }
        // The fleet is judged as a whole.
        if self.robots.iter().any(|robot| robot.has_failed() || robot.is_of_another()) {
            return;
        }
        let offenders = self.skew_of_first_act(now).map(|skew| skew.offenders()).unwrap_or_default();
        for (id, kind) in offenders {
            if let Some(index) = self.robots.position(|robot| robot.id == id) {
                self.note_failure(index, kind);
            }
        }
    }

    fn check_sensors(&mut self) {
        for index in self.robots.indices() {
            let robot = &self.robots[index];
            if robot.standing != Standing::In
                || self.options.greeting == Greeting::Skip
                || robot.is_of_another()
            {
                continue;
            }
            let short =
                robot.settings.require.iter().zip(&robot.greeted.readings).filter(|(required, reading)| {
                    !reading.is_some_and(|reading| required.range.contains(reading))
                });
            let short: Vec<_> = short
                .map(|(required, reading)| FailureKind::Requirement {
                    sensor: required.sensor.clone(),
                    reading: *reading,
                    range: required.range,
                })
                .chain(self.misplaced(index))
                .collect();
            short.into_iter().for_each(|kind| self.note_failure(index, kind));
        }
    }

    pub(super) fn greeting_overdue(&mut self, now: Timestamp<Server>) {
        let within = self.options.patience;
        self.leave_to_others();
        let full = self.options.greeting == Greeting::Full;
        for index in self.robots.indices() {
            self.robots[index].requests.forget_readings(|what| matches!(what, Reading::Shown(_)));
            let robot = &self.robots[index];
            let awaited = match robot.link {
                _ if robot.has_failed() || robot.standing != Standing::In => continue,
                Link::Connecting | Link::Lost(_) => "connection",
                Link::Unnamed { .. } => "initialization block",
                Link::Up { .. } if full && robot.clock.samples() == 0 => "availability response",
                Link::Up { .. } if full && robot.clock.samples() < CLOCK_SAMPLES => {
                    "further availability responses"
                }
                Link::Up { .. } if full && robot.requests.awaited_readings().next().is_some() => {
                    "readings of its sensors"
                }
                Link::Up { .. } if full && robot.pose.owed > 0 => "positions of its devices",
                Link::Up { .. } => continue,
            };
            if self.options.join == Join::NextAct && !robot.is_up() {
                self.robots[index].standing = Standing::Absent;
                self.reconnect(index);
                continue;
            }
            let awaited = match robot.contact.exchanges.ignored() {
                0 => awaited.to_owned(),
                ignored => format!(
                    "{awaited} (answers ignored because they match no request or have impossible times: {ignored})"
                ),
            };
            self.fail(now, index, FailureKind::Silent { awaited, within });
        }
        self.greeting.sampling = None;
        self.greeting_progress(now);
    }

    /// Adds a robot that was absent at first to the mission, once it has been greeted and if the options permit it.
    fn join_if_greeted(&mut self, now: Timestamp<Server>, robot: RobotIndex) {
        let state = &self.robots[robot];
        if state.clock.samples() < CLOCK_SAMPLES {
            return self.ask_further(now, robot);
        }
        if state.greeted.introduced && !state.has_failed() && self.options.join == Join::NextAct {
            self.joins(robot);
            let robot = self.robots[robot].id.clone();
            self.tell(Progress::Reattached { robot });
        }
    }

    /// Adds a robot to the mission, starting with the next act that has not been sent.
    pub(super) fn joins(&mut self, robot: RobotIndex) {
        self.robots[robot].standing = Standing::In;
        self.robots[robot].joined_late = true;
        self.robots[robot].pose.unplaced = true;
        self.acts.iter_mut().for_each(|act| act.gather(&self.robots));
    }

    /// Ends the mission with this outcome before anything has been sent that could move a robot.
    pub(super) fn refuse(&mut self, outcome: Outcome) {
        self.conclusion.outcome = Some(outcome);
        if self.has_moved() {
            self.admit_that_it_moved();
        }
        self.end();
    }
}

/// The reason why a robot is refused if the scenario requires `all_or_none: strict`.
const NOT_STRICT_ENOUGH: &str = "the scenario requires `all_or_none: strict`, but the robot does not declare `pending_until` and `inquiry`";
/// The maximum number of encodings that a message lists per robot.
const ENCODINGS_SHOWN: usize = 8;

/// The maximum number of faults that are listed per robot. Otherwise, a single robot with a wrong unit would bury the faults of the
/// others.
const UNFIT_SHOWN: usize = 12;

/// Returns the reasons why a robot's own description does not allow the commands of a script.
pub(super) fn unfit(script: &downbeat_plan::DeviceScript, block: &InitializationBlock) -> Vec<String> {
    let id = &script.device;
    let Some(device) = block.device(id.as_str()) else {
        return vec![format!("it has no device `{id}`")];
    };
    let mut reasons = Vec::new();
    let steps = script.script.steps();
    let room = device.available_control_types.script().map_or(0, |s| s.max_number_of_steps as usize);
    if steps.len() > room {
        reasons.push(format!(
            "device `{id}` supports at most {} per script, but the plan has {}",
            counted(room, "step"),
            steps.len()
        ));
    }
    let faults = steps.iter().enumerate().filter_map(|(i, step)| {
        let error = device.check_in_script(&step.setpoint).err()?;
        Some(format!("device `{id}` step {}: {}", i + 1, error.message))
    });
    reasons.extend(faults.take(3));
    reasons
}
