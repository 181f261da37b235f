//! `downbeat dry-run --world` and `--trials`: plays the mission under the conditions of a world file, once or many times.

use std::path::Path;
use std::time::Duration;

use downbeat_scripts::{Act, Choreography, Finding, Fleet, World, read_world};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::{Exit, Format, console, load};
use crate::show::trials_text;
use crate::trials::{Results, Trials};

/// Reads a world file. Without one, returns the world that the fleet file implies.
pub(super) fn world(
    path: Option<&Path>,
    fleet: &Fleet,
    choreography: &Choreography,
    format: Format,
) -> Result<World, Exit> {
    let Some(path) = path else { return Ok(World::default()) };
    let acts: Vec<&str> = choreography.acts.iter().map(Act::called).collect();
    let (world, findings) = read_world(path, fleet, &acts);
    match format {
        Format::Text => load::show_findings(&findings),
        Format::Json if world.is_none() => {
            console::print_json(&serde_json::json!({ "findings": findings }));
        }
        Format::Json => {}
    }
    let unreadable = findings.iter().any(Finding::is_about_access);
    world.ok_or(if unreadable { Exit::Usage } else { Exit::Failed })
}

/// Plays all trials, with a progress bar on the terminal.
pub(super) fn play(trials: &Trials<'_>, count: u32, format: Format) -> Result<Results, Exit> {
    let bar = bar(count, format);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let played = trials.play(count, threads, |over| {
        bar.set_position(u64::from(over));
        true
    });
    bar.finish_and_clear();
    played.map_err(|error| {
        console::error(&error.to_string());
        Exit::Failed
    })
}

fn bar(count: u32, format: Format) -> ProgressBar {
    let target = match format {
        Format::Text => ProgressDrawTarget::stderr(),
        Format::Json => ProgressDrawTarget::hidden(),
    };
    let bar = ProgressBar::with_draw_target(Some(u64::from(count)), target);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos:>6}/{len} trials  {eta} left") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// Prints the results of the trials.
pub(super) fn print(results: &Results, format: Format) {
    match format {
        Format::Text => console::print(&trials_text(results, console::columns())),
        Format::Json => console::print_json(results),
    }
}
