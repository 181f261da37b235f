//! Checks the steps of devices: each step if all steps can be predicted, otherwise the error at hundreds of times.

use std::collections::BTreeMap;

use num_rational::Ratio;
use proptest::prelude::*;

use super::super::verified::held::{Held, as_few_as_can_be};
use super::super::verified::{Change, Movement, NEAR, as_far_off, final_value, looked_at, meant, played};
use super::meaning::rounded;
use super::times::{Times, timings};
use super::{Cue, DEVICES, LAMP, MS, Nanos, ROBOTS, Show, settable};
use crate::{Act, Code, Compiled, Severity};

/// The movement of one device in one cue.
struct Segment<'a> {
    cue: &'a Cue,
    /// Index of the robot in the cue.
    index: usize,
    begin: Nanos,
    movement: Movement,
    /// The change that the cue makes to the movement, including the length to which it is stretched.
    change: Change,
    length: Nanos,
}

impl Segment<'_> {
    /// Returns the first value to which the segment sets the device.
    fn first(&self) -> f64 {
        settable(self.cue.device).nearest(meant(&self.movement, &self.change, 0.0))
    }
}

/// Returns all segments of each device in an act, by (robot, device), in order of time.
fn lanes<'a>(show: &Show, act: &'a [Cue], times: &Times) -> BTreeMap<(usize, usize), Vec<Segment<'a>>> {
    let mut lanes: BTreeMap<(usize, usize), Vec<Segment<'_>>> = BTreeMap::new();
    for (number, cue) in act.iter().enumerate() {
        let start = times.starts[number];
        let (written, length) = (cue.length(show), times.ends[number] - start - cue.delay(show));
        for (index, (robot, delay)) in cue.delays(show).into_iter().enumerate() {
            let own = match written {
                0 => 0,
                _ => rounded(Ratio::new(cue.own_length(show, index) * length, written)),
            };
            let mut change = cue.change(show, index);
            change.duration = (length != written).then_some(own as f64 / 1e6);
            lanes.entry((robot, cue.device)).or_default().push(Segment {
                cue,
                index,
                begin: start + delay,
                movement: cue.movement(show, index),
                change,
                length: own,
            });
        }
    }
    let in_order = |segment: &Segment<'_>| (segment.begin, segment.length);
    lanes.values_mut().for_each(|segments| segments.sort_by_key(in_order));
    lanes
}

