//! `downbeat sim`: simulates all robots of a fleet that have a network address, in one process.

use std::path::PathBuf;

use downbeat_robot::{Door, Host, HostOptions};
use downbeat_scripts::{Address, Protection};

use super::listen::{Exposure, Listening, NetworkAccess, NetworkArgs};
use super::metrics::MetricsArgs;
use super::realtime::RealtimeArgs;
use super::{Exit, Format, ProjectArgs, console, load, robot};
use crate::signals::{OnHangUp, Signals};
use crate::{fleet, keys};

/// Simulate all TCP and Zenoh robots of a fleet in one process.
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
    network: NetworkArgs,
    #[command(flatten)]
    project: ProjectArgs,
    /// Write every step and movement of the robots to this file, one JSON line each.
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
            "the address of `{}` is {}, which requires keys; set their folder with --keys, or simulate the robot with `address: sim`",
            robot.id, robot.address
        ));
        return Exit::Usage;
    }
    let mut machines = Vec::new();
    let mut addresses = Vec::new();
    let mut names = Vec::new();
    for (seed, robot) in fleet.robots.iter().enumerate() {
        if !robot.address.is_served() {
            continue;
        }
        match fleet::simulated(robot, seed as u64) {
            Ok(machine) => machines.push(machine),
            Err(error) => {
                console::error(&error.to_string());
                return Exit::Failed;
            }
        }
        names.push(robot.id.clone());
        let own_id = robot.init.as_ref().map_or(&robot.id, |init| &init.id);
        let door = match (&robot.address, &args.keys) {
            (Address::Tcp { protection, .. }, Some(keys)) => keys::door_of(keys, own_id, *protection),
            _ => Ok(Door::default()),
        };
        match door {
            Ok(door) => addresses.push((&robot.address, door)),
            Err(error) => return robot::failed(&error),
        }
    }
    if machines.is_empty() {
        console::error(
            "no robot of this fleet has `address: tcp://host:port` or `address: zenoh:KEY`; `downbeat run` itself simulates robots with `address: sim`",
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
        let mut way = args.network.way(fleet.zenoh.as_deref());
        let mut places = Vec::new();
        for (index, (address, door)) in addresses.into_iter().enumerate() {
            match listening(address, door, &mut way).await {
                Ok(place) => {
                    robot::announce(&host, index, &place, format);
                    places.push(place);
                }
                Err(error) => return robot::failed(&error),
            }
        }
        let exit = robot::serve_until_asked_to_end(places, &host, signals).await;
        host.stop();
        log.spoils(exit).await
    })
}

/// Opens the address that a fleet file states for a robot. Anyone may drive simulated robots, because they move nothing.
async fn listening(address: &Address, door: Door, way: &mut NetworkAccess) -> Result<Listening, String> {
    match address {
        Address::Zenoh { key } => way.listen(key, Exposure::Accepted).await,
        Address::Tcp { host, port, .. } => {
            let place =
                if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") };
            Ok(Listening::Tcp(Listening::bind(&place).await?, door))
        }
        _ => Err(format!("cannot listen at the address {address}")),
    }
}
