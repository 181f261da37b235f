//! Renewals, and the round of them that carries every lease over the start.
//!
//! Renewals are placed so that the instant one lease before the start falls into the middle between two of them: a
//! scheduler that dies between renewals leaves either all leases short of the start or all beyond it. What remains is the
//! time that one round takes to reach everyone. Whoever has not answered that round half a lease before the start may not
//! start, so the others are withdrawn while there still is time.

use urrcp::{Message, Millis, Server, Span, Timestamp};

use super::act::{ActRun, Member, Stage, Timing};
use super::lead::LeadTime;
use super::record::Record;
use super::robot_state::{FailureKind, ScriptPhase, ScriptState};
use super::skew::SkewBudget;
use super::{Mission, Phase, Progress};

/// Between two renewals where no lease asks for more.
const KEEP_ALIVE: Span = Span::from_millis(1_000);

impl Mission {
    /// Renews all leases when the next round is due.
    pub(super) fn renew_if_due(&mut self, now: Timestamp<Server>) {
        if now < *self.next_renewal.get_or_insert(now + KEEP_ALIVE) {
            return;
        }
        self.renew_all(now);
        self.send_again(now);
        self.ask_whether_held(now);
        self.next_renewal = Some(self.renewal_after(now));
    }

    /// Scripts that were sent while others play and have not been answered: one that was lost would come too late.
    fn send_again(&mut self, now: Timestamp<Server>) {
        for index in 0..self.runs.len() {
            if self.runs[index].stage != Stage::Playing {
                continue;
            }
            for member in 0..self.runs[index].members.len() {
                let state = &self.runs[index].members[member];
                let unanswered = |script: &ScriptState| script.phase == ScriptPhase::Sent && !script.accepted;
                let which: Vec<_> =
                    (0..state.scripts.len()).filter(|s| unanswered(&state.scripts[*s])).collect();
                let (robot, out) = (state.robot, state.out);
                for script in which.into_iter().filter(|_| !out) {
                    if let Some(request) = self.request(index, member, script)
                        && request.starts_at().is_some_and(|start| start > now)
                    {
                        self.robots[robot].totals.retries += 1;
                        self.send(now, robot, Message::ControlRequest(request));
                    }
                }
            }
        }
    }

    /// With the renewals that carry the leases over a start every robot is asked whether it still holds what it accepted:
    /// it may have begun anew, or a lease may have run out unnoticed.
    fn ask_whether_held(&mut self, now: Timestamp<Server>) {
        let due = |run: &ActRun| {
            let timing = run.timing.as_ref();
            run.stage == Stage::Decided && timing.is_some_and(|timing| now >= timing.critical())
        };
        for index in (0..self.runs.len()).filter(|index| due(&self.runs[*index])).collect::<Vec<_>>() {
            for member in 0..self.runs[index].members.len() {
                if self.runs[index].members[member].out {
                    continue;
                }
                for script in 0..self.runs[index].members[member].scripts.len() {
                    if self.runs[index].members[member].scripts[script].is_out() {
                        self.probe(now, index, member, script);
                    }
                }
            }
        }
    }

    pub(super) fn renew_all(&mut self, now: Timestamp<Server>) {
        for robot in 0..self.robots.len() {
            match (self.robots[robot].stop_sent, self.robots[robot].stops.is_empty()) {
                (false, _) => self.ask_availability(now, robot),
                // A robot that was left out has not confirmed yet.
                (true, false) => self.stop_anew(now, robot),
                (true, true) => {}
            }
        }
    }

    /// When the round after this one is due: a third of the shortest lease, and so that the instant one lease before a
    /// start that lies ahead falls into the middle between two rounds.
    pub(super) fn renewal_after(&self, now: Timestamp<Server>) -> Timestamp<Server> {
        let leases = self.runs.iter().filter(|run| run.is_sent()).flat_map(|run| {
            let scripts = || run.present().flat_map(|member| &member.scripts).filter(|s| s.is_out());
            let waits = |script: &ScriptState| script.phase != ScriptPhase::Started;
            let pending = run.timing.as_ref().map(|timing| timing.lead.lease);
            let pending = pending.filter(|_| run.stage < Stage::Playing || scripts().any(waits));
            pending.into_iter().chain(scripts().filter_map(running_lease)).collect::<Vec<_>>()
        });
        let shortest = leases.min().map(|lease| lease / LeadTime::RENEWALS_A_LEASE);
        let interval = shortest.unwrap_or(KEEP_ALIVE).min(KEEP_ALIVE).max(Span::from_millis(1));
        let ahead = self.runs.iter().filter_map(|run| run.timing.as_ref()).map(Timing::critical);
        match ahead.filter(|critical| *critical > now).min() {
            Some(critical) => first_renewal(now, critical, interval),
            None => now + interval,
        }
    }

