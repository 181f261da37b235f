//! Robots that speak the early Thrift form of URRCP: binary protocol, buffered transport, one connection at a time.
//!
//! The service has only six calls, with at most two arguments of plain types. This module therefore implements them by hand instead of
//! using generated code.

use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;
use std::{fmt, io};

use thrift::protocol::{
    TBinaryInputProtocol, TBinaryOutputProtocol, TFieldIdentifier, TInputProtocol, TMessageIdentifier,
    TMessageType, TOutputProtocol, TStructIdentifier, TType,
};
use thrift::transport::{
    ReadHalf, TBufferedReadTransport, TBufferedWriteTransport, TIoChannel, TTcpChannel, WriteHalf,
};
use thrift::{ApplicationErrorKind, TConfiguration, TransportErrorKind};
use urrcp::{DeviceId, InitializationBlock, RobotId, Setpoint};

use super::described::is_driven;
use super::{Driver, DriverError, Lifeline, described};

/// Default of [`ThriftRobot::wait_max`], for robots on a network.
const WAIT_MAX: Duration = Duration::from_secs(1);
/// Maximum length of a text from a robot, in bytes: the maximum length of a URRCP line.
const TEXT_BYTES_MAX: usize = urrcp::LINE_BYTES_MAX;

/// Driver for a robot that speaks the Thrift form of URRCP.
pub struct ThriftRobot {
    host: String,
    port: u16,
    block: InitializationBlock,
    /// The id that the hardware has to report.
    expected: RobotId,
    connection: Option<Connection>,
    /// Time limit for connecting to the robot, for sending it a call, and for its answer. `None`: no limit.
    wait_max: Option<Duration>,
}

impl ThriftRobot {
    /// Creates a driver for the devices of this robot, without connecting.
    ///
    /// # Errors
    /// [`DriverError::Refused`] for a device with more than one control type: a value in the Thrift form does not name its control type.
    pub fn new(host: &str, port: u16, block: &InitializationBlock) -> Result<Self, DriverError> {
        let driven = |device: &urrcp::Device| {
            let types = device.available_control_types.iter().map(|(control_type, _)| control_type);
            types.filter(|control_type| is_driven(*control_type)).count()
        };
        if let Some(device) = block.devices.iter().find(|device| driven(device) > 1) {
            let message = format!(
                "device `{}` has several control types, but a Thrift robot supports only one; remove the others",
                device.id
            );
            return Err(DriverError::Refused(message));
        }
        Ok(Self {
            host: host.to_owned(),
            port,
            block: block.clone(),
            expected: block.id.clone(),
            connection: None,
            wait_max: Some(WAIT_MAX),
        })
    }

    /// Sets the id that the hardware has to report. `None`: the robot's own.
    #[must_use]
    pub fn identified_as(mut self, id: Option<RobotId>) -> Self {
        self.expected = id.unwrap_or_else(|| self.block.id.clone());
        self
    }

    fn call<T>(&mut self, call: impl FnOnce(&mut Connection) -> thrift::Result<T>) -> Result<T, DriverError> {
        let away = || DriverError::Away("not connected".to_owned());
        let called = call(self.connection.as_mut().ok_or_else(away)?);
        called.map_err(|error| match error {
            thrift::Error::Application(error) => DriverError::Refused(told(&error)),
            error => {
                // Otherwise a late answer would be taken for the answer to the next call.
                self.connection = None;
                DriverError::Away(if has_ended(&error) {
                    self.ended()
                } else {
                    format!("{}:{}: {error}", self.host, self.port)
                })
            }
        })
    }

    fn ended(&self) -> String {
        format!("{}:{} has closed the connection", self.host, self.port)
    }
}

fn told(error: &thrift::ApplicationError) -> String {
    match error.kind {
        ApplicationErrorKind::UnknownMethod => {
            format!("the robot does not support the call: {}", error.message)
        }
        _ => format!("the robot reported: {}", error.message),
    }
}

