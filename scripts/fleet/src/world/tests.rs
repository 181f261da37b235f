use std::path::Path;

use urrcp::Span;

use super::{Between, Delay, Reading, Trouble, World, read_world};
use crate::fleet::{Fleet, read_fleet};
use downbeat_yaml::render::render;

fn fleet() -> Fleet {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fleet.yaml"));
    read_fleet(path).0.unwrap()
}

fn read(text: &str) -> Result<World, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("world.yaml");
    std::fs::write(&path, text).unwrap();
    let (world, findings) = read_world(&path, &fleet(), &["opening", "finale"]);
    world.ok_or_else(|| render(&findings, false))
}

fn index(robot: &str) -> usize {
    fleet().robots.iter().position(|known| known.id.as_str() == robot).unwrap()
}

#[test]
fn own_entry_overrides_group_entry_and_group_entry_overrides_all() {
    let world =
        read("world: w\nlinks: {cf1: {delay: 3ms}, drones: {delay: 2ms}, all: {delay: 1ms, loss: 0.5%}}")
            .unwrap();
    let delay = |robot| match &world.links[index(robot)].as_ref().unwrap().delay {
        Delay::Between(Between { least, .. }) => *least,
        Delay::Quantiles(_) => unreachable!(),
    };
    assert_eq!(["cf1", "cf2", "tank-1"].map(delay), [3, 2, 1].map(Span::from_millis));
    assert_eq!(world.links[index("tank-1")].as_ref().unwrap().loss, 0.005);
    assert_eq!(world.clocks, vec![None; fleet().robots.len()], "as the fleet file says");
}

#[test]
fn world_with_every_supported_entry_is_read() {
    let world = read(
        "world: w
links: {cf1: {delay: {least: 1ms, p50: 2ms, p90: 3ms, p99: 10ms, largest: 40ms}, interruptions: [{every: 2min, lasts: {from: 1s, to: 2s}}]}}
clocks: {cf2: {offset: -5ms, drift: {from: -2ppm, to: 3ppm}, error: 0.4ms}}
sensors: {rover-1/range: [[0s, 2], [{from: 5s, to: 9s}, 0.4]], rover-1/battery: {from: 10, to: 90}}
operator: {go_after: 3s, never: 1%}
incidents:
  - {robot: drones, what: dies, act: finale, at: -50ms, back_after: 3s, probability: 0.05}
  - {robot: cf1, what: stalls, at: {from: 0s, to: 9s}, lasts: 400ms}
  - {robot: cf1, what: refuses}
  - {robot: cf1, what: link_down, lasts: 1s}",
    )
    .unwrap();
    let link = world.links[index("cf1")].as_ref().unwrap();
    assert_eq!(link.delay, Delay::Quantiles([1, 2, 3, 10, 40].map(Span::from_millis)));
    assert_eq!(link.interruptions[0].lasts.largest, Span::from_millis(2_000));
    let clock = world.clocks[index("cf2")].as_ref().unwrap();
    assert_eq!(clock.offset, Some(Between::fixed(Span::from_millis(-5))));
    assert_eq!(clock.drift_ppm, Some(Between { least: -2.0, largest: 3.0 }));
    assert_eq!(
        world.sensors[0].reading,
        Reading::OverTime(vec![
            (Between::fixed(Span::ZERO), Between::fixed(2.0)),
            (
                Between { least: Span::from_millis(5_000), largest: Span::from_millis(9_000) },
                Between::fixed(0.4)
            ),
        ])
    );
    assert_eq!(world.operator.as_ref().unwrap().never, 0.01);
    assert_eq!(world.incidents[0].robots.len(), 6);
    assert_eq!(world.incidents[0].at, Between::fixed(Span::from_millis(-50)));
    assert_eq!(world.incidents[2].trouble, Trouble::Refuses { lasts: None });
    assert_eq!(world.incidents[2].probability, 1.0);
}

#[test]
fn all_mistakes_are_reported_at_once_with_their_positions() {
    let said = read(
        "world: w
links:
  cf7: {delay: 1ms}
  cf1: {delay: -1ms}
  cf2: {loss: 120%}
  cf3: {loss: 1.5}
  cf4: {delay: {least: 2ms, p50: 1ms, p90: 3ms, p99: 10ms, largest: 40ms}}
  cf5: {loss: 100%}
sensors: {rover-1/rnage: 3, tank: 2}
incidents:
  - {robot: cf11, what: dies}
  - {robot: cf1, what: dies, lasts: 3s}
  - {robot: cf1, what: stalls}
  - {robot: cf1, what: explodes}
  - {robot: cf1, what: refuses, act: final}
  - {robot: cf1, what: refuses, act: finale, at: 1s}
  - {robot: cf1, what: refuses, at: -1s}
  - {robot: cf1, what: refuses, at: {from: 2s, to: 1s}}",
    )
    .unwrap_err();
    for part in [
        "no robot or group `cf7` in the fleet",
        ":4:16",
        "found `120%`",
        "found the number 1.5",
        "`p50` lies below `least`",
        "with a loss of 100%, no message ever arrives",
        "the robot has no sensor `rnage`",
        "did you mean `range`",
        "`tank` does not name a robot and a sensor",
        "no robot or group `cf11` in the fleet",
        "`lasts` is not supported for this incident",
        "missing duration of the incident",
        "unknown word `explodes`",
        "no act `final`",
        "`at` is not supported for this incident",
        "did you mean `finale`",
        "the time is before the start of the mission",
        "`to` is less than `from`",
    ] {
        assert!(said.contains(part), "{part} is not in\n{said}");
    }
}

#[test]
fn other_document_types_are_named_in_the_error() {
    for (text, says) in [
        ("scenario: s\ncues: []", "this is a scenario, not a world file"),
        ("robots: {}", "this is a fleet file, not a world file"),
        ("", "world"),
        ("links: {}", "has no `world`"),
    ] {
        let said = read(text).unwrap_err();
        assert!(said.contains(says), "{says}: {said}");
    }
}
