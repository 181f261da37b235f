//! An act from its start to its end: when each robot starts and ends, and when there is room for further scripts.

use urrcp::{
    ControlResponse, ErrorCode, RequestReport, RequestState, Robot, Server, Span, Status, Timestamp,
};

use super::timing::CLOCK_UNKNOWN;
use super::{Act, ActAction, Member, PromisedStage, Timing};
use crate::claim::{Possible, Times, Told};
use crate::failure_kind::FailureKind;
use crate::robot_state::{Reading, RobotState, Robots};
use crate::script::{News, Script, ScriptRef, ScriptState, error_of};
use crate::{MemberIndex, Progress, RobotIndex};

/// How long after an event a robot's report of it may still arrive, in addition to two round trips.
const REPORT_GRACE: Span = Span::from_millis(500);
/// A script on a robot that cannot report its end is considered ended this long after its planned end.
pub(crate) const LAPSE: Span = Span::from_millis(15);
/// Interval between questions to a robot that does not report by itself, about a script that should have ended.
const ASK_AGAIN: Span = Span::from_millis(50);

/// How long the mission waits for a first reading of a robot's clock before it may consider the robot's scripts over.
const CLOCK_AWAITED: Span = Span::from_millis(3_000);

/// The maximum error of a robot's timestamp because its clock is coarse.
const GRAIN: Span = Span::from_millis(5);

/// The state of an act that has started.
#[derive(Clone, Debug)]
pub(super) struct Playing {
    /// The time of the next check for reports; `None`: check at once.
    watch: Option<Timestamp<Server>>,
    /// The time at which the robots were last asked for overdue reports.
    asked: Option<Timestamp<Server>>,
    /// How long after an event a robot's report of it may still arrive, as determined at the last check for reports.
    grace: Span,
    /// Number of leading members that have completed their scripts, or no longer take part.
    done: usize,
}

impl Playing {
    pub(super) const fn beginning(now: Timestamp<Server>) -> Self {
        Self { watch: Some(now), asked: None, grace: Span::ZERO, done: 0 }
    }

    /// Returns the time of the next check. If the check is due now, returns `at_once`, an instant that has passed.
    pub(super) fn wakeup(&self, at_once: Timestamp<Server>) -> Timestamp<Server> {
        self.watch.unwrap_or(at_once)
    }

    pub(super) const fn recheck(&mut self) {
        self.watch = None;
    }
}

/// The times of a robot's report.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReportTimes {
    /// The sending time of the question that the report answers.
    pub(crate) asked_at: Timestamp<Server>,
    /// The time of the report by the robot's clock.
    pub(crate) said_at: Timestamp<Robot>,
    pub(crate) arrived: Timestamp<Server>,
}

/// The consequences of a robot's statement about a script.
#[derive(Debug)]
pub(crate) struct Noted {
    pub(crate) news: News,
    pub(crate) actions: Vec<ActAction>,
}

impl Act {
    /// Whether the robot has ended a script because the operator's key is no longer valid. It has then ended all commands of the session,
    /// and rests.
    pub(crate) fn was_barred(&self, script: ScriptRef, response: &ControlResponse) -> bool {
        let was_accepted = matches!(self.script(script).state(), ScriptState::Held | ScriptState::Running);
        let forbidden = response.error.as_ref().is_some_and(|error| error.code == ErrorCode::Forbidden);
        was_accepted && forbidden && response.status == Status::Failed
    }

