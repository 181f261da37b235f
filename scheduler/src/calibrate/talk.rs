//! A dialogue with one robot during a session: over one link, with one request at a time.

use std::collections::{BTreeMap, VecDeque};

use downbeat_onset::Reading;
use downbeat_scripts::{ClockMode, FleetRobot};
use tokio::sync::mpsc;
use urrcp::{
    AvailabilityRequest, Command, ControlRequest, ControlResponse, ControlType, Device, DeviceId, ErrorCode,
    InitializationBlock, InitializationRequest, Inquiry, Message, Millis, RequestId, Robot, Script, Server,
    Span, Status, StatusValue, StopCondition, Timestamp,
};

use crate::clock::{ClockEstimate, ClockReading, ClockSample};
use crate::drive::{Happened, LinkNumber, Urgency};
use crate::link::{Endpoint, Link};
use crate::mission::{Event, RobotIndex};
use crate::server_clock::ServerClock;
use crate::session::Session;

/// Number of message exchanges that measure the robot's clock.
const EXCHANGES: u32 = 16;
/// Maximum permitted error of the clock of a robot that follows NTP.
const CLOCK_OFF_MAX: Span = Span::from_millis(10);
/// Duration of the lease of each movement. A robot that receives nothing for this long ends the movement by itself.
const LEASE: Span = Span::from_millis(1_000);
/// Minimum time from sending a script to its start, so that the script arrives in time.
const LEAD: Span = Span::from_millis(150);

/// Why the dialogue with a robot failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DialogueError {
    /// The link broke, or the robot could not be reached.
    #[error("{0}")]
    Link(String),
    /// The robot does not answer within the contained time.
    #[error("no answer within {0}")]
    Silent(Span),
    /// Another session drives the robot.
    #[error("the robot belongs to another session; wait until its mission has ended")]
    Busy,
    /// The robot refuses a request, for the contained reason.
    #[error("the robot refused the request: {0}")]
    Refused(String),
    /// A movement ended early.
    #[error("a movement of `{device}` failed: {reason}")]
    Failed {
        /// The id of the device.
        device: DeviceId,
        /// The reason that the robot reports.
        reason: String,
    },
    /// Another robot answers at the address.
    #[error("a different robot answered: its id is `{found}`, expected `{expected}`")]
    Another {
        /// The id that the robot reports.
        found: String,
        /// The id in the fleet file.
        expected: String,
    },
    /// The contained device differs from the description in the init file.
    #[error(
        "the robot's description of `{0}` differs from its init file; `downbeat fleet describe` shows the description"
    )]
    Different(DeviceId),
    /// The robot's clock differs from the server's clock by the contained amount.
    #[error("its clock is off by {0}; check its NTP synchronization")]
    Clock(Span),
}

/// A sensor's value, with the times at which it was requested and received.
#[derive(Clone, Copy, Debug)]
pub struct TimedReading {
    /// When the request was sent.
    pub asked: Timestamp<Server>,
    /// When the response arrived.
    pub answered: Timestamp<Server>,
    /// The value, in the unit of the sensor.
    pub value: f64,
    /// When the value was taken. `None` if the robot does not state it.
    pub taken: Option<Stamped>,
}

/// The time at which the value of a sensor was taken, as the robot states it.
#[derive(Clone, Copy, Debug)]
pub struct Stamped {
    /// The time on the server's clock.
    pub at: Timestamp<Server>,
    /// Uncertainty of the robot's clock.
    pub uncertainty: Span,
}

/// A dialogue with one robot.
pub struct RobotDialogue {
    link: Link,
    happened: mpsc::Receiver<Happened>,
    clock: ServerClock,
    mode: ClockMode,
    session: Session,
    estimate: ClockEstimate,
    patience: Span,
    asked: u64,
    /// Reports about movements that arrived while the dialogue waited for another message.
    reports: VecDeque<ControlResponse>,
    /// The ids of the robot's devices whose description differs from the init file.
    different: Vec<DeviceId>,
    /// Whether the robot answers inquiries.
    takes_inquiries: bool,
}

/// Maximum number of consecutive readings that may be missed.
const MISSED_MAX: u32 = 3;
/// Maximum number of stored reports about movements.
const REPORTS_MAX: usize = 256;

