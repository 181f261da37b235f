//! The lock of a journal. It shows whether the scheduler lives, and it can be queried without being taken. If a query had to take the
//! lock for a moment, it would occasionally block a stop. So would any other program that locks the file with `flock`, which is
//! independent of this lock.

use std::fs::File;
use std::io;

use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;

/// Takes the lock for as long as the file is open.
///
/// # Errors
/// Returns [`io::ErrorKind::WouldBlock`] if another open file holds the lock.
pub(super) fn take(file: &File) -> io::Result<()> {
    let lock = whole_file();
    fcntl(file, FcntlArg::F_OFD_SETLK(&lock)).map(drop).map_err(|errno| match errno {
        nix::Error::EACCES | nix::Error::EAGAIN => io::ErrorKind::WouldBlock.into(),
        other => other.into(),
    })
}

/// Whether another open file holds the lock.
pub(super) fn is_taken(file: &File) -> bool {
    let mut lock = whole_file();
    match fcntl(file, FcntlArg::F_OFD_GETLK(&mut lock)) {
        Ok(_) => i32::from(lock.l_type) != libc::F_UNLCK,
        Err(errno) => {
            tracing::debug!("cannot ask for a lock: {errno}");
            false
        }
    }
}

fn whole_file() -> libc::flock {
    libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: 0,
        l_len: 0,
        l_pid: 0,
    }
}
