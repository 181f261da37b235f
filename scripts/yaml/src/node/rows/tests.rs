//! Tests that a text with runs of keyframes is read exactly as the YAML library alone would read it.

use proptest::prelude::*;

use super::*;
use crate::duration::parse_duration;
use crate::node::{parse, parse_whole};
use crate::source::Source;

fn source(text: &str) -> Source {
    Source { name: "s.yaml".into(), text: text.to_owned() }
}

/// Makes trees comparable: writes equal times alike, and sorts the keys of each map.
fn alike(node: &Node) -> Node {
    match node {
        Node::Text(text) => Node::Text(parse_duration(text).map_or_else(|| text.clone(), written)),
        Node::List(items) => Node::List(Items::Nodes(items.iter().map(alike).collect())),
        Node::Map(entries) => {
            let mut entries: Vec<_> = entries.iter().map(|(key, node)| (key.clone(), alike(node))).collect();
            entries.sort_by(|a, b| a.0.cmp(&b.0));
            Node::Map(entries)
        }
        other => other.clone(),
    }
}

/// Checks that the text is read alike with and without the special treatment of runs. Returns whether it contains a run.
#[track_caller]
fn same(text: &str) -> bool {
    let source = source(text);
    let (ours, whole) = (parse(&source), parse_whole(&source));
    match (ours, whole) {
        (Ok(ours), Ok(whole)) => {
            assert_eq!(format!("{:?}", alike(&ours)), format!("{:?}", alike(&whole)), "{text}")
        }
        (ours, whole) => assert_eq!(ours.err(), whole.err(), "{text}"),
    }
    condense(text).is_some()
}

fn repeated(row: &str, between: &str) -> String {
    [row; 9].join(between)
}

#[test]
fn keyframe_runs_in_every_style_are_read_as_by_library() {
    for row in [
        "{at: 1s, to: 2}",
        "{\"at\":\"40ms\",\"to\":-1.5e-3}",
        "{to: [1, 2.5 ,3], at: 1m30s}",
        "{to: 0, ease: step, at: 2m}",
    ] {
        assert!(same(&format!("a:\n  - {}\nb: 1\n", repeated(row, "\n  - "))));
        assert!(same(&format!("a:\r\n  - {}\r\n", repeated(row, "\r\n  - "))));
        assert!(same(&format!("a: [{}]\n", repeated(row, ", "))));
        assert!(same(&format!("{{\"a\": [\n  {}\n]}}", repeated(row, ",\n  "))));
        assert!(same(&format!("a: [x, {}, {{at: 3}}]\n", repeated(row, ", "))));
    }
    assert!(same(&format!("a:\n- {}\n", repeated("at: 1s\n  to: 2", "\n- "))));
    assert!(same(&format!("a:\n  - {}", repeated("at: 1.5s\n    to: 1\n    ease: smooth", "\n  - "))));
    assert!(same(&format!("a:\n  - {}", repeated("at: 1.5s\n    to: [1, 2]", "\n  - "))));
    assert!(!same(&format!("a: [{}]\n", repeated("{at: 1s, to: [1, 2], ease: step}", ", "))));
    assert!(same(&format!("a: &a [{}]\nb: *a\n", repeated("{at: 1s, to: 2}", ", "))));
}

#[test]
fn text_resembling_keyframe_run_is_read_as_written() {
    let rows = repeated("{at: 1s, to: 2}", ", ");
    let lines = repeated("- {at: 1s, to: 2}", "\n  ");
    for text in [
        format!("a: \"{rows}\"\n"),
        format!("a: '{rows}'\n"),
        format!("a: # {rows}\n  x\n"),
        format!("a: |\n  {lines}\n"),
        format!("a: >\n  {lines}\n"),
        format!("a: \"\n  {lines}\"\n"),
        format!("a: [{rows}\n"),
        format!("a: {{{rows}}}\n"),
        format!("a: x\n  {lines}\n"),
        format!("a:\n  {lines}\n   b: 1\n"),
        format!("a:\n  {lines}: 1\n"),
        format!("a:\n  {lines} # 1\n"),
        format!("a:\n- {}\n  fade: 1\n", repeated("at: 1s\n  to: 2", "\n- ")),
        format!("a: ? [{rows}]\n"),
        format!("a: !x [{rows}]\n"),
        format!("a: [{rows}]\n\u{e000}: 1\n"),
    ] {
        same(&text);
    }
}

#[test]
fn long_line_is_processed_as_fast_as_many_lines() {
    let text = format!("a: [{}]\n", "{at: 1s, to: x}, aaaaaaaa, ".repeat(200_000));
    assert!(condense(&text).is_none());
}

#[test]
fn numbers_and_times_are_read_as_by_library() {
    for value in [
        "0",
        "-0",
        "-0.0",
        "007",
        "0.5",
        "1e5",
        "1e400",
        "1.",
        ".5",
        "+1",
        "1-2",
        "12345678901234567890",
        "0x1f",
        "1_0",
        "-",
        "1e",
        "e5",
    ] {
        same(&format!("a: [{}]\n", repeated(&format!("{{at: 1s, to: {value}}}"), ", ")));
    }
    for time in [
        "1",
        "1s",
        "01s",
        "1.5m",
        "999999999s",
        "99999999999ms",
        "100000000000ms",
        "1h2m3s4ms5us",
        "1e5s",
        "1S",
        "s",
        "1.5.5s",
    ] {
        same(&format!("a: [{}]\n", repeated(&format!("{{at: {time}, to: 1}}"), ", ")));
    }
}

fn row() -> impl Strategy<Value = String> {
    let at = prop_oneof![4 => (0u32..9_000).prop_map(|ms| format!("{ms}ms")), 1 => "[0-9.smh]{1,4}"];
    let to =
        prop_oneof![4 => (-9i32..9).prop_map(|v| format!("{}", f64::from(v) / 4.0)), 1 => "[-0-9.e]{1,4}"];
    (at, to, prop::bool::weighted(0.1)).prop_map(|(at, to, eased)| {
        format!("{{at: {at}, to: {to}{}}}", if eased { ", ease: cubic" } else { "" })
    })
}

proptest! {
    #[test]
    fn every_text_is_read_as_by_library(
        rows in prop::collection::vec(row(), 8..30),
        block in any::<bool>(),
        cut in 0usize..400,
        drop in 0usize..3,
        insert in "[\\[\\]{}:,&*!|>'\"#%a-z0-9 \n-]{0,3}",
    ) {
        let text = if block { format!("x:\n  - {}\ny: 1\n", rows.join("\n  - ")) } else { format!("x: [{}]\ny: 1\n", rows.join(", ")) };
        same(&text);
        let cut = cut.min(text.len());
        let end = (cut + drop).min(text.len());
        same(&format!("{}{insert}{}", &text[..cut], &text[end..]));
    }
}
