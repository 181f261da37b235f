//! Missions on real robots: the links, files, threads and clocks around the state machine of `downbeat-mission`.
//!
//! | module | |
//! |---|---|
//! | [`run`] | a mission in real time, and the requests that another process can make of it |
//! | [`fleet`] | robots of a fleet file: participants, endpoints, simulated robots |
//! | [`link`] | links to robots: within the process, over TCP, TLS and Zenoh |
//! | [`journal`], [`recording`] | the files of a mission |
//! | [`stop_lane`], [`signals`] | the operator's stop, on a separate thread; signals of the system |
//! | [`server_clock`] | the clock of the server, and NTP |
//! | [`keys`] | the authority of a site, which creates the keys of robots and operators |
//! | [`open_files`] | the limit of open files, raised for many sockets |

pub mod fleet;
pub mod journal;
pub mod keys;
pub mod link;
pub mod open_files;
pub mod recording;
pub mod run;
pub mod server_clock;
pub mod signals;
pub mod stop_lane;
