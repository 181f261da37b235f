//! The possible spread of the starts of an act, as far as the clocks of the robots and the latencies of their devices are known.

use std::collections::HashMap;

use downbeat_plan::Plan;
use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, RobotId, Span, Timestamp};

use super::act::Member;
use super::failure_kind::FailureKind;
use super::robot_state::{RobotState, Robots, Standing};
use super::{ClockMode, RobotIndex};

/// The predicted spread of starts with its components.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SkewBudget {
    /// The latest possible start of a motion minus the earliest one.
    #[serde(rename = "predicted_ms")]
    pub predicted: Span,
    /// The latest possible start of a command minus the earliest one. Commands depend only on clocks and wake-ups.
    #[serde(rename = "clocks_ms")]
    pub clocks: Span,
    /// The scenario's `start_tolerance`.
    #[serde(rename = "tolerance_ms")]
    pub tolerance: Span,
    /// The contribution of each robot to the spread.
    pub robots: Vec<RobotSkew>,
    /// The index of each robot in `robots`.
    #[serde(skip)]
    place: HashMap<RobotId, usize>,
}

/// The possible start of a robot, relative to the plan: from `offset` - `uncertainty` to `offset` + `uncertainty` + `wake_up`. The
/// motions of its devices may begin earlier and later by `latency_spread`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotSkew {
    /// The robot's id.
    pub robot: RobotId,
    /// How early the robot starts, as measured: by how much its clock is ahead of the server's. Zero if requests are translated into the
    /// robot's time.
    #[serde(rename = "offset_ms")]
    pub offset: Span,
    /// The uncertainty of the offset.
    #[serde(rename = "uncertainty_ms")]
    pub uncertainty: Span,
    /// How late the robot may wake up.
    #[serde(rename = "wake_up_ms")]
    pub wake_up: Span,
    /// 95 % of the motions of the devices that the act moves begin within their latency ± this time.
    #[serde(rename = "latency_spread_ms")]
    pub latency_spread: Span,
}

impl RobotSkew {
    /// The skew of a robot that moves these devices; `None` while its clock is unknown. If requests are translated into the robot's time,
    /// `strayed` returns the remaining offset of its clock.
    fn of<'a>(
        robot: &RobotState,
        devices: impl Iterator<Item = &'a DeviceId>,
        at: Timestamp<urrcp::Server>,
        strayed: impl Fn(Span) -> Span,
    ) -> Option<Self> {
        let reading = robot.clock_at(at)?;
        let offset = match robot.settings.clock {
            ClockMode::Ntp => reading.offset,
            ClockMode::Measured => strayed(reading.offset),
        };
        let spreads = devices.filter_map(|device| robot.settings.latencies.get(device));
        let latency_spread = spreads.map(|known| known.latency.spread).max().unwrap_or_default();
        let (robot, wake_up) = (robot.id.clone(), robot.settings.wake_up);
        Some(Self { robot, offset, uncertainty: reading.uncertainty, wake_up, latency_spread })
    }

    /// The robot's earliest and latest start, relative to the plan. A robot whose clock is ahead starts early.
    fn range(&self) -> (Span, Span) {
        (
            Span::ZERO - self.offset - self.uncertainty,
            Span::ZERO - self.offset + self.uncertainty + self.wake_up,
        )
    }

    /// The earliest and latest start of the robot's motions, relative to the plan.
    fn range_of_motions(&self) -> (Span, Span) {
        let (earliest, latest) = self.range();
        (earliest - self.latency_spread, latest + self.latency_spread)
    }
}

impl SkewBudget {
    /// How much later than planned a robot may start; negative if it certainly starts earlier. `None` if the budget does not contain the
    /// robot.
    pub(crate) fn late_of(&self, robot: &RobotId) -> Option<Span> {
        Some(self.robots[*self.place.get(robot)?].range().1)
    }

    /// The offset of a robot's clock, with its uncertainty. If the robot's scripts are translated into its time, this is the offset that
    /// remains after the translation.
    pub(crate) fn offset_of(&self, robot: &RobotId) -> Option<(Span, Span)> {
        let robot = self.robots.get(*self.place.get(robot)?)?;
        Some((robot.offset, robot.uncertainty))
    }

