//! One script of one device and its state: planned, sent, held, running, ended, or unknown.

mod invariants;

use downbeat_plan::DeviceScript;
use urrcp::{
    Command, ContentHash, ControlError, ControlResponse, ErrorCode, Interpolation, Millis, RequestId,
    RequestReport, RequestState, Robot, Server, Span, Status, Timestamp,
};

use super::claim::{Claim, Told};
use super::{ActNumber, MemberIndex};

/// Identifies one script of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct ScriptRef {
    /// The number of the script's act in the mission.
    pub(crate) act: ActNumber,
    /// Index of the robot among the robots (members) of the act.
    pub(crate) member: MemberIndex,
    /// Index of the script among the scripts of that member.
    pub(crate) script: usize,
}

/// State of a script, as far as the scheduler knows it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ScriptState {
    /// The script was not sent.
    Planned,
    /// The request of the script was sent; the robot has not answered.
    Sent,
    /// The robot holds the script; its start is in the future.
    Held,
    /// The script has begun.
    Running,
    /// The robot has reported the end of the script.
    Ended(Ending),
    /// The script was sent, its time has passed, and no message reported its fate.
    Unknown,
}

/// How a script ended: completed or failed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Ending {
    /// All steps of the script were executed.
    Completed,
    /// The script was refused or ended early.
    Failed(ControlError),
    /// The robot made an impossible statement about the script. All further statements about it are ignored.
    Discredited(ControlError),
}

/// What the robot has stated about its acceptance of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Acceptance {
    None,
    /// The script began or ended, so the robot had accepted it.
    Implied,
    /// The time of the first report that the robot holds the script, by the robot's clock.
    At(Timestamp<Robot>),
}

/// What the robot has stated about the start of a script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Start {
    None,
    /// The script has begun, but no credible report states when.
    Unknown,
    At(Timestamp<Robot>),
}

impl Acceptance {
    const fn implied(self) -> Self {
        match self {
            Self::None => Self::Implied,
            Self::Implied | Self::At(_) => self,
        }
    }
}

impl Start {
    /// The start according to a further report, which may state its time.
    fn or(self, at: Option<Timestamp<Robot>>) -> Self {
        match self {
            Self::None | Self::Unknown => at.map_or(self, Self::At),
            Self::At(_) => self,
        }
    }
}

/// The clock offset with which a script is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shift {
    /// The offset of the act.
    OfAct,
    Own(Span),
    /// Another process may have sent the script with an offset that is missing in the journal. Contains the assumed offset, if it differs
    /// from the one of the act.
    Lost(Option<Span>),
}

/// The times at which a script's request was sent, or is assumed to have been sent.
#[derive(Clone, Copy, Debug)]
struct Sent {
    first: Timestamp<Server>,
    last: Timestamp<Server>,
    by: Sender,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sender {
    ThisProcess,
    /// It is assumed that a process that has died sent the request.
    Another,
}

/// The steps of a script that its robot has reported.
#[derive(Clone, Copy, Debug, Default)]
struct Steps {
    done: u32,
    late: u32,
    /// The largest lateness of a step.
    late_max: Option<Span>,
}

impl Steps {
    /// Adds a report, which may be older than an earlier one.
    fn count(&mut self, done: Option<u32>, late: Option<u32>, late_max: Option<Millis>) {
        self.done = self.done.max(done.unwrap_or(0));
        self.late = self.late.max(late.unwrap_or(0));
        self.late_max = self.late_max.max(late_max.map(Millis::span));
    }
}

/// The new information about a script in an answer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum News {
    None,
    /// The robot holds the script.
    Accepted,
    /// The script has begun.
    Started,
    /// The script has completed.
    Completed,
    /// The script was refused, lost or ended early.
    Failed(ControlError),
    /// The robot never received the script.
    NeverReceived,
    /// The robot's statement about the script is impossible.
    Discredited,
    /// The fate of the script can no longer be learned.
    Lapsed,
}

