//! Tests both ends of a connection in one process, and attacks on the connection.

use proptest::prelude::*;
use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};

use super::*;
use crate::handshake::NotSealed;
use crate::passes::Held;
use crate::{Claim, Keys, connect};
use urrcp::{Role, Roles};

const LATER: i64 = 4_000_000_000;

fn claim(roles: &[Role]) -> Claim {
    let roles: Roles = roles.iter().copied().collect();
    Claim { name: "anna".into(), roles, expires: LATER, serial: "0a:1b".into() }
}

fn held(secret: &Secret, robot: &str, claim: Claim) -> Held {
    Held { robot: robot.parse().unwrap(), pass: secret.pass(&claim), claim }
}

fn guard(secret: &Secret) -> Guard {
    Guard::new("cf 1/ö".parse().unwrap(), secret.clone(), None).unwrap()
}

/// Connects an operator to a robot. Returns the operator that the robot has admitted, or the robot's error; then the operator's result.
fn meet(guard: &Guard, held: &Held) -> (Result<Claim, String>, Result<(), String>) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (near, far) = duplex(64 * 1024);
        let accepted = async {
            let (mut stream, claim) = guard.accept(far).await.map_err(|error| error.to_string())?;
            let mut word = [0; 8];
            stream.read_exact(&mut word).await.map_err(|error| error.to_string())?;
            assert_eq!(&word, b"operator");
            stream.write_all(b"robot").await.unwrap();
            stream.flush().await.unwrap();
            Ok(claim)
        };
        let connected = async {
            let mut stream = connect(near, held).await.map_err(|error| error.to_string())?;
            stream.write_all(b"operator").await.map_err(|error| error.to_string())?;
            stream.flush().await.unwrap();
            let mut word = [0; 5];
            stream.read_exact(&mut word).await.map_err(|error| error.to_string())?;
            assert_eq!(&word, b"robot");
            Ok(())
        };
        tokio::join!(accepted, connected)
    })
}

#[test]
fn robot_and_operator_with_the_same_secret_authenticate_each_other() {
    let secret = Secret::generate().unwrap();
    let (proof, connected) =
        meet(&guard(&secret), &held(&secret, "cf 1/ö", claim(&[Role::Stop, Role::Observe])));
    let proof = proof.unwrap();
    assert_eq!((proof.name.as_str(), proof.roles.to_string()), ("anna", "observe, stop".to_owned()));
    connected.unwrap();
}

#[track_caller]
fn refused(guard: &Guard, held: &Held, why: &NotSealed) {
    let (robots, operators) = meet(guard, held);
    assert!(robots.is_err());
    assert_eq!(operators, Err(why.to_string()));
}

#[test]
fn peer_without_proof_of_a_valid_pass_is_refused() {
    let (secret, other) = (Secret::generate().unwrap(), Secret::generate().unwrap());
    let guard = guard(&secret);
    let right = held(&secret, "cf 1/ö", claim(&[Role::Drive]));
    refused(&guard, &held(&other, "cf 1/ö", claim(&[Role::Drive])), &NotSealed::OtherSecret);
    let own = "cf 1/ö".parse().unwrap();
    let of_another = held(&secret, "cf2", claim(&[Role::Drive]));
    refused(&guard, &of_another, &NotSealed::Refused(Refused::OtherRobot(own)));
    let expired = Claim { expires: 1_700_000_000, ..claim(&[Role::Drive]) };
    refused(&guard, &held(&secret, "cf 1/ö", expired), &NotSealed::Refused(Refused::Expired));
    // The claim was extended beyond the claim that its pass proves.
    let more = Held { claim: claim(&[Role::Drive, Role::Stop]), ..right.clone() };
    refused(&guard, &more, &NotSealed::OtherSecret);
    let longer = Held { claim: Claim { expires: LATER + 1, ..claim(&[Role::Drive]) }, ..right.clone() };
    refused(&guard, &longer, &NotSealed::OtherSecret);
    assert!(meet(&guard, &right).0.is_ok());
}

