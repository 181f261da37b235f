//! The places of findings.

use crate::{Fleet, NoFiles, Source, compile};

#[test]
fn every_finding_is_on_existing_line() {
    for text in [
        "---",
        "---\n",
        "--- # nothing",
        "---\n...",
        "--- !x",
        "a: 1\n---",
        "? ",
        "- ",
        "--- |\n",
        "{a: ",
        "'",
    ] {
        let source = Source { name: "s.yaml".into(), text: text.to_owned() };
        let findings = compile(&source, &Fleet::default(), &NoFiles).findings;
        let lines = text.matches('\n').count() + 1;
        assert!(findings.iter().all(|finding| finding.line <= lines), "{text:?}: {findings:?}");
    }
}
