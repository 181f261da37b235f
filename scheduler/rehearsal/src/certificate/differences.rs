//! Describes the differences between a plan and a certified plan in sentences.

use std::collections::BTreeMap;

use serde_json::Value;
use urrcp::ContentHash;

use super::{Certificate, CertifiedAct, CertifiedRobot, Options, Subject};

/// Maximum number of sentences to list; further ones are only counted.
const SHOWN: usize = 20;

/// Returns the reasons why `certificate` does not cover the plan `now`; empty if it covers the plan.
#[must_use]
pub fn differences(certificate: &Certificate, now: &Subject) -> Vec<String> {
    let mut found = Vec::new();
    let version = env!("CARGO_PKG_VERSION");
    if certificate.downbeat != version {
        found.push(format!(
            "it was made by downbeat {}, but this is downbeat {version}, which may play the same plan differently",
            certificate.downbeat
        ));
    }
    let then = &certificate.subject;
    if then.scenario != now.scenario {
        found.push(format!("it is for the scenario `{}`, but this is `{}`", then.scenario, now.scenario));
    }
    let options = options(&then.options, &now.options);
    // If the options differ, the scripts differ too; listing those differences would hide the cause.
    if options.is_empty() {
        acts(&then.acts, &now.acts, &mut found);
    } else {
        found.extend(options);
    }
    settings("the fleet", &then.fleet, &now.fleet, &mut found);
    robots(then, now, &mut found);
    if found.is_empty() && (then.plan_hash != now.plan_hash || then.fleet_hash != now.fleet_hash) {
        found.push("its hashes do not match this plan and this fleet".to_owned());
    }
    if found.len() > SHOWN {
        let more = found.len() - SHOWN;
        found.truncate(SHOWN);
        found.push(format!("and {more} more"));
    }
    found
}

fn options(then: &Options, now: &Options) -> Vec<String> {
    let text = |name: &Option<String>| {
        name.as_ref().map_or_else(|| "all acts".to_owned(), |name| format!("`{name}`"))
    };
    let list = |options: &Options| match options.only.as_slice() {
        [] => "all robots".to_owned(),
        only => only.iter().map(|robot| format!("`{robot}`")).collect::<Vec<_>>().join(", "),
    };
    let pairs = [
        ("--act", text(&then.act), text(&now.act)),
        ("--from", text(&then.from), text(&now.from)),
        ("--only", list(then), list(now)),
        ("--speed", then.speed.to_string(), now.speed.to_string()),
    ];
    let differ = pairs.into_iter().filter(|(_, then, now)| then != now);
    differ.map(|(name, then, now)| format!("{name}: {now}, but certified with {then}")).collect()
}

/// Returns the name of an act, as used in a sentence.
fn called(act: &CertifiedAct) -> String {
    if act.act.is_empty() { "the scenario".to_owned() } else { format!("act `{}`", act.act) }
}

fn acts(then: &[CertifiedAct], now: &[CertifiedAct], found: &mut Vec<String>) {
    let names = |acts: &[CertifiedAct]| acts.iter().map(|act| act.act.clone()).collect::<Vec<_>>();
    let (mut names_then, mut names_now) = (names(then), names(now));
    if names_then != names_now {
        names_then.sort();
        names_now.sort();
        if names_then == names_now {
            let order: Vec<_> = now.iter().map(|act| format!("`{}`", act.act)).collect();
            found.push(format!("the order of the acts is now {}", order.join(", ")));
        }
    }
    let of = |acts: &[CertifiedAct], name: &str| acts.iter().find(|act| act.act == name).cloned();
    for act in then.iter().filter(|act| of(now, &act.act).is_none()) {
        found.push(format!("{} was certified but no longer exists", called(act)));
    }
    for act in now {
        let Some(before) = of(then, &act.act) else {
            found.push(format!("{} was not certified", called(act)));
            continue;
        };
        settings(&called(act), &before.settings, &act.settings, found);
        let who = called(act);
        hashes(&before.scripts, &act.scripts, found, |script, what| match what {
            Change::Other => format!("{who}: the scripts of `{script}` differ from the certified ones"),
            Change::New => format!("{who}: `{script}` moves, but did not when it was certified"),
            Change::Gone => format!("{who}: `{script}` moved when it was certified, but no longer does"),
        });
    }
}

fn robots(then: &Subject, now: &Subject, found: &mut Vec<String>) {
    for robot in then.robots.keys().filter(|robot| !now.robots.contains_key(*robot)) {
        found.push(format!("robot `{robot}` was certified but does not take part"));
    }
    for (robot, after) in &now.robots {
        match then.robots.get(robot) {
            Some(before) => one_robot(&format!("robot `{robot}`"), before, after, found),
            None => found.push(format!("robot `{robot}` was not certified")),
        }
    }
}

fn one_robot(who: &str, before: &CertifiedRobot, after: &CertifiedRobot, found: &mut Vec<String>) {
    settings(who, &before.settings, &after.settings, found);
    if before.description != after.description {
        found.push(format!("{who}: its description differs"));
    }
    if before.body != after.body {
        found.push(format!("{who}: its body differs"));
    }
    hashes(&before.devices, &after.devices, found, |device, what| match what {
        Change::Other => format!("{who}: the description of its device `{device}` differs"),
        Change::New => format!("{who}: its device `{device}` was not certified"),
        Change::Gone => format!("{who}: its device `{device}` was certified but no longer exists"),
    });
}

fn settings(
    who: &str,
    then: &BTreeMap<String, Value>,
    now: &BTreeMap<String, Value>,
    found: &mut Vec<String>,
) {
    let keys: std::collections::BTreeSet<&String> = then.keys().chain(now.keys()).collect();
    let text = |value: Option<&Value>| value.map_or_else(|| "nothing".to_owned(), ToString::to_string);
    for key in keys {
        let (before, after) = (then.get(key), now.get(key));
        // The setting `space` is a hash, which means nothing to people.
        match before == after {
            true => {}
            false if key == "space" => {
                found.push(format!("{who}: its `space` differs from the certified one"))
            }
            false => {
                found.push(format!("{who}: {key} is {}, but {} was certified", text(after), text(before)))
            }
        }
    }
}

#[derive(Clone, Copy)]
enum Change {
    Other,
    New,
    Gone,
}

fn hashes(
    then: &BTreeMap<String, ContentHash>,
    now: &BTreeMap<String, ContentHash>,
    found: &mut Vec<String>,
    say: impl Fn(&str, Change) -> String,
) {
    for (name, hash) in now {
        match then.get(name) {
            Some(before) if before == hash => {}
            Some(_) => found.push(say(name, Change::Other)),
            None => found.push(say(name, Change::New)),
        }
    }
    let gone = then.keys().filter(|name| !now.contains_key(*name));
    found.extend(gone.map(|name| say(name, Change::Gone)));
}
