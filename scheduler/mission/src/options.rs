//! Who takes part in a mission, and what the operator chose.

use std::sync::Arc;

use downbeat_fleet::fleet::MissionSettings;
use serde::{Deserialize, Serialize};
use urrcp::{InitializationBlock, RobotId, Server, SessionId, Span, Timestamp};

use super::transfer::PlanTransfer;
use crate::session::Session;
use crate::zone::Zone;

/// A robot that takes part, by its index in the mission from here on.
#[derive(Clone, Debug)]
pub struct Participant {
    /// Its id in the fleet file.
    pub id: RobotId,
    /// Its static description, if the fleet file gives one, with the id by which it has to call itself.
    pub block: Option<InitializationBlock>,
    /// What the fleet file says of it.
    pub settings: MissionSettings,
    /// Whether the robot runs in the process of the mission. It ends with that process, so no earlier one can still move it.
    pub in_process: bool,
}

impl Participant {
    /// A robot of which nothing but this is known, and that wakes up for a start on time.
    #[must_use]
    pub fn new(id: RobotId, block: Option<InitializationBlock>) -> Self {
        let settings = MissionSettings { wake_up: Span::ZERO, ..MissionSettings::default() };
        Self { id, block, settings, in_process: false }
    }

    /// What the robot has to call itself.
    #[must_use]
    pub fn own_id(&self) -> &RobotId {
        self.block.as_ref().map_or(&self.id, |block| &block.id)
    }
}

/// Whether steps 1 to 4 of the protocol are played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Greeting {
    /// Ask every robot for its availability, clock and initialization block.
    Full,
    /// Trust the static blocks (a static system in a closed network).
    Skip,
}

/// What becomes of a robot that is not there when the mission begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Join {
    /// Nothing starts without it.
    #[default]
    Refuse,
    /// The others begin, and it joins at the first act that begins after it has come.
    NextAct,
}

/// What the operator chose.
#[derive(Clone, Debug)]
pub struct MissionOptions {
    /// Steps 1 to 4, or not.
    pub greeting: Greeting,
    /// Overrides the scenario's lead time.
    pub lead: Option<Span>,
    /// How long to wait for links, greetings and stop confirmations.
    pub patience: Span,
    /// Uncertainty of the server's own clock against NTP.
    pub server_uncertainty: Span,
    /// On whose behalf robots are driven. Without one a robot cannot tell this scheduler from another.
    pub session: Option<Session>,
    /// The starts at fixed times.
    pub fixed: FixedStarts,
    /// With which act to begin, by its index.
    pub first_act: usize,
    /// No further act begins once so many have, those included that waited in vain; the mission then comes to its end as
    /// after its last act. The first act always begins. `None`: no bound.
    pub acts_max: Option<u32>,
    /// What becomes of robots that are not there at first.
    pub join: Join,
    /// Takes robots that belong to other sessions, where they let it: they have proven who they are, and this operator has the role.
    pub seize: bool,
    /// Reads the sensors that show positions around the first movement of each device in an act, and tells when motions began.
    pub verify_motion: bool,
    /// Ends once the fleet is checked.
    pub preflight_only: bool,
    /// The time zone of the times of day for which acts wait.
    pub zone: Zone,
    /// Plans acts after a stop. Without it, each robot goes to its default positions on its own, and the act after a failure
    /// begins only if its robots have come to rest at their first positions.
    pub transfer: Option<Arc<dyn PlanTransfer>>,
    /// Checks after every event what must hold of the mission, and panics where it does not. By default, only programs that are not optimized do.
    pub check_invariants: bool,
}

/// The starts at fixed times: by the operator, or by acts that wait for a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FixedStarts {
    /// `None`: the operator fixes no start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<FixedStart>,
    /// By how much a start may be later than fixed if it would otherwise not take place.
    #[serde(rename = "within_ms", default)]
    pub within: Span,
}

/// The first start of an act, as the operator fixes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FixedStart {
    /// The index of the act.
    pub act: usize,
    /// When it starts.
    pub at: Timestamp<Server>,
}

impl MissionOptions {
    /// The session as robots know it, with its key. It must not be shown.
    #[must_use]
    pub fn session_on_the_wire(&self) -> Option<SessionId> {
        self.session.as_ref().map(|session| session.on_the_wire().clone())
    }

    /// The session as people know it.
    #[must_use]
    pub fn session_name(&self) -> Option<&SessionId> {
        self.session.as_ref().map(Session::name)
    }

    /// With what the names of this session's requests begin.
    pub(crate) fn names_begin(&self) -> String {
        self.session_name().map(|name| format!("{name}/")).unwrap_or_default()
    }
}

impl Default for MissionOptions {
    fn default() -> Self {
        Self {
            greeting: Greeting::Full,
            lead: None,
            patience: Span::from_millis(5_000),
            server_uncertainty: Span::ZERO,
            session: None,
            fixed: FixedStarts::default(),
            first_act: 0,
            acts_max: None,
            join: Join::Refuse,
            seize: false,
            verify_motion: false,
            preflight_only: false,
            zone: Zone::UTC,
            transfer: None,
            check_invariants: cfg!(debug_assertions),
        }
    }
}
