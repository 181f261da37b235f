//! What a robot last answered to each request, so that a repeated one is answered again and not executed again, and an
//! inquiry learns what became of it.

use std::collections::{HashMap, VecDeque};

use urrcp::{ContentHash, ControlResponse, RequestId, Robot, Status, Timestamp};

/// Requests that have ended and whose last answer is kept, at least; the oldest go first. Of those that have not ended
/// every answer is kept: the devices' queues bound their number.
pub(crate) const ENDED_KEPT: usize = 256;
/// As many for each device, so that a question about its last ones is answered.
const ENDED_KEPT_A_DEVICE: usize = 4;

/// What is known of each request that carried a `request_id`.
#[derive(Clone, Debug)]
pub(crate) struct Answers {
    kept: usize,
    known: HashMap<RequestId, Known>,
    ended: VecDeque<RequestId>,
}

/// What is known of one request.
#[derive(Clone, Debug)]
pub(crate) struct Known {
    /// The last answer to it.
    pub(crate) answer: ControlResponse,
    /// Hash of what the robot accepted.
    pub(crate) content_hash: Option<ContentHash>,
    /// When it is, or was, to start.
    pub(crate) start: Option<Timestamp<Robot>>,
    /// When it really started.
    pub(crate) began: Option<Timestamp<Robot>>,
}

impl Answers {
    pub(crate) fn of(devices: usize) -> Self {
        let kept = ENDED_KEPT.max(devices * ENDED_KEPT_A_DEVICE);
        Self { kept, known: HashMap::new(), ended: VecDeque::new() }
    }

    /// The last answer to a request.
    pub(crate) fn find(&self, id: &RequestId) -> Option<&ControlResponse> {
        self.known(id).map(|known| &known.answer)
    }

    pub(crate) fn known(&self, id: &RequestId) -> Option<&Known> {
        self.known.get(id)
    }

    /// An accepted request is to start then.
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
                self.known.insert(id.clone(), Known { answer, content_hash, start: None, began });
                false
            }
        };
        if has_ended(answer) && !ended_before {
            self.forget_oldest(id);
        }
    }

    /// This request has ended: the oldest that has goes, if there are too many.
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
