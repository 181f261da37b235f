//! Finds the characters of a text in the YAML source. There, the text may have quotes and escapes, or extend over several lines.

/// The quotation marks of a scalar in the source.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Style {
    /// The scalar is written without quotes, or as a block.
    Plain,
    Single,
    Double,
}

/// Returns the byte offsets in `source` at which the characters `from` to `to` of `text` begin and end. `source` must begin with the YAML
/// scalar for `text`. `None` if it begins with something else, such as an alias.
pub(super) fn offsets(source: &str, text: &str, from: usize, to: usize) -> Option<(usize, usize)> {
    let begin = after_properties(source);
    let style = match source[begin..].chars().next()? {
        '\'' => Style::Single,
        '"' => Style::Double,
        _ => Style::Plain,
    };
    let quote = usize::from(style != Style::Plain);
    let mut walk = Walk { source, at: begin + quote, style };
    let (mut first, mut end) = (None, None);
    let mut chars = text.trim_end().chars().enumerate().peekable();
    while let Some((index, c)) = chars.next() {
        if c.is_whitespace() {
            let mut last = index;
            while let Some((next, _)) = chars.next_if(|(_, c)| c.is_whitespace()) {
                last = next;
            }
            first = first.or((from <= last).then_some(walk.at));
            end = end.or((index < to && to <= last + 1).then_some(walk.at));
            walk.blank()?;
            continue;
        }
        walk.continued();
        first = first.or((from <= index).then_some(walk.at));
        walk.past(c)?;
        end = end.or((to <= index + 1).then_some(walk.at));
    }
    let end = end.unwrap_or(walk.at);
    Some((first.unwrap_or(end), end))
}

/// Returns the byte offset of the scalar, after its anchor and its tag if there are any.
fn after_properties(source: &str) -> usize {
    let mut at = 0;
    while source[at..].starts_with(['&', '!']) {
        let rest = &source[at..];
        let word = rest.find(char::is_whitespace).unwrap_or(rest.len());
        let blank = rest[word..].find(|c: char| !c.is_whitespace()).unwrap_or(rest.len() - word);
        at += word + blank;
    }
    at
}

struct Walk<'s> {
    source: &'s str,
    at: usize,
    style: Style,
}

impl Walk<'_> {
    fn rest(&self) -> &str {
        &self.source[self.at..]
    }

    fn skip_blank(&mut self) {
        let rest = self.rest();
        self.at += rest.find(|c: char| !c.is_whitespace()).unwrap_or(rest.len());
    }

    /// Skips spaces, tabs and line ends, whether escaped or not. `None` if there are none.
    fn blank(&mut self) -> Option<()> {
        let before = self.at;
        loop {
            self.skip_blank();
            let escape = self.rest().strip_prefix('\\').filter(|_| self.style == Style::Double);
            match escape.and_then(|escape| escape.chars().next()) {
                Some('n' | 't' | 'r' | ' ' | '\t' | '\n' | '\r' | 'N' | '_' | 'L' | 'P') => self.at += 2,
                _ => break,
            }
        }
        (self.at > before).then_some(())
    }

    /// Skips escaped line ends, which add nothing to the text.
    fn continued(&mut self) {
        while self.style == Style::Double
            && self.rest().strip_prefix('\\').is_some_and(|rest| rest.starts_with(['\n', '\r']))
        {
            self.at += 1;
            self.skip_blank();
        }
    }

    fn past(&mut self, c: char) -> Option<()> {
        let rest = self.rest();
        let length = match (self.style, rest.strip_prefix('\\')) {
            (Style::Double, Some(escape)) => {
                let kind = escape.chars().next()?;
                let digits = match kind {
                    'x' => 2,
                    'u' => 4,
                    'U' => 8,
                    _ => return self.plainly_escaped(kind, c),
                };
                let code = u32::from_str_radix(escape.get(1..=digits)?, 16).ok()?;
                (char::from_u32(code)? == c).then_some(2 + digits)?
            }
            (Style::Single, _) if c == '\'' => rest.starts_with("''").then_some(2)?,
            _ => rest.starts_with(c).then(|| c.len_utf8())?,
        };
        self.at += length;
        Some(())
    }

    /// Skips an escape sequence whose second character stands for itself: `\"`, `\\`, `\/`. `None` if that character is not `c`.
    fn plainly_escaped(&mut self, kind: char, c: char) -> Option<()> {
        (kind == c).then_some(())?;
        self.at += 1 + kind.len_utf8();
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::offsets;

    #[track_caller]
    fn check(source: &str, text: &str, part: &str, shown: Option<&str>) {
        let from = text[..text.find(part).unwrap()].chars().count();
        let found = offsets(source, text, from, from + part.chars().count());
        assert_eq!(found.map(|(from, to)| &source[from..to]), shown, "{source}");
    }

    #[test]
    fn part_of_text_is_located_where_it_is_written() {
        check("$a + b, to: 3", "$a + b", "b", Some("b"));
        check("\"$a + b\"}", "$a + b", "+", Some("+"));
        check("'it''s + b'", "it's + b", "b", Some("b"));
        check("'it''s + b'", "it's + b", "'s", Some("''s"));
        check("\"\\x24a +\\t\\u00e4 \\\" b\"", "$a +\t\u{e4} \" b", "\u{e4}", Some("\\u00e4"));
        check("\"\\x24a +\\t\\u00e4 \\\" b\"", "$a +\t\u{e4} \" b", "b", Some("b"));
        check("\"$a +\n     b * 2\"", "$a + b * 2", "b", Some("b"));
        check("\"$a + \\\n     b * 2\"", "$a + b * 2", "* 2", Some("* 2"));
        check("\"si\\\n   n(3)\"", "sin(3)", "3", Some("3"));
        check("$a +\n   b * 2\n", "$a +\nb * 2\n", "*", Some("*"));
        check("&x !!str \"$a / 0\"", "$a / 0", "/", Some("/"));
    }

    #[test]
    fn text_written_elsewhere_is_not_located() {
        check("*x, to: 3", "$a + b", "b", None);
        check("\"$a\"", "$a + b", "b", None);
    }
}
