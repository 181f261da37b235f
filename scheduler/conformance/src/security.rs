//! Checks of robots at `tls://` and `hmac://` addresses: how they handle peers that do not prove their identity, and messages that are
//! altered in transit.

use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use downbeat_robot::Role;
use downbeat_robot::sealed::{Held, Hello, Keys, NotSealed, Pass, Refused, proof_of_operator};
use urrcp::{AvailabilityRequest, ErrorCode, Message, Server, Span, Timestamp, encode};

use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::stream::{Stream, dial, hello, line};
use super::trial::Trial;
use downbeat_runtime::link::Security;
use downbeat_yaml::render::counted;

const SECTION: &str = "Proving who one is (D)";
/// Time within which a robot closes the connection to a peer that has not proven its identity.
const DEADLINE: Span = Span::from_millis(5_000);

pub(super) const ALL: [Requirement; 12] = [
    Requirement {
        name: "no-plain",
        number: "secure-1",
        demands: "A message from a peer that has not proven its identity is not answered, and the connection is closed.",
        section: SECTION,
        check: no_plain,
    },
    Requirement {
        name: "proven-in-time",
        number: "secure-2",
        demands: "A peer that has not proven its identity within 5 s is disconnected.",
        section: SECTION,
        check: proven_in_time,
    },
    Requirement {
        name: "altered",
        number: "secure-3",
        demands: "Bytes that were altered in transit end the connection and are not processed.",
        section: SECTION,
        check: altered,
    },
    Requirement {
        name: "repeated",
        number: "secure-4",
        demands: "A record that is repeated in transit is not processed again and ends the connection.",
        section: SECTION,
        check: repeated,
    },
    Requirement {
        name: "reordered",
        number: "secure-5",
        demands: "Records that arrive in a different order than they were sent in are not processed and end the connection.",
        section: SECTION,
        check: reordered,
    },
    Requirement {
        name: "no-certificate",
        number: "secure-6",
        demands: "With `tls`: a peer without a certificate is not answered, and the connection is closed.",
        section: SECTION,
        check: no_certificate,
    },
    Requirement {
        name: "wrong-secret",
        number: "secure-7",
        demands: "With `hmac`: an operator that does not prove that it has its pass is disconnected.",
        section: SECTION,
        check: wrong_secret,
    },
    Requirement {
        name: "expired-claim",
        number: "secure-8",
        demands: "With `hmac`: a claim that has expired is refused.",
        section: SECTION,
        check: expired_claim,
    },
    Requirement {
        name: "other-robot",
        number: "secure-9",
        demands: "With `hmac`: a claim for another robot is refused, and the refusal contains the robot's own id.",
        section: SECTION,
        check: other_robot,
    },
    Requirement {
        name: "forged-roles",
        number: "secure-10",
        demands: "With `hmac`: the robot's proof depends on the claim, so roles cannot be added to the claim.",
        section: SECTION,
        check: forged_roles,
    },
    Requirement {
        name: "repeated-connection",
        number: "secure-11",
        demands: "With `hmac`: messages recorded on an earlier connection are not accepted as proof.",
        section: SECTION,
        check: repeated_connection,
    },
    Requirement {
        name: "roles",
        number: "secure-12",
        demands: "An operator that may only observe receives answers, but its requests to move a device are refused with `forbidden`.",
        section: "Errors",
        check: roles,
    },
];

/// Whether `requirement` is one of those that this module tests.
pub(super) fn is_among(requirement: &Requirement) -> bool {
    ALL.iter().any(|own| own.name == requirement.name)
}

fn protected(trial: &Trial) -> Result<(), Unmet> {
    match trial.options().security {
        Security::Plain => {
            Err(not_applicable("the robot has a tcp:// address, so it does not check identities"))
        }
        _ => Ok(()),
    }
}

fn held(trial: &Trial) -> Result<&Held, Unmet> {
    protected(trial)?;
    match &trial.options().security {
        Security::Hmac(hmac) => hmac.pass().map_err(|error| not_applicable(error.to_string())),
        _ => Err(not_applicable("the robot has no hmac:// address")),
    }
}

fn availability() -> Message {
    Message::AvailabilityRequest(AvailabilityRequest {
        timestamp: None,
        session: None,
        seize: false,
        revocation_list: None,
    })
}

/// Opens a connection without proving an identity.
fn unproven(trial: &Trial) -> Result<TcpStream, Unmet> {
    let failed = |error: io::Error| Unmet::Failed(format!("no connection to {}: {error}", trial.address()));
    dial(trial.address(), trial.options().patience.to_duration()).map_err(failed)
}

/// Returns the bytes that arrive until the robot closes the connection; `None` if the connection is still open at `until`.
fn until_hung_up(
    trial: &Trial,
    socket: &mut TcpStream,
    until: Timestamp<Server>,
) -> Result<Option<Vec<u8>>, Unmet> {
    let (mut came, mut bytes) = (Vec::new(), [0; 4096]);
    let _unlimited_never = socket.set_read_timeout(Some(Duration::from_millis(50)));
    while trial.now() < until {
        trial.go_on()?;
        match socket.read(&mut bytes) {
            Ok(0) => return Ok(Some(came)),
            Ok(n) => came.extend_from_slice(&bytes[..n]),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_reset) => return Ok(Some(came)),
        }
    }
    Ok(None)
}

