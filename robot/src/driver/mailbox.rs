//! What is still to be set, between the precise thread and a driver's own.
//!
//! For each signal of each device at most one value waits, and one movement that begins behind it: newer ones take their
//! place. Putting a value in never waits for the driver.
#![expect(clippy::disallowed_methods, reason = "waits until the next sample or ping is due")]

use std::collections::hash_map::Entry;
use std::collections::{HashMap, VecDeque};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use urrcp::{ControlType, DeviceId, Robot, Setpoint};

use super::PlanWord;
use super::pulse::{Demand, Pulse, QUIET};
use crate::clock::HostClock;
use crate::confirmation::Ticket;
use crate::hardware::{READINGS_MAX, ReadingId, STALE};
use crate::plans::{PlanCancel, PlanPart};
use crate::signal::Signal;

/// One signal of one device.
pub(crate) type Key = (DeviceId, ControlType);

/// A signal that moves, with the clock on which it does.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Movement {
    pub(crate) signal: Signal,
    pub(crate) clock: HostClock,
}

/// A value, and from when on it is too old to be set.
#[derive(Clone, Debug)]
pub(crate) struct Value {
    pub(crate) setpoint: Setpoint,
    /// `None`: the default state is never too old.
    pub(crate) due: Option<Instant>,
}

impl Value {
    /// By how much it is late, where that is too much.
    pub(crate) fn stale(&self, now: Instant) -> Option<Duration> {
        let late = now.saturating_duration_since(self.due?);
        (late > STALE).then_some(late)
    }
}

/// What the machine wants of the hardware.
#[derive(Clone, Debug)]
pub(crate) enum Order {
    Set(Key, Value),
    Follow(Key, Movement),
    Read(ReadingId, DeviceId),
    /// Say when all that was put in before for the device has been done.
    Confirm(Ticket, DeviceId),
    Plan(PlanOrder),
}

/// What a driver is to do with a script that it times by itself.
#[derive(Clone, Debug)]
pub(crate) enum PlanOrder {
    /// Take steps of it, with the clock of their times.
    Take(PlanPart<Robot>, HostClock),
    Cancel(PlanCancel),
}

impl PlanOrder {
    const fn device(&self) -> &DeviceId {
        match self {
            Self::Take(part, _) => &part.device,
            Self::Cancel(cancel) => &cancel.device,
        }
    }
}

/// A signal, the value that is set, and the movement that begins then.
pub(crate) type Drive = (Key, Option<Value>, Option<Movement>);

/// What the mailbox has to know of the driver of a connection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Manners {
    /// The hardware has a value once the driver's call has returned.
    pub(crate) acknowledges: bool,
    /// It is told all values that wait at one instant.
    pub(crate) takes_frames: bool,
    /// Between two pings in the second before a start.
    pub(crate) ping_period: Duration,
}

/// What a driver's thread does next.
#[derive(Debug)]
pub(crate) enum Work {
    /// Set these, then follow those. Several only for a driver that takes frames.
    Drive(Vec<Drive>),
    Read(ReadingId, DeviceId),
    /// Take a script, or end one.
    Plan(PlanOrder),
    /// Pass on what the driver says of scripts that it times by itself.
    Words(Vec<PlanWord>),
    /// Tell that the hardware has taken what these ask about.
    Confirm(Vec<Ticket>),
    /// Ask the hardware for a sign of life.
    Ping,
    /// The connection has ended, as this tells.
    HungUp(String),
    /// The hardware has said that it failed.
    Fault(String),
    /// Nothing until the time that was asked for.
    Nothing,
    /// Nothing is left, and nothing more will come.
    Closed,
}

/// Words of a driver about scripts that may wait to be passed on.
const WORDS_MAX: usize = 10_000;
/// Sensors whose readings are kept unasked.
const PUSHED_MAX: usize = 10_000;
/// A reading waits for a time without movements, but no longer than this.
const READ_WAIT_MAX: Duration = Duration::from_millis(200);
/// Before it is looked again whether a ping would be in no movement's way.
const PING_RETRY: Duration = Duration::from_millis(2);

