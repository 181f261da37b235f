//! Plays one mission on a fleet: with a planned start, or with a start on receipt.

use std::sync::atomic::{AtomicUsize, Ordering};

use downbeat::drive::{Happened, LinkNumber, Urgency};
use downbeat::link::Link;
use downbeat::mission::{Event, Mission, MissionOptions, Participant, Progress};
use downbeat::server_clock::ServerClock;
use downbeat_scripts::{DeviceScript, Plan, RobotPlan};
use tokio::sync::mpsc;
use urrcp::{
    Command as Control, ControlRequest, ControlType, DeviceId, InitializationBlock, Message, Millis, RobotId,
    Script, Setpoint, Span, Status, Step, StopCondition,
};

use super::ROBOTS;
use super::fleet::{Fleet, ROBOT};
use super::witness::Witness;

/// Number of missions that failed and were repeated.
pub static REPEATED: AtomicUsize = AtomicUsize::new(0);
/// Maximum number of repetitions; more of them are an error.
const REPEATED_MAX: usize = 100;

fn script() -> Script {
    let step = |millis, value| Step {
        offset: Millis::new(millis).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, value),
        stop_condition: None,
    };
    Script::new(vec![step(0.0, 45.0), step(20.0, 0.0), step(40.0, 45.0)]).unwrap()
}

fn plan() -> Plan {
    let stop_condition = StopCondition { pending: None, running: Millis::new(2_000.0).ok() };
    let device = DeviceId::new("d").unwrap();
    let script =
        DeviceScript { device, start: Millis::ZERO, stop_condition, script: script(), rest: Span::ZERO };
    let robot =
        |id| RobotPlan { robot: RobotId::new(format!("r{id}")).unwrap(), scripts: vec![script.clone()] };
    let robots = (0..ROBOTS).map(robot).collect();
    let start_tolerance = Span::from_millis(200);
    Plan { scenario: "spread".into(), start_tolerance, lead: None, stop_condition, robots }
}

/// Plays one mission with Downbeat. Repeats it if it fails because the scheduler was delayed.
pub async fn deferred(fleet: &Fleet, witness: Option<&Witness>) {
    while !was_played(fleet, witness).await {
        REPEATED.fetch_add(1, Ordering::Relaxed);
    }
}

async fn was_played(fleet: &Fleet, witness: Option<&Witness>) -> bool {
    let block: InitializationBlock = serde_json::from_str(ROBOT).unwrap();
    let participant = |id| {
        let id = RobotId::new(format!("r{id}")).unwrap();
        Participant::new(id.clone(), Some(InitializationBlock { id, ..block.clone() }))
    };
    let clock = ServerClock::anchored(Span::ZERO);
    let participants = (0..ROBOTS).map(participant).collect();
    let mission = Mission::of_plan(plan(), participants, MissionOptions::default(), clock.now()).unwrap();
    let endpoints = (0..ROBOTS).map(|id| fleet.endpoint(id)).collect();
    let (_operator, said) = mpsc::channel(1);
    let told = |_, progress: &Progress| {
        if let (Progress::Decided { start, .. }, Some(witness)) = (progress, witness) {
            witness.attend(start.as_nanos());
        }
    };
    let report = downbeat::run::run(mission, endpoints, clock, said, told).await;
    let again = REPEATED.load(Ordering::Relaxed);
    assert!(report.is_done() || again < REPEATED_MAX, "{}: {:?}", report.outcome, report.failures);
    report.is_done()
}

/// Sends the same script to all robots at once; each starts when it receives it.
pub async fn on_receipt(fleet: &Fleet) {
    let (events, mut happened) = mpsc::channel(1_024);
    let clock = ServerClock::anchored(Span::ZERO);
    let links: Vec<_> = (0..ROBOTS)
        .map(|id| {
            let link = (id.into(), LinkNumber(id as u64));
            Link::open(link, fleet.endpoint(id), clock, events.clone(), std::time::Duration::ZERO)
        })
        .collect();
    let (mut up, mut ended) = (0, 0);
    while ended < ROBOTS {
        let Happened::OnLink { event, .. } = happened.recv().await.unwrap() else { continue };
        match *event {
            Event::LinkUp { .. } => {
                up += 1;
                if up == ROBOTS {
                    links.iter().for_each(send_at_once);
                }
            }
            Event::Received { message: Message::ControlResponse(response), .. } => {
                assert_ne!(response.status, Status::Failed, "{response:?}");
                ended += usize::from(response.status == Status::Ok);
            }
            _ => {}
        }
    }
}

fn send_at_once(link: &Link) {
    let command = Control::Script(script());
    let request = ControlRequest::immediate(DeviceId::new("d").unwrap(), command);
    link.send(Message::ControlRequest(request), Urgency::InOrder).unwrap();
}
