//! One connection of the test client. It sends and receives bytes, limits every wait, and assigns each response to its request.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::ops::RangeInclusive;
use std::time::Duration;

use urrcp::{
    AvailabilityRequest, AvailabilityResponse, ControlRequest, ControlResponse, Decoder, ErrorCode,
    InitializationBlock, Inquiry, InquiryResponse, Message, Server, SessionId, Span, Status, Timestamp,
    encode,
};

use super::heard::{Exchanges, Received, SentRequest, Ticket, says_malformed};
use super::requirement::{Unmet, differs, shown};
use super::stream::Stream;
use super::trial::Trial;

/// Maximum length in bytes of a line from a robot. The initialization block of a robot with 32,000 devices is shorter.
const LINE_BYTES_MAX: usize = 64 * 1024 * 1024;
/// The first byte of a frame of the compact encoding.
const FRAME: u8 = 0xC1;
/// Read timeout; after each one, the client checks whether the operator has interrupted the examination.
const SLICE: Duration = Duration::from_millis(50);

/// A connection to the robot, with the messages received on it. Dropping it ends the held commands (accepted, not yet ended) and closes
/// the connection.
pub(super) struct Line<'a> {
    trial: &'a Trial,
    stream: Stream,
    buffer: Vec<u8>,
    /// Number of bytes at the start of `buffer` that contain no newline.
    searched: usize,
    exchanges: Exchanges,
    /// The session named in the most recent request; it owns the held commands (accepted, not yet ended).
    session: Option<SessionId>,
    others: VecDeque<Received<Message>>,
    /// Why the connection has ended; `None` while it is open.
    ended: Option<String>,
}

/// An inquiry with the robot's response.
#[derive(Clone, Debug)]
pub(super) struct Inquired {
    pub(super) sent: String,
    came: String,
    pub(super) response: InquiryResponse,
}

impl Inquired {
    /// Creates a failure that states the inquiry, the response and the expected response.
    pub(super) fn differs(&self, expected: &str) -> Unmet {
        differs(&self.sent, &self.came, expected)
    }
}

impl<'a> Line<'a> {
    pub(super) fn over(trial: &'a Trial, stream: Stream) -> Self {
        Self {
            trial,
            stream,
            buffer: Vec::new(),
            searched: 0,
            exchanges: Exchanges::default(),
            session: None,
            others: VecDeque::new(),
            ended: None,
        }
    }

    /// Sends a request and returns its ticket.
    pub(super) fn ask(&mut self, request: &ControlRequest) -> Result<Ticket, Unmet> {
        let mut line = Vec::new();
        encode(&Message::ControlRequest(request.clone()), &mut line);
        let text = String::from_utf8_lossy(&line).into_owned();
        let id = request.request_id.as_ref().map(ToString::to_string);
        self.names(request.session.as_ref());
        self.ask_text(id, request.device_id.as_str(), &text)
    }

    /// Sends the text of a control request, which may be invalid. `text` has to end with a newline.
    pub(super) fn ask_text(&mut self, id: Option<String>, device: &str, text: &str) -> Result<Ticket, Unmet> {
        let sent = self.send(text.as_bytes())?;
        Ok(self.exchanges.ask(id, device.to_owned(), text.to_owned(), sent))
    }

    /// Sends a request again, byte for byte.
    pub(super) fn ask_again(&mut self, ticket: Ticket) -> Result<(), Unmet> {
        let text = self.asked(ticket).text.clone();
        let sent = self.send(text.as_bytes())?;
        self.exchanges.ask_again(ticket, sent);
        Ok(())
    }

    /// Registers a request that was sent on another connection, because its reports may arrive on this one.
    pub(super) fn expect_for(&mut self, asked: &SentRequest) -> Ticket {
        self.exchanges.adopt(asked.clone())
    }

