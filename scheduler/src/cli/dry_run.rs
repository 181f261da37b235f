//! `downbeat dry-run`: plays a mission in virtual time.

use std::path::{Path, PathBuf};

use downbeat_scripts::shown::within;
use downbeat_scripts::{Attempt, Choreography, Fleet, FleetRobot, Refusal, counted};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use urrcp::{DeviceId, RobotId, Server, Timestamp};

use super::certify;
use super::choice::{self, ChoiceArgs};
use super::console::OutputArgs;
use super::load;
use super::{Exit, Format, ScenarioArgs, console, trials};
use crate::dry_run::{Audience, Cut, Logs, Played, ROUNDS, Rehearsal};
use crate::fleet;
use crate::mission::{MissionOptions, Progress};
use crate::page::{self, Rehearsed, TimedProgress};
use crate::requirements::{Figures, any_unmet, closest_of, judge};
use crate::show::local::ZONE;
use crate::show::{picture, report_text};
use crate::trials::Trials;

/// Play a scenario in virtual time with simulated robots.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A dry run opens no connections and does not wait, so an hour of a show takes only moments. All robots are \
simulated as the fleet file describes them, with their clocks, delays and faults. An act that waits for the operator begins \
one second after the previous act has ended. An act that waits for a sensor gets the reading that it waits for, unless \
--reading sets another. Acts that repeat forever end after a while. The requirements of the scenario (`require`) are checked: if one of them is not met, the \
exit code is 1.

A world file (--world) describes the conditions on the day; docs/world.md lists its keys. --trials simulates many missions in this world, and the exit code is 1 only if a requirement of the scenario is not met; --trial repeats one of them.

Examples:
  downbeat dry-run show.yaml
  downbeat dry-run show.yaml --html show.html
  downbeat dry-run show.yaml --picture show.svg
  downbeat dry-run show.yaml --act finale
  downbeat dry-run show.yaml --acts 12
  downbeat dry-run show.yaml --reading rover-1/range=2.5
  downbeat dry-run show.yaml --world friday.yaml --trials 1000 --seed 7
  downbeat dry-run show.yaml --world friday.yaml --trials 1000 --seed 7 --html friday.html
  downbeat dry-run show.yaml --world friday.yaml --seed 7 --trial 417 --html 417.html
  downbeat dry-run show.yaml --certify show.cert.json"
)]
pub(super) struct DryRunArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    choice: ChoiceArgs,
    /// Give a sensor a reading, for example rover-1/range=0.4.
    #[arg(long, value_name = "ROBOT/SENSOR=VALUE", value_parser = reading, conflicts_with_all = ["world", "trial"])]
    reading: Vec<(RobotId, DeviceId, f64)>,
    /// Draw the movements of every device over time as SVG. Several acts are written to numbered files.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Write a page for a browser: timeline, curves, and robots in space; with --trials, their results. It needs no network.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// End after this number of acts. By default, after three times the number of acts of the scenario, which only a loop reaches.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    acts: Option<u32>,
    /// The conditions of the mission: links, clocks, sensors, the operator, and faults.
    #[arg(long, value_name = "FILE")]
    world: Option<PathBuf>,
    /// Play this number of missions, each with another draw of the world, and report their results.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000), conflicts_with_all = ["reading", "picture"])]
    trials: Option<u32>,
    /// Play only this one of the trials, counted from 0.
    #[arg(long, value_name = "K", conflicts_with = "trials")]
    trial: Option<u32>,
    /// Play the plan against faults of every robot, and certify that its promises held, for `run --require-certificate`.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["reading", "picture", "html", "acts", "world", "trials", "trial"])]
    certify: Option<PathBuf>,
    /// Seed of the random delays and clock errors. The same seed gives the same run.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    output: OutputArgs,
}

fn reading(text: &str) -> Result<(RobotId, DeviceId, f64), String> {
    let parsed = text.split_once('=').and_then(|(whose, value)| {
        let (robot, sensor) = whose.split_once('/')?;
        let value = value.parse::<f64>().ok().filter(|value| value.is_finite())?;
        Some((robot.parse().ok()?, sensor.parse().ok()?, value))
    });
    parsed.ok_or_else(|| "expected ROBOT/SENSOR=NUMBER, as in rover-1/range=0.4".to_owned())
}

