//! Missions on a vehicle that speaks MAVLink: pymavlink, not an autopilot. `PYMAVLINK` names an interpreter that has it; `.ci/mavlink`
//! installs one.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};

use serde_json::Value;
use stage::quiet::await_that;
use stage::session::{Session, root};

const VEHICLE: &str = "id: vehicle
api_version: '1'
reports: true
devices:
  - {id: flight, default_value: 0, available_control_types: {position: {min_value: 0, max_value: 1, granularity: 1}, script: {min_value: 0, max_value: 1, granularity: 1, max_number_of_steps: 9}}}
  - {id: x, unit: m, interpolation: linear, available_control_types: {position: {min_value: -9, max_value: 9, granularity: 0.001}, sensor: {min_value: -9, max_value: 9}, script: {min_value: -9, max_value: 9, granularity: 0.001, max_number_of_steps: 99}}}
  - {id: y, unit: m, interpolation: linear, available_control_types: {position: {min_value: -9, max_value: 9, granularity: 0.001}, sensor: {min_value: -9, max_value: 9}, script: {min_value: -9, max_value: 9, granularity: 0.001, max_number_of_steps: 99}}}
  - {id: z, unit: m, interpolation: linear, available_control_types: {position: {min_value: 0, max_value: 9, granularity: 0.001}, sensor: {min_value: 0, max_value: 9}, script: {min_value: 0, max_value: 9, granularity: 0.001, max_number_of_steps: 99}}}
  - {id: yaw, unit: deg, available_control_types: {position: {min_value: -180, max_value: 180, granularity: 1}, script: {min_value: -180, max_value: 180, granularity: 1, max_number_of_steps: 99}}}
";

/// Takes off, moves 1 m to the west (y) and 1 m up in 2 s, turns by 90 degrees at 4 s, and holds until 5 s.
const SHOW: &str = "scenario: show
start_tolerance: 1s
cues:
  - at: 0s
    robots: drone
    tracks:
      flight: [{at: 0s, to: 1}]
      x: [{at: 1s, to: 0}, {at: 5s, to: 0}]
      y: [{at: 1s, to: 0}, {at: 2s, to: 0}, {at: 4s, to: 1}]
      z: [{at: 1s, to: 1.5}, {at: 2s, to: 1.5}, {at: 4s, to: 2.5}]
      yaw: [{at: 4s, to: 90}]
";

/// The numbers of commands.
const ARM: i64 = 400;
const MODE: i64 = 176;
const TAKEOFF: i64 = 22;
const LAND: i64 = 21;

struct Vehicle {
    process: Child,
    messages: Arc<Mutex<Vec<Value>>>,
}

impl Vehicle {
    fn start(port: u16, refused: &[i64]) -> Self {
        let python = std::env::var("PYMAVLINK").unwrap_or_else(|_| "python3".to_owned());
        let mut command = Command::new(python);
        command.arg(root().join("tests/mavlink/vehicle.py")).arg(port.to_string());
        command.args(refused.iter().map(ToString::to_string));
        let mut process = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let messages = Arc::new(Mutex::new(Vec::new()));
        let taken = Arc::clone(&messages);
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                // Python writes NaN, which JSON does not have.
                let line = line.replace("NaN", "null");
                taken.lock().unwrap().push(serde_json::from_str::<Value>(&line).unwrap());
            }
        });
        Self { process, messages }
    }

    fn of_type(&self, kind: &str) -> Vec<Value> {
        let messages = self.messages.lock().unwrap();
        messages.iter().filter(|message| message["type"] == kind).cloned().collect()
    }

    /// Returns the numbers of the commands that move the vehicle.
    fn commands(&self) -> Vec<i64> {
        let all = self.of_type("COMMAND_LONG").into_iter().filter_map(|command| command["command"].as_i64());
        all.filter(|command| [ARM, MODE, TAKEOFF, LAND].contains(command)).collect()
    }
}

