//! Reads the files that describe a fleet of robots.
//!
//! | module | |
//! |---|---|
//! | [`fleet`] | the fleet file: robots, their settings, bodies and latencies |
//! | [`init`] | descriptions of robots: initialization blocks or Thrift dictionaries |
//! | [`address`] | addresses of robots |
//! | [`sensor_range`] | the acceptable readings of a sensor |
//! | [`world`] | delays, losses and clocks for dry runs |

pub mod address;
pub mod fleet;
pub mod init;
mod kinds;
pub mod sensor_range;
pub mod world;
