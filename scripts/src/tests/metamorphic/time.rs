//! Metamorphic tests of shows that begin later, are split into two acts, or are played faster.

use std::collections::BTreeSet;

use proptest::prelude::*;

use super::super::ways::draw::shows;
use super::super::ways::{Act, Show, Target, Waits};
use super::{all_steps, facts, of, steps, three};
use crate::Code;

/// Removes facts that depend on the length of acts.
fn of_movements(facts: BTreeSet<String>) -> BTreeSet<String> {
    let of_lengths = [Code::LeaseTooLong, Code::ActHasToWait];
    facts.into_iter().filter(|fact| !of_lengths.iter().any(|code| fact.starts_with(code.as_str()))).collect()
}

/// Changes the speed of a show: divides all written times by a factor, and multiplies speeds by it.
fn faster(show: &Show, factor: i64) -> Show {
    let mut fast = show.clone();
    for cue in fast.acts.iter_mut().flat_map(|act| &mut act.cues) {
        cue.at /= factor;
        for (at, value) in &mut cue.keyframes {
            *at /= factor;
            *value *= if cue.by_speed { factor as f64 } else { 1.0 };
        }
    }
    fast
}

/// Splits an act into two acts; the second one begins with the cue at this index.
fn split(show: &Show, act: usize, cue: usize) -> Show {
    let mut parts = show.clone();
    let behind = |target: &mut Target| {
        if let Target::Act(to) = target {
            *to += usize::from(*to > act);
        }
    };
    for written in &mut parts.acts {
        written.next.as_mut().into_iter().chain(&mut written.otherwise).for_each(behind);
        written.then = written.then.map(|then| then + usize::from(then > act));
    }
    let first = &mut parts.acts[act];
    let mut cues = first.cues.split_off(cue);
    let begin = cues[0].at;
    cues.iter_mut().for_each(|cue| cue.at -= begin);
    let second = Act { waits: Waits::Done, otherwise: None, cues, ..first.clone() };
    (first.next, first.then) = (None, None);
    parts.acts.insert(act + 1, second);
    parts
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(80) })]

    #[test]
    fn delaying_all_cues_only_shifts_their_steps(show in shows(), later in 1i64..9_000) {
        let mut shifted = show.clone();
        shifted.acts.iter_mut().flat_map(|act| &mut act.cues).for_each(|cue| cue.at += later);
        let (before, after) = (of(&show, &three()), of(&shifted, &three()));
        prop_assert_eq!(of_movements(facts(&before, |line| line)), of_movements(facts(&after, |line| line)));
        let mut moved = all_steps(&before);
        for step in moved.iter_mut().flatten().flat_map(|steps| steps.values_mut()).flatten() {
            step.0 += later * 1_000_000;
        }
        prop_assert_eq!(moved, all_steps(&after), "{}", show.yaml());
    }

    #[test]
    fn show_at_double_speed_equals_show_with_halved_times(show in shows()) {
        let written = of(&show, &three());
        prop_assume!(written.choreography.is_some());
        let (played, fast) = (written.choreography.unwrap().at_speed(2.0, &three()), of(&faster(&show, 2), &three()));
        prop_assert_eq!(played.is_ok(), fast.choreography.is_some(), "{}{:?}", show.yaml(), fast.findings);
        if let (Ok(played), Some(fast)) = (played, &fast.choreography) {
            let of = |acts: &[crate::Act]| acts.iter().map(steps).collect::<Vec<_>>();
            prop_assert_eq!(of(&played.acts), of(&fast.acts), "{}", show.yaml());
        }
    }

    #[test]
    fn show_at_normal_speed_is_unchanged(show in shows()) {
        let Some(written) = of(&show, &three()).choreography else { return Ok(()) };
        prop_assert_eq!(written.clone().at_speed(1.0, &three()), Ok(written), "{}", show.yaml());
    }

    /// Checks between cues and checks between acts are equivalent for a linear device.
    #[test]
    fn act_split_in_two_has_same_findings(show in shows(), act in 0usize..6, cue in 1usize..5) {
        let act = act % show.acts.len();
        let mut show = show;
        show.acts[act].cues.retain(|cue| cue.kind().moves);
        prop_assume!(cue < show.acts[act].cues.len());
        let parts = split(&show, act, cue);
        let second = parts.line_of_act(act + 1);
        // Two lines are new: the first line of the second part, which corresponds to the first line of the first part, and the last line
        // of the first part.
        let line = |line: usize| match line {
            line if line == second => parts.line_of_act(act),
            line if line > second => line - 2,
            line => line,
        };
        let (before, after) = (of(&show, &three()), of(&parts, &three()));
        // Each part may leave a device in motion that the whole act continues to move.
        let kept = |facts: BTreeSet<String>| {
            of_movements(facts).into_iter().filter(|fact| !fact.starts_with(Code::LeftInMotion.as_str())).collect::<BTreeSet<_>>()
        };
        prop_assert_eq!(kept(facts(&before, |line| line)), kept(facts(&after, line)), "{}{}", show.yaml(), parts.yaml());
    }
}
