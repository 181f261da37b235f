//! Metamorphic tests of loops: acts in a loop are equivalent to the same acts written one after another. An act after other acts is
//! equivalent to the only act of a show whose devices begin where the other acts leave them.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::super::ways::draw::shows;
use super::super::ways::{Act, Show, Target, Waits};
use super::{facts, of, three};
use crate::{Code, Fleet, Severity};

/// Writes the acts of a show one after another, `times` times.
fn rounds(show: &Show, times: usize) -> Show {
    let plain =
        |act: &Act| Act { otherwise: None, next: None, then: None, waits: Waits::Operator, ..act.clone() };
    let acts: Vec<Act> = show.acts.iter().map(plain).collect();
    Show { acts: (0..times).flat_map(|_| acts.clone()).collect(), ..show.clone() }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(80) })]

    /// The looped show leads from its last act back to the first one. It ends if the operator does not give the go.
    #[test]
    fn loop_has_findings_of_its_unrolled_rounds(show in shows()) {
        let once = rounds(&show, 1);
        let mut looped = once.clone();
        let last = looped.acts.len() - 1;
        looped.acts[last].next = Some(Target::Act(0));
        looped.acts[last].otherwise = Some(Target::End);
        let unrolled = rounds(&show, 3);
        let lines = once.line_of_act(last) + once.acts[last].cues.len() + 2 - once.line_of_act(0);
        let first = once.line_of_act(0);
        let line = |line: usize| if line < first { line } else { first + (line - first) % lines };
        let (before, after) = (of(&looped, &three()), of(&unrolled, &three()));
        let rounds: BTreeSet<String> = {
            // Findings that each round repeats are one finding of the loop.
            after.findings.iter().flat_map(|finding| {
                let one = crate::Compiled { findings: vec![finding.clone()], choreography: None };
                facts(&one, line)
            }).collect()
        };
        // Where the first round has a warning about the initial position, a later round may have an error at the same place.
        let surest = |facts: BTreeSet<String>| {
            let sure: BTreeSet<String> = facts.iter().filter_map(|fact| Some(fact.strip_prefix(Code::TooFast.as_str())?.to_owned())).collect();
            facts.into_iter().filter(|fact| fact.strip_prefix(Code::Jump.as_str()).is_none_or(|rest| !sure.contains(rest))).collect::<BTreeSet<_>>()
        };
        prop_assert_eq!(surest(facts(&before, |line| line)), surest(rounds), "{}", looped.yaml());
    }

    #[test]
    fn jumps_in_act_start_from_positions_left_by_previous_acts(show in shows()) {
        let both = rounds(&show, 1);
        prop_assume!(both.acts.len() > 1);
        let Some(choreography) = of(&both, &three()).choreography else { return Ok(()) };
        let (last, before) = choreography.acts.split_last().unwrap();
        let mut left: BTreeMap<(String, String), Option<f64>> = BTreeMap::new();
        for act in before {
            for robot in &act.plan.robots {
                for script in &robot.scripts {
                    let setpoint = &script.script.steps().last().unwrap().setpoint;
                    let position = (setpoint.control_type == urrcp::ControlType::Position).then_some(setpoint.value);
                    left.insert((robot.robot.to_string(), script.device.to_string()), position);
                }
            }
        }
        let mut fleet: Fleet = three();
        for robot in &mut fleet.robots {
            for device in robot.init.iter_mut().flat_map(|block| block.devices.iter_mut()) {
                if let Some(position) = left.get(&(robot.id.to_string(), device.id.to_string())) {
                    device.default_value = *position;
                }
            }
        }
        let alone = Show { acts: vec![both.acts[both.acts.len() - 1].clone()], ..both.clone() };
        let begin = both.line_of_act(both.acts.len() - 1);
        let jumps = |compiled: &crate::Compiled, from: usize| -> BTreeSet<String> {
            let own = |finding: &&crate::Finding| finding.code == Code::Jump && finding.line > from;
            let findings = compiled.findings.iter().filter(own).cloned().collect();
            facts(&crate::Compiled { findings, choreography: None }, |line| line - from)
        };
        let (after, own) = (of(&both, &three()), of(&alone, &fleet));
        prop_assert!(own.findings.iter().all(|finding| finding.severity == Severity::Warning), "{:#?}", own.findings);
        prop_assert_eq!(jumps(&after, begin), jumps(&own, alone.line_of_act(0)), "{} {}", last.name, both.yaml());
    }
}
