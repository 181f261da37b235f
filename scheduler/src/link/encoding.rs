//! In which encoding a robot is written to.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use urrcp::{Encoding, Message};

/// The encoding that the fleet file asks for, from when on the robot is known to understand it; JSON until then. Clones
/// are of one robot and learn together, so that a link that is made again need not ask again.
#[derive(Clone, Debug)]
pub struct Speech {
    wanted: Encoding,
    understood: Arc<AtomicBool>,
}

impl Speech {
    /// To a robot that is asked for its initialization block before it is trusted with anything but JSON.
    #[must_use]
    pub fn once_listed(wanted: Encoding) -> Self {
        Self { wanted, understood: Arc::new(AtomicBool::new(false)) }
    }

    /// To a robot of which the files say what it understands.
    #[must_use]
    pub fn at_once(wanted: Encoding) -> Self {
        Self { wanted, understood: Arc::new(AtomicBool::new(true)) }
    }

    /// What the next message is written in.
    pub(crate) fn encoding(&self) -> Encoding {
        match self.understood.load(Ordering::Relaxed) {
            true => self.wanted,
            false => Encoding::Json,
        }
    }

    /// Takes note of what the robot says of itself.
    pub(super) fn hear(&self, message: &Message) {
        if let Message::InitializationBlock(block) = message {
            self.understood.store(block.understands(self.wanted), Ordering::Relaxed);
        }
    }
}

impl Default for Speech {
    fn default() -> Self {
        Self::at_once(Encoding::Json)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(understands: &str) -> Message {
        let device = r#"{"id": "a", "name": "a", "available_control_types": {}}"#;
        let json = format!(
            r#"{{"initialization_block": {{"id": "r", "api_version": "1", {understands} "devices": [{device}]}}}}"#
        );
        serde_json::from_str(&json).unwrap()
    }

    #[test]
    fn nothing_but_json_is_written_before_a_robot_has_said_that_it_understands_more() {
        let speech = Speech::once_listed(Encoding::MessagePack);
        assert_eq!(speech.encoding(), Encoding::Json);
        speech.hear(&block(""));
        assert_eq!(speech.encoding(), Encoding::Json);
        speech.hear(&block(r#""encodings": ["json", "msgpack"],"#));
        assert_eq!(speech.encoding(), Encoding::MessagePack);
        assert_eq!(Speech::at_once(Encoding::MessagePack).encoding(), Encoding::MessagePack);
    }
}
