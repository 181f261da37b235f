//! `downbeat import`: converts choreography files of other tools into a scenario and its fleet.

mod describe;
mod write;

use describe::Described;
pub(super) use write::write_all;

use std::path::PathBuf;

use clap::builder::PossibleValue;
use downbeat_import::{
    Decimal, ImportFormat, ImportOptions, ImportOutcome, Imported, Scenes, TimeUnit, files_of, scenario_text,
    steps_written,
};
use downbeat_scripts::{Finding, Source, counted};
use serde::Serialize;
use urrcp::Span;

use super::load::show_findings;
use super::run::parse_span;
use super::{Exit, Format, console};

/// Convert files of other tools into a scenario and its fleet.
#[derive(Debug, clap::Args)]
#[command(after_help = after_help())]
pub(super) struct ImportArgs {
    /// The format of the files.
    #[arg(value_name = "FORMAT")]
    from: From,
    /// The files, or folders of them.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Write DIR/scenario.yaml, DIR/fleet.yaml and DIR/robots/. By default, the scenario is printed.
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Replace files that exist.
    #[arg(long, requires = "output")]
    force: bool,
    /// The description of the robots. By default, one is made from the range of the data.
    #[arg(long, value_name = "FILE")]
    init: Option<PathBuf>,
    /// Sample curves at this rate. By default, they stay curves if possible. For a csv with frame numbers or timecodes: the frames per
    /// second.
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate: Option<f64>,
    /// Maximum number of polynomial pieces per robot and scene. A Crazyflie has 4 KB for pieces of 132 bytes.
    #[arg(long, value_name = "N", default_value_t = 31)]
    max_pieces: usize,
    /// Put all scenes into one list of cues, one after the other.
    #[arg(long)]
    join: bool,
    /// Import only these scenes.
    #[arg(long, value_name = "SCENE", value_delimiter = ',')]
    only: Vec<String>,
    /// The name of the scenario.
    #[arg(long)]
    name: Option<String>,
    /// Names for the robots, in the order of the files.
    #[arg(long, value_name = "ROBOT", value_delimiter = ',')]
    robots: Vec<String>,
    /// The kind of robot, which names the file of its description.
    #[arg(long)]
    kind: Option<String>,
    /// The column of a csv with the times, by name or number.
    #[arg(long, value_name = "COLUMN")]
    time: Option<String>,
    /// The unit of the times of a csv, if its header does not name one: h, min, s, ms, us, ns, 25fps, hh:mm:ss, mm:ss or mm:ss:ms.
    #[arg(long, value_name = "UNIT")]
    time_unit: Option<TimeUnit>,
    /// Leave out the first lines of a csv, for example a title.
    #[arg(long, value_name = "LINES")]
    skip: Option<usize>,
    /// The decimal mark of a csv. By default, the mark that fits all numbers.
    #[arg(long, value_name = "point|comma")]
    decimal: Option<Decimal>,
    /// The column of a csv, or the channel of an fseq, that moves a device. Several columns are separated by commas. A `*` stands
    /// for any text, and `*=*` for all columns that no other --map names. Without a robot, each file is a robot.
    #[arg(long, value_name = "[ROBOT/]DEVICE=COLUMN", value_parser = column)]
    map: Vec<(String, String)>,
    /// A device that keeps each value until the next instead of moving there.
    #[arg(long, value_name = "DEVICE")]
    hold: Vec<String>,
    /// Remove the jumps of a device whose values repeat with a period, for example heading=360.
    #[arg(long, value_name = "DEVICE=PERIOD", value_parser = period)]
    unwrap: Vec<(String, f64)>,
    /// Time at which each scene sets its first value. The default is the time in the file.
    #[arg(long, value_name = "TIME", value_parser = parse_span)]
    start: Option<Span>,
    /// The mode of a fixture, by its name or its short name. By default, the only mode.
    #[arg(long, value_name = "MODE")]
    mode: Option<String>,
    /// Multiply the values of a device by a factor.
    #[arg(long, value_name = "DEVICE=FACTOR", value_parser = factor)]
    scale: Vec<(String, f64)>,
}

fn after_help() -> String {
    let described = Described::ALL.iter().map(|format| (format.word(), format.about()));
    let formats = ImportFormat::ALL.iter().map(|facts| (facts.word, facts.about)).chain(described);
    let formats: String = formats.map(|(word, about)| format!("  {word:<18}{about}\n")).collect();
    format!(
        "Formats:
{formats}
Each scene becomes an act. With --join, all scenes become one list of cues.

Examples:
  downbeat import crazyswarm pp*.csv --robots cf1,cf2,cf3 --output swap
  downbeat import bitbots dance.json --init wolf.yaml --robots wolf-1
  downbeat import fseq star.fseq --map star/lamp=1,2,3 --output star
  downbeat import urdf arm.urdf --output arm
  downbeat import fixture spot.json --mode 16bit --output spot
  downbeat import csv log.csv --time t --time-unit s --map arm-1/elbow=q2
  downbeat import csv log.csv --time 'Time [s]' --map 'arm/ch*=channel *'"
    )
}

