//! Tests of questions and their answers, stops and their confirmations, and links and attempts to reconnect.

use urrcp::{ErrorCode, Interpolation, StatusValue};

use super::*;
use crate::bench::{self, Tells, at, ms, response};
use crate::open_requests::Answered;
use crate::{ActNumber, MemberIndex};

#[test]
fn response_settles_its_request_and_all_older_ones() {
    let mut questions = Questions::default();
    [1, 2, 3].into_iter().for_each(|millis| questions.asked(at(millis)));
    assert_eq!(
        (questions.answered(), questions.unanswered(), questions.last_unanswered()),
        (None, Some(at(1)), Some(at(3)))
    );
    questions.answer(at(2));
    assert_eq!(
        (questions.answered(), questions.unanswered(), questions.last_unanswered()),
        (Some(at(2)), Some(at(3)), Some(at(3)))
    );
    questions.answer(at(1));
    assert_eq!(questions.answered(), Some(at(2)), "an older answer that comes later takes nothing back");
    questions.answer(at(3));
    assert_eq!((questions.unanswered(), questions.last_unanswered()), (None, None));
}

#[test]
fn requests_skipped_by_a_later_response_may_have_been_received() {
    let mut questions = Questions::default();
    for (asked, answered, passed_over) in
        [(&[1][..], 1, false), (&[2, 4], 4, true), (&[], 2, true), (&[5], 5, false)]
    {
        asked.iter().for_each(|millis| questions.asked(at(*millis)));
        questions.answer(at(answered));
        assert_eq!(questions.passed_over(), passed_over, "the answer to {answered}");
    }
}

#[test]
fn forgiven_requests_need_no_response_and_answered_ones_stay_answered() {
    let mut questions = Questions::default();
    questions.asked(at(1));
    questions.answer(at(1));
    questions.asked(at(2));
    questions.forgive();
    assert_eq!((questions.answered(), questions.unanswered()), (Some(at(1)), None));
}

#[test]
fn forgiven_requests_may_have_been_received_if_the_latest_is_unanswered() {
    for (answered, passed_over) in [(&[3][..], true), (&[2, 3], false), (&[1, 3], true)] {
        let mut questions = Questions::default();
        questions.asked(at(0));
        questions.answer(at(0));
        [1, 2].into_iter().for_each(|millis| questions.asked(at(millis)));
        questions.forgive();
        questions.forgive();
        questions.asked(at(3));
        answered.iter().for_each(|millis| questions.answer(at(*millis)));
        assert_eq!(questions.passed_over(), passed_over, "answers to {answered:?}");
        questions.asked(at(4));
        questions.answer(at(4));
        assert!(!questions.passed_over(), "that was before the last answer");
    }
}

#[test]
fn oldest_open_requests_are_kept_on_a_dead_link() {
    let mut questions = Questions::default();
    (0..1_000).for_each(|millis| questions.asked(at(millis)));
    assert_eq!(questions.unanswered(), Some(at(0)));
    assert_eq!(questions.open.len(), OPEN_MAX);
    questions.answer(at(2_000));
    assert_eq!(questions.unanswered(), None);
}

const STOPPED: i64 = 100;

/// A robot whose devices `a` and `b` were sent stops.
fn stopped(rest: Rest) -> RobotState {
    let mut robot = bench::robot("r0", Tells::Everything, 2);
    robot.halt.touched = ["a", "b"].map(|device| device.parse().unwrap()).into();
    robot.set_stop(Stop::Sent(SentStop { at: at(STOPPED), rest, taken_over: None, given_up: false }));
    for device in ["a", "b"] {
        robot.requests.add_stop(id(device), device.parse().unwrap());
    }
    robot
}

/// Passes a response to the robot that arrives at `now`, and returns whether it answers a stop. `open` is the device that has an open
/// script, if any.
fn answers_stop(
    robot: &mut RobotState,
    now: Timestamp<Server>,
    response: &ControlResponse,
    open: Option<&str>,
) -> bool {
    let script = ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 };
    let open = open.filter(|device| *device == response.device_id.as_str()).map(|_| script);
    let answered = match &response.request_id {
        Some(id) => robot.requests.answer_named(id),
        None => robot.stop_confirmed_without_id(now, response, open).map(Answered::Stop),
    };
    let Some(Answered::Stop(id)) = answered else { return false };
    robot.stop_answered(&id, response);
    true
}

fn id(device: &str) -> RequestId {
    RequestId::new(format!("stop/{device}")).unwrap()
}

fn without_name(device: &str, status: Status, millis: i64) -> ControlResponse {
    response(&device.parse().unwrap(), None, status, at(millis))
}