    /// Writes bytes; returns the time just before the first byte was written.
    pub(super) fn send(&mut self, bytes: &[u8]) -> Result<Timestamp<Server>, Unmet> {
        let sent = self.trial.now();
        self.stream.write_all(bytes).and_then(|()| self.stream.flush()).map_err(|error| {
            let text = String::from_utf8_lossy(&bytes[..bytes.len().min(2_000)]);
            Unmet::Failed(format!(
                "the connection broke while {} bytes were being sent ({error}): {}; expected the robot to continue reading",
                bytes.len(),
                shown(&text)
            ))
        })?;
        Ok(sent)
    }

    fn names(&mut self, session: Option<&SessionId>) {
        self.session = session.cloned().or_else(|| self.session.take());
    }

    /// Encodes a message and returns its bytes as they would be sent, after encryption. The state of the encryption advances as if they
    /// had been sent.
    pub(super) fn wrapped(&mut self, message: &Message) -> Result<Vec<u8>, Unmet> {
        let mut line = Vec::new();
        encode(message, &mut line);
        let broke = |error| Unmet::Failed(format!("cannot encrypt or seal the message: {error}"));
        self.stream.wrapped(&line).map_err(broke)
    }

    /// Sends bytes as they are, without encryption or authentication.
    pub(super) fn send_past(&mut self, bytes: &[u8]) -> Result<(), Unmet> {
        let broke =
            |error| Unmet::Failed(format!("the connection broke while bytes were being sent: {error}"));
        self.stream.socket().write_all(bytes).map_err(broke)
    }

    /// Sends a message, and returns the JSON text sent.
    pub(super) fn say(&mut self, message: &Message) -> Result<String, Unmet> {
        let mut line = Vec::new();
        encode(message, &mut line);
        if let Message::AvailabilityRequest(request) = message {
            self.names(request.session.as_ref());
        }
        self.send(&line)?;
        Ok(String::from_utf8_lossy(&line).into_owned())
    }

    pub(super) fn asked(&self, ticket: Ticket) -> &SentRequest {
        self.exchanges.of(ticket)
    }

    /// Reads messages until `done` returns true or the instant `until` is reached. Returns whether `done` returned true.
    pub(super) fn listen(
        &mut self,
        until: Timestamp<Server>,
        mut done: impl FnMut(&Self) -> bool,
    ) -> Result<bool, Unmet> {
        loop {
            if done(self) {
                return Ok(true);
            }
            let left = until - self.trial.now();
            if left <= Span::ZERO || self.ended.is_some() {
                return Ok(false);
            }
            self.trial.go_on()?;
            self.read(left.to_duration().min(SLICE))?;
        }
    }

    fn read(&mut self, limit: Duration) -> Result<(), Unmet> {
        let mut bytes = [0; 64 * 1024];
        // A timeout of zero would be invalid.
        let _unlimited_never =
            self.stream.socket().set_read_timeout(Some(limit.max(Duration::from_micros(100))));
        let read = match self.stream.read(&mut bytes) {
            Ok(0) => return self.end("the robot closed the connection"),
            Ok(read) => read,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                return Ok(());
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => return Ok(()),
            Err(error) => return self.end(&format!("the connection broke ({error})")),
        };
        let at = self.trial.now();
        self.buffer.extend_from_slice(&bytes[..read]);
        while let Some(newline) = self.buffer[self.searched..].iter().position(|byte| *byte == b'\n') {
            let rest = self.buffer.split_off(self.searched + newline + 1);
            let line = std::mem::replace(&mut self.buffer, rest);
            self.searched = 0;
            self.take(at, &line)?;
        }
        self.searched = self.buffer.len();
        if self.buffer.len() <= LINE_BYTES_MAX {
            Ok(())
        } else {
            Err(Unmet::Failed(format!("the robot sent {LINE_BYTES_MAX} bytes without a newline")))
        }
    }

    fn end(&mut self, why: &str) -> Result<(), Unmet> {
        self.ended = Some(why.to_owned());
        Ok(())
    }

