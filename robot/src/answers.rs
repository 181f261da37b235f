//! What a robot last answered to each request, so that a repeated one is answered again and not executed again.

use std::collections::{HashMap, VecDeque};

use urrcp::{ControlResponse, RequestId, Status};

/// Requests that have ended and whose last answer is kept, at least; the oldest go first. Of those that have not ended
/// every answer is kept: the devices' queues bound their number.
pub(crate) const ENDED_KEPT: usize = 256;
/// As many for each device: whoever asks what became of the last ones is told.
const ENDED_KEPT_A_DEVICE: usize = 4;

/// The last answer to each request that carried a `request_id`.
#[derive(Clone, Debug)]
pub(crate) struct Answers {
    kept: usize,
    last: HashMap<RequestId, ControlResponse>,
    ended: VecDeque<RequestId>,
}

impl Answers {
    pub(crate) fn of(devices: usize) -> Self {
        let kept = ENDED_KEPT.max(devices * ENDED_KEPT_A_DEVICE);
        Self { kept, last: HashMap::new(), ended: VecDeque::new() }
    }

    pub(crate) fn find(&self, id: &RequestId) -> Option<&ControlResponse> {
        self.last.get(id)
    }

    pub(crate) fn remember(&mut self, answer: &ControlResponse) {
        let Some(id) = &answer.request_id else { return };
        let before = self.last.insert(id.clone(), answer.clone());
        let ended_before = before.is_some_and(|before| has_ended(&before));
        if !has_ended(answer) || ended_before {
            return;
        }
        self.ended.push_back(id.clone());
        if self.ended.len() > self.kept {
            let oldest = self.ended.pop_front();
            oldest.and_then(|id| self.last.remove(&id));
        }
    }
}

fn has_ended(answer: &ControlResponse) -> bool {
    !matches!(answer.status, Status::Accepted | Status::Started)
}
