//! Links over real sockets: a robot that misbehaves affects only its own link.

use downbeat_mission::RobotIndex;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt};
use urrcp::{Command, ControlRequest, ControlType, Millis, Script, Setpoint, StatusValue, Step};

use super::*;
use crate::link::{Endpoint, Link, LinkEncoding, Security};
use downbeat_mission::drive::{Happened, LinkNumber, Urgency};

const R0: RobotIndex = RobotIndex::new(0);
const R1: RobotIndex = RobotIndex::new(1);

/// Maximum time to wait for an expected event, long enough for a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

#[tokio::test]
async fn stop_never_waits_behind_an_unread_upload() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let (events, _happened) = mpsc::channel(64);
    let clock = ServerClock::anchored(Span::ZERO);
    let endpoint = Endpoint::Tcp {
        host: "127.0.0.1".into(),
        port,
        encoding: LinkEncoding::default(),
        security: Security::Plain,
    };
    let link = Link::open((R0, LinkNumber(0)), endpoint, clock, events, Duration::ZERO);
    let (_unread, _) = listener.accept().await.unwrap();
    let stop = |device: String| {
        let request = ControlRequest::immediate(device.parse().unwrap(), Command::Script(Script::cancel()));
        Message::ControlRequest(request)
    };
    // This is far more than any socket buffers.
    for _ in 0..39_000 {
        link.send(stop("x".repeat(250)), Urgency::InOrder).unwrap();
    }
    tokio::time::sleep(Duration::from_millis(100)).await;
    link.send(stop("arm".to_owned()), Urgency::Overtaking).unwrap();
    let (second, _) = tokio::time::timeout(PATIENCE, listener.accept()).await.unwrap().unwrap();
    let line = tokio::io::BufReader::new(second).lines().next_line().await.unwrap().unwrap();
    assert!(line.contains(r#""device_id":"arm""#), "{line}");
}

#[tokio::test]
async fn stop_behind_a_long_upload_uses_a_separate_connection() {
    for (messages, overtakes) in [(400, true), (100, false)] {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        // Even a slow reader does not reach this limit.
        let long_upload = crate::link::LongUpload(Span::from_millis(3_600_000));
        let of_robot = crate::link::OfRobot { long_upload, ..Default::default() };
        let (link, _happened) = linked_as(of_robot, listener.local_addr().unwrap().port());
        let cancel = |device: &str| {
            let cancel = Command::Script(Script::cancel());
            Message::ControlRequest(ControlRequest::immediate(device.parse().unwrap(), cancel))
        };
        // All messages are queued before the link is up, and are written as one batch.
        for _ in 0..messages {
            link.send(cancel(&"x".repeat(250)), Urgency::InOrder).unwrap();
        }
        let (first, _) = listener.accept().await.unwrap();
        let mut first = tokio::io::BufReader::new(first).lines();
        for _ in 0..messages {
            first.next_line().await.unwrap().unwrap();
        }
        link.send(cancel("arm"), Urgency::Overtaking).unwrap();
        let came = tokio::time::timeout(PATIENCE, async {
            tokio::select! {
                line = first.next_line() => (false, line.unwrap().unwrap()),
                second = listener.accept() => {
                    let mut second = tokio::io::BufReader::new(second.unwrap().0).lines();
                    (true, second.next_line().await.unwrap().unwrap())
                }
            }
        });
        let (by_its_own, line) = came.await.unwrap();
        assert!(line.contains(r#""device_id":"arm""#), "{line}");
        assert_eq!(by_its_own, overtakes, "behind {messages} messages");
    }
}

async fn next(happened: &mut mpsc::Receiver<Happened>) -> Event {
    match tokio::time::timeout(PATIENCE, happened.recv()).await.unwrap().unwrap() {
        Happened::OnLink { event, .. } => *event,
        other => panic!("{other:?}"),
    }
}

/// Returns the first `count` events of a robot that writes `bytes`. Checks that a well-behaved robot is not affected.
async fn events_of(bytes: Vec<u8>, count: usize) -> Vec<Event> {
    let clock = ServerClock::anchored(Span::ZERO);
    let (events, mut happened) = mpsc::channel(64);
    let mut links = Vec::new();
    for (robot, bytes) in [bytes, b"{\"initialization_request\":{}}\n".to_vec()].into_iter().enumerate() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let endpoint = Endpoint::Tcp {
            host: "127.0.0.1".into(),
            port,
            encoding: LinkEncoding::default(),
            security: Security::Plain,
        };
        let link = Link::open(
            (RobotIndex::new(robot), LinkNumber(robot as u64)),
            endpoint,
            clock,
            events.clone(),
            Duration::ZERO,
        );
        // The answer may be as long as a description, because one is requested.
        let asked = Message::InitializationRequest(urrcp::InitializationRequest::default());
        link.send(asked, Urgency::InOrder).unwrap();
        links.push(link);
        // The task ends when the link is dropped at the end of the test.
        tokio::spawn(async move {
            let (mut stream, _) = listener.accept().await.unwrap();
            let mut asked = [0; 256];
            let _asked = stream.read(&mut asked).await;
            let _hung_up = stream.write_all(&bytes).await;
            let _until_dropped = stream.read(&mut asked).await;
        });
    }
    let (mut of_hostile, mut of_other) = (Vec::new(), 0);
    while of_hostile.len() < count || of_other < 2 {
        match next(&mut happened).await {
            Event::LinkUp { robot: R1 } | Event::Received { robot: R1, .. } => of_other += 1,
            of => of_hostile.push(of),
        }
    }
    assert_eq!(of_other, 2, "the other link is up and carries");
    of_hostile
}

#[tokio::test]
async fn invalid_lines_are_reported_and_the_link_stays_open() {
    let device = |i: usize| format!(r#"{{"id":"d{i}","name":"","available_control_types":{{}}}}"#);
    let devices: Vec<_> = (0..32_001).map(device).collect();
    let block = |devices: &str| {
        format!(r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{devices}]}}}}"#)
    };
    let twice = device(1).replace("\"name\"", "\"id\":\"e\",\"name\"");
    let cases = [
        (block(&devices.join(",")), "32001 devices, expected 1 to 32000"),
        (block(""), "0 devices, expected 1 to 32000"),
        (block(&format!("{},{}", device(1), device(1))), "duplicate device id `d1`"),
        (block(&twice), "duplicate field `id`"),
        ("x".repeat(17 * 1024 * 1024), "the line is too long, expected at most 16777216 bytes"),
        (r#"{"control_response":"#.repeat(100_000), "invalid JSON"),
        (format!(r#"{{"control_response":{}1}}"#, r#"{"status_value":["#.repeat(50_000)), ""),
        (
            r#"{"availability_response":{},"availability_response":{}}"#.to_owned(),
            "2 keys, expected exactly one",
        ),
        (block(&device(1)).replace("\"r\"", &format!("\"{}\"", "r".repeat(257))), "257 characters"),
        (block(&device(1)).replace("\"r\"", "\"\\ud800\""), "at `initialization_block.id`"),
    ];
    for (line, says) in cases {
        let bytes = format!("{line}\n{}\n", block(&device(1))).into_bytes();
        let events = events_of(bytes, 3).await;
        let [Event::LinkUp { .. }, Event::Garbled { robot: R0, reason }, Event::Received { message, .. }] =
            &events[..]
        else {
            panic!("{says}: {events:?}");
        };
        assert!(reason.contains(says) && reason.chars().count() < 600, "{reason}");
        assert!(matches!(message, Message::InitializationBlock(_)));
    }
    let cut = format!("\u{ff}\u{fe}{}", block(&device(1))).chars().map(|c| c as u8).collect::<Vec<_>>();
    let events = events_of([&cut[..], b"\n"].concat(), 2).await;
    assert!(
        matches!(&events[1], Event::Garbled { reason, .. } if reason.contains("invalid UTF-8")),
        "{events:?}"
    );
}

/// Returns the number of events from a robot that writes `bytes` endlessly, and the last event.
async fn flooded_by(bytes: &'static [u8]) -> (u64, Event) {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let (link, mut happened) = linked(listener.local_addr().unwrap().port());
    let asked = urrcp::AvailabilityRequest::default();
    link.send(Message::AvailabilityRequest(asked), Urgency::InOrder).unwrap();
    // The task ends when the link is closed.
    let flooding = tokio::spawn(async move {
        let (mut stream, _) = listener.accept().await.unwrap();
        while stream.write_all(bytes).await.is_ok() {}
    });
    let mut count = 0;
    loop {
        count += 1;
        if let down @ Event::LinkDown { .. } = next(&mut happened).await {
            tokio::time::timeout(PATIENCE, flooding).await.unwrap().unwrap();
            return (count, down);
        }
    }
}

#[tokio::test]
async fn link_with_far_more_data_than_requested_is_closed() {
    const ANSWER: &str = "{\"availability_response\":{\"receive_timestamp\":\"2026-11-20T19:00:00Z\",\
        \"timestamp\":\"2026-11-20T19:00:00Z\",\"status\":\"OK\"}}\n";
    // Blocks of 64 KiB, so that the bytes arrive faster than the link's reserve is refilled, even on a busy machine.
    static LINE: [u8; 64 * 1024] = [b'x'; 64 * 1024];
    static EMPTY: [u8; 64 * 1024] = [b'\n'; 64 * 1024];
    for (bytes, most) in
        [("x\n".as_bytes(), 1_200), (ANSWER.as_bytes(), 1_200), (&LINE[..], 3), (&EMPTY[..], 3)]
    {
        let begin = ServerClock::anchored(Span::ZERO);
        let started = begin.now();
        let (count, down) = flooded_by(bytes).await;
        // The permitted amount grows with time: a slow machine needs longer to read it.
        let seconds = u64::try_from((begin.now() - started).as_nanos()).unwrap() / 1_000_000_000 + 1;
        let (more_messages, more_bytes) = (100 * seconds, 64 * 1024 * seconds);
        let Event::LinkDown { loss: Loss::Flooding { messages, bytes: came }, reason, .. } = down else {
            panic!("{down:?}");
        };
        assert!(count <= most + more_messages, "{count} events of {:?}", &bytes[..3]);
        let told = format!("{messages} messages, {came} bytes in {seconds} s");
        assert!(messages <= 1_200 + more_messages && came < 6 * 1024 * 1024 + more_bytes, "{told}");
        assert!(reason.contains("the robot is sending far more data than requested"), "{reason}");
    }
}

#[tokio::test]
async fn link_occupies_at_most_its_places_in_the_queue() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let (host, port) = ("127.0.0.1".to_owned(), listener.local_addr().unwrap().port());
    let (events, mut happened) = mpsc::channel(10_000);
    let endpoint = Endpoint::Tcp { host, port, encoding: LinkEncoding::default(), security: Security::Plain };
    let (asked, clock) = (crate::link::SharedAllowance::default(), ServerClock::anchored(Span::ZERO));
    let of = (R0, LinkNumber(0));
    let of_robot = crate::link::OfRobot { asked, ..Default::default() };
    let _link = Link::open_beside_others(of, endpoint, of_robot, clock, events, Duration::ZERO);
    let (mut stream, _) = listener.accept().await.unwrap();
    stream.write_all("x\n".repeat(900).as_bytes()).await.unwrap();
    let mut waiting = Vec::new();
    while waiting.len() < 256 {
        waiting.push(tokio::time::timeout(PATIENCE, happened.recv()).await.unwrap().unwrap());
    }
    // The test holds all places, so none becomes free.
    assert!(tokio::time::timeout(Duration::from_millis(300), happened.recv()).await.is_err());
    drop(waiting);
    // The queue contains one event for the link and 900 for invalid lines.
    for _ in 256..1 + 900 {
        tokio::time::timeout(PATIENCE, happened.recv()).await.unwrap().unwrap();
    }
    assert!(tokio::time::timeout(Duration::from_millis(300), happened.recv()).await.is_err());
}

/// Opens a link to `port` of the local host. Returns the link and the receiver of its events.
fn linked(port: u16) -> (Link, mpsc::Receiver<Happened>) {
    linked_as(crate::link::OfRobot::default(), port)
}

fn linked_as(of_robot: crate::link::OfRobot, port: u16) -> (Link, mpsc::Receiver<Happened>) {
    let (events, happened) = mpsc::channel(64);
    let endpoint = Endpoint::Tcp {
        host: "127.0.0.1".into(),
        port,
        encoding: LinkEncoding::default(),
        security: Security::Plain,
    };
    let (clock, events) = (ServerClock::anchored(Span::ZERO), crate::link::Events::Plain(events));
    let sink = crate::link::EventSink { robot: R0, link: Some(LinkNumber(0)), clock, events };
    (Link::carrying(sink, endpoint, of_robot, Duration::ZERO), happened)
}

fn loss(event: &Event) -> Loss {
    match event {
        Event::LinkDown { loss, .. } => *loss,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn connecting_without_a_listener_is_refused() {
    let port = {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        listener.local_addr().unwrap().port()
    };
    let (_link, mut happened) = linked(port);
    assert_eq!(loss(&next(&mut happened).await), Loss::Refused);
}

#[tokio::test]
async fn idle_link_closed_by_robot_is_noticed_without_sending() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    for resets in [false, true] {
        let (_link, mut happened) = linked(listener.local_addr().unwrap().port());
        let (stream, _) = listener.accept().await.unwrap();
        assert!(matches!(next(&mut happened).await, Event::LinkUp { .. }));
        if resets {
            stream.set_zero_linger().unwrap();
        }
        drop(stream);
        assert_eq!(loss(&next(&mut happened).await), Loss::Closed, "by a reset: {resets}");
    }
}

#[tokio::test]
async fn unread_messages_fill_the_queue_and_sender_gets_an_error() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let (link, _happened) = linked(listener.local_addr().unwrap().port());
    let (mut stream, _) = listener.accept().await.unwrap();
    let request = urrcp::AvailabilityRequest {
        timestamp: None,
        session: "s".repeat(250).parse().ok(),
        seize: false,
        revocation_list: None,
    };
    let mut sent = 0;
    while link.send(Message::AvailabilityRequest(request.clone()), Urgency::InOrder).is_ok() {
        sent += 1;
        assert!(sent < 1_000_000, "a queue without end");
    }
    link.cut();
    let mut bytes = Vec::new();
    let _reset = stream.read_to_end(&mut bytes).await;
    assert!(bytes.len() < sent * 250, "what waited was discarded");
}

#[tokio::test]
async fn script_repeated_by_robot_reuses_the_one_sent() {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let (link, mut happened) = linked(listener.local_addr().unwrap().port());
    let step = |value| Step::new(Millis::ZERO, Setpoint::new(ControlType::Position, value));
    let script = Script::new(vec![step(1.0), step(2.0)]).unwrap();
    let command = Command::Script(script.clone());
    let request = ControlRequest::immediate("arm".parse().unwrap(), command).with_content_hash();
    link.send(request.into(), Urgency::InOrder).unwrap();
    let (stream, _) = listener.accept().await.unwrap();
    let mut stream = tokio::io::BufReader::new(stream);
    stream.read_line(&mut String::new()).await.unwrap();
    let text = serde_json::to_string(&script).unwrap();
    let answer = format!(
        r#"{{"control_response":{{"timestamp":"2026-11-20T19:00:00Z","device_id":"arm","status":"Accepted","status_value":{text}}}}}"#
    );
    stream.write_all(format!("{answer}\n").as_bytes()).await.unwrap();
    assert!(matches!(next(&mut happened).await, Event::LinkUp { .. }));
    let Event::Received { message: Message::ControlResponse(response), .. } = next(&mut happened).await
    else {
        panic!()
    };
    let StatusValue::Script(repeated) = response.status_value else { panic!() };
    assert!(std::ptr::eq(repeated.steps(), script.steps()), "no step was read");
}
