//! Tests of an act from its decision to its start: the leases end before the start unless the act is committed, and it is committed only
//! for valid reasons.

use downbeat_plan::OnDoubt;

use super::*;

/// Returns when the lease of the script with this `id` ends, if the robot receives no further question after this one.
fn ends(question: &Question, id: &urrcp::RequestId) -> Option<Timestamp<Server>> {
    let group = question.named.iter().find(|group| group.requests.contains(id))?;
    Some(question.at + ROUND_TRIP / 2 + group.lease?)
}

#[test]
fn leases_of_requests_before_critical_instant_end_before_the_start() {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 400), ("b", 30, 400)], &[("a", 100, 400)]];
    let mut bench = Bench::new(&[Tells::Everything; 2], &scripts);
    bench.commit(Leases::Shortened);
    let critical = bench.timing().critical();
    let before: Vec<_> = bench.asked.iter().filter(|question| question.at < critical).collect();
    assert!(before.len() >= 12, "{} questions", before.len());
    for question in before {
        for script in bench.scripts_of(question.robot) {
            let script = bench.act.script(script);
            let begins = bench.start() + script.plan.start.span();
            let lease_ends = ends(question, script.request_id().unwrap()).unwrap();
            assert!(lease_ends < begins - bench.timing().lead.margin / 50, "{question:?}");
        }
    }
}

#[test]
fn no_request_is_sent_between_critical_instant_and_commitment() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        let mut bench = Bench::pair();
        bench.decide(leases);
        // The disk does not finish by the critical instant.
        let takes = bench.timing().commit_from() - bench.timing().record_from() + ms(1);
        bench.disk = Some(takes);
        bench.commit_from_here();
        let critical = bench.timing().critical();
        let approaching = |question: &&Question| question.stage == Progressed::Approaching;
        let last = bench.asked.iter().filter(approaching).map(|question| question.at).max().unwrap();
        assert!(critical - last >= ROUND_TRIP, "answers are there by the critical instant: {leases:?}");
        let committed =
            bench.asked.iter().filter(|question| !approaching(question)).map(|question| question.at).min();
        let committed = committed.unwrap();
        assert!(committed >= critical && committed == bench.commitments()[0] + takes, "{leases:?}");
        for robot in 0..2 {
            assert!(
                bench.asked_of(RobotIndex::new(robot)).any(|question| question.at == committed),
                "{leases:?} {robot}"
            );
        }
    }
}

#[test]
fn messages_are_held_only_from_critical_instant_to_commitment() {
    let mut bench = Bench::pair();
    bench.decide(Leases::Shortened);
    let critical = bench.timing().critical();
    assert!(!bench.act.holds_messages_to(R0, critical - Span::from_nanos(1)));
    assert!(bench.act.holds_messages_to(R0, critical) && bench.act.holds_messages_to(R1, critical));
    bench.run_until(bench.start());
    assert_eq!(bench.act.progress(), Progressed::Committed);
    assert!(!bench.act.holds_messages_to(R0, bench.now));
}

#[test]
fn urgent_message_is_sent_to_member_while_lease_can_end_before_start() {
    for (leases, lets_through) in [(Leases::Shortened, true), (Leases::Fixed, false)] {
        let mut bench = Bench::pair();
        bench.decide(leases);
        let (critical, brink) = (bench.timing().critical(), bench.timing().brink());
        assert_eq!(bench.act.lets_through(R0, critical), lets_through, "{leases:?}");
        assert!(!bench.act.lets_through(R0, brink - ms(1)), "{leases:?}: no time is left");
        assert!(!bench.act.lets_through(R2, critical), "{leases:?}: no member");
    }
}

#[test]
fn commitment_requires_an_answer_of_every_robot_in_last_two_rounds() {
    // The robot is silent long enough before the critical instant to miss both of the last rounds.
    for (periods, committed) in [(0, true), (1, true), (4, false)] {
        let mut bench = Bench::pair();
        bench.decide(Leases::Shortened);
        let (critical, period) = (bench.timing().critical(), bench.timing().pace.period);
        bench.run_until(critical - period * periods - period / 2);
        bench.silent = vec![R1];
        bench.run_until(bench.start());
        let went_on = bench.act.progress() == Progressed::Committed;
        assert_eq!(went_on, committed, "silent {periods} periods before: {:?}", bench.failed);
    }
}

