//! From the decision to the last step: who has started, how exactly, and who has ended.

use urrcp::{ControlResponse, Server, Span, Timestamp};

use super::robot_state::{FailureKind, ScriptPhase, ScriptState};
use super::{Mission, Progress, Timing};
use crate::report::Outcome;

/// How long after its instant a report may still arrive, besides the measured delay.
const REPORT_GRACE: Span = Span::from_millis(500);

impl Mission {
    pub(super) fn started(&mut self, robot: usize, index: usize, response: &ControlResponse) {
        let planned = self.timing.map(|timing| timing.start);
        let state = &mut self.robots[robot];
        let script = &mut state.scripts[index];
        let at = response.event_timestamp.unwrap_or(response.timestamp);
        script.started_at = Some(at);
        script.phase = ScriptPhase::Started;
        let planned = planned.map(|start| start + script.plan.start.span());
        let error = planned.map(|planned| at - planned.assume_clock());
        let robot = state.id.clone();
        self.tell(Progress::Started { robot, error });
    }

    pub(super) fn ended(
        &mut self,
        now: Timestamp<Server>,
        robot: usize,
        index: usize,
        response: &ControlResponse,
    ) {
        let state = &mut self.robots[robot];
        let script = &mut state.scripts[index];
        script.phase = ScriptPhase::Ended;
        let all = u32::try_from(script.plan.script.steps().len()).unwrap_or(u32::MAX);
        script.steps_done = response.steps_done.unwrap_or(all);
        if state.is_done() {
            let robot = state.id.clone();
            self.tell(Progress::Finished { robot });
        }
        self.watch(now);
    }

    /// Ends the mission when all is done, and finds reports that are overdue.
    pub(super) fn watch(&mut self, now: Timestamp<Server>) {
        let Some(timing) = self.timing else { return };
        let grace = self.report_grace();
        if self.robots.iter().all(|robot| robot.is_done() || !robot.reports() && now >= timing.end) {
            self.outcome = Some(Outcome::Done);
            return self.end();
        }
        let overdue = (0..self.robots.len())
            .filter(|robot| self.robots[*robot].reports())
            .flat_map(|robot| (0..self.robots[robot].scripts.len()).map(move |script| (robot, script)))
            .find(|(robot, script)| {
                report_due(&self.robots[*robot].scripts[*script], &timing, grace)
                    .is_some_and(|due| now >= due)
            });
        if let Some((robot, index)) = overdue {
            let script = &self.robots[robot].scripts[index];
            let what = if script.phase == ScriptPhase::Started { "end" } else { "start" };
            let awaited = format!("report of the {what} of `{}`", script.plan.device);
            self.fail(now, robot, FailureKind::Silent { awaited, within: grace });
        }
    }

    pub(super) fn next_watch(&self, timing: &Timing) -> Timestamp<Server> {
        let grace = self.report_grace();
        let scripts = self.robots.iter().filter(|robot| robot.reports()).flat_map(|robot| &robot.scripts);
        let first = scripts.filter_map(|script| report_due(script, timing, grace)).min();
        let silent_end = self.robots.iter().any(|robot| !robot.reports()).then_some(timing.end);
        let due = first.into_iter().chain(silent_end).min();
        due.unwrap_or(timing.end + grace)
    }

    fn report_grace(&self) -> Span {
        let delays = self.robots.iter().filter_map(|robot| robot.clock.reading());
        delays.map(|reading| reading.delay_max).max().unwrap_or(Span::ZERO) * 2 + REPORT_GRACE
    }
}

/// When the next report of a script is overdue; `None` once none is awaited.
fn report_due(script: &ScriptState, timing: &Timing, grace: Span) -> Option<Timestamp<Server>> {
    let start = timing.start + script.plan.start.span();
    match script.phase {
        ScriptPhase::Planned | ScriptPhase::Sent | ScriptPhase::Accepted => Some(start + grace),
        ScriptPhase::Started => Some(start + script.plan.script.duration() + grace),
        ScriptPhase::Ended | ScriptPhase::Failed(_) => None,
    }
}
