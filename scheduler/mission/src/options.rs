//! The participants of a mission, and the operator's choices.

use std::sync::Arc;

use downbeat_fleet::fleet::MissionSettings;
use serde::{Deserialize, Serialize};
use urrcp::{InitializationBlock, RobotId, Server, SessionId, Span, Timestamp};

use super::ActIndex;
use super::transfer::PlanTransfer;
use crate::session::Session;
use crate::zone::Zone;

/// A robot that takes part in a mission. After the mission is created, the robot is identified by its index.
#[derive(Clone, Debug)]
pub struct Participant {
    /// The robot's id in the fleet file.
    pub id: RobotId,
    /// The robot's static description, if the fleet file gives one, with the id by which the robot must identify itself.
    pub block: Option<InitializationBlock>,
    /// The robot's settings in the fleet file.
    pub settings: MissionSettings,
    /// Whether the robot runs in the process of the mission. Such a robot ends with that process, so no earlier process can still move
    /// it.
    pub in_process: bool,
}

impl Participant {
    /// A participant with this id and description. Its settings are the defaults, except that its robot wakes up without delay.
    #[must_use]
    pub fn new(id: RobotId, block: Option<InitializationBlock>) -> Self {
        let settings = MissionSettings { wake_up: Span::ZERO, ..MissionSettings::default() };
        Self { id, block, settings, in_process: false }
    }

    /// The id with which the robot must identify itself.
    #[must_use]
    pub fn own_id(&self) -> &RobotId {
        self.block.as_ref().map_or(&self.id, |block| &block.id)
    }
}

/// Whether the mission performs steps 1 to 4 of the protocol, in which it greets the robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Greeting {
    /// Ask every robot for its availability, clock and initialization block.
    Full,
    /// Trust the static descriptions of the robots, as in a static system in a closed network.
    Skip,
}

/// How to treat a robot that is missing when the mission begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Join {
    /// The mission does not start without the robot.
    #[default]
    Refuse,
    /// The other robots begin, and this robot joins at the first act that begins after its arrival.
    NextAct,
}

/// The operator's choices for a mission.
#[derive(Clone, Debug)]
pub struct MissionOptions {
    /// Whether to perform steps 1 to 4 of the protocol, in which the mission greets the robots.
    pub greeting: Greeting,
    /// The lead time that overrides the scenario's lead time; `None` if the scenario's lead time applies.
    pub lead: Option<Span>,
    /// How long to wait for links, greetings and stop confirmations.
    pub patience: Span,
    /// Uncertainty of the server's own clock against NTP.
    pub server_uncertainty: Span,
    /// The session for which robots are driven. Without one, a robot cannot distinguish this scheduler from another.
    pub session: Option<Session>,
    /// The starts at fixed times, and their permitted delay.
    pub fixed: FixedStarts,
    /// The index of the first act that the mission plays.
    pub first_act: ActIndex,
    /// The maximum number of acts, including those that waited without success. After them, the mission ends as after its last act. The
    /// first act always begins. `None` if there is no limit.
    pub acts_max: Option<u32>,
    /// How to treat robots that are missing when the mission begins.
    pub join: Join,
    /// Whether to take over robots that belong to other sessions. A robot permits this only if it has proven its identity and this
    /// operator has the required role.
    pub seize: bool,
    /// Whether to read the sensors that show positions around the first movement of each device in an act, and report when motions began.
    pub verify_motion: bool,
    /// Whether to end the mission once the fleet is checked.
    pub preflight_only: bool,
    /// The time zone of the times of day that acts wait for.
    pub zone: Zone,
    /// The planner of acts after a stop. Without it, each robot moves to its default positions on its own. The act after a failure then
    /// begins only if its robots have come to rest at their first positions.
    pub transfer: Option<Arc<dyn PlanTransfer>>,
    /// Whether to check the invariants of the mission after every event, and panic if one is violated. By default, only unoptimized
    /// programs check them.
    pub check_invariants: bool,
}

/// The starts that are fixed by the operator or by acts that wait for a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FixedStarts {
    /// The start that the operator fixes; `None` if the operator fixes none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<FixedStart>,
    /// The permitted delay of a fixed start that cannot take place on time.
    #[serde(rename = "within_ms", default)]
    pub within: Span,
}

/// The first start of an act, fixed by the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FixedStart {
    /// The index of the act.
    pub act: ActIndex,
    /// The time of the start.
    pub at: Timestamp<Server>,
}

impl MissionOptions {
    /// The session id as sent to robots, with its key. It must not be displayed.
    #[must_use]
    pub fn session_on_the_wire(&self) -> Option<SessionId> {
        self.session.as_ref().map(|session| session.on_the_wire().clone())
    }

    /// The session's name for users.
    #[must_use]
    pub fn session_name(&self) -> Option<&SessionId> {
        self.session.as_ref().map(Session::name)
    }

    /// The prefix of the request ids of this session.
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
            first_act: ActIndex::new(0),
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
