//! A thousand simulated robots in one process over loopback TCP.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test fails by panicking and may print")]

use downbeat::link::{Endpoint, LinkEncoding, Security};
use downbeat::mission::{Mission, MissionOptions, Participant};
use downbeat::server_clock::ServerClock;
use downbeat_robot::simulated::{Settings, SimulatedRobot};
use downbeat_robot::{Host, HostOptions, serve};
use downbeat_scripts::{DeviceScript, Plan, RobotPlan};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use urrcp::{
    ControlType, DeviceId, InitializationBlock, Millis, RobotId, Script, Setpoint, Span, Step, StopCondition,
};

const ROBOTS: usize = 1_000;

fn block(id: usize) -> InitializationBlock {
    let json = format!(
        r#"{{"id": "r{id}", "api_version": "1", "reports": true, "devices": [{{"id": "d", "name": "d", "available_control_types": {{
        "position": {{"min_value": 0, "max_value": 90, "granularity": 1}},
        "script": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 20}}}}}}]}}"#
    );
    serde_json::from_str(&json).unwrap()
}

fn plan() -> Plan {
    let step = |i: u32| Step {
        offset: Millis::new(f64::from(i) * 50.0).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, f64::from(i)),
        stop_condition: None,
    };
    let stop_condition = StopCondition { pending: None, running: Millis::new(10_000.0).ok() };
    let script = DeviceScript {
        device: DeviceId::new("d").unwrap(),
        start: Millis::ZERO,
        stop_condition,
        script: Script::new((0..20).map(step).collect()).unwrap(),
        rest: Span::ZERO,
    };
    let robot =
        |id| RobotPlan { robot: RobotId::new(format!("r{id}")).unwrap(), scripts: vec![script.clone()] };
    Plan {
        scenario: "crowd".into(),
        // A noisy machine may delay any answer: this test only checks that every robot takes part.
        start_tolerance: Span::from_millis(1_000),
        lead: None,
        stop_condition,
        robots: (0..ROBOTS).map(robot).collect(),
    }
}

#[test]
fn thousand_robots_over_tcp_prepare_start_and_report_without_failure() {
    downbeat::open_files::raise_limit();
    let machines = (0..ROBOTS).map(|id| SimulatedRobot::new(block(id), Settings::default())).collect();
    let host = Host::start(machines, HostOptions::default()).unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let report = runtime.block_on(async {
        let mut endpoints = Vec::new();
        for index in 0..ROBOTS {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let port = listener.local_addr().unwrap().port();
            endpoints.push(Endpoint::Tcp {
                host: "127.0.0.1".into(),
                port,
                encoding: LinkEncoding::default(),
                security: Security::Plain,
            });
            tokio::spawn(serve(listener, host.handle(), index));
        }
        let clock = ServerClock::anchored(Span::ZERO);
        let participants = (0..ROBOTS).map(|id| Participant::new(block(id).id, Some(block(id)))).collect();
        let options = MissionOptions { patience: Span::from_millis(60_000), ..MissionOptions::default() };
        let mission = Mission::of_plan(plan(), participants, options, clock.now()).unwrap();
        let (_operator, said) = mpsc::channel(1);
        downbeat::run::run(mission, endpoints, clock, said, |_, _| {}).await
    });
    runtime.shutdown_background();
    assert!(report.is_done(), "{}: {:?}", report.outcome, report.failures.first());
    assert!(report.robots.iter().all(|robot| robot.steps_done == 20 && robot.started == 1));
    println!("{ROBOTS} robots: lead {}, spread {}", report.lead.unwrap().total(), report.spread.unwrap());
}
