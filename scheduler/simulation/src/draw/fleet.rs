//! The robots of a seed: what they are, how well they follow the protocol, how they are reached.

use downbeat_robot::simulated::Settings;
use fastrand::Rng;
use urrcp::{InitializationBlock, RobotId, Span};

use super::{millis, one_in};
use downbeat_mission::ClockMode;

/// A robot that does not do what it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lie {
    /// It accepts, reports starts and ends, and does not move.
    NeverMoves,
    /// It states times that are off by this.
    WrongTime(Span),
    /// It accepts and forgets at once.
    Forgets,
    /// It echoes the hash of something else.
    WrongHash,
    /// It says that it has done more steps than any script has.
    TooManySteps,
}

/// Whether a robot says in its answers which request they are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Names {
    /// It does.
    Echoed,
    /// It leaves them out.
    LeftOut,
}

/// How many connections a robot serves at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Connections {
    /// The newest one; an older one is closed.
    Newest,
    /// The oldest one: another is taken, and nothing on it is read until that one is seen to end.
    One,
}

/// What moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hands {
    /// The robot itself.
    Own,
    /// Hardware behind an edge, which may die on its own.
    Hardware,
}

/// One robot.
#[derive(Clone, Debug)]
pub struct DrawnRobot {
    /// How it describes itself.
    pub block: InitializationBlock,
    /// Its clock.
    pub settings: Settings,
    /// How its time is brought to agree.
    pub clock: ClockMode,
    /// What it lies about.
    pub lie: Option<Lie>,
    /// How long it takes for every answer in addition to the network.
    pub slow: Span,
    /// Whether it names requests in its answers.
    pub names: Names,
    /// How many connections it serves.
    pub connections: Connections,
    /// What moves.
    pub hands: Hands,
    /// Bytes a second that its link carries each way; `None`: no limit.
    pub bandwidth: Option<u32>,
    /// Its process begins this long after the mission.
    pub there_from: Span,
}

/// Which devices it has, for the scripts.
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
    // One that leaves out what it did cannot lie about that.
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
        // What any link is trusted to carry.
        Show::Large => Some(rng.u32(10_000_000..=40_000_000)),
        Show::Small => one_in(rng, 8).then(|| rng.u32(100_000..=2_000_000)),
    }
}

/// Clocks that are right, off by some milliseconds, or without NTP.
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
    // Written above: it is one.
    serde_json::from_str(&json).unwrap_or_else(|_| unreachable_block())
}

/// Another robot that has taken over the address.
pub(crate) fn stranger(block: &InitializationBlock) -> InitializationBlock {
    InitializationBlock { id: RobotId::new("stranger").unwrap_or_else(|_| block.id.clone()), ..block.clone() }
}

#[expect(clippy::expect_used, reason = "a constant that a test reads")]
fn unreachable_block() -> InitializationBlock {
    let json = r#"{"id": "r", "api_version": "1", "devices": [{"id": "a", "name": "a", "available_control_types": {}}]}"#;
    serde_json::from_str(json).expect("a constant that a test reads")
}
