//! Writes a graph in the DOT language of Graphviz. Each act is a cluster.

use std::fmt::Write;

use super::{ActNode, Course, CourseEdge, CueNode, END, Graph, RelationEdge};

const HEAD: &str = "digraph scenario {
  graph [rankdir=LR, compound=true, fontname=\"Helvetica\", nodesep=0.3, ranksep=0.7];
  node [shape=box, style=\"rounded,filled\", fillcolor=white, fontname=\"Helvetica\", fontsize=11];
  edge [fontname=\"Helvetica\", fontsize=9, color=\"#555555\"];
";

const CRITICAL: &str = "color=\"#c00000\", fontcolor=\"#c00000\", penwidth=2.5";

pub(super) fn dot(graph: &Graph) -> String {
    let mut text = HEAD.to_owned();
    for act in &graph.acts {
        text += &cluster(act, &graph.scenario);
    }
    if graph.ends() {
        let _ = writeln!(text, "  {END} [shape=doublecircle, label=\"\", width=0.2];");
    }
    for edge in &graph.course {
        text += &course(edge, graph);
    }
    text + "}\n"
}

fn cluster(act: &ActNode, scenario: &str) -> String {
    let mut text = format!(
        "  subgraph cluster_{} {{\n    graph [label={}, labeljust=l, style=\"rounded,filled\", fillcolor=\"#f4f6fa\", \
         color=\"#8090a8\", fontsize=13];\n",
        act.id,
        label(&act.title(scenario))
    );
    for cue in &act.cues {
        text += &node(cue);
    }
    if act.cues.is_empty() {
        let _ = writeln!(text, "    {}x [shape=point, style=invis];", act.id);
    }
    for edge in &act.relations {
        text += &relation(edge);
    }
    text + "  }\n"
}

fn node(cue: &CueNode) -> String {
    let critical = if cue.critical { format!(", {CRITICAL}") } else { String::new() };
    format!("    {} [label={}{critical}];\n", cue.id, label(&cue.lines()))
}

fn relation(edge: &RelationEdge) -> String {
    let critical = if edge.critical { format!(", {CRITICAL}") } else { String::new() };
    let text = label(std::slice::from_ref(&edge.text));
    format!("    {} -> {} [label={text}{critical}];\n", edge.from, edge.to)
}

/// Returns the DOT statement for an edge between two acts. In DOT, the edge connects a node of each act and is clipped at the surrounding
/// clusters.
fn course(edge: &CourseEdge, graph: &Graph) -> String {
    let act = |id: &str| graph.acts.iter().find(|act| act.id == id);
    let last = |act: &ActNode| {
        let cue = act.cues.iter().max_by_key(|cue| cue.start_ms + cue.duration_ms);
        cue.map_or_else(|| format!("{}x", act.id), |cue| cue.id.clone())
    };
    let first = |act: &ActNode| {
        let cue = act.cues.iter().min_by_key(|cue| cue.start_ms);
        cue.map_or_else(|| format!("{}x", act.id), |cue| cue.id.clone())
    };
    let style = match edge.kind {
        Course::Next => "style=bold, color=\"#203050\"",
        Course::OnFailure => "style=dashed, color=\"#c06000\", fontcolor=\"#c06000\"",
        Course::OnTimeout => "style=dotted, color=\"#203050\", penwidth=2",
    };
    let from = act(&edge.from).map_or_else(|| edge.from.clone(), last);
    let ltail = format!("ltail=cluster_{}", edge.from);
    let (to, lhead) = match act(&edge.to) {
        Some(to) => (first(to), format!(", lhead=cluster_{}", to.id)),
        None => (edge.to.clone(), String::new()),
    };
    let text = label(std::slice::from_ref(&edge.text));
    format!("  {from} -> {to} [{ltail}{lhead}, {style}, label={text}];\n")
}

/// Returns lines of text as a quoted DOT string. Backslashes and HTML entities are escaped, because Graphviz would interpret them.
fn label(lines: &[String]) -> String {
    let escaped = lines.iter().map(|line| {
        let line = downbeat_scripts::shown::shown(line);
        line.replace('&', "&amp;").replace('\\', "\\\\").replace('"', "\\\"")
    });
    format!("\"{}\"", escaped.collect::<Vec<_>>().join("\\n"))
}

#[cfg(test)]
mod tests {
    use super::super::tests::{graph, hostile};
    use super::*;

    #[test]
    fn critical_path_cues_are_bold_and_red() {
        let text = dot(&graph(
            "scenario: s\ncues:\n  - {cue: a, at: 1s}\n  - {cue: b, after: a + 2s}\n  - {cue: c, at: 0s}\n",
        ));
        let line = |start: &str| text.lines().find(|line| line.trim().starts_with(start)).unwrap();
        assert!(line("a0c0 [").contains("penwidth=2.5"), "{text}");
        assert!(
            line("a0c0 -> a0c1").contains("label=\"after the end of a + 2 s\", color=\"#c00000\""),
            "{text}"
        );
        assert!(!line("a0c2 [").contains("penwidth"), "{text}");
    }

    #[test]
    fn hostile_names_are_escaped_in_dot_strings() {
        let text = dot(&hostile());
        let outside: Vec<&str> = text.lines().filter(|line| line.contains("script")).collect();
        // The two lines are the title of the act and the node of its cue.
        assert_eq!(outside.len(), 2, "{text}");
        for line in outside {
            let string = line.split_once("label=\"").unwrap().1;
            // Every quote of the name is escaped, and the one that ends the string is not.
            let mut escaped = false;
            let end = string.char_indices().find(|(_, c)| {
                let ends = *c == '"' && !escaped;
                escaped = *c == '\\' && !escaped;
                ends
            });
            let (label, rest) = string.split_at(end.unwrap().0);
            assert!(label.contains("alert(1)</script> &amp; #quot;"), "{label}");
            assert!(!rest.contains("script"), "{rest}");
        }
    }
}
