//! Draws missions with two combinations of events that rarely occur by chance. In the first, the scheduler dies between the decision and
//! the commitment. The mission is resumed before the start while a robot is unreachable. In the second, a link breaks in the middle of a
//! long script, and is re-established well before the lease expires.
//!
//! The times come from a run of the same mission without faults. One seed in fifty is such a mission.

use downbeat_plan::{Choreography, DeviceScript, Way};
use fastrand::Rng;
use urrcp::{ControlType, Millis, Script, Server, Setpoint, Span, Step, StopCondition, Timestamp};

use super::{Drawn, Fault, Network, millis, one_in};
use crate::{Happened, Ran, play};
use downbeat_mission::{Progress, Promise, Record};
use downbeat_rehearsal::dry_run::BEGIN;
use downbeat_rehearsal::world::Direction;

/// Adds one of the two combinations of events to a drawn mission, unless the mission never reaches its first decision.
pub(super) fn bring_together(rng: &mut Rng, drawn: Drawn) -> Drawn {
    if rng.bool() { taken_up_before_the_start(rng, drawn) } else { back_before_the_lease_is_over(rng, drawn) }
}

/// The promise of the first act that is decided, and the times of its decision, commitment and start. Times are relative to the start of
/// the mission.
struct Decision {
    promise: Promise,
    decided: Span,
    committed: Span,
    start: Span,
    /// The instant from which the mission may notice a robot's silence too late.
    doubtful_from: Span,
}

fn first_decision(drawn: &Drawn) -> Option<Decision> {
    let Ran { records, history, .. } = play(drawn.clone().without_faults());
    let at = |of: &dyn Fn(&Record) -> bool| {
        let found: Option<&(Timestamp<Server>, Record)> = records.iter().find(|(_, record)| of(record));
        found.map(|(at, _)| *at - BEGIN)
    };
    let decided = at(&|record| matches!(record, Record::Decided { .. }))?;
    let committed = at(&|record| matches!(record, Record::Committed { .. }))?;
    let doubt = history.iter().find_map(|(_, happened)| match happened {
        Happened::Told(progress) => match **progress {
            Progress::Decided { doubt, .. } => Some(doubt),
            _ => None,
        },
        _ => None,
    })?;
    let promise = records.into_iter().find_map(|(_, record)| match record {
        Record::Prepared(promise) => Some(promise),
        _ => None,
    })?;
    let start = promise.start - BEGIN;
    Some(Decision { promise, decided, committed, start, doubtful_from: start - doubt })
}

fn between(rng: &mut Rng, from: Span, until: Span) -> Span {
    from + Span::from_nanos(rng.i64(0..=(until - from).as_nanos().max(0)))
}

/// Adds that the scheduler dies between the decision and the commitment, and that a robot is unreachable from about then until after the
/// start. Another process resumes the mission when little or no time is left before the start.
fn taken_up_before_the_start(rng: &mut Rng, drawn: Drawn) -> Drawn {
    let Some(decision) = first_decision(&drawn) else { return drawn };
    let robots: Vec<usize> = (0..drawn.robots.len())
        .filter(|robot| {
            let id = &drawn.robots[*robot].block.id;
            decision.promise.scripts.iter().any(|script| script.robot == *id)
        })
        .collect();
    let Some(robot) = rng.choice(robots) else { return drawn };
    // Without the decision on its disk, the process that takes over would withdraw the act.
    let written = decision.decided + drawn.disk.sync;
    let lost = between(rng, written, decision.doubtful_from);
    let dies = (lost + millis(rng, -20, 20)).max(written).min(decision.committed);
    let taken_up =
        decision.start - Span::from_millis_f64(decision.promise.lease.as_millis_f64() * rng.f64() * 0.6);
    let resumed_after = Some((taken_up - dies).max(Span::ZERO));
    let lasts = decision.start - lost + millis(rng, 100, 1_500);
    let faults =
        vec![(lost, out_of_reach(rng, robot, lasts)), (dies, Fault::SchedulerCrash { resumed_after })];
    with_faults(drawn, faults)
}

fn out_of_reach(rng: &mut Rng, robot: usize, lasts: Span) -> Fault {
    match rng.u8(0..6) {
        0..=1 => Fault::Partition { robot, lasts, breaks: rng.bool() },
        2 => Fault::OneWay { robot, way: Direction::ToRobot, lasts },
        3 => Fault::DeadLink { robot, lasts },
        4 => Fault::RobotPause { robot, lasts },
        _ => Fault::RobotCrash { robot, back_after: None, told: false },
    }
}

/// Adds that a link breaks while the robot plays a long script under a lease, and is re-established well before the lease expires.
fn back_before_the_lease_is_over(rng: &mut Rng, mut drawn: Drawn) -> Drawn {
    let lease = millis(rng, 600, 2_500);
    let Some((robot, begins, lasts)) = with_a_long_script(rng, &mut drawn.choreography, lease) else {
        return drawn;
    };
    let Some(robot) = drawn.robots.iter().position(|drawn| drawn.block.id == robot) else { return drawn };
    drawn.network = Network::Stream;
    drawn.tail = 0.0;
    drawn.robots[robot].lie = None;
    drawn.robots[robot].bandwidth = None;
    let Some(decision) = first_decision(&drawn) else { return drawn };
    let begins = decision.start + begins;
    let faults = (0..rng.usize(1..=2)).map(|_| {
        let at = between(rng, begins, begins + lasts - lease);
        let lasts = Span::from_millis_f64(lease.as_millis_f64() * (0.05 + 0.75 * rng.f64()));
        (at, Fault::Partition { robot, lasts, breaks: true })
    });
    let faults = faults.collect();
    with_faults(drawn, faults)
}

