//! The encoding of messages to a robot.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use urrcp::{Encoding, Message};

/// The encoding of a link to a robot. It is JSON until the robot is known to support the encoding requested in the fleet file. Clones
/// belong to the same robot and share this knowledge, so a new link to that robot need not ask again.
#[derive(Clone, Debug)]
pub struct LinkEncoding {
    wanted: Encoding,
    understood: Arc<AtomicBool>,
}

impl LinkEncoding {
    /// Uses JSON until the robot's initialization block lists the wanted encoding.
    #[must_use]
    pub fn once_listed(wanted: Encoding) -> Self {
        Self { wanted, understood: Arc::new(AtomicBool::new(false)) }
    }

    /// Uses the wanted encoding immediately, for a robot whose init file lists it.
    #[must_use]
    pub fn at_once(wanted: Encoding) -> Self {
        Self { wanted, understood: Arc::new(AtomicBool::new(true)) }
    }

    /// Returns the encoding to use for the next message.
    pub(crate) fn current(&self) -> Encoding {
        if self.understood.load(Ordering::Relaxed) { self.wanted } else { Encoding::Json }
    }

    /// Notes whether the robot's initialization block lists the wanted encoding, if `message` is that block.
    pub(super) fn hear(&self, message: &Message) {
        if let Message::InitializationBlock(block) = message {
            self.understood.store(block.understands(self.wanted), Ordering::Relaxed);
        }
    }
}

impl Default for LinkEncoding {
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
    fn only_json_is_sent_until_robot_reports_support_for_other_encodings() {
        let encoding = LinkEncoding::once_listed(Encoding::MessagePack);
        assert_eq!(encoding.current(), Encoding::Json);
        encoding.hear(&block(""));
        assert_eq!(encoding.current(), Encoding::Json);
        encoding.hear(&block(r#""encodings": ["json", "msgpack"],"#));
        assert_eq!(encoding.current(), Encoding::MessagePack);
        assert_eq!(LinkEncoding::at_once(Encoding::MessagePack).current(), Encoding::MessagePack);
    }
}