/// A script with its plan and its state.
#[derive(Clone, Debug)]
pub(crate) struct Script {
    pub(crate) plan: DeviceScript,
    state: ScriptState,
    request_id: Option<RequestId>,
    /// The id of the script's first request, which is in the journal.
    promised_id: Option<RequestId>,
    /// The number of times that the robot had no room for the script.
    refusals: u32,
    content_hash: ContentHash,
    shift: Shift,
    /// The planned time from the start of the act until the script begins to move its device.
    starts: Span,
    duration: Span,
    running: RunningLeases,
    acceptance: Acceptance,
    start: Start,
    steps: Steps,
    /// The latest report of executed steps, with its time by the robot's clock.
    steps_said: Option<(Timestamp<Robot>, u32)>,
    /// The sending time of the latest question to which the robot answered that it holds the script.
    held_at: Option<Timestamp<Server>>,
    /// The sending time of the newest inquiry whose answer reports on the script.
    reported_at: Option<Timestamp<Server>>,
    /// `None` if the script was not sent, as far as known.
    sent: Option<Sent>,
    /// Whether another process may have sent the script before this process took over, even if its robot has not reported on it.
    perhaps_sent: bool,
    /// Whether the robot no longer knows the script, although it had accepted it.
    lost: bool,
}

impl Script {
    /// A script for a device with this interpolation.
    pub(crate) fn new(plan: &DeviceScript, interpolation: Interpolation) -> Self {
        Self {
            starts: plan.start.span() + plan.script.until_started(interpolation),
            content_hash: Command::Script(plan.script.clone()).content_hash(),
            duration: plan.script.duration(),
            running: RunningLeases::of(plan),
            plan: plan.clone(),
            state: ScriptState::Planned,
            request_id: None,
            promised_id: None,
            refusals: 0,
            shift: Shift::OfAct,
            acceptance: Acceptance::None,
            start: Start::None,
            steps: Steps::default(),
            steps_said: None,
            held_at: None,
            reported_at: None,
            sent: None,
            perhaps_sent: false,
            lost: false,
        }
    }

    pub(crate) const fn state(&self) -> &ScriptState {
        &self.state
    }

    pub(crate) const fn request_id(&self) -> Option<&RequestId> {
        self.request_id.as_ref()
    }

    /// The id of the script's first request, which is in the journal.
    pub(crate) const fn promised_id(&self) -> Option<&RequestId> {
        self.promised_id.as_ref()
    }

    pub(crate) const fn content_hash(&self) -> ContentHash {
        self.content_hash
    }

    pub(super) const fn translate(&mut self, shift: Span) {
        self.shift = Shift::Own(shift);
    }

    pub(super) const fn lose_shift(&mut self) {
        self.shift = Shift::Lost(self.shift());
    }

    /// Whether the script's planned start by its robot's clock is known only to within the drift of that clock.
    pub(super) const fn shift_is_lost(&self) -> bool {
        matches!(self.shift, Shift::Lost(_))
    }

    /// The offset added to the timestamp of the script's request; `None` if it is the offset of the act.
    pub(super) const fn shift(&self) -> Option<Span> {
        match self.shift {
            Shift::OfAct => None,
            Shift::Own(shift) => Some(shift),
            Shift::Lost(shift) => shift,
        }
    }

    /// The time at which the script's request was sent for the first time.
    pub(crate) fn first_sent_at(&self) -> Option<Timestamp<Server>> {
        self.sent.map(|sent| sent.first)
    }

    /// Whether the script's request was sent more than once, as far as known.
    pub(crate) fn came_again(&self) -> bool {
        self.perhaps_sent || self.sent.is_some_and(|sent| sent.first != sent.last)
    }

    /// The planned time from the start of the act until the script begins to move its device. A device that moves linearly does so when
    /// the script begins; a device that holds its value does so at the first step.
    pub(crate) const fn starts(&self) -> Span {
        self.starts
    }

    /// Time from the start of the script to its last step.
    pub(crate) const fn duration(&self) -> Span {
        self.duration
    }

    /// The shortest lease under which the script plays; `None` if it always plays without a lease.
    pub(crate) const fn shortest_lease(&self) -> Option<Span> {
        self.running.shortest
    }

    /// The longest lease under which the script plays; `None` if it plays without a lease at times.
    pub(crate) const fn longest_lease(&self) -> Option<Span> {
        self.running.longest
    }

    pub(crate) const fn is_lost(&self) -> bool {
        self.lost
    }

    pub(crate) const fn was_accepted(&self) -> bool {
        !matches!(self.acceptance, Acceptance::None)
    }

    pub(crate) const fn started_at(&self) -> Option<Timestamp<Robot>> {
        match self.start {
            Start::At(at) => Some(at),
            Start::None | Start::Unknown => None,
        }
    }

    pub(crate) const fn steps_done(&self) -> u32 {
        self.steps.done
    }

    pub(crate) const fn late_steps(&self) -> u32 {
        self.steps.late
    }

    /// The largest lateness of a step of the script, if the robot reports it.
    pub(crate) fn late_max(&self) -> Option<Span> {
        self.steps.late_max.filter(|_| self.steps.late > 0)
    }

