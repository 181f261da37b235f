//! Health checks: whether the parts of this process are alive and ready.

use std::future::Future;
use std::pin::Pin;

/// A part of the process that can report its health.
pub(crate) trait Health: Send + Sync {
    /// Checks the current health of this part.
    fn now(&self) -> Pin<Box<dyn Future<Output = Checked> + Send + '_>>;
}

/// The results of the two health checks, `alive` and `ready`, as text for people. Each error names the fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Checked {
    /// Whether the part works. If it does not, the process must be restarted.
    pub(crate) alive: Result<String, String>,
    /// Whether the part can currently do its work.
    pub(crate) ready: Result<String, String>,
}
