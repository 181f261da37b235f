//! Tests in which a robot sends arbitrary reports about a script in arbitrary order.

use proptest::prelude::*;

use super::*;
use crate::bench::{self, at, by_robot, ms, refusal, report, response};

/// Reports about a script, and other events that concern the script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Said {
    Accepted,
    Started,
    Ok(Option<u32>),
    Failed,
    Held,
    Running(u32),
    EndedWell(Option<u32>),
    EndedBadly,
    Unknown,
    /// The script is sent again.
    Sent,
    /// The time of the script has passed, and no message about it has arrived.
    Lapses,
}

fn sent() -> Script {
    let mut script = Script::new(&bench::device_script(("a", 0, 400)), Interpolation::Hold);
    script.name(RequestId::new("id").ok());
    script.sent(at(0));
    script
}

/// Passes a report to the script, `millis` milliseconds after the script was sent.
fn take(script: &mut Script, said: Said, millis: i64) -> News {
    let now = at(millis);
    let id = script.request_id().unwrap().clone();
    let status = |status, steps_done, error| ControlResponse {
        steps_done,
        error,
        ..response(&script.plan.device, Some(&id), status, now)
    };
    let state = |state, steps_done, error| RequestReport { steps_done, error, ..report(&id, state, None) };
    let failed = refusal(ErrorCode::Late);
    let reported = match said {
        Said::Accepted => return script.answered(&status(Status::Accepted, None, None)),
        Said::Started => return script.answered(&status(Status::Started, None, None)),
        Said::Ok(steps) => return script.answered(&status(Status::Ok, steps, None)),
        Said::Failed => return script.answered(&status(Status::Failed, None, failed)),
        Said::Sent => {
            script.sent(now);
            return News::None;
        }
        Said::Lapses => {
            script.lapse();
            return News::None;
        }
        Said::Held => state(RequestState::Held, None, None),
        Said::Running(steps) => RequestReport {
            event_timestamp: Some(by_robot(now)),
            ..state(RequestState::Running, Some(steps), None)
        },
        Said::EndedWell(steps) => state(RequestState::Ended, steps, None),
        Said::EndedBadly => state(RequestState::Ended, None, failed),
        Said::Unknown => state(RequestState::Unknown, None, None),
    };
    script.reported(&reported, now, by_robot(now))
}

const ANSWERS: [Said; 10] = [
    Said::Accepted,
    Said::Started,
    Said::Ok(None),
    Said::Ok(Some(1)),
    Said::Failed,
    Said::Held,
    Said::Running(1),
    Said::EndedWell(Some(2)),
    Said::EndedBadly,
    Said::Unknown,
];

fn is_end(news: &News) -> bool {
    matches!(news, News::Completed | News::Failed(_))
}

#[test]
fn end_of_a_script_is_final_and_reported_once_in_any_response_order() {
    for one in ANSWERS {
        for two in ANSWERS {
            for three in ANSWERS {
                for four in ANSWERS {
                    let mut script = sent();
                    let (mut ended, mut ends, mut steps) = (None, 0, 0);
                    for (index, said) in [one, two, three, four].into_iter().enumerate() {
                        let news = take(&mut script, said, 1 + index as i64);
                        let final_now = script.is_final().then(|| script.state().clone());
                        assert!(ended.is_none() || final_now == ended, "{one:?} {two:?} {three:?} {four:?}");
                        ends += usize::from(is_end(&news) && script.is_final());
                        assert!(script.steps_done() >= steps, "{one:?} {two:?} {three:?} {four:?}");
                        (ended, steps) = (final_now, script.steps_done());
                    }
                    assert_eq!(ends, usize::from(ended.is_some()), "{one:?} {two:?} {three:?} {four:?}");
                }
            }
        }
    }
}

#[test]
fn usual_course_is_reported_step_by_step() {
    let mut script = sent();
    assert!(script.is_out() && !script.was_accepted() && !script.has_begun());
    assert_eq!(take(&mut script, Said::Accepted, 1), News::Accepted);
    assert_eq!(take(&mut script, Said::Held, 2), News::None);
    assert_eq!(script.held_at(), Some(at(2)));
    assert_eq!(take(&mut script, Said::Started, 3), News::Started);
    assert!(script.has_begun() && *script.state() == ScriptState::Running);
    assert_eq!(take(&mut script, Said::Running(1), 4), News::None);
    assert_eq!(take(&mut script, Said::Ok(None), 5), News::Completed);
    assert!(script.has_completed() && !script.is_unaccounted());
    assert_eq!((script.steps_done(), script.started_at()), (2, Some(by_robot(at(3)))));
}

