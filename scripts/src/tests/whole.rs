//! The second reading for whole scenarios: acts, groups, cues that relate to each other, zones, tempo and what is done with
//! movements. Times are whole numbers and fractions, solved by the plainest way there is; movements are evaluated point by
//! point, and step by step where a device plays them as they are written.
//!
//! It looks at 500 scenarios, with `DOWNBEAT_SCENARIOS` at as many.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::io::Write as _;

use num_rational::Ratio;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use super::robot;
use super::verified::{Change, Movement, NEAR, changes, final_value, looked_at, meant, movements, played};
use crate::{Act, Code, Compiled, Files, Finding, Fleet, FleetRobot, Severity, Source, compile};

type Nanos = i128;
const MS: Nanos = 1_000_000;

/// The devices of every robot: its name, whether it moves, its granularity, and the steps of one script.
const DEVICES: [(&str, bool, f64, usize); 6] = [
    ("pole", true, 0.001, 100_000),
    ("crane", true, 0.5, 100_000),
    ("chain", true, 0.5, 7),
    ("valve", false, 0.5, 100_000),
    ("tap", false, 0.5, 9),
    ("gate", false, 0.5, 100_000),
];
const ROBOTS: [&str; 3] = ["a", "b", "c"];
/// Names that stand for robots.
const NAMES: [(&str, &[usize]); 7] = [
    ("a", &[0]),
    ("b", &[1]),
    ("c", &[2]),
    ("pair", &[2, 0]),
    ("all", &[0, 1, 2]),
    ("cast", &[1, 2]),
    ("[c, a]", &[2, 0]),
];

/// A cue with one movement.
#[derive(Clone, Debug)]
struct Cue {
    who: usize,
    device: usize,
    movement: Movement,
    /// Where each keyframe lies in quarters of a beat, and its value: then it is played as it is written.
    beats: Option<Vec<(i64, f64)>>,
    change: Change,
    tolerance: Option<f64>,
    canon: Option<i64>,
    late: Option<(usize, i64)>,
    stretch: Option<(i64, i64)>,
    when: When,
    relations: Vec<Relation>,
    zone: Option<usize>,
    apart: Option<usize>,
    /// Part of a move with parameters instead of own tracks.
    by_move: bool,
}

#[derive(Clone, Copy, Debug)]
enum When {
    Free,
    At(i64),
    Between(i64, i64),
    Bar(i64),
    EndBy(i64),
}

/// To another cue, by its index.
#[derive(Clone, Copy, Debug)]
struct Relation {
    word: Word,
    other: usize,
    /// `start of`, `end of`, or neither.
    end: Option<bool>,
    lag: Lag,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Word {
    After,
    With,
    Before,
}

/// Milliseconds, or quarters of a beat.
#[derive(Clone, Copy, Debug)]
enum Lag {
    None,
    One(i64),
    Range(i64, i64),
    Beats(i64),
}

#[derive(Clone, Debug)]
struct Show {
    /// Beats a minute in hundredths.
    tempo: i64,
    auto: bool,
    acts: Vec<Vec<Cue>>,
}

struct Csvs(HashMap<String, String>);

impl Files for Csvs {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        Ok(Source { name: name.into(), text: self.0.get(name).cloned().unwrap_or_default() })
    }
}

fn fleet() -> Fleet {
    let device = |(name, moves, granularity, most): &(&str, bool, f64, usize)| {
        let interpolation = if *moves { "linear" } else { "hold" };
        let error = if *moves {
            if *granularity < 0.1 { r#", "max_error": 0.01"# } else { r#", "max_error": 0.5"# }
        } else {
            ""
        };
        let limits = format!(r#""min_value": -1000, "max_value": 1000, "granularity": {granularity}{error}"#);
        format!(
            r#"{{"id": "{name}", "name": "{name}", "interpolation": "{interpolation}", "script_queue": 10000, "available_control_types": {{
            "position": {{{limits}}}, "script": {{{limits}, "max_number_of_steps": {most}}}}}}}"#
        )
    };
    let devices: Vec<String> = DEVICES.iter().map(device).collect();
    let bot = |id: &&str| {
        let block = format!(r#"{{"id": "{id}", "api_version": "1", "devices": [{}]}}"#, devices.join(", "));
        let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
        FleetRobot { id: init.id.clone(), init: Some(init), ..robot() }
    };
    let robots: Vec<FleetRobot> = ROBOTS.iter().map(bot).collect();
    let group = |members: &[usize]| members.iter().map(|robot| robots[*robot].id.clone()).collect();
    let groups = BTreeMap::from([("pair".to_owned(), group(&[2, 0])), ("all".to_owned(), group(&[0, 1, 2]))]);
    Fleet { robots, groups, ..Fleet::default() }
}

// What is written.

