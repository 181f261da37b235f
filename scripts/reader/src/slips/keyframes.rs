//! Hints for movements that are written in another form than a list of keyframes.

use downbeat_yaml::at::At;
use downbeat_yaml::duration::parse_duration;
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

/// A notation of times and values that beginners use instead of a list of keyframes.
pub struct OtherForm {
    /// A description of the notation, for the finding.
    pub found: &'static str,
    /// Two hints that show how to write the list of keyframes: in brackets, and in block style.
    pub hints: [String; 2],
}

/// Recognizes times and values that are written in another form than a list of keyframes. `None` for any other value.
pub fn as_keyframes(at: &At<'_>) -> Option<OtherForm> {
    let time = |node: &Node| match node {
        Node::Text(text) if parse_duration(text).is_some() => Some(text.clone()),
        _ => None,
    };
    let keyframe = |at: &str, to: &Node| match to {
        Node::Number(value) => Some(format!("{{at: {at}, to: {value}}}")),
        Node::Text(text) if text.starts_with('$') => Some(format!("{{at: {at}, to: {}}}", shortened(text))),
        _ => None,
    };
    let (found, keyframes): (&'static str, Option<Vec<String>>) = match at.node {
        Node::Map(entries) if entries.iter().all(|(key, _)| time_of_key(key).is_some()) => (
            "a map from time to value",
            entries.iter().map(|(at, to)| keyframe(&time_of_key(at)?, to)).collect(),
        ),
        Node::Map(entries) if entries.iter().any(|(key, _)| key == "at" || key == "to") => {
            let of = |name: &str| entries.iter().find(|(key, _)| key == name).map(|(_, node)| node);
            let begin = of("at").map_or_else(|| Some("0s".to_owned()), time);
            ("a single keyframe", begin.zip(of("to")).and_then(|(at, to)| Some(vec![keyframe(&at, to)?])))
        }
        Node::List(items) if items.iter().all(|item| matches!(item, Node::List(pair) if pair.len() == 2)) => {
            let pair = |item: &Node| match item {
                Node::List(pair) => keyframe(&time(&pair[0])?, &pair[1]),
                _ => None,
            };
            ("a list of pairs", items.iter().map(pair).collect())
        }
        Node::List(items) if items.iter().all(|item| matches!(item, Node::Number(_))) => (
            "a list of numbers",
            items.iter().enumerate().map(|(index, to)| keyframe(&format!("{index}s"), to)).collect(),
        ),
        Node::List(items) if items.iter().all(is_whole_or_single) && are_halves(items) => {
            ("keyframes without braces", Some(vec!["{at: 1s, to: 45}".to_owned()]))
        }
        _ => return None,
    };
    let shown = match keyframes.as_deref() {
        Some([]) => return None,
        Some(all @ ([_] | [_, _])) => all.join(", "),
        Some([first, second, ..]) => format!("{first}, {second}, ..."),
        None => "{at: 0s, to: 0}, ...".to_owned(),
    };
    let first = keyframes.as_ref().and_then(|all| all.first()).map_or("{at: 0s, to: 0}", String::as_str);
    let in_lines = match at.node {
        Node::List(items) if items.iter().all(is_whole_or_single) => {
            "the time and the value belong to one entry: replace the dash before the second one with two spaces"
                .to_owned()
        }
        _ => format!("write each keyframe as an entry of a list: `- {first}`"),
    };
    Some(OtherForm { found, hints: [format!("write `[{shown}]`"), in_lines] })
}

/// Returns the time that the key of a map states: `1s`, or `1` for one second. `None` if it is not a time.
fn time_of_key(key: &str) -> Option<String> {
    let is_number = key.parse::<f64>().is_ok_and(|seconds| seconds >= 0.0 && seconds.is_finite());
    if is_number { Some(format!("{key}s")) } else { parse_duration(key).map(|_| key.to_owned()) }
}

/// Whether a list item is only one part of a keyframe, such as `at: 1s`: a map with one key.
fn is_single(node: &Node) -> bool {
    matches!(node, Node::Map(entries) if matches!(entries.as_slice(), [(key, _)] if ["at", "to", "ease"].contains(&key.as_str())))
}

/// Whether a list contains a keyframe cut in halves: its time and its value are successive items.
fn are_halves(items: &[Node]) -> bool {
    let key = |node: &Node| match node {
        Node::Map(entries) if is_single(node) => entries.first().map(|(key, _)| key.clone()),
        _ => None,
    };
    items.windows(2).any(|pair| match (key(&pair[0]), key(&pair[1])) {
        (Some(first), Some(second)) => first != second,
        _ => false,
    })
}

fn is_whole_or_single(node: &Node) -> bool {
    is_single(node) || matches!(node, Node::Map(entries) if entries.len() > 1)
}