    /// The time of the first report that the robot holds the script, by the robot's clock.
    pub(crate) const fn accepted_at(&self) -> Option<Timestamp<Robot>> {
        match self.acceptance {
            Acceptance::At(at) => Some(at),
            Acceptance::None | Acceptance::Implied => None,
        }
    }

    /// The sending time of the latest question to which the robot answered that it holds the script.
    pub(crate) const fn held_at(&self) -> Option<Timestamp<Server>> {
        self.held_at
    }

    pub(crate) const fn reported_at(&self) -> Option<Timestamp<Server>> {
        self.reported_at
    }

    pub(crate) const fn is_planned(&self) -> bool {
        matches!(self.state, ScriptState::Planned)
    }

    /// Whether the script was sent and has not ended, as far as known: the robot has it or may have it.
    pub(crate) const fn is_out(&self) -> bool {
        matches!(self.state, ScriptState::Sent | ScriptState::Held | ScriptState::Running)
    }

    /// Whether the script was sent, perhaps by another process, and no message reported its fate.
    pub(crate) const fn is_unaccounted(&self) -> bool {
        self.is_out()
            || matches!(self.state, ScriptState::Unknown)
            || (self.is_planned() && self.perhaps_sent)
    }

    /// Whether another process may have sent the script, and its robot has not reported on it to this process.
    pub(crate) const fn is_unheard_since_taken_up(&self) -> bool {
        self.perhaps_sent
            && !self.was_accepted()
            && matches!(self.state, ScriptState::Planned | ScriptState::Sent | ScriptState::Unknown)
    }

    /// Whether the robot may have played the script, although it refuses it as too late. Another process may have sent the script in
    /// time, and the robot may have forgotten it since.
    pub(super) fn may_have_been_played(&self, response: &ControlResponse) -> bool {
        let late = || error_of(response).code == ErrorCode::Late;
        let untold = matches!(self.state, ScriptState::Sent | ScriptState::Unknown);
        self.perhaps_sent && untold && response.status == Status::Failed && late()
    }

    /// Whether the robot refused the script, ended it early, or made an impossible statement about it.
    pub(crate) const fn has_failed(&self) -> bool {
        matches!(self.state, ScriptState::Ended(Ending::Failed(_) | Ending::Discredited(_)))
    }

    const fn is_discredited(&self) -> bool {
        matches!(self.state, ScriptState::Ended(Ending::Discredited(_)))
    }

    pub(crate) const fn has_completed(&self) -> bool {
        matches!(self.state, ScriptState::Ended(Ending::Completed))
    }

    /// Whether the robot has reported that the script began.
    pub(crate) const fn has_begun(&self) -> bool {
        self.has_started() || matches!(self.state, ScriptState::Running)
    }

    /// Whether the robot has reported that the script moved its device.
    pub(crate) const fn has_started(&self) -> bool {
        !matches!(self.start, Start::None) || self.steps.done > 0 || self.has_completed()
    }

    pub(super) fn name(&mut self, id: Option<RequestId>) {
        self.request_id.clone_from(&id);
        self.promised_id = id;
    }

    /// Whether an answer contains an earlier id of the script. The robot has refused that id permanently, and refuses a duplicate request
    /// again.
    pub(super) fn had_another_name(&self, response: &ControlResponse) -> bool {
        response.request_id.is_some() && response.request_id != self.request_id
    }

    /// Notes that this process takes over from another one, which may have sent the script.
    pub(super) const fn taken_up(&mut self) {
        self.perhaps_sent = true;
    }

    pub(super) fn sent(&mut self, now: Timestamp<Server>) {
        self.is_sent(now, Sender::ThisProcess);
    }

    /// Treats the script as sent, because another process may have sent it.
    pub(super) fn assume_sent(&mut self, now: Timestamp<Server>) {
        self.is_sent(now, self.sent.map_or(Sender::Another, |sent| sent.by));
    }

    fn is_sent(&mut self, now: Timestamp<Server>, by: Sender) {
        self.state = ScriptState::Sent;
        self.sent = Some(Sent { first: self.first_sent_at().unwrap_or(now), last: now, by });
    }

    /// Whether the robot owes this process an answer to the script's request. Answers to another process went to that process.
    pub(super) const fn awaits_answer(&self) -> bool {
        matches!((&self.state, self.sent), (ScriptState::Sent, Some(Sent { by: Sender::ThisProcess, .. })))
    }

    /// Whether the script was sent, or another process may have sent it.
    pub(crate) const fn was_ever_sent(&self) -> bool {
        self.sent.is_some() || self.perhaps_sent
    }

