//! Guards one robot: keeps a connection ready until the operator requests a stop, then sends the stop until the robot has confirmed it.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::pin::pin;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use urrcp::{ControlResponse, Message, RequestId, Status};

use super::Alarm;
use super::connection::Connection;
use super::sent::Sent;
use crate::link::{Endpoint, SharedAllowance, Waiting};
use crate::server_clock::ServerClock;
use downbeat_mission::drive::Happened;
use downbeat_mission::{Event, Rest, RobotIndex, may_be_for_a_stop};

/// Initial and maximum pause between attempts to connect. The pause doubles after each attempt.
const TRY_EVERY: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));
/// Time after which the lane also sends an unconfirmed stop on the mission's own link.
const ANSWERS_SOON: Duration = Duration::from_millis(100);
/// Initial and final time limit of an attempt to stop. The limit doubles after each attempt.
const TRY_WITHIN: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(1));

/// Stops that the robot has not confirmed, by request id.
type Open = BTreeMap<RequestId, Message>;

/// The result of an attempt to stop a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Attempt {
    Over,
    /// The operator has now requested the contained kind of rest (in place or at home) instead of the previous one.
    Otherwise(Rest),
}

/// The data of the task that guards and stops one robot.
pub(super) struct Guard {
    pub(super) robot: RobotIndex,
    pub(super) endpoint: Endpoint,
    pub(super) clock: ServerClock,
    /// How much the robot may send, given the requests that the lane has sent to it.
    pub(super) asked: SharedAllowance,
    pub(super) events: mpsc::Sender<Waiting>,
    pub(super) sent: watch::Receiver<Sent>,
    pub(super) alarm: watch::Receiver<Alarm>,
}

impl Guard {
    pub(super) async fn keep(mut self) {
        let mut known = None;
        let (connection, rest) = self.until_alarm(&mut known).await;
        self.stop(connection, known, rest).await;
    }

    /// Waits until the operator requests a stop. Returns the connection if one is up, and the requested kind of rest (in place or at
    /// home).
    async fn until_alarm(&mut self, known: &mut Option<SocketAddr>) -> (Option<Connection>, Rest) {
        let mut ringing = pin!(rings(self.alarm.clone(), None));
        tokio::select! {
            biased;
            rest = &mut ringing => return (None, rest),
            () = reached(&mut self.sent) => {}
        }
        let mut pause = TRY_EVERY.0;
        loop {
            let opened = tokio::select! {
                biased;
                rest = &mut ringing => return (None, rest),
                opened = Connection::open(&self.endpoint, self.clock, &self.asked, known) => opened,
            };
            match opened {
                // A connection to a robot in this process cannot fail.
                Ok(connection @ Connection::InProcess(_)) => {
                    return (Some(connection), ringing.await);
                }
                Ok(mut connection) => tokio::select! {
                    biased;
                    rest = &mut ringing => return (Some(connection), rest),
                    () = connection.stay() => {}
                },
                Err(error) => tracing::debug!("cannot open a connection for stops: {error}"),
            }
            tokio::select! {
                biased;
                rest = &mut ringing => return (None, rest),
                () = tokio::time::sleep(pause) => {}
            }
            pause = (pause * 2).min(TRY_EVERY.1);
        }
    }

    /// Stops the robot. When the operator requests another kind of rest (in place or at home), stops it again, because the mission may
    /// have moved it home meanwhile.
    async fn stop(&self, mut connection: Option<Connection>, mut known: Option<SocketAddr>, mut rest: Rest) {
        loop {
            self.stop_once(&mut connection, &mut known, &mut rest).await;
            let mut otherwise = pin!(rings(self.alarm.clone(), Some(rest)));
            // The robot may report its scripts on this connection, because this is the connection on which it last received the session.
            rest = loop {
                let Some(stands) = &mut connection else { break otherwise.await };
                tokio::select! {
                    latest = &mut otherwise => break latest,
                    message = stands.next() => match message {
                        Some(message) => self.hand_on(message),
                        None => connection = None,
                    },
                }
            };
        }
    }

    async fn stop_once(
        &self,
        connection: &mut Option<Connection>,
        known: &mut Option<SocketAddr>,
        rest: &mut Rest,
    ) {
        let mut open = self.stops();
        if open.is_empty() {
            return;
        }
        if connection.is_none() {
            self.overtake(&open);
        }
        let mut within = TRY_WITHIN.0;
        loop {
            let kept = connection.is_some();
            let attempt = self.attempt(connection, known, &mut open, *rest);
            let ended = tokio::time::timeout(within, attempt).await;
            if open.is_empty() {
                break;
            }
            if let Ok(Attempt::Otherwise(latest)) = ended {
                // The same connection is used, so that it remains the one on which the robot last received the session.
                *rest = latest;
                open = self.stops();
                continue;
            }
            *connection = None;
            if !kept {
                // An attempt that fails immediately is not repeated immediately.
                if ended.is_ok() {
                    tokio::time::sleep(within).await;
                }
                within = (within * 2).min(TRY_WITHIN.1);
            }
        }
    }

