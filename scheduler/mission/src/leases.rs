//! The time at which an unreachable robot comes to rest because its leases end.

use urrcp::{Server, Span, Timestamp};

use super::act::{Act, Member};
use super::robot_state::RobotState;
use super::script::ScriptState;

impl Act {
    /// The time at which a lease ends the script that a robot still has from a closed act, provided that the robot receives nothing more.
    /// A waiting script is ended by its pending lease; a script that plays, by its running lease. `None` if no script remains,
    /// `Some(None)` if the script continues without a lease.
    pub(super) fn left_behind(
        &self,
        member: &Member,
        script: usize,
        robot: &RobotState,
        now: Timestamp<Server>,
    ) -> Option<Option<Timestamp<Server>>> {
        let timing = self.timing()?;
        let state = &member.scripts()[script];
        let begins = timing.start + state.plan.start.span();
        let plays = state.is_unaccounted() && now < begins + state.plan.script.duration();
        let nothing = match state.state() {
            ScriptState::Planned => !state.is_unaccounted(),
            _ => state.has_failed(),
        };
        if nothing || !(plays || robot.stop_was_sent()) {
            return None;
        }
        // The last message may have travelled for the longest measured time.
        let delay = robot.clock.reading().map_or(Span::ZERO, |clock| clock.delay_max);
        let silent_since = robot.contact.last_sent? + delay;
        let pending_ends = member.pending_lease(script, timing.lead.lease).map(|lease| silent_since + lease);
        let waits = matches!(state.state(), ScriptState::Sent | ScriptState::Held);
        let ends = match pending_ends.filter(|ends| waits && *ends < begins) {
            Some(ends) => Some(ends),
            None => state.longest_lease().map(|lease| {
                let running_ends = silent_since + lease;
                pending_ends.filter(|_| waits).map_or(running_ends, |pending| running_ends.max(pending))
            }),
        };
        // A lease that has already ended ends now.
        Some(ends.map(|at| at.max(now)))
    }
}
