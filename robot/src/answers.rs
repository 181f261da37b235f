//! Keeps a robot's last answer to each request. A repeated request gets this answer without being executed again; the response to an
//! inquiry about a request contains it.

use std::collections::{HashMap, VecDeque};

use urrcp::{ContentHash, ControlResponse, RequestId, Robot, Status, Timestamp};

/// Minimum number of ended requests whose last answer is kept; the oldest are dropped first. Requests that have not ended always keep
/// their answer, because the device queues bound their number.
pub(crate) const ENDED_KEPT: usize = 256;
/// Minimum number of ended requests per device whose last answer is kept, so that an inquiry about a device's last requests can be
/// answered.
const ENDED_KEPT_A_DEVICE: usize = 4;

/// What the robot knows about each request that had a `request_id`.
#[derive(Clone, Debug)]
pub(crate) struct Answers {
    kept: usize,
    known: HashMap<RequestId, Box<Known>>,
    ended: VecDeque<RequestId>,
}

#[derive(Clone, Debug)]
pub(crate) struct Known {
    /// The robot's last answer to the request.
    pub(crate) answer: ControlResponse,
    /// Hash of the request's content, as in the robot's first answer. `None` if that answer contained no hash.
    pub(crate) content_hash: Option<ContentHash>,
    /// Planned start of the command on the robot's clock. `None`: the request was not accepted.
    pub(crate) start: Option<Timestamp<Robot>>,
    /// Actual start of the command on the robot's clock. `None`: the command has not started.
    pub(crate) began: Option<Timestamp<Robot>>,
}

impl Answers {
    pub(crate) fn of(devices: usize) -> Self {
        let kept = ENDED_KEPT.max(devices * ENDED_KEPT_A_DEVICE);
        Self { kept, known: HashMap::new(), ended: VecDeque::new() }
    }

    pub(crate) fn find(&self, id: &RequestId) -> Option<&ControlResponse> {
        self.known(id).map(|known| &known.answer)
    }

    pub(crate) fn known(&self, id: &RequestId) -> Option<&Known> {
        self.known.get(id).map(Box::as_ref)
    }

    /// Records the planned start of an accepted request.
    pub(crate) fn plan(&mut self, id: &RequestId, start: Timestamp<Robot>) {
        if let Some(known) = self.known.get_mut(id) {
            known.start = Some(start);
        }
    }

    pub(crate) fn remember(&mut self, answer: &ControlResponse) {
        let Some(id) = &answer.request_id else { return };
        let began = answer.event_timestamp.filter(|_| answer.status == Status::Started);
        let ended_before = match self.known.get_mut(id) {
            Some(known) => {
                known.began = began.or(known.began);
                let before = std::mem::replace(&mut known.answer, answer.clone());
                has_ended(&before)
            }
            None => {
                let (answer, content_hash) = (answer.clone(), answer.content_hash);
                let known = Known { answer, content_hash, start: None, began };
                self.known.insert(id.clone(), Box::new(known));
                false
            }
        };
        if has_ended(answer) && !ended_before {
            self.forget_oldest(id);
        }
    }

    /// Records that the request `latest` has ended. If more answers than the limit are kept, drops the answer to the request that ended
    /// first.
    fn forget_oldest(&mut self, latest: &RequestId) {
        self.ended.push_back(latest.clone());
        if self.ended.len() > self.kept {
            let oldest = self.ended.pop_front();
            oldest.and_then(|id| self.known.remove(&id));
        }
    }
}

fn has_ended(answer: &ControlResponse) -> bool {
    !matches!(answer.status, Status::Accepted | Status::Started)
}

#[cfg(test)]
mod tests {
    use urrcp::DeviceId;

    use super::*;

    fn id(name: &str) -> RequestId {
        RequestId::new(name).unwrap()
    }

    fn answer(name: &str, status: Status) -> ControlResponse {
        let (at, device) = (Timestamp::from_nanos(0), DeviceId::new("arm").unwrap());
        ControlResponse { request_id: Some(id(name)), ..ControlResponse::new(at, device, status) }
    }

    #[test]
    fn ended_requests_are_kept_up_to_a_limit_and_others_always() {
        for (devices, kept) in [(1, 256), (64, 256), (65, 260)] {
            let mut answers = Answers::of(devices);
            answers.remember(&answer("runs", Status::Started));
            for i in 0..kept {
                answers.remember(&answer(&i.to_string(), Status::Accepted));
                answers.remember(&answer(&i.to_string(), Status::Ok));
            }
            assert!(answers.known(&id("0")).is_some());
            answers.remember(&answer("0", Status::Ok));
            assert!(answers.known(&id("0")).is_some(), "it has ended before");
            answers.remember(&answer("last", Status::Failed));
            let known = ["0", "1", "last", "runs"].map(|name| answers.known(&id(name)).is_some());
            assert_eq!(known, [false, true, true, true], "{devices} devices");
        }
    }

    #[test]
    fn last_answer_replaces_earlier_ones_and_keeps_the_start_times() {
        let mut answers = Answers::of(1);
        let (begun, over) = (Timestamp::from_nanos(5), Timestamp::from_nanos(9));
        answers.plan(&id("a"), begun);
        assert!(answers.find(&id("a")).is_none(), "of what is unknown nothing is planned");
        answers.remember(&answer("a", Status::Accepted));
        answers.plan(&id("a"), begun);
        let event = |status, at| ControlResponse { event_timestamp: Some(at), ..answer("a", status) };
        answers.remember(&event(Status::Started, begun));
        answers.remember(&event(Status::Ok, over));
        let known = answers.known(&id("a")).unwrap();
        assert_eq!(
            (known.start, known.began, known.answer.status.clone()),
            (Some(begun), Some(begun), Status::Ok)
        );
    }
}
