//! Secrets of robots without TLS, and the operators' passes that are made from these secrets.
//!
//! A pass has the same name, roles, expiry and serial number as the operator's certificate, so both expire and are revoked together.

use std::collections::BTreeSet;
use std::path::PathBuf;

use downbeat_robot::sealed::{Claim, Held, Passes, Secret};
use downbeat_robot::tls::Name;
use urrcp::RobotId;

use super::{Authority, Entry, Issued, KeysError, Kind, calendar, files};

/// What to do if a robot already has a secret.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IfThere {
    /// Keep the existing secret and refuse to make another.
    Keep,
    /// Replace the existing secret. Passes made from the old secret become invalid once the robot has the new one.
    Replace,
}

impl Authority {
    /// Makes a secret for each robot, and a pass for each operator and robot. Returns the paths of the secrets' files.
    ///
    /// # Errors
    /// Returns [`KeysError`], also if any of the robots already has a secret that must be kept. Nothing is made in that case.
    pub fn make_secrets(
        &self,
        robots: &BTreeSet<RobotId>,
        if_there: IfThere,
    ) -> Result<Vec<PathBuf>, KeysError> {
        let path = |robot: &RobotId| files::secret_path(&self.folder, robot);
        let taken: Vec<RobotId> = robots.iter().filter(|robot| path(robot).exists()).cloned().collect();
        if if_there == IfThere::Keep && !taken.is_empty() {
            return Err(KeysError::SecretTaken(taken));
        }
        let make = |robot: &RobotId| {
            let path = path(robot);
            path.parent().map(files::make_private_folder).transpose()?;
            files::write_private(&path, &Secret::generate()?.made_at(calendar()).text(robot))?;
            Ok(path)
        };
        let made = robots.iter().map(make).collect::<Result<_, KeysError>>();
        // The list is written even if one secret could not be written, because the other secrets exist.
        let issued = self.issued()?;
        self.write_revoked_serials(&issued, self.list_number())?;
        self.write_passes(&issued)?;
        made
    }

    /// Returns the robots that have a secret, sorted by id.
    ///
    /// # Errors
    /// Fails if the folder cannot be read.
    pub fn robots_with_secret(&self) -> Result<Vec<RobotId>, KeysError> {
        files::robots_with_secret(&self.folder)
    }

    /// Deletes a robot's secret. Returns 1 if there was one, else 0.
    pub(super) fn delete_secret(&self, robot: &RobotId) -> Result<usize, KeysError> {
        Ok(usize::from(files::delete(&files::secret_path(&self.folder, robot))?))
    }

    /// Writes the passes of all operators, one for each robot with a secret. Revoked operators get no passes.
    pub(super) fn write_passes(&self, issued: &Issued) -> Result<(), KeysError> {
        let robots = self.robots_with_secret()?.into_iter().map(|robot| {
            let secret = Secret::read(&files::secret_path(&self.folder, &robot))?;
            Ok((robot, secret))
        });
        let robots: Vec<(RobotId, Secret)> = robots.collect::<Result<_, KeysError>>()?;
        let file = |name: &str| {
            Passes::next_to(&files::identity_path(&self.folder, &Name::Operator(name.to_owned())))
        };
        for entry in issued.operators() {
            let held = |(robot, secret): &(RobotId, Secret)| {
                let claim = claim(entry);
                Held { robot: robot.clone(), pass: secret.pass(&claim), claim }
            };
            if robots.is_empty() {
                files::delete(&file(&entry.name))?;
            } else {
                files::write_private(
                    &file(&entry.name),
                    &Passes::new(robots.iter().map(held).collect()).text(),
                )?
            }
        }
        for entry in issued.entries().iter().filter(|entry| entry.kind == Kind::Operator) {
            if issued.operators().all(|counts| counts.name != entry.name) {
                files::delete(&file(&entry.name))?;
            }
        }
        Ok(())
    }

    /// Writes the list of revoked passes: one serial number per line, for robots without TLS. `number` is that of the list of revoked
    /// certificates.
    pub(super) fn write_revoked_serials(&self, issued: &Issued, number: u64) -> Result<(), KeysError> {
        let head = format!("# Numbers of revoked passes, written by `downbeat keys`.\n# number {number}\n");
        let is_revoked = |entry: &&Entry| entry.kind == Kind::Operator && entry.revoked.is_some();
        let lines = issued.entries().iter().filter(is_revoked).map(|entry| format!("{}\n", entry.serial));
        files::write_public(
            &self.revoked_serials(),
            &std::iter::once(head).chain(lines).chain(["# end\n".to_owned()]).collect::<String>(),
        )
    }
}

fn claim(entry: &Entry) -> Claim {
    Claim {
        name: entry.name.clone(),
        roles: entry.roles(),
        expires: entry.expires,
        serial: entry.serial.clone(),
    }
}
