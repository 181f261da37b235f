//! A mission with robots that obey, in virtual time: its progress while it plays, and its outcome.

use std::collections::HashMap;

use urrcp::{
    AvailabilityResponse, Command, ControlRequest, ControlResponse, DeviceReport, Inquiry, InquiryResponse,
    RequestReport, RequestState, StatusValue,
};

use super::*;

use crate::bench::{ms, refusal, report, response};

/// Time from a message to its answer.
const ROUND_TRIP: Span = Span::from_micros(400);

/// A script that a robot has: the index of the robot, the device, the start and the end.
type Held = (RobotIndex, DeviceId, Timestamp<Server>, Timestamp<Server>);

pub(super) struct Played {
    pub(super) mission: Mission,
    pub(super) now: Timestamp<Server>,
    records: u64,
    scripts: HashMap<RequestId, Held>,
    /// Scripts that have ended before their last step, with the reason and the number of steps done.
    ended: HashMap<RequestId, (ErrorCode, u32)>,
    arrivals: Vec<(Timestamp<Server>, Event)>,
    /// Robots whose messages are lost in both directions from now on.
    pub(super) mute: Vec<RobotIndex>,
    /// The positions that the robots report for their devices.
    pub(super) positions: HashMap<DeviceId, f64>,
    /// The time until which devices slow down, and their distance from their final positions per remaining millisecond.
    pub(super) slows: Option<(Timestamp<Server>, f64)>,
    /// The maximum error of device positions. The error changes continuously, and its sign changes every second.
    pub(super) jitters: f64,
    /// Whether robots report the positions of all devices in each answer to an inquiry.
    pub(super) states_all: bool,
    /// Whether the control responses of robots omit the ids of requests.
    pub(super) leaves_out_names: bool,
    /// The times by which the clocks of robots are ahead of the server's.
    pub(super) ahead: HashMap<RobotIndex, Span>,
    pub(super) told: Vec<Progress>,
    pub(super) sent: Vec<(Timestamp<Server>, RobotIndex, Message)>,
    pub(super) recorded: Vec<Record>,
    /// The attempts to reconnect to robots, each with the pause before it.
    pub(super) reconnects: Vec<(RobotIndex, Span)>,
}

impl Played {
    /// A mission whose links are all connected at once. It sends its first act as soon as the duration of a record is known.
    pub(super) fn begun(mission: Mission) -> Self {
        Self::of(mission, Vec::new())
    }

    /// Like `begun`, but the robots in `mute` receive and send nothing.
    pub(super) fn of(mission: Mission, mute: Vec<RobotIndex>) -> Self {
        let all: Vec<RobotIndex> = mission.robots.indices().collect();
        let mut played = Self::linked(mission, &all);
        played.mute = mute;
        played.run_until(at(10));
        played
    }

    /// A mission whose links to these robots are about to be connected.
    pub(super) fn linked(mission: Mission, robots: &[RobotIndex]) -> Self {
        let arrivals = robots.iter().map(|robot| (at(0), Event::LinkUp { robot: *robot })).collect();
        Self {
            mission,
            now: at(0),
            records: 0,
            scripts: HashMap::new(),
            ended: HashMap::new(),
            arrivals,
            mute: Vec::new(),
            positions: HashMap::new(),
            slows: None,
            jitters: 0.0,
            states_all: false,
            leaves_out_names: false,
            ahead: HashMap::new(),
            told: Vec::new(),
            sent: Vec::new(),
            recorded: Vec::new(),
            reconnects: Vec::new(),
        }
    }

