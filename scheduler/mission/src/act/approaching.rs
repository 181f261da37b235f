//! An act from its decision to its start. A lease is the time for which a robot keeps its scripts without a message from the scheduler.
//! Rounds of questions make all leases end just before the start. The commitment, a final message to each robot, extends the leases
//! beyond the start.
//!
//! Every round asks each robot whether it holds its scripts. At the critical instant, the scheduler stops sending: no earlier message can
//! make a robot start. A moment later, a single message can make any robot start. The scheduler sends this message, the commitment, under
//! three conditions. Every robot has answered one of the last two rounds, every clock is right, and the commitment is recorded on disk.
//! If this does not happen in time, the scheduler never sends the commitment, and no robot starts. If a scheduler stalled during the last
//! rounds, it asks again, provided that the leases can still end just before the start.

use downbeat_plan::OnDoubt;
use urrcp::{Server, Span, Timestamp};

use super::PromisedStage::{Approaching, Committed};
use super::playing::Playing;
use super::timing::Leases;
use super::{Act, ActAction, Promised, PromisedStage, Stage, Timing};
use crate::failure_kind::FailureKind;
use crate::record::Record;
use crate::robot_state::{RobotState, Robots};
use crate::{Outcome, Progress, RobotIndex};

/// How long before the latest time for the commitment a silent robot is considered failed. The other robots can then still be committed
/// in time.
const FAIL_AHEAD: Span = Span::from_millis(5);

/// Progress of writing the commitment record to disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OnDisk {
    Nothing,
    Asked,
    Commitment,
}

/// State of an act between the decision to start it and its commitment. In this time, robots are asked repeatedly whether they hold their
/// scripts.
#[derive(Clone, Debug)]
pub(crate) struct Approach {
    /// The time of the next round of questions. After the last round, the time of the next check whether to commit the act or to give it
    /// up.
    wakeup: Timestamp<Server>,
    /// Sending times of the last two rounds of questions, the newer one last.
    pub(super) rounds: [Timestamp<Server>; 2],
    on_disk: OnDisk,
    /// Number of leading members (robots of the act) that have answered one of the last two rounds of questions.
    heard: usize,
    /// The time of an extra round of questions after the critical instant. It is sent because this process had stalled during the regular
    /// rounds; `None` if there was none.
    late_round: Option<Timestamp<Server>>,
    /// The time at which this process took over the act from the process that decided it; `None` if this process decided it.
    pub(super) taken_up: Option<Timestamp<Server>>,
}

/// State of an act that is committed, but has not started on all robots.
#[derive(Clone, Debug)]
pub(crate) struct Commitment {
    next_round: Timestamp<Server>,
    since: Timestamp<Server>,
    /// The instant by which the last robot has started.
    begun: Timestamp<Server>,
    /// The next instant at which a device may have finished a script, and so have room for another one.
    room: Timestamp<Server>,
    /// Number of leading members (robots of the act) that have answered since the commitment was sent.
    heard: usize,
    told: Told,
    /// The time at which the mission checks whether all robots have answered the commitment. It is the latest one at which a withdrawal
    /// still helps. `None` after the check, or if the other robots start in any case.
    doubt: Option<Timestamp<Server>>,
}

/// Whether the operator was informed how long the commitment took.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Told {
    NotYet,
    Window,
}

impl Approach {
    /// Returns the state right after the decision to start the act. The first round of questions is sent at once.
    pub(super) const fn beginning(now: Timestamp<Server>) -> Self {
        let (rounds, on_disk) = ([now, now], OnDisk::Nothing);
        Self { wakeup: now, rounds, on_disk, heard: 0, late_round: None, taken_up: None }
    }

    /// Returns the state of an act that another process has decided to start and this process takes over. There may be too little time
    /// left to ask the robots.
    pub(super) const fn taken_up(now: Timestamp<Server>) -> Self {
        Self { taken_up: Some(now), ..Self::beginning(now) }
    }

    /// Whether a robot counts as failed because it has not confirmed that it holds its scripts. The robot is not blamed if this process
    /// itself is late: the confirmation may be unread, or the robot was not asked in time.
    fn blames_silence(&self, now: Timestamp<Server>, timing: &Timing) -> bool {
        let in_time = now <= self.commit_by(timing) && !self.was_held_up(timing);
        in_time && self.taken_up.is_none_or(|at| now - at >= timing.lead.lease)
    }