    /// The skew budget of these robots of an act; `None` while the clock of one of them is unknown.
    pub(crate) fn of<'a>(
        members: impl Iterator<Item = &'a Member>,
        robots: &Robots,
        tolerance: Span,
        at: Timestamp<urrcp::Server>,
    ) -> Option<Self> {
        Self::with(members, robots, tolerance, at, |_, _| Span::ZERO)
    }

    /// The skew budget of the participating robots of a plan, before any of it is sent. `index_of` contains the index of each planned
    /// robot.
    pub(crate) fn of_planned(
        plan: &Plan,
        index_of: &[Option<RobotIndex>],
        robots: &Robots,
        at: Timestamp<urrcp::Server>,
    ) -> Option<Self> {
        let planned = plan.robots.iter().zip(index_of);
        let planned = planned.filter_map(|(planned, index)| Some((planned, &robots[(*index)?])));
        let present = planned.filter(|(_, robot)| robot.standing == Standing::In);
        let skews = present.map(|(planned, robot)| {
            let devices = planned.scripts.iter().map(|script| &script.device);
            RobotSkew::of(robot, devices, at, |_| Span::ZERO)
        });
        Self::of_robots(skews.collect(), plan.start_tolerance)
    }

    /// The skew budget of robots to which an act with this start is sent now. Clocks drift until the start, but translations into a
    /// robot's time are made now.
    pub(crate) fn ahead<'a>(
        members: impl Iterator<Item = &'a Member>,
        robots: &Robots,
        tolerance: Span,
        now: Timestamp<urrcp::Server>,
        start: Timestamp<urrcp::Server>,
    ) -> Option<Self> {
        Self::with(members, robots, tolerance, start, |member, offset| {
            robots[member.robot].clock_at(now).map_or(Span::ZERO, |reading| offset - reading.offset)
        })
    }

    /// The skew budget of robots to which an act has been sent. Translations into a robot's time are off by the drift of its clock since
    /// then.
    pub(crate) fn of_sent<'a>(
        members: impl Iterator<Item = &'a Member>,
        robots: &Robots,
        tolerance: Span,
        at: Timestamp<urrcp::Server>,
    ) -> Option<Self> {
        Self::with(members, robots, tolerance, at, |member, offset| offset - member.shift())
    }

    fn with<'a>(
        members: impl Iterator<Item = &'a Member>,
        robots: &Robots,
        tolerance: Span,
        at: Timestamp<urrcp::Server>,
        strayed: impl Fn(&Member, Span) -> Span,
    ) -> Option<Self> {
        let skew = |member: &'a Member| {
            let devices = member.firsts().map(|script| &script.plan.device);
            RobotSkew::of(&robots[member.robot], devices, at, |offset| strayed(member, offset))
        };
        Self::of_robots(members.map(skew).collect(), tolerance)
    }

    fn of_robots(robots: Option<Vec<RobotSkew>>, tolerance: Span) -> Option<Self> {
        let robots = robots.filter(|robots| !robots.is_empty())?;
        // The devices of one robot share its clock. Each may still wake up late, and vary by itself.
        let (predicted, clocks) = match robots.as_slice() {
            [alone] => (alone.wake_up + alone.latency_spread * 2, alone.wake_up),
            _ => (
                width(robots.iter().map(RobotSkew::range_of_motions)),
                width(robots.iter().map(RobotSkew::range)),
            ),
        };
        let place = robots.iter().enumerate().map(|(place, robot)| (robot.robot.clone(), place)).collect();
        Some(Self { predicted, clocks, tolerance, robots, place })
    }

    /// How much earlier and how much later than planned this robot may start. `None` if the budget does not contain the robot.
    pub(crate) fn early_and_late_of(&self, robot: &RobotId) -> Option<(Span, Span)> {
        let (earliest, latest) = self.robots[*self.place.get(robot)?].range();
        Some(((Span::ZERO - earliest).max(Span::ZERO), latest.max(Span::ZERO)))
    }

    /// How much earlier and how much later than planned any robot may start.
    pub(crate) fn early_and_late(&self) -> (Span, Span) {
        let earliest = self.robots.iter().map(|robot| robot.range().0).min().unwrap_or_default();
        let latest = self.robots.iter().map(|robot| robot.range().1).max().unwrap_or_default();
        ((Span::ZERO - earliest).max(Span::ZERO), latest.max(Span::ZERO))
    }

    /// The robots that may start earlier than planned by more than `by`.
    pub(crate) fn earlier_than(&self, by: Span) -> Vec<(RobotId, FailureKind)> {
        let early = self.robots.iter().filter(|robot| Span::ZERO - robot.range().0 > by);
        early.map(|robot| self.failure(robot)).collect()
    }

    fn failure(&self, robot: &RobotSkew) -> (RobotId, FailureKind) {
        let (offset, uncertainty) = (robot.offset, robot.uncertainty);
        (robot.robot.clone(), FailureKind::Clock { offset, uncertainty, tolerance: self.tolerance })
    }

    /// The components of the budget, as text to follow the total; empty if no latency varies.
    #[must_use]
    pub fn parts(&self) -> String {
        if self.predicted == self.clocks {
            String::new()
        } else {
            format!(" ({} from the clocks alone, the rest from varying latencies)", self.clocks)
        }
    }

    pub(crate) fn fits(&self) -> bool {
        self.predicted <= self.tolerance
    }

    /// The median clock offset of the fleet. For an even number of robots there are two middle offsets; the one nearer to this machine's
    /// clock is used.
    fn middle(&self) -> Span {
        let mut offsets: Vec<Span> = self.robots.iter().map(|robot| robot.offset).collect();
        offsets.sort_unstable();
        let (low, high) = (offsets.len().saturating_sub(1) / 2, offsets.len() / 2);
        offsets
            .get(low..=high)
            .unwrap_or_default()
            .iter()
            .copied()
            .min_by_key(|at| at.abs())
            .unwrap_or_default()
    }

    /// The robots that make the spread exceed the tolerance: those that may start further than half the tolerance from the middle of the
    /// fleet.
    pub(crate) fn offenders(&self) -> Vec<(RobotId, FailureKind)> {
        if self.fits() {
            return Vec::new();
        }
        let middle = self.middle();
        let half = self.tolerance / 2;
        let is_far = |(earliest, latest): (Span, Span)| {
            (Span::ZERO - middle) - earliest > half || latest - (Span::ZERO - middle) > half
        };
        let of = |robot: &RobotSkew| {
            if is_far(robot.range()) {
                return Some(self.failure(robot));
            }
            let kind = FailureKind::LatencySpread { spread: robot.latency_spread, tolerance: self.tolerance };
            is_far(robot.range_of_motions()).then(|| (robot.robot.clone(), kind))
        };
        self.robots.iter().filter_map(of).collect()
    }
}