#[test]
fn any_report_implies_the_lost_reports_before_it() {
    for said in [Said::Started, Said::Running(1), Said::Ok(None), Said::EndedWell(None)] {
        let mut script = sent();
        let _ = take(&mut script, said, 1);
        assert!(script.was_accepted() && script.has_begun(), "{said:?}");
        assert_eq!(take(&mut script, Said::Accepted, 2), News::None, "{said:?}");
        assert!(script.has_begun(), "{said:?}");
    }
}

#[test]
fn unknown_script_was_never_received_or_lost_or_queried_too_early() {
    let mut never = sent();
    assert_eq!(take(&mut never, Said::Unknown, 1), News::NeverReceived);
    assert_eq!(*never.state(), ScriptState::Sent);
    for first in [Said::Accepted, Said::Started] {
        let mut lost = sent();
        let _ = take(&mut lost, first, 1);
        assert!(matches!(take(&mut lost, Said::Unknown, 2), News::Failed(_)), "{first:?}");
        assert_eq!(*lost.state(), ScriptState::Unknown, "what it did is unknown");
    }
    // A question that overtook the request in the same instant means nothing.
    let mut behind = sent();
    assert_eq!(take(&mut behind, Said::Unknown, 0), News::None);
    let mut again = sent();
    again.sent(at(5));
    assert_eq!(take(&mut again, Said::Unknown, 4), News::None);
}

#[test]
fn script_possibly_sent_by_another_process_is_unaccounted_until_reported() {
    let taken_up = || {
        let mut script = Script::new(&bench::device_script(("a", 0, 400)), Interpolation::Hold);
        script.name(RequestId::new("id").ok());
        script.taken_up();
        assert!(script.is_planned() && script.is_unaccounted());
        script
    };
    let mut unknown = taken_up();
    assert_eq!(take(&mut unknown, Said::Unknown, 1), News::None);
    assert!(unknown.is_planned() && unknown.is_unaccounted(), "its robot may have been restarted since");
    let mut played = taken_up();
    assert_eq!(take(&mut played, Said::EndedWell(Some(2)), 1), News::Completed);
    assert!(!played.is_unaccounted());
}

#[test]
fn script_without_a_report_becomes_unknown_and_may_still_be_reported() {
    let mut script = sent();
    script.lapse();
    assert_eq!(*script.state(), ScriptState::Unknown);
    assert!(script.is_unaccounted() && !script.is_out() && !script.has_begun());
    assert_eq!(take(&mut script, Said::Ok(None), 500), News::Completed);
    script.lapse();
    assert!(script.has_completed());
}

#[test]
fn robot_that_accepted_other_content_has_failed() {
    let other = Some(Command::Script(bench::device_script(("a", 0, 401)).script).content_hash());
    let mut answered = sent();
    let id = answered.request_id().cloned();
    let accepted = response(&answered.plan.device, id.as_ref(), Status::Accepted, at(1));
    assert!(matches!(
        answered.answered(&ControlResponse { content_hash: other, ..accepted }),
        News::Failed(_)
    ));
    for state in [RequestState::Held, RequestState::Running] {
        let mut reported = sent();
        let report = report(id.as_ref().unwrap(), state, other);
        assert!(matches!(reported.reported(&report, at(1), by_robot(at(1))), News::Failed(_)));
        assert!(!reported.was_accepted() && !reported.has_begun());
    }
}

#[test]
fn temporarily_refused_script_is_planned_again_under_a_new_id() {
    let mut script = sent();
    // A robot whose clock was set back by minutes keeps its queue full for the same time.
    for refusals in 1..=5_000 {
        script.refused_for_now();
        let name = script.request_id().expect("a name is never too long").as_str();
        assert_eq!((name, promised_name(name)), (format!("id+{refusals}").as_str(), "id"));
        assert!(script.is_planned());
        script.sent(at(refusals));
    }
    for promised in ["id", "id+", "id+a", "a+1/0/0/0"] {
        assert_eq!(promised_name(promised), promised);
    }
}

#[test]
fn refused_script_may_have_been_sent_by_dead_process_under_next_id() {
    let mut script = sent();
    script.refused_for_now();
    assert!(!script.is_unaccounted());
    let mut taken_up = sent();
    taken_up.taken_up();
    taken_up.refused_for_now();
    assert!(taken_up.is_planned() && taken_up.is_unaccounted());
}

