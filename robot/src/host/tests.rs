//! Tests robots on the real clock: which events must occur, and in which order. A separate benchmark measures how precisely they occur.

use std::path::PathBuf;

use urrcp::{
    AvailabilityRequest, Command, ControlRequest, ControlResponse, ControlType, DeviceId, ErrorCode,
    InitializationBlock, Millis, RequestId, Script, Server, Setpoint, Status, Step, Timestamp,
};

use super::outbox::MESSAGES_MAX;
use super::*;
use crate::clock::HostClock;
use crate::refusals::Reason;
use crate::simulated::{Fault, Settings, SimulatedRobot};
use crate::tolerance::Tolerance;

const ARM: &str = r#"{"id": "arm", "name": "arm", "available_control_types": {
    "position": {"min_value": 0, "max_value": 90, "granularity": 1},
    "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": STEPS}}}"#;

/// Returns `count` simulated robots, each with one arm. They tolerate delays of an hour, so that the tests pass even on a slow machine.
pub(crate) fn arms(count: usize, settings: &Settings) -> Vec<SimulatedRobot> {
    arms_with_steps(count, 4, settings)
}

/// Like [`arms`], with scripts of up to `steps` steps.
pub(crate) fn arms_with_steps(count: usize, steps: u32, settings: &Settings) -> Vec<SimulatedRobot> {
    let arm = ARM.replace("STEPS", &steps.to_string());
    let block = |i| format!(r#"{{"id": "r{i}", "api_version": "1", "reports": true, "devices": [{arm}]}}"#);
    let block = |i| serde_json::from_str::<InitializationBlock>(&block(i)).unwrap();
    let robot = |i| SimulatedRobot::new(block(i), settings.clone()).tolerating(Tolerance::AN_HOUR);
    (0..count).map(robot).collect()
}

/// Time from sending a request to its start, in milliseconds. It is so long that the robot receives the request before the start, however
/// busy the machine is.
pub(crate) const LEAD_MS: f64 = 3_000.0;

/// Returns a script that moves the arm to 45, 0 and 45 and starts `lead_ms` from now. It is a little faster than the script in the paper
/// on the protocol.
pub(crate) fn paper(lead_ms: f64) -> Message {
    let step = |millis, value| Step {
        offset: Millis::new(millis).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, value),
        stop_condition: None,
    };
    let steps = vec![step(0.0, 45.0), step(20.0, 0.0), step(40.0, 45.0)];
    let now: Timestamp<Server> = HostClock::anchored().now().assume_clock();
    Message::ControlRequest(ControlRequest {
        timestamp: Some(now),
        time_offset_to_start: Some(Millis::new(lead_ms).unwrap()),
        request_id: Some(RequestId::new("wave").unwrap()),
        ..ControlRequest::immediate(
            DeviceId::new("arm").unwrap(),
            Command::Script(Script::new(steps).unwrap()),
        )
    })
}

/// A log file that only one test uses. The file is deleted when this value is dropped.
pub(crate) struct LogFile(pub(crate) PathBuf);

impl LogFile {
    pub(crate) fn new(test: &str) -> Self {
        Self(std::env::temp_dir().join(format!("downbeat-robot-{}-{test}.jsonl", std::process::id())))
    }

    pub(crate) fn lines(&self) -> Vec<serde_json::Value> {
        let text = std::fs::read_to_string(&self.0).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }
}

impl Drop for LogFile {
    fn drop(&mut self) {
        let _never_written = std::fs::remove_file(&self.0);
    }
}

