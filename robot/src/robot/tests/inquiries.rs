//! Tests inquiries: messages that ask for states, and that start, stop, move and claim nothing.

use urrcp::{DeviceReport, Inquiry, InquiryResponse, RequestReport, RequestState, SessionId};

use super::*;
use crate::plans::PlanEvent;

fn names(ids: &[&str]) -> Vec<RequestId> {
    ids.iter().map(|id| RequestId::new(*id).unwrap()).collect()
}

fn about(ids: &[&str]) -> Inquiry {
    Inquiry { requests: names(ids), ..Inquiry::default() }
}

fn session(name: &str) -> Option<SessionId> {
    Some(SessionId::new(name).unwrap())
}

impl Bench {
    fn inquire_on(&mut self, link: LinkId, inquiry: Inquiry) -> InquiryResponse {
        let before = self.out.len();
        self.robot.handle(self.now, link, Input::Message(Message::Inquiry(inquiry)), &mut self.out);
        match self.out.get(before) {
            Some(Output::Send { link: to, message: Message::InquiryResponse(response) }) if *to == link => {
                response.clone()
            }
            other => panic!("{other:?}"),
        }
    }

    fn inquire(&mut self, inquiry: Inquiry) -> InquiryResponse {
        self.inquire_on(LINK, inquiry)
    }

    /// Returns the robot's report about one request.
    fn state(&mut self, id: &str) -> RequestReport {
        let [report] = &self.inquire(about(&[id])).requests[..] else { panic!() };
        assert_eq!(report.request_id.as_str(), id);
        report.clone()
    }
}

fn paper() -> Command {
    script(ControlType::Position, &PAPER)
}

#[test]
fn script_starts_with_its_first_value_or_the_movement_to_it() {
    for (device, started) in [("arm", 1_500), ("ramp", 1_000)] {
        let mut bench = Bench::new();
        bench.request(timed(
            device,
            "a",
            1_000.0,
            script(ControlType::Position, &[(500.0, 20.0), (800.0, 30.0)]),
        ));
        bench.until(1_200);
        let told = bench.state("a");
        let begun = (RequestState::Running, Some(0), Some(at(started)).filter(|at| *at <= bench.now));
        assert_eq!((told.state, told.steps_done, told.event_timestamp), begun, "{device}");
        bench.until(2_000);
        assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
        let report = bench.responses().into_iter().find(|report| report.status == Status::Started).unwrap();
        assert_eq!(
            (report.event_timestamp, &report.status_value),
            (Some(at(started)), &StatusValue::Number(20.0))
        );
        assert_eq!(bench.state("a").event_timestamp, Some(at(started)));
    }
}

#[test]
fn script_that_ends_before_its_first_value_has_not_started() {
    let mut bench = Bench::new();
    let leased = timed("arm", "a", 100.0, script(ControlType::Position, &[(500.0, 20.0)]));
    bench.request(ControlRequest { stop_condition: lease(5_000.0, 300.0), ..leased });
    bench.until(1_000);
    assert_eq!(bench.statuses(), ["Accepted", "Failed link_lost"]);
    let told = bench.state("a");
    assert_eq!((told.event_timestamp, told.steps_done), (None, Some(0)));
    assert!(told.error.unwrap().message.as_str().starts_with("the running lease"));
    assert!(bench.values().is_empty());
}

#[test]
fn request_is_unknown_then_held_then_running_then_ended() {
    let mut bench = Bench::new();
    assert_eq!(bench.state("a"), RequestReport::new(names(&["a"]).remove(0), RequestState::Unknown));
    let hashed =
        ControlRequest { content_hash: Some(paper().content_hash()), ..timed("arm", "a", 1_000.0, paper()) };
    bench.request(hashed);
    let known = RequestReport { content_hash: Some(paper().content_hash()), ..bench.state("x") };
    let known = RequestReport { request_id: names(&["a"]).remove(0), ..known };
    let planned = RequestReport { start_timestamp: Some(at(1_000)), ..known.clone() };
    assert_eq!(bench.state("a"), RequestReport { state: RequestState::Held, ..planned.clone() });
    bench.until(2_500);
    let running = RequestReport {
        state: RequestState::Running,
        event_timestamp: Some(at(1_000)),
        steps_done: Some(2),
        late_steps: Some(0),
        ..planned
    };
    assert_eq!(bench.state("a"), running);
    bench.until(4_000);
    let (state, start_timestamp, steps_done) = (RequestState::Ended, None, Some(3));
    assert_eq!(bench.state("a"), RequestReport { state, start_timestamp, steps_done, ..running });
}

