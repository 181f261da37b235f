//! Tests a robot that admits only operators with a pass derived from its secret: peers without a proof of identity, and altered data.

use super::*;
use downbeat_sealed::{Claim, Guard, Held, RevokedSerials, Secret, connect};
use urrcp::Role;

/// Starts a robot that requires a pass. Returns its host, its address, and a pass.
async fn sealed(patience: Patience) -> (Host, SocketAddr, Held) {
    sealed_until(patience, 4_000_000_000, None).await
}

/// Like [`sealed`], with a pass that is valid until `expires`, and a list of revoked passes.
async fn sealed_until(
    patience: Patience,
    expires: i64,
    revoked: Option<&RevokedSerials>,
) -> (Host, SocketAddr, Held) {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    sealed_host(host, patience, expires, revoked).await
}

/// Makes a robot of this host reachable, like [`sealed_until`].
async fn sealed_host(
    host: Host,
    patience: Patience,
    expires: i64,
    revoked: Option<&RevokedSerials>,
) -> (Host, SocketAddr, Held) {
    let secret = Secret::generate().unwrap();
    let robot = host.handle().robots()[0].clone();
    let roles = [Role::Observe, Role::Drive].into_iter().collect();
    let claim = Claim { name: "anna".into(), roles, expires, serial: "0a:1b".into() };
    let held = Held { robot: robot.clone(), pass: secret.pass(&claim), claim };
    let door = Door::Sealed(Arc::new(Guard::new(robot, secret, revoked).unwrap()));
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(serve_with(listener, host.handle(), 0, patience, door));
    (host, address, held)
}

async fn ended(stream: &mut TcpStream) {
    let mut rest = Vec::new();
    let ended = tokio::time::timeout(PATIENCE, stream.read_to_end(&mut rest)).await;
    assert!(ended.is_ok(), "it is left open");
}

#[tokio::test]
async fn data_altered_in_transit_ends_the_connection_and_is_counted() {
    let (host, address, held) = sealed(PATIENT).await;
    for (altered, count) in [(&b""[..], 0), (b"\0\0\0\x01sixteen of a code.", 1), (b"\0\0\0\0", 2)] {
        let mut stream = TcpStream::connect(address).await.unwrap();
        let mut spoken = connect(&mut stream, &held).await.unwrap();
        spoken.write_all(ASK).await.unwrap();
        spoken.flush().await.unwrap();
        spoken.read_exact(&mut [0]).await.unwrap();
        drop(spoken);
        stream.write_all(altered).await.unwrap();
        stream.shutdown().await.unwrap();
        ended(&mut stream).await;
        assert_eq!(host.refusals().count(Reason::Altered), count);
    }
    assert_eq!(host.refusals().count(Reason::NotProven), 0);
}

#[tokio::test]
async fn peer_without_proof_is_disconnected_and_counted() {
    let patience = Patience { first_message: Duration::from_millis(500), ..PATIENT };
    let (host, address, held) = sealed(patience).await;
    let other = Held { pass: Secret::generate().unwrap().pass(&held.claim), ..held };
    let stream = TcpStream::connect(address).await.unwrap();
    assert!(connect(stream, &other).await.is_err());
    let mut plain = TcpStream::connect(address).await.unwrap();
    plain.write_all(ASK).await.unwrap();
    ended(&mut plain).await;
    let mut silent = TcpStream::connect(address).await.unwrap();
    ended(&mut silent).await;
    assert_eq!(host.refusals().count(Reason::NotProven), 3);
}

const CLAIM: &[u8] = b"{\"availability_request\":{\"session\":\"s\"}}\n";

