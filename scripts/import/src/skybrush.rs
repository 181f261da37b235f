//! Reads compiled drone shows of Skybrush. A `.skyc` file is a ZIP archive of `show.json` and the files to which it refers. These contain
//! paths as Bezier curves, headings, and light programs.

use std::collections::BTreeSet;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use urrcp::Span;

use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::{Code, names};
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::archive::Archive;
use super::input::Input;
use super::light_program::{self, Color, Lights};
use super::malformed::Malformed;
use super::sink::Sink;
use super::{
    Clearance, Course, DeviceMotion, ImportOptions, Keyframe, Motion, Piece, RobotMotion, keyframes, tree,
};

/// Maximum number of control points between two points of a path. As in Skybrush, curves have at most degree 7.
const CONTROLS_MAX: usize = 6;
/// Maximum number of drones.
const DRONES_MAX: usize = 10_000;
/// Default number of samples of a fade per second: one for each frame of the light programs.
const FADE_HZ: f64 = 50.0;
const AXES: [&str; 3] = ["x", "y", "z"];
/// The keys of a show that the import uses. `DRONE_KEYS` contains those of a drone's settings.
const SHOW_KEYS: [&str; 4] = ["version", "swarm", "settings", "environment"];
/// Default minimum distances between drones, indoors and outdoors, in metres, as in Skybrush's viewer.
const INDOOR_M: f64 = 0.5;
const OUTDOOR_M: f64 = 3.0;
const DRONE_KEYS: [&str; 4] = ["name", "trajectory", "lights", "yawControl"];

/// The parts of a drone. Each part is in a separate file or in the show's file.
struct Drone {
    name: String,
    trajectory: PartSource,
    lights: Option<PartSource>,
    yaw: Option<PartSource>,
}

/// Where a part of the show is written: in the show's file or in a separate file.
enum PartSource {
    Here(Node),
    File(String),
}

/// Observations that are reported once for all drones.
#[derive(Default)]
struct ShowRemarks {
    left_out: BTreeSet<String>,
    pyro: usize,
    endless: usize,
    fades: usize,
    auto_yaw: usize,
    late_yaw: usize,
    still: usize,
    clearance: Option<Clearance>,
}

/// The context for reading one drone's files.
struct Show<'a> {
    archive: Archive<'a>,
    name: &'a str,
    period_ms: u64,
    told: ShowRemarks,
}

