//! What a robot's state machine knows about its hardware: whether the hardware is present, and which readings are pending.

use std::collections::BTreeMap;
use std::time::Duration;

use urrcp::{ControlError, ControlRequest, ErrorCode, Robot, Span, Timestamp};

use crate::ids::LinkId;

/// Maximum number of pending readings; further ones are refused.
pub(crate) const READINGS_MAX: usize = 64;

/// Relation between the sender of a request and the robot. It limits the sender's pending readings: the hardware answers one reading
/// after another, and no stranger may fill its queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Standing {
    /// The robot belongs to the sender's session.
    Owner,
    /// The robot belongs to no session.
    Free,
    /// The robot belongs to a session other than the sender's.
    Stranger,
}

impl Standing {
    /// Returns the maximum number of pending readings of one party, and of all parties together that do not own the robot.
    pub(crate) const fn readings_max(self) -> (usize, usize) {
        match self {
            Self::Owner => (READINGS_MAX, READINGS_MAX),
            Self::Free => (READINGS_MAX / 4, READINGS_MAX / 2),
            Self::Stranger => (4, 8),
        }
    }
}

/// The sender of a request for a reading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asker {
    pub(crate) link: LinkId,
    pub(crate) party: LinkId,
    pub(crate) standing: Standing,
}
/// Time limit of a reading if the sensor declares no `max_delay`, in milliseconds.
const READING_WAIT_MS: f64 = 1_000.0;
/// Longest time limit of a reading in milliseconds, even if the sensor declares a longer `max_delay`.
const READING_WAIT_MS_MAX: f64 = 60_000.0;

/// Time before a start within which the start counts as near.
pub(crate) const START_NEAR: Duration = Duration::from_secs(1);

/// Identifies a requested reading of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ReadingId(pub u64);

/// The answer of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorReading {
    /// The value, in the sensor's unit.
    pub value: f64,
    /// When the value was taken, by the robot's clock. `None` if the hardware does not state it.
    pub taken: Option<Timestamp<Robot>>,
}

impl From<f64> for SensorReading {
    fn from(value: f64) -> Self {
        Self { value, taken: None }
    }
}

/// Whether the hardware is present, as far as the robot's state machine knows.
#[derive(Clone, Debug)]
enum Presence {
    /// There is no hardware: the state machine answers requests for readings by itself.
    Simulated,
    There,
    /// The hardware is connected, but has not answered for the contained time.
    Silent(Span),
    /// The hardware is disconnected, for the contained reason.
    Away(String),
}

/// A pending reading.
#[derive(Clone, Debug)]
pub(crate) struct OpenReading {
    pub(crate) link: LinkId,
    pub(crate) request: ControlRequest,
    party: LinkId,
    standing: Standing,
    until: Timestamp<Robot>,
    wait: Span,
}

/// What a robot's state machine knows about the robot's hardware.
#[derive(Clone, Debug)]
pub(crate) struct Hardware {
    presence: Presence,
    readings: BTreeMap<ReadingId, OpenReading>,
    last: u64,
}

impl Hardware {
    pub(crate) const fn simulated() -> Self {
        Self { presence: Presence::Simulated, readings: BTreeMap::new(), last: 0 }
    }

    /// Creates the state for hardware that has not answered yet.
    pub(crate) fn awaited() -> Self {
        let presence = Presence::Away("the hardware is not available: it has not answered yet".to_owned());
        Self { presence, ..Self::simulated() }
    }

    pub(crate) const fn is_simulated(&self) -> bool {
        matches!(self.presence, Presence::Simulated)
    }

    pub(crate) fn found(&mut self) {
        self.presence = Presence::There;
    }

    pub(crate) fn lost(&mut self, reason: &str) {
        self.presence = Presence::Away(reason.to_owned());
    }

    /// Records that the hardware has been silent for too long (`Some`), or that it answers again (`None`).
    pub(crate) fn silent(&mut self, silence: Option<Span>) {
        if let Presence::There | Presence::Silent(_) = self.presence {
            self.presence = silence.map_or(Presence::There, Presence::Silent);
        }
    }

