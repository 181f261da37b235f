//! Tests devices whose driver times scripts by itself: handing the scripts to the driver, and forwarding its reports.

use std::collections::BTreeMap;

use super::*;
use crate::PlanReportError;
use crate::plans::{Lookahead, PlanCancel, PlanEvent, PlanId, PlanPart, Then};

pub(super) const P1: PlanId = PlanId(1);
const P2: PlanId = PlanId(2);

/// Returns a robot whose driver receives the scripts of these devices ahead of time and times them by itself.
fn planned(devices: &[(&str, Lookahead)]) -> Bench {
    let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
    let mut bench = Bench { robot: Robot::driven(block).confirmed_by_its_driver(), ..Bench::new() };
    let lookahead = devices.iter().map(|(device, ahead)| (DeviceId::new(*device).unwrap(), *ahead));
    bench.robot.plans_ahead(&lookahead.collect::<BTreeMap<_, _>>());
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench
}

pub(super) fn whole(device: &str) -> Bench {
    planned(&[(device, Lookahead::Script)])
}

#[test]
fn robot_with_driver_timed_scripts_does_not_declare_pending_until() {
    assert!(planned(&[]).robot.block().pending_until);
    assert!(!whole("arm").robot.block().pending_until);
}

impl Bench {
    fn parts(&self) -> Vec<&PlanPart<urrcp::Robot>> {
        self.out.iter().filter_map(|o| if let Output::Plan(part) = o { Some(part) } else { None }).collect()
    }

    fn cancels(&self) -> Vec<(u64, Then)> {
        let cancel = |output: &Output| match output {
            Output::Cancel(PlanCancel { plan, then, .. }) => Some((plan.0, *then)),
            _ => None,
        };
        self.out.iter().filter_map(cancel).collect()
    }

    /// Reports an event to the robot as its driver would. `at_ms` is the time of the event in milliseconds.
    fn says(&mut self, id: PlanId, at_ms: i64, event: PlanEvent) -> Result<(), PlanReportError> {
        let at = at(at_ms);
        self.robot.plan_reported(self.now, id, at, &event, &mut self.out)
    }

    #[track_caller]
    pub(super) fn hears(&mut self, id: PlanId, at_ms: i64, event: PlanEvent) {
        assert_eq!(self.says(id, at_ms, event), Ok(()));
    }

    fn last(&self) -> &ControlResponse {
        self.responses().last().unwrap()
    }

    /// Sends the script from the paper on the protocol to `arm`, with a start after one second.
    fn paper(&mut self) {
        self.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER)));
    }

    fn stop_arm(&mut self, home: bool) {
        let stop = ControlRequest {
            request_id: Some(RequestId::new("stop").unwrap()),
            home,
            ..ControlRequest::immediate(DeviceId::new("arm").unwrap(), Command::Script(Script::default()))
        };
        self.request(stop);
    }
}

fn milliseconds(at: Timestamp<urrcp::Robot>) -> f64 {
    (at - Timestamp::from_nanos(BEGIN)).as_millis_f64()
}

#[test]
fn accepted_script_is_sent_whole_to_driver_with_absolute_times() {
    let mut bench = whole("arm");
    bench.paper();
    let [part] = bench.parts()[..] else { panic!("{:?}", bench.out) };
    assert_eq!((part.plan, part.first, part.is_last), (P1, 0, true));
    assert_eq!((milliseconds(part.start), milliseconds(part.begin_by)), (1_000.0, 1_050.0));
    let steps: Vec<_> = part.steps.iter().map(|step| (milliseconds(step.at), step.setpoint.value)).collect();
    let planned: Vec<_> = PAPER.iter().map(|(ms, value)| (1_000.0 + ms, *value)).collect();
    assert_eq!(steps, planned);
    bench.until(5_000);
    assert!(bench.values().is_empty(), "set by the edge as well: {:?}", bench.values());
}

