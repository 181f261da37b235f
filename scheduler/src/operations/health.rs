//! Whether the parts of this process are alive and ready.

use std::future::Future;
use std::pin::Pin;

/// A part of the process that can report its health.
pub(crate) trait Health: Send + Sync {
    /// Checks the current state.
    fn now(&self) -> Pin<Box<dyn Future<Output = Checked> + Send + '_>>;
}

/// The results of both checks, as text for people. Each error names the fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Checked {
    /// Whether it works. If not, it must be restarted.
    pub(crate) alive: Result<String, String>,
    /// Whether it can currently do its job.
    pub(crate) ready: Result<String, String>,
}