    /// Processes a response to a request of this act.
    pub(crate) fn answered(
        &mut self,
        script: ScriptRef,
        response: &ControlResponse,
        arrived: Timestamp<Server>,
        robots: &Robots,
    ) -> Noted {
        if self.script(script).had_another_name(response) {
            return Noted { news: News::None, actions: Vec::new() };
        }
        if let Some(noted) = self.doubted(script, &Told::by_response(response, arrived), robots) {
            return noted;
        }
        let robot = &robots[self.robot_of(script)];
        let member = &mut self.members[script.member];
        // A robot that cannot report the end of a script may be sent the next one, which is timed, slightly too early.
        let state = member.scripts()[script.script].state();
        let full = !robot.tells_fates() && *state == ScriptState::Sent && is_full(response);
        if full {
            member.change(script.script, Script::refused_for_now);
            return Noted { news: News::None, actions: Vec::new() };
        }
        if member.scripts()[script.script].may_have_been_played(response) {
            member.change(script.script, Script::lapse);
            let actions = vec![ActAction::Refill(vec![member.robot])];
            self.look_again();
            return Noted { news: News::Lapsed, actions };
        }
        let untold = self.may_have_begun_untold(script, response);
        let member = &mut self.members[script.member];
        let news = member.change(script.script, |script| {
            if untold { script.failed_untold(error_of(response)) } else { script.answered(response) }
        });
        self.noted(script, news, robots)
    }

    /// Whether a failed script may have started unnoticed: it failed after its planned start, and the robot does not report progress. The
    /// `Started` response may be lost, for example because the robot sent it to a process that has died.
    fn may_have_begun_untold(&self, script: ScriptRef, response: &ControlResponse) -> bool {
        let (member, planned) = (&self.members[script.member], self.script(script));
        let start = self.timing().map(|it| it.start + planned.plan.start.span() + member.shift_of(planned));
        let due = start.is_some_and(|start| response.timestamp >= start.assume_clock());
        let untold = response.status == urrcp::Status::Failed && response.steps_done.is_none();
        let accepted = match planned.state() {
            ScriptState::Held => true,
            ScriptState::Planned | ScriptState::Sent => planned.is_unheard_since_taken_up(),
            _ => false,
        };
        due && untold && accepted
    }

    /// Processes a robot's report about a request of this act.
    pub(crate) fn reported(
        &mut self,
        script: ScriptRef,
        report: &RequestReport,
        times: ReportTimes,
        robots: &Robots,
    ) -> Noted {
        let ReportTimes { asked_at, said_at, arrived } = times;
        if let Some(noted) = self.doubted(script, &Told::by_report(report, said_at, arrived), robots) {
            return noted;
        }
        let start = self.timing().map(|timing| timing.start + self.script(script).plan.start.span());
        let member = &mut self.members[script.member];
        if let Some((told, start)) = report.start_timestamp.zip(start)
            && member.scripts()[script.script].shift_is_lost()
        {
            member.change(script.script, |script| script.translate(told - start.assume_clock()));
        }
        let known = &member.scripts()[script.script];
        // The robot states the hash of a script only if it has accepted the script, perhaps from a process that has died.
        let accepted = known.was_accepted() || report.content_hash.is_some();
        let untold = report.steps_done.is_none() && accepted && !known.has_begun();
        let due = start.is_some_and(|start| said_at >= (start + member.shift_of(known)).assume_clock());
        let untold = report.error.clone().filter(|_| report.state == RequestState::Ended && untold && due);
        let news = member.change(script.script, |script| match untold {
            Some(error) => script.failed_untold(error),
            None => script.reported(report, asked_at, said_at),
        });
        let begins = self
            .stage
            .timing()
            .map(|timing| timing.start + member.scripts()[script.script].plan.start.span());
        // The robot may have received and played the script, and then forgotten it.
        let over = news == News::NeverReceived && begins.is_some_and(|begins| arrived >= begins);
        let news = if over { member.change(script.script, Script::lose) } else { news };
        self.noted(script, news, robots)
    }

    /// Returns the consequences of a robot's impossible statement about a script; `None` if the statement is possible. Statements about a
    /// finished script are ignored.
    fn doubted(&mut self, reference: ScriptRef, told: &Told, robots: &Robots) -> Option<Noted> {
        let member = &self.members[reference.member];
        let script = &member.scripts()[reference.script];
        let robot = member.robot;
        let claim = self.possible(member, script, &robots[robot], told).contradicts(told);
        let over = script.is_final();
        let device = script.plan.device.clone();
        let member = &mut self.members[reference.member];
        let Some(claim) = claim else {
            member.change(reference.script, |script| script.said(told));
            return None;
        };
        member.change(reference.script, |script| script.discredit(&claim, told));
        let failing = (robot, FailureKind::Claim { device, claim });
        let actions = if over { Vec::new() } else { vec![ActAction::Fail(vec![failing])] };
        let news = if over { News::None } else { News::Discredited };
        Some(Noted { news, actions })
    }

