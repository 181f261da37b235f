//! Tests of the act that moves devices to their first positions before a show.

use downbeat_scripts::{Address, Approach, Fleet, FleetRobot, NoFiles, Source, add_approach, compile};
use urrcp::Interpolation;

use super::*;

const SHOW: &str = "scenario: show
on_failure: POLICY
cues:
  - {at: 0s, robots: [arm-0, arm-1], tracks: {shoulder: [{at: 0s, to: 45}, {at: 2s, to: 0}]}}
";

/// An arm whose shoulder moves linearly and starts at 10 degrees.
fn linear(id: usize) -> InitializationBlock {
    let mut block = block(id);
    block.devices[0].interpolation = Interpolation::Linear;
    block.devices[0].default_value = Some(10.0);
    block
}

/// Plays a show of two arms that starts with an approach, an act that moves devices to their first positions. The second arm disconnects
/// once it has accepted the approach.
fn approached(on_failure: &str) -> Played {
    let robot = |id| FleetRobot::new(linear(id).id, Address::Simulated, Some(linear(id)));
    let fleet = Fleet { robots: vec![robot(0), robot(1)], ..Fleet::default() };
    let show = Source { name: "show.yaml".into(), text: SHOW.replace("POLICY", on_failure) };
    let compiled = compile(&show, &fleet, &NoFiles);
    let show = compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings));
    let stands = || [(DeviceId::new("shoulder").unwrap(), 10.0)].into();
    let from = (0..2).map(|id| (linear(id).id, stands())).collect();
    let over = Span::from_millis(2_000);
    let (show, first) = add_approach(show, 0, &fleet, &Approach { over, from }).unwrap();
    assert_eq!((first, show.acts.len()), (0, 2));
    let machine = |id| {
        let fault = (id == 1).then_some(Fault::Disconnect);
        SimulatedRobot::new(linear(id), Settings { fault, ..Settings::default() })
    };
    let participants = (0..2).map(|id| Participant::new(linear(id).id, Some(linear(id)))).collect();
    let mission = Mission::new(show, participants, MissionOptions::default(), BEGIN).unwrap();
    play(mission, vec![machine(0), machine(1)])
}

#[test]
fn approach_is_all_or_none_or_without_failed_robots_as_the_show_states() {
    for (on_failure, outcome, moves) in
        [("stop", Outcome::NotStarted, 0), ("without", Outcome::DoneWithout, 1)]
    {
        let played = approached(on_failure);
        assert_eq!(played.report.outcome, outcome, "{:?}", played.report.failures);
        assert_eq!(moved(&played.logs), moves, "{on_failure}: {:?}", played.logs);
        let last = played.logs[0].iter().rfind(|entry| entry.is_set()).map(|entry| entry.value);
        assert_eq!(last, (moves == 1).then_some(0.0), "{on_failure}");
        assert!(!played.logs[1].iter().any(|entry| entry.is_set()), "{on_failure}");
    }
}
