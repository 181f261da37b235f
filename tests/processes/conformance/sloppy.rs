//! A robot whose door (the proxy that authenticates peers by a shared secret) is correct except for one fault. The conformance test has
//! to find this fault.

use std::collections::HashSet;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use downbeat::conformance::{Options, Verdict, examine, requirements};
use downbeat::link::Site;
use downbeat_robot::sealed::{
    Claim, Hello, Keys, NotSealed, Pass, Refused, Sealing, Secret, proof_of_operator,
};
use downbeat_robot::simulated::{Settings, SimulatedRobot};
use downbeat_robot::{Host, HostOptions, serve};
use downbeat_scripts::Protection;
use urrcp::{InitializationBlock, Span};

use stage::session::{ARM, Session};

/// A fault of the door, which authenticates the peers of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    None,
    /// The door passes plain messages (without authentication).
    Plain,
    /// The door does not disconnect silent peers.
    Patient,
    /// The door does not check the authentication codes of records.
    AnyRecord,
    /// The door does not check the operator's proof.
    AnyProof,
    /// The door does not check whether a claim has expired.
    Expired,
    /// The door does not check whether a peer intends to reach this robot.
    AnyRobot,
    /// The door accepts one pass for all claims.
    OnePass,
    /// The door sends the same random number on every connection.
    OneNumber,
    /// The door does not pass roles on to the robot.
    NoRoles,
}

/// The door in front of a robot, which authenticates its peers: its fault and its settings.
#[derive(Clone)]
struct Door {
    fault: Fault,
    secret: Secret,
    known: Claim,
    robot: SocketAddr,
}

fn line(socket: &mut TcpStream) -> Option<String> {
    let (mut line, mut byte) = (String::new(), [0]);
    while !line.ends_with('\n') {
        socket.read_exact(&mut byte).ok()?;
        line.push(char::from(byte[0]));
    }
    Some(line)
}

impl Door {
    fn listen(self) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        // Ends with the process.
        std::thread::spawn(move || {
            for socket in listener.incoming() {
                let (own, socket) = (self.clone(), socket.unwrap());
                std::thread::spawn(move || {
                    let closing = socket.try_clone().unwrap();
                    own.carry(socket);
                    let _gone = closing.shutdown(Shutdown::Both);
                });
            }
        });
        address
    }

    fn judge(&self, hello: &Hello) -> Result<Pass, Refused> {
        if hello.robot.as_str() != "arm" && self.fault != Fault::AnyRobot {
            return Err(Refused::OtherRobot("arm".parse().unwrap()));
        }
        if hello.claim.expires < 1_000_000_000 && self.fault != Fault::Expired {
            return Err(Refused::Expired);
        }
        let claim = if self.fault == Fault::OnePass { &self.known } else { &hello.claim };
        Ok(self.secret.pass(claim))
    }

    fn carry(self, mut socket: TcpStream) -> Option<()> {
        let limit = if self.fault == Fault::Patient { 60 } else { 5 };
        socket.set_read_timeout(Some(Duration::from_secs(limit))).unwrap();
        let mut first = [0];
        socket.peek(&mut first).ok()?;
        if first[0] == b'{' && self.fault == Fault::Plain {
            let robot = TcpStream::connect(self.robot).ok()?;
            let (mut back, mut to) = (robot.try_clone().unwrap(), socket.try_clone().unwrap());
            std::thread::spawn(move || std::io::copy(&mut back, &mut to));
            return std::io::copy(&mut socket, &mut &robot).ok().map(drop);
        }
        if first[0] != b'U' {
            return None;
        }
        let said = line(&mut socket)?;
        let hello = match Hello::read(&said) {
            Err(NotSealed::Refused(refused)) => return socket.write_all(refused.line().as_bytes()).ok(),
            hello => hello.ok()?,
        };
        let pass = match self.judge(&hello) {
            Err(refused) => return socket.write_all(refused.line().as_bytes()).ok(),
            Ok(pass) => pass,
        };
        let nonce = if self.fault == Fault::OneNumber { [7; 16] } else { fastrand::u128(..).to_be_bytes() };
        let answer = hello.answer(&pass, &nonce);
        socket.write_all(answer.as_bytes()).ok()?;
        let proof = line(&mut socket)?;
        if proof != proof_of_operator(&pass, &said, &answer) && self.fault != Fault::AnyProof {
            return None;
        }
        socket.set_read_timeout(None).unwrap();
        let (sealing, mut opening) = Keys::of(&pass, &said, &answer).of_robot();
        let mut robot = TcpStream::connect(self.robot).ok()?;
        answers(&robot, &socket, sealing);
        let mut raw = Vec::new();
        loop {
            let mut bytes = [0; 20 * 1024];
            let n = socket.read(&mut bytes).ok().filter(|n| *n > 0)?;
            let mut opened = Vec::new();
            if self.fault == Fault::AnyRecord {
                raw.extend_from_slice(&bytes[..n]);
                while let Some(length) = raw.first_chunk::<4>() {
                    let end = 20 + usize::try_from(u32::from_be_bytes(*length)).unwrap();
                    let Some(carried) = raw.get(20..end) else { break };
                    opened.extend_from_slice(carried);
                    raw.drain(..end);
                }
            } else {
                opening.push(&bytes[..n]);
                while opening.open(&mut opened).ok()? {}
            }
            robot.write_all(&opened).ok()?;
        }
    }
}

