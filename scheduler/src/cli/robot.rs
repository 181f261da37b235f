//! `downbeat robot`: runs one simulated robot in its own process.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::ValueEnum;
use downbeat_robot::sealed::{self, RevokedSerials, Secret};
use downbeat_robot::simulated::{Fault, Settings, SimulatedRobot};
use downbeat_robot::tls::{self, Credentials, Name, Revoked};
use downbeat_robot::{Door, Host, HostError, HostOptions, Hosted};
use downbeat_scripts::shown::{self, shown};
use downbeat_scripts::{Attempt, Refusal};
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use urrcp::{DeviceId, InitializationBlock, RobotId, Span};

use super::listen::{Listening, NetworkArgs};
use super::metrics::MetricsArgs;
use super::realtime::RealtimeArgs;
use super::run::parse_span;
use super::{Exit, Format, audit, console};
use crate::report::Report;
use crate::signals::{OnHangUp, Signals};

/// Run one simulated robot that listens on TCP.
#[derive(Debug, clap::Args)]
#[command(after_help = "The command prints the address on which it listens and runs until Ctrl-C.

Examples:
  downbeat robot --init robots/arm.yaml --listen 127.0.0.1:7401
  downbeat robot --init arm.yaml --id arm-2 --clock-offset 120ms
  downbeat robot --init arm.yaml --listen 0.0.0.0:7401 --identity arm.pem
  downbeat robot --init arm.yaml --listen 0.0.0.0:7401 --secret arm.secret")]
pub(super) struct RobotArgs {
    #[command(flatten)]
    process: ProcessArgs,
    /// How far its uncorrected clock is ahead of the true time. A negative time means behind.
    #[arg(long, value_parser = parse_offset, default_value = "0s", value_name = "TIME", allow_hyphen_values = true)]
    clock_offset: Span,
    /// Error of its clock after NTP has corrected it.
    #[arg(long, value_parser = parse_span, default_value = "0s", value_name = "TIME")]
    ntp_error: Span,
    /// Do not correct its clock by NTP.
    #[arg(long)]
    no_ntp: bool,
    /// Delay every message by a random time up to this.
    #[arg(long, value_parser = parse_span, value_name = "TIME")]
    delay_max: Option<Span>,
    /// Simulate a fault.
    #[arg(long, value_enum)]
    fault: Option<FaultArg>,
    /// Give a sensor a reading, for example range=0.4. Can be repeated.
    #[arg(long = "reading", value_parser = parse_reading, value_name = "SENSOR=VALUE")]
    readings: Vec<(DeviceId, f64)>,
    /// Seed of its random delays.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// Options of a robot in its own process, simulated or real.
#[derive(Debug, clap::Args)]
pub(super) struct ProcessArgs {
    /// The description of the robot, YAML or JSON.
    #[arg(long, value_name = "FILE")]
    init: PathBuf,
    /// Use this id instead of the file's.
    #[arg(long)]
    id: Option<RobotId>,
    /// The address to listen on, HOST:PORT, or a key of a Zenoh network, zenoh:KEY. Port 0 takes any free port.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7401")]
    listen: String,
    #[command(flatten)]
    network: NetworkArgs,
    /// Write every step and movement of the robot to this file, one JSON line each.
    #[arg(long, value_name = "FILE")]
    log_file: Option<PathBuf>,
    /// Continue this audit trail of who claims, moves and stops the robot (`downbeat audit`). By default, a robot with access control or
    /// a driver has a trail in the folder `audit` of the state folder.
    #[arg(long, value_name = "FILE")]
    audit: Option<PathBuf>,
    /// Write no audit trail.
    #[arg(long, conflicts_with = "audit")]
    no_audit: bool,
    #[command(flatten)]
    guard: GuardArgs,
    #[command(flatten)]
    realtime: RealtimeArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
}

/// Options for who may drive a listening robot.
#[derive(Debug, clap::Args)]
pub(super) struct GuardArgs {
    /// Accept only operators of the authority that made this identity file (`downbeat keys robot`), by TLS.
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Accept only operators with a pass made from the secret in this file (`downbeat keys secret`): for robots without TLS.
    #[arg(long, value_name = "FILE", conflicts_with = "identity")]
    secret: Option<PathBuf>,
    /// Refuse the operators on this list (`downbeat keys revoke`): revoked.pem with --identity, revoked.serials with --secret. The list
    /// is read again when it changes.
    #[arg(long, value_name = "FILE")]
    revoked: Option<PathBuf>,
    /// Let anyone who reaches the robot's port drive it, without TLS: for an isolated network.
    #[arg(long, conflicts_with_all = ["identity", "secret"])]
    insecure: bool,
}

impl GuardArgs {
    /// Whether operators have to prove their identities.
    const fn proves(&self) -> bool {
        self.identity.is_some() || self.secret.is_some()
    }