impl RobotDialogue {
    /// Connects to a robot and checks its description and its clock against the fleet file. Then claims the robot.
    ///
    /// # Errors
    /// Returns [`DialogueError`] if the robot does not answer, refuses, or cannot be used.
    pub async fn begin(
        robot: &FleetRobot,
        endpoint: Endpoint,
        clock: ServerClock,
        session: Session,
        patience: Span,
    ) -> Result<Self, DialogueError> {
        let (events, happened) = mpsc::channel(256);
        let link = Link::open(
            (RobotIndex::new(0), LinkNumber(0)),
            endpoint,
            clock,
            events,
            std::time::Duration::ZERO,
        );
        let mut talk = Self {
            link,
            happened,
            clock,
            mode: robot.mission.clock,
            session,
            estimate: ClockEstimate::default(),
            patience,
            asked: 0,
            reports: VecDeque::new(),
            different: Vec::new(),
            takes_inquiries: false,
        };
        let block = talk.block().await?;
        check_identity(robot, &block)?;
        talk.different = different(robot, &block);
        talk.takes_inquiries = block.inquiry;
        for _ in 0..EXCHANGES {
            talk.ping().await?;
        }
        if let Some(reading) = talk.estimate.reading() {
            let beyond = reading.offset.abs() - reading.uncertainty;
            if talk.mode == ClockMode::Ntp && beyond > CLOCK_OFF_MAX {
                return Err(DialogueError::Clock(reading.offset));
            }
        }
        Ok(talk)
    }

    /// Returns the estimate of the robot's clock and of the delay to the robot. Returns `None` before the first exchange.
    #[must_use]
    pub fn clock_reading(&self) -> Option<ClockReading> {
        self.estimate.reading()
    }

    /// Returns the current time of the server's clock.
    #[must_use]
    pub fn now(&self) -> Timestamp<Server> {
        self.clock.now()
    }

    /// Returns the next event of the link, or `None` if no event arrives before `until`.
    async fn next(
        &mut self,
        until: Timestamp<Server>,
    ) -> Result<Option<(Timestamp<Server>, Event)>, DialogueError> {
        let at = self.clock.instant_of(until);
        match tokio::time::timeout_at(at.into(), self.happened.recv()).await {
            Err(_) => Ok(None),
            Ok(Some(Happened::OnLink { at, event, .. })) => match *event {
                Event::LinkDown { reason, .. } | Event::Garbled { reason, .. } => {
                    Err(DialogueError::Link(reason))
                }
                event => Ok(Some((at, event))),
            },
            Ok(Some(Happened::Event { at, event })) => Ok(Some((at, *event))),
            Ok(_) => Err(DialogueError::Link("the link was closed".to_owned())),
        }
    }

    fn say(&self, message: Message) -> Result<(), DialogueError> {
        let full = |_| DialogueError::Link("the robot is not reading its incoming messages".to_owned());
        self.link.send(message, Urgency::InOrder).map_err(full)
    }

    async fn block(&mut self) -> Result<InitializationBlock, DialogueError> {
        let until = self.now() + self.patience;
        while let Some((_, event)) = self.next(until).await? {
            match event {
                Event::LinkUp { .. } => {
                    let timestamp = Some(self.now());
                    self.say(Message::InitializationRequest(InitializationRequest { timestamp }))?;
                }
                Event::Received { message: Message::InitializationBlock(block), .. } => return Ok(block),
                Event::Received { message: Message::AvailabilityResponse(response), .. } => {
                    available(response.status, response.error.as_ref())?;
                }
                _ => {}
            }
        }
        Err(DialogueError::Silent(self.patience))
    }

    /// Sends an availability request. It claims the robot, renews the robot's leases and measures its clock.
    ///
    /// # Errors
    /// Returns [`DialogueError`] if the robot does not answer, refuses, or cannot be used.
    pub async fn ping(&mut self) -> Result<(), DialogueError> {
        let sent = self.now();
        let session = Some(self.session.on_the_wire().clone());
        self.say(Message::AvailabilityRequest(AvailabilityRequest {
            timestamp: Some(sent),
            session,
            seize: false,
            revocation_list: None,
        }))?;
        let until = sent + self.patience;
        while let Some((at, event)) = self.next(until).await? {
            match event {
                Event::Received { message: Message::AvailabilityResponse(response), .. } => {
                    available(response.status, response.error.as_ref())?;
                    if response.originate_timestamp == Some(sent) {
                        let (received, answered) = (response.receive_timestamp, response.timestamp);
                        self.estimate.add(ClockSample::from_exchange(sent, received, answered, at));
                        return Ok(());
                    }
                }
                other => self.keep(other),
            }
        }
        Err(DialogueError::Silent(self.patience))
    }

    fn keep(&mut self, event: Event) {
        if let Event::Received { message: Message::ControlResponse(response), .. } = event {
            if self.reports.len() >= REPORTS_MAX {
                self.reports.pop_front();
            }
            self.reports.push_back(response);
        }
    }

    /// Returns a new request id. It is unique within the session, and differs from the ids that other runs send to the same robot.
    fn name(&mut self) -> RequestId {
        self.asked += 1;
        let name = format!("{}/{}", self.session.name(), self.asked);
        RequestId::new(name).unwrap_or_else(|_| unreachable_name())
    }

