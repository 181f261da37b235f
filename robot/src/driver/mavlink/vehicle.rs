//! Drives a multicopter: take-off, landing, and positions in the local frame.
#![expect(clippy::disallowed_methods, reason = "messages of a vehicle in real time")]

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use mavlink::dialects::common::{
    COMMAND_LONG_DATA, HEARTBEAT_DATA, MavAutopilot, MavCmd, MavFrame, MavMessage, MavResult, MavType,
    PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use mavlink::error::MessageReadError;
use mavlink::{MavHeader, MavlinkReader};
use urrcp::{Device, DeviceId, InitializationBlock, Setpoint};

use super::{MavlinkAddress, VehicleEnd};
use crate::driver::{Driver, DriverError};

/// Number of ArduCopter's mode in which it follows positions of a ground station.
const GUIDED: f32 = 4.0;
/// A vehicle whose last message is older than this does not answer. Connected, it sends 20 positions per second.
const SILENCE_MAX: Duration = Duration::from_secs(1);
/// Time to wait for a heartbeat when connecting.
const HEARTBEAT_WAIT: Duration = Duration::from_millis(1_100);
/// Time to wait for the acknowledgement of a command.
const ACK_WAIT: Duration = Duration::from_millis(300);
/// How often a command is sent until it is acknowledged.
const ATTEMPTS: u8 = 3;
/// Interval of this program's own heartbeats, without which autopilots assume that the ground station is lost.
const OWN_HEARTBEAT: Duration = Duration::from_secs(1);
/// Interval of the positions that are requested from the vehicle, in microseconds.
const POSITION_INTERVAL_US: f32 = 50_000.0;
/// The number of LOCAL_POSITION_NED.
const LOCAL_POSITION: f32 = 32.0;
/// The number of ATTITUDE.
const ATTITUDE: f32 = 30.0;
/// Number of packets that are taken at once, so that a flood of them delays no value for long.
const PACKETS_MAX: usize = 1_000;
/// The usual ids of a ground station.
const STATION: MavHeader = MavHeader { system_id: 255, component_id: 190, sequence: 0 };

/// Drives one vehicle.
#[derive(Debug)]
pub struct MavlinkVehicle {
    address: MavlinkAddress,
    socket: Option<UdpSocket>,
    heard: Heard,
    /// The commanded position and heading.
    target: Place,
    /// Whether the vehicle was ordered to fly.
    flies: bool,
    sequence: u8,
    last_own_heartbeat: Option<Instant>,
}

/// The messages of the vehicle.
#[derive(Debug, Default)]
struct Heard {
    vehicle: Option<Vehicle>,
    /// When the last message of the vehicle arrived.
    heard_at: Option<Instant>,
    /// Where the vehicle is. `None` before its first report.
    place: Option<Place>,
    /// Heading in degrees, counterclockwise from x.
    yaw: Option<f64>,
    /// Charge of the battery, in percent.
    battery: Option<f64>,
    /// The result of the last command, by the number of the command.
    acknowledged: Option<(MavCmd, MavResult)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Vehicle {
    from: SocketAddr,
    system: u8,
    component: u8,
}

/// A position in metres: x to the north, y to the west, z up; and the heading in degrees, counterclockwise from x.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Place {
    x: f64,
    y: f64,
    z: f64,
    yaw: Option<f64>,
}

impl MavlinkVehicle {
    /// Creates the driver of a vehicle. Its devices are `x`, `y`, `z` (positions in metres), `yaw` (degrees) and `flight` (0: landed, 1:
    /// flying); its sensors are those of the same names, without `flight`, and `battery` (percent).
    ///
    /// # Errors
    /// [`DriverError::Refused`] if the block contains any other device.
    pub fn new(address: MavlinkAddress, block: &InitializationBlock) -> Result<Self, DriverError> {
        for device in block.devices.iter() {
            check(device)?;
        }
        let (heard, target) = (Heard::default(), Place::default());
        Ok(Self { address, socket: None, heard, target, flies: false, sequence: 0, last_own_heartbeat: None })
    }

    fn vehicle(&self) -> Result<Vehicle, DriverError> {
        let MavlinkAddress { host, port, .. } = &self.address;
        self.heard
            .vehicle
            .ok_or_else(|| DriverError::Away(format!("no vehicle sends heartbeats to {host}:{port}")))
    }

    fn send(&mut self, message: &MavMessage) -> Result<(), DriverError> {
        let to = self.vehicle()?.from;
        self.sequence = self.sequence.wrapping_add(1);
        let header = MavHeader { sequence: self.sequence, ..STATION };
        let mut bytes = Vec::new();
        let written = mavlink::write_v2_msg(&mut bytes, header, message);
        written.map_err(|error| DriverError::Refused(error.to_string()))?;
        let socket = self.socket.as_ref().ok_or_else(closed)?;
        socket.send_to(&bytes, to).map(drop).map_err(|error| DriverError::Away(error.to_string()))
    }

    /// Takes the messages that have arrived, and those that arrive until `is_enough`, or for `wait`.
    fn hear(&mut self, wait: Duration, is_enough: impl Fn(&Heard) -> bool) -> Result<(), DriverError> {
        let until = Instant::now() + wait;
        let mut buffer = [0; 2_048];
        for _ in 0..PACKETS_MAX {
            let left = until.saturating_duration_since(Instant::now());
            let socket = self.socket.as_ref().ok_or_else(closed)?;
            let away = |error: io::Error| DriverError::Away(error.to_string());
            let is_waiting = !left.is_zero() && !is_enough(&self.heard);
            socket.set_nonblocking(!is_waiting).map_err(away)?;
            if is_waiting {
                socket.set_read_timeout(Some(left)).map_err(away)?;
            }
            match socket.recv_from(&mut buffer) {
                Ok((length, from)) => self.heard.take(&buffer[..length], from, self.address.system),
                Err(error) if is_pending(&error) && is_waiting => {}
                Err(error) if is_pending(&error) => return Ok(()),
                Err(error) => return Err(away(error)),
            }
        }
        Ok(())
    }

    /// Orders the vehicle to do something, and waits until it agrees.
    fn command(&mut self, command: MavCmd, name: &str, params: [f32; 7]) -> Result<(), DriverError> {
        let Vehicle { system, component, .. } = self.vehicle()?;
        let [param1, param2, param3, param4, param5, param6, param7] = params;
        for confirmation in 0..ATTEMPTS {
            self.heard.acknowledged = None;
            self.send(&MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
                param1,
                param2,
                param3,
                param4,
                param5,
                param6,
                param7,
                command,
                target_system: system,
                target_component: component,
                confirmation,
            }))?;
            let is_answer =
                |heard: &Heard| heard.acknowledged.is_some_and(|(answered, _)| answered == command);
            self.hear(ACK_WAIT, is_answer)?;
            match self.heard.acknowledged.filter(|(answered, _)| *answered == command) {
                Some((_, MavResult::MAV_RESULT_ACCEPTED | MavResult::MAV_RESULT_IN_PROGRESS)) => {
                    return Ok(());
                }
                Some((_, result)) => {
                    return Err(DriverError::Refused(format!("the vehicle refuses to {name}: {result:?}")));
                }
                None => {}
            }
        }
        Err(DriverError::Away(format!("the vehicle does not acknowledge the command to {name}")))
    }

    fn take_off(&mut self) -> Result<(), DriverError> {
        const CUSTOM_MODE: f32 = 1.0;
        let height = f64::from(self.address.takeoff_mm) / 1_000.0;
        self.command(
            MavCmd::MAV_CMD_DO_SET_MODE,
            "be guided",
            [CUSTOM_MODE, GUIDED, 0.0, 0.0, 0.0, 0.0, 0.0],
        )?;
        self.command(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, "arm", [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])?;
        self.command(
            MavCmd::MAV_CMD_NAV_TAKEOFF,
            "take off",
            [0.0, 0.0, 0.0, f32::NAN, 0.0, 0.0, float(height)],
        )?;
        self.flies = true;
        Ok(())
    }

    fn land(&mut self) -> Result<(), DriverError> {
        self.command(MavCmd::MAV_CMD_NAV_LAND, "land", [0.0; 7])?;
        self.flies = false;
        Ok(())
    }

    /// Sends the commanded position.
    fn send_target(&mut self) -> Result<(), DriverError> {
        if !self.flies {
            let reason = "the vehicle does not fly; set `flight` to 1 before its first position";
            return Err(DriverError::Refused(reason.to_owned()));
        }
        let Vehicle { system, component, .. } = self.vehicle()?;
        let Place { x, y, z, yaw } = self.target;
        let ignored = [
            PositionTargetTypemask::POSITION_TARGET_TYPEMASK_VX_IGNORE,
            PositionTargetTypemask::POSITION_TARGET_TYPEMASK_VY_IGNORE,
            PositionTargetTypemask::POSITION_TARGET_TYPEMASK_VZ_IGNORE,
            PositionTargetTypemask::POSITION_TARGET_TYPEMASK_AX_IGNORE,
            PositionTargetTypemask::POSITION_TARGET_TYPEMASK_AY_IGNORE,
            PositionTargetTypemask::POSITION_TARGET_TYPEMASK_AZ_IGNORE,
            PositionTargetTypemask::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE,
        ];
        let mut type_mask = ignored.into_iter().fold(PositionTargetTypemask::empty(), |all, one| all | one);
        if yaw.is_none() {
            type_mask |= PositionTargetTypemask::POSITION_TARGET_TYPEMASK_YAW_IGNORE;
        }
        self.send(&MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
            x: float(x),
            y: float(-y),
            z: float(-z),
            yaw: float(-yaw.unwrap_or_default().to_radians()),
            type_mask,
            target_system: system,
            target_component: component,
            coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
            ..SET_POSITION_TARGET_LOCAL_NED_DATA::default()
        }))
    }

    fn keep_in_touch(&mut self) -> Result<(), DriverError> {
        if self.last_own_heartbeat.is_some_and(|at| at.elapsed() < OWN_HEARTBEAT) {
            return Ok(());
        }
        self.last_own_heartbeat = Some(Instant::now());
        self.send(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            mavtype: MavType::MAV_TYPE_GCS,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            mavlink_version: 3,
            ..HEARTBEAT_DATA::default()
        }))
    }
}

