//! The times that devices take from a command to visible motion: the key `latency` of a robot, and the file of measured latencies that
//! `downbeat calibrate` writes. This module reads, writes and merges them; the compiler compensates for them.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};
use urrcp::{Device, DeviceId, InitializationBlock, Latency, RobotId, Span};

use super::RobotKeys;
use super::declared::device_named;
use crate::kinds;
use downbeat_import::scalar;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys;
use downbeat_reader::keys::{Declaration, Item, Kind, Naming};
use downbeat_yaml::duration::written;
use downbeat_yaml::finding::{Code, Finding, Place};
use downbeat_yaml::locate::locate;
use downbeat_yaml::node::{self, Node};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

/// Maximum latency, and also maximum spread of a latency.
const LATENCY_MAX: Span = Span::from_millis(10_000);
/// Maximum number of measured motions that a latency file may state for one device.
const TRIALS_MAX: u32 = 1_000_000;

keys! {
    /// A latency.
    pub(crate) struct LatencyKeys {
        /// Half of all motions start no later.
        #[required]
        median: kinds::TIME,
        /// 95 % of all motions start within the median ± this.
        spread: kinds::TIME,
    }
}

keys! {
    /// A latency file.
    pub(crate) struct FileKeys {
        /// Latencies by robot and by device.
        #[required]
        latency: Kind::NameKeys(Naming::Uses(Item::Robot), &Kind::Entries(&Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&MeasuredKeys::KIND)))),
    }
}

keys! {
    /// The measured latency of a device.
    pub(crate) struct MeasuredKeys {
        /// Half of all motions start no later.
        #[required]
        median: kinds::TIME,
        /// 95 % of all motions start within the median ± this.
        spread: kinds::TIME,
        /// 95 % of all motions start no later.
        p95: kinds::TIME,
        /// The number of measured motions.
        trials: kinds::COUNT,
        /// The time of the measurement.
        measured: kinds::TEXT,
        /// The sum of the time constants of all first-order lags with which the device follows.
        time_constant: kinds::TIME,
        /// The number of such lags in series.
        #[default("1")]
        lags: kinds::COUNT,
        /// How much later the device visibly starts than such lags alone.
        #[default("0s")]
        later: kinds::SIGNED_TIME,
        /// How far the device lags behind a movement of constant speed.
        tracking_lag: kinds::TIME,
    }
}

/// Returns the declaration of the keys of latency files.
#[must_use]
pub fn latency_keys() -> &'static Declaration {
    FileKeys::declaration()
}

/// The latency of a device, which the compiler compensates for, and its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct DeviceLatency {
    /// The latency of the device.
    #[serde(flatten)]
    pub latency: Latency,
    /// The source of the latency.
    pub from: LatencySource,
    /// The lag with which the device follows its commands; `None` if it was not measured. The compiler does not compensate for it.
    #[serde(skip)]
    pub lag: Option<Lag>,
}

/// The lag with which a device follows its commands, modelled as equal first-order lags in series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lag {
    /// The sum of the time constants of all lags: the time by which the device lags behind a value that changes at constant speed.
    pub time_constant: Span,
    /// The number of lags in series. With 1, the device starts immediately at full speed towards the value; with 2, it starts softly.
    pub lags: u8,
    /// How much later the device visibly starts than the lags alone would, for example because of static friction. Negative if it starts
    /// earlier.
    pub later: Span,
}

/// Maximum number of lags in series.
pub const LAGS_MAX: u8 = 2;

/// The source of a latency. The first source takes precedence over the later ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LatencySource {
    /// The key `latency` of the robot in the fleet file.
    Fleet,
    /// The file of measured latencies.
    File,
    /// The robot's initialization block.
    Robot,
}

impl fmt::Display for LatencySource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Fleet => "fleet",
            Self::File => "file",
            Self::Robot => "robot",
        })
    }
}