fn name(cue: usize) -> String {
    format!("c{cue}")
}

impl Lag {
    fn yaml(self, sign: char) -> String {
        let signed = |millis: i64| if millis < 0 { format!("-{}ms", -millis) } else { format!("{millis}ms") };
        match self {
            Self::None => String::new(),
            Self::One(millis) if millis < 0 => {
                let other = if sign == '+' { '-' } else { '+' };
                format!(" {other} {}ms", -millis)
            }
            Self::One(millis) => format!(" {sign} {millis}ms"),
            Self::Range(least, largest) => format!(" {sign} {}..{}", signed(least), signed(largest)),
            Self::Beats(quarters) => format!(" {sign} {} beats", quarters as f64 / 4.0),
        }
    }
}

impl Cue {
    fn yaml(&self, index: usize, csvs: &mut HashMap<String, String>, moves: &mut String) -> String {
        let mut yaml = format!("cue: {}, robots: {}", name(index), NAMES[self.who].0);
        match self.when {
            When::Free => {}
            When::At(millis) => yaml.push_str(&format!(", at: {millis}ms")),
            When::Between(least, largest) => yaml.push_str(&format!(", at: {least}ms..{largest}ms")),
            When::Bar(bar) => yaml.push_str(&format!(", at: bar {bar}")),
            When::EndBy(millis) => yaml.push_str(&format!(", end_by: {millis}ms")),
        }
        for (word, key, sign) in
            [(Word::After, "after", '+'), (Word::With, "with", '+'), (Word::Before, "before", '-')]
        {
            let all = self.relations.iter().filter(|relation| relation.word == word);
            let all: Vec<String> = all
                .map(|relation| {
                    let end = match relation.end {
                        None => "",
                        Some(true) => "end of ",
                        Some(false) => "start of ",
                    };
                    format!("\"{end}{}{}\"", name(relation.other), relation.lag.yaml(sign))
                })
                .collect();
            if !all.is_empty() {
                yaml.push_str(&format!(", {key}: [{}]", all.join(", ")));
            }
        }
        if let Some((least, largest)) = self.stretch {
            let duration =
                if least == largest { format!("{least}ms") } else { format!("{least}ms..{largest}ms") };
            yaml.push_str(&format!(", duration: {duration}"));
        }
        yaml.push_str(&self.canon.map_or(String::new(), |canon| format!(", canon: {canon}ms")));
        if let Some((robot, millis)) = self.late {
            yaml.push_str(&format!(", overrides: {{{}: {{delay: {millis}ms}}}}", ROBOTS[robot]));
        }
        yaml.push_str(&self.zone.map_or(String::new(), |zone| format!(", uses: z{zone}")));
        yaml.push_str(&self.apart.map_or(String::new(), |other| format!(", apart: {}", name(other))));
        yaml.push_str(&self.change.yaml);
        let csv = format!("{}.csv", csvs.len());
        let written = self.movement.yaml.replace("c.csv", &csv);
        csvs.insert(csv, self.movement.csv.clone());
        let wish = self.tolerance.map_or(String::new(), |tolerance| format!("tolerance: {tolerance}, "));
        let tracks = format!("{{{}: {{{wish}{written}}}}}", DEVICES[self.device].0);
        if self.by_move {
            let own = format!("m{}", csvs.len());
            moves.push_str(&format!("  {own}: {{tracks: {tracks}}}\n"));
            yaml.push_str(&format!(", move: {own}"));
        } else {
            yaml.push_str(&format!(", tracks: {tracks}"));
        }
        yaml
    }
}

impl Show {
    fn yaml(&self, csvs: &mut HashMap<String, String>) -> String {
        let order = if self.auto { "auto" } else { "given" };
        let mut moves = String::new();
        let mut acts = String::new();
        for (index, act) in self.acts.iter().enumerate() {
            acts.push_str(&format!("  - act: a{index}\n    cues:\n"));
            for (index, cue) in act.iter().enumerate() {
                acts.push_str(&format!("      - {{{}}}\n", cue.yaml(index, csvs, &mut moves)));
            }
        }
        let moves = if moves.is_empty() { moves } else { format!("moves:\n{moves}") };
        format!(
            "scenario: s\noff_grid: snap\ntempo: {}.{:02}\nzones: {{z0: {order}, z1: given}}\nroles: {{cast: [b, c]}}\n{moves}acts:\n{acts}",
            self.tempo / 100,
            self.tempo % 100
        )
    }

    /// Nanoseconds of so many quarters of a beat.
    fn beats(&self, quarters: i64) -> Ratio<i128> {
        Ratio::new(i128::from(quarters) * 60_000_000_000 * 100, 4 * i128::from(self.tempo))
    }
}

// What is meant.

