//! Limits how much a robot may send: the responses to requests that it has received, and a little more. A robot that sends more floods
//! its link.
//!
//! Each message to a robot permits a number of response messages and bytes. Anything else that the robot sends is taken from a reserve
//! that refills with time. Once the reserve is empty, the link is closed: a robot that sends endlessly costs the mission's time and
//! memory, and a working robot never does that.
//!
//! A robot that floods may still move, so the mission may open another link to stop it. On that link, only responses to requests sent
//! since the flooding are accepted. It closes after a short time.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use urrcp::{Command, LINE_BYTES_MAX, Message, RequestId, Server, Span, Timestamp};

use downbeat_mission::Loss;

/// Number of unrequested messages that a robot may send at once.
const RESERVE_MESSAGES: u64 = 1_000;
/// Number of bytes in unrequested messages that a robot may send at once.
const RESERVE_BYTES: u64 = 4 * 1024 * 1024;
/// Refill rate of the reserve, in messages per second.
const REFILL_MESSAGES: u64 = 100;
/// Refill rate of the reserve, in bytes per second.
const REFILL_BYTES: u64 = 64 * 1024;
/// Maximum number of responses to a control request: `Accepted`, `Started`, and `OK` or `Failed`.
const ANSWERS_TO_A_REQUEST: u64 = 3;
/// Maximum size of a response in bytes, without the request that it repeats: names, times, hash, reason.
const ANSWER_BYTES: u64 = 4 * 1024;
/// Maximum size of a script repeated in a response, as a multiple of its size when sent. The robot may repeat in JSON a script that it
/// received in the compact encoding.
const REPEATED: u64 = 8;
/// Maximum number of permitted responses that have not yet arrived. It suffices for three scripts on each of 32,000 devices, and more.
const ASKED_MESSAGES_MAX: u64 = 500_000;
/// Maximum total size, in bytes, of permitted responses that have not yet arrived.
const ASKED_BYTES_MAX: u64 = 1024 * 1024 * 1024;

/// How long a link to a robot that has flooded (sent more than permitted) is read, from the first received bytes.
const SIFTED_FOR: Span = Span::from_millis(2_000);

/// How much a robot may still send on all its links together. It is kept per robot, because responses to requests on a broken link arrive
/// on the next link. A robot that closes its link gets no new reserve.
#[derive(Clone, Debug, Default)]
pub(crate) struct SharedAllowance(Arc<Mutex<Allowance>>);

#[derive(Debug)]
struct Allowance {
    asked_for: Amount,
    reserve: Amount,
    /// When the reserve was last refilled. `None` until the first bytes arrive.
    filled: Option<Timestamp<Server>>,
    /// The responses that are still accepted from a robot that has flooded (sent more than permitted). `None` if the robot never flooded.
    sieve: Option<Sieve>,
}

/// The responses still permitted for a robot that has flooded (sent more than permitted). They belong to requests sent since then.
#[derive(Debug, Default)]
struct Sieve {
    /// Number of responses that may still arrive for each request.
    answers: HashMap<RequestId, u64>,
    /// Number of initialization blocks that may still arrive.
    descriptions: u64,
}

impl Sieve {
    fn note(&mut self, message: &Message) {
        match message {
            Message::InitializationRequest(_) => self.descriptions += 1,
            Message::ControlRequest(request) => {
                let id = request.request_id.clone();
                self.answers.extend(id.map(|id| (id, ANSWERS_TO_A_REQUEST)));
            }
            _ => {}
        }
    }

    fn passes(&mut self, message: &Message) -> bool {
        let left = match message {
            Message::InitializationBlock(_) => Some(&mut self.descriptions),
            Message::ControlResponse(response) => {
                response.request_id.as_ref().and_then(|id| self.answers.get_mut(id))
            }
            _ => None,
        };
        left.filter(|left| **left > 0).map(|left| *left -= 1).is_some()
    }
}

