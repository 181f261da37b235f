//! The lock of a journal. It shows whether the scheduler lives. A process can query the lock without taking it: if it took the lock even
//! for a moment, it could block a stop. The lock is independent of `flock`, so programs that use `flock` on the file do not block a stop
//! either.

use std::fs::File;
use std::io;

use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;

/// Takes the journal's lock. It is held until the file is closed.
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

/// Whether another open file description holds the lock of this journal.
pub(super) fn is_taken(file: &File) -> bool {
    let mut lock = whole_file();
    match fcntl(file, FcntlArg::F_OFD_GETLK(&mut lock)) {
        Ok(_) => i32::from(lock.l_type) != libc::F_UNLCK,
        Err(errno) => {
            tracing::debug!("cannot check whether the journal is locked: {errno}");
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