async fn response(link: &mut RobotLink) -> ControlResponse {
    match link.recv().await {
        Some(LinkEvent::Message(Message::ControlResponse(response))) => response,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn robot_starts_at_the_set_time_never_early_and_logs_its_steps() {
    let file = LogFile::new("starts");
    let options = HostOptions { log: Some(file.0.clone()), ..HostOptions::default() };
    let host = Host::start(arms(1, &Settings::default()), options).unwrap();
    let mut link = host.handle().connect(0).unwrap();
    link.send(paper(LEAD_MS));
    for expected in [Status::Accepted, Status::Started, Status::Ok] {
        assert_eq!(response(&mut link).await.status, expected);
    }
    host.stop();
    let lines = file.lines();
    let values: Vec<_> = lines.iter().map(|line| line["value"].as_f64().unwrap()).collect();
    assert_eq!(values, [45.0, 0.0, 45.0]);
    for line in &lines {
        assert_eq!(line["robot"], "r0");
        assert!(line["set_at"].as_str() >= line["due"].as_str(), "early: {line}");
    }
}

#[tokio::test]
async fn hash_computed_outside_the_precise_thread_is_compared_and_echoed() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let mut link = host.handle().connect(0).unwrap();
    let Message::ControlRequest(mut request) = paper(60_000.0) else { panic!() };
    request.content_hash = Some(Command::ReadSensor.content_hash());
    link.send(Message::ControlRequest(ControlRequest { request_id: None, ..request.clone() }));
    assert_eq!(response(&mut link).await.error.unwrap().code, ErrorCode::Malformed);
    request.content_hash = Some(request.command.content_hash());
    link.send(Message::ControlRequest(request.clone()));
    assert_eq!(response(&mut link).await.content_hash, request.content_hash);
}

#[tokio::test]
async fn many_robots_due_at_the_same_instant_all_start() {
    let file = LogFile::new("many");
    let options = HostOptions { log: Some(file.0.clone()), ..HostOptions::default() };
    let host = Host::start(arms(300, &Settings::default()), options).unwrap();
    let mut links: Vec<_> = (0..300).map(|i| host.handle().connect(i).unwrap()).collect();
    let request = paper(LEAD_MS);
    links.iter().for_each(|link| link.send(request.clone()));
    for link in &mut links {
        for expected in [Status::Accepted, Status::Started, Status::Ok] {
            assert_eq!(response(link).await.status, expected);
        }
    }
    host.stop();
    assert_eq!(file.lines().len(), 900);
}

#[tokio::test]
async fn host_counts_actions_of_its_robots_and_responds_while_running() {
    let host = Host::start(arms(2, &Settings::default()), HostOptions::default()).unwrap();
    let (handle, figures) = (host.handle(), host.figures());
    let mut link = handle.connect(1).unwrap();
    link.send(paper(LEAD_MS));
    while response(&mut link).await.status != Status::Ok {}
    let [idle, busy] = figures.robots() else { panic!("two robots") };
    let counts = busy.counts();
    assert_eq!((counts.held, counts.started, counts.ended, counts.failed), (0, 1, 1, 0));
    assert_eq!((busy.steps(), busy.connections(), busy.hardware_answers()), (3, 1, true));
    assert_eq!((idle.counts(), idle.steps(), idle.connections()), (crate::Counts::default(), 0, 0));
    assert!(figures.wake_up.cumulated().last() > Some(&0), "it woke for the steps");
    drop(link);
    assert!(handle.answers_within(Duration::from_secs(60)).await);
    assert_eq!(busy.connections(), 0, "the link was dropped before");
    host.stop();
    assert!(!handle.answers_within(Duration::from_secs(60)).await);
}

#[tokio::test]
async fn connection_to_unknown_robot_or_stopped_host_is_refused() {
    let host = Host::start(arms(2, &Settings::default()), HostOptions::default()).unwrap();
    let handle = host.handle();
    assert_eq!(handle.robots().len(), 2);
    assert!(handle.connect(2).is_none());
    let mut link = handle.connect(1).unwrap();
    host.stop();
    assert!(link.recv().await.is_none());
    assert!(handle.connect(1).is_none());
}

#[tokio::test]
async fn robot_with_disconnect_fault_closes_the_connection_after_acceptance() {
    let settings = Settings { fault: Some(Fault::Disconnect), ..Settings::default() };
    let host = Host::start(arms(1, &settings), HostOptions::default()).unwrap();
    let mut link = host.handle().connect(0).unwrap();
    link.send(paper(60_000.0));
    assert_eq!(response(&mut link).await.status, Status::Accepted);
    assert!(matches!(link.recv().await, Some(LinkEvent::Closed)));
    assert!(link.recv().await.is_none());
}

#[tokio::test]
async fn peer_that_does_not_read_is_disconnected_without_harm_to_others() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let mut deaf = host.handle().connect(0).unwrap();
    let ping = Message::AvailabilityRequest(AvailabilityRequest::default());
    for _ in 0..=MESSAGES_MAX {
        deaf.send(ping.clone());
    }
    let mut other = host.handle().connect(0).unwrap();
    other.send(ping);
    assert!(matches!(other.recv().await, Some(LinkEvent::Message(_))));
    let mut waiting = 0;
    while deaf.recv().await.is_some() {
        waiting += 1;
    }
    assert_eq!(waiting, MESSAGES_MAX, "only the earlier messages");
}

#[tokio::test]
async fn stranger_with_too_many_unread_messages_is_disconnected_and_counted() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let stranger = Peer::at("192.0.2.7:1000".parse().unwrap());
    let mut deaf = host.handle().connect_as(0, stranger).unwrap();
    let mut other = host.handle().connect(0).unwrap();
    let ping = Message::AvailabilityRequest(AvailabilityRequest::default());
    for _ in 0..8_000 {
        deaf.send(ping.clone());
    }
    other.send(ping);
    assert!(matches!(other.recv().await, Some(LinkEvent::Message(_))));
    let mut waiting = 0;
    while deaf.recv().await.is_some() {
        waiting += 1;
    }
    assert!((4_000..5_000).contains(&waiting), "about a mebibyte of short answers: {waiting}");
    assert_eq!(host.refusals().iter().collect::<Vec<_>>(), [(Reason::Unread, 1)]);
}

