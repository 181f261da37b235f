//! Links to robots. A link is a pair of channels, served by tasks that carry the messages. The mission does not depend on the transport
//! that they use.

mod batch;
mod budget;
mod by_key;
mod encoding;
mod in_process;
mod reach;
mod secure;
mod shared;
mod tcp;

use std::sync::Arc;
use std::time::Duration;

pub(crate) use budget::{Budget, SharedAllowance};
#[cfg(not(feature = "zenoh"))]
pub use by_key::NOT_BUILT;
pub use by_key::Network;
#[cfg(feature = "zenoh")]
pub use by_key::join;
pub use encoding::LinkEncoding;
pub(crate) use reach::{Purpose, Reach, ReadEnd, WriteEnd, over};
pub use secure::denial;
pub use secure::{Hmac, Security, Site, Tls};
pub(crate) use shared::SharedScripts;

use downbeat_robot::HostHandle;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::AbortHandle;
use urrcp::{KnownScripts, Message, Span};

use crate::server_clock::ServerClock;
use downbeat_mission::drive::{Happened, LinkNumber, QueueFull, Urgency};
use downbeat_mission::session;
use downbeat_mission::{Event, Loss, RobotIndex};

/// Maximum number of messages that may wait to be sent to one robot. If there are more, the link is treated as broken.
const OUTGOING_MAX: usize = 40_000;

/// Number of places that one link's events may occupy in the mission's queue. If all are occupied, this link waits; other links have
/// their own places.
const PLACES: usize = 256;
/// A message of n bytes occupies n / `PLACE_BYTES` places, rounded down, plus one, but at most `PLACES`.
const PLACE_BYTES: usize = 64 * 1024;

/// An event, and the places that it occupies in the mission's queue until the mission has received it.
#[derive(Debug)]
pub(crate) struct Waiting {
    /// The event.
    pub(crate) happened: Happened,
    /// The occupied places, which are freed on drop. `None` for an event that occupies no places.
    _places: Option<OwnedSemaphorePermit>,
}

impl From<Happened> for Waiting {
    fn from(happened: Happened) -> Self {
        Self { happened, _places: None }
    }
}

/// The transport and address of a robot, with all data needed to connect.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Endpoint {
    /// A simulated robot in this process, by its index in the host.
    InProcess {
        /// The host that runs the robot.
        host: HostHandle,
        /// The robot's index in the host.
        index: usize,
    },
    /// A robot that listens on TCP.
    Tcp {
        /// Host name or IP address.
        host: String,
        /// TCP port.
        port: u16,
        /// The encoding of messages to the robot.
        encoding: LinkEncoding,
        /// Whether and how both sides authenticate.
        security: Security,
    },
    /// A robot that is reached through a key of a Zenoh network.
    #[cfg(feature = "zenoh")]
    Zenoh {
        /// The Zenoh network.
        network: downbeat_robot::zenoh::Network,
        /// The robot's key in the network.
        key: downbeat_robot::zenoh::Key,
        /// The encoding of messages to the robot.
        encoding: LinkEncoding,
    },
}

impl Endpoint {
    /// Returns the id of the Zenoh session and the place (the robot's key without its last part), or `None` without Zenoh. Robots for
    /// which both are equal can receive texts that are published once for several robots.
    fn place(&self) -> Option<shared::Place> {
        match self {
            #[cfg(feature = "zenoh")]
            Self::Zenoh { network, key, .. } => Some((network.id().to_owned(), key.place().to_owned())),
            Self::InProcess { .. } | Self::Tcp { .. } => None,
        }
    }
}

/// The sending end of a link. When it is dropped, the link closes once all messages have been sent.
#[derive(Debug)]
pub struct Link {
    outgoing: mpsc::Sender<Outgoing>,
    urgent: mpsc::UnboundedSender<Outgoing>,
    task: AbortHandle,
}

/// A robot that listens on the network, with all data that a link to it needs.
#[derive(Clone)]
struct Peer {
    sink: EventSink,
    reach: Reach,
    encoding: LinkEncoding,
    of: OfRobot,
    /// Scripts sent on this link. They are kept because a robot repeats a script when it accepts it.
    sent: KnownScripts,
}

