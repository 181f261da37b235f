//! The graph of acts: where each way leads, which acts are never reached, which never come to an end.

use std::collections::{HashMap, HashSet};

use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{Dfs, Reversed};

use super::cast::Cast;
use super::perform::unknown_sensor;
use crate::budget::{Budget, USES_MAX};
use crate::fields::Reader;
use crate::finding::{Code, names};
use crate::node::shortened;
use crate::plan::{FailurePolicy, Wait, Way};
use crate::scenario::{Act, Name};

/// What leads to an act and from it.
pub(super) struct Ways {
    pub(super) wait: Wait,
    pub(super) on_timeout: Way,
    pub(super) next: Way,
    pub(super) on_failure: FailurePolicy,
}

/// The ways of each act. `complete`: all acts could be read, so that the graph can be judged.
pub(super) fn ways(findings: &mut Reader, acts: &[Act], cast: &Cast<'_>, complete: bool) -> Vec<Ways> {
    let before = findings.found.len();
    same_names(findings, acts);
    let mut index_of = HashMap::new();
    for (index, act) in acts.iter().enumerate() {
        index_of.entry(act.name.as_str()).or_insert(index);
    }
    let acts_by_name = ByName { acts, index_of };
    let mut room = Budget::new(USES_MAX);
    let way = |index| way(findings, &acts_by_name, index, cast, &mut room);
    let ways: Vec<Ways> = (0..acts.len()).map(way).collect();
    if complete && findings.found.len() == before {
        check_graph(findings, acts, &ways);
    }
    ways
}

fn same_names(findings: &mut Reader, acts: &[Act]) {
    let mut seen = HashSet::new();
    for act in acts {
        if !seen.insert(act.name.as_str()) {
            let message = format!("several acts are called `{}`", shortened(&act.name));
            findings.add(Code::NameTwice, act.place.of_key("act"), message, "a unique name", None);
        }
    }
}

fn way(
    findings: &mut Reader,
    by_name: &ByName<'_>,
    index: usize,
    cast: &Cast<'_>,
    room: &mut Budget,
) -> Ways {
    let act = &by_name.acts[index];
    let following = if index + 1 < by_name.acts.len() { Way::Act(index + 1) } else { Way::End };
    let next = act.next.as_ref().and_then(|name| by_name.find(findings, name)).unwrap_or(following);
    let on_timeout =
        act.wait.otherwise.as_ref().and_then(|name| by_name.find(findings, name)).unwrap_or(Way::Fail);
    if let Wait::Sensor { robot, sensor, .. } = &act.wait.wait {
        check_sensor(findings, cast, act, robot, sensor);
    }
    let mut ruled = HashSet::new();
    let mut policy =
        FailurePolicy { default: act.on_failure.default.unwrap_or_default(), ..FailurePolicy::default() };
    for (name, rule) in act.on_failure.robots.iter().chain(act.on_failure.inherited.iter()) {
        // If there are several rules for one robot, the first is the act's own.
        let robots = cast.robots(findings, name);
        if !taken(findings, act, room, robots.len()) {
            break;
        }
        let new = robots.into_iter().filter(|robot| ruled.insert(*robot));
        policy.robots.extend(new.map(|robot| (cast.id(robot).clone(), *rule)));
    }
    if let Some(Way::Act(then)) = act.on_failure.then.as_ref().and_then(|name| by_name.find(findings, name)) {
        policy.then = Some(then);
    }
    Ways { wait: act.wait.wait.clone(), on_timeout, next, on_failure: policy }
}

/// Whether there is room for a rule of this many robots: each act has its own for each of them.
fn taken(findings: &mut Reader, act: &Act, room: &mut Budget, robots: usize) -> bool {
    let (told, sound) = (room.is_overdrawn(), room.take(robots.max(1)));
    if !sound && !told {
        let message = format!("with the act `{}` there are too many rules for robots", shortened(&act.name));
        let expected = format!("at most {} in all acts", room.most());
        let hint = Some("let `on_failure` have one word for all, or fewer acts".to_owned());
        findings.add(Code::TooMuch, act.place.clone(), message, expected, hint);
    }
    sound
}

/// The acts, of those of one name the first.
struct ByName<'a> {
    acts: &'a [Act],
    index_of: HashMap<&'a str, usize>,
}

impl ByName<'_> {
    fn find(&self, findings: &mut Reader, name: &Name) -> Option<Way> {
        if name.text == "end" {
            return Some(Way::End);
        }
        let found = self.index_of.get(name.text.as_str()).copied();
        if found.is_none() {
            let known = || self.acts.iter().map(|act| act.name.as_str());
            let hint = findings.did_you_mean(&name.text, known());
            let message = format!("no act `{}`", shortened(&name.text));
            let expected = format!("`end` or one of {}", names(known()));
            findings.add(Code::UnknownAct, name.place.clone(), message, expected, hint);
        }
        found.map(Way::Act)
    }
}

fn check_sensor(findings: &mut Reader, cast: &Cast<'_>, act: &Act, robot: &str, sensor: &str) {
    let name = Name { text: robot.to_owned(), place: act.wait.place.of_key("sensor") };
    let robots = cast.robots(findings, &name);
    let [robot] = robots.as_slice() else {
        if robots.len() > 1 {
            let message = format!("`{}` is {} robots", shortened(robot), robots.len());
            findings.add(Code::UnknownSensor, name.place, message, "one robot to wait for", None);
        }
        return;
    };
    let has = cast
        .devices(*robot)
        .iter()
        .any(|device| device.id.as_str() == sensor && device.available_control_types.sensor().is_some());
    if !has {
        unknown_sensor(findings, cast, &robots, (&format!("{}/", name.text), sensor), &name.place);
    }
}

fn check_graph(findings: &mut Reader, acts: &[Act], ways: &[Ways]) {
    let mut graph: DiGraph<(), ()> = DiGraph::new();
    let nodes: Vec<NodeIndex> = acts.iter().map(|_| graph.add_node(())).collect();
    let end = graph.add_node(());
    for (index, ways) in ways.iter().enumerate() {
        let then = ways.on_failure.then.map(Way::Act);
        for way in [Some(ways.next), Some(ways.on_timeout), then].into_iter().flatten() {
            match way {
                Way::Act(act) => drop(graph.add_edge(nodes[index], nodes[act], ())),
                Way::End => drop(graph.add_edge(nodes[index], end, ())),
                // A mission that fails has not come to its end.
                Way::Fail => {}
            }
        }
    }
    let Some(&first) = nodes.first() else { return };
    let mut reached = Dfs::new(&graph, first);
    while reached.next(&graph).is_some() {}
    let backwards = Reversed(&graph);
    let mut ending = Dfs::new(backwards, end);
    while ending.next(backwards).is_some() {}
    for (act, node) in acts.iter().zip(&nodes) {
        let name = shortened(&act.name);
        if !reached.discovered.contains(node.index()) {
            let message = format!("no way leads to the act `{name}`");
            let hint = Some("name it under `next`, `otherwise` or `then` of another act".to_owned());
            findings.add(Code::Unreachable, act.place.clone(), message, "acts that can be reached", hint);
        } else if !ending.discovered.contains(node.index()) {
            let message = format!("no way leads from the act `{name}` to the end");
            let hint = Some("let one of the acts that follow it have `next: end`".to_owned());
            findings.add(Code::DeadEnd, act.place.clone(), message, "acts that come to an end", hint);
        }
    }
}