/// What a call that has ended well tells of the hardware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sign {
    /// It has answered.
    Answered,
    /// Nothing: the system under it may have taken the call.
    Unknown,
}

#[derive(Debug, Default)]
struct State {
    /// Counts connections; 0 while there is none.
    connection: u64,
    values: HashMap<Key, Waiting>,
    /// The keys of `values`, the longest waiting first.
    order: VecDeque<Key>,
    readings: VecDeque<(ReadingId, DeviceId, Instant)>,
    /// With the numbers of their orders, the oldest first.
    plans: VecDeque<(u64, PlanOrder)>,
    words: Vec<PlanWord>,
    /// Words were passed on last: a driver that says many does not keep others waiting.
    words_were_last: bool,
    /// Counts orders.
    orders: u64,
    /// What the driver was given last, until it asks for more.
    in_hand: Vec<(DeviceId, u64)>,
    confirms: Vec<Confirm>,
    /// There while there is a connection.
    manners: Option<Manners>,
    /// What sensors read by themselves, and when.
    pushed: HashMap<DeviceId, (f64, Instant)>,
    fault: Option<String>,
    demand: Demand,
    /// There while there is a connection.
    pulse: Option<Pulse>,
    /// Why the connection has ended, though nothing was asked of it.
    hung_up: Option<String>,
    /// A first try to connect has ended.
    tried: bool,
    closed: bool,
}

/// What waits for one signal.
#[derive(Debug, Default)]
struct Waiting {
    set: Option<Value>,
    follow: Option<Movement>,
    /// The number of the oldest order that it stands for.
    since: u64,
}

/// A question whether the hardware has taken the orders for a device up to this number.
#[derive(Debug)]
struct Confirm {
    ticket: Ticket,
    device: DeviceId,
    up_to: u64,
    /// The hardware has answered since they were done.
    answered: bool,
}

/// Orders that wait for a driver.
#[derive(Debug, Default)]
pub(crate) struct Mailbox {
    state: Mutex<State>,
    changed: Condvar,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing in here panics; were it to, every state is a whole one.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts in orders that were given under a connection; those of an earlier one are void.
    pub(crate) fn post(&self, connection: u64, orders: impl Iterator<Item = Order>, demand: Demand) {
        let now = Instant::now();
        let mut state = self.lock();
        state.demand = demand;
        let mut any = state.pulse.as_mut().is_some_and(|pulse| pulse.demand(now, demand));
        for order in orders.filter(|_| connection > 0) {
            if state.connection == connection {
                state.put(order);
                any = true;
            }
        }
        drop(state);
        if any {
            self.changed.notify_all();
        }
    }

    /// No more will come: what is in is still to be done.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// A connection stands; orders are taken for it alone.
    pub(crate) fn connected(&self, connection: u64, manners: Manners) {
        let now = Instant::now();
        let mut state = self.lock();
        let mut pulse = Pulse::new(now, manners.ping_period);
        pulse.demand(now, state.demand);
        state.connection = connection;
        state.manners = Some(manners);
        state.pulse = Some(pulse);
        state.hung_up = None;
        state.fault = None;
        state.words.clear();
    }

    /// The connection is gone, and everything that waited for it.
    pub(crate) fn disconnected(&self) {
        let mut state = self.lock();
        state.connection = 0;
        state.pulse = None;
        state.hung_up = None;
        state.values.clear();
        state.order.clear();
        state.plans.clear();
        state.words.clear();
        state.manners = None;
        state.readings.clear();
        state.confirms.clear();
        state.in_hand.clear();
        state.pushed.clear();
        state.fault = None;
    }

    pub(crate) fn tried(&self) {
        self.lock().tried = true;
        self.changed.notify_all();
    }

    /// Waits until a first try to connect has ended, well or not.
    pub(crate) fn await_tried(&self, until: Instant) {
        let mut state = self.lock();
        while !state.tried && !state.closed {
            let Some(left) = until.checked_duration_since(Instant::now()) else { return };
            state = self.wait(state, left);
        }
    }

