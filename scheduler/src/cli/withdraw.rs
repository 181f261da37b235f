//! Withdraws missions: cancels the commands that a mission has left on its robots, so that the robots come to rest. Uses only the
//! mission's journal, because other files may have changed since the mission began.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use downbeat_robot::HostOptions;
use downbeat_scripts::{Address, Fleet, FleetRobot, Handshake, counted};
use serde::Serialize;
use tokio::sync::mpsc;
use urrcp::{Device, RobotId, Server, Span, Timestamp};

use super::live::Live;
use super::run::{listen, stop_lane};
use super::{Format, console, identity, robot};
use crate::fleet::{self, Drivers};
use crate::journal::{Contents, FileDisk, Found, Journal, Opened, OpenedRobot, read};
use crate::link::Site;
use crate::mission::{Cause, Left, LeftOn, Mission, MissionOptions, Outcome, Record, Rest, Torn};
use crate::report::{Report, StopState, Withdrawal};
use crate::run::Keep;
use crate::server_clock::ServerClock;
use crate::signals::OnHangUp;
use crate::stop_lane::{Operator, StopLane};

/// Maximum time to wait until the disk has recorded that a mission was stopped.
const RECORD_MAX: Duration = Duration::from_secs(5);

/// The locked journal of a mission whose scheduler is gone.
pub(super) struct Taken {
    pub(super) contents: Contents,
    disk: FileDisk,
    folder: PathBuf,
}

/// The reason why a mission cannot be taken over.
#[derive(Debug, thiserror::Error)]
pub(super) enum NotTaken {
    /// Another process holds the journal's lock.
    #[error("another process has resumed it")]
    Held,
    /// The mission has ended meanwhile.
    #[error("another process has already ended it")]
    Ended,
    /// The journal cannot be opened or read.
    #[error("{0}")]
    Journal(String),
}

impl Taken {
    /// Locks the mission's journal, and then reads it.
    pub(super) fn of(found: &Found) -> Result<Self, NotTaken> {
        let path = found.folder.join("journal");
        let disk = FileDisk::take_up(&found.folder).map_err(|error| match error.kind() {
            std::io::ErrorKind::WouldBlock => NotTaken::Held,
            _ => NotTaken::Journal(format!("cannot open the journal {}: {error}", path.display())),
        })?;
        let contents = read(&path).map_err(|error| NotTaken::Journal(error.to_string()))?;
        if contents.kept.outcome.is_some() {
            return Err(NotTaken::Ended);
        }
        if let Some(torn) = contents.kept.torn {
            console::warn(&torn_text(torn));
        }
        Ok(Self { contents, disk, folder: found.folder.clone() })
    }

    /// Returns the contents of the journal, and the journal itself, opened for further records.
    pub(super) fn journal(self) -> Result<(Contents, Journal), String> {
        let journal = Journal::taken_up(self.disk, self.folder.join("journal"), self.contents.clone());
        Ok((self.contents, journal.map_err(|error| error.to_string())?))
    }
}

fn torn_text(torn: Torn) -> String {
    let Torn { line, bytes, whole_after } = torn;
    match whole_after {
        0 => format!(
            "the last record of the journal (line {line}) is incomplete: its {bytes} bytes are discarded, and its content is lost"
        ),
        after => format!(
            "the journal is damaged from line {line} on: its last {bytes} bytes are discarded, including {} after the damage",
            counted(after, "whole record")
        ),
    }
}

/// The state of the scheduler process that ran a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scheduler {
    /// The process is gone, and everything that ran in it as well.
    Gone,
    /// The process exists but does not answer.
    Silent,
}

/// A robot that cannot be reached, because it runs or ran in the scheduler's own process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Inside {
    pub(super) robot: RobotId,
    pub(super) what: InsideWhat,
}

/// The kind of a robot in the scheduler's process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub(super) enum InsideWhat {
    /// A simulated robot: it ended, or is suspended, with the process.
    Simulated,
    /// A driver of hardware to which the mission had sent commands.
    Driver,
    /// A driver program that ended with the process. Only the fleet file states how to start it again.
    Program,
    /// A driver of hardware to which the mission had not sent anything.
    Unmoved,
}

