//! Computes the times of an act's cues. The cues' times and relations form a simple temporal network (Dechter, Meiri and Pearl,
//! Artificial Intelligence 49, 1991), which is solved for the earliest schedule.

use std::collections::HashMap;

use downbeat_timing::{ConstraintId, Effort, Event, Network, Ordering, Schedule, Task, order};
use urrcp::{ControlType, Span};

use super::cast::{Cast, Members};
use super::conflict::{self, Origin};
use crate::duration::parse_duration;
use crate::fields::{Name, Reader};
use crate::finding::{Code, Place, names, one_defined, one_of, within_file};
use crate::motion::Stretch;
use crate::plan::{PlannedCue, Repetition};
use crate::scenario::{Act, Anchor, Cue, Motion, Order, Relation};
use crate::shown::shortened;
use crate::slips;

/// The planned time of a cue.
#[derive(Clone, Debug)]
pub(super) struct CueTime {
    pub(super) start: Span,
    pub(super) end: Span,
    /// How the cue's movement is stretched: the length as written, and the planned length.
    pub(super) stretch: Stretch,
    /// Largest delay of the cue's start that does not delay the end of the act.
    pub(super) slack: Span,
    /// Whether the cue determines the end of the act.
    pub(super) critical: bool,
}

/// Returns the time of each cue, and whether the times satisfy all constraints.
pub(super) fn schedule(
    findings: &mut Reader,
    act: &Act,
    members: &[Members],
    cast: &Cast<'_>,
    horizon: Span,
) -> (Vec<CueTime>, bool) {
    let before = findings.found.len();
    let mut times = Timetable::new(act);
    times.ambiguous(findings);
    for (index, cue) in act.cues.iter().enumerate() {
        times.length(index, cue, &members[index]);
        times.limits(index, cue, &members[index], cast);
        for relation in &cue.relations {
            times.relate(findings, index, relation);
        }
    }
    let shared = times.zones(findings);
    times.order_given(&shared);
    let consistent = match times.network.solve() {
        // Orders are searched only if the times are consistent.
        Ok(schedule) if times.in_time(findings, &schedule, horizon) => {
            times.order_auto(findings, &shared, schedule)
        }
        Ok(_) => None,
        Err(conflict) => {
            findings.found.push(conflict::finding(act, &times.origins, &conflict));
            None
        }
    };
    match consistent.filter(|schedule| times.in_time(findings, schedule, horizon)) {
        Some(schedule) => (times.read(&schedule, members), findings.found.len() == before),
        None => (natural(act, members), false),
    }
}

/// Returns the time of each cue as if no other cue existed. These times are used when the written times contradict each other.
fn natural(act: &Act, members: &[Members]) -> Vec<CueTime> {
    let time = |(cue, members): (&Cue, &Members)| {
        let length = match &cue.duration {
            Some(bounds) if bounds.max == Some(bounds.min) => bounds.min,
            Some(bounds) => members.length.max(bounds.min),
            None => members.length,
        };
        let stretch = Stretch { from: members.length, to: length };
        CueTime {
            start: Span::ZERO,
            end: length + members.delay,
            stretch,
            slack: Span::ZERO,
            critical: false,
        }
    };
    act.cues.iter().zip(members).map(time).collect()
}

/// Returns the cues of an act with their times, for display.
pub(super) fn planned(act: &Act, times: &[CueTime]) -> Vec<PlannedCue> {
    let cue = |(cue, time): (&Cue, &CueTime)| PlannedCue {
        name: cue.name.clone(),
        start: time.start,
        end: time.end,
        slack: time.slack,
        critical: time.critical,
        repetition: repetition(cue, time.stretch),
        text: cue.text.clone(),
    };
    act.cues.iter().zip(times).map(cue).collect()
}

/// Returns the repetition in a cue, with the cue's stretched length. If several movements of the cue are repeated, returns the one with
/// the most repetitions.
fn repetition(cue: &Cue, stretch: Stretch) -> Option<Repetition> {
    let others = cue.overrides.iter().map(|(_, movement)| movement).chain(&cue.own);
    let all = std::iter::once(&cue.movement).chain(others).filter_map(|movement| movement.repetition);
    let Repetition { times, length, every } = all.max_by_key(|repetition| repetition.times)?;
    Some(Repetition { times, length: stretch.of(length), every: stretch.of(every) })
}

