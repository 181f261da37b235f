//! Runs robots in real time. All robots of a host share one precise thread, which wakes them on time.

mod audit;
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
#[cfg(any(feature = "sealed", feature = "tls"))]
use urrcp::Label;
use urrcp::{ControlType, Device, InitializationBlock, KnownScripts, LINE_BYTES_MAX, Message, RobotId};

use self::audit::Audit;
pub use self::audit::numbered as audit_file;
use self::body::Body;
use self::executor::{Destinations, Order, prepared_thread};
use self::hosted::DriverThread;
pub use self::hosted::Hosted;
use self::outbox::{Inbox, outbox};
use crate::budget::Strangers;
use crate::driver::Mailbox;
use crate::figures::Figures;
use crate::ids::LinkId;
use crate::newcomers::Newcomers;
use crate::parties::Claimant;
use crate::peer::Peer;
use crate::refusals::Refusals;
use crate::robot::Input;
use downbeat_realtime::{Realtime, Scheduling};

/// Maximum number of inputs of one peer outside this process that wait for the robot. Further inputs are read later.
const WINDOW: usize = 32;

/// Options for a host that runs robots.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct HostOptions {
    /// Whether the precise thread requests real-time scheduling and locked process memory.
    pub realtime: Realtime,
    /// Log file for all values that are set, as one JSON line per value. `None`: no log.
    pub log: Option<PathBuf>,
    /// File of the audit trail ([`crate::audit`]), which the host continues if it exists. `None`: no trail.
    pub audit: Option<PathBuf>,
}

impl HostOptions {
    /// Sets whether real-time scheduling and locked memory are requested.
    #[must_use]
    pub const fn with_realtime(mut self, realtime: Realtime) -> Self {
        self.realtime = realtime;
        self
    }

    /// Sets the log file.
    #[must_use]
    pub fn with_log(mut self, path: PathBuf) -> Self {
        self.log = Some(path);
        self
    }

    /// Sets the file of the audit trail.
    #[must_use]
    pub fn with_audit(mut self, path: PathBuf) -> Self {
        self.audit = Some(path);
        self
    }
}

