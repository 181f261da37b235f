//! Finds robots that hold their scripts but will not start with the others. Their clocks show this, or no message has reached them for
//! too long.

use urrcp::{ControlError, ErrorCode, Robot, RobotId, Server, Span, Timestamp};

use super::{Act, ActAction, Member, Promised, PromisedStage, Stage};
use crate::clock::DRIFT_BOUND;
use crate::failure_kind::FailureKind;
use crate::robot_state::Robots;
use crate::script::{Script, ScriptState};
use crate::skew::SkewBudget;
use crate::{ClockMode, RobotIndex};

/// The maximum error of a robot's timestamp because its clock is coarse.
const GRAIN: Span = Span::from_millis(5);

impl Act {
    /// Returns members that would start too far from the others, because their clock has strayed since the act was sent. A robot whose
    /// clock was set forward may start before the commitment. It is therefore reported as soon as its clock shows this, not only at the
    /// commitment.
    pub(crate) fn strayed(&self, now: Timestamp<Server>, robots: &Robots) -> Vec<(RobotIndex, FailureKind)> {
        use PromisedStage::{Approaching, Preparing, Recording};
        if !matches!(self.stage.promised(), Some(Recording | Preparing(_) | Approaching(_))) {
            return Vec::new();
        }
        let tolerance = self.written().plan.start_tolerance;
        let skew = SkewBudget::of_sent(self.present(), robots, tolerance, now);
        let strayed = skew.map(|skew| skew.offenders()).unwrap_or_default();
        self.by_index(strayed, robots)
    }

    /// Returns the failure of a robot whose clock has been set while the act plays, after its scripts were converted to that clock. Its
    /// remaining scripts would start too far from their plan. `None` if that is not certain.
    pub(crate) fn clock_was_set(
        &self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        robots: &Robots,
    ) -> Option<FailureKind> {
        let timing = self.timing().filter(|_| self.is_committed())?;
        let member = self.member(robot).filter(|member| member.takes_part())?;
        if member.clock_steps == Some(robots[robot].clock.steps()) {
            return None;
        }
        let (deviation, uncertainty) = self.deviation(member, now, robots)?;
        let (common, doubt) = self.common_deviation(member, now, robots)?;
        let offset = deviation - common;
        let tolerance = self.written().plan.start_tolerance;
        // Scripts may have been translated by the offset predicted for the end of the act.
        let length = timing.end.max(now) - timing.timestamp;
        let drift = Span::from_millis_f64(length.as_millis_f64() * DRIFT_BOUND);
        let is_certain = offset.abs() > tolerance + uncertainty + doubt + drift;
        is_certain.then_some(FailureKind::Clock { offset, uncertainty, tolerance })
    }

    /// Returns how far off the plan a robot would start its remaining scripts, positive if early, and the uncertainty of this value.
    fn deviation(&self, member: &Member, now: Timestamp<Server>, robots: &Robots) -> Option<(Span, Span)> {
        let timing = self.timing()?;
        let state = &robots[member.robot];
        let reading = state.clock_at(now)?;
        let known = timing.skew.as_ref().and_then(|skew| skew.offset_of(&state.id));
        let (left, uncertainty) = match (known, state.settings.clock) {
            (Some(known), _) => known,
            (None, ClockMode::Measured) => (Span::ZERO, Span::ZERO),
            // The earlier offset of the robot's clock is unknown.
            (None, ClockMode::Ntp) => return None,
        };
        let ahead = |script: &&Script| timing.start + script.plan.start.span() > now;
        let scripts = member.under_way().map(|(_, script)| script);
        let deviations = scripts
            .filter(|script| ahead(script) && !script.shift_is_lost())
            .map(|script| reading.offset - left - member.shift_of(script));
        let deviation = deviations.max_by_key(|deviation| deviation.abs())?;
        Some((deviation, reading.uncertainty + uncertainty))
    }

    /// Returns the deviation that all members have in common, and its uncertainty. It arises if this machine's clock differs from that of
    /// the process that converted their scripts to their clocks. It is zero for an act that this process has sent; `None` until it is
    /// known.
    fn common_deviation(
        &self,
        member: &Member,
        now: Timestamp<Server>,
        robots: &Robots,
    ) -> Option<(Span, Span)> {
        if member.clock_steps.is_some() {
            return Some((Span::ZERO, Span::ZERO));
        }
        let is_measured = |member: &&Member| robots[member.robot].settings.clock == ClockMode::Measured;
        let mut measured = self.present().filter(is_measured);
        if measured.any(|member| robots[member.robot].clock.samples() == 0) {
            return None;
        }
        let deviations = self.present().filter_map(|member| self.deviation(member, now, robots));
        let (mut deviations, doubts): (Vec<Span>, Vec<Span>) = deviations.unzip();
        deviations.sort_unstable();
        let doubt = doubts.into_iter().max()?;
        (deviations.len() > 2).then(|| (deviations[deviations.len() / 2], doubt))
    }

