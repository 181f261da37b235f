//! Assigns received messages to the requests that they belong to.

use urrcp::{ControlResponse, Message, Server, Status, Timestamp};

/// A message received from the robot.
#[derive(Clone, Debug)]
pub(super) struct Received<T> {
    /// Arrival time by the server's clock.
    pub(super) at: Timestamp<Server>,
    /// The received line.
    pub(super) text: String,
    /// The message parsed from the line.
    pub(super) message: T,
}

/// Identifies a request sent on a connection; used to query its responses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ticket(usize);

/// A request that was sent, with all its responses.
#[derive(Clone, Debug)]
pub(super) struct SentRequest {
    pub(super) id: Option<String>,
    pub(super) device: String,
    pub(super) text: String,
    /// Time just before the first byte of the request was last written.
    pub(super) sent: Timestamp<Server>,
    /// Number of times that the request was sent, minus the number of immediate answers to it.
    unanswered: u32,
    pub(super) heard: Vec<Received<ControlResponse>>,
}

impl SentRequest {
    fn has(&self, status: &Status) -> bool {
        self.heard.iter().any(|heard| heard.message.status == *status)
    }

    /// Whether the robot has accepted the request and has not yet reported that it ended.
    pub(super) fn is_held(&self) -> bool {
        self.has(&Status::Accepted) && !self.has(&Status::Ok) && !self.has(&Status::Failed)
    }
}

/// The requests sent on one connection, in the order of sending.
#[derive(Debug, Default)]
pub(super) struct Exchanges {
    sent: Vec<SentRequest>,
    /// For each response in the order of arrival, the index of its request and whether the robot held this request afterwards.
    arrived: Vec<Arrived>,
}

#[derive(Debug)]
struct Arrived {
    request: usize,
    is_held: bool,
}

impl Exchanges {
    pub(super) fn ask(
        &mut self,
        id: Option<String>,
        device: String,
        text: String,
        sent: Timestamp<Server>,
    ) -> Ticket {
        self.sent.push(SentRequest { id, device, text, sent, unanswered: 1, heard: Vec::new() });
        Ticket(self.sent.len() - 1)
    }

    /// Adds a request that was sent on another connection, with the responses received so far.
    pub(super) fn adopt(&mut self, asked: SentRequest) -> Ticket {
        self.sent.push(SentRequest { unanswered: 0, ..asked });
        Ticket(self.sent.len() - 1)
    }

    pub(super) fn ask_again(&mut self, ticket: Ticket, sent: Timestamp<Server>) {
        let asked = &mut self.sent[ticket.0];
        asked.unanswered += 1;
        asked.sent = sent;
    }

    pub(super) fn of(&self, ticket: Ticket) -> &SentRequest {
        &self.sent[ticket.0]
    }

    pub(super) fn any_held(&self) -> bool {
        self.sent.iter().any(SentRequest::is_held)
    }

    /// Assigns a response to its request. Without a `request_id`, an immediate answer belongs to the oldest unanswered request, and a
    /// later report to the oldest held request. Returns the response if no request matches.
    pub(super) fn note(&mut self, heard: Received<ControlResponse>) -> Option<Received<ControlResponse>> {
        let Some(index) = self.find(&heard.message) else { return Some(heard) };
        let asked = &mut self.sent[index];
        if !is_report(&heard.message, asked.is_held()) {
            asked.unanswered = asked.unanswered.saturating_sub(1);
        }
        asked.heard.push(heard);
        let is_held = asked.is_held();
        self.arrived.push(Arrived { request: index, is_held });
        None
    }

    /// Whether the robot still held a request when the first response to the request `other` arrived.
    pub(super) fn is_held_until(&self, ticket: Ticket, other: Ticket) -> bool {
        let before = self.arrived.iter().take_while(|arrived| arrived.request != other.0);
        before.filter(|arrived| arrived.request == ticket.0).last().is_some_and(|last| last.is_held)
    }