impl Driver for ThriftRobot {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.connection = None;
        self.connection = Some(Connection::open(&self.host, self.port, self.wait_max)?);
        self.ping()?;
        // The robot may be another one than before, or differ from its init file.
        let schema = self.call(Connection::schema)?;
        described::fits(&schema, &self.block, &self.expected).map_err(|why| {
            DriverError::Away(format!(
                "the robot at {}:{} is not the expected one: {why}",
                self.host, self.port
            ))
        })
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        self.call(|connection| connection.set(device.as_str(), setpoint.value))
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        match self.call(|connection| connection.sensor_double(sensor.as_str())) {
            // Some robots answer with text for a sensor. If the text contains a number, the number is the reading.
            Err(DriverError::Refused(reason)) => {
                let Ok(text) = self.call(|connection| connection.sensor_text(sensor.as_str())) else {
                    return Err(DriverError::Refused(reason));
                };
                let no_number = || DriverError::Refused(format!("`{sensor}` reads `{text}`, not a number"));
                text.trim().parse().map_err(|_| no_number())
            }
            reading => reading,
        }
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        if self.call(Connection::ping)? {
            Ok(())
        } else {
            Err(DriverError::Away("the robot is not ready: it answers ping with false".to_owned()))
        }
    }

    fn lifeline(&self) -> Option<Lifeline> {
        Lifeline::of(&self.connection.as_ref()?.stream, self.ended())
    }
}

/// Whether the error means that the connection has ended. A call may notice this before the driver's lifeline does.
fn has_ended(error: &thrift::Error) -> bool {
    let thrift::Error::Transport(error) = error else { return false };
    matches!(error.kind, TransportErrorKind::EndOfFile | TransportErrorKind::NotOpen)
}

/// Requests a Thrift robot's description, a JSON text.
///
/// # Errors
/// The reason why the description is missing.
pub fn describe(host: &str, port: u16) -> Result<String, DriverError> {
    describe_within(host, port, Some(WAIT_MAX))
}

fn describe_within(host: &str, port: u16, wait_max: Option<Duration>) -> Result<String, DriverError> {
    let mut connection = Connection::open(host, port, wait_max)?;
    connection.schema().map_err(|error| DriverError::Away(format!("{host}:{port}: {error}")))
}

/// Connects to the first of the host's addresses that accepts a connection.
fn stream(host: &str, port: u16, wait_max: Option<Duration>) -> io::Result<TcpStream> {
    let mut last = None;
    for address in (host, port).to_socket_addrs()? {
        let connected = match wait_max {
            Some(wait_max) => TcpStream::connect_timeout(&address, wait_max),
            None => TcpStream::connect(address),
        };
        match connected {
            Ok(stream) => return Ok(stream),
            Err(error) => last = Some(error),
        }
    }
    Err(last.unwrap_or_else(|| io::Error::other("the host name does not resolve to an address")))
}

type Input = TBinaryInputProtocol<TBufferedReadTransport<ReadHalf<TTcpChannel>>>;
type Output = TBinaryOutputProtocol<TBufferedWriteTransport<WriteHalf<TTcpChannel>>>;

/// A connection to a Thrift robot, with the six calls of the service.
struct Connection {
    /// The connection's socket, used only to detect its end.
    stream: TcpStream,
    input: Input,
    output: Output,
    sequence: i32,
}

enum Argument<'a> {
    Text(&'a str),
    Double(f64),
}

impl Connection {
    fn open(host: &str, port: u16, wait_max: Option<Duration>) -> Result<Self, DriverError> {
        let away = |why: &dyn fmt::Display| {
            DriverError::Away(format!("no connection to thrift://{host}:{port}: {why}"))
        };
        // Names the error kind: otherwise the library would report "not open", and the system would add a number.
        let told = |error: std::io::Error| match error.raw_os_error() {
            Some(_) => away(&error.kind()),
            None => away(&error),
        };
        let stream = stream(host, port, wait_max).map_err(told)?;
        Self::over(stream, wait_max).map_err(|error| away(&error))
    }

