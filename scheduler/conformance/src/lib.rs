//! Acts as the server of a robot, and checks the requirements of the protocol one at a time.
//!
//! The crate has its own test client, with blocking sockets and raw bytes, because it must also send bytes that no server sends. Each
//! file covers one topic and lists its requirements with their checks. `trial` is the environment of the checks, `line` is one
//! connection.

mod actor;
mod claims;
mod devices;
mod forms;
mod greeting;
mod heard;
mod identity;
mod ids;
mod inquiries;
mod instants;
mod leases;
mod line;
mod links;
mod movement;
mod order;
mod owners;
mod questions;
mod repeats;
mod reports;
mod requirement;
mod scripts;
mod security;
mod silence;
mod starting;
mod stopping;
mod stops;
mod stream;
mod trial;
mod values;
mod wire;

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use urrcp::{InitializationBlock, Span};

pub use requirement::{Judged, Requirement, Verdict};

use downbeat_runtime::link::Security;
use downbeat_runtime::server_clock::ServerClock;
use requirement::Unmet;
use trial::Trial;

/// Settings for the examination of a robot.
#[derive(Clone, Debug)]
pub struct Options {
    /// Maximum time that the robot may take for a response.
    pub patience: Span,
    /// Maximum deviation of a start or an end from its planned time.
    pub tolerance: Span,
    /// The id of the device to move. `None`: the first suitable device.
    pub device: Option<String>,
    /// Whether to judge times by the robot's own clock, regardless of its offset from the server's clock.
    pub clock_measured: bool,
    /// A value that is safe for the custom control types of the device to move. `None`: the device is moved by another type.
    pub custom: Option<f64>,
    /// The names or numbers of the requirements to check. If the list is empty, all are checked.
    pub only: Vec<String>,
    /// How the test client proves its identity to the robot.
    pub security: Security,
    /// The identity of an operator that may only observe. `None`: the permissions of observers are not tested.
    pub observer: Option<Security>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            patience: Span::from_millis(2_000),
            tolerance: Span::from_millis(20),
            device: None,
            custom: None,
            clock_measured: false,
            only: Vec::new(),
            security: Security::Plain,
            observer: None,
        }
    }
}

/// The result of the examination of a robot.
#[derive(Clone, Debug)]
pub struct Examined {
    /// One verdict for each requirement that was checked.
    pub judged: Vec<Judged>,
    /// Whether the robot has a device that the checks could move. If not, most requirements are not applicable.
    pub moves: bool,
    /// Whether the operator interrupted the examination.
    pub interrupted: bool,
    /// Whether the robot confirmed at the end that it is at rest.
    pub at_rest: bool,
}

/// Why a robot cannot be examined.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotExamined {
    /// No robot answers at the address.
    #[error("{0}")]
    Unreachable(String),
    /// The robot lacks the device that the examination is to move.
    #[error("{0}")]
    NoDevice(String),
}

/// Iterates over all requirements, in the order in which they are checked.
pub fn requirements() -> impl Iterator<Item = &'static Requirement> {
    let of_robot = greeting::ALL.iter().chain(&values::ALL).chain(&order::ALL).chain(&starting::ALL);
    let of_time = instants::ALL.iter().chain(&scripts::ALL).chain(&reports::ALL).chain(&leases::ALL);
    let of_server = silence::ALL.iter().chain(&stopping::ALL).chain(&stops::ALL).chain(&devices::ALL);
    let of_names = identity::ALL.iter().chain(&ids::ALL).chain(&repeats::ALL);
    let of_owners = owners::ALL.iter().chain(&claims::ALL).chain(&inquiries::ALL).chain(&questions::ALL);
    let of_lines = movement::ALL.iter().chain(&wire::ALL).chain(&forms::ALL).chain(&links::ALL);
    of_robot
        .chain(of_time)
        .chain(of_server)
        .chain(of_names)
        .chain(of_owners)
        .chain(of_lines)
        .chain(&security::ALL)
}

