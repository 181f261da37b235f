//! The parts that cues share: included files, variables, moves, sequences, roles, formations, paths, and the tempo.

use std::borrow::Cow;
use std::cell::{OnceCell, RefCell};
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use super::Name;
use super::each::Roster;
use super::formations;
use super::includes::{self, Included};
use super::kinds;
use super::nesting::Used;
use super::paths;
use crate::ensemble::{Action, Course, Form, Ground, Sweep, Target, Together, WrittenFormation, WrittenPath};
use crate::exact::{Fraction, fraction};
use crate::fields::{At, Reader, is_spread};
use crate::files::Files;
use crate::finding::{Code, Finding, Place, Use, one_defined, within_file};
use crate::fleet::Fleet;
use crate::identify::not_to_include;
use crate::locate::locate;
use crate::music::{Section, Tempo, position};
use crate::node::{self, Node};
use crate::scope::Variable;
use crate::shown::shortened;
use crate::source::Source;
use crate::syntax::conceal;
use crate::tags::foreign_tags;
use downbeat_reader::keys::Keys;
use downbeat_reader::{keys, schema};

/// Maximum number of files that a scenario may include, directly or indirectly.
pub(super) const INCLUDES_MAX: usize = 256;

keys! {
    /// A file that scenarios include.
    pub(super) struct IncludedKeys {
        /// Purpose of the file, in words.
        doc: kinds::TEXT,
        /// Names with their defaults; `~` for none.
        parameters: kinds::DEFAULTS,
        include: kinds::INCLUDE,
        variables: kinds::VARIABLES,
        moves: kinds::MOVES,
        sequences: kinds::SEQUENCES,
        roles: kinds::ROLES,
        formations: kinds::FORMATIONS,
        paths: kinds::PATHS,
    }
}

/// The keys for shared parts, which both scenarios and included files may have.
pub(super) struct Parts<'a> {
    pub(super) variables: Option<At<'a>>,
    pub(super) moves: Option<At<'a>>,
    pub(super) sequences: Option<At<'a>>,
    pub(super) roles: Option<At<'a>>,
    pub(super) formations: Option<At<'a>>,
    pub(super) paths: Option<At<'a>>,
}

impl<'a> IncludedKeys<'a> {
    pub(super) const fn parts(&self) -> Parts<'a> {
        let Self { variables, moves, sequences, roles, formations, paths, .. } = *self;
        Parts { variables, moves, sequences, roles, formations, paths }
    }
}

/// The texts and trees of the scenario and its included files.
#[derive(Debug, Default)]
pub(crate) struct Documents<'a> {
    pub(crate) sources: Vec<Cow<'a, Source>>,
    pub(crate) nodes: Vec<Node>,
    /// The name by which each file is included; empty for the scenario itself.
    pub(super) names: Vec<String>,
    /// For each file, the place of its plain include, which has no name and parameters; `None` if there is no such include.
    pub(super) plain: Vec<Option<Place>>,
}

