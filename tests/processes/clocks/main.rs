//! Clocks, latencies and real-time scheduling as measured on real processes.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod calibrate;
mod latency;
mod measured;
mod ntp;
mod realtime;