/// Checks a robot against the requirements. Calls `tell` with each requirement before its check, and again with the verdict afterwards.
///
/// # Errors
/// [`NotExamined`] if no robot answers at the address, or if the robot lacks the device that it should move.
pub fn examine(
    address: SocketAddr,
    mut options: Options,
    interrupted: Arc<AtomicBool>,
    tell: &mut dyn FnMut(&Requirement, Option<&Judged>),
) -> Result<Examined, NotExamined> {
    let patience = options.patience.to_duration();
    options.security = stream::for_robot_at(address, options.security, patience);
    options.observer = options.observer.map(|of| stream::for_robot_at(address, of, patience));
    let clock = ServerClock::anchored(Span::ZERO);
    let mut trial = Trial::new(address, options, clock, interrupted);
    if let Err(unmet) = trial.connect() {
        return Err(NotExamined::Unreachable(why(unmet)));
    }
    let block = trial.connect().and_then(|mut line| line.initialization()).ok();
    let block = block.map(|(_, block)| block.message);
    has_device(block.as_ref(), trial.options().device.as_deref())?;
    trial.learn(block);
    let off = greeting::compare_clocks(&trial).ok();
    let off = off.filter(|reading| trial.options().clock_measured || !greeting::agrees(reading));
    trial.shift = off.map_or(Span::ZERO, |reading| reading.offset);
    trial.greets = matches!(greeting::skip_handshake(&trial), Err(Unmet::Failed(_)));
    // The check of the greeting may have left a script pending on the robot.
    let _at_rest = trial.settle();
    let mut examined =
        Examined { judged: Vec::new(), moves: trial.moves(), interrupted: false, at_rest: true };
    let chosen = |r: &&Requirement| {
        let Options { only, security, .. } = trial.options();
        // A tcp:// address requires no proof of identity.
        let asked_for = !security::is_among(r) || !matches!(security, Security::Plain);
        (only.is_empty() && asked_for) || only.iter().any(|name| r.is_called(name))
    };
    let answered = trial.is_alive();
    // The requirement since which the robot no longer answers.
    let mut dead: Option<&'static str> = None;
    for requirement in requirements().filter(chosen) {
        tell(requirement, None);
        let judged = match dead {
            Some(since) => Some(not_judged(requirement, since)),
            None => judge(&trial, requirement),
        };
        let Some(judged) = judged else {
            examined.interrupted = true;
            break;
        };
        if judged.verdict == Verdict::Fail && dead.is_none() && answered && !trial.is_alive() {
            dead = Some(requirement.name);
        }
        tell(requirement, Some(&judged));
        examined.judged.push(judged);
    }
    examined.at_rest = trial.settle_at_the_end();
    Ok(examined)
}

/// Returns an error if the robot lacks the device `named`; otherwise nearly all requirements would be reported as not applicable.
fn has_device(block: Option<&InitializationBlock>, named: Option<&str>) -> Result<(), NotExamined> {
    let (Some(block), Some(named)) = (block, named) else { return Ok(()) };
    if block.device(named).is_some() {
        return Ok(());
    }
    let known: Vec<_> = block.devices.iter().take(20).map(|device| format!("`{}`", device.id)).collect();
    let more = if block.devices.len() > known.len() { ", ..." } else { "" };
    let known = known.join(", ");
    Err(NotExamined::NoDevice(format!(
        "`{}` has no device `{named}`, expected one of {known}{more}",
        block.id
    )))
}

/// Creates the result for a requirement that is not checked because the robot has been unresponsive since the check `since`. Any further
/// check would only wait for timeouts.
fn not_judged(requirement: &Requirement, since: &str) -> Judged {
    let why = format!(
        "not checked: since the check `{since}`, the robot has not accepted a connection or has not answered; expected it to keep running"
    );
    Judged {
        requirement: requirement.name,
        number: requirement.number,
        verdict: Verdict::Fail,
        why,
        millis: 0,
    }
}

/// Checks one requirement. Returns `None` if the operator interrupts the check.
fn judge(trial: &Trial, requirement: &'static Requirement) -> Option<Judged> {
    let began = trial.now();
    let (verdict, why) = match (requirement.check)(trial) {
        Ok(note) => (Verdict::Pass, note),
        Err(Unmet::Failed(why)) => (Verdict::Fail, why),
        Err(Unmet::NotApplicable(why)) => (Verdict::NotApplicable, why),
        Err(Unmet::Interrupted) => return None,
    };
    let took = (trial.now() - began).to_duration().as_millis();
    let _at_rest = trial.settle();
    Some(Judged {
        requirement: requirement.name,
        number: requirement.number,
        verdict,
        why,
        millis: u64::try_from(took).unwrap_or(u64::MAX),
    })
}

fn why(unmet: Unmet) -> String {
    match unmet {
        Unmet::Failed(why) | Unmet::NotApplicable(why) => why,
        Unmet::Interrupted => "interrupted".to_owned(),
    }
}