    /// Waits, unless it is closed.
    pub(crate) fn pause(&self, pause: Duration) {
        let until = Instant::now() + pause;
        let mut state = self.lock();
        while !state.closed {
            let Some(left) = until.checked_duration_since(Instant::now()) else { return };
            state = self.wait(state, left);
        }
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>, left: Duration) -> MutexGuard<'a, State> {
        let (state, _timed_out) =
            self.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner);
        state
    }

    /// The connection has ended by itself.
    pub(crate) fn hung_up(&self, connection: u64, reason: String) {
        let mut state = self.lock();
        if state.connection == connection {
            state.hung_up = Some(reason);
            drop(state);
            self.changed.notify_all();
        }
    }

    /// The hardware has said that it failed.
    pub(crate) fn failed_by_itself(&self, reason: String) {
        let mut state = self.lock();
        if state.connection > 0 {
            state.fault = Some(reason);
            drop(state);
            self.changed.notify_all();
        }
    }

    /// The driver has said something of a script.
    pub(super) fn told_of_plan(&self, word: PlanWord) {
        let mut state = self.lock();
        if state.connection == 0 {
            return;
        }
        if state.words.len() < WORDS_MAX {
            state.words.push(word);
        } else {
            state.fault = Some(format!("it says more than {WORDS_MAX} things of scripts at a time"));
        }
        drop(state);
        self.changed.notify_all();
    }

    /// What the driver has said of scripts since this was asked last.
    pub(super) fn words(&self) -> Vec<PlanWord> {
        std::mem::take(&mut self.lock().words)
    }

    /// A sensor has told what it reads.
    pub(super) fn read_by_itself(&self, sensor: &DeviceId, reading: f64) {
        let now = Instant::now();
        let mut state = self.lock();
        let room = state.pushed.len() < PUSHED_MAX || state.pushed.contains_key(sensor);
        if state.connection > 0 && room {
            state.pushed.insert(sensor.clone(), (reading, now));
        }
    }

    /// What a sensor has told within this time.
    pub(super) fn pushed(&self, sensor: &DeviceId, within: Duration) -> Option<f64> {
        let now = Instant::now();
        let (reading, at) = *self.lock().pushed.get(sensor)?;
        (now.saturating_duration_since(at) <= within).then_some(reading)
    }

    /// Notes what a call took, and whether it shows that the hardware lives.
    pub(crate) fn called(&self, took: Duration, sign: Sign) {
        let now = Instant::now();
        let mut state = self.lock();
        if let Some(pulse) = &mut state.pulse {
            pulse.called(took);
            if sign == Sign::Answered {
                pulse.seen(now);
            }
        }
        if sign == Sign::Answered {
            state.answered();
        }
    }

    /// A reading begins or has ended.
    pub(crate) fn reading(&self, under_way: bool) {
        if let Some(pulse) = &mut self.lock().pulse {
            pulse.reading(under_way);
        }
    }

    /// For how long the hardware has not answered, where that is too long for what is held.
    pub(crate) fn silence(&self) -> Option<Duration> {
        let now = Instant::now();
        self.lock().pulse.as_ref()?.silence(now)
    }

    /// The next thing to do: values first, then signs of life, then readings where no movement is near.
    pub(crate) fn next(&self, until: Instant) -> Work {
        let mut state = self.lock();
        state.in_hand.clear();
        loop {
            let now = Instant::now();
            // What was said before a fault or an end was so.
            if !state.words.is_empty() && !std::mem::replace(&mut state.words_were_last, true) {
                return Work::Words(std::mem::take(&mut state.words));
            }
            state.words_were_last = false;
            if let Some(reason) = state.fault.take() {
                return Work::Fault(reason);
            }
            if let Some(reason) = state.hung_up.take() {
                return Work::HungUp(reason);
            }
            let confirmed = state.confirmed();
            if !confirmed.is_empty() {
                return Work::Confirm(confirmed);
            }
            if state.pulse.as_ref().is_some_and(|pulse| pulse.is_overdue(now)) {
                return Work::Ping;
            }
            if let Some(plan) = state.take_plan() {
                return Work::Plan(plan);
            }
            let drives = state.take();
            if !drives.is_empty() {
                return Work::Drive(drives);
            }
            let ping = state.pulse.as_ref().map(|pulse| (pulse.next_ping(now), pulse.is_quiet(now)));
            if ping.is_some_and(|(ping, quiet)| ping <= now && quiet) {
                return Work::Ping;
            }
            if !state.words.is_empty() {
                return Work::Words(std::mem::take(&mut state.words));
            }
            if state.closed {
                return Work::Closed;
            }
            let waited = |asked: &Instant| now.saturating_duration_since(*asked) >= READ_WAIT_MAX;
            let quiet = state.pulse.as_ref().is_none_or(|pulse| pulse.is_quiet_for_readings(now));
            if state.readings.front().is_some_and(|(.., asked)| quiet || waited(asked))
                && let Some((id, sensor, _)) = state.readings.pop_front()
            {
                return Work::Read(id, sensor);
            }
            let Some(left) = until.checked_duration_since(now).filter(|left| !left.is_zero()) else {
                return Work::Nothing;
            };
            let left = if state.readings.is_empty() { left } else { left.min(QUIET) };
            // Where a movement is near the ping is looked for again behind it.
            let ping = ping.map(|(ping, _)| ping.saturating_duration_since(now).max(PING_RETRY));
            let left = ping.map_or(left, |ping| left.min(ping));
            state = self.wait(state, left);
        }
    }
}