/// Reads a scenario and all files that it includes, directly or indirectly. Each file is read only once.
pub(super) fn documents<'a>(source: &'a Source, files: &dyn Files) -> Result<Documents<'a>, Vec<Finding>> {
    let parse = |source: &Source| {
        let mut node = node::parse(source)?;
        node.compose();
        Ok(node)
    };
    let root = parse(source).map_err(|finding| vec![finding])?;
    let mut documents = Documents {
        sources: vec![Cow::Borrowed(source)],
        nodes: vec![root],
        names: vec![String::new()],
        plain: vec![Some(Place::default())],
    };
    let mut findings = foreign_tags(source);
    let mut next = 0;
    while next < documents.nodes.len() {
        for Included { file: name, place, is_plain } in includes::named(&documents.nodes[next], next) {
            let plain = is_plain.then(|| place.clone());
            if let Some(index) = documents.names.iter().position(|known| *known == name) {
                documents.plain[index] = documents.plain[index].take().or(plain);
                continue;
            }
            if documents.names.len() > INCLUDES_MAX {
                continue;
            }
            let read = files.read(&name).and_then(|source| match parse(&source) {
                Ok(node) => Ok((source, node)),
                Err(finding) => Err(conceal(finding, &source, IncludedKeys::NAMES)),
            });
            if let Ok((_, node)) = &read
                && let Some((message, hint)) = not_to_include(node, IncludedKeys::NAMES)
            {
                let mut reader = Reader::default();
                let expected =
                    "a file with `moves`, `variables` and other keys that can be shared by scenarios";
                reader.add(Code::Include, place, message, expected, Some(hint.to_owned()));
                findings.extend(locate(&documents.sources, reader.found));
                continue;
            }
            match read {
                Ok((source, node)) => {
                    findings.extend(foreign_tags(&source));
                    documents.names.push(name);
                    documents.plain.push(plain);
                    documents.sources.push(Cow::Owned(source));
                    documents.nodes.push(node);
                }
                Err(finding) if finding.code == Code::OutsideProject => {
                    let mut reader = Reader::default();
                    reader.add_named(place, finding);
                    findings.extend(locate(&documents.sources, reader.found));
                }
                Err(finding) if finding.code == Code::Unreadable => {
                    let mut reader = Reader::default();
                    let message = format!("cannot read `{}`: {}", shortened(&name), finding.message);
                    let hint = Some(if name.contains('*') {
                        "list each file, as in `[moves/bow.yaml, moves/wave.yaml]`".to_owned()
                    } else {
                        "the path is relative to the folder of the scenario".to_owned()
                    });
                    reader.add(Code::Include, place, message, "a readable file", hint);
                    findings.extend(locate(&documents.sources, reader.found));
                }
                Err(finding) => findings.push(finding),
            }
        }
        next += 1;
    }
    if findings.is_empty() { Ok(documents) } else { Err(findings) }
}

/// A move or a sequence as written; both are parts that cues share.
#[derive(Clone, Copy)]
pub(crate) struct Shared<'a> {
    pub(crate) file: u16,
    /// Name of the part in its own file.
    pub(crate) name: &'a str,
    pub(crate) node: &'a Node,
    /// Index of the part's copy in [`Library::copies`]; 0 if it belongs to the scenario or a plain include.
    pub(super) copy: usize,
}

/// A copy of a file that is included under a name or with parameters. The first copy is the scenario with all its plain includes.
#[derive(Default)]
pub(super) struct Copy {
    /// Prefix of the names in this copy, such as `left.`.
    pub(super) prefix: String,
    /// Parameters and variables of this copy.
    pub(super) values: Vec<Variable>,
    /// Place of the include that created this copy.
    pub(super) used: Option<Arc<Use>>,
}

/// The moves, sequences, roles, formations and paths of all files, by name. Also gives access to data files.
pub(crate) struct Library<'a> {
    pub(super) moves: HashMap<String, Shared<'a>>,
    pub(super) sequences: HashMap<String, Shared<'a>>,
    pub(super) roles: HashMap<String, Vec<Name>>,
    pub(super) formations: HashMap<String, WrittenFormation>,
    pub(super) paths: HashMap<String, WrittenPath>,
    pub(super) files: &'a dyn Files,
    pub(super) copies: Vec<Copy>,
    /// Number of variables that all files can use.
    pub(super) globals: usize,
    roster: Roster<'a>,
    used: RefCell<HashSet<(&'static str, String)>>,
    /// Sorted names of all moves; created for the first finding that lists these names.
    names: OnceCell<Vec<String>>,
}

impl<'a> Library<'a> {
    /// Registers the moves and sequences of the scenario and all plain includes. [`Self::include`] and [`Self::add`] report their errors.
    pub(super) fn new(documents: &'a Documents<'_>, files: &'a dyn Files, fleet: &'a Fleet) -> Self {
        let mut library = Self {
            moves: HashMap::new(),
            sequences: HashMap::new(),
            roles: HashMap::new(),
            formations: HashMap::new(),
            paths: HashMap::new(),
            files,
            copies: vec![Copy::default()],
            globals: 0,
            roster: Roster::new(fleet),
            used: RefCell::default(),
            names: OnceCell::new(),
        };
        for (file, (node, plain)) in (0u16..).zip(documents.nodes.iter().zip(&documents.plain)) {
            if plain.is_some() {
                library.register(node, file, 0);
            }
        }
        library
    }