/// Returns the latest time by which the robot must close a connection that is opened now without proof of identity.
fn deadline(trial: &Trial) -> Timestamp<Server> {
    trial.now() + DEADLINE + trial.options().patience
}

fn no_plain(trial: &Trial) -> Checked {
    protected(trial)?;
    let mut socket = unproven(trial)?;
    let mut said = Vec::new();
    encode(&availability(), &mut said);
    let text = format!("{} without a proof of identity", String::from_utf8_lossy(&said).trim_end());
    let _hung_up = socket.write_all(&said);
    match until_hung_up(trial, &mut socket, deadline(trial))? {
        None => Err(differs(&text, "no disconnection", "the robot to close the connection")),
        Some(came) if came.contains(&b'{') => Err(differs(
            &text,
            &String::from_utf8_lossy(&came),
            "no answer, and the robot to close the connection",
        )),
        Some(_) => pass(),
    }
}

fn proven_in_time(trial: &Trial) -> Checked {
    protected(trial)?;
    let mut socket = unproven(trial)?;
    let begun = trial.now();
    match until_hung_up(trial, &mut socket, deadline(trial))? {
        Some(_) => Ok(format!("disconnected after {}", trial.now() - begun)),
        None => {
            let waited = format!("no disconnection within {}", trial.now() - begun);
            Err(differs("no message on a connection", &waited, "the robot to close the connection after 5 s"))
        }
    }
}

/// Checks that the robot closes the connection after at most `answers_max` responses.
fn ends(trial: &Trial, line: &mut Line<'_>, what: &str, answers_max: usize) -> Checked {
    let until = trial.patience();
    line.listen(until, |line| line.has_ended())?;
    if !line.has_ended() {
        return Err(differs(what, "no disconnection", "the robot to close the connection"));
    }
    let mut answers = 0;
    while let Some(heard) = line.other(trial.now())? {
        answers += 1;
        if answers > answers_max {
            let answers = match answers_max {
                0 => "without an answer".to_owned(),
                most => format!("after at most {}", counted(most, "answer")),
            };
            return Err(differs(what, &heard.text, &format!("the robot to close the connection {answers}")));
        }
    }
    pass()
}

fn altered(trial: &Trial) -> Checked {
    protected(trial)?;
    let mut line = trial.connect()?;
    let mut record = line.wrapped(&availability())?;
    if let Some(byte) = record.iter_mut().rev().nth(1) {
        *byte ^= 1;
    }
    line.send_past(&record)?;
    ends(trial, &mut line, "an availability request with a bit changed in transit", 0)
}

fn repeated(trial: &Trial) -> Checked {
    protected(trial)?;
    let mut line = trial.connect()?;
    let record = line.wrapped(&availability())?;
    line.send_past(&record.repeat(2))?;
    ends(trial, &mut line, "an availability request that is duplicated in transit", 1)
}

fn reordered(trial: &Trial) -> Checked {
    protected(trial)?;
    let mut line = trial.connect()?;
    let records = [line.wrapped(&availability())?, line.wrapped(&availability())?];
    line.send_past(&[records[1].as_slice(), &records[0]].concat())?;
    ends(trial, &mut line, "two availability requests that are swapped in transit", 0)
}

fn no_certificate(trial: &Trial) -> Checked {
    protected(trial)?;
    let Security::Tls(tls) = &trial.options().security else {
        return Err(not_applicable("the robot has no tls:// address"));
    };
    let mut said = Vec::new();
    encode(&availability(), &mut said);
    let text = format!("{} over TLS without a certificate", String::from_utf8_lossy(&said).trim_end());
    // With TLS 1.3, the robot may refuse the handshake after this side considers it complete, so sending the message may succeed.
    let answered = Stream::without_certificate(trial.address(), tls, trial.options().patience.to_duration())
        .and_then(|mut stream| {
            stream.write_all(&said)?;
            let mut came = [0; 4096];
            stream.read(&mut came).map(|n| String::from_utf8_lossy(&came[..n]).into_owned())
        });
    match answered {
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
            Err(differs(&text, "no disconnection", "the robot to close the connection"))
        }
        Ok(came) if !came.is_empty() => {
            Err(differs(&text, &came, "no answer, and the robot to close the connection"))
        }
        Ok(_) | Err(_) => pass(),
    }
}

/// Connects and sends the first line of the handshake. Returns the connection and the robot's answer.
fn greeted(trial: &Trial, hello: &Hello) -> Result<(TcpStream, String), Unmet> {
    let mut socket = unproven(trial)?;
    let said = hello.line();
    let answer = socket.write_all(said.as_bytes()).and_then(|()| line(&mut socket));
    let answer = answer.map_err(|error| {
        differs(said.trim_end(), &format!("no line ({error})"), "the robot's line of the handshake")
    })?;
    Ok((socket, answer))
}

