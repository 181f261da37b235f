//! Controls the course of a mission through its acts: each act is advanced, followed by the next one, and closed.

use std::collections::VecDeque;
use std::sync::Arc;

use downbeat_plan::Way;
use urrcp::{Server, Timestamp};

use super::act::{Act, ActAction, Member, act_name};
use super::facts::{ActReport, spread};
use super::failure_kind::FailureKind;
use super::fates::{ActCourse, ActFate};
use super::record::{ActFlaws, ActOver, OutOfTolerance, Record, StepsLate};
use super::robot_state::{Reading, Rest, RobotState, Standing};
use super::script::Script;
use super::{ActIndex, ActNumber, Action, IndexVec, Mission, Outcome, Phase, Progress};

/// The maximum number of rows in all kept reports of acts together. A row is one robot in one act.
const ROWS_KEPT: usize = 20_000;

/// The course of a mission through its acts.
#[derive(Debug)]
pub(super) struct Course {
    /// Number of acts that have begun.
    pub(super) begun: u32,
    /// The number of acts in `begun` that repeat a withdrawn act.
    pub(super) repeated: u32,
    /// Whether `acts_max` prevented a further act.
    pub(super) bounded: bool,
    /// The index of the act that a failure policy requests as the next one.
    pub(super) detour: Option<ActIndex>,
    /// The index of the act with which the mission continues after a stop.
    pub(super) then: Option<ActIndex>,
    /// Whether the act whose start the operator fixed has been queued.
    pub(super) start_was_fixed: bool,
    /// Number of consecutive acts that were skipped because no robot was left to play them.
    pub(super) skipped: usize,
    /// The fate of each act of the scenario.
    pub(super) fates: IndexVec<ActIndex, ActCourse>,
    /// Whether robots may have moved in a mission of another process that this mission only withdraws. The acts of that mission are not
    /// in `fates`.
    pub(super) moved_before: bool,
    pub(super) reports: VecDeque<ActReport>,
    pub(super) reports_omitted: usize,
}

impl Course {
    pub(super) const fn new(fates: IndexVec<ActIndex, ActCourse>) -> Self {
        Self {
            begun: 0,
            repeated: 0,
            bounded: false,
            detour: None,
            then: None,
            start_was_fixed: false,
            skipped: 0,
            fates,
            moved_before: false,
            reports: VecDeque::new(),
            reports_omitted: 0,
        }
    }
}

impl Mission {
    /// Performs everything that is due while acts wait, start and play.
    pub(super) fn perform(&mut self, now: Timestamp<Server>) {
        self.notice_hold_up(now);
        self.renew_if_due(now);
        self.notice_silence(now);
        self.give_up_lost(now);
        let mut index = 0;
        while self.phase == Phase::Performing && index < self.acts.len() {
            self.advance_act(now, index);
            match self.acts.get(index).map(Act::is_over) {
                Some(true) => self.close_act(now, index),
                _ => index += 1,
            }
        }
        if self.phase == Phase::Performing {
            self.line_up(now);
            self.send_deferred(now);
        }
    }

    /// Continues the mission after an event that may permit an act to progress.
    pub(super) fn goes_on(&mut self, now: Timestamp<Server>) {
        match self.phase {
            Phase::Performing => self.perform(now),
            Phase::Stopping { .. } => self.stop_progress(now),
            Phase::Greeting { .. } | Phase::Ended => {}
        }
    }

    fn advance_act(&mut self, now: Timestamp<Server>, index: usize) {
        // An act may pass several stages at once. Each is processed in turn.
        for _ in 0..6 {
            let (number, before) = (self.acts[index].number(), self.acts[index].progress());
            let actions = self.acts[index].advance(now, &self.robots, &self.options);
            let acted = !actions.is_empty();
            self.carry_out(now, number, actions);
            if self.phase != Phase::Performing
                || self.acts.get(index).is_none_or(|act| act.number() != number)
            {
                return;
            }
            self.prepare_if_it_fits(now, index);
            let gone_on = self.acts.get(index).is_some_and(|act| act.progress() != before);
            if self.phase != Phase::Performing || !(gone_on || acted) {
                return;
            }
            // Other leases apply now.
            let lease = self.acts.get(index).and_then(Act::shortest_lease);
            self.quicken_rounds(now, lease);
        }
    }