    /// Registers the moves and sequences of a file under the names that they have in the copy with this index.
    pub(super) fn register(&mut self, node: &'a Node, file: u16, copy: usize) {
        let Node::Map(entries) = node else { return };
        let prefix = self.copies[copy].prefix.clone();
        for (kind, parts) in [("moves", &mut self.moves), ("sequences", &mut self.sequences)] {
            let named = entries.iter().filter(|(key, _)| key == kind).filter_map(|(_, node)| match node {
                Node::Map(parts) => Some(parts),
                _ => None,
            });
            for (name, node) in named.flatten() {
                parts.entry(format!("{prefix}{name}")).or_insert(Shared { file, name, node, copy });
            }
        }
    }

    /// Replaces names of roles by their names in the whole scenario, which have a prefix, if the included file that is being read defines
    /// them.
    pub(super) fn cast(&self, reader: &Reader, mut names: Vec<Name>) -> Vec<Name> {
        names.iter_mut().for_each(|name| self.cast_name(reader, name));
        names
    }

    pub(super) fn cast_name(&self, reader: &Reader, name: &mut Name) {
        let own = format!("{}{}", self.copies[reader.nesting.copy].prefix, name.text);
        if self.roles.contains_key(&own) {
            name.text = own;
        }
    }

    /// Replaces the name of a formation or a path by its name in the whole scenario. Names that the included file that is being read does
    /// not define remain.
    pub(super) fn form_name(&self, reader: &Reader, group: &mut Together) {
        let own = |name: &str| format!("{}{name}", self.copies[reader.nesting.copy].prefix);
        let named = match &mut group.action {
            Action::Form(Form { to: Target::Formation(name), .. }) => {
                Some((self.formations.contains_key(&own(name)), name))
            }
            Action::Sweep(Sweep { along: Some(Course { path, .. }), .. }) => {
                Some((self.paths.contains_key(&own(path)), path))
            }
            Action::Form(_) | Action::Sweep(_) => None,
        };
        if let Some((true, name)) = named {
            *name = own(name);
        }
    }

    /// Returns the robots that the names refer to. Unknown names are skipped.
    pub(super) fn robots(&self, names: &[Name]) -> Vec<usize> {
        self.roster.robots(&self.roles, names)
    }

