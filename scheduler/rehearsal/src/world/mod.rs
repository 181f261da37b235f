//! The parts of all virtual worlds, that of dry runs and trials and that of the simulation with random faults: time and the order of
//! events, the network, and the robots' processes.

mod agenda;
mod kernel;
mod path;
mod processes;

pub use self::agenda::Agenda;
pub use self::kernel::{Kernel, Virtual};
pub(crate) use self::path::between;
pub use self::path::{Conditions, Direction, Path, Transport, Travel};
pub use self::processes::Processes;
