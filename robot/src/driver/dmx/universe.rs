//! A universe, which all robots of this process share, and the thread that sends its frames.
#![expect(clippy::disallowed_methods, reason = "fades and frames on the monotonic clock")]

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::net::SocketAddr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use urrcp::RobotId;

use super::patch::{CHANNELS, Level, Slot};
use super::transport::{Transport, destination};
use super::{AtEnd, DmxAddress, FRAMES_PER_SECOND, Protocol};

/// Time for which a frame waits for values of other robots that are due at the same instant.
const COLLECT: Duration = Duration::from_micros(500);
/// Interval between frames while nothing changes. Receivers of sACN assume that a source has gone after 2.5 s.
const KEEP_ALIVE: Duration = Duration::from_millis(800);
/// Interval between two lists of universes (ANSI E1.31, 4.3).
const ANNOUNCE: Duration = Duration::from_secs(10);
/// Number of frames that may be sent without a pause, so that a value on time does not wait for the next regular frame.
const BURST: f64 = 4.0;

/// One universe of the process.
#[derive(Debug)]
pub(super) struct Universe {
    shared: Arc<Shared>,
    sender: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    sent: Condvar,
}

#[derive(Debug)]
struct State {
    transport: Transport,
    channels: BTreeMap<Slot, Channel>,
    /// The channels of each fixture.
    fixtures: Vec<(RobotId, BTreeSet<u16>)>,
    /// Number of changes so far, and the number of those that have been sent.
    changes: u64,
    sent: u64,
    /// When the first change was made that was not sent yet.
    unsent_since: Option<Instant>,
    /// When the last frame was sent. `None` before the first one: until a robot sets a value, nothing is sent.
    last: Option<Instant>,
    announced: Option<Instant>,
    budget: Budget,
    /// Why the last frame was not sent.
    error: Option<String>,
    is_closing: bool,
}

/// A channel or a pair of channels, and its level.
#[derive(Clone, Copy, Debug)]
struct Channel {
    level: f64,
    fade: Option<Fade>,
}

#[derive(Clone, Copy, Debug)]
struct Fade {
    from: f64,
    begin: Instant,
    duration: Duration,
}

impl Channel {
    const fn at(level: f64) -> Self {
        Self { level, fade: None }
    }

    /// Returns the level at an instant: the final one, or one on the way to it.
    fn level_at(&self, now: Instant) -> f64 {
        match self.fade {
            Some(Fade { from, begin, duration }) if now < begin + duration => {
                let share = now.saturating_duration_since(begin).as_secs_f64() / duration.as_secs_f64();
                from + (self.level - from) * share
            }
            _ => self.level,
        }
    }

    fn moves_at(&self, now: Instant) -> bool {
        self.fade.is_some_and(|fade| now < fade.begin + fade.duration)
    }
}

/// Limits the frames per second, and permits a few at once.
#[derive(Clone, Copy, Debug)]
struct Budget {
    frames: f64,
    at: Instant,
}

impl Budget {
    fn refill(&mut self, now: Instant) {
        let new = now.saturating_duration_since(self.at).as_secs_f64() * FRAMES_PER_SECOND;
        *self = Self { frames: (self.frames + new).min(BURST), at: now };
    }

    /// Returns when the next frame may be sent.
    fn next(&self) -> Instant {
        let missing = (1.0 - self.frames).max(0.0);
        self.at + Duration::from_secs_f64(missing / FRAMES_PER_SECOND)
    }
}

/// Where the frames of a universe go. Robots with equal places share a universe.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Place {
    protocol: Protocol,
    universe: u16,
    to: SocketAddr,
}

/// All universes of the process that a fixture uses.
static UNIVERSES: Mutex<Option<Universes>> = Mutex::new(None);

type Universes = HashMap<Place, Used>;

/// A universe that fixtures of the process use, or have used.
#[derive(Debug)]
struct Used {
    priority: u8,
    universe: Weak<Universe>,
}

