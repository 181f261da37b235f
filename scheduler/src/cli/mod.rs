//! The command line: one file per subcommand. Only this module prints.
//!
//! Exit codes: 0 done; 1 findings or differences, or the mission failed or did not start; 2 usage, or a file that cannot be read or
//! written; 3 stopped by the operator, every robot confirmed; 4 ended with robots whose stop is not confirmed; 5 done without robots that
//! failed, or without acts whose wait timed out; 6 played to its end, but not as promised or not known; 7 done, but standard output or
//! the recording could not be written.

mod advice;
mod audit;
mod calibrate;
mod certify;
mod check;
mod choice;
mod completions;
mod conformance;
mod console;
mod cues;
mod detach;
mod diff;
mod discover;
#[cfg(test)]
mod documented;
mod drivers;
mod dry_run;
mod edge;
mod explain;
mod export;
mod fleet;
mod go;
mod graph;
mod identity;
mod import;
mod init;
mod jog;
mod keys;
mod listen;
mod live;
mod load;
mod lsp;
mod metrics;
mod missions;
mod moves;
mod outlet;
mod passphrase;
mod plan;
mod push;
mod ready_drivers;
mod realtime;
mod report;
mod request;
mod resume;
mod robot;
mod run;
mod schema;
mod sim;
mod stop;
mod traces;
mod trials;
mod watch;
mod withdraw;
mod world;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand, ValueEnum};
use downbeat_scripts::{Attempt, Project, Refusal};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use crate::signals;

/// Make many robots start together and stay together.
#[derive(Debug, Parser)]
#[command(
    name = "downbeat",
    version,
    after_help = "Examples:
  downbeat init                write a small show to begin with
  downbeat check show.yaml     find mistakes
  downbeat dry-run show.yaml   play it in virtual time
  downbeat run show.yaml       play it on the fleet of ./fleet.yaml

Exit codes:
  0  done
  1  mistakes or differences were found, or the mission failed or did not start
  2  wrong arguments, no such mission, or a file that cannot be read or written
  3  stopped by the operator; every robot confirmed the stop
  4  ended, but a robot did not confirm its stop
  5  done, but robots failed on the way or acts were skipped
  6  played to the end, but late, out of tolerance, or with unknown results
  7  done, but the output or the recording could not be written

It is not an error if the reader of a pipe ends first, as in `downbeat plan show.yaml | head`."
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Output format: text for people, or JSON for machines.
    #[arg(long, global = true, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Log to standard error, for example `info` or `downbeat=debug`.
    #[arg(long, global = true, value_name = "FILTER", default_value = "off", value_parser = log_filter)]
    log: Targets,
}

/// The output format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people.
    Text,
    /// For machines, one JSON document on standard output.
    Json,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Write a small show to begin with: a fleet, its robots and a scenario that run at once.
    Init(init::InitArgs),
    /// Find the mistakes in a scenario and its fleet, without moving anything.
    Check(check::CheckArgs),
    /// Explain the code of a finding in detail.
    Explain(explain::ExplainArgs),
    /// Serve an editor that speaks the Language Server Protocol.
    Lsp(lsp::LspArgs),
    /// List the moves and sequences of a scenario with their parameters, devices and documentation.
    Moves(moves::MovesArgs),
    /// Show when each cue takes place and which requests each robot receives.
    Plan(plan::PlanArgs),
    /// List all cues for the people who run the show, also as CSV or as a page to print.
    Cues(cues::CuesArgs),
    /// Write acts, cues and their relations as a graph, for Graphviz.
    Graph(graph::GraphArgs),
    /// Play a scenario in virtual time with simulated robots.
    DryRun(dry_run::DryRunArgs),
    /// Check whether every robot of a scenario is ready, without moving anything.
    Preflight(run::PreflightArgs),
    /// Play a scenario on the fleet: all robots start together, or none does.
    Run(run::RunArgs),
    /// Begin the act that waits for the operator.
    Go(go::GoArgs),
    /// Stop missions and bring their robots to rest.
    Stop(stop::StopArgs),
    /// Continue a mission whose scheduler was killed.
    Resume(resume::ResumeArgs),
    /// List the missions of this machine.
    Missions(missions::MissionsArgs),
    /// Show who connected to, claimed, moved and stopped robots.
    Audit(audit::AuditArgs),
    /// Show a mission that was played, from its journal or its recording.
    Report(report::ReportArgs),
    /// Show the differences between two compiled scenarios, or between two missions that were played.
    Diff(diff::DiffArgs),
    /// Write a world file from a recording: delays, losses and clocks as measured.
    World(world::WorldArgs),
    /// Measure how long devices take from a command to visible motion.
    Calibrate(calibrate::CalibrateArgs),
    /// Move the devices of a robot by hand, within their limits, and save poses for scenarios.
    Jog(jog::JogArgs),
    /// List robots, lights and other hardware that answer on this network.
    Discover(discover::DiscoverArgs),
    /// Check whether a robot does what the protocol demands.
    Conformance(conformance::ConformanceArgs),
    /// Run one simulated robot that listens on TCP.
    Robot(robot::RobotArgs),
    /// Run a real robot behind a driver.
    Edge(edge::EdgeArgs),
    /// List the drivers for hardware, with the address to write into the fleet file, and their requirements.
    Drivers(ready_drivers::DriversArgs),
    /// Simulate all TCP robots of a fleet in one process.
    Sim(sim::SimArgs),
    /// Convert files of other tools into a scenario and its fleet.
    Import(import::ImportArgs),
    /// Convert a scenario into files of other tools.
    Export(export::ExportArgs),
    /// Print the JSON Schema of a scenario, a fleet file, a world file, a report or the protocol's messages.
    Schema(schema::SchemaArgs),
    /// Print completions for a shell.
    Completions(completions::CompletionsArgs),
    /// Write the man pages, one for each command.
    Man(completions::ManArgs),
    /// Ask the robots of a fleet for their descriptions and clocks.
    #[command(subcommand)]
    Fleet(fleet::FleetCommand),
    /// Make keys and certificates for robots and operators.
    #[command(subcommand)]
    Keys(keys::KeysCommand),
}