#[test]
fn script_leases_are_those_of_its_steps_and_of_the_request_before_them() {
    let planned = |first: i64, leases: &[Option<i64>]| {
        let step = |(index, lease): (usize, &Option<i64>)| urrcp::Step {
            offset: Millis::from_span(ms(first + 10 * index as i64)),
            setpoint: urrcp::Setpoint::new(urrcp::ControlType::Position, 1.0),
            stop_condition: lease.map(|lease| urrcp::StopCondition {
                pending: None,
                running: (lease > 0).then(|| Millis::from_span(ms(lease))),
            }),
        };
        let steps = leases.iter().enumerate().map(step).collect();
        let script = urrcp::Script::new(steps).unwrap();
        Script::new(&DeviceScript { script, ..bench::device_script(("a", 0, 0)) }, Interpolation::Hold)
    };
    let both = |script: Script| (script.shortest_lease(), script.longest_lease());
    let whole = bench::RUNNING;
    assert_eq!(both(planned(0, &[None, None])), (Some(whole), Some(whole)));
    assert_eq!(both(planned(0, &[Some(100), Some(300)])), (Some(ms(100)), Some(ms(300))));
    assert_eq!(
        both(planned(5, &[Some(100), Some(300)])),
        (Some(ms(100)), Some(whole)),
        "up to its first step"
    );
    assert_eq!(both(planned(0, &[Some(100), Some(0)])), (Some(ms(100)), None), "the second has none");
}

#[test]
fn running_script_has_started_once_its_robot_reports_the_time() {
    let step = urrcp::Step {
        offset: Millis::from_span(ms(500)),
        setpoint: urrcp::Setpoint::new(urrcp::ControlType::Position, 1.0),
        stop_condition: None,
    };
    let plan = DeviceScript {
        script: urrcp::Script::new(vec![step]).unwrap(),
        ..bench::device_script(("a", 200, 0))
    };
    let starts = |interpolation| Script::new(&plan, interpolation).starts();
    assert_eq!([Interpolation::Hold, Interpolation::Linear].map(starts), [ms(700), ms(200)]);
    let mut script = Script::new(&plan, Interpolation::Hold);
    script.sent(at(0));
    let id = RequestId::new("id").unwrap();
    let running = RequestReport { steps_done: Some(0), ..report(&id, RequestState::Running, None) };
    assert_eq!(script.reported(&running, at(210), by_robot(at(211))), News::None);
    assert!(script.has_begun() && !script.has_started());
    let event_timestamp = Some(by_robot(at(701)));
    let started = response(&plan.device, Some(&id), Status::Started, at(702));
    assert_eq!(script.answered(&ControlResponse { event_timestamp, ..started }), News::Started);
    assert_eq!(script.started_at(), event_timestamp);
}

fn any_said() -> impl Strategy<Value = Said> {
    let steps = proptest::option::of(0_u32..4);
    prop_oneof![
        prop::sample::select(&ANSWERS[..]),
        Just(Said::Sent),
        Just(Said::Lapses),
        steps.clone().prop_map(Said::Ok),
        steps.prop_map(Said::EndedWell),
        (0_u32..4).prop_map(Said::Running),
    ]
}

proptest! {
    #[test]
    fn progress_never_goes_back_whatever_is_reported(
        said in prop::collection::vec(any_said(), 1..12),
    ) {
        let mut script = sent();
        for (index, said) in said.into_iter().enumerate() {
            // A script that has ended is not sent again.
            if said == Said::Sent && script.is_final() {
                continue;
            }
            let before = (script.steps_done(), script.was_accepted(), script.started_at(), script.has_completed());
            let _ = take(&mut script, said, 1 + index as i64);
            prop_assert!(script.steps_done() >= before.0);
            prop_assert!(script.was_accepted() >= before.1);
            prop_assert!(before.2.is_none() || script.started_at() == before.2);
            prop_assert!(script.has_completed() >= before.3);
        }
    }
}