#[test]
fn ended_request_is_reported_with_its_outcome_and_actual_start() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "refused", 100.0, script(ControlType::Position, &[(0.0, 91.0)])));
    bench.request(timed("arm", "a", 1_000.0, paper()));
    bench.now = at(1_030);
    bench.robot.advance(bench.now, &mut bench.out);
    bench.until(1_500);
    let stop = ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::cancel()));
    bench.request(ControlRequest { request_id: names(&["stop"]).pop(), ..stop });
    let code = |report: RequestReport| report.error.map(|error| error.code);
    let ended = bench.state("a");
    assert_eq!((ended.state, ended.event_timestamp), (RequestState::Ended, Some(at(1_030))));
    assert_eq!((ended.steps_done, code(ended)), (Some(1), Some(ErrorCode::Cancelled)));
    let refused = bench.state("refused");
    assert_eq!((refused.state, refused.event_timestamp), (RequestState::Ended, None));
    assert_eq!(code(refused), Some(ErrorCode::OutOfRange));
    let stop = bench.state("stop");
    assert_eq!((stop.state, code(stop)), (RequestState::Ended, None));
}

#[test]
fn robot_without_reports_still_answers_inquiries() {
    let mut bench = Bench::new();
    let block = BLOCK.replace(r#""reports": true"#, r#""reports": false"#);
    bench.robot = Robot::new(serde_json::from_str(&block).unwrap());
    bench.request(timed("arm", "a", 1_000.0, paper()));
    bench.until(1_500);
    assert_eq!(bench.state("a").state, RequestState::Running);
    bench.until(4_000);
    assert_eq!(bench.state("a").event_timestamp, Some(at(1_000)));
    assert_eq!(bench.statuses(), ["Accepted"]);
}

#[test]
fn response_keeps_the_inquiry_order_and_states_room_of_known_devices() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, paper()));
    bench.until(5);
    let devices = ["wheel", "leg", "arm"].map(|id| DeviceId::new(id).unwrap()).to_vec();
    let timestamp = Some(at(1).assume_clock());
    let answer = bench.inquire(Inquiry { devices, timestamp, ..about(&["b", "a", "b"]) });
    let states: Vec<_> = answer.requests.iter().map(|report| report.state).collect();
    assert_eq!(states, [RequestState::Unknown, RequestState::Held, RequestState::Unknown]);
    let report =
        |id: &str, position| DeviceReport { device_id: DeviceId::new(id).unwrap(), room: 1, position };
    assert_eq!(answer.devices, [report("wheel", None), report("arm", Some(10.0))]);
    assert_eq!((answer.status, answer.originate_timestamp), (Status::Ok, timestamp));
    assert_eq!((answer.receive_timestamp, answer.timestamp), (at(5), at(5)));
}

#[test]
fn inquiry_renews_only_the_leases_of_its_own_party() {
    for (link, values) in [(LINK, 1), (LinkId(2), 0)] {
        let mut bench = Bench::new();
        let mut request = timed("arm", "a", 500.0, script(ControlType::Position, &[(0.0, 45.0)]));
        request.stop_condition = lease(300.0, 300.0);
        bench.request(request);
        for millis in [200, 400, 600] {
            bench.until(millis);
            bench.inquire_on(link, Inquiry::default());
        }
        bench.until(2_000);
        assert_eq!(bench.values().len(), values);
    }
}

