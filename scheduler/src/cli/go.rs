//! `downbeat go`: begins the act that waits for the operator, from another terminal.

use urrcp::SessionId;

use super::missions::{failed, one};
use super::{Exit, Format, console, identity};
use crate::journal::MissionState;
use crate::run::control;

/// Begin the act that waits for the operator.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The command prints the act that starts. If no act waits for the operator, or a different act than the one \
that you name, nothing happens: the command prints the reason, and the exit code is 1.

Examples:
  downbeat go
  downbeat go finale
  downbeat go --mission swap@stage-4711-20261121T193000000
  DOWNBEAT_IDENTITY=cleo.pem downbeat go finale"
)]
pub(super) struct GoArgs {
    /// The act to begin. By default, the act that waits.
    act: Option<String>,
    /// The mission. Needed only if several run.
    #[arg(long)]
    mission: Option<String>,
}

pub(super) fn go(args: &GoArgs, format: Format) -> Exit {
    let found = match one(args.mission.as_deref(), MissionState::Running, format) {
        Ok(found) => found,
        Err(exit) => return exit,
    };
    let name = &found.opened.session;
    let presented = match identity::presented() {
        Ok(presented) => presented,
        Err(error) => return refused(name, &error, format),
    };
    super::with_runtime(async {
        match control::go(&found.folder, args.act.as_deref(), presented.as_ref()).await {
            Ok(Ok(act)) => {
                match format {
                    Format::Json => {
                        console::print_json(&serde_json::json!({"mission": name, "started": act}))
                    }
                    Format::Text => console::print(&format!("`{act}` begins\n")),
                }
                Exit::Done
            }
            Ok(Err(reason)) => refused(name, &reason, format),
            Err(unheard) => {
                let pid = found.opened.pid;
                refused(name, &format!("the scheduler of `{name}` (process {pid}): {unheard}"), format)
            }
        }
    })
}

fn refused(mission: &SessionId, reason: &str, format: Format) -> Exit {
    match format {
        Format::Json => {
            console::print_json(&serde_json::json!({"mission": mission, "error": reason}));
            Exit::Failed
        }
        Format::Text => failed(&format!("no go: {reason}")),
    }
}