#[test]
fn driver_reports_are_forwarded() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_010);
    assert_eq!(bench.statuses(), ["Accepted"], "the machine alone reports nothing");
    bench.hears(P1, 1_007, PlanEvent::Began);
    assert_eq!(bench.last().event_timestamp, Some(at(1_007)));
    bench.hears(P1, 1_008, PlanEvent::Step(0));
    bench.until(2_000);
    bench.hears(P1, 2_000, PlanEvent::Step(1));
    bench.until(3_020);
    bench.hears(P1, 3_019, PlanEvent::Done);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
    let ended = bench.last();
    assert_eq!((ended.event_timestamp, ended.steps_done), (Some(at(3_019)), Some(3)));
    assert_eq!(ended.late_steps, Some(1), "the first step");
    assert_eq!(ended.status_value, StatusValue::Number(PAPER[2].1));
    assert!(bench.robot.is_idle());
}

#[test]
fn unobserved_end_has_unknown_result_and_assumed_steps_are_not_counted() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_010);
    bench.hears(P1, 1_000, PlanEvent::AssumedRunning);
    bench.until(2_010);
    bench.hears(P1, 2_000, PlanEvent::AssumedRunning);
    bench.until(3_010);
    bench.hears(P1, 3_000, PlanEvent::AssumedDone);
    assert_eq!(bench.statuses(), ["Accepted", "Failed internal"], "nothing was observed");
    let failed = bench.last();
    assert_eq!(failed.steps_done, None, "it is unknown how many");
    let message = failed.error.as_ref().unwrap().message.to_string();
    assert_eq!(message, "the result of the script of `arm` is unknown: its driver did not observe its end");
    assert!(bench.robot.is_idle() && bench.values().is_empty(), "{:?}", bench.values());
}

#[test]
fn script_withdrawn_before_a_start_report_is_due_has_not_begun() {
    for (until, steps_done) in [(1_010, Some(0)), (1_800, None)] {
        let mut bench = whole("arm");
        bench.paper();
        bench.until(until);
        bench.stop_arm(false);
        bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
        let failed = bench.out.iter().rev().find_map(|output| match output {
            crate::robot::Output::Send { message: urrcp::Message::ControlResponse(said), .. }
                if said.status == urrcp::Status::Failed =>
            {
                Some(said.steps_done)
            }
            _ => None,
        });
        assert_eq!(failed, Some(steps_done), "after {until} ms");
    }
}

#[test]
fn assumed_end_without_assumed_start_has_unknown_result() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_410);
    bench.hears(P1, 1_400, PlanEvent::AssumedDone);
    assert_eq!(
        (bench.statuses(), bench.last().steps_done),
        (vec!["Accepted".to_owned(), "Failed internal".to_owned()], None)
    );
}

#[test]
fn observed_end_is_accepted_without_observed_start() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_010);
    bench.hears(P1, 1_000, PlanEvent::AssumedRunning);
    bench.until(3_005);
    bench.hears(P1, 3_005, PlanEvent::Done);
    assert_eq!(bench.statuses(), ["Accepted", "OK"]);
    assert_eq!(bench.last().steps_done, Some(3));
}

#[test]
fn driver_that_assumes_the_start_must_report_the_end() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_010);
    bench.hears(P1, 1_000, PlanEvent::AssumedRunning);
    bench.until(3_800);
    assert_eq!(bench.cancels(), [(1, Then::Hold)]);
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    let message = bench.last().error.as_ref().unwrap().message.to_string();
    assert!(message.ends_with("did not report its end"), "{message}");
}

#[test]
fn end_reported_early_by_driver_is_forwarded_when_script_is_over() {
    let mut bench = whole("arm");
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &[(0.0, 5.0), (500.0, 6.0)])));
    bench.until(999);
    bench.hears(P1, 999, PlanEvent::Began);
    assert_eq!(bench.statuses(), ["Accepted"]);
    bench.until(1_400);
    bench.hears(P1, 1_400, PlanEvent::Done);
    assert_eq!(bench.statuses(), ["Accepted", "Started"]);
    bench.until(1_500);
    assert_eq!(bench.last().event_timestamp, Some(at(1_400)), "as the driver says");
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
}

