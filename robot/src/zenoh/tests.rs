//! Tests connections over Zenoh between two sessions of this process, which connect directly over TCP on the loopback interface.

use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ::zenoh::Wait;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use urrcp::ContentHash;

use super::network::{HEARINGS_MAX, OPENING_MAX};
use super::{Key, Listener, Network, Networks, Stream, Text, Urgency, connect, connect_sharing};

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn listening(port: u16) -> String {
    format!(r#"{{mode: "peer", listen: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}"#)
}

fn connecting(port: u16) -> String {
    format!(r#"{{mode: "client", connect: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}"#)
}

/// Returns two sessions of one network: the first listens, and the second connects to it.
fn two() -> (Network, Network) {
    let port = free_port();
    (Network::open_with(&listening(port)).unwrap(), Network::open_with(&connecting(port)).unwrap())
}

fn key(key: &str) -> Key {
    key.parse().unwrap()
}

async fn soon<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(30), what).await.unwrap()
}

#[tokio::test]
async fn bytes_are_sent_in_both_directions_and_followed_by_the_end() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let mut near = soon(connect(&schedulers, &key("hall/arm"), Urgency::None)).await.unwrap();
    let mut far = soon(listener.accept()).await.unwrap();
    assert_eq!(near.name(), far.name());
    near.write_all(b"ask").await.unwrap();
    let mut came = [0; 3];
    soon(far.read_exact(&mut came)).await.unwrap();
    assert_eq!(&came, b"ask");
    far.write_all(b"answer").await.unwrap();
    drop(far);
    let mut all = Vec::new();
    soon(near.read_to_end(&mut all)).await.unwrap();
    assert_eq!(all, b"answer");
}

#[tokio::test]
async fn key_without_a_robot_and_key_in_use_give_different_errors() {
    let (robots, schedulers) = two();
    let _arm = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    // Checked before any connection, as robots do. A session that has connected to robots observes their tokens, and Zenoh may then
    // answer too early.
    let taken = Listener::bind(&schedulers, key("hall/arm")).await.unwrap_err();
    assert_eq!(taken.kind(), std::io::ErrorKind::AddrInUse);
    Listener::bind(&schedulers, key("hall/other")).await.unwrap();
    let nobody = soon(connect(&schedulers, &key("hall/nobody"), Urgency::None)).await.unwrap_err();
    assert_eq!(nobody.kind(), std::io::ErrorKind::NotFound);
}

#[tokio::test]
async fn robots_are_distributed_among_sessions_that_all_reach_them() {
    let port = free_port();
    let robots = Networks::open_with_sessions_of(&listening(port), 2).unwrap();
    let listening: Vec<_> = (0..5).map(|_| robots.for_one_more()).collect();
    assert!(listening.iter().all(|network| network.id() == listening[0].id()), "its port is taken once");
    let schedulers = Networks::open_with_sessions_of(&connecting(port), 2).unwrap();
    let sessions: Vec<_> = (0..5).map(|_| schedulers.for_one_more()).collect();
    let ids: Vec<_> = sessions.iter().map(Network::id).collect();
    let firsts: Vec<_> = ids.iter().map(|id| ids.iter().position(|one| one == id).unwrap()).collect();
    assert_eq!(firsts, [0, 0, 2, 2, 4]);
    let mut arm = Listener::bind(&listening[4], key("hall/arm")).await.unwrap();
    for session in &sessions {
        let mut near = soon(connect(session, &key("hall/arm"), Urgency::None)).await.unwrap();
        let mut far = soon(arm.accept()).await.unwrap();
        near.write_all(b"x").await.unwrap();
        assert_eq!(soon(far.read_u8()).await.unwrap(), b'x');
    }
}

/// Returns a new port, which forwards one connection to `port` and rejects later ones. Also returns the number of rejected connections.
fn way_for_one(port: u16) -> (u16, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (way, turned_away) = (listener.local_addr().unwrap().port(), Arc::new(AtomicUsize::new(0)));
    let counted = Arc::clone(&turned_away);
    std::thread::spawn(move || {
        let (near, _) = listener.accept().unwrap();
        let far = TcpStream::connect(("127.0.0.1", port)).unwrap();
        for (mut from, mut to) in [(near.try_clone().unwrap(), far.try_clone().unwrap()), (far, near)] {
            std::thread::spawn(move || std::io::copy(&mut from, &mut to));
        }
        for _ in listener.incoming() {
            counted.fetch_add(1, Ordering::Relaxed);
        }
    });
    (way, turned_away)
}

