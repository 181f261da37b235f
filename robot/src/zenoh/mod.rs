//! Robots at a key of a Zenoh network. The network's routers make them reachable across networks and machines.
//!
//! A connection is a stream of bytes, like a TCP connection: in order, each byte at most once, with a detected end, and with bounded
//! buffers. The following keys belong to the robot at the key `KEY`:
//!
//! | key | content |
//! |---|---|
//! | `KEY/robot/ID` | liveliness token of the robot's Zenoh session: the robot's process exists and is reachable |
//! | `PLACE/scheduler/ID` | liveliness token of the scheduler's session; `PLACE` is `KEY` without its last chunk |
//! | `KEY/open` | answers queries that open a connection; the answer is `ID` |
//! | `KEY/to` | frames to the robot |
//! | `KEY/from/ID` | frames from the robot to the scheduler's session `ID` |
//!
//! A query at `KEY/open` contains the name of the connection, and `stop` if the connection takes precedence. The name of the connection
//! is
//! attached to every frame.
//!
//! Keys of frames and queries are declared, and contain no wildcards: with any other keys, every session and every router compares each
//! message with the keys of all robots.
//!
//! Texts for several robots may be published once, at a separate key:
//!
//! | key | content |
//! |---|---|
//! | `PLACE/shared/ID/N` | texts that the scheduler's session publishes for its audience `N`, a group of robots in a place |
//! | `PLACE/shared/ID` | answers queries for one of these texts, identified by its SHA-256 |
//!
//! The audiences of the robot are attached to the query at `KEY/open`; the answer shows whether the robot receives their texts. If it
//! does,
//! a frame to the robot may refer to a part of a text, and the robot's side inserts the bytes. The robot's side requests a missing text.
//! If the text still does not arrive, the connection ends.
//!
//! Frames are numbered. A frame that is lost, repeated, or received in the wrong order breaks the connection.

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
