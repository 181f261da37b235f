//! Who this terminal is to robots with TLS: the identity file of the fleet file, unless the environment names another.

use std::path::{Path, PathBuf};

use downbeat_robot::sealed::Held;
use downbeat_robot::tls::Credentials;
use downbeat_scripts::Fleet;

use super::console;
use crate::journal::OpenedKeys;
use crate::keys::calendar;
use crate::link::Site;
use crate::run::desk::{Desk, Presented};

/// Names an operator's identity file: several people may use one fleet file.
const IDENTITY: &str = "DOWNBEAT_IDENTITY";
/// Names the configuration of the Zenoh network, which differs from machine to machine where a fleet file does not.
const ZENOH: &str = "DOWNBEAT_ZENOH";

/// Days before the end of a certificate from which on it is told of.
const SOON: i64 = 30;
const DAY: i64 = 24 * 3_600;

/// The files, with paths that count in any folder.
pub(super) fn keys(fleet: &Fleet) -> OpenedKeys {
    let own = named_by(IDENTITY);
    let whole = |path: PathBuf| std::path::absolute(&path).unwrap_or(path);
    OpenedKeys {
        identity: own.or_else(|| fleet.identity.clone()).map(whole),
        revoked: fleet.revoked.clone().map(whole),
        zenoh: zenoh(None).or_else(|| fleet.zenoh.clone()).map(whole),
    }
}

fn named_by(variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable).filter(|path| !path.is_empty()).map(PathBuf::from)
}

/// The configuration of Zenoh that the command line names, or else the environment.
pub(super) fn zenoh(named: Option<&Path>) -> Option<PathBuf> {
    named.map(Path::to_owned).or_else(|| named_by(ZENOH))
}

/// How the robots of a fleet are spoken to.
pub(super) fn site(fleet: &Fleet) -> Result<Site, String> {
    site_of(&keys(fleet))
}

/// How a robot is spoken to that no fleet file names: the environment names the files.
pub(super) fn site_of_terminal() -> Result<Site, String> {
    site(&Fleet::default())
}

/// Who decides at the socket of a mission with these keys. Where they cannot be used, nobody that presents itself is heard as such.
pub(super) fn desk(keys: &OpenedKeys) -> Option<Desk> {
    Desk::of(keys).unwrap_or_else(|error| {
        console::warn(&format!("what operators say from other terminals is not told apart: {error}"));
        None
    })
}

/// The identity that this terminal presents to missions: what the environment names.
///
/// # Errors
/// The file cannot be used, as a sentence.
pub(super) fn presented() -> Result<Option<Presented>, String> {
    let own = named_by(IDENTITY);
    let own = own.map(|path| Credentials::read(&path).map(Presented::new)).transpose();
    own.map_err(|error| error.to_string())
}

/// The same with files that are known.
pub(super) fn site_of(keys: &OpenedKeys) -> Result<Site, String> {
    let site = Site::of_files(keys.identity.as_deref(), keys.revoked.as_deref())?;
    let site = site.with_zenoh(keys.zenoh.clone());
    let now = calendar();
    let ends_soon = |held: &&Held| (held.claim.expires - now) / DAY < SOON;
    let soon: Vec<&Held> = site.passes().held().iter().filter(ends_soon).collect();
    let with_identity = |held: &Held| site.identity().is_some_and(|own| own.expires == held.claim.expires);
    if let Some(held) = soon.iter().find(|held| !with_identity(held)) {
        let days = (held.claim.expires - now) / DAY;
        console::warn(&format!(
            "the pass for robot {} counts for {days} more days: copy the file of passes that `downbeat keys renew` has written",
            held.robot
        ));
    }
    if let Some(identity) = site.identity() {
        let days = (identity.expires - calendar()) / DAY;
        if days < SOON {
            let name = &identity.name;
            console::warn(&format!(
                "the certificate of {name} counts for {days} more days: `downbeat keys renew` makes a new one"
            ));
        }
    }
    Ok(site)
}
