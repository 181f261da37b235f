//! `downbeat dry-run`: the mission in virtual time.

use std::path::{Path, PathBuf};

use downbeat_scripts::{Fleet, Plan};

use super::load;
use super::{Exit, Format, ScenarioArgs, console};
use crate::dry_run::Played;
use crate::fleet;
use crate::mission::{Mission, MissionOptions};
use crate::report::{picture, report_text};

/// Play a scenario in virtual time, with simulated robots and the real mission machine.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "No sockets and no waiting: an hour of show takes moments. The robots are simulated as the fleet file
describes them, with their clocks, delays and faults, whatever their address.

Examples:
  downbeat dry-run scripts/examples/swap.yaml
  downbeat dry-run scripts/examples/dance.yaml --picture dance.svg
  downbeat dry-run scripts/examples/meeting.yaml --act finale"
)]
pub(super) struct DryRunArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Play this act alone, instead of all along the main line.
    #[arg(long, value_name = "NAME")]
    act: Option<String>,
    /// Draw what every device did over time, as SVG; of several acts one file each, numbered.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Of the random delays and clock errors; the same seed gives the same run.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

pub(super) fn dry_run(args: &DryRunArgs, format: Format) -> Exit {
    let (choreography, fleet) = match load::load_choreography(&args.scenario, format) {
        Ok(loaded) => loaded,
        Err(exit) => return exit,
    };
    let acts = match load::acts(&choreography, args.act.as_deref()) {
        Ok(acts) => acts,
        Err(exit) => return exit,
    };
    let mut reports = Vec::with_capacity(acts.len());
    let mut ended = Exit::Done;
    for (index, act) in acts.iter().enumerate() {
        let played = match play(&act.plan, &fleet, args.seed) {
            Ok(played) => played,
            Err(error) => {
                console::error(&error);
                return Exit::Failed;
            }
        };
        if let Some(path) = &args.picture {
            let path = if acts.len() > 1 { numbered(path, index + 1) } else { path.clone() };
            if let Err(error) =
                std::fs::write(&path, picture::draw(act, &fleet::robots_of(&fleet, &act.plan), &played))
            {
                console::error(&format!("cannot write {}: {error}", path.display()));
                return Exit::Usage;
            }
        }
        ended = super::run::exit_of(&played.report);
        if format == Format::Text {
            console::print(&report_text(&played.report));
        }
        reports.push(played.report);
        if ended != Exit::Done {
            break;
        }
    }
    match (format, reports.as_slice()) {
        (Format::Json, [only]) => console::print_json(only),
        (Format::Json, several) => console::print_json(&several),
        (Format::Text, _) => {}
    }
    ended
}

/// `swap.svg` as `swap-2.svg`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
    path.with_file_name(format!("{stem}-{number}{extension}"))
}

/// One act as a mission of its own.
fn play(plan: &Plan, fleet: &Fleet, seed: u64) -> Result<Played, String> {
    let robots = fleet::robots_of(fleet, plan);
    let machines: Result<Vec<_>, _> = robots
        .iter()
        .enumerate()
        .map(|(index, robot)| fleet::simulated(robot, seed.wrapping_add(index as u64)))
        .collect();
    let machines = machines.map_err(|error| error.to_string())?;
    let options = MissionOptions { greeting: fleet::greeting(fleet), ..MissionOptions::default() };
    let mission = Mission::new(plan.clone(), fleet::participants(&robots), options, crate::dry_run::BEGIN);
    Ok(crate::dry_run::play(mission.map_err(|error| error.to_string())?, machines))
}