    fn take(&mut self, at: Timestamp<Server>, line: &[u8]) -> Result<(), Unmet> {
        let text = String::from_utf8_lossy(line).trim_end().to_owned();
        let mut decoder = Decoder::new(LINE_BYTES_MAX);
        decoder.push(line);
        match decoder.next_message() {
            None => {}
            Some(Ok(Message::ControlResponse(response))) => {
                let stray = self.exchanges.note(Received { at, text, message: response });
                self.others.extend(stray.map(|stray| Received {
                    at,
                    text: stray.text,
                    message: Message::ControlResponse(stray.message),
                }));
            }
            Some(Ok(message)) => self.others.push_back(Received { at, text, message }),
            Some(Err(error)) => {
                return Err(Unmet::Failed(format!(
                    "the robot sent a line that is not a message: {error}: {}",
                    shown(&text)
                )));
            }
        }
        Ok(())
    }

    pub(super) fn has_ended(&self) -> bool {
        self.ended.is_some()
    }

    /// Describes why no message arrived: the robot closed the connection or did not respond within the timeout.
    fn nothing(&self) -> String {
        let silent = || format!("nothing within {}", self.trial.options().patience);
        self.ended.as_ref().map_or_else(silent, |why| format!("nothing: {why}"))
    }

    /// Waits for the first response to a request.
    pub(super) fn answer(&mut self, ticket: Ticket) -> Result<Received<ControlResponse>, Unmet> {
        self.nth_answer(ticket, 0)
    }

    /// Waits for the n-th response to a request, counted from 0.
    pub(super) fn nth_answer(
        &mut self,
        ticket: Ticket,
        n: usize,
    ) -> Result<Received<ControlResponse>, Unmet> {
        let until = self.trial.patience();
        self.listen(until, |line| line.asked(ticket).heard.len() > n)?;
        let found = self.asked(ticket).heard.get(n).cloned();
        found.ok_or_else(|| {
            let came = self.others.back().map_or_else(|| self.nothing(), |other| other.text.clone());
            differs(&self.asked(ticket).text, &came, "a control_response with the request_id of the request")
        })
    }

    pub(super) fn accepted(&mut self, ticket: Ticket) -> Result<Received<ControlResponse>, Unmet> {
        let answer = self.answer(ticket)?;
        match answer.message.status {
            Status::Accepted => Ok(answer),
            _ => Err(differs(&self.asked(ticket).text, &answer.text, "status `Accepted`")),
        }
    }

    /// Sends a request and waits until the robot accepts it.
    pub(super) fn held(&mut self, request: &ControlRequest) -> Result<Ticket, Unmet> {
        let ticket = self.ask(request)?;
        self.accepted(ticket)?;
        Ok(ticket)
    }

    pub(super) fn refused(
        &mut self,
        ticket: Ticket,
        codes: &[ErrorCode],
    ) -> Result<Received<ControlResponse>, Unmet> {
        let answer = self.answer(ticket)?;
        if is_failure(&answer.message, codes) {
            Ok(answer)
        } else {
            let codes: Vec<_> = codes.iter().map(|code| format!("`{code}`")).collect();
            let expected = format!("status `Failed` with error code {}", codes.join(" or "));
            Err(differs(&self.asked(ticket).text, &answer.text, &expected))
        }
    }

    /// Sends a request, and checks that the robot refuses it with `code`.
    pub(super) fn refuses(&mut self, request: &ControlRequest, code: ErrorCode) -> Result<(), Unmet> {
        let ticket = self.ask(request)?;
        self.refused(ticket, &[code]).map(drop)
    }