    /// Returns the robot's access control ([`Door`]). If the robot can be reached from other machines, access without authentication
    /// requires `--insecure`.
    pub(super) fn door(&self, robot: &RobotId, listener: &TcpListener) -> Result<Door, String> {
        match (&self.identity, &self.secret) {
            (Some(path), _) => self.by_identity(robot, path),
            (None, Some(path)) => {
                let secret = Secret::read(path).map_err(|error| error.to_string())?;
                let revoked = self.revoked.as_deref().map(RevokedSerials::in_file).transpose();
                let revoked = revoked.map_err(|error| error.to_string())?;
                let guard = sealed::Guard::new(robot.clone(), secret, revoked.as_ref());
                Ok(Door::Sealed(Arc::new(guard.map_err(|error| error.to_string())?)))
            }
            (None, None) if self.revoked.is_some() => {
                Err("--revoked requires --identity or --secret; without them, peers are not identified"
                    .to_owned())
            }
            (None, None) => match listener.local_addr() {
                Ok(address) if !address.ip().to_canonical().is_loopback() && !self.insecure => Err(format!(
                    "anyone who can reach {address} could drive the robot; add --identity FILE, which `downbeat keys robot` creates, or --insecure if the network is isolated"
                )),
                _ => Ok(Door::Open),
            },
        }
    }

    /// Returns an error if an option for access control is given and the address is a Zenoh key. The network decides who may drive such a
    /// robot.
    pub(super) fn refuse_at_key(&self) -> Result<(), String> {
        let given = [("identity", &self.identity), ("secret", &self.secret), ("revoked", &self.revoked)];
        match given.into_iter().find(|(_, file)| file.is_some()) {
            Some((name, _)) => Err(format!(
                "--{name} applies only to TCP; the access control of the routers decides who may drive a robot at a zenoh: address (docs/zenoh.md)"
            )),
            None => Ok(()),
        }
    }

    /// Whether `--insecure` was given.
    pub(super) const fn permits_anyone(&self) -> bool {
        self.insecure
    }

    fn by_identity(&self, robot: &RobotId, path: &Path) -> Result<Door, String> {
        let own = Credentials::read(path).map_err(|error| error.to_string())?;
        if own.identity().name != Name::Robot(robot.clone()) {
            let name = &own.identity().name;
            return Err(format!(
                "{}: this is the identity of {name}, expected that of robot {robot}",
                path.display()
            ));
        }
        let revoked = self.revoked.as_deref().map(Revoked::in_file).transpose();
        let guard = tls::Guard::new(own, revoked.map_err(|error| error.to_string())?)?;
        Ok(Door::Tls(Arc::new(guard)))
    }
}

impl ProcessArgs {
    /// Reads the robot's description from the init file, and replaces its id if `--id` is given.
    pub(super) fn block(&self) -> Result<InitializationBlock, Exit> {
        let mut block = downbeat_scripts::read_init(&self.init).map_err(|findings| {
            super::load::show_findings(&findings);
            let unreadable = findings.iter().any(downbeat_scripts::Finding::is_about_access);
            if unreadable { Exit::Usage } else { Exit::Failed }
        })?;
        if let Some(id) = &self.id {
            block.id = id.clone();
        }
        Ok(block)
    }

    /// Returns the file of the robot's audit trail. `None` if the robot has none.
    fn audit_file(&self, id: &RobotId, body: Body) -> Option<PathBuf> {
        if self.audit.is_some() || self.no_audit {
            return self.audit.clone();
        }
        if body == Body::Simulated && !self.guard.proves() {
            return None;
        }
        match audit::default_file(id) {
            Ok(file) => Some(file),
            Err(error) => {
                console::warn(&format!("no audit trail is written: {error}; name a file with --audit"));
                None
            }
        }
    }

