//! A robot's encoded description. It is encoded once, and shared by all connections.

use std::sync::{Arc, Mutex, PoisonError};

use urrcp::{Encoding, InitializationBlock, Message, encode_as};

/// Number of devices above which a description is encoded on another thread.
const DEVICES_AT_ONCE: usize = 256;

/// The most recently encoded description, one for each encoding.
#[derive(Debug, Default)]
pub(super) struct Described(Mutex<Vec<Written>>);

#[derive(Clone, Debug)]
struct Written {
    block: InitializationBlock,
    encoding: Encoding,
    bytes: Arc<[u8]>,
}

impl Described {
    /// Returns the encoded form of this description.
    pub(super) async fn bytes(&self, block: InitializationBlock, encoding: Encoding) -> Arc<[u8]> {
        if let Some(bytes) = self.find(&block, encoding) {
            return bytes;
        }
        let written = if block.devices.len() <= DEVICES_AT_ONCE {
            write(block, encoding)
        } else {
            let copy = block.clone();
            // The call fails only if the runtime ends; speed then no longer matters.
            let written = tokio::task::spawn_blocking(move || write(copy, encoding)).await;
            written.unwrap_or_else(|_| write(block, encoding))
        };
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|other| other.encoding != encoding);
        all.push(written.clone());
        written.bytes
    }

    /// Returns the approximate length of the encoded description in bytes, or 0 if no description has been encoded yet.
    pub(super) fn length(&self) -> usize {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.iter().map(|written| written.bytes.len()).max().unwrap_or(0)
    }

    fn find(&self, block: &InitializationBlock, encoding: Encoding) -> Option<Arc<[u8]>> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = all.iter().find(|written| written.encoding == encoding && written.block == *block);
        found.map(|written| Arc::clone(&written.bytes))
    }
}

fn write(block: InitializationBlock, encoding: Encoding) -> Written {
    let mut bytes = Vec::new();
    encode_as(encoding, &Message::InitializationBlock(block.clone()), &mut bytes);
    Written { block, encoding, bytes: bytes.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(id: &str, devices: usize) -> InitializationBlock {
        let devices: Vec<_> =
            (0..devices).map(|i| format!(r#"{{"id":"d{i}","available_control_types":{{}}}}"#)).collect();
        let block = format!(r#"{{"id":"{id}","api_version":"1","devices":[{}]}}"#, devices.join(","));
        serde_json::from_str(&block).unwrap()
    }

    fn expected(block: &InitializationBlock, encoding: Encoding) -> Vec<u8> {
        let mut bytes = Vec::new();
        encode_as(encoding, &Message::InitializationBlock(block.clone()), &mut bytes);
        bytes
    }

    #[tokio::test]
    async fn robot_describes_itself_in_each_requested_encoding() {
        let described = Described::default();
        assert_eq!(described.length(), 0);
        // The long description is encoded on another thread.
        for (first, second) in [(block("r", 1), block("s", 1)), (block("r", 300), block("s", 300))] {
            for block in [&first, &second, &second, &first] {
                for encoding in [Encoding::Json, Encoding::MessagePack, Encoding::Json] {
                    let bytes = described.bytes(block.clone(), encoding).await;
                    assert_eq!(*bytes, *expected(block, encoding));
                }
            }
            assert_eq!(described.length(), expected(&first, Encoding::Json).len(), "of the longer encoding");
        }
    }

    #[tokio::test]
    async fn description_is_encoded_once_and_shared() {
        let described = Described::default();
        let json = described.bytes(block("r", 3), Encoding::Json).await;
        let packed = described.bytes(block("r", 3), Encoding::MessagePack).await;
        assert!(Arc::ptr_eq(&json, &described.bytes(block("r", 3), Encoding::Json).await));
        assert!(Arc::ptr_eq(&packed, &described.bytes(block("r", 3), Encoding::MessagePack).await));
    }
}
