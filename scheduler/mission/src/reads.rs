//! The readings that a robot owes, in the order of their requests.

use urrcp::{ControlResponse, DeviceId, RequestId, Status};

use super::robot_state::Reading;

/// The readings that one robot owes, in the order of their requests.
#[derive(Debug, Default)]
pub(crate) struct OwedReadings(Vec<Owed>);

#[derive(Debug)]
struct Owed {
    id: RequestId,
    device: DeviceId,
    /// The purpose of the reading; `None` if the answer is no longer awaited. The entry is kept, so that a late answer without an id is
    /// not assigned to a later request.
    what: Option<Reading>,
}

/// Maximum number of readings that a robot owes. Beyond it, readings that are no longer awaited, and readings for conditions of acts, are
/// discarded.
const OWED_MAX: usize = 1_024;

impl OwedReadings {
    pub(crate) fn ask(&mut self, id: RequestId, device: DeviceId, what: Reading) {
        self.0.push(Owed { id, device, what: Some(what) });
    }

    /// Makes room for another reading.
    pub(crate) fn make_room(&mut self) {
        if self.0.len() >= OWED_MAX {
            self.0.retain(|owed| !matches!(owed.what, None | Some(Reading::Wait(_))));
        }
    }

    pub(crate) const fn len(&self) -> usize {
        self.0.len()
    }

    /// Removes and returns the reading that a response answers: the reading with the id of the response, or else the oldest reading of
    /// its device.
    pub(crate) fn take_answered(&mut self, response: &ControlResponse) -> Option<Reading> {
        let answers = matches!(response.status, Status::Provide | Status::Failed);
        let is_meant = |owed: &Owed| match &response.request_id {
            Some(id) => owed.id == *id,
            None => answers && owed.device == response.device_id,
        };
        let place = self.0.iter().position(is_meant)?;
        self.0.remove(place).what
    }

    /// The readings whose answers are awaited.
    pub(crate) fn awaited(&self) -> impl Iterator<Item = &Reading> {
        self.0.iter().filter_map(|owed| owed.what.as_ref())
    }

    /// Stops awaiting these readings.
    pub(crate) fn forget(&mut self, is_forgotten: impl Fn(&Reading) -> bool) {
        for owed in &mut self.0 {
            owed.what.take_if(|what| is_forgotten(what));
        }
    }

    /// Discards all readings, because the link on which they were requested is gone, and their answers with it.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use urrcp::{Server, Timestamp};

    use super::*;
    use crate::ActNumber;
    use crate::bench::{at, response};

    fn name(name: &str) -> RequestId {
        RequestId::new(name).unwrap()
    }

    fn provides(device: &str, id: Option<&str>, status: Status) -> ControlResponse {
        let said: Timestamp<Server> = at(1);
        response(&device.parse().unwrap(), id.map(name).as_ref(), status, said)
    }

    /// Two readings of `a`, the first of which is forgotten, and one of `b`.
    fn owed() -> OwedReadings {
        let mut owed = OwedReadings::default();
        for (id, device, act) in [("0", "a", 0), ("1", "b", 1), ("2", "a", 2)] {
            owed.ask(name(id), device.parse().unwrap(), Reading::Wait(ActNumber::new(act)));
        }
        owed.forget(|what| *what == Reading::Wait(ActNumber::new(0)));
        owed
    }

    #[test]
    fn response_without_id_belongs_to_oldest_reading_even_if_forgotten() {
        let mut owed = owed();
        let mut answered = |device| owed.take_answered(&provides(device, None, Status::Provide));
        assert_eq!(answered("a"), None);
        assert_eq!(answered("a"), Some(Reading::Wait(ActNumber::new(2))));
        assert_eq!(answered("b"), Some(Reading::Wait(ActNumber::new(1))));
        assert_eq!(answered("b"), None);
    }

    #[test]
    fn response_with_id_belongs_to_that_reading() {
        let mut owed = owed();
        assert_eq!(
            owed.take_answered(&provides("a", Some("2"), Status::Provide)),
            Some(Reading::Wait(ActNumber::new(2)))
        );
        assert_eq!(owed.take_answered(&provides("a", Some("3"), Status::Provide)), None);
        assert_eq!(owed.awaited().collect::<Vec<_>>(), [&Reading::Wait(ActNumber::new(1))]);
    }

    #[test]
    fn only_a_value_or_refusal_answers_a_reading_without_id() {
        let is_answered = |status: Status| owed().take_answered(&provides("b", None, status)).is_some();
        assert!(is_answered(Status::Provide) && is_answered(Status::Failed));
        assert!(!is_answered(Status::Accepted) && !is_answered(Status::Started) && !is_answered(Status::Ok));
    }
}
