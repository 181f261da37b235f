//! Opens the journal of a new mission. The operator can stop the mission even while the disk stalls.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use downbeat_scripts::{Address, Attempt, FleetRobot, Refusal};
use tokio::sync::mpsc;

use super::{Stopped, failed, usage};
use crate::cli::Exit;
use crate::journal::{self, Journal, Opened, OpenedRobot};
use crate::server_clock::ServerClock;
use crate::stop_lane::Operator;

/// Removes old journals and begins the journal of this mission.
///
/// # Errors
/// Fails if the disk refuses the journal, or if the operator stops the mission first.
pub(super) async fn begin(
    state: PathBuf,
    opened: Opened,
    clock: ServerClock,
    operator: &mut mpsc::Receiver<Operator>,
) -> Result<Journal, Stopped> {
    let opening = move || {
        journal::forget_old(&state);
        journal::create_state_folder(&state).map_err(|error| unwritable(&state, &error))?;
        open_journal(&state.join(opened.session.as_str()), &opened, &clock)
    };
    unless_stopped(operator, opening).await?.map_err(usage)
}

/// Runs `work` on another thread, because the disk may stall. Does not wait for the end of `work` if the operator stops the mission.
async fn unless_stopped<T: Send + 'static>(
    operator: &mut mpsc::Receiver<Operator>,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Stopped> {
    let mut working = tokio::task::spawn_blocking(work);
    loop {
        tokio::select! {
            done = &mut working => return done.map_err(|error| failed(error.to_string())),
            Some(word) = operator.recv() => if matches!(word, Operator::Stop { .. } | Operator::Leave) {
                let message = "stopped by the operator while the journal was being opened; nothing was sent";
                return Err((message.to_owned(), Exit::Stopped));
            },
        }
    }
}

/// Returns the data of a robot that the journal must contain, so that a stop needs only the journal.
pub(super) fn opened_robot(robot: &FleetRobot) -> OpenedRobot {
    let is_driven = robot.address.is_driven() || matches!(robot.address, Address::Program { .. });
    let (init, limits) =
        if is_driven { (robot.init.clone(), robot.limits.clone()) } else { (None, BTreeMap::new()) };
    let own_id = robot.init.as_ref().map(|init| init.id.clone()).filter(|own_id| *own_id != robot.id);
    OpenedRobot { robot: robot.id.clone(), own_id, address: robot.address.to_string(), init, limits }
}

fn unwritable(state: &Path, error: &std::io::Error) -> String {
    let reason = Refusal::of(Attempt::Write(state), error).reason;
    format!("cannot create the folder {} for journals: {reason}; {OTHERWISE}", state.display())
}

/// Suggestion that is printed if no journal can be written.
const OTHERWISE: &str = "set DOWNBEAT_STATE to a writable folder, or run with --no-journal";

fn open_journal(folder: &Path, opened: &Opened, clock: &ServerClock) -> Result<Journal, String> {
    let hint = |error: journal::JournalError| format!("{error}; {OTHERWISE}");
    let mut journal = Journal::open(folder).map_err(hint)?;
    journal.begin(clock.now(), opened).map_err(hint)?;
    Ok(journal)
}