#[test]
fn stop_is_confirmed_when_every_device_has_confirmed_it_by_id() {
    let mut robot = stopped(Rest::Home);
    let confirmed = |robot: &mut RobotState, device: &str, status| {
        let response = response(&device.parse().unwrap(), Some(&id(device)), status, at(STOPPED + 1));
        answers_stop(robot, at(STOPPED + 2), &response, None)
    };
    assert!(confirmed(&mut robot, "a", Status::Accepted), "it is an answer, and no confirmation");
    assert!(confirmed(&mut robot, "a", Status::Ok));
    assert!(robot.awaits_stop() && !robot.is_settled());
    assert!(confirmed(&mut robot, "b", Status::Failed), "it is an answer, and no confirmation");
    assert!(robot.awaits_stop());
    assert!(confirmed(&mut robot, "b", Status::Ok));
    assert!(matches!(robot.halt.stop, Stop::Confirmed(Rest::Home)) && robot.is_settled());
    assert!(!confirmed(&mut robot, "b", Status::Ok), "there is nothing left to confirm");
}

#[test]
fn response_to_another_request_confirms_no_stop() {
    let mut robot = stopped(Rest::InPlace);
    let response =
        response(&"a".parse().unwrap(), RequestId::new("act").ok().as_ref(), Status::Ok, at(STOPPED + 1));
    assert!(!answers_stop(&mut robot, at(STOPPED + 2), &response, None));
    assert!(robot.awaits_stop());
}

#[test]
fn response_without_id_confirms_the_stop_of_its_device_only() {
    let mut robot = stopped(Rest::InPlace);
    assert!(answers_stop(&mut robot, at(STOPPED + 2), &without_name("a", Status::Ok, STOPPED + 1), None));
    assert!(matches!(robot.halt.stop, Stop::Sent(_)), "b has not confirmed");
    assert_eq!(robot.requests.stops().map(|(id, _)| id).collect::<Vec<_>>(), [&id("b")]);
    assert!(!answers_stop(&mut robot, at(STOPPED + 3), &without_name("a", Status::Ok, STOPPED + 2), None));
    assert!(answers_stop(&mut robot, at(STOPPED + 4), &without_name("b", Status::Ok, STOPPED + 3), None));
    assert!(robot.is_settled());
}

#[test]
fn ambiguous_or_too_early_response_without_id_confirms_no_stop() {
    let mut robot = stopped(Rest::InPlace);
    let after = without_name("a", Status::Ok, STOPPED + 1);
    assert!(!answers_stop(&mut robot, at(STOPPED + 2), &after, Some("a")));
    let before = without_name("a", Status::Ok, STOPPED - 1);
    assert!(!answers_stop(&mut robot, at(STOPPED + 2), &before, None));
    // Only the end of a script has a last value and steps.
    let last_value = ControlResponse { status_value: StatusValue::Number(45.0), ..after.clone() };
    let steps = ControlResponse { steps_done: Some(1), ..after.clone() };
    for ended in [last_value, steps] {
        assert!(!answers_stop(&mut robot, at(STOPPED + 2), &ended, None), "{ended:?}");
    }
    for status in [Status::Accepted, Status::Started, Status::Failed, Status::Provide] {
        let response = ControlResponse {
            error: bench::refusal(ErrorCode::Cancelled),
            ..without_name("a", status, STOPPED + 1)
        };
        assert!(!answers_stop(&mut robot, at(STOPPED + 2), &response, None));
    }
    assert!(robot.awaits_stop());
    assert!(answers_stop(&mut robot, at(STOPPED + 2), &after, Some("b")));
}

#[test]
fn response_time_follows_robot_clock_but_is_never_later_than_now() {
    let mut robot = stopped(Rest::InPlace);
    let there = bench::by_robot(at(10)) + ms(5_000);
    robot.clock.add(crate::clock::ClockSample::from_exchange(at(10), there, there, at(10)));
    let said = |robot: &RobotState, millis| robot.said_at(at(200), bench::by_robot(at(millis)));
    assert!((said(&robot, 5_150) - at(150)).abs() < ms(1), "its clock is five seconds ahead");
    assert_eq!(said(&robot, 9_000), at(200));
    // By its own clock it was sent long after the stop, but actually before it.
    let response = without_name("a", Status::Ok, 5_000 + STOPPED - 50);
    assert!(!answers_stop(&mut robot, at(STOPPED + 60), &response, None));
}

#[test]
fn no_response_confirms_a_stop_before_one_is_sent() {
    let mut robot = bench::robot("r0", Tells::Everything, 2);
    assert!(robot.is_settled(), "it was sent nothing");
    robot.halt.touched.insert("a".parse().unwrap());
    assert!(!robot.is_settled());
    assert!(!answers_stop(&mut robot, at(1), &without_name("a", Status::Ok, 1), None));
}

