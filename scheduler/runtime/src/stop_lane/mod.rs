//! The stop lane: a thread with a runtime of its own that stops the robots when the operator says so, whatever else has come
//! to a standstill in this process: the mission's loop, the terminal, the disk, the other links.
//!
//! It keeps a connection to every robot, knows which of their devices were sent anything (`sent.rs`), and sends nothing but
//! stops. It hears the signals and the mission's socket (`words.rs`), stops the robots first and hands the word on to the
//! mission, which stops them in its own way: it asks for confirmations, decides and reports. Once the operator has said stop,
//! nothing that moves leaves this process, except the way home if the operator requests it.

mod connection;
mod sent;
mod stopping;
mod words;

use std::collections::BTreeSet;
use std::io;
use std::sync::mpsc::sync_channel;

use tokio::runtime::{Builder, Handle};
use tokio::sync::{mpsc, watch};
use urrcp::{DeviceId, Message, SessionId};

pub(crate) use self::sent::Passage;
use self::sent::{Book, Sent};
use self::stopping::Guard;
pub use self::words::{MissionOver, Operator, Voice};
use crate::link::{Asked, Endpoint, Link, Waiting};
use crate::server_clock::ServerClock;
pub use crate::signals::OnHangUp;
use downbeat_mission::Rest;

/// Words that may wait for the mission.
const WORDS_MAX: usize = 64;

/// Whether the operator has said stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Alarm {
    Quiet,
    /// It is said; the latest word says how the robots come to rest.
    Ringing(Rest),
    /// The operator's latest command was home. All robots rest, and the mission moves them to their default positions.
    GoingHome,
}

/// What an earlier process of the mission has moved.
#[derive(Clone, Debug, Default)]
pub(crate) struct Before {
    /// As the robots know it.
    pub(crate) session: Option<SessionId>,
    /// The devices of each robot, by its index.
    pub(crate) devices: Vec<BTreeSet<DeviceId>>,
}

/// The mission's end of the lane. When it is dropped the robots are let go; signals are heard to the end of the process.
#[derive(Debug)]
pub struct StopLane {
    runtime: Handle,
    voice: Voice,
    alarm: watch::Receiver<Alarm>,
    robots: Vec<Book>,
    /// The robots' tasks end with it.
    over: watch::Sender<()>,
}

impl StopLane {
    /// Starts the thread, which hears the signals from now on. Also returns what the operator says, for the mission.
    ///
    /// # Errors
    /// The system gives no thread, no runtime or no signal handlers.
    pub fn start(on_hang_up: OnHangUp) -> io::Result<(Self, mpsc::Receiver<Operator>)> {
        Self::hearing(Some(on_hang_up))
    }

    /// The same for a mission that moves nothing: the lane hears no signals, so that one of them ends the process.
    ///
    /// # Errors
    /// Same as [`start`](Self::start), except for signal handlers.
    pub fn deaf() -> io::Result<(Self, mpsc::Receiver<Operator>)> {
        Self::hearing(None)
    }

    fn hearing(on_hang_up: Option<OnHangUp>) -> io::Result<(Self, mpsc::Receiver<Operator>)> {
        let (mission, operator) = mpsc::channel(WORDS_MAX);
        let (ring, alarm) = watch::channel(Alarm::Quiet);
        let voice = Voice::new(mission, ring);
        let of_signals = voice.clone();
        let (ready, started) = sync_channel(1);
        // Ends with the process: signals have to be heard as long as it lives.
        std::thread::Builder::new().name("stop-lane".to_owned()).spawn(move || {
            let runtime = match Builder::new_current_thread().enable_all().build() {
                Ok(runtime) => runtime,
                Err(error) => return drop(ready.send(Err(error))),
            };
            runtime.block_on(async {
                let Some(on_hang_up) = on_hang_up else {
                    let _waited_for = ready.send(Ok(Handle::current()));
                    return std::future::pending().await;
                };
                match crate::signals::Signals::of_scheduler(on_hang_up) {
                    Ok(signals) => {
                        let _waited_for = ready.send(Ok(Handle::current()));
                        words::hear(signals, of_signals).await;
                    }
                    Err(error) => drop(ready.send(Err(error))),
                }
            });
        })?;
        let gone = |_| io::Error::other("the stop lane has ended");
        let runtime = started.recv().map_err(gone)??;
        let (robots, over) = (Vec::new(), watch::Sender::new(()));
        Ok((Self { runtime, voice, alarm, robots, over }, operator))
    }

    /// By which others speak for the operator.
    #[must_use]
    pub fn voice(&self) -> Voice {
        self.voice.clone()
    }

    /// The runtime of the lane, for what has to hear a stop whatever else stands still.
    #[must_use]
    pub const fn runtime(&self) -> &Handle {
        &self.runtime
    }

    /// Completes once the operator has requested a stop.
    pub fn is_stopped(&self) -> impl Future<Output = ()> + use<> {
        let mut alarm = self.alarm.clone();
        async move {
            if alarm.wait_for(|alarm| *alarm != Alarm::Quiet).await.is_err() {
                // The lane has ended with the process.
                std::future::pending().await
            }
        }
    }

    /// Takes the mission's robots into its care, in their order. `before` is what another process has moved of them under this
    /// session. What they answer to stops goes to `events`.
    pub(crate) fn guard(
        &mut self,
        endpoints: &[Endpoint],
        before: &Before,
        clock: ServerClock,
        events: &mpsc::Sender<Waiting>,
    ) {
        for (robot, endpoint) in endpoints.iter().enumerate() {
            let devices = before.devices.get(robot).cloned().unwrap_or_default();
            let sent = watch::Sender::new(Sent::before(&devices, before.session.clone()));
            let guard = Guard {
                robot,
                endpoint: endpoint.clone(),
                clock,
                asked: Asked::default(),
                events: events.clone(),
                sent: sent.subscribe(),
                alarm: self.alarm.clone(),
            };
            let mut over = self.over.subscribe();
            self.runtime.spawn(async move {
                tokio::select! {
                    // The mission's end has been dropped.
                    _ = over.changed() => {}
                    () = guard.keep() => {}
                }
            });
            self.robots.push(Book::new(sent));
        }
    }

    /// The mission is over: what it leaves as it is stays so, also if the operator says stop now.
    pub(crate) fn let_go(&self) {
        self.voice.ended();
        self.over.send_replace(());
    }

    /// The mission's loop continues.
    pub(crate) fn turned(&self) {
        self.voice.turned();
    }

    /// Lets the way home pass, unless the operator has stopped the mission in another way meanwhile.
    pub(crate) fn goes_home(&self) {
        self.voice.goes_home();
    }

    /// The mission has made a link to a robot.
    pub(crate) fn links(&self, robot: usize, link: &Link) {
        self.robots[robot].links(link);
    }

    /// A link of the mission stands, so the robot can be reached.
    pub(crate) fn reached(&self, robot: usize) {
        self.robots[robot].reached();
    }

    /// Notes what the mission is about to send, and says whether it may.
    pub(crate) fn passes(&self, robot: usize, message: &Message) -> Passage {
        match self.robots[robot].note(message) {
            sent::Moves::Nothing => Passage::Open,
            // It is noted first and looked second: either the lane knows of it, or it is not sent.
            sent::Moves::Devices if matches!(*self.alarm.borrow(), Alarm::Ringing(_)) => Passage::Closed,
            sent::Moves::Devices => Passage::Open,
        }
    }
}
