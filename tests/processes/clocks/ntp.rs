//! Tests of the server's clock against NTP: a small SNTP server answers with a known offset (RFC 5905, figure 8).

use std::net::UdpSocket;
use std::time::{Duration, SystemTime};

use downbeat::server_clock::ask_ntp;
use urrcp::Span;

use stage::session::{Session, arm_at};

const NTP_EPOCH_SECONDS: u64 = 2_208_988_800;

fn ntp_now(offset: Duration) -> [u8; 8] {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap() + offset;
    let fraction = (u64::from(now.subsec_nanos()) << 32) / 1_000_000_000;
    (((now.as_secs() + NTP_EPOCH_SECONDS) << 32) | fraction).to_be_bytes()
}

/// Starts an SNTP server with this offset that answers every request until the tests end. Returns its address.
fn serve(offset: Duration) -> String {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let mut packet = [0u8; 512];
        while let Ok((_, peer)) = socket.recv_from(&mut packet) {
            let mut answer = [0u8; 48];
            answer[..4].copy_from_slice(&[0b00_100_100, 1, 0, 0xe9]);
            answer[12..16].copy_from_slice(b"LOCL");
            answer[16..24].copy_from_slice(&ntp_now(offset));
            answer[24..32].copy_from_slice(&packet[40..48]);
            answer[32..40].copy_from_slice(&ntp_now(offset));
            answer[40..48].copy_from_slice(&ntp_now(offset));
            let _ = socket.send_to(&answer, peer);
        }
    });
    address
}

#[test]
fn ntp_server_offset_is_measured_within_its_uncertainty() {
    let server = serve(Duration::from_millis(250));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let reading = runtime.block_on(ask_ntp(&server)).unwrap();
    let error = (reading.offset - Span::from_millis(250)).abs();
    // The client's own arithmetic adds rounding of the 32-bit fractions.
    assert!(error <= reading.uncertainty + Span::from_micros(50), "{reading:?}");
    assert_eq!(reading.stratum, 1);
}

#[test]
fn robots_not_synchronized_with_ntp_server_prevent_mission_start() {
    let session = Session::new();
    let fleet = std::fs::read_to_string(session.path("fleet.yaml")).unwrap();
    session.file("arm.yaml", arm_at(45));
    session.file("fleet.yaml", format!("ntp: {}\n{fleet}", serve(Duration::from_millis(250))));
    session.file(
        "test.yaml",
        "scenario: test\ncues:\n  - {at: 0s, robots: arms, tracks: {shoulder: [{at: 0s, to: 45}]}}\n",
    );
    session.run(&["run", "test.yaml"]).says(1, &["stratum 1", "clock off by -2", "test: not started"]);
}

#[test]
fn unresponsive_ntp_server_is_named() {
    let session = Session::new();
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let fleet = std::fs::read_to_string(session.path("fleet.yaml")).unwrap();
    session.file("fleet.yaml", format!("ntp: {}\n{fleet}", silent.local_addr().unwrap()));
    session.file(
        "test.yaml",
        "scenario: test\ncues:\n  - {at: 0s, robots: arms, tracks: {shoulder: [{at: 0s, to: 45}]}}\n",
    );
    session.run(&["run", "test.yaml"]).says(1, &["no NTP time from"]);
}