impl Default for Allowance {
    fn default() -> Self {
        let reserve = Amount { messages: RESERVE_MESSAGES, bytes: RESERVE_BYTES };
        Self { asked_for: Amount::default(), reserve, filled: None, sieve: None }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Amount {
    messages: u64,
    bytes: u64,
}

impl SharedAllowance {
    /// Notes a message of `bytes` bytes that is about to be written to the robot, and permits the responses to it.
    pub(crate) fn note(&self, message: &Message, bytes: usize) {
        if let Some(sieve) = &mut self.lock().sieve {
            return sieve.note(message);
        }
        let written = u64::try_from(bytes).unwrap_or(u64::MAX);
        let (messages, bytes) = match message {
            Message::InitializationRequest(_) => {
                let mut allowance = self.lock();
                // A robot that does not send its initialization block is asked repeatedly, but may send the block only once.
                let bytes = allowance.asked_for.bytes.max(LINE_BYTES_MAX as u64);
                allowance.asked_for.bytes = bytes;
                (1, 0)
            }
            Message::Inquiry(inquiry) => {
                let names = u64::try_from(inquiry.requests.len() + inquiry.devices.len()).unwrap_or(u64::MAX);
                (1, names.saturating_add(1).saturating_mul(ANSWER_BYTES))
            }
            Message::ControlRequest(request) => {
                let repeated = match request.command {
                    Command::ReadSensor => 0,
                    _ => written.saturating_mul(REPEATED),
                };
                (ANSWERS_TO_A_REQUEST, repeated.saturating_add(ANSWER_BYTES * ANSWERS_TO_A_REQUEST))
            }
            _ => (1, ANSWER_BYTES),
        };
        self.allow(messages, bytes);
    }

    /// Permits the responses to scripts that another process has sent to the robot. `scripts` is their number.
    pub(crate) fn note_held(&self, scripts: usize) {
        let messages = u64::try_from(scripts).unwrap_or(u64::MAX).saturating_mul(ANSWERS_TO_A_REQUEST);
        self.allow(messages, messages.saturating_mul(ANSWER_BYTES));
    }

    fn allow(&self, messages: u64, bytes: u64) {
        let Allowance { asked_for, .. } = &mut *self.lock();
        asked_for.messages = asked_for.messages.saturating_add(messages).min(ASKED_MESSAGES_MAX);
        asked_for.bytes = asked_for.bytes.saturating_add(bytes).min(ASKED_BYTES_MAX);
    }

    fn lock(&self) -> MutexGuard<'_, Allowance> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Allowance {
    /// Refills the reserve for the time since the last refill.
    fn fill(&mut self, now: Timestamp<Server>) {
        let filled = self.filled.get_or_insert(now);
        let passed = u64::try_from((now - *filled).max(Span::ZERO).as_nanos()).unwrap_or(0);
        let brought = |a_second: u64| {
            u64::try_from(u128::from(a_second) * u128::from(passed) / 1_000_000_000).unwrap_or(u64::MAX)
        };
        let messages = brought(REFILL_MESSAGES);
        // The reserve is refilled by whole messages, so that no rounding error accumulates.
        if messages > 0 {
            *filled = now;
            self.reserve.messages = self.reserve.messages.saturating_add(messages).min(RESERVE_MESSAGES);
            self.reserve.bytes = self.reserve.bytes.saturating_add(brought(REFILL_BYTES)).min(RESERVE_BYTES);
        }
    }
}

/// Counts the data received on one link against the robot's allowance.
#[derive(Debug)]
pub(crate) struct Budget {
    asked: SharedAllowance,
    came: Amount,
    hears: Hears,
}

/// Which messages are accepted on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Hears {
    /// All messages, as long as the robot stays within its allowance.
    All,
    /// Only responses to requests sent since the robot flooded (sent more than permitted). Contains when the first bytes arrived; `None`
    /// before that.
    Sifted(Option<Timestamp<Server>>),
}

impl Budget {
    /// Creates the budget of a new link. `asked` is the allowance of the link's robot.
    pub(crate) fn new(asked: SharedAllowance) -> Self {
        let hears = if asked.lock().sieve.is_some() { Hears::Sifted(None) } else { Hears::All };
        Self { asked, came: Amount::default(), hears }
    }

    /// Deducts received bytes from the budget.
    ///
    /// # Errors
    /// Returns [`Loss::Flooding`] if the robot sent more than requested. The link must then be closed.
    pub(crate) fn take_bytes(&mut self, now: Timestamp<Server>, bytes: usize) -> Result<(), Loss> {
        let bytes = u64::try_from(bytes).unwrap_or(u64::MAX);
        self.came.bytes = self.came.bytes.saturating_add(bytes);
        if let Hears::Sifted(since) = &mut self.hears {
            let since = *since.get_or_insert(now);
            return if now - since > SIFTED_FOR { Err(self.flooding()) } else { Ok(()) };
        }
        let mut allowance = self.asked.lock();
        allowance.fill(now);
        let Allowance { asked_for, reserve, sieve, .. } = &mut *allowance;
        take(&mut asked_for.bytes, &mut reserve.bytes, bytes).ok_or_else(|| {
            sieve.get_or_insert_default();
            self.flooding()
        })
    }

