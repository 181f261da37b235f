//! Checks of the first four steps of the protocol: the robot's availability, description and clock.

use urrcp::{ControlType, InitializationBlock, Span};

use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::trial::Trial;
use downbeat_mission::clock::{ClockEstimate, ClockReading, ClockSample};

pub(super) const ALL: [Requirement; 5] = [
    Requirement {
        name: "availability",
        number: "core-1",
        demands: "An availability request is answered with `OK`; originate_timestamp repeats the timestamp of the request, and receive_timestamp is no later than timestamp.",
        section: "Availability",
        check: availability,
    },
    Requirement {
        name: "initialization",
        number: "core-2",
        demands: "An initialization request is answered with the same block on each connection, and the block is within all limits.",
        section: "Initialization",
        check: initialization,
    },
    Requirement {
        name: "api-version",
        number: "core-3",
        demands: "The api_version is `1` or `1.` followed by a number: this test checks robots of version 1.",
        section: "Versions (D)",
        check: api_version,
    },
    Requirement {
        name: "skip-handshake",
        number: "core-4",
        demands: "A control request is processed even if it is the very first message of a connection.",
        section: "Messages (D)",
        check: skip_handshake,
    },
    Requirement {
        name: "clock",
        number: "core-5",
        demands: "The robot's clock agrees with that of this machine to within 50 ms, plus the uncertainty of the exchange.",
        section: "Availability",
        check: clock,
    },
];

/// Number of request-response exchanges per clock comparison.
const SAMPLES: u32 = 8;
/// Maximum clock offset up to which starts can be judged without correction.
const CLOCK_OFFSET_MAX: Span = Span::from_millis(50);

fn availability(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    for _ in 0..2 {
        let (sent, _, heard) = line.availability()?;
        let response = &heard.message;
        let request = urrcp_timestamp(&sent);
        if response.originate_timestamp.map(|at| at.to_string()) != request {
            let expected = "originate_timestamp equal to the timestamp of the request, to the last digit";
            return Err(differs(&sent, &heard.text, expected));
        }
        if response.receive_timestamp > response.timestamp {
            return Err(differs(&sent, &heard.text, "receive_timestamp no later than timestamp"));
        }
    }
    pass()
}

/// Extracts the timestamp from the JSON of an availability request.
fn urrcp_timestamp(sent: &str) -> Option<String> {
    let json: serde_json::Value = serde_json::from_str(sent).ok()?;
    json["availability_request"]["timestamp"].as_str().map(str::to_owned)
}

fn initialization(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let (sent, first) = line.initialization()?;
    let block = &first.message;
    let wrong = |what: String| Err(differs(&sent, &first.text, &what));
    for device in &block.devices {
        let id = &device.id;
        let primary = device.primary_control_type();
        let limits = primary.and_then(|primary| device.available_control_types.limits(primary));
        if let (Some(value), Some(limits)) = (device.default_value, limits)
            && !limits.contains(value)
        {
            return wrong(format!(
                "default_value of `{id}` from {} to {}",
                limits.min_value, limits.max_value
            ));
        }
        let Some(script) = device.available_control_types.script() else { continue };
        let lists = script.control_types.iter().flatten();
        let mut stray = lists.filter(|t| {
            matches!(t, ControlType::Script | ControlType::Sensor)
                || device.available_control_types.get(**t).is_none()
        });
        if let Some(stray) = stray.next() {
            return wrong(format!(
                "script control_types of `{id}` that the device itself supports, other than script and sensor; found {stray}"
            ));
        }
    }
    if block.pending_until && !block.inquiry {
        return wrong("`inquiry` with `pending_until`".to_owned());
    }
    let (_, second) = line.initialization()?;
    has_block(trial, &second.message)?;
    if second.message == first.message {
        Ok(format!("{} with {}", block.id, downbeat_yaml::render::counted(block.devices.len(), "device")))
    } else {
        Err(differs(&sent, &second.text, "the same block as before"))
    }
}

/// Checks that the robot sends the same block on a new connection.
fn has_block(trial: &Trial, block: &InitializationBlock) -> Result<(), Unmet> {
    let (sent, again) = trial.connect()?.initialization()?;
    if again.message == *block {
        return Ok(());
    }
    Err(differs(&sent, &again.text, "the same block as on the connection before"))
}

fn api_version(trial: &Trial) -> Checked {
    let version = trial.block()?.api_version.as_str();
    let (major, minor) = version.split_once('.').unwrap_or((version, "0"));
    if major == "1" && !minor.is_empty() && minor.bytes().all(|digit| digit.is_ascii_digit()) {
        return Ok(version.to_owned());
    }
    Err(Unmet::Failed(format!("the api_version is `{version}`, expected `1` or `1.` followed by a number")))
}

pub(super) fn skip_handshake(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect_silently()?;
    line.held(&trial.pending(actor))?;
    pass()
}

/// Compares the clocks of server and robot by several exchanges, each with the four timestamps of NTP.
pub(super) fn compare_clocks(trial: &Trial) -> Result<ClockReading, Unmet> {
    let mut line = trial.connect()?;
    let mut estimate = ClockEstimate::default();
    for _ in 0..SAMPLES {
        let (_, sent, heard) = line.availability()?;
        let response = heard.message;
        estimate.add(ClockSample::from_exchange(
            sent,
            response.receive_timestamp,
            response.timestamp,
            heard.at,
        ));
    }
    estimate.reading().ok_or_else(|| not_applicable("no exchange produced a clock reading"))
}

/// Whether the robot's clock is accurate enough to judge starts without correction.
pub(super) fn agrees(reading: &ClockReading) -> bool {
    reading.offset.abs() <= reading.uncertainty + CLOCK_OFFSET_MAX
}

fn clock(trial: &Trial) -> Checked {
    let reading = compare_clocks(trial)?;
    let measured = format!("{} ahead, +-{}", reading.offset, reading.uncertainty);
    if agrees(&reading) || trial.options().clock_measured {
        Ok(measured)
    } else {
        Err(Unmet::Failed(format!(
            "according to {SAMPLES} exchanges, the robot's clock is {measured}; expected an offset of at most {CLOCK_OFFSET_MAX} plus this uncertainty: \
         synchronize the clock by NTP, or use `--clock measured`; all other requirements were checked by the robot's own clock"
        )))
    }
}
