//! Values that wait on their way from the precise thread (which runs the robot's state machine) to a driver's thread.
//!
//! For each signal of a device, at most one value waits, and at most one movement that starts from this value. Newer ones replace them.
//! Adding a value never waits for the driver.
#![expect(clippy::disallowed_methods, reason = "waits until the next sample or ping is due")]

use std::collections::hash_map::Entry;
use std::collections::{HashMap, VecDeque};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use urrcp::{ControlType, DeviceId, Robot, Setpoint};

use super::PlanReport;
use super::pulse::{Demand, Pulse, QUIET};
use crate::clock::HostClock;
use crate::confirmation::Ticket;
use crate::hardware::{READINGS_MAX, ReadingId};
use crate::plans::{PlanCancel, PlanPart};
use crate::signal::Signal;
use crate::tolerance::Tolerance;

pub(crate) type Key = (DeviceId, ControlType);

/// A moving signal, and the clock to which its times refer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Movement {
    pub(crate) signal: Signal,
    pub(crate) clock: HostClock,
}

/// A value of a device, and the time when it is due.
#[derive(Clone, Debug)]
pub(crate) struct Value {
    pub(crate) setpoint: Setpoint,
    /// Due time of the value. `None`: the value belongs to a stop and is never too late.
    pub(crate) due: Option<Instant>,
}

impl Value {
    /// Returns the value's delay if it exceeds `late_max`.
    pub(crate) fn stale(&self, now: Instant, late_max: Duration) -> Option<Duration> {
        let late = now.saturating_duration_since(self.due?);
        (late > late_max).then_some(late)
    }
}

/// A request of the robot's state machine to the hardware.
#[derive(Clone, Debug)]
pub(crate) enum Order {
    Set(Key, Value),
    Follow(Key, Movement),
    Read(ReadingId, DeviceId),
    /// Report to the state machine once all earlier orders for the device have been executed.
    Confirm(Ticket, DeviceId),
    Plan(PlanOrder),
}

/// An order for a driver that times scripts by itself.
#[derive(Clone, Debug)]
pub(crate) enum PlanOrder {
    /// Take these steps of a script. Their times refer to the contained clock.
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

/// A signal, its next value, and the movement that starts at that value.
pub(crate) type Drive = (Key, Option<Value>, Option<Movement>);

/// Properties of a connected driver on which the mailbox depends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriverTraits {
    /// Whether a returned call of the driver means that the hardware itself has taken the value.
    pub(crate) acknowledges: bool,
    /// Whether the driver receives in one call all values that are due at the same instant.
    pub(crate) takes_frames: bool,
    /// Interval between two pings in the last second before a start.
    pub(crate) ping_period: Duration,
    /// Maximum time for which the hardware may show no sign of life near a start. `None` if the driver declares none.
    pub(crate) silence_max: Option<Duration>,
}

/// The next work of a driver's thread.
#[derive(Debug)]
pub(crate) enum Work {
    /// Set these values, then follow these movements. Only a driver that takes frames (several values per call) receives more than one
    /// entry.
    Drive(Vec<Drive>),
    Read(ReadingId, DeviceId),
    /// Take a script, or end one.
    Plan(PlanOrder),
    /// Forward these reports of the driver about scripts that it times by itself.
    Words(Vec<PlanReport>),
    /// Report that the hardware has taken all orders that were given before these tickets (questions of the state machine).
    Confirm(Vec<Ticket>),
    /// Ask the hardware for a sign of life.
    Ping,
    /// The connection has ended; contains the reason.
    HungUp(String),
    /// The hardware has reported this fault.
    Fault(String),
    /// No work is due before the requested time.
    Nothing,
    /// No work remains, and none will follow.
    Closed,
}

/// Maximum number of the driver's reports about scripts that wait to be forwarded.
const WORDS_MAX: usize = 10_000;
/// Maximum number of sensors whose unsolicited readings are kept.
const PUSHED_MAX: usize = 10_000;
/// Maximum time for which a sensor reading is postponed while a movement is near.
const READ_WAIT_MAX: Duration = Duration::from_millis(200);
/// Delay after which the mailbox checks again whether a ping would delay a movement.
const PING_RETRY: Duration = Duration::from_millis(2);