    fn possible(&self, member: &Member, script: &Script, robot: &RobotState, told: &Told) -> Possible {
        let reading = robot.clock_at(told.arrived());
        let shift = member.shift_of(script);
        let times = self.timing().map(|timing| Times {
            sent: timing.timestamp,
            start: (timing.start + script.plan.start.span() + shift).assume_clock(),
            duration: script.duration(),
            offset: reading.map_or(shift, |reading| reading.offset),
            uncertainty: reading.map_or(CLOCK_UNKNOWN, |reading| reading.uncertainty),
            tolerance: self.written().plan.start_tolerance,
        });
        Possible { planned: script.steps_planned(), before: script.steps_said(), times }
    }

    fn noted(&mut self, script: ScriptRef, news: News, robots: &Robots) -> Noted {
        let member = &self.members[script.member];
        let robot = member.robot;
        let id = robots[robot].id.clone();
        let accepted = |member: &Member| self.timing().is_some_and(|it| member.has_accepted(it));
        let mut actions = Vec::new();
        if news == News::Accepted && member.waits_for(script.script) {
            // The following scripts of the device are sent once the first one has arrived.
            actions.push(ActAction::Refill(vec![robot]));
        }
        match &news {
            // Robots are expected to drop these scripts: the act is prepared again with other requests.
            News::Failed(_) | News::NeverReceived if self.is_lapsing() => {}
            News::Accepted
                if matches!(self.stage.promised(), Some(PromisedStage::Preparing(_))) && accepted(member) =>
            {
                actions.push(ActAction::Tell(Progress::Accepted { robot: id }));
            }
            News::Started => {
                let error = self.start_error(member, &member.scripts()[script.script]);
                actions.push(ActAction::Tell(Progress::Started { robot: id, error }));
            }
            News::Completed => {
                if member.is_done() {
                    actions.push(ActAction::Tell(Progress::Finished { robot: id, number: self.number }));
                }
                actions.push(ActAction::Refill(vec![robot]));
                if robots[robot].reports() {
                    self.watch_for(script.member, robots)
                } else {
                    // The robot is asked at the end of the scripts that are sent to it now.
                    self.look_again()
                }
            }
            News::NeverReceived if member.takes_part() => actions.push(ActAction::Send(script)),
            // A robot that was left out does not fail again.
            News::Failed(error) if member.takes_part() => {
                let device = member.scripts()[script.script].plan.device.clone();
                let kind = FailureKind::Script { device, error: error.clone() };
                actions.push(ActAction::Fail(vec![(robot, kind)]));
            }
            News::None
            | News::Accepted
            | News::NeverReceived
            | News::Failed(_)
            | News::Discredited
            | News::Lapsed => {}
        }
        Noted { news, actions }
    }

    /// Returns the actual minus the planned start of a script, both by the robot's own clock; `None` if one of them is unknown.
    pub(crate) fn start_error(&self, member: &Member, script: &Script) -> Option<Span> {
        if script.shift_is_lost() {
            return None;
        }
        let planned = self.timing()?.start + script.starts() + member.shift_of(script);
        Some(script.started_at()? - planned.assume_clock())
    }

    /// Whether a script can have ended when its robot's clock shows this time. A small error is tolerated, because clocks may be coarse.
    pub(crate) fn can_have_ended(&self, script: ScriptRef, shown: Timestamp<Robot>) -> bool {
        let (member, planned) = (&self.members[script.member], self.script(script));
        let shift = member.shift_of(planned);
        let end = self.timing().map(|timing| planned_end(timing.start, planned) + shift);
        end.is_some_and(|end| shown + GRAIN >= end.assume_clock())
    }

