//! Messages from a robot that a peer has not read yet. Their total size is bounded, so that a peer that sends requests but reads no
//! responses occupies little memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::sync::mpsc;
use urrcp::{Message, StatusValue};

use super::LinkEvent;
use crate::peer::Peer;

/// Maximum number of messages that may wait for one peer.
pub(super) const MESSAGES_MAX: usize = 65_536;
/// Maximum size of the messages that may wait for a peer that does not own the robot, in bytes on the wire.
pub(super) const BYTES_MAX: usize = 1024 * 1024;
/// Maximum size of the messages that may wait for the peer that owns the robot, in bytes on the wire.
pub(super) const OWNER_BYTES_MAX: usize = 64 * 1024 * 1024;

/// The robot's end of the channel to a peer. Events are boxed, because every channel reserves memory for 32 of them, and a robot has many
/// peers.
pub(super) struct Outbox {
    events: mpsc::Sender<Box<LinkEvent>>,
    unread: Arc<AtomicUsize>,
    peer: Peer,
}

/// The peer's end of the channel from a robot.
#[derive(Debug)]
pub(super) struct Inbox {
    events: mpsc::Receiver<Box<LinkEvent>>,
    unread: Arc<AtomicUsize>,
}

/// Creates both ends of a channel from a robot to a peer.
pub(super) fn outbox(peer: Peer) -> (Outbox, Inbox) {
    let (events, incoming) = mpsc::channel(MESSAGES_MAX);
    let unread = Arc::new(AtomicUsize::new(0));
    (Outbox { events, unread: Arc::clone(&unread), peer }, Inbox { events: incoming, unread })
}

impl Outbox {
    pub(super) const fn peer(&self) -> &Peer {
        &self.peer
    }

    /// Queues a message for the peer. Returns false if the unread messages exceed the limit; the peer must then be disconnected. If no
    /// message is unread, a message of any length is accepted.
    pub(super) fn say(&self, message: Message, is_owner: impl FnOnce() -> bool) -> bool {
        let unread = self.unread.load(Ordering::Relaxed);
        let too_much = unread > BYTES_MAX && (unread > OWNER_BYTES_MAX || !is_owner());
        if too_much && !self.peer.is_in_process() {
            return false;
        }
        self.unread.fetch_add(weight(&message), Ordering::Relaxed);
        self.events.try_send(Box::new(LinkEvent::Message(message))).is_ok()
    }

    /// Closes the link after the peer has received the pending messages.
    pub(super) fn close(&self) {
        let _full_or_gone = self.events.try_send(Box::new(LinkEvent::Closed));
    }
}

impl Inbox {
    pub(super) async fn recv(&mut self) -> Option<LinkEvent> {
        let event = self.events.recv().await;
        self.taken(event)
    }

    pub(super) fn try_recv(&mut self) -> Option<LinkEvent> {
        let event = self.events.try_recv().ok();
        self.taken(event)
    }

    fn taken(&self, event: Option<Box<LinkEvent>>) -> Option<LinkEvent> {
        let event = event.map(|event| *event);
        if let Some(LinkEvent::Message(message)) = &event {
            self.unread.fetch_sub(weight(message), Ordering::Relaxed);
        }
        event
    }
}

/// Estimates the size of a message in bytes on the wire, without encoding it.
pub(super) fn weight(message: &Message) -> usize {
    const BASE: usize = 256;
    let lists = match message {
        Message::InitializationBlock(block) => block.devices.len() * 256,
        Message::ControlResponse(response) => match &response.status_value {
            StatusValue::Script(script) => script.steps().len() * 80,
            _ => 0,
        },
        Message::InquiryResponse(response) => response.requests.len() * 256 + response.devices.len() * 96,
        _ => 0,
    };
    BASE + lists
}

#[cfg(test)]
mod tests {
    use urrcp::{AvailabilityRequest, InitializationBlock};

    use super::*;

