//! The door of a robot that shares a secret: who comes in has to prove a pass.

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

/// What a robot knows, and whom it lets in: operators with a pass for it that counts.
#[derive(Debug)]
pub struct Guard {
    robot: RobotId,
    secret: Secret,
    revoked: Option<RevokedSerials>,
    /// The numbers as they were read last.
    known: Mutex<Vec<String>>,
}

impl Guard {
    /// A door for a robot with this id.
    #[must_use]
    pub fn new(robot: RobotId, secret: Secret, revoked: Option<RevokedSerials>) -> Self {
        Self { robot, secret, revoked, known: Mutex::default() }
    }

    /// A list that cannot be read does not open the door to those that were revoked: the last one counts.
    fn is_revoked(&self, serial: &str) -> bool {
        let Some(revoked) = &self.revoked else { return false };
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        match revoked.read() {
            Ok(read) => *known = read,
            Err(error) => tracing::warn!("the last list of revoked passes counts: {error}"),
        }
        known.iter().any(|revoked| revoked == serial)
    }

    /// The pass that a claim takes.
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

    /// Lets an operator in.
    ///
    /// # Errors
    /// The peer does not prove who it is.
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
