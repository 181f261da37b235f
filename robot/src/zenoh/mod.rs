//! Robots at a key of a Zenoh network, which are reached through its routers, across networks and machines.
//!
//! A connection is a stream of bytes, like a TCP connection: in order, each byte at most once, with a detected end, and with bounded
//! buffers. Below the key `KEY` of a robot are
//!
//! | key | what |
//! |---|---|
//! | `KEY/robot/ID` | liveliness token of the robot's Zenoh session: the robot's process exists and is reachable |
//! | `PLACE/scheduler/ID` | liveliness token of the scheduler's session; `PLACE` is `KEY` without its last chunk |
//! | `KEY/open` | answers queries that open a connection; they carry its name, and `stop` if it takes precedence; the answer is `ID` |
//! | `KEY/to`, `KEY/from/ID` | the frames to the robot, and from it to the scheduler's session; the name of the connection is attached |
//!
//! Keys of frames and queries are declared, and contain no wildcards: with any other keys, every session and every router compares each
//! message with the keys of all robots.
//!
//! Texts for several robots may be published once, at a separate key:
//!
//! | key | what |
//! |---|---|
//! | `PLACE/shared/ID/N` | texts that the scheduler's session publishes for some robots of a place, its audience `N` |
//! | `PLACE/shared/ID` | answers queries for one of them by its SHA-256 |
//!
//! The query at `KEY/open` has the audiences of the robot attached, and the answer shows whether the robot receives their texts. A frame
//! to it may then name a part of a text, and the robot's side inserts the bytes. A missing text is requested, and if it still does not
//! arrive, the connection ends.
//!
//! Frames are numbered. One that is lost, repeated or overtaken on its way breaks the connection.

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
pub use network::{Network, Urgency};
pub use networks::Networks;
pub use offers::Text;
pub use stream::Stream;

#[cfg(test)]
mod tests;
