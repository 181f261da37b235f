//! `downbeat keys push`: sends the list of revoked keys to the robots of a fleet.

use std::path::{Path, PathBuf};

use downbeat_robot::tls::{Credentials, Name};
use downbeat_scripts::shown::shown;
use downbeat_scripts::{Address, Fleet, FleetRobot, Protection};
use serde::Serialize;
use urrcp::{RobotId, Span};

use super::fleet::{Answer, RobotToAsk, ask_all, shown_list};
use super::keys::FolderArgs;
use super::run::parse_span;
use super::{Exit, Format, ProjectArgs, console, identity, load};
use crate::fleet::{Drivers, StartPrograms};
use crate::keys::{Authorities, Issuing, calendar};

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
    /// Time for which `downbeat keys revoke --fleet` waits for answers. Equals the default of `--patience`.
    pub(super) const PATIENCE: Span = Span::from_millis(5_000);
}

/// The list that a robot uses after the latest list has been sent to it.
#[derive(Debug, Serialize)]
pub(super) struct Pushed {
    robot: RobotId,
    /// Number of the list that the robot uses. `None` if unknown.
    list: Option<u64>,
    /// Why the robot does not use the latest list. `None` if it does.
    problem: Option<String>,
}

pub(super) fn push(args: &PushArgs, format: Format) -> Exit {
    let fleet = match fleet(&args.fleet, &args.project, format) {
        Ok(fleet) => fleet,
        Err(exit) => return exit,
    };
    let robots = match send(&fleet, &args.folder, args.patience) {
        Ok(robots) => robots,
        Err(message) => {
            console::error(&message);
            return Exit::Usage;
        }
    };
    match format {
        Format::Json => console::print_json(&serde_json::json!({ "robots": robots })),
        Format::Text => show(&robots),
    }
    exit(&robots)
}

/// Reads a fleet file. Prints an error if none of its robots requires a proven identity.
pub(super) fn fleet(path: &Path, project: &ProjectArgs, format: Format) -> Result<Fleet, Exit> {
    let fleet = load::load_fleet(path, project, format)?;
    if protected(&fleet).next().is_none() {
        console::error(&format!(
            "{}: no robot has a tls:// or hmac:// address, so none uses a list of revoked keys",
            shown(&path.display().to_string())
        ));
        return Err(Exit::Usage);
    }
    Ok(fleet)
}

/// Whether this terminal connects to the robots of a fleet as this operator.
pub(super) fn is_sent_by(fleet: &Fleet, operator: &Name) -> bool {
    let own = identity::keys(fleet).identity.and_then(|path| Credentials::read(&path).ok());
    own.is_some_and(|own| own.identity().name == *operator)
}

fn protected(fleet: &Fleet) -> impl Iterator<Item = (&FleetRobot, Protection)> {
    fleet.robots.iter().filter_map(|robot| match robot.address {
        Address::Tcp { protection, .. } if protection != Protection::Open => Some((robot, protection)),
        _ => None,
    })
}

/// Sends the latest list to all robots of a fleet that require a proven identity.
///
/// # Errors
/// A sentence with the reason why no robot could be asked.
pub(super) fn send(fleet: &Fleet, folder: &FolderArgs, patience: Span) -> Result<Vec<Pushed>, String> {
    let (mut pushed, mut asked) = (Vec::new(), Vec::new());
    let mut bytes = 0;
    let latest = {
        // The folder is locked while the authority is open.
        let authority = folder.open().map_err(|error| error.to_string())?;
        refuse_ended(fleet, &authority.authorities().map_err(|error| error.to_string())?)?;
        authority.renew_lists(calendar()).map_err(|error| error.to_string())?;
        for (robot, protection) in protected(fleet) {
            let id = robot.init.as_ref().map_or(&robot.id, |init| &init.id);
            match authority.list_for(id, protection) {
                Ok(list) => {
                    bytes = bytes.max(list.len());
                    asked.push(RobotToAsk { robot, list: Some(list) });
                }
                Err(error) => {
                    let problem = format!(
                        "{error}; make a secret for it with `downbeat keys secret {id}`, or remove it from the fleet file"
                    );
                    pushed.push(Pushed { robot: robot.id.clone(), list: None, problem: Some(problem) });
                }
            }
        }
        authority.list_number()
    };
    let mut answers = Err(String::new());
    super::with_runtime(async {
        answers = ask_all(fleet, asked, Drivers::from(StartPrograms::No), patience).await;
        Exit::Done
    });
    pushed.extend(answers?.into_iter().map(|answer| result(answer, latest, bytes)));
    Ok(pushed)
}

/// Returns an error if this terminal's key is of an authority that has ended: robots would refuse it. `authorities` are those of the
/// folder from which the list comes.
fn refuse_ended(fleet: &Fleet, authorities: &Authorities) -> Result<(), String> {
    let own = identity::keys(fleet).identity.and_then(|path| Credentials::read(&path).ok());
    let Some(own) = own.as_ref().map(Credentials::identity) else { return Ok(()) };
    let has_tls = protected(fleet).any(|(_, protection)| protection == Protection::Tls);
    if !has_tls || authorities.issuing(Some(&own.authority)) != Issuing::Ended {
        return Ok(());
    }
    Err(format!(
        "the key of {} is of another authority than that of the list, or of one that has ended; set DOWNBEAT_IDENTITY to an identity file of the present authority",
        own.name
    ))
}

/// Length in bytes of a list that a robot accepts even while it plays in another operator's mission.
const ALWAYS_ACCEPTED: usize = 60_000;

fn result(answer: Answer, latest: u64, bytes: usize) -> Pushed {
    let Answer { robot, problem, revocation_list, .. } = answer;
    let list = revocation_list.as_ref().map(|list| list.number).filter(|number| *number > 0);
    let refused = revocation_list.and_then(|list| list.refused);
    let problem = match list {
        Some(number) if number > latest => Some(format!(
            "it is newer than list {latest} in the authority's folder: this folder may be an old copy"
        )),
        Some(number) if number == latest && refused.is_none() => None,
        _ => {
            let unknown = || "it does not state which list it uses; copy the list to it".to_owned();
            let problem = refused.or(problem).unwrap_or_else(unknown);
            let hint = "; while a robot plays in a mission, it may refuse a list of this length: try again later, or copy the list to it";
            Some(format!("{problem}{}", if bytes > ALWAYS_ACCEPTED { hint } else { "" }))
        }
    };
    Pushed { robot, list, problem }
}

pub(super) fn show(robots: &[Pushed]) {
    for Pushed { robot, list, problem } in robots {
        let list = list.map(shown_list);
        match (problem, list) {
            (None, list) => {
                console::print(&format!("{robot}: uses the latest list {}\n", list.unwrap_or_default()));
            }
            (Some(problem), Some(list)) => {
                console::error(&format!("{robot}: still uses list {list}: {problem}"));
            }
            (Some(problem), None) => console::error(&format!("{robot}: {problem}")),
        }
    }
}

/// Returns [`Exit::Done`] if all robots use the latest list, otherwise [`Exit::Failed`].
pub(super) fn exit(robots: &[Pushed]) -> Exit {
    if robots.iter().all(|robot| robot.problem.is_none()) { Exit::Done } else { Exit::Failed }
}