fn answers(robot: &TcpStream, operator: &TcpStream, mut sealing: Sealing) {
    let (mut robot, mut operator) = (robot.try_clone().unwrap(), operator.try_clone().unwrap());
    std::thread::spawn(move || {
        let mut bytes = [0; 8 * 1024];
        while let Ok(n @ 1..) = robot.read(&mut bytes) {
            let mut records = Vec::new();
            sealing.seal(&bytes[..n], &mut records);
            if operator.write_all(&records).is_err() {
                return;
            }
        }
    });
}

fn plain_robot() -> SocketAddr {
    let (tell, told) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let block: InitializationBlock = serde_yaml::from_str(ARM).unwrap();
        let robot = SimulatedRobot::new(block, Settings::default());
        let host = Host::start(vec![robot], HostOptions::default()).unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
            tell.send(listener.local_addr().unwrap()).unwrap();
            serve(listener, host.handle(), 0).await.unwrap();
        });
    });
    told.recv().unwrap()
}

/// The requirements about proofs of identity, which only a robot with a door can fail.
pub const OF_PROOFS: [&str; 10] = [
    "no-plain",
    "proven-in-time",
    "altered",
    "repeated",
    "reordered",
    "wrong-secret",
    "expired-claim",
    "other-robot",
    "forged-roles",
    "repeated-connection",
];

/// Returns the requirements that a robot fails if its door (the proxy that authenticates peers) has this fault.
fn fails(session: &Session, fault: Fault) -> Vec<&'static str> {
    let secret = Secret::read(&session.path("keys/secrets/arm.secret")).unwrap();
    let site = Site::of_files(Some(&session.path("keys/operators/anna.pem")), None).unwrap();
    let known = site.passes().held()[0].claim.clone();
    let address = Door { fault, secret, known, robot: plain_robot() }.listen();
    let security = site.with(Protection::Hmac, None);
    let mut options = Options { security, patience: Span::from_millis(1_000), ..Options::default() };
    if fault == Fault::NoRoles {
        let observer = Site::of_files(Some(&session.path("keys/operators/bert.pem")), None).unwrap();
        options.observer = Some(observer.with(Protection::Hmac, None));
    }
    let about_proofs = |name: &str| OF_PROOFS.contains(&name) || (name == "roles" && fault == Fault::NoRoles);
    let ours = requirements().filter(|requirement| about_proofs(requirement.name));
    // It takes seconds.
    let ours = ours.filter(|r| r.name != "proven-in-time" || matches!(fault, Fault::None | Fault::Patient));
    options.only = ours.map(|requirement| requirement.name.to_owned()).collect();
    let examined = examine(address, options, Arc::new(AtomicBool::new(false)), &mut |_, _| {}).unwrap();
    assert!(examined.judged.iter().all(|judged| judged.verdict != Verdict::NotApplicable));
    let failed = examined.judged.iter().filter(|judged| judged.verdict == Verdict::Fail);
    failed.map(|judged| judged.requirement).collect()
}

#[test]
fn each_authentication_fault_fails_only_the_requirements_it_violates() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "operator", "anna", "--role", "observe,drive"]).says(0, &[]);
    session.run(&["keys", "secret", "arm"]).says(0, &[]);
    session.run(&["keys", "operator", "bert", "--role", "observe"]).says(0, &[]);
    let expected: [(Fault, &[&str]); 10] = [
        (Fault::None, &[]),
        (Fault::Plain, &["no-plain"]),
        (Fault::Patient, &["proven-in-time"]),
        (Fault::AnyRecord, &["altered", "repeated", "reordered"]),
        (Fault::AnyProof, &["wrong-secret"]),
        (Fault::Expired, &["expired-claim"]),
        (Fault::AnyRobot, &["other-robot"]),
        (Fault::OnePass, &["forged-roles"]),
        (Fault::OneNumber, &["repeated-connection"]),
        (Fault::NoRoles, &["roles"]),
    ];
    let failed: HashSet<&str> = expected.iter().flat_map(|(_, fails)| fails.iter().copied()).collect();
    assert!(OF_PROOFS.iter().all(|requirement| failed.contains(requirement)));
    std::thread::scope(|scope| {
        let session = &session;
        let tried =
            expected.map(|(fault, expected)| (fault, expected, scope.spawn(move || fails(session, fault))));
        for (fault, expected, failed) in tried {
            assert_eq!(failed.join().unwrap(), expected, "{fault:?}");
        }
    });
}
