//! Handles clocks that drift while an act plays. Later scripts are corrected when they are sent. At its end, the act is checked for
//! robots that have drifted apart.

use urrcp::{Server, Span, Timestamp};

use super::playing::planned_end;
use super::{Act, Member};
use crate::clock::DRIFT_BOUND;
use crate::robot_state::Robots;
use crate::script::ScriptRef;
use crate::{ClockMode, Record};

/// The maximum change of a clock that counts as drift. A clock that has changed by more was set: at 50 ppm, this much drift would take
/// more than five hours.
const DRIFT_MAX: Span = Span::from_millis(1_000);

impl Act {
    /// Corrects the start of a script for the drift of its robot's clock since the act was promised. The script must follow another one
    /// on its device. `offset_at` returns by how much the clock is ahead of the server's at a given time. Returns a record of the new
    /// offset, if one is needed.
    pub(crate) fn translate(
        &mut self,
        script: ScriptRef,
        clock_steps: u32,
        offset_at: impl FnOnce(Timestamp<Server>) -> Option<Span>,
    ) -> Option<Record> {
        let timing = self.timing().filter(|_| self.is_committed())?;
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

    /// Returns how far apart robots certainly were at the end of the act because of clock drift. If a robot was certainly even further
    /// off its plan, returns that time instead. Considers only robots that played to the end. A robot whose clock was set meanwhile is
    /// ignored, because its plan may not follow that clock.
    pub(crate) fn drifted_apart(&self, robots: &Robots) -> Option<Span> {
        let start = self.timing()?.start;
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

/// A robot's deviation from its plan at the end of its last script, by the clock of this machine.
struct Deviation {
    end: Timestamp<Server>,
    least: Span,
    most: Span,
    is_measured: bool,
    by_plan: bool,
}

/// Returns the largest time by which any two of these robots certainly ended apart. `all` is sorted by the ends of the robots. Between
/// two ends, the clock of this machine may have drifted at `rate`. That drift does not affect robots whose plans follow that clock.
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
    /// Returns the largest clock offset among the last scripts of all devices, whether those were already sent or not. The offset
    /// converts start times to the robot's clock.
    pub(crate) fn last_shift(&self) -> Option<Span> {
        let scripts = self.scripts();
        let is_last = |index: &usize| *index + 1 == scripts.len() || self.before(index + 1).is_none();
        (0..scripts.len()).filter(is_last).map(|index| self.shift_of(&scripts[index])).max()
    }

    /// Returns the clock offset of a script that is sent for the first time: that of the previous script on its device, plus `change`.
    /// The offset is limited so that the script begins no earlier than the previous one ends.
    fn translation(&self, script: usize, change: Span) -> Option<Span> {
        let (before, follows) = (self.before(script)?, &self.scripts()[script]);
        let pause = follows.plan.start.span() - before.plan.start.span() - before.duration();
        Some(self.shift_of(before) + change.max(Span::ZERO - pause))
    }
}