fn rounded(time: Ratio<i128>) -> Nanos {
    (time + Ratio::new(1, 2)).floor().to_integer()
}

/// Where a length from a cue's start ends, from there on.
fn laid(start: Option<Ratio<i128>>, length: Ratio<i128>) -> Nanos {
    match start {
        Some(start) if !length.is_integer() => rounded(start + length) - rounded(start),
        _ => length.floor().to_integer(),
    }
}

impl Cue {
    fn start(&self, show: &Show) -> Option<Ratio<i128>> {
        match self.when {
            When::At(millis) => Some(Ratio::from_integer(i128::from(millis) * MS)),
            When::Bar(bar) => Some(show.beats(16 * (bar - 1))),
            _ => None,
        }
    }

    /// One turn of its movement.
    fn lap(&self, show: &Show) -> Ratio<i128> {
        match &self.beats {
            Some(keyframes) => show.beats(keyframes[keyframes.len() - 1].0),
            None => {
                let millis = self.movement.ways[self.movement.ways.len() - 1].end;
                Ratio::from_integer(millis.round() as i128 * MS)
            }
        }
    }

    /// Its length as it is written, with its turns.
    fn length(&self, show: &Show) -> Nanos {
        let turns = Ratio::from_integer(i128::from(self.change.turns));
        laid(self.start(show), self.lap(show) * turns)
    }

    /// How much later each of its robots begins.
    fn delays(&self) -> Vec<(usize, Nanos)> {
        let delay = |(index, robot): (usize, &usize)| {
            let own = self.late.filter(|(late, _)| late == robot).map_or(0, |(_, millis)| i128::from(millis));
            (*robot, (index as i128 * i128::from(self.canon.unwrap_or(0)) + own) * MS)
        };
        NAMES[self.who].1.iter().enumerate().map(delay).collect()
    }

    fn delay(&self) -> Nanos {
        self.delays().iter().map(|(_, delay)| *delay).max().unwrap_or(0)
    }

    /// Its steps from its start, where the device plays it as it is written; with what is written for each.
    fn as_written(&self, show: &Show) -> Option<Vec<(Nanos, f64, f64)>> {
        let keyframes = self.beats.as_ref()?;
        let (_, moves, granularity, _) = DEVICES[self.device];
        if self.tolerance.is_some() || self.change.backwards {
            return None;
        }
        let start = self.start(show);
        let (cycle, whole) = (self.lap(show), self.length(show));
        let mut steps: Vec<(Nanos, f64, f64)> = Vec::new();
        for turn in 0..self.change.turns {
            let begin = laid(start, cycle * i128::from(turn));
            let end = laid(start, cycle * i128::from(turn + 1));
            for (index, (quarters, value)) in keyframes.iter().enumerate() {
                let at = match index + 1 == keyframes.len() {
                    true => end,
                    // Turns differ by a nanosecond.
                    false => (begin + laid(start, show.beats(*quarters))).min(end),
                };
                let written = self.change.about + self.change.scale * (value - self.change.about);
                let set = (written / granularity).round() * granularity;
                let before = steps.last().copied();
                let seam = before.is_some_and(|before| before.0 == at);
                match before {
                    // Of a device that holds, the later of two at one time counts; of one that moves, one of two alike.
                    Some(_) if seam && !moves => *steps.last_mut()? = (at, set, written),
                    Some(before) if seam && before.1 == set => {
                        let worse = (set - written).abs() > (before.1 - before.2).abs();
                        *steps.last_mut()? = (at, set, if worse { written } else { before.2 });
                    }
                    _ => steps.push((at, set, written)),
                }
            }
        }
        if let Some((least, largest)) = self.stretch {
            if least != largest {
                return None;
            }
            let to = i128::from(least) * MS;
            for step in &mut steps {
                step.0 = rounded(Ratio::new(step.0 * to, whole));
            }
        }
        Some(steps)
    }
}

/// to >= from + least.
type Bound = (usize, usize, Nanos);

/// The earliest times of all events by relaxing bounds until nothing changes; none if that never ends.
fn earliest(events: usize, bounds: &[Bound]) -> Option<Vec<Nanos>> {
    let mut times = vec![0; events];
    for _ in 0..=events {
        let mut changed = false;
        for (from, to, least) in bounds {
            if times[*to] < times[*from] + least {
                times[*to] = times[*from] + least;
                changed = true;
            }
        }
        if !changed {
            return (times[0] == 0).then_some(times);
        }
    }
    None
}

/// The latest times by which everything still ends in time.
fn latest(events: usize, bounds: &[Bound], end: Nanos) -> Vec<Nanos> {
    let mut times = vec![end; events];
    times[0] = 0;
    for _ in 0..=events {
        for (from, to, least) in bounds {
            times[*from] = times[*from].min(times[*to] - least);
        }
    }
    times
}

