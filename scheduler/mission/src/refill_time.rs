//! Checks whether each script that does not fit into its device's queue at first can be sent in time, on the links as measured.
//!
//! A robot refuses a script that arrives late, even in the middle of a show. The command `check` finds scripts that no link could deliver
//! in time. Before anything has moved, this module finds scripts that the current links cannot deliver in time.

use downbeat_plan::{Refill, RefillKind, Wait, refills_behind, refills_of_robots};
use urrcp::{DeviceId, RobotId, Server, Span, Timestamp};

use super::act::LAPSE;
use super::failure_kind::FailureKind;
use super::robot_state::RobotState;
use super::{ClockMode, Mission};

impl Mission {
    /// Refuses robots to whose devices a script cannot be sent in time.
    pub(super) fn check_refills(&mut self, now: Timestamp<Server>) {
        let queue = |robot: &RobotId, device: &DeviceId| self.queue(robot, device);
        let later = |refill: &Refill| refill.kind == RefillKind::Later;
        let refills = refills_of_robots(&self.choreography, queue, self.longest_sending(now));
        for refill in refills.into_iter().filter(later) {
            let Some(robot) = self.robots.position(|robot| robot.id == refill.robot) else { continue };
            let needed = self::sending(&self.robots[robot], now);
            if refill.time < needed {
                let act =
                    Some(self.choreography.acts[refill.act].name.clone()).filter(|name| !name.is_empty());
                let Refill { device, script, time, .. } = refill;
                self.note_failure(robot, FailureKind::NoTimeToSend { device, act, script, time, needed });
            }
        }
    }

    /// Whether a later script of an act could not be sent in time if the act followed the one that still plays. The greeting did not
    /// check this: it assumed that an act that waits for a time finds the devices' queues empty. Here, that time has already passed.
    pub(super) fn is_too_tight_behind(&self, now: Timestamp<Server>, index: usize) -> bool {
        let act = &self.acts[index];
        let before = index.checked_sub(1).map(|before| &self.acts[before]);
        let (Some(before), Wait::Instant(_) | Wait::TimeOfDay(_)) = (before, &act.written().wait) else {
            return false;
        };
        let (Some(timing), Some(target)) = (before.timing(), act.target()) else { return false };
        let pause = (target - timing.end).max(Span::ZERO);
        let queue = |robot: &RobotId, device: &DeviceId| self.queue(robot, device);
        let acts = (before.index().get(), act.index().get());
        let refills = refills_behind(&self.choreography, acts, pause, queue, self.longest_sending(now));
        refills.iter().filter(|refill| refill.kind == RefillKind::Later).any(|refill| {
            let robot = self.robots.iter().find(|robot| robot.id == refill.robot);
            robot.is_some_and(|robot| refill.time < sending(robot, now))
        })
    }

    /// The number of scripts that a device can hold, as its robot has reported; `None` if the robot or the device is not described.
    fn queue(&self, robot: &RobotId, device: &DeviceId) -> Option<u32> {
        let state = self.robots.iter().find(|state| state.id == *robot)?;
        Some(state.block.as_ref()?.device(device.as_str())?.script_queue)
    }

    fn longest_sending(&self, now: Timestamp<Server>) -> Span {
        self.robots.iter().map(|robot| sending(robot, now)).max().unwrap_or_default()
    }
}

/// The minimum time to send a script for which a slot becomes free: the robot reports the end of the previous script, then receives the
/// next one. If the robot does not report by itself, the scheduler asks once the script must have ended, even by the slowest possible
/// clock.
fn sending(robot: &RobotState, now: Timestamp<Server>) -> Span {
    // A few exchanges rarely include the longest one, especially if they differ a lot. A robot plays no part of a late script.
    let round_trip = robot.round_trip();
    let shortest = robot.clock_at(now).map_or(round_trip, |reading| reading.delay_min);
    let round_trip = round_trip + (round_trip / 4).max(round_trip - shortest);
    match (robot.reports(), robot.takes_inquiries()) {
        (true, _) => round_trip,
        (false, true) => round_trip * 2 + LAPSE + late(robot, now),
        (false, false) => round_trip + LAPSE + late(robot, now),
    }
}

