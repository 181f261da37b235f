//! One act under way: who plays in it, how far it is, and its instants.

use downbeat_scripts::Way;
use urrcp::{Server, Span, Timestamp};

use super::lead::LeadTime;
use super::robot_state::{RobotState, ScriptPhase, ScriptState, Standing};
use super::skew::SkewBudget;

/// How far an act is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Stage {
    /// Its condition does not hold yet.
    Waiting,
    /// It may be sent as soon as it fits.
    Ready,
    /// Requests are out; the decision is due.
    Preparing,
    /// All have accepted; the round of renewals that carries the leases over the start is due or under way.
    Decided,
    /// All leases are known to reach over the start.
    Committed,
    /// The start has passed.
    Playing,
    /// All has ended.
    Over,
}

/// The instants of an act that has been sent.
#[derive(Clone, Debug)]
pub(crate) struct Timing {
    /// The sending timestamp that all requests share.
    pub(crate) timestamp: Timestamp<Server>,
    pub(crate) start: Timestamp<Server>,
    pub(crate) lead: LeadTime,
    pub(crate) decision: Timestamp<Server>,
    /// When renewals of the last round before the start must have been answered.
    pub(crate) commit: Timestamp<Server>,
    /// A withdrawal sent later may reach somebody after the start.
    pub(crate) no_return: Timestamp<Server>,
    /// When the last step is planned.
    pub(crate) end: Timestamp<Server>,
    /// What spread the clocks allow.
    pub(crate) skew: Option<SkewBudget>,
    /// When the last acceptance came.
    pub(crate) accepted_at: Option<Timestamp<Server>>,
    /// The round of renewals that carries the leases over the start: when it was sent, and when its last answer came.
    pub(crate) round: Option<(Timestamp<Server>, Timestamp<Server>)>,
    /// How much later it starts than it should: at the end of the act before, or at the time that it waits for.
    pub(crate) gap: Option<Span>,
    pub(crate) asked_again: bool,
}

impl Timing {
    /// One lease before the start: a robot that hears nothing from here on does not start.
    pub(crate) fn critical(&self) -> Timestamp<Server> {
        self.start - self.lead.lease
    }
}

/// A robot of an act.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    /// Its index in the mission.
    pub(crate) robot: usize,
    /// It takes part no longer.
    pub(crate) out: bool,
    /// What is added to the act's timestamp so that it is right by the robot's own clock.
    pub(crate) shift: Span,
    pub(crate) scripts: Vec<ScriptState>,
}

impl Member {
    /// Every script that was sent before the decision is accepted.
    pub(crate) fn has_accepted(&self) -> bool {
        self.scripts.iter().all(|script| script.accepted || script.phase == ScriptPhase::Planned)
    }

    pub(crate) fn is_done(&self) -> bool {
        self.scripts.iter().all(|script| script.phase == ScriptPhase::Ended)
    }

    /// Indices of scripts that may be sent now: a device holds as many as its queue has room for. `held` tells how many
    /// another act has there.
    pub(crate) fn sendable(
        &self,
        robot: &RobotState,
        held: impl Fn(&urrcp::DeviceId) -> usize,
    ) -> Vec<usize> {
        let mut sendable = Vec::new();
        let mut index = 0;
        // Scripts of one device stand together, in order of time.
        while index < self.scripts.len() {
            let device = &self.scripts[index].plan.device;
            let of_device = self.scripts[index..].iter().take_while(|s| s.plan.device == *device).count();
            let chain = &self.scripts[index..index + of_device];
            let out = chain.iter().filter(|script| script.is_out()).count() + held(device);
            let room = robot.queue_of(device).saturating_sub(out);
            let planned = (index..).zip(chain).filter(|(_, script)| script.phase == ScriptPhase::Planned);
            sendable.extend(planned.map(|(index, _)| index).take(room));
            index += of_device;
        }
        sendable
    }
}

