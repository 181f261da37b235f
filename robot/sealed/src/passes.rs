//! The passes of an operator (keys that prove the operator's claims to robots), in a file next to the operator's identity file.

use std::path::{Path, PathBuf};

use urrcp::RobotId;

use super::claim::{Claim, encoded, robot_id};
use super::secret::Pass;
use super::{SecretError, hex};
use downbeat_key_file::read_private_of;

/// Maximum size of a file of passes in bytes. A pass takes about 200 bytes.
const BYTES_MAX: u64 = 16 * 1024 * 1024;

/// A pass, with the claim that it proves and the robot that accepts it.
#[derive(Clone, Debug)]
pub struct Held {
    /// Robot that accepts the pass.
    pub robot: RobotId,
    /// Claim that the pass proves.
    pub claim: Claim,
    /// Key with which the operator proves the claim.
    pub pass: Pass,
}

/// All passes of an operator: one for each robot that authenticates operators with a secret.
#[derive(Clone, Debug, Default)]
pub struct Passes {
    held: Vec<Held>,
}

impl Passes {
    /// Creates the passes of an operator from a list.
    #[must_use]
    pub const fn new(held: Vec<Held>) -> Self {
        Self { held }
    }

    /// Returns the path of the file of passes that belongs to the operator's identity file.
    #[must_use]
    pub fn next_to(identity: &Path) -> PathBuf {
        identity.with_extension("passes")
    }

    /// Reads a file of passes. Each line contains a robot's id, a claim and a pass.
    ///
    /// # Errors
    /// The file cannot be read, other users can read it, or it is not a file of passes.
    pub fn read(path: &Path) -> Result<Self, SecretError> {
        let none = || SecretError::NoPasses(path.into());
        let text = String::from_utf8(read_private_of(path, BYTES_MAX)?).map_err(|_| none())?;
        let lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
        let held: Option<Vec<Held>> = lines.map(held).collect();
        held.map(Self::new).ok_or_else(none)
    }

    /// Returns the content of a file that contains these passes.
    #[must_use]
    pub fn text(&self) -> String {
        let head = "# Passes for robots with a secret, written by `downbeat keys`: robot, claim, pass.\n";
        let line = |Held { robot, claim, pass }: &Held| {
            format!("{} {claim} {}\n", encoded(robot.as_str()), hex::hex(&pass.0))
        };
        std::iter::once(head.to_owned()).chain(self.held.iter().map(line)).collect()
    }

    /// Returns all passes.
    #[must_use]
    pub fn held(&self) -> &[Held] {
        &self.held
    }

    /// Returns the pass for a robot, if the operator has one.
    #[must_use]
    pub fn of(&self, robot: &RobotId) -> Option<&Held> {
        self.held.iter().find(|held| held.robot == *robot)
    }
}

fn held(line: &str) -> Option<Held> {
    let (robot, rest) = line.split_once(' ')?;
    let (claim, pass) = rest.rsplit_once(' ')?;
    Some(Held { robot: robot_id(robot)?, claim: claim.parse().ok()?, pass: Pass(hex::bytes(pass)?) })
}
