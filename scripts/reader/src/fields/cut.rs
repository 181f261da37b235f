//! Detects values within braces that YAML cuts in two at a comma, such as `0,5` and `max(1, 2)`.

use super::{At, Reader};
use downbeat_motion::expression;
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

impl Reader {
    /// Adds one finding for a decimal comma: YAML reads `{at: 0,3s}` as the number 0 and a key `3s`.
    pub(super) fn report_decimal_comma(&mut self, at: &At<'_>, key: &str, whole: &str, others: &[&str]) {
        let Some(rest) = others.first() else { return };
        let place = at.entry(rest, 0, &Node::Null).key_place();
        let message = format!(
            "the comma ends the value of `{}`, so that `{}` is read as a key",
            shortened(key),
            shortened(rest)
        );
        let (expected, hint) = match others {
            [_] => ("a decimal point", format!("write a decimal point: `{whole}.{}`", shortened(rest))),
            _ => (
                "a list in brackets",
                format!("write a list: `[{whole}, {}]`", shortened(&others.join(", "))),
            ),
        };
        self.add(Code::UnknownKey, place, message, expected, Some(hint));
        self.wrong.push(at.place().of_key(key));
    }

    /// Adds one finding for a comma in an expression: YAML reads `{to: max(1, 2)}` as the text `max(1` and a key `2)`.
    pub(super) fn cut_in_brackets(&mut self, at: &At<'_>, key: &str, text: &str) {
        let place = at.entry(key, 0, &Node::Null).place();
        let message = format!("the expression `{}` is cut off by a comma", shortened(text));
        let hint = Some(
            "within `{` and `[`, put quotes around an expression that contains a comma: `\"max(1, 2)\"`"
                .to_owned(),
        );
        self.add(Code::Expression, place.clone(), message, "an expression in quotes", hint);
        self.wrong.push(place);
    }
}

/// Detects a decimal comma that turned the digits after it into the key `rest`. Returns the key of the entry before it, and the digits
/// before the comma.
pub(super) fn decimal_comma<'a>(
    before: &'a (String, Node),
    rest: &str,
    node: &Node,
) -> Option<(&'a str, String)> {
    let (key, value) = before;
    let decimals = rest.starts_with(|c: char| c.is_ascii_digit()) && *node == Node::Null;
    match value {
        Node::Number(whole) if decimals && whole.fract() == 0.0 => Some((key, whole.to_string())),
        // `00:01:30,5` and `$a * 1,5`.
        Node::Text(text) if decimals && is_open(text) == 0 => {
            let begins = text.rfind(|c: char| !c.is_ascii_digit() && c != ':').map_or(0, |at| at + 1);
            let whole = &text[begins..];
            (whole.ends_with(|c: char| c.is_ascii_digit()) && (begins == 0 || expression::is_one(text)))
                .then(|| (key.as_str(), whole.to_owned()))
        }
        _ => None,
    }
}

/// Returns the keys at the start of `entries` that are numbers without a value. The first key is included in any case.
pub(super) fn numbers_alone(entries: &[(String, Node)]) -> Vec<&str> {
    let is_number = |(key, node): &&(String, Node)| *node == Node::Null && key.parse::<f64>().is_ok();
    let count = entries.iter().take_while(is_number).count().max(1);
    entries.iter().take(count).map(|(key, _)| key.as_str()).collect()
}

/// Returns the number of round brackets that are not closed at the end of a text.
fn is_open(text: &str) -> usize {
    text.chars().fold(0, |open: usize, c| match c {
        '(' => open + 1,
        ')' => open.saturating_sub(1),
        _ => open,
    })
}

/// Detects a comma in an expression that ended the value, so that the rest of the expression became the next key. Returns the key and the
/// cut value; `None` if there is no such comma.
pub(super) fn cut_in_brackets<'a>(before: &'a (String, Node), node: &Node) -> Option<(&'a str, &'a str)> {
    let (key, value) = before;
    match value {
        Node::Text(text) if *node == Node::Null && is_open(text) > 0 && expression::is_one(text) => {
            Some((key, text))
        }
        _ => None,
    }
}