    /// The robot has answered what was sent at `sent`: a part of the round that carries leases over a start.
    pub(super) fn note_round(&mut self, now: Timestamp<Server>, sent: Timestamp<Server>) {
        for timing in
            self.runs.iter_mut().filter(|run| run.stage == Stage::Decided).filter_map(|r| r.timing.as_mut())
        {
            if sent >= timing.critical() {
                let (first, _) = timing.round.unwrap_or((sent, now));
                timing.round = Some((first.min(sent), now));
            }
        }
    }

    /// Half a lease before the start every robot must have answered a renewal that carries its lease over the start.
    pub(super) fn commit_if_due(&mut self, now: Timestamp<Server>, index: usize) {
        let run = &self.runs[index];
        let Some(timing) = run.timing.as_ref().filter(|timing| now >= timing.commit) else { return };
        let (critical, window, no_return) = (timing.critical(), timing.round, timing.no_return);
        let within = timing.lead.lease / 3;
        let held = |member: &Member| {
            let robot = &self.robots[member.robot];
            let mut out = member.scripts.iter().filter(|script| script.is_out());
            // A robot that never answers such questions cannot be held to them.
            let renewed = robot.renewed_at.is_none_or(|at| at >= critical);
            renewed && (!robot.echoes || out.all(|script| script.held_at.is_some_and(|at| at >= critical)))
        };
        let short: Vec<_> = run
            .present()
            .filter(|member| !held(member))
            .map(|member| {
                let kind = match &self.robots[member.robot].broken {
                    Some(reason) => FailureKind::LinkDown { reason: reason.clone() },
                    None => {
                        let awaited = "word that it holds its scripts over the start".to_owned();
                        FailureKind::Silent { awaited, within }
                    }
                };
                (member.robot, kind)
            })
            .collect();
        let tolerance = self.choreography.acts[run.act].plan.start_tolerance;
        let skew = SkewBudget::of_sent(run.present(), &self.robots, tolerance, now);
        // A clock that was set since the gate shows in the answers to the renewals.
        let strayed = skew.map(|skew| skew.offenders()).unwrap_or_default();
        let index_of = |id| self.robots.iter().position(|robot| robot.id == id);
        let strayed = strayed.into_iter().filter_map(|(id, kind)| Some((index_of(id)?, kind)));
        let failing: Vec<_> = short.into_iter().chain(strayed).collect();
        if !failing.is_empty() {
            self.fail_all(now, failing);
        }
        let Some(run) = self.runs.get_mut(index).filter(|_| self.phase == Phase::Performing) else { return };
        if now >= no_return && run.stage == Stage::Decided && window.is_none() {
            tracing::warn!("this machine was held up over the commitment");
        }
        run.stage = Stage::Committed;
        let (number, act) = (run.number, run.act);
        let act = self.act_name(act);
        let window = window.map(|(sent, answered)| answered - sent);
        self.record(Record::Committed { number });
        self.tell(Progress::Committed { act, window });
    }

    pub(super) fn begin_if_due(&mut self, now: Timestamp<Server>, index: usize) {
        let run = &mut self.runs[index];
        let Some(timing) = run.timing.as_ref().filter(|timing| now >= timing.start) else { return };
        run.watch = Some(timing.start);
        run.stage = Stage::Playing;
    }
}

/// The shortest of the leases under which a script plays.
pub(super) fn running_lease(script: &ScriptState) -> Option<Span> {
    let whole = script.plan.stop_condition.running;
    let steps = script.plan.script.steps().iter().filter_map(|step| step.stop_condition?.running);
    whole.into_iter().chain(steps).map(Millis::span).min()
}

/// The earliest instant after `from` of the grid of renewals that leaves `critical` in the middle of a gap.
fn first_renewal(from: Timestamp<Server>, critical: Timestamp<Server>, interval: Span) -> Timestamp<Server> {
    let on_grid = critical + interval / 2;
    let whole = (on_grid - from).as_nanos() / interval.as_nanos().max(1);
    on_grid - interval * (whole - i64::from(on_grid - interval * whole <= from))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn renewals_leave_the_instant_one_lease_before_the_start_in_mid_gap() {
        let from = Timestamp::from_nanos(0);
        let interval = Span::from_millis(80);
        for millis in 300..400 {
            let critical = from + Span::from_millis(millis);
            let first = first_renewal(from, critical, interval);
            assert!(first > from && first <= from + interval, "{first}");
            let gap = (critical - first).as_nanos().rem_euclid(interval.as_nanos());
            assert_eq!(gap, interval.as_nanos() / 2);
        }
    }
}
