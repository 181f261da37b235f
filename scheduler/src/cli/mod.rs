//! The command line: one file a subcommand. The only room that prints.
//!
//! Exit codes: 0 done; 1 findings, or the mission failed or did not start; 2 usage or unreadable input; 3 stopped by the
//! operator, every robot confirmed; 4 ended with robots whose stop is not confirmed; 5 done without robots that failed,
//! or without acts whose wait ran out; 6 played to its end, but not as promised or not known; 7 done, but standard output or
//! the recording could not be written.

mod check;
mod choice;
mod completions;
mod conformance;
mod console;
mod detach;
#[cfg(test)]
mod documented;
mod dry_run;
mod edge;
mod explain;
mod export;
mod fleet;
mod go;
mod import;
mod init;
mod live;
mod load;
mod missions;
mod outlet;
mod plan;
mod realtime;
mod resume;
mod robot;
mod run;
mod schema;
mod sim;
mod stop;
mod withdraw;

#[cfg(test)]
pub(crate) use withdraw::InsideWhat;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::signals;

/// Makes many robots start together and stay together.
#[derive(Debug, Parser)]
#[command(
    name = "downbeat",
    version,
    after_help = "Examples:
  downbeat check scripts/examples/swap.yaml       find everything that will not work
  downbeat dry-run scripts/examples/swap.yaml     play it in virtual time
  downbeat run scripts/examples/swap.yaml         play it on the fleet of ./fleet.yaml
  downbeat sim fleet.yaml                         run the fleet's robots as simulated ones on TCP

Exit codes:
  0  done
  1  findings, or the mission failed or did not start
  2  usage, or input that cannot be read
  3  stopped by the operator, every robot confirmed it
  4  ended with robots whose stop is not confirmed
  5  done, without robots that failed on the way, or without acts whose wait ran out
  6  played to its end, but not as promised, or not known
  7  done, but standard output or the recording could not be written

A pipe whose reader has gone, as with `| head`, is no error."
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// What to print: text for people, or JSON for machines.
    #[arg(long, global = true, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// What to log to standard error, as `info` or `downbeat=debug`.
    #[arg(long, global = true, value_name = "FILTER", default_value = "off")]
    log: String,
}

/// What is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people.
    Text,
    /// For machines: one JSON document on standard output.
    Json,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Write a small show to begin with: a fleet, its robots and a scenario that run at once.
    Init(init::InitArgs),
    /// Find everything in a scenario that will not work, without moving anything.
    Check(check::CheckArgs),
    /// Explain a code of a finding at length.
    Explain(explain::ExplainArgs),
    /// Show when each cue takes place, what each device needs of its budget, and the control requests.
    Plan(plan::PlanArgs),
    /// Play a scenario in virtual time, with simulated robots and the real mission machine.
    DryRun(dry_run::DryRunArgs),
    /// Check the fleet without moving anything.
    Preflight(run::PreflightArgs),
    /// Play a scenario on the fleet: all robots start together, or none does.
    Run(run::RunArgs),
    /// Let the act begin that waits for the operator.
    Go(go::GoArgs),
    /// Stop missions: every robot that can be reached comes to rest.
    Stop(stop::StopArgs),
    /// Take up a mission whose scheduler was killed.
    Resume(resume::ResumeArgs),
    /// List the missions of this machine.
    Missions(missions::MissionsArgs),
    /// Check whether a robot does what the protocol demands.
    Conformance(conformance::ConformanceArgs),
    /// Run one simulated robot as a process of its own.
    Robot(robot::RobotArgs),
    /// Run a real robot behind a driver as a process of its own.
    Edge(edge::EdgeArgs),
    /// Run all TCP robots of a fleet as simulated ones in this process.
    Sim(sim::SimArgs),
    /// Turn other people's choreography files into a scenario and its fleet.
    Import(import::ImportArgs),
    /// Write what a scenario compiles to as files that other tools read.
    Export(export::ExportArgs),
    /// Print the JSON Schema of a scenario, a fleet file, a report or the messages.
    Schema(schema::SchemaArgs),
    /// Print the completions of a shell.
    Completions(completions::CompletionsArgs),
    /// Write the man pages, one for each command.
    Man(completions::ManArgs),
    /// Look at the fleet's robots.
    #[command(subcommand)]
    Fleet(fleet::FleetCommand),
}