/// Cues that must not overlap because they need the same resource.
struct Shared {
    /// Name of the zone that the cues share; `None` if they are separated only by the key `apart`.
    zone: Option<String>,
    order: Order,
    cues: Vec<usize>,
}

/// Returns the prefix of a cue's name that comes from its sequence, such as `greet.`. Empty if the cue is not part of a sequence.
fn sequence_of<'n>(name: &'n str, place: &Place) -> &'n str {
    &name[..name.rfind('.').filter(|_| place.used.is_some()).map_or(0, |dot| dot + 1)]
}

/// Returns a hint if `name` is the name of an act, or of a cue in another act.
fn of_acts(findings: &Reader, name: &str) -> Option<String> {
    let order = "acts follow each other in the order of the file, or as set with `next`";
    let name_shown = shortened(name);
    match findings.act_of.get(name) {
        Some(act) => Some(format!("`{name_shown}` is a cue of the act `{}`: {order}", shortened(act))),
        None => findings
            .act_of
            .values()
            .any(|act| act == name)
            .then(|| format!("`{name_shown}` is an act: {order}")),
    }
}

/// The least and the largest time between two events; `None` without such a bound.
#[derive(Clone, Copy)]
struct Bounds {
    min: Option<Span>,
    max: Option<Span>,
}

impl Bounds {
    const fn at_least(min: Span) -> Self {
        Self { min: Some(min), max: None }
    }
}

struct Timetable<'a> {
    act: &'a Act,
    network: Network,
    origins: HashMap<ConstraintId, Origin>,
    /// Start and end event of each cue.
    events: Vec<(Event, Event)>,
    by_name: HashMap<&'a str, Option<usize>>,
}

impl<'a> Timetable<'a> {
    fn new(act: &'a Act) -> Self {
        let mut network = Network::new();
        let events = act.cues.iter().map(|_| (network.event(), network.event())).collect();
        let mut by_name: HashMap<&str, Option<usize>> = HashMap::new();
        for (index, cue) in act.cues.iter().enumerate() {
            // A duplicate name cannot be referred to.
            by_name.entry(&cue.name).and_modify(|known| *known = None).or_insert(Some(index));
        }
        Self { act, network, origins: HashMap::new(), events, by_name }
    }

    fn constrain(&mut self, from: Event, to: Event, bounds: Bounds, origin: Origin) {
        let id = self.network.constrain(from, to, bounds.min, bounds.max);
        self.origins.insert(id, origin);
    }

    /// Adds the length of a cue to the constraints: that of its movement, or the bounds of its `duration`.
    fn length(&mut self, index: usize, cue: &Cue, members: &Members) {
        let (start, end) = self.events[index];
        let (min, max, place) = match &cue.duration {
            Some(bounds) => (bounds.min, bounds.max, &bounds.place),
            None => (members.length, Some(members.length), &cue.place),
        };
        let bounds = Bounds { min: Some(min + members.delay), max: max.map(|max| max + members.delay) };
        self.constrain(
            start,
            end,
            bounds,
            Origin::Length { cue: index, delay: members.delay, place: place.clone() },
        );
    }

    /// Adds a lower bound for the length of a stretchable cue: the time that the speed and acceleration limits of its devices require.
    fn limits(&mut self, index: usize, cue: &Cue, members: &Members, cast: &Cast<'_>) {
        let Some(bounds) = cue.duration.as_ref().filter(|bounds| bounds.max != Some(bounds.min)) else {
            return;
        };
        let mut largest: Option<(Span, usize, String)> = None;
        for member in &members.all {
            let movement = cue.movement_of(member);
            for track in &movement.tracks {
                let (Motion::Curve(curve), Some(device)) =
                    (&track.motion, cast.device(member.robot, &track.device))
                else {
                    continue;
                };
                let limits =
                    cast.limits(member.robot, device, track.control.unwrap_or(ControlType::Position));
                let peaks = curve.peaks();
                let worst = |limit: Option<f64>, rate: fn((f64, f64)) -> f64| {
                    let rates = (1..curve.knots.len()).map(|knot| rate(curve.peak_rates(knot, &peaks)));
                    limit.map_or(0.0, |limit| rates.fold(0.0, f64::max) / limit)
                };
                // If a movement is stretched by a factor, speeds are divided by the factor and accelerations by its square.
                let factor = worst(limits.speed, |rates| rates.0)
                    .max(worst(limits.acceleration, |rates| rates.1).sqrt());
                let needed = Span::from_millis_f64(movement.length.as_millis_f64() * factor);
                if needed > bounds.min && largest.as_ref().is_none_or(|(known, ..)| needed > *known) {
                    largest = Some((needed, member.robot, track.device.clone()));
                }
            }
        }
        if let Some((needed, robot, device)) = largest {
            let (start, end) = self.events[index];
            let origin = Origin::Limit {
                cue: index,
                robot: cast.id(robot).to_string(),
                device,
                place: bounds.place.clone(),
            };
            self.constrain(start, end, Bounds::at_least(needed + members.delay), origin);
        }
    }

