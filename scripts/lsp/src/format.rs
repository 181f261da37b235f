//! Formats a file: spaces and line breaks change, values and comments remain.

use downbeat_scripts::Source;
use downbeat_yaml::node::parse;
use lsp_types::TextEdit;
use pretty_yaml::config::{FormatOptions, LanguageOptions, LayoutOptions, Quotes};
use pretty_yaml::format_text;

use crate::file::File;

/// Maximum length of lines in characters, unless a single value is longer.
const WIDTH: usize = 120;

/// Returns the edit that formats a file; none if the file is formatted already. `None` if the file is not valid YAML.
pub(crate) fn format(file: &File) -> Option<Vec<TextEdit>> {
    let text = file.text.as_str();
    let new = format_text(text, &options()).ok()?;
    let source = |text: &str| Source { name: String::new(), text: text.to_owned() };
    let is_same =
        parse(&source(text)).ok()? == parse(&source(&new)).ok()? && comments(text) == comments(&new);
    if !is_same || new == text {
        return is_same.then(Vec::new);
    }
    Some(vec![TextEdit { range: file.text.range(0..text.len()), new_text: new }])
}

fn options() -> FormatOptions {
    FormatOptions {
        layout: LayoutOptions { print_width: WIDTH, ..LayoutOptions::default() },
        language: LanguageOptions {
            brace_spacing: false,
            bracket_spacing: false,
            quotes: Quotes::PreferDouble,
            ..LanguageOptions::default()
        },
    }
}

/// Returns the words after each `#`, which include all comments, in the order of the text.
fn comments(text: &str) -> Vec<&str> {
    let after = text.lines().filter_map(|line| line.split_once('#').map(|(_, rest)| rest.trim()));
    after.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text::Text;

    fn formatted(text: &str) -> Option<String> {
        let edits = format(&File::new("show.yaml".into(), Text::new(text.to_owned())))?;
        Some(edits.first().map_or_else(|| text.to_owned(), |edit| edit.new_text.clone()))
    }

    #[test]
    fn spaces_change_and_comments_remain() {
        let text = "# A show.\nscenario:   s   # its name\ncues:\n    - {cue: a,at: 1s}\n\n    # the last\n    - cue: b\n";
        let expected =
            "# A show.\nscenario: s # its name\ncues:\n  - {cue: a, at: 1s}\n\n  # the last\n  - cue: b\n";
        assert_eq!(formatted(text).as_deref(), Some(expected));
        assert_eq!(formatted(expected).as_deref(), Some(expected));
        assert_eq!(formatted("a: [1\nb: 2\n"), None);
    }

    #[test]
    fn examples_keep_their_meaning() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
        let mut count = 0;
        for entry in folder.read_dir().unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "yaml") {
                let text = std::fs::read_to_string(&path).unwrap();
                assert!(formatted(&text).is_some(), "{}", path.display());
                count += 1;
            }
        }
        assert!(count > 4, "{count}");
    }
}