/// A scenario with its fleet, as most commands take them.
#[derive(Debug, Args)]
pub struct ScenarioArgs {
    /// The scenario, a YAML file.
    scenario: PathBuf,
    /// The fleet file; otherwise the one that the scenario names, otherwise ./fleet.yaml.
    #[arg(long, value_name = "FILE")]
    fleet: Option<PathBuf>,
}

/// How a command ended, as scripts see it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(test, derive(strum::VariantNames))]
pub enum Exit {
    /// All went well.
    Done = 0,
    /// Findings, or a mission that failed or did not start.
    Failed = 1,
    /// Usage or unreadable input.
    Usage = 2,
    /// Stopped by the operator and confirmed by all.
    Stopped = 3,
    /// The stop of some robots is not confirmed.
    Unconfirmed = 4,
    /// Done, without robots that failed on the way, or without acts whose wait ran out.
    DoneWithout = 5,
    /// Played to its end, and not all of it is known to be as promised: starts were too far apart, or robots cannot say what
    /// they did.
    Uncertain = 6,
    /// Done, and what was to be written could not be: standard output, or the recording.
    Unwritten = 7,
}

impl Exit {
    /// All, in the order of their codes.
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

    /// What another process of this program ended with.
    fn of_code(code: i32) -> Self {
        Self::ALL.into_iter().find(|exit| *exit as i32 == code).unwrap_or(Self::Failed)
    }
}

/// Reads the arguments, does what they say and tells the shell how it went.
#[must_use]
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return ExitCode::from(told_by_clap(&error) as u8),
    };
    signals::take_harmless();
    start_log(&cli.log);
    let format = cli.format;
    let exit = match cli.command {
        Command::Init(args) => init::init(&args, format),
        Command::Check(args) => check::check(&args, format),
        Command::Explain(args) => explain::explain(&args, format),
        Command::Plan(args) => plan::plan(&args, format),
        Command::DryRun(args) => dry_run::dry_run(&args, format),
        Command::Preflight(args) => run::preflight(&args, format),
        Command::Run(args) => run::run(&args, format),
        Command::Go(args) => go::go(&args, format),
        Command::Stop(args) => stop::stop(&args, format),
        Command::Resume(args) => resume::resume(&args, format),
        Command::Missions(args) => missions::missions(&args, format),
        Command::Conformance(args) => conformance::conformance(&args, format),
        Command::Robot(args) => robot::robot(&args, format),
        Command::Edge(args) => edge::edge(&args, format),
        Command::Sim(args) => sim::sim(&args, format),
        Command::Import(args) => import::import(&args, format),
        Command::Export(args) => export::export(&args, format),
        Command::Schema(args) => schema::schema(&args),
        Command::Completions(args) => completions::completions(&args),
        Command::Man(args) => completions::man(&args),
        Command::Fleet(command) => fleet::fleet(&command, format),
    };
    if format == Format::Json {
        console::document_failure(exit);
    }
    ExitCode::from(console::finish(exit) as u8)
}

/// Whether JSON is asked for by arguments that cannot be read.
fn wants_json() -> bool {
    let args: Vec<_> = std::env::args().collect();
    let apart = args.windows(2).any(|two| two[0] == "--format" && two[1] == "json");
    apart || args.iter().any(|arg| arg == "--format=json")
}

/// Prints help, a version or what is wrong with the arguments, and returns with which code that ends.
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

fn start_log(filter: &str) {
    let filter = tracing_subscriber::EnvFilter::new(filter);
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false).with_writer(|| console::Log);
    if let Err(error) = log.try_init() {
        console::warn(&format!("no log: {error}"));
    }
}

/// A runtime for the commands that talk to robots.
fn with_runtime(work: impl Future<Output = Exit>) -> Exit {
    crate::open_files::raise_limit();
    console::never_wait();
    match tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build() {
        Ok(runtime) => {
            let exit = runtime.block_on(work);
            // Listening sockets and silent links must not keep the process.
            runtime.shutdown_background();
            exit
        }
        Err(error) => {
            console::error(&format!("no asynchronous runtime: {error}"));
            Exit::Failed
        }
    }
}
