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
use crate::hardware::{READINGS_MAX, ReadingId};
use crate::plans::{PlanCancel, PlanPart};
use crate::signal::Signal;
use crate::tolerance::Tolerance;

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
    /// `None`: a stop is never too old.
    pub(crate) due: Option<Instant>,
}

impl Value {
    /// By how much it is late, where that is more than `late_max`.
    pub(crate) fn stale(&self, now: Instant, late_max: Duration) -> Option<Duration> {
        let late = now.saturating_duration_since(self.due?);
        (late > late_max).then_some(late)
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
    /// How long the hardware may show no sign of life near a start, if its driver declares it.
    pub(crate) silence_max: Option<Duration>,
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
    /// It showed itself this long ago, as its driver reports.
    Seen(Duration),
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
    tolerance: Tolerance,
    /// The instant that its clock shows all the time, in a test.
    #[cfg(test)]
    stopped_at: Option<Instant>,
}

impl Mailbox {
    /// With these limits of lateness.
    pub(crate) fn tolerating(tolerance: Tolerance) -> Self {
        Self { tolerance, ..Self::default() }
    }

    /// Reads no clock, except where it waits.
    #[cfg(test)]
    pub(crate) fn stopped_at(instant: Instant) -> Self {
        Self { stopped_at: Some(instant), ..Self::default() }
    }

    pub(crate) const fn tolerance(&self) -> Tolerance {
        self.tolerance
    }

    fn now(&self) -> Instant {
        #[cfg(test)]
        if let Some(stopped_at) = self.stopped_at {
            return stopped_at;
        }
        Instant::now()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing in here panics; were it to, every state is a whole one.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts in orders that were given under a connection; those of an earlier one are void.
    pub(crate) fn post(&self, connection: u64, orders: impl Iterator<Item = Order>, demand: Demand) {
        let now = self.now();
        let mut state = self.lock();
        state.demand = demand;
        let mut any = state.pulse.as_mut().is_some_and(|pulse| pulse.demand(now, demand));
        for order in orders.filter(|_| connection > 0) {
            if state.connection == connection {
                state.put(order, now);
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
        let now = self.now();
        let mut state = self.lock();
        let mut pulse = Pulse::new(now, manners.ping_period);
        pulse.signs_within(manners.silence_max);
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

    /// Waits until the first attempt to connect has ended, with or without success. Returns whether it has.
    pub(crate) fn await_tried(&self, until: Instant) -> bool {
        let mut state = self.lock();
        while !state.tried && !state.closed {
            let Some(left) = until.checked_duration_since(Instant::now()) else { return false };
            state = self.wait(state, left);
        }
        true
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
        let now = self.now();
        let mut state = self.lock();
        let room = state.pushed.len() < PUSHED_MAX || state.pushed.contains_key(sensor);
        if state.connection > 0 && room {
            state.pushed.insert(sensor.clone(), (reading, now));
        }
    }

    /// What a sensor has told within this time.
    pub(super) fn pushed(&self, sensor: &DeviceId, within: Duration) -> Option<f64> {
        let now = self.now();
        let (reading, at) = *self.lock().pushed.get(sensor)?;
        (now.saturating_duration_since(at) <= within).then_some(reading)
    }

    /// Notes what a call took, and whether it shows that the hardware lives.
    pub(crate) fn called(&self, took: Duration, sign: Sign) {
        let now = self.now();
        let mut state = self.lock();
        if let Some(pulse) = &mut state.pulse {
            pulse.called(took);
            match sign {
                Sign::Answered => pulse.answered(now),
                Sign::Seen(ago) => pulse.seen(now, ago),
                Sign::Unknown => {}
            }
        }
        if sign != Sign::Unknown {
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
        let now = self.now();
        let state = self.lock();
        state.pulse.as_ref()?.silence(now, self.tolerance.silence)
    }

    /// The next thing to do: values first, then signs of life, then readings where no movement is near.
    pub(crate) fn next(&self, until: Instant) -> Work {
        let mut state = self.lock();
        state.in_hand.clear();
        if let Some(pulse) = &mut state.pulse {
            pulse.busy(None);
        }
        let (mut state, work) = self.await_work(state, until);
        let now = self.now();
        if let Some(pulse) = &mut state.pulse {
            pulse.busy(Some(now));
        }
        work
    }

    fn await_work<'a>(
        &'a self,
        mut state: MutexGuard<'a, State>,
        until: Instant,
    ) -> (MutexGuard<'a, State>, Work) {
        loop {
            let now = self.now();
            // What was said before a fault or an end was so.
            if !state.words.is_empty() && !std::mem::replace(&mut state.words_were_last, true) {
                let words = std::mem::take(&mut state.words);
                return (state, Work::Words(words));
            }
            state.words_were_last = false;
            if let Some(reason) = state.fault.take() {
                return (state, Work::Fault(reason));
            }
            if let Some(reason) = state.hung_up.take() {
                return (state, Work::HungUp(reason));
            }
            let confirmed = state.confirmed();
            if !confirmed.is_empty() {
                return (state, Work::Confirm(confirmed));
            }
            if state.pulse.as_ref().is_some_and(|pulse| pulse.is_overdue(now)) {
                return (state, Work::Ping);
            }
            if let Some(plan) = state.take_plan() {
                return (state, Work::Plan(plan));
            }
            let drives = state.take();
            if !drives.is_empty() {
                return (state, Work::Drive(drives));
            }
            let ping = state.pulse.as_ref().map(|pulse| (pulse.next_ping(now), pulse.is_quiet(now)));
            if ping.is_some_and(|(ping, quiet)| ping <= now && quiet) {
                return (state, Work::Ping);
            }
            if !state.words.is_empty() {
                let words = std::mem::take(&mut state.words);
                return (state, Work::Words(words));
            }
            if state.closed {
                return (state, Work::Closed);
            }
            let waited = |asked: &Instant| now.saturating_duration_since(*asked) >= READ_WAIT_MAX;
            let quiet = state.pulse.as_ref().is_none_or(|pulse| pulse.is_quiet_for_readings(now));
            if state.readings.front().is_some_and(|(.., asked)| quiet || waited(asked))
                && let Some((id, sensor, _)) = state.readings.pop_front()
            {
                return (state, Work::Read(id, sensor));
            }
            let Some(left) = until.checked_duration_since(now).filter(|left| !left.is_zero()) else {
                return (state, Work::Nothing);
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
    fn put(&mut self, order: Order, now: Instant) {
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
                self.readings.push_back((id, sensor, now));
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
mod tests;
