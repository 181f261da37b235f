//! `downbeat dry-run`: the mission in virtual time.

use std::path::{Path, PathBuf};

use downbeat_scripts::shown::within;
use downbeat_scripts::{Choreography, Fleet, counted};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use urrcp::{DeviceId, RobotId, Server, Timestamp};

use super::choice::{self, ChoiceArgs};
use super::load;
use super::{Exit, Format, ScenarioArgs, console};
use crate::dry_run::{Audience, Cut, Logs, Played, ROUNDS, Rehearsal};
use crate::fleet;
use crate::mission::{MissionOptions, Progress};
use crate::report::{picture, report_text};

/// Play a scenario in virtual time, with simulated robots and the real mission machine.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "No sockets and no waiting: an hour of show takes moments. The robots are simulated as the fleet file
describes them, with their clocks, delays and faults, whatever their address. The operator says go a
second after an act has begun to wait with nothing else playing; a sensor that an act waits for reads
what it waits for, unless --reading says otherwise. Acts that repeat for ever end after a while.

Examples:
  downbeat dry-run scripts/examples/swap.yaml
  downbeat dry-run scripts/examples/dance.yaml --picture dance.svg
  downbeat dry-run scripts/examples/meeting.yaml --act finale
  downbeat dry-run scripts/examples/meeting.yaml --acts 12
  downbeat dry-run scripts/examples/meeting.yaml --reading rover-1/range=2.5"
)]
pub(super) struct DryRunArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    choice: ChoiceArgs,
    /// What a sensor reads, as rover-1/range=0.4.
    #[arg(long, value_name = "ROBOT/SENSOR=VALUE", value_parser = reading)]
    reading: Vec<(RobotId, DeviceId, f64)>,
    /// Draw what every device did over time, as SVG; of several acts one file each, numbered.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// End after so many acts; by default after three times as many as the scenario has, which only a loop reaches.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    acts: Option<u32>,
    /// Of the random delays and clock errors; the same seed gives the same run.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

fn reading(text: &str) -> Result<(RobotId, DeviceId, f64), String> {
    let parsed = text.split_once('=').and_then(|(whose, value)| {
        let (robot, sensor) = whose.split_once('/')?;
        let value = value.parse::<f64>().ok().filter(|value| value.is_finite())?;
        Some((robot.parse().ok()?, sensor.parse().ok()?, value))
    });
    parsed.ok_or_else(|| format!("`{text}`, expected a robot, a sensor and a number, as rover-1/range=0.4"))
}

pub(super) fn dry_run(args: &DryRunArgs, format: Format) -> Exit {
    let (choreography, fleet, _) = match load::load_choreography(&args.scenario, format) {
        Ok(loaded) => loaded,
        Err(exit) => return exit,
    };
    let (choreography, first_act) = match choice::choose(choreography, &fleet, &args.choice.asked()) {
        Ok(chosen) => chosen,
        Err(exit) => return exit,
    };
    let bar = Bar::new(format);
    let played = play(args, &choreography, first_act, &fleet, &mut bar.clone());
    bar.0.finish_and_clear();
    let played = match played {
        Ok(played) => played,
        Err((exit, error)) => {
            console::error(&error);
            return exit;
        }
    };
    if let Some(path) = &args.picture
        && let Err(error) = draw(path, &choreography, &fleet, &played)
    {
        console::error(&format!("cannot write {}: {error}", path.display()));
        return Exit::Usage;
    }
    match format {
        Format::Text => console::print(&report_text(&played.report, console::columns())),
        Format::Json => console::print_json(&played.report),
    }
    if let Some(cut) = &played.cut {
        console::note(&cut_text(cut));
    }
    if let Some(acts) = played.report.acts_max_reached.filter(|_| args.acts.is_none()) {
        let acts = counted(acts as usize, "act");
        console::note(&format!(
            "a dry run plays {ROUNDS} times as many acts as the scenario has, here {acts}; --acts sets another bound"
        ));
    }
    super::run::exit_of(&played.report)
}

fn cut_text(cut: &Cut) -> String {
    format!(
        "stopped: `{}` waits for {}, which does not come in virtual time; --reading says what sensors read",
        cut.act, cut.awaits
    )
}

/// Virtual time on a terminal.
#[derive(Clone)]
struct Bar(ProgressBar);

impl Bar {
    fn new(format: Format) -> Self {
        let target = match format {
            Format::Text => ProgressDrawTarget::stderr(),
            Format::Json => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(None, target);
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos:>6}/{len} s of virtual time  {msg}") {
            bar.set_style(style);
        }
        Self(bar)
    }
}

impl Audience for Bar {
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress) {
        if let Progress::Decided { act, start, duration, .. } = progress {
            let left = (*start + *duration - at).to_duration().as_secs();
            self.0.set_length(self.0.position() + left);
            self.0.set_message(format!("`{}`", within(act, 30)));
        }
    }

    fn second(&mut self, _: Timestamp<Server>) {
        self.0.inc(1);
    }
}

fn draw(path: &Path, choreography: &Choreography, fleet: &Fleet, played: &Played) -> std::io::Result<()> {
    let several = played.report.acts.len() > 1;
    for (index, reported) in played.report.acts.iter().enumerate() {
        let path = if several { numbered(path, index + 1) } else { path.to_path_buf() };
        let Some(act) = choreography.acts.iter().find(|act| act.is_named(&reported.act)) else { continue };
        let robots = fleet::robots_of(fleet, &act.plan);
        std::fs::write(&path, picture::draw(act, reported, &robots, played))?;
    }
    Ok(())
}

/// `swap.svg` as `swap-2.svg`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
    path.with_file_name(format!("{stem}-{number}{extension}"))
}

fn play(
    args: &DryRunArgs,
    choreography: &Choreography,
    first_act: usize,
    fleet: &Fleet,
    bar: &mut Bar,
) -> Result<Played, (Exit, String)> {
    let robots = fleet::robots_in(fleet, choreography);
    let machines: Result<Vec<_>, _> = robots
        .iter()
        .enumerate()
        .map(|(index, robot)| fleet::rehearsed(robot, args.seed.wrapping_add(index as u64)))
        .collect();
    let machines = machines.map_err(|error| (Exit::Failed, error.to_string()))?;
    let options = MissionOptions {
        greeting: fleet::greeting(fleet),
        first_act,
        acts_max: args.acts,
        ..MissionOptions::default()
    };
    let mut rehearsal = Rehearsal::new(choreography.clone(), fleet::participants(&robots), options, machines)
        .map_err(|error| (Exit::Failed, error.to_string()))?;
    for (robot, sensor, value) in &args.reading {
        if !rehearsal.set_reading(robot, sensor, *value) {
            let what = format!(
                "--reading: no robot that takes part is called `{robot}` and has a sensor `{sensor}`"
            );
            return Err((Exit::Usage, what));
        }
    }
    let logs = if args.picture.is_some() { Logs::Kept } else { Logs::Dropped };
    Ok(rehearsal.with_logs(logs).play_before(bar))
}