    fn relate(&mut self, findings: &mut Reader, index: usize, relation: &Relation) {
        let from = self.event(findings, index, &relation.from, relation);
        let to = self.event(findings, index, &relation.to, relation);
        if let (Some(from), Some(to)) = (from, to) {
            let origin = Origin::Relation { cue: index, relation: relation.clone() };
            self.constrain(from, to, Bounds { min: relation.min, max: relation.max }, origin);
        }
    }

    fn event(
        &self,
        findings: &mut Reader,
        index: usize,
        anchor: &Anchor,
        relation: &Relation,
    ) -> Option<Event> {
        let other = |findings: &mut Reader, name: &str| {
            let name = Name { text: name.to_owned(), place: relation.place.clone() };
            let cue = self.cue(findings, &name)?;
            if cue == index {
                let message = format!("`{}` cannot follow or precede itself", shortened(&name.text));
                let hint = Some("name another cue, or set a time with `at`".to_owned());
                findings.add(Code::Conflict, name.place, message, "another cue", hint);
                return None;
            }
            Some(self.events[cue])
        };
        Some(match anchor {
            Anchor::Origin => self.network.origin(),
            Anchor::Start => self.events[index].0,
            Anchor::End => self.events[index].1,
            Anchor::StartOf(name) => other(findings, name)?.0,
            Anchor::EndOf(name) => other(findings, name)?.1,
        })
    }

    fn cue(&self, findings: &mut Reader, name: &Name) -> Option<usize> {
        match self.by_name.get(name.text.as_str()) {
            // `ambiguous` reports names that several cues have.
            Some(index) => *index,
            None => {
                let (prefix, text) = name.text.split_at(sequence_of(&name.text, &name.place).len());
                let known = || self.act.cues.iter().filter_map(|cue| cue.name.strip_prefix(prefix));
                let hint = if parse_duration(text).is_some() {
                    Some(format!("write a time under `at`: `at: {}`", shortened(text)))
                } else {
                    of_acts(findings, text)
                        .or_else(|| relation(text, known()))
                        .or_else(|| slips::several_names(text, known()))
                        .or_else(|| within_file(text, known()))
                        .or_else(|| findings.did_you_mean(text, known()))
                        .or_else(|| slips::earlier_cue(text))
                };
                let message = format!("no cue `{}`", shortened(text));
                let expected = one_of(known());
                findings.add(Code::UnknownCue, name.place.clone(), message, expected, hint);
                None
            }
        }
    }

    /// Reports each name that several cues share. There is only one finding for each name, at the second of its cues.
    fn ambiguous(&self, findings: &mut Reader) {
        let mut cues_of: HashMap<&str, Vec<&Cue>> = HashMap::new();
        for cue in &self.act.cues {
            let cues = cues_of.entry(&cue.name).or_default();
            cues.push(cue);
            let [first, second] = cues.as_slice() else { continue };
            let called =
                shortened(cue.name.strip_prefix(sequence_of(&cue.name, &cue.place)).unwrap_or(&cue.name));
            let related = vec![
                (second.place.of_key("cue"), format!("another cue called `{called}`")),
                (first.place.of_key("cue"), format!("the first cue called `{called}`")),
            ];
            let message = format!("duplicate cue name `{called}`");
            let hint = Some("rename one of them".to_owned());
            findings.add_related(Code::NameTwice, related, message, "a unique name", hint);
        }
    }

