//! What a stop needs to know about the messages that the mission has sent to a robot. The mission's loop writes this record, and the stop
//! lane reads its latest version. Neither waits for the other.

use std::collections::BTreeSet;

use tokio::sync::{mpsc, watch};
use urrcp::{Command, ControlRequest, DeviceId, Message, RequestId, Script, Server, SessionId, Timestamp};

use crate::link::{Link, Outgoing};
use downbeat_mission::{RobotIndex, session};

/// What a stop needs to know about the messages that the mission has sent to a robot.
#[derive(Clone, Debug, Default)]
pub(super) struct Sent {
    /// The devices for which the mission has sent a command that moves them.
    devices: BTreeSet<DeviceId>,
    /// The latest timestamp of the requests sent to the robot, by the robot's own clock if that differs from the server's. A stop also
    /// cancels requests that arrive after it but have a timestamp up to this one.
    latest: Option<Timestamp<Server>>,
    /// The session as the robot knows it. `None` without a session.
    session: Option<SessionId>,
    /// The channel of the mission's own link to the robot, for messages that overtake all waiting ones. `None` before the first link.
    pub(super) link: Option<mpsc::UnboundedSender<Outgoing>>,
    /// Whether a link of the mission to this robot has ever been up.
    pub(super) reached: bool,
}

impl Sent {
    /// Creates the record for a robot of a mission that an earlier process began. `devices` are those that the earlier process moved.
    pub(super) fn before(devices: &BTreeSet<DeviceId>, session: Option<SessionId>) -> Self {
        Self { devices: devices.clone(), session, ..Self::default() }
    }
}

/// Whether the mission may send a message to a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Passage {
    Open,
    /// The message must not be sent, because the operator has requested a stop.
    Closed,
}

/// Whether a message moves devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Moves {
    Nothing,
    Devices,
}

/// The mission's end of the record [`Sent`]. It writes new versions, which the stop lane reads.
#[derive(Debug)]
pub(super) struct SentScripts(watch::Sender<Sent>);

impl SentScripts {
    pub(super) const fn new(sent: watch::Sender<Sent>) -> Self {
        Self(sent)
    }

    pub(super) fn note(&self, message: &Message) -> Moves {
        let Message::ControlRequest(request) = message else { return Moves::Nothing };
        match &request.command {
            Command::ReadSensor => Moves::Nothing,
            Command::Script(script) if script.is_empty() => Moves::Nothing,
            Command::Set(_) | Command::Script(_) | Command::Unknown(_) => {
                self.0.send_modify(|sent| sent.add(request));
                Moves::Devices
            }
        }
    }

    pub(super) fn links(&self, link: &Link) {
        self.0.send_modify(|sent| sent.link = Some(link.overtaking()));
    }

    pub(super) fn reached(&self) {
        self.0.send_if_modified(|sent| !std::mem::replace(&mut sent.reached, true));
    }
}

impl Sent {
    fn add(&mut self, request: &ControlRequest) {
        self.devices.insert(request.device_id.clone());
        self.latest = self.latest.max(request.timestamp);
        self.session.clone_from(&request.session);
    }

    /// Returns a stop for each device that may move because of the mission's commands, each with its own request id. The stops bring
    /// devices to rest where they are, even if the mission moves them home afterwards.
    pub(super) fn stops(&self, now: Timestamp<Server>, robot: RobotIndex) -> Vec<(RequestId, Message)> {
        let name = |session: &SessionId| format!("{}/", session::name_of(session));
        let session = self.session.as_ref().map(name).unwrap_or_default();
        let stop = |(index, device): (usize, &DeviceId)| {
            let name = format!("{session}stop/{}/lane/{robot}/{index}", now.as_nanos() / 1_000);
            // This program names the sessions, with lengths far below the limit.
            let id = RequestId::new(name).ok()?;
            let mut request = ControlRequest::immediate(device.clone(), Command::Script(Script::cancel()));
            request.request_id = Some(id.clone());
            request.timestamp = self.latest;
            request.session.clone_from(&self.session);
            Some((id, Message::ControlRequest(request)))
        };
        self.devices.iter().enumerate().filter_map(stop).collect()
    }
}

#[cfg(test)]
mod tests {
    use urrcp::Setpoint;

    use super::*;

    fn request(device: &str, command: Command, at: i64) -> Message {
        let mut request = ControlRequest::immediate(device.parse().unwrap(), command);
        request.timestamp = Some(Timestamp::from_nanos(at));
        request.session = Some("show".parse().unwrap());
        Message::ControlRequest(request)
    }

    fn set() -> Command {
        Command::Set(Setpoint::new(urrcp::ControlType::Position, 1.0))
    }

    #[test]
    fn stop_goes_to_every_addressed_device_and_cancels_all_its_requests() {
        let book = SentScripts::new(watch::Sender::new(Sent::default()));
        assert_eq!(book.note(&request("arm", set(), 7)), Moves::Devices);
        assert_eq!(book.note(&request("leg", set(), 9)), Moves::Devices);
        assert_eq!(book.note(&request("arm", set(), 5)), Moves::Devices);
        let stops = book.0.borrow().stops(Timestamp::from_nanos(1_000), RobotIndex::new(3));
        let told = |(id, message): &(RequestId, Message)| {
            let Message::ControlRequest(request) = message else { panic!("{message:?}") };
            assert_eq!(request.command, Command::Script(Script::cancel()));
            assert_eq!(request.session, Some("show".parse().unwrap()));
            assert_eq!(request.request_id.as_ref(), Some(id));
            (request.device_id.to_string(), request.timestamp, request.home, id.to_string())
        };
        let latest = Some(Timestamp::from_nanos(9));
        let expected = [
            ("arm".to_owned(), latest, false, "show/stop/1/lane/3/0".to_owned()),
            ("leg".to_owned(), latest, false, "show/stop/1/lane/3/1".to_owned()),
        ];
        assert_eq!(stops.iter().map(told).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn sensor_reads_and_stops_leave_nothing_to_stop() {
        let book = SentScripts::new(watch::Sender::new(Sent::default()));
        assert_eq!(book.note(&request("eye", Command::ReadSensor, 7)), Moves::Nothing);
        assert_eq!(book.note(&request("arm", Command::Script(Script::cancel()), 7)), Moves::Nothing);
        assert!(book.0.borrow().stops(Timestamp::from_nanos(0), RobotIndex::new(0)).is_empty());
    }
}
