//! Takes over an act that another process promised before it died.

use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::Arc;

use downbeat_plan::Choreography;
use urrcp::{RequestId, Server, Span, Timestamp};

use super::approaching::Approach;
use super::member::{Part, members_among};
use super::playing::Playing;
use super::timing::{CLOCK_UNKNOWN, Leases, Measured, Pace};
use super::{Act, Member, Promised, PromisedStage, Stage, Timing, places};
use crate::lead::LeadTime;
use crate::record::{Promise, PromisedScript};
use crate::resume::Changed;
use crate::robot_state::{Robots, Standing};
use crate::script::ScriptRef;
use crate::{MemberIndex, RobotIndex};

/// The last step that the other process completed for an act before it died.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reached {
    /// All robots had accepted.
    Decision,
    /// The commitment was on disk.
    Commitment,
}

/// The round trip that is assumed before the first measurement: an upper limit for a local network.
const ROUND_TRIP: Span = Span::from_millis(10);

impl Act {
    /// Takes over an act that another process promised. If the act was not committed, this process commits it, provided that there is
    /// time. If it was committed, it may already play.
    ///
    /// # Errors
    /// [`Changed`] if the promise does not match the choreography.
    pub(crate) fn take_up(
        choreography: Arc<Choreography>,
        promise: &Promise,
        reached: Reached,
        robots: &Robots,
        now: Timestamp<Server>,
    ) -> Result<Self, Changed> {
        if promise.act.get() >= choreography.acts.len() {
            return Err(Changed { what: format!("act {} no longer exists", promise.act.get() + 1) });
        }
        let mut act = Self::new(choreography, promise.act, promise.number, robots, now, None);
        // The members include robots that were left out after the promise: the report contains the steps that they played.
        let sent: HashSet<_> = promise.scripts.iter().map(|script| &script.robot).collect();
        act.members = members_among(&act.written().plan, robots, |robot| sent.contains(&robot.id));
        act.place = places(&act.members);
        let is_out = |member: &&mut Member| robots[member.robot].standing == Standing::Out;
        act.members.iter_mut().filter(is_out).for_each(|member| member.part = Part::Dropped);
        let mut promised: HashMap<_, VecDeque<&PromisedScript>> = HashMap::new();
        for script in &promise.scripts {
            promised.entry((script.robot.clone(), script.device.clone())).or_default().push_back(script);
        }
        for member in &mut act.members {
            let robot = &robots[member.robot];
            for index in 0..member.scripts().len() {
                let script = &member.scripts()[index];
                let same = |promised: &&PromisedScript| {
                    promised.start == script.plan.start && promised.content_hash == script.content_hash()
                };
                let of_device = promised.get_mut(&(robot.id.clone(), script.plan.device.clone()));
                let Some(promised) = of_device.and_then(VecDeque::pop_front).filter(same) else {
                    let (robot, device) = (&robot.id, &script.plan.device);
                    return Err(Changed {
                        what: format!("device `{device}` of `{robot}` was sent a different script"),
                    });
                };
                let id = promised.request_id.clone();
                member.taken_up(index, id, promised.shift, robot.settings.clock);
            }
        }
        act.attempts = promise.prepared_again;
        let timing = act.timing_of(promise);
        let stage = match reached {
            Reached::Decision => PromisedStage::Approaching(Approach::taken_up(now)),
            // The commitment is written ahead of time, and was not sent yet.
            Reached::Commitment if now < timing.critical() => {
                let mut approach = Approach::taken_up(now);
                approach.recorded();
                PromisedStage::Approaching(approach)
            }
            Reached::Commitment => PromisedStage::Playing(Playing::beginning(now)),
        };
        act.stage = Stage::Promised(Promised { timing, stage });
        Ok(act)
    }

    /// Keeps the interval of doubt that was stated at the decision, if the act plays. In this interval before the start, a robot's
    /// silence may be noticed too late. This process cannot recompute it, because it does not know the leases and links of that time.
    pub(crate) fn keep_doubt(&mut self, stated: Option<Span>) {
        let plays = self.is_playing();
        if let Some(timing) = self.stage.timing_mut().filter(|_| plays) {
            timing.stated_doubt = stated;
        }
    }

    fn timing_of(&self, promise: &Promise) -> Timing {
        let prepare = promise.start - promise.timestamp - promise.lease;
        let tolerance = self.written().plan.start_tolerance;
        let measured = Measured {
            robots: self.members.len(),
            scripts: promise.scripts.len(),
            questions: 1,
            leases: Leases::Fixed,
            round_trip: ROUND_TRIP,
            early: tolerance.min(CLOCK_UNKNOWN),
            late: tolerance.min(CLOCK_UNKNOWN),
            record: Span::ZERO,
            lateness: Span::ZERO,
        };
        let lead = LeadTime { prepare, lease: promise.lease, margin: Span::ZERO };
        let pace = Pace::of(&measured, promise.lease);
        Timing::new(promise.timestamp, lead, pace, self.written().plan.duration())
    }

    /// Marks scripts whose planned start has passed as possibly sent. Their robots are asked about all of them at once.
    pub(crate) fn note_as_sent_until(&mut self, now: Timestamp<Server>) {
        let Some(start) = self.timing().map(|timing| timing.start) else { return };
        for member in &mut self.members {
            for index in 0..member.scripts().len() {
                let script = &member.scripts()[index];
                if script.is_planned() && start + script.plan.start.span() <= now {
                    member.change(index, |script| script.assume_sent(now));
                }
            }
        }
    }

    /// Treats a script as sent, because another process may have sent it.
    pub(crate) fn assume_sent(&mut self, now: Timestamp<Server>, script: ScriptRef) {
        self.members[script.member].change(script.script, |script| script.assume_sent(now));
    }

    /// Returns the ids of all requests of the act, each with its robot and its script.
    pub(crate) fn all_names(&self) -> Vec<(RobotIndex, RequestId, ScriptRef)> {
        let of_member = |(m, member): (MemberIndex, &Member)| {
            let named = member.scripts().iter().enumerate().filter_map(|(s, script)| {
                let reference = ScriptRef { act: self.number, member: m, script: s };
                Some((member.robot, script.request_id()?.clone(), reference))
            });
            named.collect::<Vec<_>>()
        };
        self.members.enumerated().flat_map(of_member).collect()
    }
}