#[test]
fn robot_that_lost_its_script_prevents_commitment() {
    let mut bench = Bench::pair();
    bench.decide(Leases::Shortened);
    bench.run_until(bench.timing().critical() - ms(20));
    let script = bench.scripts_of(R1)[0];
    bench.report(script, bench.now, RequestState::Unknown);
    assert!(matches!(bench.failed.as_slice(), [(_, R1, FailureKind::Script { .. })]));
}

#[test]
fn commitment_is_on_disk_before_it_is_sent_to_any_robot() {
    let mut bench = Bench::pair();
    bench.decide(Leases::Shortened);
    bench.disk = Some(ms(20));
    bench.commit_from_here();
    let recorded = bench.commitments();
    assert_eq!(recorded.len(), 1);
    let critical = bench.timing().critical();
    let told = bench.asked.iter().map(|question| question.at).find(|at| *at >= critical).unwrap();
    assert!(told >= recorded[0] + ms(20));
}

#[test]
fn slow_disk_withdraws_the_act_before_any_movement() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        let mut bench = Bench::pair();
        bench.decide(leases);
        bench.disk = None;
        bench.run_to_the_end();
        let (when, outcome) = bench.withdrawn.clone().unwrap();
        assert!(matches!(outcome, Outcome::CommitmentLate { .. }));
        assert!(when < bench.timing().brink());
        assert!(bench.asked.iter().all(|question| question.at < bench.timing().critical()));
        assert!(bench.failed.is_empty(), "it is not the fault of a robot");
    }
}

#[test]
fn process_stalled_past_commitment_fails_no_robot_with_unread_responses() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        let mut bench = Bench::of_three(Policy::Without);
        bench.decide(leases);
        bench.run_until(bench.timing().critical() - ms(30));
        bench.now = bench.timing().brink();
        bench.pump();
        assert!(bench.failed.is_empty(), "{leases:?} {:?}", bench.failed);
        assert!(matches!(bench.withdrawn, Some((_, Outcome::CommitmentLate { .. }))), "{leases:?}");
    }
}

#[test]
fn process_stalled_past_commitment_does_not_record_one_later() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        for late in [Span::from_nanos(1), ms(1_000)] {
            let mut bench = Bench::pair();
            bench.decide(leases);
            bench.run_until(bench.timing().record_from() - ms(1));
            let last = bench.asked.last().unwrap().at;
            bench.now = bench.timing().commit_by(last) + late;
            bench.pump();
            assert_eq!(bench.commitments(), [], "{leases:?} {late}: robots may have lost what they held");
            assert!(
                matches!(bench.withdrawn, Some((_, Outcome::CommitmentLate { .. }))),
                "{leases:?} {late}"
            );
        }
    }
}

/// Returns an act whose process stalls from well before the last rounds until `after` past the critical instant.
fn held_up(leases: Leases, after: Span, silent: &[RobotIndex]) -> Bench {
    let mut bench = Bench::of_three(Policy::Without);
    bench.decide(leases);
    let doubtful = bench.timing().doubtful_from();
    bench.run_until(doubtful - ms(40));
    bench.silent = silent.to_vec();
    bench.run_until(doubtful - ms(1));
    bench.arrivals.retain(|(at, _)| *at < doubtful);
    bench.now = bench.timing().critical() + after;
    bench.take_arrivals();
    bench.pump();
    bench.run_until(bench.start());
    bench
}

#[test]
fn process_stalled_over_last_rounds_asks_again_before_commitment() {
    for after in [Span::ZERO, ms(1), ms(5)] {
        let bench = held_up(Leases::Shortened, after, &[]);
        assert_eq!((bench.act.progress(), &bench.withdrawn), (Progressed::Committed, &None), "{after}");
        let (critical, brink) = (bench.timing().critical(), bench.timing().brink());
        let approaching = |question: &&Question| question.stage == Progressed::Approaching;
        let late: Vec<_> =
            bench.asked.iter().filter(approaching).filter(|asked| asked.at >= critical).collect();
        assert_eq!(
            late.iter().map(|asked| (asked.robot, asked.at)).collect::<Vec<_>>(),
            [(R0, critical + after), (R1, critical + after), (R2, critical + after)]
        );
        for question in late {
            let id = bench.act.script(bench.scripts_of(question.robot)[0]).request_id().unwrap();
            assert_eq!(ends(question, id), Some(brink + ROUND_TRIP / 2), "{after}");
        }
    }
}

