//! Reads waypoints: a CSV file with the header `id,x[m],y[m],z[m],t[s]`. Each line is the position of one robot at one time.

use std::collections::HashMap;

use urrcp::Span;

use downbeat_yaml::finding::Code;
use downbeat_yaml::render::counted;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::dialect::Dialect;
use super::input::{Input, drone_name};
use super::natural::natural_order;
use super::sink::Sink;
use super::table::{Row, rows};
use super::units::{self, name_and_unit};
use super::{DeviceMotion, Keyframe, Motion, RobotMotion, keyframes};

const COLUMNS: [(&str, &str); 5] = [("id", ""), ("x", "m"), ("y", "m"), ("z", "m"), ("t", "s")];

/// Maximum number of robots that are each reported in a separate note.
const NOTES_MAX: usize = 20;

struct Waypoint {
    at: Span,
    position: [f64; 3],
}

/// Reads one file. Returns the motions of its robots, as one scene.
pub(super) fn read(input: &Input, source: &Source, sink: &mut Sink) -> Vec<Motion> {
    let mut rows = rows(source, Dialect::of(source, 0, None));
    let Some(mut header) = rows.next() else {
        let expected = "the header id,x[m],y[m],z[m],t[s] and waypoints";
        sink.about(&source.name, Code::ImportTable, "the file is empty".into(), expected, None);
        return Vec::new();
    };
    header.drop_trailing(COLUMNS.len());
    let Some(factors) = factors(&header, source, sink) else { return Vec::new() };
    let before = sink.findings.len();
    let mut robots: HashMap<String, Vec<Waypoint>> = HashMap::new();
    let mut count = 0_usize;
    for mut row in rows {
        row.drop_trailing(COLUMNS.len());
        count += 3;
        if let Some((robot, waypoint)) = read_waypoint(&row, &factors, source, sink) {
            let own = robots.entry(robot).or_default();
            if own.last().is_none_or(|last| is_later(last, &waypoint, &row, source, sink)) {
                own.push(waypoint);
            }
        }
        if sink.is_full(source) || !sink.has_room_for(count as f64) {
            break;
        }
    }
    if robots.is_empty() && sink.findings.len() == before {
        sink.about(
            &source.name,
            Code::NothingToDo,
            "the file has no waypoints".into(),
            "one waypoint per line",
            None,
        );
    }
    let mut robots: Vec<_> = robots.into_iter().collect();
    robots.sort_by(|a, b| natural_order(&a.0, &b.0));
    note_unequal(&robots, source, sink);
    let motion = |(robot, own): (String, Vec<Waypoint>)| Motion {
        scene: input.scene.clone(),
        robot: robot_motion(robot, &own),
    };
    robots.into_iter().map(motion).collect()
}

/// Returns, for each column, the factor that converts its values to metres or seconds.
fn factors(header: &Row<'_>, source: &Source, sink: &mut Sink) -> Option<[f64; 5]> {
    let mut factors = [1.0; 5];
    for (index, (name, unit)) in COLUMNS.iter().enumerate() {
        let Some(cell) = header.cells.get(index) else { break };
        let (found, found_unit) = name_and_unit(&cell.text);
        let factor = if found_unit.is_empty() { Some(1.0) } else { units::factor(found_unit, unit) };
        match factor.filter(|_| found.eq_ignore_ascii_case(name)) {
            Some(factor) => factors[index] = factor,
            None => {
                let message = format!("column {} of the header is `{}`", index + 1, shortened(&cell.text));
                let hint = Some("the header must be id,x[m],y[m],z[m],t[s]");
                let expected =
                    if unit.is_empty() { format!("`{name}`") } else { format!("`{name}[{unit}]`") };
                sink.found(source, header.spot(index), Code::ImportTable, message, expected, hint);
                return None;
            }
        }
    }
    header.has(COLUMNS.len(), source, sink).then_some(factors)
}

fn read_waypoint(
    row: &Row<'_>,
    factors: &[f64; 5],
    source: &Source,
    sink: &mut Sink,
) -> Option<(String, Waypoint)> {
    if !row.has(COLUMNS.len(), source, sink) {
        return None;
    }
    let numbers = [1, 2, 3, 4].map(|index| {
        let number = row.number(index, &format!("`{}`", COLUMNS[index].0), source, sink);
        number.map(|number| number * factors[index])
    });
    let robot = drone_name(&row.cells[0].text);
    if robot.is_empty() {
        let message = "the waypoint has no robot id";
        sink.found(source, row.spot(0), Code::ImportNames, message, "the id of a robot", None);
    }
    let [x, y, z, at_s] = numbers;
    let at_s = at_s?;
    let Some(at) = keyframes::span(at_s) else {
        let expected = format!("a time from 0 to {} s", keyframes::SECONDS_MAX);
        sink.found(source, row.spot(4), Code::ImportTime, format!("the time is {at_s} s"), expected, None);
        return None;
    };
    let position = [x?, y?, z?];
    (!robot.is_empty()).then_some((robot, Waypoint { at, position }))
}

fn is_later(last: &Waypoint, next: &Waypoint, row: &Row<'_>, source: &Source, sink: &mut Sink) -> bool {
    keyframes::check_later(last.at, next.at).is_none_or(|(code, message, hint)| {
        let message = format!("robot `{}`: {message}", shortened(&row.cells[0].text));
        let expected = format!("a time after {} s", keyframes::seconds(last.at));
        sink.found(source, row.spot(4), code, message, expected, Some(hint));
        false
    })
}

/// Adds a note for each robot with fewer waypoints than others. This is not an error, because lines may be omitted.
fn note_unequal(robots: &[(String, Vec<Waypoint>)], source: &Source, sink: &mut Sink) {
    let most = robots.iter().map(|(_, own)| own.len()).max().unwrap_or(0);
    for (robot, own) in robots.iter().filter(|(_, own)| own.len() < most).take(NOTES_MAX) {
        let have = counted(own.len(), "waypoint");
        sink.note(format!(
            "{}: `{robot}` has {have}, but other robots have up to {most}: it moves in straight lines between its own waypoints",
            source.name
        ));
    }
}

fn robot_motion(robot: String, own: &[Waypoint]) -> RobotMotion {
    let device = |axis: usize| DeviceMotion {
        device: COLUMNS[axis + 1].0.to_owned(),
        unit: "m".to_owned(),
        keyframes: own.iter().map(|w| Keyframe { at: w.at, value: w.position[axis] + 0.0 }).collect(),
        ..DeviceMotion::default()
    };
    RobotMotion { robot, devices: (0..3).map(device).collect() }
}
