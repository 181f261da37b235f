//! Tests of the promise, which is recorded before anything is sent, and of the decision to start.

use super::super::preparing::HELD_UP;
use super::*;

#[test]
fn stalled_process_fails_no_robot_for_unread_acceptances() {
    for (late, blamed) in [(ms(0), 1), (ms(1_000), 0)] {
        let mut bench = Bench { silent: vec![R1], ..Bench::pair() };
        bench.promise(Leases::Fixed);
        bench.run_until(bench.timing().decision - ms(1));
        bench.now = bench.timing().decision + late;
        bench.pump();
        assert_eq!(bench.failed.len(), blamed, "{late} after the decision was due");
        let late = matches!(bench.withdrawn, Some((_, Outcome::DecisionLate { .. })));
        assert_eq!(late, blamed == 0);
    }
}

#[test]
fn no_robot_fails_because_of_disk_delay() {
    for (percent, blamed) in [(10, 1), (80, 0)] {
        let mut bench = Bench { disk: None, silent: vec![R1], ..Bench::pair() };
        bench.promise(Leases::Fixed);
        let (promised, decision) = (bench.now, bench.timing().decision);
        bench.run_until(promised + (decision - promised) * percent / 100);
        bench.take(Arrival::Recorded);
        bench.run_until(decision + ms(1));
        assert_eq!(bench.failed.len(), blamed, "the promise is on the disk after {percent} % of the time");
        let late = matches!(bench.withdrawn, Some((_, Outcome::DecisionLate { .. })));
        assert_eq!(late, blamed == 0);
    }
}

#[test]
fn nothing_is_sent_before_the_promise_is_on_disk() {
    let mut bench = Bench { disk: None, ..Bench::pair() };
    bench.promise(Leases::Shortened);
    assert!(
        matches!(bench.recorded.as_slice(), [(_, Record::Prepared(promise))] if promise.scripts.len() == 2)
    );
    bench.run_until(at(30));
    assert_eq!((bench.act.progress(), bench.sent.len()), (Progressed::Promised, 0));
    assert!(!bench.act.is_open());
    bench.take(Arrival::Recorded);
    assert_eq!((bench.act.progress(), bench.sent.len()), (Progressed::Preparing, 2));
}