    /// Waits for a response to a request with the given status.
    pub(super) fn report(
        &mut self,
        ticket: Ticket,
        status: &Status,
        until: Timestamp<Server>,
    ) -> Result<Received<ControlResponse>, Unmet> {
        let ended = |asked: &SentRequest| {
            asked.heard.iter().any(|h| h.message.status == *status || h.message.status == Status::Failed)
        };
        self.listen(until, |line| ended(line.asked(ticket)))?;
        let asked = self.asked(ticket);
        let found = asked.heard.iter().find(|heard| heard.message.status == *status).cloned();
        found.ok_or_else(|| {
            let last = asked
                .heard
                .last()
                .map_or_else(|| self.nothing(), |last| format!("{} as the last response", last.text));
            differs(&asked.text, &last, &format!("a report with status `{status}`"))
        })
    }

    /// Waits for the report that an accepted request failed with `code`.
    pub(super) fn failure(
        &mut self,
        ticket: Ticket,
        code: ErrorCode,
        until: Timestamp<Server>,
    ) -> Result<Received<ControlResponse>, Unmet> {
        let failed =
            |asked: &SentRequest| asked.heard.iter().any(|heard| heard.message.status == Status::Failed);
        self.listen(until, |line| failed(line.asked(ticket)))?;
        let asked = self.asked(ticket);
        let last = asked.heard.last();
        match last.filter(|last| is_failure(&last.message, std::slice::from_ref(&code))) {
            Some(last) => Ok(last.clone()),
            None => {
                let came =
                    last.map_or_else(|| self.nothing(), |last| format!("{} as the last response", last.text));
                Err(differs(
                    &asked.text,
                    &came,
                    &format!("a report with status `Failed` and error code `{code}`"),
                ))
            }
        }
    }

    /// Checks that the robot still holds a request `millis` milliseconds from now, `because` of this reason. A robot that sends no
    /// reports is asked by repeating the request.
    pub(super) fn stays_held(&mut self, ticket: Ticket, millis: i64, because: &str) -> Result<(), Unmet> {
        self.listen(self.trial.soon(millis), |line| !line.asked(ticket).is_held())?;
        if !self.trial.reports() && !self.is_known_to_end(ticket)? {
            return Ok(());
        }
        let asked = self.asked(ticket);
        match asked.heard.last().filter(|_| !asked.is_held()) {
            None => Ok(()),
            Some(last) => Err(differs(&asked.text, &last.text, &format!("no end of the command: {because}"))),
        }
    }

    /// Repeats a request. Returns whether the robot answers that it has ended.
    fn is_known_to_end(&mut self, ticket: Ticket) -> Result<bool, Unmet> {
        let heard = self.asked(ticket).heard.len();
        self.ask_again(ticket)?;
        self.nth_answer(ticket, heard)?;
        Ok(!self.asked(ticket).is_held())
    }

    /// Checks that a request ends with the error `code`. A robot that sends no reports is asked by repeating the request.
    pub(super) fn ends(&mut self, ticket: Ticket, code: ErrorCode) -> Result<(), Unmet> {
        self.ends_by(ticket, code, self.trial.patience())
    }

    /// Like [`Line::ends`], with the instant at which the end must be known.
    pub(super) fn ends_by(
        &mut self,
        ticket: Ticket,
        code: ErrorCode,
        until: Timestamp<Server>,
    ) -> Result<(), Unmet> {
        if !self.trial.reports() && self.asked(ticket).is_held() {
            self.is_known_to_end(ticket)?;
        }
        self.failure(ticket, code, until).map(drop)
    }

    /// Sends `stop`, and checks the report of the command that it ends: its keys, and the number of executed steps.
    pub(super) fn ends_after(
        &mut self,
        ticket: Ticket,
        stop: &ControlRequest,
        steps: RangeInclusive<u32>,
    ) -> Result<(), Unmet> {
        let stop = self.ask(stop)?;
        self.answer(stop)?;
        let report = self.failure(ticket, ErrorCode::Cancelled, self.trial.patience())?;
        let stated = &report.message;
        let right = stated.steps_done.is_some_and(|done| steps.contains(&done))
            && stated.event_timestamp.is_some()
            && report.text.contains("\"status_value\":null");
        if right {
            return Ok(());
        }
        let expected = format!(
            "status_value null, an event_timestamp, and steps_done from {} to {}",
            steps.start(),
            steps.end()
        );
        Err(differs(&self.asked(ticket).text, &report.text, &expected))
    }

