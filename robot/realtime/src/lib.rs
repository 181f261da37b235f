//! How precisely a thread wakes: what the system grants it, how it waits, and how late that is on this host. Linux only.

mod precise_wait;
mod scheduling;
mod wake_up;

pub use precise_wait::{PreciseWait, Woken};
pub use scheduling::{Realtime, Scheduling};
pub use wake_up::WakeUp;
