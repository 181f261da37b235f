//! Answers to inquiries: messages that ask for the state of requests and devices. They start, stop, move and claim nothing.

use urrcp::{
    ControlError, DeviceId, DeviceReport, Inquiry, InquiryResponse, Message, RequestId, RequestReport,
    RequestState, Status,
};

use super::control::Owner;
use super::{Now, Output, Robot};
use crate::answers::Known;
use crate::held::{Held, Limit};
use crate::ids::LinkId;

impl Robot {
    pub(super) fn inquire(&mut self, now: Now, link: LinkId, inquiry: &Inquiry, out: &mut Vec<Output>) {
        let busy = match self.owner(now, link, inquiry.session.as_ref()) {
            Owner::Another(busy) => Some(busy),
            Owner::Nobody | Owner::Asker => None,
        };
        let belongs = busy.is_none();
        let response = self.what_is_known(now, inquiry, busy);
        out.push(Output::Send { link, message: Message::InquiryResponse(response) });
        if belongs && !inquiry.requests.is_empty() {
            let party = self.parties.party(link);
            let (pending, until) = (inquiry.pending_lease, inquiry.pending_until);
            let limit = Limit { pending, until, asked: inquiry.timestamp.map(|asked| (link, asked)) };
            inquiry.requests.iter().for_each(|id| self.limit(id, party, limit));
            // An inquiry may set a lease of zero length, which ends at once.
            self.advance(now, out);
        }
    }

    fn what_is_known(&self, now: Now, inquiry: &Inquiry, busy: Option<ControlError>) -> InquiryResponse {
        let belongs = busy.is_none();
        let error = busy.or_else(|| self.hardware.missing());
        let status = if error.is_some() { Status::Failed } else { Status::Ok };
        InquiryResponse {
            error,
            requests: if belongs {
                inquiry.requests.iter().map(|id| self.report_of(id)).collect()
            } else {
                Vec::new()
            },
            devices: if belongs {
                inquiry.devices.iter().filter_map(|id| self.device_report(now, id)).collect()
            } else {
                Vec::new()
            },
            ..InquiryResponse::new(inquiry, now, now, status)
        }
    }

    fn report_of(&self, id: &RequestId) -> RequestReport {
        let unknown = RequestReport::new(id.clone(), RequestState::Unknown);
        let Some(known) = self.answers.known(id) else { return unknown };
        let known_of =
            RequestReport { content_hash: known.content_hash, event_timestamp: known.began, ..unknown };
        match known.answer.status {
            // A device that holds its value between steps reports `Started` only with the first value. Until then, the last response is
            // `Accepted`.
            Status::Accepted
                if self.running(known).is_none_or(|held| held.request_id.as_ref() != Some(id)) =>
            {
                RequestReport { state: RequestState::Held, start_timestamp: known.start, ..known_of }
            }
            Status::Accepted | Status::Started => self.running_report(known, known_of),
            _ => RequestReport {
                state: RequestState::Ended,
                steps_done: known.answer.steps_done,
                late_steps: known.answer.late_steps,
                late_ms_max: known.answer.late_ms_max,
                error: known.answer.error.clone(),
                ..known_of
            },
        }
    }

    /// Returns the command that runs on the device of this request, if any.
    fn running(&self, known: &Known) -> Option<&Held> {
        self.devices[*self.index_of.get(&known.answer.device_id)?].running()
    }

    fn running_report(&self, known: &Known, report: RequestReport) -> RequestReport {
        let running = self.running(known);
        if let Some(plan) = known.answer.request_id.as_ref().and_then(|id| self.plans.of_request(id)) {
            return RequestReport {
                state: RequestState::Running,
                start_timestamp: known.start,
                steps_done: Some(plan.steps_done),
                late_steps: Some(plan.late.count),
                late_ms_max: plan.late.ms_max(),
                ..report
            };
        }
        RequestReport {
            state: RequestState::Running,
            start_timestamp: known.start,
            steps_done: running.map(|held| held.steps_done()),
            late_steps: running.map(|held| held.late.count),
            late_ms_max: running.and_then(|held| held.late.ms_max()),
            ..report
        }
    }

    /// Returns the report about a device. If the hardware does not answer, the device reports room for 0 commands. `None` if the device
    /// does not exist.
    fn device_report(&self, now: Now, id: &DeviceId) -> Option<DeviceReport> {
        let device = &self.devices[*self.index_of.get(id)?];
        let is_missing = self.hardware.missing().is_some();
        Some(DeviceReport {
            device_id: id.clone(),
            room: if is_missing { 0 } else { device.room() },
            position: device.position(now).filter(|_| !is_missing),
        })
    }

    /// Limits the pending lease of a request (its maximum silence before the start), if `party` sent the request. The inquiry of this
    /// party has just renewed the lease.
    fn limit(&mut self, id: &RequestId, party: LinkId, limit: Limit) {
        let Some(known) = self.answers.known(id) else { return };
        let (Some(start), Some(&index)) = (known.start, self.index_of.get(&known.answer.device_id)) else {
            return;
        };
        self.devices[index].limit(id, start, party, limit);
        self.refresh_wakeup(index);
    }
}