#[test]
fn inquiry_shortens_pending_leases_of_named_requests_and_extends_none() {
    let mut bench = Bench::new();
    for (id, start, pending) in [("a", 5_000.0, 2_000.0), ("b", 8_000.0, 100.0)] {
        let request = timed("arm", id, start, script(ControlType::Position, &[(0.0, 45.0)]));
        bench.request(ControlRequest { stop_condition: lease(pending, 9_000.0), ..request });
    }
    bench.request(timed("wheel", "c", 5_000.0, script(ControlType::Speed, &[(0.0, 0.0)])));
    bench.request(timed("ramp", "d", 5_000.0, script(ControlType::Position, &[(0.0, 9.0)])));
    bench.until(50);
    let shorter = Inquiry { pending_lease: Millis::new(300.0).ok(), ..about(&["a", "b", "c", "x"]) };
    bench.inquire(shorter);
    bench.until(9_000);
    let lost: Vec<_> = bench.responses().into_iter().filter(|r| r.status == Status::Failed).collect();
    let lost: Vec<_> =
        lost.iter().map(|r| (r.request_id.as_ref().unwrap().as_str(), r.event_timestamp.unwrap())).collect();
    assert_eq!(lost, [("b", at(150)), ("a", at(350)), ("c", at(350))]);
    assert_eq!(bench.values(), [(5_000, 9.0)], "not named");
}

#[test]
fn pending_lease_ends_at_the_stated_time_however_late_the_inquiry_is() {
    let held = || {
        let mut bench = Bench::new();
        let request = timed("arm", "a", 1_000.0, paper());
        bench.request(ControlRequest { stop_condition: lease(5_000.0, 9_000.0), ..request });
        // Sent to limit the pending lease to 100 ms, up to 900, and 300 ms while running.
        bench.until(800);
        let pending_lease = Millis::new(400.0).ok();
        bench.inquire(Inquiry { pending_lease, pending_until: Some(at(900)), ..about(&["a"]) });
        bench
    };
    let mut silent = held();
    silent.until(5_000);
    assert_eq!(silent.values(), []);
    let lost = silent.responses().into_iter().find(|response| response.status == Status::Failed).unwrap();
    assert_eq!(lost.event_timestamp, Some(at(900)));

    let mut heard = held();
    heard.until(850);
    heard.inquire(Inquiry::default());
    heard.until(5_000);
    assert_eq!(heard.values(), [], "a message that does not name it lifts nothing");

    let mut asked = held();
    asked.until(850);
    asked.inquire(about(&["a"]));
    asked.until(5_000);
    assert_eq!(asked.values(), [], "an inquiry without an instant lifts nothing");

    let mut committed = held();
    committed.until(850);
    committed.inquire(Inquiry { pending_until: Some(at(2_000)), ..about(&["a"]) });
    committed.until(5_000);
    assert_eq!(committed.values().len(), 3);
}

#[test]
fn request_unconfirmed_by_its_pending_until_never_starts() {
    let requested = |came: i64, pending_until: i64| {
        let mut bench = Bench::new();
        bench.until(came);
        let request = timed("arm", "a", 1_000.0 - came as f64, paper());
        bench.request(ControlRequest { pending_until: Some(at(pending_until)), ..request });
        bench
    };
    // The robot receives messages from the server, but no inquiry confirms the request.
    let mut heard = requested(10, 900);
    heard.until(850);
    heard.inquire(Inquiry::default());
    heard.until(5_000);
    assert_eq!(heard.values(), []);
    let lost = heard.responses().pop().unwrap();
    assert_eq!((&lost.status, lost.event_timestamp), (&Status::Failed, Some(at(900))));

    let mut late = requested(900, 900);
    let refused = late.responses().pop().unwrap();
    assert_eq!(refused.error.as_ref().map(|error| &error.code), Some(&ErrorCode::Late));
    late.until(5_000);
    assert_eq!(late.values(), []);

    let mut confirmed = requested(10, 900);
    confirmed.until(850);
    confirmed.inquire(Inquiry { pending_until: Some(at(2_000)), ..about(&["a"]) });
    confirmed.until(5_000);
    assert_eq!(confirmed.values().len(), 3);
}