    fn find(&self, response: &ControlResponse) -> Option<usize> {
        if let Some(id) = &response.request_id {
            return self.sent.iter().rposition(|asked| asked.id.as_deref() == Some(id.as_str()));
        }
        let of_device = |asked: &&SentRequest| asked.device == response.device_id.as_str();
        let place = |wanted: &dyn Fn(&SentRequest) -> bool| {
            self.sent.iter().position(|asked| of_device(&asked) && wanted(asked))
        };
        let held = place(&|asked| {
            asked.is_held() && !(response.status == Status::Started && asked.has(&Status::Started))
        });
        let open = place(&|asked| asked.unanswered > 0);
        if is_report(response, held.is_some()) { held } else { open }
    }
}

/// Whether `response` is a later report on an accepted command and not the immediate answer to a request.
fn is_report(response: &ControlResponse, held: bool) -> bool {
    match response.status {
        Status::Started => true,
        Status::Ok => response.steps_done.is_some() && held,
        Status::Failed => {
            let code = response.error.as_ref().map(|error| error.code.as_str());
            held && matches!(code, Some("cancelled" | "link_lost"))
        }
        _ => false,
    }
}

/// Whether the robot reports that it cannot parse a line.
pub(super) fn says_malformed(message: &Message) -> bool {
    let (status, error) = match message {
        Message::AvailabilityResponse(response) => (&response.status, &response.error),
        Message::ControlResponse(response) => (&response.status, &response.error),
        _ => return false,
    };
    *status == Status::Failed && error.as_ref().is_some_and(|error| error.code == urrcp::ErrorCode::Malformed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Assigns the responses `said`, which have no request ids, to the requests `asked`, and checks how many each request receives.
    #[track_caller]
    fn check(asked: &[&str], said: &[&str], expected: &[usize]) {
        let mut exchanges = Exchanges::default();
        let at = Timestamp::from_nanos(0);
        let ask = |id: &&str| exchanges.ask(Some((*id).to_owned()), "d".to_owned(), String::new(), at);
        let tickets: Vec<_> = asked.iter().map(ask).collect();
        for fields in said {
            let line = format!(r#"{{"timestamp":"2026-11-20T19:00:00Z","device_id":"d",{fields}}}"#);
            let message = serde_json::from_str(&line).unwrap();
            exchanges.note(Received { at, text: String::new(), message });
        }
        let given: Vec<_> = tickets.iter().map(|ticket| exchanges.of(*ticket).heard.len()).collect();
        assert_eq!(given, expected);
    }

    const ACCEPTED: &str = r#""status":"Accepted""#;
    const STARTED: &str = r#""status":"Started""#;
    const DONE: &str = r#""status":"OK","steps_done":1"#;
    const CANCELLED: &str = r#""status":"Failed","error":{"code":"cancelled"}"#;
    const OK: &str = r#""status":"OK""#;

    #[test]
    fn responses_without_ids_are_assigned_to_oldest_open_or_held_request() {
        check(&["a", "b"], &[ACCEPTED, ACCEPTED, STARTED, DONE, STARTED, DONE], &[3, 3]);
        check(&["a", "b"], &[ACCEPTED, STARTED, ACCEPTED, STARTED, DONE], &[3, 2]);
    }

    #[test]
    fn stop_is_answered_after_the_reports_of_the_commands_it_ended() {
        check(&["a", "b", "stop"], &[ACCEPTED, ACCEPTED, CANCELLED, CANCELLED, OK], &[2, 2, 1]);
    }

    #[test]
    fn request_cancelled_before_it_was_held_is_refused() {
        check(&["a"], &[CANCELLED], &[1]);
    }

    #[test]
    fn response_with_an_id_is_assigned_to_its_request_whatever_else_is_open() {
        check(&["a", "b"], &[r#""status":"Accepted","request_id":"b""#, ACCEPTED], &[1, 1]);
        check(&["a"], &[r#""status":"Accepted","request_id":"strange""#], &[0]);
    }
}
