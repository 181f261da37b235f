//! Robots that are addressed by keys of a Zenoh network. Schedulers reach them directly or through routers.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test in a binary of its own")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod direct;
mod guarded;
mod network;
mod routed;
mod shared;
