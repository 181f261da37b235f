//! Metamorphic tests of devices: limits that are wider by less than the grid, more steps, and scripts of another length.

use proptest::prelude::*;

use super::super::verified::{EVERY, changes, movements, tolerances};
use super::{Steps, steps};
use crate::{Compiled, Files, Finding, Fleet, FleetRobot, Severity, Source, compile};

struct Table(String);

impl Files for Table {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        Ok(Source { name: name.into(), text: self.0.clone() })
    }
}

/// A device with its limits and the maximum number of steps of a script.
#[derive(Clone, Copy)]
struct Device {
    moves: bool,
    limits: [f64; 2],
    granularity: f64,
    most: usize,
}

impl Device {
    /// Compiles a track for the device.
    fn plays(self, track: &str, changes: &str, csv: &str) -> Compiled {
        let Self { moves, limits: [min, max], granularity, most } = self;
        let limits = format!(r#""min_value": {min}, "max_value": {max}, "granularity": {granularity}"#);
        let block = format!(
            r#"{{"id": "bot", "api_version": "1", "devices": [{{"id": "d", "name": "d", "interpolation": "{}", "script_queue": 10000,
            "available_control_types": {{"position": {{{limits}}}, "script": {{{limits}, "max_number_of_steps": {most}}}}}}}]}}"#,
            if moves { "linear" } else { "hold" }
        );
        let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
        let robot = FleetRobot { id: init.id.clone(), init: Some(init), ..crate::tests::robot() };
        let fleet = Fleet { robots: vec![robot], ..Fleet::default() };
        let text = format!(
            "scenario: s\noff_grid: snap\ncues: [{{at: 0s, robots: bot, tracks: {{d: {{{track}}}}}{changes}}}]\n"
        );
        compile(&Source { name: "s.yaml".into(), text }, &fleet, &Table(csv.to_owned()))
    }
}

/// Returns the steps of the only act, and the codes of all findings.
fn told(compiled: &Compiled) -> (Option<Steps>, Vec<crate::Code>) {
    let act = compiled.choreography.as_ref().map(|choreography| steps(&choreography.acts[0]));
    (act, compiled.findings.iter().map(|finding| finding.code).collect())
}

/// Draws a change of a movement, without the key `every`.
fn written() -> impl Strategy<Value = String> {
    changes().prop_map(|change| change.yaml).prop_filter("turn to turn", |yaml| !yaml.contains(EVERY))
}

fn moving() -> impl Strategy<Value = (bool, super::super::verified::Movement)> {
    any::<bool>().prop_flat_map(|moves| (Just(moves), movements(moves)))
}

fn wish(tolerance: Option<f64>) -> String {
    tolerance.map_or(String::new(), |tolerance| format!("tolerance: {tolerance}, "))
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(100) })]

    /// Both pairs of limits are between the same multiples of the granularity, so the device can be set to the same values.
    #[test]
    fn limits_widened_by_less_than_grid_change_no_step(
        (moves, movement) in moving(), change in written(), tolerance in tolerances(),
        reach in 0i32..15, parts in [50i32..90, 90i32..100],
    ) {
        let granularity = 2.0;
        let track = format!("{}{}", wish(tolerance), movement.yaml);
        let [narrow, wide] = parts.map(|part| {
            let most = (f64::from(reach) + f64::from(part) / 100.0) * granularity;
            let device = Device { moves, limits: [-most, most], granularity, most: 100_000 };
            device.plays(&track, &change, &movement.csv)
        });
        if narrow.choreography.is_some() {
            prop_assert_eq!(told(&narrow), told(&wide), "{}{}", track, change);
        }
    }

    #[test]
    fn script_length_does_not_change_played_steps((moves, movement) in moving(), change in written(), most in 2usize..30) {
        let long = Device { moves, limits: [-1e3, 1e3], granularity: 0.5, most: 100_000 };
        let [one, chain] = [long, Device { most, ..long }].map(|device| device.plays(&movement.yaml, &change, &movement.csv));
        // Short scripts may leave too little time for sending them.
        prop_assume!(chain.findings.iter().all(|finding| finding.severity == Severity::Warning));
        prop_assert_eq!(told(&one).0, told(&chain).0, "{}{}", movement.yaml, change);
    }

    #[test]
    fn more_steps_never_increase_error((moves, movement) in moving(), change in written(), most in 2u32..30, more in 1u32..9) {
        let device = Device { moves, limits: [-1e3, 1e3], granularity: 0.5, most: 100_000 };
        let off = |most: u32| {
            let track = format!("tolerance: 1000, max_steps: {most}, {}", movement.yaml);
            let compiled = device.plays(&track, &change, &movement.csv);
            compiled.choreography.map(|choreography| choreography.acts[0].devices[0].worst_error)
        };
        if let Some(few) = off(most) {
            let many = off(most + more);
            // On a coarse grid, the search for steps of a linear device does not find the least error.
            let least = if moves { f64::INFINITY } else { few * (1.0 + 1e-6) + 1e-9 };
            prop_assert!(many.is_some_and(|many| many <= least), "{} {:?}: {}{}", few, many, movement.yaml, change);
        }
    }
}
