//! The lines of a journal. Each line consists of a checksum and a JSON value.

use std::io;

use serde::Serialize;
use serde_json::Value;
use urrcp::{Server, Timestamp};

use super::ActReport;
use super::record::{ENDED_ACT, EndedAct};

/// The journal line of a record of any type, with the time of the record.
///
/// # Errors
/// Fails if the record cannot be written as JSON.
pub fn dated_line(at: Timestamp<Server>, record: &impl Serialize) -> io::Result<Vec<u8>> {
    #[derive(Serialize)]
    struct Dated<'a, T> {
        at: Timestamp<Server>,
        #[serde(flatten)]
        record: &'a T,
    }
    line(&Dated { at, record })
}

/// The journal line of a value: the checksum, then the JSON.
///
/// # Errors
/// Fails if the value cannot be written as JSON.
pub fn line(json: &impl Serialize) -> io::Result<Vec<u8>> {
    let json = serde_json::to_vec(json)?;
    let mut bytes = format!("{:08x} ", crc32fast::hash(&json)).into_bytes();
    bytes.extend_from_slice(&json);
    bytes.push(b'\n');
    Ok(bytes)
}

/// The length in bytes of the complete lines (whose checksums match) at the beginning of a journal.
pub fn whole_length(bytes: &[u8]) -> usize {
    let lines = bytes.split_inclusive(|byte| *byte == b'\n');
    lines.take_while(|line| sound(line).is_some()).map(<[u8]>::len).sum()
}

/// The JSON value of a complete line; `None` if the line is incomplete.
pub fn whole(line: &[u8]) -> Option<Value> {
    serde_json::from_slice(sound(line)?).ok()
}

/// The JSON of a line; `None` if its checksum does not match.
pub fn sound(line: &[u8]) -> Option<&[u8]> {
    let line = line.strip_suffix(b"\n")?;
    let (sum, json) = line.split_at_checked(9)?;
    let sum = u32::from_str_radix(std::str::from_utf8(sum.strip_suffix(b" ")?).ok()?, 16).ok()?;
    (crc32fast::hash(json) == sum).then_some(json)
}

/// Whether the first 128 bytes of the JSON of a line contain `kind`: the text, after the time, that names the kind of the record.
pub fn begins_with(json: &[u8], kind: &[u8]) -> bool {
    let begin = &json[..json.len().min(128)];
    begin.windows(kind.len()).any(|bytes| bytes == kind)
}

/// The reports of the ended acts in a journal, in order. Attempts that were repeated later are omitted.
pub fn ended_acts(bytes: &[u8]) -> impl Iterator<Item = ActReport> {
    let lines = bytes.split_inclusive(|byte| *byte == b'\n').map_while(sound);
    let ended = lines.filter(|json| begins_with(json, ENDED_ACT));
    let ended = ended.filter_map(|json| serde_json::from_slice::<EndedAct<ActReport>>(json).ok());
    ended.filter(|ended| !ended.again).map(|ended| ended.report)
}
