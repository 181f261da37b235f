//! The identity that this terminal uses for robots with TLS: the identity file that the fleet file names, unless the environment names
//! another one.

use std::path::{Path, PathBuf};

use downbeat_robot::sealed::Held;
use downbeat_robot::tls::Credentials;
use downbeat_scripts::{Fleet, expand_home};

use super::console;
use crate::journal::OpenedKeys;
use crate::keys::calendar;
use crate::link::Site;
use crate::run::desk::{Desk, Presented};

/// The environment variable that contains the path of the operator's identity file. Several people may use one fleet file.
const IDENTITY: &str = "DOWNBEAT_IDENTITY";
/// The environment variable that contains the path of the Zenoh configuration. The configuration may differ between machines, even if
/// they use the same fleet file.
const ZENOH: &str = "DOWNBEAT_ZENOH";

/// Warnings begin this number of days before a certificate expires.
const SOON: i64 = 30;
const DAY: i64 = 24 * 3_600;

/// Returns the absolute paths of the files for TLS and Zenoh, from the fleet file and the environment.
pub(super) fn keys(fleet: &Fleet) -> OpenedKeys {
    let own = named_by(IDENTITY);
    let whole = |path: PathBuf| std::path::absolute(&path).unwrap_or(path);
    OpenedKeys {
        identity: own.or_else(|| fleet.identity.clone()).map(whole),
        revoked: fleet.revoked.clone().map(whole),
        zenoh: zenoh(None).or_else(|| fleet.zenoh.clone()).map(whole),
    }
}

pub(super) fn named_by(variable: &str) -> Option<PathBuf> {
    let path = std::env::var_os(variable).filter(|path| !path.is_empty()).map(PathBuf::from);
    path.map(|path| expand_home(&path))
}

/// Returns the path of the Zenoh configuration: from the command line, or else from the environment.
pub(super) fn zenoh(named: Option<&Path>) -> Option<PathBuf> {
    named.map(Path::to_owned).or_else(|| named_by(ZENOH))
}

/// Returns the credentials and networks for the robots of a fleet.
pub(super) fn site(fleet: &Fleet) -> Result<Site, String> {
    site_of(&keys(fleet))
}

/// Returns the credentials and networks for a robot that is in no fleet file. In that case, only environment variables name the files.
pub(super) fn site_of_terminal() -> Result<Site, String> {
    site(&Fleet::default())
}

/// Returns the desk, which identifies operators and checks their permissions, for a mission with these key files. If the files cannot be
/// used, prints a warning and returns `None`. The mission then ignores identities.
pub(super) fn desk(keys: &OpenedKeys) -> Option<Desk> {
    Desk::of(keys).unwrap_or_else(|error| {
        console::warn(&format!("operators at other terminals cannot be identified: {error}"));
        None
    })
}

/// Returns the identity that this terminal presents to missions. `None` if the environment names no identity file.
///
/// # Errors
/// Returns the reason as a sentence if the file cannot be used.
pub(super) fn presented() -> Result<Option<Presented>, String> {
    let own = named_by(IDENTITY);
    let own = own.map(|path| Credentials::read(&path).map(Presented::new)).transpose();
    own.map_err(|error| error.to_string())
}

/// Like [`site_of`], for a stop. A stop must not depend on the list of revoked certificates: if the list cannot be used, prints a warning
/// and ignores it.
pub(super) fn site_to_stop(keys: &OpenedKeys) -> Result<Site, String> {
    site_of(keys).or_else(|error| {
        if keys.revoked.is_none() {
            return Err(error);
        }
        let site = site_of(&OpenedKeys { revoked: None, ..keys.clone() })?;
        console::warn(&format!("the robots are stopped without a list of revoked certificates: {error}"));
        Ok(site)
    })
}

/// Like [`site`], but with the given paths of the files.
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
            "the pass for robot {} expires in {days} days; run `downbeat keys renew`, then copy the new passes file",
            held.robot
        ));
    }
    if let Some(identity) = site.identity() {
        let days = (identity.expires - calendar()) / DAY;
        if days < SOON {
            let name = &identity.name;
            console::warn(&format!(
                "the certificate of {name} expires in {days} days; create a new one with `downbeat keys renew`"
            ));
        }
        if site.is_of_replaced_authority() {
            console::warn(&format!(
                "the certificate of {} is of an authority that is being replaced; create a new one with `downbeat keys renew`, and use its file",
                identity.name
            ));
        }
    }
    Ok(site)
}