#[test]
fn revoked_pass_is_refused_at_once_and_despite_a_damaged_list() {
    let folder = std::env::temp_dir().join(format!("downbeat-sealed-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("revoked.serials");
    std::fs::write(&path, "# none\n# end\n").unwrap();
    let secret = Secret::generate().unwrap();
    let list = RevokedSerials::in_file(&path).unwrap();
    let guard = Guard::new("cf1".parse().unwrap(), secret.clone(), Some(&list)).unwrap();
    let anna = held(&secret, "cf1", claim(&[Role::Drive]));
    assert!(meet(&guard, &anna).0.is_ok());
    std::fs::write(&path, "# one\n0a:1b\n# end\n").unwrap();
    refused(&guard, &anna, &NotSealed::Refused(Refused::Revoked));
    for damaged in ["not a list\n# end\n", "# one\n", "# one\n0a:", "-----BEGIN X509 CRL-----\n"] {
        std::fs::write(&path, damaged).unwrap();
        refused(&guard, &anna, &NotSealed::Refused(Refused::Revoked));
        assert!(RevokedSerials::in_file(&path).is_err());
    }
    std::fs::remove_dir_all(&folder).unwrap();
    refused(&guard, &anna, &NotSealed::Refused(Refused::Revoked));
}

#[test]
fn replayed_connection_is_refused_as_unproven() {
    let secret = Secret::generate().unwrap();
    let guard = guard(&secret);
    let anna = held(&secret, "cf 1/ö", claim(&[Role::Drive]));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let recorded = runtime.block_on(async {
        let (near, mut between) = duplex(64 * 1024);
        let (mut further, far) = duplex(64 * 1024);
        let accepted = guard.accept(far);
        let connected = async {
            let mut stream = connect(near, &anna).await.unwrap();
            stream.write_all(b"move\n").await.unwrap();
            stream.flush().await.unwrap();
            stream
        };
        let passed_on = async {
            let (mut recorded, mut bytes) = (Vec::new(), [0; 4096]);
            // Records the first line, the proof, and the record.
            while recorded.iter().filter(|byte| **byte == b'\n').count() < 2 || !recorded.ends_with(b"move\n") {
                tokio::select! {
                    n = between.read(&mut bytes) => {
                        let n = n.unwrap();
                        recorded.extend_from_slice(&bytes[..n]);
                        further.write_all(&bytes[..n]).await.unwrap();
                    }
                    line = async { let mut answer = vec![0; 4096]; let n = further.read(&mut answer).await.unwrap(); answer.truncate(n); answer } => {
                        between.write_all(&line).await.unwrap();
                    }
                }
            }
            recorded
        };
        let (accepted, _connected, recorded) = tokio::join!(accepted, connected, passed_on);
        assert!(accepted.is_ok());
        recorded
    });
    runtime.block_on(async {
        let (mut near, far) = duplex(64 * 1024);
        near.write_all(&recorded).await.unwrap();
        let Err(error) = guard.accept(far).await else { panic!("a repeated connection was let in") };
        assert_eq!(error.to_string(), NotSealed::NotProven.to_string());
    });
}

#[test]
fn foreign_protocol_is_refused_without_waiting() {
    let guard = guard(&Secret::generate().unwrap());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let hello: &[&[u8]] = &[
            b"{\"availability_request\":{}}\n",
            b"\x16\x03\x01\x02",
            b"URRCP-HMAC 2 ",
            b"URRCP-HMAC 1 \xff\n",
            &[b"URRCP-HMAC 1 ".as_slice(), &[b'a'; 9000]].concat(),
        ];
        for said in hello {
            let (mut near, far) = duplex(64 * 1024);
            near.write_all(said).await.unwrap();
            let Err(error) = guard.accept(far).await else { panic!() };
            assert_eq!(error.to_string(), NotSealed::NotSpoken.to_string());
        }
        let (mut near, far) = duplex(64 * 1024);
        near.write_all(b"URRCP-HMAC 1 00 cf1 claim\n").await.unwrap();
        assert!(guard.accept(far).await.is_err());
        let mut said = String::new();
        near.read_to_string(&mut said).await.unwrap();
        assert_eq!(said, "URRCP-HMAC 1 refused claim\n");
    });
}