/// The result of withdrawing a mission, that is, of stopping its robots.
pub(super) struct Withdrawn {
    /// When this process began to stop the robots.
    pub(super) begun: Timestamp<Server>,
    pub(super) report: Report,
    pub(super) inside: Vec<Inside>,
    /// Robots that did not confirm their stop, although the mission is recorded as ended.
    pub(super) forgotten: Vec<RobotId>,
}

impl Withdrawn {
    /// Returns the robots that may still move, because they did not confirm their stop or could not be reached.
    fn unconfirmed(&self) -> Vec<RobotId> {
        let robots = self.report.robots.iter().filter(|robot| robot.stop.is_unconfirmed());
        let driven = |inside: &&Inside| matches!(inside.what, InsideWhat::Driver | InsideWhat::Program);
        let driven = self.inside.iter().filter(driven);
        robots.map(|robot| &robot.robot).chain(driven.map(|inside| &inside.robot)).cloned().collect()
    }

    /// Whether every robot is known to be at rest.
    pub(super) fn is_confirmed(&self) -> bool {
        self.report.not_at_rest.is_empty() && self.unconfirmed().is_empty()
    }
}

/// What to do with a mission if a robot does not confirm its stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unconfirmed {
    /// The mission stays open and can be stopped again.
    Kept,
    /// The mission is recorded as ended.
    Forgotten,
}

/// The options for withdrawing a mission.
#[derive(Clone, Copy)]
pub(super) struct How {
    pub(super) scheduler: Scheduler,
    /// What to do with the mission if a robot does not confirm its stop.
    pub(super) unconfirmed: Unconfirmed,
    /// How robots come to rest.
    pub(super) rest: Rest,
    pub(super) patience: Span,
    pub(super) drivers: Drivers,
    /// The format of progress reports. With JSON, no progress is reported.
    pub(super) told: Format,
}

/// The driver programs that this process may start again, as the address of each robot in the fleet file, by the robot's id. A journal
/// alone does not permit starting a program.
pub(super) type Programs = BTreeMap<RobotId, Address>;

/// Stops the robots of a mission, and then records the stop in the locked journal. The record is written last, because a stop must not
/// wait for the disk.
pub(super) async fn withdraw_and_record(
    taken: Taken,
    programs: &Programs,
    cause: Cause,
    how: How,
) -> Result<Withdrawn, String> {
    let (lane, operator) = stop_lane(OnHangUp::End)?;
    // If another terminal requests a stop meanwhile, it receives the result of this stop.
    let control = listen(&taken.folder, &lane, None);
    let mut withdrawn = withdraw_as(&taken.contents, programs, cause, how, lane, operator).await?;
    let (begun, records) = (withdrawn.begun, records_of(&withdrawn, how));
    let recorded = tokio::task::spawn_blocking(move || write_down(taken, begun, &records));
    match tokio::time::timeout(RECORD_MAX, recorded).await {
        Ok(Ok(Ok(()))) if how.unconfirmed == Unconfirmed::Forgotten => {
            withdrawn.forgotten = withdrawn.unconfirmed();
        }
        Ok(Ok(Ok(()))) => {}
        Ok(Ok(Err(reason))) => console::warn(&reason),
        Ok(Err(_)) | Err(_) => {
            console::warn("the disk is not responding, so the stop was not recorded in the journal")
        }
    }
    if let Some(control) = control {
        control.end(serde_json::to_string(&Withdrawal::from(&withdrawn.report)).ok()).await;
    }
    Ok(withdrawn)
}

/// Stops the robots of a mission without recording it. Starts no programs.
pub(super) async fn withdraw(contents: &Contents, how: How) -> Result<Withdrawn, String> {
    let (lane, operator) = stop_lane(OnHangUp::End)?;
    withdraw_as(contents, &Programs::new(), by_operator(), how, lane, operator).await
}

/// Returns the outcome of a mission that the operator stops, and the text of this outcome for people.
pub(super) fn by_operator() -> Cause {
    Cause { outcome: Outcome::Stopped, reason: Outcome::Stopped.to_string() }
}