#[test]
fn overtaken_inquiry_on_a_connection_does_not_undo_a_later_one() {
    // Two inquiries of the same instant are handled in the order of their arrival.
    for (overtaken_on, first, plays) in [(LINK, 20, true), (LINK, 10, false), (LinkId(9), 20, false)] {
        let mut bench = Bench::new();
        let of_session = ControlRequest { session: session("show"), ..timed("arm", "a", 1_000.0, paper()) };
        bench.request(of_session);
        let asked = |millis: i64| Inquiry {
            timestamp: Some(urrcp::Timestamp::from_nanos(millis * 1_000_000)),
            session: session("show"),
            ..about(&["a"])
        };
        bench.inquire(Inquiry { pending_until: Some(at(2_000)), ..asked(first) });
        let earlier = Inquiry { pending_until: Some(at(900)), ..asked(10) };
        bench.inquire_on(overtaken_on, earlier);
        bench.until(5_000);
        assert_eq!(!bench.values().is_empty(), plays, "{overtaken_on:?}");
    }
}

#[test]
fn inquiry_does_not_change_the_lease_of_a_running_script() {
    let mut bench = Bench::new();
    bench.request(ControlRequest {
        stop_condition: lease(9_000.0, 3_000.0),
        ..timed("arm", "a", 0.0, paper())
    });
    bench.until(10);
    bench.inquire(Inquiry { pending_lease: Some(Millis::ZERO), ..about(&["a"]) });
    bench.until(5_000);
    assert_eq!(bench.values().len(), 3);
}

#[test]
fn inquiry_does_not_shorten_leases_of_another_connection() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, paper()));
    bench.until(10);
    bench.inquire_on(LinkId(2), Inquiry { pending_lease: Some(Millis::ZERO), ..about(&["a"]) });
    bench.until(5_000);
    assert_eq!(bench.values().len(), 3);
}

#[test]
fn inquiry_of_another_session_gets_no_state_and_shortens_no_lease() {
    let mut bench = Bench::new();
    bench.request(ControlRequest { session: session("show-1"), ..timed("arm", "a", 1_000.0, paper()) });
    for other in [session("show-2"), None] {
        let devices = vec![DeviceId::new("arm").unwrap()];
        let pending_lease = Some(Millis::ZERO);
        let asks = Inquiry { session: other, devices, pending_lease, ..about(&["a"]) };
        let answer = bench.inquire_on(LinkId(2), asks);
        let error = answer.error.unwrap();
        assert_eq!((answer.status, error.code), (Status::Failed, ErrorCode::Busy));
        assert!(!error.message.contains("show-1"), "{}", error.message);
        assert!(answer.requests.is_empty() && answer.devices.is_empty());
    }
    bench.until(5_000);
    assert_eq!(bench.values().len(), 3);
}

#[test]
fn inquiry_claims_no_robot_even_after_a_session_has_ended() {
    let mut bench = Bench::new();
    bench.inquire(Inquiry { session: session("show-1"), ..Inquiry::default() });
    let claim = |bench: &mut Bench, link, name| {
        let request = AvailabilityRequest {
            session: session(name),
            timestamp: None,
            seize: false,
            revocation_list: None,
        };
        bench.robot.handle(
            bench.now,
            link,
            Input::Message(Message::AvailabilityRequest(request)),
            &mut bench.out,
        );
        match bench.out.last() {
            Some(Output::Send { message: Message::AvailabilityResponse(r), .. }) => r.status.clone(),
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(claim(&mut bench, LinkId(2), "show-2"), Status::Ok);
    bench.until(5_001);
    let answer = bench.inquire_on(LinkId(2), Inquiry { session: session("show-2"), ..Inquiry::default() });
    assert_eq!(answer.status, Status::Ok, "the robot is free");
    assert_eq!(claim(&mut bench, LINK, "show-1"), Status::Ok);
}

#[test]
fn unavailable_hardware_has_no_room_and_requests_it_ended_are_reported() {
    let mut bench = Bench::new();
    bench.robot = Robot::driven(serde_json::from_str(BLOCK).unwrap());
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench.request(timed("arm", "a", 1_000.0, paper()));
    bench.robot.hardware_lost(bench.now, "unplugged", &mut bench.out);
    let devices = vec![DeviceId::new("arm").unwrap()];
    let answer = bench.inquire(Inquiry { devices, ..about(&["a"]) });
    assert_eq!(answer.error.unwrap().code, ErrorCode::Internal);
    assert_eq!((answer.requests[0].state, answer.devices[0].room), (RequestState::Ended, 0));
}

#[test]
fn start_without_a_value_is_not_a_late_step() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &[(500.0, 45.0), (900.0, 0.0)])));
    bench.now = at(1_030);
    bench.robot.advance(bench.now, &mut bench.out);
    let begun = bench.state("a");
    assert_eq!((begun.steps_done, begun.late_steps), (Some(0), Some(0)));
    bench.until(2_000);
    assert_eq!(bench.state("a").late_steps, Some(0));
}