fn overlaps(segments: &[Segment<'_>]) -> bool {
    let mut end = Nanos::MIN;
    segments.iter().any(|segment| {
        let early = segment.begin < end;
        end = end.max(segment.begin + segment.length);
        early
    }) || segments.windows(2).any(|pair| pair[0].begin == pair[1].begin && pair[0].first() != pair[1].first())
}

fn disagree(what: String) -> Result<(), TestCaseError> {
    Err(TestCaseError::fail(what))
}

/// Compares the steps of one device with the meaning of its cues.
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
    let mut end: Option<(urrcp::Span, f64)> = None;
    let mut steps: Vec<(Nanos, f64)> = Vec::new();
    for script in &scripts {
        let start = script.start.span();
        let all = script.script.steps();
        if let Some((end, left_at)) = end {
            // A pause between scripts has no effect if the device keeps its value until the first step.
            let keeps = all[0].offset.get() == 0.0 && (!moves || all[0].setpoint.value == left_at);
            prop_assert!(end == start || end < start && keeps, "{who}: a gap between scripts");
        }
        prop_assert!(all.len() <= most);
        let all = all.iter();
        steps.extend(
            all.map(|step| (i128::from((start + step.offset.span()).as_nanos()), step.setpoint.value)),
        );
        let left_at = script.script.steps().last().map(|step| step.setpoint.value).unwrap_or_default();
        end = Some((start + script.duration(), left_at));
    }
    let Some(used) =
        act.devices.iter().find(|used| used.robot.as_str() == robot && used.device.as_str() == device)
    else {
        return disagree(format!("{who} does nothing"));
    };
    prop_assert_eq!(used.steps, steps.len());
    prop_assert_eq!(used.scripts, scripts.len());
    let least = steps.len().div_ceil(most);
    prop_assert!((least..2 * least).contains(&scripts.len()), "{who}: {} scripts", scripts.len());
    prop_assert!(used.at_least <= used.steps, "{who}: at least {} of {}", used.at_least, used.steps);
    let last = &segments[segments.len() - 1];
    let ends = end.map_or(0, |(end, _)| i128::from(end.as_nanos()));
    prop_assert!(
        (ends - last.begin - last.length).abs() <= 1 && steps[steps.len() - 1].0 <= ends,
        "{who} ends at {ends}, not {}",
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
        for at in looked_at(&segment.movement, &segment.change, &within) {
            let crowded = own.iter().filter(|step| (step.0 - at).abs() < 2.0 * NEAR).count() > 2;
            if !crowded && at > NEAR && at < length - NEAR {
                let wanted = meant(&segment.movement, &segment.change, at);
                seen((played(&own, moves, at) - wanted).abs(), begin + at);
            }
        }
        // The device keeps its value until the next cue.
        let next = segments.get(index + 1).map_or(f64::INFINITY, |next| next.begin as f64 / 1e6);
        let end = begin + length;
        let written = final_value(&segment.movement, &segment.change);
        if next > end + 4.0 * NEAR {
            for part in [0.0, 0.3, 0.7, 1.0] {
                let at = end + 2.0 * NEAR + (next.min(end + 5_000.0) - end - 4.0 * NEAR) * part;
                seen((played(&millis, moves, at) - written).abs(), at);
            }
        }
        let allowed = segment.cue.tolerance.unwrap_or(if granularity < 0.1 { 0.01 } else { granularity });
        least_allowed = least_allowed.max(allowed);
    }
    as_far_off(&who, worst, granularity / 2.0, (used.worst_error, least_allowed))?;
    if let ([only], false) = (segments, moves)
        && let Some(tolerance) = only.cue.tolerance
    {
        let held = Held::of(&only.movement, &only.change, settable(only.cue.device));
        as_few_as_can_be(used, &held, tolerance, None)?;
    }
    for (index, step) in steps.iter().enumerate() {
        prop_assert!(
            (step.1 / granularity - (step.1 / granularity).round()).abs() < 1e-6,
            "{who}: {step:?} is off the grid"
        );
        prop_assert!(index == 0 || steps[index - 1].0 <= step.0);
    }
    Ok(())
}

