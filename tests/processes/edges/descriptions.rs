//! Descriptions of robots behind an edge, which come from the robots themselves or from files.

use downbeat_robot::driver::{Driver, DriverError, ThriftRobot};
use urrcp::{ControlType, DeviceId, Setpoint};

use super::processes::{Edge, Tank};
use super::{TANK, session, sets};
use stage::quiet::await_that;
use stage::session::Session;

#[test]
fn thrift_driver_sets_reads_describes_and_reports_lost_connection() {
    let session = session();
    let (tank, port) = Tank::start(&session, "1.log", 0);
    let block = downbeat_scripts::read_init(&session.path("tank.json")).unwrap();
    let mut driver = ThriftRobot::new("127.0.0.1", port, &block).unwrap();
    let device = |id: &str| DeviceId::new(id).unwrap();
    assert!(matches!(driver.ping(), Err(DriverError::Away(_))), "nothing before it is connected");
    driver.connect().unwrap();
    driver.set(&device("left"), &Setpoint::new(ControlType::Position, 4.5)).unwrap();
    assert_eq!(driver.read(&device("battery")), Ok(12.5));
    assert_eq!(sets(&session, "1.log"), ["left 4.5"]);
    let schema = downbeat_robot::driver::describe_thrift;
    drop(driver);
    assert_eq!(schema("127.0.0.1", port).unwrap(), TANK);
    let mut driver = ThriftRobot::new("127.0.0.1", port, &block).unwrap();
    driver.connect().unwrap();
    drop(tank);
    // A one-way call may still fit into the socket; a question cannot be answered.
    assert!(matches!(driver.ping(), Err(DriverError::Away(_))));
    // The robot's port may still accept a connection for a moment.
    await_that(
        "a refused connection",
        || matches!(driver.connect(), Err(DriverError::Away(reason)) if reason.contains("no connection")),
    );
}

#[test]
fn drivers_refuse_multiple_control_types_and_ids_with_spaces() {
    let session = Session::new();
    session.file(
        "two.yaml",
        "id: a\napi_version: '1'\ndevices: [{id: two wheels, name: w, available_control_types: {position: {min_value: 0, max_value: 1, granularity: 1}, speed: {min_value: 0, max_value: 1, granularity: 1}}}]\n",
    );
    let refused = |driver: &str| session.run(&["edge", "--init", "two.yaml", "--driver", driver]);
    refused("thrift://localhost:1").says(2, &["`two wheels` has several control types"]);
    refused("program:true")
        .says(2, &["the id of device `two wheels` contains a space or a control character"]);
    refused("serial:x")
        .says(2, &["osc:host:port/path, mavlink:udp:host:port, thrift://host:port or program:COMMAND"]);
}

#[test]
fn robot_description_is_printed_as_init_file_over_either_protocol() {
    let session = session();
    let (_tank, port) = Tank::start(&session, "1.log", 0);
    let told = session.run(&["fleet", "describe", &format!("thrift://127.0.0.1:{port}")]);
    assert_eq!(told.code(), 0, "{}", told.text());
    session.file("told.yaml", told.out());
    let edge = Edge::start(&session, "told.yaml", "sim");
    let again = session.run(&["fleet", "describe", &format!("tcp://127.0.0.1:{}", edge.1)]);
    assert_eq!(again.out(), told.out());
    assert!(told.out().contains("id: tank-1\n"), "{}", told.out());
    session.run(&["fleet", "describe", "sim"]).says(2, &["`sim` cannot be described"]);
    session.run(&["fleet", "describe", "thrift://127.0.0.1:1"]).says(1, &["127.0.0.1:1"]);
}

#[test]
fn thrift_robot_description_errors_are_reported_in_the_right_file() {
    let session = session();
    let tank = |keys: &str| {
        format!(
            "robots:\n  tank-1:\n    init: tank.json\n    address: thrift://localhost:9090\n{keys}groups: {{tanks: [tank-1]}}\n"
        )
    };
    let check = |fleet: &str, says: &[&str]| {
        session.file("fleet.yaml", fleet);
        session.run(&["check", "tanks.yaml"]).says(1, says);
    };
    check(
        &tank("    devices: {lft: {granularity: 1}}\n"),
        &["DB0009", "fleet.yaml:5:15", "no device `lft`", "did you mean `left`?"],
    );
    check(&tank("    devices:\n      left: {granularity: 0}\n"), &["DB0003", "fleet.yaml:6:27", "above 0"]);
    check(&tank("    devices: {left: {control_type: sped}}\n"), &["DB0020", "did you mean `speed`?"]);
    check(
        &tank("").replace("localhost:9090", "localhost"),
        &["DB0020", "fleet.yaml:4:14", "thrift://host:port"],
    );
    let whole = tank("    devices: {shoulder: {granularity: 1}}\n").replace("tank.json", "arm.yaml");
    check(&whole, &["DB0004", "fleet.yaml:5:5", "`arm.yaml` already describes its devices completely"]);
    session.file("tank.json", TANK.replace("get_sensor_double_value", "get_colour"));
    check(&tank(""), &["DB0020", "tank.json:19:15", "unknown call `get_colour`", "get_sensor_double_value"]);
}
