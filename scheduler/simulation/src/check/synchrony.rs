//! Checks invariant (f): robots start at the announced times. Relative to the plan and to each other, they stay within the skew budget
//! that was printed before anything was sent.
//!
//! The check uses the true start by the clock of the simulated world, not the robot's own report. A clock that is set, or a process that
//! stalls, excuses only its own robot.
//!
//! If a clock was set before the act became doubtful (too late to notice the silence of a robot), the mission must notice the change.
//! Then the start is still within the scenario's tolerance, or the robot does not start.

use urrcp::{Message, RequestId, Server, Span, Timestamp};

use super::Verdict;
use super::cause::Cause;
use super::facts::{Facts, SentAct, SentScript};
use crate::Happened;
use downbeat_mission::RobotSkew;

/// Maximum rounding error of times: the simulated world has a resolution of nanoseconds, and clock readings are computed by division.
const GRAIN: Span = Span::from_micros(1);
/// Maximum delay after which a robot still starts a script.
const START_LATE_MAX: Span = Span::from_millis(50);
/// Maximum difference between an instant by a robot's own clock and the same instant as computed from the reported clock data.
const CLOCKS: Span = Span::from_millis(1);
/// Maximum drift, as a fraction, of a clock since the beginning of an act. It is the bound that the mission assumes for clocks.
const DRIFT_BOUND: f64 = downbeat_mission::clock::DRIFT_BOUND;

/// The actual start of a robot's script, as its deviation from the plan.
struct Start {
    robot: usize,
    error: Span,
}

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    for act in &facts.acts {
        let Some(skew) = act.skew else { continue };
        let mut starts = Vec::new();
        for script in act.scripts.iter().filter(|script| facts.honest(script.robot)) {
            let Some(error) = error_of(act, script) else { continue };
            let robot = script.robot;
            let told = skew.robots.iter().find(|told| told.robot == *facts.name(robot));
            let drift = Span::from_millis_f64(script.promised.start.get() * DRIFT_BOUND);
            let fits = told.is_some_and(|told| within(told, error, drift + GRAIN));
            match excuse(facts, act, script, told).filter(|_| !fits) {
                Some(cause) => verdict.excused('f', cause),
                None if fits => starts.push(Start { robot, error }),
                None => verdict.violated('f', beyond(act, told, robot, error)),
            }
        }
        let grain = Span::from_millis_f64(act.starts_within().as_millis_f64() * DRIFT_BOUND) + GRAIN;
        apart(skew.predicted + grain, act, &starts, verdict);
    }
}

fn within(told: &RobotSkew, error: Span, grain: Span) -> bool {
    let (earliest, latest) = range(told);
    error >= earliest - grain && error <= latest + grain
}

/// Returns the lower and the upper bound that were announced for a robot's deviation from the plan.
fn range(told: &RobotSkew) -> (Span, Span) {
    (Span::ZERO - told.offset - told.uncertainty, told.uncertainty + told.wake_up - told.offset)
}

fn beyond(act: &SentAct<'_>, told: Option<&RobotSkew>, robot: usize, error: Span) -> String {
    let number = act.promise.number;
    match told {
        Some(told) => format!(
            "r{robot} started {error} away from its planned time in act {number}, but its clock error was reported as {} +- {} ahead",
            told.offset, told.uncertainty
        ),
        None => format!("r{robot} started act {number}, but nothing was reported about its clock"),
    }
}

/// Checks that the starts of robots differ from each other by no more than the budget of the fleet. Considers only robots that are within
/// their own budgets.
fn apart(budget: Span, act: &SentAct<'_>, starts: &[Start], verdict: &mut Verdict) {
    let least = starts.iter().min_by_key(|start| start.error);
    let Some((least, most)) = least.zip(starts.iter().max_by_key(|start| start.error)) else { return };
    // The devices of one robot share its clock.
    if least.robot != most.robot && most.error - least.error > budget {
        let (apart, number) = (most.error - least.error, act.promise.number);
        let what =
            format!("the starts of act {number} were {apart} apart on r{} and r{}", least.robot, most.robot);
        verdict.violated('f', format!("{what}, but at most {budget} was predicted"));
    }
}

/// Returns the true start of a script minus its planned start; `None` if the script did not start.
fn error_of(act: &SentAct<'_>, script: &SentScript<'_>) -> Option<Span> {
    let first = script.log.first()?;
    let planned = act.start_of(script) + script.starts_after;
    Some(Timestamp::<Server>::from_nanos(first.true_ns) - planned)
}

/// Returns the excuse of a robot for a wrong start: its clock was set after the last measurement, or its process stalled at the start. A
/// measurement does not reveal a change of the clock that is smaller than the duration of the exchange.
fn excuse(
    facts: &Facts<'_>,
    act: &SentAct<'_>,
    script: &SentScript<'_>,
    told: Option<&RobotSkew>,
) -> Option<Cause> {
    let due = act.start_of(script) + script.starts_after;
    let own = facts.hits.iter().filter(|hit| hit.is_of(script.robot));
    let hidden = facts.drawn().delay.1 * 2 + facts.drawn().robots[script.robot].slow;
    let excuses = own.filter(|hit| match hit.cause {
        Cause::ClockSet => {
            let shows = |at| hit.by.abs() > hidden + held_up(facts, script.robot, at);
            let seen = facts.asked(script.robot, hit.from, act.at).any(shows);
            // A script that arrives after its start still begins if the clock was set back in the meantime.
            !seen && hit.from <= (due + START_LATE_MAX).max(arrived(facts, script))
        }
        Cause::RobotPause => told.is_some_and(|told| {
            let (earliest, latest) = range(told);
            hit.overlaps(due + earliest - CLOCKS, due + latest + CLOCKS)
        }),
        _ => false,
    });
    excuses.map(|hit| hit.cause).min()
}

/// Returns when the request with which a script began first arrived.
fn arrived(facts: &Facts<'_>, script: &SentScript<'_>) -> Timestamp<Server> {
    let name = script.log.first().and_then(|entry| entry.request_id.as_deref());
    let named = |happened: &Happened| match happened {
        Happened::AtRobot(robot, Message::ControlRequest(request)) => {
            *robot == script.robot && request.request_id.as_ref().map(RequestId::as_str) == name
        }
        _ => false,
    };
    let first = facts.ran.history.iter().find(|(_, happened)| named(happened));
    first.map_or(Timestamp::from_nanos(0), |(at, _)| *at)
}

/// Returns the unusual delay of an exchange whose question reached a robot at the instant `at`; zero if nothing delayed its messages.
fn held_up(facts: &Facts<'_>, robot: usize, at: Timestamp<Server>) -> Span {
    let answered = at + facts.drawn().robots[robot].slow;
    let slow = facts.hits.iter().filter(|hit| hit.is_of(robot) && hit.cause == Cause::Slow);
    slow.filter(|hit| hit.overlaps(at, answered)).map(|hit| hit.until - hit.from).max().unwrap_or_default()
}
