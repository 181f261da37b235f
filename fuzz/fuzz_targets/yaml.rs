//! Reads any text as YAML. The reader does not panic or hang, and its memory is bounded. A finding refers to a place in the text. The
//! library alone and the reader of long runs of keyframes agree. `fuzz/run` adds the address sanitizer, because the library contains
//! unsafe code.
#![no_main]

use downbeat_yaml::node::{parse, parse_whole, too_deep};
use downbeat_yaml::source::Source;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let source = Source { name: "s.yaml".into(), text: text.to_owned() };
    let read = parse(&source);
    if let Err(finding) = &read {
        let lines = text.matches(['\n', '\r']).count() + 1;
        assert!(finding.line <= lines, "{finding:?}");
        return;
    }
    if too_deep(&source).is_none() {
        assert!(parse_whole(&source).is_ok(), "only the reader of keyframes accepts this");
    }
});
