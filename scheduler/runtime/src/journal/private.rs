//! Opens private folders and files: those of the state folder, and those of an authority's keys. They must belong to the user of this process. If something else has their name, such as
//! another user's folder, a link or a pipe, this module returns an error that names it. This module never opens, follows or waits for
//! such an object.

use std::fs::{DirBuilder, File};
use std::io::{self, ErrorKind};
use std::os::fd::OwnedFd;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, FileType, Mode, OFlags, Stat};
use rustix::process::geteuid;

/// Mode of folders: full access for the owner only.
const FOLDER: Mode = Mode::RWXU;
/// Mode of files: read and write access for the owner only.
const FILE: Mode = Mode::RUSR.union(Mode::WUSR);
/// Any permission bit of other users.
const OTHERS: u32 = 0o077;
/// Write permission bits of other users.
const OTHERS_WRITE: u32 = 0o022;

/// The error for a folder or file to which other users have or had access.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} {fault}", path.display())]
pub struct NotPrivate {
    /// The path of the folder or file.
    pub path: PathBuf,
    fault: Fault,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum Fault {
    #[error("belongs to user {owner}, but this process runs as user {}: run this command as the owner, or use a folder of your own (set DOWNBEAT_STATE, or --keys for keys)", geteuid().as_raw())]
    Owner { owner: u32 },
    #[error("is writable by other users (mode {:04o}), so they may have changed it: check its contents, then restrict access with `chmod -R go= {path}`", mode & 0o7777)]
    Writable { mode: u32, path: String },
    #[error(
        "is a symbolic link, which is not followed: remove it, or use its target (set DOWNBEAT_STATE, or --keys for keys)"
    )]
    Link,
    #[error("has several hard links: move it away, then copy it back with `cp`")]
    Linked,
    #[error("is not a {0}: remove it")]
    Kind(&'static str),
}

impl NotPrivate {
    fn error(path: &Path, fault: Fault) -> io::Error {
        io::Error::other(Self { path: path.to_path_buf(), fault })
    }

    /// Returns the [`NotPrivate`] that caused an error, if there is one.
    #[must_use]
    pub fn of(error: &io::Error) -> Option<&Self> {
        error.get_ref()?.downcast_ref()
    }
}

/// How a file is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum How {
    /// Opens an existing file for reading.
    Read,
    /// Opens an existing file for reading and appending.
    Append,
    /// Like [`How::Append`], but creates the file if it does not exist.
    Create,
}

/// Opens an existing folder. If other users can read but not write it, removes their access first.
///
/// # Errors
/// Returns [`NotPrivate`], or the operating system's error.
pub fn folder(path: &Path) -> io::Result<OwnedFd> {
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let folder = match rustix::fs::open(path, flags, Mode::empty()) {
        Ok(folder) => folder,
        Err(rustix::io::Errno::NOTDIR | rustix::io::Errno::LOOP) => {
            let found = rustix::fs::lstat(path)?;
            let is_link = FileType::from_raw_mode(found.st_mode) == FileType::Symlink;
            return Err(NotPrivate::error(path, if is_link { Fault::Link } else { Fault::Kind("folder") }));
        }
        Err(error) => return Err(error.into()),
    };
    let found = rustix::fs::fstat(&folder)?;
    belongs(path, &found)?;
    if found.st_mode & OTHERS != 0
        && let Err(error) = rustix::fs::fchmod(&folder, FOLDER)
    {
        tracing::debug!("cannot restrict other users' access to {}: {error}", path.display());
    }
    Ok(folder)
}

/// Creates a folder for this user only, including missing parents, or opens the existing folder.
///
/// # Errors
/// Returns [`NotPrivate`], or the operating system's error.
pub fn create_folder(path: &Path) -> io::Result<OwnedFd> {
    match DirBuilder::new().recursive(true).mode(FOLDER.bits()).create(path) {
        // `folder` below reports what exists there instead.
        Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(error),
        _ => folder(path),
    }
}

/// Opens the file `name` in a subfolder of the state folder, or creates it as `how` permits.
///
/// # Errors
/// Fails like [`folder`], and also for anything that is not a regular file.
pub fn file(within: &Path, name: &str, how: How) -> io::Result<File> {
    let path = within.join(name);
    let access = match how {
        How::Read => OFlags::RDONLY,
        How::Append => OFlags::RDWR | OFlags::APPEND,
        How::Create => OFlags::RDWR | OFlags::APPEND | OFlags::CREATE,
    };
    let flags = access | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    let file = match rustix::fs::openat(folder(within)?, name, flags, FILE) {
        Ok(file) => File::from(file),
        Err(rustix::io::Errno::LOOP) => return Err(NotPrivate::error(&path, Fault::Link)),
        // A socket, or a device without a driver.
        Err(rustix::io::Errno::NXIO) => return Err(NotPrivate::error(&path, Fault::Kind("file"))),
        Err(error) => return Err(error.into()),
    };
    let found = rustix::fs::fstat(&file)?;
    if FileType::from_raw_mode(found.st_mode) != FileType::RegularFile {
        return Err(NotPrivate::error(&path, Fault::Kind("file")));
    }
    belongs(&path, &found)?;
    if found.st_nlink > 1 {
        return Err(NotPrivate::error(&path, Fault::Linked));
    }
    if how != How::Read
        && found.st_mode & OTHERS != 0
        && let Err(error) = rustix::fs::fchmod(&file, FILE)
    {
        tracing::debug!("cannot restrict other users' access to {}: {error}", path.display());
    }
    Ok(file)
}