/// State shared by all links to one robot.
#[derive(Clone, Debug, Default)]
pub(crate) struct OfRobot {
    /// How much the robot may still send, on all its links together.
    pub(crate) asked: SharedAllowance,
    /// The scripts that this robot and others receive.
    pub(crate) shared: SharedScripts,
    pub(crate) long_upload: LongUpload,
}

/// How long a robot may be busy reading a batch of maximum size (`WRITE_BATCH`).
#[derive(Clone, Copy, Debug)]
pub(crate) struct LongUpload(pub(crate) Span);

impl Default for LongUpload {
    fn default() -> Self {
        Self(Span::from_millis(2_000))
    }
}

/// The receiving ends of a link's channels.
struct Queue {
    outgoing: mpsc::Receiver<Outgoing>,
    /// Urgent messages, which are stops: usually at most one per device. A stop is occasionally repeated.
    urgent: mpsc::UnboundedReceiver<Outgoing>,
}

/// A message to a robot. It is boxed, because a channel reserves room for 32 messages, and there may be thousands of links.
pub(crate) type Outgoing = Box<Message>;

impl Link {
    /// Opens a link after the delay `after`. `of` contains the robot's index and the link's number; they accompany each event sent to
    /// `events`.
    pub fn open(
        of: (RobotIndex, LinkNumber),
        endpoint: Endpoint,
        clock: ServerClock,
        events: mpsc::Sender<Happened>,
        after: Duration,
    ) -> Self {
        let (robot, number) = of;
        let sink = EventSink { robot, link: Some(number), clock, events: Events::Plain(events) };
        Self::carrying(sink, endpoint, OfRobot::default(), after)
    }

    /// Like [`Link::open`], but limits the queue places that the link's events occupy, so that events of other links have room.
    pub(crate) fn open_beside_others(
        of: (RobotIndex, LinkNumber),
        endpoint: Endpoint,
        of_robot: OfRobot,
        clock: ServerClock,
        events: mpsc::Sender<Waiting>,
        after: Duration,
    ) -> Self {
        // A robot in this process is trusted, and its host stores the waiting messages.
        let places =
            (!matches!(endpoint, Endpoint::InProcess { .. })).then(|| Arc::new(Semaphore::new(PLACES)));
        let (robot, number) = of;
        let sink = EventSink { robot, link: Some(number), clock, events: Events::Placed(events, places) };
        Self::carrying(sink, endpoint, of_robot, after)
    }

    fn carrying(sink: EventSink, endpoint: Endpoint, of: OfRobot, after: Duration) -> Self {
        let (outgoing, queue) = mpsc::channel(OUTGOING_MAX);
        let (urgent, first) = mpsc::unbounded_channel();
        let queue = Queue { outgoing: queue, urgent: first };
        // The task ends when its link breaks or when `outgoing` is dropped, whichever happens first.
        let task = tokio::spawn(async move {
            if !after.is_zero() {
                tokio::time::sleep(after).await;
            }
            if queue.outgoing.is_closed() {
                return;
            }
            let sent = KnownScripts::default();
            match endpoint {
                Endpoint::InProcess { host, index } => in_process::carry(sink, host, index, queue).await,
                Endpoint::Tcp { host, port, encoding, security } => {
                    let reach = Reach::Tcp { host, port, security };
                    tcp::carry(Peer { sink, reach, encoding, of, sent }, queue).await;
                }
                #[cfg(feature = "zenoh")]
                Endpoint::Zenoh { network, key, encoding } => {
                    let reach = Reach::Zenoh { network, key };
                    tcp::carry(Peer { sink, reach, encoding, of, sent }, queue).await;
                }
            }
        });
        Self { outgoing, urgent, task: task.abort_handle() }
    }

    /// Queues a message. If the link is down, the message is dropped; a separate event informs the mission that the link is down.
    ///
    /// # Errors
    /// Returns [`QueueFull`] if the robot does not read. The message is then lost.
    pub fn send(&self, message: Message, urgency: Urgency) -> Result<(), QueueFull> {
        let message = Box::new(message);
        let full = match urgency {
            Urgency::Overtaking => {
                let _down = self.urgent.send(message);
                false
            }
            Urgency::InOrder => {
                matches!(self.outgoing.try_send(message), Err(mpsc::error::TrySendError::Full(_)))
            }
        };
        if full { Err(QueueFull { waiting: OUTGOING_MAX }) } else { Ok(()) }
    }