/// A format, as given on the command line.
#[derive(Clone, Copy, Debug)]
enum From {
    /// Files that contain choreographies.
    Motions(ImportFormat),
    /// A file that describes a robot.
    Robot(Described),
}

impl clap::ValueEnum for From {
    fn value_variants<'a>() -> &'a [Self] {
        const MOTIONS: usize = ImportFormat::ALL.len();
        const ALL: [From; MOTIONS + Described::ALL.len()] = {
            let mut all = [From::Robot(Described::Urdf); MOTIONS + Described::ALL.len()];
            let mut index = 0;
            while index < all.len() {
                all[index] = if index < MOTIONS {
                    From::Motions(ImportFormat::ALL[index].format)
                } else {
                    From::Robot(Described::ALL[index - MOTIONS])
                };
                index += 1;
            }
            all
        };
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(match self {
            Self::Motions(format) => format.word(),
            Self::Robot(described) => described.word(),
        }))
    }
}

/// Parses a rate from 0.001 to 1000 Hz.
pub(super) fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse::<f64>().ok().filter(|rate| *rate >= 0.001 && *rate <= 1_000.0);
    rate.ok_or_else(|| "expected a rate from 0.001 to 1000 Hz".to_owned())
}

fn column(text: &str) -> Result<(String, String), String> {
    let parts = text.split_once('=').filter(|(to, column)| {
        let (robot, device) = to.split_once('/').unwrap_or(("-", to));
        !robot.is_empty() && !device.is_empty() && !column.is_empty()
    });
    let (to, column) = parts.ok_or("expected ROBOT/DEVICE=COLUMN, as in arm-1/elbow=q2, or DEVICE=COLUMN")?;
    Ok((to.to_owned(), column.to_owned()))
}

fn period(text: &str) -> Result<(String, f64), String> {
    let (device, period) = factor(text).map_err(|_| "expected DEVICE=PERIOD, as in heading=360")?;
    if period > 0.0 { Ok((device, period)) } else { Err("expected a period above 0".to_owned()) }
}

fn factor(text: &str) -> Result<(String, f64), String> {
    let parts =
        text.rsplit_once('=').and_then(|(device, factor)| Some((device, factor.parse::<f64>().ok()?)));
    let parts = parts.filter(|(device, factor)| !device.is_empty() && factor.is_finite() && *factor != 0.0);
    let (device, factor) = parts.ok_or("expected DEVICE=FACTOR with a factor other than 0, as in x=0.001")?;
    Ok((device.to_owned(), factor))
}

#[derive(Serialize)]
struct Done<'a> {
    scenario: Option<&'a str>,
    robots: usize,
    scenes: usize,
    steps: usize,
    /// Number of steps that repeat the previous value, for pauses and for values that a file omits.
    held: usize,
    duration_ms: Span,
    #[serde(flatten)]
    told: CommonOutput<'a>,
}

/// The part of the output that all imports have: notes on conversion rules, findings and written files.
#[derive(Serialize)]
struct CommonOutput<'a> {
    notes: &'a [String],
    findings: &'a [Finding],
    files: &'a [String],
    /// The resulting text. `None` if it is written to files.
    #[serde(skip_serializing_if = "Option::is_none")]
    text: Option<&'a str>,
}

impl CommonOutput<'_> {
    fn show(&self) {
        for note in self.notes {
            console::note(&format!("note: {note}"));
        }
        show_findings(self.findings);
        if let Some(text) = self.text {
            console::print(text);
        }
        for file in self.files {
            console::note(&format!("wrote {file}"));
        }
    }
}

pub(super) fn import(args: &ImportArgs, format: Format) -> Exit {
    if args.mode.is_some() && !matches!(args.from, From::Robot(Described::Fixture)) {
        console::error("--mode applies only to fixture; leave it out");
        return Exit::Usage;
    }
    match args.from {
        From::Motions(from) => import_motions(from, args, format),
        From::Robot(described) => describe::describe(described, args, format),
    }
}