/// Checks that the socket `name` in a subfolder of the state folder belongs to this user, and returns its path.
///
/// # Errors
/// Returns [`NotPrivate`], or the operating system's error.
pub fn socket(within: &Path, name: &str) -> io::Result<PathBuf> {
    let path = within.join(name);
    let found = rustix::fs::statat(folder(within)?, name, AtFlags::SYMLINK_NOFOLLOW)?;
    match FileType::from_raw_mode(found.st_mode) {
        FileType::Socket => belongs(&path, &found).map(|()| path),
        FileType::Symlink => Err(NotPrivate::error(&path, Fault::Link)),
        _ => Err(NotPrivate::error(&path, Fault::Kind("socket"))),
    }
}

fn belongs(path: &Path, found: &Stat) -> io::Result<()> {
    if found.st_uid != geteuid().as_raw() {
        return Err(NotPrivate::error(path, Fault::Owner { owner: found.st_uid }));
    }
    if found.st_mode & OTHERS_WRITE != 0 {
        let path_text = path.display().to_string();
        return Err(NotPrivate::error(path, Fault::Writable { mode: found.st_mode, path: path_text }));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs::{Permissions, set_permissions};
    use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};

    use rustix::fs::{CWD, mknodat};

    use super::*;

    const NOBODY: u32 = 65_534;

    fn mode(path: &Path) -> u32 {
        path.metadata().unwrap().mode() & 0o7777
    }

    fn told<T: std::fmt::Debug>(refused: io::Result<T>) -> String {
        let error = refused.unwrap_err();
        assert!(NotPrivate::of(&error).is_some(), "{error}");
        error.to_string()
    }

    /// Gives a file to another user and returns whether that succeeded. Only root can do that.
    fn given_away(path: &Path) -> bool {
        let given = chown(path, Some(NOBODY), None);
        assert_eq!(given.is_ok(), geteuid().is_root());
        given.is_ok()
    }

    #[test]
    fn folders_and_files_are_created_for_this_user_only() {
        let stage = tempfile::tempdir().unwrap();
        let (state, mission) = (stage.path().join("a/state"), stage.path().join("a/state/m"));
        create_folder(&mission).unwrap();
        drop(file(&mission, "journal", How::Create).unwrap());
        for path in [&stage.path().join("a"), &state, &mission] {
            assert_eq!(mode(path), 0o700, "{}", path.display());
        }
        assert_eq!(mode(&mission.join("journal")), 0o600);
    }

    #[test]
    fn folder_readable_by_others_is_made_private_and_a_writable_one_refused() {
        let stage = tempfile::tempdir().unwrap();
        let state = stage.path().join("state");
        std::fs::create_dir(&state).unwrap();
        set_permissions(&state, Permissions::from_mode(0o755)).unwrap();
        folder(&state).unwrap();
        assert_eq!(mode(&state), 0o700);
        for open in [0o770, 0o707, 0o1777] {
            set_permissions(&state, Permissions::from_mode(open)).unwrap();
            let told = told(folder(&state));
            assert!(told.contains("is writable by other users") && told.contains("`chmod -R go= "), "{told}");
            assert!(create_folder(&state).is_err());
        }
    }

    #[test]
    fn file_or_folder_of_another_user_is_refused_and_named() {
        let stage = tempfile::tempdir().unwrap();
        let state = stage.path().join("state");
        create_folder(&state).unwrap();
        drop(file(&state, "journal", How::Create).unwrap());
        if !given_away(&state.join("journal")) {
            return;
        }
        let told_of_file = told(file(&state, "journal", How::Read));
        assert!(told_of_file.contains("state/journal belongs to user 65534"), "{told_of_file}");
        assert!(given_away(&state));
        assert!(told(folder(&state)).contains("state belongs to user 65534"));
        assert!(told(create_folder(&state)).contains("run this command as the owner"));
    }

    #[test]
    fn links_pipes_and_sockets_are_neither_followed_nor_waited_for() {
        let stage = tempfile::tempdir().unwrap();
        let state = stage.path().join("state");
        create_folder(&state).unwrap();
        std::fs::write(stage.path().join("elsewhere"), "text").unwrap();
        symlink(stage.path().join("elsewhere"), state.join("link")).unwrap();
        std::fs::hard_link(stage.path().join("elsewhere"), state.join("linked")).unwrap();
        mknodat(CWD, state.join("pipe"), FileType::Fifo, FILE, 0).unwrap();
        let _listens = std::os::unix::net::UnixListener::bind(state.join("socket")).unwrap();
        for how in [How::Read, How::Append, How::Create] {
            assert!(told(file(&state, "link", how)).contains("link is a symbolic link"));
            assert!(told(file(&state, "linked", how)).contains("has several hard links"));
            assert!(told(file(&state, "pipe", how)).contains("pipe is not a file"));
            assert!(told(file(&state, "socket", how)).contains("socket is not a file"));
        }
        symlink(&state, stage.path().join("state-link")).unwrap();
        assert!(told(folder(&stage.path().join("state-link"))).contains("is a symbolic link"));
        assert!(told(create_folder(&stage.path().join("state-link"))).contains("is a symbolic link"));
        assert!(told(folder(&stage.path().join("elsewhere"))).contains("elsewhere is not a folder"));
        assert!(told(socket(&state, "pipe")).contains("pipe is not a socket"));
        set_permissions(state.join("socket"), Permissions::from_mode(0o600)).unwrap();
        assert_eq!(socket(&state, "socket").unwrap(), state.join("socket"));
    }

    #[test]
    fn file_in_place_of_a_new_folder_is_named() {
        let stage = tempfile::tempdir().unwrap();
        let path = stage.path().join("elsewhere");
        std::fs::write(&path, "text").unwrap();
        assert!(told(create_folder(&path)).contains("elsewhere is not a folder"));
        assert_eq!(create_folder(&path.join("below")).unwrap_err().kind(), ErrorKind::NotADirectory);
    }
}
