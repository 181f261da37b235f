//! The graph of acts: the target of each transition, unreachable acts, and acts that never lead to the end.

use std::collections::{HashMap, HashSet};

use petgraph::Direction;
use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::{Dfs, IntoNeighbors, Reversed, Visitable};
use urrcp::Device;

use super::cast::Cast;
use super::perform::unknown_sensor;
use crate::budget::{Budget, USES_MAX};
use crate::fields::{Name, Reader};
use crate::finding::{Code, Place, did_you_mean_this, names};
use crate::plan::{FailurePolicy, Wait, Way};
use crate::scenario::Act;
use crate::sensor_range::SensorRange;
use crate::shown::shortened;

/// What an act waits for before it begins, and the acts to which its transitions lead.
pub(super) struct Ways {
    pub(super) wait: Wait,
    pub(super) on_timeout: Way,
    pub(super) next: Way,
    pub(super) on_failure: FailurePolicy,
}

/// Returns the transitions of each act. `complete` states whether all acts could be read; only then can the graph be checked.
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
            let message = format!("duplicate act name `{}`", shortened(&act.name));
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
    let mut wait = act.wait.wait.clone();
    if let Wait::Sensor { robot, sensor, range } = &mut wait
        && let Some((known, device)) = check_sensor(findings, cast, act, robot, sensor)
    {
        check_range(findings, act, device, range);
        // The ids as declared by the robots.
        (*robot, *sensor) = (cast.id(known).to_string(), device.id.to_string());
    }
    let mut ruled = HashSet::new();
    let mut policy =
        FailurePolicy { default: act.on_failure.default.unwrap_or_default(), ..FailurePolicy::default() };
    for (name, rule) in act.on_failure.robots.iter().chain(act.on_failure.inherited.iter()) {
        // If a robot has several rules, the act's own comes first.
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
    Ways { wait, on_timeout, next, on_failure: policy }
}

/// Whether the budget has room for the failure rules of `act`: each act has a separate rule for each of `robots` robots.
fn taken(findings: &mut Reader, act: &Act, room: &mut Budget, robots: usize) -> bool {
    let (told, sound) = (room.is_overdrawn(), room.take(robots.max(1)));
    if !sound && !told {
        let message = format!(
            "the act `{}` brings the number of failure rules for robots above the maximum",
            shortened(&act.name)
        );
        let expected = format!("at most {} in all acts", room.most());
        let hint = Some("use one word for all robots under `on_failure`, or fewer acts".to_owned());
        findings.add(Code::TooMuch, act.place.clone(), message, expected, hint);
    }
    sound
}

/// The acts by name. If a name occurs several times, the first act applies.
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
            let number =
                name.text.parse::<usize>().ok().and_then(|number| self.acts.get(number.checked_sub(1)?));
            let hint = match (name.text.as_str(), number) {
                (_, Some(act)) => Some(did_you_mean_this(&shortened(&act.name))),
                ("next" | "following" | "continue", _) => {
                    Some("leave it out: acts follow each other in the order of the file".to_owned())
                }
                ("stop" | "finish" | "exit" | "quit" | "done" | "none", _) => Some(did_you_mean_this("end")),
                _ => findings.did_you_mean(&name.text, known().chain(["end"])),
            };
            let message = format!("no act `{}`", shortened(&name.text));
            let expected = format!("`end` or one of {}", names(known()));
            findings.add(Code::UnknownAct, name.place.clone(), message, expected, hint);
        }
        found.map(Way::Act)
    }
}

/// Returns the sensor whose reading an act waits for, and the robot that has the sensor.
fn check_sensor<'c>(
    findings: &mut Reader,
    cast: &Cast<'c>,
    act: &Act,
    robot: &str,
    sensor: &str,
) -> Option<(usize, &'c Device)> {
    let name = Name { text: robot.to_owned(), place: act.wait.place.of_key("sensor") };
    let robots = cast.robots(findings, &name);
    let [robot] = robots.as_slice() else {
        if robots.len() > 1 {
            let message = format!("`{}` includes {} robots", shortened(robot), robots.len());
            findings.add(Code::UnknownSensor, name.place, message, "one robot to wait for", None);
        }
        return None;
    };
    let found =
        cast.device(*robot, sensor).filter(|device| device.available_control_types.sensor().is_some());
    if found.is_none() {
        unknown_sensor(findings, cast, &robots, (&format!("{}/", name.text), sensor), &name.place);
    }
    Some((*robot, found?))
}