#[test]
fn robot_silent_during_a_stall_over_the_last_rounds_prevents_the_start() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        for after in [ms(1), ms(15)] {
            let bench = held_up(leases, after, &[R1]);
            assert!(
                bench.failed.is_empty(),
                "{leases:?} {after}: it had no time to answer, {:?}",
                bench.failed
            );
            let Some((_, Outcome::CommitmentLate { by })) = bench.withdrawn else {
                panic!("{leases:?} {after}: {:?}", bench.act.progress())
            };
            assert!(by >= after, "{leases:?} {after}: {by}");
        }
    }
}

#[test]
fn clock_set_after_decision_is_a_failure_before_commitment() {
    let mut bench = Bench::of_three(Policy::Abort);
    bench.decide(Leases::Shortened);
    bench.run_until(bench.timing().critical() - ms(1));
    let (now, there) = (bench.now, by_robot(bench.now) + ms(500));
    bench.robots[R1].clock.add(ClockSample::from_exchange(now - ROUND_TRIP, there, there, now));
    bench.run_until(bench.start());
    assert!(matches!(bench.failed.as_slice(), [(_, R1, FailureKind::Clock { .. })]), "{:?}", bench.failed);
}

#[test]
fn silent_robot_fails_early_enough_to_commit_the_others() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        let mut bench = Bench::of_three(Policy::Without);
        bench.decide(leases);
        bench.silent = vec![R1];
        bench.run_to_the_end();
        assert!(
            matches!(bench.failed.as_slice(), [(_, R1, FailureKind::Silent { .. })]),
            "{leases:?} {:?}",
            bench.failed
        );
        assert_eq!(bench.withdrawn, None, "{leases:?}");
        let (failed, ..) = bench.failed[0];
        let committed =
            bench.asked_of(R0).find(|question| question.at >= bench.timing().critical()).unwrap().at;
        assert!(failed <= committed && committed < bench.timing().brink(), "{leases:?}");
        assert!(bench.asked_of(R1).all(|question| question.at < failed));
        assert!(bench.state(R0, 0) == bench.state(R2, 0) && bench.act.is_over());
    }
}

#[test]
fn robot_left_out_before_commitment_does_not_delay_the_others() {
    let mut bench = Bench::of_three(Policy::Without);
    bench.decide(Leases::Shortened);
    bench.act.drop_robot(R1);
    bench.commit_from_here();
    assert!(bench.failed.is_empty());
}

#[test]
fn act_without_robots_is_over_without_commitment() {
    let mut bench = Bench::pair();
    bench.decide(Leases::Shortened);
    bench.act.drop_robot(R0);
    bench.act.drop_robot(R1);
    bench.pump();
    assert!(bench.act.is_over());
    assert!(bench.commitments().is_empty());
}

#[test]
fn robot_without_inquiry_support_is_judged_by_its_other_responses() {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 400)]; 2];
    for silent in [false, true] {
        let mut bench = Bench::new(&[Tells::Everything, Tells::Reports], &scripts);
        bench.decide(Leases::Fixed);
        bench.run_until(bench.timing().critical() - bench.timing().pace.period * 4);
        bench.silent = if silent { vec![R1] } else { Vec::new() };
        bench.run_until(bench.start());
        assert_eq!(bench.act.progress() == Progressed::Committed, !silent);
        assert_eq!(bench.failed.len(), usize::from(silent));
    }
}

#[test]
fn following_script_sent_too_late_for_an_inquiry_does_not_prevent_start() {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 400), ("a", 400, 400)], &[("a", 0, 400)]];
    let mut bench = Bench::of(&[Tells::Everything; 2], 1, bench::played(&scripts));
    bench.decide(Leases::Shortened);
    assert_eq!(bench.sent_to(R0).len(), 1);
    bench.run_until(bench.timing().critical() - Span::from_micros(100));
    // An earlier act has just ended on the robot: there is room, and the sent script waits for the commitment.
    bench.act.sent(bench.now, bench.scripts_of(R0)[1]);
    bench.run_until(bench.start());
    assert_eq!((bench.act.progress(), &bench.failed), (Progressed::Committed, &Vec::new()));
}

