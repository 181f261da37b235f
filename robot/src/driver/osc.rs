//! Drives hardware and programs that receive Open Sound Control 1.0 over UDP.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, ToSocketAddrs, UdpSocket};

use rosc::{OscBundle, OscMessage, OscPacket, OscTime, OscType};
use urrcp::{ControlParameters, Device, DeviceId, InitializationBlock, Setpoint};

use super::{Driver, DriverError};

/// Where messages are sent: each to the OSC address `PATH/DEVICE`, with the device's id.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct OscAddress {
    /// Host name or IP address of the receiver.
    pub host: String,
    /// UDP port of the receiver.
    pub port: u16,
    /// Beginning of all OSC addresses, such as `/cue`; may be empty.
    pub path: String,
}

impl OscAddress {
    /// Creates the address of a receiver.
    #[must_use]
    pub const fn new(host: String, port: u16, path: String) -> Self {
        Self { host, port, path }
    }
}

/// Sends the values of one robot as OSC messages.
#[derive(Debug)]
pub struct OscRobot {
    address: OscAddress,
    /// The OSC address of each device, and the type of its values.
    devices: BTreeMap<DeviceId, (String, Number)>,
    socket: Option<UdpSocket>,
}

/// The type of an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Number {
    /// `i`, for devices whose values are whole numbers.
    Int,
    /// `f`.
    Float,
}

impl OscRobot {
    /// Creates the driver of a robot. A device whose granularity is a whole number receives integers, any other device floats.
    ///
    /// # Errors
    /// [`DriverError::Refused`] if the id of a device cannot be a part of an OSC address, or a device is a sensor.
    pub fn new(address: OscAddress, block: &InitializationBlock) -> Result<Self, DriverError> {
        let named = |device: &Device| {
            let id = device.id.as_str();
            if device.available_control_types.sensor().is_some() {
                return Err(DriverError::Refused(format!(
                    "`{id}` is a sensor, and OSC receivers cannot be read"
                )));
            }
            if id.chars().any(|c| !c.is_ascii_graphic() || " #*,?[]{}".contains(c)) {
                let expected = "printable ASCII characters without spaces and #*,?[]{}";
                return Err(DriverError::Refused(format!(
                    "the device id `{id}` cannot be a part of an OSC address, expected {expected}"
                )));
            }
            Ok((device.id.clone(), (format!("{}/{id}", address.path), number(device))))
        };
        let devices = block.devices.iter().map(named).collect::<Result<_, _>>()?;
        Ok(Self { address, devices, socket: None })
    }

    fn message(&self, device: &DeviceId, setpoint: &Setpoint) -> Result<OscPacket, DriverError> {
        let (addr, number) = self
            .devices
            .get(device)
            .ok_or_else(|| DriverError::Refused(format!("unknown device `{device}`")))?;
        let args = setpoint.values().map(|value| argument(value, *number)).collect();
        Ok(OscPacket::Message(OscMessage { addr: addr.clone(), args }))
    }

    fn send(&self, packet: &OscPacket) -> Result<(), DriverError> {
        let socket =
            self.socket.as_ref().ok_or_else(|| DriverError::Away("the socket is not open".to_owned()))?;
        let bytes = rosc::encoder::encode(packet).map_err(|error| DriverError::Refused(error.to_string()))?;
        socket.send(&bytes).map(drop).map_err(|error| self.away(&error))
    }

    fn away(&self, error: &io::Error) -> DriverError {
        let OscAddress { host, port, .. } = &self.address;
        match error.kind() {
            io::ErrorKind::ConnectionRefused => {
                DriverError::Away(format!("no program receives OSC at {host}:{port}"))
            }
            _ => DriverError::Away(format!("{host}:{port}: {error}")),
        }
    }
}

fn number(device: &Device) -> Number {
    let types = &device.available_control_types;
    let whole = |(_, parameters): (_, &ControlParameters)| match parameters {
        ControlParameters::Motion(limits) => limits.granularity.fract() == 0.0,
        ControlParameters::Custom(_) => {
            types.script().is_some_and(|script| script.limits.granularity.fract() == 0.0)
        }
        _ => true,
    };
    if types.iter().all(whole) { Number::Int } else { Number::Float }
}

/// Returns an OSC argument. A whole number beyond 32 bits becomes a float.
fn argument(value: f64, number: Number) -> OscType {
    #[expect(clippy::cast_possible_truncation, reason = "within the range of the type, or rounded to it")]
    match number {
        Number::Int if value.abs() <= f64::from(i32::MAX) => OscType::Int(value.round() as i32),
        Number::Int | Number::Float => OscType::Float(value as f32),
    }
}