impl Universe {
    /// Returns the universe of an address, and begins it if no other robot of the process uses it.
    pub(super) fn of(address: &DmxAddress) -> Result<Arc<Self>, String> {
        let host = || address.host.as_deref().unwrap_or("the universe's multicast address");
        let to = destination(address).map_err(|error| format!("{} cannot be resolved: {error}", host()))?;
        let place = Place { protocol: address.protocol, universe: address.universe, to };
        let mut universes = UNIVERSES.lock().unwrap_or_else(PoisonError::into_inner);
        let universes = universes.get_or_insert_default();
        if let Some(used) = universes.get(&place)
            && let Some(universe) = used.universe.upgrade()
        {
            return if used.priority == address.priority {
                Ok(universe)
            } else {
                let (number, theirs, own) = (address.universe, used.priority, address.priority);
                Err(format!(
                    "universe {number} has the priority {theirs} for another robot, and {own} for this one; give all robots of a universe the same priority"
                ))
            };
        }
        let transport =
            Transport::open(address, to).map_err(|error| format!("cannot open a socket: {error}"))?;
        let universe = Arc::new(Self::begin(transport)?);
        universes.retain(|_, used| used.universe.strong_count() > 0);
        universes.insert(place, Used { priority: address.priority, universe: Arc::downgrade(&universe) });
        Ok(universe)
    }

    fn begin(transport: Transport) -> Result<Self, String> {
        let now = Instant::now();
        let state = State {
            transport,
            channels: BTreeMap::new(),
            fixtures: Vec::new(),
            changes: 0,
            sent: 0,
            unsent_since: None,
            last: None,
            announced: None,
            budget: Budget { frames: BURST, at: now },
            error: None,
            is_closing: false,
        };
        let shared =
            Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new(), sent: Condvar::new() });
        let thread = std::thread::Builder::new().name("dmx".to_owned());
        let sender = thread.spawn({
            let shared = Arc::clone(&shared);
            move || shared.send_frames()
        });
        let sender = sender.map_err(|error| format!("cannot start a thread: {error}"))?;
        Ok(Self { shared, sender: Some(sender) })
    }

    /// Reserves the channels of a fixture. `defaults` are the levels that its channels have in frames of the universe until they are set.
    pub(super) fn lease(
        self: Arc<Self>,
        robot: &RobotId,
        channels: BTreeSet<u16>,
        defaults: &[Level],
        at_end: AtEnd,
    ) -> Result<Lease, String> {
        let mut state = self.shared.state();
        for (other, taken) in &state.fixtures {
            if let Some(channel) = taken.intersection(&channels).next() {
                return Err(format!("channel {} of the universe also belongs to `{other}`", channel + 1));
            }
        }
        for Level { slot, level } in defaults {
            state.channels.insert(*slot, Channel::at(*level));
        }
        state.fixtures.push((robot.clone(), channels.clone()));
        drop(state);
        Ok(Lease { universe: self, robot: robot.clone(), channels, at_end })
    }
}

impl Drop for Universe {
    fn drop(&mut self) {
        self.shared.state().is_closing = true;
        self.shared.changed.notify_all();
        if let Some(sender) = self.sender.take() {
            // A panic of the sender has been printed.
            let _ = sender.join();
        }
    }
}

/// The share of a fixture in its universe.
#[derive(Debug)]
pub(super) struct Lease {
    universe: Arc<Universe>,
    robot: RobotId,
    channels: BTreeSet<u16>,
    at_end: AtEnd,
}

impl Lease {
    /// Sets levels now.
    pub(super) fn set(&self, levels: &[Level]) {
        let mut state = self.universe.shared.state();
        for Level { slot, level } in levels {
            state.channels.insert(*slot, Channel::at(*level));
        }
        state.note_change(Instant::now());
        drop(state);
        self.universe.shared.changed.notify_all();
    }

    /// Moves to levels in `duration`.
    pub(super) fn fade(&self, levels: &[Level], duration: Duration) {
        let begin = Instant::now();
        let mut state = self.universe.shared.state();
        for Level { slot, level } in levels {
            let from = state.channels.get(slot).map_or(0.0, |channel| channel.level_at(begin));
            let fade = Some(Fade { from, begin, duration });
            state.channels.insert(*slot, Channel { level: *level, fade });
        }
        state.note_change(begin);
        drop(state);
        self.universe.shared.changed.notify_all();
    }

    /// Sends a frame again if the last one was not sent.
    pub(super) fn retry(&self) {
        let mut state = self.universe.shared.state();
        if state.error.take().is_some() {
            state.note_change(Instant::now());
        }
        drop(state);
        self.universe.shared.changed.notify_all();
    }

