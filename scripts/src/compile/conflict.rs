//! Reports contradictory times with the lines of the file: the chain of bounds that contradict each other, and possible corrections.

use std::collections::HashMap;

use downbeat_timing::{Bound, Conflict, ConstraintId, Link};
use urrcp::Span;

use crate::duration::written;
use crate::finding::{Code, PathStep, Pending, Place, names};
use crate::scenario::{Act, Anchor, Bounds, Relation};

/// Maximum number of bounds that are reported for one chain of contradictory bounds.
const LINKS_MAX: usize = 24;

/// The origin of a timing constraint in the scenario.
#[derive(Clone, Debug)]
pub(super) enum Origin {
    Relation {
        cue: usize,
        relation: Relation,
    },
    /// The duration of a cue. The last robot of the cue begins after `delay`, which prolongs the cue.
    Length {
        cue: usize,
        delay: Span,
        place: Place,
    },
    Limit {
        cue: usize,
        robot: String,
        device: String,
        place: Place,
    },
    Zone {
        zone: Option<String>,
        first: usize,
        second: usize,
        auto: bool,
    },
}

pub(super) fn finding(act: &Act, origins: &HashMap<ConstraintId, Origin>, conflict: &Conflict) -> Pending {
    let teller = Teller { act };
    let links: Vec<(&Link, Option<&Origin>)> =
        conflict.chain.iter().map(|link| (link, link.constraint.and_then(|id| origins.get(&id)))).collect();
    let known = links.iter().filter_map(|(link, origin)| Some((*link, (*origin)?))).take(LINKS_MAX);
    let related: Vec<(Place, String)> =
        known.map(|(link, origin)| (teller.place(origin), teller.says(origin, link))).collect();
    let place = related.first().map_or_else(|| act.place.clone(), |(place, _)| place.clone());
    let fixes: Vec<String> = conflict
        .corrections
        .iter()
        .filter_map(|correction| {
            let (link, origin) = links.get(correction.link)?;
            teller.fixes((*origin)?, link, correction.by)
        })
        .collect();
    if is_circle(&links) {
        return circle(&teller, &links, place, related);
    }
    let hint = match fixes.as_slice() {
        [] => "no single change is enough: there are other contradictions".to_owned(),
        [only] => only.clone(),
        several => format!("make one of these changes: {}", several.join("; ")),
    };
    Pending {
        code: Code::Conflict,
        place,
        message: format!("these times contradict each other by {}", told(conflict.excess)),
        expected: "times without contradictions".to_owned(),
        hint: Some(hint),
        related,
        affected: None,
        hint_in_block: None,
    }
}

/// Whether cues wait for each other in a circle: each link makes one cue follow another, and no link is a fixed time or a deadline.
fn is_circle(links: &[(&Link, Option<&Origin>)]) -> bool {
    links.iter().all(|(link, origin)| match origin {
        Some(Origin::Length { .. } | Origin::Limit { .. }) => link.bound == Bound::Min,
        Some(Origin::Zone { .. }) => true,
        Some(Origin::Relation { relation, .. }) => {
            let anchors = [&relation.from, &relation.to];
            is_written(relation)
                && !anchors.contains(&&Anchor::Origin)
                && link.span >= Span::ZERO
                && link.bound == Bound::Min
        }
        None => false,
    })
}

