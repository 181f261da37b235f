//! Tests that each promise in `docs/mission.md` and `docs/protocol.md` is checked. Each sentence that promises a behaviour has a judge: a
//! test that detects a violation. For each judge there is a planted fault, which it detects. `promises/table.txt` lists the sentences as
//! [`sentences`] returns them, in document order. Each sentence is followed by its judges, or by the reason why it promises nothing.

mod sentences;

use std::collections::{BTreeMap, BTreeSet};

use downbeat::conformance::requirements;
use downbeat_simulation::Verdict;
use stage::session::root;

use sentences::sentences;

const TABLE: &str = include_str!("promises/table.txt");
const DOCUMENTS: [&str; 4] = ["docs/mission.md", "docs/protocol.md", "docs/transport.md", "docs/proof.md"];

/// A row of `promises/table.txt`: a sentence and its judges, which detect violations of the sentence.
struct Row {
    document: &'static str,
    sentence: &'static str,
    judges: Vec<Judge>,
    /// The reason why the sentence promises nothing; `None` if it has judges.
    reason: Option<&'static str>,
}

/// A test that detects a violation of a promise. It is itself tested with a planted fault.
#[derive(Clone, Copy, Debug)]
enum Judge {
    /// An invariant of the simulation, and the patch in `scheduler/simulation/planted` that plants a violation of the invariant.
    Simulation(&'static str, &'static str),
    /// An invariant of the simulation, and the test in `scheduler/simulation/src/check/tests.rs` in which a mission violates the
    /// invariant.
    Falsified(&'static str, &'static str),
    /// A requirement of the conformance test, and the faulty robot or door (which authenticates a robot's peers) in
    /// `tests/processes/conformance` that fails it.
    Conformance(&'static str, &'static str),
    /// A test, written as `file::name`, that fails if the promise is broken.
    Test(&'static str),
}

/// Words that mark a sentence of the documents as a promise.
const PROMISING: [&str; 12] = [
    "never",
    "no robot",
    "nothing",
    "all robots",
    "every",
    "at most",
    "within",
    "only",
    "must",
    "has to",
    "stays",
    "keeps",
];

/// Folder of the patches that plant faults in the program.
const PLANTED: &str = "scheduler/simulation/planted";
/// File of the tests in which missions violate invariants of the simulation.
const FALSIFIED: &str = "scheduler/simulation/src/check/tests.rs";
/// Folder of the faulty robots and doors (which authenticate a robot's peers) that the conformance test must detect.
const FAULTY: &str = "tests/processes/conformance";

impl Judge {
    /// Parses a judge from its line in `promises/table.txt`.
    fn of(line: &'static str) -> Self {
        let parts = line.split_once(' ').and_then(|(kind, rest)| match kind {
            "test" => Some(Self::Test(rest)),
            "conformance" => rest.split_once(": ").map(|(name, fault)| Self::Conformance(name, fault)),
            "simulation" => rest.split_once(' ').map(|(letter, patch)| Self::Simulation(letter, patch)),
            "falsified" => rest.split_once(' ').map(|(letter, test)| Self::Falsified(letter, test)),
            _ => None,
        });
        parts.unwrap_or_else(|| panic!("`{line}` is no judge"))
    }
}

fn rows() -> Vec<Row> {
    let (mut rows, mut document) = (Vec::<Row>::new(), "");
    for line in TABLE.lines().filter(|line| !line.is_empty()) {
        match (line.strip_prefix("# "), line.strip_prefix("  ")) {
            (Some(path), _) => document = path,
            (_, Some(below)) => {
                let row = rows.last_mut().unwrap();
                match below.strip_prefix("none: ") {
                    Some(reason) => row.reason = Some(reason),
                    None => row.judges.push(Judge::of(below)),
                }
            }
            _ => rows.push(Row { document, sentence: line, judges: Vec::new(), reason: None }),
        }
    }
    rows
}

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn promises(sentence: &str) -> bool {
    let sentence = sentence.to_lowercase();
    let joins = |c: char| c.is_alphanumeric() || c == '_';
    PROMISING.iter().any(|word| {
        sentence.match_indices(word).any(|(at, _)| {
            !sentence[..at].ends_with(joins) && !sentence[at + word.len()..].starts_with(joins)
        })
    })
}

#[test]
fn each_listed_sentence_is_in_its_document_and_listed_once() {
    let mut wrong = Vec::new();
    let mut seen = BTreeSet::new();
    let known: BTreeMap<_, _> = DOCUMENTS.map(|document| (document, sentences(&read(document)))).into();
    for Row { document, sentence, .. } in rows() {
        if !known[document].iter().any(|known| known == sentence) {
            wrong.push(format!("{document} lacks: {sentence}"));
        }
        if !seen.insert((document, sentence)) {
            wrong.push(format!("twice: {sentence}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Whether the source code contains a test with the given name.
fn has_test(source: &str, name: &str) -> bool {
    let Some((before, _)) = source.split_once(&format!("fn {name}(")) else { return false };
    let attributes = before.rsplit('}').next().unwrap_or_default();
    attributes.contains("#[test]") || attributes.contains("#[tokio::test")
}

/// Whether `sources` state that a robot or door with the fault `faulty` fails the given requirement.
fn is_failed_by(sources: &[String], requirement: &str, faulty: &str) -> bool {
    let places = [format!("\"{faulty}\","), format!("Fault::{faulty}, ")];
    // The requirements that a fault violates follow its name.
    sources.iter().any(|source| {
        let mut after = places.iter().filter_map(|place| Some(source.split_once(place)?.1));
        after.any(|after| {
            let listed = after.split_once("&[").and_then(|(_, rest)| rest.split_once(']'));
            listed.is_some_and(|(fails, _)| fails.contains(&format!("\"{requirement}\"")))
        })
    })
}

fn faulty_sources() -> Vec<String> {
    let mut sources = vec![read(&format!("{FAULTY}/sloppy.rs"))];
    for entry in std::fs::read_dir(root().join(FAULTY).join("faults")).unwrap() {
        sources.push(std::fs::read_to_string(entry.unwrap().path()).unwrap());
    }
    sources
}

#[test]
fn every_listed_judge_and_planted_fault_exists() {
    let (faulty, mut sources) = (faulty_sources(), BTreeMap::new());
    let is_invariant =
        |letter: &str| Verdict::INVARIANTS.iter().any(|(known, _)| letter == known.to_string());
    let mut test = |path: &str, name: &str| {
        let source = sources
            .entry(path.to_owned())
            .or_insert_with(|| std::fs::read_to_string(root().join(path)).unwrap_or_default());
        has_test(source, name)
    };
    let mut wrong = Vec::new();
    for Row { sentence, judges, reason, .. } in rows() {
        if judges.is_empty() == reason.is_none() {
            wrong.push(format!("expected judges, or a reason why it promises nothing: {sentence}"));
        }
        for judge in judges {
            let exists = match judge {
                Judge::Simulation(letter, patch) => {
                    is_invariant(letter) && root().join(PLANTED).join(format!("{patch}.patch")).is_file()
                }
                Judge::Falsified(letter, name) => is_invariant(letter) && test(FALSIFIED, name),
                Judge::Conformance(name, fault) => {
                    requirements().any(|known| known.name == name) && is_failed_by(&faulty, name, fault)
                }
                Judge::Test(place) => place.rsplit_once("::").is_some_and(|(path, name)| test(path, name)),
            };
            if !exists {
                wrong.push(format!("{judge:?} of: {sentence}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn each_sentence_with_promise_is_listed_in_table() {
    let listed: BTreeSet<_> = rows().iter().map(|row| (row.document, row.sentence)).collect();
    let mut missing = Vec::new();
    for document in DOCUMENTS {
        for sentence in sentences(&read(document)) {
            if promises(&sentence) && !listed.contains(&(document, sentence.as_str())) {
                missing.push(format!("{document}: {sentence}"));
            }
        }
    }
    let todo = "give it a judge in tests/documents/promises/table.txt, or say there why it promises nothing";
    assert!(missing.is_empty(), "{todo}:\n{}", missing.join("\n"));
}

#[test]
fn document_states_current_promise_counts() {
    let rows = rows();
    let with = |of: fn(&Judge) -> bool| rows.iter().filter(|row| row.judges.iter().any(of)).count();
    let figures = [
        ("promises", with(|_| true)),
        (
            "judged by an invariant",
            with(|judge| matches!(judge, Judge::Simulation(..) | Judge::Falsified(..))),
        ),
        ("by a requirement", with(|judge| matches!(judge, Judge::Conformance(..)))),
        ("by tests", with(|judge| matches!(judge, Judge::Test(_)))),
    ];
    let page = read("docs/simulation.md");
    let section = page.split_once("**Promises.**").and_then(|(_, rest)| rest.split_once("\n\n")).unwrap().0;
    let stated: Vec<usize> =
        section.split(|c: char| !c.is_ascii_digit()).filter_map(|digits| digits.parse().ok()).collect();
    assert_eq!(stated, figures.map(|(_, count)| count), "docs/simulation.md should state {figures:?}");
}

/// Files of the mission in which `holds!` quotes `docs/mission.md`.
const QUOTING: [&str; 5] = [
    "scheduler/mission/src/invariants.rs",
    "scheduler/mission/src/act/invariants.rs",
    "scheduler/mission/src/act/timing/invariants.rs",
    "scheduler/mission/src/robot_state/invariants.rs",
    "scheduler/mission/src/script/invariants.rs",
];

/// Returns the last string in the arguments of each `holds!`: the quoted statement.
fn quotations(source: &str) -> Vec<&str> {
    let arguments = source.split("holds!(").skip(1);
    arguments.filter_map(|arguments| last_string(arguments)).collect()
}

/// Returns the last string before the parenthesis that ends the arguments.
fn last_string(arguments: &str) -> Option<&str> {
    let (mut depth, mut last, mut begins) = (1, None, None);
    for (at, c) in arguments.char_indices() {
        match (c, begins) {
            ('"', Some(from)) => (last, begins) = (Some(&arguments[from..at]), None),
            ('"', None) => begins = Some(at + 1),
            ('(', None) => depth += 1,
            (')', None) => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return last;
        }
    }
    None
}

#[test]
fn invariants_of_the_mission_quote_its_document() {
    let stated = sentences(&read("docs/mission.md")).join(" ");
    let mut wrong = Vec::new();
    for path in QUOTING {
        let source = read(path);
        let quoted = quotations(&source);
        assert_eq!(quoted.len(), source.matches("holds!(").count(), "{path}");
        wrong.extend(
            quoted.iter().filter(|quoted| !stated.contains(**quoted)).map(|it| format!("{path}: {it}")),
        );
    }
    assert!(wrong.is_empty(), "docs/mission.md does not state:\n{}", wrong.join("\n"));
}