#[test]
fn first_line_is_accepted_up_to_the_maximum_length_in_any_pieces() {
    let guard = guard(&Secret::generate().unwrap());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    for (bytes, is_read) in [(8_192, true), (8_193, false), (10_000, false)] {
        let line = [b"URRCP-HMAC 1 ".as_slice(), &vec![b'a'; bytes - 14], b"\n"].concat();
        for piece in [64, 1_000, bytes] {
            let refused = runtime.block_on(async {
                let (mut near, far) = duplex(piece);
                let said = async {
                    // The rest of a line that is too long is not read.
                    let _hung_up = near.write_all(&line).await;
                    let mut answer = String::new();
                    near.read_to_string(&mut answer).await.unwrap();
                    answer
                };
                let (accepted, answer) = tokio::join!(guard.accept(far), said);
                (accepted.err().unwrap().to_string(), answer)
            });
            let why = if is_read { NotSealed::Refused(Refused::Unreadable) } else { NotSealed::NotSpoken };
            let answer = if is_read { Refused::Unreadable.line() } else { String::new() };
            assert_eq!(refused, (why.to_string(), answer), "{bytes} bytes, {piece} at a time");
        }
    }
    let endless = [b"URRCP-HMAC 1 ".as_slice(), &[b'a'; 8_192 - 13]].concat();
    let refused = runtime.block_on(async {
        let (mut near, far) = duplex(64 * 1024);
        near.write_all(&endless).await.unwrap();
        tokio::time::timeout(std::time::Duration::from_secs(60), guard.accept(far)).await
    });
    assert!(matches!(refused, Ok(Err(_))), "its end is not waited for");
}

#[test]
fn long_message_passes_completely_through_a_small_buffer() {
    let secret = Secret::generate().unwrap();
    let (guard, anna) = (guard(&secret), held(&secret, "cf 1/ö", claim(&[Role::Drive])));
    let long: Vec<u8> = (0..200_000_u32).map(|n| n as u8).collect();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (near, far) = duplex(100);
        let sent = async {
            let mut stream = connect(near, &anna).await.unwrap();
            stream.write_all(&long).await.unwrap();
            stream.flush().await.unwrap();
            stream
        };
        let heard = async {
            let (mut stream, _) = guard.accept(far).await.unwrap();
            let mut heard = vec![0; long.len()];
            stream.read_exact(&mut heard).await.unwrap();
            heard
        };
        // The sender stays connected, but sends nothing more.
        let (_stream, heard) = tokio::join!(sent, heard);
        assert!(heard == long);
    });
}

proptest! {
    #[test]
    fn first_line_round_trips_with_any_names(
        nonce in any::<[u8; 16]>(),
        robot in "\\PC{1,40}",
        name in "[^\\x00]{1,40}",
        roles in proptest::sample::subsequence(Role::ALL.to_vec(), 0..=4),
        expires in any::<i64>(),
        serial in "[0-9a-f:]{1,60}",
    ) {
        let claim = Claim { name, roles: roles.into_iter().collect(), expires, serial };
        let hello = Hello { nonce, robot: robot.parse().unwrap(), claim };
        let line = hello.line();
        prop_assert_eq!(line.matches('\n').count(), 1);
        prop_assert_eq!(Hello::read(&line), Ok(hello));
    }

    #[test]
    fn unsealed_bytes_are_never_opened(raw in proptest::collection::vec(any::<u8>(), 0..200), begin in 0_u8..40) {
        let secret = Secret::of_bytes([1; 32]);
        let (_, mut opening) = Keys::of(&secret.pass(&claim(&[])), "hello\n", "answer\n").of_robot();
        opening.push(&[0, 0, 0, begin]);
        opening.push(&raw);
        let mut opened = Vec::new();
        prop_assert_ne!(opening.open(&mut opened), Ok(true));
        prop_assert!(opened.is_empty());
    }

    #[test]
    fn parsing_any_first_line_never_panics(line in "\\PC{0,200}", begun in any::<bool>()) {
        let line = if begun { format!("URRCP-HMAC 1 {line}\n") } else { line };
        let _judged = Hello::read(&line);
    }
}

