//! Robots that speak the early Thrift form of URRCP: binary protocol, buffered transport, one connection at a time.
//!
//! The service has six calls, each with at most two arguments of plain types, so they are written out here and no
//! generated code is carried along.

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
use urrcp::{DeviceId, InitializationBlock, Setpoint};

use super::described::is_driven;
use super::{Driver, DriverError, Lifeline, described};

/// How long the robot may take to let itself be connected to, to take a call, to answer one.
const WAIT_MAX: Duration = Duration::from_secs(1);
/// Longest text that a robot may send, in bytes: as long as a line of URRCP.
const TEXT_BYTES_MAX: usize = urrcp::LINE_BYTES_MAX;

/// A robot of the Thrift form.
pub struct ThriftRobot {
    host: String,
    port: u16,
    block: InitializationBlock,
    connection: Option<Connection>,
}

impl ThriftRobot {
    /// For the devices of this robot. Connects to nothing yet.
    ///
    /// # Errors
    /// [`DriverError::Refused`] for a device with more than one control type: the Thrift form names none with a value.
    pub fn new(host: &str, port: u16, block: &InitializationBlock) -> Result<Self, DriverError> {
        let driven = |device: &urrcp::Device| {
            let types = device.available_control_types.iter().map(|(control_type, _)| control_type);
            types.filter(|control_type| is_driven(*control_type)).count()
        };
        if let Some(device) = block.devices.iter().find(|device| driven(device) > 1) {
            let message = format!(
                "device `{}` has several control types; a Thrift robot takes plain values, so leave it one",
                device.id
            );
            return Err(DriverError::Refused(message));
        }
        Ok(Self { host: host.to_owned(), port, block: block.clone(), connection: None })
    }

    fn call<T>(&mut self, call: impl FnOnce(&mut Connection) -> thrift::Result<T>) -> Result<T, DriverError> {
        let away = || DriverError::Away("not connected".to_owned());
        let called = call(self.connection.as_mut().ok_or_else(away)?);
        called.map_err(|error| match error {
            thrift::Error::Application(error) => DriverError::Refused(told(&error)),
            error => {
                // The answer may still come, and would be taken for that of the next call.
                self.connection = None;
                DriverError::Away(match has_ended(&error) {
                    true => self.ended(),
                    false => format!("{}:{}: {error}", self.host, self.port),
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
        ApplicationErrorKind::UnknownMethod => format!("the robot knows no such call: {}", error.message),
        _ => format!("the robot says: {}", error.message),
    }
}

impl Driver for ThriftRobot {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.connection = None;
        self.connection = Some(Connection::open(&self.host, self.port)?);
        self.ping()?;
        // It may be another one than before, or another than its init file says.
        let schema = self.call(Connection::schema)?;
        described::fits(&schema, &self.block)
            .map_err(|why| DriverError::Away(format!("{}:{} is another robot: {why}", self.host, self.port)))
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        self.call(|connection| connection.set(device.as_str(), setpoint.value))
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        match self.call(|connection| connection.sensor_double(sensor.as_str())) {
            // Some robots have sensors that answer in words; a number among them will do.
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
        match self.call(Connection::ping)? {
            true => Ok(()),
            false => Err(DriverError::Away("the robot answers ping with false: not ready".to_owned())),
        }
    }

    fn lifeline(&self) -> Option<Lifeline> {
        Lifeline::of(&self.connection.as_ref()?.stream, self.ended())
    }
}

/// A call may learn of the end of a connection before the lifeline does.
fn has_ended(error: &thrift::Error) -> bool {
    let thrift::Error::Transport(error) = error else { return false };
    matches!(error.kind, TransportErrorKind::EndOfFile | TransportErrorKind::NotOpen)
}

/// Asks a Thrift robot for its description, a JSON text.
///
/// # Errors
/// Why there is none.
pub fn describe(host: &str, port: u16) -> Result<String, DriverError> {
    let mut connection = Connection::open(host, port)?;
    connection.schema().map_err(|error| DriverError::Away(format!("{host}:{port}: {error}")))
}

/// A connection to the first of the host's addresses that takes one.
fn stream(host: &str, port: u16) -> io::Result<TcpStream> {
    let mut last = None;
    for address in (host, port).to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, WAIT_MAX) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = Some(error),
        }
    }
    Err(last.unwrap_or_else(|| io::Error::other("the name has no address")))
}

type Input = TBinaryInputProtocol<TBufferedReadTransport<ReadHalf<TTcpChannel>>>;
type Output = TBinaryOutputProtocol<TBufferedWriteTransport<WriteHalf<TTcpChannel>>>;

/// A connection, with the six calls.
struct Connection {
    /// To be watched alone.
    stream: TcpStream,
    input: Input,
    output: Output,
    sequence: i32,
}

/// An argument of a call.
enum Argument<'a> {
    Text(&'a str),
    Double(f64),
}

impl Connection {
    fn open(host: &str, port: u16) -> Result<Self, DriverError> {
        let away = |why: &dyn fmt::Display| {
            DriverError::Away(format!("no connection to thrift://{host}:{port}: {why}"))
        };
        // In words of its kind: the library makes them "not open", the system adds a number.
        let told = |error: std::io::Error| match error.raw_os_error() {
            Some(_) => away(&error.kind()),
            None => away(&error),
        };
        let stream = stream(host, port).map_err(told)?;
        Self::over(stream).map_err(|error| away(&error))
    }

    fn over(stream: TcpStream) -> thrift::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(WAIT_MAX))?;
        stream.set_write_timeout(Some(WAIT_MAX))?;
        let watched = stream.try_clone()?;
        let (reader, writer) = TTcpChannel::with_stream(stream).split()?;
        let limits = TConfiguration::builder().max_string_size(Some(TEXT_BYTES_MAX)).build()?;
        // Robots of the older, headerless form of the protocol are understood as well.
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
            let message = format!("`{name}` came back without a result");
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

/// An answer to another call: the connection is out of step and of no more use.
fn foreign(error: &thrift::Error) -> thrift::Error {
    std::io::Error::new(std::io::ErrorKind::InvalidData, error.to_string()).into()
}