    /// Returns the difference between the reported start or end of a script and the planned one, by its robot's clock.
    pub(crate) fn off_its_time(&self, script: ScriptRef, response: &ControlResponse) -> Option<Span> {
        let (member, planned) = (&self.members[script.member], self.script(script));
        let start = self.timing()?.start;
        let due = match response.status {
            urrcp::Status::Started => start + planned.starts(),
            _ => planned_end(start, planned),
        };
        Some((response.timestamp - (due + member.shift_of(planned)).assume_clock()).abs())
    }

    /// Marks the fate of a script as permanently unknown.
    pub(crate) fn mark_unknown(&mut self, script: ScriptRef) {
        self.members[script.member].change(script.script, Script::lapse);
    }

    /// Ends the act when all scripts are done, and finds overdue reports.
    pub(super) fn watch(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let mut actions = self.read_what_is_due(now, robots);
        if self.has_ended(now, robots) {
            self.enter(PromisedStage::Over);
            return actions;
        }
        let Some(PromisedStage::Playing(playing)) = self.stage.promised() else { return actions };
        if playing.watch.is_some_and(|at| now < at) {
            return actions;
        }
        actions.extend(self.refill_lapsed(now, robots));
        if self.has_ended(now, robots) {
            self.enter(PromisedStage::Over);
            return actions;
        }
        actions.extend(self.ask_for_overdue(now, robots));
        let next = self.next_watch(now, robots);
        let grace = self.report_grace(robots);
        if let Some(PromisedStage::Playing(playing)) = self.stage.promised_mut() {
            playing.watch = Some(next);
            playing.grace = grace;
        }
        actions
    }

    fn has_ended(&mut self, now: Timestamp<Server>, robots: &Robots) -> bool {
        self.is_played(robots)
            && !self.awaits_those_left_out(now, robots)
            && self.rests_until().is_none_or(|end| now >= end)
    }

    /// Returns the end of the last movement that continues after the last step of its script; `None` if no movement does.
    fn rests_until(&self) -> Option<Timestamp<Server>> {
        let start = self.timing()?.start;
        let plans = self.present().flat_map(Member::scripts).map(|script| &script.plan);
        let resting = plans.filter(|plan| plan.rest > Span::ZERO);
        resting.map(|plan| start + plan.start.span() + plan.duration()).max()
    }

    /// Whether no script of the act can still run. Each event checks only from the first member that is not done.
    fn is_played(&mut self, robots: &Robots) -> bool {
        let Some(PromisedStage::Playing(playing)) = self.stage.promised_mut() else { return false };
        let done = |member: &&Member| !member.takes_part() || member.is_done();
        playing.done += self.members.iter().skip(playing.done).take_while(done).count();
        let mut rest = self.members.iter().skip(playing.done).filter(|member| member.takes_part());
        rest.all(|member| member.is_done() || (may_lapse(member, &robots[member.robot]) && member.is_over()))
    }

    /// Whether robots that were left out before this process took over the act may soon report the steps that they played.
    fn awaits_those_left_out(&self, now: Timestamp<Server>, robots: &Robots) -> bool {
        let may_answer = |member: &Member| {
            let robot = &robots[member.robot];
            robot.takes_inquiries() && !robot.is_gone() && self.unheard_of(member.robot).is_some()
        };
        now < self.since + REPORT_GRACE && self.members.iter().any(may_answer)
    }

    /// Brings forward the next check, if a member needs an earlier one. The member reports by itself and now plays another script. The
    /// checks of the other members are unchanged.
    fn watch_for(&mut self, member: MemberIndex, robots: &Robots) {
        let Some(PromisedStage::Playing(Playing { watch: Some(watch), grace, .. })) = self.stage.promised()
        else {
            return;
        };
        let next = self.watched(&self.members[member], robots, *grace).flatten().min();
        let next = next.map_or(*watch, |next| next.min(*watch));
        if let Some(PromisedStage::Playing(playing)) = self.stage.promised_mut() {
            playing.watch = Some(next);
        }
    }

