//! Links to robots. A link is a pair of channels with tasks behind it; which transport carries the messages, the mission
//! never knows.

mod encoding;
mod in_process;
mod tcp;

use std::time::Duration;

pub use encoding::LinkEncoding;

use downbeat_robot::HostHandle;
use tokio::sync::mpsc;
use tokio::task::AbortHandle;
use urrcp::Message;

use crate::drive::{Happened, LinkNumber, QueueFull, Urgency};
use crate::mission::{Event, Loss};
use crate::server_clock::ServerClock;

/// Messages that may wait for one robot's socket; beyond that the link counts as broken.
const OUTGOING_MAX: usize = 40_000;

/// Where a robot is reached.
#[derive(Clone, Debug)]
#[non_exhaustive]
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
        /// How it is written to.
        encoding: LinkEncoding,
    },
}

/// The sending end of a link. Dropping it closes the link once all has been sent.
#[derive(Debug)]
pub struct Link {
    outgoing: mpsc::Sender<Message>,
    urgent: mpsc::UnboundedSender<Message>,
    task: AbortHandle,
}

/// A robot on TCP.
#[derive(Clone)]
struct Peer {
    sink: EventSink,
    host: String,
    port: u16,
    encoding: LinkEncoding,
}

/// The other ends of a link's channels.
struct Queue {
    outgoing: mpsc::Receiver<Message>,
    /// Stops: at most one a device, and a repetition now and then.
    urgent: mpsc::UnboundedReceiver<Message>,
}

impl Link {
    /// Opens a link after a while; what happens on it comes as events of `robot` on the link of this number.
    pub fn open(
        (robot, number): (usize, LinkNumber),
        endpoint: Endpoint,
        clock: ServerClock,
        events: mpsc::Sender<Happened>,
        after: Duration,
    ) -> Self {
        let (outgoing, queue) = mpsc::channel(OUTGOING_MAX);
        let (urgent, first) = mpsc::unbounded_channel();
        let queue = Queue { outgoing: queue, urgent: first };
        let sink = EventSink { robot, link: Some(number), clock, events };
        // The task ends when its link breaks or when `outgoing` is dropped, whichever comes first.
        let task = tokio::spawn(async move {
            if !after.is_zero() {
                tokio::time::sleep(after).await;
            }
            if queue.outgoing.is_closed() {
                return;
            }
            match endpoint {
                Endpoint::InProcess { host, index } => in_process::carry(sink, host, index, queue).await,
                Endpoint::Tcp { host, port, encoding } => {
                    tcp::carry(Peer { sink, host, port, encoding }, queue).await;
                }
            }
        });
        Self { outgoing, urgent, task: task.abort_handle() }
    }

    /// Queues a message. A link that is down drops it: the mission hears of that by its own event.
    ///
    /// # Errors
    /// [`QueueFull`] when the robot does not read: the message is lost.
    pub fn send(&self, message: Message, urgency: Urgency) -> Result<(), QueueFull> {
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

    /// Where messages go in that overtake all that waits.
    pub(crate) fn overtaking(&self) -> mpsc::UnboundedSender<Message> {
        self.urgent.clone()
    }

    /// Closes the link at once. What waits to be sent is discarded.
    pub fn cut(&self) {
        self.task.abort();
    }
}

impl Queue {
    /// The next message, urgent ones first, and whether it is one; `None` once the mission has let go of the link.
    async fn next(&mut self) -> Option<(Message, bool)> {
        tokio::select! {
            biased;
            Some(message) = self.urgent.recv() => Some((message, true)),
            message = self.outgoing.recv() => message.map(|message| (message, false)),
        }
    }

    fn try_next(&mut self) -> Option<Message> {
        self.urgent.try_recv().ok().or_else(|| self.outgoing.try_recv().ok())
    }
}

/// Stamps what happens on a link and hands it to the mission's driver.
#[derive(Clone)]
struct EventSink {
    robot: usize,
    /// `None` on an additional connection, which says nothing about the link.
    link: Option<LinkNumber>,
    clock: ServerClock,
    events: mpsc::Sender<Happened>,
}

impl EventSink {
    /// The driver's end is gone only when the mission has ended; then the event is not needed.
    async fn put(&self, event: Event) {
        let (at, robot, event) = (self.clock.now(), self.robot, Box::new(event));
        let happened = match self.link {
            Some(link) => Happened::OnLink { at, robot, link, event },
            None => Happened::Event { at, event },
        };
        let _ended = self.events.send(happened).await;
    }

    async fn up(&self) {
        self.put(Event::LinkUp { robot: self.robot }).await;
    }

    async fn down(&self, loss: Loss, reason: impl Into<String>) {
        self.put(Event::LinkDown { robot: self.robot, loss, reason: reason.into() }).await;
    }

    async fn received(&self, message: Message) {
        self.put(Event::Received { robot: self.robot, message }).await;
    }
}