#[test]
fn robots_share_last_session_without_delay_if_no_other_can_be_opened() {
    let port = free_port();
    let _robots = Network::open_with(&listening(port)).unwrap();
    let (way, turned_away) = way_for_one(port);
    let schedulers = Networks::open_with_sessions_of(&connecting(way), 2).unwrap();
    let sessions: Vec<_> = (0..9).map(|_| schedulers.for_one_more()).collect();
    assert!(sessions.iter().all(|session| session.id() == sessions[0].id()));
    assert_eq!(
        turned_away.load(Ordering::Relaxed),
        1,
        "a network that does not answer may take ten seconds to say so"
    );
}

#[test]
fn session_subscribes_to_at_most_sixteen_schedulers_per_place() {
    let network = Network::open_with(&listening(free_port())).unwrap();
    let key_of = |place: usize, scheduler: usize| format!("hall/{place}/shared/{scheduler:x}");
    let all = |place: usize| (0..HEARINGS_MAX).map(move |scheduler| key_of(place, scheduler));
    let heard: Vec<_> = (0..3).flat_map(all).map(|key| network.hearing(key).unwrap()).collect();
    assert!(network.hearing(key_of(1, HEARINGS_MAX)).is_none(), "one more at a place");
    drop(heard);
    assert!(network.hearing(key_of(1, HEARINGS_MAX)).is_some(), "those of before are gone");
}

#[tokio::test]
async fn connections_wait_while_many_are_being_opened_but_stops_do_not() {
    let (robots, schedulers) = two();
    let (arm, _listener) = (key("a"), Listener::bind(&robots, key("a")).await.unwrap());
    let mut opening = Vec::new();
    for _ in 0..OPENING_MAX {
        opening.push(soon(schedulers.may_open(Urgency::None)).await.unwrap());
    }
    soon(connect(&schedulers, &arm, Urgency::Stop)).await.unwrap();
    let mut waiting = Box::pin(connect(&schedulers, &arm, Urgency::None));
    assert!(tokio::time::timeout(Duration::from_millis(300), &mut waiting).await.is_err());
    drop(opening.pop());
    soon(waiting).await.unwrap();
}

#[tokio::test]
async fn large_data_passes_intact_through_a_small_window() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("a")).await.unwrap();
    let mut near = soon(connect(&schedulers, &key("a"), Urgency::None)).await.unwrap();
    let mut far = soon(listener.accept()).await.unwrap();
    let much: Vec<u8> = (0..5_000_000_u32).map(|i| u8::try_from(i % 251).unwrap()).collect();
    let sent = much.clone();
    let writing = tokio::spawn(async move {
        near.write_all(&sent).await.unwrap();
        near.shutdown().await.unwrap();
        near
    });
    let mut came = Vec::new();
    soon(far.read_to_end(&mut came)).await.unwrap();
    assert!(came == much);
    drop(writing.await.unwrap());
}

#[tokio::test]
async fn connections_end_when_a_process_of_either_side_ends() {
    for robot_goes in [true, false] {
        let (robots, schedulers) = two();
        let mut listener = Listener::bind(&robots, key("a")).await.unwrap();
        let mut near = soon(connect(&schedulers, &key("a"), Urgency::Stop)).await.unwrap();
        let mut far = soon(listener.accept()).await.unwrap();
        near.write_all(b"x").await.unwrap();
        soon(far.read_u8()).await.unwrap();
        // As if the operating system had ended the process: no further message is sent.
        let (gone, left) = if robot_goes { (robots, &mut near) } else { (schedulers, &mut far) };
        gone.cut();
        let ended = soon(left.read_u8()).await.unwrap_err();
        assert_eq!(ended.kind(), std::io::ErrorKind::ConnectionReset, "{ended}");
        assert!(ended.to_string().contains("process or the connection to it has ended"), "{ended}");
    }
}

#[tokio::test]
async fn stop_does_not_wait_behind_unread_data() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("a")).await.unwrap();
    let mut near = soon(connect(&schedulers, &key("a"), Urgency::None)).await.unwrap();
    let _unread = soon(listener.accept()).await.unwrap();
    let writing = tokio::spawn(async move { near.write_all(&vec![0; 5_000_000]).await });
    let mut stop = soon(connect(&schedulers, &key("a"), Urgency::Stop)).await.unwrap();
    let mut heard = soon(listener.accept()).await.unwrap();
    stop.write_all(b"s").await.unwrap();
    assert_eq!(soon(heard.read_u8()).await.unwrap(), b's');
    assert!(!writing.is_finished());
    writing.abort();
}

