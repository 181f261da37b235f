//! Predicts the faults of a show by following every transition between acts, for each device of each robot.

use std::collections::BTreeSet;

use super::observed::{arrival, device, keyframe, line};
use super::{Act, Cue, DEVICES, Kind, Lease, ROBOTS, Show, Target, Waits, Word};
use crate::Code;

const LINE_OF_LEASE: usize = 3;

/// The position of a device. `is_sure` is whether a movement has left the device there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pose {
    pub(super) value: f64,
    pub(super) is_sure: bool,
}

/// Which faults a prediction contains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Completeness {
    All,
    /// The prediction excludes movements with invalid values, and transitions to acts that do not exist.
    WithoutMovements,
}

impl Completeness {
    pub(super) fn includes(self, fact: &str) -> bool {
        let of_movements = [Code::TooFast, Code::Jump, Code::LeftInMotion, Code::LeaseTooLong];
        self == Self::All || !of_movements.iter().any(|code| fact.starts_with(code.as_str()))
    }
}

impl Kind {
    fn contains(&self, value: f64) -> bool {
        value >= self.limits[0] && value <= self.limits[1]
    }

    fn multiple(&self, value: f64) -> f64 {
        // Rounded as people write it.
        let multiple = (value / self.granularity).round() * self.granularity;
        (multiple * 1e9).round() / 1e9 + 0.0
    }

    fn is_on_grid(&self, value: f64) -> bool {
        (self.multiple(value) - value).abs() < 1e-6
    }

    /// Returns the multiple of the granularity within the limits that is nearest to a value. Steps inward from the nearest multiple if
    /// that is outside.
    fn nearest(&self, value: f64) -> f64 {
        let mut nearest = self.multiple(value);
        while nearest > self.limits[1] + 1e-9 {
            nearest -= self.granularity;
        }
        while nearest < self.limits[0] - 1e-9 {
            nearest += self.granularity;
        }
        nearest
    }

    /// Returns the fault that the value of a position causes; `None` if the value is valid.
    fn fault(&self, value: f64, snap: bool) -> Option<Code> {
        match (self.contains(value), self.is_on_grid(value)) {
            (true, true) => None,
            (true, false) if snap => Some(Code::Snapped),
            (false, false) if snap && self.contains(self.multiple(value)) => Some(Code::Snapped),
            (true, false) => Some(Code::OffGranularity),
            (false, _) => Some(Code::OutOfRange),
        }
    }
}

impl Cue {
    /// Returns the value to which the device is set. If `snap` is set, positions are moved to the grid.
    pub(super) fn set(&self, value: f64, snap: bool) -> f64 {
        if snap && !self.by_speed { self.kind().nearest(value) } else { value }
    }

    pub(super) fn first(&self, snap: bool) -> (i64, f64) {
        let (at, value) = self.keyframes[0];
        (at, self.set(value, snap))
    }

    pub(super) fn last(&self, snap: bool) -> f64 {
        self.set(self.keyframes[self.keyframes.len() - 1].1, snap)
    }

    /// Returns, for each keyframe but the first, its number from 1 and the speed of the movement that leads to it.
    pub(super) fn speeds(&self, snap: bool) -> Vec<(usize, f64)> {
        let speed = |(index, pair): (usize, &[(i64, f64)])| {
            let way = (self.set(pair[1].1, snap) - self.set(pair[0].1, snap)).abs();
            (index + 2, way * 1_000.0 / (pair[1].0 - pair[0].0) as f64)
        };
        self.keyframes.windows(2).enumerate().map(speed).collect()
    }

    /// Returns the speed of the movement from a position to the first keyframe; `None` if the device takes the first value without a
    /// movement.
    pub(super) fn approach(&self, from: f64, snap: bool) -> Option<f64> {
        let (at, first) = self.first(snap);
        let moves_there = at > 0 && self.kind().moves && !self.by_speed;
        moves_there.then(|| (first - from).abs() * 1_000.0 / at as f64)
    }
}