    /// Whether the script was sent for the first time at or after an instant.
    pub(super) fn was_sent_since(&self, since: Timestamp<Server>) -> bool {
        self.sent.is_some_and(|sent| sent.first >= since)
    }

    /// Marks the fate of the script as unknown: its time has passed on a robot that does not report. The script is considered ended.
    pub(super) fn lapse(&mut self) {
        if self.is_out() {
            self.state = ScriptState::Unknown;
        }
    }

    /// Handles a refusal because the device's queue was still full. The script is sent again with another id, because the robot remembers
    /// its answer to the first id. A process that died may have used that other id, too.
    pub(super) fn refused_for_now(&mut self) {
        self.state = ScriptState::Planned;
        self.refusals += 1;
        let again = self.promised_id.as_ref().map(|id| RequestId::new(format!("{id}+{}", self.refusals)));
        self.request_id = again.and_then(Result::ok);
    }

    /// The number of planned steps of the script.
    pub(crate) fn steps_planned(&self) -> u32 {
        u32::try_from(self.plan.script.steps().len()).unwrap_or(u32::MAX)
    }

    /// The latest report of executed steps, with its time by the robot's clock.
    pub(crate) const fn steps_said(&self) -> Option<(Timestamp<Robot>, u32)> {
        self.steps_said
    }

    /// Notes a plausible number of executed steps that the robot reported.
    pub(super) fn said(&mut self, told: &Told) {
        self.steps_said = self.steps_said.max(told.steps());
    }

    /// Notes an impossible statement of the robot. All further statements about the script are ignored. Its start becomes unknown,
    /// because either of two contradictory statements may be true.
    pub(super) fn discredit(&mut self, claim: &Claim, told: &Told) {
        if self.start == Start::None && told.says_that_it_moved() {
            self.start = Start::Unknown;
        }
        if !self.is_final() {
            if self.start != Start::None {
                self.start = Start::Unknown;
            }
            let error = ControlError::new(ErrorCode::Internal, claim.to_string());
            self.state = ScriptState::Ended(Ending::Discredited(error));
        }
    }

    pub(crate) const fn is_final(&self) -> bool {
        matches!(self.state, ScriptState::Ended(_))
    }

    /// Processes a response about the script. Responses may arrive in any order.
    pub(super) fn answered(&mut self, response: &ControlResponse) -> News {
        if self.is_discredited() {
            return News::None;
        }
        self.steps.count(response.steps_done, response.late_steps, response.late_ms_max);
        match &response.status {
            Status::Accepted => match response.content_hash.filter(|hash| *hash != self.content_hash) {
                Some(_) => self.fail(foreign()),
                None => self.accept(response.timestamp),
            },
            Status::Started => self.begin(response.event_timestamp.or(Some(response.timestamp))),
            Status::Ok => self.complete(response.steps_done),
            Status::Failed => self.fail(error_of(response)),
            Status::Provide | Status::Other(_) => News::None,
        }
    }

    /// Processes a robot's report about the script. The robot sent it at `said_at`, in answer to the question that was sent at
    /// `asked_at`.
    pub(super) fn reported(
        &mut self,
        report: &RequestReport,
        asked_at: Timestamp<Server>,
        said_at: Timestamp<Robot>,
    ) -> News {
        self.reported_at = self.reported_at.max(Some(asked_at));
        if self.is_discredited() {
            return News::None;
        }
        self.steps.count(report.steps_done, report.late_steps, report.late_ms_max);
        let foreign_content = report.content_hash.is_some_and(|hash| hash != self.content_hash);
        match report.state {
            RequestState::Held | RequestState::Running if foreign_content => self.fail(foreign()),
            RequestState::Held => {
                self.held_at = self.held_at.max(Some(asked_at));
                self.accept(said_at)
            }
            RequestState::Running => self.begin(report.event_timestamp),
            RequestState::Ended => {
                self.start = self.start.or(report.event_timestamp);
                match &report.error {
                    None => self.complete(report.steps_done),
                    Some(error) => self.fail(error.clone()),
                }
            }
            RequestState::Unknown => self.unknown_to_the_robot(asked_at, said_at),
        }
    }

