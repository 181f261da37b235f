//! Applies each hint that contains an edit literally, and checks that the finding disappears.

use std::path::{Path, PathBuf};

use crate::{Code, Compiled, Finding, Folder, Source, compile, parse_duration, read_fleet};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/sessions/findings/folder")
}

fn compiled(name: &str, text: &str) -> Compiled {
    let own = folder().join(format!("fleets/{name}.yaml"));
    let fleet = if own.exists() { own } else { folder().join("fleet.yaml") };
    let (fleet, _) = read_fleet(&fleet);
    let source = Source { name: format!("{name}.yaml"), text: text.to_owned() };
    compile(&source, &fleet.unwrap_or_default(), &Folder::new(folder()))
}

/// Replaces `width` characters of a line by a text.
fn replaced(text: &str, line: usize, column: usize, width: usize, new: &str) -> String {
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let chars: Vec<char> = lines[line - 1].chars().collect();
    let (before, after) = (&chars[..column - 1], &chars[(column - 1 + width).min(chars.len())..]);
    lines[line - 1] =
        format!("{}{new}{}", before.iter().collect::<String>(), after.iter().collect::<String>());
    lines.join("\n") + "\n"
}

/// Returns the texts between back-ticks.
fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

/// Returns the line on which a cue begins.
fn line_of_cue(text: &str, name: &str) -> Option<usize> {
    let named = |line: &str| line.split(['{', '-', ',']).any(|part| part.trim() == format!("cue: {name}"));
    text.lines().position(named).map(|index| index + 1)
}

/// Sets a key of a cue. If the cue is written in one line, the key is set in that line.
fn with_key(text: &str, cue: &str, edit: &str) -> Option<String> {
    let line = line_of_cue(text, cue)?;
    let key = edit.split(':').next()?;
    let whole = text.lines().nth(line - 1)?;
    if !whole.contains('{') {
        let own: Vec<usize> = (line..text.lines().count())
            .take_while(|index| !text.lines().nth(*index).unwrap_or("").trim_start().starts_with("- "))
            .filter(|index| {
                text.lines().nth(*index).unwrap_or("").trim_start().starts_with(&format!("{key}:"))
            })
            .collect();
        let indent = " ".repeat(whole.find("cue:")?);
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        match own.first() {
            Some(index) => lines[*index] = format!("{indent}{edit}"),
            None => lines.insert(line, format!("{indent}{edit}")),
        }
        return Some(lines.join("\n") + "\n");
    }
    match whole.find(&format!(" {key}: ")) {
        Some(at) => {
            let rest = &whole[at + 1..];
            let end = rest.find([',', '}'])?;
            Some(text.replace(whole, &format!("{} {edit}{}", &whole[..at], &rest[end..])))
        }
        None => Some(text.replace(whole, &whole.replacen("cue: ", &format!("{edit}, cue: "), 1))),
    }
}

/// Sets a key of a cue in one of the lines of a contradiction.
fn with_bound(text: &str, finding: &Finding, cue: &str, edit: &str) -> Option<String> {
    let (key, value) = edit.split_once(": ")?;
    let target = |text: &str| {
        text.split([' ', ','])
            .filter(|word| !word.contains(['+', '.']))
            .map(str::to_owned)
            .find(|w| !["start", "end", "of"].contains(&w.as_str()))
    };
    let fits = |related: &&crate::Related| {
        let line: Vec<char> = text.lines().nth(related.line - 1).unwrap_or("").chars().collect();
        let old: String = line[related.column - 1..related.column - 1 + related.width].iter().collect();
        let before: String = line[..related.column - 1].iter().collect();
        match key {
            "at" | "end_by" => {
                before.ends_with(&format!("{key}: ")) && related.message.starts_with(&format!("`{cue}`"))
            }
            _ => {
                let ahead = before.rsplit_once(": ").map_or("", |(ahead, _)| ahead);
                ahead.ends_with(key) && target(&old) == target(value)
            }
        }
    };
    let related = finding.related.iter().find(fits)?;
    Some(replaced(text, related.line, related.column, related.width, value))
}

/// Delays all keyframes that follow a column in a line by a number of seconds.
fn later(text: &str, line: usize, column: usize, seconds: f64) -> String {
    let whole = text.lines().nth(line - 1).unwrap();
    let (before, rest) = whole.split_at(column - 1);
    let parts: Vec<String> = rest
        .split("at: ")
        .enumerate()
        .map(|(index, part)| {
            let end = part.find(',').unwrap_or(part.len());
            match parse_duration(&part[..end]).filter(|_| index > 0) {
                Some(at) => format!("{:.6}s{}", at.as_millis_f64() / 1_000.0 + seconds, &part[end..]),
                None => part.to_owned(),
            }
        })
        .collect();
    text.replace(whole, &format!("{before}{}", parts.join("at: ")))
}