    /// Waits until all changes so far have been sent.
    ///
    /// # Errors
    /// The reason why they were not sent within `wait`.
    pub(super) fn flush(&self, wait: Duration) -> Result<(), String> {
        let shared = &self.universe.shared;
        let mut state = shared.state();
        let (goal, end) = (state.changes, Instant::now() + wait);
        loop {
            if let Some(error) = &state.error {
                return Err(error.clone());
            }
            let left = end.saturating_duration_since(Instant::now());
            if state.sent >= goal {
                return Ok(());
            }
            if left.is_zero() {
                return Err(format!("a frame was not sent within {} ms", wait.as_millis()));
            }
            state = shared.sent.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        let mut state = self.universe.shared.state();
        let now = Instant::now();
        state.fixtures.retain(|(robot, _)| *robot != self.robot);
        let has_sent = state.last.is_some();
        let own = state.channels.iter_mut().filter(|(slot, _)| self.channels.contains(&slot.coarse));
        for (_, channel) in own {
            *channel = match self.at_end {
                AtEnd::Hold => Channel::at(channel.level_at(now)),
                AtEnd::Blackout => Channel::at(0.0),
            };
        }
        if self.at_end == AtEnd::Blackout && has_sent {
            state.note_change(now);
        }
        drop(state);
        self.universe.shared.changed.notify_all();
    }
}

impl State {
    fn note_change(&mut self, now: Instant) {
        self.changes += 1;
        self.unsent_since.get_or_insert(now);
    }

    /// Returns the values of the channels, up to the last one that a fixture uses.
    fn frame(&self, now: Instant) -> Vec<u8> {
        let mut frame = [0; CHANNELS as usize];
        let mut length = 0;
        for (slot, channel) in &self.channels {
            let level = channel.level_at(now);
            let coarse = usize::from(slot.coarse);
            match slot.fine.map(usize::from) {
                None => frame[coarse] = scaled(level, u8::MAX.into()).to_be_bytes()[1],
                Some(fine) => [frame[coarse], frame[fine]] = scaled(level, u16::MAX).to_be_bytes(),
            }
            length = length.max(coarse + 1).max(slot.fine.map_or(0, |fine| usize::from(fine) + 1));
        }
        // Art-Net requires an even number of channels.
        frame[..(length + length % 2).max(2)].to_vec()
    }

    /// Returns when the next frame is due. `None` if nothing was ever set.
    fn next_frame(&self, now: Instant) -> Option<Instant> {
        let change = self.unsent_since.map(|since| (since + COLLECT).max(self.budget.next()));
        let moves = self.channels.values().any(|channel| channel.moves_at(now));
        let period = if moves { Duration::from_secs_f64(1.0 / FRAMES_PER_SECOND) } else { KEEP_ALIVE };
        let regular = self.last.map(|last| last + period);
        change.into_iter().chain(regular).min()
    }

    fn send(&mut self, now: Instant) {
        self.budget.refill(now);
        self.budget.frames -= 1.0;
        let frame = self.frame(now);
        let announcement = self.announced.is_none_or(|at| now >= at + ANNOUNCE);
        let announced = if announcement { self.transport.announce() } else { Ok(()) };
        if announcement {
            self.announced = Some(now);
        }
        let sent = announced.and_then(|()| self.transport.send(&frame));
        self.error = sent.err().map(|error| match error.kind() {
            std::io::ErrorKind::ConnectionRefused => "no program of the receiver takes frames".to_owned(),
            _ => format!("the network does not take frames: {error}"),
        });
        (self.last, self.unsent_since, self.sent) = (Some(now), None, self.changes);
        for channel in self.channels.values_mut().filter(|channel| !channel.moves_at(now)) {
            channel.fade = None;
        }
    }
}

/// Returns a level, 0 to 1, as a share of `max`.
fn scaled(level: f64, max: u16) -> u16 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and `max`")]
    let scaled = (level.clamp(0.0, 1.0) * f64::from(max)).round() as u16;
    scaled
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn send_frames(&self) {
        let mut state = self.state();
        loop {
            let now = Instant::now();
            state.budget.refill(now);
            let next = state.next_frame(now);
            if next.is_some_and(|next| next <= now) || (state.is_closing && state.unsent_since.is_some()) {
                state.send(now);
                self.sent.notify_all();
                continue;
            }
            if state.is_closing {
                break;
            }
            let wait = next.map_or(KEEP_ALIVE, |next| next - now);
            state = self.changed.wait_timeout(state, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
        if state.last.is_some() {
            let frame = state.frame(Instant::now());
            if let Err(error) = state.transport.end(&frame) {
                tracing::warn!("receivers were not informed of the end of a universe: {error}");
            }
        }
    }
}
