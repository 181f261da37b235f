//! Tests of the invariants, with random operations and with past findings of the fuzzer.

use proptest::prelude::*;

use super::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn robot_keeps_its_invariants_under_any_operations(
        operations in prop::collection::vec(any::<u8>(), 0..2_000).prop_map(|bytes| operations(&bytes)),
    ) {
        play(&operations).map_err(|violation| TestCaseError::fail(violation.to_string()))?;
    }
}

#[track_caller]
fn check_driven(position: &str, acceleration: &str, more: &str) {
    let block = format!(
        r#"{{"id": "r", "api_version": "1", "devices": [{{"id": "d", "name": "d", "interpolation": "linear"{more},
           "available_control_types": {{"position": {position}, "acceleration": {acceleration},
             "script": {{"min_value": -1.7e308, "max_value": 1.7e308, "granularity": 5e-324, "max_number_of_steps": 9}}}}}}]}}"#
    );
    let block = serde_json::from_str(&block).unwrap();
    assert_eq!(drive_all(&block), Ok(()));
}

#[test]
fn moving_device_always_has_a_numeric_value_even_with_extreme_limits() {
    let widest = r#"{"min_value": -1.7e308, "max_value": 1.7e308, "granularity": 1e292}"#;
    let ordinary = r#"{"min_value": -90, "max_value": 90, "granularity": 1}"#;
    let weakest = r#"{"min_value": 0, "max_value": 5e-324, "granularity": 5e-324}"#;
    for position in [widest, ordinary, weakest] {
        for acceleration in [widest, ordinary, weakest] {
            check_driven(position, acceleration, "");
            check_driven(position, acceleration, r#", "default_value": 0"#);
        }
    }
}

#[test]
fn fuzzer_seeds_and_earlier_findings_keep_the_invariants() {
    let seeds = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/seeds/robot");
    let mut played = 0;
    for entry in std::fs::read_dir(seeds).unwrap() {
        let path = entry.unwrap().path();
        let operations = operations(&std::fs::read(&path).unwrap());
        if let Err(violation) = play(&operations) {
            panic!("{}: {violation}", path.display());
        }
        played += 1;
    }
    assert!(played > 40, "{played} seeds");
}
