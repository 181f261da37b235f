//! Simulates the usual practice, which has no joint decision to start: robots start when they receive a "go" message. Acts, robots,
//! networks and faults are the same as in Downbeat's own mission.

use fastrand::Rng;
use urrcp::Span;

use super::check::{ActStarts, Starts};
use super::draw::{Drawn, Fault, Network};
use downbeat_rehearsal::dry_run::BEGIN;
use downbeat_rehearsal::world::Direction;

/// How the "go" message is sent to the robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Go {
    /// The message is sent to all robots at once, without any acknowledgement.
    Broadcast,
    /// The message is sent to one robot after another, each time after the previous robot has answered. If a robot does not answer within
    /// 500 ms, the rest is not sent.
    Sequential,
}

/// Interval between the messages to successive robots in a broadcast.
const EACH: Span = Span::from_micros(50);
/// Time that a robot has to answer.
const ANSWER: Span = Span::from_millis(500);

/// Determines whether all, none or some of the robots of `act`, which Downbeat sent, would start with a "go". The "go" is sent at the
/// planned start of the act, and every script has arrived before the mission began.
///
/// `act.robots` excludes robots that lie and robots that Downbeat had left out before the start, so they are excluded here as well.
#[must_use]
pub fn starts(drawn: &Drawn, go: Go, act: &ActStarts) -> Starts {
    let mut rng = Rng::with_seed(drawn.seed ^ 0xba5e ^ u64::from(act.number.get()));
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

/// Whether the scheduler's process has ended by `now` and no other process has resumed the mission.
fn scheduler_is_gone(drawn: &Drawn, now: Span) -> bool {
    drawn.faults.iter().any(|(at, fault)| match fault {
        Fault::SchedulerCrash { resumed_after } | Fault::SchedulerCrashAmid { resumed_after, .. } => {
            *at <= now && resumed_after.is_none_or(|after| *at + after > now)
        }
        _ => false,
    })
}

/// Returns when a message that is sent to a robot at `now` arrives; `None` if it is lost or no process listens.
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
            // Even if the robot returns, earlier messages to it are lost.
            Some(Meets::Gone) => return None,
            _ => {}
        }
    }
    (!lost).then_some(arrival)
}

/// The effect of a fault on a message to a robot.
enum Meets {
    /// The message waits until the fault, which has this duration, is over.
    Wait(Span),
    /// Each message takes longer by the first span. The fault lasts for the second span.
    Longer(Span, Span),
    /// All messages are lost for this duration; forever if `None`.
    Nothing(Option<Span>),
    /// The robot has lost its whole state.
    Gone,
}

/// The effect of a fault on messages to the robot `to`; `None` if it has none.
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
