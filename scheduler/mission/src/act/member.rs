//! A robot's part in an act: the scripts that the robot was sent, and whether it still takes part.

use downbeat_plan::DeviceScript;
use urrcp::{DeviceId, RequestId, Robot, Server, Span, Timestamp};

use super::timing::{Leases, Timing};
use super::{NamedScripts, Question};
use crate::robot_state::{RobotState, Robots, Standing};
use crate::script::{Script, ScriptState};
use crate::{ClockMode, IndexVec, MemberIndex, RobotIndex};

/// How long after its planned start a committed script may still wait on the robot (`pending_until`). The robot therefore never drops a
/// script that may begin.
const BEYOND_START: Span = Span::from_millis(1_000);

/// Whether a robot still takes part in an act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    Taking,
    Dropped,
}

/// A robot with a part in an act.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    /// Index of the robot in the mission.
    pub(crate) robot: RobotIndex,
    pub(super) part: Part,
    /// The offset added to the act's timestamp to convert it to the robot's clock.
    pub(super) shift: Span,
    /// How often the robot's clock had been set when the act was sent; `None` if another process sent the act.
    pub(super) clock_steps: Option<u32>,
    scripts: Vec<Script>,
    /// The progress of each device through its scripts, in the order of `scripts`.
    pub(super) chains: Vec<Chain>,
    /// The last time at which the robot was asked for overdue reports.
    pub(super) asked: Option<Timestamp<Server>>,
    /// The first time at which the robot was asked for its newest overdue report.
    pub(super) asked_since: Option<Timestamp<Server>>,
}

/// The robots with a part in one act.
pub(crate) type Members = IndexVec<MemberIndex, Member>;

/// Sort key of the questions to a robot. Questions that shorten leases come first, in the order in which their scripts begin after the
/// start of the act. A question that shortens no lease comes last.
type Group = (bool, Option<Span>);

/// Progress of one device through its scripts, which are adjacent in the list and sorted by time. Each event inspects only the scripts
/// under way, not all past and future ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chain {
    pub(super) first: usize,
    /// The scripts before this index have completed.
    pub(super) completed: usize,
    /// The scripts from this index on have never been sent.
    pub(super) unsent: usize,
    pub(super) end: usize,
}

impl Member {
    fn new(robot: RobotIndex, scripts: Vec<Script>) -> Self {
        let mut chains: Vec<Chain> = Vec::new();
        for (index, script) in scripts.iter().enumerate() {
            let follows =
                index.checked_sub(1).is_some_and(|before| scripts[before].plan.device == script.plan.device);
            match chains.last_mut().filter(|_| follows) {
                Some(chain) => chain.end = index + 1,
                None => chains.push(Chain { first: index, completed: index, unsent: index, end: index + 1 }),
            }
        }
        let (part, shift, clock_steps) = (Part::Taking, Span::ZERO, None);
        Self { robot, part, shift, clock_steps, scripts, chains, asked: None, asked_since: None }
    }

    pub(super) fn change<R>(&mut self, script: usize, change: impl FnOnce(&mut Script) -> R) -> R {
        let changed = change(&mut self.scripts[script]);
        let place = self.chains.partition_point(|chain| chain.end <= script);
        let chain = &mut self.chains[place];
        if !self.scripts[script].is_planned() {
            chain.unsent = chain.unsent.max(script + 1);
        }
        let completed =
            self.scripts[chain.completed..chain.end].iter().take_while(|script| script.has_completed());
        chain.completed += completed.count();
        changed
    }

    /// Sets the id of a script's request.
    pub(super) fn name(&mut self, script: usize, id: Option<RequestId>) {
        self.scripts[script].name(id);
    }

    /// Adopts the id and the clock offset of a script from another process, which may have sent the script with them. If the robot's
    /// clock is measured, a later script may have been sent with another offset whose record is lost.
    pub(super) fn taken_up(&mut self, script: usize, id: RequestId, shift: Span, clock: ClockMode) {
        let follows = self.before(script).is_some();
        if !follows {
            self.shift = shift;
        }
        let taken_up = &mut self.scripts[script];
        taken_up.name(Some(id));
        if follows && shift == self.shift && clock == ClockMode::Measured {
            taken_up.lose_shift()
        } else {
            taken_up.translate(shift)
        }
        self.scripts[script].taken_up();
    }

    /// Returns the scripts under way: those that were sent and have not completed, and the next unsent one of each device.
    pub(crate) fn under_way(&self) -> impl Iterator<Item = (usize, &Script)> {
        let of_chain = |chain: &Chain| chain.completed..chain.end.min(chain.unsent + 1);
        self.chains.iter().flat_map(of_chain).map(|index| (index, &self.scripts[index]))
    }

    /// For each device: the scripts that have not completed, in order of time.
    pub(crate) fn chains(&self) -> impl Iterator<Item = impl Iterator<Item = (usize, &Script)>> {
        self.chains
            .iter()
            .map(|chain| (chain.completed..chain.end).map(|index| (index, &self.scripts[index])))
    }

    pub(crate) fn takes_part(&self) -> bool {
        self.part == Part::Taking
    }