impl Act {
    /// Returns the act's cues that move one device of a robot, in order, each with its index.
    pub(super) fn cues_of(&self, device: usize, robot: usize) -> impl Iterator<Item = (usize, &Cue)> {
        let own = move |(_, cue): &(usize, &Cue)| cue.device == device && cue.robots.contains(&robot);
        self.cues.iter().enumerate().filter(own)
    }

    /// Returns the position in which the act leaves a device. The device begins at the position `before`. `None` if the final position is
    /// unknown.
    pub(super) fn leaves(
        &self,
        device: usize,
        robot: usize,
        before: Option<Pose>,
        snap: bool,
    ) -> Option<Pose> {
        match self.cues_of(device, robot).last() {
            None => before,
            Some((_, cue)) if cue.by_speed => None,
            Some((_, cue)) => Some(Pose { value: cue.last(snap), is_sure: true }),
        }
    }

    fn word(&self, show: &Show, robot: usize) -> Word {
        let own = self.words.iter().find(|(listed, _)| *listed == robot).map(|(_, word)| *word);
        own.or(self.default).or(show.default).unwrap_or(Word::Stop)
    }
}

impl Show {
    pub(super) fn next(&self, act: usize) -> Option<usize> {
        match self.acts[act].next {
            Some(Target::Act(next)) => Some(next),
            Some(_) => None,
            None => (act + 1 < self.acts.len()).then_some(act + 1),
        }
    }

    /// Whether a robot takes part in the mission: it moves, or reads the sensor for which an act waits.
    fn takes_part(&self, robot: usize) -> bool {
        let waits = |act: &Act| ROBOTS[robot] == "b" && matches!(act.waits, Waits::Above(_) | Waits::Nothing);
        self.acts.iter().any(|act| waits(act) || act.cues.iter().any(|cue| cue.robots.contains(&robot)))
    }

    fn ways(&self, act: usize) -> Vec<Option<usize>> {
        let to = |target: Target| if let Target::Act(act) = target { Some(act) } else { None };
        let otherwise = self.acts[act].otherwise.filter(|target| *target != Target::Nowhere).map(to);
        let then = self.acts[act].then.map(Some);
        std::iter::once(self.next(act)).chain(otherwise).chain(then).collect()
    }

    /// Returns all predicted faults.
    pub(super) fn facts(&self) -> (BTreeSet<String>, Completeness) {
        let (mut facts, mut values) = (BTreeSet::new(), BTreeSet::new());
        if !self.unknown(&mut facts) {
            self.graph(&mut facts);
        }
        self.values(&mut values);
        let is_named = |code: Code, fact: &String| fact.starts_with(code.as_str());
        let are_unknown = facts.iter().any(|fact| is_named(Code::UnknownAct, fact))
            || values.iter().any(|fact| !is_named(Code::Snapped, fact));
        facts.extend(values);
        if are_unknown {
            return (facts, Completeness::WithoutMovements);
        }
        self.within_acts(&mut facts);
        self.between_acts(&mut facts);
        self.at_the_end(&mut facts);
        let is_error = |fact: &String| {
            Code::ALL.iter().any(|code| code.severity() == crate::Severity::Error && is_named(*code, fact))
        };
        if !facts.iter().any(is_error) {
            self.waiting(&mut facts);
        }
        (facts, Completeness::All)
    }

    /// Adds faults about acts and sensors that do not exist, and about impossible readings. Returns whether there are any.
    fn unknown(&self, facts: &mut BTreeSet<String>) -> bool {
        for (index, act) in self.acts.iter().enumerate() {
            let at = self.line_of_act(index);
            if act.next == Some(Target::Nowhere) || act.otherwise == Some(Target::Nowhere) {
                facts.insert(line(Code::UnknownAct, at));
            }
            match act.waits {
                Waits::Nothing => _ = facts.insert(line(Code::UnknownSensor, at)),
                Waits::Above(9..) => _ = facts.insert(line(Code::OutOfRange, at)),
                _ => {}
            }
        }
        !facts.is_empty()
    }

