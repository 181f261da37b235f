//! `downbeat stop`: stops missions from any terminal. If a mission's scheduler is gone or does not answer, the command stops the robots
//! by itself, with data from the journal.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use downbeat_scripts::shown;
use rustix::process::Pid;
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::{Value, json};
use tokio::task::{JoinSet, LocalSet};
use urrcp::{RobotId, Server, SessionId, Timestamp};

use super::missions::{is_called, listed, none};
use super::run::HowArgs;
use super::withdraw::{
    How, Inside, InsideWhat, NotTaken, Programs, Scheduler, Taken, Unconfirmed, Withdrawn, by_operator,
    stop_fleet, withdraw, withdraw_and_record,
};
use super::{Exit, Format, ProjectArgs, console, identity, load};
use crate::fleet::StartPrograms;
use crate::journal::{Contents, Found, MissionState};
use crate::mission::Rest;
use crate::mission::{Failure, Standing};
use crate::report::{StopState, Withdrawal, WithdrawnRobot};
use crate::run::control::{self, Ending, Undelivered};
use crate::run::desk::Presented;
use crate::show::TAKEN_OVER;
use crate::show::local::time_of_day;
use crate::signals;

/// Stop missions and bring their robots to rest.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Without a name, the command stops all missions that run or were cut off. It stops a running mission \
through its scheduler and waits for the report. If the scheduler was killed, or does not answer within one second, the \
command stops the robots directly: the journal names them, and no other file is read. A stop starts no program: if a program \
drove a robot, `downbeat resume` starts it again and brings the robot to rest. The command lists which robots \
confirmed the stop, which did not, and when their leases end. A mission can be stopped again, even after it has ended.

With --fleet no journal is needed: all robots with a `tcp://`, `tls://` or `hmac://` address are stopped, in missions of all \
operators, from any machine. Robots at tls:// and hmac:// accept the stop if you have the role `stop`; other robots accept it while they are free.

Examples:
  downbeat stop
  downbeat stop --fleet fleet.yaml
  downbeat stop --home
  downbeat stop swap@stage-4711-20261121T193000000 --patience 2s
  DOWNBEAT_IDENTITY=dora.pem downbeat stop"
)]
pub(super) struct StopArgs {
    /// The mission. By default all missions.
    mission: Option<String>,
    /// Stop all missions that run or were cut off. JSON output is then always an array.
    #[arg(long, conflicts_with = "mission")]
    all: bool,
    /// Stop all robots of this fleet file, whichever mission they play.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["mission", "all", "forget"])]
    fleet: Option<PathBuf>,
    #[command(flatten)]
    project: ProjectArgs,
    /// Treat a mission that was cut off as ended even if a robot does not confirm, for example because it is gone for good.
    #[arg(long, requires = "mission")]
    forget: bool,
    /// Then move all robots to their default positions, in an act that is planned from the positions at which they rest. If the scheduler
    /// of the mission has ended, each robot moves there on its own.
    #[arg(long)]
    home: bool,
    #[command(flatten)]
    how: HowArgs,
}

/// The result of stopping one mission.
struct Stopped {
    mission: SessionId,
    /// When this command began to stop the robots directly. `None` if the mission's scheduler stopped them.
    begun: Option<Timestamp<Server>>,
    /// The report, or the reason why the mission was not stopped.
    report: Result<Ended, String>,
    inside: Vec<Inside>,
    /// Robots that did not confirm their stop, although the mission is recorded as ended (`--forget`).
    forgotten: Vec<RobotId>,
    exit: Exit,
}

/// The report of a mission that was stopped.
struct Ended {
    report: Withdrawal,
    /// The whole report as JSON.
    document: Value,
}

impl Ended {
    fn of(report: &str) -> Result<Self, serde_json::Error> {
        Ok(Self { report: serde_json::from_str(report)?, document: serde_json::from_str(report)? })
    }
}

