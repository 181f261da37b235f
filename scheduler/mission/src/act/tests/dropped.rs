//! Tests that a robot that is left out never receives anything again, at any stage of the act.

use super::*;

/// Returns the number of scripts, questions and readings that were requested of a robot.
fn wanted_of(bench: &Bench, robot: RobotIndex) -> usize {
    let read = bench.reads.iter().filter(|(_, read, _)| *read == robot).count();
    bench.sent_to(robot).len() + bench.asked_of(robot).count() + read
}

fn three() -> Bench {
    let scripts: [&[Planned]; 3] = [&[("a", 0, 200), ("a", 200, 200), ("a", 400, 200)]; 3];
    let mut choreography = bench::choreography(&scripts);
    let reading =
        |at| downbeat_plan::PlannedReading { robot: "r1".parse().unwrap(), sensor: "b".parse().unwrap(), at };
    choreography.acts[0].readings = vec![reading(ms(100)), reading(ms(350))];
    Bench { policy: Policy::Without, ..Bench::of(&[Tells::Everything; 3], 2, choreography.into()) }
}

#[test]
fn robot_left_out_at_any_stage_receives_nothing_and_the_others_play() {
    let mut probe = three();
    probe.promise(Leases::Shortened);
    let timing = probe.timing().clone();
    let instants = [
        (at(1), Progressed::Promised),
        (at(2) + ROUND_TRIP / 2, Progressed::Preparing),
        (timing.critical() - ms(1), Progressed::Approaching),
        (timing.commit_from(), Progressed::Committed),
        (timing.start - ms(1), Progressed::Committed),
        (timing.start + ms(50), Progressed::Playing),
        (timing.start + ms(300), Progressed::Playing),
    ];
    for (when, stage) in instants {
        let mut bench = three();
        bench.promise(Leases::Shortened);
        bench.run_until(when);
        assert_eq!(bench.act.progress(), stage);
        bench.act.drop_robot(R1);
        let wanted = wanted_of(&bench, R1);
        bench.run_to_the_end();
        assert_eq!(wanted_of(&bench, R1), wanted, "{stage:?}");
        assert!(bench.act.is_over() && bench.failed.is_empty(), "{stage:?}: {:?}", bench.failed);
        assert!(
            bench.act.member(R0).unwrap().is_done() && bench.act.member(R2).unwrap().is_done(),
            "{stage:?}"
        );
        assert!(bench.act.names_of(R1, bench.now, None).is_empty());
        assert_eq!(bench.act.place_of(R1), None);
    }
}

#[test]
fn script_never_received_by_a_left_out_robot_is_not_resent() {
    let mut bench = Bench { silent: vec![R1], policy: Policy::Without, ..Bench::pair() };
    bench.promise(Leases::Shortened);
    bench.run_until(at(10));
    bench.act.drop_robot(R1);
    bench.report(bench.scripts_of(R1)[0], at(9), RequestState::Unknown);
    assert_eq!(bench.sent_to(R1).len(), 1);
}

#[test]
fn robots_can_join_an_act_only_before_it_is_sent() {
    let mut bench = Bench::pair();
    bench.robots[R1].standing = crate::robot_state::Standing::Absent;
    bench.act.gather(&bench.robots);
    assert_eq!(bench.act.present().count(), 1);
    bench.robots[R1].standing = crate::robot_state::Standing::In;
    bench.act.gather(&bench.robots);
    assert_eq!(bench.act.present().count(), 2);
    bench.decide(Leases::Shortened);
    bench.act.drop_robot(R1);
    bench.act.gather(&bench.robots);
    assert_eq!(bench.act.present().count(), 1);
}

#[test]
fn act_that_waits_for_room_is_over_when_its_robots_are_left_out() {
    let mut bench = Bench::pair();
    bench.pump();
    bench.act.look_again_at(Some(at(900)));
    bench.act.drop_robot(R0);
    bench.act.drop_robot(R1);
    bench.pump();
    assert!(bench.act.is_over());
    assert!(bench.recorded.is_empty());
}