pub(super) fn dry_run(args: &DryRunArgs, format: Format) -> Exit {
    args.output.apply();
    let (choreography, fleet, fleet_path, findings) = match load::load_whole(&args.scenario, format) {
        Ok(loaded) => loaded,
        Err(exit) => return exit,
    };
    let (choreography, first_act) = match choice::choose(choreography, &fleet, &args.choice.asked()) {
        Ok(chosen) => chosen,
        Err(exit) => return exit,
    };
    if let Some(path) = &args.certify {
        let asked = args.choice.asked();
        let plan = certify::Plan { choreography: &choreography, fleet: &fleet, asked: &asked, first_act };
        let sources = [args.scenario.scenario.as_path(), &fleet_path];
        return certify::certify(&plan, args.seed, path, &sources, format);
    }
    let sources = [Some(args.scenario.scenario.as_path()), Some(&fleet_path), args.world.as_deref()];
    let sources: Vec<&Path> = sources.into_iter().flatten().collect();
    if let Some(error) = args.html.as_ref().and_then(|path| load::replaces(path, &sources)) {
        console::error(&error);
        return Exit::Usage;
    }
    let world = match trials::world(args.world.as_deref(), &fleet, &choreography, format) {
        Ok(world) => world,
        Err(exit) => return exit,
    };
    if let Some(count) = args.trials {
        let options = options(args, &fleet, first_act);
        let trials = Trials::new(&choreography, &fleet, &world, options, args.seed);
        return match trials::play(&trials, count, format) {
            Ok(results) => {
                let page =
                    |path| page::of_trials(&results, &args.replay()).and_then(|text| page::save(path, &text));
                if let Some((path, Err(error))) = args.html.as_ref().map(|path| (path, page(path))) {
                    return not_written(path, &error);
                }
                trials::print(&results, format);
                if any_unmet(&results.requirements) { Exit::Failed } else { Exit::Done }
            }
            Err(exit) => exit,
        };
    }
    let mut viewers = Viewers { bar: Bar::new(format), told: args.html.is_some().then(Vec::new) };
    let options = options(args, &fleet, first_act);
    let played = if args.world.is_some() || args.trial.is_some() {
        Trials::new(&choreography, &fleet, &world, options, args.seed)
            .play_one(args.trial.unwrap_or_default(), args.logs(), &mut viewers)
            .map_err(|error| (Exit::Failed, error.to_string()))
    } else {
        let choice = Choice { readings: &args.reading, seed: args.seed, logs: args.logs() };
        play(&choice, &choreography, options, &fleet, &mut viewers)
    };
    viewers.bar.0.finish_and_clear();
    let mut played = match played {
        Ok(played) => played,
        Err((exit, error)) => {
            console::error(&error);
            return exit;
        }
    };
    let required = judge(&choreography.requirements, &figures(&choreography, &played));
    let unmet = any_unmet(&required);
    played.report.requirements = required;
    let drawn = args.picture.as_ref().map(|path| (path, draw(path, &choreography, &fleet, &played)));
    let page = args.html.as_ref().map(|path| {
        let outline = load::outline(&args.scenario, &fleet);
        let told = viewers.told.unwrap_or_default();
        let rehearsed = Rehearsed {
            choreography: &choreography,
            outline: &outline,
            fleet: &fleet,
            findings: &findings,
            played: &played,
            told: &told,
        };
        (path, page::of_dry_run(&rehearsed).and_then(|text| page::save(path, &text)))
    });
    for (path, written) in drawn.into_iter().chain(page) {
        if let Err(error) = written {
            return not_written(path, &error);
        }
    }
    match format {
        Format::Text => console::print(&report_text(&played.report, console::detail(), console::columns())),
        Format::Json => console::print_json(&played.report),
    }
    if let Some(cut) = &played.cut {
        console::note(&cut_text(cut));
    }
    if let Some(acts) = played.report.acts_max_reached.filter(|_| args.acts.is_none()) {
        let acts = counted(acts as usize, "act");
        console::note(&format!(
            "the dry run ended after {acts} ({ROUNDS} times the number of acts in the scenario); --acts sets another limit"
        ));
    }
    if unmet { Exit::Failed } else { super::run::exit_of(&played.report) }
}

fn not_written(path: &Path, error: &std::io::Error) -> Exit {
    let refusal = Refusal::of(Attempt::Write(path), error);
    console::error(&format!("cannot write `{}`: {refusal}", path.display()));
    Exit::Usage
}

/// Returns the figures of one run that the scenario's requirements refer to.
fn figures(choreography: &Choreography, played: &Played) -> Figures {
    Figures {
        spread_max: played.report.largest_true_spread(),
        closest: closest_of(choreography),
        ..Figures::default()
    }
}

/// Plays a whole scenario in virtual time, for an HTML page.
pub(super) fn rehearse(
    choreography: &Choreography,
    fleet: &Fleet,
    format: Format,
) -> Result<(Played, Vec<TimedProgress>), (Exit, String)> {
    let mut viewers = Viewers { bar: Bar::new(format), told: Some(Vec::new()) };
    let whole = Choice { readings: &[], seed: 0, logs: Logs::Kept };
    let options = MissionOptions {
        greeting: fleet::greeting(fleet),
        zone: ZONE,
        transfer: Some(fleet::transfer(fleet)),
        ..MissionOptions::default()
    };
    let played = play(&whole, choreography, options, fleet, &mut viewers);
    viewers.bar.0.finish_and_clear();
    Ok((played?, viewers.told.unwrap_or_default()))
}