    /// Checks single robots, by their own clocks, before the act plays on all of them. Finds overdue reports, and lapsed scripts (whose
    /// fate can no longer be learned).
    pub(super) fn look_for_ends(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let mut actions = self.refill_lapsed(now, robots);
        actions.extend(self.ask_for_overdue(now, robots));
        actions
    }

    fn refill_lapsed(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let lapsed = self.lapse(now, robots);
        if lapsed.is_empty() { Vec::new() } else { vec![ActAction::Refill(lapsed)] }
    }

    /// Marks scripts whose time has passed as lapsed (of unknown fate), on robots that cannot report it. Returns those robots.
    fn lapse(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<RobotIndex> {
        let Some(timing) = self.stage.timing() else { return Vec::new() };
        let grace = self.report_grace(robots);
        let mut lapsed = Vec::new();
        for member in self.members.iter_mut().filter(|member| member.takes_part()) {
            let robot = &robots[member.robot];
            // After a resumption, the clock by which a robot plays is initially unknown.
            if robot.clock.samples() == 0 && now < self.since + CLOCK_AWAITED {
                continue;
            }
            let over = |(index, script): (usize, &Script)| {
                let at = lapses_at(timing, script, robot, grace);
                (script.is_out() && at.is_some_and(|at| now >= at)).then_some(index)
            };
            let over: Vec<usize> = member.under_way().filter_map(over).collect();
            for script in over {
                member.change(script, Script::lapse);
                lapsed.push(member.robot);
            }
            // A planned script was refused, because the queue was full slightly longer than expected.
            if lapses(robot) && member.under_way().any(|(_, script)| script.is_planned()) {
                lapsed.push(member.robot);
            }
        }
        lapsed.dedup();
        lapsed
    }

    /// Asks robots for overdue reports. A robot that still has not reported after the grace time fails.
    fn ask_for_overdue(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let grace = self.report_grace(robots);
        let again = ASK_AGAIN.max((grace - REPORT_GRACE) / 2);
        let mut ask = Vec::new();
        let mut failing: Vec<(RobotIndex, FailureKind)> = Vec::new();
        for (place, member) in self.members.enumerated().filter(|(_, member)| member.takes_part()) {
            let robot = &robots[member.robot];
            // A robot without a link cannot report, nor one that has sent nothing on a new link. A lost link has its own deadline.
            if !robot.tells_fates() || !robot.is_up() || robot.lost().is_some() {
                continue;
            }
            let due =
                |script: &Script| self.report_due(member, script, robot, grace).filter(|due| now >= *due);
            let mut scripts = member.under_way().map(|(_, script)| script);
            let Some(script) = scripts.find(|script| due(script).is_some()) else { continue };
            let newest = || member.under_way().filter_map(|(_, script)| due(script)).max();
            let lost = |script: &Script| {
                let due = self.report_due(member, script, robot, grace);
                due.is_some_and(|due| now >= due + grace && was_asked(member, script, robot, due, grace))
            };
            if lost(script) {
                let what = if *script.state() == ScriptState::Running { "end" } else { "start" };
                let awaited = format!("report about the {what} of the script on `{}`", script.plan.device);
                failing.push((member.robot, FailureKind::Silent { awaited, within: grace * 2 }));
            } else if robot.takes_inquiries()
                && may_be_asked(now, member.asked, newest(), robot, again, grace)
            {
                let since = member.asked_since.filter(|since| newest().is_none_or(|due| *since >= due));
                ask.push((place, since.unwrap_or(now)));
            }
        }
        let mut actions = Vec::new();
        if !ask.is_empty() {
            if let Some(PromisedStage::Playing(playing)) = self.stage.promised_mut() {
                playing.asked = Some(now);
            }
            for (place, since) in &ask {
                (self.members[*place].asked, self.members[*place].asked_since) = (Some(now), Some(*since));
            }
            let robots = ask.into_iter().map(|(place, _)| self.members[place].robot);
            actions.push(ActAction::Ask(robots.collect()));
        }
        if !failing.is_empty() {
            actions.push(ActAction::Fail(failing));
        }
        actions
    }

    /// Returns the time at which a robot is asked about a script; `None` if nothing is pending. A robot that does not report by itself is
    /// asked when the script should have ended.
    fn report_due(
        &self,
        member: &Member,
        script: &Script,
        robot: &RobotState,
        grace: Span,
    ) -> Option<Timestamp<Server>> {
        let timing = self.timing()?;
        if lost_with_its_process(script, robot) {
            return None;
        }
        let late = late_of(timing, robot);
        let begin = timing.start + script.plan.start.span() + late;
        let start = timing.start + script.starts() + late;
        let end = planned_end(timing.start, script) + late;
        match script.state() {
            // The script is sent when its device has room.
            ScriptState::Planned if member.under_way().any(|(_, script)| script.is_out()) => None,
            ScriptState::Ended(_) => None,
            ScriptState::Planned => Some(begin + grace),
            _ if !robot.reports() => Some(end + LAPSE),
            ScriptState::Unknown => Some(end),
            ScriptState::Sent | ScriptState::Held => Some(start + grace),
            ScriptState::Running => Some(end + grace),
        }
    }

    /// Returns the times of the next checks for each script under way on a robot: to ask for its report, and to detect that it is still
    /// missing.
    fn watched<'a>(
        &'a self,
        member: &'a Member,
        robots: &'a Robots,
        grace: Span,
    ) -> impl Iterator<Item = [Timestamp<Server>; 2]> + 'a {
        let robot = &robots[member.robot];
        member.under_way().filter_map(move |(_, script)| {
            if let Some(at) = lapses_at(self.timing()?, script, robot, grace) {
                return Some([at; 2]);
            }
            let asked = self.report_due(member, script, robot, grace)?;
            // If the report is still missing after another grace time, the robot fails.
            Some([asked, asked + grace])
        })
    }

    pub(super) fn next_watch(&self, now: Timestamp<Server>, robots: &Robots) -> Timestamp<Server> {
        let grace = self.report_grace(robots);
        let due = self.present().flat_map(|member| self.watched(member, robots, grace));
        let answered = Some(self.since + REPORT_GRACE).filter(|_| self.awaits_those_left_out(now, robots));
        let next = due
            .flatten()
            .chain(answered)
            .chain(self.rests_until())
            .filter(|at| *at > now)
            .min()
            .unwrap_or(now + grace);
        next.min(now + self.patience_with_silent_ones(robots))
    }

    /// Returns the interval until the next check. It is short while a robot that does not report by itself owes an answer or must be sent
    /// a script again.
    fn patience_with_silent_ones(&self, robots: &Robots) -> Span {
        let silent = self.present().any(|member| !robots[member.robot].reports() && !member.is_done());
        let asked =
            matches!(self.stage.promised(), Some(PromisedStage::Playing(Playing { asked: Some(_), .. })));
        let planned = |member: &Member| member.under_way().any(|(_, script)| script.is_planned());
        let planned = self.present().any(|member| lapses(&robots[member.robot]) && planned(member));
        if silent && (asked || planned) {
            ASK_AGAIN.max(longest_round_trip(self, robots))
        } else {
            Span::from_millis(3_600_000)
        }
    }

    /// Returns how long after an event a robot's report of it may still arrive.
    pub(crate) fn report_grace(&self, robots: &Robots) -> Span {
        longest_round_trip(self, robots) * 2 + REPORT_GRACE
    }

    /// Returns the time by which an unreachable robot has certainly ended its scripts of this act. This is the end of its leases or,
    /// without leases, the end of the scripts plus `patience`. `None` until the commitment, because the decision and the commitment then
    /// handle such a robot.
    pub(crate) fn gives_up(
        &self,
        robot: RobotIndex,
        now: Timestamp<Server>,
        robots: &Robots,
        patience: Span,
    ) -> Option<Timestamp<Server>> {
        let member = self.member(robot).filter(|_| self.is_committed())?;
        let timing = self.timing()?;
        let grace = self.report_grace(robots);
        let ends = member.under_way().filter(|(_, script)| script.is_out()).map(|(_, script)| {
            let begins = timing.start + script.plan.start.span();
            match script.longest_lease() {
                Some(lease) => now.max(begins) + lease + grace,
                None => planned_end(timing.start, script) + patience,
            }
        });
        ends.max()
    }

    /// Returns the shortest lease under which a robot now plays scripts of this act; `None` if it does not, or without a lease.
    pub(crate) fn running_lease(&self, robot: RobotIndex, now: Timestamp<Server>) -> Option<Span> {
        let timing = self.timing().filter(|timing| now >= timing.start)?;
        let member = self.member(robot).filter(|member| member.takes_part())?;
        let begins = |script: &Script| timing.start + script.plan.start.span();
        if member.firsts().map(begins).min().is_none_or(|first| now < first) {
            return None;
        }
        let lease = |(index, script): (usize, &Script)| {
            if now >= begins(script) {
                script.shortest_lease()
            } else {
                // The next script waits. It is lost when both of its leases have ended.
                script.shortest_lease().max(member.pending_lease_now(index, timing))
            }
        };
        member.under_way().filter(|(_, script)| script.is_out()).filter_map(lease).min()
    }

    /// Returns the shortest lease of this act on robots that also take part in the act `other`.
    pub(crate) fn lease_with(&self, other: &Self) -> Option<Span> {
        let both = self.present().filter(|member| other.place_of(member.robot).is_some());
        both.flat_map(Member::scripts).filter_map(Script::shortest_lease).min()
    }

    /// Returns the next time after `now` at which a script that a robot holds begins; `None` if there is no such script.
    pub(crate) fn next_begin(&self, robot: RobotIndex, now: Timestamp<Server>) -> Option<Timestamp<Server>> {
        let start = self.timing()?.start;
        let out = self.member(robot)?.under_way().filter(|(_, script)| script.is_out());
        out.map(|(_, script)| start + script.plan.start.span()).filter(|begins| *begins > now).min()
    }

    /// Returns the shortest lease that applies to a script from now on.
    pub(crate) fn shortest_lease_of(&self, script: ScriptRef) -> Option<Span> {
        self.members[script.member].shortest_lease(script.script, self.timing()?)
    }

    /// Returns the shortest lease of this act that must be renewed between two rounds of questions.
    pub(crate) fn shortest_lease(&self) -> Option<Span> {
        let timing = self.timing()?;
        let before = (!self.is_playing()).then_some(timing.lead.lease);
        let leases = self.present().flat_map(|member| {
            let out = member.under_way().filter(|(_, script)| script.is_out());
            out.filter_map(|(index, _)| member.shortest_lease(index, timing))
        });
        leases.chain(before).min()
    }

    /// Requests those sensor readings of the scenario that are due.
    fn read_what_is_due(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let mut actions = Vec::new();
        while self.reading_due().is_some_and(|due| now >= due) {
            let which = self.readings_asked;
            self.readings_asked += 1;
            let planned = &self.written().readings[which];
            let what = Reading::Planned(self.number, which);
            let left_out = |robot: RobotIndex| self.member(robot).is_some_and(|member| !member.takes_part());
            let robot = robots.position(|state| state.id == planned.robot);
            let robot = robot.filter(|robot| !left_out(*robot));
            let sensor = planned.sensor.clone();
            actions.extend(robot.map(|robot| ActAction::Read { robot, sensor, what }));
        }
        actions
    }

    pub(super) fn reading_due(&self) -> Option<Timestamp<Server>> {
        let planned = self.written().readings.get(self.readings_asked)?;
        Some(self.timing()?.start + planned.at)
    }

    /// Stores a reading that the scenario requested.
    pub(crate) fn read(&mut self, which: usize, robot: &RobotState, value: Option<f64>) {
        if let Some(planned) = self.choreography.acts[self.index.get()].readings.get(which) {
            let (robot, sensor) = (robot.id.clone(), planned.sensor.clone());
            self.readings.push(super::TakenReading { robot, sensor, at: planned.at, value });
        }
    }
}