#[test]
fn connection_that_ends_within_a_record_is_an_error() {
    let secret = Secret::generate().unwrap();
    let (guard, anna) = (guard(&secret), held(&secret, "cf 1/ö", claim(&[Role::Drive])));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    for (behind, expected) in [(&b""[..], None), (b"\0\0", Some(std::io::ErrorKind::UnexpectedEof))] {
        runtime.block_on(async {
            let (mut near, far) = duplex(64 * 1024);
            let operator = async {
                let mut stream = connect(&mut near, &anna).await.unwrap();
                stream.write_all(b"move\n").await.unwrap();
                stream.flush().await.unwrap();
            };
            let ((), accepted) = tokio::join!(operator, guard.accept(far));
            near.write_all(behind).await.unwrap();
            drop(near);
            let mut heard = Vec::new();
            let ended = accepted.unwrap().0.read_to_end(&mut heard).await;
            assert_eq!(ended.err().map(|error| error.kind()), expected);
            assert_eq!(heard, b"move\n");
        });
    }
}

/// Path of a file that only one test uses. Dropping this value deletes the file.
struct Kept(std::path::PathBuf);

impl Kept {
    fn new(name: &str, text: &str) -> Self {
        use std::os::unix::fs::PermissionsExt;
        let path = std::env::temp_dir().join(format!("downbeat-sealed-{}-{name}", std::process::id()));
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        Self(path)
    }
}

impl Drop for Kept {
    fn drop(&mut self) {
        let _gone = std::fs::remove_file(&self.0);
    }
}

#[test]
fn passes_round_trip_and_are_found_by_robot() {
    use crate::Passes;
    let secret = Secret::generate().unwrap();
    let (first, second) = (held(&secret, "cf 1/ö", claim(&[Role::Drive])), held(&secret, "cf2", claim(&[])));
    let written = Passes::new(vec![first.clone(), second]);
    let file = Kept::new("passes", &written.text());
    let read = Passes::read(&file.0).unwrap();
    assert_eq!(read.text(), written.text());
    assert_eq!(read.held().len(), 2);
    let found = read.of(&"cf 1/ö".parse().unwrap()).unwrap();
    assert_eq!((&found.robot, &found.claim), (&first.robot, &first.claim));
    assert!(meet(&guard(&secret), found).0.is_ok(), "it is the same pass");
    assert_eq!(read.of(&"cf2".parse().unwrap()).unwrap().claim.roles, Roles::default());
    assert!(read.of(&"cf3".parse().unwrap()).is_none());
    assert_eq!(Passes::next_to("keys/anna.pem".as_ref()), std::path::Path::new("keys/anna.passes"));
    let line = written.text().lines().nth(1).unwrap().to_owned();
    for damaged in [&line[..line.len() - 1], "cf1", "cf1 pass"] {
        assert!(Passes::read(&Kept::new("no-passes", damaged).0).is_err(), "{damaged}");
    }
}

#[test]
fn secret_round_trips_and_other_content_is_refused() {
    let secret = Secret::of_bytes([0xa5; 32]);
    let text = secret.text(&"cf 1".parse().unwrap());
    assert_eq!(
        text,
        format!("# The secret of robot cf%201. Copy it only to this robot.\n{}\n", "a5".repeat(32))
    );
    let read = Secret::read(&Kept::new("secret", &text).0).unwrap();
    let anna = held(&read, "cf 1/ö", claim(&[Role::Drive]));
    assert!(meet(&guard(&secret), &anna).0.is_ok(), "it is the same secret");
    let digits = "a5".repeat(32);
    for wrong in ["", "# nothing\n", &digits[1..], &format!("{digits}\n{digits}"), &digits.to_uppercase()] {
        let error = Secret::read(&Kept::new("no-secret", wrong).0).unwrap_err().to_string();
        assert!(error.contains("one line of 64 hexadecimal digits"), "{error}");
    }
}

