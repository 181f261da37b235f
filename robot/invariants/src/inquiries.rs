//! Checks that the robot answers inquiries truthfully, and that an inquiry changes only leases.

use downbeat_robot::{LinkId, Output};
use urrcp::{
    ErrorCode, Inquiry, InquiryResponse, Message, RequestId, RequestReport, RequestState, Status, Timestamp,
};

use crate::judge::Judge;
use crate::model::{Order, Party};
use crate::{Violation, hold};

type Now = Timestamp<urrcp::Robot>;

impl Judge {
    /// Judges the response to an inquiry. Everything that was due before the inquiry has already been judged.
    pub(crate) fn inquired(
        &mut self,
        now: Now,
        link: LinkId,
        inquiry: &Inquiry,
        out: &[Output],
    ) -> Result<(), Violation> {
        let party = self.heard(now, link, inquiry.session.as_ref());
        let [Output::Send { link: to, message: Message::InquiryResponse(answer) }, brought @ ..] = out else {
            return Err(Violation(format!("unexpected answer to {inquiry:?}: {out:?}")));
        };
        let echoes = *to == link && answer.originate_timestamp == inquiry.timestamp;
        let shows = answer.receive_timestamp == now && answer.timestamp == now;
        hold(echoes && shows, || format!("{answer:?} to {inquiry:?}"))?;
        match answer.status {
            Status::Ok => self.told(party, inquiry, answer)?,
            _ => self.not_told(inquiry, answer)?,
        }
        // An inquiry has further effects only if a lease has expired.
        self.passed(now, brought)
    }

    fn told(&mut self, party: Party, inquiry: &Inquiry, answer: &InquiryResponse) -> Result<(), Violation> {
        self.hold_session(inquiry.session.as_ref())?;
        hold(answer.error.is_none() && answer.requests.len() == inquiry.requests.len(), || {
            format!("{answer:?} to {inquiry:?}")
        })?;
        for (id, report) in inquiry.requests.iter().zip(&answer.requests) {
            hold(report.request_id == *id && self.is_true(report), || {
                format!("{report:?}, last answered {:?}", self.answers.get(id))
            })?;
        }
        let known = inquiry.devices.iter().filter_map(|id| self.devices.get(id));
        let room =
            known.map(|device| (&device.spec.id, device.spec.script_queue as usize - device.queue.len()));
        let told = answer.devices.iter().map(|device| (&device.device_id, device.room as usize));
        hold(room.eq(told), || format!("the room {:?}", answer.devices))?;
        inquiry.requests.iter().for_each(|id| self.limit(party, id, inquiry));
        Ok(())
    }

    fn not_told(&self, inquiry: &Inquiry, answer: &InquiryResponse) -> Result<(), Violation> {
        let busy = answer.error.as_ref().is_some_and(|error| error.code == ErrorCode::Busy);
        let others = self.heard.sessions().any(|session| inquiry.session.as_ref() != Some(session));
        let silent = answer.requests.is_empty() && answer.devices.is_empty();
        hold(busy && others && silent, || format!("{answer:?} to {inquiry:?}"))
    }

    fn order(&self, id: &RequestId) -> Option<&Order> {
        let orders = || self.devices.values().flat_map(|device| &device.queue);
        orders().find(|order| order.id.as_ref() == Some(id))
    }

    fn is_true(&self, report: &RequestReport) -> bool {
        let id = &report.request_id;
        let unknown = RequestReport::new(id.clone(), RequestState::Unknown);
        let known = RequestReport {
            content_hash: self.hashes.get(id).copied(),
            event_timestamp: self.starts.get(id).copied(),
            ..unknown.clone()
        };
        if let Some(order) = self.order(id) {
            let held = RequestReport { start_timestamp: Some(order.start), ..known };
            let steps_done = u32::try_from(order.done).ok();
            return if !order.began {
                *report == RequestReport { state: RequestState::Held, ..held }
            } else {
                let late_steps = report.late_steps.filter(|late| Some(*late) <= steps_done);
                let state = RequestState::Running;
                let late_ms_max = report.late_ms_max.filter(|_| late_steps > Some(0));
                *report == RequestReport { state, steps_done, late_steps, late_ms_max, ..held }
            };
        }
        let Some(answer) = self.answers.get(id) else { return *report == unknown };
        let error = answer.error.clone();
        // The robot does not remember a refusal because of the session.
        let forgotten = error.as_ref().is_some_and(|error| error.code == ErrorCode::Busy);
        let (steps_done, late_steps, late_ms_max) =
            (answer.steps_done, answer.late_steps, answer.late_ms_max);
        let state = RequestState::Ended;
        let ended = RequestReport { state, steps_done, late_steps, late_ms_max, error, ..known };
        *report == ended || forgotten && *report == unknown
    }

    fn limit(&mut self, party: Party, id: &RequestId, inquiry: &Inquiry) {
        let orders = self.devices.values_mut().flat_map(|device| &mut device.queue);
        let named =
            |order: &&mut Order| order.id.as_ref() == Some(id) && order.party == party && !order.began;
        orders.filter(named).for_each(|order| order.limit(inquiry.pending_lease, inquiry.pending_until));
    }
}
