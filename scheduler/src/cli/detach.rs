//! `downbeat run --detach`: the mission goes on as a process of its own, away from the terminal, with its own log.

use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use downbeat_scripts::shown::shown;
use downbeat_scripts::{Attempt, Refusal};
use rustix::process::{Pid, Signal, kill_process};
use urrcp::SessionId;

use super::{Exit, Format, console};
use crate::journal::has_begun;
use crate::journal::private::{self, How};
use crate::run::control;
use crate::signals::{OnHangUp, Signals};

/// Tells the process in the background the name of its mission.
const NAME: &str = "DOWNBEAT_DETACHED_AS";
/// Its log, in its folder.
const LOG: &str = "log";
/// How often it is looked whether the mission has begun.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// A mission that has begun has its socket within so many looks, or never: it plays without one, too.
const LOOKS_FOR_SOCKET: u32 = 25;

/// The mission's name, in the process that runs in the background. It leaves the terminal here.
pub(super) fn detached_as() -> Option<SessionId> {
    let session = std::env::var(NAME).ok()?.parse().ok()?;
    if let Err(error) = rustix::process::setsid() {
        console::warn(&format!("the mission still belongs to its terminal: {error}"));
    }
    Some(session)
}

/// Starts this very command again in the background, and waits until its fleet is checked and it can be stopped from other
/// terminals. One that ends before that tells why, by what it printed and by its exit code.
pub(super) fn detach(session: &SessionId, state: &Path, format: Format) -> Exit {
    let folder = &state.join(session.as_str());
    let log = folder.join(LOG);
    let mut child = match start(session, state, folder) {
        Ok(child) => child,
        Err(error) => {
            console::error(&format!(
                "cannot start a mission in the background with the log {}: {}; DOWNBEAT_STATE names the folder",
                log.display(),
                Refusal::of(Attempt::Write(&log), &error)
            ));
            return Exit::Usage;
        }
    };
    super::with_runtime(async {
        let mut signals = Signals::listen(OnHangUp::End).ok();
        let mut looks = 0;
        loop {
            if let Ok(Some(status)) = child.try_wait() {
                console::note_block(&logged(folder).unwrap_or_default());
                return status.code().map_or(Exit::Failed, Exit::of_code);
            }
            looks += u32::from(has_begun(folder));
            if looks > 0 && control::socket(folder).exists() || looks > LOOKS_FOR_SOCKET {
                announce(session, child.id(), log, format);
                return Exit::Done;
            }
            if asked_to_stop(signals.as_mut()).await {
                let _ended = kill_process(Pid::from_child(&child), Signal::TERM);
            }
        }
    })
}

/// Waits a moment. Returns whether the operator wants the mission to stop, which nobody else can be told yet.
async fn asked_to_stop(signals: Option<&mut Signals>) -> bool {
    let asked = async {
        match signals {
            Some(signals) => drop(signals.next().await),
            None => std::future::pending().await,
        }
    };
    tokio::time::timeout(LOOK_EVERY, asked).await.is_ok()
}

fn start(session: &SessionId, state: &Path, folder: &Path) -> io::Result<Child> {
    private::create_folder(state)?;
    private::create_folder(folder)?;
    let out = private::file(folder, LOG, How::Create)?;
    let mut command = Command::new(std::env::current_exe()?);
    command.args(std::env::args_os().skip(1)).env(NAME, session.as_str());
    command.stdin(Stdio::null()).stdout(out.try_clone()?).stderr(out).spawn()
}

/// What the process in the background has said.
fn logged(folder: &Path) -> io::Result<String> {
    let mut text = String::new();
    private::file(folder, LOG, How::Read)?.read_to_string(&mut text)?;
    Ok(text)
}

fn announce(session: &SessionId, process: u32, log: PathBuf, format: Format) {
    match format {
        Format::Json => {
            console::print_json(&serde_json::json!({"mission": session, "process": process, "log": log}));
        }
        Format::Text => console::print(&format!(
            "mission {session} runs in the background, process {process}\n  follow it: tail -f {}\n  stop it:   downbeat stop {session}\n",
            shown(&log.display().to_string())
        )),
    }
}
