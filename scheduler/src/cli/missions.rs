//! `downbeat missions`: lists the missions of this machine, which other processes run or ran.

use std::io;
use std::path::Path;

use downbeat_scripts::{Attempt, Refusal, counted};
use serde::Serialize;
use serde_json::json;
use urrcp::{RobotId, SessionId};

use super::{Exit, Format, console};
use crate::journal::{self, Found, MissionState, Missions, NotPrivate, Unreadable};
use crate::show::table::Rows;

/// List the missions of this machine that run or were cut off.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Journals are kept in $DOWNBEAT_STATE, or else in $XDG_STATE_HOME/downbeat, or else in ~/.local/state/downbeat. \
Only you can read that folder; the command refuses one that another user owns or can write to.

Examples:
  downbeat missions
  downbeat missions --all --format json"
)]
pub(super) struct MissionsArgs {
    /// Also list missions that ended.
    #[arg(long)]
    all: bool,
}

#[derive(Serialize)]
struct Row {
    mission: SessionId,
    state: &'static str,
    pid: u32,
    scenario: std::path::PathBuf,
    robots: Vec<RobotId>,
}

impl From<Found> for Row {
    fn from(found: Found) -> Self {
        Self {
            mission: found.opened.session,
            state: match found.life {
                MissionState::Running => "running",
                MissionState::CutOff => "cut off",
                MissionState::Ended => "ended",
            },
            pid: found.opened.pid,
            scenario: found.opened.scenario,
            robots: found.opened.robots.into_iter().map(|opened| opened.robot).collect(),
        }
    }
}

pub(super) fn missions(args: &MissionsArgs, format: Format) -> Exit {
    let listed = match listed() {
        Ok(listed) => listed,
        Err(exit) => return exit,
    };
    let unread = listed.unread();
    let shown = listed.found.into_iter().filter(|found| args.all || found.life != MissionState::Ended);
    let rows: Vec<Row> = shown.map(Row::from).collect();
    match format {
        Format::Json => console::print_json(&rows),
        Format::Text if rows.is_empty() && unread > 0 => {
            console::note("no other mission is running, and none was cut off");
        }
        Format::Text if rows.is_empty() => console::note("no mission is running, and none was cut off"),
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

/// Returns the missions of this machine. Prints which missions are unreadable, and to which paths other users have access.
pub(super) fn listed() -> Result<Missions, Exit> {
    let told = |message: &str| {
        console::error(message);
        Exit::Usage
    };
    let state = journal::state_folder().map_err(|error| told(&error.to_string()))?;
    let missions = Missions::of(&state).map_err(|error| told(&unusable(&state, &error)))?;
    for refused in &missions.refused {
        console::warn(&format!("{refused}; if a mission is running there, this command cannot reach it"));
    }
    for journal in &missions.damaged {
        let why = match journal::read(journal) {
            Err(other @ Unreadable::OtherVersion { .. }) => other.to_string(),
            _ => format!(
                "the first line of {} cannot be read, so the robots of its mission are unknown; make sure that no robot is moving, then delete the file",
                journal.display()
            ),
        };
        console::warn(&why);
    }
    Ok(missions)
}

/// Returns the error message for missions that cannot be listed.
pub(super) fn unusable(state: &Path, error: &io::Error) -> String {
    match NotPrivate::of(error) {
        Some(refused) => format!("cannot access the missions of this machine: {refused}"),
        None => {
            let refusal = Refusal::of(Attempt::Read(state), error).reason;
            format!("cannot read the missions in {}: {refusal}", state.display())
        }
    }
}

/// Returns the mission with this name and state. Without a name, there must be exactly one mission with this state.
pub(super) fn one(named: Option<&str>, life: MissionState, format: Format) -> Result<Found, Exit> {
    let (what, what_several) = match life {
        MissionState::Running => ("is running", "are running"),
        MissionState::CutOff => ("was cut off", "were cut off"),
        MissionState::Ended => ("has ended", "have ended"),
    };
    let fits = |found: &Found| found.life == life && is_called(found, named);
    let mut fitting: Vec<Found> = listed()?.found.into_iter().filter(fits).collect();
    match (fitting.pop(), fitting.is_empty()) {
        (Some(found), true) => Ok(found),
        (Some(last), false) => {
            let text = format!("several missions {what_several}; name one of them");
            let several: Vec<_> = fitting.iter().chain([&last]).map(|found| &found.opened.session).collect();
            match format {
                Format::Json => console::print_json(&json!({"error": text, "missions": several})),
                Format::Text => {
                    console::error(&format!("{text}:"));
                    several.iter().for_each(|session| console::note(&format!("  {session}")));
                }
            }
            Err(Exit::Usage)
        }
        (None, _) => Err(none(named, what, format)),
    }
}

/// Whether a mission has the given name. True if no name is given.
pub(super) fn is_called(found: &Found, named: Option<&str>) -> bool {
    named.is_none_or(|name| found.opened.session.as_str() == name)
}

/// Prints that no mission has the given name or state, and returns the exit code.
pub(super) fn none(named: Option<&str>, what: &str, format: Format) -> Exit {
    let text = match named {
        Some(name) => format!("no mission `{name}` {what}; `downbeat missions --all` lists all missions"),
        None if what == "was cut off" => format!("no mission {what}, so there is nothing to resume"),
        None if what == "is running" => format!("no mission {what}; start one with `downbeat run SCENARIO`"),
        None => format!(
            "no mission {what}, so there is nothing to stop; `downbeat missions --all` lists those that ended"
        ),
    };
    match format {
        Format::Json => console::print_json(&json!({"error": text})),
        Format::Text => console::error(&text),
    }
    Exit::Usage
}

pub(super) fn failed(message: &str) -> Exit {
    console::error(message);
    Exit::Failed
}