    /// Sends a request and waits for the first response to it.
    async fn ask(
        &mut self,
        mut request: ControlRequest,
    ) -> Result<(Timestamp<Server>, Timestamp<Server>, ControlResponse), DialogueError> {
        let name = self.name();
        request.request_id = Some(name.clone());
        request.session = Some(self.session.on_the_wire().clone());
        let sent = self.now();
        self.say(Message::ControlRequest(request))?;
        let until = sent + self.patience;
        while let Some((at, event)) = self.next(until).await? {
            match event {
                Event::Received { message: Message::ControlResponse(response), .. }
                    if response.request_id.as_ref() == Some(&name) =>
                {
                    return Ok((sent, at, response));
                }
                other => self.keep(other),
            }
        }
        Err(DialogueError::Silent(self.patience))
    }

    /// Requests one reading of a sensor.
    ///
    /// # Errors
    /// Returns [`DialogueError`] if the robot does not answer, refuses, or cannot be used.
    pub async fn read(&mut self, sensor: &DeviceId) -> Result<TimedReading, DialogueError> {
        let request = ControlRequest::immediate(sensor.clone(), Command::ReadSensor);
        let (sent, at, response) = self.ask(request).await?;
        match (response.status, response.status_value) {
            (Status::Provide, StatusValue::Number(value)) => {
                let taken = response.event_timestamp.and_then(|taken| self.taken(taken, at));
                Ok(TimedReading { asked: sent, answered: at, value, taken })
            }
            _ => Err(refusal(response.error.as_ref())),
        }
    }

    /// Converts the time at which a robot has taken a value. Returns `None` for a time after the arrival of the answer, which is impossible.
    fn taken(&self, taken: Timestamp<Robot>, answered: Timestamp<Server>) -> Option<Stamped> {
        let clock = self.estimate.reading()?;
        let at = (taken - clock.offset).assume_clock();
        (at <= answered + clock.uncertainty).then_some(Stamped { at, uncertainty: clock.uncertainty })
    }

    /// Requests a reading of a sensor, and repeats the request if the reading is missed, for example because the sensor is busy.
    ///
    /// # Errors
    /// Returns [`DialogueError`] if the robot does not answer, if it cannot be used, or if several consecutive readings are missed.
    pub async fn read_again(&mut self, sensor: &DeviceId) -> Result<TimedReading, DialogueError> {
        for _ in 0..MISSED_MAX {
            match self.read(sensor).await {
                Err(DialogueError::Refused(_)) => {}
                read => return read,
            }
        }
        self.read(sensor).await
    }

    /// Sends a script that starts at least `lead` later. Returns the start time on the server's clock, and the request id.
    ///
    /// # Errors
    /// Returns [`DialogueError`] if the robot does not answer, refuses, or cannot be used.
    pub async fn command(
        &mut self,
        device: &DeviceId,
        script: Script,
        lead: Span,
    ) -> Result<(Timestamp<Server>, Option<RequestId>), DialogueError> {
        let reading = self.estimate.reading();
        let offset = reading.as_ref().map_or(Span::ZERO, |reading| reading.offset);
        let usual = reading.map_or(Span::ZERO, |reading| reading.delay_high);
        let lead = lead.max(LEAD) + usual * 2;
        let now = self.now();
        // A robot without NTP receives times of its own clock. The clock of a robot with NTP has a small measured offset, and the robot
        // starts that much earlier.
        let (timestamp, start) = match self.mode {
            ClockMode::Measured => (now + offset, now + lead),
            ClockMode::Ntp => (now, now + lead - offset),
        };
        let request = ControlRequest {
            stop_condition: Some(StopCondition::both(Millis::from_span(lead + LEASE))),
            ..ControlRequest::deferred(
                timestamp,
                Millis::from_span(lead),
                device.clone(),
                Command::Script(script),
            )
        };
        let (_, _, response) = self.ask(request).await?;
        match response.status {
            Status::Accepted => Ok((start, response.request_id)),
            _ => Err(refusal(response.error.as_ref())),
        }
    }