fn closed() -> DriverError {
    DriverError::Away("the socket is not open".to_owned())
}

fn is_pending(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

#[expect(clippy::cast_possible_truncation, reason = "MAVLink's numbers have 32 bits")]
const fn float(value: f64) -> f32 {
    value as f32
}

fn check(device: &Device) -> Result<(), DriverError> {
    let id = device.id.as_str();
    let is_sensor = device.available_control_types.sensor().is_some();
    let known: &[&str] =
        if is_sensor { &["x", "y", "z", "yaw", "battery"] } else { &["x", "y", "z", "yaw", "flight"] };
    if known.contains(&id) {
        return Ok(());
    }
    let kind = if is_sensor { "sensor" } else { "device" };
    let known: Vec<_> = known.iter().map(|id| format!("`{id}`")).collect();
    Err(DriverError::Refused(format!(
        "a MAVLink vehicle has no {kind} `{id}`, expected {}",
        known.join(", ")
    )))
}

/// Calls `take` for each message in a packet. Messages that are damaged or unknown are skipped.
pub(super) fn messages(packet: &[u8], mut take: impl FnMut(MavHeader, MavMessage)) {
    let mut reader = MavlinkReader::new(packet);
    // No message is shorter than 8 bytes.
    for _ in 0..packet.len() / 8 + 1 {
        match reader.read_any_message::<MavMessage>() {
            Ok((header, message)) => take(header, message),
            Err(MessageReadError::Io(_)) => return,
            Err(MessageReadError::Parse(_)) => {}
        }
    }
}

impl Heard {
    fn take(&mut self, packet: &[u8], from: SocketAddr, wanted: Option<u8>) {
        messages(packet, |header, message| {
            let Ok(system) = u8::try_from(header.system_id) else { return };
            let is_wanted = wanted.is_none_or(|wanted| wanted == system);
            let is_known = self.vehicle.is_some_and(|vehicle| vehicle.system == system);
            if is_known || (is_wanted && self.vehicle.is_none()) {
                let vehicle = Vehicle { from, system, component: header.component_id };
                self.note(vehicle, &message);
            }
        });
    }

    fn note(&mut self, vehicle: Vehicle, message: &MavMessage) {
        if self.vehicle.is_some() {
            self.heard_at = Some(Instant::now());
        }
        match message {
            // Cameras and other ground stations send heartbeats, too.
            MavMessage::HEARTBEAT(heartbeat)
                if heartbeat.autopilot != MavAutopilot::MAV_AUTOPILOT_INVALID =>
            {
                // After a restart, the vehicle may have another port.
                self.vehicle = Some(vehicle);
                self.heard_at = Some(Instant::now());
            }
            MavMessage::LOCAL_POSITION_NED(position) => {
                let [x, y, z] = [position.x, -position.y, -position.z].map(f64::from);
                self.place = Some(Place { x, y, z, yaw: None });
            }
            MavMessage::ATTITUDE(attitude) => self.yaw = Some(-f64::from(attitude.yaw).to_degrees()),
            MavMessage::SYS_STATUS(status) if status.battery_remaining >= 0 => {
                self.battery = Some(status.battery_remaining.into());
            }
            MavMessage::COMMAND_ACK(ack) => self.acknowledged = Some((ack.command, ack.result)),
            _ => {}
        }
    }

    fn is_recent(&self) -> bool {
        self.vehicle.is_some() && self.heard_at.is_some_and(|at| at.elapsed() <= SILENCE_MAX)
    }
}

impl Driver for MavlinkVehicle {
    fn connect(&mut self) -> Result<(), DriverError> {
        let MavlinkAddress { host, port, .. } = &self.address;
        if self.socket.is_none() {
            let open = UdpSocket::bind((host.as_str(), *port));
            let away = |error| DriverError::Away(format!("cannot listen at {host}:{port}: {error}"));
            self.socket = Some(open.map_err(away)?);
        }
        if !self.heard.is_recent() {
            self.heard.vehicle = None;
        }
        self.hear(HEARTBEAT_WAIT, Heard::is_recent)?;
        self.ping()?;
        for message in [LOCAL_POSITION, ATTITUDE] {
            let params = [message, POSITION_INTERVAL_US, 0.0, 0.0, 0.0, 0.0, 0.0];
            self.command(MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL, "report its position", params)?;
        }
        Ok(())
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        self.set_frame(&[(device.clone(), setpoint.clone())])
    }

    fn set_frame(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), DriverError> {
        self.hear(Duration::ZERO, |_| false)?;
        let (mut flight, mut is_moved) = (None, false);
        for (device, setpoint) in values {
            let value = setpoint.value;
            match device.as_str() {
                "x" => self.target.x = value,
                "y" => self.target.y = value,
                "z" => self.target.z = value,
                "yaw" => self.target.yaw = Some(value),
                "flight" => flight = Some(value >= 0.5),
                _ => return Err(DriverError::Refused(format!("unknown device `{device}`"))),
            }
            is_moved |= device.as_str() != "flight";
        }
        match flight {
            Some(flies) if flies == self.flies => {}
            Some(true) => self.take_off()?,
            Some(false) => return self.land(),
            None => {}
        }
        if is_moved { self.send_target() } else { Ok(()) }
    }

    fn takes_frames(&self) -> bool {
        true
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        self.hear(Duration::ZERO, |_| false)?;
        let Heard { place, yaw, battery, .. } = &self.heard;
        let value = match sensor.as_str() {
            "x" => place.map(|place| place.x),
            "y" => place.map(|place| place.y),
            "z" => place.map(|place| place.z),
            "yaw" => *yaw,
            _ => *battery,
        };
        value.ok_or_else(|| DriverError::Refused(format!("the vehicle has not reported `{sensor}` yet")))
    }

    /// Checks that the last message of the vehicle is recent.
    fn ping(&mut self) -> Result<(), DriverError> {
        self.hear(Duration::ZERO, |_| false)?;
        self.vehicle()?;
        if !self.heard.is_recent() {
            let silence = SILENCE_MAX.as_secs_f64();
            return Err(DriverError::Away(format!("the vehicle has sent nothing for {silence} s")));
        }
        self.keep_in_touch()
    }
}

impl Drop for MavlinkVehicle {
    fn drop(&mut self) {
        if !self.flies {
            return;
        }
        let ended = match self.address.at_end {
            VehicleEnd::Hold => Ok(()),
            VehicleEnd::Land => self.land(),
            VehicleEnd::ReturnToLaunch => {
                self.command(MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH, "return to launch", [0.0; 7])
            }
        };
        if let Err(error) = ended {
            tracing::warn!("the vehicle was not brought down: {error}");
        }
    }
}

#[cfg(test)]
mod tests;