    /// Performs the actions of an act in order. While the mission does not play acts, only failures and reports to the operator are
    /// processed.
    pub(super) fn carry_out(&mut self, now: Timestamp<Server>, number: ActNumber, actions: Vec<ActAction>) {
        for action in actions {
            if matches!(self.phase, Phase::Ended) {
                return;
            }
            let performs = self.phase == Phase::Performing;
            match action {
                ActAction::Tell(progress) => self.tell(progress),
                ActAction::Fail(failing) => self.fail_of_act(now, number, failing),
                _ if !performs => {}
                ActAction::Record(record) => self.record_for(now, number, record),
                ActAction::Send(script) if self.may_send(script) => {
                    self.count_retry(script);
                    self.send_script(now, script);
                }
                // It is sent once the robot has confirmed its stop, or has answered on its new link.
                ActAction::Send(_) => {}
                ActAction::Refill(robots) => robots.into_iter().for_each(|robot| self.refill(now, robot)),
                ActAction::Ask(robots) => robots.into_iter().for_each(|robot| self.inquire(now, robot)),
                ActAction::Withdraw(outcome) => self.withdraw_act(now, number, outcome),
                ActAction::TimedOut(way) => self.skip_act(now, number, way),
                ActAction::Read { robot, sensor, what } => {
                    // An answer that was lost must not be awaited.
                    if matches!(what, Reading::Wait(_) | Reading::Motion(..)) {
                        self.robots[robot].requests.forget_readings(|waits| *waits == what);
                    }
                    self.read(now, robot, sensor, what);
                }
            }
        }
    }

    /// Skips an act whose condition was not met in time.
    fn skip_act(&mut self, now: Timestamp<Server>, number: ActNumber, way: Way) {
        if let Some(at) = self.acts.iter().position(|act| act.number() == number) {
            let act = self.acts.remove(at);
            let fate = ActFate::timed_out(&act);
            let reason = format!("`{}` {fate}", act.name());
            self.skipped_act(&act, fate);
            if way == Way::Fail {
                return self.abort_because(now, Outcome::Failed, reason, Rest::InPlace, None);
            }
        }
        self.go_way(now, way);
    }

    /// Queues the next act once the current act is committed or over, unless another act is already queued.
    fn line_up(&mut self, now: Timestamp<Server>) {
        let [last] = self.acts.as_slice() else { return };
        if !(last.is_committed() || last.is_over()) || !self.may_begin_another() {
            return;
        }
        let way = self.course.detour.map_or(last.follow(), |act| Way::Act(act.get()));
        if let Way::Act(act) = way {
            self.course.detour = None;
            self.line_up_act(now, ActIndex::new(act));
        }
    }

    /// Makes the mission continue with another act after a failure. An act that waits for the playing one to end is removed, unless it
    /// was sent.
    pub(super) fn lead_elsewhere(&mut self, act: ActIndex) {
        self.course.detour = Some(act);
        if let [.., _, waiting] = self.acts.as_slice()
            && !waiting.was_sent()
        {
            self.acts.pop();
            self.course.begun -= 1;
        }
    }

    /// Continues the mission after an act has ended while no other act is queued.
    fn go_on_from(&mut self, now: Timestamp<Server>, follow: Way) {
        let way = self.course.detour.take().map_or(follow, |act| Way::Act(act.get()));
        self.go_way(now, way);
    }

    pub(super) fn go_way(&mut self, now: Timestamp<Server>, way: Way) {
        match way {
            Way::Act(act) if self.may_begin_another() => self.line_up_act(now, ActIndex::new(act)),
            Way::Act(_) => {
                self.course.bounded = true;
                self.come_to_the_end();
            }
            Way::End => self.come_to_the_end(),
            Way::Fail => self.abort(now, Outcome::Failed, Rest::InPlace, None),
        }
    }

    fn may_begin_another(&self) -> bool {
        self.options.acts_max.is_none_or(|acts_max| self.course.begun - self.course.repeated < acts_max)
    }

    fn come_to_the_end(&mut self) {
        for robot in self.robots.indices() {
            if let Some(reason) = self.robots[robot].why_it_never_joined() {
                self.note_failure(robot, FailureKind::NeverJoined { reason });
            }
        }
        self.conclusion.outcome =
            Some(self.conclusion.flawed.clone().unwrap_or_else(|| self.outcome_at_the_end()));
        self.arrive_home();
        self.end();
    }

