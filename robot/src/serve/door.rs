//! Decides which peers a robot admits, and whether an admitted peer may stay.

#[cfg(any(feature = "sealed", feature = "tls"))]
use std::collections::BTreeMap;
#[cfg(any(feature = "sealed", feature = "tls"))]
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
#[cfg(any(feature = "sealed", feature = "tls"))]
use std::time::{Duration, SystemTime, UNIX_EPOCH};
#[cfg(any(feature = "sealed", feature = "tls"))]
use std::{fmt, io};

#[cfg(any(feature = "sealed", feature = "tls"))]
use crate::host::HostHandle;
#[cfg(feature = "tls")]
use crate::tls;
#[cfg(feature = "sealed")]
use downbeat_sealed as sealed;
#[cfg(any(feature = "sealed", feature = "tls"))]
use urrcp::Proof;

/// Interval at which a robot checks whether the key of an open connection is still valid.
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
    /// Replaces the robot's list of revoked keys with this one, if this one is newer.
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
    /// Reads the list of revoked keys again if its file has changed. Runs on a separate thread, because a slow file system must not delay
    /// other connections.
    pub(super) async fn refresh(&self) {
        let door = self.clone();
        let _read = tokio::task::spawn_blocking(move || match door {
            Self::Open => {}
            #[cfg(feature = "tls")]
            Self::Tls(guard) => drop(guard.list()),
            #[cfg(feature = "sealed")]
            Self::Sealed(guard) => drop(guard.list()),
        })
        .await;
    }

    /// Returns the reason why a key is not valid at `now` (in seconds since 1970, UTC). `None` if it is valid.
    fn invalid(&self, key: &Key, now: i64) -> Option<Invalid> {
        let is_revoked = match self {
            Self::Open => return None,
            #[cfg(feature = "tls")]
            Self::Tls(guard) => guard.latest_list().is_some_and(|list| list.contains(&key.serial)),
            #[cfg(feature = "sealed")]
            Self::Sealed(guard) => guard.latest_list().is_some_and(|list| list.contains(&key.serial)),
        };
        if is_revoked {
            Some(Invalid::Revoked)
        } else if key.expires < now {
            Some(Invalid::Expired)
        } else {
            None
        }
    }
}

/// The keys with which peers of one robot have proven their identities. A key stays here after its connections have ended, because
/// the robot may still hold commands of the key's owner.
#[cfg(any(feature = "sealed", feature = "tls"))]
#[derive(Debug, Default)]
pub(super) struct Keys {
    admitted: Mutex<BTreeMap<String, Key>>,
}

#[cfg(any(feature = "sealed", feature = "tls"))]
impl Keys {
    /// Admits a peer if its key is valid now, and returns the identity that the key proves. The key may have become invalid since the
    /// peer began to prove its identity.
    pub(super) async fn admit(&self, door: &Door, key: Key) -> io::Result<Proof> {
        door.refresh().await;
        if let Some(invalid) = door.invalid(&key, calendar()) {
            return Err(io::Error::other(invalid.to_string()));
        }
        let proof = key.proof.clone().ok_or_else(|| io::Error::other("the name is too long"))?;
        self.lock().insert(key.serial.clone(), key);
        Ok(proof)
    }

    /// Whether a key was admitted and is still valid, as far as the robot has checked.
    pub(super) fn contains(&self, proof: &Proof) -> bool {
        proof.serial.as_ref().is_some_and(|serial| self.lock().contains_key(serial.as_str()))
    }

    /// Checks all keys once per second until the host stops. If a key has become invalid, ends the commands of the key's owner and closes
    /// the connections that used the key.
    pub(super) async fn watch(&self, door: &Door, host: &HostHandle, robot: usize) {
        while !host.has_stopped() {
            tokio::time::sleep(CHECK).await;
            door.refresh().await;
            let now = calendar();
            let check = |key: &Key| Some((key.proof.as_ref()?.serial.clone()?, door.invalid(key, now)?));
            let invalid: Vec<_> = self.lock().values().filter_map(check).collect();
            for (serial, why) in invalid {
                // The key is removed first, because a connection that has just been opened checks afterwards whether its key is still
                // here.
                self.lock().remove(serial.as_str());
                host.bar(robot, serial, why.to_string());
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Key>> {
        self.admitted.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(any(feature = "sealed", feature = "tls"))]
#[expect(clippy::disallowed_methods, reason = "keys are valid by the calendar")]
fn calendar() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}
