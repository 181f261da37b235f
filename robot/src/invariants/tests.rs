//! The invariants over random operations, and over what the fuzzer once found.

use proptest::prelude::*;

use super::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn whatever_happens_to_a_robot_it_keeps_its_invariants(
        operations in prop::collection::vec(any::<u8>(), 0..2_000).prop_map(|bytes| operations(&bytes)),
    ) {
        play(&operations).map_err(|violation| TestCaseError::fail(violation.to_string()))?;
    }
}