    /// Whether the hardware answers, so that the robot can promise a start now.
    #[cfg(feature = "host")]
    pub(crate) const fn answers(&self) -> bool {
        matches!(self.presence, Presence::Simulated | Presence::There)
    }

    /// Returns the reason why the robot cannot promise a start now: the hardware is disconnected or silent. `None` if it can.
    pub(crate) fn missing(&self) -> Option<ControlError> {
        match &self.presence {
            Presence::Silent(silence) => Some(unanswered(*silence)),
            _ => self.away(),
        }
    }

    /// Returns the reason why no device can be moved now: the hardware is disconnected. `None` for silent hardware, which may be present
    /// and must still be stopped.
    pub(crate) fn away(&self) -> Option<ControlError> {
        match &self.presence {
            Presence::Away(reason) => Some(ControlError::new(ErrorCode::Internal, reason.clone())),
            Presence::Simulated | Presence::There | Presence::Silent(_) => None,
        }
    }

    /// Adds a pending reading.
    ///
    /// # Errors
    /// `busy` if too many readings are pending: in total, of this party, or of all parties that do not own the robot.
    pub(crate) fn ask(
        &mut self,
        now: Timestamp<Robot>,
        asker: Asker,
        request: &ControlRequest,
        max_delay: Option<f64>,
    ) -> Result<ReadingId, ControlError> {
        let Asker { link, party, standing } = asker;
        let open = |of: fn(&OpenReading, LinkId) -> bool| {
            self.readings.values().filter(|open| of(open, party)).count()
        };
        let (own_max, others_max) = standing.readings_max();
        let own = open(|open, party| open.party == party);
        let others = open(|open, _| open.standing != Standing::Owner);
        let full = match standing {
            _ if self.readings.len() >= READINGS_MAX => Some(READINGS_MAX),
            _ if own >= own_max => Some(own_max),
            Standing::Free | Standing::Stranger if others >= others_max => Some(others_max),
            _ => None,
        };
        if let Some(max) = full {
            let message = format!("{max} readings are already pending");
            return Err(ControlError::new(ErrorCode::Busy, message));
        }
        let wait = Span::from_millis_f64(max_delay.unwrap_or(READING_WAIT_MS).min(READING_WAIT_MS_MAX));
        self.last += 1;
        let id = ReadingId(self.last);
        let request = request.clone();
        let open = OpenReading { link, request, party, standing, until: now + wait, wait };
        self.readings.insert(id, open);
        Ok(id)
    }

    /// Removes and returns a pending reading. `None` if it has been removed before.
    pub(crate) fn close(&mut self, id: ReadingId) -> Option<OpenReading> {
        self.readings.remove(&id)
    }

    /// Returns the time at which the first pending reading expires.
    pub(crate) fn next_wakeup(&self) -> Option<Timestamp<Robot>> {
        self.readings.values().map(|open| open.until).min()
    }

    /// Removes and returns the readings whose time limit has expired, each with its error.
    pub(crate) fn overdue(&mut self, now: Timestamp<Robot>) -> Vec<(OpenReading, ControlError)> {
        let overdue = self.readings.iter().filter(|(_, open)| open.until <= now).map(|(id, _)| *id);
        let overdue: Vec<ReadingId> = overdue.collect();
        let failed = |open: OpenReading| {
            let message = format!("no reading within {}", open.wait);
            (open, ControlError::new(ErrorCode::Internal, message))
        };
        overdue.into_iter().filter_map(|id| self.readings.remove(&id)).map(failed).collect()
    }

    /// Removes and returns all pending readings, because none of them can be answered any longer.
    pub(crate) fn abandon(&mut self) -> Vec<OpenReading> {
        std::mem::take(&mut self.readings).into_values().collect()
    }
}

/// Returns the error for a start that does not take place, or that cannot be promised, because the hardware is silent.
pub(crate) fn unanswered(silence: Span) -> ControlError {
    let message = format!("the hardware has not answered for {silence}");
    ControlError::new(ErrorCode::Internal, message)
}