    /// Runs the robot until a signal asks the program to end. Nothing moves before the robot listens on its address.
    pub(super) fn run(&self, id: RobotId, robot: Hosted, body: Body, format: Format) -> Exit {
        let mut options = HostOptions::default().with_realtime(self.realtime.realtime());
        options.log.clone_from(&self.log_file);
        options.audit = self.audit_file(&id, body);
        super::with_runtime(async {
            // Signals are handled before anything moves.
            let signals = match Signals::listen(OnHangUp::End) {
                Ok(signals) => signals,
                Err(error) => return failed(&format!("cannot install signal handlers: {error}")),
            };
            let mut way = self.network.way(None);
            let place = match Listening::at(&self.listen, &id, &self.guard, &mut way).await {
                Ok(place) => place,
                Err(error) => return failed(&error),
            };
            let metrics = match self.metrics.serve(format) {
                Ok(metrics) => metrics,
                Err(error) => return failed(&error),
            };
            let mut host = match Host::start(vec![robot], options) {
                Ok(host) => host,
                Err(error) => return failed(&not_hosted(&error)),
            };
            metrics.add_host(&host, vec![id]);
            let log = LogWatch::of(&mut host);
            self.realtime.tell(&host, format);
            announce(&host, 0, &place, format);
            let exit = serve_until_asked_to_end(vec![place], &host, signals).await;
            if stop(host) { log.spoils(exit).await } else { Exit::Unconfirmed }
        })
    }
}

/// What moves when a robot moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Body {
    Simulated,
    Real,
}

/// Watches the log of the robots' values. Prints an error immediately if the log ends while the robots still run.
pub(super) struct LogWatch(Option<JoinHandle<bool>>);

impl LogWatch {
    pub(super) fn of(host: &mut Host) -> Self {
        let watch = |lost: oneshot::Receiver<HostError>| {
            // The task ends with the host.
            tokio::spawn(async move {
                let lost = lost.await.ok();
                lost.iter().for_each(|error| console::error(&error.to_string()));
                lost.is_some()
            })
        };
        Self(host.log_lost().map(watch))
    }

    /// Waits for the end of the log, and returns the exit code: `exit`, or a failure if the command was otherwise successful but the log
    /// is incomplete.
    pub(super) async fn spoils(self, exit: Exit) -> Exit {
        let lost = match self.0 {
            Some(watch) => watch.await.unwrap_or(false),
            None => false,
        };
        if lost && exit == Exit::Done { Exit::Unwritten } else { exit }
    }
}

/// The fault of a simulated robot.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum FaultArg {
    /// Refuses every script.
    Refuse,
    /// Never answers a control request.
    Silent,
    /// Closes the connection after it has accepted a script.
    Disconnect,
}

pub(super) fn robot(args: &RobotArgs, format: Format) -> Exit {
    let block = match args.process.block() {
        Ok(block) => block,
        Err(exit) => return exit,
    };
    let settings = Settings {
        clock_offset: args.clock_offset,
        ntp_error: (!args.no_ntp).then_some(args.ntp_error),
        delay: args.delay_max.map(|largest| (Span::ZERO, largest)),
        fault: args.fault.map(|fault| match fault {
            FaultArg::Refuse => Fault::Refuse,
            FaultArg::Silent => Fault::Silent,
            FaultArg::Disconnect => Fault::Disconnect,
        }),
        seed: args.seed,
        ..Settings::default()
    };
    let is_sensor = |sensor: &DeviceId| {
        block.device(sensor.as_str()).is_some_and(|d| d.available_control_types.sensor().is_some())
    };
    if let Some((sensor, _)) = args.readings.iter().find(|(sensor, _)| !is_sensor(sensor)) {
        let sensors = block.devices.iter().filter(|device| is_sensor(&device.id));
        let known: Vec<String> = sensors.map(|device| format!("`{}`", device.id)).collect();
        let known = if known.is_empty() {
            "it has no sensors, so leave out --reading".to_owned()
        } else {
            format!("its sensors are {}", known.join(", "))
        };
        console::error(&format!("--reading: `{}` has no sensor `{sensor}`; {known}", block.id));
        return Exit::Usage;
    }
    let id = block.id.clone();
    let mut robot = SimulatedRobot::new(block, settings);
    args.readings.iter().for_each(|(sensor, reading)| robot.set_reading(sensor.clone(), *reading));
    args.process.run(id, robot.into(), Body::Simulated, format)
}