    fn over(stream: TcpStream, wait_max: Option<Duration>) -> thrift::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(wait_max)?;
        stream.set_write_timeout(wait_max)?;
        let watched = stream.try_clone()?;
        let (reader, writer) = TTcpChannel::with_stream(stream).split()?;
        let limits = TConfiguration::builder().max_string_size(Some(TEXT_BYTES_MAX)).build()?;
        // Robots that use the older, headerless form of the protocol are accepted as well.
        let input = TBinaryInputProtocol::with_config(TBufferedReadTransport::new(reader), false, limits);
        let output = TBinaryOutputProtocol::new(TBufferedWriteTransport::new(writer), true);
        Ok(Self { stream: watched, input, output, sequence: 0 })
    }

    fn ping(&mut self) -> thrift::Result<bool> {
        self.ask("ping", &[], TType::Bool, Input::read_bool)
    }

    fn schema(&mut self) -> thrift::Result<String> {
        self.ask("get_init_schema", &[], TType::String, Input::read_string)
    }

    fn set(&mut self, device: &str, value: f64) -> thrift::Result<()> {
        let arguments = [Argument::Text(device), Argument::Double(value)];
        self.send("set_device_double_value", TMessageType::OneWay, &arguments)
    }

    fn sensor_double(&mut self, sensor: &str) -> thrift::Result<f64> {
        let arguments = [Argument::Text(sensor)];
        self.ask("get_sensor_double_value", &arguments, TType::Double, Input::read_double)
    }

    fn sensor_text(&mut self, sensor: &str) -> thrift::Result<String> {
        let arguments = [Argument::Text(sensor)];
        self.ask("get_sensor_string_value", &arguments, TType::String, Input::read_string)
    }

    fn ask<T>(
        &mut self,
        name: &str,
        arguments: &[Argument<'_>],
        kind: TType,
        read: impl Fn(&mut Input) -> thrift::Result<T>,
    ) -> thrift::Result<T> {
        self.send(name, TMessageType::Call, arguments)?;
        let answer = self.input.read_message_begin()?;
        if answer.message_type == TMessageType::Exception {
            let error = thrift::Error::read_application_error_from_in_protocol(&mut self.input)?;
            self.input.read_message_end()?;
            return Err(thrift::Error::Application(error));
        }
        thrift::protocol::verify_expected_sequence_number(self.sequence, answer.sequence_number)
            .map_err(|error| foreign(&error))?;
        let mut result = None;
        self.input.read_struct_begin()?;
        loop {
            let field = self.input.read_field_begin()?;
            match field.field_type {
                TType::Stop => break,
                found if field.id == Some(0) && found == kind => result = Some(read(&mut self.input)?),
                found => self.input.skip(found)?,
            }
            self.input.read_field_end()?;
        }
        self.input.read_struct_end()?;
        self.input.read_message_end()?;
        result.ok_or_else(|| {
            let message = format!("`{name}` returned no result");
            thrift::Error::Application(thrift::ApplicationError::new(
                ApplicationErrorKind::MissingResult,
                message,
            ))
        })
    }

    fn send(
        &mut self,
        name: &str,
        message_type: TMessageType,
        arguments: &[Argument<'_>],
    ) -> thrift::Result<()> {
        self.sequence = self.sequence.wrapping_add(1);
        let out = &mut self.output;
        out.write_message_begin(&TMessageIdentifier::new(name, message_type, self.sequence))?;
        out.write_struct_begin(&TStructIdentifier::new("args"))?;
        for (id, argument) in (1..).zip(arguments) {
            let kind = match argument {
                Argument::Text(_) => TType::String,
                Argument::Double(_) => TType::Double,
            };
            out.write_field_begin(&TFieldIdentifier::new("", kind, id))?;
            match argument {
                Argument::Text(text) => out.write_string(text)?,
                Argument::Double(value) => out.write_double(*value)?,
            }
            out.write_field_end()?;
        }
        out.write_field_stop()?;
        out.write_struct_end()?;
        out.write_message_end()?;
        out.flush()
    }
}

/// Returns the error for an answer that belongs to another call: answers no longer match calls, so the connection is unusable.
fn foreign(error: &thrift::Error) -> thrift::Error {
    std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()).into()
}

#[cfg(test)]
mod tests {
    use std::net::{Shutdown, TcpListener};
    use std::sync::Arc;
    use std::thread::JoinHandle;

    use urrcp::ControlType;

    use super::*;

