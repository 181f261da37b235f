//! Scripts that a robot's current process has lost, but that another process of the robot may still run.

use downbeat_plan::is_rate;
use urrcp::{Server, Span, Timestamp};

use super::Act;
use super::playing::{late_of, planned_end};
use crate::robot_state::RobotState;
use crate::script::{Script, ScriptRef};

impl Act {
    /// Returns the time at which a script comes to rest that the robot has lost, but another process may still run. `None` if no process
    /// can run the script; `Some(None)` if one may run it forever.
    pub(crate) fn runs_elsewhere(
        &self,
        script: ScriptRef,
        robot: &RobotState,
        now: Timestamp<Server>,
    ) -> Option<Option<Timestamp<Server>>> {
        let (timing, lost) = (self.timing()?, self.script(script));
        let is_dropped = !self.is_committed() && robot.drops_undecided();
        if !lost.is_lost() || is_dropped || robot.in_process {
            return None;
        }
        let delay = robot.clock.reading().map_or(Span::ZERO, |clock| clock.delay_max);
        let lease = lost.longest_lease().map(|lease| now + delay + lease);
        let ends = planned_end(timing.start, lost) + late_of(timing, robot);
        let until =
            if leaves_a_rate_on(lost) { lease } else { Some(lease.map_or(ends, |lease| lease.min(ends))) };
        until.is_none_or(|until| now < until).then_some(until)
    }
}

/// Whether a script ends with a speed or an acceleration. The device keeps this rate until the lease of the script ends.
fn leaves_a_rate_on(script: &Script) -> bool {
    let last = script.plan.script.steps().last();
    last.is_some_and(|step| is_rate(step.setpoint.control_type) && step.setpoint.value != 0.0)
}