    /// Deducts one received message, valid or not, from the budget.
    ///
    /// # Errors
    /// Returns [`Loss::Flooding`] if the robot sent more than requested. The link must then be closed.
    pub(crate) fn take_message(&mut self) -> Result<(), Loss> {
        self.came.messages += 1;
        if self.is_sifted() {
            return Ok(());
        }
        let Allowance { asked_for, reserve, sieve, .. } = &mut *self.asked.lock();
        take(&mut asked_for.messages, &mut reserve.messages, 1).ok_or_else(|| {
            sieve.get_or_insert_default();
            self.flooding()
        })
    }

    /// Whether the robot has already flooded (sent more than permitted). If so, this link accepts only responses to later requests.
    pub(crate) const fn is_sifted(&self) -> bool {
        matches!(self.hears, Hears::Sifted(_))
    }

    /// Whether a message is accepted. On a link to a robot that has flooded, an accepted message uses up one permitted response.
    pub(crate) fn passes(&self, message: &Message) -> bool {
        match self.hears {
            Hears::All => true,
            Hears::Sifted(_) => self.asked.lock().sieve.as_mut().is_some_and(|sieve| sieve.passes(message)),
        }
    }

    const fn flooding(&self) -> Loss {
        Loss::Flooding { messages: self.came.messages, bytes: self.came.bytes }
    }
}

/// Deducts `came` bytes or messages from the permitted responses first, and the rest from the reserve. Returns `None` if the reserve is
/// too small.
fn take(asked_for: &mut u64, reserve: &mut u64, came: u64) -> Option<()> {
    let answers = came.min(*asked_for);
    *asked_for -= answers;
    *reserve = reserve.checked_sub(came - answers)?;
    Some(())
}

#[cfg(test)]
mod tests {
    use urrcp::{
        AvailabilityRequest, ControlError, ControlRequest, ControlResponse, ErrorCode, InitializationRequest,
        Inquiry, Script,
    };

    use super::*;

    fn at(millis: i64) -> Timestamp<Server> {
        Timestamp::from_nanos(millis * 1_000_000)
    }

    /// Returns how many messages of `bytes` bytes are accepted at one instant.
    fn taken(budget: &mut Budget, now: Timestamp<Server>, bytes: usize) -> u64 {
        let mut count = 0;
        while budget.take_bytes(now, bytes).and_then(|()| budget.take_message()).is_ok() {
            count += 1;
            assert!(count < 10_000_000, "without end");
        }
        count
    }

    fn request() -> Message {
        let command = Command::Script(Script::cancel());
        Message::ControlRequest(ControlRequest::immediate("d".parse().unwrap(), command))
    }

    #[test]
    fn unrequested_messages_use_a_reserve_that_refills() {
        let mut budget = Budget::new(SharedAllowance::default());
        assert_eq!(taken(&mut budget, at(0), 100), RESERVE_MESSAGES);
        assert_eq!(taken(&mut budget, at(500), 100), REFILL_MESSAGES / 2);
        assert_eq!(taken(&mut budget, at(3_600_000), 100), RESERVE_MESSAGES);
    }

    #[test]
    fn few_long_messages_also_cause_flooding() {
        let mut budget = Budget::new(SharedAllowance::default());
        assert_eq!(taken(&mut budget, at(0), 1024 * 1024), 4);
        let Err(Loss::Flooding { messages, bytes }) = budget.take_bytes(at(0), 1) else { panic!() };
        assert!(messages == 4 && bytes > RESERVE_BYTES, "{messages} {bytes}");
    }

    #[test]
    fn requests_allow_answers_on_later_links_and_reserve_is_per_robot() {
        let asked = SharedAllowance::default();
        (0..32_000).for_each(|_| asked.note(&request(), 100));
        let mut first = Budget::new(asked.clone());
        for _ in 0..3 * 32_000 + RESERVE_MESSAGES / 2 {
            assert!(first.take_bytes(at(0), 300).and_then(|()| first.take_message()).is_ok());
        }
        (0..32_000).for_each(|_| asked.note(&request(), 100));
        let mut second = Budget::new(asked);
        assert_eq!(taken(&mut second, at(1), 300), 3 * 32_000 + RESERVE_MESSAGES / 2);
    }

    #[test]
    fn repeated_description_requests_allow_only_one_maximum_length_line() {
        let asked = SharedAllowance::default();
        let question = Message::InitializationRequest(InitializationRequest::default());
        (0..10).for_each(|_| asked.note(&question, 30));
        let mut budget = Budget::new(asked);
        assert!(budget.take_bytes(at(0), LINE_BYTES_MAX).is_ok());
        assert!(budget.take_bytes(at(0), LINE_BYTES_MAX).is_err());
    }