    const BLOCK: &str = r#"{"id": "r", "api_version": "1", "devices": [
      {"id": "arm", "name": "arm", "available_control_types": {
         "position": {"min_value": 0, "max_value": 9, "granularity": 1}}},
      {"id": "eye", "name": "eye", "available_control_types": {"sensor": {"min_value": 0, "max_value": 9}}}]}"#;
    const SCHEMA: &str = r#"{"id": "r", "devices": {"arm": {"min_value": 0, "max_value": 9}}}"#;

    /// Time limit of a test. It is not a socket timeout: if a process was suspended, Linux interrupts a read with such a timeout. The
    /// driver would mistake the interruption for the end of the connection.
    const PATIENCE: Duration = Duration::from_secs(60);

    /// An answer of a robot in a test.
    enum Reply {
        Bool(bool),
        Double(f64),
        Text(&'static str),
        /// An answer without a result.
        Empty,
        Error(ApplicationErrorKind),
        /// An answer that belongs to another call.
        Foreign,
        /// No answer, for a call that needs none.
        Nothing,
        HangsUp,
    }

    /// Starts a robot that accepts one connection and answers each call as `reply` specifies for its name and arguments. The thread
    /// returns the received calls.
    fn robot(reply: impl Fn(&str) -> Reply + Send + 'static) -> (ThriftRobot, JoinHandle<Vec<String>>) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let serving = std::thread::spawn(move || serve_one(&listener, reply));
        let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
        let robot = ThriftRobot::new("127.0.0.1", port, &block).unwrap();
        (ThriftRobot { wait_max: None, ..robot }, serving)
    }

    /// Serves one connection, and closes it if the test takes too long. Returns the received calls.
    #[expect(clippy::disallowed_methods, reason = "the longest time that a real connection takes")]
    fn serve_one(listener: &TcpListener, reply: impl Fn(&str) -> Reply) -> Vec<String> {
        let stream = Arc::new(listener.accept().unwrap().0);
        let watched = Arc::downgrade(&stream);
        // The thread ends with the process, or finds no stream left to break.
        std::thread::spawn(move || {
            std::thread::sleep(PATIENCE);
            let _already_ended = watched.upgrade().map(|stream| stream.shutdown(Shutdown::Both));
        });
        serve(&stream, reply)
    }

    fn serve(stream: &TcpStream, reply: impl Fn(&str) -> Reply) -> Vec<String> {
        let (reader, writer) = TTcpChannel::with_stream(stream.try_clone().unwrap()).split().unwrap();
        let mut input = TBinaryInputProtocol::new(TBufferedReadTransport::new(reader), true);
        let mut out = TBinaryOutputProtocol::new(TBufferedWriteTransport::new(writer), true);
        let mut calls = Vec::new();
        while let Ok(call) = input.read_message_begin() {
            let mut told = call.name.clone();
            input.read_struct_begin().unwrap();
            loop {
                let field = input.read_field_begin().unwrap();
                match field.field_type {
                    TType::Stop => break,
                    TType::String => told = format!("{told} {}", input.read_string().unwrap()),
                    TType::Double => told = format!("{told} {}", input.read_double().unwrap()),
                    other => panic!("{other:?}"),
                }
            }
            calls.push(told.clone());
            let reply = reply(&told);
            let kind = match reply {
                Reply::Nothing => continue,
                Reply::HangsUp => break,
                Reply::Error(_) => TMessageType::Exception,
                _ => TMessageType::Reply,
            };
            let sequence = call.sequence_number + i32::from(matches!(reply, Reply::Foreign));
            out.write_message_begin(&TMessageIdentifier::new(&call.name, kind, sequence)).unwrap();
            if let Reply::Error(kind) = reply {
                let error = thrift::ApplicationError::new(kind, "so it is");
                thrift::Error::write_application_error_to_out_protocol(&error, &mut out).unwrap();
            } else {
                let mut field = |kind| out.write_field_begin(&TFieldIdentifier::new("", kind, 0)).unwrap();
                match reply {
                    Reply::Bool(value) => {
                        field(TType::Bool);
                        out.write_bool(value).unwrap();
                    }
                    Reply::Double(value) => {
                        field(TType::Double);
                        out.write_double(value).unwrap();
                    }
                    Reply::Text(text) => {
                        field(TType::String);
                        out.write_string(text).unwrap();
                    }
                    _ => {}
                }
                out.write_field_stop().unwrap();
            }
            out.write_message_end().unwrap();
            out.flush().unwrap();
        }
        calls
    }

    /// Returns the answer of a working robot to a call.
    fn in_order(call: &str) -> Reply {
        match call.split(' ').next().unwrap() {
            "ping" => Reply::Bool(true),
            "get_init_schema" => Reply::Text(SCHEMA),
            "get_sensor_double_value" => Reply::Double(4.5),
            "set_device_double_value" => Reply::Nothing,
            other => panic!("{other}"),
        }
    }

    fn eye() -> DeviceId {
        DeviceId::new("eye").unwrap()
    }

    #[test]
    fn expected_robot_receives_values_and_reading_requests() {
        let (mut robot, serving) = robot(in_order);
        assert!(robot.lifeline().is_none());
        robot.connect().unwrap();
        assert!(robot.lifeline().is_some());
        robot.set(&DeviceId::new("arm").unwrap(), &Setpoint::new(ControlType::Position, 5.0)).unwrap();
        assert_eq!(robot.read(&eye()), Ok(4.5));
        drop(robot);
        let calls =
            ["ping", "get_init_schema", "set_device_double_value arm 5", "get_sensor_double_value eye"];
        assert_eq!(serving.join().unwrap(), calls);
    }

    #[test]
    fn robot_that_describes_another_robot_is_unavailable() {
        let other = |call: &str| match call {
            "get_init_schema" => Reply::Text(r#"{"id": "s"}"#),
            call => in_order(call),
        };
        let (mut robot, _serving) = robot(other);
        let error = robot.connect().unwrap_err();
        assert!(matches!(error, DriverError::Away(_)), "{error:?}");
        assert!(
            error.to_string().ends_with("is not the expected one: its id is `s`, expected `r`"),
            "{error}"
        );
    }

    #[test]
    fn only_the_description_is_requested_from_a_robot() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let serving = std::thread::spawn(move || serve_one(&listener, in_order));
        assert_eq!(describe_within("127.0.0.1", port, None), Ok(SCHEMA.to_owned()));
        assert_eq!(serving.join().unwrap(), ["get_init_schema"]);
        let error = describe("127.0.0.1", port).unwrap_err().to_string();
        assert_eq!(error, format!("no connection to thrift://127.0.0.1:{port}: connection refused"));
    }

    #[test]
    fn robot_that_refuses_a_call_stays_connected_and_its_reason_is_reported() {
        for (kind, expected) in [
            (ApplicationErrorKind::UnknownMethod, "the robot does not support the call: so it is"),
            (ApplicationErrorKind::InternalError, "the robot reported: so it is"),
        ] {
            let (mut robot, _serving) = robot(move |call| match call {
                "get_sensor_double_value eye" | "get_sensor_string_value eye" => Reply::Error(kind),
                call => in_order(call),
            });
            robot.connect().unwrap();
            assert_eq!(robot.read(&eye()), Err(DriverError::Refused(expected.to_owned())));
            robot.ping().unwrap();
        }
    }

    #[test]
    fn text_reading_of_a_sensor_is_accepted_if_it_is_a_number() {
        for (text, expected) in [
            (" 7.5 ", Ok(7.5)),
            ("far", Err(DriverError::Refused("`eye` reads `far`, not a number".to_owned()))),
        ] {
            let (mut robot, _serving) = robot(move |call| match call {
                "get_sensor_double_value eye" => Reply::Empty,
                "get_sensor_string_value eye" => Reply::Text(text),
                call => in_order(call),
            });
            robot.connect().unwrap();
            assert_eq!(robot.read(&eye()), expected);
        }
    }

    #[test]
    fn answer_of_another_type_is_no_result() {
        let (mut robot, _serving) = robot(|call| match call {
            "get_sensor_double_value eye" => Reply::Text("7"),
            "get_sensor_string_value eye" => Reply::Double(7.0),
            call => in_order(call),
        });
        robot.connect().unwrap();
        let refused = "the robot reported: `get_sensor_double_value` returned no result";
        assert_eq!(robot.read(&eye()), Err(DriverError::Refused(refused.to_owned())));
    }

    #[test]
    fn unready_out_of_step_or_disconnected_robot_is_unavailable() {
        let of = |reply: fn() -> Reply| {
            let (mut robot, _serving) =
                robot(move |call| if call == "ping" { reply() } else { in_order(call) });
            let error = robot.connect().unwrap_err();
            assert!(matches!(error, DriverError::Away(_)), "{error:?}");
            (error.to_string(), robot.lifeline().is_some())
        };
        let not_ready = "the robot is not ready: it answers ping with false".to_owned();
        assert_eq!(of(|| Reply::Bool(false)), (not_ready, true));
        let (gone, is_connected) = of(|| Reply::HangsUp);
        assert!(gone.ends_with(" has closed the connection") && !is_connected, "{gone}");
        let (foreign, is_connected) = of(|| Reply::Foreign);
        assert!(!foreign.ends_with(" has closed the connection") && !is_connected, "{foreign}");
        let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
        let mut apart = ThriftRobot::new("127.0.0.1", 9, &block).unwrap();
        assert_eq!(apart.ping(), Err(DriverError::Away("not connected".to_owned())));
    }

    #[test]
    fn device_with_several_control_types_is_refused() {
        let more = r#""speed": {"min_value": 0, "max_value": 9, "granularity": 1}, "position""#;
        let block = BLOCK.replace("\"position\"", more);
        let block: InitializationBlock = serde_json::from_str(&block).unwrap();
        let error = ThriftRobot::new("127.0.0.1", 9, &block).err().unwrap().to_string();
        assert!(error.starts_with("device `arm` has several control types"), "{error}");
    }
}
