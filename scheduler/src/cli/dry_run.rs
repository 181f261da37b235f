//! `downbeat dry-run`: the mission in virtual time.

use std::path::PathBuf;

use super::load;
use super::{Exit, Format, ScenarioArgs, console};
use crate::fleet;
use crate::mission::{Mission, MissionOptions};
use crate::report::picture;

/// Play a scenario in virtual time, with simulated robots and the real mission machine.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "No sockets and no waiting: an hour of show takes moments. The robots are simulated as the fleet file
describes them, with their clocks, delays and faults, whatever their address.

Examples:
  downbeat dry-run scripts/examples/swap.yaml
  downbeat dry-run scripts/examples/dance.yaml --picture dance.svg"
)]
pub(super) struct DryRunArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Draw what every device did over time, as SVG.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Of the random delays and clock errors; the same seed gives the same run.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

pub(super) fn dry_run(args: &DryRunArgs, format: Format) -> Exit {
    let (plan, fleet) = match load::load_plan(&args.scenario, format) {
        Ok(loaded) => loaded,
        Err(exit) => return exit,
    };
    let robots = fleet::robots_of(&fleet, &plan);
    let machines: Result<Vec<_>, _> = robots
        .iter()
        .enumerate()
        .map(|(index, robot)| fleet::simulated(robot, args.seed.wrapping_add(index as u64)))
        .collect();
    let machines = match machines {
        Ok(machines) => machines,
        Err(error) => {
            console::error(&error.to_string());
            return Exit::Failed;
        }
    };
    let options = MissionOptions { greeting: fleet::greeting(&fleet), ..MissionOptions::default() };
    let mission = Mission::new(plan.clone(), fleet::participants(&robots), options, crate::dry_run::BEGIN);
    let played = match mission {
        Ok(mission) => crate::dry_run::play(mission, machines),
        Err(error) => {
            console::error(&error.to_string());
            return Exit::Failed;
        }
    };
    if let Some(path) = &args.picture {
        let drawing = picture::draw(&plan, &played);
        if let Err(error) = std::fs::write(path, drawing) {
            console::error(&format!("cannot write {}: {error}", path.display()));
            return Exit::Usage;
        }
    }
    super::run::finish(&played.report, format)
}