    /// The mission as another process resumes it at `now`, after its process has died. That process is about to connect. The robots have
    /// continued meanwhile, and their reports are lost.
    pub(super) fn resumed_at(&self, now: Timestamp<Server>, kept: &Kept, ended: Vec<ActReport>) -> Self {
        let participant = |robot: &RobotState| Participant::new(robot.id.clone(), robot.block.clone());
        let participants = self.mission.robots.iter().map(participant).collect();
        let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
        let choreography = Arc::clone(&self.mission.choreography);
        let mission =
            Mission::resume(choreography, participants, options, kept, ended.into_iter(), now).unwrap();
        let all: Vec<RobotIndex> = mission.robots.indices().collect();
        let (scripts, ended) = (self.scripts.clone(), self.ended.clone());
        let (positions, ahead) = (self.positions.clone(), self.ahead.clone());
        let arrivals = all.iter().map(|robot| (now, Event::LinkUp { robot: *robot })).collect();
        Self { now, scripts, ended, arrivals, positions, ahead, ..Self::linked(mission, &[]) }
    }

    pub(super) fn run_until(&mut self, until: Timestamp<Server>) {
        for _ in 0..100_000 {
            let arrives = self.arrivals.iter().map(|(at, _)| *at).min();
            let wakes = self.mission.next_wakeup();
            let Some(next) = arrives.into_iter().chain(wakes).min().filter(|next| *next <= until) else {
                self.now = self.now.max(until);
                return;
            };
            self.now = self.now.max(next);
            let due = |(at, _): &mut (Timestamp<Server>, Event)| *at <= next;
            let due: Vec<_> = self.arrivals.extract_if(.., due).collect();
            due.into_iter().for_each(|(_, event)| self.happens(event));
            let actions = self.mission.advance(self.now);
            self.carry_out(actions);
        }
        panic!("it wakes up for nothing at {}: {}", self.now, self.mission.due());
    }

    pub(super) fn run_to_the_end(&mut self) -> Outcome {
        self.run_until(self.now + ms(60_000));
        self.mission.outcome().cloned().expect("it ends")
    }

    /// Runs until the first act under way has started.
    pub(super) fn run_to_the_start(&mut self) {
        let begun = self.mission.acts[0].timing().unwrap().begun();
        self.run_until(begun + ms(5));
    }

    pub(super) fn happens(&mut self, event: Event) {
        let actions = self.mission.handle(self.now, event);
        self.carry_out(actions);
        let actions = self.mission.advance(self.now);
        self.carry_out(actions);
    }

