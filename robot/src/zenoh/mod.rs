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
//! What goes to several robots may be published once, at a key of its own:
//!
//! | key | what |
//! |---|---|
//! | `PLACE/shared/ID/N` | texts that the scheduler's session publishes for some robots of a place, its audience `N` |
//! | `PLACE/shared/ID` | answers queries for one of them by its SHA-256 |
//!
//! The query at `KEY/open` has the audiences of the robot attached, and the answer of a robot that hears them says so. A frame to it may then
//! name a part of a text, and its side puts the bytes in. A text that has not come is asked for, and if it does not come then, the
//! connection has ended.
//!
//! A frame is numbered. One that is lost, repeated or overtaken on its way breaks the connection.

mod config;
mod connect;
mod frame;
mod hearing;
mod keys;
mod listener;
mod network;
mod networks;
mod offers;
mod pipe;
mod presence;
mod stream;
mod texts;

pub use config::NetworkError;
pub use connect::{connect, connect_sharing};
pub use keys::{AUDIENCES_MAX, Key, NoKey};
pub use listener::Listener;
pub use network::{Haste, Network};
pub use networks::Networks;
pub use offers::Text;
pub use stream::Stream;

#[cfg(test)]
mod tests;