async fn withdraw_as(
    contents: &Contents,
    programs: &Programs,
    cause: Cause,
    how: How,
    lane: StopLane,
    operator: mpsc::Receiver<Operator>,
) -> Result<Withdrawn, String> {
    let left = contents.left();
    let (robots, inside) = robots_of(&contents.opened, &left, programs, how);
    let robots: Vec<&FleetRobot> = robots.iter().collect();
    let clock = ServerClock::anchored(contents.opened.clock_offset);
    let options = MissionOptions {
        greeting: contents.opened.greeting,
        patience: how.patience,
        session: Some(contents.opened.drives_as()),
        check_invariants: false,
        ..MissionOptions::default()
    };
    let begun = clock.now();
    let scenario = scenario_of(&contents.opened);
    let participants = fleet::participants(&robots);
    let mission = Mission::withdraw(scenario, participants, options, &left, cause, how.rest, begun);
    let site = identity::site_to_stop(&contents.opened.keys)?;
    let report = carry_out(mission, &robots, &site, clock, how, lane, operator).await?;
    Ok(Withdrawn { begun, report, inside, forgotten: Vec::new() })
}

/// Stops every device of a fleet, whichever mission uses it. Robots decide by the operator's certificate whether this is permitted.
pub(super) async fn stop_fleet(of: &Fleet, how: How) -> Result<Withdrawn, String> {
    let is_reached = |robot: &&FleetRobot| robot.address.is_served();
    let (robots, inside): (Vec<&FleetRobot>, Vec<&FleetRobot>) = of.robots.iter().partition(is_reached);
    let inside = inside.into_iter().map(|robot| Inside {
        robot: robot.id.clone(),
        what: match robot.address {
            Address::Simulated => InsideWhat::Simulated,
            _ => InsideWhat::Driver,
        },
    });
    let inside = inside.collect();
    let clock = ServerClock::anchored(Span::ZERO);
    let options = MissionOptions { patience: how.patience, ..MissionOptions::default() };
    let left = Left {
        robots: robots.iter().map(|robot| (robot.id.clone(), anything_on(robot))).collect(),
        own_ids: robots
            .iter()
            .filter_map(|robot| Some((robot.id.clone(), robot.init.as_ref()?.id.clone())))
            .collect(),
        ..Left::default()
    };
    let begun = clock.now();
    let (name, participants) = ("the fleet".to_owned(), fleet::participants(&robots));
    let mission = Mission::withdraw(name, participants, options, &left, by_operator(), how.rest, begun);
    let site = identity::site_to_stop(&identity::keys(of))?;
    let (lane, operator) = stop_lane(OnHangUp::End)?;
    let report = carry_out(mission, &robots, &site, clock, how, lane, operator).await?;
    Ok(Withdrawn { begun, report, inside, forgotten: Vec::new() })
}

/// Returns what missions may have left on a robot: commands to all its devices, except for mere sensors.
fn anything_on(robot: &FleetRobot) -> LeftOn {
    let devices = robot.init.iter().flat_map(|init| init.devices.iter());
    let is_driven = |device: &&Device| {
        let types = &device.available_control_types;
        types.sensor().is_none() || types.iter().count() > 1
    };
    LeftOn {
        devices: devices.filter(is_driven).map(|device| device.id.clone()).collect(),
        ..LeftOn::default()
    }
}

async fn carry_out(
    mission: Mission,
    robots: &[&FleetRobot],
    site: &Site,
    clock: ServerClock,
    how: How,
    lane: StopLane,
    operator: mpsc::Receiver<Operator>,
) -> Result<Report, String> {
    let (host, endpoints) =
        fleet::endpoints_at_once(robots, Handshake::Full, site, HostOptions::default(), how.drivers)
            .map_err(|error| error.to_string())?;
    let live = Live::lines(how.told);
    let tell = |at, progress: &_| live.tell(at, progress);
    let mut keep = Keep { stop_lane: Some(lane), ..Keep::default() };
    let mut report = crate::run::run_and_keep(mission, endpoints, clock, operator, tell, &mut keep).await;
    robot::stop_for(&mut report, host);
    Ok(report)
}