/// What a successful call to the hardware shows about whether the hardware is alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sign {
    /// The hardware answered.
    Answered,
    /// The driver reports that the hardware showed a sign of life this long before the answer.
    Seen(Duration),
    /// The call shows nothing: it may have reached only the system below the driver.
    Unknown,
}

#[derive(Debug, Default)]
struct State {
    /// Number of the current connection; 0 while disconnected.
    connection: u64,
    values: HashMap<Key, Waiting>,
    /// Keys of `values`, the one that has waited longest first.
    order: VecDeque<Key>,
    readings: VecDeque<(ReadingId, DeviceId, Instant)>,
    /// Waiting script orders with their order numbers, oldest first.
    plans: VecDeque<(u64, PlanOrder)>,
    words: Vec<PlanReport>,
    /// Whether the last work of the driver's thread was to forward reports. If so, other work comes next, so that many reports cannot
    /// delay it.
    words_were_last: bool,
    /// Number of orders that have been added so far.
    orders: u64,
    /// Devices and order numbers of the work that the driver's thread received last. Empty once the thread asks for more work.
    in_hand: Vec<(DeviceId, u64)>,
    confirms: Vec<Confirm>,
    /// Properties of the connected driver; `None` while disconnected.
    manners: Option<DriverTraits>,
    /// Last unsolicited reading of each sensor, and its time.
    pushed: HashMap<DeviceId, (f64, Instant)>,
    fault: Option<String>,
    demand: Demand,
    /// Signs of life of the connection; `None` while disconnected.
    pulse: Option<Pulse>,
    /// Reason why the connection ended while no request was pending.
    hung_up: Option<String>,
    /// Whether the first attempt to connect has ended.
    tried: bool,
    closed: bool,
}

/// The pending value and movement of one signal.
#[derive(Debug, Default)]
struct Waiting {
    set: Option<Value>,
    follow: Option<Movement>,
    /// Order number of the oldest order that this entry includes.
    since: u64,
}

/// A question whether the hardware has taken all orders for a device up to the number `up_to`.
#[derive(Debug)]
struct Confirm {
    ticket: Ticket,
    device: DeviceId,
    up_to: u64,
    /// Whether the hardware has answered a call since the orders up to `up_to` were executed.
    answered: bool,
}

/// Orders that wait for a driver's thread.
#[derive(Debug, Default)]
pub(crate) struct Mailbox {
    state: Mutex<State>,
    changed: Condvar,
    tolerance: Tolerance,
    /// Fixed time that the mailbox uses instead of a clock in a test.
    #[cfg(test)]
    stopped_at: Option<Instant>,
}

impl Mailbox {
    /// Returns a mailbox that applies the given maximum delays.
    pub(crate) fn tolerating(tolerance: Tolerance) -> Self {
        Self { tolerance, ..Self::default() }
    }

    /// Returns a mailbox that uses `instant` as the current time, except while it waits.
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
        // Nothing in here panics; even if it did, every intermediate state is consistent.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds orders that the state machine gave for the connection with this number. Discards orders for an earlier connection.
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

