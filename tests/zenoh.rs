//! Robots at keys of a Zenoh network: with schedulers and robots that speak to each other directly, and behind routers.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test in a binary of its own")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

#[path = "zenoh/direct.rs"]
mod direct;
#[path = "zenoh/guarded.rs"]
mod guarded;
#[path = "zenoh/network.rs"]
mod network;
mod robots;
#[path = "zenoh/routed.rs"]
mod routed;
#[path = "zenoh/shared.rs"]
mod shared;
