//! Metamorphic tests: another order of a list, or additional items in it, change nothing.

use proptest::prelude::*;

use super::super::ways::draw::shows;
use super::super::ways::{ROBOTS, Show, fleet_of};
use super::{all_steps, facts, of, three};

fn same(show: &Show, fleet: &crate::Fleet) -> Result<(), TestCaseError> {
    let (before, after) = (of(show, &three()), of(show, fleet));
    prop_assert_eq!(facts(&before, |line| line), facts(&after, |line| line), "{}", show.yaml());
    prop_assert_eq!(all_steps(&before), all_steps(&after), "{}", show.yaml());
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(80) })]

    #[test]
    fn order_of_robots_in_fleet_does_not_change_result(show in shows(), order in Just(ROBOTS.to_vec()).prop_shuffle()) {
        same(&show, &fleet_of(&order))?;
    }

    /// The additional robot does not take part in the mission, so it cannot fail.
    #[test]
    fn idle_robot_changes_nothing(show in shows(), at in 0usize..4) {
        let mut robots = ROBOTS.to_vec();
        robots.insert(at, "idle");
        same(&show, &fleet_of(&robots))?;
    }

    #[test]
    fn order_of_robots_in_cue_does_not_change_result(show in shows()) {
        let mut turned = show.clone();
        turned.acts.iter_mut().flat_map(|act| &mut act.cues).for_each(|cue| cue.robots.reverse());
        let (before, after) = (of(&show, &three()), of(&turned, &three()));
        prop_assert_eq!(facts(&before, |line| line), facts(&after, |line| line), "{}", show.yaml());
        prop_assert_eq!(all_steps(&before), all_steps(&after), "{}", show.yaml());
    }

    /// Each cue has a fixed start.
    #[test]
    fn order_of_cues_in_file_does_not_change_result(show in shows()) {
        let mut turned = show.clone();
        turned.acts.iter_mut().for_each(|act| act.cues.reverse());
        let line = |line: usize| {
            let act = (0..show.acts.len()).rfind(|act| show.line_of_act(*act) <= line);
            let Some(act) = act.filter(|act| show.line_of_act(*act) < line) else { return line };
            let cues = show.acts[act].cues.len();
            show.line_of_cue(act, cues - 1 - (line - show.line_of_cue(act, 0)))
        };
        let (before, after) = (of(&show, &three()), of(&turned, &three()));
        prop_assert_eq!(facts(&before, |line| line), facts(&after, line), "{}", show.yaml());
        prop_assert_eq!(all_steps(&before), all_steps(&after), "{}", show.yaml());
    }
}
