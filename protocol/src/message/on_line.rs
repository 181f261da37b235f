//! Messages with a gap for the text of a script. A mission and a robot have serialized each of their scripts to hash it, so the line of
//! JSON reuses that text.

use serde::{Serialize, Serializer};

use super::{Command, Message, Script, StatusValue};

/// Serializes like [`Serialize`], but replaces a script whose text is kept by an empty list.
pub(crate) struct OnLine<'a, T>(pub(crate) &'a T);

impl<'a> OnLine<'a, Message> {
    /// The key whose value is the empty list, and the text that replaces it; `None` without a gap.
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
