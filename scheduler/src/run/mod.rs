//! A mission in real time: robots behind sockets or in this process, a journal and a recording on the disk, an operator.

pub mod control;
mod world;

use tokio::sync::mpsc;
use urrcp::{Server, Timestamp};

use self::world::RealWorld;
use crate::drive::drive;
use crate::journal::Journal;
use crate::link::Endpoint;
use crate::mission::{Mission, Progress};
use crate::recording::Recorder;
use crate::report::Report;
use crate::server_clock::{NtpWatch, ServerClock};

/// What the operator asks for while a mission runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operator {
    /// Let the act begin that waits for it.
    Go,
    /// Stop all robots and wait for their confirmation.
    Stop,
    /// Leave at once.
    Leave,
}

/// What is kept of a mission on disk.
#[derive(Debug, Default)]
pub struct Keep {
    /// What was promised to whom.
    pub journal: Option<Journal>,
    /// Everything that was said.
    pub recording: Option<Recorder>,
    /// Follows NTP while the mission goes on.
    pub ntp: Option<NtpWatch>,
}

/// Runs a mission to its end. `endpoints` stand in the order of the mission's robots.
pub async fn run(
    mission: Mission,
    endpoints: Vec<Endpoint>,
    clock: ServerClock,
    operator: mpsc::Receiver<Operator>,
    tell: impl FnMut(Timestamp<Server>, &Progress),
) -> Report {
    let mut keep = Keep::default();
    run_and_keep(mission, endpoints, clock, operator, tell, &mut keep).await
}

/// As [`run`], with a journal or a recording.
pub async fn run_and_keep(
    mut mission: Mission,
    endpoints: Vec<Endpoint>,
    clock: ServerClock,
    operator: mpsc::Receiver<Operator>,
    tell: impl FnMut(Timestamp<Server>, &Progress),
    keep: &mut Keep,
) -> Report {
    let ids = (0..endpoints.len()).map(|robot| mission.robot_id(robot).clone()).collect();
    let mut world = RealWorld::new(endpoints, ids, clock, operator, tell, std::mem::take(keep));
    let report = drive(&mut mission, &mut world).await;
    *keep = world.finish().await;
    // A real process that is killed does not come here.
    report.unwrap_or_else(|| Report::as_left(&mut mission, clock.now()))
}
