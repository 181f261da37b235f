//! `downbeat keys push`: sends the list of revoked keys to the robots of a fleet.

use std::path::{Path, PathBuf};

use downbeat_scripts::shown::shown;
use downbeat_scripts::{Address, Fleet, Protection};
use serde::Serialize;
use urrcp::{RobotId, Span};

use super::fleet::{Answer, Asked, ask_all, shown_list};
use super::keys::FolderArgs;
use super::run::parse_span;
use super::{Exit, Format, ProjectArgs, console, load};
use crate::fleet::{Drivers, StartPrograms};
use crate::keys::{Authority, calendar};

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Robots with a tls:// or hmac:// address that were started with --revoked store the list, and apply it at once. The command \
fails if a robot does not use the latest list afterwards.

Examples:
  downbeat keys push
  downbeat keys push stage.yaml --keys /media/safe/keys"
)]
pub(super) struct PushArgs {
    /// The fleet file.
    #[arg(default_value = "fleet.yaml")]
    fleet: PathBuf,
    #[command(flatten)]
    project: ProjectArgs,
    #[command(flatten)]
    folder: FolderArgs,
    /// How long to wait for answers.
    #[arg(long, value_parser = parse_span, default_value = "5s", value_name = "TIME")]
    patience: Span,
}

impl PushArgs {
    /// Default time to wait for answers.
    pub(super) const PATIENCE: Span = Span::from_millis(5_000);
}

/// The list that a robot uses after the latest one was sent to it.
#[derive(Serialize)]
struct Pushed {
    robot: RobotId,
    /// Number of the list that the robot uses. `None` if unknown.
    list: Option<u64>,
    /// Why the robot does not use the latest list. `None` if it does.
    problem: Option<String>,
}

pub(super) fn push(args: &PushArgs, format: Format) -> Exit {
    push_to(&args.fleet, &args.project, &args.folder, args.patience, format)
}

/// Sends the latest list to all robots of a fleet that require a proven identity.
pub(super) fn push_to(
    path: &Path,
    project: &ProjectArgs,
    folder: &FolderArgs,
    patience: Span,
    format: Format,
) -> Exit {
    let fleet = match load::load_fleet(path, project, format) {
        Ok(fleet) => fleet,
        Err(exit) => return exit,
    };
    let (latest, asked) = match lists(&fleet, folder) {
        Ok(lists) => lists,
        Err(message) => {
            console::error(&message);
            return Exit::Usage;
        }
    };
    if asked.is_empty() {
        console::error(&format!(
            "{}: no robot has a tls:// or hmac:// address, so none uses a list of revoked keys",
            shown(&path.display().to_string())
        ));
        return Exit::Usage;
    }
    super::with_runtime(async {
        match ask_all(&fleet, asked, Drivers::from(StartPrograms::No), patience).await {
            Ok(answers) => show(answers.into_iter().map(|answer| pushed(answer, latest)).collect(), format),
            Err(message) => {
                console::error(&message);
                Exit::Failed
            }
        }
    })
}

/// Returns the number of the latest list, and the robots that should use it, each with the text to send.
fn lists<'a>(fleet: &'a Fleet, folder: &FolderArgs) -> Result<(u64, Vec<Asked<'a>>), String> {
    let authority = Authority::open(&folder.keys).map_err(|error| error.to_string())?;
    authority.renew_lists(calendar()).map_err(|error| error.to_string())?;
    let mut asked = Vec::new();
    for robot in &fleet.robots {
        let Address::Tcp { protection, .. } = robot.address else { continue };
        if protection == Protection::Open {
            continue;
        }
        let id = robot.init.as_ref().map_or(&robot.id, |init| &init.id);
        let list = authority.list_for(id, protection).map_err(|error| error.to_string())?;
        asked.push((robot, Some(list)));
    }
    Ok((authority.list_number(), asked))
}

fn pushed(answer: Answer, latest: u64) -> Pushed {
    let Answer { robot, problem, revocation_list, .. } = answer;
    let list = revocation_list.as_ref().map(|list| list.number);
    let problem = if list == Some(latest) {
        None
    } else {
        let refused = revocation_list.and_then(|list| list.refused);
        let unknown = || "it does not state which list it uses; copy the list to it".to_owned();
        Some(refused.or(problem).unwrap_or_else(unknown))
    };
    Pushed { robot, list: list.filter(|number| *number > 0), problem }
}

fn show(robots: Vec<Pushed>, format: Format) -> Exit {
    let all_well = robots.iter().all(|robot| robot.problem.is_none());
    match format {
        Format::Json => console::print_json(&serde_json::json!({ "robots": robots })),
        Format::Text => {
            for Pushed { robot, list, problem } in &robots {
                match (problem, list) {
                    (None, list) => {
                        let list = list.map_or_else(String::new, |number| format!(" {}", shown_list(number)));
                        console::print(&format!("{robot}: uses the latest list{list}\n"));
                    }
                    (Some(problem), Some(list)) => console::error(&format!(
                        "{robot}: uses the older list {}: {problem}",
                        shown_list(*list)
                    )),
                    (Some(problem), None) => console::error(&format!("{robot}: {problem}")),
                }
            }
        }
    }
    if all_well { Exit::Done } else { Exit::Failed }
}