fn import_motions(from: ImportFormat, args: &ImportArgs, format: Format) -> Exit {
    if let Some(wrong) = wrong_options(from, args) {
        console::error(wrong);
        return Exit::Usage;
    }
    let (init, mut outcome) = read(from, args);
    let scenes = if args.join { Scenes::Joined } else { Scenes::Acts };
    let mut files = Vec::new();
    let mut text = None;
    if let Some(imported) = outcome.imported.as_ref().filter(|_| outcome.findings.is_empty()) {
        let block = init.as_ref().map(|init| (&init.block, init.text.as_str()));
        match &args.output {
            Some(folder) => match write::write_all(folder, &files_of(imported, scenes, block), args.force) {
                Ok(written) => files = written,
                Err(mut findings) => outcome.findings.append(&mut findings),
            },
            None => text = Some(scenario_text(imported, scenes, block.map(|(block, _)| block), None)),
        }
    }
    let ImportOutcome { imported, notes, findings } = &outcome;
    let told = CommonOutput { notes, findings, files: &files, text: text.as_deref() };
    match format {
        Format::Json => show_json(imported.as_ref(), scenes, told),
        Format::Text => show_text(imported.as_ref(), scenes, &told),
    }
    exit_of(&outcome.findings)
}

fn exit_of(findings: &[Finding]) -> Exit {
    match findings {
        [] => Exit::Done,
        findings if findings.iter().any(Finding::is_about_access) => Exit::Usage,
        _ => Exit::Failed,
    }
}

/// Returns the fault if an option does not apply to the format, or if options contradict each other.
fn wrong_options(from: ImportFormat, args: &ImportArgs) -> Option<&'static str> {
    let for_csv = [
        args.time.is_some(),
        args.time_unit.is_some(),
        args.skip.is_some(),
        args.decimal.is_some(),
        !args.hold.is_empty(),
    ];
    // The text that `*` stands for may contain the robot's name.
    let whose = |(to, _): &(String, String)| to.contains('/');
    let nobodys = |(to, _): &(String, String)| !to.contains(['/', '*']);
    if from == ImportFormat::Csv && args.map.is_empty() {
        Some(
            "csv requires the column of each device; add --map ROBOT/DEVICE=COLUMN, or --map DEVICE=COLUMN if each file contains one robot",
        )
    } else if from != ImportFormat::Csv && for_csv.contains(&true) {
        Some("--time, --time-unit, --skip, --decimal and --hold apply only to csv; leave them out")
    } else if !from.facts().is_mapped && !args.map.is_empty() {
        Some("--map applies only to csv and fseq; leave it out")
    } else if args.map.iter().any(whose) && args.map.iter().any(nobodys) {
        Some("name a robot in every --map, or in none if each file contains one robot")
    } else {
        None
    }
}

/// The initialization block from the file that the user names, and the text of this file.
struct Init {
    block: urrcp::InitializationBlock,
    text: String,
}

fn read(from: ImportFormat, args: &ImportArgs) -> (Option<Init>, ImportOutcome) {
    let init = args.init.as_deref().map(|path| {
        let source = Source::read(path).map_err(|finding| vec![finding])?;
        let block = downbeat_scripts::init_of(&source)?;
        Ok::<_, Vec<Finding>>(Init { text: source.text, block })
    });
    let (init, broken) = match init.transpose() {
        Ok(init) => (init, Vec::new()),
        Err(findings) => (None, findings),
    };
    let options = ImportOptions {
        rate_hz: args.rate,
        pieces_max: Some(args.max_pieces),
        name: args.name.clone(),
        robots: args.robots.clone(),
        kind: args.kind.clone(),
        only: args.only.clone(),
        scales: args.scale.clone(),
        time_column: args.time.clone(),
        time_unit: args.time_unit,
        skip: args.skip.unwrap_or(0),
        decimal: args.decimal,
        holds: args.hold.clone(),
        unwraps: args.unwrap.clone(),
        start: args.start,
        columns: args.map.clone(),
        init: init.as_ref().map(|init| init.block.clone()),
    };
    let mut outcome = downbeat_import::import(from, &args.files, &options);
    outcome.findings.extend(broken);
    (init, outcome)
}

fn show_json(imported: Option<&Imported>, scenes: Scenes, told: CommonOutput<'_>) {
    console::print_json(&Done {
        scenario: imported.map(|imported| imported.name.as_str()),
        robots: imported.map_or(0, |imported| imported.robots().len()),
        scenes: imported.map_or(0, |imported| imported.scenes.len()),
        steps: imported.map_or(0, |imported| steps_written(imported, scenes)),
        held: imported.map_or(0, |imported| imported.held),
        duration_ms: imported.map_or(Span::ZERO, Imported::duration),
        told,
    });
}

fn show_text(imported: Option<&Imported>, scenes: Scenes, told: &CommonOutput<'_>) {
    told.show();
    let Some(imported) = imported.filter(|_| told.findings.is_empty()) else { return };
    console::note(&format!(
        "{}: {}, {}, {}, {}",
        imported.name,
        counted(imported.robots().len(), "robot"),
        counted(imported.scenes.len(), "scene"),
        counted(steps_written(imported, scenes), "step"),
        imported.duration()
    ));
}
