//! The limit of open files, which also limits sockets. A fleet of a thousand robots needs more sockets than the usual soft limit permits.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Raises the soft limit of open files to the hard limit. If the system does not permit that, the soft limit stays unchanged.
pub fn raise_limit() {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    if let Err(error) = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }) {
        tracing::warn!("cannot raise the limit on open files: {error}");
    }
}