/// An error that prevents the start of a host.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HostError {
    /// The log file cannot be written.
    #[error("cannot write the log {}: {error}", path.display())]
    Log {
        /// Path of the log file.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
    /// The audit trail cannot be written.
    #[error("cannot write the audit trail {}: {error}", path.display())]
    Audit {
        /// Path of the trail's newest file.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
    /// The system could not create a thread. Contains the system's error.
    #[error("cannot start a thread for the robots: {0}")]
    Thread(io::Error),
    /// The required scheduling was not granted. Contains the scheduling that was granted.
    #[error("{0}")]
    Realtime(Scheduling),
}

/// A robot whose hardware was moved, and may not be at rest although its host has stopped.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the devices of `{robot}` may not be at rest: {reason}")]
#[non_exhaustive]
pub struct NotAtRest {
    /// Id of the robot.
    pub robot: RobotId,
    /// Reason why the robot's devices may not be at rest, as a sentence without a full stop.
    pub reason: String,
}

/// An event on a link to a robot.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "nearly all values are messages")]
pub enum LinkEvent {
    /// A message from the robot.
    Message(Message),
    /// The robot has closed the link.
    Closed,
}

/// A set of running robots. A single thread with precise timing (the "precise thread") runs all of them.
#[derive(Debug)]
pub struct Host {
    handle: HostHandle,
    scheduling: Scheduling,
    thread: Option<JoinHandle<()>>,
    writer: Option<JoinHandle<()>>,
    auditor: Option<JoinHandle<()>>,
    log_lost: Option<oneshot::Receiver<HostError>>,
    /// Threads of the drivers, each with the index of its robot.
    drivers: Vec<(usize, DriverThread)>,
    mailboxes: Vec<Arc<Mailbox>>,
}

/// A handle that opens links to the robots of a host. Clones refer to the same host.
#[derive(Clone, Debug)]
pub struct HostHandle {
    orders: flume::Sender<Order>,
    robots: Arc<[RobotId]>,
    next_link: Arc<AtomicU64>,
    refusals: Arc<Refusals>,
    figures: Arc<Figures>,
    strangers: Arc<Strangers>,
    newcomers: Arc<Newcomers>,
    audit: Option<Audit>,
    scripts: KnownScripts,
    owners: Arc<[watch::Receiver<Option<Claimant>>]>,
    /// Maximum length of a command in bytes, one entry per robot.
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

/// The sending half of a link. It is used while another task receives from the link.
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
    /// [`HostError`] if the log cannot be written, the system cannot create a thread, or the required scheduling is not granted. In these
    /// cases no hardware was connected or moved.
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
        let audit = options.audit.map(|path| audit::start(path, Arc::clone(&ids))).transpose()?;
        let (audit, auditor) = audit.unzip();
        let (writer, log_lost) = writer.map(|writer| (writer.thread, writer.lost)).unzip();
        // This channel uses a lock: on a lock-free channel, a real-time thread could spin forever for a sender that it interrupted.
        let (orders, inbox) = flume::unbounded();
        let (owners, watched): (Vec<_>, Vec<_>) = ids.iter().map(|_| watch::channel(None)).unzip();
        let handle = HostHandle {
            orders,
            figures: Arc::new(Figures::of(ids.len())),
            robots: ids,
            next_link: Arc::new(AtomicU64::new(0)),
            refusals: Arc::default(),
            strangers: Arc::default(),
            newcomers: Arc::default(),
            audit,
            scripts: KnownScripts::default(),
            owners: watched.into(),
            longest: hosted.iter().map(|hosted| longest_command(hosted.block())).collect(),
        };
        let told = Destinations {
            log,
            owners,
            refusals: Arc::clone(&handle.refusals),
            figures: Arc::clone(&handle.figures),
            audit: handle.audit.clone(),
        };
        let (thread, ready, scheduling) = prepared_thread(options.realtime, told, inbox)?;
        let (mut robots, mut drivers) = (Vec::new(), Vec::new());
        for (index, hosted) in hosted.into_iter().enumerate() {
            let (robot, thread) = hosted.attach(index, &handle.orders).map_err(HostError::Thread)?;
            robots.push(robot);
            drivers.extend(thread.map(|thread| (index, thread)));
        }
        let mailboxes: Vec<_> = robots.iter().filter_map(Body::mailbox).collect();
        // The thread now only waits for the robots.
        let _always_taken = ready.send(robots);
        Ok(Self { handle, scheduling, thread: Some(thread), writer, auditor, log_lost, drivers, mailboxes })
    }

    /// Waits up to `patience` until every driver has tried to connect once, so that the robots' next responses report the result. Returns
    /// whether all drivers have tried.
    #[expect(clippy::disallowed_methods, reason = "drivers connect in real time")]
    pub fn await_hardware(&self, patience: Duration) -> bool {
        let until = std::time::Instant::now() + patience;
        self.mailboxes.iter().all(|mailbox| mailbox.await_tried(until))
    }

    /// Returns the scheduling that the system granted to the precise thread, which runs the robots.
    #[must_use]
    pub const fn scheduling(&self) -> &Scheduling {
        &self.scheduling
    }

    /// Returns a handle that opens links to this host's robots.
    #[must_use]
    pub fn handle(&self) -> HostHandle {
        self.handle.clone()
    }

    /// Returns how often peers were refused, slowed down or disconnected, and why.
    #[must_use]
    pub fn refusals(&self) -> &Refusals {
        &self.handle.refusals
    }

    /// Returns the metrics of the host's robots, which are updated continuously.
    #[must_use]
    pub fn figures(&self) -> Arc<Figures> {
        Arc::clone(&self.handle.figures)
    }

    /// Returns a receiver for the error that occurs if the log cannot be written while the robots run; the robots then continue without a
    /// log. Returns `None` if there is no log, or if this method was called before.
    pub const fn log_lost(&mut self) -> Option<oneshot::Receiver<HostError>> {
        self.log_lost.take()
    }

    /// Stops the robots where they are, brings moving hardware to rest, and completes the log. Returns the robots whose hardware may not
    /// be at rest.
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
        self.handle.audit.iter().for_each(Audit::end);
        if self.auditor.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the thread that writes the audit trail panicked");
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

/// Returns a generous upper bound for the length in bytes of a command for any of these devices. The bound allows 512 bytes per step; a
/// step with one value takes fewer than 200.
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
    /// Returns the ids of the robots, in the order of their indices.
    #[must_use]
    pub fn robots(&self) -> &[RobotId] {
        &self.robots
    }

    /// Returns the maximum length of a command for the robot at the end of this link, in bytes.
    pub(crate) fn longest_command(&self, link: &RobotLink) -> usize {
        self.longest.get(link.robot).copied().unwrap_or(LINE_BYTES_MAX)
    }

    /// Opens a link to a robot from within this process. Returns `None` if the robot does not exist or the host has stopped.
    #[must_use]
    pub fn connect(&self, robot: usize) -> Option<RobotLink> {
        self.connect_as(robot, Peer::in_process())
    }

    /// Opens a link to a robot for a peer. Returns `None` if the robot does not exist or the host has stopped. The peer's unread messages
    /// are bounded, unless the peer is in this process. A session that the peer claims is tied to the peer's proven name, if it has one.
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

    /// Returns the metrics of the robots, which are updated continuously.
    #[must_use]
    pub fn figures(&self) -> Arc<Figures> {
        Arc::clone(&self.figures)
    }

    /// Whether the precise thread, which runs the robots, answers within `patience`.
    pub async fn answers_within(&self, patience: Duration) -> bool {
        let (answer, answered) = oneshot::channel();
        let asked = self.orders.send(Order::Beat { answer }).is_ok();
        asked && tokio::time::timeout(patience, answered).await.is_ok_and(|answered| answered.is_ok())
    }

    /// Whether the host has stopped.
    pub(crate) fn has_stopped(&self) -> bool {
        self.orders.is_disconnected()
    }

    /// Returns how often peers were refused, slowed down or disconnected, and why.
    #[must_use]
    pub fn refusals(&self) -> &Refusals {
        &self.refusals
    }

    /// Returns the budget for messages and reading time that is shared by all peers that own no robot of this host.
    pub(crate) fn strangers(&self) -> Arc<Strangers> {
        Arc::clone(&self.strangers)
    }

    /// Returns the new connections of all robots of this host.
    pub(crate) const fn newcomers(&self) -> &Arc<Newcomers> {
        &self.newcomers
    }

    /// Returns the audit trail, if there is one.
    #[cfg(any(feature = "sealed", feature = "tls"))]
    pub(crate) const fn audit(&self) -> Option<&Audit> {
        self.audit.as_ref()
    }

    /// Returns the cache of the most recently received scripts. It is useful because several robots of a host often receive the same
    /// script.
    pub(crate) const fn scripts(&self) -> &KnownScripts {
        &self.scripts
    }

    /// Returns a receiver that shows the current or last owner of a robot. `None` if the robot does not exist.
    pub(crate) fn owner(&self, robot: usize) -> Option<watch::Receiver<Option<Claimant>>> {
        self.owners.get(robot).cloned()
    }

    /// Ends the commands and closes the links of the peers that have proven their names with this key.
    #[cfg(any(feature = "sealed", feature = "tls"))]
    pub(crate) fn bar(&self, robot: usize, serial: Label, why: String) {
        let _stopped = self.orders.send(Order::Bar { robot, serial, why });
    }

    /// Makes a robot check whether the session that owns it is over. Returns once the robot has checked, or once the host has stopped.
    pub(crate) async fn look(&self, robot: usize) {
        let (permit, looked) = oneshot::channel();
        let _stopped = self.orders.send(Order::Look { robot, permit });
        let _stopped = looked.await;
    }
}