#[test]
fn script_without_driver_reports_is_cancelled_and_fails() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_800);
    assert_eq!(bench.cancels(), [(1, Then::Hold)]);
    assert_eq!(bench.statuses(), ["Accepted"], "whether it has ended is unknown yet");
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted", "Failed internal"]);
    let message = bench.last().error.as_ref().unwrap().message.to_string();
    assert!(message.contains("did not report its start"), "{message}");

    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_100);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.until(3_700);
    assert_eq!(bench.cancels(), [], "it may still say so");
    bench.until(3_800);
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed internal"]);
    assert_eq!(bench.last().steps_done, Some(0));
}

#[test]
fn stalled_edge_waits_for_reports_in_transit() {
    let mut bench = whole("arm");
    bench.paper();
    bench.now = at(4_900);
    bench.robot.advance(bench.now, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted"]);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.hears(P1, 3_000, PlanEvent::Done);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
}

#[test]
fn stop_and_end_are_reported_after_the_driver_has_ended_the_script() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_500);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.hears(P1, 1_000, PlanEvent::Step(0));
    bench.stop_arm(true);
    assert_eq!(bench.cancels(), [(1, Then::Slow)], "at the speed that it declares");
    assert_eq!(bench.statuses(), ["Accepted", "Started"]);
    let place = |wanted: fn(&Output) -> bool| bench.out.iter().position(wanted).unwrap();
    let cancel = place(|output| matches!(output, Output::Cancel(_)));
    let rest = place(|output| matches!(output, Output::Set(_)));
    let confirm = place(|output| matches!(output, Output::Confirm { .. }));
    assert!(cancel < rest && rest < confirm, "{:?}", bench.out);
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed cancelled"]);
    assert_eq!(bench.last().steps_done, Some(1));
    bench.robot.confirmed(bench.now, crate::confirmation::Ticket(1), &mut bench.out);
    assert_eq!(bench.last().status, Status::Ok);
}

#[test]
fn stopped_device_stays_where_its_driver_has_moved_it() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_500);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.stop_arm(false);
    assert!(bench.sets().is_empty(), "{:?}", bench.out);
    assert_eq!(bench.cancels(), [(1, Then::Hold)]);
}

#[test]
fn hardware_lost_during_cancellation_leaves_stop_unconfirmed() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_500);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.stop_arm(false);
    bench.robot.hardware_lost(bench.now, "it did not answer `cancel`", &mut bench.out);
    let failed: Vec<_> = bench.responses().iter().filter(|r| r.status == Status::Failed).cloned().collect();
    let messages: Vec<_> = failed.iter().map(|r| r.error.as_ref().unwrap().message.to_string()).collect();
    assert_eq!(messages.len(), 2, "{messages:?}");
    assert!(messages.iter().any(|m| m.contains("the hardware may not have accepted the last value")));
    assert!(messages.iter().any(|m| m.contains("the hardware may not have stopped")));
    assert!(bench.robot.is_idle());
}

#[test]
fn script_withdrawn_before_its_start_is_ended_alone() {
    let mut bench = whole("arm");
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &[(0.0, 5.0), (900.0, 6.0)])));
    bench.hears(P1, 0, PlanEvent::Began);
    bench.request(timed("arm", "b", 1_000.0, script(ControlType::Position, &PAPER)));
    bench.request(timed("arm", "withdraw", 1_000.0, Command::Script(Script::default())));
    assert_eq!(bench.cancels(), [(2, Then::Keep)]);
    bench.robot.plan_cancelled(bench.now, P2, &mut bench.out);
    bench.robot.confirmed(bench.now, crate::confirmation::Ticket(1), &mut bench.out);
    bench.until(900);
    bench.hears(P1, 900, PlanEvent::Done);
    let ends: Vec<_> = bench.responses().iter().map(|r| r.status.clone()).collect();
    assert!(ends.contains(&Status::Ok) && bench.robot.is_idle(), "{:?}", bench.statuses());
}

