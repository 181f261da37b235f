//! Compiles any text as a scenario for a small fleet. The text after a line `%%` is the file `a.yaml`, which the scenario can include.
//! The compiler does not panic or hang, and its memory is bounded. Its findings refer to places in the text. It returns a choreography
//! exactly if there is no error.
#![no_main]

use std::path::Path;
use std::sync::LazyLock;

use downbeat_scripts::{
    Address, Body, Coordinate, Files, Finding, Fleet, FleetRobot, NoFiles, Severity, Shape, Source, compile,
    read_fleet, render, sarif,
};
use libfuzzer_sys::fuzz_target;

/// The description of a drone with a position in three dimensions, so that it can move in formations.
const DRONE: &str = r#"{"id": "drone", "api_version": "1", "devices": [
  {"id": "x", "name": "x", "default_value": 0, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -50, "max_value": 50, "granularity": 0.01, "max_error": 0.01},
     "script": {"min_value": -50, "max_value": 50, "granularity": 0.01, "max_number_of_steps": 256}}},
  {"id": "y", "name": "y", "default_value": 0, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -50, "max_value": 50, "granularity": 0.01, "max_error": 0.01},
     "script": {"min_value": -50, "max_value": 50, "granularity": 0.01, "max_number_of_steps": 256}}},
  {"id": "z", "name": "z", "default_value": 0, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": 0, "max_value": 50, "granularity": 0.01, "max_error": 0.01},
     "script": {"min_value": 0, "max_value": 50, "granularity": 0.01, "max_number_of_steps": 256}}}]}"#;

/// Returns a drone whose home position is `along` metres along x.
fn drone(name: &str, along: f64) -> FleetRobot {
    let mut init: urrcp::InitializationBlock = serde_json::from_str(DRONE).unwrap();
    init.id = urrcp::RobotId::new(name).unwrap();
    let device =
        |id: &str, offset: f64| Coordinate::Device { device: id.parse().unwrap(), scale: 1.0, offset };
    let coordinates = [device("x", along), device("y", 0.0), device("z", 0.0), Coordinate::Fixed(0.0)];
    let body = Body {
        coordinates,
        shape: Shape::Ball { radius: 0.1 },
        speed: Some(5.0),
        acceleration: Some(8.0),
        ..Body::default()
    };
    FleetRobot { body: Some(body), ..FleetRobot::new(init.id.clone(), Address::Simulated, Some(init)) }
}

/// The robots that the seed scenarios in `tests/sessions/findings` use, and four drones.
static FLEET: LazyLock<Fleet> = LazyLock::new(|| {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/sessions/findings/folder/fleet.yaml");
    let mut fleet = read_fleet(&path).0.unwrap();
    let drones = [drone("e", 0.0), drone("f", 1.0), drone("g", 2.0), drone("h", 3.0)];
    fleet.groups.insert("drones".to_owned(), drones.iter().map(|drone| drone.id.clone()).collect());
    fleet.robots.extend(drones);
    fleet.space.distance = Some(0.2);
    fleet
});

/// Provides the text of `a.yaml`, the only file that a scenario can include.
struct Included<'t>(&'t str);

impl Files for Included<'_> {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        match name {
            "a.yaml" => Ok(Source { name: name.into(), text: self.0.to_owned() }),
            _ => NoFiles.read(name),
        }
    }
}

fuzz_target!(|text: &str| {
    let (text, included) = text.split_once("\n%%\n").unwrap_or((text, ""));
    let source = Source { name: "s.yaml".into(), text: text.to_owned() };
    let compiled = compile(&source, &FLEET, &Included(included));
    let error = |finding: &downbeat_scripts::Finding| finding.severity == Severity::Error;
    assert_eq!(compiled.choreography.is_none(), compiled.findings.iter().any(error));
    for finding in &compiled.findings {
        let text = if finding.file == "s.yaml" { text } else { included };
        let lines = text.matches(['\n', '\r']).count() + 1;
        assert!(finding.line <= lines, "{finding:?}");
    }
    let shown = render(&compiled.findings, true);
    assert!(!shown.is_empty());
    let _document = sarif(&compiled.findings).to_string();
});