/// Reports cues that wait for each other in a circle.
fn circle(
    teller: &Teller<'_>,
    links: &[(&Link, Option<&Origin>)],
    place: Place,
    related: Vec<(Place, String)>,
) -> Pending {
    let mut waits: Vec<(usize, Option<&Relation>)> = Vec::new();
    for origin in links.iter().filter_map(|(_, origin)| *origin) {
        match origin {
            Origin::Relation { cue, relation } => waits.push((*cue, Some(relation))),
            Origin::Zone { second, .. } => waits.push((*second, None)),
            Origin::Length { .. } | Origin::Limit { .. } => {}
        }
    }
    let mut cues: Vec<usize> = waits.iter().map(|(cue, _)| *cue).collect();
    cues.dedup();
    let written = waits.iter().filter_map(|(cue, relation)| Some((*cue, (*relation)?)));
    let out: Vec<String> = written
        .map(|(cue, relation)| {
            let edit = edit(
                &teller.in_its_file(cue, relation),
                relation.min,
                relation.max.filter(|_| relation.min == relation.max),
            );
            format!("`{edit}` of {}", teller.name(cue))
        })
        .collect();
    let message = match cues.as_slice() {
        [only] => format!("the cue {} waits for itself", teller.name(*only)),
        several => format!(
            "the cues {} form a cycle",
            names(several.iter().map(|cue| teller.act.cues[*cue].name.as_str()))
        ),
    };
    Pending {
        code: Code::Conflict,
        place,
        message,
        expected: "a cue that does not wait for any of the others".to_owned(),
        hint: Some(format!("remove one of these: {}", out.join("; "))),
        related,
        affected: None,
        hint_in_block: None,
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

    /// Describes an instant, for example `` `spin` starts `` or `` `raise` ends ``.
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
        let span = told(link.span);
        match (origin, link.bound) {
            (Origin::Length { cue, .. }, Bound::Min) => format!("{} lasts at least {span}", self.name(*cue)),
            (Origin::Length { cue, .. }, Bound::Max) => format!("{} lasts at most {span}", self.name(*cue)),
            (Origin::Limit { cue, robot, device, .. }, _) => format!(
                "{} lasts at least {span}, because `{device}` of `{robot}` cannot move faster",
                self.name(*cue)
            ),
            (Origin::Zone { zone, first, second, auto }, _) => {
                let why = match zone {
                    Some(zone) => format!("zone `{zone}`"),
                    None => "kept apart".to_owned(),
                };
                let order = if *auto { "order found automatically" } else { "order given in the file" };
                format!(
                    "{} starts after {} has ended ({why}, {order})",
                    self.name(*second),
                    self.name(*first)
                )
            }
            (Origin::Relation { cue, relation }, bound) => self.relation(*cue, relation, bound, link.span),
        }
    }

    fn relation(&self, cue: usize, relation: &Relation, bound: Bound, span: Span) -> String {
        let to = self.anchor(&relation.to, cue);
        let together = span == Span::ZERO;
        let span = told(span);
        if relation.from == Anchor::Origin {
            return match (relation.min == relation.max, bound) {
                (true, _) => format!("{to} at {span}"),
                (false, Bound::Min) => format!("{to} at {span} or later"),
                (false, Bound::Max) => format!("{to} at {span} or earlier"),
            };
        }
        let from = self.anchor(&relation.from, cue);
        match (relation.min == relation.max, bound, together) {
            (true, _, true) => format!("{to} when {from}"),
            (true, _, false) => format!("{to} {span} after {from}"),
            (false, Bound::Min, true) => format!("{} before {from}", negated(&to)),
            (false, Bound::Min, false) => format!("{to} at least {span} after {from}"),
            (false, Bound::Max, _) => format!("{to} at most {span} after {from}"),
        }
    }

    /// Describes how to correct a bound, as an edit if a single one suffices. `None` if the bound would disappear.
    fn fixes(&self, origin: &Origin, link: &Link, by: Span) -> Option<String> {
        Some(match origin {
            Origin::Length { cue, delay, .. } => return self.fixes_length(*cue, *delay, link, by),
            Origin::Limit { robot, device, .. } => {
                let needed = written(link.span - by);
                format!("raise the limits of `{device}` of `{robot}` so that {needed} is enough")
            }
            Origin::Zone { zone, second, first, .. } => {
                let (first, second, by) = (self.name(*first), self.name(*second), written(by));
                match zone {
                    Some(zone) => {
                        format!("allow {second} to start {by} before {first} leaves the zone `{zone}`")
                    }
                    None => format!("allow {first} and {second} to overlap by {by}"),
                }
            }
            // The relation that keeps a sequence's cues within the sequence has no line of its own.
            Origin::Relation { relation, .. } if !is_written(relation) => return None,
            Origin::Relation { cue, relation } => self.fixes_relation(*cue, relation, link, by),
        })
    }

    fn fixes_length(&self, cue: usize, delay: Span, link: &Link, by: Span) -> Option<String> {
        let (verb, length) = match link.bound {
            Bound::Min => ("shorten", link.span - by - delay),
            Bound::Max => ("lengthen", link.span + by - delay),
        };
        let duration = match (&self.act.cues[cue].duration, link.bound) {
            (Some(Bounds { max: Some(max), min, .. }), Bound::Min) if min != max => {
                format!("{}..{}", written(length), written(*max))
            }
            (Some(Bounds { max: Some(max), min, .. }), Bound::Max) if min != max => {
                format!("{}..{}", written(*min), written(length))
            }
            _ => written(length),
        };
        let name = self.name(cue);
        (length > Span::ZERO).then(|| format!("{verb} {name} by {}: `duration: {duration}`", written(by)))
    }

    /// Returns a relation with the names that its cues have within the file of their sequence, without the prefix that the scenario adds.
    fn in_its_file(&self, cue: usize, relation: &Relation) -> Relation {
        let mut relation = relation.clone();
        if relation.place.used.is_some() {
            let own = &self.act.cues[cue].name;
            for anchor in [&mut relation.from, &mut relation.to] {
                if let Anchor::StartOf(name) | Anchor::EndOf(name) = anchor {
                    let same = own.bytes().zip(name.bytes()).take_while(|(own, other)| own == other).count();
                    let prefix = name.get(..same).and_then(|same| same.rfind('.')).map_or(0, |dot| dot + 1);
                    *name = name.split_off(prefix);
                }
            }
        }
        relation
    }

    fn fixes_relation(&self, cue: usize, relation: &Relation, link: &Link, by: Span) -> String {
        let fixed = relation.min == relation.max;
        let name = match &relation.to {
            Anchor::StartOf(name) | Anchor::EndOf(name) => format!("`{name}`"),
            _ => self.name(cue),
        };
        let verb = if matches!(relation.to, Anchor::End | Anchor::EndOf(_)) { "end" } else { "start" };
        let new = if link.bound == Bound::Max { link.span + by } else { link.span - by };
        let (min, max) = match link.bound {
            _ if fixed => (Some(new), Some(new)),
            Bound::Min => (Some(new), relation.max),
            Bound::Max => (relation.min, Some(new)),
        };
        let edit = edit(&self.in_its_file(cue, relation), min, max);
        let by = written(by);
        if relation.from == Anchor::Origin {
            return match (link.bound, fixed) {
                (Bound::Max, true) => format!("delay {name} by {by}: `{edit}`"),
                (Bound::Min, true) => format!("start {name} {by} earlier: `{edit}`"),
                (Bound::Max, false) => format!("let {name} {verb} {by} later: `{edit}`"),
                (Bound::Min, false) => format!("let {name} {verb} {by} earlier: `{edit}`"),
            };
        }
        let from = self.anchor(&relation.from, cue);
        let lag = if new >= Span::ZERO {
            format!("{} after", written(new))
        } else {
            format!("{} before", written(-new))
        };
        format!("let {name} {verb} {lag} {from}: `{edit}`")
    }
}

