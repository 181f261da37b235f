//! An act from its decision to its start: rounds of questions make all leases end just before the start, and the commitment extends all
//! of them beyond it.
//!
//! Every round asks each robot whether it holds its scripts. At the critical instant the scheduler stops sending: its earlier messages
//! let no robot start. A moment later, one message lets any robot start. The scheduler sends it, the commitment, once every robot has
//! answered one of the last two rounds, every clock is right, and the commitment is on disk. If this does not happen in time, it never
//! sends it, and no robot starts. A scheduler that stalled during the last rounds asks again, if the leases can still end just before the
//! start.

use downbeat_plan::OnDoubt;
use urrcp::{Server, Span, Timestamp};

use super::timing::Leases;
use super::{Act, ActAction, Stage, Timing};
use crate::failure_kind::FailureKind;
use crate::record::Record;
use crate::robot_state::RobotState;
use crate::{Outcome, Progress};

/// A failure is noted this long before the last instant for the commitment, so that the other robots can still be committed.
const FAIL_AHEAD: Span = Span::from_millis(5);

/// State of the commitment record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OnDisk {
    Nothing,
    Asked,
    Commitment,
}

/// The approach of a decided act to its start, before its commitment.
#[derive(Clone, Debug)]
pub(crate) struct Approach {
    /// The time of the next round; after the critical instant, the time at which the mission gives up the act.
    wakeup: Timestamp<Server>,
    /// Sending times of the last two rounds, the newer one last.
    rounds: [Timestamp<Server>; 2],
    on_disk: OnDisk,
    /// The members before this index have answered one of the last two rounds.
    heard: usize,
    /// The time at which the robots were asked again after the critical instant, because this process had stalled during the last rounds.
    late_round: Option<Timestamp<Server>>,
    /// The time at which this process took over the act from the process that decided it; `None` if this process decided it.
    taken_up: Option<Timestamp<Server>>,
}

/// The commitment of an act that has not started on all robots.
#[derive(Clone, Debug)]
pub(crate) struct Commitment {
    next_round: Timestamp<Server>,
    since: Timestamp<Server>,
    /// The instant by which the last robot has started.
    begun: Timestamp<Server>,
    /// The next instant at which a robot may have played a script, and its device may have room for another one.
    room: Timestamp<Server>,
    /// The members before this index have answered since the commitment.
    heard: usize,
    told: Told,
    /// The time at which the mission checks for missing answers to the commitment, as late as a withdrawal permits. `None` if the others
    /// start in any case, or after the check.
    doubt: Option<Timestamp<Server>>,
}

/// Whether the operator was informed how long the commitment took.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Told {
    NotYet,
    Window,
}

impl Approach {
    /// The approach after a new decision. The first round is sent at once.
    pub(super) const fn beginning(now: Timestamp<Server>) -> Self {
        let (rounds, on_disk) = ([now, now], OnDisk::Nothing);
        Self { wakeup: now, rounds, on_disk, heard: 0, late_round: None, taken_up: None }
    }

    /// The approach of an act that another process has decided. This process may be too late to ask the robots.
    pub(super) const fn taken_up(now: Timestamp<Server>) -> Self {
        Self { taken_up: Some(now), ..Self::beginning(now) }
    }

    /// Whether a robot that has not confirmed that it holds its scripts has failed. If this process itself is late, the confirmation may
    /// be unread, or the robot was not asked in time.
    fn blames_silence(&self, now: Timestamp<Server>, timing: &Timing) -> bool {
        let in_time = now <= self.commit_by(timing) && !self.was_held_up(timing);
        in_time && self.taken_up.is_none_or(|at| now - at >= timing.lead.lease)
    }

    /// Every robot must have answered a question that was sent at this time or later: one of the last two rounds, but none before the
    /// limit that was printed for silence.
    fn since(&self, timing: &Timing) -> Timestamp<Server> {
        self.rounds[0].max(timing.doubtful_from())
    }

    /// Whether this process stalled during the last rounds.
    fn was_held_up(&self, timing: &Timing) -> bool {
        self.late_round.is_some() || self.rounds[0] < timing.doubtful_from()
    }

