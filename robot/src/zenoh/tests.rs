//! Connections over Zenoh between sessions of this process, from peer to peer over TCP on the loopback interface.

use std::net::TcpListener;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::{Haste, Key, Listener, Network, connect};

/// A network of two: one listens, the other connects.
fn two() -> (Network, Network) {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let here = format!(r#"{{mode: "peer", listen: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}"#);
    let there = format!(r#"{{mode: "client", connect: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}"#);
    (Network::open_with(&here).unwrap(), Network::open_with(&there).unwrap())
}

fn key(key: &str) -> Key {
    key.parse().unwrap()
}

async fn soon<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(30), what).await.unwrap()
}

#[tokio::test]
async fn bytes_go_both_ways_and_the_end_is_read_behind_them() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let mut near = soon(connect(&schedulers, &key("hall/arm"), Haste::None)).await.unwrap();
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
async fn a_key_without_a_robot_and_a_key_with_another_are_told_apart() {
    let (robots, schedulers) = two();
    let _arm = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    // Asked first, as robots do: a session that has connected to robots follows their tokens, and Zenoh may answer it too early.
    let taken = Listener::bind(&schedulers, key("hall/arm")).await.unwrap_err();
    assert_eq!(taken.kind(), std::io::ErrorKind::AddrInUse);
    Listener::bind(&schedulers, key("hall/other")).await.unwrap();
    let nobody = soon(connect(&schedulers, &key("hall/nobody"), Haste::None)).await.unwrap_err();
    assert_eq!(nobody.kind(), std::io::ErrorKind::NotFound);
}

#[tokio::test]
async fn much_goes_through_a_small_window_and_arrives_whole() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("a")).await.unwrap();
    let mut near = soon(connect(&schedulers, &key("a"), Haste::None)).await.unwrap();
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
async fn connections_end_when_a_process_of_either_side_does() {
    for robot_goes in [true, false] {
        let (robots, schedulers) = two();
        let mut listener = Listener::bind(&robots, key("a")).await.unwrap();
        let mut near = soon(connect(&schedulers, &key("a"), Haste::Stop)).await.unwrap();
        let mut far = soon(listener.accept()).await.unwrap();
        near.write_all(b"x").await.unwrap();
        soon(far.read_u8()).await.unwrap();
        // As the system does it: nothing is said any more.
        let (gone, left) = if robot_goes { (robots, &mut near) } else { (schedulers, &mut far) };
        gone.cut();
        let ended = soon(left.read_u8()).await.unwrap_err();
        assert_eq!(ended.kind(), std::io::ErrorKind::ConnectionReset, "{ended}");
        assert!(ended.to_string().contains("process has ended"), "{ended}");
    }
}

#[tokio::test]
async fn a_stop_does_not_wait_behind_much_that_is_not_read() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("a")).await.unwrap();
    let mut near = soon(connect(&schedulers, &key("a"), Haste::None)).await.unwrap();
    let _unread = soon(listener.accept()).await.unwrap();
    let writing = tokio::spawn(async move { near.write_all(&vec![0; 5_000_000]).await });
    let mut stop = soon(connect(&schedulers, &key("a"), Haste::Stop)).await.unwrap();
    let mut heard = soon(listener.accept()).await.unwrap();
    stop.write_all(b"s").await.unwrap();
    assert_eq!(soon(heard.read_u8()).await.unwrap(), b's');
    assert!(!writing.is_finished());
    writing.abort();
}

#[tokio::test]
async fn connections_to_one_robot_hear_their_own_frames_and_no_others() {
    let (robots, schedulers) = two();
    let mut listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let mut pairs = Vec::new();
    for _ in 0..3 {
        let near = soon(connect(&schedulers, &key("hall/arm"), Haste::None)).await.unwrap();
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
    // One of them ends, the others do not.
    drop(pairs.remove(0));
    let (near, far) = &mut pairs[0];
    near.write_u8(7).await.unwrap();
    assert_eq!(soon(far.read_u8()).await.unwrap(), 7);
}

#[tokio::test]
async fn a_robot_that_has_left_and_come_back_is_reached_again() {
    let (robots, schedulers) = two();
    let listener = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    soon(connect(&schedulers, &key("hall/arm"), Haste::None)).await.unwrap();
    drop(listener);
    let refused = async {
        while connect(&schedulers, &key("hall/arm"), Haste::None).await.is_ok() {
            tokio::task::yield_now().await;
        }
        connect(&schedulers, &key("hall/arm"), Haste::None).await.unwrap_err()
    };
    assert_eq!(soon(refused).await.kind(), std::io::ErrorKind::NotFound);
    let _again = Listener::bind(&robots, key("hall/arm")).await.unwrap();
    let reached = async {
        while connect(&schedulers, &key("hall/arm"), Haste::None).await.is_err() {
            tokio::task::yield_now().await;
        }
    };
    soon(reached).await;
}
