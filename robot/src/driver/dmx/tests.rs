#![expect(clippy::disallowed_methods, reason = "frames are sent in real time")]

use std::net::UdpSocket;
use std::time::{Duration, Instant};

use sacn::packet::{AcnRootLayerProtocol, E131RootLayerData};
use urrcp::{ControlType, DeviceId, InitializationBlock, Setpoint};

use super::*;

/// A receiver of frames at an address of its own, because ports are given by the protocols.
struct Receiver {
    socket: UdpSocket,
    host: String,
}

impl Receiver {
    fn at(host: &str, port: u16) -> Self {
        let socket = heard::shared_socket(host.parse().unwrap(), port).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        Self { socket, host: host.to_owned() }
    }

    fn bytes(&self) -> Vec<u8> {
        let mut buffer = [0; 1_500];
        let length = self.socket.recv(&mut buffer).unwrap();
        buffer[..length].to_vec()
    }

    /// Returns the channels of the next sACN frame, and whether it ends the stream.
    fn frame(&self) -> (Vec<u8>, bool) {
        loop {
            let bytes = self.bytes();
            let packet = AcnRootLayerProtocol::parse(&bytes).unwrap();
            if let E131RootLayerData::DataPacket(data) = packet.pdu.data {
                assert_eq!((data.universe, data.priority, data.data.property_values[0]), (7, 100, 0));
                return (data.data.property_values[1..].to_vec(), data.stream_terminated);
            }
        }
    }

    fn frame_with(&self, is_awaited: impl Fn(&[u8]) -> bool) -> Vec<u8> {
        loop {
            let (frame, _) = self.frame();
            if is_awaited(&frame) {
                return frame;
            }
        }
    }
}

fn block(id: &str) -> InitializationBlock {
    let text = format!(
        r#"{{"id": "{id}", "api_version": "1", "devices": [
            {{"id": "dimmer", "channel": 1, "available_control_types": {{"position": {{"min_value": 0, "max_value": 100, "granularity": 0.1}}}}}},
            {{"id": "pan", "channel": [2, 3], "available_control_types": {{"position": {{"min_value": -270, "max_value": 270, "granularity": 0.01}}}}}}]}}"#
    );
    serde_json::from_str(&text).unwrap()
}

fn fixture(id: &str, protocol: Protocol, channel: u16, host: &str) -> DmxFixture {
    DmxFixture::new(DmxAddress::new(protocol, 7, channel, Some(host.to_owned())), &block(id)).unwrap()
}

fn id(id: &str) -> DeviceId {
    DeviceId::new(id).unwrap()
}

fn at(value: f64) -> Setpoint {
    Setpoint::new(ControlType::Position, value)
}

#[test]
fn fixtures_of_one_universe_do_not_overwrite_each_other() {
    let receiver = Receiver::at("127.0.7.1", 5568);
    let mut first = fixture("first", Protocol::Sacn, 1, &receiver.host);
    let mut second = fixture("second", Protocol::Sacn, 4, &receiver.host);
    first.connect().unwrap();
    second.connect().unwrap();
    first.set(&id("dimmer"), &at(100.0)).unwrap();
    first.ping().unwrap();
    // Devices without a default value are at zero, or at the lower limit of their range.
    assert_eq!(receiver.frame_with(|frame| frame[0] == 255), [255, 128, 0, 0, 128, 0]);
    second.set_frame(&[(id("dimmer"), at(50.0)), (id("pan"), at(270.0))]).unwrap();
    assert_eq!(receiver.frame_with(|frame| frame[3] != 0), [255, 128, 0, 128, 255, 255]);
    drop(second);
    first.set(&id("pan"), &at(-270.0)).unwrap();
    assert_eq!(
        receiver.frame_with(|frame| frame[1] == 0),
        [255, 0, 0, 128, 255, 255],
        "the other fixture holds"
    );
    drop(first);
    while !receiver.frame().1 {}
}