#[test]
fn much_later_script_keeps_its_lease_and_following_script_is_not_queried() {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 100), ("a", 100, 100), ("b", 60, 100), ("c", 500, 100)]];
    let mut bench = Bench::new(&[Tells::Everything], &scripts);
    bench.decide(Leases::Shortened);
    bench.run_until(bench.timing().critical() - ms(1));
    let named = &bench.asked.last().unwrap().named;
    let id = |script: usize| bench.act.script(bench.scripts_of(R0)[script]).request_id().unwrap();
    let group_of = |script| named.iter().find(|group| group.requests.contains(id(script)));
    let lease_of = |script| group_of(script).unwrap().lease;
    let shortened = lease_of(0).unwrap();
    assert!(shortened < LEASE / 2);
    assert!(group_of(1).is_none(), "it cannot begin without the one before it");
    assert_eq!(lease_of(2), Some(shortened + ms(60)));
    assert_eq!(lease_of(3), None, "it loses its lease long before it would begin");
    // A question without a lease renews everything that the robot has. The shortened leases must be shorter by then.
    let leases: Vec<_> = named.iter().map(|group| group.lease).collect();
    assert_eq!(leases, [Some(shortened), Some(shortened + ms(60)), None]);
}

#[test]
fn no_lease_is_shortened_outside_the_approach() {
    let mut bench = Bench { silent: vec![R1], ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_until(at(10));
    assert!(bench.act.names_of(R0, bench.now, None).iter().all(|group| group.lease.is_none()));
    let mut bench = Bench::pair();
    bench.play(Leases::Shortened);
    assert!(bench.act.names_of(R0, bench.now, None).iter().all(|group| group.lease.is_none()));
}

fn with_doubt(on_doubt: OnDoubt, policy: Policy) -> Bench {
    let mut choreography = bench::choreography(&[&[("a", 0, 400)], &[("a", 0, 400)], &[("a", 0, 400)]]);
    choreography.acts[0].on_doubt = on_doubt;
    Bench { policy, ..Bench::of(&[Tells::Everything; 3], 2, choreography.into()) }
}

#[test]
fn on_doubt_determines_the_effect_of_an_unanswered_commitment() {
    for (on_doubt, failures) in [(OnDoubt::Start, 0), (OnDoubt::Withdraw, 1)] {
        for leases in [Leases::Shortened, Leases::Fixed] {
            let mut bench = with_doubt(on_doubt, Policy::Abort);
            bench.commit(leases);
            bench.silent = vec![R0];
            bench.run_until(bench.start());
            let failed: Vec<_> = bench.failed.iter().map(|(_, robot, _)| *robot).collect();
            assert_eq!(failed, vec![R0; failures], "{on_doubt:?} {leases:?}");
            let by = bench.timing().last_withdrawal();
            assert!(
                bench.failed.iter().all(|(when, ..)| *when == by),
                "a withdrawal still arrives: {leases:?}"
            );
        }
    }
}

#[test]
fn robots_that_answered_the_commitment_start_without_the_doubtful_one() {
    let mut bench = with_doubt(OnDoubt::Withdraw, Policy::Without);
    bench.commit(Leases::Shortened);
    bench.silent = vec![R0];
    bench.run_to_the_end();
    assert_eq!(bench.failed.iter().map(|(_, robot, _)| *robot).collect::<Vec<_>>(), [R0]);
    assert!(bench.act.is_over());
}

#[test]
fn process_stalled_past_last_withdrawal_fails_no_robot_for_unread_answers() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        for late in [Span::ZERO, ms(1_000)] {
            let mut bench = with_doubt(OnDoubt::Withdraw, Policy::Without);
            bench.commit(leases);
            bench.now = bench.timing().begins() + late;
            bench.pump();
            assert!(bench.failed.is_empty(), "{leases:?} {late}: {:?}", bench.failed);
        }
    }
}

#[test]
fn commitment_window_is_reported_once_when_all_have_answered() {
    let mut bench = Bench::pair();
    bench.commit(Leases::Shortened);
    bench.run_to_the_end();
    let windows = bench.told.iter().filter_map(|(_, progress)| match progress {
        Progress::Committed { window, .. } => Some(*window),
        _ => None,
    });
    let windows: Vec<_> = windows.collect();
    assert_eq!(windows, [Some(ROUND_TRIP)]);
}

impl Bench {
    /// Continues until the act is committed.
    fn commit_from_here(&mut self) {
        self.run_until(self.start() - ms(1));
        assert_eq!(self.act.progress(), Progressed::Committed);
    }
}

#[test]
fn rounds_continue_after_commitment_until_robots_have_started() {
    let mut bench = Bench::pair();
    bench.commit(Leases::Shortened);
    let (committed, begun) = (bench.now, bench.timing().begun());
    bench.run_until(begun);
    for robot in 0..2 {
        let rounds = bench
            .asked_of(RobotIndex::new(robot))
            .filter(|question| question.at > committed && question.at < begun);
        let rounds: Vec<_> = rounds.map(|question| question.at - committed).collect();
        assert!(rounds.len() >= 2, "{rounds:?} of {}", begun - committed);
    }
}

