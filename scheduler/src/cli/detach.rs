//! `downbeat run --detach`: the mission continues in its own process, independent of the terminal, with its own log.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use downbeat_scripts::shown::shown;
use downbeat_scripts::{Attempt, Refusal};
use rustix::process::{Pid, Signal, kill_process};
use urrcp::SessionId;

use super::{Exit, Format, console};
use crate::journal::private::{self, How};
use crate::journal::{has_begun, state_folder};
use crate::run::control;
use crate::signals::{OnHangUp, Signals};

/// The environment variable that passes the mission's name to the background process.
const NAME: &str = "DOWNBEAT_DETACHED_AS";
/// The name of the log file in the mission's folder.
const LOG: &str = "log";
/// Interval between checks whether the mission has begun.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Interval between checks that the log can still be found under its name.
const KEEP_EVERY: Duration = Duration::from_millis(250);
/// Number of checks after which a mission that has begun is assumed to run without a control socket.
const LOOKS_FOR_SOCKET: u32 = 25;

/// If this process runs a mission in the background, detaches the process from the terminal and returns the mission's name. Otherwise
/// returns `None`.
pub(super) fn detached_as() -> Option<SessionId> {
    let session: SessionId = std::env::var(NAME).ok()?.parse().ok()?;
    if let Err(error) = rustix::process::setsid() {
        console::warn(&format!("cannot detach the mission from its terminal: {error}"));
    }
    if let Ok(state) = state_folder() {
        let folder = state.join(session.as_str());
        // The thread ends with the process.
        let keeping =
            std::thread::Builder::new().name("log".to_owned()).spawn(move || keep_log(&state, &folder));
        if let Err(error) = keeping {
            console::warn(&format!("the log will not be restored if it is removed: {error}"));
        }
    }
    Some(session)
}

/// Writes the log again whenever it is removed or replaced, because the output of the mission is stored nowhere else.
#[expect(clippy::disallowed_methods, reason = "a separate thread, only for the log")]
fn keep_log(state: &Path, folder: &Path) {
    let mut log = rustix::io::dup(rustix::stdio::stdout()).map(File::from);
    loop {
        std::thread::sleep(KEEP_EVERY);
        let Ok(written) = &log else { return };
        match log_is_gone(written, folder) {
            Ok(true) => match write_log_again(written, state, folder) {
                Ok(again) => log = Ok(again),
                Err(error) => tracing::debug!("cannot restore the log: {error}"),
            },
            Ok(false) => {}
            Err(error) => tracing::debug!("cannot check the log: {error}"),
        }
    }
}

fn log_is_gone(written: &File, folder: &Path) -> io::Result<bool> {
    let own = written.metadata()?;
    match std::fs::symlink_metadata(folder.join(LOG)) {
        Ok(found) => Ok((found.dev(), found.ino()) != (own.dev(), own.ino())),
        Err(error) => match error.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Ok(true),
            _ => Err(error),
        },
    }
}

/// Copies the log to its original path, and redirects further output to this copy. The path may already contain a copy of the log's
/// beginning.
fn write_log_again(written: &File, state: &Path, folder: &Path) -> io::Result<File> {
    private::create_folder(state)?;
    private::create_folder(folder)?;
    let mut again = private::file(folder, LOG, How::Create)?;
    let there = again.metadata()?.len();
    let copied = copy_from(written, there, &mut again)?;
    rustix::stdio::dup2_stdout(again.as_fd())?;
    rustix::stdio::dup2_stderr(again.as_fd())?;
    // Output that was printed during the first copy is copied as well.
    copy_from(written, copied, &mut again)?;
    Ok(again)
}

/// Copies all bytes of the log after the position `from`, and returns the position of its end.
fn copy_from(log: &File, mut from: u64, to: &mut File) -> io::Result<u64> {
    let mut bytes = [0; 8 * 1024];
    loop {
        match log.read_at(&mut bytes, from)? {
            0 => return Ok(from),
            n => {
                to.write_all(&bytes[..n])?;
                from += n as u64;
            }
        }
    }
}

/// Starts this command again in the background. Waits until the mission has checked its fleet and other terminals can stop it. If the
/// background process ends before that, prints its output and returns its exit code.
pub(super) fn detach(session: &SessionId, state: &Path, format: Format) -> Exit {
    let folder = &state.join(session.as_str());
    let log = folder.join(LOG);
    let mut child = match start(session, state, folder) {
        Ok(child) => child,
        Err(error) => {
            console::error(&format!(
                "cannot start the mission in the background with the log {}: {}; to use another folder, set DOWNBEAT_STATE",
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

/// Waits for [`LOOK_EVERY`], or until the operator requests a stop. Returns whether a stop was requested. At this stage, only this
/// process can receive the request.
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

/// Returns the output of the background process.
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
            "mission {session} is running in the background (process {process})\n  follow it: tail -f {}\n  stop it:   downbeat stop {session}\n",
            shown(&log.display().to_string())
        )),
    }
}
