//! Runs a mission in real time: with robots behind sockets or in this process, a journal and a recording on the disk, and an operator.

pub mod control;
pub mod desk;
pub mod watch;
mod world;

use tokio::sync::mpsc;
use urrcp::{Server, Timestamp};

use self::watch::Watches;
use self::world::{Reached, RealWorld};
use crate::journal::Journal;
use crate::link::{Endpoint, SharedScripts};
use crate::recording::Recorder;
use crate::server_clock::{NtpWatch, ServerClock};
use crate::stop_lane::{Before, Operator, StopLane};
use downbeat_mission::drive::drive;
use downbeat_mission::report::Report;
use downbeat_mission::{Mission, Progress, RobotIndex};

/// Optional resources of a mission, such as its journal. The mission returns them when it ends.
#[derive(Debug, Default)]
pub struct Keep {
    /// The journal, which records the requests that the mission is about to send, and the course of the mission.
    pub journal: Option<Journal>,
    /// The recording of all messages and decisions.
    pub recording: Option<Recorder>,
    /// The task that compares the server's clock with NTP during the mission.
    pub ntp: Option<NtpWatch>,
    /// The stop lane, a thread that stops the robots even if everything else is blocked.
    pub stop_lane: Option<StopLane>,
    /// The watchers, for example for metrics and traces.
    pub watches: Watches,
}

/// Runs a mission to its end and returns its report. `endpoints` are in the order of the mission's robots.
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

/// Like [`run`], but also uses the resources in `keep`, such as a journal or a recording.
pub async fn run_and_keep(
    mut mission: Mission,
    endpoints: Vec<Endpoint>,
    clock: ServerClock,
    operator: mpsc::Receiver<Operator>,
    tell: impl FnMut(Timestamp<Server>, &Progress),
    keep: &mut Keep,
) -> Report {
    let ids = (0..endpoints.len()).map(|robot| mission.robot_id(RobotIndex::new(robot)).clone()).collect();
    let before = Before {
        session: mission.options().session_on_the_wire(),
        devices: mission.moved_by_another().collect(),
    };
    let shared = SharedScripts::of(&mission, &endpoints);
    let robots = Reached { ids, endpoints, shared, before };
    let mut world = RealWorld::new(robots, clock, operator, tell, std::mem::take(keep));
    let report = drive(&mut mission, &mut world).await;
    *keep = world.finish().await;
    keep.watches.each(|watch| watch.ended(clock.now(), &mission));
    // Code after this point does not run if the real process is killed.
    report.unwrap_or_else(|| Report::as_left(&mut mission, clock.now()))
}
