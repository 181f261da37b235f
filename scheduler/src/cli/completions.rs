//! `downbeat completions` and `downbeat man`: write the shell completions and man pages that a package installs with the program.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use clap::CommandFactory;
use clap_complete::Shell;
use downbeat_scripts::{Attempt, Refusal};

use super::{Cli, Exit, console};

/// Print completions for a shell.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat completions bash > ~/.local/share/bash-completion/completions/downbeat
  downbeat completions zsh > ~/.zfunc/_downbeat
  downbeat completions fish > ~/.config/fish/completions/downbeat.fish")]
pub(super) struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    shell: Shell,
}

pub(super) fn completions(args: &CompletionsArgs) -> Exit {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "downbeat", &mut script);
    console::print(&String::from_utf8_lossy(&script));
    Exit::Done
}

/// Write the man pages, one for each command.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  downbeat man ~/.local/share/man/man1")]
pub(super) struct ManArgs {
    /// The folder to write to. It is created if it does not exist.
    folder: PathBuf,
}

pub(super) fn man(args: &ManArgs) -> Exit {
    match write_pages(&args.folder) {
        Ok(()) => Exit::Done,
        Err(error) => {
            let refusal = Refusal::of(Attempt::Write(&args.folder), &error);
            console::error(&format!("cannot write the man pages to `{}`: {refusal}", args.folder.display()));
            Exit::Usage
        }
    }
}

fn write_pages(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    clap_mangen::generate_to(Cli::command(), folder)
}
