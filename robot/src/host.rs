//! Runs robots in real time: one thread of its own that wakes precisely, however many robots live on it.

mod body;
mod executor;
mod hosted;
mod log;
mod outbox;

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::sync::{Semaphore, oneshot, watch};
use urrcp::{ControlType, Device, InitializationBlock, KnownScripts, LINE_BYTES_MAX, Message, RobotId};

use self::body::Body;
use self::executor::{Order, Told, prepared_thread};
use self::hosted::DriverThread;
pub use self::hosted::Hosted;
use self::outbox::{Inbox, outbox};
use crate::budget::Strangers;
use crate::driver::Mailbox;
use crate::figures::Figures;
use crate::ids::LinkId;
use crate::parties::Claimant;
use crate::peer::Peer;
use crate::refusals::Refusals;
use crate::robot::Input;
use downbeat_realtime::{Realtime, Scheduling};

/// Inputs that a peer outside this process may have handed over and the robot not yet taken; more have to wait.
const WINDOW: usize = 32;

/// How robots are run.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct HostOptions {
    /// Whether the precise thread asks for real-time scheduling, and for the process's memory to be locked.
    pub realtime: Realtime,
    /// Write everything that is set to this file, a JSON line each.
    pub log: Option<PathBuf>,
}

impl HostOptions {
    /// The same with real-time scheduling asked for, or not.
    #[must_use]
    pub const fn with_realtime(mut self, realtime: Realtime) -> Self {
        self.realtime = realtime;
        self
    }

    /// The same with a log file.
    #[must_use]
    pub fn with_log(mut self, path: PathBuf) -> Self {
        self.log = Some(path);
        self
    }
}

/// A host could not be started.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HostError {
    /// The log file cannot be written.
    #[error("cannot write the log {}: {error}", path.display())]
    Log {
        /// Which file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// The system gives no thread.
    #[error("cannot start a thread for the robots: {0}")]
    Thread(io::Error),
    /// What is required was not granted.
    #[error("{0}")]
    Realtime(Scheduling),
}

/// A robot whose hardware was moved and, when its host stopped, may not be at rest.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the devices of `{robot}` may not be at rest: {reason}")]
#[non_exhaustive]
pub struct NotAtRest {
    /// Id of the robot.
    pub robot: RobotId,
    /// Why its devices may not rest, as a sentence without a full stop.
    pub reason: String,
}

/// What comes back on a link.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "nearly all values are messages")]
pub enum LinkEvent {
    /// The robot says something.
    Message(Message),
    /// The robot has closed the link.
    Closed,
}

/// Robots running on a precise thread.
#[derive(Debug)]
pub struct Host {
    handle: HostHandle,
    scheduling: Scheduling,
    thread: Option<JoinHandle<()>>,
    writer: Option<JoinHandle<()>>,
    log_lost: Option<oneshot::Receiver<HostError>>,
    /// With the index of their robot.
    drivers: Vec<(usize, DriverThread)>,
    mailboxes: Vec<Arc<Mailbox>>,
}

/// Opens links to the robots of a host.
#[derive(Clone, Debug)]
pub struct HostHandle {
    orders: flume::Sender<Order>,
    robots: Arc<[RobotId]>,
    next_link: Arc<AtomicU64>,
    refusals: Arc<Refusals>,
    figures: Arc<Figures>,
    strangers: Arc<Strangers>,
    scripts: KnownScripts,
    owners: Arc<[watch::Receiver<Option<Claimant>>]>,
    /// The maximum length of a command for each robot, in bytes.
    longest: Arc<[usize]>,
}

/// A link to one robot. Dropping it breaks the link.
#[derive(Debug)]
pub struct RobotLink {
    orders: flume::Sender<Order>,
    robot: usize,
    link: LinkId,
    incoming: Inbox,
}

/// The sending end of a link, for use next to the receiving end.
#[derive(Clone, Debug)]
pub(crate) struct LinkSender {
    orders: flume::Sender<Order>,
    robot: usize,
    link: LinkId,
    window: Arc<Semaphore>,
}