#[tokio::test]
async fn session_belongs_to_the_proven_name_of_the_peer_that_claims_it() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let named = |name: &str| {
        let peer = Peer::at("192.0.2.7:1000".parse().unwrap()).with_proof(proof(name));
        host.handle().connect_as(0, peer).unwrap()
    };
    let claim = || {
        let session = urrcp::SessionId::new("show").ok();
        Message::AvailabilityRequest(AvailabilityRequest { session, ..AvailabilityRequest::default() })
    };
    let (mut desk, mut other, mut again) = (named("desk"), named("other"), named("desk"));
    for (link, status) in [(&mut desk, Status::Ok), (&mut other, Status::Failed), (&mut again, Status::Ok)] {
        link.send(claim());
        let Some(LinkEvent::Message(Message::AvailabilityResponse(response))) = link.recv().await else {
            panic!()
        };
        assert_eq!(response.status, status);
    }
    assert_eq!(host.refusals().count(Reason::Busy), 1);
    // Inquiries and commands of another session are not answered either.
    let session = urrcp::SessionId::new("show").ok();
    other.send(Message::Inquiry(urrcp::Inquiry { session, ..urrcp::Inquiry::default() }));
    let Some(LinkEvent::Message(Message::InquiryResponse(answer))) = other.recv().await else { panic!() };
    assert_eq!(answer.error.map(|error| error.code), Some(ErrorCode::Busy));
    other.send(paper(60_000.0));
    assert_eq!(response(&mut other).await.error.map(|error| error.code), Some(ErrorCode::Busy));
    assert_eq!(host.refusals().count(Reason::Busy), 3);
}

/// Returns the proof of identity of an operator with the roles `observe` and `drive`.
fn proof(name: &str) -> urrcp::Proof {
    urrcp::Proof {
        name: urrcp::Label::new(name).unwrap(),
        roles: [urrcp::Role::Observe, urrcp::Role::Drive].into_iter().collect(),
        serial: None,
    }
}

#[tokio::test]
async fn log_write_failure_is_reported_and_the_robots_continue() {
    let options = HostOptions::default().with_log("/dev/full".into());
    let mut host = Host::start(arms(1, &Settings::default()), options).unwrap();
    let lost = host.log_lost().unwrap();
    assert!(host.log_lost().is_none(), "to be taken once");
    let mut link = host.handle().connect(0).unwrap();
    link.send(paper(LEAD_MS));
    for expected in [Status::Accepted, Status::Started, Status::Ok] {
        assert_eq!(response(&mut link).await.status, expected);
    }
    let error = tokio::time::timeout(Duration::from_secs(60), lost).await.unwrap().unwrap();
    assert!(error.to_string().starts_with("cannot write the log /dev/full: "), "{error}");
    link.send(paper(60_000.0));
    assert_eq!(response(&mut link).await.status, Status::Ok, "the first again, which has ended");
}

#[test]
fn host_does_not_start_with_an_unwritable_log() {
    let options = HostOptions::default().with_log("/no/such/folder/log".into());
    let error = Host::start(arms(1, &Settings::default()), options).unwrap_err();
    assert!(matches!(&error, HostError::Log { path, .. } if path.starts_with("/no")), "{error}");
}

#[tokio::test]
async fn host_without_a_log_cannot_lose_it() {
    let mut host = Host::start(arms(2, &Settings::default()), HostOptions::default()).unwrap();
    assert!(host.log_lost().is_none());
    assert_eq!(host.handle().robots().len(), 2);
    assert!(std::sync::Arc::ptr_eq(&host.figures(), &host.handle().figures()));
    host.handle().refusals().note(Reason::Busy, &Peer::in_process());
    assert_eq!(host.refusals().count(Reason::Busy), 1, "they are the same");
}

#[tokio::test]
async fn connections_are_counted_per_robot_until_they_are_dropped() {
    let host = Host::start(arms(2, &Settings::default()), HostOptions::default()).unwrap();
    let (handle, figures) = (host.handle(), host.figures());
    let links = [handle.connect(0), handle.connect(0), handle.connect(1)];
    let counted = async || {
        assert!(handle.answers_within(Duration::from_secs(60)).await);
        [0, 1].map(|robot| figures.robots()[robot].connections())
    };
    assert_eq!(counted().await, [2, 1]);
    let [first, _second, third] = links;
    drop((first, third));
    assert_eq!(counted().await, [1, 0]);
}