#[test]
fn lease_that_ends_before_the_start_cancels_the_script_at_the_driver() {
    let mut bench = whole("arm");
    let lease = StopCondition { pending: Some(Millis::new(300.0).unwrap()), running: None };
    bench.request(ControlRequest {
        stop_condition: Some(lease),
        ..timed("arm", "a", 1_000.0, script(ControlType::Position, &PAPER))
    });
    bench.until(400);
    assert_eq!(bench.cancels().len(), 1);
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted", "Failed link_lost"]);
}

#[test]
fn failure_at_the_driver_is_reported_with_its_step() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_100);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.until(2_100);
    bench.hears(P1, 2_000, PlanEvent::Step(1));
    bench.hears(P1, 2_050, PlanEvent::Failed("torque".to_owned()));
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed internal"]);
    let failed = bench.last();
    assert_eq!(failed.error.as_ref().unwrap().message.to_string(), "the hardware failed in step 3: torque");
    assert_eq!(failed.steps_done, Some(2));
    assert_eq!(bench.cancels(), [], "it has ended it by itself");
    assert!(bench.sets().iter().all(|set| set.step.is_some()), "the device stays where it is");
}

#[test]
fn failure_after_the_planned_end_is_reported() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_100);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.until(3_100);
    bench.hears(P1, 3_050, PlanEvent::Failed("torque".to_owned()));
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed internal"]);
    assert!(bench.robot.is_idle());
}

#[test]
fn script_refused_by_the_driver_fails_alone() {
    let mut bench = whole("arm");
    bench.paper();
    let error = urrcp::ControlError::new(ErrorCode::Internal, "the hardware refused a script of `arm`: no");
    bench.robot.plan_refused(bench.now, P1, 0, error, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted", "Failed internal"]);
    assert_eq!(bench.cancels(), []);
    bench.request(timed("arm", "b", 1_000.0, script(ControlType::Position, &PAPER)));
    assert_eq!(bench.last().status, Status::Accepted);
}

#[test]
fn impossible_driver_reports_are_rejected() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_100);
    for (id, at_ms, event, why) in [
        (P2, 1_000, PlanEvent::Began, "never sent to the driver"),
        (P1, 1_200, PlanEvent::Began, "in the future"),
        (P1, -50, PlanEvent::Began, "before the script was accepted"),
        (P1, 1_050, PlanEvent::Done, "progress was reported, but no start"),
        (P1, 1_050, PlanEvent::Step(0), "progress was reported, but no start"),
    ] {
        let said = bench.says(id, at_ms, event);
        assert!(said.as_ref().is_err_and(|said| said.to_string().contains(why)), "{why}: {said:?}");
    }
    bench.hears(P1, 1_000, PlanEvent::Began);
    assert!(bench.says(P1, 1_100, PlanEvent::Step(3)).is_err());
    assert_eq!(bench.statuses(), ["Accepted", "Started"]);
}

#[test]
fn driver_report_after_end_of_script_is_ignored() {
    let mut bench = whole("arm");
    bench.paper();
    bench.stop_arm(false);
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    let said = bench.out.len();
    bench.hears(P1, 0, PlanEvent::Began);
    assert_eq!(bench.out.len(), said);
}

#[test]
fn each_step_is_handed_over_one_horizon_before_its_movement() {
    let mut bench = planned(&[("arm", Lookahead::Horizon(Span::from_millis(400)))]);
    bench.paper();
    assert!(bench.parts().is_empty());
    bench.until(599);
    assert!(bench.parts().is_empty());
    bench.until(600);
    // The movement to the second step starts with the first step.
    let told = |bench: &Bench| -> Vec<_> {
        bench.parts().iter().map(|part| (part.first, part.steps.len(), part.is_last)).collect()
    };
    assert_eq!(told(&bench), [(0, 2, false)]);
    bench.until(1_000);
    bench.hears(P1, 1_000, PlanEvent::Began);
    assert!(bench.says(P1, 1_000, PlanEvent::Done).is_err(), "not all was handed over");
    bench.until(1_600);
    assert_eq!(told(&bench), [(0, 2, false), (2, 1, true)]);
    bench.until(3_000);
    bench.hears(P1, 3_000, PlanEvent::Done);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "OK"]);
}

