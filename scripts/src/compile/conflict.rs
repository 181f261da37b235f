//! Times that contradict each other, told in the lines of the file: the chain, and what would fix it.

use std::collections::HashMap;

use urrcp::Span;

use crate::finding::{Code, Pending, Place};
use crate::scenario::{Act, Anchor, Relation};
use crate::timing::{Bound, Conflict, ConstraintId, Link};

/// Most links of a chain that are told.
const LINKS_MAX: usize = 24;

/// Why a constraint is there.
#[derive(Clone, Debug)]
pub(super) enum Origin {
    Relation { cue: usize, relation: Relation },
    Length { cue: usize, place: Place },
    Limit { cue: usize, robot: String, device: String, place: Place },
    Zone { zone: Option<String>, first: usize, second: usize, auto: bool },
}

pub(super) fn finding(act: &Act, origins: &HashMap<ConstraintId, Origin>, conflict: &Conflict) -> Pending {
    let teller = Teller { act };
    let links: Vec<(&Link, Option<&Origin>)> =
        conflict.chain.iter().map(|link| (link, link.constraint.and_then(|id| origins.get(&id)))).collect();
    let told = links.iter().filter_map(|(link, origin)| Some((*link, (*origin)?))).take(LINKS_MAX);
    let related: Vec<(Place, String)> =
        told.map(|(link, origin)| (teller.place(origin), teller.says(origin, link))).collect();
    let place = related.first().map_or_else(|| act.place.clone(), |(place, _)| place.clone());
    let fixes: Vec<String> = conflict
        .corrections
        .iter()
        .filter_map(|correction| {
            let (link, origin) = links.get(correction.link)?;
            Some(teller.fixes((*origin)?, link, correction.by))
        })
        .collect();
    let hint = match fixes.as_slice() {
        [] => "no single change is enough: there are other contradictions beside this one".to_owned(),
        [only] => only.clone(),
        several => format!("any one of: {}", several.join("; ")),
    };
    Pending {
        code: Code::Conflict,
        place,
        message: format!("these times contradict each other: {} too tight", conflict.excess),
        expected: "times that can all be kept".to_owned(),
        hint: Some(hint),
        related,
    }
}

struct Teller<'a> {
    act: &'a Act,
}

impl Teller<'_> {
    fn name(&self, cue: usize) -> String {
        format!("`{}`", self.act.cues[cue].name)
    }

    fn place(&self, origin: &Origin) -> Place {
        match origin {
            Origin::Relation { relation, .. } => relation.place.clone(),
            Origin::Length { place, .. } | Origin::Limit { place, .. } => place.clone(),
            Origin::Zone { second, .. } => self.act.cues[*second].place.clone(),
        }
    }

    /// `spin` starts, the end of `raise`.
    fn anchor(&self, anchor: &Anchor, cue: usize) -> String {
        match anchor {
            Anchor::Origin => "the act starts".to_owned(),
            Anchor::Start => format!("{} starts", self.name(cue)),
            Anchor::End => format!("{} ends", self.name(cue)),
            Anchor::StartOf(name) => format!("`{name}` starts"),
            Anchor::EndOf(name) => format!("`{name}` ends"),
        }
    }

    fn says(&self, origin: &Origin, link: &Link) -> String {
        let span = link.span;
        match (origin, link.bound) {
            (Origin::Length { cue, .. }, Bound::Min) => format!("{} lasts {span} or more", self.name(*cue)),
            (Origin::Length { cue, .. }, Bound::Max) => format!("{} lasts {span} at most", self.name(*cue)),
            (Origin::Limit { cue, robot, device, .. }, _) => format!(
                "{} lasts {span} or more, since `{device}` of `{robot}` moves no faster",
                self.name(*cue)
            ),
            (Origin::Zone { zone, first, second, auto }, _) => {
                let why = match zone {
                    Some(zone) => format!("zone `{zone}`"),
                    None => "kept apart".to_owned(),
                };
                let order = if *auto { "the order found" } else { "order given" };
                format!(
                    "{} starts after {} has ended ({why}, {order})",
                    self.name(*second),
                    self.name(*first)
                )
            }
            (Origin::Relation { cue, relation }, bound) => self.relation(*cue, relation, bound, span),
        }
    }

    fn relation(&self, cue: usize, relation: &Relation, bound: Bound, span: Span) -> String {
        let to = self.anchor(&relation.to, cue);
        if relation.from == Anchor::Origin {
            return match (relation.min == relation.max, bound) {
                (true, _) => format!("{to} at {span}"),
                (false, Bound::Min) => format!("{to} at {span} or later"),
                (false, Bound::Max) => format!("{to} at {span} or earlier"),
            };
        }
        let from = self.anchor(&relation.from, cue);
        match (relation.min == relation.max, bound, span == Span::ZERO) {
            (true, _, true) => format!("{to} when {from}"),
            (true, _, false) => format!("{to} {span} after {from}"),
            (false, Bound::Min, true) => format!("{to} not before {from}"),
            (false, Bound::Min, false) => format!("{to} {span} or more after {from}"),
            (false, Bound::Max, _) => format!("{to} at most {span} after {from}"),
        }
    }

    /// What loosening a bound by so much means.
    fn fixes(&self, origin: &Origin, link: &Link, by: Span) -> String {
        match (origin, link.bound) {
            (Origin::Length { cue, .. }, Bound::Min) => format!("shorten {} by {by}", self.name(*cue)),
            (Origin::Length { cue, .. }, Bound::Max) => format!("lengthen {} by {by}", self.name(*cue)),
            (Origin::Limit { robot, device, .. }, _) => {
                let needed = link.span - by;
                format!("let `{device}` of `{robot}` move as fast as {needed} needs")
            }
            (Origin::Zone { zone, second, first, .. }, _) => match zone {
                Some(zone) => format!(
                    "let {} begin {by} before {} leaves the zone `{zone}`",
                    self.name(*second),
                    self.name(*first)
                ),
                None => format!("let {} and {} overlap by {by}", self.name(*first), self.name(*second)),
            },
            (Origin::Relation { cue, relation }, bound) => {
                self.mends_relation(*cue, relation, bound, link.span, by)
            }
        }
    }

    fn mends_relation(&self, cue: usize, relation: &Relation, bound: Bound, span: Span, by: Span) -> String {
        let fixed = relation.min == relation.max;
        let name = match &relation.to {
            Anchor::StartOf(name) | Anchor::EndOf(name) => format!("`{name}`"),
            _ => self.name(cue),
        };
        let verb = if matches!(relation.to, Anchor::End | Anchor::EndOf(_)) { "end" } else { "start" };
        if relation.from == Anchor::Origin {
            let new = if bound == Bound::Max { span + by } else { span - by };
            return match (bound, fixed) {
                (Bound::Max, true) => format!("delay {name} by {by}, to {new}"),
                (Bound::Min, true) => format!("start {name} {by} earlier, at {new}"),
                (Bound::Max, false) => format!("let {name} {verb} as late as {new}"),
                (Bound::Min, false) => format!("let {name} {verb} as early as {new}"),
            };
        }
        let from = self.anchor(&relation.from, cue);
        match bound {
            Bound::Max => format!("let {name} {verb} {} after {from}", span + by),
            Bound::Min if span - by >= Span::ZERO => format!("let {name} {verb} {} after {from}", span - by),
            Bound::Min => format!("let {name} {verb} {} before {from}", by - span),
        }
    }
}