/// Returns the scenario's name. If the journal does not contain it, returns the beginning of the session's name.
fn scenario_of(mission: &Opened) -> String {
    let session = mission.session.as_str();
    let kept = session.split_once('@').map_or(session, |(scenario, _)| scenario);
    mission.name.clone().unwrap_or_else(|| kept.to_owned())
}

/// Splits the robots of a journal into those that this process can reach, and the others.
fn robots_of(mission: &Opened, left: &Left, programs: &Programs, how: How) -> (Vec<FleetRobot>, Vec<Inside>) {
    let (mut reached, mut inside) = (Vec::new(), Vec::new());
    for opened in &mission.robots {
        let reachable = how.scheduler == Scheduler::Gone && opened.init.is_some();
        let what = match (opened.address.parse(), programs.get(&opened.robot)) {
            (Ok(address), _) if address.is_served() => {
                reached.push(fleet_robot(opened, address));
                continue;
            }
            (Ok(address), _) if address.is_driven() && reachable => {
                reached.push(fleet_robot(opened, address));
                continue;
            }
            (Ok(Address::Program { .. }), Some(program)) if reachable => {
                reached.push(fleet_robot(opened, started_in(mission.folder.as_deref(), program.clone())));
                continue;
            }
            (Ok(Address::Simulated), _) => InsideWhat::Simulated,
            _ if !left.robots.contains_key(&opened.robot) => InsideWhat::Unmoved,
            (Ok(Address::Program { .. }), None) if how.scheduler == Scheduler::Gone => InsideWhat::Program,
            _ => InsideWhat::Driver,
        };
        inside.push(Inside { robot: opened.robot.clone(), what });
    }
    (reached, inside)
}

/// Changes a program's address so that the program starts in the mission's working directory, because the command may name files there.
pub(super) fn started_in(folder: Option<&Path>, address: Address) -> Address {
    match (folder.and_then(Path::to_str), address) {
        (Some(folder), Address::Program { command }) => {
            let quoted = folder.replace('\'', r"'\''");
            Address::Program { command: format!("cd -- '{quoted}' || exit\n{command}") }
        }
        (_, address) => address,
    }
}

/// Creates a fleet robot from a journal, with only the data that a stop needs. Its encoding is JSON, which every robot understands.
fn fleet_robot(opened: &OpenedRobot, address: Address) -> FleetRobot {
    let robot = FleetRobot::new(opened.robot.clone(), address, opened.init.clone());
    FleetRobot { limits: opened.limits.clone(), ..robot }
}

/// Returns the journal records about a stop. If a robot may still move and the mission is not to be forgotten, the records do not contain
/// the mission's end, so that the mission can be stopped again.
fn records_of(withdrawn: &Withdrawn, How { unconfirmed, rest, .. }: How) -> Vec<Record> {
    let report = &withdrawn.report;
    let confirmed =
        |robot: &&crate::report::RobotReport| matches!(robot.stop, StopState::Confirmed | StopState::Home);
    let mut records = vec![Record::Stopping { outcome: report.outcome.clone(), rest, by: None }];
    let robots = report.robots.iter().filter(confirmed);
    records.extend(robots.map(|robot| Record::StopConfirmed { robot: robot.robot.clone() }));
    if withdrawn.is_confirmed() || unconfirmed == Unconfirmed::Forgotten {
        records.push(Record::Ended { outcome: report.outcome.clone() });
    }
    records
}

fn write_down(taken: Taken, begun: Timestamp<Server>, records: &[Record]) -> Result<(), String> {
    let clock = ServerClock::anchored(taken.contents.opened.clock_offset);
    let (_, mut journal) = taken.journal()?;
    let at = |record: &Record| match record {
        // The time of this record is the start of the stop, because leases are no longer renewed from then.
        Record::Stopping { .. } => begun,
        _ => clock.now(),
    };
    let written = records.iter().try_for_each(|record| journal.append(at(record), record));
    written.and_then(|()| journal.sync()).map(drop).map_err(|broken| broken.to_string())
}
