//! What is still to be set, between the precise thread and a driver's own.
//!
//! For each signal of each device at most one value waits, and one movement that begins behind it: newer ones take their
//! place. Whoever puts something in never waits for the driver.
#![expect(clippy::disallowed_methods, reason = "waits until the next sample or ping is due")]

use std::collections::hash_map::Entry;
use std::collections::{HashMap, VecDeque};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use urrcp::{ControlType, DeviceId, Setpoint};

use crate::clock::HostClock;
use crate::hardware::{READINGS_MAX, ReadingId};
use crate::signal::Signal;

/// One signal of one device.
pub(crate) type Key = (DeviceId, ControlType);

/// A signal that moves, with the clock on which it does.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Movement {
    pub(crate) signal: Signal,
    pub(crate) clock: HostClock,
}

/// What the machine wants of the hardware.
#[derive(Clone, Debug)]
pub(crate) enum Order {
    Set(Key, Setpoint),
    Follow(Key, Movement),
    Read(ReadingId, DeviceId),
}

/// What a driver's thread does next.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "nearly every one is to drive something")]
pub(crate) enum Work {
    /// Set this, then follow that.
    Drive(Key, Option<Setpoint>, Option<Movement>),
    Read(ReadingId, DeviceId),
    /// Nothing until the time that was asked for.
    Nothing,
    /// Nothing is left, and nothing more will come.
    Closed,
}

/// A reading is not begun so shortly before a movement: the hardware would be busy with it.
pub(crate) const QUIET: Duration = Duration::from_millis(20);
/// It is begun all the same once it has waited so long.
const READ_WAIT_MAX: Duration = Duration::from_millis(200);

#[derive(Debug, Default)]
struct State {
    /// Counts connections; 0 while there is none.
    connection: u64,
    values: HashMap<Key, Waiting>,
    /// The keys of `values`, the longest waiting first.
    order: VecDeque<Key>,
    readings: VecDeque<(ReadingId, DeviceId, Instant)>,
    next_due: Option<Instant>,
    /// A first try to connect has ended.
    tried: bool,
    closed: bool,
}

/// What waits for one signal.
#[derive(Debug, Default)]
struct Waiting {
    set: Option<Setpoint>,
    follow: Option<Movement>,
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
    pub(crate) fn post(
        &self,
        connection: u64,
        orders: impl Iterator<Item = Order>,
        next_due: Option<Instant>,
    ) {
        let mut state = self.lock();
        state.next_due = next_due;
        let mut any = false;
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
    pub(crate) fn connected(&self, connection: u64) {
        self.lock().connection = connection;
    }

    /// The connection is gone, and everything that waited for it.
    pub(crate) fn disconnected(&self) {
        let mut state = self.lock();
        state.connection = 0;
        state.values.clear();
        state.order.clear();
        state.readings.clear();
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

    /// Whether no movement is due so soon that a question to the hardware could delay it.
    pub(crate) fn is_quiet(&self) -> bool {
        self.lock().is_quiet(Instant::now())
    }

    /// The next thing to do: values first, then readings where no movement is near.
    pub(crate) fn next(&self, until: Instant) -> Work {
        let mut state = self.lock();
        loop {
            match state.take() {
                Some((key, Waiting { set, follow })) => return Work::Drive(key, set, follow),
                None if state.closed => return Work::Closed,
                None => {}
            }
            let now = Instant::now();
            let waited = |asked: &Instant| now.saturating_duration_since(*asked) >= READ_WAIT_MAX;
            let quiet = state.is_quiet(now);
            if state.readings.front().is_some_and(|(.., asked)| quiet || waited(asked))
                && let Some((id, sensor, _)) = state.readings.pop_front()
            {
                return Work::Read(id, sensor);
            }
            let Some(left) = until.checked_duration_since(now).filter(|left| !left.is_zero()) else {
                return Work::Nothing;
            };
            let left = if state.readings.is_empty() { left } else { left.min(QUIET) };
            state = self.wait(state, left);
        }
    }
}

impl State {
    fn is_quiet(&self, now: Instant) -> bool {
        self.next_due.is_none_or(|due| due > now + QUIET)
    }

    fn put(&mut self, order: Order) {
        match order {
            Order::Set(key, setpoint) => {
                *self.waiting(key) = Waiting { set: Some(setpoint), follow: None };
            }
            // A value that is due at the same instant is still set first.
            Order::Follow(key, movement) => self.waiting(key).follow = Some(movement),
            // One that finds no room is not answered, which its time limit tells.
            Order::Read(id, sensor) if self.readings.len() < READINGS_MAX => {
                self.readings.push_back((id, sensor, Instant::now()));
            }
            Order::Read(..) => {}
        }
    }

    fn waiting(&mut self, key: Key) -> &mut Waiting {
        match self.values.entry(key) {
            Entry::Occupied(waiting) => waiting.into_mut(),
            Entry::Vacant(place) => {
                self.order.push_back(place.key().clone());
                place.insert(Waiting::default())
            }
        }
    }

    fn take(&mut self) -> Option<(Key, Waiting)> {
        let key = self.order.pop_front()?;
        let value = self.values.remove(&key)?;
        Some((key, value))
    }
}
