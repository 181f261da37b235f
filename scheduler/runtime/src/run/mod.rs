//! A mission in real time: robots behind sockets or in this process, a journal and a recording on the disk, an operator.

pub mod control;
pub mod desk;
pub mod watch;
mod world;

use tokio::sync::mpsc;
use urrcp::{Server, Timestamp};

use self::watch::Watches;
use self::world::RealWorld;
use crate::journal::Journal;
use crate::link::{Endpoint, SharedScripts};
use crate::recording::Recorder;
use crate::server_clock::{NtpWatch, ServerClock};
use crate::stop_lane::{Before, Operator, StopLane};
use downbeat_mission::drive::drive;
use downbeat_mission::report::Report;
use downbeat_mission::{Mission, Progress};

/// The additional resources of a mission, which it returns at its end.
#[derive(Debug, Default)]
pub struct Keep {
    /// The promises to robots.
    pub journal: Option<Journal>,
    /// All messages and decisions.
    pub recording: Option<Recorder>,
    /// Follows NTP while the mission continues.
    pub ntp: Option<NtpWatch>,
    /// Stops the robots even if everything else is blocked.
    pub stop_lane: Option<StopLane>,
    /// The watchers, for example for metrics and traces.
    pub watches: Watches,
}

/// Runs a mission to its end. `endpoints` are in the order of the mission's robots.
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

/// Same as [`run`], with the resources in `keep`, such as a journal or a recording.
pub async fn run_and_keep(
    mut mission: Mission,
    endpoints: Vec<Endpoint>,
    clock: ServerClock,
    operator: mpsc::Receiver<Operator>,
    tell: impl FnMut(Timestamp<Server>, &Progress),
    keep: &mut Keep,
) -> Report {
    let ids = (0..endpoints.len()).map(|robot| mission.robot_id(robot).clone()).collect();
    let before = Before {
        session: mission.options().session_on_the_wire(),
        devices: mission.moved_by_another().collect(),
    };
    let shared = SharedScripts::of(&mission, &endpoints);
    let mut world =
        RealWorld::new((endpoints, shared, before), ids, clock, operator, tell, std::mem::take(keep));
    let report = drive(&mut mission, &mut world).await;
    *keep = world.finish().await;
    keep.watches.each(|watch| watch.ended(clock.now(), &mission));
    // A real process that is killed does not get here.
    report.unwrap_or_else(|| Report::as_left(&mut mission, clock.now()))
}