#[test]
fn state_of_a_driver_timed_script_follows_the_driver_reports() {
    let mut bench = planned::whole("arm");
    bench.request(timed("arm", "a", 1_000.0, paper()));
    bench.until(2_010);
    let done = |bench: &mut Bench| {
        let report = bench.state("a");
        (report.state, report.start_timestamp, report.steps_done, report.late_steps)
    };
    bench.hears(planned::P1, 1_000, PlanEvent::Began);
    assert_eq!(done(&mut bench), (RequestState::Running, Some(at(1_000)), Some(0), Some(0)));
    bench.hears(planned::P1, 1_000, PlanEvent::Step(0));
    bench.hears(planned::P1, 2_010, PlanEvent::Step(1));
    assert_eq!(done(&mut bench), (RequestState::Running, Some(at(1_000)), Some(2), Some(1)));
}

#[test]
fn room_of_a_device_is_the_free_space_in_its_queue() {
    let mut bench = Bench::new();
    let devices = vec![DeviceId::new("arm").unwrap()];
    let room = |bench: &mut Bench| {
        bench.inquire(Inquiry { devices: devices.clone(), ..Inquiry::default() }).devices[0].room
    };
    for (start, expected) in [(1_000.0, 2), (9_000.0, 1), (20_000.0, 0)] {
        assert_eq!(room(&mut bench), expected);
        bench.request(timed("arm", &start.to_string(), start, paper()));
    }
    bench.until(3_000);
    assert_eq!(room(&mut bench), 1, "the first has ended");
}

#[test]
fn position_of_a_device_is_reported_if_it_is_known() {
    let position = |bench: &mut Bench| {
        let devices = vec![DeviceId::new("arm").unwrap()];
        bench.inquire(Inquiry { devices, ..Inquiry::default() }).devices[0].position
    };
    let set = || Command::Set(Setpoint::new(ControlType::Position, 30.0));
    let mut simulated = Bench::new();
    assert_eq!(position(&mut simulated), Some(10.0), "a simulated device begins in its default state");
    simulated.request(timed("arm", "a", 1_000.0, set()));
    assert_eq!(position(&mut simulated), Some(10.0));
    simulated.until(1_000);
    assert_eq!(position(&mut simulated), Some(30.0));

    simulated.request(timed("arm", "b", 2_000.0, Command::Set(Setpoint::new(ControlType::Speed, 2.0))));
    simulated.until(2_000);
    assert_eq!(position(&mut simulated), None, "a speed takes it somewhere");

    let mut driven = Bench { robot: Robot::driven(simulated.robot.block().clone()), ..Bench::new() };
    let found = |bench: &mut Bench, at_ms| bench.robot.hardware_found(at(at_ms), &mut Vec::new());
    found(&mut driven, 0);
    assert_eq!(position(&mut driven), None, "hardware may be anywhere");
    driven.request(timed("arm", "a", 1_000.0, set()));
    driven.until(1_000);
    assert_eq!(position(&mut driven), Some(30.0));
    driven.robot.hardware_lost(at(1_500), "unplugged", &mut Vec::new());
    assert_eq!(position(&mut driven), None);
    found(&mut driven, 2_000);
    assert_eq!(position(&mut driven), None, "it may have been moved by hand");
}

#[test]
fn single_value_is_reported_like_a_script_of_one_step() {
    let mut bench = Bench::new();
    bench.request(timed("arm", "a", 1_000.0, Command::Set(Setpoint::new(ControlType::Position, 30.0))));
    let held = bench.state("a");
    assert_eq!((held.state, held.start_timestamp), (RequestState::Held, Some(at(1_000))));
    bench.until(1_000);
    assert_eq!(bench.values(), [(1_000, 30.0)]);
    let ended = bench.state("a");
    assert_eq!((ended.state, ended.steps_done, ended.late_steps), (RequestState::Ended, Some(1), Some(0)));
}
