//! The usual practice without a decision: the same acts, robots, networks and faults, with a "go" message that starts on receipt.

use fastrand::Rng;
use urrcp::Span;

use super::check::{ActStarts, Starts};
use super::draw::{Drawn, Fault, Network};
use downbeat_rehearsal::dry_run::BEGIN;
use downbeat_rehearsal::world::Direction;

/// How the "go" is distributed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Go {
    /// To all at once, without any acknowledgement.
    Broadcast,
    /// To one after another, each after the previous one has answered; after 500 ms without an answer the rest is not sent.
    Sequential,
}

/// Interval between the messages to two robots.
const EACH: Span = Span::from_micros(50);
/// Timeout of an answer.
const ANSWER: Span = Span::from_millis(500);

/// Whether all, none or some robots of Downbeat's own act start. The "go" is sent at its planned start, and every script has arrived
/// before the mission began. Robots that Downbeat had left out by then are also left out here, and robots that lie are excluded from
/// both.
#[must_use]
pub fn starts(drawn: &Drawn, go: Go, act: &ActStarts) -> Starts {
    let mut rng = Rng::with_seed(drawn.seed ^ 0xba5e ^ u64::from(act.number));
    let mut now = act.start - BEGIN;
    let (mut started, mut reached) = (0, 0);
    for robot in act.robots.iter().copied() {
        if scheduler_is_gone(drawn, now) {
            break;
        }
        reached += 1;
        let heard = heard_at(drawn, &mut rng, robot, now);
        started += usize::from(heard.is_some());
        match go {
            Go::Broadcast => now += EACH,
            Go::Sequential => {
                let answered = heard.and_then(|at| heard_at(drawn, &mut rng, robot, at));
                match answered.filter(|answered| *answered - now <= ANSWER) {
                    Some(answered) => now = answered,
                    None => break,
                }
            }
        }
    }
    match started {
        0 => Starts::None,
        all if all == act.robots.len() && reached == all => Starts::All,
        _ => Starts::Mixed,
    }
}

/// Whether the scheduler's process has ended and no other process has resumed the mission by `now`.
fn scheduler_is_gone(drawn: &Drawn, now: Span) -> bool {
    drawn.faults.iter().any(|(at, fault)| match fault {
        Fault::SchedulerCrash { resumed_after } | Fault::SchedulerCrashAmid { resumed_after, .. } => {
            *at <= now && resumed_after.is_none_or(|after| *at + after > now)
        }
        _ => false,
    })
}

/// When a message that is sent now arrives; `None` if it is lost or no process listens.
fn heard_at(drawn: &Drawn, rng: &mut Rng, robot: usize, now: Span) -> Option<Span> {
    let (least, largest) = drawn.delay;
    let mut arrival = now + Span::from_nanos(rng.i64(least.as_nanos()..=largest.as_nanos()));
    let lost = match drawn.network {
        Network::Stream => false,
        Network::Datagram { loss, .. } => rng.f64() < loss,
    };
    for (at, fault) in &drawn.faults {
        if *at > arrival {
            break;
        }
        match meets(fault, robot) {
            // Waiting messages pass at the end, on a connection that persists.
            Some(Meets::Wait(lasts)) if *at <= now && now < *at + lasts => match drawn.network {
                Network::Stream => arrival = arrival.max(*at + lasts),
                Network::Datagram { .. } => return None,
            },
            Some(Meets::Longer(by, lasts)) if *at <= now && now < *at + lasts => arrival += by,
            Some(Meets::Nothing(lasts)) if *at <= now && lasts.is_none_or(|lasts| now < *at + lasts) => {
                return None;
            }
            // When it returns, earlier messages to it are lost too.
            Some(Meets::Gone) => return None,
            _ => {}
        }
    }
    (!lost).then_some(arrival)
}

/// The effect of a fault on a message to a robot.
enum Meets {
    /// The message waits for this long.
    Wait(Span),
    /// Each message takes this much longer, for this long.
    Longer(Span, Span),
    /// The message is lost, for this long or forever.
    Nothing(Option<Span>),
    /// The robot is gone with its whole state.
    Gone,
}

/// The effect of a fault on messages to a robot.
fn meets(fault: &Fault, to: usize) -> Option<Meets> {
    match *fault {
        Fault::Partition { robot, lasts, breaks: false }
        | Fault::OneWay { robot, way: Direction::ToRobot, lasts }
            if robot == to =>
        {
            Some(Meets::Wait(lasts))
        }
        Fault::Partition { robot, lasts, breaks: true } | Fault::DeadLink { robot, lasts } if robot == to => {
            Some(Meets::Nothing(Some(lasts)))
        }
        Fault::Lag { robot, by, lasts } if robot == to => Some(Meets::Longer(by, lasts)),
        // The connection is not re-established.
        Fault::HalfOpen { robot } if robot == to => Some(Meets::Nothing(None)),
        Fault::HardwareDies { robot, back_after, .. } if robot == to => Some(Meets::Nothing(back_after)),
        Fault::RobotCrash { robot, .. } | Fault::AnotherRobot { robot, .. } | Fault::Twin { robot, .. }
            if robot == to =>
        {
            Some(Meets::Gone)
        }
        _ => None,
    }
}