/// A scenario with its fleet, as most commands take them.
#[derive(Debug, Args)]
pub struct ScenarioArgs {
    /// The scenario, a YAML file.
    scenario: PathBuf,
    /// The fleet file. By default the one that the scenario names, or else ./fleet.yaml.
    #[arg(long, value_name = "FILE")]
    fleet: Option<PathBuf>,
    #[command(flatten)]
    project: ProjectArgs,
}

/// The folder that must contain the files named by scenarios and fleets.
#[derive(Clone, Debug, Default, Args)]
pub struct ProjectArgs {
    /// The folder that must contain all files named by scenarios and fleets. By default, the nearest folder with .git, or else with
    /// fleet.yaml, or else that of the files themselves.
    #[arg(long, value_name = "DIR", value_parser = parse_project)]
    project: Option<Project>,
}

fn parse_project(text: &str) -> Result<Project, String> {
    let folder = Path::new(text);
    Project::within(folder).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => "the folder does not exist".to_owned(),
        std::io::ErrorKind::NotADirectory => "it is not a folder".to_owned(),
        _ => Refusal::of(Attempt::Read(folder), &error).to_string(),
    })
}

/// The exit code of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(test, derive(strum::VariantNames))]
pub enum Exit {
    /// All went well.
    Done = 0,
    /// Findings, differences, or a mission that failed or did not start.
    Failed = 1,
    /// Wrong usage or unreadable input.
    Usage = 2,
    /// Stopped by the operator, and confirmed by all robots.
    Stopped = 3,
    /// The stop of at least one robot is not confirmed.
    Unconfirmed = 4,
    /// The mission ended, but without robots that failed on the way, or without acts whose wait timed out; or the conformance test ended
    /// without moving the robot.
    DoneWithout = 5,
    /// The mission played to its end, but perhaps not as promised: robots were too far apart, or cannot report what they did.
    Uncertain = 6,
    /// Done, but standard output or the recording could not be written.
    Unwritten = 7,
}

impl Exit {
    /// All exit codes, in ascending order of their numbers.
    const ALL: [Self; 8] = [
        Self::Done,
        Self::Failed,
        Self::Usage,
        Self::Stopped,
        Self::Unconfirmed,
        Self::DoneWithout,
        Self::Uncertain,
        Self::Unwritten,
    ];

    /// Returns the exit code with this number, which another process of this program has returned.
    fn of_code(code: i32) -> Self {
        Self::ALL.into_iter().find(|exit| *exit as i32 == code).unwrap_or(Self::Failed)
    }
}