#[test]
fn discredited_script_has_no_known_start_whatever_is_reported() {
    let claim = Claim::Ahead { claimed: by_robot(at(9)), by: ms(1) };
    let running = |script: &mut Script| take(script, Said::Running(1), 5);
    let ended = |script: &mut Script| take(script, Said::EndedWell(Some(2)), 6);
    for truth_first in [true, false] {
        let mut script = sent();
        if truth_first {
            assert_eq!(running(&mut script), News::Started);
        }
        let began = response(&script.plan.device, None, Status::Started, at(7));
        script.discredit(&claim, &Told::by_response(&began, at(7)));
        assert_eq!((running(&mut script), ended(&mut script)), (News::None, News::None));
        assert_eq!(script.started_at(), None, "{truth_first}");
        assert_eq!(script.steps_done(), u32::from(truth_first), "later steps do not count");
        assert!(script.has_begun() && script.is_final() && !script.has_completed());
    }
}

#[test]
fn only_a_script_of_another_process_can_be_unreported_since_takeover() {
    let planned = Script::new(&bench::device_script(("a", 0, 400)), Interpolation::Hold);
    assert!(!planned.is_unheard_since_taken_up() && !sent().is_unheard_since_taken_up());
    let mut taken_up = sent();
    taken_up.perhaps_sent = true;
    assert!(taken_up.is_unheard_since_taken_up());
    take(&mut taken_up, Said::Accepted, 1);
    assert!(!taken_up.is_unheard_since_taken_up());
}

#[test]
fn script_with_a_completed_step_has_begun() {
    let mut script = sent();
    assert!(!script.has_begun());
    script.steps.done = 1;
    assert!(script.has_begun());
}

#[test]
fn request_sent_twice_or_possibly_by_another_process_is_a_repeat() {
    let mut script = sent();
    assert!(!script.came_again());
    assert!(script.was_sent_since(at(0)) && !script.was_sent_since(at(0) + Span::from_nanos(1)));
    script.sent(at(1));
    assert!(script.came_again());
    assert!(!script.was_sent_since(at(1)), "for the first time");
    let mut taken_up = sent();
    taken_up.taken_up();
    assert!(taken_up.came_again());
}

#[test]
fn steps_and_late_steps_never_decrease() {
    let mut script = sent();
    let id = script.request_id().unwrap().clone();
    for (steps, late, expected) in [(2, 1, (2, 1)), (1, 0, (2, 1))] {
        let said = ControlResponse {
            steps_done: Some(steps),
            late_steps: Some(late),
            ..response(&script.plan.device, Some(&id), Status::Started, at(steps.into()))
        };
        script.answered(&said);
        assert_eq!((script.steps_done(), script.late_steps()), expected);
    }
    assert_eq!(script.late_max(), None);
    for (late, latest) in [(7.5, 7.5), (2.0, 7.5)] {
        let late_ms_max = Millis::new(late).ok();
        let told =
            RequestReport { late_steps: Some(2), late_ms_max, ..report(&id, RequestState::Running, None) };
        script.reported(&told, at(5), by_robot(at(5)));
        assert_eq!((script.steps_done(), script.late_steps()), (2, 2));
        assert_eq!(script.late_max(), Some(Span::from_millis_f64(latest)));
    }
}

#[test]
fn script_refused_as_late_may_have_been_played_for_another_process() {
    let late = |script: &Script| ControlResponse {
        error: refusal(ErrorCode::Late),
        ..response(&script.plan.device, script.request_id(), Status::Failed, at(1))
    };
    let mut script = sent();
    assert!(!script.may_have_been_played(&late(&script)), "nobody else has sent it");
    script.taken_up();
    assert!(script.may_have_been_played(&late(&script)));
    let busy = ControlResponse { error: refusal(ErrorCode::Busy), ..late(&script) };
    assert!(!script.may_have_been_played(&busy));
    let accepted = ControlResponse { status: Status::Accepted, ..late(&script) };
    assert!(!script.may_have_been_played(&accepted));
    take(&mut script, Said::Accepted, 2);
    assert!(!script.may_have_been_played(&late(&script)), "it is known that the robot had it");
}

#[test]
fn report_of_unknown_script_before_its_acceptance_is_ignored() {
    let id = RequestId::new("id").unwrap();
    for (said, lost) in [(10, false), (11, true)] {
        let mut script = sent();
        assert_eq!(take(&mut script, Said::Accepted, 10), News::Accepted);
        let unknown = report(&id, RequestState::Unknown, None);
        let news = script.reported(&unknown, at(9), by_robot(at(said)));
        assert_eq!((is_end(&news), *script.state() == ScriptState::Held), (lost, !lost), "{news:?}");
    }
}
