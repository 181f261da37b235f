//! A robot's description as it goes over the wire: written once, and shared by all connections.

use std::sync::{Arc, Mutex, PoisonError};

use urrcp::{Encoding, InitializationBlock, Message, encode_as};

/// A description with more devices is written on a thread of its own.
const DEVICES_AT_ONCE: usize = 256;

/// The last description in each encoding.
#[derive(Debug, Default)]
pub(super) struct Described(Mutex<Vec<Written>>);

#[derive(Clone, Debug)]
struct Written {
    block: InitializationBlock,
    encoding: Encoding,
    bytes: Arc<[u8]>,
}

impl Described {
    /// The bytes of this description.
    pub(super) async fn bytes(&self, block: InitializationBlock, encoding: Encoding) -> Arc<[u8]> {
        if let Some(bytes) = self.find(&block, encoding) {
            return bytes;
        }
        let written = match block.devices.len() > DEVICES_AT_ONCE {
            false => write(block, encoding),
            true => {
                let copy = block.clone();
                // It fails where the runtime ends: then nothing is left to be quick for.
                let written = tokio::task::spawn_blocking(move || write(copy, encoding)).await;
                written.unwrap_or_else(|_| write(block, encoding))
            }
        };
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|other| other.encoding != encoding);
        all.push(written.clone());
        written.bytes
    }

    /// About how long a description is.
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