/// The maximum delay of a script's end because of its robot's clock and wake-up.
fn late(robot: &RobotState, now: Timestamp<Server>) -> Span {
    let late = robot.clock_at(now).map(|reading| match robot.settings.clock {
        ClockMode::Ntp => reading.uncertainty - reading.offset,
        ClockMode::Measured => reading.uncertainty,
    });
    late.unwrap_or_default().max(Span::ZERO) + robot.settings.wake_up
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ActIndex;
    use crate::bench::{self, R0, R1, Tells, at, ms};
    use crate::clock::ClockSample;

    #[test]
    fn sending_on_a_symmetric_link_takes_one_and_a_quarter_round_trips() {
        let mut robot = bench::robot("r0", Tells::Everything, 2);
        for sent in [0, 20, 40] {
            let there = bench::by_robot(at(sent + 4));
            robot.clock.add(ClockSample::from_exchange(at(sent), there, there, at(sent + 8)));
        }
        assert_eq!(sending(&robot, at(60)), ms(10));
    }

    #[test]
    fn script_end_may_be_late_by_clock_lag_and_late_wake_up() {
        let mut robot = bench::robot("r0", Tells::Answers, 2);
        assert_eq!(late(&robot, at(0)), Span::ZERO);
        robot.settings.wake_up = ms(50);
        let there = bench::by_robot(at(0)) - ms(30);
        robot.clock.add(ClockSample::from_exchange(at(0), there, there, at(0)));
        let behind = late(&robot, at(0));
        assert!((ms(80)..=ms(82)).contains(&behind), "{behind}");
        robot.settings.clock = ClockMode::Measured;
        let measured = late(&robot, at(0));
        assert!((ms(50)..=ms(52)).contains(&measured), "{measured}");
    }

    /// A mission that has greeted two robots with two scripts each, ten milliseconds apart. Their devices hold `queue` scripts, and their
    /// links have these round trips.
    fn greeted(queue: usize, round_trips: [Span; 2]) -> Mission {
        let scripts: &[bench::Planned] = &[("a", 0, 400), ("a", 410, 400)];
        let mut choreography = bench::choreography(&[scripts; 2]);
        choreography.acts[0].name = "one".to_owned();
        let participant = |id: &str| {
            let block = bench::robot(id, Tells::Everything, queue).block;
            crate::Participant::new(RobotId::new(id).unwrap(), block)
        };
        let participants = vec![participant("r0"), participant("r1")];
        let options = crate::MissionOptions::default();
        let mut mission = Mission::new(choreography, participants, options, at(0)).unwrap();
        for (robot, round_trip) in mission.robots.iter_mut().zip(round_trips) {
            let there = bench::by_robot(at(0) + round_trip / 2);
            robot.clock.add(ClockSample::from_exchange(at(0), there, there, at(0) + round_trip));
        }
        mission
    }

    #[test]
    fn robot_with_link_too_slow_for_second_script_is_refused_before_motion() {
        for (queue, round_trip, refused) in
            [(1, ms(8), false), (1, ms(8) + Span::from_micros(1), true), (2, ms(200), false)]
        {
            let mut mission = greeted(queue, [ms(1), round_trip]);
            mission.check_refills(at(1_000));
            assert!(!mission.robots[R0].has_failed());
            let failures: Vec<_> =
                mission.robots[R1].failures.iter().map(|failure| failure.kind.clone()).collect();
            let expected = FailureKind::NoTimeToSend {
                device: "a".parse().unwrap(),
                act: Some("one".to_owned()),
                script: 1,
                time: ms(10),
                needed: round_trip + round_trip / 4,
            };
            assert_eq!(failures, if refused { vec![expected] } else { vec![] }, "{queue}, {round_trip}");
        }
    }

    #[test]
    fn act_waits_for_the_slowest_link() {
        assert_eq!(greeted(1, [ms(8), ms(40)]).longest_sending(at(1_000)), ms(50));
        assert_eq!(greeted(1, [ms(40), ms(8)]).longest_sending(at(1_000)), ms(50));
    }

    #[test]
    fn sending_time_of_non_reporting_robot_includes_wait_for_previous_end() {
        for (tells, takes) in [
            (Tells::Everything, ms(10)),
            (Tells::Reports, ms(10)),
            (Tells::Answers, ms(20) + LAPSE),
            (Tells::Nothing, ms(10) + LAPSE),
        ] {
            let mut robot = bench::robot("r0", tells, 2);
            robot.settings.clock = ClockMode::Measured;
            for sent in [0, 20, 40] {
                let there = bench::by_robot(at(sent + 4));
                robot.clock.add(ClockSample::from_exchange(at(sent), there, there, at(sent + 8)));
            }
            let late = if robot.reports() { Span::ZERO } else { late(&robot, at(60)) };
            assert_eq!(sending(&robot, at(60)), takes + late, "{tells:?}");
        }
    }

    #[test]
    fn overdue_act_is_checked_against_scripts_left_by_the_previous_act() {
        for (wait, round_trip, tight) in [
            (Wait::Instant(at(0)), ms(40), true),
            (Wait::Instant(at(0)), ms(8), false),
            (Wait::Instant(at(600_000)), ms(40), false),
            (Wait::Done, ms(40), false),
        ] {
            // Each act fits by itself. After the other one, its second script has room 20 ms before its start.
            let mut mission = greeted(2, [round_trip; 2]);
            let mut choreography = downbeat_plan::Choreography::clone(&mission.choreography);
            choreography.acts.push(choreography.acts[0].clone());
            choreography.acts[1].wait = wait.clone();
            let short = [("a", 0, 10), ("a", 20, 10)].map(bench::device_script).to_vec();
            choreography.acts[1].plan.robots.iter_mut().for_each(|robot| robot.scripts.clone_from(&short));
            choreography.acts.iter_mut().for_each(|act| act.plan.start_tolerance = ms(2_000));
            mission.choreography = choreography.into();
            mission.options.greeting = crate::Greeting::Skip;
            for robot in 0..2 {
                let _up = mission.handle(at(1_000), crate::Event::LinkUp { robot: robot.into() });
            }
            let _known = mission.handle(at(1_000), crate::Event::Recorded { count: 1 });
            assert!(mission.acts[0].timing().is_some());
            assert!(!mission.is_too_tight_behind(at(1_000), 0), "nothing is before it");
            mission.line_up_act(at(1_000), ActIndex::new(1));
            assert_eq!(mission.is_too_tight_behind(at(1_000), 1), tight, "{wait:?}, {round_trip}");
        }
    }
}
