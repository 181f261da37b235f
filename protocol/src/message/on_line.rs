//! Messages as they stand on a line of JSON. The text is the same as by [`Serialize`], but a script is not written step by
//! step where its text is kept: a mission writes each of its scripts when it hashes them, and so does a robot.

use serde::{Serialize, Serializer};

use super::{Command, Message, Script, StatusValue};

/// For serde_json alone: no other format knows what a [`serde_json::value::RawValue`] is.
pub(crate) struct OnLine<'a, T>(pub(crate) &'a T);

impl OnLine<'_, Message> {
    /// About how many bytes the line has, or fewer.
    pub(crate) fn length(&self) -> usize {
        const WITHOUT_SCRIPT: usize = 512;
        let script = match self.0 {
            Message::ControlRequest(request) => match &request.command {
                Command::Script(script) => script.kept_text(),
                _ => None,
            },
            Message::ControlResponse(response) => match &response.status_value {
                StatusValue::Script(script) => script.kept_text(),
                _ => None,
            },
            _ => None,
        };
        script.map_or(0, |text| WITHOUT_SCRIPT + text.get().len())
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
            Some(text) => text.serialize(serializer),
            None => self.0.serialize(serializer),
        }
    }
}