    pub(crate) fn scripts(&self) -> &[Script] {
        &self.scripts
    }

    pub(crate) const fn shift(&self) -> Span {
        self.shift
    }

    /// Returns the offset that converts the timestamp of a script's request to the robot's clock.
    pub(crate) fn shift_of(&self, script: &Script) -> Span {
        script.shift().unwrap_or(self.shift)
    }

    /// Whether the robot has accepted the first script of every device, and every later script that was sent early enough for the
    /// decision.
    pub(super) fn has_accepted(&self, timing: &Timing) -> bool {
        self.unaccepted(timing).next().is_none()
    }

    /// Returns the scripts that the robot must still accept before the decision to start. A later script of a device is excluded if it
    /// was sent too late for a second question. The robot may accept it after the decision.
    pub(super) fn unaccepted(&self, timing: &Timing) -> impl Iterator<Item = (usize, &Script)> {
        let late = timing.ask_again();
        let follows = move |script: &Script| script.is_out() && !script.was_sent_since(late);
        let open = move |index: usize, script: &Script| self.before(index).is_none() || follows(script);
        self.under_way().filter(move |(index, script)| !script.was_accepted() && open(*index, script))
    }

    pub(crate) fn is_done(&self) -> bool {
        self.chains.iter().all(|chain| chain.completed == chain.end)
    }

    /// Whether all scripts of this member have been sent, and none can still run.
    pub(super) fn is_over(&self) -> bool {
        self.under_way().all(|(_, script)| !script.is_out() && !script.is_planned())
    }

