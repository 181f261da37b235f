//! `downbeat calibrate`: measures how long devices take from a command to visible motion, and writes the result to a file.

use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};

use chrono::SecondsFormat;
use downbeat_robot::HostOptions;
use downbeat_scripts::shown::shown;
use downbeat_scripts::{
    Attempt, Lag, LatencyFile, MeasuredLatency, Refusal, latency_text, read_latency_file,
};
use serde_json::json;
use urrcp::{RobotId, SessionId, Span};

use super::drivers::DriverArgs;
use super::run::parse_span;
use super::{Exit, Format, ProjectArgs, console, identity, load};
use crate::calibrate::{
    DialogueError, Measured, NotMeasured, PlannedDevice, PlannedRobot, RobotDialogue, Unplanned, measure,
    plan,
};
use crate::fleet::{self, StartPrograms};
use crate::link::Endpoint;
use crate::server_clock::ServerClock;
use crate::session::{Session, SessionKey};
use crate::show::table::Rows;
use crate::signals::{OnHangUp, Signals};

/// Measure how long devices take from a command to visible motion.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The command moves devices. It moves those that have `calibrate` in the fleet file, each by the small amount \
declared there and at no more than half of its maximum speed. It shows what it will do and asks first; without a terminal it needs --yes. \
Each robot is reserved as in a mission, and robots that belong to another mission are not moved. At the end, and when you press \
Ctrl-C, devices stay where they are or return to where they were.

If a device cannot be measured, the command reports the reason: for example, the sensor is too noisy, or the device does not move. \
The results are written to a file; the entries of other devices in it are kept. Name this file in the fleet file: `latency: latency.yaml`. Missions then send the \
steps of these devices earlier.

Examples:
  downbeat calibrate --dry-run
  downbeat calibrate stage.yaml --robots arm-1,arm-2
  downbeat calibrate stage.yaml --trials 60 --yes --format json"
)]
pub(super) struct CalibrateArgs {
    /// The fleet file.
    #[arg(default_value = "fleet.yaml")]
    fleet: PathBuf,
    #[command(flatten)]
    project: ProjectArgs,
    /// Measure only these robots, separated by commas.
    #[arg(long, value_delimiter = ',', value_name = "ROBOTS")]
    robots: Vec<RobotId>,
    /// Number of movements of each device. Up to three times as many may be made, until the median is known to within 1 ms.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(6..=200), value_name = "N")]
    trials: u16,
    /// The file to write. By default, latency.yaml next to the fleet file.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Show what would be moved, and move nothing.
    #[arg(long)]
    dry_run: bool,
    /// Do not ask before devices are moved.
    #[arg(long)]
    yes: bool,
    /// How long to wait for an answer of a robot.
    #[arg(long, value_parser = parse_span, default_value = "5s", value_name = "TIME")]
    patience: Span,
    #[command(flatten)]
    drivers: DriverArgs,
}

/// The result of measuring one device.
struct Outcome {
    robot: RobotId,
    device: String,
    result: Result<Measured, String>,
}

/// Why the measurement of a robot ended early.
enum Ended {
    Error(NotMeasured),
    Interrupted,
}

pub(super) fn calibrate(args: &CalibrateArgs, format: Format) -> Exit {
    let fleet = match load::load_fleet_to_measure(&args.fleet, &args.project, format) {
        Ok(fleet) => fleet,
        Err(exit) => return exit,
    };
    if let Some(unknown) = args.robots.iter().find(|id| !fleet.robots.iter().any(|robot| robot.id == **id)) {
        return usage(&format!("unknown robot `{unknown}`: it is not in {}", args.fleet.display()));
    }
    let only = (!args.robots.is_empty()).then_some(args.robots.as_slice());
    let (robots, unplanned) = plan(&fleet, only);
    if format == Format::Text {
        console::print(&plan_text(&robots, &unplanned, args));
    }
    if robots.is_empty() {
        let hint = "add `calibrate: {DEVICE: {sensor: SENSOR, by: AMOUNT}}` to a robot of the fleet file";
        console::error(&format!("nothing to measure; {hint}"));
        return Exit::Failed;
    }
    if args.dry_run {
        if format == Format::Json {
            console::print_json(&plan_json(&robots, &unplanned));
        }
        return Exit::Done;
    }
    let path = args.output.clone().unwrap_or_else(|| args.fleet.with_file_name("latency.yaml"));
    let kept = match kept(&path) {
        Ok(kept) => kept,
        Err(exit) => return exit,
    };
    if let Err(reason) = writable(&path) {
        return usage(&reason);
    }
    if !args.yes {
        match confirmed() {
            Some(true) => {}
            Some(false) => return Exit::Done,
            None => {
                return usage(
                    "devices would move, but there is no terminal to ask for confirmation; add --yes if the movement is safe",
                );
            }
        }
    }
    let mut exit = Exit::Done;
    super::with_runtime(async {
        let outcomes = match all(&fleet, &robots, args, format).await {
            Ok((outcomes, ended)) => {
                exit = ended;
                outcomes
            }
            Err(reason) => {
                console::error(&reason);
                exit = Exit::Failed;
                return exit;
            }
        };
        let written = write(&path, kept, &outcomes);
        match format {
            Format::Text => console::print(&outcome_text(&outcomes)),
            Format::Json => console::print_json(&outcome_json(&outcomes, &unplanned)),
        }
        exit = told(&path, &outcomes, written, exit, args);
        exit
    })
}

