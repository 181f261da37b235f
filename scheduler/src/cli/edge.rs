//! `downbeat edge`: a real robot behind a driver, as a process of its own.

use std::path::PathBuf;

use downbeat_robot::driver::{AtStart, DriverOptions, DriverSpec, SAMPLES_PER_SECOND};
use downbeat_robot::{Host, HostOptions, Hosted};
use tokio::net::TcpListener;
use urrcp::RobotId;

use super::{Exit, Format, console, robot};

/// Run a real robot behind a driver as a process of its own.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Prints the address on which it listens, then runs until it is ended. Then, as at its start and
whenever the hardware comes back, the devices go to their default state. See docs/edge.md.

Drivers:
  sim                  nothing is driven
  thrift://host:port   a robot that speaks the early Thrift form of URRCP
  program:COMMAND      a program that is told one line a value on its standard input

Examples:
  downbeat edge --init robot.yaml --listen 0.0.0.0:7401 --driver thrift://tank.local:9090
  downbeat edge --init robot.yaml --driver 'program:python3 drive.py' --realtime"
)]
pub(super) struct EdgeArgs {
    /// Its initialization block, YAML or JSON.
    #[arg(long, value_name = "FILE")]
    init: PathBuf,
    /// Its id, instead of the file's.
    #[arg(long)]
    id: Option<RobotId>,
    /// What drives it.
    #[arg(long)]
    driver: DriverSpec,
    /// Where to listen; port 0 takes any free one.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7401")]
    listen: String,
    /// Samples of a linear movement a second, where the hardware does not move linearly by itself; up to 1000.
    #[arg(long, value_name = "NUMBER", default_value_t = SAMPLES_PER_SECOND, value_parser = rate)]
    samples_per_second: f64,
    /// Write everything that the robot wants set to this file, a JSON line each.
    #[arg(long, value_name = "FILE")]
    log_file: Option<PathBuf>,
    /// Ask for real-time scheduling (needs the right to).
    #[arg(long)]
    realtime: bool,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| *rate >= 0.1 && *rate <= 1_000.0)
        .ok_or_else(|| "expected a number from 0.1 to 1000".to_owned())
}

pub(super) fn edge(args: &EdgeArgs, format: Format) -> Exit {
    let mut block = match downbeat_scripts::read_init(&args.init) {
        Ok(block) => block,
        Err(findings) => {
            super::load::show_findings(&findings);
            return Exit::Usage;
        }
    };
    if let Some(id) = &args.id {
        block.id = id.clone();
    }
    let driver = match args.driver.driver(&block) {
        Ok(driver) => driver,
        Err(error) => return failed(&error.to_string()),
    };
    let used = DriverOptions { samples_per_second: args.samples_per_second, at_start: AtStart::Default };
    let options = HostOptions { realtime: args.realtime, log: args.log_file.clone() };
    let host = match Host::start(vec![Hosted::driven(block, driver, used)], options) {
        Ok(host) => host,
        Err(error) => return failed(&error.to_string()),
    };
    super::with_runtime(async {
        let listener = match TcpListener::bind(&args.listen).await {
            Ok(listener) => listener,
            Err(error) => return failed(&format!("cannot listen on {}: {error}", args.listen)),
        };
        robot::announce(&host, 0, &listener, format);
        let exit = robot::serve_until_interrupted(vec![(listener, 0)], &host).await;
        host.stop();
        exit
    })
}

fn failed(message: &str) -> Exit {
    console::error(message);
    Exit::Usage
}
