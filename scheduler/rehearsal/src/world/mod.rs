//! What all virtual worlds share, that of a dry run and that of the simulation with random faults: the order of events.

mod agenda;

pub use self::agenda::Agenda;