#[test]
fn nothing_is_sent_before_the_first_value_and_blackout_is_sent_at_the_end() {
    let receiver = Receiver::at("127.0.7.2", 5568);
    let address =
        DmxAddress::new(Protocol::Sacn, 7, 1, Some(receiver.host.clone())).with_at_end(AtEnd::Blackout);
    let mut fixture = DmxFixture::new(address, &block("spot")).unwrap();
    fixture.connect().unwrap();
    fixture.ping().unwrap();
    receiver.socket.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    assert!(receiver.socket.recv(&mut [0; 9]).is_err());
    receiver.socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    fixture.set(&id("dimmer"), &at(100.0)).unwrap();
    receiver.frame_with(|frame| frame[0] == 255);
    drop(fixture);
    assert_eq!(receiver.frame_with(|frame| frame[0] == 0), [0, 0, 0, 0]);
}

#[test]
fn fade_passes_through_all_levels_and_keeps_the_rate_of_a_universe() {
    let receiver = Receiver::at("127.0.7.3", 5568);
    let mut fixture = fixture("spot", Protocol::Sacn, 1, &receiver.host);
    fixture.connect().unwrap();
    fixture.set(&id("dimmer"), &at(0.0)).unwrap();
    let begin = Instant::now();
    let ramp =
        Ramp { control_type: ControlType::Position, to: 100.0, duration: Duration::from_millis(1_000) };
    fixture.ramp(&id("dimmer"), ramp).unwrap();
    let mut levels = Vec::new();
    while levels.last() != Some(&255) {
        levels.push(receiver.frame().0[0]);
    }
    assert!(levels.is_sorted(), "{levels:?}");
    let seconds = begin.elapsed().as_secs_f64();
    assert!(levels.len() as f64 <= FRAMES_PER_SECOND * seconds + 5.0, "{} in {seconds} s", levels.len());
    assert!(levels.iter().filter(|level| (1..255).contains(*level)).count() >= 2, "{levels:?}");
}

#[test]
fn reconnected_fixture_keeps_its_levels() {
    let receiver = Receiver::at("127.0.7.4", 5568);
    let mut fixture = fixture("spot", Protocol::Sacn, 1, &receiver.host);
    fixture.connect().unwrap();
    fixture.set(&id("dimmer"), &at(100.0)).unwrap();
    receiver.frame_with(|frame| frame[0] == 255);
    fixture.connect().unwrap();
    fixture.set(&id("pan"), &at(270.0)).unwrap();
    assert_eq!(receiver.frame_with(|frame| frame[1] == 255), [255, 255, 255, 0]);
}

#[test]
fn art_net_frames_have_the_port_address_and_an_even_number_of_channels() {
    let receiver = Receiver::at("127.0.7.5", 6454);
    let mut fixture = fixture("spot", Protocol::ArtNet, 1, &receiver.host);
    fixture.connect().unwrap();
    fixture.set(&id("dimmer"), &at(100.0)).unwrap();
    let frame = receiver.bytes();
    assert_eq!(&frame[..8], b"Art-Net\0");
    // Operation code, version, physical port, port address (low byte first), length (high byte first), levels.
    assert_eq!((&frame[8..12], &frame[13..18]), (&[0x00, 0x50, 0, 14][..], &[0, 7, 0, 0, 4][..]));
    assert_eq!(&frame[18..], [255, 128, 0, 0]);
}

#[test]
fn conflicting_fixtures_are_refused() {
    let mut first = fixture("first", Protocol::Sacn, 1, "127.0.7.6");
    first.connect().unwrap();
    let refused = fixture("second", Protocol::Sacn, 3, "127.0.7.6").connect().unwrap_err();
    assert_eq!(refused.to_string(), "channel 3 of the universe also belongs to `first`");
    let address = DmxAddress::new(Protocol::Sacn, 7, 20, Some("127.0.7.6".to_owned())).with_priority(150);
    let priority = DmxFixture::new(address, &block("third")).unwrap().connect().unwrap_err();
    assert!(
        priority.to_string().contains("priority 100 for another robot, and 150 for this one"),
        "{priority}"
    );
}