/// Prints the failures and the path of the written file, and returns the exit code.
fn told(
    path: &Path,
    outcomes: &[Outcome],
    written: Result<bool, String>,
    exit: Exit,
    args: &CalibrateArgs,
) -> Exit {
    for Outcome { robot, device, result } in outcomes {
        if let Err(reason) = result {
            console::error(&format!("{}: {}: {reason}", shown(robot.as_str()), shown(device)));
        }
    }
    let failed = outcomes.iter().any(|outcome| outcome.result.is_err());
    match written {
        Err(reason) => {
            console::error(&reason);
            return if exit == Exit::Done { Exit::Unwritten } else { exit };
        }
        Ok(true) => console::note(&format!(
            "wrote {}; it takes effect only if {} names it with the key `latency`",
            path.display(),
            args.fleet.display()
        )),
        Ok(false) => {}
    }
    if exit == Exit::Done && failed { Exit::Failed } else { exit }
}

fn usage(reason: &str) -> Exit {
    console::error(reason);
    Exit::Usage
}

/// Returns the existing entries of the latency file.
fn kept(path: &Path) -> Result<LatencyFile, Exit> {
    if !path.exists() {
        return Ok(LatencyFile::new());
    }
    read_latency_file(path).map_err(|findings| {
        load::show_findings(&findings);
        Exit::Usage
    })
}

/// Returns the path of the temporary file to which the new contents are written. The file is then renamed to `path`, so that nobody reads
/// an incomplete file.
fn part_of(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    path.with_file_name(name)
}

fn refused(path: &Path, error: &std::io::Error) -> String {
    format!("cannot write {}: {}", path.display(), Refusal::of(Attempt::Write(path), error))
}

/// Checks, before anything moves, that the latency file can be written.
fn writable(path: &Path) -> Result<(), String> {
    let part = part_of(path);
    let tried = std::fs::write(&part, "").and_then(|()| std::fs::remove_file(&part));
    tried.map_err(|error| refused(path, &error))
}

/// Asks on the terminal whether devices may be moved. Returns `None` if there is no terminal.
fn confirmed() -> Option<bool> {
    if !std::io::stdin().is_terminal() || !std::io::stderr().is_terminal() {
        return None;
    }
    console::note("these devices will move; is the area clear of people and obstacles? [y/N]");
    let _unseen = std::io::stderr().flush();
    let mut answer = String::new();
    let _nothing_read = std::io::stdin().lock().read_line(&mut answer);
    Some(matches!(answer.trim(), "y" | "Y" | "yes"))
}

