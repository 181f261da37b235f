//! `downbeat resume`: continues a mission whose scheduler was killed.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use downbeat_robot::{Host, HostOptions};
use downbeat_scripts::{Address, Choreography, Fleet, FleetRobot};
use urrcp::SessionId;

use super::console::OutputArgs;
use super::drivers::DriverArgs;
use super::live::{Live, Speaker};
use super::metrics::{Metrics, MetricsArgs};
use super::missions::{failed, one};
use super::realtime::{self, RealtimeArgs};
use super::run::{HowArgs, exit_of, finish, listen, server_clock, stop_lane};
use super::traces::{Traces, TracesArgs};
use super::withdraw::{
    How, Programs, Scheduler, Taken, Unconfirmed, Withdrawn, started_in, withdraw_and_record,
};
use super::{Exit, Format, ProjectArgs, ScenarioArgs, choice, console, identity, load, robot, stop};
use crate::certificate;
use crate::fleet::{self, Drivers, EndpointError, StartPrograms};
use crate::journal::{Contents, Found, Journal, MissionState, Opened, OpenedRobot};
use crate::link::Endpoint;
use crate::mission::{Changed, Fate, Mission, MissionOptions, ended_acts};
use crate::report::Report;
use crate::run::Keep;
use crate::server_clock::ServerClock;
use crate::show::ending_text;
use crate::show::local::ZONE;
use crate::signals::OnHangUp;

/// Continue a mission whose scheduler was killed.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The command reads the journal, connects to the robots again, asks what they did in the meantime, and plays \
the mission to its end. If the start of an act was not decided yet, the command withdraws the act instead. It refuses \
to resume if the fleet file has a different address for a robot than when its scripts were sent, or if the plan has changed \
since the mission began.

It restarts the programs that drive robots (`address: program:COMMAND`). It takes them from the fleet file, never from a journal: \
from the file that you name with --fleet, or from the file of the mission if you own it and it names the same programs as before.

Examples:
  downbeat resume
  downbeat resume --fleet stage.yaml
  downbeat resume swap@stage-4711-20261121T193000000"
)]
pub(super) struct ResumeArgs {
    /// The mission. Needed only if several were cut off.
    mission: Option<String>,
    /// The fleet file. By default, the one with which the mission began.
    #[arg(long, value_name = "FILE")]
    fleet: Option<PathBuf>,
    #[command(flatten)]
    how: HowArgs,
    #[command(flatten)]
    realtime: RealtimeArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    traces: TracesArgs,
    #[command(flatten)]
    drivers: DriverArgs,
    #[command(flatten)]
    output: OutputArgs,
}

pub(super) fn resume(args: &ResumeArgs, format: Format) -> Exit {
    args.output.apply();
    console::never_wait();
    let found = match one(args.mission.as_deref(), MissionState::CutOff, format) {
        Ok(found) => found,
        Err(exit) => return exit,
    };
    let taken = match Taken::of(&found) {
        Ok(taken) => taken,
        Err(reason) => return failed(&format!("{}: {reason}", found.opened.session)),
    };
    if let Fate::Withdraw(why) = taken.contents.kept.fate() {
        console::note(&format!("{why}: withdrawing the mission"));
        let rest = taken.contents.kept.stopping.as_ref().map(|stopping| stopping.rest).unwrap_or_default();
        let cause = taken.contents.kept.ending(why);
        let programs = programs_to_reach(&taken.contents.opened, args, format);
        return super::with_runtime(async {
            let how = How {
                scheduler: Scheduler::Gone,
                unconfirmed: Unconfirmed::Kept,
                rest,
                patience: args.how.patience,
                drivers: args.drivers.of(StartPrograms::Yes),
                told: format,
            };
            let withdrawn = withdraw_and_record(taken, &programs, cause, how).await;
            conclude(found.opened.session.clone(), withdrawn, format)
        });
    }
    match Resumption::of(found, taken, args, format) {
        Ok(resumption) => super::with_runtime(resumption.play()),
        Err(exit) => {
            console::note("nothing was resumed; `downbeat stop` stops the robots and needs only the journal");
            exit
        }
    }
}

/// Prints the result of withdrawing (stopping) a mission instead of resuming it. If all stops are confirmed, returns the exit code for
/// the mission's outcome.
fn conclude(mission: SessionId, withdrawn: Result<Withdrawn, String>, format: Format) -> Exit {
    if let (Ok(withdrawn), Format::Text) = (&withdrawn, format) {
        console::print(&ending_text(&withdrawn.report, console::columns()));
    }
    let ended = withdrawn.as_ref().map(|withdrawn| exit_of(&withdrawn.report));
    let ended = ended.unwrap_or(Exit::Unconfirmed);
    match stop::conclude(mission, withdrawn, format) {
        Exit::Done => ended,
        unconfirmed => unconfirmed,
    }
}