/// Parses a time that may have a minus sign.
fn parse_offset(text: &str) -> Result<Span, String> {
    match text.strip_prefix('-') {
        Some(behind) => parse_span(behind).map(|behind| Span::ZERO - behind),
        None => parse_span(text),
    }
}

fn parse_reading(text: &str) -> Result<(DeviceId, f64), String> {
    let parsed = text.split_once('=').and_then(|(sensor, reading)| {
        let reading = reading.parse().ok().filter(|reading: &f64| reading.is_finite())?;
        Some((sensor.parse().ok()?, reading))
    });
    parsed.ok_or_else(|| "expected SENSOR=NUMBER, as in range=0.4".to_owned())
}

pub(super) fn failed(message: &str) -> Exit {
    console::error(message);
    Exit::Usage
}

/// Returns the error message if the robots of this process cannot run.
pub(super) fn not_hosted(error: &HostError) -> String {
    match error {
        HostError::Log { path, error } => {
            format!("cannot write the log {}: {}", path.display(), Refusal::of(Attempt::Write(path), error))
        }
        HostError::Audit { path, error } => {
            let refusal = Refusal::of(Attempt::Write(path), error);
            format!("cannot write the audit trail {}: {refusal}", path.display())
        }
        other => other.to_string(),
    }
}

/// Stops a host and prints the robots that may not have come to rest. Returns whether all robots have come to rest.
pub(super) fn stop(host: Host) -> bool {
    let not_at_rest = host.stop();
    for robot in &not_at_rest {
        console::error(&robot.to_string());
    }
    not_at_rest.is_empty()
}

/// Stops the host that runs a mission's robots in this process. Adds the robots that may not have come to rest to the report.
pub(super) fn stop_for(report: &mut Report, host: Option<Host>) {
    let not_at_rest = host.map(Host::stop).unwrap_or_default();
    report.not_at_rest = not_at_rest.iter().map(ToString::to_string).collect();
    report.not_at_rest.iter().for_each(|robot| console::error(robot));
}

/// Prints the address at which a robot listens.
pub(super) fn announce(host: &Host, index: usize, listening: &Listening, format: Format) {
    let robot = host.handle().robots()[index].clone();
    let Some(place) = listening.place() else { return };
    match format {
        Format::Text => {
            console::print(&format!("robot {} listens on {}\n", shown(robot.as_str()), shown(&place)))
        }
        Format::Json => console::print(&format!(
            "{}\n",
            shown::json(&serde_json::json!({"robot": robot, "listens": place}).to_string())
        )),
    }
}

/// Serves clients of the host's robots until a signal asks the program to end. `places` are the robots' addresses, in the host's order.
pub(super) async fn serve_until_asked_to_end(
    places: Vec<Listening>,
    host: &Host,
    mut signals: Signals,
) -> Exit {
    let mut serving = tokio::task::JoinSet::new();
    for (index, place) in places.into_iter().enumerate() {
        serving.spawn(place.serve(host.handle(), index));
    }
    tokio::select! {
        _ = signals.next() => Exit::Done,
        Some(ended) = serving.join_next() => match ended {
            Ok(Ok(())) => Exit::Done,
            Ok(Err(error)) => failed(&format!("listening ended: {error}")),
            Err(error) => failed(&format!("listening ended: {error}")),
        },
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use urrcp::Span;

    use crate::cli::{Cli, Command};

    #[test]
    fn clock_offset_may_be_negative() {
        for (time, expected) in [("-80ms", -80), ("80ms", 80)] {
            let args = ["downbeat", "robot", "--init", "arm.yaml", "--clock-offset", time, "--no-ntp"];
            let parsed = Cli::try_parse_from(args).map(|cli| cli.command);
            let Ok(Command::Robot(robot)) = parsed else { panic!("{time}: {parsed:?}") };
            assert_eq!(robot.clock_offset, Span::from_millis(expected));
        }
    }
}