#[test]
fn edge_stalled_past_a_start_sends_no_past_steps() {
    let mut bench = planned(&[("arm", Lookahead::Horizon(Span::from_millis(400)))]);
    bench.paper();
    bench.now = at(1_100);
    bench.robot.advance(bench.now, &mut bench.out);
    assert!(bench.parts().is_empty());
    assert_eq!(bench.statuses(), ["Accepted", "Failed late"]);
}

#[test]
fn complete_script_continues_although_the_edge_was_delayed() {
    let mut bench = whole("arm");
    bench.paper();
    bench.now = at(2_400);
    let silence = || None;
    bench.robot.check_hardware(bench.now, silence, &mut bench.out);
    bench.robot.advance(bench.now, &mut bench.out);
    assert_eq!((bench.statuses(), bench.cancels()), (vec!["Accepted".to_owned()], vec![]));
}

#[test]
fn edge_shutdown_cancels_scripts_held_by_driver() {
    let mut bench = whole("arm");
    bench.paper();
    bench.robot.shut_down(bench.now, &mut bench.out);
    assert_eq!(bench.cancels(), [(1, Then::Hold)]);
}

#[test]
fn driver_and_edge_can_time_different_devices_of_one_robot() {
    let mut bench = whole("arm");
    bench.paper();
    bench.request(timed("wheel", "w", 1_000.0, script(ControlType::Speed, &[(0.0, 3.0)])));
    bench.until(1_001);
    assert_eq!(bench.values(), [(1_000, 3.0)]);
    assert_eq!(bench.parts().len(), 1);
}

#[test]
fn inquiry_reports_steps_done_by_driver() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_100);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.hears(P1, 1_000, PlanEvent::Step(0));
    bench.until(2_100);
    bench.send(Message::Inquiry(urrcp::Inquiry {
        requests: vec![RequestId::new("a").unwrap()],
        ..urrcp::Inquiry::default()
    }));
    let Some(Output::Send { message: Message::InquiryResponse(response), .. }) = bench.out.last() else {
        panic!("{:?}", bench.out.last())
    };
    assert_eq!(response.requests[0].steps_done, Some(1), "the machine itself would be two steps on");
}

#[test]
fn late_step_reported_by_driver_is_counted_once() {
    let mut bench = whole("arm");
    bench.paper();
    // A step that is done a millisecond after its deadline is on time. Repeated reports, and reports after a later step, are ignored.
    for (at_ms, event) in [
        (1_000, PlanEvent::Began),
        (1_001, PlanEvent::Step(0)),
        (2_002, PlanEvent::Step(1)),
        (2_002, PlanEvent::Step(1)),
        (2_003, PlanEvent::Step(0)),
        (3_005, PlanEvent::Step(2)),
        (3_005, PlanEvent::Done),
    ] {
        bench.until(at_ms);
        bench.hears(P1, at_ms, event);
    }
    assert_eq!((bench.last().steps_done, bench.last().late_steps), (Some(3), Some(2)));
}

/// A robot whose arm slows down within its declared acceleration.
const LIFT: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "arm", "name": "arm", "interpolation": "linear", "available_control_types": {
     "position": {"min_value": 0, "max_value": 100, "granularity": 1},
     "acceleration": {"min_value": -400, "max_value": 400, "granularity": 1},
     "script": {"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 8}}}]}"#;

#[test]
fn driver_of_a_slowing_device_is_informed_and_receives_values() {
    let mut bench = Bench { robot: Robot::driven(serde_json::from_str(LIFT).unwrap()), ..Bench::new() };
    let lookahead = BTreeMap::from([(DeviceId::new("arm").unwrap(), Lookahead::Script)]);
    bench.robot.plans_ahead(&lookahead);
    bench.robot.hardware_found(bench.now, &mut bench.out);
    bench.request(timed("arm", "a", 0.0, script(ControlType::Position, &[(0.0, 0.0), (1_000.0, 90.0)])));
    bench.hears(P1, 0, PlanEvent::Began);
    bench.until(500);
    bench.stop_arm(false);
    assert_eq!(bench.cancels(), [(1, Then::Slow)]);
    assert!(bench.sets().iter().any(|set| matches!(set.motion, Motion::Slow { .. })), "{:?}", bench.out);
}

#[test]
fn times_reported_by_driver_may_be_off_by_ten_milliseconds() {
    let mut bench = whole("arm");
    bench.until(20);
    bench.paper();
    bench.until(1_000);
    let just_beyond = |millis: i64, nanos: i64| Timestamp::from_nanos(BEGIN + millis * 1_000_000 + nanos);
    let mut says = |at| bench.robot.plan_reported(bench.now, P1, at, &PlanEvent::Began, &mut Vec::new());
    assert!(says(just_beyond(1_010, 1)).is_err_and(|why| why.to_string().contains("in the future")));
    assert!(
        says(just_beyond(10, -1))
            .is_err_and(|why| why.to_string().contains("before the script was accepted"))
    );
    assert_eq!(says(at(10)), Ok(()));
    assert_eq!(says(at(1_010)), Ok(()));
}

#[test]
fn event_time_in_the_future_is_reported_as_now() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_000);
    bench.hears(P1, 1_009, PlanEvent::Began);
    assert_eq!(bench.last().event_timestamp, Some(at(1_000)));
}

