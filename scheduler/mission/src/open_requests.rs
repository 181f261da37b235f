//! The requests to one robot whose answers the mission still expects, by their ids.

use std::collections::HashMap;

use urrcp::{ControlResponse, DeviceId, RequestId, Status};

use super::robot_state::Reading;
use super::script::ScriptRef;

/// Maximum number of readings that a robot owes. Beyond it, readings that are no longer awaited, and readings for conditions of acts, are
/// discarded.
const READINGS_MAX: usize = 1_024;

/// The requests to one robot whose answers the mission still expects.
#[derive(Debug, Default)]
pub(crate) struct OpenRequests {
    by_id: HashMap<RequestId, OpenRequest>,
    /// The ids of the readings, in the order of their requests.
    readings: Vec<RequestId>,
}

/// A request whose answer the mission still expects.
#[derive(Debug)]
enum OpenRequest {
    /// The device is to come to rest. It has not confirmed this.
    Stop(DeviceId),
    /// The device is to read its sensor.
    Reading {
        device: DeviceId,
        /// `None` if the answer is no longer awaited. The entry is kept, so that a late answer without an id is not assigned to a later
        /// request.
        purpose: Option<Reading>,
    },
    /// A script of an act under way.
    Script(ScriptRef),
}

/// The request that a response answers.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Answered {
    /// The stop of one device, with the id of its request.
    Stop(RequestId),
    /// A reading, with its purpose.
    Reading(Reading),
    Script(ScriptRef),
}

impl OpenRequests {
    /// Returns the request with this id, which a response names. A reading is answered only once, and is therefore removed. `None` if
    /// there is no such request, or if its answer is no longer awaited.
    pub(crate) fn answer_named(&mut self, id: &RequestId) -> Option<Answered> {
        match self.by_id.get(id)? {
            OpenRequest::Stop(_) => Some(Answered::Stop(id.clone())),
            OpenRequest::Script(script) => Some(Answered::Script(*script)),
            OpenRequest::Reading { .. } => self.take_reading(id).map(Answered::Reading),
        }
    }

    /// Removes the oldest reading of a device that a response without an id answers, and returns its purpose. `None` if the response
    /// answers no reading, or if its answer is no longer awaited.
    pub(crate) fn answer_oldest_reading(&mut self, response: &ControlResponse) -> Option<Reading> {
        if !matches!(response.status, Status::Provide | Status::Failed) {
            return None;
        }
        let is_meant = |id: &&RequestId| match self.by_id.get(*id) {
            Some(OpenRequest::Reading { device, .. }) => *device == response.device_id,
            _ => false,
        };
        let id = self.readings.iter().find(is_meant)?.clone();
        debug_assert!(
            matches!(self.by_id.get(&id), Some(OpenRequest::Reading { device, .. }) if *device == response.device_id),
            "a response answers a reading of its device"
        );
        self.take_reading(&id)
    }

    fn take_reading(&mut self, id: &RequestId) -> Option<Reading> {
        self.readings.retain(|reading| reading != id);
        match self.by_id.remove(id) {
            Some(OpenRequest::Reading { purpose, .. }) => purpose,
            _ => None,
        }
    }

    pub(crate) fn add_script(&mut self, id: RequestId, script: ScriptRef) {
        self.by_id.insert(id, OpenRequest::Script(script));
    }

    pub(crate) fn remove_script(&mut self, id: &RequestId) {
        self.by_id.remove(id);
    }

    /// Returns the script that was sent with this id.
    pub(crate) fn script(&self, id: &RequestId) -> Option<ScriptRef> {
        match self.by_id.get(id) {
            Some(OpenRequest::Script(script)) => Some(*script),
            _ => None,
        }
    }

    /// The scripts of acts under way, each with the id of its request.
    pub(crate) fn scripts(&self) -> impl Iterator<Item = (&RequestId, ScriptRef)> {
        self.by_id.iter().filter_map(|(id, request)| match request {
            OpenRequest::Script(script) => Some((id, *script)),
            _ => None,
        })
    }

    pub(crate) fn add_stop(&mut self, id: RequestId, device: DeviceId) {
        self.by_id.insert(id, OpenRequest::Stop(device));
    }

    pub(crate) fn remove_stop(&mut self, id: &RequestId) {
        self.by_id.remove(id);
    }

    pub(crate) fn remove_all_stops(&mut self) {
        self.by_id.retain(|_, request| !matches!(request, OpenRequest::Stop(_)));
    }

    /// The devices that have not confirmed their stop, each with the id of its request.
    pub(crate) fn stops(&self) -> impl Iterator<Item = (&RequestId, &DeviceId)> {
        self.by_id.iter().filter_map(|(id, request)| match request {
            OpenRequest::Stop(device) => Some((id, device)),
            _ => None,
        })
    }

    pub(crate) fn add_reading(&mut self, id: RequestId, device: DeviceId, purpose: Reading) {
        let reading = OpenRequest::Reading { device, purpose: Some(purpose) };
        if self.by_id.insert(id.clone(), reading).is_none() {
            self.readings.push(id);
        }
    }

