//! Decides who may send `go` and `stop` to a mission's socket if several operators share a computer. An operator presents a certificate
//! and signs the command. The operator's roles decide.
//!
//! This serves accountability, not security. A process of the mission's user, or of root, can end the mission by other means. A process
//! that presents no identity is treated as the mission's own operator, because a stop must not depend on a key.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use downbeat_robot::Role;
use downbeat_robot::tls::{Credentials, Name, Revoked, Signed, Witness};

use crate::journal::OpenedKeys;

/// Number of random bytes in a challenge.
const NONCE_BYTES: usize = 32;

/// The challenge that an operator signs together with its command. It is valid for one connection of one mission.
#[derive(Clone, Debug)]
pub struct Challenge {
    mission: String,
    nonce: String,
}

impl Challenge {
    /// Creates the challenge for a connection of this mission. If the system has no random bits, no signature is accepted.
    pub(super) fn new(mission: &str) -> Self {
        let mut bytes = [0; NONCE_BYTES];
        let nonce = match getrandom::fill(&mut bytes) {
            Ok(()) => bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
            Err(_) => String::new(),
        };
        Self { mission: mission.to_owned(), nonce }
    }

    /// Creates the challenge from the nonce that the mission sent.
    pub(super) fn of(mission: &str, nonce: &str) -> Self {
        Self { mission: mission.to_owned(), nonce: nonce.to_owned() }
    }

    pub(super) fn nonce(&self) -> &str {
        &self.nonce
    }

    /// Returns the bytes to sign. They start with a prefix that no other statement signed with an operator's key has.
    fn statement(&self, word: &str) -> Vec<u8> {
        format!("downbeat control\0{}\0{}\0{word}", self.mission, self.nonce).into_bytes()
    }
}

/// The identity that a client presents to a mission.
#[derive(Debug)]
pub struct Presented(Credentials);

impl Presented {
    /// Wraps the credentials that were read from an identity file.
    #[must_use]
    pub const fn new(credentials: Credentials) -> Self {
        Self(credentials)
    }

    /// Returns the certificate and the signature, both in Base64, as the `as` line contains them.
    pub(super) fn signed(&self, challenge: &Challenge, word: &str) -> Result<String, String> {
        let Signed { certificate, signature } = self.0.sign(&challenge.statement(word))?;
        Ok(format!("{} {}", STANDARD.encode(certificate), STANDARD.encode(signature)))
    }
}

/// Decides which commands an operator may send to a mission that has an identity.
#[derive(Debug)]
pub struct Desk {
    witness: Witness,
}

impl Desk {
    /// Creates the desk of the operator who began the mission. Returns `None` without an identity, because then no authority is known
    /// that could verify other operators.
    ///
    /// # Errors
    /// Returns the reason why the files cannot be used, as a sentence.
    pub fn of(keys: &OpenedKeys) -> Result<Option<Self>, String> {
        let Some(identity) = &keys.identity else { return Ok(None) };
        let own = Credentials::read(identity).map_err(|error| error.to_string())?;
        let revoked = keys.revoked.as_deref().map(Revoked::in_file).transpose();
        let revoked = revoked.map_err(|error| error.to_string())?;
        Ok(Some(Self { witness: Witness::new(own, revoked)? }))
    }

    /// Returns the operator who sends this command. Returns `None` for the operator who began the mission and may send any command.
    ///
    /// # Errors
    /// Returns the reason, as a sentence, if the operator may not send the command.
    pub(super) fn admits(
        &self,
        challenge: &Challenge,
        presented: &str,
        word: &str,
    ) -> Result<Option<String>, String> {
        let unreadable = || "the presented identity cannot be read".to_owned();
        let is_stop = word == "stop";
        if challenge.nonce.is_empty() && is_stop {
            return Ok(None);
        }
        if challenge.nonce.is_empty() {
            return Err(
                "this machine cannot generate a random challenge, so no identity can be verified".to_owned()
            );
        }
        let (certificate, signature) = presented.split_once(' ').ok_or_else(unreadable)?;
        let decode = |text: &str| STANDARD.decode(text).map_err(|_| unreadable());
        let signed = Signed { certificate: decode(certificate)?, signature: decode(signature)? };
        let identity = self.witness.who(&challenge.statement(word), &signed)?;
        let Name::Operator(_) = &identity.name else { return Err(unreadable()) };
        if identity.name == self.witness.identity().name {
            return Ok(None);
        }
        let (takes, role) = match word {
            "stop" => ("a stop", Role::Stop),
            "home" => ("the move to the default positions", Role::Drive),
            _ => ("a go", Role::Drive),
        };
        if !identity.roles.has(role) {
            let roles = identity.roles.in_words();
            return Err(format!("{} has {roles}, but {takes} requires the role {role}", identity.name));
        }
        Ok(Some(identity.name.to_string()))
    }
}
