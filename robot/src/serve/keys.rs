//! The keys with which the peers of a robot have proven their identities, and whether these keys are still valid.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use std::{fmt, io};

use super::door::Door;
use crate::host::HostHandle;
#[cfg(feature = "tls")]
use crate::tls;
#[cfg(feature = "sealed")]
use downbeat_sealed as sealed;
use urrcp::Proof;

/// Interval at which a robot checks whether the keys of its peers are still valid.
const CHECK: Duration = Duration::from_secs(1);

/// The key with which a peer has proven its identity.
#[derive(Clone, Debug)]
pub(super) struct Key {
    /// The identity that the key proves. `None` if the name is too long for the protocol.
    proof: Option<Proof>,
    /// Serial number of the certificate or the pass.
    serial: String,
    /// Name of the authority that issued the certificate. `None` for a pass.
    #[cfg(feature = "tls")]
    authority: Option<String>,
    /// Time after which the key is invalid, in seconds since 1970, UTC.
    expires: i64,
}

#[cfg(feature = "tls")]
impl From<tls::Identity> for Key {
    fn from(identity: tls::Identity) -> Self {
        Self {
            proof: identity.proof(),
            expires: identity.expires,
            serial: identity.serial,
            authority: Some(identity.authority),
        }
    }
}

#[cfg(feature = "sealed")]
impl From<sealed::Claim> for Key {
    fn from(claim: sealed::Claim) -> Self {
        Self {
            proof: claim.proof(),
            expires: claim.expires,
            serial: claim.serial,
            #[cfg(feature = "tls")]
            authority: None,
        }
    }
}

/// Reason why a key is no longer valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Invalid {
    Revoked,
    #[cfg(feature = "tls")]
    AuthorityEnded,
    Expired,
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Revoked => "the operator's key was revoked",
            #[cfg(feature = "tls")]
            Self::AuthorityEnded => "the authority of the operator's key was replaced",
            Self::Expired => "the operator's key has expired",
        })
    }
}

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
        let excluded = match self {
            Self::Open => return None,
            #[cfg(feature = "tls")]
            Self::Tls(guard) => guard.latest_list().and_then(|list| {
                let authority = key.authority.as_deref().unwrap_or_default();
                list.exclusion(authority, &key.serial).map(Invalid::from)
            }),
            #[cfg(feature = "sealed")]
            Self::Sealed(guard) => {
                guard.latest_list().is_some_and(|list| list.contains(&key.serial)).then_some(Invalid::Revoked)
            }
        };
        excluded.or_else(|| (key.expires < now).then_some(Invalid::Expired))
    }
}

#[cfg(feature = "tls")]
impl From<tls::Exclusion> for Invalid {
    fn from(exclusion: tls::Exclusion) -> Self {
        match exclusion {
            tls::Exclusion::Revoked => Self::Revoked,
            tls::Exclusion::AuthorityEnded => Self::AuthorityEnded,
        }
    }
}

/// The keys with which peers of one robot have proven their identities. A key stays here after its connections have ended, because
/// the robot may still hold commands of the key's owner.
#[derive(Debug, Default)]
pub(super) struct Keys {
    admitted: Mutex<BTreeMap<String, Key>>,
}

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

#[expect(clippy::disallowed_methods, reason = "keys are valid by the calendar")]
fn calendar() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
}
