//! A robot in the same process: messages go to its host as they are, without bytes.

use downbeat_robot::{HostHandle, LinkEvent};
use tokio::sync::mpsc;
use urrcp::Message;

use super::EventSink;

/// Carries messages both ways until either side closes.
pub(super) async fn carry(
    sink: EventSink,
    host: HostHandle,
    index: usize,
    mut queue: mpsc::Receiver<Message>,
) {
    let Some(mut link) = host.connect(index) else {
        return sink.down("the simulated robot is gone").await;
    };
    sink.up().await;
    loop {
        tokio::select! {
            message = queue.recv() => match message {
                Some(message) => link.send(message),
                None => return,
            },
            event = link.recv() => match event {
                Some(LinkEvent::Message(message)) => sink.received(message).await,
                Some(LinkEvent::Closed) | None => return sink.down("the robot closed the link").await,
            },
        }
    }
}
