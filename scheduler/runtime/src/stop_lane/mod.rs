//! The stop lane: a thread with its own runtime that stops the robots on the operator's command, even if everything else in this process
//! is blocked: the mission's loop, the terminal, the disk, the other links.
//!
//! The lane keeps a connection to every robot, tracks which of its devices were sent commands (`sent.rs`), and sends only stops. It
//! receives the signals and the commands from the mission's socket (`words.rs`). It stops the robots first and then forwards the command
//! to the mission. The mission also stops the robots in its own way: it requests confirmations, decides and reports. After a stop
//! command, no message that moves a robot leaves this process, except motions home if the operator requests them.

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
use self::sent::{Sent, SentScripts};
use self::stopping::Guard;
pub use self::words::{MissionOver, Operator, OperatorHandle};
use crate::link::{Endpoint, Link, SharedAllowance, Waiting};
use crate::server_clock::ServerClock;
pub use crate::signals::OnHangUp;
use downbeat_mission::{Rest, RobotIndex};

/// Maximum number of the operator's commands that may wait for the mission.
const WORDS_MAX: usize = 64;

/// The operator's latest stop command, if any.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Alarm {
    Quiet,
    /// A stop was requested. The contained value states how the robots come to rest, as the latest command requires.
    Ringing(Rest),
    /// The operator's latest stop command sends robots home. All robots rest, and the mission moves them to their default positions.
    GoingHome,
}

/// The session of a mission that an earlier process began, and the devices that this earlier process has moved.
#[derive(Clone, Debug, Default)]
pub(crate) struct Before {
    /// The session as the robots know it. `None` without a session.
    pub(crate) session: Option<SessionId>,
    /// The moved devices of each robot, in the order of the mission's robots.
    pub(crate) devices: Vec<BTreeSet<DeviceId>>,
}

/// The mission's handle to the stop lane. When it is dropped, the lane no longer guards the robots. It still handles signals until the
/// process ends.
#[derive(Debug)]
pub struct StopLane {
    runtime: Handle,
    voice: OperatorHandle,
    alarm: watch::Receiver<Alarm>,
    robots: Vec<SentScripts>,
    /// The tasks that guard the robots end when this sender is dropped.
    over: watch::Sender<()>,
}

impl StopLane {
    /// Starts the lane's thread. The lane handles signals from that moment. Also returns the channel through which the mission receives
    /// the operator's commands.
    ///
    /// # Errors
    /// Fails if the operating system cannot provide a thread, a runtime or signal handlers.
    pub fn start(on_hang_up: OnHangUp) -> io::Result<(Self, mpsc::Receiver<Operator>)> {
        Self::hearing(Some(on_hang_up))
    }

    /// Like [`start`](Self::start), but for a mission that moves nothing: the lane handles no signals, so a signal ends the process.
    ///
    /// # Errors
    /// Fails if the operating system cannot provide a thread or a runtime.
    pub fn deaf() -> io::Result<(Self, mpsc::Receiver<Operator>)> {
        Self::hearing(None)
    }

    fn hearing(on_hang_up: Option<OnHangUp>) -> io::Result<(Self, mpsc::Receiver<Operator>)> {
        let (mission, operator) = mpsc::channel(WORDS_MAX);
        let (ring, alarm) = watch::channel(Alarm::Quiet);
        let voice = OperatorHandle::new(mission, ring);
        let of_signals = voice.clone();
        let (ready, started) = sync_channel(1);
        // This thread ends with the process, because signals must be handled until then.
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
        let gone = |_| io::Error::other("the thread that stops robots has ended");
        let runtime = started.recv().map_err(gone)??;
        let (robots, over) = (Vec::new(), watch::Sender::new(()));
        Ok((Self { runtime, voice, alarm, robots, over }, operator))
    }

    /// Returns a handle that sends commands to the mission as the operator.
    #[must_use]
    pub fn voice(&self) -> OperatorHandle {
        self.voice.clone()
    }

    /// Returns the runtime of the lane, for tasks that must receive a stop even if everything else is blocked.
    #[must_use]
    pub const fn runtime(&self) -> &Handle {
        &self.runtime
    }

    /// Returns a future that completes once the operator has requested a stop.
    pub fn is_stopped(&self) -> impl Future<Output = ()> + use<> {
        let mut alarm = self.alarm.clone();
        async move {
            if alarm.wait_for(|alarm| *alarm != Alarm::Quiet).await.is_err() {
                // The lane has ended with the process.
                std::future::pending().await
            }
        }
    }

    /// Starts guarding the mission's robots, given in the mission's order. `before` lists the devices that another process has moved in
    /// this session. The robots' responses to stops are sent to `events`.
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
                robot: RobotIndex::new(robot),
                endpoint: endpoint.clone(),
                clock,
                asked: SharedAllowance::default(),
                events: events.clone(),
                sent: sent.subscribe(),
                alarm: self.alarm.clone(),
            };
            let mut over = self.over.subscribe();
            self.runtime.spawn(async move {
                tokio::select! {
                    // The mission's handle has been dropped.
                    _ = over.changed() => {}
                    () = guard.keep() => {}
                }
            });
            self.robots.push(SentScripts::new(sent));
        }
    }

    /// Ends the lane's work when the mission is over. The robots stay as the mission leaves them, even if the operator then requests a
    /// stop.
    pub(crate) fn let_go(&self) {
        self.voice.ended();
        self.over.send_replace(());
    }

    /// Records that the mission's loop has completed an iteration, which shows that it is not blocked.
    pub(crate) fn turned(&self) {
        self.voice.turned();
    }

    /// Permits the mission to move robots home, unless the operator has requested a stop in place meanwhile.
    pub(crate) fn goes_home(&self) {
        self.voice.goes_home();
    }

    /// Registers a link that the mission has made to a robot.
    pub(crate) fn links(&self, robot: RobotIndex, link: &Link) {
        self.robots[robot.get()].links(link);
    }

    /// Records that a link of the mission is up, so the robot can be reached.
    pub(crate) fn reached(&self, robot: RobotIndex) {
        self.robots[robot.get()].reached();
    }

    /// Notes the message that the mission is about to send, and returns whether it may be sent.
    pub(crate) fn passes(&self, robot: RobotIndex, message: &Message) -> Passage {
        match self.robots[robot.get()].note(message) {
            sent::Moves::Nothing => Passage::Open,
            // Noted first, checked second: either the lane knows of the message, or it is not sent.
            sent::Moves::Devices if matches!(*self.alarm.borrow(), Alarm::Ringing(_)) => Passage::Closed,
            sent::Moves::Devices => Passage::Open,
        }
    }
}
