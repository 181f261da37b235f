//! The secret of a robot, and the passes that are derived from it.

use std::fmt;
use std::path::{Path, PathBuf};

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use urrcp::RobotId;

use super::claim::Claim;
use super::hex;
use downbeat_key_file::{KeyFileError, read_private};

/// Size in bytes of a secret, of a pass and of an untruncated authentication code.
const BYTES: usize = 32;
/// Text that precedes the claim when a pass is computed. The pass is an authentication code over this text and the claim.
const OF_A_PASS: &[u8] = b"urrcp pass 1\n";

/// Text that precedes a list of revoked passes when its code is computed.
const OF_A_LIST: &[u8] = b"urrcp revoked 1\n";
/// Text before the time at which a secret was made.
const MADE: &str = "# made ";
/// Text before the code in the last line of a list of revoked passes.
const CODE: &str = "# code ";

/// Returns a code over the concatenation of several parts.
pub(super) fn code(key: &[u8; BYTES], parts: &[&[u8]]) -> Hmac<Sha256> {
    // RFC 2104 pads a shorter key with zeros to the block size of the hash function.
    let mut block = [0; 64];
    block[..BYTES].copy_from_slice(key);
    let mut code = Hmac::<Sha256>::new(&block.into());
    parts.iter().for_each(|part| code.update(part));
    code
}

/// An error in a secret or in passes.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SecretError {
    /// The file cannot be read, or other users can read it too.
    #[error(transparent)]
    File(#[from] KeyFileError),
    /// The file does not contain a secret.
    #[error("{}: expected a file that `downbeat keys secret` wrote, with one line of 64 hexadecimal digits and comment lines that begin with #", .0.display())]
    NoSecret(PathBuf),
    /// The file does not contain passes.
    #[error("{}: expected a file of passes that `downbeat keys` wrote, with a robot, a claim and 64 hexadecimal digits in each line", .0.display())]
    NoPasses(PathBuf),
    /// The system provides no random bytes.
    #[error("cannot get random bytes: {0}")]
    NoRandomBytes(#[from] getrandom::Error),
}

/// A secret that only a robot and its authority (the issuer of passes) know.
#[derive(Clone)]
pub struct Secret {
    bytes: [u8; BYTES],
    /// When the secret was made, in seconds since 1970, UTC. 0 if unknown.
    made: i64,
}

impl Secret {
    /// Generates a new secret.
    ///
    /// # Errors
    /// The system provides no random bytes.
    pub fn generate() -> Result<Self, SecretError> {
        let mut bytes = [0; BYTES];
        getrandom::fill(&mut bytes)?;
        Ok(Self::of_bytes(bytes))
    }

    /// Returns the secret with the time at which it was made, in seconds since 1970, UTC. A robot whose clock shows an earlier time admits
    /// nobody, because it could not detect that a pass has expired.
    #[must_use]
    pub const fn made_at(self, made: i64) -> Self {
        Self { made, ..self }
    }

    /// Returns when the secret was made, in seconds since 1970, UTC. 0 if unknown.
    #[must_use]
    pub const fn made(&self) -> i64 {
        self.made
    }

    /// Creates a secret from known bytes.
    #[must_use]
    pub const fn of_bytes(bytes: [u8; BYTES]) -> Self {
        Self { bytes, made: 0 }
    }

    /// Reads a secret from its file.
    ///
    /// # Errors
    /// [`SecretError`] if the file contains no secret, cannot be read, or can be read by other users.
    pub fn read(path: &Path) -> Result<Self, SecretError> {
        let none = || SecretError::NoSecret(path.into());
        let text = String::from_utf8(read_private(path)?).map_err(|_| none())?;
        let mut lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
        let secret = lines.next().and_then(hex::bytes).ok_or_else(none)?;
        let made = text.lines().find_map(|line| line.strip_prefix(MADE)?.parse().ok());
        if lines.next().is_some() {
            return Err(none());
        }
        Ok(Self::of_bytes(secret).made_at(made.unwrap_or_default()))
    }

    /// Returns the content of a file that contains this secret.
    #[must_use]
    pub fn text(&self, robot: &RobotId) -> String {
        let robot = super::claim::encoded(robot.as_str());
        let made = if self.made == 0 { String::new() } else { format!("{MADE}{}\n", self.made) };
        format!(
            "# The secret of robot {robot}. Copy it only to this robot.\n{made}{}\n",
            hex::hex(&self.bytes)
        )
    }

    /// Returns a list of revoked passes with a last line that proves to the robot with this secret that the authority made the list.
    #[must_use]
    pub fn proven_list(&self, list: &str) -> String {
        let proof = code(&self.bytes, &[OF_A_LIST, list.as_bytes()]).finalize().into_bytes();
        format!("{list}{CODE}{}\n", hex::hex(&proof))
    }

    /// Returns the list from a text that [`Secret::proven_list`] made with this secret; `None` for any other text.
    pub(super) fn list<'a>(&self, proven: &'a str) -> Option<&'a str> {
        let (list, proof) = proven.strip_suffix('\n')?.rsplit_once(CODE)?;
        let proof = hex::bytes::<BYTES>(proof)?;
        code(&self.bytes, &[OF_A_LIST, list.as_bytes()]).verify(&proof.into()).is_ok().then_some(list)
    }

    /// Returns the pass with which an operator proves this claim to the robot that has this secret.
    #[must_use]
    pub fn pass(&self, claim: &Claim) -> Pass {
        let claim = claim.to_string();
        Pass(code(&self.bytes, &[OF_A_PASS, claim.as_bytes()]).finalize().into_bytes().into())
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}

/// A key that an operator uses to prove a claim to one robot.
#[derive(Clone)]
pub struct Pass(pub(super) [u8; BYTES]);

impl Pass {
    /// Creates a pass from known bytes.
    #[must_use]
    pub const fn of_bytes(bytes: [u8; BYTES]) -> Self {
        Self(bytes)
    }
}

impl fmt::Debug for Pass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Pass")
    }
}
