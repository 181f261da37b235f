//! A server that controls one edge.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::{Duration, SystemTime};

use urrcp::{
    AvailabilityRequest, AvailabilityResponse, Command as Controls, ControlError, ControlRequest,
    ControlResponse, ControlType, DeviceId, Message, Millis, RequestId, Script, Setpoint, Status, Step,
    Timestamp,
};

use super::processes::Edge;

/// A server that sends messages to one edge, without clock synchronization.
pub struct Server {
    edge: BufReader<TcpStream>,
    /// Responses about the script that arrived while the server waited for other messages.
    said: VecDeque<ControlResponse>,
    /// Planned start of the script.
    start: SystemTime,
}

impl Server {
    pub fn connected(edge: &Edge) -> Self {
        let edge = TcpStream::connect(("127.0.0.1", edge.1)).unwrap();
        edge.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Self { edge: BufReader::new(edge), said: VecDeque::new(), start: SystemTime::now() }
    }

    pub fn send(&mut self, message: &Message) {
        let mut line = Vec::new();
        urrcp::encode(message, &mut line);
        self.edge.get_mut().write_all(&line).unwrap();
    }

    pub fn hear(&mut self) -> Message {
        let mut line = String::new();
        self.edge.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: `{line}`"))
    }

    /// Returns the next response of the edge about the script, and waits for it if necessary.
    pub fn response(&mut self) -> ControlResponse {
        if let Some(said) = self.said.pop_front() {
            return said;
        }
        match self.hear() {
            Message::ControlResponse(response) => response,
            other => panic!("{other:?}"),
        }
    }

    pub fn availability(&mut self) -> AvailabilityResponse {
        self.send(&Message::AvailabilityRequest(AvailabilityRequest::default()));
        loop {
            match self.hear() {
                Message::AvailabilityResponse(response) => return response,
                Message::ControlResponse(response) => self.said.push_back(response),
                other => panic!("{other:?}"),
            }
        }
    }

    /// Sends a script for `left` that starts in `lead` milliseconds. `steps` contains the offset of each step in milliseconds, and its
    /// value.
    pub fn script(&mut self, lead: u64, steps: &[(f64, f64)]) {
        let step = |(millis, value): &(f64, f64)| Step {
            offset: Millis::new(*millis).unwrap(),
            setpoint: Setpoint::new(ControlType::Position, *value),
            stop_condition: None,
        };
        let script = Script::new(steps.iter().map(step).collect()).unwrap();
        self.start = SystemTime::now() + Duration::from_millis(lead);
        let start = self.start.duration_since(SystemTime::UNIX_EPOCH).unwrap();
        self.send(&Message::ControlRequest(ControlRequest {
            timestamp: Some(Timestamp::from_nanos(i64::try_from(start.as_nanos()).unwrap())),
            time_offset_to_start: Some(Millis::new(0.0).unwrap()),
            request_id: Some(RequestId::new("a").unwrap()),
            ..ControlRequest::immediate(DeviceId::new("left").unwrap(), Controls::Script(script))
        }));
        assert_eq!(self.response().status, Status::Accepted);
    }

    /// Sleeps until this many milliseconds before the start of the script.
    pub fn await_start_less(&self, millis: u64) {
        let at = self.start - Duration::from_millis(millis);
        std::thread::sleep(at.duration_since(SystemTime::now()).unwrap_or_default());
    }

    /// Waits until the script fails without having started, and returns its error.
    pub fn fails_unstarted(&mut self) -> ControlError {
        let failed = self.response();
        assert_eq!(failed.status, Status::Failed, "{failed:?}");
        failed.error.unwrap()
    }
}
