//! A robot in the same process: messages go to its host as they are, without bytes.

use downbeat_robot::{HostHandle, LinkEvent};

use super::{EventSink, Queue};
use crate::mission::Loss;

/// Carries messages both ways until either side closes.
pub(super) async fn carry(sink: EventSink, host: HostHandle, index: usize, mut queue: Queue) {
    let Some(mut link) = host.connect(index) else {
        return sink.down(Loss::Refused, "the simulated robot is gone").await;
    };
    sink.up().await;
    loop {
        tokio::select! {
            message = queue.next() => match message {
                Some((message, _)) => link.send(message),
                None => return,
            },
            event = link.recv() => match event {
                Some(LinkEvent::Message(message)) => sink.received(message, 0).await,
                Some(LinkEvent::Closed) | None => {
                    return sink.down(Loss::Closed, "the robot closed the link").await;
                }
            },
        }
    }
}