/// A mission to be resumed.
struct Resumption<'a> {
    found: Found,
    contents: Contents,
    journal: Journal,
    choreography: Choreography,
    fleet: Fleet,
    how: &'a HowArgs,
    realtime: RealtimeArgs,
    drivers: Drivers,
    metrics: Metrics,
    traces: Traces,
    format: Format,
}

impl<'a> Resumption<'a> {
    fn of(found: Found, taken: Taken, args: &'a ResumeArgs, format: Format) -> Result<Self, Exit> {
        let scenario = ScenarioArgs {
            scenario: found.opened.scenario.clone(),
            fleet: Some(fleet_file(&found.opened, args).to_path_buf()),
            project: ProjectArgs::remembered(found.opened.project.as_deref()),
        };
        let (choreography, fleet, _) = load::load_choreography(&scenario, format)?;
        let (choreography, _) = choice::choose(choreography, &fleet, &found.opened.asked)?;
        let moved = moved(&found.opened.robots, &fleet);
        if !moved.is_empty() {
            return Err(failed(&moved.join("; ")));
        }
        if found.opened.plan_hash != Some(certificate::plan_hash(&choreography, &found.opened.asked)) {
            let what = "the plan differs from the one with which the mission began".to_owned();
            return Err(failed(&Changed { what }.to_string()));
        }
        may_start(&found.opened, &fleet::robots_in(&fleet, &choreography), args)
            .map_err(|why| failed(&why))?;
        let metrics = args.metrics.serve(format).map_err(|why| failed(&why))?;
        let traces = args.traces.open().map_err(|why| failed(&why))?;
        let (contents, journal) = taken.journal().map_err(|reason| failed(&reason))?;
        Ok(Self {
            found,
            contents,
            journal,
            choreography,
            fleet,
            how: &args.how,
            realtime: args.realtime,
            drivers: args.drivers.of(StartPrograms::Yes),
            metrics,
            traces,
            format,
        })
    }

    async fn play(mut self) -> Exit {
        let clock = match server_clock(&self.fleet, self.format).await {
            Ok((clock, _)) => clock,
            Err(error) => return failed(&error),
        };
        let folder = self.found.opened.folder.as_deref();
        let started_in_it = |robot: &FleetRobot| FleetRobot {
            address: started_in(folder, robot.address.clone()),
            ..robot.clone()
        };
        let robots: Vec<FleetRobot> =
            fleet::robots_in(&self.fleet, &self.choreography).into_iter().map(started_in_it).collect();
        let robots: Vec<&FleetRobot> = robots.iter().collect();
        let options = MissionOptions {
            greeting: fleet::greeting(&self.fleet),
            patience: self.how.patience,
            session: Some(self.found.opened.drives_as()),
            fixed: self.found.opened.fixed,
            zone: ZONE,
            transfer: Some(fleet::transfer(&self.fleet)),
            check_invariants: false,
            ..MissionOptions::default()
        };
        let participants = fleet::participants(&robots);
        let bytes = match self.journal.bytes() {
            Ok(bytes) => bytes,
            Err(error) => return failed(&error.to_string()),
        };
        let (choreography, ended) = (self.choreography.clone(), ended_acts(&bytes));
        let resumed =
            Mission::resume(choreography, participants, options, &self.contents.kept, ended, clock.now());
        drop(bytes);
        let mission = match resumed {
            Ok(mission) => mission,
            Err(changed) => return failed(&changed.to_string()),
        };
        let format = self.format;
        let (host, endpoints) = match self.endpoints(&robots) {
            Ok(reached) => reached,
            Err(error) => {
                let exit = realtime::exit_of(&error);
                console::error(&error.to_string());
                return exit;
            }
        };
        let keep = Keep { journal: Some(self.journal), ..Keep::default() };
        let (found, metrics, traces) = (self.found, self.metrics, self.traces);
        let rest = RestOfMission { found, mission, host, endpoints, keep, metrics, traces };
        match rest.play(clock, format).await {
            Ok(report) => finish(&report, format),
            Err(exit) => exit,
        }
    }

    fn endpoints(&self, robots: &[&FleetRobot]) -> Result<(Option<Host>, Vec<Endpoint>), EndpointError> {
        let options = HostOptions::default().with_realtime(self.realtime.realtime());
        let site = identity::site(&self.fleet).map_err(EndpointError::Identity)?;
        let (host, endpoints) = fleet::endpoints(robots, self.fleet.handshake, &site, options, self.drivers)?;
        if let Some(host) = &host {
            self.realtime.tell(host, self.format);
        }
        Ok((host, endpoints))
    }
}

/// Returns the path of the fleet file that the operator names, or else of the file with which the mission began.
fn fleet_file<'a>(opened: &'a Opened, args: &'a ResumeArgs) -> &'a Path {
    args.fleet.as_deref().unwrap_or(&opened.fleet)
}