/// The measured latency of one device. Values that are not known are `None`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MeasuredLatency {
    /// The median time from a command to the first visible motion.
    pub median: Span,
    /// Half-width of the interval around the median that contains 95 % of all measured latencies.
    pub spread: Option<Span>,
    /// The 95th percentile of the measured latencies.
    pub p95: Option<Span>,
    /// The number of measured motions.
    pub trials: Option<u32>,
    /// The time of the measurement, as text.
    pub measured: Option<String>,
    /// The lag with which the device follows its commands.
    pub lag: Option<Lag>,
    /// The time by which the device lags behind a value that changes at constant speed.
    pub tracking_lag: Option<Span>,
}

/// The contents of a file of measured latencies, by the robot's key in the fleet file and by device id.
pub type LatencyFile = BTreeMap<RobotId, BTreeMap<DeviceId, MeasuredLatency>>;

/// Reads a file of measured latencies.
///
/// # Errors
/// Returns findings if the text is not a file of measured latencies, or if a latency is negative or longer than 10 s.
pub fn latency_file_of(source: &Source) -> Result<LatencyFile, Vec<Finding>> {
    let document = node::parse(source).map_err(|finding| vec![finding])?;
    let mut findings = Reader::default();
    let file = read_file(&mut findings, &At::document(&document, 0));
    let findings = locate(std::slice::from_ref(source), findings.finish());
    if findings.is_empty() { Ok(file) } else { Err(findings) }
}

/// Like [`latency_file_of`], but reads a file whose path the user has specified.
///
/// # Errors
/// Returns findings if the file cannot be read, and for the errors of [`latency_file_of`].
pub fn read_latency_file(path: &Path) -> Result<LatencyFile, Vec<Finding>> {
    latency_file_of(&Source::read(path).map_err(|finding| vec![finding])?)
}

/// Formats measured latencies as the text of a file. [`latency_file_of`] reads it back.
#[must_use]
pub fn latency_text(file: &LatencyFile) -> String {
    let mut text = String::from("# Written by `downbeat calibrate`.\nlatency:\n");
    if file.is_empty() {
        text = text.replace("latency:\n", "latency: {}\n");
    }
    for (robot, devices) in file {
        text += &format!("  {}:{}\n", scalar(robot.as_str()), if devices.is_empty() { " {}" } else { "" });
        for (device, measured) in devices {
            text += &format!("    {}: {{{}}}\n", scalar(device.as_str()), entry(measured));
        }
    }
    text
}