/// Compares tracks with several values at once: every step if none is omitted, otherwise the deviation of each value.
fn compare_colours(act: &Act, robot: &str, segments: &[Segment<'_>]) -> Result<(), TestCaseError> {
    let scripts =
        act.plan.robots.iter().filter(|plan| plan.robot.as_str() == robot).flat_map(|plan| &plan.scripts);
    let own = scripts.filter(|script| script.device.as_str() == DEVICES[LAMP].0);
    let steps: Vec<(Nanos, Vec<f64>)> = own
        .flat_map(|script| {
            let at = |step: &urrcp::Step| i128::from((script.start.span() + step.offset.span()).as_nanos());
            script.script.steps().iter().map(move |step| (at(step), step.setpoint.values().collect()))
        })
        .collect();
    let mut expected: Vec<(Nanos, Vec<f64>)> = Vec::new();
    let (mut thinned, mut worst) = (false, 0.0);
    for segment in segments {
        let colours = segment.cue.colours.as_deref().unwrap_or_default();
        let written = i128::from(colours[colours.len() - 1].0) * MS;
        let laid = |millis: i64| {
            segment.begin + rounded(Ratio::new(i128::from(millis) * MS * segment.length, written))
        };
        let all: Vec<(Nanos, Vec<f64>)> =
            colours.iter().map(|(at, values)| (laid(*at), values.to_vec())).collect();
        thinned |= segment.cue.tolerance.is_some();
        let allowed = segment.cue.tolerance.unwrap_or(0.0);
        for (at, values) in &all[..all.len() - 1] {
            let played = &steps[steps.partition_point(|step| step.0 <= *at) - 1].1;
            let off = played.iter().zip(values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            prop_assert!(off <= allowed + 1e-9, "{values:?} at {at} is {played:?}");
            worst = f64::max(worst, off);
        }
        // Another cue may begin at the end of this one.
        prop_assert!(steps.contains(&all[all.len() - 1]), "{all:?} ends otherwise in {steps:?}");
        expected.extend(all);
    }
    prop_assert!(thinned || steps == expected, "{expected:?}\nnot {steps:?}");
    let Some(used) = act
        .devices
        .iter()
        .find(|used| used.robot.as_str() == robot && used.device.as_str() == DEVICES[LAMP].0)
    else {
        return disagree(format!("the lamp of {robot} does nothing"));
    };
    prop_assert_eq!(used.steps, steps.len());
    prop_assert!(steps.len() <= expected.len() && used.at_least <= used.steps);
    prop_assert!((used.worst_error - worst).abs() < 1e-9, "off by {worst}, not {}", used.worst_error);
    Ok(())
}

/// Compares the planned sensor readings and their times.
fn compare_readings(show: &Show, planned: &Act, act: &[Cue], times: &Times) -> Result<(), TestCaseError> {
    let of_cue = |(cue, start): (&Cue, &Nanos)| {
        let of_robot = |(robot, delay): (usize, Nanos)| {
            cue.reads
                .iter()
                .map(move |millis| (ROBOTS[robot].to_owned(), start + delay + i128::from(*millis) * MS))
                .collect::<Vec<_>>()
        };
        cue.delays(show).into_iter().flat_map(of_robot).collect::<Vec<_>>()
    };
    let mut expected: Vec<(String, Nanos)> = act.iter().zip(&times.starts).flat_map(of_cue).collect();
    let found =
        planned.readings.iter().map(|reading| (reading.robot.to_string(), i128::from(reading.at.as_nanos())));
    let mut found: Vec<(String, Nanos)> = found.collect();
    expected.sort();
    found.sort();
    prop_assert_eq!(expected, found, "readings");
    Ok(())
}

/// Compares every step to the nanosecond, if the device plays the written keyframes of all its cues without further steps.
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
        let Some(mut own) = segment.cue.as_written(show, segment.index) else { return Ok(()) };
        // An additional step keeps a device that moves from creeping to the next cue.
        if let Some((at, value)) = expected.last().copied()
            && moves
            && segment.begin > at
            && own[0].1 != value
        {
            expected.push((segment.begin, value));
        }
        worst = own.iter().map(|(_, set, written)| (set - written).abs()).fold(worst, f64::max);
        // At the end, a holding device is not set to its current value again.
        while !moves && own.windows(2).next_back().is_some_and(|pair| pair[0].1 == pair[1].1) {
            own.pop();
        }
        expected.extend(own.iter().map(|(at, set, _)| (segment.begin + at, *set)));
    }
    let same = expected.len() == steps.len()
        && expected.iter().zip(steps).all(|(e, s)| e.0 == s.0 && (e.1 - s.1).abs() < 1e-9);
    prop_assert!(same, "{who}: {expected:?}\nnot {steps:?}");
    prop_assert_eq!(at_least, steps.len(), "{}: at least", who);
    prop_assert!((worst_error - worst).abs() < 1e-9, "{who}: worst error {worst}, not {worst_error}");
    Ok(())
}

pub(super) fn compare(show: &Show, compiled: &Compiled) -> Result<(), TestCaseError> {
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
        let critical: Vec<_> = planned.cues.iter().filter(|cue| cue.critical).collect();
        prop_assert!(
            critical.iter().all(|cue| cue.slack == urrcp::Span::ZERO),
            "slack on the critical path: {critical:?}"
        );
        prop_assert!(!critical.is_empty() || planned.cues.is_empty(), "nothing decides when the act ends");
        // The best order of a few cues must be found.
        let end = |times: &Times| times.ends.iter().copied().max();
        prop_assert_eq!(end(times), timings.iter().map(end).min().flatten(), "a longer act than need be");
        let lanes = lanes(show, act, times);
        prop_assert_eq!(planned.devices.len(), lanes.len());
        for ((robot, _), segments) in &lanes {
            prop_assert!(!overlaps(segments), "an overlap that is not told");
            match segments[0].cue.device {
                LAMP => compare_colours(planned, ROBOTS[*robot], segments)?,
                _ => compare_lane(show, planned, ROBOTS[*robot], segments)?,
            }
        }
        compare_readings(show, planned, act, times)?;
    }
    Ok(())
}