    /// Whether the robot still held a request when the first response to the request `other` arrived.
    pub(super) fn is_held_until(&self, ticket: Ticket, other: Ticket) -> bool {
        self.exchanges.is_held_until(ticket, other)
    }

    /// Sends a frame of the compact encoding, and waits for a frame. Returns its message; `None` if the robot answers with a line or not
    /// at all.
    pub(super) fn exchange_frame(&mut self, frame: &[u8]) -> Result<Option<Message>, Unmet> {
        self.send(frame)?;
        let until = self.trial.patience();
        let (mut decoder, mut bytes) = (Decoder::new(LINE_BYTES_MAX), [0; 64 * 1024]);
        let mut begun = false;
        while self.trial.now() < until {
            self.trial.go_on()?;
            let _set = self.stream.socket().set_read_timeout(Some(SLICE));
            let read = match self.stream.read(&mut bytes) {
                Ok(0) => return Ok(None),
                Ok(read) => read,
                Err(_) => continue,
            };
            if !begun && bytes[0] != FRAME {
                return Ok(None);
            }
            begun = true;
            decoder.push(&bytes[..read]);
            if let Some(decoded) = decoder.next_message() {
                return Ok(decoded.ok());
            }
        }
        Ok(None)
    }

    /// Waits for the next message that does not belong to a control request; `None` if none arrives before `until`.
    pub(super) fn other(&mut self, until: Timestamp<Server>) -> Result<Option<Received<Message>>, Unmet> {
        self.listen(until, |line| !line.others.is_empty())?;
        Ok(self.others.pop_front())
    }

    /// Sends an availability request and waits for the response. Ignores `Failed` responses, which belong to another request.
    pub(super) fn availability(
        &mut self,
    ) -> Result<(String, Timestamp<Server>, Received<AvailabilityResponse>), Unmet> {
        let request = AvailabilityRequest {
            timestamp: Some(self.trial.stamp()),
            session: None,
            seize: false,
            revocation_list: None,
        };
        let sent_at = self.trial.now();
        let sent = self.say(&Message::AvailabilityRequest(request))?;
        let until = self.trial.patience();
        let mut last = None;
        while let Some(heard) = self.other(until)? {
            match heard.message {
                Message::AvailabilityResponse(message) if message.status == Status::Ok => {
                    self.trial.saw_round_trip(heard.at - sent_at);
                    return Ok((sent, sent_at, Received { at: heard.at, text: heard.text, message }));
                }
                _ => last = Some(heard.text),
            }
        }
        let came = last.map_or_else(|| self.nothing(), |last| format!("{last} and nothing more"));
        Err(differs(&sent, &came, "an availability_response with status `OK`"))
    }

    /// Checks that the robot still responds after `before`, the text of a message, was sent.
    pub(super) fn survives(&mut self, before: &str) -> Result<(), Unmet> {
        match self.availability() {
            Ok(_) => Ok(()),
            Err(Unmet::Failed(why)) => Err(Unmet::Failed(format!(
                "after {} the connection must remain usable, but: {why}",
                shown(before)
            ))),
            Err(other) => Err(other),
        }
    }

    /// Requests the robot's initialization block and waits for it.
    pub(super) fn initialization(&mut self) -> Result<(String, Received<InitializationBlock>), Unmet> {
        let sent = self.say(&Message::InitializationRequest(urrcp::InitializationRequest::default()))?;
        let until = self.trial.patience();
        while let Some(heard) = self.other(until)? {
            if let Message::InitializationBlock(message) = heard.message {
                return Ok((sent, Received { at: heard.at, text: heard.text, message }));
            }
        }
        Err(differs(&sent, &self.nothing(), "an initialization_block"))
    }

