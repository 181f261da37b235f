//! The result of compiling a scenario. A [`Choreography`] contains acts and the transitions between them. Each [`Act`] has a [`Plan`]
//! with the scripts of every device. The compiler (`downbeat-scripts`) produces choreographies and missions (`downbeat-mission`) play
//! them; neither crate depends on the other.
//!
//! | module | |
//! |---|---|
//! | `choreography` | acts, plans, scripts, and transitions between acts |
//! | `requirements` | bounds that a scenario sets for its trials |
//! | `refill` | the time available for sending scripts that a device cannot hold from the start |
//! | [`compensate`] | commands sent earlier than their motions, by the latency of the device |
//! | `rehearse` | a choreography at another speed, with some of the robots, or reduced to a single act |

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