/// Returns how much later than planned a robot may play because of its clock; negative if it certainly plays earlier. The value follows
/// from the announced skew or the current clock reading, whichever is larger. If both are unknown, returns the value of the latest robot
/// of the fleet.
pub(super) fn late_of(timing: &Timing, robot: &RobotState) -> Span {
    let told = timing.skew.as_ref().and_then(|skew| skew.late_of(&robot.id));
    let shown = robot.clock.reading().map(|reading| robot.shift - reading.offset + reading.uncertainty);
    told.max(shown).unwrap_or(timing.pace.late)
}

/// Whether to ask a robot for reports again. It was last asked at `asked`, and its newest report was due at `due`. While an answer is
/// still under way, the robot is not asked again: if it cannot keep up, it would receive more and more questions.
fn may_be_asked(
    now: Timestamp<Server>,
    asked: Option<Timestamp<Server>>,
    due: Option<Timestamp<Server>>,
    robot: &RobotState,
    again: Span,
    grace: Span,
) -> bool {
    let Some(asked) = asked else { return true };
    let owed = robot.contact.questions.unanswered().is_some_and(|open| open <= asked);
    due.is_some_and(|due| asked < due) || now >= asked + if owed { grace } else { again }
}

/// Whether a robot has had the opportunity to report on a script since `due`. While this process is suspended, and before it resumes a
/// mission, it neither sends inquiries nor reads messages. A robot that reports by itself has done so before it answers a question. If an
/// answer does not contain the script, it is accepted only after the robot has ignored the script's id for `grace`.
fn was_asked(
    member: &Member,
    script: &Script,
    robot: &RobotState,
    due: Timestamp<Server>,
    grace: Span,
) -> bool {
    let answered = robot.contact.questions.answered();
    if !robot.takes_inquiries() || script.is_planned() {
        return answered >= Some(due);
    }
    let ignored = || member.asked_since.is_some_and(|since| since >= due && answered >= Some(since + grace));
    script.reported_at() >= Some(due) || ignored()
}