    pub(super) fn carry_out(&mut self, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Send { robot, message, .. } => {
                    if !self.mute.contains(&robot) {
                        self.answer(robot, &message);
                    }
                    self.sent.push((self.now, robot, message));
                }
                Action::Record(record) => {
                    if record.is_durable() {
                        self.records += 1;
                        self.arrivals.push((self.now + ms(2), Event::Recorded { count: self.records }));
                    }
                    self.recorded.push(record);
                }
                Action::Tell(progress) => self.told.push(progress),
                Action::Reconnect { robot, after } => self.reconnects.push((robot, after)),
                Action::Answer(_) => {}
            }
        }
    }

    fn answer(&mut self, robot: RobotIndex, message: &Message) {
        let there = self.shown(robot, self.now + ROUND_TRIP / 2);
        let answer = match message {
            Message::AvailabilityRequest(request) => {
                let response = AvailabilityResponse::new(request, there, there, Status::Ok);
                Message::AvailabilityResponse(response)
            }
            Message::InitializationRequest(_) => {
                Message::InitializationBlock(self.mission.robots[robot].block.clone().unwrap())
            }
            Message::Inquiry(inquiry) => Message::InquiryResponse(self.inquired(robot, inquiry)),
            Message::ControlRequest(request) => self.asked_to(robot, request),
            other => panic!("{other:?}"),
        };
        self.says(self.now + ROUND_TRIP, robot, answer);
    }

    /// The time of a robot's clock at this instant.
    fn shown(&self, robot: RobotIndex, at: Timestamp<Server>) -> Timestamp<urrcp::Robot> {
        by_robot(at + self.ahead.get(&robot).copied().unwrap_or_default())
    }

    fn position(&self, device: &DeviceId, when: Timestamp<Server>) -> Option<f64> {
        let away = self.slows.map_or(0.0, |(until, by)| (until - when).as_millis_f64().max(0.0) * by);
        let changes = 0.8 + 0.2 * Span::from_nanos(when.as_nanos() % 1_000_003).as_millis_f64();
        let is_above = when.as_nanos() / 1_000_000_000 % 2 == 0;
        let off = self.jitters * if is_above { changes } else { -changes };
        self.positions.get(device).map(|position| position + away + off)
    }

    fn inquired(&self, robot: RobotIndex, inquiry: &Inquiry) -> InquiryResponse {
        let when = self.now + ROUND_TRIP / 2;
        let requests = inquiry.requests.iter().map(|id| {
            if let Some((code, steps_done)) = self.ended.get(id) {
                let ended = report(id, RequestState::Ended, None);
                let steps_done = Some(*steps_done);
                return RequestReport { steps_done, error: refusal(code.clone()), ..ended };
            }
            let state = match self.scripts.get(id) {
                None => RequestState::Unknown,
                Some((.., start, _)) if when < *start => RequestState::Held,
                Some((.., end)) if when < *end => RequestState::Running,
                Some(_) => RequestState::Ended,
            };
            let begun = matches!(state, RequestState::Running | RequestState::Ended);
            let start =
                self.scripts.get(id).filter(|_| begun).map(|(.., start, _)| self.shown(robot, *start));
            RequestReport { event_timestamp: start, ..report(id, state, None) }
        });
        let requests = requests.collect();
        let stated = |device: &DeviceId| DeviceReport {
            device_id: device.clone(),
            room: 2,
            position: self.position(device, when),
        };
        let devices = if !self.states_all {
            inquiry.devices.iter().map(stated).collect()
        } else {
            self.positions.keys().map(stated).collect()
        };
        let there = self.shown(robot, when);
        InquiryResponse { requests, devices, ..InquiryResponse::new(inquiry, there, there, Status::Ok) }
    }

    fn asked_to(&mut self, robot: RobotIndex, request: &ControlRequest) -> Message {
        let (device, id) = (&request.device_id, request.request_id.as_ref());
        let ahead = self.ahead.get(&robot).copied().unwrap_or_default();
        let says = |status, at| Message::ControlResponse(response(device, id, status, at + ahead));
        let there = self.now + ROUND_TRIP / 2;
        let Command::Script(script) = &request.command else {
            let Some(position) = self.position(device, there) else { return says(Status::Failed, there) };
            let reading = response(device, id, Status::Provide, there);
            let status_value = StatusValue::Number(position);
            return Message::ControlResponse(ControlResponse { status_value, ..reading });
        };
        let Some((sent, offset)) = request.timestamp.zip(request.time_offset_to_start) else {
            let now = self.now;
            let cancelled =
                self.scripts.extract_if(|_, (of, on, _, end)| (*of, &*on) == (robot, device) && *end > now);
            // Scripts have one step at their start and one at their end.
            let steps = |start: Timestamp<Server>| u32::from(start <= now);
            let ended = cancelled.map(|(id, (.., start, _))| (id, (ErrorCode::Cancelled, steps(start))));
            self.ended.extend(ended);
            let own = |message: &Message| matches!(message, Message::ControlResponse(said) if said.device_id == *device);
            self.arrivals.retain(|(_, event)| !matches!(event, Event::Received { robot: of, message } if *of == robot && own(message)));
            return says(Status::Ok, there);
        };
        let start = sent + offset.span() - ahead;
        let end = start + script.duration();
        let known = self.scripts.insert(id.unwrap().clone(), (robot, device.clone(), start, end)).is_some();
        if self.mission.robots[robot].reports() && !known {
            let of = (says(Status::Started, start), says(Status::Ok, end));
            self.says(start + ROUND_TRIP / 2, robot, of.0);
            self.says(end + ROUND_TRIP / 2, robot, of.1);
        }
        says(Status::Accepted, there)
    }

    fn says(&mut self, at: Timestamp<Server>, robot: RobotIndex, mut message: Message) {
        if let Message::ControlResponse(response) = &mut message {
            response.request_id.take_if(|_| self.leaves_out_names);
        }
        self.arrivals.push((at, Event::Received { robot, message }));
    }

    /// Ends the pending lease of a script, so that the robot does not begin it.
    pub(super) fn drops(&mut self, id: &RequestId) {
        self.loses(id);
        self.ended.insert(id.clone(), (ErrorCode::LinkLost, 0));
    }

    /// Replaces the robot's process by a process that does not know the script.
    pub(super) fn loses(&mut self, id: &RequestId) {
        self.scripts.remove(id);
        let of_it = |message: &Message| matches!(message, Message::ControlResponse(said) if said.request_id.as_ref() == Some(id));
        self.arrivals
            .retain(|(_, event)| !matches!(event, Event::Received { message, .. } if of_it(message)));
    }

    /// Delays the connection to a robot.
    pub(super) fn delay_link(&mut self, robot: RobotIndex, by: Span) {
        for (at, event) in &mut self.arrivals {
            if matches!(event, Event::LinkUp { robot: of } if *of == robot) {
                *at = *at + by;
            }
        }
    }

    /// Delays those answers under way that report on scripts.
    pub(super) fn delay_reports(&mut self, by: Span) {
        for (at, event) in &mut self.arrivals {
            let Event::Received { message: Message::InquiryResponse(response), .. } = event else { continue };
            if !response.requests.is_empty() {
                *at = *at + by;
            }
        }
    }

    /// Ends all scripts of all robots now, after `steps_done` steps.
    pub(super) fn ends_early(&mut self, steps_done: u32) {
        self.ended.extend(self.scripts.drain().map(|(id, _)| (id, (ErrorCode::LinkLost, steps_done))));
    }

    /// The number of stops that were sent, one for each device.
    pub(super) fn stops(&self) -> usize {
        let stops = self.sent.iter().filter(|(.., message)| {
            matches!(message, Message::ControlRequest(request) if request.time_offset_to_start.is_none())
        });
        stops.count()
    }

    pub(super) fn mutes(&mut self, robot: RobotIndex) {
        self.mute.push(robot);
        self.arrivals
            .retain(|(_, event)| !matches!(event, Event::Received { robot: of, .. } if *of == robot));
    }
}