/// The time from the earliest to the latest instant of these ranges.
fn width(ranges: impl Iterator<Item = (Span, Span)> + Clone) -> Span {
    let latest = ranges.clone().map(|range| range.1).max().unwrap_or_default();
    let earliest = ranges.map(|range| range.0).min().unwrap_or_default();
    latest - earliest
}

#[cfg(test)]
mod tests {
    use downbeat_fleet::fleet::{DeviceLatency, LatencySource};

    use super::*;
    use crate::bench::{self, R0, R1, Tells, at, ms};
    use crate::clock::ClockSample;

    #[test]
    fn wrong_one_of_two_diverging_clocks_is_named() {
        let scripts: [&[bench::Planned]; 2] = [&[("a", 0, 400)]; 2];
        let choreography = bench::played(&scripts);
        for (first, second, off) in
            [(-1, 1_800, "r1"), (1_800, -1, "r0"), (-1_800, 1, "r0"), (1, -1_800, "r1")]
        {
            let mut robots =
                Robots::from_iter(["r0", "r1"].map(|name| bench::robot(name, Tells::Everything, 2)));
            for (robot, ahead) in robots.iter_mut().zip([first, second]) {
                let instant = at(10 + ahead).assume_clock();
                robot.clock.add(ClockSample::from_exchange(at(9), instant, instant, at(11)));
            }
            let members = crate::act::members(&choreography.acts[0].plan, &robots);
            let budget = SkewBudget::of(members.iter(), &robots, ms(60), at(11)).unwrap();
            let plan = &choreography.acts[0].plan;
            let planned = SkewBudget::of_planned(plan, &[Some(R0), Some(R1)], &robots, at(11));
            let ranges = |budget: &SkewBudget| (budget.predicted, budget.clocks, budget.robots.clone());
            assert_eq!(planned.as_ref().map(ranges), Some(ranges(&budget)), "before anything is sent");
            let offenders: Vec<_> = budget.offenders().into_iter().map(|(id, _)| id.to_string()).collect();
            assert_eq!(offenders, [off], "{first} and {second} ms ahead");
        }
    }

