//! Each sentence of `docs/mission.md` and `docs/protocol.md` that promises a behaviour has a judge, which finds a violation, and a
//! planted fault that this judge finds. The sentences are in [`table`], as [`sentences`] reads them.

mod sentences;
mod table;

use std::collections::{BTreeMap, BTreeSet};

use downbeat::conformance::requirements;
use downbeat_simulation::Verdict;
use stage::session::root;

use sentences::sentences;
use table::{NO_PROMISES, PROMISES};

/// Which document a sentence is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Document {
    Mission,
    Protocol,
}

/// What finds a violation of a promise, and what shows that it does.
#[derive(Clone, Copy, Debug)]
pub enum Judge {
    /// The simulation, by this invariant. It is violated if this patch in `scheduler/simulation/planted` is applied.
    Simulation(char, &'static str),
    /// The simulation, by this invariant. This test of `scheduler/simulation/src/check/tests.rs` makes a mission violate it.
    Falsified(char, &'static str),
    /// The conformance test, by this requirement. This robot or door of `tests/processes/conformance` fails it.
    Conformance(&'static str, &'static str),
    /// A test, written as `file::name`, that fails if the promise is broken.
    Test(&'static str),
}

/// A sentence with its judges.
pub type Promise = (Document, &'static str, &'static [Judge]);

/// The words by which these documents promise.
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

/// Folder of the patches that plant faults.
const PLANTED: &str = "scheduler/simulation/planted";
/// Tests of the simulation's invariants.
const FALSIFIED: &str = "scheduler/simulation/src/check/tests.rs";
/// The robots and doors with faults.
const FAULTY: &str = "tests/processes/conformance";

impl Document {
    const fn path(self) -> &'static str {
        match self {
            Self::Mission => "docs/mission.md",
            Self::Protocol => "docs/protocol.md",
        }
    }

    fn sentences(self) -> Vec<String> {
        sentences(&read(self.path()))
    }
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

/// All sentences of both tables.
fn listed() -> impl Iterator<Item = (Document, &'static str)> {
    let promises = PROMISES.iter().map(|(document, sentence, _)| (*document, *sentence));
    promises.chain(NO_PROMISES.iter().map(|(document, sentence, _)| (*document, *sentence)))
}

#[test]
fn each_sentence_is_in_its_document_and_once_in_the_tables() {
    let mut wrong = Vec::new();
    let mut seen = BTreeSet::new();
    let documents = [Document::Mission, Document::Protocol];
    let known: BTreeMap<_, _> = documents.map(|document| (document, document.sentences())).into();
    for (document, sentence) in listed() {
        if !known[&document].iter().any(|known| known == sentence) {
            wrong.push(format!("{} lacks: {sentence}", document.path()));
        }
        if !seen.insert((document, sentence)) {
            wrong.push(format!("twice: {sentence}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Whether a source has a test with this name.
fn has_test(source: &str, name: &str) -> bool {
    let Some((before, _)) = source.split_once(&format!("fn {name}(")) else { return false };
    let attributes = before.rsplit('}').next().unwrap_or_default();
    attributes.contains("#[test]") || attributes.contains("#[tokio::test")
}

/// Whether a robot or a door with this fault is expected to fail this requirement.
fn is_failed_by(sources: &[String], requirement: &str, faulty: &str) -> bool {
    let places = [format!("\"{faulty}\","), format!("Fault::{faulty}, ")];
    // What a fault fails follows its name.
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
fn each_judge_and_each_planted_fault_exists() {
    let (faulty, mut sources) = (faulty_sources(), BTreeMap::new());
    let is_invariant = |letter: char| Verdict::INVARIANTS.iter().any(|(known, _)| *known == letter);
    let mut test = |path: &str, name: &str| {
        let source = sources
            .entry(path.to_owned())
            .or_insert_with(|| std::fs::read_to_string(root().join(path)).unwrap_or_default());
        has_test(source, name)
    };
    let mut wrong = Vec::new();
    for (_, sentence, judges) in PROMISES {
        if judges.is_empty() {
            wrong.push(format!("nothing judges: {sentence}"));
        }
        for judge in *judges {
            let exists = match judge {
                Judge::Simulation(letter, patch) => {
                    is_invariant(*letter) && root().join(PLANTED).join(format!("{patch}.patch")).is_file()
                }
                Judge::Falsified(letter, name) => is_invariant(*letter) && test(FALSIFIED, name),
                Judge::Conformance(name, fault) => {
                    requirements().any(|known| known.name == *name) && is_failed_by(&faulty, name, fault)
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
fn each_sentence_that_promises_something_is_in_a_table() {
    let listed: BTreeSet<_> = listed().collect();
    let mut missing = Vec::new();
    for document in [Document::Mission, Document::Protocol] {
        for sentence in document.sentences() {
            if promises(&sentence) && !listed.contains(&(document, sentence.as_str())) {
                missing.push(format!("{}: {sentence}", document.path()));
            }
        }
    }
    let todo = "give it a judge in tests/documents/promises/table.rs, or say there why it promises nothing";
    assert!(missing.is_empty(), "{todo}:\n{}", missing.join("\n"));
    let reasons = NO_PROMISES.iter().all(|(.., reason)| reason.ends_with('.'));
    assert!(reasons, "a sentence that promises nothing needs a reason");
}

#[test]
fn the_document_states_the_figures() {
    let with = |of: fn(&Judge) -> bool| PROMISES.iter().filter(|(.., judges)| judges.iter().any(of)).count();
    let figures = [
        ("promises", PROMISES.len()),
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