    /// Returns the outcome of a mission that has played its last act.
    fn outcome_at_the_end(&self) -> Outcome {
        let never_joined = |robot: &RobotState| {
            robot.failures.iter().any(|f| matches!(f.kind, FailureKind::NeverJoined { .. }))
        };
        // A robot that failed while it was absent did not join either.
        let is_out = |robot: &RobotState| robot.standing != Standing::In || never_joined(robot);
        // Robots that were left out do not matter.
        if self.robots.iter().any(|robot| !is_out(robot) && robot.was_lost_sight_of) {
            return Outcome::Unknown;
        }
        if let Some(flaw) = &self.conclusion.flaw_of_times {
            return flaw.clone();
        }
        if self.robots.iter().any(is_out) {
            return Outcome::DoneWithout;
        }
        let fates = self.course.fates.enumerated().filter(|(_, act)| act.was_skipped());
        let skipped = fates.map(|(act, _)| act_name(&self.choreography, act));
        match skipped.collect::<Vec<_>>() {
            none if none.is_empty() => Outcome::Done,
            acts => Outcome::DoneSkipping { acts },
        }
    }

    /// Queues an act, which begins to wait for its condition.
    pub(super) fn line_up_act(&mut self, now: Timestamp<Server>, index: ActIndex) {
        let fixed = self.options.fixed.operator.filter(|fixed| fixed.act == index);
        let start = fixed.filter(|_| !std::mem::replace(&mut self.course.start_was_fixed, true));
        self.line_up_attempt(now, index, 0, start.map(|fixed| fixed.at));
    }

    /// Like `line_up_act`, but for an act that was already withdrawn `attempts` times, and with the fixed start `start`, if any.
    pub(super) fn line_up_attempt(
        &mut self,
        now: Timestamp<Server>,
        index: ActIndex,
        attempts: u32,
        start: Option<Timestamp<Server>>,
    ) {
        let before = self.acts.last().and_then(Act::timing).map(|timing| timing.end);
        let choreography = Arc::clone(&self.choreography);
        let mut act =
            Act::new(choreography, index, ActNumber::new(self.course.begun), &self.robots, now, before);
        if let Some(start) = start {
            act.starts_at(start);
        }
        if attempts > 0 {
            act.is_attempted_again(attempts);
        }
        if self.options.verify_motion {
            act.verify_motions(&self.robots);
        }
        if self.acts.is_empty() {
            act.comes_next(now);
        }
        self.course.begun += 1;
        self.acts.push(act);
        self.announce(self.acts.len() - 1);
        self.advance_act(now, self.acts.len() - 1);
    }

    /// Reports the condition of an act, unless it still waits for an earlier act.
    fn announce(&mut self, index: usize) {
        let announcement = self.acts.get_mut(index).and_then(|act| act.announcement(&self.options));
        announcement.into_iter().for_each(|waiting| self.tell(waiting));
    }

    /// Processes the operator's go. It applies to the act that waits for it now, not to a later one.
    pub(super) fn go(&mut self, now: Timestamp<Server>, named: Option<&str>, by: Option<String>) {
        let answer = match self.awaits_go(named) {
            Ok(index) => {
                self.acts[index].go();
                let act = self.acts[index].name();
                self.record(Record::Go { act: act.clone(), by });
                Ok(act)
            }
            Err(reason) => Err(reason),
        };
        let counts = answer.is_ok();
        self.outbox.actions.push(Action::Answer(answer));
        if counts {
            self.goes_on(now);
        }
    }

    /// Returns the act to which a go applies now, or the reason why a go is ignored.
    fn awaits_go(&self, named: Option<&str>) -> Result<usize, String> {
        let known = |name: &str| {
            (0..self.choreography.acts.len())
                .any(|act| act_name(&self.choreography, ActIndex::new(act)) == name)
        };
        if let Some(name) = named.filter(|name| !known(name)) {
            return Err(format!("unknown act `{name}`"));
        }
        match self.phase {
            Phase::Greeting { .. } => return Err("the fleet is still being checked".to_owned()),
            Phase::Stopping { .. } => return Err("the mission is being stopped".to_owned()),
            Phase::Ended => return Err("the mission is over".to_owned()),
            Phase::Performing => {}
        }
        let waiting = self.acts.iter().position(|act| act.awaits_operator() && act.is_alone());
        let Some(index) = waiting else { return Err(self.why_no_go(named)) };
        let name = self.acts[index].name();
        match named {
            Some(other) if other != name => {
                Err(format!("`{other}` is not waiting; `{name}` waits for the operator's go"))
            }
            _ => Ok(index),
        }
    }

    /// Returns the reason, for users, why the operator's go is ignored although the mission performs acts.
    fn why_no_go(&self, named: Option<&str>) -> String {
        let behind = self.acts.windows(2).find(|acts| acts[1].awaits_operator());
        match (behind, named) {
            (Some([before, act]), named) if named.is_none_or(|name| name == act.name()) => {
                format!("`{}` waits until `{}` has ended", act.name(), before.name())
            }
            (_, Some(name)) => format!("`{name}` is not waiting for the operator"),
            (_, None) => "no act is waiting for the operator".to_owned(),
        }
    }