/// Makes the last script of a robot in the first act longer than its lease. Returns the index of the robot, the start of the script
/// within the act, and its duration.
fn with_a_long_script(
    rng: &mut Rng,
    choreography: &mut Choreography,
    lease: Span,
) -> Option<(urrcp::RobotId, Span, Span)> {
    if one_in(rng, 2) {
        choreography.acts.truncate(1);
        let act = choreography.acts.first_mut()?;
        (act.next, act.on_timeout, act.on_failure.then) = (Way::End, Way::End, None);
    }
    let plan = &mut choreography.acts.first_mut()?.plan;
    let index = rng.usize(0..plan.robots.len());
    let running = Some(Millis::from_span(lease));
    plan.stop_condition.running = running;
    let scripts = plan.robots.iter_mut().flat_map(|robot| &mut robot.scripts);
    scripts.for_each(|script| script.stop_condition = StopCondition { running, ..script.stop_condition });
    let last = |a: &&mut DeviceScript, b: &&mut DeviceScript| a.start.get().total_cmp(&b.start.get());
    let plays = plan.robots.get_mut(index)?;
    let script = plays.scripts.iter_mut().max_by(last)?;
    let each = lease.as_millis_f64() / 3.0;
    let steps = (0..rng.u32(6..=12)).map(|step| {
        let offset = Millis::new((f64::from(step) * each).round()).ok()?;
        Some(Step {
            offset,
            setpoint: Setpoint::new(ControlType::Position, f64::from(step)),
            stop_condition: None,
        })
    });
    let steps: Vec<Step> = steps.collect::<Option<_>>()?;
    let lasts = steps.last()?.offset.span();
    script.script = Script::new(steps).ok()?;
    Some((plays.robot.clone(), script.start.span(), lasts))
}

fn with_faults(drawn: Drawn, mut faults: Vec<(Span, Fault)>) -> Drawn {
    faults.sort_by_key(|(at, _)| *at);
    Drawn { faults, ..drawn }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{judge, run};

    /// Plays several missions of this family.
    fn such() -> impl Iterator<Item = Ran> {
        (0..10_000).filter(|seed| seed % super::super::FAMILIES == super::super::TOGETHER).map(run)
    }

    fn first(ran: &Ran, of: impl Fn(&Happened) -> bool) -> Option<Timestamp<Server>> {
        ran.history.iter().find(|(_, happened)| of(happened)).map(|(at, _)| *at)
    }

    #[test]
    fn processes_die_between_decision_and_commitment_and_resume_before_start() {
        let mut found = 0;
        for ran in such() {
            let crash =
                |happened: &Happened| matches!(happened, Happened::Fault(Fault::SchedulerCrash { .. }));
            let Some(dies) = first(&ran, crash) else { continue };
            let before = |of: fn(&Record) -> bool| {
                ran.records.iter().take_while(|(at, _)| *at < dies).any(|(_, record)| of(record))
            };
            let decided = before(|record| matches!(record, Record::Decided { .. }));
            let committed = before(|record| matches!(record, Record::Committed { .. }));
            let start = ran.records.iter().find_map(|(_, record)| match record {
                Record::Prepared(promise) => Some(promise.start),
                _ => None,
            });
            let taken_up = first(&ran, |happened| matches!(happened, Happened::TakenUp("resumed")));
            found += usize::from(
                decided && !committed && taken_up.zip(start).is_some_and(|(at, start)| at < start),
            );
        }
        assert!(found >= 15, "{found} of 200");
    }

    #[test]
    fn links_break_during_play_and_recover_before_the_lease_expires() {
        let mut found = 0;
        for ran in such() {
            let Some(lease) = ran.drawn.choreography.acts[0].plan.stop_condition.running else { continue };
            let breaks = |fault: &&(Span, Fault)| matches!(fault.1, Fault::Partition { breaks: true, .. });
            let Some((at, Fault::Partition { robot, .. })) = ran.drawn.faults.iter().find(breaks) else {
                continue;
            };
            let at = BEGIN + *at;
            let again = ran.history.iter().find(|(when, happened)| {
                *when > at && matches!(happened, Happened::LinkUp(of) if of == robot)
            });
            let within = again.is_some_and(|(when, _)| *when < at + lease.span());
            let set = |after: bool| {
                ran.logs[*robot].iter().any(|entry| {
                    let when = Timestamp::<Server>::from_nanos(entry.true_ns);
                    entry.step.is_some() && if after { when > at } else { when <= at }
                })
            };
            found += usize::from(within && set(false) && set(true));
        }
        assert!(found >= 40, "{found} of 200");
    }

    #[test]
    fn missions_with_combined_events_violate_no_invariant() {
        for ran in such() {
            assert_eq!(judge(&ran).violations, [], "seed {}", ran.drawn.seed);
        }
    }
}
