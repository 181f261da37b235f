//! Incidents of a world: faults and their times.

use urrcp::Span;

use super::amount::{self, Between, between};
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys::{Item, Kind, Naming};
use downbeat_reader::{keys, words};
use downbeat_yaml::finding::Code;

keys! {
    /// A fault of robots or of their links.
    pub(crate) struct IncidentKeys as "incident" {
        /// A robot, a group, or `all`. The incident is drawn separately for each robot.
        #[required]
        robot: Kind::Name(Naming::Uses(Item::Robot), &kinds::NAME),
        /// The kind of fault.
        #[required]
        what: words!(WHAT_WORDS),
        /// The act from whose planned start `at` counts; without it, from the beginning of the mission.
        act: Kind::Name(Naming::Uses(Item::Act), &kinds::NAME),
        /// The time of the fault. By default 0s.
        at: amount::SIGNED_TIMES,
        /// The duration; `refuses` without it is permanent.
        lasts: amount::TIMES,
        /// The time after which a robot that died is back; without it, it never comes back.
        back_after: amount::TIMES,
        /// The probability that it happens. By default 100%.
        probability: amount::PROBABILITY,
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum What {
    Dies,
    Stalls,
    Refuses,
    LinkDown,
}

const WHAT_WORDS: [(&str, What); 4] = [
    ("dies", What::Dies),
    ("stalls", What::Stalls),
    ("refuses", What::Refuses),
    ("link_down", What::LinkDown),
];

/// A fault of robots or of their links.
#[derive(Clone, Debug, PartialEq)]
pub struct Incident {
    /// The affected robots, as indices into the fleet. Whether and when the incident happens is random, and drawn separately for each
    /// robot.
    pub robots: Vec<usize>,
    /// The kind of fault.
    pub trouble: Trouble,
    /// The act whose start is the reference for the time `at`: the start as planned when the act is first sent. `None` if `at` counts from
    /// the beginning of the mission. If the incident is a refusal, the reference is the time at which the act is sent instead.
    pub act: Option<String>,
    /// The time of the fault, counted from the start of `act` or of the mission.
    pub at: Between<Span>,
    /// Probability that the incident happens, from 0 to 1.
    pub probability: f64,
}

/// The kind of fault.
#[derive(Clone, Debug, PartialEq)]
pub enum Trouble {
    /// The robot's process and its connections end. The robot restarts after some time, or never.
    Dies {
        /// The time until the restart. `None` if the robot never restarts.
        back_after: Option<Between<Span>>,
    },
    /// The robot stalls: it executes no commands, answers no requests, and then continues as if no time had passed.
    Stalls {
        /// The duration of the stall.
        lasts: Between<Span>,
    },
    /// The robot refuses all movements, as if it were busy.
    Refuses {
        /// The duration of the refusal. `None` if it is permanent.
        lasts: Option<Between<Span>>,
    },
    /// No messages pass on the robot's link.
    LinkDown {
        /// The duration of the interruption.
        lasts: Between<Span>,
    },
}

/// Reads the remaining keys of an incident, after its robots and its act have been read.
pub(super) fn read(
    findings: &mut Reader,
    whole: &At<'_>,
    keys: &IncidentKeys<'_>,
    robots: Vec<usize>,
    act: Option<String>,
) -> Option<Incident> {
    let what = keys.what.and_then(|at| findings.word(&at, &WHAT_WORDS));
    let at = keys.at.map(|at| (at, between(findings, &at, amount::signed_duration)));
    if let (Some((place, Some(at))), None) = (&at, &act)
        && at.least < Span::ZERO
        && keys.act.is_none()
    {
        let hint = Some("add `act` to count the time from the start of an act".to_owned());
        let message = "the time is before the start of the mission";
        findings.add(Code::BadDuration, place.place(), message, "a time of at least 0", hint);
    }
    let lasts = keys.lasts.map(|at| between(findings, &at, amount::positive_duration));
    let back_after = keys.back_after.map(|at| between(findings, &at, amount::positive_duration));
    let probability = keys.probability.map(|at| amount::probability(findings, &at));
    let what = what?;
    unneeded(
        findings,
        keys.lasts.as_ref(),
        "lasts",
        what == What::Dies,
        "use `back_after` for the time until the robot returns",
    );
    let sent = what == What::Refuses && keys.act.is_some();
    unneeded(
        findings,
        keys.at.as_ref(),
        "at",
        sent,
        "leave `at` out: with `act`, the robot refuses everything that is sent for that act",
    );
    let why = "only a robot that dies can come back: use `lasts` to set how long the incident lasts";
    unneeded(findings, keys.back_after.as_ref(), "back_after", what != What::Dies, why);
    if matches!(what, What::Stalls | What::LinkDown) && keys.lasts.is_none() {
        let message = "missing duration of the incident";
        findings.add(Code::MissingKey, whole.place(), message, "a key `lasts`", None);
    }
    let trouble = match what {
        What::Dies => Trouble::Dies { back_after: back_after.map_or(Some(None), |after| after.map(Some))? },
        What::Refuses => Trouble::Refuses { lasts: lasts.map_or(Some(None), |lasts| lasts.map(Some))? },
        What::Stalls => Trouble::Stalls { lasts: lasts?? },
        What::LinkDown => Trouble::LinkDown { lasts: lasts?? },
    };
    Some(Incident {
        robots,
        trouble,
        act,
        at: at.map_or(Some(Between::fixed(Span::ZERO)), |(_, at)| at)?,
        probability: probability.unwrap_or(Some(1.0))?,
    })
}

fn unneeded(findings: &mut Reader, at: Option<&At<'_>>, key: &str, is: bool, hint: &str) {
    if let Some(at) = at.filter(|_| is) {
        let message = format!("`{key}` is not supported for this incident");
        findings.add(
            Code::UnknownKey,
            at.key_place(),
            message,
            "a key that is valid for this kind of incident (see `what`)",
            Some(hint.to_owned()),
        );
    }
}