    /// Closes all acts, whatever their stage.
    pub(super) fn close_all(&mut self, now: Timestamp<Server>) {
        while !self.acts.is_empty() {
            self.close_act(now, 0);
        }
    }

    /// Discards an attempt to start an act that was withdrawn and is repeated. The report does not list the attempt.
    pub(super) fn forget_act(&mut self, now: Timestamp<Server>, index: usize) {
        let act = self.acts.remove(index);
        self.tell(Progress::ActWithdrawn { act: act.name() });
        for member in act.members() {
            let robot = &mut self.robots[member.robot];
            robot.halt.left.clear();
            let names = member.scripts().iter().filter_map(Script::request_id);
            names.for_each(|id| robot.requests.remove_script(id));
        }
        if let Some(report) = ActReport::new(&act, &self.robots) {
            let over = ActOver { act: act.index(), fate: self.fate_of(now, &act) };
            self.record(Record::ActEnded {
                report: Box::new(report),
                flaws: ActFlaws::default(),
                over,
                again: true,
            });
        }
    }

    /// Moves the facts of an act into its report and discards the rest.
    fn close_act(&mut self, now: Timestamp<Server>, index: usize) {
        let act = self.acts.remove(index);
        if act.was_sent() {
            self.account(now, &act);
            self.note_missed(&act);
            self.note_arrivals(&act);
        }
        let fate = self.fate_of(now, &act);
        match fate {
            ActFate::NobodyLeft => self.skipped_act(&act, fate),
            fate => self.course.fates[act.index()].note(fate),
        }
        if let Some(report) = ActReport::new(&act, &self.robots) {
            self.course.skipped = 0;
            self.keep_report(&act, report);
        }
        if let Some(next) = self.acts.get_mut(index) {
            next.comes_next(now);
            if self.phase == Phase::Performing {
                self.announce(index);
            }
        }
        let mut follow = act.follow();
        if !act.was_sent() {
            // A cycle of acts without a robot left to play them would never end.
            self.course.skipped += 1;
            if self.course.skipped > self.choreography.acts.len() {
                follow = Way::End;
            }
        }
        // An act that is over before the previous one, for example because all its robots were left out, is not played again.
        if let Some(before) = index.checked_sub(1).and_then(|before| self.acts.get_mut(before)) {
            before.lead_to(follow);
        }
        if self.acts.is_empty() && self.phase == Phase::Performing {
            self.go_on_from(now, follow);
        }
    }

    fn skipped_act(&mut self, act: &Act, fate: ActFate) {
        self.tell(Progress::ActSkipped { act: act.name(), fate: fate.clone() });
        self.record(Record::ActSkipped(ActOver { act: act.index(), fate: fate.clone() }));
        self.course.fates[act.index()].note(fate);
    }

    /// Whether robots have moved, or may have moved, in an act that is over, in this process or in one that died.
    pub(super) fn has_moved(&self) -> bool {
        self.course.moved_before || self.course.fates.iter().any(|act| act.moved)
    }

    /// Whether robots may have begun to play an act: they have reported it, or its earliest start has passed and the fate of a script is
    /// unknown. A robot that does not report may also have moved, as early as its clock permits.
    pub(super) fn may_have_begun(&self, now: Timestamp<Server>, act: &Act) -> bool {
        let is_due = act.timing().is_some_and(|timing| now >= timing.earliest_start());
        act.has_begun() || is_due && self.may_begin_unheard(act)
    }

    /// Whether a script whose fate is unknown may begin. If a robot drops the scripts of an undecided act by itself, none of them begins
    /// before the commitment.
    fn may_begin_unheard(&self, act: &Act) -> bool {
        let unaccounted = |member: &&Member| member.scripts().iter().any(Script::is_unaccounted);
        let begins = |member: &Member| act.is_committed() || !self.robots[member.robot].drops_undecided();
        act.members().iter().filter(unaccounted).any(begins)
    }

