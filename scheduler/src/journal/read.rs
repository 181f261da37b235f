//! Reads the lines of a journal back, as far as they are whole.

use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;
use urrcp::{Server, Timestamp};

use super::private::{self, How};
use super::{Kept, Opened};
use crate::mission::ActReport;

/// A journal that does not even say whose it is.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// The file cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// Its first line is not whole.
    #[error("{} does not begin with a whole line of a journal", path.display())]
    NoBegin {
        /// Which file.
        path: PathBuf,
    },
}

/// A journal with a line that was cut off or changed. What that line and those after it said is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Torn {
    /// Which line, counted from 1.
    pub line: usize,
    /// Bytes from there to the end of the file.
    pub bytes: usize,
    /// Whole lines behind it: the file was damaged, not only cut off.
    pub whole_after: usize,
}

/// Reads a journal of this user up to the first line that is not whole.
///
/// # Errors
/// [`Unreadable`] where not even the first line is whole.
pub fn read(path: &Path) -> Result<Kept, Unreadable> {
    let bytes = bytes_of(path).map_err(|error| Unreadable::Io { path: path.to_path_buf(), error })?;
    Kept::of_bytes(&bytes).ok_or_else(|| Unreadable::NoBegin { path: path.to_path_buf() })
}

/// The bytes of a journal in the state folder.
pub(super) fn bytes_of(path: &Path) -> io::Result<Vec<u8>> {
    let name = path.file_name().and_then(std::ffi::OsStr::to_str).ok_or(io::ErrorKind::NotFound)?;
    let mut bytes = Vec::new();
    private::file(path.parent().unwrap_or(Path::new(".")), name, How::Read)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// All that a journal says, for reports and pages.
#[derive(Clone, Debug)]
pub struct Records {
    /// Its first line.
    pub opened: Opened,
    /// Its further lines, up to where it stops being whole.
    pub all: Vec<(Timestamp<Server>, Value)>,
    /// Where that is.
    pub torn: Option<Torn>,
}

/// The lines of a journal whose bytes these are, up to the first one that is not whole. `path` is for error messages.
///
/// # Errors
/// [`Unreadable::NoBegin`] where not even the first line is whole.
pub fn records(bytes: &[u8], path: &Path) -> Result<Records, Unreadable> {
    let kept = Kept::of_bytes(bytes).ok_or_else(|| Unreadable::NoBegin { path: path.to_path_buf() })?;
    let lines = bytes[..kept.whole()].split_inclusive(|byte| *byte == b'\n').skip(1).filter_map(whole);
    let dated = |line: Value| Some((Timestamp::deserialize(&line["at"]).ok()?, line));
    Ok(Records { opened: kept.opened, all: lines.filter_map(dated).collect(), torn: kept.torn })
}

/// Bytes of the whole lines at the beginning.
pub(super) fn whole_length(bytes: &[u8]) -> usize {
    let lines = bytes.split_inclusive(|byte| *byte == b'\n');
    lines.take_while(|line| sound(line).is_some()).map(<[u8]>::len).sum()
}

/// What a whole line says.
pub(super) fn whole(line: &[u8]) -> Option<Value> {
    serde_json::from_slice(sound(line)?).ok()
}

/// The JSON of a line that is as it was written.
pub(super) fn sound(line: &[u8]) -> Option<&[u8]> {
    let line = line.strip_suffix(b"\n")?;
    let (sum, json) = line.split_at_checked(9)?;
    let sum = u32::from_str_radix(std::str::from_utf8(sum.strip_suffix(b" ")?).ok()?, 16).ok()?;
    (crc32fast::hash(json) == sum).then_some(json)
}

/// Whether a line is of this kind. The kind follows the time of the line.
pub(super) fn begins_with(json: &[u8], kind: &[u8]) -> bool {
    let begin = &json[..json.len().min(128)];
    begin.windows(kind.len()).any(|bytes| bytes == kind)
}

/// The reports of the acts that have ended, in order, without attempts that were repeated. Reports that cannot be read, for
/// example those of an earlier version, are left out.
pub fn ended_acts(bytes: &[u8]) -> impl Iterator<Item = ActReport> {
    #[derive(Deserialize)]
    struct Ended {
        report: ActReport,
        #[serde(default)]
        again: bool,
    }
    let lines = bytes.split_inclusive(|byte| *byte == b'\n').map_while(sound);
    let ended = lines.filter(|json| begins_with(json, br#","record":"act_ended","#));
    let ended = ended.filter_map(|json| serde_json::from_slice::<Ended>(json).ok());
    ended.filter(|ended| !ended.again).map(|ended| ended.report)
}