    /// Whether a process that stalled during the last rounds may ask again, with leases that still end at the brink.
    fn may_ask_late(&self, now: Timestamp<Server>, timing: &Timing) -> bool {
        self.late_round.is_none()
            && self.was_held_up(timing)
            && now >= timing.critical()
            && now < self.commit_by(timing) - FAIL_AHEAD
            && timing.lets_through(now)
    }

    /// Whether the robots are asked again, after a stall of this process, at the instant `now`.
    pub(super) fn asks_late(&self, now: Timestamp<Server>) -> bool {
        self.late_round == Some(now)
    }

    /// Whether this process took over the act after the last instant at which it may ask robots, so that no robot can answer. This
    /// process would send nothing until the commitment is too late, and the leases of acts that play would end.
    fn was_taken_up_too_late(&self, timing: &Timing) -> bool {
        self.on_disk == OnDisk::Nothing && self.taken_up.is_some_and(|at| at >= timing.critical())
    }

    pub(super) const fn recorded(&mut self) {
        self.on_disk = OnDisk::Commitment;
    }

    fn commit_by(&self, timing: &Timing) -> Timestamp<Server> {
        timing.commit_by(self.rounds[1])
    }

    /// The instant by which robots must have answered; others have failed. It leaves enough time to commit the other robots: for the
    /// record and the commitment itself.
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
    /// Performs the next step of the approach that is due: a round of questions, the record of the commitment, or the commitment itself.
    pub(super) fn approach(&mut self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<ActAction> {
        if self.present().next().is_none() {
            self.stage = Stage::Deserted;
            return Vec::new();
        }
        if self.has_to_ask_late(now, robots) {
            return self.ask_late(now, robots);
        }
        let (Stage::Approaching(approach), Some(timing)) = (&mut self.stage, &self.timing) else {
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

    fn round(&mut self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<ActAction> {
        let mut actions = Vec::new();
        if self.may_be_recorded(now, robots) {
            actions.push(ActAction::Record(Record::Committed { number: self.number }));
        }
        let (Stage::Approaching(approach), Some(timing)) = (&mut self.stage, &self.timing) else {
            return actions;
        };
        if !actions.is_empty() {
            approach.on_disk = OnDisk::Asked;
        }
        approach.round(now, timing);
        actions.push(ActAction::Ask(self.present().map(|member| member.robot).collect()));
        actions
    }

    /// Whether one more round is needed and possible after the critical instant, because this process stalled during the last rounds.
    fn has_to_ask_late(&self, now: Timestamp<Server>, robots: &[RobotState]) -> bool {
        let (Stage::Approaching(approach), Some(timing)) = (&self.stage, &self.timing) else { return false };
        let since = approach.since(timing);
        approach.may_ask_late(now, timing)
            && self.present().any(|member| !member.holds_since(&robots[member.robot], since))
    }

    fn ask_late(&mut self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<ActAction> {
        let actions = self.round(now, robots);
        if let Stage::Approaching(approach) = &mut self.stage {
            (approach.rounds, approach.late_round) = ([now, now], Some(now));
        }
        actions
    }

    /// Whether to write the commitment now. It is written ahead of time, because the disk may be slow.
    fn may_be_recorded(&self, now: Timestamp<Server>, robots: &[RobotState]) -> bool {
        let (Stage::Approaching(approach), Some(timing)) = (&self.stage, &self.timing) else { return false };
        if approach.on_disk != OnDisk::Nothing || now < timing.record_from() {
            return false;
        }
        let since = approach.rounds[0];
        // Shortened leases end long before another process could read the record. Robots that are still missing may be left out, and the
        // others start.
        let shortened = timing.pace.leases == Leases::Shortened;
        shortened || self.present().all(|member| member.holds_since(&robots[member.robot], since))
    }

    /// After the critical instant: commits once all conditions hold, or gives up in time.
    fn commit_if_all_hold(&mut self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<ActAction> {
        let (Stage::Approaching(approach), Some(timing)) = (&mut self.stage, &self.timing) else {
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
        let heard = self.members[approach.heard..].iter().take_while(|member| holds(member)).count();
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

    /// Members that have not confirmed in time that they hold their scripts, and those whose clock was set since the decision.
    fn not_committable(
        &self,
        now: Timestamp<Server>,
        since: Timestamp<Server>,
        robots: &[RobotState],
    ) -> Vec<(usize, FailureKind)> {
        let blamed = match (&self.stage, &self.timing) {
            (Stage::Approaching(approach), Some(timing)) => approach.blames_silence(now, timing),
            _ => true,
        };
        let short = self.present().filter(|member| !member.holds_since(&robots[member.robot], since));
        let short = short.filter_map(|member| {
            let kind = match robots[member.robot].broken() {
                Some(reason) => FailureKind::LinkDown { reason: reason.to_owned() },
                None if blamed => {
                    let awaited =
                        "confirmation shortly before the start that it holds its scripts".to_owned();
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
        let Some(timing) = &self.timing else { return Vec::new() };
        let next_round = timing.out_of_quiet(now + timing.pace.period);
        let doubt = withdraws.then(|| timing.last_withdrawal());
        let told = Told::NotYet;
        let begun = timing.out_of_quiet(timing.begun());
        let room = timing.begins();
        self.stage =
            Stage::Committed(Commitment { next_round, since: now, begun, room, heard: 0, told, doubt });
        vec![ActAction::Ask(self.present().map(|member| member.robot).collect())]
    }

    /// Keeps the leases extended beyond the start, and detects whether the commitment has reached every robot.
    pub(super) fn begin_if_due(&mut self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<ActAction> {
        let doubtful = self.doubtful(now, robots);
        if !doubtful.is_empty() {
            return vec![ActAction::Fail(doubtful)];
        }
        let mut actions = self.note_answers(now, robots);
        let (Stage::Committed(commitment), Some(timing)) = (&mut self.stage, &self.timing) else {
            return actions;
        };
        let (due, begun) = (now >= commitment.next_round, now >= commitment.begun);
        if due {
            commitment.next_round = timing.out_of_quiet(now + timing.pace.period);
            actions.push(ActAction::Ask(self.present().map(|member| member.robot).collect()));
        }
        if begun {
            self.begin(now)
        } else {
            actions.extend(self.make_room(now, robots))
        }
        actions
    }

    /// Sends further scripts to robots whose clocks are ahead: they may have played a script and need the next one before the last robot
    /// has started.
    fn make_room(&mut self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<ActAction> {
        if !matches!(&self.stage, Stage::Committed(commitment) if now >= commitment.room) {
            return Vec::new();
        }
        let actions = self.look_for_ends(now, robots);
        let next = self.next_watch(now, robots);
        if let Stage::Committed(commitment) = &mut self.stage {
            // Scripts are also sent in the quiet around the start, because a robot would refuse a later one as late.
            commitment.room = next;
        }
        actions
    }

    /// Robots that have not answered the commitment while it can still be withdrawn, if the scenario requests a withdrawal. It is unknown
    /// whether they will start.
    fn doubtful(&mut self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<(usize, FailureKind)> {
        let (Stage::Committed(commitment), Some(timing)) = (&mut self.stage, &self.timing) else {
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
        let failure = |robot: usize| {
            let awaited = "confirmation of the start (`on_doubt` is `withdraw`)".to_owned();
            (robot, FailureKind::Silent { awaited, within })
        };
        silent.map(|member| failure(member.robot)).collect()
    }

    fn note_answers(&mut self, now: Timestamp<Server>, robots: &[RobotState]) -> Vec<ActAction> {
        let (Stage::Committed(commitment), Some(timing)) = (&mut self.stage, &mut self.timing) else {
            return Vec::new();
        };
        let since = commitment.since;
        let answered =
            |member: &super::Member| !member.takes_part() || has_answered(&robots[member.robot], since);
        let heard = self.members[commitment.heard..].iter().take_while(|member| answered(member)).count();
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
    robot.questions.answered().is_none_or(|at| at >= since)
}
