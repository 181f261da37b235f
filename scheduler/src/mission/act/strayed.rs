//! Robots that will not start with the others though they hold their scripts: what shows it is their clock, or how long
//! nothing reached them.

use urrcp::{ControlError, ErrorCode, Robot, Server, Timestamp};

use super::{Act, Stage};
use crate::mission::failure_kind::FailureKind;
use crate::mission::robot_state::RobotState;
use crate::mission::script::{Script, ScriptState};
use crate::mission::skew::SkewBudget;

impl Act {
    /// Members whose clock has strayed so far since the act was sent that they would start too far from the others. One that
    /// was set forward may have its robot start before the commitment, so it is looked at when it shows, and not only then.
    pub(crate) fn strayed(&self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<(usize, FailureKind)> {
        if !matches!(self.stage, Stage::Promised | Stage::Preparing(_) | Stage::Approaching(_)) {
            return Vec::new();
        }
        let tolerance = self.written().plan.start_tolerance;
        let skew = SkewBudget::of_sent(self.present(), robots, tolerance, now);
        let strayed = skew.map(|skew| skew.offenders()).unwrap_or_default();
        let index_of = |id| self.present().map(|member| member.robot).find(|robot| robots[*robot].id == id);
        strayed.into_iter().filter_map(|(id, kind)| Some((index_of(id)?, kind))).collect()
    }

    /// Why a robot cannot have kept a script that it has accepted: between two instants by its clock no question reached it, for
    /// longer than its lease. It may not be able to say so. Later than the last instant for a withdrawal it is let be.
    pub(crate) fn ran_out(
        &self,
        now: Timestamp<Server>,
        robot: usize,
        (before, at): (Timestamp<Robot>, Timestamp<Robot>),
    ) -> Option<FailureKind> {
        let timing = self.timing.as_ref().filter(|timing| now <= timing.no_return())?;
        let waits = matches!(self.stage, Stage::Preparing(_) | Stage::Approaching(_) | Stage::Committed(_));
        let member = self.member(robot).filter(|member| waits && member.takes_part())?;
        let lease = timing.lead.lease;
        let unreached = |script: &Script| Some(at - script.accepted_at()?.max(before));
        let over = |script: &&Script| {
            *script.state() == ScriptState::Held && unreached(script).is_some_and(|gap| gap > lease)
        };
        let script = member.firsts().find(over)?;
        let gap = unreached(script)?;
        let message = format!("nothing reached it for {gap}, and its lease is {lease}");
        let error = ControlError::new(ErrorCode::LinkLost, message);
        Some(FailureKind::Script { device: script.plan.device.clone(), error })
    }
}
