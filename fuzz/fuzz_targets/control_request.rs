//! Parses any text as a control request. If a valid request is written and read again, the request, its text and its hash are unchanged.
//! A robot that receives the request keeps its invariants.
#![no_main]

use libfuzzer_sys::fuzz_target;
use robot_invariants::ask;
use urrcp::ControlRequest;

fuzz_target!(|text: &str| {
    let Ok(request) = serde_json::from_str::<ControlRequest>(text) else { return };
    let written = serde_json::to_string(&request).unwrap();
    let again: ControlRequest = serde_json::from_str(&written).unwrap();
    assert_eq!(again, request);
    assert_eq!(serde_json::to_string(&again).unwrap(), written, "one text");
    assert_eq!(again.command.content_hash(), request.command.content_hash(), "one hash");
    if let Err(violation) = ask(&request) {
        panic!("{violation}\n{written}");
    }
});