pub(super) fn stop(args: &StopArgs, format: Format) -> Exit {
    console::never_wait();
    if let Some(fleet) = &args.fleet {
        return stop_all_of(fleet, args, format);
    }
    let missions = match listed() {
        Ok(missions) => missions,
        Err(exit) => return exit,
    };
    let unreadable = if missions.unread() == 0 { Exit::Done } else { Exit::Failed };
    let named = args.mission.as_deref();
    let meant =
        |found: &Found| is_called(found, named) && (named.is_some() || found.life != MissionState::Ended);
    let found: Vec<Found> = missions.found.into_iter().filter(meant).collect();
    let unread: Vec<Unread> =
        missions.damaged.iter().filter_map(|journal| Unread::of(journal, named)).collect();
    if found.is_empty() && unread.is_empty() {
        if args.all && format == Format::Json {
            console::print_json(&json!([]));
            return Exit::Usage;
        }
        let none = none(named, "is running or was cut off", format);
        return if unreadable == Exit::Done { none } else { unreadable };
    }
    let shown = if args.all || found.len() + unread.len() > 1 { Shown::Several } else { Shown::One };
    let told = if shown == Shown::One { format } else { Format::Json };
    let forgotten = if args.forget { Unconfirmed::Forgotten } else { Unconfirmed::Kept };
    let rest = if args.home { Rest::Home } else { Rest::InPlace };
    let patience = args.how.patience;
    let drivers = StartPrograms::No.into();
    let how = How { scheduler: Scheduler::Gone, unconfirmed: forgotten, rest, patience, drivers, told };
    // A stop is sent even without a usable key.
    let presented = identity::presented().unwrap_or_else(|error| {
        console::warn(&format!("sending the stop without an identity: {error}"));
        None
    });
    let stops = stop_all(found, unread, how, presented.map(Arc::new), shown, format);
    worst(unreadable, super::with_runtime(LocalSet::new().run_until(stops)))
}

/// Stops all robots of a fleet file, without a journal. Robots decide by the operator's certificate whether to obey.
fn stop_all_of(path: &Path, args: &StopArgs, format: Format) -> Exit {
    let fleet = match load::load_fleet(path, &args.project, format) {
        Ok(fleet) => fleet,
        Err(exit) => return exit,
    };
    let rest = if args.home { Rest::Home } else { Rest::InPlace };
    let (scheduler, unconfirmed) = (Scheduler::Gone, Unconfirmed::Kept);
    let (patience, drivers) = (args.how.patience, StartPrograms::No.into());
    let how = How { scheduler, unconfirmed, rest, patience, drivers, told: format };
    let stopping = async { conclude(fleet_as_mission(), stop_fleet(&fleet, how).await, format) };
    super::with_runtime(stopping)
}

#[expect(clippy::expect_used, reason = "a constant, read by every test of this command")]
fn fleet_as_mission() -> SessionId {
    SessionId::new("the fleet").expect("a constant below every limit")
}

/// A mission whose journal cannot be read, but whose scheduler may still listen.
struct Unread {
    mission: SessionId,
    folder: PathBuf,
}

impl Unread {
    /// Returns the mission of a damaged journal. Returns `None` if the operator named another mission, or if the mission has no socket.
    fn of(journal: &Path, named: Option<&str>) -> Option<Self> {
        let folder = journal.parent()?.to_path_buf();
        let name = folder.file_name()?.to_str()?;
        let meant = named.is_none_or(|named| named == name) && control::socket(&folder).exists();
        Some(Self { mission: SessionId::new(name).ok().filter(|_| meant)?, folder })
    }

    async fn stop(self, rest: Rest, presented: Option<Arc<Presented>>) -> Stopped {
        match control::stop(&self.folder, rest, presented.as_deref()).await {
            Ok(ending) if leaves_undone(&ending, rest) => {
                Stopped::of(self.mission, Err(ENDED_AHEAD.to_owned()))
            }
            Ok(ending) => Stopped::by_itself(self.mission, &ending.report),
            Err(refused @ Undelivered::Refused(_)) => Stopped::of(self.mission, Err(refused.to_string())),
            Err(unheard) => {
                let reason =
                    format!("its journal cannot be read, and its process does not answer: {unheard}");
                Stopped::of(self.mission, Err(reason))
            }
        }
    }
}

/// The form of the output: for one mission or for several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    One,
    Several,
}

async fn stop_all(
    found: Vec<Found>,
    unread: Vec<Unread>,
    how: How,
    presented: Option<Arc<Presented>>,
    shown: Shown,
    format: Format,
) -> Exit {
    let mut stops = JoinSet::new();
    for unread in unread {
        stops.spawn_local(unread.stop(how.rest, presented.clone()));
    }
    for found in found {
        stops.spawn_local(stop_one(found, how, presented.clone()));
    }
    let mut exit = Exit::Done;
    let mut documents = Vec::new();
    while let Some(joined) = stops.join_next().await {
        match joined {
            Ok(stopped) => {
                exit = worst(exit, stopped.exit);
                stopped.tell(shown, format);
                documents.push(stopped.document(shown));
            }
            Err(error) => {
                console::error(&error.to_string());
                exit = Exit::Unconfirmed;
            }
        }
    }
    match (format, shown) {
        (Format::Text, _) => {}
        (Format::Json, Shown::Several) => console::print_json(&documents),
        (Format::Json, Shown::One) => documents.iter().for_each(console::print_json),
    }
    exit
}

