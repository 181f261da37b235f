//! Shrinks the mission of a seed to the smallest one that violates the same invariant, by removing faults, acts, robots and scripts.

use downbeat_plan::Way;
use urrcp::Span;

use super::draw::{Drawn, DrawnDisk, Network};
use super::{judge, play};

/// Maximum number of attempts to shrink a mission. Each attempt plays one or two missions.
const ATTEMPTS_MAX: usize = 400;

/// A shrunk mission.
#[derive(Clone, Debug)]
pub struct Shrunk {
    /// The drawn mission without the parts that are not necessary for the violation.
    pub drawn: Drawn,
    /// The letter of the invariant that the mission violates.
    pub invariant: char,
}

/// Shrinks the mission of a seed; `None` if the mission violates no invariant.
#[must_use]
pub fn shrunk(seed: u64) -> Option<Shrunk> {
    let drawn = super::draw(seed);
    let invariant = judge(&play(drawn.clone())).violations.first()?.invariant;
    Some(Shrunk { drawn: shrink(drawn, |drawn| violates(drawn, invariant)), invariant })
}

fn violates(drawn: &Drawn, invariant: char) -> bool {
    judge(&play(drawn.clone())).violations.iter().any(|violation| violation.invariant == invariant)
}

/// Removes as many parts of a mission as possible such that `shows` still returns true.
fn shrink(mut drawn: Drawn, shows: impl Fn(&Drawn) -> bool) -> Drawn {
    let mut attempts = 0;
    loop {
        let shorter = simpler(&drawn).into_iter().take(ATTEMPTS_MAX - attempts).find(|simpler| {
            attempts += 1;
            shows(simpler)
        });
        match shorter {
            Some(shorter) => drawn = shorter,
            None => return drawn,
        }
    }
}

/// Returns all missions that lack one more part, starting with the largest parts.
fn simpler(drawn: &Drawn) -> Vec<Drawn> {
    let mut all = Vec::new();
    let mut with = |change: &dyn Fn(&mut Drawn)| {
        let mut simpler = drawn.clone();
        change(&mut simpler);
        all.push(simpler);
    };
    let acts = drawn.choreography.acts.len();
    (0..acts).filter(|_| acts > 1).for_each(|act| with(&|drawn| without_act(drawn, act)));
    (0..drawn.faults.len()).for_each(|fault| {
        with(&|drawn| {
            let _taken_away = drawn.faults.remove(fault);
        })
    });
    for act in 0..acts {
        let robots = drawn.choreography.acts[act].plan.robots.len();
        let without = |robot: usize| {
            move |drawn: &mut Drawn| drop(drawn.choreography.acts[act].plan.robots.remove(robot))
        };
        (0..robots).filter(|_| robots > 1).for_each(|robot| with(&without(robot)));
    }
    for act in 0..acts {
        for robot in 0..drawn.choreography.acts[act].plan.robots.len() {
            let scripts = drawn.choreography.acts[act].plan.robots[robot].scripts.len();
            let without = |script: usize| {
                move |drawn: &mut Drawn| {
                    drop(drawn.choreography.acts[act].plan.robots[robot].scripts.remove(script));
                }
            };
            (0..scripts).filter(|_| scripts > 1).for_each(|script| with(&without(script)));
        }
    }
    if drawn.network != Network::Stream {
        with(&|drawn| drawn.network = Network::Stream);
    }
    if drawn.tail > 0.0 {
        with(&|drawn| drawn.tail = 0.0);
    }
    let simple = DrawnDisk { sync: Span::ZERO, capacity: None, loses_power: false };
    if drawn.disk.sync > Span::ZERO || drawn.disk.capacity.is_some() || drawn.disk.loses_power {
        with(&|drawn| drawn.disk = simple);
    }
    for robot in 0..drawn.robots.len() {
        if drawn.robots[robot].lie.is_some() {
            with(&|drawn| drawn.robots[robot].lie = None);
        }
        if drawn.robots[robot].slow > Span::ZERO {
            with(&|drawn| drawn.robots[robot].slow = Span::ZERO);
        }
    }
    all
}

/// Removes an act, so that later acts have lower indices. Acts that led to the removed act lead to its successor.
fn without_act(drawn: &mut Drawn, act: usize) {
    if act < drawn.comes_after.len() {
        let _taken_away = drawn.comes_after.remove(act);
    }
    let acts = &mut drawn.choreography.acts;
    let follow = acts.remove(act).next;
    let moved = |to: usize| if to > act { to - 1 } else { to };
    let redirected = |way: Way| match way {
        Way::Act(to) if to == act => match follow {
            Way::Act(next) if next != act => Way::Act(moved(next)),
            Way::Act(_) => Way::End,
            other => other,
        },
        Way::Act(to) => Way::Act(moved(to)),
        other => other,
    };
    for left in acts.iter_mut() {
        left.next = redirected(left.next);
        left.on_timeout = redirected(left.on_timeout);
        left.on_failure.then = match left.on_failure.then.map(|to| redirected(Way::Act(to))) {
            Some(Way::Act(to)) => Some(to),
            _ => None,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Fault, draw};

    /// Returns the first drawn mission with several acts and several faults, one of them a stop.
    fn rich() -> Drawn {
        let several = |drawn: &Drawn| drawn.choreography.acts.len() > 2 && drawn.faults.len() > 2;
        let stop = |drawn: &Drawn| drawn.faults.iter().any(|(_, fault)| matches!(fault, Fault::Stop));
        (0..).map(draw).find(|drawn| several(drawn) && stop(drawn)).unwrap()
    }

    #[test]
    fn shrinking_keeps_only_parts_needed_for_the_violation() {
        let stops = |drawn: &Drawn| drawn.faults.iter().any(|(_, fault)| matches!(fault, Fault::Stop));
        let shrunk = shrink(rich(), stops);
        assert_eq!(shrunk.faults.len(), 1, "{:?}", shrunk.faults);
        assert!(stops(&shrunk));
        let acts = &shrunk.choreography.acts;
        assert_eq!(acts.len(), 1);
        assert_eq!(acts[0].next, Way::End);
        assert_eq!(acts[0].plan.robots.len(), 1);
        assert_eq!(acts[0].plan.robots[0].scripts.len(), 1);
        assert_eq!((shrunk.network, shrunk.tail), (Network::Stream, 0.0));
    }

    #[test]
    fn shrunk_missions_can_be_played() {
        for simpler in simpler(&rich()) {
            assert!(!play(simpler).hung);
        }
    }
}