impl Host {
    /// Starts the robots.
    ///
    /// # Errors
    /// [`HostError`] when the log cannot be written, or the system gives no thread or not what is required. Then nothing
    /// was connected to or moved.
    pub fn start<R: Into<Hosted>>(robots: Vec<R>, options: HostOptions) -> Result<Self, HostError> {
        let hosted: Vec<Hosted> = robots.into_iter().map(Into::into).collect();
        let ids: Arc<[RobotId]> = hosted.iter().map(|hosted| hosted.id().clone()).collect();
        let (log, writer) = match options.log {
            None => (None, None),
            Some(path) => {
                let (log, writer) = log::start(path, Arc::clone(&ids))?;
                (Some(log), Some(writer))
            }
        };
        let (writer, log_lost) = writer.map(|writer| (writer.thread, writer.lost)).unzip();
        // With a lock: on a lock-free channel a real-time thread could spin forever for a sender that it interrupted.
        let (orders, inbox) = flume::unbounded();
        let (owners, watched): (Vec<_>, Vec<_>) = ids.iter().map(|_| watch::channel(None)).unzip();
        let handle = HostHandle {
            orders,
            figures: Arc::new(Figures::of(ids.len())),
            robots: ids,
            next_link: Arc::new(AtomicU64::new(0)),
            refusals: Arc::default(),
            strangers: Arc::default(),
            scripts: KnownScripts::default(),
            owners: watched.into(),
            longest: hosted.iter().map(|hosted| longest_command(hosted.block())).collect(),
        };
        let told = Told {
            log,
            owners,
            refusals: Arc::clone(&handle.refusals),
            figures: Arc::clone(&handle.figures),
        };
        let (thread, ready, scheduling) = prepared_thread(options.realtime, told, inbox)?;
        let (mut robots, mut drivers) = (Vec::new(), Vec::new());
        for (index, hosted) in hosted.into_iter().enumerate() {
            let (robot, thread) = hosted.attach(index, &handle.orders).map_err(HostError::Thread)?;
            robots.push(robot);
            drivers.extend(thread.map(|thread| (index, thread)));
        }
        let mailboxes: Vec<_> = robots.iter().filter_map(Body::mailbox).collect();
        // The thread waits for nothing else.
        let _always_taken = ready.send(robots);
        Ok(Self { handle, scheduling, thread: Some(thread), writer, log_lost, drivers, mailboxes })
    }

    /// Waits until every driver has tried to connect once, so that the next answer states the result. Returns whether all of
    /// them have.
    #[expect(clippy::disallowed_methods, reason = "drivers connect in real time")]
    pub fn await_hardware(&self, patience: Duration) -> bool {
        let until = std::time::Instant::now() + patience;
        self.mailboxes.iter().all(|mailbox| mailbox.await_tried(until))
    }

    /// What the precise thread was granted.
    #[must_use]
    pub const fn scheduling(&self) -> &Scheduling {
        &self.scheduling
    }

    /// Opens links to these robots.
    #[must_use]
    pub fn handle(&self) -> HostHandle {
        self.handle.clone()
    }

    /// How often peers were refused, slowed down or hung up on, and why.
    #[must_use]
    pub fn refusals(&self) -> &Refusals {
        &self.handle.refusals
    }

    /// Counts of its robots, which change as they play.
    #[must_use]
    pub fn figures(&self) -> Arc<Figures> {
        Arc::clone(&self.handle.figures)
    }

    /// Hears why the log ends ahead of the robots, which continue without it; nothing where it does not. To be taken once.
    pub const fn log_lost(&mut self) -> Option<oneshot::Receiver<HostError>> {
        self.log_lost.take()
    }

    /// Stops the robots where they are and completes the log. Hardware that moves comes to rest; returns the robots of which that
    /// is not certain.
    pub fn stop(mut self) -> Vec<NotAtRest> {
        self.shut_down()
    }

    fn shut_down(&mut self) -> Vec<NotAtRest> {
        let _already_gone = self.handle.orders.send(Order::Stop);
        for thread in [self.thread.take(), self.writer.take()].into_iter().flatten() {
            if thread.join().is_err() {
                tracing::error!("a thread of the robots' host panicked");
            }
        }
        let mut not_at_rest = Vec::new();
        for (index, thread) in self.drivers.drain(..) {
            let ended = thread.join().unwrap_or_else(|_| Err("its driver panicked".to_owned()));
            let robot = &self.handle.robots[index];
            not_at_rest.extend(ended.err().map(|reason| NotAtRest { robot: robot.clone(), reason }));
        }
        not_at_rest
    }
}

/// A generous upper bound on the bytes of a command for one of these devices: a step with one value takes fewer than 200.
fn longest_command(block: &InitializationBlock) -> usize {
    const STEP: usize = 512;
    let of_device = |device: &Device| {
        let types = &device.available_control_types;
        let has_custom = types.iter().any(|(control_type, _)| matches!(control_type, ControlType::Custom(_)));
        let steps = types.script().map_or(0, |script| script.max_number_of_steps as usize);
        if has_custom { LINE_BYTES_MAX } else { steps.saturating_mul(STEP) }
    };
    block.devices.iter().map(of_device).max().unwrap_or_default().min(LINE_BYTES_MAX)
}

impl Drop for Host {
    fn drop(&mut self) {
        for robot in self.shut_down() {
            tracing::error!("{robot}");
        }
    }
}

