//! Replaces whole files atomically.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Writes a file with these permission bits. A reader sees either the old version or the new one, never a part of it. When this function
/// returns, the new version is on disk.
pub fn replace(path: &Path, content: &[u8], mode: u32) -> io::Result<()> {
    // Robots on one machine may share a list, so each process writes the new version under a temporary name of its own.
    let part = path.with_extension(format!("part{}", std::process::id()));
    let _left_by_an_interrupted_call = fs::remove_file(&part);
    let mut file = OpenOptions::new().write(true).create_new(true).mode(mode).open(&part)?;
    file.write_all(content)?;
    file.sync_all()?;
    fs::rename(&part, path)
}
