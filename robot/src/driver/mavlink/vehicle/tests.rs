use std::net::UdpSocket;
use std::thread::JoinHandle;

use mavlink::dialects::common::{COMMAND_ACK_DATA, LOCAL_POSITION_NED_DATA};
use urrcp::ControlType;

use super::*;

/// A vehicle that sends a heartbeat, acknowledges commands, and returns the messages that it has received when the driver lands it.
fn vehicle(port: u16, refused: Option<MavCmd>) -> JoinHandle<Vec<MavMessage>> {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    socket.connect(("127.0.0.1", port)).unwrap();
    std::thread::spawn(move || {
        let header = MavHeader { system_id: 3, component_id: 1, sequence: 0 };
        let send = |message: MavMessage| {
            let mut bytes = Vec::new();
            mavlink::write_v2_msg(&mut bytes, header, &message).unwrap();
            let _not_open_yet = socket.send(&bytes);
        };
        let (mut taken, mut buffer) = (Vec::new(), [0; 600]);
        for _ in 0..200 {
            let autopilot = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;
            send(MavMessage::HEARTBEAT(HEARTBEAT_DATA { autopilot, ..HEARTBEAT_DATA::default() }));
            let position =
                LOCAL_POSITION_NED_DATA { x: 1.0, y: 2.0, z: -3.0, ..LOCAL_POSITION_NED_DATA::default() };
            send(MavMessage::LOCAL_POSITION_NED(position));
            let Ok(length) = socket.recv(&mut buffer) else { continue };
            let mut landed = false;
            messages(&buffer[..length], |_, message| {
                if let MavMessage::COMMAND_LONG(command) = &message {
                    let denied = refused == Some(command.command);
                    let result =
                        if denied { MavResult::MAV_RESULT_DENIED } else { MavResult::MAV_RESULT_ACCEPTED };
                    send(MavMessage::COMMAND_ACK(COMMAND_ACK_DATA { command: command.command, result }));
                    landed = command.command == MavCmd::MAV_CMD_NAV_LAND;
                }
                taken.push(message);
            });
            if landed {
                break;
            }
        }
        taken
    })
}

fn block(devices: &str) -> InitializationBlock {
    let text = format!(r#"{{"id": "drone", "api_version": "1", "devices": [{devices}]}}"#);
    serde_json::from_str(&text).unwrap()
}

fn device(id: &str) -> String {
    format!(
        r#"{{"id": "{id}", "available_control_types": {{"position": {{"min_value": 0, "max_value": 9, "granularity": 0.1}}}}}}"#
    )
}

fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn driver(port: u16) -> MavlinkVehicle {
    let devices = ["x", "y", "z", "yaw", "flight"].map(device).join(",");
    let address = MavlinkAddress::new("127.0.0.1".to_owned(), port).with_at_end(VehicleEnd::Land);
    MavlinkVehicle::new(address, &block(&devices)).unwrap()
}

fn value(id: &str, value: f64) -> (DeviceId, Setpoint) {
    (id.parse().unwrap(), Setpoint::new(ControlType::Position, value))
}

/// Connects within the time of a busy machine.
fn connect(driver: &mut MavlinkVehicle) {
    let connected = (0..20).any(|_| driver.connect().is_ok());
    assert!(connected, "{:?}", driver.connect());
}

#[test]
fn positions_follow_the_take_off_and_the_end_lands() {
    let port = free_port();
    let mut driver = driver(port);
    let vehicle = vehicle(port, None);
    connect(&mut driver);
    let early = driver.set_frame(&[value("x", 1.0)]).unwrap_err().to_string();
    assert!(early.contains("the vehicle does not fly"), "{early}");
    driver.set_frame(&[value("z", 2.0), value("flight", 1.0), value("y", 1.5)]).unwrap();
    driver.ping().unwrap();
    driver.hear(Duration::from_secs(20), |heard| heard.place.is_some()).unwrap();
    assert_eq!(["x", "y", "z"].map(|axis| driver.read(&axis.parse().unwrap())), [Ok(1.0), Ok(-2.0), Ok(3.0)]);
    assert!(driver.read(&"battery".parse().unwrap()).is_err());
    drop(driver);
    let taken = vehicle.join().unwrap();
    let target = taken.iter().find_map(|message| match message {
        MavMessage::SET_POSITION_TARGET_LOCAL_NED(target) => Some(target),
        _ => None,
    });
    let target = target.unwrap();
    assert_eq!((target.x, target.y, target.z, target.target_system), (1.0, -1.5, -2.0, 3));
    assert!(target.type_mask.contains(PositionTargetTypemask::POSITION_TARGET_TYPEMASK_YAW_IGNORE));
    let place = |command: MavCmd| {
        taken.iter().position(
            |message| matches!(message, MavMessage::COMMAND_LONG(found) if found.command == command),
        )
    };
    let order = [
        MavCmd::MAV_CMD_DO_SET_MODE,
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
        MavCmd::MAV_CMD_NAV_TAKEOFF,
        MavCmd::MAV_CMD_NAV_LAND,
    ];
    assert!(order.map(|command| place(command).unwrap()).is_sorted(), "{taken:?}");
}

#[test]
fn refusal_and_silence_of_a_vehicle_are_reported() {
    let port = free_port();
    let mut driver = driver(port);
    let silent = driver.connect().unwrap_err();
    assert_eq!(silent, DriverError::Away(format!("no vehicle sends heartbeats to 127.0.0.1:{port}")));
    let _vehicle = vehicle(port, Some(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM));
    connect(&mut driver);
    let refused = driver.set_frame(&[value("flight", 1.0)]).unwrap_err();
    assert_eq!(refused, DriverError::Refused("the vehicle refuses to arm: MAV_RESULT_DENIED".to_owned()));
}

#[test]
fn damaged_packets_and_unknown_devices_are_refused() {
    let mut count = 0;
    for packet in [&[][..], &[0xfd], &[0xfd; 300], &[0xfe, 255, 0, 0, 0, 0], &[0; 2_000]] {
        messages(packet, |_, _| count += 1);
    }
    assert_eq!(count, 0);
    let address = MavlinkAddress::new("127.0.0.1".to_owned(), 1);
    let refused = MavlinkVehicle::new(address.clone(), &block(&device("lamp"))).unwrap_err().to_string();
    assert!(refused.contains("no device `lamp`, expected `x`, `y`, `z`, `yaw`, `flight`"), "{refused}");
    let sensor =
        r#"{"id": "flight", "available_control_types": {"sensor": {"min_value": 0, "max_value": 1}}}"#;
    assert!(
        MavlinkVehicle::new(address, &block(sensor)).unwrap_err().to_string().contains("no sensor `flight`")
    );
}