impl Drop for Vehicle {
    fn drop(&mut self) {
        let _ended = self.process.kill();
        let _ended = self.process.wait();
    }
}

/// Returns a session with a fleet of one vehicle, and the port of its address.
fn session(options: &str) -> (Session, u16) {
    let (session, port) = (Session::new(), std::net::UdpSocket::bind("127.0.0.1:0").unwrap());
    let port = port.local_addr().unwrap().port();
    session.file("vehicle.yaml", VEHICLE).file("show.yaml", SHOW).file(
        "fleet.yaml",
        format!(
            "robots:\n  drone: {{init: vehicle.yaml, address: \"mavlink:udp:127.0.0.1:{port}{options}\"}}\n"
        ),
    );
    (session, port)
}

#[test]
fn vehicle_takes_off_follows_positions_in_the_local_frame_and_lands() {
    let (session, port) = session("?system=7&takeoff=1.5&end=land");
    let vehicle = Vehicle::start(port, &[]);
    let ran = session.run(&["run", "show.yaml"]);
    ran.says(0, &["show: done"]);
    assert_eq!(vehicle.commands(), [MODE, ARM, TAKEOFF, LAND]);
    let takeoff =
        vehicle.of_type("COMMAND_LONG").into_iter().find(|command| command["command"] == TAKEOFF).unwrap();
    assert_eq!((&takeoff["param7"], &takeoff["target_system"]), (&1.5.into(), &7.into()));
    let targets = vehicle.of_type("SET_POSITION_TARGET_LOCAL_NED");
    let last = targets.last().unwrap();
    let value = |target: &Value, key: &str| target[key].as_f64().unwrap();
    // West is negative in a frame whose second axis points east, up is negative, and turns are clockwise there.
    let [x, y, z, yaw] = ["x", "y", "z", "yaw"].map(|key| value(last, key));
    assert!(x == 0.0 && y == -1.0 && z == -2.5 && (yaw + 1.570_796).abs() < 1e-5, "{last}");
    assert_eq!(last["coordinate_frame"], 1);
    // Samples of a movement of 2 s, in order.
    let way: Vec<f64> =
        targets.iter().map(|target| value(target, "y")).filter(|y| *y < 0.0 && *y > -1.0).collect();
    assert!(way.len() > 20 && way.windows(2).all(|two| two[1] <= two[0]), "{way:?}");
    assert!(!vehicle.of_type("HEARTBEAT").is_empty(), "the ground station sends heartbeats");
}

#[test]
fn vehicle_that_refuses_or_falls_silent_fails_the_mission() {
    let (refusing, port) = session("");
    let vehicle = Vehicle::start(port, &[ARM]);
    let ran = refusing.run(&["run", "show.yaml"]);
    assert_ne!(ran.code(), 0, "{}", ran.text());
    assert!(ran.text().contains("the vehicle refuses to arm: MAV_RESULT_DENIED"), "{}", ran.text());
    assert!(!vehicle.commands().contains(&TAKEOFF));
    assert!(vehicle.of_type("SET_POSITION_TARGET_LOCAL_NED").is_empty());
    drop(vehicle);

    let (absent, _) = session("");
    let ran = absent.run(&["preflight", "show.yaml", "--wait", "3s"]);
    assert_ne!(ran.code(), 0, "{}", ran.text());

    let (silent, port) = session("");
    let mut vehicle = Vehicle::start(port, &[]);
    let mission =
        silent.command(&["run", "show.yaml"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    await_that("the first position", || !vehicle.of_type("SET_POSITION_TARGET_LOCAL_NED").is_empty());
    vehicle.process.kill().unwrap();
    let ended = mission.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&ended.stderr).into_owned() + &String::from_utf8_lossy(&ended.stdout);
    assert_ne!(ended.status.code(), Some(0), "{text}");
    assert!(text.contains("has sent nothing for 1 s"), "{text}");
}