/// Measures all robots, one after the other.
async fn all(
    fleet: &downbeat_scripts::Fleet,
    robots: &[PlannedRobot<'_>],
    args: &CalibrateArgs,
    format: Format,
) -> Result<(Vec<Outcome>, Exit), String> {
    let mut signals =
        Signals::listen(OnHangUp::End).map_err(|error| format!("cannot install signal handlers: {error}"))?;
    let site = identity::site(fleet)?;
    let of: Vec<_> = robots.iter().map(|planned| planned.robot).collect();
    let drivers = args.drivers.of(StartPrograms::Yes);
    let (host, endpoints) =
        fleet::endpoints_at_once(&of, fleet.handshake, &site, HostOptions::default(), drivers)
            .map_err(|error| error.to_string())?;
    if let Some(host) = &host {
        tokio::select! {
            () = fleet::await_hardware(host, drivers) => {}
            _ = signals.next() => return Ok((Vec::new(), Exit::Stopped)),
        }
    }
    let session = session()?;
    let (mut outcomes, mut exit) = (Vec::new(), Exit::Done);
    for (planned, endpoint) in robots.iter().zip(endpoints) {
        let ended = one(planned, endpoint, &session, args, format, &mut signals, &mut outcomes).await;
        if ended != Exit::Done {
            exit = ended;
            break;
        }
    }
    if let Some(host) = host {
        for robot in host.stop() {
            console::error(&robot.to_string());
            exit = Exit::Unconfirmed;
        }
    }
    Ok((outcomes, exit))
}

fn session() -> Result<Session, String> {
    let name = format!("calibrate@{}", std::process::id());
    let name = SessionId::new(name).map_err(|error| error.to_string())?;
    let key = SessionKey::random().map_err(|error| error.to_string())?;
    Session::with_key(name, &key).map_err(|error| error.to_string())
}

/// Measures the devices of one robot. Even after an error, orders devices that may have moved to stay where they are.
async fn one(
    planned: &PlannedRobot<'_>,
    endpoint: Endpoint,
    session: &Session,
    args: &CalibrateArgs,
    format: Format,
    signals: &mut Signals,
    outcomes: &mut Vec<Outcome>,
) -> Exit {
    let robot = &planned.robot.id;
    let clock = ServerClock::anchored(Span::ZERO);
    let begun = tokio::select! {
        begun = RobotDialogue::begin(planned.robot, endpoint, clock, session.clone(), args.patience) => begun,
        _ = signals.next() => return Exit::Stopped,
    };
    let mut talk = match begun {
        Ok(talk) => talk,
        Err(error) => {
            let failed = |device: &PlannedDevice| Outcome {
                robot: robot.clone(),
                device: device.device.to_string(),
                result: Err(error.to_string()),
            };
            outcomes.extend(planned.devices.iter().map(failed));
            return Exit::Done;
        }
    };
    for device in &planned.devices {
        let name = format!("{} {}", shown(robot.as_str()), shown(device.device.as_str()));
        let trials = usize::from(args.trials);
        let tell = |progress: crate::calibrate::Progress| {
            if format == Format::Text && progress.trials.is_multiple_of(10) {
                console::note(&format!("{name}: {} movements", progress.trials));
            }
        };
        let ended = tokio::select! {
            measured = measure(&mut talk, device, trials, tell) => measured.map_err(Ended::Error),
            _ = signals.next() => Err(Ended::Interrupted),
        };
        let held = talk.hold(&device.device).await;
        let (is_interrupted, link_lost) = match &ended {
            Err(Ended::Interrupted) => (true, false),
            Err(Ended::Error(NotMeasured::Dialogue(DialogueError::Link(_) | DialogueError::Silent(_)))) => {
                (false, true)
            }
            _ => (false, false),
        };
        let result = ended.map_err(|ended| match ended {
            Ended::Error(error) => error.to_string(),
            Ended::Interrupted => "interrupted".to_owned(),
        });
        outcomes.push(Outcome { robot: robot.clone(), device: device.device.to_string(), result });
        if let Err(error) = held {
            console::error(&format!("{name} may still be moving: {error}; the movement ends within 2 s"));
            return Exit::Unconfirmed;
        }
        if is_interrupted || link_lost {
            return if is_interrupted { Exit::Stopped } else { Exit::Unconfirmed };
        }
    }
    Exit::Done
}

/// Adds the measurements to the existing entries and writes the latency file. Returns whether there was anything to write.
fn write(path: &Path, mut file: LatencyFile, outcomes: &[Outcome]) -> Result<bool, String> {
    let mut any = false;
    for Outcome { robot, device, result } in outcomes {
        let (Ok(measured), Ok(device)) = (result, urrcp::DeviceId::new(device.as_str())) else { continue };
        file.entry(robot.clone()).or_default().insert(device, entry(measured));
        any = true;
    }
    if any {
        let part = part_of(path);
        let written = std::fs::write(&part, latency_text(&file)).and_then(|()| std::fs::rename(&part, path));
        written.map_err(|error| refused(path, &error))?;
    }
    Ok(any)
}

/// Rounds to a hundredth of a millisecond, because further digits are meaningless.
fn rounded(span: Span) -> Span {
    const STEP: i64 = 10_000;
    Span::from_nanos((span.as_nanos() + STEP / 2).div_euclid(STEP) * STEP)
}

#[expect(clippy::disallowed_methods, reason = "the date of the measurement, for people")]
fn entry(measured: &Measured) -> MeasuredLatency {
    let of = &measured.latencies;
    MeasuredLatency {
        median: rounded(of.median).max(Span::ZERO),
        spread: Some(rounded(of.spread)),
        p95: Some(rounded(of.p95).max(Span::ZERO)),
        trials: u32::try_from(of.trials).ok(),
        measured: Some(chrono::Utc::now().to_rfc3339_opts(SecondsFormat::Secs, true)),
        lag: measured.lag.map(|lag| Lag {
            time_constant: rounded(lag.time_constant),
            later: rounded(lag.later),
            ..lag
        }),
        tracking_lag: measured.tracking_lag.map(|lag| rounded(lag).max(Span::ZERO)),
    }
}

fn plan_text(robots: &[PlannedRobot<'_>], unplanned: &[Unplanned], args: &CalibrateArgs) -> String {
    let header = ["robot", "device", "sensor", "from", "by", "speed limit", "movements", "time"];
    let mut table = Rows::new(&header, 3);
    for (robot, device) in
        robots.iter().flat_map(|robot| robot.devices.iter().map(move |device| (robot, device)))
    {
        let unit = device.unit.as_deref().map(|unit| format!(" {unit}")).unwrap_or_default();
        let seconds = Span::from_millis(700) + device.lasts;
        table.add([
            robot.robot.id.to_string(),
            device.device.to_string(),
            device.how.sensor.to_string(),
            device.how.from.map_or_else(|| "current position".to_owned(), |from| format!("{from}{unit}")),
            format!("{}{unit}", device.how.by),
            device.speed.map_or_else(|| "-".to_owned(), |speed| format!("{speed}{unit}/s")),
            args.trials.to_string(),
            format!("about {} s", (seconds * i64::from(args.trials)).as_nanos() / 1_000_000_000 + 2),
        ]);
    }
    let mut text = if table.is_empty() { String::new() } else { table.text(console::columns()) };
    for alike in unplanned.chunk_by(|a, b| (&a.robot, &a.reason) == (&b.robot, &b.reason)) {
        let devices: Vec<_> = alike.iter().map(|one| shown(one.device.as_str()).to_string()).collect();
        let Unplanned { robot, reason, .. } = &alike[0];
        text += &format!("{}: {}: not measured: {reason}\n", shown(robot.as_str()), devices.join(", "));
    }
    text
}

fn plan_json(robots: &[PlannedRobot<'_>], unplanned: &[Unplanned]) -> serde_json::Value {
    let devices = robots.iter().flat_map(|robot| {
        robot.devices.iter().map(|device| {
            json!({
                "robot": robot.robot.id, "device": device.device, "sensor": device.how.sensor, "from": device.how.from,
                "by": device.how.by, "speed_limit": device.speed, "lasts_ms": device.lasts.as_millis_f64(),
            })
        })
    });
    json!({ "planned": devices.collect::<Vec<_>>(), "not_measured": unplanned })
}

fn outcome_text(outcomes: &[Outcome]) -> String {
    let header = [
        "robot",
        "device",
        "median",
        "known to",
        "spread",
        "p95",
        "time constant",
        "ramp lag",
        "sensor",
        "trials",
    ];
    let mut table = Rows::new(&header, 2);
    for Outcome { robot, device, result } in outcomes {
        let Ok(measured) = result else { continue };
        let of = &measured.latencies;
        let some = |span: Option<Span>| span.map_or_else(|| "-".to_owned(), |span| rounded(span).to_string());
        table.add([
            robot.to_string(),
            device.clone(),
            rounded(of.median).to_string(),
            format!("+-{}", rounded(of.median_error + measured.systematic)),
            format!("+-{}", rounded(of.spread)),
            rounded(of.p95).to_string(),
            some(measured.lag.map(|lag| lag.time_constant)),
            some(measured.tracking_lag),
            format!("every {}", rounded(measured.interval)),
            of.trials.to_string(),
        ]);
    }
    if table.is_empty() { String::new() } else { table.text(console::columns()) }
}

fn outcome_json(outcomes: &[Outcome], unplanned: &[Unplanned]) -> serde_json::Value {
    let millis = |span: Span| rounded(span).as_millis_f64();
    let devices = outcomes.iter().map(|Outcome { robot, device, result }| match result {
        Ok(measured) => {
            let of = &measured.latencies;
            json!({
                "robot": robot, "device": device, "median_ms": millis(of.median), "median_error_ms": millis(of.median_error),
                "systematic_ms": millis(measured.systematic), "spread_ms": millis(of.spread), "p95_ms": millis(of.p95),
                "trials": of.trials, "unclear": measured.unclear,
                "time_constant_ms": measured.lag.map(|lag| millis(lag.time_constant)), "lags": measured.lag.map(|lag| lag.lags),
                "later_ms": measured.lag.map(|lag| millis(lag.later)),
                "tracking_lag_ms": measured.tracking_lag.map(millis),
                "sensor_delay_ms": millis(measured.sensor_delay), "reading_interval_ms": millis(measured.interval),
            })
        }
        Err(reason) => json!({ "robot": robot, "device": device, "error": reason }),
    });
    json!({ "devices": devices.collect::<Vec<_>>(), "not_measured": unplanned })
}
