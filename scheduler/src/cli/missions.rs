//! `downbeat missions`, `go`, `stop` and `resume`: missions that other processes run, or ran.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use downbeat_robot::HostOptions;
use downbeat_scripts::shown::shown;
use downbeat_scripts::{FleetRobot, Handshake, counted};
use serde::Serialize;
use urrcp::{RobotId, SessionId, Span};

use super::run::{HowArgs, finish, operator, server_clock, utc_offset};
use super::{Exit, Format, ScenarioArgs, choice, console, load, robot};
use crate::fleet;
use crate::journal::{self, Fate, Found, Journal, Torn};
use crate::mission::{Mission, MissionOptions};
use crate::report::table::Rows;
use crate::report::{Report, StopState};
use crate::run::{Keep, control};

/// List the missions of this machine: those that run, and those that were cut off.
#[derive(Debug, clap::Args)]
#[command(after_help = "Journals lie in $DOWNBEAT_STATE, else in $XDG_STATE_HOME/downbeat, else in
~/.local/state/downbeat.

Examples:
  downbeat missions
  downbeat missions --all --format json")]
pub(super) struct MissionsArgs {
    /// Those that ended well, too.
    #[arg(long)]
    all: bool,
}

/// Let the act begin that waits for the operator.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  downbeat go\n  downbeat go swap@stage-4711-20261121T193000000")]
pub(super) struct GoArgs {
    /// The mission; needed where several run.
    mission: Option<String>,
}

/// Stop a mission: every robot that can be reached comes to rest.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Stops a mission that runs, from any terminal, and waits for its report. Of a mission whose scheduler was
killed, withdraws what its journal says was promised. Says which robots confirmed, which did not, and when their
leases end.

Examples:
  downbeat stop
  downbeat stop swap@stage-4711-20261121T193000000 --patience 2s"
)]
pub(super) struct StopArgs {
    /// The mission; needed where there are several.
    mission: Option<String>,
    #[command(flatten)]
    how: HowArgs,
}

/// Take up a mission whose scheduler was killed.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Reads the journal, reaches the robots again under the same session, learns what they did meanwhile, and
plays the mission to its end. An act that was not decided yet is withdrawn instead.

Examples:
  downbeat resume
  downbeat resume swap@stage-4711-20261121T193000000"
)]
pub(super) struct ResumeArgs {
    /// The mission; needed where several were cut off.
    mission: Option<String>,
    #[command(flatten)]
    how: HowArgs,
}

#[derive(Serialize)]
struct Row {
    mission: SessionId,
    state: &'static str,
    pid: u32,
    scenario: std::path::PathBuf,
    robots: Vec<RobotId>,
}

fn state_of(found: &Found) -> &'static str {
    match (found.alive, &found.kept.outcome) {
        (true, _) => "running",
        (false, Some(_)) => "ended",
        (false, None) => "cut off",
    }
}

pub(super) fn missions(args: &MissionsArgs, format: Format) -> Exit {
    let all = journal::missions(&journal::state_folder());
    let shown = all.iter().filter(|found| args.all || state_of(found) != "ended");
    let rows: Vec<Row> = shown
        .map(|found| Row {
            mission: found.kept.opened.session.clone(),
            state: state_of(found),
            pid: found.kept.opened.pid,
            scenario: found.kept.opened.scenario.clone(),
            robots: found.kept.opened.robots.iter().map(|(robot, _)| robot.clone()).collect(),
        })
        .collect();
    match format {
        Format::Json => console::print_json(&rows),
        Format::Text if rows.is_empty() => console::note("no mission runs, none was cut off"),
        Format::Text => {
            let mut table = Rows::new(&["mission", "state", "process", "robots", "scenario"], 5);
            for row in rows {
                let robots = counted(row.robots.len(), "robot");
                let scenario = row.scenario.display().to_string();
                table.add([
                    row.mission.to_string(),
                    row.state.to_owned(),
                    row.pid.to_string(),
                    robots,
                    scenario,
                ]);
            }
            console::print(&table.text(console::columns()));
        }
    }
    Exit::Done
}

/// The one mission that is meant.
fn find(named: Option<&str>, fits: impl Fn(&Found) -> bool, what: &str) -> Result<Found, Exit> {
    let all = journal::missions(&journal::state_folder());
    let named_so = |found: &Found| named.is_none_or(|name| found.kept.opened.session.as_str() == name);
    let mut fitting: Vec<Found> = all.into_iter().filter(|found| named_so(found) && fits(found)).collect();
    match (fitting.len(), named) {
        (1, _) => fitting.pop().ok_or(Exit::Usage),
        (0, Some(name)) => {
            console::error(&format!("no mission `{name}` {what}; `downbeat missions --all` lists them"));
            Err(Exit::Usage)
        }
        (0, None) => {
            console::error(&format!("no mission {what}"));
            Err(Exit::Usage)
        }
        (_, _) => {
            console::error(&format!("several missions {what}, name one of them:"));
            fitting.iter().for_each(|found| console::note(&format!("  {}", found.kept.opened.session)));
            Err(Exit::Usage)
        }
    }
}