    /// Adds faults about acts that are unreachable, and about acts from which the end is unreachable.
    fn graph(&self, facts: &mut BTreeSet<String>) {
        let count = self.acts.len();
        let leads: Vec<Vec<Option<usize>>> = (0..count).map(|act| self.ways(act)).collect();
        // Whether an act is reachable from another one; each round adds one intermediate act.
        let mut reaches: Vec<Vec<bool>> = (0..count)
            .map(|from| (0..count).map(|to| from == to || leads[from].contains(&Some(to))).collect())
            .collect();
        for _ in 0..count {
            for from in 0..count {
                for to in 0..count {
                    reaches[from][to] |= (0..count).any(|by| reaches[from][by] && reaches[by][to]);
                }
            }
        }
        let ends = |act: usize| {
            let is_end = |by: usize| {
                // The end after a failure is not an end of the show, unlike the end after a timeout.
                let otherwise = self.acts[by].otherwise == Some(Target::End);
                self.next(by).is_none() || otherwise
            };
            (0..count).any(|by| reaches[act][by] && is_end(by))
        };
        let circle = |act: usize| {
            (0..count).filter(|other| reaches[act][*other] && reaches[*other][act]).collect::<Vec<_>>()
        };
        for act in 0..count {
            let own = circle(act);
            let others = || (0..count).filter(|other| !own.contains(other));
            let is_reached = |act: usize| reaches[0][act];
            if !is_reached(act)
                && own[0] == act
                && others().all(|other| is_reached(other) || !reaches[other][act])
            {
                facts.insert(line(Code::Unreachable, self.line_of_act(act)));
            }
            let is_stuck = |act: usize| is_reached(act) && !ends(act);
            if is_stuck(act)
                && own[own.len() - 1] == act
                && others().all(|other| !is_stuck(other) || !reaches[act][other])
            {
                facts.insert(line(Code::DeadEnd, self.line_of_act(act)));
            }
        }
    }

    fn values(&self, facts: &mut BTreeSet<String>) {
        for (index, act) in self.acts.iter().enumerate() {
            for (number, cue) in act.cues.iter().enumerate().filter(|(_, cue)| !cue.by_speed) {
                let faults =
                    cue.keyframes.iter().filter_map(|(_, value)| cue.kind().fault(*value, self.snap));
                facts.extend(faults.map(|code| line(code, self.line_of_cue(index, number))));
            }
        }
    }

    /// Adds faults of movements between keyframes, and between cues of an act.
    fn within_acts(&self, facts: &mut BTreeSet<String>) {
        for (index, act) in self.acts.iter().enumerate() {
            for (number, cue) in act.cues.iter().enumerate().filter(|(_, cue)| !cue.by_speed) {
                let at = self.line_of_cue(index, number);
                let limit = cue.kind().speed.unwrap_or(f64::INFINITY) * (1.0 + 1e-6);
                let fast = cue.speeds(self.snap).into_iter().filter(|(_, speed)| *speed > limit);
                facts.extend(fast.map(|(number, _)| keyframe(Code::TooFast, at, number)));
            }
            for (device, kind) in DEVICES.iter().enumerate().filter(|(_, kind)| kind.moves) {
                for (robot, name) in ROBOTS.iter().enumerate() {
                    let cues: Vec<_> = act.cues_of(device, robot).collect();
                    for pair in cues.windows(2).filter(|pair| !pair[0].1.by_speed) {
                        let from = Pose { value: pair[0].1.last(self.snap), is_sure: true };
                        let at = self.line_of_cue(index, pair[1].0);
                        facts.extend(self.arrives((kind, name), pair[1].1, at, from));
                    }
                }
            }
        }
    }

