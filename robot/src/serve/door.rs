//! Decides which peers a robot admits, and whether an admitted peer may stay.

#[cfg(any(feature = "sealed", feature = "tls"))]
use std::fmt;
use std::sync::Arc;
#[cfg(any(feature = "sealed", feature = "tls"))]
use std::time::{Duration, SystemTime, UNIX_EPOCH};

#[cfg(feature = "tls")]
use crate::tls;
#[cfg(feature = "sealed")]
use downbeat_sealed as sealed;
#[cfg(any(feature = "sealed", feature = "tls"))]
use urrcp::Proof;

/// Interval at which it is checked whether the key of an open connection is still valid.
#[cfg(any(feature = "sealed", feature = "tls"))]
const CHECK: Duration = Duration::from_secs(1);

/// Determines which peers a robot admits.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub enum Door {
    /// Admits all peers.
    #[default]
    Open,
    /// Admits operators with a certificate of the robot's authority.
    #[cfg(feature = "tls")]
    Tls(Arc<tls::Guard>),
    /// Admits operators with a pass that is derived from the robot's secret.
    #[cfg(feature = "sealed")]
    Sealed(Arc<sealed::Guard>),
}

impl Door {
    /// Replaces the robot's list of revoked keys with this one, if it is later.
    #[cfg_attr(not(any(feature = "sealed", feature = "tls")), expect(unused_variables))]
    pub(super) fn replace_list(&self, text: &str) -> Result<(), String> {
        match self {
            Self::Open => Err("the robot accepts all peers, and has no list of revoked keys".to_owned()),
            #[cfg(feature = "tls")]
            Self::Tls(guard) => guard.replace_list(text),
            #[cfg(feature = "sealed")]
            Self::Sealed(guard) => guard.replace_list(text),
        }
    }

    /// Returns the number of the robot's list of revoked keys. `None` if it has no list.
    pub(super) fn list_number(&self) -> Option<u64> {
        match self {
            Self::Open => None,
            #[cfg(feature = "tls")]
            Self::Tls(guard) => guard.latest_list()?.number(),
            #[cfg(feature = "sealed")]
            Self::Sealed(guard) => guard.latest_list().map(|list| list.number()),
        }
    }
}

/// The key with which a peer has proven its identity.
#[cfg(any(feature = "sealed", feature = "tls"))]
#[derive(Clone, Debug)]
pub(super) struct Key {
    /// The identity that the key proves. `None` if the name is too long for the protocol.
    pub(super) proof: Option<Proof>,
    /// Serial number of the certificate or the pass.
    serial: String,
    /// Time after which the key is invalid, in seconds since 1970, UTC.
    expires: i64,
}

#[cfg(feature = "tls")]
impl From<tls::Identity> for Key {
    fn from(identity: tls::Identity) -> Self {
        Self { proof: identity.proof(), expires: identity.expires, serial: identity.serial }
    }
}

#[cfg(feature = "sealed")]
impl From<sealed::Claim> for Key {
    fn from(claim: sealed::Claim) -> Self {
        Self { proof: claim.proof(), expires: claim.expires, serial: claim.serial }
    }
}

/// Reason why a key is no longer valid.
#[cfg(any(feature = "sealed", feature = "tls"))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Invalid {
    Revoked,
    Expired,
}

#[cfg(any(feature = "sealed", feature = "tls"))]
impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Revoked => "the operator's key was revoked",
            Self::Expired => "the operator's key has expired",
        })
    }
}

#[cfg(any(feature = "sealed", feature = "tls"))]
impl Door {
    /// Returns why an admitted peer's key is no longer valid at `now`, in seconds since 1970, UTC.
    fn invalid(&self, key: &Key, now: i64) -> Option<Invalid> {
        let is_revoked = match self {
            Self::Open => return None,
            #[cfg(feature = "tls")]
            Self::Tls(guard) => guard.list().is_some_and(|list| list.contains(&key.serial)),
            #[cfg(feature = "sealed")]
            Self::Sealed(guard) => guard.list().is_some_and(|list| list.contains(&key.serial)),
        };
        if is_revoked {
            Some(Invalid::Revoked)
        } else if key.expires < now {
            Some(Invalid::Expired)
        } else {
            None
        }
    }

    /// Waits until an admitted peer's key is no longer valid.
    pub(super) async fn until_invalid(&self, key: &Key) -> Invalid {
        loop {
            tokio::time::sleep(CHECK).await;
            let (door, own) = (self.clone(), key.clone());
            // A slow file system must not delay other connections.
            let checked = tokio::task::spawn_blocking(move || door.invalid(&own, calendar()));
            if let Ok(Some(invalid)) = checked.await {
                return invalid;
            }
        }
    }
}

#[cfg(any(feature = "sealed", feature = "tls"))]
#[expect(clippy::disallowed_methods, reason = "keys are valid by the calendar")]
fn calendar() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}