    #[test]
    fn after_flooding_only_answers_to_new_requests_pass_and_only_briefly() {
        let asked = SharedAllowance::default();
        let mut first = Budget::new(asked.clone());
        assert!(!first.is_sifted());
        taken(&mut first, at(0), 100);
        let named = |id: &str| {
            let Message::ControlRequest(mut stop) = request() else { panic!() };
            stop.request_id = id.parse().ok();
            stop
        };
        let answer = |id: &str| {
            let now = Timestamp::from_nanos(0);
            Message::ControlResponse(ControlResponse::refusal(
                now,
                &named(id),
                ControlError::new(ErrorCode::Late, ""),
            ))
        };
        let mut second = Budget::new(asked.clone());
        assert!(second.is_sifted() && !second.passes(&answer("stop")));
        asked.note(&Message::ControlRequest(named("stop")), 100);
        let passed = (0..10).filter(|_| second.passes(&answer("stop"))).count();
        assert_eq!((passed, second.passes(&answer("noise"))), (3, false));
        for (millis, heard) in [(10, true), (2_010, true), (2_011, false)] {
            let taken = second.take_bytes(at(millis), 1_000_000).and_then(|()| second.take_message());
            assert_eq!(taken.is_ok(), heard, "{millis}");
        }
    }

    #[test]
    fn robot_that_answers_every_request_never_floods() {
        let asked = SharedAllowance::default();
        let mut budget = Budget::new(asked.clone());
        let names = vec!["request".parse().unwrap(); 100];
        for round in 0..100_000 {
            asked.note(&Message::AvailabilityRequest(AvailabilityRequest::default()), 80);
            asked.note(&Message::Inquiry(Inquiry { requests: names.clone(), ..Inquiry::default() }), 900);
            for bytes in [200, 100 * 400] {
                let answered = budget.take_bytes(at(round), bytes).and_then(|()| budget.take_message());
                assert!(answered.is_ok(), "{round}: {answered:?}");
            }
        }
    }

    #[test]
    fn robot_may_report_outcomes_of_scripts_sent_by_another_process() {
        let asked = SharedAllowance::default();
        asked.note_held(50);
        assert_eq!(taken(&mut Budget::new(asked), at(0), 100), RESERVE_MESSAGES + 50 * ANSWERS_TO_A_REQUEST);
    }

    #[test]
    fn allowed_answer_length_grows_with_number_of_inquired_requests() {
        let inquiry = Inquiry {
            requests: (0..9).map(|index| RequestId::new(format!("r{index}")).unwrap()).collect(),
            ..Inquiry::default()
        };
        let longest = usize::try_from(RESERVE_BYTES + 10 * ANSWER_BYTES).unwrap();
        for (bytes, taken) in [(longest, true), (longest + 1, false)] {
            let asked = SharedAllowance::default();
            asked.note(&Message::Inquiry(inquiry.clone()), 100);
            assert_eq!(Budget::new(asked).take_bytes(at(0), bytes).is_ok(), taken);
        }
    }

    #[test]
    fn robot_that_flooded_may_send_each_requested_description() {
        let asked = SharedAllowance::default();
        taken(&mut Budget::new(asked.clone()), at(0), 100);
        let budget = Budget::new(asked.clone());
        let block = r#"{"initialization_block": {"id": "r", "api_version": "1", "devices": [{"id": "a", "name": "a", "available_control_types": {}}]}}"#;
        let described: Message = serde_json::from_str(block).unwrap();
        let passed = |count: usize| (0..count).filter(|_| budget.passes(&described)).count();
        assert_eq!(passed(1), 0, "nobody asked");
        (0..2)
            .for_each(|_| asked.note(&Message::InitializationRequest(InitializationRequest::default()), 30));
        assert_eq!(passed(5), 2);
    }

    #[test]
    fn three_answers_per_request_may_repeat_it_unless_it_reads_a_sensor() {
        let sensor = ControlRequest::immediate("s".parse().unwrap(), Command::ReadSensor);
        for (message, repeated) in [(request(), 8 * 100), (Message::ControlRequest(sensor), 0)] {
            let longest = usize::try_from(RESERVE_BYTES + 3 * ANSWER_BYTES + repeated).unwrap();
            for (bytes, taken) in [(longest, true), (longest + 1, false)] {
                let asked = SharedAllowance::default();
                asked.note(&message, 100);
                assert_eq!(Budget::new(asked).take_bytes(at(0), bytes).is_ok(), taken, "{message:?}");
            }
        }
    }
}