    fn by_index(
        &self,
        failing: Vec<(RobotId, FailureKind)>,
        robots: &Robots,
    ) -> Vec<(RobotIndex, FailureKind)> {
        let index_of = |id| self.present().map(|member| member.robot).find(|robot| robots[*robot].id == id);
        failing.into_iter().filter_map(|(id, kind)| Some((index_of(id)?, kind))).collect()
    }

    /// Adapts the leases of an act that approaches its start, if a clock is found to have changed since the act was sent. The limits for
    /// failures and silence move with the end of the leases, and are returned as progress to report. If there is no time left to end a
    /// lease before its robot starts, that robot fails.
    pub(crate) fn allow_for(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let Stage::Promised(Promised { timing, stage: PromisedStage::Approaching(_) }) = &self.stage else {
            return Vec::new();
        };
        let known = self.present().filter(|member| robots[member.robot].clock.samples() > 0);
        let shown = SkewBudget::of_sent(known, robots, self.written().plan.start_tolerance, now);
        let Some(shown) = shown else { return Vec::new() };
        let before = (timing.no_return(), timing.doubt());
        let early = self.allow_for_shown(now, &shown, robots);
        if !early.is_empty() {
            return vec![ActAction::Fail(early)];
        }
        let Some(timing) = self.timing() else { return Vec::new() };
        let changed = before != (timing.no_return(), timing.doubt());
        self.decided().filter(|_| changed).map(ActAction::Tell).into_iter().collect()
    }

    /// Makes the leases end as early as the current clock readings require. If there is no time left for this, returns the robots that
    /// would start before their leases end.
    pub(super) fn allow_for_shown(
        &mut self,
        now: Timestamp<Server>,
        shown: &SkewBudget,
        robots: &Robots,
    ) -> Vec<(RobotIndex, FailureKind)> {
        let (early, late) = shown.early_and_late();
        let Some(timing) = self.stage.timing_mut() else { return Vec::new() };
        if timing.allow_for(now, early, late) {
            return Vec::new();
        }
        let early = shown.earlier_than(timing.early_at_most());
        self.by_index(early, robots)
    }

    /// Returns the failure of a robot that cannot have kept an accepted script. Between the two instants, by its clock, no question
    /// reached the robot for longer than its lease. The robot may be unable to report this itself. `None` after the latest time for a
    /// withdrawal.
    pub(crate) fn ran_out(
        &self,
        now: Timestamp<Server>,
        robot: RobotIndex,
        before: Timestamp<Robot>,
        at: Timestamp<Robot>,
    ) -> Option<FailureKind> {
        use PromisedStage::{Approaching, Committed, Preparing};
        let Stage::Promised(Promised { timing, stage: Preparing(_) | Approaching(_) | Committed(_) }) =
            &self.stage
        else {
            return None;
        };
        if now > timing.no_return() {
            return None;
        }
        let member = self.member(robot).filter(|member| member.takes_part())?;
        let lease = timing.lead.lease;
        let unreached = |script: &Script| Some(at - script.accepted_at()?.max(before));
        let over = |script: &&Script| {
            *script.state() == ScriptState::Held && unreached(script).is_some_and(|gap| gap > lease)
        };
        let script = member.firsts().find(over)?;
        Some(link_lost(script, unreached(script)?, "pending", lease))
    }

    /// Returns the failure of a robot that cannot have kept a script that had begun, because no message reached it for longer than its
    /// running lease. The robot has dropped that script, and all following scripts of its device. The two instants are by its clock.
    pub(crate) fn broke_off(
        &self,
        robot: RobotIndex,
        before: Timestamp<Robot>,
        at: Timestamp<Robot>,
    ) -> Option<FailureKind> {
        let timing = self.timing()?;
        let member = self.member(robot).filter(|member| self.is_committed() && member.takes_part())?;
        member.under_way().filter(|(_, script)| script.is_unaccounted()).find_map(|(_, script)| {
            let lease = script.longest_lease()?;
            let begins = timing.start + script.plan.start.span() + member.shift_of(script);
            let begins = begins.assume_clock();
            let over = before + lease;
            let broken = begins <= over && over < begins + script.duration() && over + GRAIN < at;
            broken.then(|| link_lost(script, at - before, "running", lease))
        })
    }
}

fn link_lost(script: &Script, silence: Span, which: &str, lease: Span) -> FailureKind {
    let message = format!(
        "no message is known to have reached the robot for {silence}, and its {which} lease is {lease}"
    );
    let error = ControlError::new(ErrorCode::LinkLost, message);
    FailureKind::Script { device: script.plan.device.clone(), error }
}