#[test]
fn steps_done_by_driver_are_logged_once_with_deadline_and_time() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(3_000);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.hears(P1, 2_001, PlanEvent::Step(1));
    bench.hears(P1, 3_000, PlanEvent::Done);
    let played = |output: &Output| match output {
        Output::Played { set, at } => Some((set.step.unwrap(), milliseconds(set.due), milliseconds(*at))),
        _ => None,
    };
    let all: Vec<_> = bench.out.iter().filter_map(played).collect();
    assert_eq!(all, [(0, 1_000.0, 2_001.0), (1, 2_000.0, 2_001.0), (2, 3_000.0, 3_000.0)]);
}

#[test]
fn script_stopped_by_the_driver_fails_with_the_step() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_100);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.hears(P1, 1_000, PlanEvent::Step(0));
    bench.hears(P1, 1_050, PlanEvent::Cancelled);
    let error = bench.last().error.as_ref().unwrap();
    assert_eq!(error.message.to_string(), "the hardware stopped on its own in step 2");
    assert_eq!(bench.cancels(), []);
}

#[test]
fn refused_continuation_cancels_the_script_at_the_driver() {
    let mut bench = planned(&[("arm", Lookahead::Horizon(Span::from_millis(400)))]);
    bench.paper();
    bench.until(1_000);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.until(1_600);
    let error = urrcp::ControlError::new(ErrorCode::Internal, "no");
    bench.robot.plan_refused(bench.now, P1, 2, error, &mut bench.out);
    assert_eq!(bench.cancels(), [(1, Then::Hold)], "it still has the first steps");
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    assert_eq!(bench.statuses(), ["Accepted", "Started", "Failed internal"]);
}

#[test]
fn continuation_ends_the_script_only_if_it_is_too_late() {
    for (held_up_until, ends) in [(2_250, false), (2_251, true)] {
        let mut bench = planned(&[("arm", Lookahead::Horizon(Span::from_millis(400)))]);
        bench.paper();
        bench.until(1_000);
        bench.hears(P1, 1_000, PlanEvent::Began);
        bench.now = at(held_up_until);
        bench.robot.advance(bench.now, &mut bench.out);
        assert_eq!(!bench.cancels().is_empty(), ends, "{held_up_until}");
        assert_eq!(bench.parts().len(), if ends { 1 } else { 2 });
    }
}

#[test]
fn unreported_end_is_unknown_after_hardware_loss() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_100);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.until(3_100);
    bench.robot.hardware_lost(bench.now, "unplugged", &mut bench.out);
    let error = bench.last().error.as_ref().unwrap();
    let expected =
        "the hardware may not have played the script to its end: the hardware is not available: unplugged";
    assert_eq!((error.code.clone(), error.message.as_str()), (ErrorCode::Internal, expected));
    assert_eq!(bench.cancels(), [], "there is nobody to tell");
}

