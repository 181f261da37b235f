//! The file formats of other programs that `downbeat import` reads, and how to recognize them by the name and the first bytes of a file.

use std::path::Path;

/// The properties of a file format of another program.
#[derive(Clone, Copy, Debug)]
pub struct FormatFacts {
    /// The format that has these properties.
    pub format: ImportFormat,
    /// The name of the format on the command line.
    pub word: &'static str,
    /// A short description of the format's files.
    pub about: &'static str,
    /// The file name extensions of the format, without the dot.
    pub ends: &'static [&'static str],
    /// Whether the file name extension alone identifies the format.
    pub is_recognized: bool,
    /// The kind of robot that is assumed to play such files, unless the user names another kind.
    pub kind: &'static str,
    /// Whether each file contains the motion of a single robot.
    pub is_single: bool,
    /// Whether the user must assign columns or channels of the files to devices.
    pub is_mapped: bool,
    /// Whether the files contain curves in addition to points.
    pub has_curves: bool,
}

/// The properties that a format has unless its declaration states others.
const POINTS: FormatFacts = FormatFacts {
    format: ImportFormat::Csv,
    word: "",
    about: "",
    ends: &[],
    is_recognized: true,
    kind: "robot",
    is_single: false,
    is_mapped: false,
    has_curves: false,
};

/// Declares the enum [`ImportFormat`], and [`FORMATS`] with the properties of each format in the same order.
macro_rules! formats {
    ($($(#[$doc:meta])* $format:ident { $($fact:ident: $value:expr,)* })*) => {
        /// The format of an imported file.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum ImportFormat {
            $($(#[$doc])* $format,)*
        }

        const FORMATS: &[FormatFacts] =
            &[$(FormatFacts { format: ImportFormat::$format, $($fact: $value,)* ..POINTS },)*];
    };
}

formats! {
    /// Crazyswarm: one CSV of polynomial pieces per robot, or one folder of numbered scenes per robot.
    Crazyswarm {
        word: "crazyswarm",
        about: "CSVs of polynomial pieces, one file or folder per robot",
        ends: &["csv"],
        is_recognized: false,
        kind: "crazyflie",
        has_curves: true,
    }

    /// Waypoints: one CSV with the columns `id,x[m],y[m],z[m],t[s]`.
    Waypoints {
        word: "waypoints",
        about: "CSV with the columns id,x[m],y[m],z[m],t[s]",
        ends: &["csv"],
        is_recognized: false,
        kind: "crazyflie",
    }

    /// The fields of the ROS message `trajectory_msgs/JointTrajectory`, as YAML or JSON.
    JointTrajectory {
        word: "joint-trajectory",
        about: "ROS trajectory_msgs/JointTrajectory as YAML or JSON",
        ends: &["yaml", "yml", "json"],
        is_recognized: false,
        is_single: true,
        has_curves: true,
    }

    /// Motions of PAL Robotics' `play_motion2`, as YAML.
    PlayMotion2 {
        word: "play-motion2",
        about: "motions of PAL Robotics robots, YAML",
        ends: &["yaml", "yml", "json"],
        is_recognized: false,
        kind: "tiago",
        is_single: true,
    }

    /// Keyframe animations of the RoboCup team Bit-Bots, as JSON.
    Bitbots {
        word: "bitbots",
        about: "keyframe animations of the RoboCup team Bit-Bots, JSON",
        ends: &["json"],
        is_recognized: false,
        kind: "humanoid",
        is_single: true,
    }

    /// Compiled drone shows of Skybrush (`.skyc`).
    Skybrush {
        word: "skybrush",
        about: "compiled Skybrush drone shows, .skyc",
        ends: &["skyc"],
        kind: "drone",
        has_curves: true,
    }

    /// Motions of Webots (`.motion`).
    Webots {
        word: "webots",
        about: "Webots motions, .motion",
        ends: &["motion"],
        is_single: true,
    }

    /// Motion capture (`.bvh`).
    Bvh {
        word: "bvh",
        about: "motion capture, .bvh",
        ends: &["bvh"],
        kind: "skeleton",
        is_single: true,
    }

    /// Standard MIDI files.
    Midi {
        word: "midi",
        about: "MIDI notes and controllers, .mid",
        ends: &["mid", "midi"],
        kind: "midi",
        is_single: true,
    }

    /// Light sequences of xLights and Falcon Player (`.fseq`).
    Fseq {
        word: "fseq",
        about: "light sequences of xLights and Falcon Player, .fseq; needs --map",
        ends: &["fseq"],
        kind: "lamps",
        is_mapped: true,
    }

    /// Recordings of ROS with joint states (`.mcap`).
    Mcap {
        word: "mcap",
        about: "ROS recordings with JointState messages, .mcap",
        ends: &["mcap"],
    }

    /// Any CSV with a column of times.
    Csv {
        word: "csv",
        about: "any CSV with a column of times; needs --time and --map",
        ends: &["csv"],
        is_mapped: true,
    }
}

impl ImportFormat {
    /// The properties of all formats, in the order in which they are listed to users.
    pub const ALL: &'static [FormatFacts] = FORMATS;

    /// The properties of this format.
    #[must_use]
    pub const fn facts(self) -> &'static FormatFacts {
        &FORMATS[self as usize]
    }

    /// The name of this format on the command line.
    #[must_use]
    pub const fn word(self) -> &'static str {
        self.facts().word
    }
}

/// Returns the format of a file of another program; `None` unless the extension of `name` alone identifies it.
pub fn format_of(name: &str) -> Option<ImportFormat> {
    let end = Path::new(name).extension()?.to_str()?.to_ascii_lowercase();
    let known = |facts: &&FormatFacts| facts.is_recognized && facts.ends.contains(&end.as_str());
    ImportFormat::ALL.iter().find(known).map(|facts| facts.format)
}

/// Returns a hint with the command that converts a file of another program to a scenario. `None` if the extension of `name` identifies no
/// format.
pub fn importing(name: &str) -> Option<String> {
    let format = format_of(name)?;
    Some(format!(
        "run `downbeat import {} {name}` to create a scenario from it; see `downbeat import --help`",
        format.word()
    ))
}

/// Whether a file contains a private key (PEM), the secret of a robot, or passes.
#[must_use]
pub fn is_secret(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text.lines().map(str::trim_end);
    let is_private_key = |line: &str| line.starts_with("-----BEGIN ") && line.ends_with("PRIVATE KEY-----");
    let has_passes = text.starts_with("# Passes for robots with a secret,");
    if has_passes || lines.any(is_private_key) {
        return true;
    }
    let mut content = text.lines().map(str::trim).filter(|line| !line.starts_with('#') && !line.is_empty());
    let is_digits = |line: &str| line.len() == 64 && line.bytes().all(|byte| byte.is_ascii_hexdigit());
    content.next().is_some_and(is_digits) && content.next().is_none()
}

/// Returns the kind of a binary file for a message, such as `a MIDI file`; `None` if its first bytes identify no kind.
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
