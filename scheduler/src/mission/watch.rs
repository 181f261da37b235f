//! From the start to the last step: who has started, how exactly, what still has to be sent, and who has ended.

use urrcp::{Command, ControlRequest, Message, Script, Server, Span, Timestamp};

use super::act::{ActRun, Member, Stage, start_error};
use super::robot_state::{FailureKind, Reading, RobotState, ScriptPhase, ScriptState};
use super::{Mission, Phase, Progress};

/// How long after its instant a report may still arrive, besides the measured delay.
const REPORT_GRACE: Span = Span::from_millis(500);

impl Mission {
    pub(super) fn started(&mut self, robot: usize, index: usize, member: usize, script: usize) {
        let run = &self.runs[index];
        let error = start_error(run, &run.members[member], &run.members[member].scripts[script]);
        let robot = self.robots[robot].id.clone();
        self.tell(Progress::Started { robot, error });
    }

    /// A script has ended: its device has room for the next one.
    pub(super) fn ended(&mut self, now: Timestamp<Server>, robot: usize, index: usize, member: usize) {
        self.runs[index].recheck = true;
        self.send_scripts(now, index, member);
        if self.runs[index].members[member].is_done() {
            let robot = self.robots[robot].id.clone();
            self.tell(Progress::Finished { robot });
        }
        self.perform(now);
    }

    /// Ends the act when all is done, and finds reports that are overdue.
    pub(super) fn watch(&mut self, now: Timestamp<Server>, index: usize) {
        self.read_what_is_due(now, index);
        let run = &self.runs[index];
        let Some(timing) = &run.timing else { return };
        let robot_of = |member: &Member| &self.robots[member.robot];
        let over = |member: &Member| member.is_done() || (!robot_of(member).reports() && now >= timing.end);
        let due = run.watch.is_none_or(|at| now >= at);
        if (due || run.recheck) && run.present().all(over) {
            self.runs[index].stage = Stage::Over;
            return;
        }
        self.runs[index].recheck = false;
        if !due {
            return;
        }
        let run = &self.runs[index];
        let robot_of = |member: &Member| &self.robots[member.robot];
        let grace = self.report_grace(run);
        let mut late = Vec::new();
        for (m, member) in run.members.iter().enumerate() {
            // Without a link nothing can be reported; it is given up in its own time.
            if member.out || !robot_of(member).reports() || !robot_of(member).is_up() {
                continue;
            }
            let overdue =
                |script: &ScriptState| report_due(script, run, member, grace).is_some_and(|due| now >= due);
            let scripts = member.scripts.iter().enumerate().filter(|(_, script)| overdue(script));
            late.extend(scripts.map(|(s, script)| (m, s, script.probed)));
        }
        let mut failing: Vec<(usize, FailureKind)> = Vec::new();
        for (m, s, probed) in late {
            match probed {
                false => {
                    self.runs[index].members[m].scripts[s].probed = true;
                    self.robots[self.runs[index].members[m].robot].totals.retries += 1;
                    self.probe(now, index, m, s);
                }
                true => {
                    let member = &self.runs[index].members[m];
                    if failing.iter().any(|(robot, _)| *robot == member.robot) {
                        continue;
                    }
                    let script = &member.scripts[s];
                    let what = if script.phase == ScriptPhase::Started { "end" } else { "start" };
                    let awaited = format!("report of the {what} of `{}`", script.plan.device);
                    failing.push((member.robot, FailureKind::Silent { awaited, within: grace * 2 }));
                }
            }
        }
        if !failing.is_empty() {
            self.fail_all(now, failing);
        }
        if self.phase == Phase::Performing && index < self.runs.len() {
            let next = self.next_watch(&self.runs[index], now);
            self.runs[index].watch = Some(next);
        }
    }

    fn next_watch(&self, run: &ActRun, now: Timestamp<Server>) -> Timestamp<Server> {
        let grace = self.report_grace(run);
        let end = run.timing.as_ref().map_or(now, |timing| timing.end);
        let due = run.present().flat_map(|member| {
            let silent = !self.robots[member.robot].reports();
            let reports = member.scripts.iter().filter(move |_| !silent);
            reports
                .filter_map(move |script| report_due(script, run, member, grace))
                .chain(silent.then_some(end))
        });
        let due = due.filter(|at| *at > now).min();
        due.unwrap_or(now + grace)
    }

    pub(super) fn report_grace(&self, run: &ActRun) -> Span {
        let delays = run.present().filter_map(|member| self.robots[member.robot].clock.reading());
        delays.map(|reading| reading.delay_max).max().unwrap_or(Span::ZERO) * 2 + REPORT_GRACE
    }

    /// Asks once more what became of a script whose start has passed, without any chance of starting it: an empty script
    /// under its name. Who remembers the name answers with what he last said; who does not, has lost it and stops.
    pub(super) fn probe(&mut self, now: Timestamp<Server>, index: usize, member: usize, script: usize) {
        let robot = self.runs[index].members[member].robot;
        let state = &mut self.runs[index].members[member].scripts[script];
        // A robot that knows no names would take it for what it looks like.
        if !self.robots[robot].echoes {
            return;
        }
        state.asked_by_name = true;
        let command = Command::Script(Script::cancel());
        let mut request = ControlRequest::immediate(state.plan.device.clone(), command);
        request.request_id.clone_from(&state.request_id);
        request.session.clone_from(&self.options.session);
        request.content_hash = Some(request.command.content_hash());
        self.send(now, robot, Message::ControlRequest(request));
    }

    /// Asks for the readings of the scenario whose time has come.
    fn read_what_is_due(&mut self, now: Timestamp<Server>, index: usize) {
        while self.reading_due(&self.runs[index]).is_some_and(|due| now >= due) {
            let run = &mut self.runs[index];
            let (number, which) = (run.number, run.readings_asked);
            run.readings_asked += 1;
            let planned = self.choreography.acts[run.act].readings[which].clone();
            if let Some(robot) = self.robots.iter().position(|state: &RobotState| state.id == planned.robot) {
                self.read(now, robot, planned.sensor, Reading::Planned(number, which));
            }
        }
    }

    pub(super) fn reading_due(&self, run: &ActRun) -> Option<Timestamp<Server>> {
        let planned = self.choreography.acts[run.act].readings.get(run.readings_asked)?;
        Some(run.timing.as_ref()?.start + planned.at)
    }
}

/// When the next report of a script is overdue; `None` once none is awaited.
fn report_due(script: &ScriptState, run: &ActRun, member: &Member, grace: Span) -> Option<Timestamp<Server>> {
    // A robot whose clock is behind starts later by the server's; the tolerance bounds that and is far below the grace.
    let start = run.timing.as_ref()?.start + script.plan.start.span();
    let grace = if script.probed { grace * 2 } else { grace };
    match script.phase {
        // Sent when its device has room.
        ScriptPhase::Planned if member.scripts.iter().any(ScriptState::is_out) => None,
        ScriptPhase::Planned | ScriptPhase::Sent | ScriptPhase::Accepted => Some(start + grace),
        ScriptPhase::Started => Some(start + script.plan.script.duration() + grace),
        ScriptPhase::Ended | ScriptPhase::Failed(_) => None,
    }
}