/// Whether the file states the relation under one of the keys for relations.
fn is_written(relation: &Relation) -> bool {
    let keys = ["at", "after", "with", "before", "end_by"];
    let is_key = |part: &PathStep| matches!(part, PathStep::Key(key, _) if keys.contains(&key.as_str()));
    relation.place.path.iter().rev().take(2).any(is_key)
}

/// Returns the key and value of a relation with other bounds, as written in a file.
fn edit(relation: &Relation, min: Option<Span>, max: Option<Span>) -> String {
    let of_key = |part: &PathStep| match part {
        PathStep::Key(key, _) => Some(key.clone()),
        PathStep::Index(_) => None,
    };
    let key = relation.place.path.iter().rev().find_map(of_key).unwrap_or_default();
    let range = match (min, max) {
        (Some(min), Some(max)) if min != max => format!("{}..{}", written(min), written(max)),
        (Some(one), _) | (None, Some(one)) => written(one),
        (None, None) => String::new(),
    };
    let (other, unsaid, sign) = match key.as_str() {
        "after" => (&relation.from, End::End, '+'),
        "before" => (&relation.to, End::Start, '-'),
        "with" => (&relation.from, End::Start, '+'),
        _ => return format!("{key}: {range}"),
    };
    let target = match (other, unsaid) {
        (Anchor::StartOf(name), End::Start) | (Anchor::EndOf(name), End::End) => name.clone(),
        (Anchor::StartOf(name), End::End) => format!("start of {name}"),
        (Anchor::EndOf(name), End::Start) => format!("end of {name}"),
        _ => String::new(),
    };
    match range.as_str() {
        "0s" => format!("{key}: {target}"),
        _ => format!("{key}: {target} {sign} {range}"),
    }
}

/// The instant of a cue that a key refers to by default.
enum End {
    Start,
    End,
}

/// Formats a time for display. Adds the exact value if rounding changes it.
pub(super) fn told(span: Span) -> String {
    let unit = match span.abs().as_nanos() {
        1_000_000_000.. => 1_000_000,
        1_000_000.. => 1_000,
        _ => 1,
    };
    if span.as_nanos() % unit == 0 { span.to_string() } else { written(span) }
}

/// Negates a description of an instant: `` `spin` starts `` becomes `` `spin` does not start ``.
fn negated(anchor: &str) -> String {
    let (who, verb) = anchor.rsplit_once(' ').unwrap_or(("", anchor));
    format!("{who} does not {}", verb.trim_end_matches('s'))
}
