//! The session for which robots are driven: a name for users, and a key that only the robots and the journal know.
//!
//! A robot obeys any party that names its session. On the wire, a session is therefore `NAME/KEY`, and the key is 128 random bits. Users
//! only see the name: in reports, on the display, in mission folders, in request ids. The first line of the journal contains the key, so
//! that the commands `resume` and `stop` can use it.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, de};
use urrcp::{ControlError, LimitError, Message, SessionId};

/// Number of random bytes in a key.
const KEY_BYTES: usize = 16;
/// Number of hexadecimal digits in a key.
const KEY_DIGITS: usize = 2 * KEY_BYTES;
/// The separator between the name and the key.
const SEPARATOR: char = '/';

/// The secret part of a session: 32 hexadecimal digits. `Debug` does not show it.
#[derive(Clone, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct SessionKey(String);

/// One run of a scheduler, with its name for users and its id for robots.
#[derive(Clone, PartialEq, Eq)]
pub struct Session {
    name: SessionId,
    on_the_wire: SessionId,
}

/// Error: the operating system provides no random bits.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("cannot get random bits for the key of the session: {0}")]
pub struct NoRandomBits(getrandom::Error);

impl SessionKey {
    /// A key that cannot be guessed, from the random bits of the operating system.
    ///
    /// # Errors
    /// [`NoRandomBits`] if the system has none.
    pub fn random() -> Result<Self, NoRandomBits> {
        let mut bytes = [0; KEY_BYTES];
        getrandom::fill(&mut bytes).map_err(NoRandomBits)?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }
}

impl fmt::Debug for SessionKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SessionKey(..)")
    }
}

impl<'de> Deserialize<'de> for SessionKey {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let digits = String::deserialize(deserializer)?;
        if is_key(&digits) {
            Ok(Self(digits))
        } else {
            Err(de::Error::custom(format!(
                "invalid key of a session, expected {KEY_DIGITS} hexadecimal digits"
            )))
        }
    }
}

impl Session {
    /// A session that robots know only by its name, for simulations. Anyone who knows the name can drive these robots.
    #[must_use]
    pub fn named(name: SessionId) -> Self {
        Self { on_the_wire: name.clone(), name }
    }

    /// A session whose key the robots know as well.
    ///
    /// # Errors
    /// [`LimitError`] if the name leaves no room for the key. The name has at most 223 characters.
    pub fn with_key(name: SessionId, key: &SessionKey) -> Result<Self, LimitError> {
        let on_the_wire = SessionId::new(format!("{name}{SEPARATOR}{}", key.0))?;
        Ok(Self { name, on_the_wire })
    }

    /// The name for users.
    #[must_use]
    pub const fn name(&self) -> &SessionId {
        &self.name
    }

    /// The session as sent to robots, with its key. It must not be displayed.
    #[must_use]
    pub const fn on_the_wire(&self) -> &SessionId {
        &self.on_the_wire
    }
}

impl From<SessionId> for Session {
    fn from(name: SessionId) -> Self {
        Self::named(name)
    }
}

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Session").field(&self.name).finish()
    }
}

/// The part of a session that may be displayed: the session without its key, if it has one.
#[must_use]
pub fn name_of(on_the_wire: &SessionId) -> &str {
    let text = on_the_wire.as_str();
    match text.rsplit_once(SEPARATOR) {
        Some((name, key)) if is_key(key) && !name.is_empty() => name,
        _ => text,
    }
}

/// The message without the key of its session, so that it may be stored where users read it.
#[must_use]
pub fn without_key(mut message: Message) -> Message {
    let session = match &mut message {
        Message::AvailabilityRequest(request) => &mut request.session,
        Message::Inquiry(inquiry) => &mut inquiry.session,
        Message::ControlRequest(request) => &mut request.session,
        _ => return message,
    };
    if let Some(on_the_wire) = session {
        let name = name_of(on_the_wire);
        if name.len() < on_the_wire.as_str().len() {
            *session = SessionId::new(name).ok();
        }
    }
    message
}

/// A robot's message without session keys, so that it may be displayed. A robot that names the session to which it belongs also names the
/// key.
#[must_use]
pub fn told_without_keys(mut message: Message) -> Message {
    match &mut message {
        Message::AvailabilityResponse(response) => hide_keys(response.error.as_mut()),
        Message::ControlResponse(response) => hide_keys(response.error.as_mut()),
        Message::InquiryResponse(response) => {
            let of_requests = response.requests.iter_mut().map(|report| report.error.as_mut());
            of_requests.for_each(hide_keys);
            hide_keys(response.error.as_mut());
        }
        _ => {}
    }
    message
}

