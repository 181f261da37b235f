//! Decides which peers a robot admits.

#[cfg(any(feature = "sealed", feature = "tls"))]
use std::sync::Arc;

#[cfg(feature = "tls")]
use crate::tls;
#[cfg(feature = "sealed")]
use downbeat_sealed as sealed;

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
