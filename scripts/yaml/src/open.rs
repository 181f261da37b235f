//! Opens files for reading. Rejects everything that is not a file, and never waits for another process while opening. All file reads
//! start here.

use std::fs::{File, FileType, OpenOptions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

/// Opens a file that the user has named on the command line. Accepts regular files, and descriptors that the user's shell has opened for
/// this process, such as `<(command)` and `/dev/stdin`.
///
/// # Errors
/// Returns an error if the system refuses access, or if the path is a folder, a socket, or a pipe or device that is no such descriptor.
pub fn open(path: &Path) -> io::Result<File> {
    let own = is_own_descriptor(path);
    let is_taken = |kind: FileType| kind.is_file() || own && (kind.is_fifo() || kind.is_char_device());
    let file = open_if(path, OFlags::empty(), is_taken)?;
    if own {
        // With the flag set, an empty pipe would fail instead of waiting for data.
        rustix::fs::fcntl_setfl(&file, OFlags::empty())?;
    }
    Ok(file)
}

/// Opens a file that another file names. Accepts only regular files, and no symbolic link at the end of the path.
pub fn open_regular(path: &Path) -> io::Result<File> {
    open_if(path, OFlags::NOFOLLOW, |kind| kind.is_file())
}

fn open_if(path: &Path, flags: OFlags, is_taken: impl Fn(FileType) -> bool) -> io::Result<File> {
    let refuse = |kind: FileType| if is_taken(kind) { Ok(()) } else { Err(no_file(kind)) };
    // Opening a device may have side effects, so the kind is checked before opening, and again on the open file.
    refuse(std::fs::metadata(path)?.file_type())?;
    // If a pipe has replaced the file meanwhile, opening must not wait for the other end.
    let flags = flags | OFlags::NONBLOCK;
    let file = OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path)?;
    refuse(file.metadata()?.file_type())?;
    Ok(file)
}

fn no_file(kind: FileType) -> io::Error {
    let what = match () {
        () if kind.is_dir() => return ErrorKind::IsADirectory.into(),
        () if kind.is_fifo() => "a pipe",
        () if kind.is_socket() => "a socket",
        () => "a device",
    };
    io::Error::other(format!("this is {what}, not a file"))
}

/// Whether a path names an open descriptor of this process, such as `/dev/stdin`.
fn is_own_descriptor(path: &Path) -> bool {
    path == Path::new("/dev/stdin")
        || ["/dev/fd", "/proc/self/fd"].iter().any(|folder| path.starts_with(folder))
}

#[cfg(test)]
mod tests {
    use std::io::Read;
    use std::os::fd::AsRawFd;

    use rustix::fs::{CWD, FileType as Kind, Mode, mknodat};

    use super::*;

    fn told(path: &Path) -> String {
        open(path).map_err(|error| error.to_string()).expect_err("it was opened")
    }

    #[test]
    fn pipes_devices_and_folders_are_refused_without_waiting() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        mknodat(CWD, &pipe, Kind::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        assert_eq!(told(&pipe), "this is a pipe, not a file");
        assert_eq!(told(Path::new("/dev/zero")), "this is a device, not a file");
        assert_eq!(open(folder.path()).unwrap_err().kind(), ErrorKind::IsADirectory);
        let _socket = std::os::unix::net::UnixListener::bind(folder.path().join("socket")).unwrap();
        assert_eq!(told(&folder.path().join("socket")), "this is a socket, not a file");
    }

    #[test]
    fn shell_pipe_is_read_to_its_end() {
        let (read, mut write) = std::io::pipe().unwrap();
        let path = format!("/dev/fd/{}", read.as_raw_fd());
        let mut file = open(Path::new(&path)).unwrap();
        assert!(open_regular(Path::new(&path)).is_err(), "another file may not name it");
        let writing = std::thread::spawn(move || {
            std::io::Write::write_all(&mut write, b"scenario: ").unwrap();
            std::io::Write::write_all(&mut write, b"show").unwrap();
        });
        drop(read);
        let mut text = String::new();
        file.read_to_string(&mut text).unwrap();
        writing.join().unwrap();
        assert_eq!(text, "scenario: show");
    }

    #[test]
    fn link_named_in_another_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        std::fs::write(&real, "text").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        assert!(open(&link).is_ok());
        assert!(open_regular(&real).is_ok());
        assert!(open_regular(&link).is_err());
    }
}