#[test]
fn close_steps_are_sent_to_driver_a_quarter_of_the_horizon_at_a_time() {
    let block = BLOCK.replace(r#""max_number_of_steps": 4"#, r#""max_number_of_steps": 20"#);
    let mut bench = Bench { robot: Robot::driven(serde_json::from_str(&block).unwrap()), ..Bench::new() };
    let horizon = Lookahead::Horizon(Span::from_millis(400));
    bench.robot.plans_ahead(&BTreeMap::from([(DeviceId::new("arm").unwrap(), horizon)]));
    bench.robot.hardware_found(bench.now, &mut bench.out);
    let steps: Vec<_> = (0..12).map(|step| (f64::from(step) * 50.0, 5.0)).collect();
    bench.request(timed("arm", "a", 1_000.0, script(ControlType::Position, &steps)));
    let mut told = Vec::new();
    for millis in 0..1_200 {
        bench.until(millis);
        if millis == 1_000 {
            bench.hears(P1, 1_000, PlanEvent::Began);
        }
        if bench.parts().len() > told.len() {
            let part = bench.parts().pop().unwrap();
            told.push((millis, part.first, part.steps.len(), part.is_last));
        }
    }
    assert_eq!(told, [(600, 0, 4, false), (750, 4, 3, false), (900, 7, 3, false), (1_050, 10, 2, true)]);
}

#[test]
fn driver_has_750_ms_to_report_the_start_and_750_ms_for_the_end() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_749);
    assert_eq!(bench.cancels(), []);
    bench.until(1_750);
    assert_eq!(bench.cancels().len(), 1);
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_000);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.until(3_749);
    assert_eq!(bench.cancels(), []);
    bench.until(3_750);
    assert_eq!(bench.cancels().len(), 1);
}

#[test]
fn edge_that_checks_too_late_for_a_report_checks_again_then_gives_up() {
    for (looks_at, gives_up_at) in [(1_850, 1_850), (1_851, 2_601)] {
        let mut bench = whole("arm");
        bench.paper();
        bench.now = at(looks_at);
        bench.robot.advance(bench.now, &mut bench.out);
        bench.until(gives_up_at - 1);
        assert_eq!(bench.cancels().is_empty(), looks_at != gives_up_at);
        bench.until(gives_up_at);
        assert_eq!(bench.cancels().len(), 1, "{looks_at}");
    }
}

#[test]
fn first_of_duplicate_driver_reports_is_used() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_010);
    bench.hears(P1, 1_007, PlanEvent::Began);
    bench.hears(P1, 1_009, PlanEvent::Began);
    bench.until(2_990);
    bench.hears(P1, 2_980, PlanEvent::Done);
    bench.hears(P1, 2_990, PlanEvent::Done);
    bench.until(3_000);
    let told: Vec<_> = bench.responses().iter().filter_map(|response| response.event_timestamp).collect();
    assert_eq!(told, [at(1_007), at(2_980)]);
    assert!(bench.says(PlanId(0), 3_000, PlanEvent::Began).is_err(), "there has never been such a one");
}

#[test]
fn stop_before_the_driver_reports_the_end_is_reported_as_cancelled() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_000);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.until(3_100);
    bench.stop_arm(false);
    assert_eq!(bench.cancels(), [(1, Then::Hold)]);
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    let error = bench.last().error.as_ref().unwrap();
    let expected = "the device was stopped before its driver reported the end of the script";
    assert_eq!((error.code.clone(), error.message.as_str()), (ErrorCode::Cancelled, expected));
    // A cancelled plan is not cancelled again.
    bench.stop_arm(false);
    assert_eq!(bench.cancels().len(), 1);
}

#[test]
fn stopped_device_without_default_value_holds_at_its_driver() {
    let mut bench = whole("ramp");
    bench.request(timed("ramp", "a", 0.0, script(ControlType::Position, &[(0.0, 5.0), (1_000.0, 80.0)])));
    bench.hears(P1, 0, PlanEvent::Began);
    bench.until(500);
    bench.request(ControlRequest::immediate(
        DeviceId::new("ramp").unwrap(),
        Command::Script(Script::default()),
    ));
    assert_eq!(bench.cancels(), [(1, Then::Hold)]);
    assert!(bench.sets().is_empty(), "{:?}", bench.sets());
}