#[test]
fn connection_attempts_slow_down_until_a_message_is_received() {
    let mut robot = bench::robot("r0", Tells::Everything, 2);
    let pauses: Vec<Span> = (0..10).map(|_| robot.next_attempt()).collect();
    assert_eq!(pauses[..4], [Span::ZERO, ms(10), ms(20), ms(40)]);
    assert!(pauses.is_sorted() && pauses[9] == RETRY_AFTER_MAX);
    assert!(!robot.heard(Timestamp::from_nanos(0)));
    assert_eq!(robot.next_attempt(), Span::ZERO);
}

#[test]
fn reconnected_link_counts_as_broken_until_the_first_message() {
    let mut robot = bench::robot("r0", Tells::Everything, 2);
    robot.contact.questions.asked(at(1));
    let lost = Lost {
        reason: "cut".into(),
        loss: Loss::Closed,
        since: at(2),
        failed: at(2),
        connecting: true,
        give_up: None,
    };
    robot.link = Link::Lost(lost.clone());
    assert_eq!((robot.is_up(), robot.broken()), (false, Some("cut")));
    robot.connected(at(0));
    assert!(robot.named());
    assert_eq!(
        (robot.is_up(), robot.broken(), robot.contact.questions.unanswered()),
        (true, Some("cut"), None)
    );
    assert!(robot.heard(Timestamp::from_nanos(0)), "for the first time since");
    assert!(!robot.heard(Timestamp::from_nanos(0)));
    assert_eq!(robot.broken(), None);
    robot.link = Link::Lost(Lost { loss: Loss::Refused, ..lost });
    assert!(robot.is_gone());
}

#[test]
fn message_sent_in_or_shortly_before_an_interval_may_arrive_in_it() {
    let mut robot = bench::robot("r0", Tells::Everything, 2);
    let spoken = |robot: &RobotState, before, after| {
        robot.was_spoken_to(at(10_000), bench::by_robot(at(before)), bench::by_robot(at(after)))
    };
    assert!(!spoken(&robot, 0, 9_000));
    robot.contact.spoken_at = Some(at(2_000));
    assert!(spoken(&robot, 1_000, 4_000));
    assert!(spoken(&robot, 2_900, 4_000), "it was under way");
    assert!(!spoken(&robot, 3_100, 4_000), "it was there before");
    assert!(!spoken(&robot, 0, 1_900), "it came later");
}

#[test]
fn silence_limit_runs_from_last_message_and_two_thirds_from_a_request() {
    let mut robot = bench::robot("r0", Tells::Everything, 2);
    let silent = |robot: &RobotState| robot.silent_at(ms(300));
    assert_eq!(silent(&robot), None, "it owes no answer");
    robot.contact.questions.asked(at(10));
    assert_eq!(silent(&robot), Some(at(310)), "it has never been heard");
    robot.heard(at(0));
    assert_eq!(silent(&robot), Some(at(300)));
    robot.contact.questions.answer(at(10));
    robot.contact.questions.asked(at(250));
    assert_eq!((robot.contact.questions.last_asked(), silent(&robot)), (Some(at(250)), Some(at(450))));
}

#[test]
fn robot_totals_add_up_over_its_scripts() {
    let mut totals = Totals::default();
    let script = |status: Option<Status>, late: u32| {
        let mut script = Script::new(&bench::device_script(("a", 0, 400)), Interpolation::Hold);
        if let Some(status) = status {
            script.sent(at(0));
            let error = bench::refusal(ErrorCode::Late).filter(|_| status == Status::Failed);
            let said = response(&script.plan.device, None, status, at(1));
            script.answered(&ControlResponse { error, late_steps: Some(late), ..said });
        }
        script
    };
    for (status, late, error) in [
        (None, 0, None),
        (Some(Status::Accepted), 0, None),
        (Some(Status::Ok), 1, Some(ms(2))),
        (Some(Status::Ok), 1, Some(ms(-5))),
        (Some(Status::Started), 1, Some(ms(3))),
        (Some(Status::Failed), 0, None),
        (Some(Status::Failed), 0, None),
    ] {
        totals.add(&script(status, late), error);
    }
    let Totals { scripts, sent, accepted, failed, started, unaccounted, .. } = totals;
    assert_eq!((scripts, sent, accepted, failed, started, unaccounted), (7, 6, 4, 2, 3, 2));
    assert_eq!((totals.steps_done, totals.steps_planned, totals.late_steps), (4, 14, 3));
    assert_eq!(totals.start_error, Some(ms(-5)), "the largest, early or late");
}

#[test]
fn robot_is_garbled_after_an_unreadable_message() {
    let mut robot = bench::robot("r0", Tells::Everything, 2);
    let mut fails = |kind| {
        robot.failures.note(crate::Failure { robot: robot.id.clone(), kind });
        robot.is_garbled()
    };
    assert!(!fails(crate::FailureKind::LinkDown { reason: "off".to_owned() }));
    assert!(fails(crate::FailureKind::Garbled { reason: "x".to_owned() }));
}
