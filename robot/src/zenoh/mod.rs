//! Robots that are reached at a key of a Zenoh network: through its routers, over many networks and machines.
//!
//! A connection is a stream of bytes like one of TCP: in order, each byte at most once, its end noticed, and bounded in what
//! waits in it. Below the key `KEY` of a robot are
//!
//! | key | what |
//! |---|---|
//! | `KEY/robot/ID` | liveliness token of the robot's Zenoh session: the robot's process is there and reached |
//! | `PLACE/scheduler/ID` | liveliness token of the scheduler's session; `PLACE` is `KEY` without its last chunk |
//! | `KEY/open` | answers queries that open a connection: the query carries the name of the connection, and `stop` behind it for one that goes ahead of others; the answer the robot's `ID` |
//! | `KEY/to`, `KEY/from/ID` | the frames to the robot, and from it to the scheduler's session; each has the name of its connection attached |
//!
//! Keys of frames and queries are declared, and without wildcards: for any others, every session and every router compares each
//! message with the keys of all robots.
//!
//! A frame is numbered. One that is lost, repeated or overtaken on its way breaks the connection.

mod config;
mod connect;
mod frame;
mod keys;
mod listener;
mod network;
mod pipe;
mod presence;
mod stream;

pub use config::NetworkError;
pub use connect::connect;
pub use keys::{Key, NoKey};
pub use listener::Listener;
pub use network::{Haste, Network};
pub use stream::Stream;

#[cfg(test)]
mod tests;
