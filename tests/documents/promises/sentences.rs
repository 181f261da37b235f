//! Splits a document into sentences.

/// Returns all sentences of a Markdown text in order, as plain text: white space becomes one space, a link becomes its text, and bold
/// text becomes plain. Headings and code blocks are skipped. A list item or a table row begins a new sentence. The cells of a row are
/// joined by ` | `.
pub fn sentences(markdown: &str) -> Vec<String> {
    blocks(markdown).iter().flat_map(|block| split(&plain(block))).collect()
}

/// Returns the paragraphs, list items and table rows, each as one line.
fn blocks(markdown: &str) -> Vec<String> {
    let (mut blocks, mut words, mut is_code) = (Vec::new(), Vec::new(), false);
    let mut end = |words: &mut Vec<&str>| {
        if !words.is_empty() {
            blocks.push(std::mem::take(words).join(" "));
        }
    };
    for line in markdown.lines() {
        let (is_fence, is_row) = (line.starts_with("```"), line.starts_with('|'));
        let begins =
            is_fence || is_row || item(line).is_some() || line.starts_with('#') || line.trim().is_empty();
        if begins {
            end(&mut words);
        }
        is_code ^= is_fence;
        if is_code || is_fence || line.starts_with('#') {
            continue;
        }
        if is_row {
            let row = line.trim_matches('|');
            if row.contains(|c: char| !matches!(c, '-' | ':' | '|' | ' ')) {
                words.extend(row.split_whitespace());
            }
            end(&mut words);
            continue;
        }
        words.extend(item(line).unwrap_or(line).split_whitespace());
    }
    end(&mut words);
    blocks
}

/// Returns the text of a list item; `None` for any other line.
fn item(line: &str) -> Option<&str> {
    let numbered = line.trim_start_matches(|c: char| c.is_ascii_digit());
    line.strip_prefix("- ").or_else(|| numbered.strip_prefix(". ").filter(|_| numbered.len() < line.len()))
}

/// Removes the markup of links and bold text.
fn plain(block: &str) -> String {
    let mut text = String::new();
    let mut rest = block;
    while let Some((before, link)) = rest.split_once('[') {
        text.push_str(before);
        rest = match link.split_once("](") {
            Some((shown, target)) if !shown.contains(']') => {
                text.push_str(shown);
                target.split_once(')').map_or("", |(_, after)| after)
            }
            _ => {
                text.push('[');
                link
            }
        };
    }
    text.push_str(rest);
    text.replace("**", "")
}

/// Splits a block after each full stop, question mark or exclamation mark that is followed by the beginning of a sentence.
fn split(block: &str) -> Vec<String> {
    let (mut sentences, mut from) = (Vec::new(), 0);
    for (at, _) in block.match_indices(' ') {
        let is_code = block[..at].matches('`').count() % 2 == 1;
        let ends = !is_code && block[..at].ends_with(['.', '?', '!']);
        let begins = |c: char| c.is_uppercase() || matches!(c, '`' | '"' | '(' | '*');
        if ends && block[at + 1..].starts_with(begins) {
            sentences.push(block[from..at].to_owned());
            from = at + 1;
        }
    }
    sentences.push(block[from..].to_owned());
    sentences
}

#[test]
fn markdown_is_split_into_sentences_correctly() {
    let markdown = "\
# A heading. No sentence

**One.** Two (see
[the page](page.md#part)) of `a. B`? `three` is `[0, 1]`, as in file.rs.

| a | b |
|---|:--|
| c | It holds. `d` too |

- e
  continues. 4 is no beginning
12. f

```
code. More
```
";
    let expected = [
        "One.",
        "Two (see the page) of `a. B`?",
        "`three` is `[0, 1]`, as in file.rs.",
        "a | b",
        "c | It holds.",
        "`d` too",
        "e continues. 4 is no beginning",
        "f",
    ];
    assert_eq!(sentences(markdown), expected);
}