    /// Makes room for another reading.
    pub(crate) fn make_room_for_reading(&mut self) {
        if self.readings.len() < READINGS_MAX {
            return;
        }
        let is_needless = |request: &OpenRequest| {
            matches!(request, OpenRequest::Reading { purpose: None | Some(Reading::Wait(_)), .. })
        };
        self.by_id.retain(|_, request| !is_needless(request));
        self.readings.retain(|id| self.by_id.contains_key(id));
    }

    /// Number of readings that the robot owes, including those whose answers are no longer awaited.
    pub(crate) const fn readings_owed(&self) -> usize {
        self.readings.len()
    }

    /// The purposes of the readings whose answers are awaited, in the order of their requests.
    pub(crate) fn awaited_readings(&self) -> impl Iterator<Item = &Reading> {
        self.readings.iter().filter_map(|id| match self.by_id.get(id) {
            Some(OpenRequest::Reading { purpose, .. }) => purpose.as_ref(),
            _ => None,
        })
    }

    /// Stops awaiting these readings.
    pub(crate) fn forget_readings(&mut self, is_forgotten: impl Fn(&Reading) -> bool) {
        for id in &self.readings {
            if let Some(OpenRequest::Reading { purpose, .. }) = self.by_id.get_mut(id) {
                purpose.take_if(|purpose| is_forgotten(purpose));
            }
        }
    }

    /// Discards all readings, because the link on which they were requested is gone, and their answers with it.
    pub(crate) fn clear_readings(&mut self) {
        for id in self.readings.drain(..) {
            self.by_id.remove(&id);
        }
    }
}

#[cfg(test)]
mod tests {
    use urrcp::{Server, Timestamp};

    use super::*;
    use crate::bench::{at, response};
    use crate::{ActNumber, MemberIndex};

    fn name(name: &str) -> RequestId {
        RequestId::new(name).unwrap()
    }

    fn provides(device: &str, status: Status) -> ControlResponse {
        let said: Timestamp<Server> = at(1);
        response(&device.parse().unwrap(), None, status, said)
    }

    fn waits(act: u32) -> Reading {
        Reading::Wait(ActNumber::new(act))
    }

    /// Two readings of `a`, the first of which is forgotten, one of `b`, a stop of `a` and a script.
    fn requests() -> OpenRequests {
        let mut requests = OpenRequests::default();
        for (id, device, act) in [("0", "a", 0), ("1", "b", 1), ("2", "a", 2)] {
            requests.add_reading(name(id), device.parse().unwrap(), waits(act));
        }
        requests.forget_readings(|what| *what == waits(0));
        requests.add_stop(name("stop"), "a".parse().unwrap());
        requests.add_script(name("script"), script());
        requests
    }

    fn script() -> ScriptRef {
        ScriptRef { act: ActNumber::new(3), member: MemberIndex::new(0), script: 1 }
    }

    #[test]
    fn response_without_id_belongs_to_oldest_reading_even_if_forgotten() {
        let mut requests = requests();
        let mut answered = |device| requests.answer_oldest_reading(&provides(device, Status::Provide));
        assert_eq!(answered("a"), None);
        assert_eq!(answered("a"), Some(waits(2)));
        assert_eq!(answered("b"), Some(waits(1)));
        assert_eq!(answered("b"), None);
    }

    #[test]
    fn response_with_id_belongs_to_the_request_with_that_id() {
        let mut requests = requests();
        assert_eq!(requests.answer_named(&name("2")), Some(Answered::Reading(waits(2))));
        assert_eq!(requests.answer_named(&name("2")), None, "a reading is answered once");
        assert_eq!(requests.answer_named(&name("0")), None, "it is no longer awaited");
        assert_eq!(requests.answer_named(&name("3")), None, "it was never sent");
        for _ in 0..2 {
            assert_eq!(requests.answer_named(&name("stop")), Some(Answered::Stop(name("stop"))));
            assert_eq!(requests.answer_named(&name("script")), Some(Answered::Script(script())));
        }
        assert_eq!(requests.awaited_readings().collect::<Vec<_>>(), [&waits(1)]);
    }

    #[test]
    fn only_a_value_or_refusal_answers_a_reading_without_id() {
        let is_answered = |status: Status| requests().answer_oldest_reading(&provides("b", status)).is_some();
        assert!(is_answered(Status::Provide) && is_answered(Status::Failed));
        assert!(!is_answered(Status::Accepted) && !is_answered(Status::Started) && !is_answered(Status::Ok));
    }

    #[test]
    fn requests_of_one_kind_are_removed_without_the_others() {
        let mut requests = requests();
        requests.clear_readings();
        assert_eq!((requests.readings_owed(), requests.stops().count()), (0, 1));
        requests.remove_all_stops();
        assert_eq!((requests.stops().count(), requests.script(&name("script"))), (0, Some(script())));
        assert_eq!(requests.scripts().collect::<Vec<_>>(), [(&name("script"), script())]);
        requests.remove_script(&name("script"));
        assert_eq!(requests.script(&name("script")), None);
    }
}
