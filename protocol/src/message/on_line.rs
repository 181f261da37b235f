//! Serializes messages with a gap, into which the text of a script is inserted. Missions and robots have already serialized each script
//! to hash it, and the line of JSON reuses this text.

use serde::{Serialize, Serializer};

use super::{Command, Message, Script, StatusValue};

/// A message or script, serialized with an empty list in place of each script whose text is cached.
pub(crate) struct OnLine<'a, T>(pub(crate) &'a T);

impl<'a> OnLine<'a, Message> {
    /// Returns the key whose value is written as an empty list, and the text that replaces the list; `None` if no script text is cached.
    pub(crate) fn gap(&self) -> Option<(&'static str, &'a str)> {
        match self.0 {
            Message::ControlRequest(request) => match &request.command {
                Command::Script(script) => Some((r#""control_value":"#, script.kept_text()?)),
                _ => None,
            },
            Message::ControlResponse(response) => match &response.status_value {
                StatusValue::Script(script) => Some((r#""status_value":"#, script.kept_text()?)),
                _ => None,
            },
            _ => None,
        }
    }
}

impl Serialize for OnLine<'_, Message> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Message::ControlRequest(request) => {
                serializer.serialize_newtype_variant("Message", 4, "control_request", &OnLine(request))
            }
            Message::ControlResponse(response) => {
                serializer.serialize_newtype_variant("Message", 5, "control_response", &OnLine(response))
            }
            other => other.serialize(serializer),
        }
    }
}

impl Serialize for OnLine<'_, StatusValue> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            StatusValue::Script(script) => OnLine(script).serialize(serializer),
            other => other.serialize(serializer),
        }
    }
}

impl Serialize for OnLine<'_, Script> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.kept_text() {
            Some(_) => Script::cancel().serialize(serializer),
            None => self.0.serialize(serializer),
        }
    }
}
