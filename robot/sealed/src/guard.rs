//! The door of a robot that shares a secret: peers must prove a pass.

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

/// A robot's secret, and the check of its peers: it admits operators with a valid pass for it.
#[derive(Debug)]
pub struct Guard {
    robot: RobotId,
    secret: Secret,
    revoked: Option<RevokedSerials>,
    /// The serial numbers from the last successful reading.
    known: Mutex<Vec<String>>,
}

impl Guard {
    /// Creates a door for a robot with this id.
    #[must_use]
    pub fn new(robot: RobotId, secret: Secret, revoked: Option<RevokedSerials>) -> Self {
        Self { robot, secret, revoked, known: Mutex::default() }
    }

    /// Whether this pass is revoked. If the list cannot be read, the last one applies, so that it does not admit revoked operators.
    fn is_revoked(&self, serial: &str) -> bool {
        let Some(revoked) = &self.revoked else { return false };
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        match revoked.read() {
            Ok(read) => *known = read,
            Err(error) => tracing::warn!("the previous list of revoked passes remains in use: {error}"),
        }
        known.iter().any(|revoked| revoked == serial)
    }

    /// Returns the pass that a claim requires.
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

    /// Admits an operator.
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