    /// Returns the fleet, formations and paths, on which group movements depend.
    pub(super) fn ground(&self) -> Ground<'_> {
        Ground { fleet: self.roster.fleet, formations: &self.formations, paths: &self.paths }
    }

    /// Adds the contents of a plain included file.
    pub(super) fn include(&mut self, reader: &mut Reader, node: &Node, file: u16, name: &str, place: &Place) {
        let at = At::document(node, file);
        let Some(keys) = reader.keys::<IncludedKeys<'_>>(&at, "an included file") else { return };
        if let Some(at) = keys.include {
            includes::check(reader, &at);
        }
        includes::set_defaults(reader, keys.parameters, name, place);
        self.add_from(reader, &keys.parts(), file, 0);
    }

    /// Adds the contents of the scenario's own file.
    pub(super) fn add(&mut self, reader: &mut Reader, include: Option<At<'_>>, parts: &Parts<'_>) {
        if let Some(at) = include {
            includes::check(reader, &at);
        }
        self.add_from(reader, parts, 0, 0);
    }

    pub(super) fn add_from(&mut self, reader: &mut Reader, parts: &Parts<'_>, file: u16, copy: usize) {
        let Parts { variables, moves, sequences, roles, formations, paths } = *parts;
        if let Some(at) = variables {
            let entries = reader.entries(&at, "a map from each variable to its value");
            reader.later = entries.iter().map(|(name, _)| (*name).to_owned()).collect();
            for (name, at) in entries {
                let name = plain_name(reader, &at, name, "variable");
                let value = scalar(reader, &at).unwrap_or(Node::Null);
                reader.scope.set(name, value);
                reader.later.remove(name);
            }
        }
        let parts = [
            (moves, &self.moves, "move", "a map from each move to its parameters and tracks"),
            (sequences, &self.sequences, "sequence", "a map from each sequence to its parameters and cues"),
        ];
        let prefix = &self.copies[copy].prefix;
        for (at, known, kind, what) in parts {
            let Some(at) = at else { continue };
            for (name, at) in reader.entries(&at, what) {
                let known = known.get(&format!("{prefix}{name}"));
                if known.is_some_and(|known| (known.file, known.copy) != (file, copy)) {
                    twice(reader, &at, kind, name);
                }
            }
        }
        if let Some(at) = roles {
            for (name, at) in reader.entries(&at, "a map from each role to its robots") {
                let robots = super::cue::robot_names(reader, &at);
                let name = format!("{}{name}", self.copies[copy].prefix);
                self.roster.check_role(reader, &at, &name);
                if self.roles.insert(name.clone(), robots).is_some() {
                    twice(reader, &at, "role", &name);
                }
            }
        }
        if let Some(at) = formations {
            for (name, at) in reader.entries(&at, "a map from each formation to its places") {
                let formation = formations::read(reader, self.files, name, &at);
                let name = format!("{}{name}", self.copies[copy].prefix);
                if self.formations.insert(name.clone(), formation).is_some() {
                    twice(reader, &at, "formation", &name);
                }
            }
        }
        if let Some(at) = paths {
            for (name, at) in reader.entries(&at, "a map from each path to its points") {
                let path = paths::read(reader, name, &at);
                let name = format!("{}{name}", self.copies[copy].prefix);
                if self.paths.insert(name.clone(), path).is_some() {
                    twice(reader, &at, "path", &name);
                }
            }
        }
    }

    /// Returns the move with the name `name`. Reports the name if there is no such move.
    pub(super) fn get(&self, reader: &mut Reader, at: &At<'_>, name: &str) -> Option<Used<'a>> {
        let found = self.find("move", reader, name);
        // A wrong value of `moves` as a whole is already reported.
        if found.is_none() && !reader.is_wrong("moves") {
            let known = || self.names.get_or_init(|| sorted(&self.moves)).iter().map(String::as_str);
            let none = || known().next().is_none().then(|| "define it under `moves`".to_owned());
            let other = || {
                let is_sequence = self.sequences.contains_key(name);
                is_sequence.then(|| format!("it is a sequence: write `sequence: {}`", shortened(name)))
            };
            let called = || {
                let (called, _) = name.split_once('(')?;
                let is_known = known().any(|known| known == called.trim());
                is_known
                    .then(|| format!("write `move: {}`, and its values under `parameters`", called.trim()))
            };
            let hint = other().or_else(none).or_else(called).or_else(|| within_file(name, known()));
            let hint = hint.or_else(|| reader.did_you_mean(name, known()));
            let message = format!("no move `{}`", shortened(name));
            reader.add(Code::UnknownMove, at.place(), message, one_defined("move", known()), hint);
        }
        found.map(|(name, part)| Used { kind: "move", name, part, place: at.place() })
    }

    /// Returns the sequence with the name `name`. Reports the name if there is no such sequence.
    pub(super) fn sequence(&self, reader: &mut Reader, at: &At<'_>, name: &str) -> Option<Used<'a>> {
        let found = self.find("sequence", reader, name);
        if found.is_none() && !reader.is_wrong("sequences") {
            let known = sorted(&self.sequences);
            let known = || known.iter().map(String::as_str);
            let hint = reader.did_you_mean(name, known());
            let message = format!("no sequence `{}`", shortened(name));
            reader.add(Code::UnknownSequence, at.place(), message, one_defined("sequence", known()), hint);
        }
        found.map(|(name, part)| Used { kind: "sequence", name, part, place: at.place() })
    }

    /// Searches for a move or a sequence, first in the included file that is being read, then among all names. Marks it as used.
    fn find(&self, kind: &'static str, reader: &Reader, name: &str) -> Option<(String, Shared<'a>)> {
        let parts = self.parts(kind);
        let own = format!("{}{name}", self.copies[reader.nesting.copy].prefix);
        let name = if parts.contains_key(&own) { own } else { name.to_owned() };
        let part = *parts.get(&name)?;
        self.used.borrow_mut().insert((kind, name.clone()));
        Some((name, part))
    }

    /// Returns all moves and sequences that cues can use, each with its kind, name and definition.
    pub(crate) fn offered(&self) -> impl Iterator<Item = (&'static str, String, Shared<'a>)> {
        let of =
            |kind: &'static str| self.parts(kind).iter().map(move |(name, part)| (kind, name.clone(), *part));
        of("move").chain(of("sequence"))
    }

    fn parts(&self, kind: &str) -> &HashMap<String, Shared<'a>> {
        if kind == "move" { &self.moves } else { &self.sequences }
    }
}