#[test]
fn promise_not_on_disk_in_time_is_not_sent() {
    let mut bench = Bench { disk: None, ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_to_the_end();
    let decision = bench.timing().decision;
    assert!(matches!(bench.withdrawn, Some((when, Outcome::DecisionLate { .. })) if when == decision));
    assert!(bench.sent.is_empty());
}

#[test]
fn decision_requires_every_acceptance_and_is_made_once() {
    let mut bench = Bench { silent: vec![R1], ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_until(at(20));
    assert_eq!(bench.act.progress(), Progressed::Preparing);
    bench.silent.clear();
    bench.say(bench.scripts_of(R1)[0], Status::Accepted);
    bench.pump();
    assert_eq!(bench.act.progress(), Progressed::Approaching);
    bench.say(bench.scripts_of(R1)[0], Status::Accepted);
    bench.run_to_the_end();
    assert_eq!(bench.decisions(), [at(20)]);
}

#[test]
fn unanswered_request_is_resent_once_before_its_robot_fails() {
    let mut bench = Bench { silent: vec![R1], ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_to_the_end();
    let (again, decision) = (bench.timing().ask_again(), bench.timing().decision);
    assert_eq!(bench.sent_to(R0).len(), 1);
    assert_eq!(bench.sent_to(R1), [(at(2), 0), (again, 0)]);
    assert!(matches!(bench.failed.as_slice(), [(when, R1, FailureKind::Silent { .. })] if *when == decision));
    assert!(bench.decisions().is_empty());
}

#[test]
fn robot_without_a_link_is_not_resent_anything_and_fails_as_link_down() {
    let mut bench = Bench { silent: vec![R1], ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_until(at(10));
    bench.break_link(R1);
    bench.run_to_the_end();
    assert_eq!(bench.sent_to(R1).len(), 1);
    assert!(matches!(bench.failed.as_slice(), [(_, R1, FailureKind::LinkDown { .. })]));
}

#[test]
fn others_are_decided_without_the_robot_that_did_not_accept() {
    let mut bench = Bench { silent: vec![R1], ..Bench::of_three(Policy::Without) };
    bench.promise(Leases::Shortened);
    bench.run_to_the_end();
    assert_eq!((bench.failed.len(), bench.decisions().len()), (1, 1));
    assert_eq!((bench.state(R0, 0), bench.state(R2, 0)), (&completed(), &completed()));
}

#[test]
fn refusal_of_a_script_is_a_failure() {
    let mut bench = Bench { silent: vec![R1], ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_until(at(10));
    bench.refuse(bench.scripts_of(R1)[0], ErrorCode::Malformed);
    assert!(matches!(bench.failed.as_slice(), [(_, R1, FailureKind::Script { .. })]));
}

#[test]
fn robot_that_reports_nothing_and_is_briefly_full_has_not_accepted() {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 400)]; 2];
    let mut bench = Bench::new(&[Tells::Everything, Tells::Nothing], &scripts);
    bench.silent = vec![R1];
    bench.promise(Leases::Fixed);
    bench.run_until(at(3));
    bench.refuse(bench.scripts_of(R1)[0], ErrorCode::Busy);
    bench.run_until(at(20));
    assert_eq!((bench.act.progress(), bench.failed.len()), (Progressed::Preparing, 0));
    bench.silent.clear();
    bench.run_until(bench.timing().decision);
    assert_eq!(bench.sent_to(R1).len(), 2, "sent again");
    assert_eq!(bench.act.progress(), Progressed::Approaching);
}

#[test]
fn act_is_withdrawn_if_decision_is_too_late_for_leases_to_expire() {
    let mut bench = Bench { silent: vec![R1], ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_until(at(10));
    // This machine was delayed.
    bench.now = bench.timing().brink() - LEASE + ms(1);
    bench.say(bench.scripts_of(R1)[0], Status::Accepted);
    bench.pump();
    assert!(matches!(bench.withdrawn, Some((_, Outcome::DecisionLate { .. }))));
}

#[test]
fn act_is_not_decided_if_a_robot_would_start_before_its_lease_can_end() {
    for (ahead, decided) in [(500, 0), (0, 1)] {
        let mut bench = Bench { silent: vec![R0], ..Bench::new(&[Tells::Everything], &[&[("a", 0, 100)]]) };
        bench.promise(Leases::Shortened);
        bench.run_until(at(10));
        let (now, there) = (bench.now, by_robot(bench.now) + ms(ahead));
        bench.robots[R0].clock.add(ClockSample::from_exchange(now - ROUND_TRIP, there, there, now));
        bench.say(bench.scripts_of(R0)[0], Status::Accepted);
        bench.pump();
        assert_eq!(bench.decisions().len(), decided, "{ahead}");
        let failed = matches!(bench.failed.as_slice(), [(_, R0, FailureKind::Clock { .. })]);
        assert_eq!(failed, decided == 0, "{:?}", bench.failed);
    }
}

#[test]
fn scripts_are_sent_only_up_to_the_capacity_of_a_device() {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 100), ("a", 100, 100), ("a", 200, 100)]];
    let mut bench = Bench::new(&[Tells::Everything], &scripts);
    bench.decide(Leases::Shortened);
    assert_eq!(bench.sent_to(R0).iter().map(|(_, script)| *script).collect::<Vec<_>>(), [0, 1]);
    assert!(bench.decisions().len() == 1, "what waits for room is not waited for");
}