    /// Asks for the commanded positions of devices. Devices whose position the robot does not know have no entry, nor have those of robots
    /// that do not answer inquiries.
    ///
    /// # Errors
    /// Returns [`DialogueError`] if the robot does not answer, refuses, or cannot be used.
    pub async fn positions(
        &mut self,
        devices: &[DeviceId],
    ) -> Result<BTreeMap<DeviceId, f64>, DialogueError> {
        if !self.takes_inquiries {
            return Ok(BTreeMap::new());
        }
        let sent = self.now();
        let session = Some(self.session.on_the_wire().clone());
        let devices = devices.to_vec();
        self.say(Message::Inquiry(Inquiry {
            timestamp: Some(sent),
            session,
            devices,
            ..Inquiry::default()
        }))?;
        let until = sent + self.patience;
        while let Some((_, event)) = self.next(until).await? {
            match event {
                Event::Received { message: Message::InquiryResponse(response), .. }
                    if response.originate_timestamp == Some(sent) =>
                {
                    available(response.status, response.error.as_ref())?;
                    let known = response.devices.into_iter();
                    return Ok(known
                        .filter_map(|report| Some((report.device_id, report.position?)))
                        .collect());
                }
                other => self.keep(other),
            }
        }
        Err(DialogueError::Silent(self.patience))
    }

    /// Whether the robot describes the device as its init file does.
    #[must_use]
    pub fn is_as_described(&self, device: &DeviceId) -> bool {
        !self.different.contains(device)
    }

    /// Checks whether the robot has reported that a movement failed.
    ///
    /// # Errors
    /// Returns [`DialogueError::Failed`] with the reason if the movement has failed.
    pub fn check(&mut self, device: &DeviceId, request: Option<&RequestId>) -> Result<(), DialogueError> {
        let failed = |report: &ControlResponse| {
            report.status == Status::Failed && request.is_some() && report.request_id.as_ref() == request
        };
        let failed = self.reports.iter().find(|report| failed(report));
        let reason = failed.map(|report| {
            report.error.as_ref().map_or_else(|| "no reason given".to_owned(), ToString::to_string)
        });
        self.reports.retain(|report| report.request_id.as_ref() != request);
        match reason {
            Some(reason) => Err(DialogueError::Failed { device: device.clone(), reason }),
            None => Ok(()),
        }
    }

    /// Orders a device to stay where it is.
    ///
    /// # Errors
    /// Returns [`DialogueError`] if the order is not confirmed. In that case, the device may not be at rest.
    pub async fn hold(&mut self, device: &DeviceId) -> Result<(), DialogueError> {
        let stop = ControlRequest::immediate(device.clone(), Command::Script(Script::cancel()));
        let (_, _, response) = self.ask(stop).await?;
        match response.status {
            Status::Ok => Ok(()),
            _ => Err(refusal(response.error.as_ref())),
        }
    }
}

impl TimedReading {
    /// Converts the reading for the estimator, with times relative to `start`.
    #[must_use]
    pub fn since(self, start: Timestamp<Server>) -> Reading {
        Reading { asked: self.asked - start, answered: self.answered - start, value: self.value }
    }
}

#[expect(clippy::expect_used, reason = "a constant below every limit")]
fn unreachable_name() -> RequestId {
    RequestId::new("calibrate").expect("a constant below every limit")
}

fn available(status: Status, error: Option<&urrcp::ControlError>) -> Result<(), DialogueError> {
    match status {
        Status::Failed => Err(refusal(error)),
        _ => Ok(()),
    }
}

fn refusal(error: Option<&urrcp::ControlError>) -> DialogueError {
    match error {
        Some(error) if error.code == ErrorCode::Busy => DialogueError::Busy,
        Some(error) => DialogueError::Refused(error.to_string()),
        None => DialogueError::Refused("no reason given".to_owned()),
    }
}

/// Returns the devices of the init file that the robot itself describes differently, or does not have.
fn different(robot: &FleetRobot, block: &InitializationBlock) -> Vec<DeviceId> {
    let own = |device: &Device| block.device(device.id.as_str()).map(|own| &own.available_control_types);
    let devices = robot.init.iter().flat_map(|init| init.devices.iter());
    let different = devices.filter(|device| own(device) != Some(&device.available_control_types));
    different.map(|device| device.id.clone()).collect()
}

/// Returns an error if a different robot answers, or if the robot's devices differ from the init file.
fn check_identity(robot: &FleetRobot, block: &InitializationBlock) -> Result<(), DialogueError> {
    let Some(expected) = &robot.init else { return Ok(()) };
    if block.id != expected.id {
        let (found, expected) = (block.id.to_string(), expected.id.to_string());
        return Err(DialogueError::Another { found, expected });
    }
    for (device, how) in &robot.mission.calibrate {
        let limits = |block: &InitializationBlock| {
            let device = block.device(device.as_str())?;
            device.available_control_types.limits(ControlType::Position).cloned()
        };
        let is_sensor = block.device(how.sensor.as_str());
        let is_sensor = is_sensor.is_some_and(|sensor| sensor.available_control_types.sensor().is_some());
        if limits(block) != limits(expected) || !is_sensor {
            return Err(DialogueError::Different(device.clone()));
        }
    }
    Ok(())
}
