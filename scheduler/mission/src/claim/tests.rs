use urrcp::{DeviceId, ErrorCode, RequestId, RequestState};

use super::*;
use crate::bench::{at, by_robot, ms, refusal, report, response};

/// A script of 400 ms and three steps that starts at 1 s, on a robot whose clock is 100 ms ahead, known to 5 ms.
const POSSIBLE: fn() -> Possible = || Possible {
    planned: 3,
    before: None,
    times: Some(Times {
        sent: at(0),
        start: by_robot(at(1_000)),
        duration: ms(400),
        offset: ms(100),
        uncertainty: ms(5),
        tolerance: ms(50),
    }),
};

fn told(status: Status, arrives: i64, event: Option<i64>, steps: Option<u32>, late: Option<u32>) -> Told {
    let device: DeviceId = "a".parse().unwrap();
    let response = ControlResponse {
        event_timestamp: event.map(|millis| by_robot(at(millis))),
        steps_done: steps,
        late_steps: late,
        error: (status == Status::Failed).then(|| refusal(ErrorCode::Late)).flatten(),
        ..response(&device, None, status, at(arrives + 100))
    };
    Told::by_response(&response, at(arrives))
}

#[track_caller]
fn holds(told: Told) {
    assert_eq!(POSSIBLE().contradicts(&told), None);
}

#[track_caller]
fn check(told: Told, says: &str) {
    let claim = POSSIBLE().contradicts(&told).map(|claim| claim.to_string());
    assert!(claim.as_deref().is_some_and(|claim| claim.contains(says)), "{claim:?}");
}

#[test]
fn reports_of_a_correctly_playing_robot_are_accepted() {
    holds(told(Status::Accepted, 10, None, None, None));
    holds(told(Status::Started, 902, Some(1_000), None, None));
    holds(told(Status::Ok, 1_302, Some(1_400), Some(3), Some(0)));
    holds(told(Status::Failed, 1_100, Some(1_200), Some(1), None));
    holds(told(Status::Ok, 1_302, None, None, None));
}

#[test]
fn report_of_a_start_or_of_a_completed_step_implies_movement() {
    let moved = |status, steps| told(status, 1_302, None, steps, None).says_that_it_moved();
    assert!(moved(Status::Started, None) && moved(Status::Failed, Some(1)) && moved(Status::Failed, Some(3)));
    assert!(
        !moved(Status::Failed, Some(0)) && !moved(Status::Failed, None) && !moved(Status::Accepted, None)
    );
}

#[test]
fn script_cannot_have_more_steps_than_sent_nor_end_with_fewer() {
    check(told(Status::Ok, 1_302, Some(1_400), Some(u32::MAX), None), "4294967295 steps done, of 3 planned");
    check(told(Status::Failed, 1_302, Some(1_400), Some(4), None), "4 steps done, of 3 planned");
    check(told(Status::Ok, 1_302, Some(1_400), Some(2), None), "completed with 2 steps done, of 3");
    check(told(Status::Ok, 1_302, Some(1_400), Some(3), Some(4)), "4 steps late, of 3 done");
}

#[test]
fn number_of_completed_steps_decreases_only_in_an_older_answer() {
    let before = |millis: i64| Possible { before: Some((by_robot(at(millis)), 2)), ..POSSIBLE() };
    let fewer = told(Status::Failed, 1_100, Some(1_200), Some(1), None);
    assert_eq!(before(1_150).contradicts(&fewer), Some(Claim::FewerSteps { claimed: 1, before: 2 }));
    assert_eq!(before(1_250).contradicts(&fewer), None);
}

#[test]
fn start_must_be_between_the_sending_and_its_report() {
    check(told(Status::Started, 902, Some(-50), None, None), "started 125 ms before the script was sent");
    holds(told(Status::Started, 902, Some(90), None, None));
    check(told(Status::Started, 902, Some(1_100), None, None), "the reported time is 73 ms in the future");
    check(told(Status::Started, 700, Some(790), None, None), "started 125 ms earlier than possible");
    holds(told(Status::Started, 840, Some(930), None, None));
    // The earliest possible instant: 900 ms, minus the tolerance, minus the uncertainty of its clock and travel time.
    holds(told(Status::Started, 825, None, None, None));
    check(told(Status::Started, 824, None, None, None), "started 1 ms earlier than possible");
}

#[test]
fn end_cannot_be_reported_before_the_script_can_have_ended() {
    check(told(Status::Ok, 902, Some(1_000), Some(3), None), "completed 330 ms earlier than possible");
    check(told(Status::Ok, 1_000, None, Some(3), None), "completed 225 ms earlier than possible");
    holds(told(Status::Ok, 1_240, Some(1_335), Some(3), None));
    check(told(Status::Ok, 1_302, Some(1_500), Some(3), None), "the reported time is 73 ms in the future");
}

#[test]
fn requested_report_is_checked_against_the_same_limits() {
    let id = RequestId::new("id").unwrap();
    let running = report(&id, RequestState::Running, None);
    let says = |report: &RequestReport, arrives| {
        POSSIBLE().contradicts(&Told::by_report(report, by_robot(at(arrives + 100)), at(arrives)))
    };
    assert_eq!(says(&running, 902), None);
    assert_eq!(says(&running, 500), Some(Claim::StartedEarly { by: ms(325) }));
    let ended = RequestReport { state: RequestState::Ended, steps_done: Some(7), ..running };
    assert_eq!(says(&ended, 1_302), Some(Claim::Steps { claimed: 7, planned: 3 }));
}