    #[test]
    fn robot_is_far_from_the_others_only_beyond_half_the_tolerance() {
        let scripts: [&[bench::Planned]; 3] = [&[("a", 0, 400)]; 3];
        let choreography = bench::played(&scripts);
        for (second, third) in [(20, -60), (-20, 60)] {
            let mut robots =
                Robots::from_iter(["r0", "r1", "r2"].map(|name| bench::robot(name, Tells::Everything, 2)));
            for (robot, ahead) in robots.iter_mut().zip([0, second, third]) {
                let instant = at(10 + ahead).assume_clock();
                robot.clock.add(ClockSample::from_exchange(at(9), instant, instant, at(11)));
            }
            let members = crate::act::members(&choreography.acts[0].plan, &robots);
            let budget = SkewBudget::of(members.iter(), &robots, ms(60), at(11)).unwrap();
            let middle = Span::ZERO - budget.middle();
            let (earliest, latest) = budget.robots[1].range();
            let distance = (middle - earliest).max(latest - middle);
            let offenders = |tolerance| {
                let budget = SkewBudget { tolerance, ..budget.clone() };
                budget.offenders().into_iter().map(|(id, _)| id.to_string()).collect::<Vec<_>>()
            };
            assert_eq!(offenders(distance * 2), ["r2"], "{second} ms ahead");
            assert_eq!(offenders(distance * 2 - Span::from_nanos(2)), ["r1", "r2"], "{second} ms ahead");
        }
    }

    #[test]
    fn varying_latency_widens_the_budget_and_is_reported_apart_from_clocks() {
        let scripts: [&[bench::Planned]; 2] = [&[("a", 0, 400)]; 2];
        let choreography = bench::played(&scripts);
        let mut robots = Robots::from_iter(["r0", "r1"].map(|name| bench::robot(name, Tells::Everything, 2)));
        for robot in &mut robots {
            let instant = at(10).assume_clock();
            robot.clock.add(ClockSample::from_exchange(at(9), instant, instant, at(11)));
        }
        let budget = |robots: &Robots, tolerance| {
            let members = crate::act::members(&choreography.acts[0].plan, robots);
            SkewBudget::of(members.iter(), robots, tolerance, at(11)).unwrap()
        };
        let plain = budget(&robots, ms(60));
        assert_eq!((plain.predicted, plain.parts().as_str()), (plain.clocks, ""));
        for (device, spread) in [("a", 20), ("other", 500)] {
            let latency = urrcp::Latency { median: ms(40), spread: ms(spread) };
            let latency = DeviceLatency { latency, from: LatencySource::File, lag: None };
            robots[R1].settings.latencies.insert(device.parse().unwrap(), latency);
        }
        let wide = budget(&robots, ms(60));
        assert_eq!((wide.clocks, wide.predicted), (plain.predicted, plain.predicted + ms(40)));
        assert!(wide.fits() && wide.parts().contains("from the clocks alone"), "{wide:?}");
        // The limits of the commands are unchanged.
        let late = |budget: &SkewBudget| budget.late_of(&robots[R1].id);
        assert_eq!(late(&wide), late(&plain));
        let tight = budget(&robots, ms(30));
        let offenders = tight.offenders();
        let [(robot, FailureKind::LatencySpread { spread, .. })] = offenders.as_slice() else {
            panic!("{offenders:?}")
        };
        assert_eq!((robot.as_str(), *spread), ("r1", ms(20)));
    }

    #[test]
    fn budget_for_a_later_start_includes_clock_drift_until_then() {
        let scripts: [&[bench::Planned]; 2] = [&[("a", 0, 400)]; 2];
        let choreography = bench::played(&scripts);
        let mut robots = Robots::from_iter(["r0", "r1"].map(|name| bench::robot(name, Tells::Everything, 2)));
        for robot in &mut robots {
            let instant = at(10).assume_clock();
            robot.clock.add(ClockSample::from_exchange(at(9), instant, instant, at(11)));
        }
        robots[R1].settings.clock = ClockMode::Measured;
        let members = crate::act::members(&choreography.acts[0].plan, &robots);
        let budget = |start| SkewBudget::ahead(members.iter(), &robots, ms(60), at(11), start).unwrap();
        let (now, later) = (budget(at(11)), budget(at(2_011)));
        for (now, later) in now.robots.iter().zip(&later.robots) {
            assert_eq!(later.uncertainty - now.uncertainty, Span::from_micros(200), "100 ppm of 2 s");
        }
        assert_eq!(later.predicted - now.predicted, Span::from_micros(400));
    }

    /// Robots `r0`, `r1` and so on, whose clocks are ahead by `offsets` in milliseconds.
    fn ahead_by(offsets: &[i64]) -> Robots {
        let robot = |(index, ahead): (usize, &i64)| {
            let mut robot = bench::robot(&format!("r{index}"), Tells::Everything, 2);
            let instant = at(10 + ahead).assume_clock();
            robot.clock.add(ClockSample::from_exchange(at(9), instant, instant, at(11)));
            robot
        };
        offsets.iter().enumerate().map(robot).collect()
    }

    fn budget(robots: &Robots) -> SkewBudget {
        let scripts: Vec<&[bench::Planned]> = vec![&[("a", 0, 400)]; robots.len()];
        let choreography = bench::played(&scripts);
        let members = crate::act::members(&choreography.acts[0].plan, robots);
        SkewBudget::of(members.iter(), robots, ms(60), at(11)).unwrap()
    }

