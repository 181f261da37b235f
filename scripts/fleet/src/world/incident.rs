//! What goes wrong in a world, and when.

use urrcp::Span;

use super::amount::{self, Between, between};
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::{keys, words};
use downbeat_yaml::finding::Code;

keys! {
    /// What goes wrong.
    pub(crate) struct IncidentKeys as "incident" {
        /// A robot, a group, or `all`: it is drawn for each of them.
        #[required]
        robot: kinds::NAME,
        /// What goes wrong.
        #[required]
        what: words!(WHAT_WORDS),
        /// The act from whose planned start `at` is counted; without it from the beginning of the mission.
        act: kinds::NAME,
        /// When. By default 0s.
        at: amount::SIGNED_TIMES,
        /// For how long; `refuses` without it: for good.
        lasts: amount::TIMES,
        /// When a robot that died is back; without it never.
        back_after: amount::TIMES,
        /// How likely it happens. By default 100%.
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

/// Something that goes wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Incident {
    /// Each of these robots, as indices into the fleet; whether and when is drawn for each of them.
    pub robots: Vec<usize>,
    /// What goes wrong.
    pub trouble: Trouble,
    /// It is counted from the planned start of the act of this name, when that is sent for the first time; `None`: from the beginning
    /// of the mission. What is refused is refused from when the act is sent on.
    pub act: Option<String>,
    /// When it happens.
    pub at: Between<Span>,
    /// Probability that it happens.
    pub probability: f64,
}

/// What goes wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum Trouble {
    /// The robot's process ends, and its connections with it. It begins again after a while, or never.
    Dies {
        /// After how long.
        back_after: Option<Between<Span>>,
    },
    /// The robot stands still: it executes nothing, answers nothing, and goes on as if no time had passed.
    Stalls {
        /// For how long.
        lasts: Between<Span>,
    },
    /// The robot refuses every movement, as if it were busy.
    Refuses {
        /// For how long; `None`: for good.
        lasts: Option<Between<Span>>,
    },
    /// Nothing passes on the robot's link.
    LinkDown {
        /// For how long.
        lasts: Between<Span>,
    },
}

/// The rest of an incident, whose robots and act are known.
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
        let hint = Some("`act` names the act from whose start it is counted".to_owned());
        let message = "the mission has not begun by then";
        findings.add(Code::BadDuration, place.place(), message, "a time from the beginning on", hint);
    }
    let lasts = keys.lasts.map(|at| between(findings, &at, amount::positive_duration));
    let back_after = keys.back_after.map(|at| between(findings, &at, amount::positive_duration));
    let probability = keys.probability.map(|at| amount::probability(findings, &at));
    let what = what?;
    unneeded(findings, keys.lasts.as_ref(), "lasts", what == What::Dies, "`back_after` says when it is back");
    let sent = what == What::Refuses && keys.act.is_some();
    unneeded(findings, keys.at.as_ref(), "at", sent, "it refuses what it is sent for the act");
    let why = "only a robot that dies comes back; `lasts` says for how long";
    unneeded(findings, keys.back_after.as_ref(), "back_after", what != What::Dies, why);
    if matches!(what, What::Stalls | What::LinkDown) && keys.lasts.is_none() {
        let message = "it is not said for how long";
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
        let message = format!("`{key}` does not belong to this incident");
        findings.add(
            Code::UnknownKey,
            at.key_place(),
            message,
            "keys that fit `what`",
            Some(hint.to_owned()),
        );
    }
}
