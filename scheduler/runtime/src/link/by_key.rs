//! Robots that are reached through keys of a Zenoh network, if this program is built with Zenoh.

use std::path::PathBuf;

use super::{Endpoint, LinkEncoding};

#[cfg(feature = "zenoh")]
use std::sync::OnceLock;

/// The error message for `zenoh:` addresses in a build without Zenoh.
#[cfg(not(feature = "zenoh"))]
pub const NOT_BUILT: &str = "this build of downbeat does not support `zenoh:` addresses; build it with \
     `cargo install --path scheduler --features zenoh`";

/// The Zenoh network of a site, which this process joins at most once.
#[derive(Debug, Default)]
pub(super) struct OfSite {
    #[cfg(feature = "zenoh")]
    file: Option<PathBuf>,
    #[cfg(feature = "zenoh")]
    joined: OnceLock<Result<Network, String>>,
}

/// A Zenoh network that this process has joined.
#[cfg(feature = "zenoh")]
#[derive(Clone, Debug)]
pub struct Network(downbeat_robot::zenoh::Networks);

/// A Zenoh network in a build without Zenoh. No value of this type exists.
#[cfg(not(feature = "zenoh"))]
#[derive(Clone, Copy, Debug)]
pub enum Network {}

#[cfg(feature = "zenoh")]
impl OfSite {
    pub(super) const fn new(file: Option<PathBuf>) -> Self {
        Self { file, joined: OnceLock::new() }
    }

    pub(super) fn joined(&self) -> Result<Network, String> {
        self.joined.get_or_init(|| join(self.file.as_deref()).map(Network)).clone()
    }
}

/// Joins the Zenoh network described by a configuration file.
///
/// # Errors
/// Returns the reason as a sentence.
#[cfg(feature = "zenoh")]
pub fn join(file: Option<&std::path::Path>) -> Result<downbeat_robot::zenoh::Networks, String> {
    let file = file.ok_or(
        "robots at `zenoh:` addresses require a Zenoh configuration file: name it with `zenoh:` in the fleet file, \
         or with DOWNBEAT_ZENOH (docs/zenoh.md)",
    )?;
    downbeat_robot::zenoh::Networks::open(file).map_err(|error| error.to_string())
}

#[cfg(feature = "zenoh")]
impl Network {
    /// Returns the endpoint of the robot at a key, or `None` if `key` is not a valid key.
    #[must_use]
    pub fn endpoint(&self, key: &str, encoding: LinkEncoding) -> Option<Endpoint> {
        let key = key.parse().ok()?;
        Some(Endpoint::Zenoh { network: self.0.for_one_more(), key, encoding })
    }
}

#[cfg(not(feature = "zenoh"))]
impl OfSite {
    pub(super) fn new(_: Option<PathBuf>) -> Self {
        Self {}
    }

    pub(super) fn joined(&self) -> Result<Network, String> {
        Err(NOT_BUILT.to_owned())
    }
}

#[cfg(not(feature = "zenoh"))]
impl Network {
    /// Returns the endpoint of the robot at a key. Cannot be called, because no value of this type exists without Zenoh.
    #[must_use]
    pub const fn endpoint(&self, _: &str, _: LinkEncoding) -> Option<Endpoint> {
        match *self {}
    }
}
