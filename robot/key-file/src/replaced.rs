//! Replaces files as a whole.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Writes a file with these permission bits so that a reader sees the old version or the new one, never a part. The new version is on
/// the disk when this returns.
pub fn replace(path: &Path, content: &[u8], mode: u32) -> io::Result<()> {
    // Robots on one machine may share a list, so each process has its own name for the new version.
    let part = path.with_extension(format!("part{}", std::process::id()));
    let _left_by_an_interrupted_call = fs::remove_file(&part);
    let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(&part)?;
    file.write_all(content)?;
    file.sync_all()?;
    fs::rename(&part, path)
}