#[tokio::test]
async fn connections_to_one_robot_receive_only_their_own_frames() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let mut pairs = Vec::new();
    for _ in 0..3 {
        let near = soon(connect(&schedulers, &key("hall/arm"), Urgency::None)).await.unwrap();
        let far = soon(listener.accept()).await.unwrap();
        assert_eq!(near.name(), far.name());
        pairs.push((near, far));
    }
    for (number, (near, far)) in (0..).zip(&mut pairs) {
        near.write_u8(number).await.unwrap();
        far.write_u8(10 + number).await.unwrap();
    }
    for (number, (near, far)) in (0..).zip(&mut pairs) {
        assert_eq!(soon(far.read_u8()).await.unwrap(), number);
        assert_eq!(soon(near.read_u8()).await.unwrap(), 10 + number);
    }
    // The end of one connection does not end the others.
    drop(pairs.remove(0));
    let (near, far) = &mut pairs[0];
    near.write_u8(7).await.unwrap();
    assert_eq!(soon(far.read_u8()).await.unwrap(), 7);
}

#[tokio::test]
async fn robot_that_left_and_returned_is_reached_again() {
    let (robots, schedulers) = two();
    let listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    soon(connect(&schedulers, &key("hall/arm"), Urgency::None)).await.unwrap();
    drop(listener);
    let refused = async {
        while connect(&schedulers, &key("hall/arm"), Urgency::None).await.is_ok() {
            tokio::task::yield_now().await;
        }
        connect(&schedulers, &key("hall/arm"), Urgency::None).await.unwrap_err()
    };
    assert_eq!(soon(refused).await.kind(), std::io::ErrorKind::NotFound);
    let _again = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let reached = async {
        while connect(&schedulers, &key("hall/arm"), Urgency::None).await.is_err() {
            tokio::task::yield_now().await;
        }
    };
    soon(reached).await;
}

/// Returns a text that does not fit into one frame.
fn long_text() -> Vec<u8> {
    (0..200_000_u32).map(|i| u8::try_from(i % 251).unwrap()).collect()
}

fn offer(stream: &Stream, text: &[u8]) -> Option<Text> {
    stream.offer(7, ContentHash::of(text), || text.to_vec())
}

/// Writes `<`, an offered text, and `>`, and then closes the stream for writing.
async fn write_around(mut stream: Stream, text: Text) -> Stream {
    stream.write_with(b"<>", &[(1, text)]).await.unwrap();
    stream.shutdown().await.unwrap();
    stream
}

async fn read_all(mut stream: Stream) -> std::io::Result<Vec<u8>> {
    let mut all = Vec::new();
    soon(stream.read_to_end(&mut all)).await.map(|_| all)
}

fn around(text: &[u8]) -> Vec<u8> {
    [b"<", text, b">"].concat()
}

/// Returns a list to which the length of each message at these keys is added when the session receives it.
fn heard(network: &Network, keys: &'static str) -> Arc<Mutex<Vec<usize>>> {
    let heard = Arc::new(Mutex::new(Vec::new()));
    let (hears, (declared, begun)) = (Arc::clone(&heard), std::sync::mpsc::channel());
    network.declare(Urgency::None, move |session| {
        let subscriber = session.declare_subscriber(keys);
        let subscriber =
            subscriber.callback(move |sample| hears.lock().unwrap().push(sample.payload().len()));
        subscriber.background().wait().unwrap();
        declared.send(()).unwrap();
    });
    begun.recv().unwrap();
    heard
}

/// Opens a connection that may refer to texts published for several robots. Returns both of its ends.
async fn sharing(schedulers: &Network, listener: &mut Listener) -> (Stream, Stream) {
    let connected = async {
        loop {
            // A router may not know about the robot yet.
            match connect_sharing(schedulers, listener.key(), &[3, 7]).await {
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => tokio::task::yield_now().await,
                connected => return connected.unwrap(),
            }
        }
    };
    let near = soon(connected).await;
    (near, soon(listener.accept()).await.unwrap())
}

#[tokio::test]
async fn text_for_several_robots_is_published_once_and_inserted_by_each() {
    let (robots, schedulers) = two();
    let published = heard(&robots, "hall/shared/*/*");
    let frames = heard(&robots, "hall/*/to");
    let (text, mut pairs) = (long_text(), Vec::new());
    for i in 0..5 {
        let mut listener = Listener::bind(&robots, key(&format!("hall/r{i}"))).await.unwrap();
        pairs.push((sharing(&schedulers, &mut listener).await, listener));
    }
    for ((near, far), _) in pairs {
        let offered = offer(&near, &text).unwrap();
        let near = write_around(near, offered).await;
        assert!(read_all(far).await.unwrap() == around(&text));
        drop(near);
    }
    assert_eq!(*published.lock().unwrap(), [text.len()]);
    assert!(frames.lock().unwrap().iter().all(|bytes| *bytes < 100), "{frames:?}");
}