fn entry(measured: &MeasuredLatency) -> String {
    let MeasuredLatency { median, spread, p95, trials, measured, lag, tracking_lag } = measured;
    let time = |key: &str, span: &Option<Span>| span.map(|span| format!("{key}: {}", written(span)));
    let parts = [
        time("median", &Some(*median)),
        time("spread", spread),
        time("p95", p95),
        trials.map(|trials| format!("trials: {trials}")),
        // Without quotes, an instant would be read as a date.
        measured.as_ref().map(|measured| format!("measured: {}", serde_json::Value::from(measured.as_str()))),
        time("time_constant", &lag.map(|lag| lag.time_constant)),
        lag.map(|lag| format!("lags: {}", lag.lags)),
        time("later", &lag.map(|lag| lag.later).filter(|later| *later != Span::ZERO)),
        time("tracking_lag", tracking_lag),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// Reads the parsed contents of a file of measured latencies.
pub(super) fn read_file(findings: &mut Reader, at: &At<'_>) -> LatencyFile {
    let mut file = LatencyFile::new();
    let keys = findings.keys(at, "the file of measured latencies");
    let Some(FileKeys { latency: Some(latency) }) = keys else { return file };
    for (name, at) in findings.entries(&latency, "a map from each robot id to the latencies of its devices") {
        let Some(robot) = id(findings, RobotId::new(name), &at, "a robot id of 1 to 256 characters") else {
            continue;
        };
        let devices = file.entry(robot).or_default();
        for (name, at) in findings.entries(&at, "a map from each device id to its latency") {
            let device = id(findings, DeviceId::new(name), &at, "a device id of 1 to 256 characters");
            let measured = read_measured(findings, &at);
            devices.extend(device.zip(measured));
        }
    }
    file
}

fn id<T>(findings: &mut Reader, id: Result<T, urrcp::LimitError>, at: &At<'_>, expected: &str) -> Option<T> {
    id.map_err(|wrong| {
        findings.add(Code::WrongType, at.key_place(), wrong.to_string(), expected, None);
    })
    .ok()
}

fn read_measured(findings: &mut Reader, at: &At<'_>) -> Option<MeasuredLatency> {
    let MeasuredKeys { median, spread, p95, trials, measured, time_constant, lags, later, tracking_lag } =
        findings.keys(at, "a measured latency")?;
    let mut span = |at: Option<At<'_>>| at.and_then(|at| latency_span(findings, &at));
    let (median, spread, p95) = (span(median), span(spread), span(p95));
    let (time_constant, tracking_lag) = (span(time_constant), span(tracking_lag));
    let trials = trials.and_then(|at| findings.count(&at, 1, TRIALS_MAX));
    let measured = measured
        .and_then(|at| findings.text(&at, "a date and time as quoted text, such as '2026-05-01T19:30:00Z'"));
    let measured = measured.map(Into::into);
    let lags = lags.and_then(|at| findings.count(&at, 1, u32::from(LAGS_MAX)));
    let lags = lags.map_or(1, |lags| u8::try_from(lags).unwrap_or(LAGS_MAX));
    let later =
        later.and_then(|at| findings.signed_duration(&at).and_then(|span| possible(findings, &at, span)));
    let later = later.unwrap_or_default();
    let lag = time_constant.map(|time_constant| Lag { time_constant, lags, later });
    Some(MeasuredLatency { median: median?, spread, p95, trials, measured, lag, tracking_lag })
}

/// Reads a time from 0 to [`LATENCY_MAX`].
fn latency_span(findings: &mut Reader, at: &At<'_>) -> Option<Span> {
    let span = findings.duration(at)?;
    possible(findings, at, span)
}

fn possible(findings: &mut Reader, at: &At<'_>, span: Span) -> Option<Span> {
    if span.abs() <= LATENCY_MAX {
        return Some(span);
    }
    let message = format!("a latency of {span} is out of range");
    let hint = Some("the latency is the time from a command to the first visible motion".to_owned());
    findings.add(Code::BadDuration, at.place(), message, format!("at most {LATENCY_MAX}"), hint);
    None
}

/// Reads the key `latency` of a robot: one time for all devices that take commands, or one for each device.
fn read_own(findings: &mut Reader, at: &At<'_>, init: &InitializationBlock) -> BTreeMap<DeviceId, Latency> {
    let takes_commands = |device: &&Device| device.primary_control_type().is_some();
    let commanded = init.devices.iter().filter(takes_commands);
    if !matches!(at.node, Node::Map(_)) {
        let Some(median) = latency_span(findings, at) else { return BTreeMap::new() };
        let latency = Latency { median, spread: Span::ZERO };
        return commanded.map(|device| (device.id.clone(), latency)).collect();
    }
    let mut own = BTreeMap::new();
    for (name, at) in findings.entries(at, "a map from each device to its latency") {
        let known = || init.devices.iter().filter(takes_commands).map(|device| device.id.as_str());
        let device = device_named(init, name).filter(takes_commands);
        if device.is_none() {
            let shown = shortened(name);
            let message = match device_named(init, name) {
                Some(_) => format!("the device `{shown}` does not accept commands"),
                None => format!("the robot has no device `{shown}`"),
            };
            let hint = findings.did_you_mean(name, known());
            findings.add(
                Code::UnknownDevice,
                at.key_place(),
                message,
                downbeat_yaml::finding::one_of(known()),
                hint,
            );
        }
        let latency = read_latency(findings, &at);
        own.extend(device.map(|device| device.id.clone()).zip(latency));
    }
    own
}

/// Reads a latency: `41ms`, or `{median: 41ms, spread: 3ms}`.
fn read_latency(findings: &mut Reader, at: &At<'_>) -> Option<Latency> {
    if !matches!(at.node, Node::Map(_)) {
        return latency_span(findings, at).map(|median| Latency { median, spread: Span::ZERO });
    }
    let LatencyKeys { median, spread } = findings.keys(at, "a latency")?;
    let spread = spread.and_then(|at| latency_span(findings, &at));
    let median = median.and_then(|at| latency_span(findings, &at))?;
    Some(Latency { median, spread: spread.unwrap_or_default() })
}

/// Returns the latency of each device: the one in the fleet file, or else the measured one, or else the one that the robot declares.
/// Leaves out devices without a known latency.
pub(super) fn read(
    findings: &mut Reader,
    keys: &RobotKeys<'_>,
    init: &InitializationBlock,
    measured: Option<&BTreeMap<DeviceId, MeasuredLatency>>,
) -> BTreeMap<DeviceId, DeviceLatency> {
    let own = keys.latency.as_ref().map(|at| read_own(findings, at, init)).unwrap_or_default();
    let of = |device: &Device| {
        let from = |from| move |latency| DeviceLatency { latency, from, lag: None };
        let of_file = |measured: &MeasuredLatency| DeviceLatency {
            latency: Latency { median: measured.median, spread: measured.spread.unwrap_or_default() },
            from: LatencySource::File,
            lag: measured.lag,
        };
        let fleet = || own.get(&device.id).copied().map(from(LatencySource::Fleet));
        let file = || measured?.get(&device.id).map(of_file);
        let robot = || device.actuation_latency().map(from(LatencySource::Robot));
        Some((device.id.clone(), fleet().or_else(file).or_else(robot)?))
    };
    init.devices.iter().filter_map(of).collect()
}

/// Returns the place of a robot, or of one of its devices, in the file of measured latencies.
fn place_in_file(file: u16, robot: &RobotId, device: Option<&DeviceId>) -> Place {
    let of_file = Place { file, path: Vec::new(), key: true, within: None, used: None };
    let of_robot = of_file.of_key("latency").of_key(robot.as_str());
    let place = device.map_or(of_robot.clone(), |device| of_robot.of_key(device.as_str()));
    Place { key: true, ..place }
}

/// Warns about robots that occur in the file of measured latencies but not in the fleet. This is not an error, because measured latencies
/// outlive fleets.
pub(super) fn warn_of_robots(findings: &mut Reader, file: u16, measured: &LatencyFile, fleet: &Node) {
    let Node::Map(robots) = fleet else { return };
    let known = || robots.iter().map(|(name, _)| name.as_str());
    let names: HashSet<&str> = known().collect();
    for robot in measured.keys().filter(|robot| !names.contains(robot.as_str())) {
        let message = format!("the latency file contains the unknown robot `{robot}`");
        let hint = findings.did_you_mean(robot.as_str(), known());
        let expected = downbeat_yaml::finding::one_of(known());
        findings.add(Code::StaleLatency, place_in_file(file, robot, None), message, expected, hint);
    }
}

/// Warns about devices that occur in the file of measured latencies but that the robot does not have.
pub(super) fn warn_of_devices(
    findings: &mut Reader,
    file: u16,
    robot: &RobotId,
    measured: &BTreeMap<DeviceId, MeasuredLatency>,
    init: &InitializationBlock,
) {
    let known = || init.devices.iter().map(|device| device.id.as_str());
    for device in measured.keys().filter(|device| init.device(device.as_str()).is_none()) {
        let message = format!("the latency file contains the unknown device `{device}` of `{robot}`");
        let hint = findings.did_you_mean(device.as_str(), known());
        let expected = downbeat_yaml::finding::one_of(known());
        findings.add(Code::StaleLatency, place_in_file(file, robot, Some(device)), message, expected, hint);
    }
}

#[cfg(test)]
mod tests;