    #[test]
    fn lone_robot_spreads_by_its_wake_up_and_its_latency_spread_both_ways() {
        let mut robots = ahead_by(&[30]);
        robots[R0].settings.wake_up = ms(5);
        let latency = urrcp::Latency { median: ms(40), spread: ms(20) };
        let latency = DeviceLatency { latency, from: LatencySource::File, lag: None };
        robots[R0].settings.latencies.insert("a".parse().unwrap(), latency);
        let alone = budget(&robots);
        assert_eq!((alone.clocks, alone.predicted), (ms(5), ms(45)));
    }

    #[test]
    fn clock_ahead_starts_its_robot_early_and_late_wake_up_starts_it_late() {
        let mut robots = ahead_by(&[30, -10]);
        robots[R1].settings.wake_up = ms(5);
        let budget = budget(&robots);
        let [ahead, behind] = budget.robots.as_slice() else { panic!("{budget:?}") };
        assert!((ahead.offset - ms(30)).abs() < Span::from_micros(1), "{ahead:?}");
        let early = ahead.offset + ahead.uncertainty;
        let late = behind.uncertainty - behind.offset + ms(5);
        assert_eq!(budget.early_and_late(), (early, late));
        assert_eq!(budget.predicted, early + late);
        let of = |robot: &str| budget.early_and_late_of(&RobotId::new(robot).unwrap());
        assert_eq!(
            (of("r0"), of("r1"), of("r2")),
            (Some((early, Span::ZERO)), Some((Span::ZERO, late)), None)
        );
        assert_eq!(budget.late_of(&robots[R0].id), Some(ahead.uncertainty - ahead.offset), "surely early");
        let earlier =
            |by| budget.earlier_than(by).into_iter().map(|(id, _)| id.to_string()).collect::<Vec<_>>();
        assert_eq!(earlier(early), Vec::<String>::new());
        assert_eq!(earlier(early - Span::from_nanos(1)), ["r0"]);
    }

    #[test]
    fn budget_as_wide_as_the_tolerance_fits() {
        let wide = budget(&ahead_by(&[0, 20]));
        for (tolerance, fits) in [(wide.predicted, true), (wide.predicted - Span::from_nanos(1), false)] {
            assert_eq!(SkewBudget { tolerance, ..wide.clone() }.fits(), fits);
        }
    }

    #[test]
    fn only_later_clock_drift_affects_translated_requests() {
        let mut robots = ahead_by(&[30, 30]);
        robots[R1].settings.clock = ClockMode::Measured;
        let scripts: [&[bench::Planned]; 2] = [&[("a", 0, 400)]; 2];
        let choreography = bench::played(&scripts);
        let members = crate::act::members(&choreography.acts[0].plan, &robots);
        let offsets = |budget: Option<SkewBudget>| {
            let offset = |robot: &RobotSkew| (robot.offset + Span::from_micros(500)).as_nanos() / 1_000_000;
            budget.unwrap().robots.iter().map(offset).collect::<Vec<_>>()
        };
        let before = SkewBudget::of(members.iter(), &robots, ms(60), at(11));
        assert_eq!(offsets(before), [30, 0]);
        let ahead = SkewBudget::ahead(members.iter(), &robots, ms(60), at(11), at(1_011));
        assert_eq!(offsets(ahead), [30, 0], "its rate is unknown");
        let sent = SkewBudget::of_sent(members.iter(), &robots, ms(60), at(11));
        assert_eq!(offsets(sent), [30, 30], "nothing was translated");
    }

    #[test]
    fn outlier_clock_among_three_robots_is_named_whichever_is_right() {
        let scripts: [&[bench::Planned]; 3] = [&[("a", 0, 400)]; 3];
        let choreography = bench::played(&scripts);
        let mut robots =
            Robots::from_iter(["r0", "r1", "r2"].map(|name| bench::robot(name, Tells::Everything, 2)));
        for (robot, ahead) in robots.iter_mut().zip([1_800, 1, 1_800]) {
            let instant = at(10 + ahead).assume_clock();
            robot.clock.add(ClockSample::from_exchange(at(9), instant, instant, at(11)));
        }
        let members = crate::act::members(&choreography.acts[0].plan, &robots);
        let budget = SkewBudget::of(members.iter(), &robots, ms(60), at(11)).unwrap();
        let offenders: Vec<_> = budget.offenders().into_iter().map(|(id, _)| id.to_string()).collect();
        assert_eq!(offenders, ["r1"]);
    }
}
