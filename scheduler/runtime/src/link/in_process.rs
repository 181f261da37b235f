//! A robot in the same process: messages go to its host unencoded.

use downbeat_robot::{HostHandle, LinkEvent};

use super::{EventSink, Queue};
use downbeat_mission::Loss;

/// Carries messages between the mission and a robot in this process until either side closes.
pub(super) async fn carry(sink: EventSink, host: HostHandle, index: usize, mut queue: Queue) {
    let Some(mut link) = host.connect(index) else {
        return sink.down(Loss::Refused, "the simulated robot is no longer running").await;
    };
    sink.up().await;
    loop {
        tokio::select! {
            message = queue.next() => match message {
                Some((message, _)) => link.send(*message),
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use downbeat_robot::simulated::{Settings, SimulatedRobot};
    use downbeat_robot::{Host, HostOptions};
    use tokio::sync::mpsc;
    use urrcp::{InitializationRequest, Message, Span};

    use crate::link::{Endpoint, Link};
    use crate::server_clock::ServerClock;
    use downbeat_mission::drive::{Happened, LinkNumber, Urgency};
    use downbeat_mission::{Event, Loss, RobotIndex};

    const R0: RobotIndex = RobotIndex::new(0);

    fn host() -> Host {
        let block = r#"{"id": "r0", "api_version": "1", "devices": [{"id": "a", "available_control_types": {
            "position": {"min_value": 0, "max_value": 90, "granularity": 1}}}]}"#;
        let robot = SimulatedRobot::new(serde_json::from_str(block).unwrap(), Settings::default());
        Host::start(vec![robot], HostOptions::default()).unwrap()
    }

    fn linked(host: &Host, index: usize) -> (Link, mpsc::Receiver<Happened>) {
        let (events, happened) = mpsc::channel(64);
        let endpoint = Endpoint::InProcess { host: host.handle(), index };
        let clock = ServerClock::anchored(Span::ZERO);
        (Link::open((R0, LinkNumber(0)), endpoint, clock, events, Duration::ZERO), happened)
    }

    async fn next(happened: &mut mpsc::Receiver<Happened>) -> Option<Event> {
        match tokio::time::timeout(Duration::from_secs(60), happened.recv()).await.unwrap()? {
            Happened::OnLink { event, .. } => Some(*event),
            other => panic!("{other:?}"),
        }
    }

    #[tokio::test]
    async fn in_process_robot_answers_until_its_link_is_dropped() {
        let host = host();
        let (link, mut happened) = linked(&host, 0);
        assert!(matches!(next(&mut happened).await, Some(Event::LinkUp { robot: R0 })));
        for urgency in [Urgency::InOrder, Urgency::Overtaking] {
            let asks = Message::InitializationRequest(InitializationRequest::default());
            link.send(asks, urgency).unwrap();
            let event = next(&mut happened).await;
            assert!(
                matches!(&event, Some(Event::Received { robot: R0, message: Message::InitializationBlock(block) }) if block.id.as_str() == "r0"),
                "{event:?}"
            );
        }
        drop(link);
        assert!(next(&mut happened).await.is_none(), "it ends without a word");
    }

    #[tokio::test]
    async fn missing_or_ended_in_process_robot_is_reported_as_lost() {
        let host = host();
        let (_other, mut of_other) = linked(&host, 1);
        let gone = next(&mut of_other).await;
        assert!(matches!(gone, Some(Event::LinkDown { loss: Loss::Refused, .. })), "{gone:?}");
        let (_link, mut happened) = linked(&host, 0);
        assert!(matches!(next(&mut happened).await, Some(Event::LinkUp { .. })));
        drop(host);
        let closed = next(&mut happened).await;
        assert!(matches!(closed, Some(Event::LinkDown { loss: Loss::Closed, .. })), "{closed:?}");
    }
}