/// Removes text that looks like a session key from an error message.
fn hide_keys(error: Option<&mut ControlError>) {
    let Some(error) = error.filter(|error| error.message.contains(SEPARATOR)) else { return };
    let mut parts = error.message.split(SEPARATOR);
    let mut shown = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        shown.push(SEPARATOR);
        let digits = part.bytes().take_while(|byte| is_digit(*byte)).count();
        // A long text is truncated, possibly within the key.
        if digits == KEY_DIGITS || digits > 0 && part[digits..] == *"…" {
            shown.push('…')
        } else {
            shown.push_str(&part[..digits])
        }
        shown.push_str(&part[digits..]);
    }
    error.message = shown;
}

const fn is_digit(byte: u8) -> bool {
    matches!(byte, b'0'..=b'9' | b'a'..=b'f')
}

fn is_key(text: &str) -> bool {
    text.len() == KEY_DIGITS && text.bytes().all(is_digit)
}

#[cfg(test)]
mod tests {
    use urrcp::{AvailabilityRequest, ErrorCode, Inquiry};

    use super::*;

    fn name() -> SessionId {
        SessionId::new("show@host-1").unwrap()
    }

    #[test]
    fn session_sent_to_robots_has_128_random_bits_that_are_never_shown() {
        let (one, other) = (SessionKey::random().unwrap(), SessionKey::random().unwrap());
        assert_ne!(one, other);
        let session = Session::with_key(name(), &one).unwrap();
        let wire = session.on_the_wire().as_str();
        let (before, key) = wire.split_once('/').unwrap();
        assert_eq!((before, key.len(), is_key(key)), ("show@host-1", 32, true));
        assert_eq!(session.name(), &name());
        assert!(!format!("{session:?} {one:?}").contains(key));
        assert_eq!(name_of(session.on_the_wire()), "show@host-1");
    }

    #[test]
    fn key_is_stored_as_its_digits_and_anything_else_is_rejected() {
        let key = SessionKey::random().unwrap();
        let kept = serde_json::to_string(&key).unwrap();
        assert_eq!(serde_json::from_str::<SessionKey>(&kept).unwrap(), key);
        for wrong in ["\"\"", "\"0123\"", "\"0123456789ABCDEF0123456789ABCDEF\"", "7"] {
            assert!(serde_json::from_str::<SessionKey>(wrong).is_err(), "{wrong}");
        }
        assert_eq!(name_of(&SessionId::new("a/b").unwrap()), "a/b");
    }

    #[test]
    fn messages_are_stored_without_the_key() {
        let key = SessionKey::random().unwrap();
        let session = Session::with_key(name(), &key).unwrap().on_the_wire().clone();
        let asked = AvailabilityRequest {
            timestamp: None,
            session: Some(session.clone()),
            seize: false,
            revocation_list: None,
        };
        let inquiry = Inquiry { session: Some(session), ..Inquiry::default() };
        for message in [Message::AvailabilityRequest(asked), Message::Inquiry(inquiry)] {
            let kept = serde_json::to_string(&without_key(message)).unwrap();
            assert!(kept.contains(r#""session":"show@host-1""#) && !kept.contains(&key.0), "{kept}");
        }
    }

    #[test]
    fn key_reported_by_a_robot_is_not_shown() {
        let key = "0123456789abcdef".repeat(2);
        for (told, shown) in [
            (format!("belongs to session `a@b/{key}`"), "belongs to session `a@b/…`".to_owned()),
            (format!("a/{key}, b/{key}"), "a/…, b/…".to_owned()),
            (format!("a/{key}0"), format!("a/{key}0")),
            ("no such file: /dev/ttyé0".to_owned(), "no such file: /dev/ttyé0".to_owned()),
        ] {
            let mut error = ControlError::new(ErrorCode::Busy, told);
            hide_keys(Some(&mut error));
            assert_eq!(error.message, shown);
        }
    }

    #[test]
    fn name_without_room_for_a_key_is_refused() {
        let key = SessionKey::random().unwrap();
        let of = |chars: usize| Session::with_key(SessionId::new("x".repeat(chars)).unwrap(), &key);
        assert!(of(223).is_ok() && of(224).is_err());
    }
}
