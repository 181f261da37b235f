//! When a robot that cannot be reached comes to rest by its own leases.

use urrcp::{Server, Span, Timestamp};

use super::act::{Act, Member};
use super::robot_state::RobotState;
use super::script::{Ending, ScriptState};

impl Act {
    /// What a robot has left of a script when its act is closed, and when that ends by its own lease if nothing is heard any
    /// more: while it waits by the pending one, else by the running one. `None` where nothing is left, `Some(None)` where it
    /// goes on without a lease.
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
            state => matches!(state, ScriptState::Ended(Ending::Failed(_))),
        };
        if nothing || !(plays || robot.stop_was_sent()) {
            return None;
        }
        // What was sent last may have travelled as long as anything did.
        let delay = robot.clock.reading().map_or(Span::ZERO, |clock| clock.delay_max);
        let silent_since = robot.last_sent? + delay;
        let pending_ends = member.pending_lease(script, timing.lead.lease).map(|lease| silent_since + lease);
        let waits = matches!(state.state(), ScriptState::Sent | ScriptState::Held);
        let ends = match pending_ends.filter(|ends| waits && *ends < begins) {
            Some(ends) => Some(ends),
            None => state.longest_lease().map(|lease| {
                let running_ends = silent_since + lease;
                pending_ends.filter(|_| waits).map_or(running_ends, |pending| running_ends.max(pending))
            }),
        };
        // One that has run out already has run out by now.
        Some(ends.map(|at| at.max(now)))
    }
}