/// Parses the arguments, runs the command and returns its exit code.
#[must_use]
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(mut error) => {
            advice::advise(&mut error, &std::env::args().collect::<Vec<_>>());
            return ExitCode::from(told_by_clap(&error) as u8);
        }
    };
    signals::take_harmless();
    start_log(cli.log);
    let format = cli.format;
    let exit = match cli.command {
        Command::Init(args) => init::init(&args, format),
        Command::Check(args) => check::check(&args, format),
        Command::Explain(args) => explain::explain(&args, format),
        Command::Lsp(args) => lsp::lsp(&args),
        Command::Moves(args) => moves::moves(&args, format),
        Command::Plan(args) => plan::plan(&args, format),
        Command::Cues(args) => cues::cues(&args, format),
        Command::Graph(args) => graph::graph(&args, format),
        Command::DryRun(args) => dry_run::dry_run(&args, format),
        Command::Preflight(args) => run::preflight(&args, format),
        Command::Run(args) => run::run(&args, format),
        Command::Go(args) => go::go(&args, format),
        Command::Stop(args) => stop::stop(&args, format),
        Command::Resume(args) => resume::resume(&args, format),
        Command::Missions(args) => missions::missions(&args, format),
        Command::Audit(args) => audit::audit(&args, format),
        Command::Report(args) => report::report(&args, format),
        Command::Diff(args) => diff::diff(&args, format),
        Command::World(args) => world::world(&args, format),
        Command::Calibrate(args) => calibrate::calibrate(&args, format),
        Command::Jog(args) => jog::jog(&args, format),
        Command::Discover(args) => discover::discover(&args, format),
        Command::Conformance(args) => conformance::conformance(&args, format),
        Command::Robot(args) => robot::robot(&args, format),
        Command::Edge(args) => edge::edge(&args, format),
        Command::Drivers(args) => ready_drivers::drivers(&args, format),
        Command::Sim(args) => sim::sim(&args, format),
        Command::Import(args) => import::import(&args, format),
        Command::Export(args) => export::export(&args, format),
        Command::Schema(args) => schema::schema(&args),
        Command::Completions(args) => completions::completions(&args),
        Command::Man(args) => completions::man(&args),
        Command::Fleet(command) => fleet::fleet(&command, format),
        Command::Keys(command) => keys::keys(&command, format),
    };
    if format == Format::Json {
        console::document_failure(exit);
    }
    ExitCode::from(console::finish(exit) as u8)
}

/// Whether the arguments request JSON output. Also works for arguments that cannot be parsed.
fn wants_json() -> bool {
    let args: Vec<_> = std::env::args().collect();
    let apart = args.windows(2).any(|two| two[0] == "--format" && two[1] == "json");
    apart || args.iter().any(|arg| arg == "--format=json")
}

/// Prints clap's message, which is help, the version or an error in the arguments, and returns the exit code.
fn told_by_clap(error: &clap::Error) -> Exit {
    let exit = if error.use_stderr() { Exit::Usage } else { Exit::Done };
    if exit == Exit::Usage && wants_json() {
        let text = error.render().to_string();
        console::print_json(&serde_json::json!({ "error": text.trim_end().trim_start_matches("error: ") }));
    }
    match error.print().and_then(|()| std::io::stdout().flush()) {
        Err(error) if exit == Exit::Done && error.kind() != std::io::ErrorKind::BrokenPipe => {
            console::error(&format!("cannot write to standard output: {error}"));
            Exit::Unwritten
        }
        _ => exit,
    }
}

fn log_filter(text: &str) -> Result<Targets, String> {
    text.parse().map_err(|_| {
        "expected `error`, `warn`, `info`, `debug` or `trace`, optionally for one part of the program, as in `downbeat=debug`"
            .to_owned()
    })
}

fn start_log(filter: Targets) {
    let lines = tracing_subscriber::fmt::layer().with_ansi(false).with_writer(|| console::Log);
    if let Err(error) = tracing_subscriber::registry().with(lines).with(filter).try_init() {
        console::warn(&format!("no log: {error}"));
    }
}

/// Runs a command that communicates with robots, and returns its exit code.
fn with_runtime(work: impl Future<Output = Exit>) -> Exit {
    crate::open_files::raise_limit();
    console::never_wait();
    match tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build() {
        Ok(runtime) => {
            let exit = runtime.block_on(work);
            // Listening sockets and silent links must not keep the process alive.
            runtime.shutdown_background();
            exit
        }
        Err(error) => {
            console::error(&format!("cannot start the asynchronous runtime: {error}"));
            Exit::Failed
        }
    }
}