fn sorted(parts: &HashMap<String, Shared<'_>>) -> Vec<String> {
    let mut names: Vec<_> = parts.keys().cloned().collect();
    names.sort_unstable();
    names
}

impl Library<'_> {
    /// Returns the names of moves or sequences that no cue uses. They are read separately, so that their errors are reported as well.
    pub(super) fn unused(&self, kind: &'static str) -> Vec<String> {
        let used = self.used.borrow();
        let names = self.parts(kind).keys().cloned();
        let mut unused: Vec<_> = names.filter(|name| !used.contains(&(kind, name.clone()))).collect();
        unused.sort_unstable();
        unused
    }
}

fn twice(reader: &mut Reader, at: &At<'_>, what: &str, name: &str) {
    let message = format!("duplicate {what} `{}`: two files define it", shortened(name));
    let hint = Some("rename one of them".to_owned());
    reader.add(Code::NameTwice, at.key_place(), message, format!("each {what} once"), hint);
}

/// Returns the name of a variable or a parameter that is being defined, without a `$`. Reports a `$`, because only uses of the name have
/// it.
pub(super) fn plain_name<'n>(reader: &mut Reader, at: &At<'_>, name: &'n str, what: &str) -> &'n str {
    let Some(plain) = name.strip_prefix('$') else { return name };
    let message = format!("unexpected `$` in the definition of the {what} `{}`", shortened(name));
    let hint =
        Some(format!("write `{}:` here, and `{}` where it is used", shortened(plain), shortened(name)));
    reader.add(Code::UnknownKey, at.key_place(), message, "a name", hint);
    plain
}

/// Reads a number, a text or a truth value.
pub(super) fn scalar(reader: &mut Reader, at: &At<'_>) -> Option<Node> {
    if is_spread(at.node) {
        return reader.spread(at).map(Node::Text);
    }
    match reader.defined(at)? {
        node @ (Node::Number(_) | Node::Text(_) | Node::Bool(_)) => Some(node),
        _ => {
            reader.wrong_type(at, "a number, a time or a word");
            None
        }
    }
}

/// Reads the tempo and the time signature, which apply to everything that is read afterwards.
pub(super) fn music(reader: &mut Reader, tempo: Option<At<'_>>, signature: Option<At<'_>>) {
    let beats_a_bar = signature.and_then(|at| read_signature(reader, &at)).unwrap_or(4);
    let Some(at) = tempo else { return };
    let sections = match at.node {
        Node::List(_) => tempo_list(reader, &at, beats_a_bar),
        _ => bpm(reader, &at)
            .map(|beats_a_minute| vec![Section { bar: 0, beats_a_minute, beats_a_bar }])
            .unwrap_or_default(),
    };
    if sections.is_empty() {
        reader.tempo_is_wrong = true;
    } else {
        reader.music.tempo = Some(Arc::new(Tempo::new(&sections)));
    }
}