impl Driver for OscRobot {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.socket = None;
        let OscAddress { host, port, .. } = &self.address;
        let open = || {
            let mut found = (host.as_str(), *port).to_socket_addrs()?;
            let to = found.next().ok_or(io::ErrorKind::NotFound)?;
            let any: IpAddr =
                if to.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
            let socket = UdpSocket::bind((any, 0))?;
            socket.set_broadcast(true)?;
            socket.connect(to)?;
            socket.set_nonblocking(true)?;
            Ok(socket)
        };
        self.socket = Some(open().map_err(|error: io::Error| self.away(&error))?);
        Ok(())
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        self.send(&self.message(device, setpoint)?)
    }

    fn set_frame(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), DriverError> {
        let content = values.iter().map(|(device, setpoint)| self.message(device, setpoint));
        let content = content.collect::<Result<Vec<_>, _>>()?;
        match &content[..] {
            [single] => self.send(single),
            _ => self.send(&OscPacket::Bundle(OscBundle { timetag: IMMEDIATELY, content })),
        }
    }

    fn takes_frames(&self) -> bool {
        true
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        Err(DriverError::Refused(format!("`{sensor}` cannot be read: OSC receivers do not answer")))
    }

    /// Checks whether the network has reported that no program receives the messages. Only the receiver's machine reports that, and only
    /// after a message.
    fn ping(&mut self) -> Result<(), DriverError> {
        let socket =
            self.socket.as_ref().ok_or_else(|| DriverError::Away("the socket is not open".to_owned()))?;
        match socket.take_error() {
            Ok(None) => Ok(()),
            Ok(Some(error)) | Err(error) => Err(self.away(&error)),
        }
    }
}

/// The time tag for messages that take effect on arrival (OSC 1.0).
const IMMEDIATELY: OscTime = OscTime { seconds: 0, fractional: 1 };

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use urrcp::ControlType;

    use super::*;

    fn block(devices: &str) -> InitializationBlock {
        let text = format!(r#"{{"id": "qlab", "api_version": "1", "devices": [{devices}]}}"#);
        serde_json::from_str(&text).unwrap()
    }

    fn position(id: &str, granularity: f64) -> String {
        format!(
            r#"{{"id": "{id}", "available_control_types": {{"position": {{"min_value": 0, "max_value": 10, "granularity": {granularity}}}}}}}"#
        )
    }

    fn driver(port: u16, devices: &str) -> Result<OscRobot, DriverError> {
        OscRobot::new(OscAddress::new("127.0.0.1".to_owned(), port, "/cue".to_owned()), &block(devices))
    }

    fn received(socket: &UdpSocket) -> OscPacket {
        let mut buffer = [0; 1_500];
        let length = socket.recv(&mut buffer).unwrap();
        rosc::decoder::decode_udp(&buffer[..length]).unwrap().1
    }

    fn id(id: &str) -> DeviceId {
        DeviceId::new(id).unwrap()
    }

    #[test]
    fn values_are_received_as_messages_and_simultaneous_ones_as_a_bundle() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let port = socket.local_addr().unwrap().port();
        let devices = format!("{},{}", position("1/start", 1.0), position("level", 0.01));
        let mut driver = driver(port, &devices).unwrap();
        driver.connect().unwrap();
        let at = |value| Setpoint::new(ControlType::Position, value);
        let message =
            |addr: &str, arg| OscPacket::Message(OscMessage { addr: addr.to_owned(), args: vec![arg] });
        driver.set(&id("1/start"), &at(1.0)).unwrap();
        assert_eq!(received(&socket), message("/cue/1/start", OscType::Int(1)));
        driver.set_frame(&[(id("1/start"), at(2.0)), (id("level"), at(0.25))]).unwrap();
        let OscPacket::Bundle(bundle) = received(&socket) else { panic!("no bundle") };
        assert_eq!(bundle.timetag, IMMEDIATELY);
        let expected =
            [message("/cue/1/start", OscType::Int(2)), message("/cue/level", OscType::Float(0.25))];
        assert_eq!(bundle.content, expected);
        driver.ping().unwrap();
    }

    #[test]
    fn receiver_that_is_not_there_is_reported_after_a_message() {
        let unused = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut driver = driver(unused, &position("go", 1.0)).unwrap();
        driver.connect().unwrap();
        // The system may report the refusal with the message itself, or with a later call.
        let set = driver.set(&id("go"), &Setpoint::new(ControlType::Position, 1.0));
        let mut pings = (0..20_000).map(|_| driver.ping());
        let error = set.err().or_else(|| pings.find_map(Result::err)).unwrap();
        assert_eq!(error, DriverError::Away(format!("no program receives OSC at 127.0.0.1:{unused}")));
    }

    #[test]
    fn device_that_cannot_be_addressed_is_refused() {
        let error = driver(1, &position("a b", 1.0)).unwrap_err().to_string();
        assert!(error.contains("the device id `a b` cannot be a part of an OSC address"), "{error}");
        let sensor =
            r#"{"id": "eye", "available_control_types": {"sensor": {"min_value": 0, "max_value": 1}}}"#;
        assert!(driver(1, sensor).unwrap_err().to_string().contains("cannot be read"));
    }
}