/// Reads one file, which contains the motions of all drones in one scene.
pub(super) fn read(
    input: &Input,
    name: &str,
    bytes: &[u8],
    options: &ImportOptions,
    sink: &mut Sink,
) -> Vec<Motion> {
    let archive = match Archive::new(bytes) {
        Ok(archive) => archive,
        Err(fault) => {
            sink.about(
                name,
                Code::Unreadable,
                fault.to_string(),
                "a compiled Skybrush show, a ZIP archive with `show.json`",
                None,
            );
            return Vec::new();
        }
    };
    let mut show = Show { archive, name, period_ms: period_ms(options), told: ShowRemarks::default() };
    let drones = show.source("show.json", sink).and_then(|source| {
        tree::read_json(&source, sink, |root, findings, _| read_show(root, &mut show.told, findings))
    });
    let mut motions = Vec::new();
    let mut steps = 0;
    for drone in drones.unwrap_or_default() {
        let devices = show.devices(&drone, sink);
        steps += devices.iter().map(|device| device.keyframes.len()).sum::<usize>();
        motions
            .push(Motion { scene: input.scene.clone(), robot: RobotMotion { robot: drone.name, devices } });
        if !sink.has_room_for(steps as f64) || sink.findings.len() > super::sink::FINDINGS_A_FILE_MAX {
            break;
        }
    }
    show.told.note(name, show.period_ms, sink);
    sink.clearance = sink.clearance.or(show.told.clearance);
    motions
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 1 to 1,000,000")]
fn period_ms(options: &ImportOptions) -> u64 {
    (1_000.0 / options.rate_hz.unwrap_or(FADE_HZ)).clamp(1.0, 1e6) as u64
}

impl ShowRemarks {
    fn note(&self, file: &str, period_ms: u64, sink: &mut Sink) {
        let mut tell = |count: usize, text: &str| {
            if count > 0 {
                sink.note(format!("{file}: {}: {text}", downbeat_yaml::render::counted(count, "drone")));
            }
        };
        tell(self.pyro, "left out fireworks");
        tell(self.auto_yaw, "headings along the path are ignored");
        tell(self.endless, "lights that repeat forever end with the path");
        tell(
            self.late_yaw,
            "heading times are counted from the start of the show, not from the takeoff, as in Skybrush",
        );
        tell(self.still, "left out points with the same time and position as the previous point");
        tell(
            self.fades,
            &format!("lights fade in steps, one every {period_ms} ms; use --rate to change this"),
        );
        if !self.left_out.is_empty() {
            sink.note(format!("{file}: left out {}", names(self.left_out.iter().map(String::as_str))));
        }
    }
}

fn read_show(root: &At<'_>, told: &mut ShowRemarks, findings: &mut Reader) -> Option<Vec<Drone>> {
    version(root, "the show", findings);
    note_unused(root, "", &SHOW_KEYS, told);
    told.clearance = Some(clearance(root));
    let swarm = tree::required(root, "swarm", "the show", findings)?;
    let list = tree::required(&swarm, "drones", "the swarm", findings)?;
    let items = findings.list(&list, "a list of drones");
    if items.is_empty() || items.len() > DRONES_MAX {
        let message = format!("the show has {} drones", items.len());
        findings.add(Code::ImportLimit, list.place(), message, format!("1 to {DRONES_MAX} drones"), None);
        return None;
    }
    let mut drones = Vec::with_capacity(items.len());
    for (index, item) in items.iter().enumerate() {
        let what = format!("drone {}", index + 1);
        let Some(settings) = tree::required(item, "settings", &what, findings) else { continue };
        note_unused(&settings, "drones' ", &DRONE_KEYS, told);
        let name = match tree::optional(&settings, "name").map(|at| at.node) {
            Some(Node::Text(name)) if !name.is_empty() => name.clone(),
            _ => what.clone(),
        };
        let trajectory = tree::required(&settings, "trajectory", &what, findings)?;
        let part =
            |key| tree::optional(&settings, key).filter(|at| *at.node != Node::Null).map(|at| part(&at));
        drones.push(Drone {
            name,
            trajectory: self::part(&trajectory),
            lights: part("lights"),
            yaw: part("yawControl"),
        });
    }
    Some(drones)
}

/// Returns the minimum distance between drones with which the show was validated.
fn clearance(root: &At<'_>) -> Clearance {
    let stated = tree::optional(root, "settings").and_then(|settings| {
        let validation = tree::optional(&settings, "validation")?;
        let metres = tree::optional(&validation, "minDistance")
            .or_else(|| tree::optional(&validation, "min_distance"))?;
        match metres.node {
            Node::Number(metres) if *metres > 0.0 && metres.is_finite() => Some(*metres),
            _ => None,
        }
    });
    let is_indoor = tree::optional(root, "environment").and_then(|environment| {
        tree::optional(&environment, "type").map(|at| at.node == &Node::Text("indoor".into()))
    });
    match (stated, is_indoor) {
        (Some(metres), _) => Clearance { metres, origin: "the distance stated in the Skybrush show" },
        (None, Some(true)) => {
            Clearance { metres: INDOOR_M, origin: "the distance that Skybrush requires in indoor shows" }
        }
        (None, _) => {
            Clearance { metres: OUTDOOR_M, origin: "the distance that Skybrush requires in outdoor shows" }
        }
    }
}

fn note_unused(at: &At<'_>, whose: &str, used: &[&str], told: &mut ShowRemarks) {
    let Node::Map(entries) = at.node else { return };
    for (key, _) in entries.iter().filter(|(key, _)| !used.contains(&key.as_str())).take(50) {
        if told.left_out.len() < 50 {
            told.left_out.insert(format!("{whose}{}", shortened(key)));
        }
    }
}

fn version(at: &At<'_>, what: &str, findings: &mut Reader) {
    if let Some(version) = tree::required(at, "version", what, findings)
        && *version.node != Node::Number(1.0)
    {
        let message = format!("unsupported version of {what}: {}", version.node.kind());
        findings.add(Code::ImportShape, version.place(), message, "version 1", None);
    }
}

/// Locates a part of the show. For example, `{"$ref": "./drones/drone_01/trajectory.json#"}` refers to another file of the archive.
fn part(at: &At<'_>) -> PartSource {
    match tree::optional(at, "$ref").map(|at| at.node) {
        Some(Node::Text(reference)) => {
            let path = reference.split('#').next().unwrap_or("");
            PartSource::File(path.trim_start_matches("./").trim_start_matches('/').to_owned())
        }
        _ => PartSource::Here(at.node.clone()),
    }
}

impl Show<'_> {
    fn source(&mut self, file: &str, sink: &mut Sink) -> Option<Source> {
        let name = format!("{}/{file}", self.name);
        let bytes = match self.archive.file(file) {
            Ok(bytes) => bytes,
            Err(fault) => {
                let known: Vec<String> = self.archive.names().take(6).collect();
                let known = names(known.iter().map(String::as_str));
                let hint = Some(format!("the archive contains {known}")).filter(|_| !known.is_empty());
                sink.about(&name, Code::Unreadable, fault.to_string(), "a file of the show", hint.as_deref());
                return None;
            }
        };
        Source::of_bytes(&name, bytes).map_err(|finding| sink.findings.push(finding)).ok()
    }

    /// Reads a part of a drone from the show's file or from a separate file.
    fn part<T>(
        &mut self,
        part: &PartSource,
        whose: &str,
        sink: &mut Sink,
        read: impl FnOnce(&At<'_>, &mut Reader) -> Option<T>,
    ) -> Option<T> {
        match part {
            PartSource::File(file) => {
                let source = self.source(file, sink)?;
                tree::read_json(&source, sink, |root, findings, _| read(root, findings))
            }
            PartSource::Here(node) => {
                let mut findings = Reader::default();
                let result = read(&At::document(node, 0), &mut findings);
                let sound = findings.found.is_empty();
                for found in findings.found.into_iter().take(super::sink::FINDINGS_A_FILE_MAX) {
                    let name = format!("{}/show.json", self.name);
                    let message = format!("{whose}: {}", found.message);
                    sink.about(&name, found.code, message, &found.expected, found.hint.as_deref());
                }
                result.filter(|_| sound)
            }
        }
    }

    fn devices(&mut self, drone: &Drone, sink: &mut Sink) -> Vec<DeviceMotion> {
        let whose = format!("`{}`", shortened(&drone.name));
        let mut devices = Vec::new();
        let Some(way) = self.part(&drone.trajectory, &whose, sink, read_way) else { return devices };
        self.told.still += usize::from(way.still > 0);
        let end_ms = way.end.as_nanos().unsigned_abs().div_ceil(1_000_000);
        devices.extend((0..3).map(|axis| way.device(axis)));
        if let Some(yaw) = &drone.yaw {
            let read = self.part(yaw, &whose, sink, read_yaw);
            if let Some(Yaw { auto, keyframes }) = read {
                self.told.auto_yaw += usize::from(auto);
                self.told.late_yaw += usize::from(way.takeoff > Span::ZERO && !keyframes.is_empty());
                let motion = DeviceMotion {
                    device: "yaw".into(),
                    unit: "deg".into(),
                    keyframes,
                    ..DeviceMotion::default()
                };
                devices.extend(Some(motion).filter(|motion| !motion.keyframes.is_empty()));
            }
        }
        if let Some(lights) = &drone.lights {
            let read = self.part(lights, &whose, sink, |at, findings| read_lights(at, end_ms, findings));
            devices.extend(read.map(|lights| self.lamp(&lights)));
        }
        devices
    }

    fn lamp(&mut self, lights: &Lights) -> DeviceMotion {
        self.told.pyro += usize::from(lights.pyro > 0);
        self.told.endless += usize::from(lights.endless);
        self.told.fades += usize::from(lights.glows.iter().any(|glow| glow.until_ms > glow.from_ms));
        let samples = light_program::sampled(lights, self.period_ms);
        let keyframe = |(at_ms, color): &(u64, Color)| {
            let at = Span::from_millis(i64::try_from(*at_ms).unwrap_or(i64::MAX));
            Keyframe { at, value: f64::from(color[0]) }
        };
        let values = samples.iter().map(|(_, color)| color.map(f64::from).to_vec()).collect();
        let mut lamp = DeviceMotion {
            device: "lamp".into(),
            keyframes: samples.iter().map(keyframe).collect(),
            course: Course::Several(values),
            ..DeviceMotion::default()
        };
        lamp.thin();
        lamp
    }
}

/// The path of a drone, from the start of the show.
struct FlightPath {
    takeoff: Span,
    end: Span,
    points: Vec<Waypoint>,
    still: usize,
}

struct Waypoint {
    at: Span,
    position: [f64; 3],
    /// Control points of the curve from the previous point to this one.
    controls: Vec<[f64; 3]>,
}

impl FlightPath {
    /// Converts one axis of the path. A straight path becomes keyframes; any other path becomes a curve.
    fn device(&self, axis: usize) -> DeviceMotion {
        let first = self
            .points
            .first()
            .filter(|first| first.at > Span::ZERO)
            .map(|first| Keyframe { at: Span::ZERO, value: first.position[axis] + 0.0 });
        let rest =
            self.points.iter().map(|point| Keyframe { at: point.at, value: point.position[axis] + 0.0 });
        let keyframes: Vec<Keyframe> = first.into_iter().chain(rest).collect();
        let plain = self.points.iter().all(|point| point.controls.is_empty());
        let course =
            if plain && self.points.len() > 1 { Course::Straight } else { Course::Pieces(self.pieces(axis)) };
        DeviceMotion { device: AXES[axis].into(), unit: "m".into(), keyframes, course }
    }

    fn pieces(&self, axis: usize) -> Vec<Piece> {
        let waits = self.points.first().filter(|first| first.at > Span::ZERO);
        let still = waits.map(|first| Piece { length: first.at, coefficients: vec![first.position[axis]] });
        let pieces = self.points.windows(2).map(|pair| {
            let length = pair[1].at - pair[0].at;
            let controls = pair[1].controls.iter().map(|control| control[axis]);
            let points =
                std::iter::once(pair[0].position[axis]).chain(controls).chain([pair[1].position[axis]]);
            let points: Vec<f64> = points.collect();
            Piece { length, coefficients: coefficients(&points, keyframes::seconds(length)) }
        });
        let mut pieces: Vec<Piece> = still.into_iter().chain(pieces).collect();
        if let (true, Some(only)) = (pieces.is_empty(), self.points.first()) {
            pieces.push(Piece { length: Span::from_millis(1), coefficients: vec![only.position[axis]] });
        }
        pieces
    }
}

/// Converts a Bezier curve to coefficients c_i for powers of the time in seconds: c_i = (n over i) / T^i times the i-th difference of its
/// points. n is the degree of the curve, and T is its duration in seconds.
fn coefficients(points: &[f64], seconds: f64) -> Vec<f64> {
    let mut differences = points.to_vec();
    let degree = points.len() - 1;
    let mut factor = 1.0;
    let mut coefficients = Vec::with_capacity(points.len());
    for i in 0..=degree {
        coefficients.push(differences[0] * factor + 0.0);
        differences = differences.windows(2).map(|pair| pair[1] - pair[0]).collect();
        factor *= (degree - i) as f64 / ((i + 1) as f64 * seconds);
    }
    while coefficients.len() > 1 && coefficients.last() == Some(&0.0) {
        coefficients.pop();
    }
    coefficients
}

fn read_way(at: &At<'_>, findings: &mut Reader) -> Option<FlightPath> {
    version(at, "the trajectory", findings);
    let takeoff = match tree::optional(at, "takeoffTime").filter(|at| *at.node != Node::Null) {
        Some(at) => time_of(&at, "the takeoff", findings)?,
        None => Span::ZERO,
    };
    let list = tree::required(at, "points", "the trajectory", findings)?;
    let items = tree::points(&list, findings);
    let mut way = FlightPath { takeoff, end: Span::ZERO, points: Vec::with_capacity(items.len()), still: 0 };
    for (index, item) in items.iter().enumerate() {
        if let Some(point) = read_point(item, index, takeoff, findings) {
            way.add(point, item, index, findings);
        }
        if tree::is_full(findings) {
            return None;
        }
    }
    way.end = way.points.last()?.at;
    Some(way)
}

impl FlightPath {
    fn add(&mut self, point: Waypoint, at: &At<'_>, index: usize, findings: &mut Reader) {
        let Some(last) = self.points.last() else { return self.points.push(point) };
        if last.at < point.at {
            return self.points.push(point);
        }
        if last.at == point.at && last.position == point.position {
            self.still += 1;
            return;
        }
        let [before, now] = [last.at, point.at].map(keyframes::seconds);
        let message = format!("point {} at {now} s follows a point at {before} s", index + 1);
        let hint = "times must increase from point to point".to_owned();
        findings.add(Code::ImportTime, at.place(), message, format!("a time after {before} s"), Some(hint));
    }
}

fn time_of(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<Span> {
    let seconds = tree::number(at, &format!("the time of {what}"), findings)?;
    let time = keyframes::span(seconds);
    if time.is_none() {
        let expected = format!("a time from 0 to {} s", keyframes::SECONDS_MAX);
        findings.add(Code::ImportTime, at.place(), format!("{what} is at {seconds} s"), expected, None);
    }
    time
}

/// Reads a point: `[time, [x, y, z], [control points]]`.
fn read_point(at: &At<'_>, index: usize, takeoff: Span, findings: &mut Reader) -> Option<Waypoint> {
    let what = format!("point {}", index + 1);
    let parts = findings.list(at, "[time, [x, y, z], control points]");
    let [time, position, rest @ ..] = parts.as_slice() else {
        if matches!(at.node, Node::List(_)) {
            let message = format!("{what} has {} parts", parts.len());
            findings.add(Code::ImportShape, at.place(), message, "[time, [x, y, z], control points]", None);
        }
        return None;
    };
    let reached = time_of(time, &what, findings)? + takeoff;
    let position = vector(position, &what, findings)?;
    let controls = match rest.first().filter(|at| *at.node != Node::Null) {
        Some(at) => findings.list(at, "a list of control points"),
        None => Vec::new(),
    };
    if controls.len() > CONTROLS_MAX {
        let message = format!("{what} has {} control points", controls.len());
        findings.add(Code::ImportShape, at.place(), message, format!("at most {CONTROLS_MAX}"), None);
        return None;
    }
    let controls: Option<Vec<_>> = controls.iter().map(|at| vector(at, &what, findings)).collect();
    Some(Waypoint { at: reached, position, controls: controls? })
}

fn vector(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<[f64; 3]> {
    let values = tree::numbers(at, what, findings)?;
    let vector = <[f64; 3]>::try_from(values.as_slice()).ok();
    if vector.is_none() {
        let message = format!("{what} has {} coordinates", values.len());
        findings.add(Code::ImportShape, at.place(), message, "three numbers: x, y, z", None);
    }
    vector
}

struct Yaw {
    auto: bool,
    keyframes: Vec<Keyframe>,
}

fn read_yaw(at: &At<'_>, findings: &mut Reader) -> Option<Yaw> {
    version(at, "the heading", findings);
    let auto = tree::optional(at, "autoYaw").is_some_and(|at| *at.node == Node::Bool(true));
    let Some(list) = tree::optional(at, "setpoints") else {
        return Some(Yaw { auto, keyframes: Vec::new() });
    };
    let mut keyframes: Vec<Keyframe> = Vec::new();
    for (index, item) in findings.list(&list, "a list of [time, degrees]").iter().enumerate() {
        let what = format!("heading {index}");
        let values = tree::numbers(item, &what, findings)?;
        let [seconds, value] = values[..] else {
            findings.add(
                Code::ImportShape,
                item.place(),
                format!("{what} has {} parts", values.len()),
                "[time, degrees]",
                None,
            );
            return None;
        };
        match (keyframes::span(seconds), keyframes.last()) {
            (Some(at), None) => keyframes.push(Keyframe { at, value }),
            (Some(at), Some(last)) if last.at < at => keyframes.push(Keyframe { at, value }),
            (Some(at), Some(last)) if last.at == at && last.value == value => {}
            _ => {
                let message = format!("{what} is at {seconds} s");
                findings.add(
                    Code::ImportTime,
                    item.place(),
                    message,
                    "times of at least 0, in increasing order",
                    None,
                );
                return None;
            }
        }
    }
    Some(Yaw { auto, keyframes })
}

fn read_lights(at: &At<'_>, end_ms: u64, findings: &mut Reader) -> Option<Lights> {
    version(at, "the light program", findings);
    let data = tree::required(at, "data", "the light program", findings)?;
    let Node::Text(text) = data.node else {
        findings.wrong_type(&data, "a base64 text");
        return None;
    };
    let decoded = STANDARD.decode(text.trim());
    let bytes = decoded.map_err(|error| Malformed::from(format!("this is not base64: {error}")));
    match bytes.and_then(|bytes| light_program::play(&bytes, end_ms)) {
        Ok(lights) => Some(lights),
        Err(fault) => {
            findings.add(
                Code::ImportShape,
                data.place(),
                fault.to_string(),
                "a Skybrush light program",
                None,
            );
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bezier_curve_equals_its_power_form() {
        let points = [1.0, -2.0, 4.0, 0.5];
        let powers = coefficients(&points, 2.5);
        for step in 0..=10 {
            let s = f64::from(step) / 10.0;
            let r = 1.0 - s;
            let bezier = points[0] * r * r * r
                + 3.0 * points[1] * s * r * r
                + 3.0 * points[2] * s * s * r
                + points[3] * s * s * s;
            let sum = powers.iter().rev().fold(0.0, |sum, c| sum * (2.5 * s) + c);
            assert!((sum - bezier).abs() < 1e-12, "at {s}: {sum} {bezier}");
        }
        assert_eq!(coefficients(&[1.0, 3.0], 2.0), [1.0, 1.0]);
    }
}