    /// Closes the mailbox to new orders; pending ones are still executed.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Records a new connection. From now on, only orders for this connection number are accepted.
    pub(crate) fn connected(&self, connection: u64, manners: DriverTraits) {
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

    /// Discards the connection and all work that waits for it.
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

    /// Waits until the first attempt to connect has ended, with or without success, but at most until `until`. Returns whether the
    /// attempt has ended.
    pub(crate) fn await_tried(&self, until: Instant) -> bool {
        let mut state = self.lock();
        while !state.tried && !state.closed {
            let Some(left) = until.checked_duration_since(Instant::now()) else { return false };
            state = self.wait(state, left);
        }
        true
    }

    /// Waits for `pause`, or until the mailbox is closed.
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

    /// Records that the connection with this number has ended without a request, and for which reason.
    pub(crate) fn hung_up(&self, connection: u64, reason: String) {
        let mut state = self.lock();
        if state.connection == connection {
            state.hung_up = Some(reason);
            drop(state);
            self.changed.notify_all();
        }
    }

    /// Records a fault that the hardware reported.
    pub(crate) fn failed_by_itself(&self, reason: String) {
        let mut state = self.lock();
        if state.connection > 0 {
            state.fault = Some(reason);
            drop(state);
            self.changed.notify_all();
        }
    }

    /// Adds a report of the driver about a script.
    pub(super) fn told_of_plan(&self, word: PlanReport) {
        let mut state = self.lock();
        if state.connection == 0 {
            return;
        }
        if state.words.len() < WORDS_MAX {
            state.words.push(word);
        } else {
            state.fault =
                Some(format!("the driver sent more than {WORDS_MAX} reports about scripts at once"));
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Removes and returns the driver's reports about scripts since the last call.
    pub(super) fn words(&self) -> Vec<PlanReport> {
        std::mem::take(&mut self.lock().words)
    }

    /// Stores an unsolicited sensor reading.
    pub(super) fn read_by_itself(&self, sensor: &DeviceId, reading: f64) {
        let now = self.now();
        let mut state = self.lock();
        let room = state.pushed.len() < PUSHED_MAX || state.pushed.contains_key(sensor);
        if state.connection > 0 && room {
            state.pushed.insert(sensor.clone(), (reading, now));
        }
    }

    /// Returns a sensor's last unsolicited reading, if it is not older than `within`.
    pub(super) fn pushed(&self, sensor: &DeviceId, within: Duration) -> Option<f64> {
        let now = self.now();
        let (reading, at) = *self.lock().pushed.get(sensor)?;
        (now.saturating_duration_since(at) <= within).then_some(reading)
    }

    /// Records the duration of a call, and whether it shows that the hardware is alive.
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

    /// Records that the reading of a sensor starts.
    pub(crate) fn begin_reading(&self) {
        if let Some(pulse) = &mut self.lock().pulse {
            pulse.begin_reading();
        }
    }

    /// Records that the reading of a sensor has ended.
    pub(crate) fn end_reading(&self) {
        if let Some(pulse) = &mut self.lock().pulse {
            pulse.end_reading();
        }
    }

    /// Returns how long the hardware has been silent, if this is too long for the pending commands; otherwise `None`.
    pub(crate) fn silence(&self) -> Option<Duration> {
        let now = self.now();
        let state = self.lock();
        state.pulse.as_ref()?.silence(now, self.tolerance.silence)
    }

    /// Returns the next work for the driver's thread: values first, then pings, then sensor readings if no movement is near.
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
            // Reports from before a fault or the end of a connection are still valid.
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
            // If a movement is near, the ping is attempted again after the movement.
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
            // A value that is due at the instant at which the movement starts is still set first.
            Order::Follow(key, movement) => self.waiting(key).follow = Some(movement),
            // If the queue of readings is full, a reading is not answered: its requester's time limit expires.
            Order::Read(id, sensor) if self.readings.len() < READINGS_MAX => {
                self.readings.push_back((id, sensor, now));
            }
            Order::Read(..) => {}
            Order::Plan(plan) => {
                if let PlanOrder::Cancel(PlanCancel { plan, .. }) = &plan {
                    // Drops those parts of the script that the driver has not received yet.
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

    /// Whether all orders that the question covers have been executed.
    fn is_done(&self, confirm: &Confirm) -> bool {
        let waits = |(device, _): &Key, since: u64| *device == confirm.device && since <= confirm.up_to;
        let in_hand =
            self.in_hand.iter().any(|(device, since)| *device == confirm.device && *since <= confirm.up_to);
        let planned =
            |(since, plan): &(u64, PlanOrder)| *plan.device() == confirm.device && *since <= confirm.up_to;
        let waits_for_plan = self.plans.iter().any(planned);
        !in_hand && !waits_for_plan && !self.values.iter().any(|(key, waiting)| waits(key, waiting.since))
    }

    /// Records that the hardware has answered.
    fn answered(&mut self) {
        let mut confirms = std::mem::take(&mut self.confirms);
        confirms.iter_mut().for_each(|confirm| confirm.answered |= self.is_done(confirm));
        self.confirms = confirms;
    }

    /// Removes and returns the tickets of the questions that can be answered: the hardware has taken the orders.
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

    /// Removes and returns the next script order, unless a value that was ordered earlier waits.
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