    /// Returns the fault of a device that is at the position `from` when its movement begins; `None` if there is no fault.
    fn arrives(&self, (kind, robot): (&Kind, &str), cue: &Cue, at: usize, from: Pose) -> Option<String> {
        let is_fault = match cue.approach(from.value, self.snap) {
            Some(speed) => speed > kind.speed? * (1.0 + 1e-6),
            None => (cue.first(self.snap).1 - from.value).abs() > kind.granularity.max(1e-9),
        };
        let code = if from.is_sure && kind.speed.is_some() { Code::TooFast } else { Code::Jump };
        (is_fault && !cue.by_speed).then(|| arrival(code, at, (kind.name, robot), from.value))
    }

    /// Returns the possible positions of one device of a robot at the start of each act, by following every transition from every
    /// position.
    pub(super) fn poses(&self, device: usize, robot: usize) -> Vec<Vec<Pose>> {
        let default = |is_sure: bool| DEVICES[device].default.map(|value| Pose { value, is_sure });
        let begins = (0, default(false));
        // Unreachable acts begin at an unknown position.
        let mut left: Vec<(usize, Option<Pose>)> =
            (0..self.acts.len()).map(|act| (act, None)).chain([begins]).collect();
        let mut seen = Vec::new();
        while let Some((act, pose)) = left.pop() {
            if seen.contains(&(act, pose)) {
                continue;
            }
            seen.push((act, pose));
            let written = &self.acts[act];
            let after = written.leaves(device, robot, pose, self.snap);
            left.extend(self.next(act).map(|next| (next, after)));
            if let Some(Target::Act(otherwise)) = written.otherwise {
                left.push((otherwise, pose));
            }
            let Some(then) = written.then else { continue };
            let words = |word: Word| {
                (0..ROBOTS.len())
                    .filter(move |other| self.takes_part(*other) && written.word(self, *other) == word)
            };
            if words(Word::Home).next().is_some() {
                left.push((then, default(true)));
            }
            // The act ends as written, except for the robot that failed.
            if words(Word::Without).any(|other| other != robot) {
                left.push((then, after));
            }
        }
        let of = |act: usize| {
            let all: Vec<Pose> =
                seen.iter().filter(|(at, _)| *at == act).filter_map(|(_, pose)| *pose).collect();
            let is_known = |pose: &Pose| all.contains(&Pose { is_sure: true, ..*pose });
            all.iter().copied().filter(|pose| pose.is_sure || !is_known(pose)).collect()
        };
        (0..self.acts.len()).map(of).collect()
    }

    fn between_acts(&self, facts: &mut BTreeSet<String>) {
        for (device, kind) in
            DEVICES.iter().enumerate().filter(|(_, kind)| kind.moves || kind.speed.is_some())
        {
            for (robot, name) in ROBOTS.iter().enumerate() {
                for (act, poses) in self.poses(device, robot).into_iter().enumerate() {
                    let Some((number, cue)) = self.acts[act].cues_of(device, robot).next() else { continue };
                    let at = self.line_of_cue(act, number);
                    facts.extend(
                        poses.into_iter().filter_map(|from| self.arrives((kind, name), cue, at, from)),
                    );
                }
            }
        }
    }

    /// Adds faults about speeds that nothing ends, and about leases that have no effect.
    fn at_the_end(&self, facts: &mut BTreeSet<String>) {
        let longest = self.acts.iter().map(Act::end).max().unwrap_or(0);
        match self.lease {
            Lease::Of(lease) if lease > longest && longest > 0 => {
                facts.insert(line(Code::LeaseTooLong, LINE_OF_LEASE));
                return;
            }
            Lease::Usual | Lease::Of(_) => return,
            Lease::None => {}
        }
        for (index, act) in self.acts.iter().enumerate() {
            for (number, kind) in DEVICES.iter().enumerate() {
                for (robot, name) in ROBOTS.iter().enumerate() {
                    let Some((cue, last)) = act.cues_of(number, robot).last() else { continue };
                    if last.by_speed && last.last(self.snap) != 0.0 {
                        facts.insert(device(
                            Code::LeftInMotion,
                            self.line_of_cue(index, cue),
                            (kind.name, name),
                        ));
                    }
                }
            }
        }
    }
}