#[test]
fn mission_with_compliant_robots_is_done() {
    for tells in [Everything, Tells::Reports, Tells::Answers, Tells::Nothing] {
        let mut played = Played::begun(begins_at_once(tells));
        let outcome = played.run_to_the_end();
        let expected = if tells == Tells::Nothing { Outcome::Unknown } else { Outcome::Done };
        assert_eq!(outcome, expected, "{tells:?}");
    }
}

#[cfg(feature = "metrics")]
#[test]
fn current_acts_are_counted_by_stage() {
    let mut mission = waits_in(1);
    assert_eq!(mission.act_stages(), [0, 0, 0]);
    assert_eq!(mission.phase_name(), super::figures::PhaseName::Greeting);
    mission = Played::begun(mission).mission;
    assert_eq!(mission.act_stages(), [0, 1, 0], "on its way to its start");
    let mut played = Played::begun(waits_in(1));
    played.run_to_the_start();
    assert_eq!(played.mission.act_stages(), [1, 0, 1], "one plays, and one waits for the operator");
    assert_eq!(played.mission.phase_name(), super::figures::PhaseName::Performing);
}

#[cfg(feature = "metrics")]
#[test]
fn robot_figures_include_the_current_acts() {
    let mut played = Played::begun(begins_at_once(Everything));
    let figures = |played: &Played| {
        let figures = played.mission.figures_of(R0);
        (
            figures.totals.sent,
            figures.totals.started,
            figures.is_linked,
            figures.takes_part,
            figures.awaits_stop,
        )
    };
    assert_eq!(figures(&played), (1, 0, true, true, false));
    played.run_to_the_start();
    assert_eq!(figures(&played), (1, 1, true, true, false));
    assert!(played.mission.figures_of(R0).clock.is_some());
    played.mutes(R0);
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    assert_eq!(figures(&played), (1, 1, true, true, true));
}