/// One act under way.
#[derive(Clone, Debug)]
pub(crate) struct ActRun {
    /// Counts the acts of the mission.
    pub(crate) number: u32,
    /// Its index in the choreography.
    pub(crate) act: usize,
    pub(crate) stage: Stage,
    /// Where the mission goes after it.
    pub(crate) follow: Way,
    /// Since when it is the next one.
    pub(crate) since: Timestamp<Server>,
    /// When nothing before it plays any more.
    pub(crate) alone_since: Option<Timestamp<Server>>,
    /// The operator said go.
    pub(crate) gone: bool,
    /// When a sensor is read next.
    pub(crate) poll: Option<Timestamp<Server>>,
    /// The instant at which it should start: the end of the act before, or the time that it waits for.
    pub(crate) target: Option<Timestamp<Server>>,
    pub(crate) timing: Option<Timing>,
    pub(crate) members: Vec<Member>,
    /// Members that have not accepted everything.
    pub(crate) awaited: usize,
    /// When reports are next looked for.
    pub(crate) watch: Option<Timestamp<Server>>,
    /// Something has ended: it may be over.
    pub(crate) recheck: bool,
    /// Readings of the scenario that have been asked for.
    pub(crate) readings_asked: usize,
    pub(crate) readings: Vec<super::TakenReading>,
}

impl ActRun {
    pub(crate) fn present(&self) -> impl Iterator<Item = &Member> {
        self.members.iter().filter(|member| !member.out)
    }

    pub(crate) fn member(&self, robot: usize) -> Option<&Member> {
        self.members.iter().find(|member| member.robot == robot)
    }

    /// Whether one of its robots may still have something of it.
    pub(crate) fn is_sent(&self) -> bool {
        self.timing.is_some()
    }

    pub(crate) fn has_begun(&self) -> bool {
        self.members.iter().flat_map(|member| &member.scripts).any(ScriptState::has_begun)
    }

    /// How much of a device's queue this act takes from another one: what is held, and where this act comes first also what
    /// is still to be sent.
    pub(crate) fn held(&self, robot: usize, device: &urrcp::DeviceId, other: u32) -> usize {
        let comes_first = self.number < other;
        let takes =
            |script: &&ScriptState| script.is_out() || (comes_first && script.phase == ScriptPhase::Planned);
        let scripts = self.member(robot).into_iter().flat_map(|member| &member.scripts);
        scripts.filter(|script| script.plan.device == *device).filter(takes).count()
    }
}

/// The members of an act: its robots that are there.
pub(crate) fn members(plan: &downbeat_scripts::Plan, robots: &[RobotState]) -> Vec<Member> {
    let index_of: std::collections::HashMap<_, _> =
        robots.iter().enumerate().map(|(index, robot)| (&robot.id, index)).collect();
    let member = |planned: &downbeat_scripts::RobotPlan| {
        let robot = *index_of.get(&planned.robot)?;
        let present = robots[robot].standing == Standing::In;
        let scripts = planned.scripts.iter().map(ScriptState::new).collect();
        present.then_some(Member { robot, out: false, shift: Span::ZERO, scripts })
    };
    plan.robots.iter().filter_map(member).collect()
}

/// Actual minus planned start, both by the robot's own clock.
pub(crate) fn start_error(run: &ActRun, member: &Member, script: &ScriptState) -> Option<Span> {
    let planned = run.timing.as_ref()?.start + script.plan.start.span() + member.shift;
    Some(script.started_at? - planned.assume_clock())
}

/// When a script that was sent ends by its own lease if nothing is heard any more: while it waits by the pending one, else
/// by the running one. `None` where nothing was sent; `Some(None)` where it goes on without a lease.
pub(crate) fn lease_end(
    run: &ActRun,
    script: &ScriptState,
    last_sent: Option<Timestamp<Server>>,
    clock: Option<crate::clock::ClockReading>,
) -> Option<Option<Timestamp<Server>>> {
    if script.phase == ScriptPhase::Planned {
        return None;
    }
    let timing = run.timing.as_ref()?;
    // What was sent last may have travelled as long as anything did.
    let silent_since = last_sent? + clock.map_or(Span::ZERO, |clock| clock.delay_max);
    let pending_ends = silent_since + timing.lead.lease;
    let begins = timing.start + script.plan.start.span();
    Some(match script.phase {
        ScriptPhase::Sent | ScriptPhase::Accepted if pending_ends < begins => Some(pending_ends),
        _ => script.plan.stop_condition.running.map(|lease| (silent_since + lease.span()).max(pending_ends)),
    })
}

impl Timing {
    /// When robots that have not answered are asked once more, in time for the decision.
    pub(crate) fn ask_again(&self) -> Timestamp<Server> {
        self.timestamp + (self.decision - self.timestamp) * 2 / 3
    }
}
