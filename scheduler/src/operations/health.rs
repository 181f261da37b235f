//! Whether what this process does is alive and ready.

use std::future::Future;
use std::pin::Pin;

/// What can be asked for its health.
pub(crate) trait Health: Send + Sync {
    /// As it is now.
    fn now(&self) -> Pin<Box<dyn Future<Output = Checked> + Send + '_>>;
}

/// The answer to both questions, for people, each with what is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Checked {
    /// It works; if not, it has to be started again.
    pub(crate) alive: Result<String, String>,
    /// It can do now what it is for.
    pub(crate) ready: Result<String, String>,
}