impl HostHandle {
    /// The robots, in the order of their indices.
    #[must_use]
    pub fn robots(&self) -> &[RobotId] {
        &self.robots
    }

    /// The maximum length of a command for the robot of this link, in bytes.
    pub(crate) fn longest_command(&self, link: &RobotLink) -> usize {
        self.longest.get(link.robot).copied().unwrap_or(LINE_BYTES_MAX)
    }

    /// Opens a link to a robot from within this process; `None` when there is no such robot or the host has stopped.
    #[must_use]
    pub fn connect(&self, robot: usize) -> Option<RobotLink> {
        self.connect_as(robot, Peer::in_process())
    }

    /// Opens a link to a robot for a peer; `None` when there is no such robot or the host has stopped. What the peer leaves
    /// unread is bounded, unless it is in this process, and a session that it claims belongs to its name.
    #[must_use]
    pub fn connect_as(&self, robot: usize, peer: Peer) -> Option<RobotLink> {
        if robot >= self.robots.len() {
            return None;
        }
        let link = LinkId(self.next_link.fetch_add(1, Ordering::Relaxed));
        let proof = peer.proof().cloned();
        let (outbox, incoming) = outbox(peer);
        self.orders.send(Order::Open { robot, link, outbox }).ok()?;
        let link = RobotLink { orders: self.orders.clone(), robot, link, incoming };
        proof.into_iter().for_each(|proof| link.order(Input::Proven(proof)));
        Some(link)
    }

    /// Counts of the robots, which change as they play.
    #[must_use]
    pub fn figures(&self) -> Arc<Figures> {
        Arc::clone(&self.figures)
    }

    /// Whether the precise thread answers within this time.
    pub async fn answers_within(&self, patience: Duration) -> bool {
        let (answer, answered) = oneshot::channel();
        let asked = self.orders.send(Order::Beat { answer }).is_ok();
        asked && tokio::time::timeout(patience, answered).await.is_ok_and(|answered| answered.is_ok())
    }

    /// Whether no robot runs here any more.
    pub(crate) fn has_stopped(&self) -> bool {
        self.orders.is_disconnected()
    }

    /// How often peers were refused, slowed down or hung up on, and why.
    #[must_use]
    pub fn refusals(&self) -> &Refusals {
        &self.refusals
    }

    /// What all peers share that have no robot of this host.
    pub(crate) fn strangers(&self) -> Arc<Strangers> {
        Arc::clone(&self.strangers)
    }

    /// Scripts that came last: often several robots of a host get the same one.
    pub(crate) const fn scripts(&self) -> &KnownScripts {
        &self.scripts
    }

    /// To whom a robot belongs, or belonged last, as it changes.
    pub(crate) fn owner(&self, robot: usize) -> Option<watch::Receiver<Option<Claimant>>> {
        self.owners.get(robot).cloned()
    }

    /// Lets a robot look whether its session is over. Back when it has, or the host has stopped.
    pub(crate) async fn look(&self, robot: usize) {
        let (permit, looked) = oneshot::channel();
        let _stopped = self.orders.send(Order::Look { robot, permit });
        let _stopped = looked.await;
    }
}

impl RobotLink {
    /// Sends a message to the robot, and hashes here what the robot has to compare. A host that has stopped takes none; [`RobotLink::recv`] says so.
    pub fn send(&self, message: Message) {
        self.order(Input::read(message));
    }

    fn order(&self, input: Input) {
        let order = Order::Input { robot: self.robot, link: self.link, input, permit: None };
        let _stopped = self.orders.send(order);
    }

    /// What the robot says next; `None` once the host has stopped.
    pub async fn recv(&mut self) -> Option<LinkEvent> {
        self.incoming.recv().await
    }

    /// What the robot has said already.
    pub(crate) fn try_recv(&mut self) -> Option<LinkEvent> {
        self.incoming.try_recv()
    }

    pub(crate) fn sender(&self) -> LinkSender {
        let window = Arc::new(Semaphore::new(WINDOW));
        LinkSender { orders: self.orders.clone(), robot: self.robot, link: self.link, window }
    }
}

impl LinkSender {
    /// Sends once the robot keeps up, so that a peer can never make the host hold more than [`WINDOW`] of its inputs.
    pub(crate) async fn send(&self, input: Input) {
        // The window is never closed, so there always is a permit in the end.
        let permit = Arc::clone(&self.window).acquire_owned().await.ok();
        let _stopped = self.orders.send(Order::Input { robot: self.robot, link: self.link, input, permit });
    }
}

impl Drop for RobotLink {
    fn drop(&mut self) {
        self.order(Input::LinkDown);
    }
}

#[cfg(test)]
pub(crate) mod tests;