keys! {
    /// A tempo that applies from a bar on.
    pub(super) struct TempoKeys {
        /// The beginning of a bar, such as `bar 9`.
        #[required]
        at: schema!({"type": "string", "pattern": "^\\s*bar\\s+\\d+(\\s+beat\\s+1)?\\s*$"}),
        /// Beats per minute.
        #[required]
        bpm: kinds::NUMBER,
        signature: kinds::SIGNATURE,
    }
}

fn tempo_list(reader: &mut Reader, at: &At<'_>, mut beats_a_bar: u8) -> Vec<Section> {
    let mut sections: Vec<Section> = Vec::new();
    for item in reader.list(at, "a list of tempos such as {at: bar 1, bpm: 120}") {
        let Some(TempoKeys { at: place, bpm: tempo, signature }) = reader.keys(&item, "a tempo") else {
            continue;
        };
        beats_a_bar = signature.and_then(|at| read_signature(reader, &at)).unwrap_or(beats_a_bar);
        let bar = place.and_then(|at| whole_bar(reader, &at));
        let beats_a_minute = tempo.and_then(|at| bpm(reader, &at));
        let (Some(bar), Some(beats_a_minute)) = (bar, beats_a_minute) else { continue };
        let least = sections.last().map_or(0, |last| last.bar + 1);
        if bar < least || (sections.is_empty() && bar > 0) {
            let message = format!("a tempo at bar {}", bar + 1);
            let expected = if sections.is_empty() {
                "the first tempo at bar 1".to_owned()
            } else {
                format!("bar {} or later", least + 1)
            };
            let place = place.map_or_else(|| item.place(), |at| at.place());
            reader.add(Code::TimeOrder, place, message, expected, None);
            continue;
        }
        sections.push(Section { bar, beats_a_minute, beats_a_bar });
    }
    sections
}

fn whole_bar(reader: &mut Reader, at: &At<'_>) -> Option<u32> {
    let expected = "the beginning of a bar, such as `bar 9`";
    let text = reader.text(at, expected)?;
    let found = position(&text).filter(|(_, beat)| *beat == Fraction::ZERO).map(|(bar, _)| bar);
    if found.is_none() {
        let message = format!("`{}` is not the beginning of a bar", shortened(&text));
        reader.add(Code::BadDuration, at.place(), message, expected, None);
    }
    found
}

fn bpm(reader: &mut Reader, at: &At<'_>) -> Option<Fraction> {
    let expected = "beats per minute, from 1 to 10000";
    let value = reader.positive(at, expected)?;
    if (1.0..=10_000.0).contains(&value) {
        return Some(fraction(value));
    }
    reader.add(Code::WrongType, at.place(), format!("a tempo of {value}"), expected, None);
    None
}

/// Reads a time signature such as `3/4`, and returns its beats per bar.
fn read_signature(reader: &mut Reader, at: &At<'_>) -> Option<u8> {
    let expected = "a time signature such as 3/4";
    let text = reader.text(at, expected)?;
    let parsed = text.split_once('/').and_then(|(beats, unit)| {
        let beats = beats.trim().parse::<u8>().ok().filter(|beats| *beats > 0)?;
        unit.trim().parse::<u8>().ok().filter(|unit| unit.is_power_of_two())?;
        Some(beats)
    });
    if parsed.is_none() {
        let message = format!("`{}` is not a time signature", shortened(&text));
        let two = text.split_once(['-', ':']).or_else(|| text.split_once(" by "));
        let two = two.map(|(beats, unit)| (beats.trim(), unit.trim()));
        let hint = two.filter(|(beats, unit)| [beats, unit].iter().all(|part| part.parse::<u8>().is_ok()));
        let hint = hint.map(|(beats, unit)| format!("write `{beats}/{unit}`"));
        reader.add(Code::UnknownWord, at.place(), message, expected, hint);
    }
    parsed
}
