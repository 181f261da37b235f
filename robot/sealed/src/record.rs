//! Records: the bytes that a connection carries in one direction are sent in records, each with an authentication code. The code covers
//! the sequence number of the record, which is not sent. A record that is repeated, omitted or reordered therefore has a wrong code.

use hmac::Mac;

use super::secret::code;

/// Maximum size of a record's content in bytes. A robot has to keep the whole record until it has verified the code.
pub const RECORD_BYTES_MAX: usize = 16 * 1024;
/// Number of bytes to which a code is truncated before it is sent: 128 bits, the minimum of RFC 2104 (section 5).
const TAG_BYTES: usize = 16;
/// Size of a record's header in bytes: the length of the content, and the code.
const HEAD_BYTES: usize = 4 + TAG_BYTES;

/// Error in a record: it differs from the record that its sender wrote, or arrived in the wrong order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadRecord {
    /// The record is empty or exceeds the maximum length. Contains its length.
    #[error("a record of {0} bytes, expected 1 to {RECORD_BYTES_MAX}")]
    Length(u32),
    /// The code of the record is wrong.
    #[error("a record was altered, repeated, omitted or reordered")]
    Code,
}

/// Writes the records of one direction of a connection.
#[derive(Debug)]
pub struct Sealing {
    key: [u8; 32],
    next: u64,
}

impl Sealing {
    pub(super) const fn new(key: [u8; 32]) -> Self {
        Self { key, next: 0 }
    }

    /// Appends `bytes` to `records` in as few records as possible.
    pub fn seal(&mut self, bytes: &[u8], records: &mut Vec<u8>) {
        for part in bytes.chunks(RECORD_BYTES_MAX) {
            let length = (u32::try_from(part.len()).unwrap_or(u32::MAX)).to_be_bytes();
            let tag = code(&self.key, &[&self.next.to_be_bytes(), &length, part]).finalize().into_bytes();
            self.next += 1;
            records.extend_from_slice(&length);
            records.extend_from_slice(&tag[..TAG_BYTES]);
            records.extend_from_slice(part);
        }
    }
}

/// Reads the records of one direction of a connection. After a bad record, it reads no further ones.
#[derive(Debug)]
pub struct Opening {
    key: [u8; 32],
    next: u64,
    raw: Vec<u8>,
    bad: Option<BadRecord>,
}

impl Opening {
    pub(super) const fn new(key: [u8; 32]) -> Self {
        Self { key, next: 0, raw: Vec::new(), bad: None }
    }

