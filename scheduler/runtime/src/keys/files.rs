//! The files of a certificate authority. Files that contain a key are private. A file is never changed in part: a new version replaces
//! it.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use downbeat_robot::tls::Name;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};
use urrcp::RobotId;

use super::KeysError;
use crate::journal::private;

/// The characters that are percent-encoded in file names: all except letters, digits, `-` and `_`. The full stop is encoded, so no file
/// name is `..` or hidden.
const KEPT: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'_');

/// Maximum number of bytes read from a file. The record of about 100,000 certificates has this size.
const BYTES_MAX: u64 = 32 * 1024 * 1024;

fn at(path: &Path) -> impl FnOnce(io::Error) -> KeysError + '_ {
    |error| match private::NotPrivate::of(&error) {
        Some(fault) => KeysError::NotPrivate(fault.clone()),
        None => KeysError::File { path: path.into(), error },
    }
}

/// Creates a folder to which only its owner has access, if it does not exist.
///
/// # Errors
/// Fails if the path is a link, or if the folder belongs to another user or is writable by other users.
pub(super) fn make_private_folder(path: &Path) -> Result<(), KeysError> {
    private::create_folder(path).map(drop).map_err(at(path))
}

/// Makes Git ignore the contents of a folder, unless the folder already states what to ignore.
pub(super) fn keep_out_of_git(folder: &Path) -> Result<(), KeysError> {
    let path = folder.join(".gitignore");
    if fs::symlink_metadata(&path).is_ok() {
        return Ok(());
    }
    write_public(&path, "# Keys must not be published.\n*\n")
}

/// Locks a folder against other processes until the file is closed.
pub(super) fn lock(folder: &Path) -> Result<File, KeysError> {
    let file = File::open(folder).map_err(at(folder))?;
    file.lock().map_err(at(folder))?;
    Ok(file)
}

/// Returns a name as the name of a file, without its extension.
#[must_use]
pub fn file_name(name: &str) -> String {
    utf8_percent_encode(name, KEPT).to_string()
}

/// Returns the name of a robot's or operator's files, without their extension.
pub(super) fn name_of(name: &Name) -> String {
    match name {
        Name::Robot(id) => file_name(id.as_str()),
        Name::Operator(name) => file_name(name),
    }
}

/// Returns the path of a robot's or operator's identity file.
pub(super) fn identity_path(folder: &Path, name: &Name) -> PathBuf {
    let kind = match name {
        Name::Robot(_) => "robots",
        Name::Operator(_) => "operators",
    };
    folder.join(kind).join(format!("{}.pem", name_of(name)))
}

/// Returns the folder that contains the robots' secrets.
fn secrets(folder: &Path) -> PathBuf {
    folder.join("secrets")
}

pub(super) fn secret_path(folder: &Path, robot: &RobotId) -> PathBuf {
    secrets(folder).join(format!("{}.secret", file_name(robot.as_str())))
}

/// Returns the robots that have a secret, sorted by id.
pub(super) fn robots_with_secret(folder: &Path) -> Result<Vec<RobotId>, KeysError> {
    let folder = secrets(folder);
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let mut robots = Vec::new();
    for entry in fs::read_dir(&folder).map_err(at(&folder))? {
        let name = entry.map_err(at(&folder))?.file_name();
        let name = name.to_str().and_then(|name| name.strip_suffix(".secret"));
        let name = name.and_then(|name| percent_decode_str(name).decode_utf8().ok());
        robots.extend(name.and_then(|name| name.parse::<RobotId>().ok()));
    }
    robots.sort();
    Ok(robots)
}

/// Deletes a file if it exists. Returns whether it existed.
pub(super) fn delete(path: &Path) -> Result<bool, KeysError> {
    #[cfg(test)]
    interruption::check(path)?;
    match fs::remove_file(path) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(at(path)(error)),
    }
}

/// Reads a whole regular file. Fails for a pipe or a device, so that the call does not block.
pub(super) fn read(path: &Path) -> Result<String, KeysError> {
    let text = downbeat_scripts::open(path).and_then(|file| io::read_to_string(file.take(BYTES_MAX)));
    text.map_err(at(path))
}

/// Returns an error if other users may have changed this key file, or may read it: it must be a regular file that belongs to the user of
/// this process, in a folder that only this user can write to.
pub(super) fn check_private(folder: &Path, name: &str) -> Result<(), KeysError> {
    let path = &folder.join(name);
    private::file(folder, name, private::How::Read).map_err(at(path))?;
    let mode = fs::metadata(path).map_err(at(path))?.permissions().mode() & 0o777;
    if mode & 0o077 == 0 {
        return Ok(());
    }
    let what = format!(
        "other users can read this key (mode {mode:03o}); restrict access with `chmod 600 {}`",
        path.display()
    );
    Err(KeysError::Damaged { path: path.into(), what })
}

/// Checks that a file does not exist.
pub(super) fn check_new(path: &Path) -> Result<(), KeysError> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(at(path)(error)),
        Ok(_) => Err(KeysError::FileExists(path.into())),
    }
}

/// Writes a new file with these permission bits. Fails if it exists; if it cannot be written, nothing remains.
pub(super) fn write_new(path: &Path, text: &str, mode: u32) -> Result<(), KeysError> {
    let file = OpenOptions::new().write(true).create_new(true).mode(mode).open(path);
    let mut file = file.map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => KeysError::FileExists(path.into()),
        _ => at(path)(error),
    })?;
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    written.map_err(|error| {
        let _partly_written = fs::remove_file(path);
        at(path)(error)
    })
}

pub(super) fn write_private(path: &Path, text: &str) -> Result<(), KeysError> {
    #[cfg(test)]
    interruption::check(path)?;
    downbeat_robot::replace(path, text.as_bytes(), 0o600).map_err(at(path))
}

pub(super) fn write_public(path: &Path, text: &str) -> Result<(), KeysError> {
    #[cfg(test)]
    interruption::check(path)?;
    downbeat_robot::replace(path, text.as_bytes(), 0o644).map_err(at(path))
}

/// Interrupts changes of a folder between two writes, as if the process had been killed there.
#[cfg(test)]
pub(super) mod interruption {
    use std::cell::Cell;
    use std::io;
    use std::path::Path;

    use super::{KeysError, at};

    thread_local! {
        /// Number of writes that this thread may still do. `None` without a limit.
        static LEFT: Cell<Option<usize>> = const { Cell::new(None) };
    }

    /// Calls `change`, and makes all its writes after the first `count` fail.
    pub(crate) fn after<T>(count: usize, change: impl FnOnce() -> T) -> T {
        LEFT.set(Some(count));
        let result = change();
        LEFT.set(None);
        result
    }

    pub(super) fn check(path: &Path) -> Result<(), KeysError> {
        match LEFT.get() {
            None => Ok(()),
            Some(0) => Err(at(path)(io::Error::other("interrupted"))),
            Some(left) => {
                LEFT.set(Some(left - 1));
                Ok(())
            }
        }
    }
}
