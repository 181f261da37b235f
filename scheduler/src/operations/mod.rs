//! Monitoring for operators of a fleet: metrics for Prometheus and health checks over HTTP (feature `metrics`), and traces for
//! OpenTelemetry (feature `traces`). `docs/operations.md` describes them.
//!
//! A mission and a host only write numbers (`mission.rs`, and [`downbeat_robot::figures`]). The thread of the endpoint (`server.rs`)
//! reads the numbers. Clients that request too often or read too slowly therefore do not disturb the mission or the host.

#[cfg(feature = "metrics")]
mod exposition;
#[cfg(feature = "metrics")]
mod health;
#[cfg(feature = "metrics")]
mod host;
#[cfg(feature = "metrics")]
mod mission;
#[cfg(any(test, feature = "metrics"))]
mod names;
#[cfg(feature = "metrics")]
mod server;
#[cfg(feature = "traces")]
mod traces;

#[cfg(feature = "metrics")]
pub(crate) use self::host::HostMetrics;
#[cfg(feature = "metrics")]
pub(crate) use self::mission::MissionMetrics;
#[cfg(feature = "metrics")]
pub(crate) use self::server::{Board, serve};
#[cfg(feature = "traces")]
pub(crate) use self::traces::{About, Traces};