    /// Returns the time since which a question must have been sent so that its answer counts as a confirmation. This is when the
    /// second-to-last round was sent, or the limit for silence that was printed, if that is later.
    fn since(&self, timing: &Timing) -> Timestamp<Server> {
        self.rounds[0].max(timing.doubtful_from())
    }

    /// Whether this process stalled during the last rounds of questions.
    fn was_held_up(&self, timing: &Timing) -> bool {
        self.late_round.is_some() || self.rounds[0] < timing.doubtful_from()
    }

    /// Whether this process stalled during the last rounds of questions, but may send another one. The leases must still end at the
    /// brink, just before the start.
    fn may_ask_late(&self, now: Timestamp<Server>, timing: &Timing) -> bool {
        self.late_round.is_none()
            && self.was_held_up(timing)
            && now >= timing.critical()
            && now < self.commit_by(timing) - FAIL_AHEAD
            && timing.lets_through(now)
    }

    /// Whether `now` is the time of the extra round of questions that follows a stall of this process.
    pub(super) fn asks_late(&self, now: Timestamp<Server>) -> bool {
        self.late_round == Some(now)
    }

    /// Whether this process took over the act too late to ask any robot. The act is then withdrawn at once. Otherwise, nothing would be
    /// sent until the commitment is too late, and the leases of acts that play would end.
    fn was_taken_up_too_late(&self, timing: &Timing) -> bool {
        self.on_disk == OnDisk::Nothing && self.taken_up.is_some_and(|at| at >= timing.critical())
    }

    pub(super) const fn recorded(&mut self) {
        self.on_disk = OnDisk::Commitment;
    }

    fn commit_by(&self, timing: &Timing) -> Timestamp<Server> {
        timing.commit_by(self.rounds[1])
    }

    /// Returns the time by which robots must have answered; the others have failed. The remaining time is enough to record the commitment
    /// and to send it to the robots that have answered.
    fn fail_by(&self, timing: &Timing) -> Timestamp<Server> {
        let latest = self.commit_by(timing) - FAIL_AHEAD;
        let latest = timing.speak_by(self.rounds[1]).map_or(latest, |by| latest.min(by));
        match self.on_disk {
            OnDisk::Nothing => {
                (latest - timing.recording()).max(timing.commit_from() + timing.pace.period).min(latest)
            }
            OnDisk::Asked | OnDisk::Commitment => latest,
        }
    }

    pub(super) const fn wakeup(&self) -> Timestamp<Server> {
        self.wakeup
    }

    fn round(&mut self, now: Timestamp<Server>, timing: &Timing) {
        self.rounds = [self.rounds[1], now];
        self.heard = 0;
        let next = timing.round_after(now);
        self.wakeup = if next < timing.critical() { next } else { timing.commit_from() };
    }
}

impl Commitment {
    pub(super) fn wakeup(&self) -> Timestamp<Server> {
        self.doubt.map_or(self.next_round, |at| at.min(self.next_round)).min(self.begun).min(self.room)
    }
}

impl Act {
    /// Performs the step that is due before the start: a round of questions, the record of the commitment, or the commitment itself.
    pub(super) fn approach(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        if self.present().next().is_none() {
            self.enter(PromisedStage::Deserted);
            return Vec::new();
        }
        if self.has_to_ask_late(now, robots) {
            return self.ask_late(now, robots);
        }
        let Stage::Promised(Promised { timing, stage: Approaching(approach) }) = &mut self.stage else {
            return Vec::new();
        };
        if approach.was_taken_up_too_late(timing) {
            return vec![ActAction::Withdraw(Outcome::CommitmentLate { by: now - timing.critical() })];
        }
        if now >= timing.commit_from() {
            return self.commit_if_all_hold(now, robots);
        }
        if now >= timing.critical() {
            approach.wakeup = timing.commit_from();
            return Vec::new();
        }
        if now >= approach.wakeup { self.round(now, robots) } else { Vec::new() }
    }

    fn round(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let mut actions = Vec::new();
        if self.may_be_recorded(now, robots) {
            actions.push(ActAction::Record(Record::Committed { number: self.number }));
        }
        let Stage::Promised(Promised { timing, stage: Approaching(approach) }) = &mut self.stage else {
            return actions;
        };
        if !actions.is_empty() {
            approach.on_disk = OnDisk::Asked;
        }
        approach.round(now, timing);
        actions.push(ActAction::Ask(self.present().map(|member| member.robot).collect()));
        actions
    }