impl State {
    fn put(&mut self, order: Order) {
        self.orders += 1;
        match order {
            Order::Set(key, value) => {
                let waiting = self.waiting(key);
                (waiting.set, waiting.follow) = (Some(value), None);
            }
            // A value that is due at the same instant is still set first.
            Order::Follow(key, movement) => self.waiting(key).follow = Some(movement),
            // One that finds no room is not answered, which its time limit tells.
            Order::Read(id, sensor) if self.readings.len() < READINGS_MAX => {
                self.readings.push_back((id, sensor, Instant::now()));
            }
            Order::Read(..) => {}
            Order::Plan(plan) => {
                if let PlanOrder::Cancel(PlanCancel { plan, .. }) = &plan {
                    // What the driver has not been told it need not be told any more.
                    let of =
                        |order: &PlanOrder| matches!(order, PlanOrder::Take(part, _) if part.plan == *plan);
                    self.plans.retain(|(_, order)| !of(order));
                }
                self.plans.push_back((self.orders, plan));
            }
            Order::Confirm(ticket, device) => {
                let confirm = Confirm { ticket, device, up_to: self.orders, answered: false };
                self.confirms.push(confirm);
            }
        }
    }

    /// Whether all has been done that a question asks about.
    fn is_done(&self, confirm: &Confirm) -> bool {
        let waits = |(device, _): &Key, since: u64| *device == confirm.device && since <= confirm.up_to;
        let in_hand =
            self.in_hand.iter().any(|(device, since)| *device == confirm.device && *since <= confirm.up_to);
        let planned =
            |(since, plan): &(u64, PlanOrder)| *plan.device() == confirm.device && *since <= confirm.up_to;
        let waits_for_plan = self.plans.iter().any(planned);
        !in_hand && !waits_for_plan && !self.values.iter().any(|(key, waiting)| waits(key, waiting.since))
    }

    /// The hardware has just answered.
    fn answered(&mut self) {
        let mut confirms = std::mem::take(&mut self.confirms);
        confirms.iter_mut().for_each(|confirm| confirm.answered |= self.is_done(confirm));
        self.confirms = confirms;
    }

    /// The questions that can be answered with yes.
    fn confirmed(&mut self) -> Vec<Ticket> {
        if self.confirms.is_empty() {
            return Vec::new();
        }
        let acknowledges = self.manners.is_some_and(|manners| manners.acknowledges);
        let all = std::mem::take(&mut self.confirms);
        let (confirmed, left): (Vec<_>, Vec<_>) =
            all.into_iter().partition(|confirm| confirm.answered || (acknowledges && self.is_done(confirm)));
        self.confirms = left;
        confirmed.into_iter().map(|confirm| confirm.ticket).collect()
    }

