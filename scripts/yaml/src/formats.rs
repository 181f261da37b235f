//! Formats of other tools, and how the name and the first bytes of a file show them. Reading them is for `import`.

use std::path::Path;

/// Which tool's files they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImportFormat {
    /// Crazyswarm: one CSV of polynomial pieces a robot, or a folder of numbered scenes a robot.
    Crazyswarm,
    /// `id,x[m],y[m],z[m],t[s]`.
    Waypoints,
    /// The fields of the ROS message `trajectory_msgs/JointTrajectory`, as YAML or JSON.
    JointTrajectory,
    /// The motions of PAL Robotics' `play_motion2`, YAML.
    PlayMotion2,
    /// Keyframe animations of the RoboCup team Bit-Bots, JSON.
    Bitbots,
    /// Compiled drone shows of Skybrush, `.skyc`.
    Skybrush,
    /// Motions of Webots, `.motion`.
    Webots,
    /// Motion capture, `.bvh`.
    Bvh,
    /// Standard MIDI files.
    Midi,
    /// Light sequences of xLights and Falcon Player, `.fseq`.
    Fseq,
    /// Recordings of ROS with joint states, `.mcap`.
    Mcap,
    /// Any CSV with a column of times.
    Csv,
}

impl ImportFormat {
    /// All of them with the names that people type.
    pub const WORDS: [(&'static str, Self); 12] = [
        ("crazyswarm", Self::Crazyswarm),
        ("waypoints", Self::Waypoints),
        ("joint-trajectory", Self::JointTrajectory),
        ("play-motion2", Self::PlayMotion2),
        ("bitbots", Self::Bitbots),
        ("skybrush", Self::Skybrush),
        ("webots", Self::Webots),
        ("bvh", Self::Bvh),
        ("midi", Self::Midi),
        ("fseq", Self::Fseq),
        ("mcap", Self::Mcap),
        ("csv", Self::Csv),
    ];

    /// As it is typed.
    #[must_use]
    pub fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(_, format)| *format == self).map_or("", |(word, _)| word)
    }

    /// Whether its files are of one robot each.
    pub fn is_single(self) -> bool {
        use ImportFormat::{Bitbots, Bvh, JointTrajectory, Midi, PlayMotion2, Webots};
        matches!(self, JointTrajectory | PlayMotion2 | Bitbots | Webots | Bvh | Midi)
    }

    /// Whether the user says what moves what.
    #[must_use]
    pub fn is_mapped(self) -> bool {
        matches!(self, Self::Csv | Self::Fseq)
    }

    /// Whether its files contain curves besides points.
    #[must_use]
    pub fn has_curves(self) -> bool {
        matches!(self, Self::Crazyswarm | Self::JointTrajectory | Self::Skybrush)
    }

    /// The kind of robot that plays such files, unless the user states another one.
    pub fn kind(self) -> &'static str {
        match self {
            Self::Crazyswarm | Self::Waypoints => "crazyflie",
            Self::JointTrajectory | Self::Webots | Self::Mcap | Self::Csv => "robot",
            Self::Bvh => "skeleton",
            Self::Midi => "midi",
            Self::Fseq => "lamps",
            Self::Skybrush => "drone",
            Self::PlayMotion2 => "tiago",
            Self::Bitbots => "humanoid",
        }
    }
}

/// Where files of other tools belong, by the ends of their names.
const IMPORTED: [(&str, ImportFormat); 8] = [
    ("csv", ImportFormat::Csv),
    ("mid", ImportFormat::Midi),
    ("midi", ImportFormat::Midi),
    ("bvh", ImportFormat::Bvh),
    ("fseq", ImportFormat::Fseq),
    ("mcap", ImportFormat::Mcap),
    ("motion", ImportFormat::Webots),
    ("skyc", ImportFormat::Skybrush),
];

/// The format of another tool's file by the end of its name.
pub fn format_of(name: &str) -> Option<ImportFormat> {
    let end = Path::new(name).extension()?.to_str()?.to_ascii_lowercase();
    IMPORTED.iter().find(|(known, _)| *known == end).map(|(_, format)| *format)
}

/// The command that makes a scenario of another tool's file.
pub fn importing(name: &str) -> Option<String> {
    let format = format_of(name)?;
    Some(format!(
        "`downbeat import {} {name}` makes a scenario of it; see `downbeat import --help`",
        format.word()
    ))
}

/// What a file is that is not text, by its first bytes.
pub fn binary(bytes: &[u8]) -> Option<&'static str> {
    const KNOWN: [(&[u8], &str); 9] = [
        (b"MThd", "a MIDI file"),
        (b"\x89MCAP", "a recording (MCAP)"),
        (b"PSEQ", "a light sequence (FSEQ)"),
        (b"PK\x03\x04", "a ZIP archive"),
        (b"\x89PNG", "a picture"),
        (b"\xff\xd8\xff", "a picture"),
        (b"%PDF", "a PDF document"),
        (b"\x7fELF", "a program"),
        (b"\x1f\x8b", "a compressed file"),
    ];
    KNOWN.iter().find(|(start, _)| bytes.starts_with(start)).map(|(_, what)| *what)
}