    /// Whether another round of questions is needed and possible after the critical instant, because this process stalled during the last
    /// rounds.
    fn has_to_ask_late(&self, now: Timestamp<Server>, robots: &Robots) -> bool {
        let Stage::Promised(Promised { timing, stage: Approaching(approach) }) = &self.stage else {
            return false;
        };
        let since = approach.since(timing);
        approach.may_ask_late(now, timing)
            && self.present().any(|member| !member.holds_since(&robots[member.robot], since))
    }

    fn ask_late(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let actions = self.round(now, robots);
        if let Some(Approaching(approach)) = self.stage.promised_mut() {
            (approach.rounds, approach.late_round) = ([now, now], Some(now));
        }
        actions
    }

    /// Whether to write the record of the commitment now. It is written before the commitment can be sent, because the disk may be slow.
    fn may_be_recorded(&self, now: Timestamp<Server>, robots: &Robots) -> bool {
        let Stage::Promised(Promised { timing, stage: Approaching(approach) }) = &self.stage else {
            return false;
        };
        if approach.on_disk != OnDisk::Nothing || now < timing.record_from() {
            return false;
        }
        let since = approach.rounds[0];
        // Shortened leases end long before another process could read the record. Robots that are still missing may be left out, and the
        // others start.
        let shortened = timing.pace.leases == Leases::Shortened;
        shortened || self.present().all(|member| member.holds_since(&robots[member.robot], since))
    }

    /// Commits the act once all conditions hold, or gives it up in time. Called after the critical instant (the end of regular
    /// questions).
    fn commit_if_all_hold(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let Stage::Promised(Promised { timing, stage: Approaching(approach) }) = &mut self.stage else {
            return Vec::new();
        };
        let (since, commit_by, fail_by) =
            (approach.since(timing), approach.commit_by(timing), approach.fail_by(timing));
        let held_up = approach.was_held_up(timing).then(|| timing.critical());
        approach.wakeup = fail_by;
        // A member that has answered counts as such until a new question is asked. Each event checks only from the first member that has
        // not answered.
        let holds =
            |member: &super::Member| !member.takes_part() || member.holds_since(&robots[member.robot], since);
        let heard = self.members.iter().skip(approach.heard).take_while(|member| holds(member)).count();
        approach.heard += heard;
        let all = approach.heard == self.members.len();
        let on_disk = approach.on_disk;
        // If the commitment is too late, robots may have lost their scripts. A process that takes over the act must not find it
        // committed.
        if all && on_disk == OnDisk::Nothing && now <= commit_by {
            approach.on_disk = OnDisk::Asked;
            return vec![ActAction::Record(Record::Committed { number: self.number })];
        }
        let ready = all && on_disk == OnDisk::Commitment;
        if !ready && now < fail_by {
            return Vec::new();
        }
        let failing = self.not_committable(now, since, robots);
        if !failing.is_empty() {
            return vec![ActAction::Fail(failing)];
        }
        if !ready || now > commit_by {
            let by = (now - held_up.unwrap_or(commit_by)).max(Span::ZERO);
            return vec![ActAction::Withdraw(Outcome::CommitmentLate { by })];
        }
        self.commit(now)
    }

    /// Returns the members that prevent the commitment, each with its failure. They have not confirmed in time that they hold their
    /// scripts, or their clock was set since the decision.
    fn not_committable(
        &self,
        now: Timestamp<Server>,
        since: Timestamp<Server>,
        robots: &Robots,
    ) -> Vec<(RobotIndex, FailureKind)> {
        let blamed = match &self.stage {
            Stage::Promised(Promised { timing, stage: Approaching(approach) }) => {
                approach.blames_silence(now, timing)
            }
            _ => true,
        };
        let short = self.present().filter(|member| !member.holds_since(&robots[member.robot], since));
        let short = short.filter_map(|member| {
            let kind = match robots[member.robot].broken() {
                Some(reason) => FailureKind::LinkDown { reason: reason.to_owned() },
                None if blamed => {
                    let awaited = "final confirmation that it holds its scripts".to_owned();
                    FailureKind::Silent { awaited, within: now - since }
                }
                None => return None,
            };
            Some((member.robot, kind))
        });
        short.chain(self.strayed(now, robots)).collect()
    }

