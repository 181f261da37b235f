//! Asks for the passphrase of the authority's key, and `downbeat keys passphrase`, which changes it.

use std::fs::OpenOptions;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use downbeat_scripts::shown::shown;

use super::keys::FolderArgs;
use super::{Format, console};
use crate::keys::{KeysError, Passphrase, PassphraseError};

/// The environment variable that contains the path of a file with the passphrase. No variable contains the passphrase itself, because
/// other processes of the user can read the variables of a process, and programs that it starts inherit them.
const FILE: &str = "DOWNBEAT_PASSPHRASE_FILE";

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Asks for the present passphrase, if the key has one, and twice for the new one. DOWNBEAT_PASSPHRASE_FILE names a file whose \
first line is the present passphrase, or the new one of a key that has none.

Examples:
  downbeat keys passphrase
  downbeat keys passphrase --remove"
)]
pub(super) struct PassphraseArgs {
    #[command(flatten)]
    folder: FolderArgs,
    /// Store the key without a passphrase.
    #[arg(long, conflicts_with = "new")]
    remove: bool,
    /// Read the new passphrase from the first line of this file.
    #[arg(long, value_name = "FILE")]
    new: Option<PathBuf>,
}

fn in_named_file() -> Option<Result<Passphrase, PassphraseError>> {
    let path = super::identity::named_by(FILE)?;
    Some(Passphrase::in_file(&path))
}

/// Returns the passphrase of the key in this file, from the named file or from the terminal.
pub(super) fn ask(key: &Path) -> Result<Passphrase, PassphraseError> {
    in_named_file().unwrap_or_else(|| {
        let prompt = format!("passphrase for {}: ", shown(&key.display().to_string()));
        typed(&prompt, || PassphraseError::Unknown(key.into()))
    })
}

/// Returns a new passphrase for the key in this file, from the named file or, entered twice, from the terminal.
pub(super) fn ask_new(key: &Path) -> Result<Passphrase, PassphraseError> {
    in_named_file().unwrap_or_else(|| type_new(key))
}

fn type_new(key: &Path) -> Result<Passphrase, PassphraseError> {
    let prompt = format!("new passphrase for {}: ", shown(&key.display().to_string()));
    let no_terminal = || PassphraseError::Terminal(io::Error::other("standard input is not a terminal"));
    let first = typed(&prompt, no_terminal)?;
    let second = typed("the same passphrase again: ", no_terminal)?;
    if first == second { Ok(first) } else { Err(PassphraseError::Different) }
}

/// Reads a passphrase from the terminal, without showing it.
fn typed(prompt: &str, no_terminal: impl Fn() -> PassphraseError) -> Result<Passphrase, PassphraseError> {
    if !io::stdin().is_terminal() {
        return Err(no_terminal());
    }
    // Ctrl-C must not end the process before the terminal shows its input again.
    let is_asking = Arc::new(AtomicBool::new(false));
    let ends =
        signal_hook::flag::register_conditional_default(signal_hook::consts::SIGINT, Arc::clone(&is_asking));
    ends.map_err(PassphraseError::Terminal)?;
    let typed = rpassword::prompt_password(prompt);
    is_asking.store(true, Ordering::Relaxed);
    // The terminal does not show the end of the line either.
    if let Ok(mut terminal) = OpenOptions::new().write(true).open("/dev/tty") {
        let _has_gone = writeln!(terminal);
    }
    Passphrase::new(typed.map_err(PassphraseError::Terminal)?)
}

pub(super) fn passphrase(args: &PassphraseArgs, format: Format) -> Result<(), KeysError> {
    let authority = args.folder.open()?;
    let had_one = authority.has_passphrase()?;
    let new = |key: &Path| match &args.new {
        Some(path) => Passphrase::in_file(path),
        None if had_one => type_new(key),
        None => ask_new(key),
    };
    let paths = if args.remove { authority.remove_passphrase()? } else { authority.set_passphrase(new)? };
    match format {
        Format::Json => {
            console::print_json(&serde_json::json!({ "keys": paths, "has_passphrase": !args.remove }));
        }
        Format::Text => {
            let state = if args.remove {
                "has no passphrase"
            } else if had_one {
                "has a new passphrase; earlier copies of the file keep the old one"
            } else {
                "has a passphrase; delete earlier copies of the file, which have none"
            };
            for path in &paths {
                console::print(&format!("{} {state}\n", shown(&path.display().to_string())));
            }
        }
    }
    Ok(())
}