/// Returns the more severe of two exit codes. The most severe one is that for robots whose stop is not confirmed.
fn worst(one: Exit, other: Exit) -> Exit {
    let rank = |exit: Exit| match exit {
        Exit::Done => 0,
        Exit::Unconfirmed => 2,
        _ => 1,
    };
    if rank(other) > rank(one) { other } else { one }
}

async fn stop_one(found: Found, how: How, presented: Option<Arc<Presented>>) -> Stopped {
    match found.life {
        MissionState::Running => match control::stop(&found.folder, how.rest, presented.as_deref()).await {
            Ok(ending) => heard(&found, how, &ending).await,
            // If the mission refuses the stop, the robots are not stopped with data from the journal either.
            Err(refused @ Undelivered::Refused(_)) => {
                Stopped::of(found.opened.session.clone(), Err(refused.to_string()))
            }
            Err(unheard) => unanswered(&found, &unheard.to_string(), how).await,
        },
        MissionState::CutOff => cut_off(&found, how).await,
        MissionState::Ended => directly(&found, how, "it has already ended; stopping its robots again").await,
    }
}

/// The reason that is printed if a mission did not carry out a stop.
const ENDED_AHEAD: &str = "it was ended by an earlier stop before this one took effect";
/// Maximum time for the process of a mission to end after it has sent its report.
const ENDS_WITHIN: Duration = Duration::from_secs(2);
/// Interval between checks whether the process has ended.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// The parts of a report that state how robots came to rest. If this command stopped the robots directly, the report has neither `home`
/// nor `standing`.
#[derive(Deserialize)]
struct Rested {
    robots: Vec<RestedRobot>,
    home: Option<IgnoredAny>,
}

#[derive(Deserialize)]
struct RestedRobot {
    standing: Option<Standing>,
    stop: StopState,
}

/// Whether the mission did not carry out this stop: robots rest in place instead of at home, or vice versa, although no later stop has
/// replaced this one.
fn leaves_undone(ending: &Ending, rest: Rest) -> bool {
    let other = match rest {
        Rest::InPlace => StopState::Home,
        Rest::Home => StopState::Confirmed,
    };
    let Ok(report) = serde_json::from_str::<Rested>(&ending.report) else { return true };
    // The mission has attempted to plan the motions home.
    let is_home = rest == Rest::Home && report.home.is_some();
    let rests_otherwise = |robot: &RestedRobot| robot.standing != Some(Standing::Out) && robot.stop == other;
    !ending.superseded && !is_home && report.robots.iter().any(rests_otherwise)
}

/// Evaluates the report of a mission that was stopped. If the mission did not carry out this stop, stops its robots directly.
async fn heard(found: &Found, how: How, ending: &Ending) -> Stopped {
    if !leaves_undone(ending, how.rest) {
        return Stopped::by_itself(found.opened.session.clone(), &ending.report);
    }
    // Hardware that the mission's process drives can be reached only once that process has ended.
    let gone = async {
        while Found::look_at(&found.folder)
            .ok()
            .flatten()
            .is_some_and(|found| found.life == MissionState::Running)
        {
            tokio::time::sleep(LOOK_EVERY).await;
        }
    };
    let scheduler = match tokio::time::timeout(ENDS_WITHIN, gone).await {
        Ok(()) => Scheduler::Gone,
        Err(_) => Scheduler::Silent,
    };
    directly(found, How { scheduler, ..how }, &format!("{ENDED_AHEAD}; stopping its robots directly")).await
}

/// Handles a running mission that sent no report.
async fn unanswered(found: &Found, unheard: &str, how: How) -> Stopped {
    let now = Found::look_at(&found.folder).ok().flatten().map_or(MissionState::Ended, |found| found.life);
    match now {
        MissionState::CutOff => return cut_off(found, how).await,
        MissionState::Ended => {
            return directly(found, how, "it has ended in the meantime; stopping its robots again").await;
        }
        MissionState::Running => {}
    }
    let pid = holder(found);
    let process = pid.map_or("its process".to_owned(), |pid| format!("process {}", pid.as_raw_nonzero()));
    let how = How { scheduler: Scheduler::Silent, ..how };
    let stopped = directly(found, how, &format!("{process}: {unheard}; stopping its robots directly")).await;
    // If the process continues later, the signal stops the mission.
    if let Some(sent) = pid.and_then(|pid| signals::stop(pid, how.rest)) {
        let session = &found.opened.session;
        console::note(&format!("{session}: {process} was sent {sent}, so it will end if it continues"));
    }
    stopped
}