    /// Returns the resources that cues share, in the order of their first use.
    fn zones(&self, findings: &mut Reader) -> Vec<Shared> {
        let mut shared: Vec<Shared> = Vec::new();
        let mut index_of: HashMap<&str, usize> = HashMap::new();
        // The act's own zones follow those of the scenario and override them.
        let orders: HashMap<&str, Order> =
            self.act.zones.iter().map(|(name, order)| (name.as_str(), *order)).collect();
        for (index, cue) in self.act.cues.iter().enumerate() {
            for zone in &cue.uses {
                let Some(order) = orders.get(zone.text.as_str()) else {
                    if findings.is_wrong("zones") {
                        continue;
                    }
                    let known = || self.act.zones.iter().map(|(name, _)| name.as_str());
                    let message = format!("no zone `{}`", shortened(&zone.text));
                    let hint = findings
                        .did_you_mean(&zone.text, known())
                        .or(Some("list it under `zones` at the top of the scenario".to_owned()));
                    let expected = one_defined("zone", known());
                    findings.add(Code::UnknownZone, zone.place.clone(), message, expected, hint);
                    continue;
                };
                let at = *index_of.entry(&zone.text).or_insert_with(|| {
                    shared.push(Shared { zone: Some(zone.text.clone()), order: *order, cues: Vec::new() });
                    shared.len() - 1
                });
                if shared[at].cues.last() != Some(&index) {
                    shared[at].cues.push(index);
                }
            }
            for other in &cue.apart {
                if let Some(other) = self.cue(findings, other).filter(|other| *other != index) {
                    shared.push(Shared {
                        zone: None,
                        order: self.act.order,
                        cues: vec![index.min(other), index.max(other)],
                    });
                }
            }
        }
        shared
    }

    /// For each zone with the order `given`, constrains its cues to the order of the file.
    fn order_given(&mut self, shared: &[Shared]) {
        for zone in shared.iter().filter(|zone| zone.order == Order::Given) {
            for pair in zone.cues.windows(2) {
                self.follow(pair[0], pair[1], zone);
            }
        }
    }

    fn follow(&mut self, first: usize, second: usize, zone: &Shared) {
        let (from, to) = (self.events[first].1, self.events[second].0);
        let origin = Origin::Zone { zone: zone.zone.clone(), first, second, auto: zone.order == Order::Auto };
        self.constrain(from, to, Bounds::at_least(Span::ZERO), origin);
    }

    /// Whether all cues have ended at `horizon`; otherwise reports the first one that has not.
    fn in_time(&self, findings: &mut Reader, schedule: &Schedule, horizon: Span) -> bool {
        let ends = self.events.iter().map(|(_, end)| schedule.time(*end));
        let late = ends.enumerate().filter(|(_, end)| *end > horizon).min_by_key(|(_, end)| *end);
        let Some((index, end)) = late else { return true };
        let (cue, start) = (&self.act.cues[index], schedule.time(self.events[index].0));
        let message = format!("the cue `{}` starts at {start} and ends at {end}", shortened(&cue.name));
        let hint = if start > horizon {
            "start it earlier: shorten the cues and pauses before it"
        } else {
            "shorten it: reduce `duration`, `repeat`, `canon` or `delay`"
        };
        let expected = format!("an end at {horizon} or earlier");
        findings.add(Code::TooMuch, cue.place.clone(), message, expected, Some(hint.to_owned()));
        false
    }

