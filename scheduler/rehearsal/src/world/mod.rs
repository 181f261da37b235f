//! The common parts of all virtual worlds: time and the order of events, the network, and the robots' processes. Dry runs, trials and the
//! simulation with random faults use them.

mod agenda;
mod kernel;
mod path;
mod processes;

pub use self::agenda::Agenda;
pub use self::kernel::{Kernel, Virtual};
pub(crate) use self::path::between;
pub use self::path::{Conditions, Direction, Path, Transport, Travel};
pub use self::processes::Processes;
