//! The handshake: the first three lines of a connection. Each side must answer the other side's new random number, so that messages from
//! an earlier connection prove nothing.

use hmac::Mac;
use urrcp::RobotId;

use super::claim::{Claim, encoded, robot_id};
use super::hex;
use super::record::{Opening, Sealing};
use super::secret::{Pass, code};

/// Prefix of all lines of the handshake except the last.
const VERSION: &str = "URRCP-HMAC 1 ";
/// Maximum length of a line of the handshake in bytes, including the newline. A robot's id and an operator's name have at most 256
/// characters each, and each character takes up to twelve bytes when encoded.
pub(super) const LINE_BYTES_MAX: usize = 8 * 1024;
/// Size of each side's random number, in bytes.
pub const NONCE_BYTES: usize = 16;
/// A random number that one side uses for one connection.
pub type Nonce = [u8; NONCE_BYTES];

/// Returns a new random number.
///
/// # Errors
/// The system provides no random bytes.
pub fn fresh_nonce() -> std::io::Result<Nonce> {
    let mut nonce = [0; NONCE_BYTES];
    getrandom::fill(&mut nonce).map_err(std::io::Error::other)?;
    Ok(nonce)
}

/// Reason why a robot refuses a claim.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The robot's clock is not set, so the robot cannot detect that a claim has expired.
    Clock,
    /// The claim has expired.
    Expired,
    /// The claim was revoked.
    Revoked,
    /// The operator wants to reach another robot. Contains the id of the robot that refuses.
    OtherRobot(RobotId),
    /// The claim cannot be parsed.
    Unreadable,
}

impl Refused {
    /// Returns the line of the handshake in which the robot reports this refusal.
    #[must_use]
    pub fn line(&self) -> String {
        let why = match self {
            Self::Clock => "clock".to_owned(),
            Self::Expired => "expired".to_owned(),
            Self::Revoked => "revoked".to_owned(),
            Self::OtherRobot(own) => format!("robot {}", encoded(own.as_str())),
            Self::Unreadable => "claim".to_owned(),
        };
        format!("{VERSION}refused {why}\n")
    }

    fn parse(why: &str) -> Option<Self> {
        match why.split_once(' ') {
            None if why == "clock" => Some(Self::Clock),
            None if why == "expired" => Some(Self::Expired),
            None if why == "revoked" => Some(Self::Revoked),
            None if why == "claim" => Some(Self::Unreadable),
            Some(("robot", own)) => Some(Self::OtherRobot(robot_id(own)?)),
            _ => None,
        }
    }
}

/// Reason why a sealed connection could not be established.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotSealed {
    /// The received line does not belong to this handshake.
    #[error("the program at this address does not use hmac")]
    NotSpoken,
    /// The robot refuses the operator's claim.
    #[error("{}", sentence(.0))]
    Refused(Refused),
    /// The robot's proof does not match the pass: the robot has a different secret, or none.
    #[error(
        "the robot does not have the secret that matches your pass: copy the robot's secret file to it, or use the latest passes that `downbeat keys` wrote"
    )]
    OtherSecret,
    /// The operator has not proven its claim.
    #[error("the peer did not prove its identity")]
    NotProven,
}

fn sentence(refused: &Refused) -> String {
    match refused {
        Refused::Clock => "the robot's clock is not set: it shows a time before its secret was made; wait until NTP has set it".to_owned(),
        Refused::Expired => "your pass has expired: make a new one with `downbeat keys renew`".to_owned(),
        Refused::Revoked => "your pass has been revoked".to_owned(),
        Refused::OtherRobot(own) => format!("it is robot {own}, but your pass is for a different robot"),
        Refused::Unreadable => "the robot cannot read the claim in your pass".to_owned(),
    }
}

/// The operator's first line of the handshake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Random number of the operator.
    pub nonce: Nonce,
    /// Id of the robot that the operator wants to reach.
    pub robot: RobotId,
    /// Claim that the operator wants to prove.
    pub claim: Claim,
}

impl Hello {
    /// Returns the line as it is sent, including the newline.
    #[must_use]
    pub fn line(&self) -> String {
        let Self { nonce, robot, claim } = self;
        format!("{VERSION}{} {} {claim}\n", hex::hex(nonce), encoded(robot.as_str()))
    }