    fn stops(&self) -> Open {
        self.sent.borrow().stops(self.clock.now(), self.robot).into_iter().collect()
    }

    /// Sends the unconfirmed stops and waits until all are confirmed. Returns earlier if the connection ends or if the operator requests
    /// another kind of rest (in place or at home).
    async fn attempt(
        &self,
        connection: &mut Option<Connection>,
        known: &mut Option<SocketAddr>,
        open: &mut Open,
        rest: Rest,
    ) -> Attempt {
        let begun = match connection {
            Some(connection) => connection,
            None => match Connection::open(&self.endpoint, self.clock, &self.asked, known).await {
                Ok(opened) => connection.insert(opened),
                Err(error) => return self.failed(&error, open),
            },
        };
        if let Err(error) = begun.send(open.values()).await {
            return self.failed(&error, open);
        }
        let mut soon = pin!(tokio::time::sleep(ANSWERS_SOON));
        let mut otherwise = pin!(rings(self.alarm.clone(), Some(rest)));
        while !open.is_empty() {
            tokio::select! {
                message = begun.next() => match message {
                    Some(message) => self.hear(message, open),
                    None => {
                        self.overtake(open);
                        return Attempt::Over;
                    }
                },
                latest = &mut otherwise => return Attempt::Otherwise(latest),
                () = &mut soon, if !soon.is_elapsed() => self.overtake(open),
            }
        }
        Attempt::Over
    }

    fn failed(&self, error: &std::io::Error, open: &Open) -> Attempt {
        tracing::debug!(robot = self.robot.get(), "the stop was not sent: {error}");
        self.overtake(open);
        Attempt::Over
    }

    fn hear(&self, message: Message, open: &mut Open) {
        match &message {
            Message::ControlResponse(response) if confirms(response) => match &response.request_id {
                Some(id) if open.remove(id).is_some() => {}
                Some(_) => self.hand_on(message),
                // A robot that does not return request ids.
                None => open.retain(|_, stop| !is_for(stop, response)),
            },
            _ => self.hand_on(message),
        }
    }

    /// Forwards robots' reports on scripts to the mission, if its queue has room for them. A response without a request id is not
    /// forwarded, because it may belong to a request of the lane.
    fn hand_on(&self, message: Message) {
        if let Message::ControlResponse(ControlResponse { request_id: Some(_), .. }) = &message {
            let event = Box::new(Event::Received { robot: self.robot, message });
            let _it_asks_again = self.events.try_send(Happened::Event { at: self.clock.now(), event }.into());
        }
    }

    /// Sends the unconfirmed stops on the mission's own link as well.
    fn overtake(&self, open: &Open) {
        if let Some(link) = &self.sent.borrow().link {
            open.values().for_each(|stop| {
                let _down = link.send(Box::new(stop.clone()));
            });
        }
    }
}

fn confirms(response: &ControlResponse) -> bool {
    response.status == Status::Ok
}

/// Whether a response without a request id confirms this stop, rather than the end of a script on the same device.
fn is_for(stop: &Message, response: &ControlResponse) -> bool {
    may_be_for_a_stop(response)
        && matches!(stop, Message::ControlRequest(request) if request.device_id == response.device_id)
}

/// Waits until the operator requests a kind of rest (in place or at home) other than `known`, and returns that kind.
async fn rings(mut alarm: watch::Receiver<Alarm>, known: Option<Rest>) -> Rest {
    let other = |alarm: &Alarm| matches!(alarm, Alarm::Ringing(rest) if Some(*rest) != known);
    match alarm.wait_for(other).await.map(|alarm| *alarm) {
        Ok(Alarm::Ringing(rest)) => rest,
        Ok(Alarm::Quiet | Alarm::GoingHome) | Err(_) => std::future::pending().await,
    }
}

async fn reached(sent: &mut watch::Receiver<Sent>) {
    if sent.wait_for(|sent| sent.reached).await.is_err() {
        std::future::pending::<()>().await;
    }
}

#[cfg(test)]
mod tests {
    use urrcp::{Command, ControlRequest, DeviceId, Script, StatusValue, Timestamp};

    use super::*;

    #[test]
    fn end_of_unnamed_script_does_not_answer_a_stop_of_its_device() {
        let device = |name: &str| name.parse::<DeviceId>().unwrap();
        let stop = ControlRequest::immediate(device("a"), Command::Script(Script::cancel()));
        let stop = Message::ControlRequest(stop);
        let ok = |name| ControlResponse::new(Timestamp::from_nanos(0), device(name), Status::Ok);
        assert!(is_for(&stop, &ok("a")));
        assert!(!is_for(&stop, &ok("b")));
        assert!(!is_for(&stop, &ControlResponse { status_value: StatusValue::Number(45.0), ..ok("a") }));
        assert!(!is_for(&stop, &ControlResponse { steps_done: Some(2), ..ok("a") }));
    }
}