async fn cut_off(found: &Found, how: How) -> Stopped {
    let mission = found.opened.session.clone();
    match Taken::of(found) {
        Ok(taken) => {
            Stopped::of(mission, withdraw_and_record(taken, &Programs::new(), by_operator(), how).await)
        }
        // Most likely, another stop command holds the lock. Its socket reports the result.
        Err(NotTaken::Held) => match control::stop(&found.folder, how.rest, None).await {
            Ok(ending) => heard(found, how, &ending).await,
            Err(unheard) => {
                directly(found, how, &format!("another process has locked its journal: {unheard}")).await
            }
        },
        Err(not_taken) => directly(found, how, &not_taken.to_string()).await,
    }
}

/// Stops the robots of a mission without locking its journal or writing to it.
async fn directly(found: &Found, how: How, why: &str) -> Stopped {
    let mission = found.opened.session.clone();
    console::warn(&format!("{mission}: {why}"));
    let journal = found.clone();
    // The journal is read on another thread, so that the other missions are stopped meanwhile.
    let read = tokio::task::spawn_blocking(move || journal.read().map_err(|error| error.to_string()));
    let contents: Result<Contents, String> = read.await.map_err(|error| error.to_string()).flatten();
    match contents {
        Ok(contents) => Stopped::of(mission, withdraw(&contents, how).await),
        Err(reason) => Stopped::of(mission, Err(reason)),
    }
}

/// Returns the process that holds the lock of a mission's journal, if it is visible to this process. It is the scheduler that began the
/// mission, or another process of this program that has taken over the mission.
fn holder(found: &Found) -> Option<Pid> {
    let journal = std::fs::canonicalize(found.folder.join("journal")).ok()?;
    let program = std::env::current_exe().ok()?;
    let is_scheduler = |pid: Pid, process: &Path| {
        u32::try_from(pid.as_raw_nonzero().get()) == Ok(found.opened.pid)
            || std::fs::read_link(process.join("exe")).is_ok_and(|exe| exe == program)
    };
    let processes = std::fs::read_dir("/proc").ok()?.flatten();
    let holds = |process: &Path| {
        let files = std::fs::read_dir(process.join("fd")).into_iter().flatten().flatten();
        let mut open = files.filter(|file| std::fs::read_link(file.path()).is_ok_and(|open| open == journal));
        open.any(|file| {
            let info = std::fs::read_to_string(process.join("fdinfo").join(file.file_name()));
            info.is_ok_and(|info| info.contains("OFDLCK"))
        })
    };
    processes
        .filter_map(|process| {
            let pid = Pid::from_raw(process.file_name().to_str()?.parse().ok()?)?;
            (is_scheduler(pid, &process.path()) && holds(&process.path())).then_some(pid)
        })
        .next()
}

impl Stopped {
    /// Creates the result for a mission whose own scheduler stopped it and sent the report.
    fn by_itself(mission: SessionId, report: &str) -> Self {
        let report = Ended::of(report).map_err(|error| error.to_string());
        let not_at_rest = report.iter().flat_map(|ended| &ended.report.not_at_rest);
        not_at_rest.for_each(|reason| console::error(reason));
        let confirmed = report.as_ref().is_ok_and(|ended| !ended.report.is_unconfirmed());
        let exit = if confirmed { Exit::Done } else { Exit::Unconfirmed };
        Self { mission, begun: None, report, inside: Vec::new(), forgotten: Vec::new(), exit }
    }

    pub(super) fn of(mission: SessionId, withdrawn: Result<Withdrawn, String>) -> Self {
        match withdrawn {
            Ok(withdrawn) => {
                let exit = if withdrawn.is_confirmed() { Exit::Done } else { Exit::Unconfirmed };
                let report = Withdrawal::from(&withdrawn.report);
                let document = serde_json::to_value(&report).map_err(|error| error.to_string());
                let report = document.map(|document| Ended { report, document });
                let (begun, forgotten) = (Some(withdrawn.begun), withdrawn.forgotten);
                Self { mission, begun, report, inside: withdrawn.inside, forgotten, exit }
            }
            Err(reason) => Self {
                mission,
                begun: None,
                report: Err(reason),
                inside: Vec::new(),
                forgotten: Vec::new(),
                exit: Exit::Unconfirmed,
            },
        }
    }