    /// Handles a request that the robot does not know: the request never arrived, or the script is lost. An answer that the robot sent
    /// before the request arrived is ignored. So is the answer to a question sent at the same instant, because the question may have
    /// overtaken the request.
    fn unknown_to_the_robot(&mut self, asked_at: Timestamp<Server>, said_at: Timestamp<Robot>) -> News {
        match self.state {
            ScriptState::Sent if self.sent.is_none_or(|sent| sent.last < asked_at) => News::NeverReceived,
            ScriptState::Held | ScriptState::Running | ScriptState::Unknown
                if self.accepted_at().is_none_or(|at| at < said_at) =>
            {
                self.lose()
            }
            _ => News::None,
        }
    }

    /// Notes that the robot no longer knows the script. It is unknown how much of it the robot played.
    pub(super) fn lose(&mut self) -> News {
        self.state = ScriptState::Unknown;
        self.lost |= self.was_accepted() || self.perhaps_sent;
        let message = if self.was_accepted() {
            "the robot has lost the script, for example because it restarted"
        } else {
            "the robot does not have the script, and the script's start has passed"
        };
        News::Failed(ControlError::new(ErrorCode::Internal, message))
    }

    fn accept(&mut self, said_at: Timestamp<Robot>) -> News {
        self.acceptance = Acceptance::At(self.accepted_at().unwrap_or(said_at));
        match self.state {
            ScriptState::Sent | ScriptState::Planned => {
                self.state = ScriptState::Held;
                News::Accepted
            }
            _ => News::None,
        }
    }

    /// Notes that the script has begun. `started_at` is the time at which it began to move its device; `None` if it has not done so yet.
    fn begin(&mut self, started_at: Option<Timestamp<Robot>>) -> News {
        self.acceptance = self.acceptance.implied();
        let starts = self.started_at().is_none() && started_at.is_some();
        self.start = self.start.or(started_at);
        if !self.is_final() {
            self.state = ScriptState::Running;
        }
        if starts { News::Started } else { News::None }
    }

    fn complete(&mut self, steps_done: Option<u32>) -> News {
        if self.is_final() {
            return News::None;
        }
        self.acceptance = self.acceptance.implied();
        self.steps.done = self.steps.done.max(steps_done.unwrap_or(self.steps_planned()));
        self.state = ScriptState::Ended(Ending::Completed);
        News::Completed
    }

    /// Notes that the script has failed, and that it is unknown whether it had begun.
    pub(super) fn failed_untold(&mut self, error: ControlError) -> News {
        match std::mem::replace(&mut self.state, ScriptState::Unknown) {
            ScriptState::Unknown => News::None,
            _ => News::Failed(error),
        }
    }

    fn fail(&mut self, error: ControlError) -> News {
        if self.is_final() {
            return News::None;
        }
        self.state = ScriptState::Ended(Ending::Failed(error.clone()));
        News::Failed(error)
    }
}

/// The id under which the journal promises a script that was sent with the id `request_id`. The two differ if the robot initially had no
/// room for the script.
#[must_use]
pub fn promised_name(request_id: &str) -> &str {
    match request_id.rsplit_once('+') {
        Some((promised, refusals)) if refusals.parse::<u32>().is_ok() => promised,
        _ => request_id,
    }
}

/// The error for a robot that accepted a different script from the one that was sent. The robot's hash of the accepted script must equal
/// the scheduler's hash.
fn foreign() -> ControlError {
    let message = "the robot accepted a different script than the one sent (content_hash differs)";
    ControlError::new(ErrorCode::Malformed, message)
}

/// The leases under which a script plays: the lease of the request until the first step, then the lease of each step.
#[derive(Clone, Copy, Debug)]
struct RunningLeases {
    shortest: Option<Span>,
    longest: Option<Span>,
}

impl RunningLeases {
    fn of(plan: &DeviceScript) -> Self {
        let whole = plan.stop_condition;
        let steps = plan.script.steps();
        let at_once = steps.first().is_some_and(|step| step.offset.span() == Span::ZERO);
        let before = (!at_once).then_some(whole.running);
        let of_steps = steps.iter().map(|step| step.stop_condition.unwrap_or(whole).running);
        let mut shortest: Option<Span> = None;
        let mut longest = Some(Span::ZERO);
        for lease in before.into_iter().chain(of_steps) {
            let lease = lease.map(Millis::span);
            shortest = shortest.into_iter().chain(lease).min();
            longest = longest.zip(lease).map(|(longest, lease)| longest.max(lease));
        }
        Self { shortest, longest }
    }
}

/// The reason in a failed response, or a default error if the robot gave none.
pub(crate) fn error_of(response: &ControlResponse) -> ControlError {
    let without = || ControlError::new(ErrorCode::Internal, "the robot gave no reason");
    response.error.clone().unwrap_or_else(without)
}

#[cfg(test)]
mod tests;
