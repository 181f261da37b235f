//! Who says `go` and `stop` at a mission's socket, where several operators share a computer: an operator presents its certificate and
//! signs what it says, and its roles decide.
//!
//! This keeps accounts; it is no wall. A process of the mission's user, or of root, can end the mission by other means, and counts as the
//! mission's own operator where it presents nothing: a stop never waits for a key.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use downbeat_robot::Role;
use downbeat_robot::tls::{Credentials, Name, Revoked, Signed, Witness};

use crate::journal::OpenedKeys;

/// Random bytes of a challenge.
const NONCE_BYTES: usize = 32;

/// What an operator signs together with its word: it counts for one connection of one mission.
#[derive(Clone, Debug)]
pub struct Challenge {
    mission: String,
    nonce: String,
}

impl Challenge {
    /// For a connection of this mission. Where the system has no random bits nothing that is signed counts.
    pub(super) fn new(mission: &str) -> Self {
        let mut bytes = [0; NONCE_BYTES];
        let nonce = match getrandom::fill(&mut bytes) {
            Ok(()) => bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
            Err(_) => String::new(),
        };
        Self { mission: mission.to_owned(), nonce }
    }

    /// As the mission has told it.
    pub(super) fn of(mission: &str, nonce: &str) -> Self {
        Self { mission: mission.to_owned(), nonce: nonce.to_owned() }
    }

    pub(super) fn nonce(&self) -> &str {
        &self.nonce
    }

    /// Nothing else that a key signs begins like this.
    fn statement(&self, word: &str) -> Vec<u8> {
        format!("downbeat control\0{}\0{}\0{word}", self.mission, self.nonce).into_bytes()
    }
}

/// The identity that a terminal presents.
#[derive(Debug)]
pub struct Presented(Credentials);

impl Presented {
    /// That of an identity file.
    #[must_use]
    pub const fn new(credentials: Credentials) -> Self {
        Self(credentials)
    }

    /// The certificate and the signature, as a line has them.
    pub(super) fn signed(&self, challenge: &Challenge, word: &str) -> Result<String, String> {
        let Signed { certificate, signature } = self.0.sign(&challenge.statement(word))?;
        Ok(format!("{} {}", STANDARD.encode(certificate), STANDARD.encode(signature)))
    }
}

/// Decides who may say what to a mission that has an identity.
#[derive(Debug)]
pub struct Desk {
    witness: Witness,
}

impl Desk {
    /// For the operator that began the mission; `None` without an identity: then there is no authority that could tell.
    ///
    /// # Errors
    /// The files cannot be used, as a sentence.
    pub fn of(keys: &OpenedKeys) -> Result<Option<Self>, String> {
        let Some(identity) = &keys.identity else { return Ok(None) };
        let own = Credentials::read(identity).map_err(|error| error.to_string())?;
        let revoked = keys.revoked.as_deref().map(Revoked::in_file).transpose();
        let revoked = revoked.map_err(|error| error.to_string())?;
        Ok(Some(Self { witness: Witness::new(own, revoked)? }))
    }

    /// Who says this word; `None`: the operator that began the mission, which may say all.
    ///
    /// # Errors
    /// Why it may not, as a sentence.
    pub(super) fn admits(
        &self,
        challenge: &Challenge,
        presented: &str,
        word: &str,
    ) -> Result<Option<String>, String> {
        let unreadable = || "what it presents cannot be read".to_owned();
        let is_stop = word == "stop";
        if challenge.nonce.is_empty() && is_stop {
            return Ok(None);
        }
        if challenge.nonce.is_empty() {
            return Err("this machine has no random bits to sign".to_owned());
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
            "home" => ("the way home", Role::Drive),
            _ => ("a go", Role::Drive),
        };
        if !identity.roles.has(role) {
            let roles = identity.roles.to_string();
            return Err(format!("{} may {roles}, and {takes} takes {role}", identity.name));
        }
        Ok(Some(identity.name.to_string()))
    }
}