#[test]
fn driver_timed_speed_goes_to_zero_by_a_following_value() {
    let mut bench = whole("wheel");
    bench.request(timed("wheel", "a", 0.0, script(ControlType::Speed, &[(0.0, 5.0), (1_000.0, 8.0)])));
    bench.hears(P1, 0, PlanEvent::Began);
    bench.until(500);
    bench.request(ControlRequest::immediate(
        DeviceId::new("wheel").unwrap(),
        Command::Script(Script::default()),
    ));
    assert_eq!(bench.cancels(), [(1, Then::Rest)]);
    assert_eq!(bench.sets().last().unwrap().motion, Motion::Rest(Setpoint::new(ControlType::Speed, 0.0)));
}

#[test]
fn failure_before_the_start_is_reported_as_such() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(500);
    bench.hears(P1, 500, PlanEvent::Failed("torque".to_owned()));
    let error = bench.last().error.as_ref().unwrap();
    assert_eq!(error.message.as_str(), "the hardware failed before its start: torque");
}

#[test]
fn driver_report_on_a_script_not_yet_sent_is_ignored() {
    let mut bench = planned(&[("arm", Lookahead::Horizon(Span::from_millis(400)))]);
    bench.paper();
    bench.until(100);
    assert_eq!(bench.says(P1, 100, PlanEvent::Began), Ok(()));
    bench.until(1_000);
    assert_eq!(bench.statuses(), ["Accepted"]);
}

#[test]
fn driver_can_report_only_steps_that_were_sent_to_it() {
    let mut bench = planned(&[("arm", Lookahead::Horizon(Span::from_millis(400)))]);
    bench.paper();
    bench.until(1_000);
    bench.hears(P1, 1_000, PlanEvent::Began);
    // The driver has received two of the three steps.
    bench.hears(P1, 1_000, PlanEvent::Step(1));
    assert!(bench.says(P1, 1_000, PlanEvent::Step(2)).is_err_and(|why| {
        why.to_string().contains("only 2 of the script's steps had been sent to the driver")
    }));
}

#[cfg(feature = "host")]
#[test]
fn script_times_are_later_on_a_clock_that_is_ahead() {
    let mut bench = whole("arm");
    bench.paper();
    let part = bench.parts()[0].clone();
    let there: PlanPart<urrcp::Robot> = part.clone().on_clock(Span::from_millis(5));
    let times = |part: &PlanPart<urrcp::Robot>| {
        let steps = part.steps.iter().map(|step| step.at);
        [part.start, part.begin_by].into_iter().chain(steps).map(milliseconds).collect::<Vec<_>>()
    };
    assert_eq!(times(&part), [1_000.0, 1_050.0, 1_000.0, 2_000.0, 3_000.0]);
    assert_eq!(times(&there), [1_005.0, 1_055.0, 1_005.0, 2_005.0, 3_005.0]);
    assert_eq!((there.plan, there.device, there.is_last), (part.plan, part.device, part.is_last));
}

#[test]
fn second_stop_does_not_report_the_end_before_the_driver_does() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_500);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.stop_arm(false);
    bench.hears(P1, 1_500, PlanEvent::Cancelled);
    bench.stop_arm(false);
    assert_eq!(bench.statuses(), ["Accepted", "Started"]);
    assert_eq!(bench.cancels(), [(1, Then::Hold)], "the driver gets one cancellation");
    bench.robot.plan_cancelled(bench.now, P1, &mut bench.out);
    assert_eq!(bench.statuses()[..3], ["Accepted", "Started", "Failed cancelled"]);
}

#[test]
fn robot_is_not_idle_until_its_driver_has_reported_the_end() {
    let mut bench = whole("arm");
    bench.paper();
    bench.until(1_000);
    bench.hears(P1, 1_000, PlanEvent::Began);
    bench.until(3_010);
    assert!(!bench.robot.is_idle(), "by its time it is over");
    bench.hears(P1, 3_005, PlanEvent::Done);
    assert!(bench.robot.is_idle());
}
