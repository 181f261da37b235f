//! `downbeat edge`: runs a real robot behind a driver, in its own process.
#![expect(
    clippy::disallowed_methods,
    reason = "repetitions on the terminal are left out by the time between them"
)]

use std::collections::VecDeque;
use std::ops::RangeInclusive;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use downbeat_robot::Hosted;
use downbeat_robot::driver::{
    DriverOptions, DriverSpec, HardwareEvent, PINGS_BOUNDS, READINGS_BOUNDS, SAMPLES_BOUNDS,
};
use downbeat_scripts::Address;
use downbeat_scripts::address_fault;
use urrcp::{DeviceId, InitializationBlock};

use super::drivers::DriverArgs;
use super::robot::{Body, ProcessArgs, failed};
use super::{Exit, Format, console};
use crate::fleet::driver_of;

/// Run a real robot behind a driver.
#[derive(Debug, clap::Args)]
#[command(after_help = "The command prints the address on which it listens and runs until Ctrl-C. Nothing \
moves when the command starts. When it ends, it brings moving devices to rest; if that fails, the exit code is 4. \
docs/edge.md describes drivers.

Drivers:
  sim                 drive nothing
  sacn:1/13, artnet:1/13@HOST  drive a DMX fixture: universe 1, first channel 13
  osc:HOST:PORT/PATH  send Open Sound Control messages
  mavlink:udp:HOST:PORT  fly a multicopter, in a build with the feature mavlink
  thrift://HOST:PORT  drive a robot that speaks Thrift URRCP
  program:COMMAND     write lines to a program's standard input

Examples:
  downbeat edge --init robot.yaml --listen 0.0.0.0:7401 --driver thrift://tank.local:9090
  downbeat edge --init robot.yaml --driver 'program:python3 drive.py' --realtime required
  downbeat edge --init robot.yaml --driver 'program:python3 drive.py' --driver-start-timeout 60s
  downbeat edge --init robot.yaml --driver sim --samples-per-second 25 --samples-per-second arm=100")]
pub(super) struct EdgeArgs {
    #[command(flatten)]
    process: ProcessArgs,
    /// The driver of the hardware.
    #[arg(long, value_parser = driver_named)]
    driver: DriverSpec,
    /// Samples per second of a linear movement, if the hardware does not move linearly by itself: NUMBER for all devices, or
    /// DEVICE=NUMBER; 0.1 to 1000. By default, as the driver declares, or 50.
    #[arg(long, value_name = "RATE", value_parser = samples)]
    samples_per_second: Vec<Samples>,
    /// Pings per second in the second before a start, half as many while a script is held; 10 to 200. By default, as the driver declares,
    /// or 40.
    #[arg(long, value_name = "NUMBER", value_parser = pings)]
    pings_per_second: Option<f64>,
    /// Maximum reads per second of each sensor. Requests in between are answered with the last reading. 0.01 to 1000. By default, as the
    /// driver declares, or as often as a reading is requested.
    #[arg(long, value_name = "NUMBER", value_parser = readings)]
    readings_per_second: Option<f64>,
    #[command(flatten)]
    patience: DriverArgs,
}

/// The accepted forms of `--driver`, for messages to the user.
const DRIVERS: &str = "sim, sacn:UNIVERSE/CHANNEL, artnet:UNIVERSE/CHANNEL@host, osc:host:port/path, mavlink:udp:host:port, thrift://host:port or program:COMMAND";

/// Samples per second of one device, or of all devices if `device` is `None`.
#[derive(Clone, Debug, PartialEq)]
struct Samples {
    device: Option<DeviceId>,
    rate: f64,
}

fn driver_named(text: &str) -> Result<DriverSpec, String> {
    let address = text.parse::<Address>().ok();
    let spec = address.as_ref().and_then(driver_of);
    spec.ok_or_else(|| match address_fault(text) {
        (_, Some(hint)) if address.is_none() && hint.starts_with("write ") => hint,
        _ => format!("unknown driver `{text}`, expected {DRIVERS}"),
    })
}

fn samples(text: &str) -> Result<Samples, String> {
    let (device, number) = match text.rsplit_once('=') {
        Some((device, number)) => (Some(device), number),
        None => (None, text),
    };
    let device = device.map(DeviceId::new).transpose().map_err(|error| error.to_string())?;
    Ok(Samples { device, rate: rate(number, &SAMPLES_BOUNDS)? })
}

fn pings(text: &str) -> Result<f64, String> {
    rate(text, &PINGS_BOUNDS)
}

fn readings(text: &str) -> Result<f64, String> {
    rate(text, &READINGS_BOUNDS)
}

fn rate(text: &str, bounds: &RangeInclusive<f64>) -> Result<f64, String> {
    let rate: Option<f64> = text.parse().ok();
    rate.filter(|rate| bounds.contains(rate))
        .ok_or_else(|| format!("expected a number from {} to {}", bounds.start(), bounds.end()))
}

/// Converts the command-line arguments to the driver's options.
fn options(args: &EdgeArgs, block: &InitializationBlock) -> Result<DriverOptions, String> {
    let mut options = DriverOptions::default();
    options.pings_per_second = args.pings_per_second;
    options.readings_per_second = args.readings_per_second;
    for Samples { device, rate } in &args.samples_per_second {
        options = match device {
            None => options.with_samples_per_second(*rate),
            Some(device) if block.device(device.as_str()).is_some() => {
                options.with_samples_of(device.clone(), *rate)
            }
            Some(device) => {
                let devices: Vec<_> = block.devices.iter().map(|device| device.id.as_str()).collect();
                return Err(format!(
                    "--samples-per-second: unknown device `{device}`, expected one of {}",
                    devices.join(", ")
                ));
            }
        };
    }
    Ok(options)
}