/// Checks that the sensor's range includes a reading that would end the act's wait.
fn check_range(findings: &mut Reader, act: &Act, device: &Device, range: &SensorRange) {
    let Some(sensor) = device.available_control_types.sensor() else { return };
    let (least, most) = (sensor.min_value, sensor.max_value);
    let (key, waits, is_possible) = match *range {
        SensorRange::Above(bound) => ("above", bound.to_string(), most > bound),
        SensorRange::Below(bound) => ("below", bound.to_string(), least < bound),
        SensorRange::Within(from, to) => ("within", format!("{from} to {to}"), from <= most && to >= least),
    };
    if !is_possible {
        let message = format!("`{}` never reads {key} {waits}", device.id);
        let expected = format!("a value that the sensor can read, from {least} to {most}");
        findings.add(Code::OutOfRange, act.wait.place.of_key(key), message, expected, None);
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
                // A failed mission has not reached its end.
                Way::Fail => {}
            }
        }
    }
    let Some(&first) = nodes.first() else { return };
    let reached = found_from(&graph, first);
    let ending = found_from(Reversed(&graph), end);
    for circle in circles(&graph, |node| !reached.contains(&node) && node != end, Direction::Incoming) {
        unreachable(findings, acts, &circle, &found_from(&graph, circle[0]));
    }
    let stuck = |node| reached.contains(&node) && !ending.contains(&node);
    for circle in circles(&graph, stuck, Direction::Outgoing) {
        dead_end(findings, acts, &circle);
    }
}

fn found_from<G>(graph: G, first: NodeIndex) -> HashSet<NodeIndex>
where
    G: IntoNeighbors<NodeId = NodeIndex> + Visitable<NodeId = NodeIndex>,
{
    let mut search = Dfs::new(graph, first);
    std::iter::from_fn(|| search.next(graph)).collect()
}

/// Returns the groups of chosen acts that can all reach each other, in the order of the file. Omits each group that a transition in
/// `direction` connects with a chosen act outside the group.
fn circles(
    graph: &DiGraph<(), ()>,
    is_chosen: impl Fn(NodeIndex) -> bool,
    direction: Direction,
) -> Vec<Vec<NodeIndex>> {
    let chosen = graph.filter_map(|node, ()| is_chosen(node).then_some(node), |_, ()| Some(()));
    let mut circles = tarjan_scc(&chosen);
    circles.retain(|circle| {
        let mut others = circle.iter().flat_map(|node| chosen.neighbors_directed(*node, direction));
        others.all(|other| circle.contains(&other))
    });
    for circle in &mut circles {
        circle.iter_mut().for_each(|node| *node = chosen[*node]);
        circle.sort_unstable();
    }
    circles.sort_unstable();
    circles
}

fn named(acts: &[Act], nodes: impl IntoIterator<Item = NodeIndex>) -> String {
    names(nodes.into_iter().map(|node| acts[node.index()].name.as_str()))
}

fn unreachable(findings: &mut Reader, acts: &[Act], circle: &[NodeIndex], beyond: &HashSet<NodeIndex>) {
    let Some(first) = circle.first() else { return };
    let act = &acts[first.index()];
    let mut others: Vec<NodeIndex> =
        beyond.iter().copied().filter(|node| node != first && node.index() < acts.len()).collect();
    others.sort_unstable();
    let others = match others.as_slice() {
        [] => String::new(),
        others => format!(", and with it {}", named(acts, others.iter().copied())),
    };
    let message = format!("the act `{}` is unreachable{others}", shortened(&act.name));
    let hint = Some("refer to it under `next`, `otherwise` or `then` in another act".to_owned());
    findings.add(Code::Unreachable, act.place.clone(), message, "acts that can be reached", hint);
}

/// Reports a cycle of acts that never ends. The last of these acts in the file is the one that leads back.
fn dead_end(findings: &mut Reader, acts: &[Act], circle: &[NodeIndex]) {
    let Some(last) = circle.last().map(|node| &acts[node.index()]) else { return };
    let name = shortened(&last.name);
    let message = match circle {
        [_] => format!("the act `{name}` follows itself and never reaches `end`"),
        _ => {
            format!("the acts {} form a cycle that never reaches `end`", named(acts, circle.iter().copied()))
        }
    };
    let place = last.next.as_ref().map_or_else(|| last.place.clone(), |next| Place::clone(&next.place));
    let end = format!("write `next: end` in the act `{name}`");
    let hint = Some(match circle {
        [_] => format!(
            "{end}; to repeat it until the operator continues, add `wait: {{for: operator, timeout: 1s, otherwise: {name}}}` to the act after it"
        ),
        _ => end,
    });
    findings.add(Code::DeadEnd, place, message, "acts that reach `end`", hint);
}