/// Events: 0 the act's start, then the start and the end of each cue.
fn bounds(show: &Show, act: &[Cue]) -> Vec<Bound> {
    let mut all: Vec<Bound> = Vec::new();
    let mut between = |from: usize, to: usize, least: Option<Nanos>, largest: Option<Nanos>| {
        all.extend(least.map(|least| (from, to, least)));
        all.extend(largest.map(|largest| (to, from, -largest)));
    };
    let event = |cue: usize, end: bool| 1 + 2 * cue + usize::from(end);
    for (index, cue) in act.iter().enumerate() {
        let (start, end) = (event(index, false), event(index, true));
        between(0, start, Some(0), None);
        between(0, end, Some(0), None);
        let (least, largest) = match cue.stretch {
            Some((least, largest)) => (i128::from(least) * MS, i128::from(largest) * MS),
            None => (cue.length(show), cue.length(show)),
        };
        between(start, end, Some(least + cue.delay()), Some(largest + cue.delay()));
        match cue.when {
            When::Free => {}
            When::At(millis) => {
                between(0, start, Some(i128::from(millis) * MS), Some(i128::from(millis) * MS))
            }
            When::Between(least, largest) => {
                between(0, start, Some(i128::from(least) * MS), Some(i128::from(largest) * MS));
            }
            When::Bar(bar) => {
                let at = rounded(show.beats(16 * (bar - 1)));
                between(0, start, Some(at), Some(at));
            }
            When::EndBy(millis) => between(0, end, None, Some(i128::from(millis) * MS)),
        }
        for Relation { word, other, end: which, lag } in &cue.relations {
            let other = |default: bool| event(*other, which.unwrap_or(default));
            let beats = |quarters: i64| show.beats(quarters).floor().to_integer();
            let (least, largest) = match (lag, word) {
                (Lag::None, Word::With) => (0, Some(0)),
                (Lag::None, _) => (0, None),
                (Lag::One(millis), Word::With) => (i128::from(*millis) * MS, Some(i128::from(*millis) * MS)),
                (Lag::One(millis), _) => (i128::from(*millis) * MS, None),
                (Lag::Beats(quarters), Word::With) => (beats(*quarters), Some(beats(*quarters))),
                (Lag::Beats(quarters), _) => (beats(*quarters), None),
                (Lag::Range(least, largest), _) => (i128::from(*least) * MS, Some(i128::from(*largest) * MS)),
            };
            match word {
                Word::After => between(other(true), start, Some(least), largest),
                Word::With => between(other(false), start, Some(least), largest),
                Word::Before => between(end, other(false), Some(least), largest),
            }
        }
        if let Some(other) = cue.apart.filter(|other| *other != index) {
            between(event(index.min(other), true), event(index.max(other), false), Some(0), None);
        }
    }
    all
}

/// The cues of a zone one after another.
fn in_order(cues: &[usize]) -> Vec<Bound> {
    cues.windows(2).map(|pair| (2 + 2 * pair[0], 1 + 2 * pair[1], 0)).collect()
}

fn of_zone(act: &[Cue], zone: usize) -> Vec<usize> {
    (0..act.len()).filter(|cue| act[*cue].zone == Some(zone)).collect()
}

fn orders(cues: &[usize]) -> Vec<Vec<usize>> {
    if cues.len() < 2 {
        return vec![cues.to_vec()];
    }
    let mut all = Vec::new();
    for (index, first) in cues.iter().enumerate() {
        let mut rest = cues.to_vec();
        rest.remove(index);
        all.extend(orders(&rest).into_iter().map(|rest| [vec![*first], rest].concat()));
    }
    all
}

/// What the reading makes of an act's times.
#[derive(Debug)]
struct Times {
    starts: Vec<Nanos>,
    ends: Vec<Nanos>,
    slacks: Vec<Nanos>,
}

/// All ways to time an act, one for each order of the cues that may be in any; of those the shortest are good enough.
fn timings(show: &Show, act: &[Cue]) -> Vec<Times> {
    let mut fixed = bounds(show, act);
    fixed.extend(in_order(&of_zone(act, 1)));
    let free = of_zone(act, 0);
    let orders = if show.auto { orders(&free) } else { vec![free] };
    let events = 1 + 2 * act.len();
    let timed = |order: Vec<usize>| {
        let all = [fixed.clone(), in_order(&order)].concat();
        let times = earliest(events, &all)?;
        let end = times.iter().copied().max()?;
        let latest = latest(events, &all, end);
        let of =
            |cue: usize| (times[1 + 2 * cue], times[2 + 2 * cue], latest[1 + 2 * cue] - times[1 + 2 * cue]);
        let cues: Vec<_> = (0..act.len()).map(of).collect();
        Some(Times {
            starts: cues.iter().map(|cue| cue.0).collect(),
            ends: cues.iter().map(|cue| cue.1).collect(),
            slacks: cues.iter().map(|cue| cue.2).collect(),
        })
    };
    orders.into_iter().filter_map(timed).collect()
}

