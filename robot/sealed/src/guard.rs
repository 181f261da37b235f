//! The guard of a robot that shares a secret with its authority: peers must prove that they have a pass.

use std::io;
use std::sync::{Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use tokio::io::{AsyncRead, AsyncWrite};
use urrcp::RobotId;

use super::handshake::{Hello, Refused};
use super::revoked::RevokedSerials;
use super::secret::{Pass, Secret};
use super::stream::{Sealed, accept};
use urrcp::Proof;

/// Checks a robot's peers by the robot's secret. Admits operators with a valid pass for this robot.
#[derive(Debug)]
pub struct Guard {
    robot: RobotId,
    secret: Secret,
    revoked: Option<RevokedSerials>,
    /// Serial numbers of revoked passes, as last read successfully.
    known: Mutex<Vec<String>>,
}

impl Guard {
    /// Creates a guard for the robot with this id.
    #[must_use]
    pub fn new(robot: RobotId, secret: Secret, revoked: Option<RevokedSerials>) -> Self {
        Self { robot, secret, revoked, known: Mutex::default() }
    }

    /// Whether the pass with this serial number is revoked. If the list cannot be read, the previous list applies, so that revoked
    /// operators are still refused.
    fn is_revoked(&self, serial: &str) -> bool {
        let Some(revoked) = &self.revoked else { return false };
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        match revoked.read() {
            Ok(read) => *known = read,
            Err(error) => tracing::warn!("the previous list of revoked passes remains in use: {error}"),
        }
        known.iter().any(|revoked| revoked == serial)
    }

    /// Returns the pass with which the operator must prove its claim, or the reason for refusing the claim.
    fn judge(&self, hello: &Hello, now: i64) -> Result<Pass, Refused> {
        if hello.robot != self.robot {
            return Err(Refused::OtherRobot(self.robot.clone()));
        }
        if hello.claim.expires < now {
            return Err(Refused::Expired);
        }
        if self.is_revoked(&hello.claim.serial) {
            return Err(Refused::Revoked);
        }
        Ok(self.secret.pass(&hello.claim))
    }

    /// Accepts the connection of an operator, and returns the operator's proof.
    ///
    /// # Errors
    /// The peer does not prove its identity.
    pub async fn accept<S>(&self, stream: S) -> io::Result<(Sealed<S>, Proof)>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        #[expect(clippy::disallowed_methods, reason = "passes count by the calendar")]
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        let now = i64::try_from(now).unwrap_or(i64::MAX);
        let (stream, hello) = accept(stream, |hello| self.judge(hello, now)).await?;
        let proof = hello.claim.proof().ok_or_else(|| io::Error::other("the name is too long"))?;
        Ok((stream, proof))
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
