//! `downbeat edge`: a real robot behind a driver, as a process of its own.

use downbeat_robot::Hosted;
use downbeat_robot::driver::{AtStart, DriverOptions, DriverSpec, SAMPLES_PER_SECOND};

use super::robot::{ProcessArgs, failed};
use super::{Exit, Format};

/// Run a real robot behind a driver.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The command prints the address on which it listens and runs until Ctrl-C. The devices go to their \
default state at the start, at the end, and whenever the hardware comes back. If they cannot at the end, the exit code is 4. \
docs/edge.md describes drivers.

Drivers:
  sim                 drive nothing
  thrift://HOST:PORT  drive a robot that speaks Thrift URRCP
  program:COMMAND     write lines to a program's standard input

Examples:
  downbeat edge --init robot.yaml --listen 0.0.0.0:7401 --driver thrift://tank.local:9090
  downbeat edge --init robot.yaml --driver 'program:python3 drive.py' --realtime required"
)]
pub(super) struct EdgeArgs {
    #[command(flatten)]
    process: ProcessArgs,
    /// The driver of the hardware.
    #[arg(long)]
    driver: DriverSpec,
    /// Samples per second of a linear movement, if the hardware does not move linearly by itself; at most 1000.
    #[arg(long, value_name = "NUMBER", default_value_t = SAMPLES_PER_SECOND, value_parser = rate)]
    samples_per_second: f64,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| *rate >= 0.1 && *rate <= 1_000.0)
        .ok_or_else(|| "expected a number from 0.1 to 1000".to_owned())
}

pub(super) fn edge(args: &EdgeArgs, format: Format) -> Exit {
    let block = match args.process.block() {
        Ok(block) => block,
        Err(exit) => return exit,
    };
    if let Some(missing) = missing_program(&args.driver) {
        return failed(&format!("the program `{missing}` of --driver does not exist; correct its path"));
    }
    let driver = match args.driver.driver(&block) {
        Ok(driver) => driver,
        Err(error) => return failed(&error.to_string()),
    };
    let used = DriverOptions::default()
        .with_samples_per_second(args.samples_per_second)
        .with_at_start(AtStart::Default);
    let id = block.id.clone();
    args.process.run(id, Hosted::driven(block, driver, used), format)
}

/// The file that a program's command begins with, if there is no such file. What the shell finds elsewhere it finds itself.
fn missing_program(driver: &DriverSpec) -> Option<&str> {
    let DriverSpec::Program { command } = driver else { return None };
    let file = command.split_whitespace().next()?;
    let plain = file.contains('/') && !file.contains(['$', '~', '\'', '"', ';', '|', '&', '(']);
    (plain && !std::path::Path::new(file).exists()).then_some(file)
}