    /// Parses the line, including the newline.
    ///
    /// # Errors
    /// [`NotSealed::NotSpoken`] for a line of another protocol, and [`Refused::Unreadable`] for a line without a valid claim.
    pub fn read(line: &str) -> Result<Self, NotSealed> {
        let rest = line.strip_prefix(VERSION).and_then(|rest| rest.strip_suffix('\n'));
        let rest = rest.ok_or(NotSealed::NotSpoken)?;
        let mut words = rest.splitn(3, ' ');
        let mut word = || words.next().ok_or(NotSealed::Refused(Refused::Unreadable));
        let (nonce, robot, claim) = (word()?, word()?, word()?);
        let read = || {
            let claim = claim.parse().ok()?;
            Some(Self { nonce: hex::bytes(nonce)?, robot: robot_id(robot)?, claim })
        };
        read().ok_or(NotSealed::Refused(Refused::Unreadable))
    }

    /// Returns the robot's answer to this line. The answer proves that the robot knows the secret.
    #[must_use]
    pub fn answer(&self, pass: &Pass, nonce: &Nonce) -> String {
        let begun = format!("{VERSION}{}", hex::hex(nonce));
        let proof = code(&pass.0, &[b"robot\n", self.line().as_bytes(), begun.as_bytes()]);
        format!("{begun} {}\n", hex::hex(&proof.finalize().into_bytes()))
    }

    /// Checks the robot's answer to this line.
    ///
    /// # Errors
    /// [`NotSealed`] if the answer is invalid, or if the robot refuses the claim.
    pub fn check_answer(&self, pass: &Pass, answer: &str) -> Result<(), NotSealed> {
        let rest = answer.strip_prefix(VERSION).and_then(|rest| rest.strip_suffix('\n'));
        let rest = rest.ok_or(NotSealed::NotSpoken)?;
        if let Some(why) = rest.strip_prefix("refused ") {
            return Err(Refused::parse(why).map_or(NotSealed::NotSpoken, NotSealed::Refused));
        }
        let (nonce, proof) = rest.split_once(' ').ok_or(NotSealed::NotSpoken)?;
        hex::bytes::<NONCE_BYTES>(nonce).ok_or(NotSealed::NotSpoken)?;
        let proof = hex::bytes::<32>(proof).ok_or(NotSealed::NotSpoken)?;
        let begun = format!("{VERSION}{nonce}");
        let expected = code(&pass.0, &[b"robot\n", self.line().as_bytes(), begun.as_bytes()]);
        expected.verify(&proof.into()).map_err(|_| NotSealed::OtherSecret)
    }
}

fn operators_code(pass: &Pass, hello: &str, answer: &str) -> hmac::Hmac<sha2::Sha256> {
    code(&pass.0, &[b"operator\n", hello.as_bytes(), answer.as_bytes()])
}

/// Returns the operator's second line of the handshake, which proves that the operator has the pass. `hello` and `answer` are the first
/// two lines, including their newlines.
#[must_use]
pub fn proof_of_operator(pass: &Pass, hello: &str, answer: &str) -> String {
    format!("{}\n", hex::hex(&operators_code(pass, hello, answer).finalize().into_bytes()))
}

/// Checks the operator's second line of the handshake, which must prove that the operator has the pass.
pub(super) fn check_operator(pass: &Pass, hello: &str, answer: &str, proof: &str) -> Result<(), NotSealed> {
    let proof = proof.strip_suffix('\n').and_then(hex::bytes::<32>).ok_or(NotSealed::NotProven)?;
    operators_code(pass, hello, answer).verify(&proof.into()).map_err(|_| NotSealed::NotProven)
}

/// The keys of a connection, one for each direction. They are derived from the whole handshake, so that no two connections have the same
/// key.
#[derive(Clone)]
pub struct Keys {
    to_robot: [u8; 32],
    to_operator: [u8; 32],
}

impl Keys {
    /// Derives the keys from the pass and the first two lines of the handshake, including their newlines.
    #[must_use]
    pub fn of(pass: &Pass, hello: &str, answer: &str) -> Self {
        let of = |direction: &[u8]| {
            code(&pass.0, &[direction, hello.as_bytes(), answer.as_bytes()]).finalize().into_bytes().into()
        };
        Self { to_robot: of(b"to robot\n"), to_operator: of(b"to operator\n") }
    }

    /// Returns the operator's two ends of the connection: one seals records to the robot, the other opens records from the robot.
    #[must_use]
    pub const fn of_operator(&self) -> (Sealing, Opening) {
        (Sealing::new(self.to_robot), Opening::new(self.to_operator))
    }

    /// Returns the robot's two ends of the connection: one seals records to the operator, the other opens records from the operator.
    #[must_use]
    pub const fn of_robot(&self) -> (Sealing, Opening) {
        (Sealing::new(self.to_operator), Opening::new(self.to_robot))
    }
}

impl std::fmt::Debug for Keys {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Keys")
    }
}