pub(super) fn go(args: &GoArgs) -> Exit {
    let found = match find(args.mission.as_deref(), |found| found.alive, "runs") {
        Ok(found) => found,
        Err(exit) => return exit,
    };
    super::with_runtime(async {
        match control::say(&found.folder, "go").await {
            Ok(answer) if answer.trim() == "heard" => Exit::Done,
            Ok(_) => failed("the mission is over"),
            Err(error) => failed(&format!("`{}` does not listen: {error}", found.kept.opened.session)),
        }
    })
}

fn failed(message: &str) -> Exit {
    console::error(message);
    Exit::Failed
}

pub(super) fn stop(args: &StopArgs, format: Format) -> Exit {
    let fits = |found: &Found| found.alive || found.kept.outcome.is_none();
    let found = match find(args.mission.as_deref(), fits, "runs or was cut off") {
        Ok(found) => found,
        Err(exit) => return exit,
    };
    super::with_runtime(async {
        if found.alive {
            return stop_running(&found, args.how.patience, format).await;
        }
        match take_up(found) {
            Ok((found, journal)) => withdraw(&found, journal, &args.how, format).await,
            Err(exit) => exit,
        }
    })
}

/// What a report says of stops, as it comes over the socket.
async fn stop_running(found: &Found, patience: Span, format: Format) -> Exit {
    // The mission itself waits for its robots as long as it was told to.
    let patience = patience.to_duration() + Duration::from_secs(60);
    let said = tokio::time::timeout(patience, control::say(&found.folder, "stop")).await;
    let answer = match said {
        Ok(Ok(answer)) => answer,
        Ok(Err(error)) => return failed(&format!("the mission does not listen: {error}")),
        Err(_) => return failed("the mission has heard the stop and does not end"),
    };
    let report = answer.lines().nth(1).and_then(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    let Some(report) = report else { return failed("the mission ended without a report") };
    if format == Format::Json {
        console::print_json(&report);
    }
    let mut unconfirmed = false;
    for robot in report["robots"].as_array().into_iter().flatten() {
        let name = robot["robot"].as_str().unwrap_or_default();
        let text = match robot["stop"]["state"].as_str() {
            Some("confirmed") => "default state confirmed".to_owned(),
            Some("held") => "held where it was, confirmed".to_owned(),
            Some("unconfirmed") => {
                unconfirmed = true;
                let ends = robot["stop"]["lease_ends"].as_str();
                ends.map_or("stop NOT confirmed, and it runs without a lease".to_owned(), |ends| {
                    format!("stop NOT confirmed; its lease ends at {ends}")
                })
            }
            _ => "nothing had been sent to it".to_owned(),
        };
        if format == Format::Text {
            console::print(&format!("{}\n", shown(&format!("{name}: {text}"))));
        }
    }
    if unconfirmed { Exit::Unconfirmed } else { Exit::Done }
}

/// Opens the journal of a mission whose scheduler is gone, and reads it again under its lock.
fn take_up(mut found: Found) -> Result<(Found, Journal), Exit> {
    let journal = Journal::open(&found.folder).map_err(|error| failed(&error.to_string()))?;
    let Some(kept) = journal.kept() else { return Err(failed("the journal is empty")) };
    found.kept = kept.clone();
    if found.kept.outcome.is_some() {
        return Err(failed("another process has ended this mission meanwhile"));
    }
    if let Some(torn) = found.kept.torn {
        console::warn(&torn_text(torn));
    }
    Ok((found, journal))
}

fn torn_text(torn: Torn) -> String {
    let Torn { line, bytes, whole_after } = torn;
    match whole_after {
        0 => format!(
            "the last record of the journal, line {line}, was not written to its end: its {bytes} bytes are cut off, what it said is not known"
        ),
        after => format!(
            "the journal is damaged from line {line} on: its last {bytes} bytes are cut off, also {} after the damage",
            counted(after, "whole record")
        ),
    }
}

/// The robots of a journal as the fleet file has them now.
fn robots_of(found: &Found) -> Result<(downbeat_scripts::Fleet, Vec<RobotId>), Exit> {
    let (fleet, findings) = downbeat_scripts::read_fleet(&found.kept.opened.fleet);
    let Some(fleet) = fleet else {
        load::show_findings(&findings);
        return Err(Exit::Usage);
    };
    Ok((fleet, found.kept.opened.robots.iter().map(|(robot, _)| robot.clone()).collect()))
}

fn options(found: &Found, how: &HowArgs, greeting: crate::mission::Greeting) -> MissionOptions {
    MissionOptions {
        greeting,
        patience: how.patience,
        session: Some(found.kept.opened.session.clone()),
        utc_offset: utc_offset(),
        ..MissionOptions::default()
    }
}

/// Stops what a dead scheduler left behind.
async fn withdraw(found: &Found, journal: Journal, how: &HowArgs, format: Format) -> Exit {
    let (fleet, ids) = match robots_of(found) {
        Ok(robots) => robots,
        Err(exit) => return exit,
    };
    let robots: Vec<&FleetRobot> = fleet.robots.iter().filter(|robot| ids.contains(&robot.id)).collect();
    let clock = match server_clock(&fleet, format).await {
        Ok((clock, _)) => clock,
        Err(error) => return failed(&error),
    };
    let options = options(found, how, fleet::greeting(&fleet));
    let touched: BTreeMap<_, _> = found.kept.touched.clone();
    let mission = Mission::withdraw(fleet::participants(&robots), options, &touched, clock.now());
    let (report, at_rest) =
        match go_on(found, journal, mission, &robots, fleet.handshake, clock, format).await {
            Ok(gone_on) => gone_on,
            Err(exit) => return exit,
        };
    let exit = finish(&report, format);
    let unconfirmed = report.robots.iter().any(|robot| matches!(robot.stop, StopState::Unconfirmed { .. }));
    match (unconfirmed, at_rest) {
        (true, _) => exit,
        (false, true) => Exit::Done,
        (false, false) => Exit::Unconfirmed,
    }
}

/// Returns the report, and whether hardware in this process is known to be in its default state.
async fn go_on(
    found: &Found,
    journal: Journal,
    mission: Mission,
    robots: &[&FleetRobot],
    handshake: Handshake,
    clock: crate::server_clock::ServerClock,
    format: Format,
) -> Result<(Report, bool), Exit> {
    let (host, endpoints) = fleet::endpoints(robots, handshake, HostOptions::default())
        .map_err(|error| failed(&error.to_string()))?;
    let mut keep = Keep { journal: Some(journal), ..Keep::default() };
    let (said, operator) = operator();
    let (tell_report, report_told) = tokio::sync::watch::channel(None);
    if let Err(error) = control::listen(&found.folder, said.clone(), report_told) {
        console::warn(&format!("`downbeat stop` will not reach this mission: {error}"));
    }
    let choreography = Arc::new(mission.choreography().clone());
    let ids = robots.iter().map(|robot| robot.id.clone());
    let live = super::live::Live::start(format, clock, choreography, ids, said);
    let tell = |at, progress: &_| live.tell(at, progress);
    let report = crate::run::run_and_keep(mission, endpoints, clock, operator, tell, &mut keep).await;
    drop(live);
    let _nobody_waits = tell_report.send(serde_json::to_string(&report).ok());
    tokio::time::sleep(Duration::from_millis(20)).await;
    Ok((report, host.is_none_or(robot::stop)))
}

pub(super) fn resume(args: &ResumeArgs, format: Format) -> Exit {
    let fits = |found: &Found| !found.alive && found.kept.outcome.is_none();
    let found = match find(args.mission.as_deref(), fits, "was cut off") {
        Ok(found) => found,
        Err(exit) => return exit,
    };
    let (found, journal) = match take_up(found) {
        Ok(taken) => taken,
        Err(exit) => return exit,
    };
    if let Fate::Withdraw(why) = found.kept.fate() {
        console::note(&format!("{why}: withdrawing what was promised"));
        return super::with_runtime(withdraw(&found, journal, &args.how, format));
    }
    let scenario = ScenarioArgs {
        scenario: found.kept.opened.scenario.clone(),
        fleet: Some(found.kept.opened.fleet.clone()),
    };
    let (choreography, fleet, _) = match load::load_choreography(&scenario, format) {
        Ok(loaded) => loaded,
        Err(exit) => return exit,
    };
    let (choreography, _) = match choice::choose(choreography, &fleet, &found.kept.opened.asked) {
        Ok(chosen) => chosen,
        Err(exit) => return exit,
    };
    super::with_runtime(async {
        let clock = match server_clock(&fleet, format).await {
            Ok((clock, _)) => clock,
            Err(error) => return failed(&error),
        };
        let robots = fleet::robots_in(&fleet, &choreography);
        let options = options(&found, &args.how, fleet::greeting(&fleet));
        let participants = fleet::participants(&robots);
        let mission = Mission::resume(choreography, participants, options, &found.kept, clock.now());
        let mission = match mission {
            Ok(mission) => mission,
            Err(changed) => return failed(&changed.to_string()),
        };
        match go_on(&found, journal, mission, &robots, fleet.handshake, clock, format).await {
            Ok((report, at_rest)) => {
                let exit = finish(&report, format);
                if at_rest { exit } else { Exit::Unconfirmed }
            }
            Err(exit) => exit,
        }
    })
}
