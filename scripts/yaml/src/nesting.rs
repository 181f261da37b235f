//! Finds brackets that are nested very deeply. Before `yaml_serde` rejects them, libyaml reads them all, which takes quadratic time in
//! their depth. The text is therefore cut at the limit, which leads to the same finding.

/// Maximum nesting depth: far more than `yaml_serde` accepts (128), but little enough for libyaml to read quickly.
const DEPTH: usize = 1_000;
/// The characters after which a value may begin, blanks aside.
const BEFORE_A_VALUE: &[u8] = b"[{,:?-\n";

/// Returns the text up to the bracket that is nested too deeply; `None` if no bracket is. The depth may be miscounted after a tag or a
/// text of several lines.
pub fn too_deep(text: &str) -> Option<&str> {
    let bytes = text.as_bytes();
    let (mut depth, mut at) = (0_usize, 0);
    // The last byte that is not blank.
    let mut before = b'\n';
    while let Some(byte) = bytes.get(at) {
        let begins = BEFORE_A_VALUE.contains(&before);
        match byte {
            b'[' | b'{' if depth > 0 || begins => depth += 1,
            b']' | b'}' => depth = depth.saturating_sub(1),
            b'"' | b'\'' if begins => at = end_of_quoted(bytes, at),
            b'#' if at.checked_sub(1).is_none_or(|at| bytes[at].is_ascii_whitespace()) => {
                at += bytes[at..].iter().position(|byte| *byte == b'\n').unwrap_or(bytes.len());
                continue;
            }
            _ => {}
        }
        if depth > DEPTH {
            return Some(&text[..at]);
        }
        // Within brackets, a value may continue on the next line.
        if !matches!(byte, b' ' | b'\t' | b'\r') && (*byte != b'\n' || depth == 0) {
            before = *byte;
        }
        at += 1;
    }
    None
}

/// Returns the byte offset of the quotation mark that ends the quoted text starting at `begin`. If the text does not end, returns the
/// length of the file.
fn end_of_quoted(bytes: &[u8], begin: usize) -> usize {
    let mark = bytes[begin];
    let mut at = begin + 1;
    while at < bytes.len() {
        match bytes[at] {
            b'\\' if mark == b'"' => at += 1,
            byte if byte == mark && mark == b'\'' && bytes.get(at + 1) == Some(&mark) => at += 1,
            byte if byte == mark => return at,
            _ => {}
        }
        at += 1;
    }
    bytes.len()
}

#[cfg(test)]
mod tests {
    use super::too_deep;
    use crate::node::parse;
    use crate::source::Source;

    fn found(text: String) -> String {
        let finding = parse(&Source { name: "s.yaml".into(), text }).unwrap_err();
        format!("{}:{}: {}", finding.line, finding.column, finding.message)
    }

    #[test]
    fn deep_nesting_is_refused_quickly_and_where_shallower_nesting_is() {
        for level in ["a: [\n", "{é: ", "[", "{\"]\\\"]\": [", "['}}''}', ", "[ # ]]\n", "{a: [b, "] {
            // Without the limit, this takes hours.
            let text = level.repeat(1_000_000);
            assert!(too_deep(&text).unwrap().len() <= level.len() * 1_001, "{level}");
            let deep = found(text);
            assert_eq!(deep, found(level.repeat(500)), "{level}");
        }
    }

    #[test]
    fn many_unnested_brackets_are_accepted() {
        let quoted = "[".repeat(3_000);
        let plain = "a[".repeat(3_000);
        for text in [
            format!("a: [{}]\nb: '{quoted}'\nc: \"{quoted}\"\n", "[1], ".repeat(3_000)),
            format!("a: {plain}\n# {quoted}\nb: it's [{quoted}\n"),
            format!("a: |\n  {quoted}\nb: >-\n  - {quoted}\n"),
        ] {
            assert!(parse(&Source { name: "s.yaml".into(), text: text.clone() }).is_ok(), "{text}");
        }
    }
}
