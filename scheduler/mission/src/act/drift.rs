//! Handles clocks that drift while an act plays: later scripts are corrected when they are sent, and the act is judged at its end.

use urrcp::{Server, Span, Timestamp};

use super::playing::planned_end;
use super::{Act, Member};
use crate::clock::DRIFT_BOUND;
use crate::robot_state::RobotState;
use crate::script::ScriptRef;
use crate::{ClockMode, Record};

/// The maximum change of a clock that counts as drift. A clock that has changed by more was set: a drift of 50 ppm would take more than
/// five hours.
const DRIFT_MAX: Span = Span::from_millis(1_000);

impl Act {
    /// Corrects the start of a later script for the drift of its robot's clock since the act was promised. `offset_at` returns the time
    /// by which that clock is ahead of the server's.
    pub(crate) fn translate(
        &mut self,
        script: ScriptRef,
        clock_steps: u32,
        offset_at: impl FnOnce(Timestamp<Server>) -> Option<Span>,
    ) -> Option<Record> {
        let timing = self.timing.as_ref().filter(|_| self.is_committed())?;
        let (member, planned) = (&self.members[script.member], self.script(script));
        let lost = planned.shift_is_lost();
        if planned.was_ever_sent() && !lost {
            return None;
        }
        // The offset is exact for the middle of the script, so its error at either end is half of the drift.
        let middle = timing.start + planned.plan.start.span() + planned.duration() / 2;
        let before = member.before(script.script)?;
        let since = planned.plan.start.span() - before.plan.start.span();
        let slewed = Span::from_millis_f64(since.as_millis_f64() * DRIFT_BOUND);
        let change = offset_at(middle)? - member.shift_of(before);
        let change = match member.clock_steps {
            Some(steps) if steps == clock_steps && change.abs() <= DRIFT_MAX => change,
            // After a clock was set, a script continues with the offset of the previous one.
            Some(_) => Span::ZERO,
            // A clock may have been set before this process took over. The offset then changes at most as fast as clocks drift.
            None => change.clamp(Span::ZERO - slewed, slewed),
        };
        let shift = member.translation(script.script, change)?;
        let request_id = planned.request_id()?.clone();
        let member = &mut self.members[script.member];
        member.change(script.script, |script| {
            script.translate(shift);
            if lost {
                // The robot may have the script with another offset.
                script.lose_shift();
            }
        });
        (shift != member.shift && !lost).then_some(Record::Translated { request_id, shift })
    }

    /// How far apart, or off the plan, the robots that played the act to its end certainly were because of clock drift. A robot whose
    /// clock was set meanwhile is not judged, because its plan may not follow that clock.
    pub(crate) fn drifted_apart(&self, robots: &[RobotState]) -> Option<Span> {
        let start = self.timing.as_ref()?.start;
        let deviation = |member: &Member| {
            let robot = &robots[member.robot];
            let last = member.scripts().iter().max_by_key(|script| script.plan.start.span())?;
            let is_same = robot.clock.steps() == member.clock_steps.unwrap_or_default();
            let end = planned_end(start, last);
            let reading = robot.clock_at(end).filter(|_| is_same)?;
            let off = reading.offset - member.shift_of(last);
            let is_measured = robot.settings.clock == ClockMode::Measured;
            Some(Deviation {
                end,
                least: off - reading.uncertainty,
                most: off + reading.uncertainty,
                is_measured,
                // The plan of a robot that follows NTP is based on its own clock, and this machine's clock may be off as well. The plan
                // of an act that was taken over is based on the earlier clock of this machine.
                by_plan: is_measured && member.clock_steps.is_some(),
            })
        };
        let played = self.present().filter(|member| member.is_done());
        let mut all: Vec<_> = played.filter_map(deviation).collect();
        all.sort_by_key(|deviation| deviation.end);
        let by_plan = all.iter().filter(|deviation| deviation.by_plan);
        let off_plan = by_plan.map(|deviation| deviation.least.max(Span::ZERO - deviation.most)).max();
        let measured = apart(all.iter().filter(|deviation| deviation.is_measured), 0.0);
        let apart = off_plan.max(measured).max(apart(all.iter(), DRIFT_BOUND));
        apart.map(|apart| apart.max(Span::ZERO))
    }
}

/// The deviation of a robot from its plan at its end, by the clock of this machine.
struct Deviation {
    end: Timestamp<Server>,
    least: Span,
    most: Span,
    is_measured: bool,
    by_plan: bool,
}

/// The largest time by which two of these robots were certainly apart. The robots are sorted by their ends. Between these ends, the clock
/// of this machine may have drifted at `rate`. That drift does not affect robots whose plans follow that clock.
fn apart<'a>(all: impl Iterator<Item = &'a Deviation>, rate: f64) -> Option<Span> {
    let mut all = all.peekable();
    let first = all.peek()?.end;
    let (mut greatest, mut smallest, mut apart) = (None, None, None);
    for Deviation { end, least, most, .. } in all {
        let drift = Span::from_millis_f64((*end - first).as_millis_f64() * rate);
        greatest = greatest.max(Some(*least + drift));
        smallest = smallest.into_iter().chain([*most - drift]).min();
        let ahead = smallest.map(|smallest| *least - drift - smallest);
        let behind = greatest.map(|greatest| greatest - drift - *most);
        apart = apart.max(ahead).max(behind);
    }
    apart
}

impl Member {
    /// The largest offset of the last script of any device, whether already sent or not.
    pub(crate) fn last_shift(&self) -> Option<Span> {
        let scripts = self.scripts();
        let is_last = |index: &usize| *index + 1 == scripts.len() || self.before(index + 1).is_none();
        (0..scripts.len()).filter(is_last).map(|index| self.shift_of(&scripts[index])).max()
    }

    /// The offset for a script that is sent for the first time, given the change since the previous script. A following script begins at
    /// or after the end of the previous one, by the same clock.
    fn translation(&self, script: usize, change: Span) -> Option<Span> {
        let (before, follows) = (self.before(script)?, &self.scripts()[script]);
        let pause = follows.plan.start.span() - before.plan.start.span() - before.duration();
        Some(self.shift_of(before) + change.max(Span::ZERO - pause))
    }
}
