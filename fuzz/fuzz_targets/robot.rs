//! Any bytes as a list of what happens to a robot: messages, silence, broken links, late wake-ups. It keeps its
//! invariants.
#![no_main]

use libfuzzer_sys::fuzz_target;
use robot_invariants::{operations, play};

fuzz_target!(|bytes: &[u8]| {
    let operations = operations(bytes);
    if let Err(violation) = play(&operations) {
        panic!("{violation}\n{operations:#?}");
    }
});