#[test]
fn robot_whose_clock_is_not_set_admits_nobody() {
    let made = 1_800_000_000;
    let text = Secret::of_bytes([0xa5; 32]).made_at(made).text(&"cf 1".parse().unwrap());
    assert!(text.contains("\n# made 1800000000\n"), "{text}");
    let secret = Secret::read(&Kept::new("made", &text).0).unwrap();
    assert_eq!(secret.made(), made);
    let hello = Hello { nonce: [7; 16], robot: "cf 1/ö".parse().unwrap(), claim: claim(&[Role::Stop]) };
    let guard = guard(&secret);
    assert!(matches!(guard.judge(&hello, 0), Err(Refused::Clock)));
    assert!(matches!(guard.judge(&hello, made - 301), Err(Refused::Clock)));
    assert!(guard.judge(&hello, made - 300).is_ok());
}

#[test]
fn debug_output_hides_the_keys() {
    let secret = Secret::generate().unwrap();
    let pass = secret.pass(&claim(&[]));
    let keys = Keys::of(&pass, "hello\n", "answer\n");
    assert_eq!(format!("{secret:?} {pass:?} {keys:?}"), "Secret Pass Keys");
}

#[test]
fn refusal_round_trips() {
    let secret = Secret::generate().unwrap();
    let anna = held(&secret, "cf1", claim(&[Role::Drive]));
    let hello = Hello { nonce: [7; 16], robot: anna.robot.clone(), claim: anna.claim.clone() };
    let own = "cf 1/ö".parse().unwrap();
    for refused in
        [Refused::Clock, Refused::Expired, Refused::Revoked, Refused::OtherRobot(own), Refused::Unreadable]
    {
        let line = refused.line();
        assert_eq!(hello.check_answer(&anna.pass, &line), Err(NotSealed::Refused(refused)), "{line}");
    }
    for line in [
        "",
        "hello\n",
        "URRCP-HMAC 1 refused\n",
        "URRCP-HMAC 1 refused why\n",
        "URRCP-HMAC 1 refused robot %\n",
    ] {
        assert_eq!(hello.check_answer(&anna.pass, line), Err(NotSealed::NotSpoken), "{line:?}");
    }
}

#[test]
fn pass_is_valid_through_the_second_in_which_it_expires() {
    let secret = Secret::generate().unwrap();
    let guard = guard(&secret);
    let expiring = Claim { expires: 1_000, ..claim(&[Role::Drive]) };
    let hello = Hello { nonce: [7; 16], robot: "cf 1/ö".parse().unwrap(), claim: expiring };
    assert!(guard.judge(&hello, 1_000).is_ok());
    assert!(matches!(guard.judge(&hello, 1_001), Err(Refused::Expired)));
}

#[test]
fn received_list_is_stored_only_with_the_code_of_the_authority() {
    let path = std::env::temp_dir().join(format!("downbeat-sent-{}", std::process::id()));
    std::fs::write(&path, "# number 5\n# end\n").unwrap();
    let secret = Secret::generate().unwrap();
    let list = RevokedSerials::in_file(&path).unwrap();
    let guard = Guard::new("cf1".parse().unwrap(), secret.clone(), Some(&list)).unwrap();
    let stored = || std::fs::read_to_string(&path).unwrap();
    let later = "# number 6\n0a:1b\n# end\n";
    let proven = secret.proven_list(later);
    let altered = proven.replace("0a:1b", "0a:1c");
    let other = Secret::generate().unwrap().proven_list(later);
    let without_end = proven.trim_end();
    for refused in [later, altered.as_str(), other.as_str(), without_end, "", "# code \n"] {
        let error = guard.replace_list(refused).unwrap_err();
        assert_eq!(
            (error.as_str(), stored().as_str()),
            ("the list is not for this robot, or was altered", "# number 5\n# end\n")
        );
    }
    assert_eq!(
        guard.replace_list(&secret.proven_list("# number 4\n# end\n")).unwrap_err(),
        "it is older than the version in use"
    );
    guard.replace_list(&proven).unwrap();
    assert_eq!((stored().as_str(), guard.list().unwrap().contains("0a:1b")), (later, true));
    std::fs::remove_file(&path).unwrap();
    std::fs::remove_file(path.with_extension("number")).unwrap();
}