    fn commit(&mut self, now: Timestamp<Server>) -> Vec<ActAction> {
        let withdraws = self.written().on_doubt == OnDoubt::Withdraw;
        let Some(timing) = self.timing() else { return Vec::new() };
        let next_round = timing.out_of_quiet(now + timing.pace.period);
        let doubt = withdraws.then(|| timing.last_withdrawal());
        let told = Told::NotYet;
        let begun = timing.out_of_quiet(timing.begun());
        let room = timing.begins();
        let commitment = Commitment { next_round, since: now, begun, room, heard: 0, told, doubt };
        self.enter(Committed(commitment));
        vec![ActAction::Ask(self.present().map(|member| member.robot).collect())]
    }

    /// Handles a committed act until it plays: renews the leases beyond the start, and detects whether every robot has answered the
    /// commitment.
    pub(super) fn begin_if_due(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let doubtful = self.doubtful(now, robots);
        if !doubtful.is_empty() {
            return vec![ActAction::Fail(doubtful)];
        }
        let mut actions = self.note_answers(now, robots);
        let Stage::Promised(Promised { timing, stage: Committed(commitment) }) = &mut self.stage else {
            return actions;
        };
        let (due, begun) = (now >= commitment.next_round, now >= commitment.begun);
        if due {
            commitment.next_round = timing.out_of_quiet(now + timing.pace.period);
            actions.push(ActAction::Ask(self.present().map(|member| member.robot).collect()));
        }
        if begun {
            self.enter(PromisedStage::Playing(Playing::beginning(now)));
        } else {
            actions.extend(self.make_room(now, robots))
        }
        actions
    }

    /// Sends further scripts to robots whose clocks are ahead. Such a robot may have played a script, and need the next one, before the
    /// last robot has started.
    fn make_room(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        if !matches!(self.stage.promised(), Some(Committed(commitment)) if now >= commitment.room) {
            return Vec::new();
        }
        let actions = self.look_for_ends(now, robots);
        let next = self.next_watch(now, robots);
        if let Some(Committed(commitment)) = self.stage.promised_mut() {
            // Scripts are also sent in the quiet around the start, because a robot would refuse a later one as late.
            commitment.room = next;
        }
        actions
    }

    /// Returns the robots that have not answered the commitment in time to withdraw it, if the scenario requests a withdrawal in this
    /// case. It is unknown whether these robots will start.
    fn doubtful(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<(RobotIndex, FailureKind)> {
        let Stage::Promised(Promised { timing, stage: Committed(commitment) }) = &mut self.stage else {
            return Vec::new();
        };
        let due = commitment.doubt.take_if(|at| now >= *at).is_some();
        // If this process stalled until no withdrawal helps, it may not have read answers that have arrived. As in any other act that
        // plays, silence is judged after they are read.
        if !due || now >= timing.begins() {
            return Vec::new();
        }
        let (since, within) = (commitment.since, now - commitment.since);
        let silent = self.present().filter(|member| !has_answered(&robots[member.robot], since));
        let failure = |robot: RobotIndex| {
            let awaited = "confirmation of the start (`on_doubt` is `withdraw`)".to_owned();
            (robot, FailureKind::Silent { awaited, within })
        };
        silent.map(|member| failure(member.robot)).collect()
    }

    fn note_answers(&mut self, now: Timestamp<Server>, robots: &Robots) -> Vec<ActAction> {
        let Stage::Promised(Promised { timing, stage: Committed(commitment) }) = &mut self.stage else {
            return Vec::new();
        };
        let since = commitment.since;
        let answered =
            |member: &super::Member| !member.takes_part() || has_answered(&robots[member.robot], since);
        let heard = self.members.iter().skip(commitment.heard).take_while(|member| answered(member)).count();
        commitment.heard += heard;
        if commitment.heard < self.members.len() || commitment.told == Told::Window {
            return Vec::new();
        }
        commitment.told = Told::Window;
        timing.round = Some((since, now));
        let window = Some(now - since);
        vec![ActAction::Tell(Progress::Committed { act: self.name(), window })]
    }
}

/// Whether a robot has answered a question that was sent at `since` or later. Also true for a robot that has never answered a question.
fn has_answered(robot: &RobotState, since: Timestamp<Server>) -> bool {
    robot.contact.questions.answered().is_none_or(|at| at >= since)
}
