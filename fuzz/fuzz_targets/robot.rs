//! Converts any bytes to a list of events for a robot: messages, silence, broken links, late wake-ups. The robot keeps its invariants in
//! all of them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use robot_invariants::{operations, play};

fuzz_target!(|bytes: &[u8]| {
    let operations = operations(bytes);
    if let Err(violation) = play(&operations) {
        panic!("{violation}\n{operations:#?}");
    }
});