    /// Returns the member's scripts on a device, in order of time.
    pub(crate) fn on<'a>(&'a self, device: &'a DeviceId) -> impl Iterator<Item = (usize, &'a Script)> {
        self.scripts.iter().enumerate().filter(move |(_, script)| script.plan.device == *device)
    }

    /// Returns the first script of every device.
    pub(crate) fn firsts(&self) -> impl Iterator<Item = &Script> {
        self.chains.iter().map(|chain| &self.scripts[chain.first])
    }

    /// Returns the previous script on this script's device; `None` for the first one. The scripts of one device are adjacent, in order of
    /// time.
    pub(super) fn before(&self, script: usize) -> Option<&Script> {
        let before = self.scripts.get(script.checked_sub(1)?)?;
        (before.plan.device == self.scripts[script].plan.device).then_some(before)
    }

    /// Whether a script may be sent: it is the first of its device, the device has accepted the first one, or another process may have
    /// sent all of them.
    pub(super) fn may_follow(&self, script: usize) -> bool {
        let chain = self.chains.iter().find(|chain| (chain.first..chain.end).contains(&script));
        let first = chain.map(|chain| &self.scripts[chain.first]);
        let taken_up = self.scripts[script].is_unaccounted();
        self.before(script).is_none() || taken_up || first.is_some_and(Script::was_accepted)
    }

    /// Returns the maximum number of questions to the robot in one round before the start. There is one for each instant at which a
    /// device begins its first script.
    pub(crate) fn questions(&self) -> usize {
        let mut begins: Vec<Span> = self.firsts().map(|script| script.plan.start.span()).collect();
        begins.sort_unstable();
        begins.dedup();
        begins.len()
    }

    /// Whether this script is the first of its device, and further scripts of the device wait to be sent.
    pub(super) fn waits_for(&self, script: usize) -> bool {
        self.chains.iter().any(|chain| chain.first == script && chain.unsent < chain.end)
    }

    /// Returns how long after the start of the act a script begins; `None` if questions do not shorten its pending lease. They shorten it
    /// if the script is the first of its device and begins within one lease of the start. A script that begins later would lose its lease
    /// long before. A script that follows another one cannot begin without the first one.
    pub(super) fn shortened_offset(&self, script: usize, lease: Span) -> Option<Span> {
        let offset = self.scripts[script].plan.start.span();
        (offset < lease && self.before(script).is_none()).then_some(offset)
    }

    /// Returns the latest time, by the robot's clock, until which a script may wait for its start while the act is not committed. `ahead`
    /// is how far that clock is ahead of the server's, if known.
    pub(super) fn brink_of(&self, script: usize, timing: &Timing, ahead: Option<Span>) -> Timestamp<Robot> {
        let offset = self.scripts[script].plan.start.span();
        let shift = self.shift_of(&self.scripts[script]);
        // If a clock was set forward since the script was sent, the start of the script comes earlier, but this limit does not.
        let ahead = ahead.unwrap_or(shift).min(shift + timing.early());
        (timing.brink() + offset + ahead).assume_clock()
    }

    /// Returns the latest time, by the robot's clock, until which a script of a committed act may wait for its start. It is later than
    /// that start.
    pub(super) fn beyond_start(&self, script: usize, timing: &Timing) -> Timestamp<Robot> {
        let offset = self.scripts[script].plan.start.span();
        (timing.start + offset + self.shift_of(&self.scripts[script]) + BEYOND_START).assume_clock()
    }

    /// Returns the requests that the robot may hold, grouped by the lease that a question gives to them.
    pub(super) fn names(
        &self,
        timing: &Timing,
        now: Timestamp<Server>,
        ahead: Option<Span>,
        question: Question,
    ) -> Vec<NamedScripts> {
        let shortens = question == Question::Shortens;
        // A question without a lease renews everything that the robot has. It comes last, so that the shortened leases are already
        // shorter.
        let mut groups: Vec<(Group, NamedScripts)> = Vec::new();
        // A following script of a device cannot begin without the first one. To save bandwidth, not every round asks about it.
        let asked = |index: usize, script: &Script| {
            script.is_unaccounted() && !(shortens && self.before(index).is_some())
        };
        for (index, script) in self.under_way().filter(|(index, script)| asked(*index, script)) {
            let offset = self.shortened_offset(index, timing.lead.lease).filter(|_| shortens);
            let key = (offset.is_none(), offset);
            // There are few groups: one for each instant at which devices begin.
            let place = groups.binary_search_by_key(&key, |(key, _)| *key).unwrap_or_else(|place| {
                let lease = offset.map(|offset| timing.lease_at(now) + offset);
                groups.insert(place, (key, NamedScripts { lease, until: None, requests: Vec::new() }));
                place
            });
            let group = &mut groups[place].1;
            let until = match question {
                Question::Asks => None,
                Question::Shortens => offset.map(|_| self.brink_of(index, timing, ahead)),
                Question::Extends => Some(self.beyond_start(index, timing)),
            };
            group.until = group.until.max(until);
            group.requests.extend(script.request_id().cloned());
        }
        groups.into_iter().map(|(_, named)| named).collect()
    }

    /// Returns the lease under which a script waits for its start. A script that follows another one cannot begin before that one has
    /// begun. It therefore waits under the running lease of the previous script, if that lease is longer. `None` if the previous script
    /// has no lease.
    pub(crate) fn pending_lease(&self, script: usize, lease: Span) -> Option<Span> {
        match self.before(script) {
            None => Some(lease),
            Some(before) => before.longest_lease().map(|running| running.max(lease)),
        }
    }

    /// Returns the lease under which a script of a playing act still waits for its start. Questions before the start of the act may have
    /// shortened it.
    pub(super) fn pending_lease_now(&self, script: usize, timing: &Timing) -> Option<Span> {
        let shortened = timing.pace.leases == Leases::Shortened;
        let offset = self.shortened_offset(script, timing.lead.lease).filter(|_| shortened);
        match offset {
            Some(offset) => Some(timing.final_lease() + offset),
            None => self.pending_lease(script, timing.lead.lease),
        }
    }

    /// Returns the shortest lease that still applies to a sent script, including its pending lease while it waits for its start.
    pub(super) fn shortest_lease(&self, script: usize, timing: &Timing) -> Option<Span> {
        let waits = matches!(self.scripts[script].state(), ScriptState::Sent | ScriptState::Held);
        let pending = waits.then(|| self.pending_lease_now(script, timing)).flatten();
        pending.into_iter().chain(self.scripts[script].shortest_lease()).min()
    }

    /// Whether the robot has answered a question sent at `since` or later, and so confirmed that it holds the first script of every
    /// device. Later scripts cannot begin without the first ones, and may be sent until shortly before they begin. If a robot takes no
    /// inquiries about scripts, an answer to any other question suffices. If it has never given one, none is required.
    pub(super) fn holds_since(&self, robot: &RobotState, since: Timestamp<Server>) -> bool {
        let answered = robot.contact.questions.answered();
        if !robot.is_up() || !self.firsts().all(Script::was_accepted) {
            return false;
        }
        if !robot.takes_inquiries() {
            return answered.is_none_or(|at| at >= since);
        }
        let held = |script: &Script| !script.is_out() || script.held_at().is_some_and(|at| at >= since);
        answered.is_some_and(|at| at >= since) && self.firsts().all(held)
    }
}

/// Returns the members that still take part.
pub(super) fn present(members: &Members) -> impl Iterator<Item = &Member> {
    members.iter().filter(|member| member.takes_part())
}

/// Returns the members of an act: the robots of the act that take part in the mission.
pub(crate) fn members(plan: &downbeat_plan::Plan, robots: &Robots) -> Members {
    members_among(plan, robots, |robot| robot.standing == Standing::In)
}

/// Returns the members of an act: its robots for which `has_part` returns true.
pub(super) fn members_among(
    plan: &downbeat_plan::Plan,
    robots: &Robots,
    has_part: impl Fn(&RobotState) -> bool,
) -> Members {
    let index_of: std::collections::HashMap<_, _> =
        robots.enumerated().map(|(index, robot)| (&robot.id, index)).collect();
    let member = |planned: &downbeat_plan::RobotPlan| {
        let robot = *index_of.get(&planned.robot)?;
        let script = |script: &DeviceScript| {
            let device = robots[robot].block.as_ref().and_then(|block| block.device(script.device.as_str()));
            Script::new(script, device.map(|device| device.interpolation).unwrap_or_default())
        };
        let scripts = || planned.scripts.iter().map(script).collect();
        has_part(&robots[robot]).then(|| Member::new(robot, scripts()))
    };
    plan.robots.iter().filter_map(member).collect()
}