    /// Returns the channel for messages that overtake all waiting ones.
    pub(crate) fn overtaking(&self) -> mpsc::UnboundedSender<Outgoing> {
        self.urgent.clone()
    }

    /// Closes the link immediately. Messages that are still queued are discarded.
    pub fn cut(&self) {
        self.task.abort();
    }
}

impl Queue {
    /// Returns the next message, urgent ones first, and whether it is urgent. Returns `None` once the mission has dropped the link.
    async fn next(&mut self) -> Option<(Outgoing, bool)> {
        tokio::select! {
            biased;
            Some(message) = self.urgent.recv() => Some((message, true)),
            message = self.outgoing.recv() => message.map(|message| (message, false)),
        }
    }

    fn try_next(&mut self) -> Option<Outgoing> {
        self.urgent.try_recv().ok().or_else(|| self.outgoing.try_recv().ok())
    }
}

/// Timestamps the events of a link and sends them to the mission's loop.
#[derive(Clone)]
struct EventSink {
    robot: RobotIndex,
    /// The number of the link. `None` on an additional connection: its events do not change the link's state.
    link: Option<LinkNumber>,
    clock: ServerClock,
    events: Events,
}

/// The channel to which a link sends its events.
#[derive(Clone)]
enum Events {
    Plain(mpsc::Sender<Happened>),
    /// Each event occupies places in the mission's queue, which the semaphore counts. `None`: places are not counted.
    Placed(mpsc::Sender<Waiting>, Option<Arc<Semaphore>>),
}

impl EventSink {
    async fn put(&self, event: Event) {
        self.put_long(event, 0).await;
    }

    /// Sends an event of `bytes` bytes once enough places are free. A missing receiver is ignored, because the mission has ended and does
    /// not need the event.
    async fn put_long(&self, event: Event, bytes: usize) {
        let (at, robot, event) = (self.clock.now(), self.robot, Box::new(event));
        let happened = match self.link {
            Some(link) => Happened::OnLink { at, robot, link, event },
            None => Happened::Event { at, event },
        };
        match &self.events {
            Events::Plain(events) => drop(events.send(happened).await),
            Events::Placed(events, None) => drop(events.send(happened.into()).await),
            Events::Placed(events, Some(places)) => {
                let count = u32::try_from((bytes / PLACE_BYTES + 1).min(PLACES)).unwrap_or(1);
                let places = Arc::clone(places).acquire_many_owned(count).await.ok();
                drop(events.send(Waiting { happened, _places: places }).await);
            }
        }
    }

    async fn up(&self) {
        self.put(Event::LinkUp { robot: self.robot }).await;
    }

    async fn down(&self, loss: Loss, reason: impl Into<String>) {
        self.put(Event::LinkDown { robot: self.robot, loss, reason: reason.into() }).await;
    }

    async fn received(&self, message: Message, bytes: usize) {
        let message = session::told_without_keys(message);
        self.put_long(Event::Received { robot: self.robot, message }, bytes).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn message_takes_one_queue_place_plus_one_per_full_64_kib() {
        for (bytes, taken) in [(0, 1), (PLACE_BYTES - 1, 1), (PLACE_BYTES, 2), (3 * PLACE_BYTES, 4)] {
            let places = Arc::new(Semaphore::new(PLACES));
            let (events, mut happened) = mpsc::channel(1);
            let events = Events::Placed(events, Some(Arc::clone(&places)));
            let clock = ServerClock::anchored(urrcp::Span::ZERO);
            let sink = EventSink { robot: RobotIndex::new(0), link: None, clock, events };
            sink.put_long(Event::LinkUp { robot: RobotIndex::new(0) }, bytes).await;
            assert_eq!(PLACES - places.available_permits(), taken, "{bytes} bytes");
            drop(happened.recv().await);
            assert_eq!(places.available_permits(), PLACES, "it was heard");
        }
    }
}
