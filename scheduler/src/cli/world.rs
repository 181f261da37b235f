//! `downbeat world`: writes a world file from a recorded mission, so that trials can use the network conditions of that mission.

use std::path::{Path, PathBuf};

use downbeat_scripts::{Attempt, Refusal, counted};

use super::{Exit, Format, console, load, report};
use crate::measured::{self, Measured};
use crate::page;

/// Write a world file from a recording: delays, losses and clocks as measured.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A recording (`downbeat run --record`) contains the answers of the robots and their times. A journal contains only the offsets of \
clocks that do not follow NTP. The comments of the file list what was measured, how often, and what was not. An incomplete file, \
for example after a power failure, is refused; --partial measures the part before the damage.

Examples:
  downbeat world show.mcap
  downbeat world show.mcap --output friday.yaml
  downbeat world show.mcap --format json"
)]
pub(super) struct WorldArgs {
    /// A recording, a journal, or the folder of a mission.
    #[arg(value_name = "RUN")]
    file: PathBuf,
    /// The file to write. By default, the world is printed.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Replace the file if it exists.
    #[arg(long, requires = "output")]
    force: bool,
    /// Measure the part before the damage of a file that is not whole.
    #[arg(long)]
    partial: bool,
}

pub(super) fn world(args: &WorldArgs, format: Format) -> Exit {
    let history = match report::read(&args.file, args.partial, "measures") {
        Ok(history) => history,
        Err(exit) => return exit,
    };
    let measured = match Measured::of(&history) {
        Ok(measured) => measured,
        Err(error) => return refused(&format!("`{}`: {error}", args.file.display())),
    };
    let name = args.file.file_name().unwrap_or(args.file.as_os_str()).to_string_lossy();
    let text = measured::world_text(&measured, &name);
    if let Some(path) = &args.output {
        if let Err(error) = save(args, path, &text) {
            return refused(&error);
        }
        let links = measured.robots.iter().filter(|robot| robot.link.is_some()).count();
        console::note(&format!("wrote {}: {} measured", path.display(), counted(links, "link")));
    }
    match format {
        Format::Json => console::print_json(&measured),
        Format::Text if args.output.is_none() => console::print(&text),
        Format::Text => {}
    }
    Exit::Done
}

fn save(args: &WorldArgs, path: &Path, text: &str) -> Result<(), String> {
    if let Some(error) = load::replaces(path, &[&args.file]) {
        return Err(error);
    }
    if !args.force && path.is_file() {
        return Err(format!("`{}` already exists; --force replaces it", path.display()));
    }
    page::save(path, text).map_err(|error| {
        let refusal = Refusal::of(Attempt::Write(path), &error);
        format!("cannot write `{}`: {refusal}", path.display())
    })
}

fn refused(error: &str) -> Exit {
    console::error(error);
    Exit::Usage
}