/// Returns the text with each edit that a hint suggests; empty if the hint leaves the edit to the user.
fn edits(text: &str, finding: &Finding, hint: &str) -> Vec<String> {
    let at_place = |new: &str| replaced(text, finding.line, finding.column, finding.width, new);
    let words = quoted(hint);
    let seconds =
        |text: &str| parse_duration(text.trim_end_matches(',')).map(|span| span.as_millis_f64() / 1_000.0);
    let several = ["make one of these changes: ", "one of these is enough: "];
    if let Some(all) = several.iter().find_map(|start| hint.strip_prefix(*start)) {
        return all.split("; ").flat_map(|part| edits(text, finding, part)).collect();
    }
    if finding.code == Code::Conflict {
        let Some(edit) = words.last().filter(|edit| edit.contains(": ")) else { return Vec::new() };
        let text = if edit.starts_with("duration") {
            with_key(text, words[0], edit)
        } else {
            with_bound(text, finding, words[0], edit)
        };
        return vec![text.unwrap_or_else(|| panic!("{finding:?} {hint}"))];
    }
    if hint.starts_with("did you mean `") {
        return vec![at_place(words[0])];
    }
    if hint.starts_with("add the unit: ") {
        return words.iter().map(|word| at_place(word)).collect();
    }
    if let Some(value) = hint.strip_prefix("the nearest possible value is ") {
        return vec![at_place(value)];
    }
    if let Some(rest) = hint.strip_prefix("the nearest values on the grid are ") {
        let (values, _) = rest.split_once(';').unwrap();
        let mut texts: Vec<String> = values.split(" and ").map(at_place).collect();
        texts.push(format!("off_grid: snap\n{text}"));
        return texts;
    }
    if hint.starts_with("use `off_grid: snap`") {
        return vec![format!("off_grid: snap\n{text}")];
    }
    if let Some((to, from)) = hint.strip_prefix("allow ").and_then(|rest| rest.split_once(" instead of ")) {
        let (to, from) = (seconds(to), seconds(from.split(',').next().unwrap()));
        return vec![later(text, finding.line, finding.column, to.unwrap() - from.unwrap())];
    }
    if let Some(rest) = hint.strip_prefix("move the first keyframe to ") {
        let whole = text.lines().nth(finding.line - 1).unwrap();
        let Some(at) = whole[finding.column - 1..].find("at: ") else { return Vec::new() };
        let at = finding.column - 1 + at;
        let end = at + whole[at..].find(',').unwrap();
        let now = seconds(&whole[at + 4..end]).unwrap();
        return vec![later(
            text,
            finding.line,
            finding.column,
            seconds(rest.split(' ').next().unwrap()).unwrap() - now,
        )];
    }
    if hint.starts_with("start `") && hint.contains("for example with `after: ") {
        return with_key(text, words[0], words[1])
            .map(|text| text.replace("at: 500ms, after", "after"))
            .into_iter()
            .collect();
    }
    if let Some(tolerance) =
        words.iter().find(|word| word.starts_with("tolerance: ")).filter(|_| hint.contains("add `tolerance"))
    {
        let whole = text.lines().nth(finding.line - 1).unwrap();
        let from = finding.column - 1;
        let value = whole[from..].split_once(": ").unwrap().1;
        let new = if value.starts_with('{') {
            value.replacen('{', &format!("{{{tolerance}, "), 1)
        } else {
            let end = value.rfind(']').unwrap() + 1;
            format!("{{{tolerance}, keyframes: {}}}{}", &value[..end], &value[end..])
        };
        return vec![text.replace(value, &new)];
    }
    Vec::new()
}

#[test]
fn every_hint_with_edit_resolves_its_finding() {
    let (mut made, mut wrong) = (0, Vec::new());
    let mut names: Vec<PathBuf> =
        std::fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.retain(|path| path.extension().is_some_and(|extension| extension == "yaml"));
    names.sort();
    for path in names {
        let (name, text) =
            (path.file_stem().unwrap().to_str().unwrap(), std::fs::read_to_string(&path).unwrap());
        for finding in compiled(name, &text).findings {
            let Some(hint) = finding.hint.as_ref().filter(|_| finding.file == format!("{name}.yaml")) else {
                continue;
            };
            for edited in edits(&text, &finding, hint) {
                made += 1;
                let same = |other: &Finding| {
                    other.code == finding.code
                        && (other.code == Code::Conflict
                            || other.message == finding.message
                            || other.column == finding.column && other.line == finding.line)
                };
                let still = compiled(name, &edited).findings.into_iter().find(same);
                if edited == text || still.is_some() {
                    wrong.push(format!("{name}: {hint}\n{edited}\n{still:?}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
    assert!(made >= 40, "only {made} edits are made");
}

#[test]
fn applying_conflict_hint_leaves_no_conflict_after_rounding() {
    for bpm in ["97", "110", "131.3"] {
        let music = format!(
            "scenario: s\ntempo: {bpm}\ncues:\n  - {{cue: a, at: bar 120, robots: left, tracks: {{elbow: [{{at: 0s, to: 0}}, {{at: 3 beats, to: 10}}]}}}}\n  - {{cue: b, at: 200s, after: a, robots: right, tracks: {{elbow: [{{at: 0s, to: 0}}, {{at: 1s, to: 10}}]}}}}\n"
        );
        let findings = compiled("x", &music).findings;
        let hint = findings[0].hint.clone().unwrap();
        let texts = edits(&music, &findings[0], &hint);
        assert!(!texts.is_empty(), "{hint}");
        for text in texts {
            let left = compiled("x", &text).findings;
            assert!(left.iter().all(|finding| finding.code != Code::Conflict), "{hint}\n{text}\n{left:?}");
        }
    }
}