impl RobotLink {
    /// Sends a message to the robot. The calling thread hashes the message's content, so that the precise thread only has to compare the
    /// hash. If the host has stopped, the message is ignored, and [`RobotLink::recv`] returns `None`.
    pub fn send(&self, message: Message) {
        self.order(Input::read(message));
    }

    fn order(&self, input: Input) {
        let order = Order::Input { robot: self.robot, link: self.link, input, permit: None };
        let _stopped = self.orders.send(order);
    }

    /// Receives the robot's next event. Returns `None` once the host has stopped.
    pub async fn recv(&mut self) -> Option<LinkEvent> {
        self.incoming.recv().await
    }

    /// Returns the next event if it is already available.
    pub(crate) fn try_recv(&mut self) -> Option<LinkEvent> {
        self.incoming.try_recv()
    }

    pub(crate) fn sender(&self) -> LinkSender {
        let window = Arc::new(Semaphore::new(WINDOW));
        LinkSender { orders: self.orders.clone(), robot: self.robot, link: self.link, window }
    }
}

impl LinkSender {
    /// Sends an input to the robot. Waits first if the robot has yet to take [`WINDOW`] earlier inputs, so that the host never holds more
    /// than [`WINDOW`] inputs of a peer.
    pub(crate) async fn send(&self, input: Input) {
        // The semaphore is never closed, so a permit always becomes available.
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
