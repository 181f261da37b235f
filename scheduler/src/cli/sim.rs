//! `downbeat sim`: all TCP robots of a fleet as simulated ones in this process.

use std::path::PathBuf;

use downbeat_robot::{Host, HostOptions};
use downbeat_scripts::{Address, Protection};
use tokio::net::TcpListener;

use super::metrics::MetricsArgs;
use super::realtime::RealtimeArgs;
use super::{Exit, Format, ProjectArgs, console, load, robot};
use crate::signals::{OnHangUp, Signals};
use crate::{fleet, keys};

/// Simulate all TCP robots of a fleet in one process.
#[derive(Debug, clap::Args)]
#[command(after_help = "Each robot listens at its address in the fleet file until Ctrl-C.

Example:
  downbeat sim stage.yaml")]
pub(super) struct SimArgs {
    /// The fleet file.
    #[arg(default_value = "fleet.yaml")]
    fleet: PathBuf,
    /// The folder of `downbeat keys` with the keys of robots at `tls://` and `hmac://` addresses.
    #[arg(long, value_name = "FOLDER")]
    keys: Option<PathBuf>,
    #[command(flatten)]
    project: ProjectArgs,
    /// Write every value that they set to this file, one JSON line each.
    #[arg(long, value_name = "FILE")]
    log_file: Option<PathBuf>,
    #[command(flatten)]
    realtime: RealtimeArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
}

fn takes_keys(address: &Address) -> bool {
    matches!(address, Address::Tcp { protection: Protection::Tls | Protection::Hmac, .. })
}

pub(super) fn sim(args: &SimArgs, format: Format) -> Exit {
    let fleet = match load::load_fleet(&args.fleet, &args.project, format) {
        Ok(fleet) => fleet,
        Err(exit) => return exit,
    };
    if let (None, Some(robot)) = (&args.keys, fleet.robots.iter().find(|robot| takes_keys(&robot.address))) {
        console::error(&format!(
            "`{}` is at {}: name the folder of the keys with --keys, or simulate it with `address: sim`",
            robot.id, robot.address
        ));
        return Exit::Usage;
    }
    let mut machines = Vec::new();
    let mut addresses = Vec::new();
    let mut names = Vec::new();
    for (seed, robot) in fleet.robots.iter().enumerate() {
        let Address::Tcp { host, port, protection } = &robot.address else { continue };
        match fleet::simulated(robot, seed as u64) {
            Ok(machine) => machines.push(machine),
            Err(error) => {
                console::error(&error.to_string());
                return Exit::Failed;
            }
        }
        names.push(robot.id.clone());
        let own_id = robot.init.as_ref().map_or(&robot.id, |init| &init.id);
        let door = args.keys.as_ref().map(|keys| keys::door_of(keys, own_id, *protection));
        match door.transpose() {
            Ok(door) => addresses.push((host.clone(), *port, door.unwrap_or_default())),
            Err(error) => {
                console::error(&error);
                return Exit::Usage;
            }
        }
    }
    if machines.is_empty() {
        console::error(
            "no robot of this fleet has `address: tcp://host:port`; `downbeat run` simulates those with `address: sim` itself",
        );
        return Exit::Failed;
    }
    let mut options = HostOptions::default().with_realtime(args.realtime.realtime());
    options.log.clone_from(&args.log_file);
    let metrics = match args.metrics.serve(format) {
        Ok(metrics) => metrics,
        Err(error) => return robot::failed(&error),
    };
    let mut host = match Host::start(machines, options) {
        Ok(host) => host,
        Err(error) => {
            console::error(&robot::not_hosted(&error));
            return Exit::Usage;
        }
    };
    metrics.add_host(&host, names);
    args.realtime.tell(&host, format);
    super::with_runtime(async {
        let signals = match Signals::listen(OnHangUp::End) {
            Ok(signals) => signals,
            Err(error) => return robot::failed(&format!("cannot install signal handlers: {error}")),
        };
        let log = robot::LogWatch::of(&mut host);
        let mut listeners = Vec::new();
        for (index, (name, port, door)) in addresses.into_iter().enumerate() {
            match TcpListener::bind((name.as_str(), port)).await {
                Ok(listener) => {
                    robot::announce(&host, index, &listener, format);
                    listeners.push((listener, index, door));
                }
                Err(error) => {
                    console::error(&robot::not_listening(&format!("{name}:{port}"), &error));
                    return Exit::Usage;
                }
            }
        }
        let exit = robot::serve_until_asked_to_end(listeners, &host, signals).await;
        host.stop();
        log.spoils(exit).await
    })
}
