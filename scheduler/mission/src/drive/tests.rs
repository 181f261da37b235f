//! Tests of the loop that drives a mission, in a simulated environment.

use downbeat_plan::{DeviceScript, Plan, RobotPlan};
use urrcp::{
    Command, ControlType, InitializationBlock, Millis, RobotId, Script, Setpoint, Step, StopCondition,
};

use super::*;
use crate::bench::{R0, R1, R2};
use crate::{ActNumber, Greeting, MissionOptions, Participant, Rest};

const BEGIN: Timestamp<Server> = Timestamp::from_nanos(1_767_225_600_000_000_000);

const ROBOT: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [{"id": "d", "name": "d",
  "available_control_types": {"position": {"min_value": 0, "max_value": 90, "granularity": 1},
  "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 8}}}]}"#;

fn mission() -> Mission {
    mission_with(MissionOptions::default())
}

fn mission_with(options: MissionOptions) -> Mission {
    mission_of(&["r"], options)
}

fn mission_of(robots: &[&str], options: MissionOptions) -> Mission {
    let block: InitializationBlock = serde_json::from_str(ROBOT).unwrap();
    let ids: Vec<RobotId> = robots.iter().map(|id| RobotId::new(*id).unwrap()).collect();
    let stop_condition = StopCondition { pending: None, running: Millis::new(2_000.0).ok() };
    let step = Step {
        offset: Millis::ZERO,
        setpoint: Setpoint::new(ControlType::Position, 45.0),
        stop_condition: None,
    };
    let script = DeviceScript {
        device: "d".parse().unwrap(),
        start: Millis::ZERO,
        stop_condition,
        script: Script::new(vec![step]).unwrap(),
        rest: Span::ZERO,
    };
    let plan = Plan {
        scenario: "s".into(),
        start_tolerance: Span::from_millis(10),
        lead: None,
        stop_condition,
        robots: ids.iter().map(|id| RobotPlan { robot: id.clone(), scripts: vec![script.clone()] }).collect(),
    };
    let described = |id: &RobotId| InitializationBlock { id: id.clone(), ..block.clone() };
    let participants = ids.iter().map(|id| Participant::new(id.clone(), Some(described(id)))).collect();
    Mission::of_plan(plan, participants, options, BEGIN).unwrap()
}

/// One robot that never answers, behind a link that takes `room` messages.
struct Silent {
    now: Timestamp<Server>,
    room: usize,
    happens: VecDeque<Happened>,
    journal: Filed,
    cut: Vec<LinkNumber>,
    /// The robots to which a connection was begun, each with the pause before it.
    connected: Vec<(RobotIndex, Span)>,
    told: Vec<Progress>,
    /// An event that happens once a script has been sent.
    once_it_sends: Option<Event>,
    stops: Vec<Stopping>,
}

/// Actions of the mission that the test records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stopping {
    Sent,
    Recorded,
}

impl Silent {
    fn new(room: usize, journal: Filed) -> Self {
        let (cut, connected, told) = (Vec::new(), Vec::new(), Vec::new());
        let (happens, stops) = (VecDeque::new(), Vec::new());
        Self { now: BEGIN, room, happens, journal, cut, connected, told, once_it_sends: None, stops }
    }

    fn on_link(&mut self, link: LinkNumber, event: Event) {
        self.happens.push_back(Happened::OnLink { at: self.now, robot: R0, link, event: Box::new(event) });
    }
}

impl World for Silent {
    fn now(&self) -> Timestamp<Server> {
        self.now
    }

    async fn next(&mut self, until: Option<Timestamp<Server>>) -> Option<Happened> {
        let happened = self.happens.pop_front();
        if happened.is_none() {
            self.now = self.now.max(until?);
        }
        happened
    }

    fn connect(&mut self, robot: RobotIndex, link: LinkNumber, after: Span) {
        self.connected.push((robot, after));
        self.now = self.now + after;
        self.on_link(link, Event::LinkUp { robot: R0 });
    }

    fn send(&mut self, _: RobotIndex, _: LinkNumber, message: Message, _: Urgency) -> Result<(), QueueFull> {
        if let Message::ControlRequest(request) = &message {
            let happens = self.once_it_sends.take();
            self.happens
                .extend(happens.map(|event| Happened::Event { at: self.now, event: Box::new(event) }));
            if matches!(&request.command, Command::Script(script) if script.is_empty()) {
                self.stops.push(Stopping::Sent);
            }
        }
        self.room = self.room.checked_sub(1).ok_or(QueueFull { waiting: 3 })?;
        Ok(())
    }

    fn cut(&mut self, _: RobotIndex, link: LinkNumber) {
        self.cut.push(link);
    }

    fn write(&mut self, _: Timestamp<Server>, record: Record) -> Filed {
        if matches!(record, Record::Stopping { .. }) {
            self.stops.push(Stopping::Recorded);
        }
        self.journal.clone()
    }

    fn tell(&mut self, _: Timestamp<Server>, progress: Progress) {
        self.told.push(progress);
    }
}

#[test]
fn robot_that_does_not_read_is_disconnected_and_reason_is_reported() {
    let mut world = Silent::new(1, Filed::AtOnce);
    let report = at_once(drive(&mut mission(), &mut world)).unwrap();
    assert_eq!(world.cut.first(), Some(&LinkNumber(0)));
    assert!(world.connected.len() > 2, "the link is retried as long as patience lasts");
    let failures: Vec<_> = report.failures.iter().map(|failure| failure.kind.to_string()).collect();
    assert!(failures.iter().any(|failure| failure.contains("does not read")), "{failures:?}");
}

#[test]
fn links_to_all_robots_are_opened_before_any_event_on_one_of_them() {
    let mut world = Silent::new(0, Filed::AtOnce);
    world.happens.push_back(Happened::Left);
    at_once(drive(&mut mission_of(&["r", "s", "t"], MissionOptions::default()), &mut world)).unwrap();
    assert_eq!(world.connected, [R0, R1, R2].map(|robot| (robot, Span::ZERO)));
}

#[test]
fn events_on_a_broken_or_replaced_link_are_ignored() {
    let mut links = Links::new(1);
    let down = Event::LinkDown { robot: R0, loss: Loss::Closed, reason: String::new() };
    let up = Event::LinkUp { robot: R0 };
    let first = links.connect(R0);
    assert!(links.takes(R0, first, &up) && links.takes(R0, first, &down));
    assert!(!links.takes(R0, first, &down) && !links.takes(R0, first, &up), "its end is its end");
    let second = links.connect(R0);
    assert!(!links.takes(R0, first, &up) && links.takes(R0, second, &up));
    let third = links.connect(R0);
    assert!(!links.takes(R0, second, &down) && links.takes(R0, third, &down));
}

#[test]
fn lost_journal_is_reported_once_and_stops_the_mission() {
    let mut driver = Driver::new(1);
    let mut world = Silent::new(9, Filed::Lost("full".to_owned()));
    let record = || Record::Decided { number: ActNumber::new(0), unnamed: Vec::new(), doubt: Span::ZERO };
    driver.perform(&mut world, vec![Action::Record(record()), Action::Record(record())]);
    let events: Vec<Event> = driver.pending.into_iter().map(|(_, event)| event).collect();
    assert!(matches!(&events[..], [Event::JournalLost { reason }] if reason == "full"), "{events:?}");
}

#[test]
fn only_durable_records_are_counted_without_a_journal() {
    let mut driver = Driver::new(1);
    let mut world = Silent::new(9, Filed::AtOnce);
    let records = [
        Record::Committed { number: ActNumber::new(0) },
        Record::StopConfirmed { robot: RobotId::new("r").unwrap() },
        Record::Committed { number: ActNumber::new(1) },
    ];
    driver.perform(&mut world, records.into_iter().map(Action::Record).collect());
    let counts: Vec<u64> = driver
        .pending
        .into_iter()
        .map(|(_, event)| match event {
            Event::Recorded { count } => count,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(counts, [1, 2]);
}

#[test]
fn stop_is_sent_before_it_is_recorded() {
    let mut mission = mission_with(MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() });
    let mut world = Silent::new(99, Filed::AtOnce);
    world.once_it_sends = Some(Event::StopRequested { rest: Rest::InPlace, by: None });
    at_once(drive(&mut mission, &mut world)).unwrap();
    assert_eq!(world.stops.get(..2), Some(&[Stopping::Sent, Stopping::Recorded][..]), "{:?}", world.told);
}
