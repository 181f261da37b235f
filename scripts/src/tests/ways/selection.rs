//! Selections of a show: only one act, all acts from a given one on, only some of the robots, or another speed.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::{DEVICES, ROBOTS, Show};
use crate::{Choreography, Fleet};

/// Returns the first position of each device in a choreography that starts with the act `first`.
fn stated(choreography: &Choreography, first: usize) -> BTreeMap<(String, String), f64> {
    let uses = choreography.first_uses(first);
    let positions = uses.iter().filter_map(|first| choreography.first_position(*first));
    let rounded = |value: f64| (value * 1e9).round() / 1e9;
    positions
        .map(|(robot, device, value)| ((robot.to_string(), device.to_string()), rounded(value)))
        .collect()
}

impl Show {
    /// Returns the first position of each device in these acts. Excludes devices that are first driven by speed.
    fn first_positions(&self, acts: &[usize]) -> BTreeMap<(String, String), f64> {
        let mut positions = BTreeMap::new();
        for (device, kind) in DEVICES.iter().enumerate() {
            for (robot, name) in ROBOTS.iter().enumerate() {
                let first = acts.iter().find_map(|act| self.acts[*act].cues_of(device, robot).next());
                if let Some((_, cue)) = first.filter(|(_, cue)| !cue.by_speed) {
                    positions.insert(((*name).to_owned(), kind.name.to_owned()), cue.first(self.snap).1);
                }
            }
        }
        positions
    }

    /// Returns the acts that follow each other without failures or timeouts, beginning with the act `first`.
    fn from(&self, first: usize) -> Vec<usize> {
        let mut acts = vec![first];
        while let Some(next) = self.next(acts[acts.len() - 1]).filter(|next| !acts.contains(next)) {
            acts.push(next);
        }
        acts
    }

    /// Returns the largest `--speed` factor at which all devices stay within their speed limits.
    fn fastest(&self) -> f64 {
        let mut factor = f64::INFINITY;
        for (device, kind) in DEVICES.iter().enumerate() {
            let Some(limit) = kind.speed else { continue };
            for robot in 0..ROBOTS.len() {
                let poses = self.poses(device, robot);
                for (act, poses) in self.acts.iter().zip(&poses) {
                    let mut before: Vec<f64> =
                        poses.iter().filter(|pose| pose.is_sure).map(|pose| pose.value).collect();
                    for (_, cue) in act.cues_of(device, robot) {
                        let approaches = before.iter().filter_map(|from| cue.approach(*from, self.snap));
                        let speeds =
                            cue.speeds(self.snap).into_iter().map(|(_, speed)| speed).chain(approaches);
                        // For a speed, the values are proportional to the factor.
                        let values = cue.keyframes.iter().map(|(_, value)| value.abs());
                        let all: Vec<f64> = if cue.by_speed { values.collect() } else { speeds.collect() };
                        factor = all.into_iter().map(|speed| limit / speed).fold(factor, f64::min);
                        before = if cue.by_speed { Vec::new() } else { vec![cue.last(self.snap)] };
                    }
                }
            }
        }
        factor
    }
}

/// Compares the compiled and the predicted result of every selection of a show. Returns the number of selections.
pub(super) fn compare(
    show: &Show,
    choreography: &Choreography,
    fleet: &Fleet,
) -> Result<usize, TestCaseError> {
    let acts = show.acts.len();
    for act in 0..acts {
        prop_assert_eq!(
            stated(choreography, act),
            show.first_positions(&show.from(act)),
            "--from act-{}",
            act
        );
        let alone = choreography.clone().act_alone(act);
        prop_assert_eq!(stated(&alone, 0), show.first_positions(&[act]), "--act act-{}", act);
        prop_assert_eq!(&alone.acts[0].plan, &choreography.acts[act].plan);
    }
    let of_act =
        |act: &crate::Act| act.plan.robots.iter().map(|robot| robot.robot.to_string()).collect::<Vec<_>>();
    for some in 1..1 << ROBOTS.len() {
        let chosen =
            |name: &str| ROBOTS.iter().position(|robot| *robot == name).is_some_and(|at| some >> at & 1 == 1);
        let names: Vec<urrcp::RobotId> =
            ROBOTS.iter().filter(|name| chosen(name)).map(|name| name.parse().unwrap()).collect();
        let moved: BTreeSet<usize> =
            show.acts.iter().flat_map(|act| &act.cues).flat_map(|cue| cue.robots.iter().copied()).collect();
        let unmoved: Vec<String> = (0..ROBOTS.len())
            .filter(|robot| chosen(ROBOTS[*robot]) && !moved.contains(robot))
            .map(|robot| ROBOTS[robot].to_owned())
            .collect();
        match choreography.clone().only(&names) {
            Err(unknown) => {
                prop_assert_eq!(unknown.iter().map(ToString::to_string).collect::<Vec<_>>(), unmoved);
            }
            Ok(only) => {
                prop_assert!(unmoved.is_empty());
                for (act, before) in only.acts.iter().zip(&choreography.acts) {
                    let kept: Vec<_> = of_act(before).into_iter().filter(|name| chosen(name)).collect();
                    prop_assert_eq!(of_act(act), kept);
                    let others = act.devices.iter().filter(|used| !chosen(used.robot.as_str())).count();
                    prop_assert_eq!(others, 0, "devices of robots that are left out");
                }
            }
        }
    }
    for factor in [0.25, 1.0, 1.4, 2.0, 3.0] {
        let fastest = show.fastest();
        let played = choreography.clone().at_speed(factor, fleet);
        prop_assert_eq!(
            played.is_ok(),
            factor <= fastest * (1.0 + 1e-6),
            "--speed {}: {} is possible: {:?}",
            factor,
            fastest,
            played.err()
        );
        if let Ok(played) = choreography.clone().at_speed(factor, fleet) {
            for (written, act) in show.acts.iter().zip(&played.acts) {
                let off = act.duration().as_millis_f64() - written.end() as f64 / factor;
                prop_assert!(off.abs() < 1e-3, "an act lasts {} at {factor}", act.duration());
            }
        }
    }
    Ok(acts + (1 << ROBOTS.len()) - 1 + 5)
}