#[test]
fn following_script_of_a_device_is_sent_once_the_first_is_accepted() {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 100), ("a", 100, 100), ("b", 60, 100)]];
    let mut bench = Bench { silent: vec![R0], ..Bench::new(&[Tells::Everything], &scripts) };
    bench.promise(Leases::Shortened);
    bench.run_until(at(10));
    let sent = |bench: &Bench| bench.sent_to(R0).iter().map(|(_, script)| *script).collect::<Vec<_>>();
    assert_eq!(sent(&bench), [0, 2], "were the first one lost, it would begin alone");
    bench.say(bench.scripts_of(R0)[0], Status::Accepted);
    assert_eq!(sent(&bench), [0, 2, 1]);
    bench.say(bench.scripts_of(R0)[2], Status::Accepted);
    bench.pump();
    assert!(bench.decisions().is_empty(), "the mission waits for it");
    bench.say(bench.scripts_of(R0)[1], Status::Accepted);
    bench.pump();
    assert_eq!(bench.decisions().len(), 1);
}

fn completed() -> ScriptState {
    ScriptState::Ended(crate::script::Ending::Completed)
}

#[test]
fn robot_has_accepted_once_all_its_scripts_are_accepted() {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 100), ("b", 0, 100)]];
    let mut bench = Bench { silent: vec![R0], ..Bench::new(&[Tells::Everything], &scripts) };
    bench.promise(Leases::Shortened);
    bench.run_until(at(10));
    let told = |bench: &Bench| {
        bench.told.iter().filter(|(_, told)| matches!(told, Progress::Accepted { .. })).count()
    };
    for (script, accepted) in bench.scripts_of(R0).into_iter().zip([0, 1]) {
        bench.say(script, Status::Accepted);
        assert_eq!(told(&bench), accepted);
    }
}

#[test]
fn request_ids_contain_the_time_of_sending() {
    let mut bench = Bench::pair();
    bench.promise(Leases::Shortened);
    let micros = bench.timing().timestamp.as_nanos() / 1_000;
    let names = [0, 1].map(|robot| {
        let script = bench.scripts_of(RobotIndex::new(robot))[0];
        bench.act.script(script).request_id().unwrap().to_string()
    });
    assert_eq!(names, [format!("{micros}/0/0/0"), format!("{micros}/0/1/0")]);
}

/// Promises an act with these scripts to one robot. Each device has room for two scripts.
fn promised_to_one(scripts: &[Planned], leases: Leases) -> Bench {
    let tells = if leases == Leases::Shortened { Tells::Everything } else { Tells::Reports };
    let mut bench = Bench { silent: vec![R0], ..Bench::new(&[tells], &[scripts]) };
    bench.promise(leases);
    bench.run_until(at(10));
    bench
}

#[test]
fn script_waits_under_its_most_recent_lease() {
    let scripts: [Planned; 5] = [("a", 0, 60), ("a", 60, 60), ("b", 60, 60), ("c", 239, 60), ("d", 240, 60)];
    for leases in [Leases::Shortened, Leases::Fixed] {
        let bench = promised_to_one(&scripts, leases);
        let timing = bench.timing();
        assert_eq!(timing.lead.lease, LEASE);
        let first =
            |offset| if leases == Leases::Shortened { timing.final_lease() + ms(offset) } else { LEASE };
        let running = bench::RUNNING;
        for (script, expected) in [(0, first(0)), (1, running), (2, first(60)), (3, first(239)), (4, LEASE)] {
            let lease = bench.act.members()[MemberIndex::new(0)].pending_lease_now(script, timing);
            assert_eq!(lease, Some(expected), "script {script}, {leases:?}");
        }
    }
}

#[test]
fn scripts_wait_behind_first_one_of_their_device_until_all_are_sent() {
    let scripts: [Planned; 4] = [("a", 0, 60), ("a", 60, 60), ("a", 120, 60), ("b", 60, 60)];
    let mut bench = promised_to_one(&scripts, Leases::Shortened);
    let waits =
        |bench: &Bench| [0, 1, 2, 3].map(|script| bench.act.members()[MemberIndex::new(0)].waits_for(script));
    assert_eq!(waits(&bench), [true, false, false, false]);
    for script in [1, 2] {
        assert!(waits(&bench)[0], "before script {script} is sent");
        let script = bench.scripts_of(R0)[script];
        bench.act.sent(at(11), script);
    }
    assert_eq!(waits(&bench), [false; 4]);
}

