//! Links to robots. A link is a pair of channels with tasks behind it; which transport carries the messages, the mission
//! never knows.

mod in_process;
mod tcp;

use downbeat_robot::HostHandle;
use tokio::sync::mpsc;
use urrcp::{Message, Server, Timestamp};

use crate::mission::Event;
use crate::server_clock::ServerClock;

/// Messages that may wait for one robot's socket; beyond that the link counts as broken.
const OUTGOING_MAX: usize = 40_000;

/// Where a robot is reached.
#[derive(Clone, Debug)]
pub enum Endpoint {
    /// A simulated robot in this process, by its index in the host.
    InProcess {
        /// The host that runs it.
        host: HostHandle,
        /// Its index there.
        index: usize,
    },
    /// A robot that listens on TCP.
    Tcp {
        /// Host name or address.
        host: String,
        /// Port.
        port: u16,
    },
}

/// An event on a link, with the instant at which it happened there.
pub type LinkEvent = (Timestamp<Server>, Event);

/// The sending end of a link. Dropping it closes the link once all has been sent.
#[derive(Debug)]
pub struct Link {
    outgoing: mpsc::Sender<Message>,
}

impl Link {
    /// Opens a link; what happens on it comes as events of `robot`.
    pub fn open(
        robot: usize,
        endpoint: Endpoint,
        clock: ServerClock,
        events: mpsc::Sender<LinkEvent>,
    ) -> Self {
        let (outgoing, queue) = mpsc::channel(OUTGOING_MAX);
        let sink = EventSink { robot, clock, events };
        // Each task ends when its link breaks or when `outgoing` is dropped, whichever comes first.
        match endpoint {
            Endpoint::InProcess { host, index } => tokio::spawn(in_process::carry(sink, host, index, queue)),
            Endpoint::Tcp { host, port } => tokio::spawn(tcp::carry(sink, host, port, queue)),
        };
        Self { outgoing }
    }

    /// Queues a message. A link that is down or full drops it: the mission hears of that by its own event.
    pub fn send(&self, message: Message) {
        if let Err(error) = self.outgoing.try_send(message) {
            tracing::debug!("message dropped: {error}");
        }
    }
}

/// Stamps what happens on a link and hands it to the mission's driver.
struct EventSink {
    robot: usize,
    clock: ServerClock,
    events: mpsc::Sender<LinkEvent>,
}

impl EventSink {
    /// The driver's end is gone only when the mission has ended; then nobody needs the event.
    async fn put(&self, event: Event) {
        let _ended = self.events.send((self.clock.now(), event)).await;
    }

    async fn up(&self) {
        self.put(Event::LinkUp { robot: self.robot }).await;
    }

    async fn down(&self, reason: impl Into<String>) {
        self.put(Event::LinkDown { robot: self.robot, reason: reason.into() }).await;
    }

    async fn received(&self, message: Message) {
        self.put(Event::Received { robot: self.robot, message }).await;
    }
}
