//! Fleets of robots as files.
//!
//! | module | |
//! |---|---|
//! | [`fleet`] | the fleet file: robots, their settings, bodies and latencies |
//! | [`init`] | descriptions of robots, as initialization blocks or Thrift dictionaries |
//! | [`address`] | addresses of robots |
//! | [`sensor_range`] | which readings of a sensor will do |
//! | [`world`] | delays, losses and clocks for dry runs |

pub mod address;
pub mod fleet;
pub mod init;
pub mod sensor_range;
pub mod world;
