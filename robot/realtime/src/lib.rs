//! Precise waiting of a thread: the scheduling that the system grants, the wait itself, and the measured delay on this host. Linux only.

mod precise_wait;
mod scheduling;
mod wake_up;

pub use precise_wait::{PreciseWait, Woken};
pub use scheduling::{Realtime, Scheduling};
pub use wake_up::WakeUp;
