//! Draws the robots of a seed: their devices, their deviations from the protocol, and their links.

use downbeat_robot::simulated::Settings;
use fastrand::Rng;
use urrcp::{InitializationBlock, RobotId, Span};

use super::{millis, one_in};
use downbeat_mission::ClockMode;

/// How a robot lies in its reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lie {
    /// The robot accepts scripts and reports starts and ends, but does not move.
    NeverMoves,
    /// The robot reports times that are wrong by the given span.
    WrongTime(Span),
    /// The robot accepts a script and forgets it at once.
    Forgets,
    /// The robot returns a wrong content hash.
    WrongHash,
    /// The robot reports more completed steps than any script has.
    TooManySteps,
}

/// Whether the responses of a robot contain the id of the request that they answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Names {
    /// The responses contain the request id.
    Echoed,
    /// The responses omit the request id.
    LeftOut,
}

/// Which connections a robot serves if there are several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Connections {
    /// The robot serves only the newest connection and closes the older one.
    Newest,
    /// The robot serves only the oldest connection. It accepts another one, but reads no message from it until the oldest has ended.
    One,
}

/// What moves: the robot itself, or hardware behind it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hands {
    /// The robot itself moves.
    Own,
    /// The robot is an edge: it controls separate hardware, which moves and may fail independently.
    Hardware,
}

/// A robot as drawn from a seed.
#[derive(Clone, Debug)]
pub struct DrawnRobot {
    /// The robot's description.
    pub block: InitializationBlock,
    /// The settings of the simulated robot, including its clock.
    pub settings: Settings,
    /// How the mission reconciles the robot's time with the server's.
    pub clock: ClockMode,
    /// How the robot lies in its reports, if it does.
    pub lie: Option<Lie>,
    /// Time that the robot takes to process a request before each response, in addition to the network delay.
    pub slow: Span,
    /// Whether the robot's responses contain request ids.
    pub names: Names,
    /// Which connections the robot serves.
    pub connections: Connections,
    /// What moves: the robot itself, or hardware behind it.
    pub hands: Hands,
    /// Bandwidth of the robot's link in each direction, in bytes per second. `None`: unlimited.
    pub bandwidth: Option<u32>,
    /// Time from the start of the mission until the robot's process starts.
    pub there_from: Span,
}

/// The size of a show, by the length of its scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Show {
    /// Scripts of a few steps.
    Small,
    /// Scripts of hundreds of steps.
    Large,
}

pub(super) fn draw_robot(rng: &mut Rng, index: usize, show: Show) -> DrawnRobot {
    let measured = one_in(rng, 5);
    let inquires = !one_in(rng, 5);
    let lie = one_in(rng, 12).then(|| draw_lie(rng));
    // A robot that omits its results cannot lie about them.
    let leaves_out = !inquires && rng.bool() && lie != Some(Lie::TooManySteps);
    let names = if leaves_out { Names::LeftOut } else { Names::Echoed };
    DrawnRobot {
        block: draw_block(rng, index, inquires, show),
        settings: draw_settings(rng, measured),
        clock: if measured { ClockMode::Measured } else { ClockMode::Ntp },
        lie,
        slow: if one_in(rng, 8) { millis(rng, 0, 60) } else { Span::ZERO },
        names,
        connections: if one_in(rng, 6) { Connections::One } else { Connections::Newest },
        hands: if one_in(rng, 5) { Hands::Hardware } else { Hands::Own },
        bandwidth: draw_bandwidth(rng, show),
        there_from: if one_in(rng, 20) { millis(rng, 0, 450) } else { Span::ZERO },
    }
}

fn draw_bandwidth(rng: &mut Rng, show: Show) -> Option<u32> {
    match show {
        // Large scripts require at least the bandwidth that every link is assumed to have.
        Show::Large => Some(rng.u32(10_000_000..=40_000_000)),
        Show::Small => one_in(rng, 8).then(|| rng.u32(100_000..=2_000_000)),
    }
}

/// Draws the clock of a robot: it is right, wrong by some milliseconds, or not controlled by NTP.
fn draw_settings(rng: &mut Rng, measured: bool) -> Settings {
    let (offset, drift) = match measured {
        true => (millis(rng, -2_000, 2_000), 100.0),
        false if one_in(rng, 6) => (millis(rng, -40, 40), 10.0),
        false => (millis(rng, -2, 2), 10.0),
    };
    Settings {
        clock_offset: offset,
        drift_ppm: (rng.f64() - 0.5) * drift,
        ntp_error: None,
        seed: rng.u64(..),
        ..Settings::default()
    }
}

fn draw_lie(rng: &mut Rng) -> Lie {
    match rng.u8(0..5) {
        0 => Lie::NeverMoves,
        1 => Lie::WrongTime(millis(rng, -100, 100)),
        2 => Lie::Forgets,
        3 => Lie::WrongHash,
        _ => Lie::TooManySteps,
    }
}

fn draw_block(rng: &mut Rng, index: usize, inquiry: bool, show: Show) -> InitializationBlock {
    let linear = rng.bool();
    let default = if rng.bool() { r#""default_value": 0, "# } else { "" };
    let steps = if show == Show::Large { 400 } else { 16 };
    let device = |name: &str, queue: u32| {
        format!(
            r#"{{"id": "{name}", "name": "{name}", {default}"interpolation": "{}", "script_queue": {queue},
              "available_control_types": {{
                "position": {{"min_value": 0, "max_value": 90, "granularity": 1}},
                "script": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": {steps}}}}}}}"#,
            if linear { "linear" } else { "hold" }
        )
    };
    let names = &["a", "b"][..rng.usize(1..=2)];
    let mut devices: Vec<_> = names.iter().map(|name| device(name, rng.u32(1..=4))).collect();
    devices.push(
        r#"{"id": "eye", "name": "eye", "available_control_types": {
          "sensor": {"min_value": 0, "max_value": 90, "granularity": 1}}}"#
            .to_owned(),
    );
    let reports = !one_in(rng, 6);
    let json = format!(
        r#"{{"id": "r{index}", "api_version": "1", "reports": {reports}, "inquiry": {inquiry}, "pending_until": {inquiry},
          "devices": [{}]}}"#,
        devices.join(",")
    );
    // The JSON above is valid.
    serde_json::from_str(&json).unwrap_or_else(|_| unreachable_block())
}

/// Creates the description of another robot, which has taken over the address of the robot that `block` describes.
pub(crate) fn stranger(block: &InitializationBlock) -> InitializationBlock {
    InitializationBlock { id: RobotId::new("stranger").unwrap_or_else(|_| block.id.clone()), ..block.clone() }
}

#[expect(clippy::expect_used, reason = "a constant that a test reads")]
fn unreachable_block() -> InitializationBlock {
    let json = r#"{"id": "r", "api_version": "1", "devices": [{"id": "a", "name": "a", "available_control_types": {}}]}"#;
    serde_json::from_str(json).expect("a constant that a test reads")
}