    fn tell(&self, shown: Shown, format: Format) {
        let indent = if shown == Shown::Several { "  " } else { "" };
        let mut lines = String::new();
        if shown == Shown::Several {
            lines.push_str(&format!("{}:\n", shown::shown(self.mission.as_str())));
        }
        let robots = self.report.iter().flat_map(|ended| &ended.report.robots);
        robots.for_each(|robot| {
            lines.push_str(&format!("{indent}{}\n", shown::shown(&robot_line(robot, self.begun))))
        });
        let failures = self.report.iter().flat_map(|ended| &ended.report.failures);
        failures.for_each(|failure| {
            lines.push_str(&format!("{indent}{}\n", shown::shown(&failure_line(failure))))
        });
        self.inside
            .iter()
            .for_each(|inside| lines.push_str(&format!("{indent}{}\n", shown::shown(&inside_line(inside)))));
        if !self.forgotten.is_empty() {
            lines.push_str(&format!("{indent}{}\n", shown::shown(&forgotten_line(&self.forgotten))));
        }
        match format {
            Format::Text => console::print(&lines),
            Format::Json => self.inside.iter().for_each(|inside| console::note(&inside_line(inside))),
        }
        if let Err(reason) = &self.report {
            console::error(&format!("{} was NOT stopped: {reason}", self.mission));
        }
    }

    fn document(&self, shown: Shown) -> Value {
        let mut report = match &self.report {
            Ok(ended) => ended.document.clone(),
            Err(reason) => json!({"error": reason}),
        };
        if !self.inside.is_empty() {
            report["inside"] = json!(self.inside);
        }
        if !self.forgotten.is_empty() {
            report["forgotten"] = json!(self.forgotten);
        }
        match shown {
            Shown::One => report,
            Shown::Several => json!({"mission": self.mission, "report": report}),
        }
    }
}

/// Returns the line about a robot's stop. `begun` is when this command began to stop the robots directly. The mission's leases may have
/// expired long before.
fn robot_line(robot: &WithdrawnRobot, begun: Option<Timestamp<Server>>) -> String {
    let name = &robot.robot;
    match robot.stop {
        StopState::Confirmed => format!("{name}: stop confirmed"),
        StopState::Home => format!("{name}: default state confirmed"),
        StopState::Unconfirmed { lease_ends: Some(ends) } => {
            let verb = if begun.is_some_and(|begun| ends < begun) { "ended" } else { "ends" };
            format!("{name}: stop NOT confirmed; its lease {verb} at {}", time_of_day(ends))
        }
        StopState::Unconfirmed { lease_ends: None } => {
            format!("{name}: stop NOT confirmed; it has no lease, so it will not stop by itself")
        }
        StopState::TakenOver => format!("{name}: {TAKEN_OVER}"),
        StopState::NotSent => format!("{name}: nothing was sent to it"),
    }
}

/// Returns a line that states why a robot has not confirmed its stop, or why it failed earlier.
fn failure_line(failure: &Failure) -> String {
    format!("{}: {}", failure.robot, failure.kind)
}

fn forgotten_line(robots: &[RobotId]) -> String {
    let names: Vec<_> = robots.iter().map(RobotId::as_str).collect();
    let (have, their) = if robots.len() == 1 { ("has", "its") } else { ("have", "their") };
    format!(
        "forgotten: the mission is considered ended, although {} {have} not confirmed {their} stop",
        names.join(", ")
    )
}

fn inside_line(inside: &Inside) -> String {
    let robot = &inside.robot;
    match inside.what {
        InsideWhat::Simulated => format!("{robot}: was simulated in the scheduler's own process"),
        InsideWhat::Unmoved => format!("{robot}: nothing was sent to it"),
        InsideWhat::Program => format!(
            "{robot}: stop NOT confirmed; it was driven by a program, which a stop does not start: `downbeat resume` starts the program in the fleet file and brings the robot to rest"
        ),
        InsideWhat::Driver => {
            format!(
                "{robot}: stop NOT confirmed; the scheduler's own process drives it; end that process, then run `downbeat stop` again"
            )
        }
    }
}

/// Prints the result of a mission that was withdrawn instead of resumed, and returns the exit code.
pub(super) fn conclude(mission: SessionId, withdrawn: Result<Withdrawn, String>, format: Format) -> Exit {
    let stopped = Stopped::of(mission, withdrawn);
    stopped.tell(Shown::One, format);
    if format == Format::Json {
        console::print_json(&stopped.document(Shown::One));
    }
    stopped.exit
}