fn fresh(held: &Held) -> Result<Hello, Unmet> {
    hello(held).map_err(|error| not_applicable(error.to_string()))
}

fn refused(trial: &Trial, hello: &Hello, expected: &Refused) -> Checked {
    let (mut socket, answer) = greeted(trial, hello)?;
    let (said, expected) = (hello.line(), expected.line());
    if answer != expected {
        return Err(differs(said.trim_end(), answer.trim_end(), expected.trim_end()));
    }
    match until_hung_up(trial, &mut socket, deadline(trial))? {
        Some(_) => pass(),
        None => {
            Err(differs(said.trim_end(), answer.trim_end(), "the robot to close the connection after that"))
        }
    }
}

fn wrong_secret(trial: &Trial) -> Checked {
    let held = held(trial)?;
    let hello = fresh(held)?;
    let (mut socket, answer) = greeted(trial, &hello)?;
    let forged = proof_of_operator(&Pass::of_bytes([0; 32]), &hello.line(), &answer);
    let _hung_up = socket.write_all(forged.as_bytes());
    match until_hung_up(trial, &mut socket, deadline(trial))? {
        Some(came) if came.is_empty() => pass(),
        Some(came) => Err(differs(
            "an invalid proof for a valid claim",
            &String::from_utf8_lossy(&came),
            "the robot to close the connection without an answer",
        )),
        None => {
            Err(differs("an invalid proof for a valid claim", "no end", "the robot to close the connection"))
        }
    }
}

fn expired_claim(trial: &Trial) -> Checked {
    let mut hello = fresh(held(trial)?)?;
    hello.claim.expires = 1;
    refused(trial, &hello, &Refused::Expired)
}

fn other_robot(trial: &Trial) -> Checked {
    let mut hello = fresh(held(trial)?)?;
    let own = hello.robot.clone();
    let another = format!("not {own}").chars().take(200).collect::<String>();
    hello.robot = another.parse().map_err(|_| not_applicable("no other robot id could be formed"))?;
    refused(trial, &hello, &Refused::OtherRobot(own))
}

fn forged_roles(trial: &Trial) -> Checked {
    let held = held(trial)?;
    let mut hello = fresh(held)?;
    let all: downbeat_robot::Roles = Role::ALL.into_iter().collect();
    hello.claim.roles = if hello.claim.roles == all { [Role::Observe].into_iter().collect() } else { all };
    let (_, answer) = greeted(trial, &hello)?;
    match hello.check_answer(&held.pass, &answer) {
        Err(NotSealed::OtherSecret) => pass(),
        Err(other) => {
            Err(differs(hello.line().trim_end(), &other.to_string(), "a line with the robot's proof"))
        }
        Ok(()) => Err(differs(
            hello.line().trim_end(),
            answer.trim_end(),
            "a proof that differs from that for the original roles",
        )),
    }
}

fn repeated_connection(trial: &Trial) -> Checked {
    let held = held(trial)?;
    let hello = fresh(held)?;
    let said = hello.line();
    let (mut socket, answer) = greeted(trial, &hello)?;
    hello.check_answer(&held.pass, &answer).map_err(|why| Unmet::Failed(why.to_string()))?;
    let proof = proof_of_operator(&held.pass, &said, &answer);
    let (mut sealing, _) = Keys::of(&held.pass, &said, &answer).of_operator();
    let (mut message, mut record) = (Vec::new(), proof.into_bytes());
    encode(&availability(), &mut message);
    sealing.seal(&message, &mut record);
    let _hung_up = socket.write_all(&record);
    let mut first = [0];
    if socket.read(&mut first).is_err() {
        return Err(differs("an availability request after the handshake", "nothing", "an answer"));
    }
    let (mut again, second) = greeted(trial, &hello)?;
    if second == answer {
        return Err(differs(
            said.trim_end(),
            second.trim_end(),
            "a different random number than on the previous connection",
        ));
    }
    let _hung_up = again.write_all(&record);
    match until_hung_up(trial, &mut again, deadline(trial))? {
        Some(came) if came.is_empty() => pass(),
        Some(_) => Err(differs(
            "all messages of an earlier connection again",
            "an answer",
            "the robot to close the connection",
        )),
        None => Err(differs(
            "all messages of an earlier connection again",
            "no end",
            "the robot to close the connection",
        )),
    }
}

fn roles(trial: &Trial) -> Checked {
    protected(trial)?;
    let Some(observer) = &trial.options().observer else {
        return Err(not_applicable(
            "no second operator is known: name the identity file of one that may only observe with `--observer`",
        ));
    };
    let mut line = trial.connect_as(observer)?;
    line.availability()?;
    let actor = trial.actor()?;
    line.refuses(&trial.set(actor, actor.rest), ErrorCode::Forbidden)?;
    line.refuses(&trial.cancel(actor), ErrorCode::Forbidden)?;
    line.survives("forbidden requests")?;
    pass()
}