#[test]
fn round_asks_a_robot_once_per_start_instant_of_its_devices() {
    for (scripts, questions) in [
        (&[("a", 0, 60), ("a", 60, 60), ("b", 0, 60)][..], 1),
        (&[("a", 0, 60), ("b", 60, 60), ("c", 60, 60)], 2),
        (&[("a", 0, 60), ("b", 60, 60), ("c", 61, 60)], 3),
    ] {
        let bench = promised_to_one(scripts, Leases::Shortened);
        assert_eq!(bench.act.members()[MemberIndex::new(0)].questions(), questions, "{scripts:?}");
    }
}

#[test]
fn scripts_are_held_since_the_request_answered_with_all_of_them() {
    let mut bench = promised_to_one(&[("a", 0, 60), ("a", 60, 60), ("b", 0, 60)], Leases::Shortened);
    let holds = |bench: &Bench, since| {
        bench.act.members()[MemberIndex::new(0)].holds_since(&bench.robots[R0], at(since))
    };
    let scripts = bench.scripts_of(R0);
    bench.robots[R0].contact.questions.asked(at(20));
    bench.robots[R0].contact.questions.answer(at(20));
    bench.report(scripts[0], at(20), RequestState::Held);
    assert!(!holds(&bench, 20), "it has not accepted the other device's first one");
    bench.say(scripts[2], Status::Accepted);
    assert!(!holds(&bench, 20), "it was not asked for it then");
    bench.report(scripts[2], at(20), RequestState::Held);
    assert_eq!([20, 21].map(|since| holds(&bench, since)), [true, false]);
    bench.report(scripts[0], at(30), RequestState::Held);
    bench.report(scripts[2], at(30), RequestState::Held);
    assert!(!holds(&bench, 21), "nothing came in answer to a later question");
    bench.robots[R0].contact.questions.asked(at(30));
    bench.robots[R0].contact.questions.answer(at(30));
    assert!(holds(&bench, 30));
    bench.break_link(R0);
    assert!(!holds(&bench, 30));
}

#[test]
fn robot_without_inquiry_support_holds_accepted_scripts_while_it_answers() {
    let mut bench = promised_to_one(&[("a", 0, 60)], Leases::Fixed);
    let holds = |bench: &Bench, since| {
        bench.act.members()[MemberIndex::new(0)].holds_since(&bench.robots[R0], at(since))
    };
    assert!(!holds(&bench, 0));
    bench.say(bench.scripts_of(R0)[0], Status::Accepted);
    assert!(holds(&bench, 1_000), "it has never answered any");
    bench.robots[R0].contact.questions.asked(at(20));
    bench.robots[R0].contact.questions.answer(at(20));
    assert_eq!([20, 21].map(|since| holds(&bench, since)), [true, false]);
}

#[test]
fn slightly_late_process_has_read_all_answers_and_fails_missing_robot() {
    let mut bench = Bench { silent: vec![R1], ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_until(bench.timing().decision - ms(1));
    bench.now = bench.timing().decision + HELD_UP;
    bench.pump();
    assert!(matches!(bench.failed.as_slice(), [(_, R1, FailureKind::Silent { .. })]), "{:?}", bench.failed);
}

#[test]
fn act_that_does_not_fit_is_checked_again_in_time_or_after_a_change() {
    let mut bench = Bench::pair();
    bench.pump();
    assert_eq!(bench.act.progress(), Progressed::Ready);
    bench.act.look_again_at(Some(at(100)));
    assert_eq!([99, 100].map(|now| bench.act.is_looked_at(at(now))), [false, true]);
    assert_eq!(bench.act.wakeup(), Some(at(100)));
    bench.act.look_again();
    assert!(bench.act.is_looked_at(at(50)));
}
