//! What all virtual worlds share, that of a dry run and that of the simulation with random faults: the order of events and the
//! network.

mod agenda;
mod path;

pub use self::agenda::Agenda;
pub(crate) use self::path::between;
pub use self::path::{Conditions, Direction, Path, Transport, Travel};
