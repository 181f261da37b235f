//! The graph of a scenario: its acts, the edges that show which act follows which, and the cues of each act with their relations. The
//! module `dot` writes the graph for Graphviz.

mod dot;

use downbeat_scripts::shown::within;
use downbeat_scripts::{Act, Choreography, Gap, Moment, Outline, PlannedCue, Way, WrittenCue};
use serde::Serialize;
use urrcp::Span;

/// Maximum width, in columns, of a name or a sentence in a picture. Longer texts are cut and end in `…`.
const TEXT_MAX: usize = 60;

/// A graph whose nodes are acts and cues. The ids of the nodes are generated and contain no names.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Graph {
    scenario: String,
    acts: Vec<ActNode>,
    /// The edges that lead from act to act.
    course: Vec<CourseEdge>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct ActNode {
    id: String,
    /// Name of the act. Empty if the scenario does not define acts.
    act: String,
    duration_ms: Span,
    /// The condition that starts the act, as text. `None` if the act follows the previous one immediately.
    waits_for: Option<String>,
    cues: Vec<CueNode>,
    relations: Vec<RelationEdge>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct CueNode {
    id: String,
    cue: String,
    start_ms: Span,
    duration_ms: Span,
    slack_ms: Span,
    critical: bool,
    robots: Vec<String>,
    /// Constraints between the cue and the act itself, such as `at 2 s`.
    bounds: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct RelationEdge {
    /// The id of the earlier cue.
    from: String,
    to: String,
    text: String,
    /// Whether both cues are on the critical path and the relation leaves no slack between them.
    critical: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct CourseEdge {
    from: String,
    /// The id of the act to which the edge leads, or `end`.
    to: String,
    kind: Course,
    text: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Course {
    Next,
    OnFailure,
    OnTimeout,
}

/// The id of the node at which a mission ends.
const END: &str = "end";

impl Graph {
    /// Builds the graph of all acts, or only of the act with the index `only`.
    #[must_use]
    pub fn of(choreography: &Choreography, outline: &Outline, only: Option<usize>) -> Self {
        let shown = |index: &usize| only.is_none_or(|only| only == *index);
        let acts = choreography.acts.iter().enumerate().filter(|(index, _)| shown(index));
        let act = |(index, act): (usize, &Act)| {
            let written = outline.acts.iter().find(|written| written.name == act.name);
            act_node(index, act, written.map_or(&[], |written| &written.cues))
        };
        let course = match only {
            Some(_) => Vec::new(),
            None => {
                choreography.acts.iter().enumerate().flat_map(|(index, act)| course(index, act)).collect()
            }
        };
        Self { scenario: choreography.scenario.clone(), acts: acts.map(act).collect(), course }
    }

    /// Returns the graph in the DOT language of Graphviz.
    #[must_use]
    pub fn dot(&self) -> String {
        dot::dot(self)
    }

    fn ends(&self) -> bool {
        self.course.iter().any(|edge| edge.to == END)
    }
}

fn act_id(index: usize) -> String {
    format!("a{index}")
}

fn cue_id(act: usize, cue: usize) -> String {
    format!("a{act}c{cue}")
}

fn act_node(index: usize, act: &Act, written: &[WrittenCue]) -> ActNode {
    let cues = act.cues.iter().enumerate();
    let cue = |(number, cue): (usize, &PlannedCue)| cue_node(cue_id(index, number), cue, written.get(number));
    let relations = written.iter().flat_map(|cue| &cue.relations);
    let edge = |text: &String, gap: Gap| RelationEdge {
        from: cue_id(index, gap.from.cue()),
        to: cue_id(index, gap.to.cue()),
        text: text.clone(),
        critical: is_critical(&act.cues, gap),
    };
    ActNode {
        id: act_id(index),
        act: act.name.clone(),
        duration_ms: act.plan.duration(),
        waits_for: Some(crate::waits(&act.wait)).filter(|waits| !waits.is_empty()),
        cues: cues.map(cue).collect(),
        relations: relations.filter_map(|told| told.gap.map(|gap| edge(&told.text, gap))).collect(),
    }
}

fn cue_node(id: String, cue: &PlannedCue, written: Option<&WrittenCue>) -> CueNode {
    let relations = written.iter().flat_map(|written| &written.relations);
    CueNode {
        id,
        cue: cue.name.clone(),
        start_ms: cue.start,
        duration_ms: cue.end - cue.start,
        slack_ms: cue.slack,
        critical: cue.critical,
        robots: written.iter().flat_map(|written| &written.robots).map(ToString::to_string).collect(),
        bounds: relations.filter(|told| told.gap.is_none()).map(|told| told.text.clone()).collect(),
    }
}

/// Whether a relation connects two cues of the critical path and leaves no slack between them.
fn is_critical(cues: &[PlannedCue], gap: Gap) -> bool {
    let instant = |moment: Moment| {
        let cue = cues.get(moment.cue()).filter(|cue| cue.critical)?;
        Some(match moment {
            Moment::StartOf(_) => cue.start,
            Moment::EndOf(_) => cue.end,
        })
    };
    let between = instant(gap.from).zip(instant(gap.to)).map(|(from, to)| to - from);
    between.is_some_and(|between| between == gap.least || Some(between) == gap.most)
}

fn course(index: usize, act: &Act) -> Vec<CourseEdge> {
    let to = |way: Way| match way {
        Way::Act(other) => Some(act_id(other)),
        Way::End => Some(END.to_owned()),
        Way::Fail => None,
    };
    let late =
        act.timeout.and_then(|timeout| Some((to(act.on_timeout)?, format!("timeout after {timeout}"))));
    let failed = act.on_failure.then.map(|other| (act_id(other), "if a robot fails".to_owned()));
    let next = to(act.next).map(|to| (to, String::new()));
    let ways = [(Course::Next, next), (Course::OnFailure, failed), (Course::OnTimeout, late)];
    let edge = |(kind, way): (Course, Option<(String, String)>)| {
        way.map(|(to, text)| CourseEdge { from: act_id(index), to, kind, text })
    };
    ways.into_iter().filter_map(edge).collect()
}

impl ActNode {
    /// Returns the lines of the act's title. The first line is the act's name, or the scenario's if the act has no name.
    fn title(&self, scenario: &str) -> Vec<String> {
        let name = if self.act.is_empty() { scenario } else { &self.act };
        let waits = self.waits_for.as_ref().map(|waits| format!("waits for {}", within(waits, TEXT_MAX)));
        let figures = std::iter::once(format!("lasts {}", self.duration_ms));
        std::iter::once(within(name, TEXT_MAX).into_owned()).chain(waits).chain(figures).collect()
    }
}

impl CueNode {
    fn lines(&self) -> Vec<String> {
        let name = within(&self.cue, TEXT_MAX).into_owned();
        let when = match self.duration_ms {
            Span::ZERO => format!("at {}", self.start_ms),
            duration => format!("at {} for {duration}", self.start_ms),
        };
        let slack = if self.critical { "critical".to_owned() } else { format!("slack {}", self.slack_ms) };
        let bounds = self.bounds.iter().map(|bound| format!("[{}]", within(bound, TEXT_MAX)));
        [name, when, slack].into_iter().chain(bounds).collect()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use downbeat_scripts::{Fleet, NoFiles, Source, compile, outline};

    /// Builds the graph of a scenario without a fleet. All cues in `text` must be marks (cues without robots and tracks).
    pub(in crate::graph) fn graph(text: &str) -> Graph {
        let source = Source { name: "s.yaml".into(), text: text.to_owned() };
        let fleet = Fleet::default();
        let compiled = compile(&source, &fleet, &NoFiles);
        let choreography = compiled.choreography.unwrap_or_else(|| panic!("{:#?}", compiled.findings));
        Graph::of(&choreography, &outline(&source, &fleet, &NoFiles), None)
    }

    const THREE: &str = "scenario: s
cues:
  - {cue: late, after: early + 2s}
  - {cue: early, at: 1s}
  - {cue: free, at: 0s..9s, before: late}
";

    #[test]
    fn edge_starts_at_earlier_cue_and_is_critical_if_it_has_no_slack() {
        let graph = graph(THREE);
        let edge = |edge: &RelationEdge| (edge.from.clone(), edge.to.clone(), edge.critical);
        let edges: Vec<_> = graph.acts[0].relations.iter().map(edge).collect();
        assert_eq!(edges, [("a0c1".into(), "a0c0".into(), true), ("a0c2".into(), "a0c0".into(), false)]);
    }

    #[test]
    fn bounds_on_a_single_cue_are_shown_on_its_node() {
        let graph = graph(THREE);
        assert_eq!(graph.acts[0].cues[1].lines(), ["early", "at 1 s", "critical", "[at 1 s]"]);
        assert_eq!(graph.acts[0].cues[2].lines(), ["free", "at 0 ms", "slack 3 s", "[at 0 ms to 9 s]"]);
    }

    #[test]
    fn course_contains_every_exit_of_an_act() {
        let graph = graph(
            "scenario: s
acts:
  - {act: one, wait: {for: operator, timeout: 5s, otherwise: end}, on_failure: {then: two}, cues: [{cue: a, at: 0s}]}
  - {act: two, cues: [{cue: b, at: 0s}]}
",
        );
        let told = |edge: &CourseEdge| format!("{} {:?} {} {}", edge.from, edge.kind, edge.to, edge.text);
        let course: Vec<_> = graph.course.iter().map(told).collect();
        let ways = [
            "a0 Next a1 ",
            "a0 OnFailure a1 if a robot fails",
            "a0 OnTimeout end timeout after 5 s",
            "a1 Next end ",
        ];
        assert_eq!(course, ways);
        assert_eq!(graph.acts[0].title("s"), ["one", "waits for the operator", "lasts 0 ms"]);
    }

    /// A name that contains all special characters of DOT and HTML.
    pub(in crate::graph) const HOSTILE: &str =
        r#"a"]; end <script>alert(1)</script> & #quot; `x` \" %% {{ | -->"#;

    pub(in crate::graph) fn hostile() -> Graph {
        let name = serde_json::Value::from(format!("{HOSTILE}\n2"));
        graph(&format!("scenario: {name}\nacts:\n  - {{act: {name}, cues: [{{cue: {name}, at: 0s}}]}}\n"))
    }
}