#[test]
fn no_commitment_window_is_reported_without_all_answers_before_start() {
    let mut bench = with_doubt(OnDoubt::Start, Policy::Without);
    bench.commit(Leases::Shortened);
    bench.silent = vec![R0];
    bench.run_until(bench.start() + ms(5));
    bench.silent.clear();
    bench.run_to_the_end();
    let tells = |progress: &Progress| matches!(progress, Progress::Committed { .. });
    assert!(!bench.told.iter().any(|(_, progress)| tells(progress)));
    assert_eq!(bench.timing().round, None);
}

#[test]
fn leases_end_together_even_if_the_clock_of_a_robot_is_ahead() {
    let mut bench = Bench::pair();
    bench.promise(Leases::Shortened);
    bench.run_until(bench.timing().critical() - ms(20));
    assert_eq!(bench.act.progress(), Progressed::Approaching);
    let brink = bench.timing().brink();
    let until = |ahead| bench.act.names_of(R0, bench.now, ahead)[0].until.unwrap();
    for ahead in [bench.timing().early(), ms(-35)] {
        assert_eq!(until(Some(ahead)), (brink + ahead).assume_clock());
    }
    assert_eq!(until(None), brink.assume_clock());
}

#[test]
fn clock_change_is_detected_at_next_response_of_robot() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        let mut bench = Bench::of_three(Policy::Abort);
        bench.decide(leases);
        bench.run_until(bench.now + ms(10));
        assert_eq!(bench.act.strayed(bench.now, &bench.robots), []);
        let (now, there) = (bench.now, by_robot(bench.now) + ms(500));
        bench.robots[R1].clock.add(ClockSample::from_exchange(now - ROUND_TRIP, there, there, now));
        let strayed = bench.act.strayed(now, &bench.robots);
        assert!(matches!(strayed.as_slice(), [(R1, FailureKind::Clock { .. })]), "{leases:?}: {strayed:?}");
    }
}

#[test]
fn clock_change_within_tolerance_shifts_end_of_all_leases() {
    for (ahead, leases) in [6, -6].into_iter().flat_map(|by| [(by, Leases::Shortened), (by, Leases::Fixed)]) {
        let mut bench = Bench::of_three(Policy::Abort);
        bench.decide(leases);
        let (brink, commit_from) = (bench.timing().brink(), bench.timing().commit_from());
        let doubt = bench.timing().doubt();
        let (now, there) = (bench.now, by_robot(bench.now) + ms(ahead));
        bench.robots[R1].clock.add(ClockSample::from_exchange(now - ROUND_TRIP, there, there, now));
        assert_eq!(bench.act.strayed(now, &bench.robots), []);
        let told = bench.act.allow_for(now, &bench.robots);
        let timing = bench.timing();
        match told.first() {
            Some(ActAction::Tell(Progress::Decided { doubt: told, .. })) => {
                assert!(*told > doubt && *told == timing.doubt(), "{leases:?} {ahead}");
            }
            _ => assert_eq!((ahead, leases, timing.doubt()), (-6, Leases::Fixed, doubt)),
        }
        assert!(timing.brink() <= brink - ms(ahead.max(0) - 2), "it does not start before its lease ends");
        assert!(
            timing.commit_from() + timing.final_lease() >= timing.start - ms(ahead.min(0)),
            "the commitment carries it over its start"
        );
        assert!(ahead > 0 || leases == Leases::Shortened || timing.commit_from() > commit_from);
        bench.commit_from_here();
    }
}

#[test]
fn withdrawn_script_ends_before_its_start_and_no_earlier_than_needed() {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 100), ("a", 100, 100), ("b", 60, 100), ("c", 500, 100)]];
    let mut bench = Bench::new(&[Tells::Everything], &scripts);
    bench.decide(Leases::Shortened);
    let withdrawn = |bench: &Bench| bench.act.to_withdraw(R0, bench.now, None);
    let [first, second] =
        withdrawn(&bench).try_into().expect("what begins a device, in groups of one instant");
    for (named, offset) in [(&first, ms(0)), (&second, ms(60))] {
        assert_eq!(named.requests.len(), 1);
        assert_eq!(named.until, Some((bench.timing().brink() + offset).assume_clock()));
        assert_eq!(named.lease, Some(bench.timing().lease_at(bench.now) + offset));
    }
    assert!(bench.now + first.lease.unwrap() <= bench.timing().brink());
    let at_the_brink = bench.act.to_withdraw(R0, bench.timing().brink(), None);
    assert!(at_the_brink.is_empty(), "its lease has ended by then");
    bench.commit_from_here();
    assert!(withdrawn(&bench).is_empty(), "it may have begun");
}

