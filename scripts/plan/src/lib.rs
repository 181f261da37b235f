//! What a scenario compiles to. A [`Choreography`] contains acts and the ways between them. Each [`Act`] has a [`Plan`]: the scripts of
//! every device. The compiler (`downbeat-scripts`) makes choreographies, and missions (`downbeat-mission`) play them; neither knows the
//! other.
//!
//! | module | |
//! |---|---|
//! | `choreography` | acts, plans, scripts, and what leads from one act to the next |
//! | `requirements` | bounds that a scenario sets for its trials |
//! | `refill` | the time for sending scripts that a device cannot hold from the start |
//! | [`compensate`] | commands that are earlier than their motions by the latency of the device |
//! | `rehearse` | a choreography at another speed, with a part of the fleet, or a single act of it |

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