    /// For each zone with the order `auto`, finds an order of its cues that makes the whole act short.
    fn order_auto(
        &mut self,
        findings: &mut Reader,
        shared: &[Shared],
        schedule: Schedule,
    ) -> Option<Schedule> {
        let auto: Vec<_> =
            shared.iter().filter(|zone| zone.order == Order::Auto && zone.cues.len() > 1).collect();
        if auto.is_empty() {
            return Some(schedule);
        }
        let limit = Span::from_nanos(i64::MAX / 4);
        if self.network.total() > limit {
            let message = "the times of this act add up to more than the automatic ordering supports";
            let hint = Some("shorten its cues, or keep the order of the file with `order: given`".to_owned());
            let place = self.act.cues[auto[0].cues[0]].place.clone();
            findings.add(Code::TooMuch, place, message, format!("at most {limit}"), hint);
            return None;
        }
        let task = |zone: usize| {
            let events = &self.events;
            move |cue: &usize| Task { start: events[*cue].0, end: events[*cue].1, zone }
        };
        let tasks: Vec<Task> =
            auto.iter().enumerate().flat_map(|(index, zone)| zone.cues.iter().map(task(index))).collect();
        let sequences = match order(&self.network, &tasks, Effort::default()) {
            Ordering::Found(found) => found.sequences,
            failed => {
                let zones = names(auto.iter().filter_map(|zone| zone.zone.as_deref()));
                let has_zones = auto.iter().any(|zone| zone.zone.is_some());
                let cues = match (has_zones, auto.iter().any(|zone| zone.zone.is_none())) {
                    (true, true) => format!("that use {zones} or are kept `apart`"),
                    (true, false) => format!("that use {zones}"),
                    (false, _) => "that are kept `apart`".to_owned(),
                };
                let proven = matches!(failed, Ordering::Infeasible(_));
                let message = if proven {
                    format!("no order satisfies all time limits of the cues {cues}")
                } else {
                    format!("found no order that satisfies all time limits of the cues {cues}")
                };
                let hint = match (proven, has_zones) {
                    (true, true) => "allow more time, or remove a cue from the zone",
                    (true, false) => "allow more time, or remove a cue from `apart`",
                    (false, _) => {
                        "the search may have missed a valid order: allow more time, or order some cues with `after`"
                    }
                };
                let place = self.act.cues[auto[0].cues[0]].place.clone();
                findings.add(
                    Code::NoOrder,
                    place,
                    message,
                    "an order that meets all deadlines",
                    Some(hint.to_owned()),
                );
                return None;
            }
        };
        let cue_of: HashMap<Event, usize> =
            self.events.iter().enumerate().map(|(cue, (start, _))| (*start, cue)).collect();
        for (zone, sequence) in auto.iter().zip(sequences) {
            let cues: Vec<_> =
                sequence.iter().filter_map(|task| cue_of.get(&tasks[*task].start).copied()).collect();
            for pair in cues.windows(2) {
                self.follow(pair[0], pair[1], zone);
            }
        }
        self.network.solve().ok()
    }

    fn read(&self, schedule: &Schedule, members: &[Members]) -> Vec<CueTime> {
        let latest = self.network.latest(schedule.makespan());
        let critical = self.network.critical(schedule);
        let time = |((first, last), members): (&(Event, Event), &Members)| {
            let (start, end) = (schedule.time(*first), schedule.time(*last));
            let stretch = Stretch { from: members.length, to: end - start - members.delay };
            let slack = latest.as_ref().map_or(Span::ZERO, |latest| latest.time(*first) - start);
            // If a cue can start later although its end is critical, another cue holds its end.
            let critical = slack == Span::ZERO && (critical.contains(first) || critical.contains(last));
            CueTime { start, end, stretch, slack, critical }
        };
        self.events.iter().zip(members).map(time).collect()
    }
}

/// Suggests the correct form of a relation: with spaces around its sign, and with its start or end in words.
fn relation<'k>(text: &str, known: impl Iterator<Item = &'k str> + Clone) -> Option<String> {
    let is_known = |name: &str| known.clone().any(|known| known == name);
    let signed = ['+', '-'].iter().find_map(|sign| {
        let (name, gap) = text.split_once(*sign)?;
        let (name, gap) = (name.trim(), gap.trim());
        (is_known(name) && parse_duration(gap).is_some()).then(|| format!("write `{name} {sign} {gap}`"))
    });
    let unsigned = || {
        let (name, gap) = text.rsplit_once(' ')?;
        (is_known(name) && parse_duration(gap).is_some()).then(|| format!("write `{name} + {gap}`"))
    };
    let end = || {
        let ends =
            [("start ", ""), ("end ", ""), ("", ".start"), ("", ".end"), ("", "'s start"), ("", "'s end")];
        ends.iter().find_map(|(before, after)| {
            let name = text.strip_prefix(before)?.strip_suffix(after)?;
            let end = if before.contains("end") || after.contains("end") { "end" } else { "start" };
            is_known(name).then(|| format!("write `{end} of {name}`"))
        })
    };
    signed.or_else(unsigned).or_else(end)
}