    fn fate_of(&self, now: Timestamp<Server>, act: &Act) -> ActFate {
        let performs = self.phase == Phase::Performing;
        let deserted = act.present().next().is_none();
        // Scripts of a robot that was left out may still move it, until it has reported otherwise.
        let moved = self.may_have_begun(now, act) || deserted && self.may_begin_unheard(act);
        // A stop does not end an act whose planned end has passed, even if no process watched that end.
        let ended = if performs { act.is_over() } else { self.has_ended_before_the_stop(act) };
        match (act.was_sent(), moved) {
            (true, _) if ended && act.is_done_by_one() => ActFate::Played,
            // A script that was never sent certainly did not play.
            (true, true) if ended && !deserted && !act.was_cut_short() && act.is_unaccounted() => {
                ActFate::Unknown
            }
            (_, true) => ActFate::Stopped,
            (true, false) => ActFate::Withdrawn,
            (false, false) if performs => ActFate::NobodyLeft,
            (false, false) if act.attempts() > 0 => ActFate::Withdrawn,
            (false, false) => ActFate::StillWaiting,
        }
    }

    fn has_ended_before_the_stop(&self, act: &Act) -> bool {
        let end = act.timing().filter(|_| act.is_committed()).map(|timing| timing.end);
        self.timers.stopped_at.zip(end).is_some_and(|(stopped, end)| stopped >= end)
    }

    /// Notes the flaws of an act that ended in this process, or in an earlier one that died. Flaws change the outcome of the mission.
    pub(super) fn is_flawed(&mut self, flaws: &ActFlaws) {
        if let Some(OutOfTolerance { spread, tolerance }) = flaws.out_of_tolerance {
            self.conclusion.flaw_of_times.get_or_insert(Outcome::OutOfTolerance { spread, tolerance });
        }
        if let Some(StepsLate { late, tolerance }) = flaws.steps_late {
            self.conclusion.flaw_of_times.get_or_insert(Outcome::StepsLate { late, tolerance });
        }
        for robot in self.robots.iter_mut().filter(|robot| flaws.unaccounted.contains(&robot.id)) {
            robot.was_lost_sight_of = true;
        }
    }

    pub(super) fn keep_report(&mut self, act: &Act, report: ActReport) {
        let tolerance = act.written().plan.start_tolerance;
        let spread = spread(act, act.present()).into_iter().chain(report.off_plan());
        let spread = spread.chain(act.drifted_apart(&self.robots)).max();
        let out_of_tolerance =
            spread.filter(|spread| *spread > tolerance).map(|spread| OutOfTolerance { spread, tolerance });
        let late = report.late_max().filter(|late| *late > tolerance);
        let steps_late = late.map(|late| StepsLate { late, tolerance });
        let lost = |member: &&Member| member.scripts().iter().any(Script::is_unaccounted);
        let unaccounted = act.members().iter().filter(lost);
        let unaccounted = unaccounted.map(|member| self.robots[member.robot].id.clone()).collect();
        let flaws = ActFlaws { unaccounted, out_of_tolerance, steps_late };
        self.is_flawed(&flaws);
        let over = ActOver { act: act.index(), fate: self.course.fates[act.index()].fate.clone() };
        self.record(Record::ActEnded { report: Box::new(report.clone()), flaws, over, again: false });
        self.list(report);
        self.tell(Progress::ActEnded { act: act.name() });
    }

    /// Adds an act to the report of the mission, and drops the oldest acts if there are more than `ROWS_KEPT` rows.
    pub(super) fn list(&mut self, report: ActReport) {
        self.course.reports.push_back(report);
        let rows = |acts: &VecDeque<ActReport>| acts.iter().map(|act| act.robots.len()).sum::<usize>();
        while self.course.reports.len() > 1 && rows(&self.course.reports) > ROWS_KEPT {
            self.course.reports.pop_front();
            self.course.reports_omitted += 1;
        }
    }

    /// Notes robots that join later and have missed their part in an act that was sent without them.
    fn note_missed(&mut self, act: &Act) {
        for index in self.robots.indices() {
            let robot = &self.robots[index];
            let late = robot.joined_late || robot.standing == Standing::Absent;
            let plays = || act.written().plan.robots.iter().any(|plan| plan.robot == robot.id);
            if late && act.member(index).is_none() && plays() {
                self.robots[index].has_missed_an_act = true;
            }
        }
    }

    fn account(&mut self, now: Timestamp<Server>, act: &Act) {
        for member in act.members() {
            // The robot's scripts of an earlier act are over, and were followed.
            if !self.robots[member.robot].stop_was_sent() {
                self.robots[member.robot].halt.left.clear();
            }
            for (index, script) in member.scripts().iter().enumerate() {
                let left = act.left_behind(member, index, &self.robots[member.robot], now);
                let robot = &mut self.robots[member.robot];
                robot.halt.left.extend(left);
                let error = act.start_error(member, script);
                robot.totals.add(script, error);
                if let Some(id) = script.request_id() {
                    robot.requests.remove_script(id);
                }
            }
        }
    }
}