    /// Appends received bytes, which [`Opening::open`] then processes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.raw.extend_from_slice(bytes);
    }

    /// Whether an incomplete record has been received.
    #[must_use]
    pub fn is_within_record(&self) -> bool {
        !self.raw.is_empty()
    }

    /// Appends the content of the next record to `bytes`. Returns whether there was a complete record.
    ///
    /// # Errors
    /// [`BadRecord`]. Every later call returns this error again, because later bytes cannot be trusted.
    pub fn open(&mut self, bytes: &mut Vec<u8>) -> Result<bool, BadRecord> {
        if let Some(bad) = self.bad {
            return Err(bad);
        }
        let opened = self.open_next(bytes);
        self.bad = opened.err();
        opened
    }

    fn open_next(&mut self, bytes: &mut Vec<u8>) -> Result<bool, BadRecord> {
        let Some((length, rest)) = self.raw.split_first_chunk::<4>() else { return Ok(false) };
        let carries = u32::from_be_bytes(*length);
        let size = usize::try_from(carries).unwrap_or(usize::MAX);
        if !(1..=RECORD_BYTES_MAX).contains(&size) {
            return Err(BadRecord::Length(carries));
        }
        let Some((tag, carried)) = rest.get(..TAG_BYTES + size).map(|rest| rest.split_at(TAG_BYTES)) else {
            return Ok(false);
        };
        // The comparison takes the same time wherever the codes differ.
        let right = code(&self.key, &[&self.next.to_be_bytes(), length, carried]).verify_truncated_left(tag);
        right.map_err(|_| BadRecord::Code)?;
        self.next += 1;
        bytes.extend_from_slice(carried);
        self.raw.drain(..HEAD_BYTES + size);
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: [u8; 32] = [7; 32];

    fn records(parts: &[&[u8]]) -> Vec<Vec<u8>> {
        let mut sealing = Sealing::new(KEY);
        let sealed = |part: &&[u8]| {
            let mut record = Vec::new();
            sealing.seal(part, &mut record);
            record
        };
        parts.iter().map(sealed).collect()
    }

    fn open(raw: &[u8]) -> (Vec<u8>, Result<bool, BadRecord>) {
        let mut opening = Opening::new(KEY);
        opening.push(raw);
        let mut bytes = Vec::new();
        loop {
            match opening.open(&mut bytes) {
                Ok(true) => {}
                ended => return (bytes, ended),
            }
        }
    }

    #[test]
    fn sealed_bytes_can_be_opened_however_they_are_split() {
        let long: Vec<u8> = (0..2 * RECORD_BYTES_MAX + 1).map(|n| n as u8).collect();
        let sealed = records(&[b"one\n", &long, b"two"]).concat();
        assert_eq!(sealed.len(), 4 + long.len() + 3 + 5 * HEAD_BYTES);
        for cut in [1, 3, 4, 19, 1000] {
            let mut opening = Opening::new(KEY);
            let mut bytes = Vec::new();
            for part in sealed.chunks(cut) {
                opening.push(part);
                while opening.open(&mut bytes).unwrap() {}
            }
            assert_eq!(bytes, [b"one\n".as_slice(), &long, b"two"].concat());
            assert!(!opening.is_within_record());
        }
    }

    #[test]
    fn altered_repeated_missing_or_reordered_record_ends_the_stream() {
        let sealed = records(&[b"zero", b"one", b"two"]);
        let [zero, one, two] = [0, 1, 2].map(|n| &sealed[n]);
        for at in 4..zero.len() {
            let mut altered = zero.clone();
            altered[at] ^= 1;
            assert_eq!(open(&altered), (vec![], Err(BadRecord::Code)), "byte {at}");
        }
        let read = |parts: &[&Vec<u8>]| {
            open(&parts.iter().flat_map(|part| part.iter().copied()).collect::<Vec<_>>())
        };
        assert_eq!(read(&[zero, zero]), (b"zero".to_vec(), Err(BadRecord::Code)));
        assert_eq!(read(&[zero, two]), (b"zero".to_vec(), Err(BadRecord::Code)));
        assert_eq!(read(&[one, zero]), (vec![], Err(BadRecord::Code)));
        assert_eq!(read(&[zero, one, two]), (b"zeroonetwo".to_vec(), Ok(false)));
    }

    #[test]
    fn invalid_record_length_is_refused_without_waiting() {
        for length in [0, 16 * 1024 + 1, u32::MAX] {
            assert_eq!(open(&length.to_be_bytes()), (vec![], Err(BadRecord::Length(length))));
        }
        let mut opening = Opening::new(KEY);
        opening.push(&[0; 4]);
        assert!(opening.open(&mut Vec::new()).is_err());
        opening.push(&records(&[b"zero"])[0]);
        assert!(opening.open(&mut Vec::new()).is_err(), "after a bad record there are no more");
    }

    #[test]
    fn incomplete_record_is_detected() {
        let mut opening = Opening::new(KEY);
        assert!(!opening.is_within_record());
        let sealed = &records(&[b"zero"])[0];
        for cut in 1..sealed.len() {
            opening.raw.clear();
            opening.push(&sealed[..cut]);
            assert_eq!(opening.open(&mut Vec::new()), Ok(false));
            assert!(opening.is_within_record(), "{cut} bytes");
        }
        opening.push(&sealed[sealed.len() - 1..]);
        assert_eq!(opening.open(&mut Vec::new()), Ok(true));
        assert!(!opening.is_within_record());
    }
}
