//! Checks invariant (b): nothing starts late, and nothing happens twice. An act is prepared again only if none of its robots has started
//! it.

use std::collections::HashSet;

use urrcp::Span;

use super::Verdict;
use super::facts::Facts;

/// Maximum delay after which a robot still starts a command.
const START_LATE_MAX: Span = Span::from_millis(51);

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    for act in facts.acts.iter().filter(|act| act.repeated) {
        let honest = act.scripts.iter().filter(|script| facts.honest(script.robot));
        for script in honest.filter(|script| script.began()) {
            let number = act.promise.number;
            verdict.violated(
                'b',
                format!(
                    "r{} started act {number}, although the act was withdrawn and prepared again",
                    script.robot
                ),
            );
        }
    }
    for (robot, log) in facts.ran.logs.iter().enumerate().filter(|(robot, _)| facts.honest(*robot)) {
        let mut done: HashSet<(&str, u32)> = HashSet::new();
        for entry in log.iter().filter(|entry| entry.is_set()) {
            let (Some(id), Some(step)) = (entry.request_id.as_deref(), entry.step) else { continue };
            if !done.insert((facts.promised_name(robot, id), step)) {
                verdict.violated('b', format!("r{robot} executed step {step} of {id} twice"));
            }
            let late = entry.set_at - entry.due;
            if step == 0 && late > START_LATE_MAX && !facts.clock_was_set(robot) {
                verdict.violated('b', format!("r{robot} started {id} {late} late"));
            }
        }
    }
}
