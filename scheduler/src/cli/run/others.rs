//! Finds other missions of this machine that contain robots of the mission about to begin.

use downbeat_scripts::{Address, FleetRobot, Protection};
use urrcp::RobotId;

use crate::cli::console;
use crate::journal::{Found, MissionState, Missions};

/// Returns an error if a robot is already in a mission of this machine. Robots themselves also refuse a second scheduler, including those
/// on other machines. If `seize` is true, robots with a `tls://` or `hmac://` address are not checked here, because they decide
/// themselves. Prints warnings about missions that were cut off.
///
/// # Errors
/// Returns, as a sentence, which robots are taken, and by which missions.
pub(super) fn look_at(missions: &Missions, robots: &[&FleetRobot], seize: bool) -> Result<(), String> {
    for refused in &missions.refused {
        console::warn(&format!("{refused}; if a mission is running there, its robots are unknown"));
    }
    warn_of_unfinished(&missions.found, robots);
    let proves = |robot: &&FleetRobot| matches!(&robot.address, Address::Tcp { protection, .. } if *protection != Protection::Open);
    let decides = |robot: &&FleetRobot| seize && proves(robot);
    let others: Vec<&FleetRobot> = robots.iter().copied().filter(|robot| !decides(robot)).collect();
    taken_here(&missions.found, &others)
}

fn taken_here(missions: &[Found], robots: &[&FleetRobot]) -> Result<(), String> {
    let (mut taken, mut stops) = (Vec::new(), Vec::new());
    for mission in missions.iter().filter(|mission| mission.life == MissionState::Running) {
        let (session, pid) = (&mission.opened.session, mission.opened.pid);
        let robots = driven_by(mission, robots);
        if !robots.is_empty() {
            stops.push(format!("`downbeat stop {session}`"));
        }
        taken.extend(robots.into_iter().map(|robot| {
            format!("robot `{robot}` already takes part in the running mission `{session}` (process {pid})")
        }));
    }
    let hint = match stops.as_slice() {
        [] => return Ok(()),
        [stop] => format!("wait until it ends, or stop it with {stop}"),
        stops => format!("wait until these missions end, or stop them with {}", stops.join(" and ")),
    };
    Err(format!("{}; {hint}", taken.join("; ")))
}

/// Prints warnings about robots in missions that were cut off and never stopped: such robots may still hold commands of these missions.
fn warn_of_unfinished(missions: &[Found], robots: &[&FleetRobot]) {
    for mission in missions.iter().filter(|mission| mission.life == MissionState::CutOff) {
        let drove: Vec<_> = driven_by(mission, robots).iter().map(|robot| format!("`{robot}`")).collect();
        let session = &mission.opened.session;
        if !drove.is_empty() {
            console::warn(&format!(
                "mission `{session}` was cut off and has not ended; it drove {}: `downbeat resume {session}` continues it, `downbeat stop {session}` ends it",
                drove.join(", ")
            ));
        }
    }
}

/// Returns the ids of those robots whose addresses the mission contains.
fn driven_by<'a>(mission: &Found, robots: &[&'a FleetRobot]) -> Vec<&'a RobotId> {
    let named = |robot: &&&FleetRobot| {
        let address = robot.address.to_string();
        robot.address != Address::Simulated
            && mission.opened.robots.iter().any(|opened| opened.address == address)
    };
    robots.iter().filter(named).map(|robot| &robot.id).collect()
}