    /// Sends an inquiry and waits for the response.
    pub(super) fn inquire(&mut self, inquiry: &Inquiry) -> Result<Inquired, Unmet> {
        let sent_at = self.trial.now();
        let sent = self.say(&Message::Inquiry(inquiry.clone()))?;
        let until = self.trial.patience();
        while let Some(heard) = self.other(until)? {
            if let Message::InquiryResponse(response) = heard.message {
                self.trial.saw_round_trip(heard.at - sent_at);
                return Ok(Inquired { sent, came: heard.text, response });
            }
        }
        Err(differs(&sent, &self.nothing(), "an inquiry_response"))
    }

    /// Requests the initialization block repeatedly without reading the responses. Stops when the robot accepts no bytes for a while or
    /// closes the connection, or when enough requests are sent. Returns the number of requests.
    pub(super) fn overfill(&mut self) -> Result<usize, Unmet> {
        const ANSWERS_BYTES_MAX: usize = 32 * 1024 * 1024;
        const REQUESTS_MAX: usize = 100_000;
        const IN_ONE_WRITE: usize = 100;
        let mut request = Vec::new();
        encode(&Message::InitializationRequest(urrcp::InitializationRequest::default()), &mut request);
        let requests = request.repeat(IN_ONE_WRITE);
        let block = serde_json::to_vec(self.trial.block()?).map_or(1, |block| block.len().max(1));
        let wanted = (ANSWERS_BYTES_MAX / block).clamp(IN_ONE_WRITE, REQUESTS_MAX);
        if self.stream.socket().set_write_timeout(Some(Duration::from_millis(200))).is_err() {
            return Ok(0);
        }
        for asked in (0..wanted).step_by(IN_ONE_WRITE) {
            self.trial.go_on()?;
            if self.stream.write_all(&requests).is_err() {
                return Ok(asked);
            }
        }
        Ok(wanted)
    }

    /// Sends an invalid line and waits until the robot reports it as malformed.
    pub(super) fn is_malformed(&mut self, line: &[u8]) -> Result<(), Unmet> {
        self.send(line)?;
        let until = self.trial.patience();
        let text = String::from_utf8_lossy(line).into_owned();
        match self.other(until)? {
            Some(heard) if says_malformed(&heard.message) => Ok(()),
            Some(heard) => Err(differs(&text, &heard.text, "status `Failed` with error code `malformed`")),
            None => Err(differs(
                &text,
                &self.nothing(),
                "an answer with status `Failed` and error code `malformed`",
            )),
        }
    }
}

impl Line<'_> {
    /// Closes the connection without ending the commands that the robot still holds.
    pub(super) fn cut(mut self) {
        self.exchanges = Exchanges::default();
    }

    /// Ends the commands that the robot still holds. Returns whether the robot has confirmed that they ended.
    fn wind_up(&mut self) -> Result<bool, Unmet> {
        let cancel = self.trial.cancel(self.trial.actor()?);
        let ticket = self.ask(&ControlRequest { session: self.session.clone(), ..cancel })?;
        let answer = self.answer(ticket)?;
        if !self.trial.reports() {
            return Ok(self.trial.confirms_rest(&answer.message));
        }
        self.listen(self.trial.soon(300), |line| !line.exchanges.any_held())
    }
}

/// Ends the commands that the robot still holds, so that a finished check leaves none behind, regardless of its result.
impl Drop for Line<'_> {
    fn drop(&mut self) {
        let certain = !self.exchanges.any_held() || matches!(self.wind_up(), Ok(true));
        if !certain {
            self.trial.leaves_held();
        }
    }
}

fn is_failure(response: &ControlResponse, codes: &[ErrorCode]) -> bool {
    let code = response.error.as_ref().map(|error| &error.code);
    response.status == Status::Failed && code.is_some_and(|code| codes.contains(code))
}
