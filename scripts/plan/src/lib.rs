//! The result of compiling a scenario. A [`Choreography`] contains acts and the transitions between them. Each [`Act`] has a [`Plan`]
//! with the scripts of every device. The compiler (`downbeat-scripts`) produces choreographies and missions (`downbeat-mission`) play
//! them; neither depends on the other.
//!
//! | module | |
//! |---|---|
//! | `choreography` | acts, plans, scripts, and transitions between acts |
//! | `requirements` | bounds that a scenario sets for its trials |
//! | `refill` | the available time for sending scripts that a device cannot hold from the start |
//! | [`compensate`] | commands that precede their motions by the latency of the device |
//! | `rehearse` | a choreography at another speed, with a part of the fleet, or reduced to a single act |

mod choreography;
pub mod compensate;
mod refill;
mod rehearse;
mod requirements;

pub use choreography::{
    Act, Choreography, CueText, DeviceScript, DeviceUse, FailurePolicy, FirstUse, OnDoubt, OnFailure, Plan,
    PlannedCue, PlannedReading, Positions, Repetition, RobotPlan, Wait, Way, is_rate,
};
pub use refill::{Freed, Refill, RefillKind, refills, refills_behind, refills_of_robots};
pub use requirements::{AllOrNone, Ceiling, Floor, Requirements, Share};
