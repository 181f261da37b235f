//! Lists the differences between two past missions for a browser page.

use urrcp::Span;

use super::Presence;
use super::runs::{RunAct, RunDifferences, RunRobot, ScriptDifferences};
use super::text::{Entry, change, figure, outcome, robot_row, script_row, word};

/// A difference, preceded by the repetition (from 1) of the act that it belongs to.
pub(crate) type Listed = (usize, Entry);

/// Lists all differences. Those that belong to no act come first.
pub(crate) fn listed(found: &RunDifferences) -> Vec<Listed> {
    let plain = |subject: &str, text: String| entry(None, subject, text);
    let mut all = Vec::new();
    if let Some(scenario) = &found.scenario {
        let name = |name: &Option<String>| name.clone().unwrap_or_else(|| "not known".to_owned());
        all.push(plain("scenario", format!("{} → {}", name(&scenario.a), name(&scenario.b))));
    }
    if let Some(ended) = &found.outcome {
        all.push(plain("outcome", format!("{} → {}", outcome(ended.a.as_ref()), outcome(ended.b.as_ref()))));
    }
    for (robots, text) in
        [(&found.dropped_added, "left out now"), (&found.dropped_removed, "no longer left out")]
    {
        all.extend(robots.iter().map(|robot| plain(robot, text.to_owned())));
    }
    let removed = found.failures.removed.iter().map(|failure| ("no longer failed", failure));
    let added = found.failures.added.iter().map(|failure| ("failed", failure));
    let failures = removed.chain(added);
    all.extend(failures.map(|(how, failure)| plain(&failure.robot, format!("{how}: {}", failure.text))));
    all.extend(found.acts.iter().flat_map(|act| of_act(act).into_iter().map(|entry| (act.time, entry))));
    all
}

fn entry(act: Option<&str>, subject: &str, text: String) -> Listed {
    let at = act.map(|_| Span::ZERO);
    (1, Entry { act: act.map(str::to_owned), at, device: None, subject: subject.to_owned(), text })
}

fn of_act(act: &RunAct) -> Vec<Entry> {
    let about = |subject: &str, text: String| entry(Some(&act.act), subject, text).1;
    if act.presence != Presence::Changed {
        return vec![about(&act.act, word(act.presence).to_owned())];
    }
    let mut all = Vec::new();
    all.extend(act.fate.as_ref().map(|fate| about(&act.act, change(Some(fate)))));
    all.extend(act.spread_ms.as_ref().map(|spread| about("spread", figure(spread))));
    all.extend(act.robots.iter().map(|robot| about(&robot.robot, robot_text(robot))));
    all.extend(act.scripts.iter().map(|script| Entry {
        device: script.robot.parse().ok().zip(script.device.parse().ok()),
        at: script.start_ms.as_ref().map(|start| Span::from_millis_f64(start.b)).or(Some(Span::ZERO)),
        ..about(&format!("{}/{}", script.robot, script.device), script_text(script))
    }));
    all
}

fn robot_text(robot: &RunRobot) -> String {
    labelled(&["start error", "steps done", "late steps", ""], &robot_row(robot)[1..])
}

fn script_text(script: &ScriptDifferences) -> String {
    labelled(&["", "start", "steps", "added", "removed", "changed"], &script_row(script)[1..])
}

/// Joins the cells that are not empty. Each is preceded by its label.
fn labelled(labels: &[&str], cells: &[String]) -> String {
    let says = labels.iter().zip(cells).filter(|(_, cell)| !matches!(cell.as_str(), "-" | ""));
    says.map(|(label, cell)| format!("{label} {cell}").trim_start().to_owned()).collect::<Vec<_>>().join(", ")
}