pub(super) fn edge(args: &EdgeArgs, format: Format) -> Exit {
    let block = match args.process.block() {
        Ok(block) => block,
        Err(exit) => return exit,
    };
    if let Some(missing) = missing_program(&args.driver) {
        return failed(&format!(
            "the program `{missing}` named by --driver does not exist; correct its path"
        ));
    }
    let driver = match args.driver.driver_within(&block, args.patience.timeouts()) {
        Ok(driver) => driver,
        Err(error) => return failed(&error.to_string()),
    };
    let used = match options(args, &block) {
        Ok(used) => used,
        Err(why) => return failed(&why),
    };
    let id = block.id.clone();
    let told = Mutex::new(PrintedLines::default());
    let name = id.to_string();
    let watch = move |event: &HardwareEvent| {
        let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(line) = told.line(&name, event, Instant::now()) {
            match event {
                HardwareEvent::There { .. } => console::note(&line),
                _ => console::warn(&line),
            }
        }
    };
    args.process.run(id, Hosted::driven(block, driver, used).watched(watch), Body::Real, format)
}

/// A time and a number of lines. Within this time, the same line is printed only once, and at most this number of lines are printed.
const QUIET: (Duration, usize) = (Duration::from_secs(10), 8);

/// The lines about the hardware that were printed on the terminal.
#[derive(Debug, Default)]
struct PrintedLines {
    /// The lines of the last ten seconds.
    lines: VecDeque<(Instant, String)>,
    /// Whether the last printed line about the hardware's availability reported that it is unavailable.
    lost: bool,
    latency_told: bool,
}

impl PrintedLines {
    /// Returns the line to print for an event, if any. After a printed line has reported unavailable hardware, the return of the hardware
    /// is always printed.
    fn line(&mut self, robot: &str, event: &HardwareEvent, now: Instant) -> Option<String> {
        let line = match event {
            HardwareEvent::There { .. } if std::mem::take(&mut self.lost) => {
                return Some(format!("{robot}: the hardware is available again"));
            }
            // Available hardware without a reported latency is not worth a line.
            HardwareEvent::There { latency } if latency.is_empty() || self.latency_told => return None,
            HardwareEvent::There { .. } => {
                self.latency_told = true;
                return Some(format!("{robot}: {event}"));
            }
            _ => format!("{robot}: {}", event),
        };
        while self.lines.front().is_some_and(|(at, _)| now.saturating_duration_since(*at) >= QUIET.0) {
            self.lines.pop_front();
        }
        if self.lines.len() >= QUIET.1 || self.lines.iter().any(|(_, told)| *told == line) {
            return None;
        }
        self.lines.push_back((now, line.clone()));
        self.lost |= matches!(event, HardwareEvent::Lost(_));
        Some(line)
    }
}

/// Returns the first word of a program's command if it is a path of a file that does not exist. Words that the shell looks up or expands
/// are not checked.
fn missing_program(driver: &DriverSpec) -> Option<&str> {
    let DriverSpec::Program { command } = driver else { return None };
    let file = command.split_whitespace().next()?;
    let plain = file.contains('/') && !file.contains(['$', '~', '\'', '"', ';', '|', '&', '(']);
    (plain && !std::path::Path::new(file).exists()).then_some(file)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn hardware_loss_and_return_are_each_printed_once() {
        let (begin, mut told) = (Instant::now(), PrintedLines::default());
        let lost = HardwareEvent::Lost("the hardware is not available: no port".to_owned());
        let there = HardwareEvent::There { latency: BTreeMap::new() };
        let mut at = |seconds, event| told.line("r", event, begin + Duration::from_secs(seconds));
        assert_eq!(at(0, &there), None, "that it is there at first is no news");
        assert_eq!(at(1, &lost).as_deref(), Some("r: the hardware is not available: no port"));
        assert_eq!(at(2, &lost), None);
        assert_eq!(at(3, &there).as_deref(), Some("r: the hardware is available again"));
        assert_eq!(at(4, &lost), None);
        assert_eq!(at(5, &there), None, "that it was away again was not told");
        assert_eq!(at(6, &lost), None);
        assert_eq!(at(11, &lost).as_deref(), Some("r: the hardware is not available: no port"));
    }

    #[test]
    fn sample_options_apply_to_all_devices_or_one_within_bounds() {
        assert_eq!(samples("25"), Ok(Samples { device: None, rate: 25.0 }));
        let arm = DeviceId::new("arm").unwrap();
        assert_eq!(samples("arm=100"), Ok(Samples { device: Some(arm), rate: 100.0 }));
        for wrong in ["", "arm=", "=3", "nan", "0", "arm=1001"] {
            assert!(samples(wrong).is_err(), "{wrong}");
        }
        assert_eq!(pings("5"), Err("expected a number from 10 to 200".to_owned()));
        assert_eq!(readings("0.001"), Err("expected a number from 0.01 to 1000".to_owned()));
    }

    #[test]
    fn many_different_faults_print_only_a_few_lines() {
        let (now, mut told) = (Instant::now(), PrintedLines::default());
        let events = (0..100).map(|i| HardwareEvent::Unread(format!("fault {i}")));
        assert_eq!(events.filter_map(|event| told.line("r", &event, now)).count(), QUIET.1);
    }
}