/// What one cue does with one device.
struct Segment<'a> {
    cue: &'a Cue,
    begin: Nanos,
    /// Its change, with the length that it is stretched to.
    change: Change,
    length: Nanos,
}

/// Everything that each device does, in order.
fn lanes<'a>(show: &Show, act: &'a [Cue], times: &Times) -> BTreeMap<(usize, usize), Vec<Segment<'a>>> {
    let mut lanes: BTreeMap<(usize, usize), Vec<Segment<'_>>> = BTreeMap::new();
    for (index, cue) in act.iter().enumerate() {
        let length = times.ends[index] - times.starts[index] - cue.delay();
        let mut change = cue.change.clone();
        change.duration = (length != cue.length(show)).then_some(length as f64 / 1e6);
        for (robot, delay) in cue.delays() {
            let begin = times.starts[index] + delay;
            lanes.entry((robot, cue.device)).or_default().push(Segment {
                cue,
                begin,
                change: change.clone(),
                length,
            });
        }
    }
    lanes.values_mut().for_each(|segments| segments.sort_by_key(|segment| segment.begin));
    lanes
}

fn overlaps(segments: &[Segment<'_>]) -> bool {
    let mut end = Nanos::MIN;
    segments.iter().any(|segment| {
        let early = segment.begin < end;
        end = end.max(segment.begin + segment.length);
        early
    })
}

fn disagree(what: String) -> Result<(), TestCaseError> {
    Err(TestCaseError::fail(what))
}

/// Compares the steps of one device with what its cues mean.
fn compare_lane(show: &Show, act: &Act, robot: &str, segments: &[Segment<'_>]) -> Result<(), TestCaseError> {
    let (device, moves, granularity, most) = DEVICES[segments[0].cue.device];
    let who = format!("{device} of {robot}");
    let scripts: Vec<_> = act
        .plan
        .robots
        .iter()
        .filter(|plan| plan.robot.as_str() == robot)
        .flat_map(|plan| &plan.scripts)
        .filter(|script| script.device.as_str() == device)
        .collect();
    let mut end = None;
    let mut steps: Vec<(Nanos, f64)> = Vec::new();
    for script in &scripts {
        let start = script.start.span();
        prop_assert!(end.is_none_or(|end| end == start), "{who}: a gap between scripts");
        prop_assert!(script.script.steps().len() <= most);
        let all = script.script.steps().iter();
        steps.extend(
            all.map(|step| (i128::from((start + step.offset.span()).as_nanos()), step.setpoint.value)),
        );
        end = Some(start + script.script.duration());
    }
    let Some(used) =
        act.devices.iter().find(|used| used.robot.as_str() == robot && used.device.as_str() == device)
    else {
        return disagree(format!("{who} does nothing"));
    };
    prop_assert_eq!(used.steps, steps.len());
    prop_assert_eq!(used.scripts, scripts.len());
    prop_assert_eq!(scripts.len(), steps.len().div_ceil(most));
    prop_assert!(used.at_least <= used.steps, "{who}: at least {} of {}", used.at_least, used.steps);
    let last = &segments[segments.len() - 1];
    prop_assert!(
        (steps[steps.len() - 1].0 - last.begin - last.length).abs() <= 1,
        "{who} ends at {}, not {}",
        steps[steps.len() - 1].0,
        last.begin + last.length
    );
    as_written(show, segments, &steps, (used.at_least, used.worst_error), &who)?;
    let millis: Vec<(f64, f64)> = steps.iter().map(|(at, value)| (*at as f64 / 1e6, *value)).collect();
    let mut worst: (f64, f64) = (0.0, 0.0);
    let mut seen = |off: f64, at: f64| {
        if off > worst.0 {
            worst = (off, at);
        }
    };
    let mut least_allowed: f64 = 0.0;
    for (index, segment) in segments.iter().enumerate() {
        let begin = segment.begin as f64 / 1e6;
        let own: Vec<(f64, f64)> = millis.iter().map(|(at, value)| (at - begin, *value)).collect();
        let length = segment.length as f64 / 1e6;
        let within: Vec<(f64, f64)> =
            own.iter().copied().filter(|(at, _)| *at > -NEAR && *at < length + NEAR).collect();
        for at in looked_at(&segment.cue.movement, &segment.change, &within) {
            let crowded = own.iter().filter(|step| (step.0 - at).abs() < 2.0 * NEAR).count() > 2;
            if !crowded && at > NEAR && at < length - NEAR {
                let wanted = meant(&segment.cue.movement, &segment.change, at);
                seen((played(&own, moves, at) - wanted).abs(), begin + at);
            }
        }
        // Until the next cue it stays where it is.
        let next = segments.get(index + 1).map_or(f64::INFINITY, |next| next.begin as f64 / 1e6);
        let end = begin + length;
        let written = final_value(&segment.cue.movement, &segment.change);
        if next > end + 4.0 * NEAR {
            for part in [0.0, 0.3, 0.7, 1.0] {
                let at = end + 2.0 * NEAR + (next.min(end + 5_000.0) - end - 4.0 * NEAR) * part;
                seen((played(&millis, moves, at) - written).abs(), at);
            }
        }
        let allowed = segment.cue.tolerance.unwrap_or(if granularity < 0.1 { 0.01 } else { 0.5 });
        least_allowed = least_allowed.max(allowed);
    }
    let dust = 2e-3;
    prop_assert!(
        worst.0 <= used.worst_error + dust,
        "{who}: off by {} at {} ms, not {}",
        worst.0,
        worst.1,
        used.worst_error
    );
    prop_assert!(used.worst_error <= least_allowed * (1.0 + 1e-9), "{who}: {} is too much", used.worst_error);
    prop_assert!(
        used.worst_error <= worst.0 + least_allowed / 4.0 + dust
            || used.worst_error <= granularity / 2.0 + 1e-9,
        "{who}: off by {} only, not {}",
        worst.0,
        used.worst_error
    );
    for (index, step) in steps.iter().enumerate() {
        prop_assert!(
            (step.1 / granularity - (step.1 / granularity).round()).abs() < 1e-6,
            "{who}: {step:?} is off the grid"
        );
        prop_assert!(index == 0 || steps[index - 1].0 <= step.0);
    }
    Ok(())
}

/// Where all cues are played as they are written every step is known, to the nanosecond.
fn as_written(
    show: &Show,
    segments: &[Segment<'_>],
    steps: &[(Nanos, f64)],
    (at_least, worst_error): (usize, f64),
    who: &str,
) -> Result<(), TestCaseError> {
    let (_, moves, _, _) = DEVICES[segments[0].cue.device];
    let mut expected: Vec<(Nanos, f64)> = Vec::new();
    let mut worst: f64 = 0.0;
    for segment in segments {
        let Some(own) = segment.cue.as_written(show) else { return Ok(()) };
        // One that moves does not creep to the next cue.
        if let Some((at, value)) = expected.last().copied()
            && moves
            && segment.begin > at
            && own[0].1 != value
        {
            expected.push((segment.begin, value));
        }
        worst = own.iter().map(|(_, set, written)| (set - written).abs()).fold(worst, f64::max);
        expected.extend(own.iter().map(|(at, set, _)| (segment.begin + at, *set)));
    }
    let same = expected.len() == steps.len()
        && expected.iter().zip(steps).all(|(e, s)| e.0 == s.0 && (e.1 - s.1).abs() < 1e-9);
    prop_assert!(same, "{who}: {expected:?}\nnot {steps:?}");
    prop_assert_eq!(at_least, steps.len(), "{}: at least", who);
    prop_assert!((worst_error - worst).abs() < 1e-9, "{who}: worst error {worst}, not {worst_error}");
    Ok(())
}

fn compare(show: &Show, compiled: &Compiled) -> Result<(), TestCaseError> {
    let all: Vec<Vec<Times>> = show.acts.iter().map(|act| timings(show, act)).collect();
    let errors = compiled.findings.iter().filter(|finding| finding.severity == Severity::Error);
    let codes: Vec<Code> = errors.map(|finding| finding.code).collect();
    let impossible = all.iter().any(Vec::is_empty);
    let told = codes.iter().any(|code| matches!(code, Code::Conflict | Code::NoOrder));
    prop_assert_eq!(impossible, told, "contradiction: {:?}", codes);
    let Some(choreography) = &compiled.choreography else {
        let known = [Code::OutOfRange, Code::ToleranceTooTight, Code::Overlap, Code::Conflict, Code::NoOrder];
        prop_assert!(codes.iter().all(|code| known.contains(code)), "{codes:?}");
        if !impossible {
            let clash = |(act, times): (&Vec<Cue>, &Vec<Times>)| {
                times.iter().any(|times| lanes(show, act, times).values().any(|segments| overlaps(segments)))
            };
            let clashes = show.acts.iter().zip(&all).any(clash);
            prop_assert!(clashes || !codes.contains(&Code::Overlap), "no overlap: {codes:?}");
        }
        return Ok(());
    };
    prop_assert_eq!(choreography.acts.len(), show.acts.len());
    for ((act, timings), planned) in show.acts.iter().zip(&all).zip(&choreography.acts) {
        let nanos = |span: urrcp::Span| i128::from(span.as_nanos());
        let alike = |times: &&Times| {
            planned.cues.iter().enumerate().all(|(index, cue)| {
                (nanos(cue.start), nanos(cue.end), nanos(cue.slack))
                    == (times.starts[index], times.ends[index], times.slacks[index])
            })
        };
        let Some(times) = timings.iter().find(alike) else {
            return disagree(format!("times {:?}\nnot {timings:?}", planned.cues));
        };
        // The best order of a few cues is found.
        let end = |times: &Times| times.ends.iter().copied().max();
        prop_assert_eq!(end(times), timings.iter().map(end).min().flatten(), "a longer act than need be");
        let lanes = lanes(show, act, times);
        prop_assert_eq!(planned.devices.len(), lanes.len());
        for ((robot, _), segments) in &lanes {
            prop_assert!(!overlaps(segments), "an overlap that is not told");
            compare_lane(show, planned, ROBOTS[*robot], segments)?;
        }
    }
    Ok(())
}

// What is drawn.

/// Keyframes at quarters of a beat, played as they are written.
fn musical(moves: bool) -> impl Strategy<Value = (Movement, Option<Vec<(i64, f64)>>)> {
    prop::collection::vec((1i64..9, -80i32..80), 2..7).prop_map(move |all| {
        let mut now = 0;
        let mut keyframes = Vec::new();
        for (index, (after, quarters)) in all.into_iter().enumerate() {
            now += if index == 0 { 0 } else { after };
            keyframes.push((now, f64::from(quarters) / 4.0));
        }
        let text: Vec<String> = keyframes
            .iter()
            .map(|(at, to)| format!("{{at: {} beats, to: {to}}}", *at as f64 / 4.0))
            .collect();
        (
            Movement::of_keyframes(&format!("keyframes: [{}]", text.join(", ")), moves, &keyframes),
            Some(keyframes),
        )
    })
}

fn lags() -> impl Strategy<Value = Lag> {
    prop_oneof![
        2 => Just(Lag::None),
        2 => (-3_000i64..4_000).prop_map(Lag::One),
        1 => (-3_000i64..3_000, 0i64..3_000).prop_map(|(least, more)| Lag::Range(least, least + more)),
        1 => (1i64..9).prop_map(Lag::Beats),
    ]
}

fn relations() -> impl Strategy<Value = Vec<(Word, usize, Option<bool>, Lag)>> {
    let word = prop_oneof![6 => Just(Word::After), 2 => Just(Word::With), 1 => Just(Word::Before)];
    let end = prop_oneof![3 => Just(None), 1 => any::<bool>().prop_map(Some)];
    let one = (word, 0usize..6, end, lags()).boxed();
    prop_oneof![
        3 => Just(Vec::new()),
        5 => prop::collection::vec(one.clone(), 1),
        1 => prop::collection::vec(one, 2..4),
    ]
}

fn cue() -> impl Strategy<Value = Cue> {
    let device = 0..DEVICES.len();
    let moving = device.prop_flat_map(|device| {
        let moves = DEVICES[device].1;
        let any = movements(moves).prop_map(|movement| (movement, None));
        (Just(device), prop_oneof![any.boxed(), musical(moves).boxed()])
    });
    let when = prop_oneof![
        12 => Just(When::Free),
        1 => (0i64..9_000).prop_map(When::At),
        1 => (0i64..9_000, 0i64..4_000).prop_map(|(least, more)| When::Between(least, least + more)),
        1 => (1i64..6).prop_map(When::Bar),
        1 => (9_000i64..90_000).prop_map(When::EndBy),
    ];
    let stretch = prop_oneof![4 => Just(None), 1 => (700i64..20_000, 0i64..2).prop_map(|(least, more)| Some((least, least + more * 2_000)))];
    let tolerance = prop_oneof![2 => Just(None), 1 => (1i32..12).prop_map(|t| Some(f64::from(t) / 2.0))];
    let canon = prop_oneof![3 => Just(None), 1 => (0i64..900).prop_map(Some)];
    let late = prop_oneof![3 => Just(None), 1 => (0usize..3, 0i64..900).prop_map(Some)];
    let zone = prop_oneof![2 => Just(None), 1 => (0usize..2).prop_map(Some)];
    let apart = prop_oneof![6 => Just(None), 1 => (0usize..6).prop_map(Some)];
    (
        (0..NAMES.len(), moving, changes(), tolerance),
        (canon, late, stretch, when),
        (relations(), zone, apart, prop::bool::weighted(0.2)),
    )
        .prop_map(
            |(
                (who, (device, (movement, beats)), change, tolerance),
                (canon, late, stretch, when),
                (relations, zone, apart, by_move),
            )| {
                let mut change = change;
                // The length is the cue's here.
                change.yaml = change.yaml.split(", duration").next().unwrap_or_default().to_owned();
                change.duration = None;
                let relation = |(word, other, end, lag)| Relation { word, other, end, lag };
                let relations = relations.into_iter().map(relation).collect();
                let late = late.filter(|(robot, _)| NAMES[who].1.contains(robot));
                Cue {
                    who,
                    device,
                    movement,
                    beats,
                    change,
                    tolerance,
                    canon,
                    late,
                    stretch,
                    when,
                    relations,
                    zone,
                    apart,
                    by_move,
                }
            },
        )
}

fn acts() -> impl Strategy<Value = Vec<Vec<Cue>>> {
    let act = prop::collection::vec(cue(), 1..6).prop_map(|mut cues| {
        let count = cues.len();
        for (index, cue) in cues.iter_mut().enumerate() {
            // To cues that there are; forwards only sometimes, as a circle is seldom wanted.
            cue.relations.retain_mut(|relation| {
                relation.other = if relation.other == 5 && index % 2 == 0 {
                    (index + 1) % count
                } else {
                    relation.other % index.max(1)
                };
                relation.other != index
            });
            cue.apart = cue.apart.map(|other| other % count).filter(|other| *other != index);
        }
        cues
    });
    prop::collection::vec(act, 1..4)
}

fn shows() -> impl Strategy<Value = Show> {
    (4_000i64..24_000, any::<bool>(), acts()).prop_map(|(tempo, auto, mut acts)| {
        let probe = Show { tempo, auto, acts: Vec::new() };
        for cue in acts.iter_mut().flatten() {
            if let Some(keyframes) = &cue.beats {
                let millis = |quarters: i64| {
                    let exact = probe.beats(quarters);
                    *exact.numer() as f64 / *exact.denom() as f64 / 1e6
                };
                cue.movement.at_times(&keyframes.iter().map(|(at, _)| millis(*at)).collect::<Vec<_>>());
            }
        }
        Show { tempo, auto, acts }
    })
}

fn scenarios() -> u32 {
    std::env::var("DOWNBEAT_SCENARIOS").ok().and_then(|text| text.parse().ok()).unwrap_or(500)
}

/// What has been compared.
#[derive(Debug, Default)]
struct Tally {
    /// Scenarios with a plan, with times that contradict each other, and with other errors.
    planned: usize,
    contradictory: usize,
    refused: usize,
    acts: usize,
    cues: usize,
    devices: usize,
    steps: usize,
    /// Cues that could start later, and devices of which every step is known.
    slack: usize,
    to_the_step: usize,
}

impl Tally {
    fn count(&mut self, show: &Show, compiled: &Compiled) {
        let told = |code: Code| compiled.findings.iter().any(|finding| finding.code == code);
        let Some(choreography) = &compiled.choreography else {
            let contradictory = told(Code::Conflict) || told(Code::NoOrder);
            *(if contradictory { &mut self.contradictory } else { &mut self.refused }) += 1;
            return;
        };
        self.planned += 1;
        for (act, written) in choreography.acts.iter().zip(&show.acts) {
            self.acts += 1;
            self.cues += act.cues.len();
            self.slack += act.cues.iter().filter(|cue| cue.slack > urrcp::Span::ZERO).count();
            self.devices += act.devices.len();
            self.steps += act.devices.iter().map(|used| used.steps).sum::<usize>();
            let known = written.iter().filter(|cue| cue.as_written(show).is_some());
            self.to_the_step += known.map(|cue| NAMES[cue.who].1.len()).sum::<usize>();
        }
    }
}

#[test]
fn whole_scenarios_are_what_a_second_reading_finds() {
    let config = ProptestConfig {
        max_shrink_iters: 20_000,
        failure_persistence: None,
        ..ProptestConfig::with_cases(scenarios())
    };
    let tally = RefCell::new(Tally::default());
    let looked_at = TestRunner::new(config).run(&shows(), |show| {
        let mut csvs = HashMap::new();
        let text = show.yaml(&mut csvs);
        let csvs = Csvs(csvs);
        let source = Source { name: "s.yaml".into(), text };
        let compiled = compile(&source, &fleet(), &csvs);
        tally.borrow_mut().count(&show, &compiled);
        compare(&show, &compiled).map_err(|error| {
            let errors = compiled.findings.iter().filter(|finding| finding.severity == Severity::Error);
            let errors: Vec<&str> = errors.map(|finding| finding.message.as_str()).collect();
            TestCaseError::fail(format!("{}\n{:?}\n{errors:#?}\n{error}", source.text, csvs.0))
        })
    });
    looked_at.unwrap_or_else(|error| panic!("{error}"));
    drop(writeln!(std::io::stderr(), "{:?}", tally.into_inner()));
}
