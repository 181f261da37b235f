//! `downbeat edge`: a real robot behind a driver, as a process of its own.

use downbeat_robot::Hosted;
use downbeat_robot::driver::{AtStart, DriverOptions, DriverSpec, SAMPLES_PER_SECOND};

use super::robot::{ProcessArgs, failed};
use super::{Exit, Format};

/// Run a real robot behind a driver as a process of its own.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Prints the address on which it listens, then runs until it is ended. Then, as at its start and
whenever the hardware comes back, the devices go to their default state; ends with 4 where that fails. See docs/edge.md.

Drivers:
  sim                  nothing is driven
  thrift://host:port   a robot that speaks the early Thrift form of URRCP
  program:COMMAND      a program that is told one line a value on its standard input

Examples:
  downbeat edge --init robot.yaml --listen 0.0.0.0:7401 --driver thrift://tank.local:9090
  downbeat edge --init robot.yaml --driver 'program:python3 drive.py' --realtime required"
)]
pub(super) struct EdgeArgs {
    #[command(flatten)]
    process: ProcessArgs,
    /// What drives it.
    #[arg(long)]
    driver: DriverSpec,
    /// Samples of a linear movement a second, where the hardware does not move linearly by itself; up to 1000.
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
    let driver = match args.driver.driver(&block) {
        Ok(driver) => driver,
        Err(error) => return failed(&error.to_string()),
    };
    let used = DriverOptions::default()
        .with_samples_per_second(args.samples_per_second)
        .with_at_start(AtStart::Default);
    args.process.run(Hosted::driven(block, driver, used), format)
}