    fn waiting(&mut self, key: Key) -> &mut Waiting {
        match self.values.entry(key) {
            Entry::Occupied(waiting) => waiting.into_mut(),
            Entry::Vacant(place) => {
                self.order.push_back(place.key().clone());
                place.insert(Waiting { since: self.orders, ..Waiting::default() })
            }
        }
    }

    /// The next thing to do with a script, unless a value waits that was put in before.
    fn take_plan(&mut self) -> Option<PlanOrder> {
        let since = self.plans.front()?.0;
        let value = self.order.front().and_then(|key| self.values.get(key));
        if value.is_some_and(|value| value.since < since) {
            return None;
        }
        let (since, plan) = self.plans.pop_front()?;
        self.in_hand.push((plan.device().clone(), since));
        Some(plan)
    }

    fn take(&mut self) -> Vec<Drive> {
        let takes_frames = self.manners.is_some_and(|manners| manners.takes_frames);
        let most = if takes_frames { self.order.len() } else { 1 };
        let mut taken = Vec::new();
        for key in self.order.drain(..most.min(self.order.len())) {
            let Some(Waiting { set, follow, since }) = self.values.remove(&key) else { continue };
            self.in_hand.push((key.0.clone(), since));
            taken.push((key, set, follow));
        }
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_too_old_only_beyond_its_bound() {
        let due = Instant::now();
        let value = |due| Value { setpoint: Setpoint::new(ControlType::Position, 1.0), due };
        let beyond = STALE + Duration::from_nanos(1);
        assert_eq!(value(Some(due)).stale(due + STALE), None);
        assert_eq!(value(Some(due)).stale(due + beyond), Some(beyond));
        assert_eq!(value(None).stale(due + beyond), None, "the default state is never too old");
    }

    const MANNERS: Manners =
        Manners { acknowledges: false, takes_frames: false, ping_period: Duration::from_millis(25) };
    const MS: Duration = Duration::from_millis(1);

    fn id(device: &str) -> DeviceId {
        DeviceId::new(device).unwrap()
    }

    fn set(device: &str, value: f64) -> Order {
        let value = Value { setpoint: Setpoint::new(ControlType::Speed, value), due: None };
        Order::Set((id(device), ControlType::Speed), value)
    }

    fn confirm(ticket: u64, device: &str) -> Order {
        Order::Confirm(Ticket(ticket), id(device))
    }

    /// A cancellation, which like a script has its place among the values.
    fn plan(device: &str) -> Order {
        let (plan, then) = (crate::PlanId(1), crate::Then::Keep);
        let cancel = PlanCancel { plan, device: id(device), then, why: String::new() };
        Order::Plan(PlanOrder::Cancel(cancel))
    }

    fn word(plan: u64) -> PlanWord {
        let (plan, at) = (crate::PlanId(plan), urrcp::Timestamp::from_nanos(0));
        PlanWord { plan, at, event: crate::plans::PlanEvent::Began }
    }

    /// Of a first connection, with these orders.
    fn with<const N: usize>(orders: [Order; N]) -> Mailbox {
        let mailbox = Mailbox::default();
        mailbox.connected(1, MANNERS);
        mailbox.post(1, orders.into_iter(), Demand::default());
        mailbox
    }

    /// What a driver's thread is given next, in a word.
    fn next(mailbox: &Mailbox) -> String {
        match mailbox.next(Instant::now()) {
            Work::Drive(drives) => {
                let shown = |(key, value, movement): &Drive| {
                    let value = value.as_ref().map(|value| format!(" {}", value.setpoint.value));
                    let movement = movement.map_or("", |_| " and on");
                    format!("{}{}{movement}", key.0, value.unwrap_or_default())
                };
                drives.iter().map(shown).collect::<Vec<_>>().join(", ")
            }
            Work::Read(reading, sensor) => format!("read {sensor} {}", reading.0),
            Work::Plan(order) => format!("plan of {}", order.device()),
            Work::Words(words) => format!("{} words", words.len()),
            Work::Confirm(tickets) => {
                format!("confirm {:?}", tickets.iter().map(|t| t.0).collect::<Vec<_>>())
            }
            Work::Ping => "ping".to_owned(),
            Work::HungUp(reason) => format!("hung up: {reason}"),
            Work::Fault(reason) => format!("fault: {reason}"),
            Work::Nothing => "nothing".to_owned(),
            Work::Closed => "closed".to_owned(),
        }
    }

    #[test]
    fn an_answer_confirms_what_was_done_of_a_device_and_nothing_that_waits_or_is_in_hand() {
        let mailbox = with([set("a", 1.0), confirm(1, "a"), confirm(2, "b"), set("b", 2.0), set("a", 3.0)]);
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "confirm [2]", "what was wanted later does not count");
        assert_eq!(next(&mailbox), "a 3");
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "b 2", "the driver has it in hand");
        mailbox.called(MS, Sign::Unknown);
        assert_eq!(next(&mailbox), "nothing", "the hardware itself has said nothing");
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "confirm [1]");
        assert_eq!(next(&mailbox), "nothing");
    }

    #[test]
    fn a_device_is_confirmed_although_others_wait_or_are_in_hand() {
        let mailbox = with([set("a", 1.0), set("b", 2.0), plan("c"), confirm(1, "d")]);
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "confirm [1]");
        mailbox.post(1, [confirm(2, "d")].into_iter(), Demand::default());
        assert_eq!(next(&mailbox), "a 1");
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "confirm [2]");
    }

    #[test]
    fn a_script_that_waits_or_is_in_hand_is_not_confirmed() {
        let mailbox = with([plan("a"), confirm(1, "a")]);
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "plan of a");
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "nothing");
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "confirm [1]");
        let mailbox = with([confirm(1, "a"), plan("a")]);
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "confirm [1]", "it was wanted later");
    }

    #[test]
    fn hardware_that_acknowledges_values_is_not_asked_again() {
        let mailbox = Mailbox::default();
        mailbox.connected(1, Manners { acknowledges: true, ..MANNERS });
        mailbox.post(1, [set("a", 1.0), confirm(1, "a")].into_iter(), Demand::default());
        assert_eq!([next(&mailbox), next(&mailbox)], ["a 1", "confirm [1]"]);
    }

    #[test]
    fn values_and_scripts_keep_the_order_in_which_they_were_wanted() {
        let mailbox = with([set("a", 1.0), plan("b"), set("a", 2.0), set("c", 3.0)]);
        let all: Vec<_> = std::iter::repeat_with(|| next(&mailbox)).take(4).collect();
        assert_eq!(
            all,
            ["a 2", "plan of b", "c 3", "nothing"],
            "the newer value keeps the place of the older"
        );
    }

    #[test]
    fn a_movement_follows_its_value_and_a_newer_value_ends_it() {
        let signal = Signal::resting(1.0, urrcp::Timestamp::from_nanos(0));
        let movement = Movement { signal, clock: HostClock::anchored() };
        let follow = || Order::Follow((id("a"), ControlType::Speed), movement);
        assert_eq!(next(&with([set("a", 1.0), follow()])), "a 1 and on");
        assert_eq!(next(&with([set("a", 1.0), follow(), set("a", 2.0)])), "a 2");
    }

    #[test]
    fn words_take_turns_with_everything_else_and_come_before_a_fault_and_an_end() {
        let mailbox = with([set("a", 1.0), set("b", 2.0)]);
        mailbox.told_of_plan(word(1));
        assert_eq!(next(&mailbox), "1 words");
        mailbox.told_of_plan(word(1));
        mailbox.told_of_plan(word(2));
        assert_eq!([next(&mailbox), next(&mailbox), next(&mailbox)], ["a 1", "2 words", "b 2"]);
        mailbox.told_of_plan(word(1));
        mailbox.hung_up(1, "cut".to_owned());
        mailbox.failed_by_itself("hot".to_owned());
        assert_eq!(
            [next(&mailbox), next(&mailbox), next(&mailbox)],
            ["1 words", "fault: hot", "hung up: cut"]
        );
        mailbox.told_of_plan(word(1));
        assert_eq!(mailbox.words().len(), 1);
        assert_eq!(next(&mailbox), "nothing");
        mailbox.told_of_plan(word(1));
        assert_eq!(next(&mailbox), "1 words");
        mailbox.told_of_plan(word(1));
        assert_eq!(next(&mailbox), "1 words", "nothing else waits for its turn");
    }

    #[test]
    fn a_driver_that_says_too_much_of_scripts_at_a_time_has_failed() {
        let mailbox = with([]);
        (0..WORDS_MAX).for_each(|_| mailbox.told_of_plan(word(1)));
        assert_eq!([next(&mailbox), next(&mailbox)], ["10000 words", "nothing"]);
        (0..=WORDS_MAX).for_each(|_| mailbox.told_of_plan(word(1)));
        assert_eq!(next(&mailbox), "10000 words");
        assert_eq!(next(&mailbox), "fault: it says more than 10000 things of scripts at a time");
    }

    #[test]
    fn nothing_that_is_told_without_a_connection_reaches_the_next_one() {
        let mailbox = Mailbox::default();
        mailbox.told_of_plan(word(1));
        mailbox.failed_by_itself("hot".to_owned());
        mailbox.hung_up(1, "cut".to_owned());
        mailbox.read_by_itself(&id("eye"), 1.0);
        mailbox.connected(1, MANNERS);
        assert_eq!(next(&mailbox), "nothing");
        assert_eq!(mailbox.pushed(&id("eye"), Duration::MAX), None);
        mailbox.hung_up(2, "cut".to_owned());
        assert_eq!(next(&mailbox), "nothing", "of another connection");
    }

    #[test]
    fn a_connection_that_ends_takes_everything_with_it() {
        let mailbox = with([set("a", 1.0), plan("a"), Order::Read(ReadingId(1), id("eye")), confirm(1, "b")]);
        mailbox.told_of_plan(word(1));
        mailbox.hung_up(1, "cut".to_owned());
        mailbox.failed_by_itself("hot".to_owned());
        mailbox.disconnected();
        mailbox.connected(2, MANNERS);
        mailbox.called(MS, Sign::Answered);
        assert_eq!(next(&mailbox), "nothing");
        mailbox.post(2, [set("a", 2.0)].into_iter(), Demand::default());
        assert_eq!(next(&mailbox), "a 2");
    }

    #[test]
    fn a_reading_waits_for_a_time_without_movements_and_not_for_long() {
        let mailbox = with([Order::Read(ReadingId(1), id("eye")), set("a", 1.0)]);
        let due = |after: Duration| Demand { next_due: Some(Instant::now() + after), ..Demand::default() };
        mailbox.post(1, std::iter::empty(), due(QUIET / 2));
        assert_eq!([next(&mailbox), next(&mailbox)], ["a 1", "nothing"], "a movement is near");
        mailbox.post(1, std::iter::empty(), due(Duration::from_secs(600)));
        assert_eq!(next(&mailbox), "read eye 1");
        let long_ago = Instant::now() - READ_WAIT_MAX;
        mailbox.lock().readings.push_back((ReadingId(2), id("eye"), long_ago));
        mailbox.post(1, std::iter::empty(), due(QUIET / 2));
        assert_eq!(next(&mailbox), "read eye 2", "it has waited long enough");
    }

    #[test]
    fn no_more_readings_wait_than_may_be_open() {
        let mailbox = with([]);
        let reads = (0..2 * READINGS_MAX as u64).map(|reading| Order::Read(ReadingId(reading), id("eye")));
        mailbox.post(1, reads, Demand::default());
        let asked = std::iter::repeat_with(|| next(&mailbox)).take_while(|what| what != "nothing");
        assert_eq!(asked.count(), READINGS_MAX);
    }

    #[test]
    fn a_ping_waits_for_values_and_movements_until_it_is_overdue() {
        let since = |silent: Duration, due: Option<Duration>| {
            let mailbox = with([set("a", 1.0)]);
            let mut pulse = Pulse::new(Instant::now() - silent, MANNERS.ping_period);
            let next_due = due.map(|due| Instant::now() + due);
            pulse.demand(Instant::now(), Demand { next_due, ..Demand::default() });
            mailbox.lock().pulse = Some(pulse);
            [next(&mailbox), next(&mailbox)]
        };
        assert_eq!(since(300 * MS, None), ["a 1", "nothing"]);
        assert_eq!(since(600 * MS, None), ["a 1", "ping"]);
        assert_eq!(since(600 * MS, Some(Duration::ZERO)), ["a 1", "nothing"]);
        assert_eq!(since(3_000 * MS, Some(Duration::ZERO)), ["ping", "ping"], "until it is answered");
    }

    #[test]
    fn hardware_is_silent_until_a_call_shows_that_it_lives_or_while_a_sensor_is_read() {
        let mailbox = with([]);
        assert_eq!(mailbox.silence(), None);
        let begin = Instant::now() - Duration::from_secs(2);
        let mut pulse = Pulse::new(begin, MANNERS.ping_period);
        pulse.demand(begin, Demand { held: true, ..Demand::default() });
        mailbox.lock().pulse = Some(pulse);
        mailbox.called(Duration::ZERO, Sign::Unknown);
        assert!(mailbox.silence().is_some());
        mailbox.reading(true);
        assert_eq!(mailbox.silence(), None);
        mailbox.reading(false);
        assert!(mailbox.silence().is_some());
        mailbox.called(Duration::ZERO, Sign::Answered);
        assert_eq!(mailbox.silence(), None);
    }

    #[test]
    fn what_is_demanded_before_a_connection_counts_for_it() {
        let mailbox = Mailbox::default();
        let demand = Demand { held: true, ..Demand::default() };
        mailbox.post(0, std::iter::empty(), demand);
        mailbox.connected(1, MANNERS);
        let state = mailbox.lock();
        let next = state.pulse.as_ref().unwrap().next_ping(Instant::now());
        assert!(next <= Instant::now() + 2 * MANNERS.ping_period);
    }

    #[test]
    fn what_is_in_is_done_before_the_mailbox_is_closed_but_no_reading() {
        let mailbox = with([Order::Read(ReadingId(1), id("eye")), set("a", 1.0), set("b", 2.0)]);
        assert!(!mailbox.is_closed());
        mailbox.close();
        assert!(mailbox.is_closed());
        assert_eq!([next(&mailbox), next(&mailbox), next(&mailbox)], ["a 1", "b 2", "closed"]);
    }

    #[test]
    fn a_wait_ends_at_once_where_there_is_nothing_to_wait_for() {
        let later = Duration::from_secs(3_600);
        let tried = Mailbox::default();
        tried.await_tried(Instant::now());
        tried.tried();
        tried.await_tried(Instant::now() + later);
        let closed = Mailbox::default();
        closed.close();
        closed.await_tried(Instant::now() + later);
        closed.pause(later);
        let begun = Instant::now();
        Mailbox::default().pause(Duration::from_millis(5));
        assert!(begun.elapsed() >= Duration::from_millis(5));
    }

    #[test]
    fn a_sensor_that_is_known_tells_on_and_no_more_sensors_than_there_is_room_for() {
        let mailbox = with([]);
        for sensor in 0..PUSHED_MAX + 1 {
            mailbox.read_by_itself(&id(&format!("s{sensor}")), 1.0);
        }
        mailbox.read_by_itself(&id("s0"), 2.0);
        let told = |sensor: usize| mailbox.pushed(&id(&format!("s{sensor}")), Duration::MAX);
        assert_eq!([told(0), told(PUSHED_MAX - 1), told(PUSHED_MAX)], [Some(2.0), Some(1.0), None]);
    }
}
