//! A graph as a flowchart of Mermaid: acts are subgraphs.

use std::fmt::Write;

use super::{ActNode, Course, END, Graph};

const STYLES: &str = "  classDef critical stroke:#c00000,stroke-width:3px,font-weight:bold\n";

pub(super) fn mermaid(graph: &Graph) -> String {
    let mut text = "flowchart LR\n".to_owned();
    // Styles of edges go by their number.
    let (mut count, mut critical) = (0_usize, Vec::new());
    for act in &graph.acts {
        text += &subgraph(act, &graph.scenario);
        for edge in &act.relations {
            let arrow = if edge.critical { "==>" } else { "-->" };
            let label = quoted(std::slice::from_ref(&edge.text));
            let _ = writeln!(text, "  {} {arrow}|{label}| {}", edge.from, edge.to);
            if edge.critical {
                critical.push(count.to_string());
            }
            count += 1;
        }
    }
    if graph.ends() {
        let _ = writeln!(text, "  the_{END}((( )))");
    }
    for edge in &graph.course {
        let arrow = match edge.kind {
            Course::Next => "-->",
            Course::OnFailure | Course::OnTimeout => "-.->",
        };
        let label = match edge.text.as_str() {
            "" => String::new(),
            text => format!("|{}|", quoted(&[text.to_owned()])),
        };
        // `end` is a word of the language.
        let to = if edge.to == END { format!("the_{END}") } else { edge.to.clone() };
        let _ = writeln!(text, "  {} {arrow}{label} {to}", edge.from);
    }
    text += STYLES;
    if !critical.is_empty() {
        let _ = writeln!(text, "  linkStyle {} stroke:#c00000", critical.join(","));
    }
    text
}

fn subgraph(act: &ActNode, scenario: &str) -> String {
    let mut text = format!("  subgraph {}[{}]\n", act.id, quoted(&act.title(scenario)));
    for cue in &act.cues {
        let critical = if cue.critical { ":::critical" } else { "" };
        let _ = writeln!(text, "    {}[{}]{critical}", cue.id, quoted(&cue.lines()));
    }
    if act.cues.is_empty() {
        let _ = writeln!(text, "    {}x[\"no cues\"]", act.id);
    }
    text + "  end\n"
}

/// A quoted string. What is not plain is written by its number, so nothing in it means anything to Mermaid, Markdown or HTML.
fn quoted(lines: &[String]) -> String {
    let mut text = String::from("\"");
    for (number, line) in lines.iter().enumerate() {
        if number > 0 {
            text += "<br/>";
        }
        for character in downbeat_scripts::shown::shown(line).chars() {
            match character {
                ' ' | '.' | ',' | '+' => text.push(character),
                plain if plain.is_alphanumeric() => text.push(plain),
                other => {
                    let _ = write!(text, "#{};", u32::from(other));
                }
            }
        }
    }
    text + "\""
}

#[cfg(test)]
mod tests {
    use super::super::tests::{graph, hostile};
    use super::*;

    #[test]
    fn critical_edges_are_thick_and_red_by_their_numbers() {
        let text = mermaid(&graph(
            "scenario: s\ncues:\n  - {cue: c, at: 0s..1s}\n  - {cue: a, at: 1s, after: c}\n  - {cue: b, after: a + 2s}\n",
        ));
        assert!(text.contains("  a0c0 -->|\"after the end of c\"| a0c1\n"), "{text}");
        assert!(text.contains("  a0c1 ==>|\"after the end of a + 2 s\"| a0c2\n"), "{text}");
        assert!(text.contains("linkStyle 1 stroke"), "{text}");
    }

    #[test]
    fn of_a_name_only_letters_and_digits_stay_as_they_are() {
        let text = mermaid(&hostile());
        let names = text.lines().filter(|line| line.contains("script"));
        assert_eq!(names.count(), 2, "{text}");
        assert!(!text.contains("<script") && !text.contains("#quot;") && !text.contains('`'), "{text}");
        assert!(text.contains("a#34;#93;#59; end #60;script#62;alert#40;1#41;"), "{text}");
    }
}
