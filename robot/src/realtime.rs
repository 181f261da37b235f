//! How precisely a thread wakes: what the system grants it, how it waits, and how late that is on this host.

#[doc(hidden)]
pub use crate::precise_wait::{PreciseWait, Woken};
pub use crate::scheduling::{Realtime, Scheduling};
pub use crate::wake_up::WakeUp;