#[tokio::test]
async fn open_connection_is_closed_when_its_pass_is_revoked() {
    let path = std::env::temp_dir().join(format!("downbeat-door-{}", std::process::id()));
    std::fs::write(&path, "# none\n# end\n").unwrap();
    let list = RevokedSerials::in_file(&path).unwrap();
    let (host, address, held) = sealed_until(PATIENT, 4_000_000_000, Some(&list)).await;
    let mut stream = TcpStream::connect(address).await.unwrap();
    let mut spoken = connect(&mut stream, &held).await.unwrap();
    spoken.write_all(CLAIM).await.unwrap();
    spoken.flush().await.unwrap();
    spoken.read_exact(&mut [0]).await.unwrap();
    drop(spoken);
    let mut owner = host.handle().owner(0).unwrap();
    assert!(owner.wait_for(Option::is_some).await.is_ok());
    std::fs::write(&path, "0a:1b\n# end\n").unwrap();
    ended(&mut stream).await;
    std::fs::remove_file(&path).unwrap();
    assert_eq!(host.refusals().count(Reason::KeyInvalid), 1);
    assert!(owner.wait_for(Option::is_none).await.is_ok(), "the robot is free");
}

#[tokio::test]
#[expect(clippy::disallowed_methods, reason = "passes are valid by the calendar")]
async fn open_connection_is_closed_when_its_pass_expires() {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs();
    let expires = i64::try_from(now).unwrap() + 5;
    let (host, address, held) = sealed_until(PATIENT, expires, None).await;
    let mut stream = TcpStream::connect(address).await.unwrap();
    drop(connect(&mut stream, &held).await.unwrap());
    assert_eq!(host.refusals().count(Reason::KeyInvalid), 0);
    ended(&mut stream).await;
    assert_eq!(host.refusals().count(Reason::KeyInvalid), 1);
}

#[tokio::test]
async fn key_revoked_during_its_proof_is_not_admitted() {
    let path = std::env::temp_dir().join(format!("downbeat-proving-{}", std::process::id()));
    std::fs::write(&path, "# none\n# end\n").unwrap();
    let list = RevokedSerials::in_file(&path).unwrap();
    let secret = Secret::generate().unwrap();
    let roles = [Role::Drive].into_iter().collect();
    let claim = Claim { name: "anna".into(), roles, expires: 4_000_000_000, serial: "0a:1b".into() };
    let guard = Guard::new("arm".parse().unwrap(), secret.clone(), Some(&list)).unwrap();
    let held = Held { robot: "arm".parse().unwrap(), pass: secret.pass(&claim), claim };
    let door = Door::Sealed(Arc::new(guard));
    let Door::Sealed(guard) = &door else { unreachable!() };
    let keys = crate::serve::keys::Keys::default();
    let admitted = async || {
        let (near, far) = tokio::io::duplex(64 * 1024);
        let (accepted, connected) = tokio::join!(guard.accept(far), connect(near, &held));
        assert!(connected.is_ok());
        accepted.unwrap().1
    };
    let (first, second) = (admitted().await, admitted().await);
    let proof = keys.admit(&door, first.into()).await.unwrap();
    assert!(keys.contains(&proof));
    std::fs::write(&path, "0a:1b\n# end\n").unwrap();
    let refused = keys.admit(&door, second.into()).await.unwrap_err();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(refused.to_string(), "the operator's key was revoked");
}

/// A peer whose messages take long to arrive still has time for its handshake.
#[tokio::test]
async fn slow_handshake_completes_while_many_connections_open() {
    let (_host, address, held) = sealed(PATIENT).await;
    let (near, mut far) = tokio::io::duplex(64 * 1024);
    let mut slow = TcpStream::connect(address).await.unwrap();
    let connecting = tokio::spawn(async move {
        let mut sealed = connect(near, &held).await?;
        sealed.write_all(ASK).await?;
        sealed.flush().await?;
        sealed.read_exact(&mut [0]).await
    });
    // Transfers a part of the handshake, then opens many other connections, and so on.
    let mut flood = Vec::new();
    let mut buffer = [0; 1024];
    for _ in 0..2 {
        let n = far.read(&mut buffer).await.unwrap();
        slow.write_all(&buffer[..n]).await.unwrap();
        for _ in 0..200 {
            flood.push(TcpStream::connect(address).await.unwrap());
        }
        let n = slow.read(&mut buffer).await.unwrap();
        far.write_all(&buffer[..n]).await.unwrap();
    }
    let copied = tokio::io::copy_bidirectional(&mut slow, &mut far);
    let connected = tokio::select! {
        connected = connecting => connected.unwrap(),
        _ = copied => panic!("the robot has closed the connection"),
    };
    assert!(connected.is_ok(), "{connected:?}");
}

