//! Admits peers to a robot that shares a secret with its authority (the issuer of passes). Each peer must prove that it has a pass.

use std::io;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use tokio::io::{AsyncRead, AsyncWrite};
use urrcp::RobotId;

use super::claim::Claim;
use super::handshake::{Hello, Refused};
use super::revoked::{CurrentSerials, RevokedSerials, Serials};
use super::secret::{Pass, Secret};
use super::stream::{Sealed, accept};
use downbeat_key_file::KeyFileError;

/// Time in seconds by which the clock of a robot may be behind that of the authority when a secret is made.
const CLOCKS_DIFFER: i64 = 300;

/// Checks the peers of a robot by means of the robot's secret. Admits operators with a valid pass for this robot.
#[derive(Debug)]
pub struct Guard {
    robot: RobotId,
    secret: Secret,
    revoked: Option<CurrentSerials>,
}

impl Guard {
    /// Creates a guard for the robot with this id.
    ///
    /// # Errors
    /// The list of revoked passes cannot be read.
    pub fn new(
        robot: RobotId,
        secret: Secret,
        revoked: Option<&RevokedSerials>,
    ) -> Result<Self, KeyFileError> {
        Ok(Self { robot, secret, revoked: revoked.map(CurrentSerials::new).transpose()? })
    }

    /// Returns the current list of revoked passes. `None` if the robot has no list.
    #[must_use]
    pub fn list(&self) -> Option<Arc<Serials>> {
        self.revoked.as_ref().map(CurrentSerials::list)
    }

    /// Returns the list in use, like [`Guard::list`], but without accessing its file, which may have changed in the last second.
    #[must_use]
    pub fn latest_list(&self) -> Option<Arc<Serials>> {
        self.revoked.as_ref().map(CurrentSerials::latest)
    }

    /// Replaces the list of revoked passes with this one, if it is later. Its last line must contain the code that
    /// [`Secret::proven_list`] adds.
    ///
    /// # Errors
    /// A sentence with the reason why the list is not used.
    pub fn replace_list(&self, text: &str) -> Result<(), String> {
        let revoked = self.revoked.as_ref();
        let revoked = revoked.ok_or("the robot has no list of revoked keys; start it with --revoked")?;
        let list = self.secret.list(text).ok_or("the list is not for this robot, or was altered")?;
        revoked.replace(list)
    }

    /// Returns the pass with which the operator must prove its claim, or the reason for refusing the claim.
    fn judge(&self, hello: &Hello, now: i64) -> Result<Pass, Refused> {
        if hello.robot != self.robot {
            return Err(Refused::OtherRobot(self.robot.clone()));
        }
        if now < self.secret.made().saturating_sub(CLOCKS_DIFFER) {
            return Err(Refused::Clock);
        }
        if hello.claim.expires < now {
            return Err(Refused::Expired);
        }
        if self.list().is_some_and(|list| list.contains(&hello.claim.serial)) {
            return Err(Refused::Revoked);
        }
        Ok(self.secret.pass(&hello.claim))
    }

    /// Accepts the connection of an operator, and returns the claim that the operator has proven.
    ///
    /// # Errors
    /// The peer does not prove its identity.
    pub async fn accept<S>(&self, stream: S) -> io::Result<(Sealed<S>, Claim)>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        #[expect(clippy::disallowed_methods, reason = "passes are valid by the calendar")]
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        let now = i64::try_from(now).unwrap_or(i64::MAX);
        let (stream, hello) = accept(stream, |hello| self.judge(hello, now)).await?;
        Ok((stream, hello.claim))
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