/// Checks whether the programs that drive these robots may be started. They may if the operator names a fleet file. Otherwise, the
/// mission's own fleet file must be writable only by the operator, and must name the same programs as before.
fn may_start(opened: &Opened, robots: &[&FleetRobot], args: &ResumeArgs) -> Result<(), String> {
    let mut programs = robots.iter().filter(|robot| matches!(robot.address, Address::Program { .. }));
    let Some(first) = programs.next() else { return Ok(()) };
    if args.fleet.is_some() {
        return Ok(());
    }
    let path = opened.fleet.display();
    let look = format!("check it, then name it with `--fleet {path}`");
    let found = rustix::fs::stat(&opened.fleet).map_err(|error| format!("cannot check {path}: {error}"))?;
    if found.st_uid != rustix::process::geteuid().as_raw() || found.st_mode & 0o002 != 0 {
        return Err(format!(
            "the fleet file {path} names programs to start, but is owned or writable by other users: {look}"
        ));
    }
    let is_as_before = |robot: &FleetRobot| {
        let address = robot.address.to_string();
        opened.robots.iter().any(|before| before.robot == robot.id && before.address == address)
    };
    match [first].into_iter().chain(programs).find(|robot| !is_as_before(robot)) {
        Some(other) => Err(format!(
            "the fleet file {path} names a different program for robot `{}` than it did when the mission began: {look}",
            other.id
        )),
        None => Ok(()),
    }
}

/// Returns those driver programs of a withdrawn mission that may be started. Prints why the others may not.
fn programs_to_reach(opened: &Opened, args: &ResumeArgs, format: Format) -> Programs {
    let is_program = |robot: &&OpenedRobot| matches!(robot.address.parse(), Ok(Address::Program { .. }));
    let driven: Vec<_> = opened.robots.iter().filter(is_program).map(|robot| &robot.robot).collect();
    if driven.is_empty() {
        return Programs::new();
    }
    let project = ProjectArgs::remembered(opened.project.as_deref());
    let Ok(fleet) = load::load_fleet(fleet_file(opened, args), &project, format) else {
        console::warn("no program is started, because the fleet file cannot be loaded");
        return Programs::new();
    };
    let robots: Vec<_> = fleet.robots.iter().filter(|robot| driven.contains(&&robot.id)).collect();
    if let Err(why) = may_start(opened, &robots, args) {
        console::warn(&format!("no program is started: {why}"));
        return Programs::new();
    }
    robots.into_iter().map(|robot| (robot.id.clone(), robot.address.clone())).collect()
}

/// Returns a text for each robot whose address has changed since its scripts were sent, with the old and the new address.
fn moved(opened: &[OpenedRobot], fleet: &Fleet) -> Vec<String> {
    let is_now = |id| fleet.robots.iter().find(|robot: &&FleetRobot| robot.id == id);
    let moved = |opened: &OpenedRobot| {
        let (robot, was) = (&opened.robot, &opened.address);
        match is_now(robot.clone()).map(|robot| robot.address.to_string()) {
            Some(now) if now == *was => None,
            Some(now) => Some(format!(
                "the scripts of robot `{robot}` were sent to {was}, but its address in the fleet file is now {now}"
            )),
            None => Some(format!(
                "the scripts of robot `{robot}` were sent to {was}, but the robot is no longer in the fleet file"
            )),
        }
    };
    opened.iter().filter_map(moved).collect()
}

/// The rest of a mission, and what playing it needs.
struct RestOfMission {
    found: Found,
    mission: Mission,
    /// Runs the robots that are in this process. `None` if there are none.
    host: Option<Host>,
    endpoints: Vec<Endpoint>,
    keep: Keep,
    metrics: Metrics,
    traces: Traces,
}

impl RestOfMission {
    /// Plays the rest of the mission and returns its report.
    async fn play(self, clock: ServerClock, format: Format) -> Result<Report, Exit> {
        let Self { found, mission, host, endpoints, mut keep, metrics, traces } = self;
        let (lane, operator) = stop_lane(OnHangUp::End).map_err(|error| failed(&error))?;
        let control = listen(&found.folder, &lane, identity::desk(&found.opened.keys));
        let choreography = Arc::new(mission.choreography().clone());
        let ids: Vec<_> = mission.robot_ids().cloned().collect();
        metrics.add_mission(clock, ids.clone(), &endpoints, host.as_ref(), &mut keep.watches);
        traces.add_mission(clock, &mission, &mut keep.watches);
        let live = Live::start(format, clock, choreography, ids, Speaker::of(&lane));
        keep.stop_lane = Some(lane);
        let tell = |at, progress: &_| live.tell(at, progress);
        let mut report = crate::run::run_and_keep(mission, endpoints, clock, operator, tell, &mut keep).await;
        drop(live);
        robot::stop_for(&mut report, host);
        if let Some(control) = control {
            control.end(serde_json::to_string(&report).ok()).await;
        }
        traces.end();
        Ok(report)
    }
}