/// Reads the messages of a sealed connection up to the response with this status.
async fn until_status<S: tokio::io::AsyncRead + Unpin>(stream: &mut S, status: Status) {
    let mut decoder = Decoder::default();
    loop {
        while let Some(decoded) = decoder.next_message() {
            if matches!(decoded.unwrap(), Message::ControlResponse(response) if response.status == status) {
                return;
            }
        }
        let mut bytes = [0; 1024];
        let n = tokio::time::timeout(PATIENCE, stream.read(&mut bytes)).await.unwrap().unwrap();
        assert_ne!(n, 0, "the connection ended");
        decoder.push(&bytes[..n]);
    }
}

#[tokio::test]
async fn audit_trail_records_who_connected_claimed_moved_and_stopped() {
    use crate::audit::{Chain, Event};
    let path = std::env::temp_dir().join(format!("downbeat-who-{}.jsonl", std::process::id()));
    let _left_by_an_earlier_test = std::fs::remove_file(&path);
    let options = HostOptions::default().with_audit(path.clone());
    let host = Host::start(arms(1, &Settings::default()), options).unwrap();
    let (host, address, held) = sealed_host(host, PATIENT, 4_000_000_000, None).await;
    let mut stranger = TcpStream::connect(address).await.unwrap();
    stranger.write_all(ASK).await.unwrap();
    ended(&mut stranger).await;
    let stream = TcpStream::connect(address).await.unwrap();
    let from = stream.local_addr().unwrap().to_string();
    let mut sealed = connect(stream, &held).await.unwrap();
    let send = |message: &Message| {
        let mut line = Vec::new();
        encode(message, &mut line);
        line
    };
    let Message::ControlRequest(request) = with_session(paper(LEAD_MS), "s") else { panic!() };
    let request = urrcp::ControlRequest { request_id: urrcp::RequestId::new("act-1").ok(), ..request };
    let mut bytes = CLAIM.to_vec();
    bytes.extend(send(&Message::ControlRequest(request)));
    sealed.write_all(&bytes).await.unwrap();
    sealed.flush().await.unwrap();
    until_status(&mut sealed, Status::Ok).await;
    let device = urrcp::DeviceId::new("arm").unwrap();
    let stop = urrcp::ControlRequest::immediate(device, Command::Script(urrcp::Script::cancel()));
    sealed.write_all(&send(&with_session(Message::ControlRequest(stop), "s"))).await.unwrap();
    sealed.flush().await.unwrap();
    until_status(&mut sealed, Status::Ok).await;
    host.stop();
    let (mut chain, mut records) = (Chain::default(), Vec::new());
    let file = std::fs::File::open(&path).unwrap();
    chain.check("trail", std::io::BufReader::new(file), |record, _| records.push(record)).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(chain.faults, [""; 0]);
    let of = |event| records.iter().filter(move |record| record.event == event).collect::<Vec<_>>();
    assert!(of(Event::Refused).iter().all(|record| record.operator.is_none() && record.reason.is_some()));
    assert_eq!(of(Event::Refused).len(), 1);
    let anna = of(Event::Connected)[0];
    assert_eq!(anna.operator.as_deref(), Some("anna"));
    assert_eq!((anna.serial.as_deref(), anna.peer.as_deref()), (Some("0a:1b"), Some(from.as_str())));
    assert_eq!(of(Event::Claimed)[0].session.as_deref(), Some("s"));
    // One record for all steps of a script.
    let [moved] = of(Event::Moved)[..] else { panic!("{records:?}") };
    assert_eq!((moved.operator.as_deref(), moved.device.as_deref()), (Some("anna"), Some("arm")));
    assert_eq!((moved.request.as_deref(), moved.session.as_deref()), (Some("act-1"), Some("s")));
    assert_eq!(of(Event::Stopped)[0].operator.as_deref(), Some("anna"));
}