#[tokio::test]
async fn robot_requests_a_publication_that_it_missed() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let (near, far) = sharing(&schedulers, &mut listener).await;
    robots.hearing(format!("hall/shared/{}", schedulers.id())).unwrap().withhold();
    let text = long_text();
    let offered = offer(&near, &text).unwrap();
    let _near = write_around(near, offered).await;
    assert!(read_all(far).await.unwrap() == around(&text));
}

#[tokio::test]
async fn robot_started_later_requests_an_earlier_publication() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let here = format!(r#"{{mode: "router", listen: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}"#);
    let there = format!(r#"{{mode: "client", connect: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}"#);
    let [first, schedulers, later] = [&here, &there, &there].map(|to| Network::open_with(to).unwrap());
    let (text, mut published) = (long_text(), None);
    for robots in [&first, &later] {
        let mut listener = Listener::bind(robots, key(&format!("hall/{}", robots.id()))).await.unwrap();
        let published = published.get_or_insert_with(|| heard(robots, "hall/shared/*/*"));
        let (near, far) = sharing(&schedulers, &mut listener).await;
        let offered = offer(&near, &text).unwrap();
        let _near = write_around(near, offered).await;
        assert!(read_all(far).await.unwrap() == around(&text));
        assert_eq!(*published.lock().unwrap(), [text.len()]);
    }
}

#[tokio::test]
async fn missing_text_ends_connection_and_next_one_carries_all_data_itself() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let (near, far) = sharing(&schedulers, &mut listener).await;
    let shared = format!("hall/shared/{}", schedulers.id());
    robots.hearing(shared.clone()).unwrap().withhold();
    // Another session answers instead of the scheduler, but not with the requested text.
    let (declared, begun) = std::sync::mpsc::channel();
    robots.declare(Urgency::None, move |session| {
        let liar = session.declare_queryable(shared.clone()).complete(true);
        let liar = liar.callback(move |query| query.reply(shared.clone(), "a lie").wait().unwrap());
        liar.background().wait().unwrap();
        declared.send(()).unwrap();
    });
    begun.recv().unwrap();
    let offered = offer(&near, &long_text()).unwrap();
    near.forget_offers();
    let mut near = write_around(near, offered).await;
    let broken = read_all(far).await.unwrap_err();
    assert!(broken.to_string().contains("did not arrive"), "{broken}");
    let told = soon(near.read_u8()).await.unwrap_err();
    assert!(told.to_string().contains("did not receive a script"), "{told}");
    drop(near);
    let (mut near, far) = sharing(&schedulers, &mut listener).await;
    assert!(offer(&near, &long_text()).is_none());
    near.write_all(b"whole").await.unwrap();
    drop(near);
    assert_eq!(read_all(far).await.unwrap(), b"whole");
}

#[tokio::test]
async fn foreign_publications_change_nothing() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let (near, far) = sharing(&schedulers, &mut listener).await;
    let shared = format!("hall/shared/{}", schedulers.id());
    schedulers.call(Urgency::None, move |session| {
        session.put(format!("{shared}/7"), "a lie").wait().unwrap();
        session.put(format!("{shared}/7"), vec![0; 8 * 1024 * 1024]).wait().unwrap();
    });
    let text = long_text();
    let offered = offer(&near, &text).unwrap();
    let _near = write_around(near, offered).await;
    assert!(read_all(far).await.unwrap() == around(&text));
}

#[tokio::test]
async fn text_is_published_only_to_its_audience() {
    let (robots, schedulers) = two();
    let published = heard(&robots, "hall/shared/*/7");
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let (near, far) = sharing(&schedulers, &mut listener).await;
    let hash = ContentHash::of(b"other");
    let other = near.offer(8, hash, || b"other".to_vec()).unwrap();
    // The robot does not receive this text when it is published, and requests it.
    let _near = write_around(near, other).await;
    assert_eq!(read_all(far).await.unwrap(), b"<other>");
    assert_eq!(*published.lock().unwrap(), [0_usize; 0]);
}

#[tokio::test]
async fn only_connections_to_subscribed_robots_may_refer_to_publications() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let plain = soon(connect(&schedulers, &key("hall/arm"), Urgency::None)).await.unwrap();
    assert!(offer(&plain, b"text").is_none(), "it was not asked for");
    drop(soon(listener.accept()).await.unwrap());
    let _others: Vec<_> = (0..16).map(|i| robots.hearing(format!("hall/shared/{i}")).unwrap()).collect();
    let (near, _far) = sharing(&schedulers, &mut listener).await;
    assert!(offer(&near, b"text").is_none(), "it hears as many schedulers as it may");
}