    fn block(devices: usize) -> Message {
        let devices: Vec<_> =
            (0..devices).map(|i| format!(r#"{{"id":"d{i}","available_control_types":{{}}}}"#)).collect();
        let block = format!(r#"{{"id":"r","api_version":"1","devices":[{}]}}"#, devices.join(","));
        serde_json::from_str::<InitializationBlock>(&block).unwrap().into()
    }

    fn stranger() -> Peer {
        Peer::at("192.0.2.7:1000".parse().unwrap())
    }

    #[test]
    fn unread_messages_of_a_stranger_are_limited_in_bytes() {
        let (said, mut heard) = outbox(stranger());
        let block = block(3_000);
        let taken = (0..100).take_while(|_| said.say(block.clone(), || false)).count();
        assert_eq!(taken, 2, "the one with which the budget is exceeded is the last");
        assert!(heard.try_recv().is_some() && heard.try_recv().is_some());
        assert!(said.say(block, || false), "all was read");
    }

    #[test]
    fn owner_may_leave_more_unread_and_in_process_peer_is_unlimited() {
        let block = block(3_000);
        let (said, _heard) = outbox(stranger());
        let taken = (0..1_000).take_while(|_| said.say(block.clone(), || true)).count();
        assert_eq!(taken, OWNER_BYTES_MAX / weight(&block) + 1);
        let (said, _heard) = outbox(Peer::in_process());
        assert!((0..1_000).all(|_| said.say(block.clone(), || false)));
    }

    #[test]
    fn unread_short_messages_are_limited() {
        let (said, _heard) = outbox(stranger());
        let ask = Message::AvailabilityRequest(AvailabilityRequest::default());
        let taken = (0..MESSAGES_MAX).take_while(|_| said.say(ask.clone(), || false)).count();
        assert_eq!(taken, BYTES_MAX / weight(&ask) + 1);
    }

    #[test]
    fn weight_of_a_message_grows_with_the_length_of_its_lists() {
        use urrcp::{
            ControlResponse, ControlType, DeviceId, Inquiry, InquiryResponse, Millis, RequestReport,
        };
        use urrcp::{RequestId, RequestState, Script, Setpoint, Status, Step, Timestamp};
        let (at, arm) = (Timestamp::from_nanos(0), DeviceId::new("arm").unwrap());
        let response = |status_value| ControlResponse {
            status_value,
            ..ControlResponse::new(at, arm.clone(), Status::Accepted)
        };
        let step = Step::new(Millis::ZERO, Setpoint::new(ControlType::Position, 1.0));
        let script = StatusValue::Script(Script::new(vec![step; 3]).unwrap());
        let report = RequestReport::new(RequestId::new("a").unwrap(), RequestState::Unknown);
        let room = urrcp::DeviceReport { device_id: arm.clone(), room: 1, position: Some(1.0) };
        let inquiry = InquiryResponse {
            requests: vec![report; 2],
            devices: vec![room; 3],
            ..InquiryResponse::new(&Inquiry::default(), at, at, Status::Ok)
        };
        for (message, expected) in [
            (Message::ControlResponse(response(StatusValue::Null)), 256),
            (Message::ControlResponse(response(script)), 256 + 3 * 80),
            (Message::InquiryResponse(inquiry), 256 + 2 * 256 + 3 * 96),
            (block(2), 256 + 2 * 256),
            (Message::AvailabilityRequest(AvailabilityRequest::default()), 256),
        ] {
            assert_eq!(weight(&message), expected, "{message:?}");
        }
    }

    #[tokio::test]
    async fn read_messages_are_released_and_closing_follows_the_last_message() {
        let (said, mut heard) = outbox(stranger());
        let block = block(3_000);
        for _ in 0..10 {
            assert!(said.say(block.clone(), || false));
            assert!(matches!(heard.recv().await, Some(LinkEvent::Message(_))));
        }
        assert_eq!(said.unread.load(Ordering::Relaxed), 0);
        assert!(said.say(block, || false));
        said.close();
        assert!(matches!(heard.try_recv(), Some(LinkEvent::Message(_))));
        assert!(matches!(heard.try_recv(), Some(LinkEvent::Closed)));
        assert!(heard.try_recv().is_none());
        assert!(!said.peer().is_in_process());
    }
}