#[test]
fn pending_limit_precedes_start_by_same_clock_at_any_clock_change() {
    for ahead in [-500, 0, 5, 100, 500].map(ms) {
        let mut bench =
            Bench::new(&[Tells::Everything], &[&[("a", 0, 100), ("a", 100, 100), ("b", 60, 100)]]);
        bench.decide(Leases::Shortened);
        let start = |offset: i64| by_robot(bench.timing().start + ms(offset));
        let named = bench.act.to_withdraw(R0, bench.now, Some(ahead));
        let untils: Vec<_> = named.iter().filter_map(|named| named.until).collect();
        assert!(untils.len() == 2 && untils[0] < start(0) && untils[1] < start(60), "{ahead}");
        let of_request = |script: usize| {
            let script = ScriptRef { act: bench.act.number(), member: MemberIndex::new(0), script };
            bench.act.pending_until(script, Some(ahead)).unwrap()
        };
        assert!(
            of_request(0) < start(0) && of_request(1) < start(100) && of_request(2) < start(60),
            "{ahead}"
        );
    }
}

#[test]
fn script_sent_after_commitment_may_start() {
    let mut bench = Bench::new(&[Tells::Everything], &[&[("a", 0, 100), ("a", 100, 100)]]);
    bench.decide(Leases::Shortened);
    let script = ScriptRef { act: bench.act.number(), member: MemberIndex::new(0), script: 1 };
    let start = by_robot(bench.timing().start + ms(100));
    assert!(bench.act.pending_until(script, None).unwrap() < start);
    bench.commit_from_here();
    assert!(bench.act.pending_until(script, None).unwrap() >= start + ms(1_000));
}

#[test]
fn lone_robot_fails_if_its_clock_would_start_it_before_its_lease_ends() {
    for (ahead, fails) in [(500, true), (0, false)] {
        let mut bench = Bench::new(&[Tells::Everything], &[&[("a", 0, 100)]]);
        bench.decide(Leases::Shortened);
        let (now, there) = (bench.now, by_robot(bench.now) + ms(ahead));
        bench.robots[R0].clock.add(ClockSample::from_exchange(now - ROUND_TRIP, there, there, now));
        assert_eq!(bench.act.strayed(now, &bench.robots), [], "it is with the others, as there are none");
        let told = bench.act.allow_for(now, &bench.robots);
        let failed = matches!(told.as_slice(), [ActAction::Fail(failing)]
            if matches!(failing.as_slice(), [(R0, FailureKind::Clock { .. })]));
        assert_eq!(failed, fails, "{told:?}");
    }
}

#[test]
fn clock_set_back_beyond_a_lease_does_not_postpone_commitment_forever() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        let mut bench = Bench::new(&[Tells::Reports], &[&[("a", 0, 100)]]);
        bench.decide(leases);
        let (now, there) = (bench.now, by_robot(bench.now) - ms(2_200));
        bench.robots[R0].clock.add(ClockSample::from_exchange(now - ROUND_TRIP, there, there, now));
        assert_eq!(bench.act.strayed(now, &bench.robots), [], "it is with the others, as there are none");
        let _told = bench.act.allow_for(now, &bench.robots);
        let timing = bench.timing();
        assert!(timing.commit_from() < timing.commit_by(timing.critical()), "{leases:?}");
        bench.commit_from_here();
    }
}

#[test]
fn robot_not_reached_for_longer_than_its_lease_has_lost_its_script() {
    let mut bench = Bench::new(&[Tells::Everything, Tells::Nothing], &[&[("a", 0, 400)], &[("a", 0, 400)]]);
    bench.decide(Leases::Fixed);
    let now = bench.now;
    let held = by_robot(now);
    let ran_out = |before, at| bench.act.ran_out(now, R1, before, at);
    assert_eq!(ran_out(held, held + LEASE), None);
    assert!(matches!(ran_out(held, held + LEASE + ms(1)), Some(FailureKind::Script { .. })));
    assert_eq!(ran_out(held - LEASE, held + ms(10)), None, "it had nothing before it accepted it");
    let late = bench.timing().no_return() + ms(1);
    assert_eq!(bench.act.ran_out(late, R1, held, held + LEASE * 2), None);
}
