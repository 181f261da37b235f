//! Turns findings into facts: short texts that can be compared with predictions, each about one affected robot.

use std::collections::BTreeSet;

use crate::{Code, Finding};

/// Returns the text of a fact: a device jumps to its first keyframe, or has too little time to move there.
pub(super) fn arrival(code: Code, line: usize, (device, robot): (&str, &str), from: f64) -> String {
    format!("{} line {line}: `{device}` of `{robot}` from {from:.3}", code.as_str())
}

/// Returns the text of a fact: one device of a robot has a fault.
pub(super) fn device(code: Code, line: usize, (device, robot): (&str, &str)) -> String {
    format!("{} line {line}: `{device}` of `{robot}`", code.as_str())
}

pub(super) fn keyframe(code: Code, line: usize, number: usize) -> String {
    format!("{} line {line}: keyframe {number}", code.as_str())
}

pub(super) fn act(code: Code, act: &str) -> String {
    format!("{}: `{act}`", code.as_str())
}

pub(super) fn line(code: Code, line: usize) -> String {
    format!("{} line {line}", code.as_str())
}

/// Returns the texts between back-ticks.
fn named(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

fn number(text: &str) -> f64 {
    let end = text.find(|c: char| !matches!(c, '-' | '.' | '0'..='9')).unwrap_or(text.len());
    text[..end].trim_end_matches('.').parse().unwrap_or(f64::NAN)
}

fn of(finding: &Finding) -> Vec<String> {
    let (code, at) = (finding.code, finding.line);
    let message = finding.message.as_str();
    let each = |before: &str, fact: &dyn Fn((&str, &str)) -> String| {
        let names = named(before);
        names[1..].iter().map(|robot| fact((names[0], robot))).collect::<Vec<_>>()
    };
    match code {
        Code::TooFast | Code::Jump => {
            let ways = [" has to jump from ", " to move from "];
            if let Some((before, after)) = ways.iter().find_map(|way| message.split_once(way)) {
                let from = number(after);
                return each(before, &|who| arrival(code, at, who, from));
            }
            match message.strip_prefix("keyframe ") {
                Some(rest) => vec![keyframe(code, at, number(rest) as usize)],
                None => vec![format!("{finding:?}")],
            }
        }
        Code::LeftInMotion => {
            each(message.split(" left ").next().unwrap_or_default(), &|who| device(code, at, who))
        }
        Code::ActHasToWait => vec![act(code, named(message)[0])],
        Code::OutOfRange
        | Code::OffGranularity
        | Code::UnknownAct
        | Code::UnknownSensor
        | Code::Unreachable
        | Code::DeadEnd
        | Code::LeaseTooLong
        | Code::Snapped => {
            let repeats = finding.related.iter().filter(|place| place.is_repeat).map(|place| place.line);
            std::iter::once(at).chain(repeats).map(|at| line(code, at)).collect()
        }
        _ => vec![format!("{finding:?}")],
    }
}

/// Returns all facts in these findings, and checks that each fact is reported once.
pub(in crate::tests) fn facts(findings: &[Finding]) -> Result<BTreeSet<String>, String> {
    let mut facts = BTreeSet::new();
    for finding in findings {
        // Each invalid value of a track is a separate finding.
        let is_value = matches!(finding.code, Code::OutOfRange | Code::OffGranularity | Code::UnknownAct);
        for fact in of(finding) {
            if !facts.insert(fact.clone()) && !is_value {
                return Err(format!("reported twice: {fact}"));
            }
        }
    }
    Ok(facts)
}