/// The options of a dry run, taken from the command line.
struct Choice<'a> {
    readings: &'a [(RobotId, DeviceId, f64)],
    seed: u64,
    logs: Logs,
}

fn cut_text(cut: &Cut) -> String {
    format!(
        "stopped: `{}` waits for {}, which never happens in virtual time; --reading sets sensor readings",
        cut.act, cut.awaits
    )
}

/// The recipients of a dry run's progress reports.
struct Viewers {
    bar: Bar,
    /// The collected progress reports. `None` if no HTML page needs them.
    told: Option<Vec<TimedProgress>>,
}

impl Audience for Viewers {
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress) {
        self.bar.told(at, progress);
        if let Some(told) = &mut self.told {
            told.push((at, progress.clone()));
        }
    }

    fn second(&mut self, now: Timestamp<Server>) {
        self.bar.second(now);
    }
}

/// A progress bar that shows virtual time on a terminal.
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

/// Adds a number to a file name: returns `swap-2.svg` for `swap.svg`, for example.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
    path.with_file_name(format!("{stem}-{number}{extension}"))
}

/// Returns an error message for a reading of an unknown sensor, with the sensors that exist.
fn no_sensor(robot: &RobotId, sensor: &DeviceId, robots: &[&FleetRobot]) -> String {
    let sensors = robots.iter().flat_map(|robot| {
        let devices = robot.init.iter().flat_map(|init| &init.devices);
        let sensors = devices.filter(|device| device.available_control_types.sensor().is_some());
        sensors.map(|device| format!("`{}/{}`", robot.id, device.id))
    });
    let known: Vec<String> = sensors.collect();
    if known.is_empty() {
        format!(
            "--reading: unknown sensor `{robot}/{sensor}`; no robot of this scenario has a sensor, so leave out --reading"
        )
    } else {
        format!("--reading: unknown sensor `{robot}/{sensor}`; the sensors are {}", known.join(", "))
    }
}

impl DryRunArgs {
    const fn logs(&self) -> Logs {
        if self.picture.is_some() || self.html.is_some() { Logs::Kept } else { Logs::Dropped }
    }

    /// Returns the words of the command that plays one of the trials again, except for `--trial K`.
    fn replay(&self) -> Vec<String> {
        let mut words = vec!["downbeat".to_owned(), "dry-run".to_owned(), named(&self.scenario.scenario)];
        let mut add = |option: &str, value: Option<String>| {
            words.extend(value.into_iter().flat_map(|value| [option.to_owned(), value]));
        };
        add("--fleet", self.scenario.fleet.as_deref().map(named));
        let asked = self.choice.asked();
        add("--act", asked.act);
        add("--from", asked.from);
        let only: Vec<&str> = asked.only.iter().map(RobotId::as_str).collect();
        add("--only", (!only.is_empty()).then(|| only.join(",")));
        add("--speed", asked.speed.map(|speed| speed.to_string()));
        add("--acts", self.acts.map(|acts| acts.to_string()));
        add("--world", self.world.as_deref().map(named));
        add("--seed", Some(self.seed.to_string()));
        words
    }
}

fn named(path: &Path) -> String {
    path.display().to_string()
}

fn options(args: &DryRunArgs, fleet: &Fleet, first_act: usize) -> MissionOptions {
    MissionOptions {
        greeting: fleet::greeting(fleet),
        first_act: first_act.into(),
        acts_max: args.acts,
        zone: ZONE,
        transfer: Some(fleet::transfer(fleet)),
        ..MissionOptions::default()
    }
}

fn play(
    choice: &Choice<'_>,
    choreography: &Choreography,
    options: MissionOptions,
    fleet: &Fleet,
    viewers: &mut Viewers,
) -> Result<Played, (Exit, String)> {
    let robots = fleet::robots_in(fleet, choreography);
    let machines: Result<Vec<_>, _> = robots
        .iter()
        .enumerate()
        .map(|(index, robot)| fleet::rehearsed(robot, choice.seed.wrapping_add(index as u64)))
        .collect();
    let machines = machines.map_err(|error| (Exit::Failed, error.to_string()))?;
    let mut rehearsal = Rehearsal::new(choreography.clone(), fleet::participants(&robots), options, machines)
        .map_err(|error| (Exit::Failed, error.to_string()))?;
    for (robot, sensor, value) in choice.readings {
        if !rehearsal.set_reading(robot, sensor, *value) {
            return Err((Exit::Usage, no_sensor(robot, sensor, &robots)));
        }
    }
    Ok(rehearsal.with_logs(choice.logs).play_before(viewers))
}
