//! An hour of virtual time with a hundred robots and a thousand acts: the scheduler's memory does not grow.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test fails by panicking and may print")]

use downbeat_mission::{Action, Event, Mission, MissionOptions, Participant, Progress, Rest};
use downbeat_plan::{Choreography, DeviceScript, Plan, Requirements, RobotPlan, Way};
use downbeat_robot::simulated::{Outgoing, Settings, SimulatedRobot};
use downbeat_robot::{Input, LinkId};
use urrcp::{
    ControlType, DeviceId, InitializationBlock, Millis, RobotId, Script, Server, Setpoint, Span, Step,
    StopCondition, Timestamp,
};

const ROBOTS: usize = 100;
const HOUR: Span = Span::from_millis(3_600_000);
const BEGIN: Timestamp<Server> = Timestamp::from_nanos(1_767_225_600_000_000_000);
const LINK: LinkId = LinkId(0);

fn block(id: usize) -> InitializationBlock {
    let json = format!(
        r#"{{"id": "r{id}", "api_version": "1", "reports": true, "devices": [{{"id": "d", "name": "d", "script_queue": 2,
        "available_control_types": {{
        "position": {{"min_value": 0, "max_value": 90, "granularity": 1}},
        "script": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 20}}}}}}]}}"#
    );
    serde_json::from_str(&json).unwrap()
}

/// Returns two acts of 3.5 s that alternate forever.
fn choreography() -> Choreography {
    let step = |i: u32| Step {
        offset: Millis::new(f64::from(i) * 500.0).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, f64::from(i)),
        stop_condition: None,
    };
    let stop_condition = StopCondition { pending: None, running: Millis::new(2_000.0).ok() };
    let script = DeviceScript {
        device: DeviceId::new("d").unwrap(),
        start: Millis::ZERO,
        stop_condition,
        script: Script::new((0..8).map(step).collect()).unwrap(),
        rest: Span::ZERO,
    };
    let robot =
        |id| RobotPlan { robot: RobotId::new(format!("r{id}")).unwrap(), scripts: vec![script.clone()] };
    let act = |next| {
        let mut act = Choreography::of_plan(Plan {
            scenario: "hour".into(),
            start_tolerance: Span::from_millis(10),
            lead: None,
            stop_condition,
            robots: (0..ROBOTS).map(robot).collect(),
        })
        .acts
        .remove(0);
        act.name = format!("to {next}");
        act.next = Way::Act(next);
        act
    };
    Choreography {
        scenario: "hour".into(),
        acts: vec![act(1), act(0)],
        requirements: Requirements::default(),
    }
}

struct World {
    mission: Mission,
    robots: Vec<SimulatedRobot>,
    acts: usize,
    recorded: u64,
}

impl World {
    fn perform(&mut self, now: Timestamp<Server>, actions: Vec<Action>) {
        for action in actions {
            match action {
                Action::Send { robot, message, .. } => {
                    self.robots[robot.get()].receive(now.assume_clock(), LINK, Input::Message(message));
                }
                Action::Tell(Progress::ActEnded { .. }) => self.acts += 1,
                Action::Record(record) if record.is_durable() => {
                    self.recorded += 1;
                    self.tell(now, Event::Recorded { count: self.recorded });
                }
                _ => {}
            }
        }
    }

    fn tell(&mut self, now: Timestamp<Server>, event: Event) {
        let actions = self.mission.handle(now, event);
        self.perform(now, actions);
    }

    fn round(&mut self, now: Timestamp<Server>) {
        let mut out = Vec::new();
        for robot in 0..self.robots.len() {
            self.robots[robot].advance(now.assume_clock(), &mut out);
            drop(self.robots[robot].take_log());
            for outgoing in out.drain(..) {
                if let Outgoing::Message { message, .. } = outgoing {
                    self.tell(now, Event::Received { robot: robot.into(), message });
                }
            }
        }
        let due = self.mission.advance(now);
        self.perform(now, due);
    }

    fn next(&self) -> Option<Timestamp<Server>> {
        let robots = self.robots.iter().filter_map(SimulatedRobot::next_wakeup);
        robots.map(Timestamp::assume_clock::<Server>).chain(self.mission.next_wakeup()).min()
    }
}

/// Returns the resident memory of this process, in kilobytes.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn memory_does_not_grow_during_second_half_of_hour_long_mission() {
    let participants = (0..ROBOTS).map(|id| Participant::new(block(id).id, Some(block(id)))).collect();
    let mission = Mission::new(choreography(), participants, MissionOptions::default(), BEGIN).unwrap();
    let robots = (0..ROBOTS).map(|id| SimulatedRobot::new(block(id), Settings::default())).collect();
    let mut world = World { mission, robots, acts: 0, recorded: 0 };
    for robot in 0..ROBOTS {
        world.tell(BEGIN, Event::LinkUp { robot: robot.into() });
    }
    let (mut now, mut half) = (BEGIN, None);
    let mut after = None;
    while world.mission.outcome().is_none() {
        if now >= BEGIN + HOUR / 2 {
            half.get_or_insert_with(|| (resident(), world.acts));
        }
        if now >= BEGIN + HOUR && after.is_none() {
            // Before the report is created.
            after = Some(resident());
            world.tell(now, Event::StopRequested { rest: Rest::InPlace, by: None });
        }
        world.round(now);
        now = world.next().map_or(now, |next| next.max(now));
    }
    let ((before, acts), after) = (half.unwrap(), after.unwrap());
    println!("after {acts} acts {before} KB, after {} acts {after} KB", world.acts);
    assert!(world.acts > 1_000, "{} acts", world.acts);
    // The memory that an allocator holds in reserve varies slightly.
    assert!(after < before + before / 20 + 2_000, "{before} KB grew to {after} KB");
}