/// Whether the fate of any script of a member may remain unknown after the script's time has passed.
fn may_lapse(member: &Member, robot: &RobotState) -> bool {
    lapses(robot) || member.under_way().any(|(_, script)| lost_with_its_process(script, robot))
}

/// Whether the robot cannot report the fate of its scripts.
fn lapses(robot: &RobotState) -> bool {
    !robot.tells_fates()
}

/// Whether the report about a script is lost: the robot reports by itself, cannot be asked, and has reported to a process that has died.
fn lost_with_its_process(script: &Script, robot: &RobotState) -> bool {
    robot.reports() && !robot.takes_inquiries() && script.is_unheard_since_taken_up()
}

/// Returns the time after which the fate of a sent script can no longer be learned; `None` if its robot reports it.
fn lapses_at(timing: &Timing, script: &Script, robot: &RobotState, grace: Span) -> Option<Timestamp<Server>> {
    if script.is_final() {
        return None;
    }
    let patience = match lapses(robot) {
        true => LAPSE,
        false if lost_with_its_process(script, robot) => grace,
        false => return None,
    };
    Some(planned_end(timing.start, script) + late_of(timing, robot) + patience)
}

fn is_full(response: &ControlResponse) -> bool {
    let code = error_of(response).code;
    response.status == urrcp::Status::Failed && matches!(code, ErrorCode::Busy | ErrorCode::Overlap)
}

pub(super) fn planned_end(start: Timestamp<Server>, script: &Script) -> Timestamp<Server> {
    start + script.plan.start.span() + script.duration()
}

fn longest_round_trip(act: &Act, robots: &Robots) -> Span {
    act.present().map(|member| robots[member.robot].round_trip()).max().unwrap_or_default()
}
