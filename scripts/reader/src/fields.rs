//! Reads a YAML tree key by key, and collects all findings. Variables are replaced by their values where they are used.

mod across;
mod cut;
mod expressions;
pub mod keys;
pub mod kinds;
mod nesting;
mod scalars;

use std::cell::Cell;
use std::collections::{HashMap, HashSet};

use self::keys::Keys;
use crate::scope::Scope;
use crate::slips::{self, Units};
use cut::{cut_in_brackets, decimal_comma, numbers_alone};
use downbeat_motion::exact::{Beginning, Exact};
use downbeat_motion::music::{Music, NoMusicalLength};
pub use downbeat_yaml::at::At;
use downbeat_yaml::budget::{Budget, COMPARISONS_MAX, EVALUATIONS_MAX, FINDINGS_MAX, KNOTS_MAX};
use downbeat_yaml::finding::{
    Affected, Code, Finding, PathStep, Pending, Place, Severity, SharedFault, did_you_mean_this, names,
    nearest, one_of,
};
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::syntax;
use expressions::Robots;
use nesting::Nesting;

pub use across::{Across, Axis, By, Group, Standing, Whereabouts, is_spread, parts};
pub(crate) use across::{BY_WORDS, DIRECTION_WORDS, SpreadKeys};
pub use expressions::Robot;
pub use expressions::tried;
pub use nesting::{Name, Unset};

/// Reads the values of a YAML tree. It holds the findings so far, the variables in scope, and the tempo.
pub struct Reader {
    /// The findings so far.
    pub found: Vec<Pending>,
    /// The variables in scope.
    pub scope: Scope,
    /// The tempo and the start of the cue that is being read, which convert bars and beats to times.
    pub music: Music,
    /// Budget for the knots (points of curves) in the movements of all cues.
    pub knots: Budget,
    /// The parameters of moves that have no value in the movement that is being read.
    pub unset: Vec<Unset>,
    /// Budget for the steps in which expressions are evaluated.
    pub evaluations: Budget,
    /// The robot whose movement is being read, if any, and the results that depend on it.
    pub robots: Robots,
    /// The robots of the cue that is being read.
    pub group: Group,
    /// The moves and sequences that are being read, nested in one another.
    pub nesting: Nesting,
    /// The time from which the times of cues count, if it is known. It is the start of the act, or of the sequence that is being read.
    pub origin: Beginning,
    /// The devices of the fleet and their units, for hints.
    pub units: Units,
    /// The names of all keys that a cue may have, for hints about unknown keys.
    pub cue_keys: &'static [&'static str],
    /// Whether the tempo is wrong and has been reported, so that times in beats need no further finding.
    pub tempo_is_wrong: bool,
    /// For each file, the first time in bars or beats that lacks a tempo. The value is the index of its finding, its message, and the
    /// places of all such times.
    without_tempo: HashMap<u16, (usize, String, HashSet<String>)>,
    /// Places that are already reported as wrong: values that a comma cut in two, and misspelt keys that are read as the suggested key.
    wrong: Vec<Place>,
    /// The names of variables that are defined below the place that is being read.
    pub later: HashSet<String>,
    /// For the name of each cue, the name of its act.
    pub act_of: HashMap<String, String>,
    /// The number of names that may still be compared to find hints for misspelt names.
    comparisons: Cell<usize>,
    /// Counts of the errors and of the warnings.
    told: [SeverityCounts; 2],
    /// Errors that are reported only if there are no other errors. Otherwise another error is their probable cause.
    follow_ups: Vec<Pending>,
    /// The indices of findings that further faults with the same code and cause join.
    alike: HashMap<(Code, String), usize>,
    /// The number of errors that were joined to earlier findings instead of being reported separately.
    joined: usize,
}

/// Counts of the findings of one severity.
#[derive(Clone, Copy, Default)]
struct SeverityCounts {
    count: usize,
    /// The index in [`Reader::found`] of the last finding that is reported.
    last: usize,
    /// Number of findings beyond the maximum, which are not reported.
    more: usize,
}

/// A state of the reader's findings that [`Reader::forget`] can restore.
pub struct FindingsMark {
    found: usize,
    told: [SeverityCounts; 2],
    unset: usize,
}

impl Default for Reader {
    fn default() -> Self {
        Self {
            found: Vec::new(),
            scope: Scope::default(),
            music: Music::default(),
            knots: Budget::new(KNOTS_MAX),
            unset: Vec::new(),
            evaluations: Budget::new(EVALUATIONS_MAX),
            robots: Robots::default(),
            group: Group::default(),
            nesting: Nesting::default(),
            origin: Beginning(Some(Exact::ZERO)),
            units: Units::default(),
            cue_keys: &[],
            tempo_is_wrong: false,
            without_tempo: HashMap::new(),
            wrong: Vec::new(),
            later: HashSet::new(),
            act_of: HashMap::new(),
            comparisons: Cell::new(COMPARISONS_MAX),
            told: [SeverityCounts::default(); 2],
            follow_ups: Vec::new(),
            alike: HashMap::new(),
            joined: 0,
        }
    }
}

impl Reader {
    /// Adds a finding, unless its place is already reported as wrong.
    pub fn add(
        &mut self,
        code: Code,
        place: Place,
        message: impl Into<String>,
        expected: impl Into<String>,
        hint: Option<String>,
    ) {
        let is_here =
            |wrong: &Place| wrong.file == place.file && wrong.path == place.path && wrong.key == place.key;
        if self.wrong.iter().any(is_here) {
            return;
        }
        let message = message.into();
        let is_without_tempo =
            code == Code::Music && hint.as_deref() == Some(NoMusicalLength::WithoutTempo.hint());
        if is_without_tempo && !self.is_first_without_tempo(&place, &message) {
            return;
        }
        let told = &mut self.told[usize::from(code.severity() == Severity::Warning)];
        if told.count == FINDINGS_MAX {
            told.more += 1;
            return;
        }
        (told.count, told.last) = (told.count + 1, self.found.len());
        let expected = expected.into();
        self.found.push(Pending {
            code,
            place,
            message,
            expected,
            hint,
            hint_in_block: None,
            related: Vec::new(),
            affected: None,
        });
    }

    /// Whether a time in bars or beats is the first one in its file that lacks a tempo. Further such times are only counted, in the
    /// message of the first one.
    fn is_first_without_tempo(&mut self, place: &Place, message: &str) -> bool {
        if self.tempo_is_wrong {
            return false;
        }
        let next = self.found.len();
        let own = format!("{:?} {:?}", place.path, place.within);
        let (index, first, places) = self
            .without_tempo
            .entry(place.file)
            .or_insert_with(|| (next, message.to_owned(), HashSet::new()));
        let known = self.found.get_mut(*index).filter(|known| known.code == Code::Music);
        let is_new = places.insert(own);
        let Some(known) = known else {
            (*index, *first) = (next, message.to_owned());
            return true;
        };
        if is_new {
            known.message = match places.len() - 1 {
                1 => format!("{first}; 1 other time also needs a tempo"),
                others => format!("{first}; {others} other times also need a tempo"),
            };
        }
        false
    }

    /// Adds a fault of some robots. If there is already a finding with the same code and cause, the robots are added to that finding.
    pub fn add_shared(&mut self, fault: SharedFault) {
        let key = (fault.code, fault.cause.clone());
        let known = self.alike.get(&key).and_then(|known| self.found.get_mut(*known));
        if let Some(Pending { affected: Some(affected), place, expected, hint, .. }) = known {
            self.joined += usize::from(fault.code.severity() == Severity::Error);
            if affected.add(&fault) {
                (*place, *expected, *hint) = (fault.place, fault.expected, fault.hint);
            }
            return;
        }
        let (index, affected) = (self.found.len(), Affected::by(&fault));
        self.add(fault.code, fault.place, affected.message(), fault.expected, fault.hint);
        if let Some(found) = self.found.get_mut(index) {
            found.affected = Some(Box::new(affected));
            self.alike.insert(key, index);
        }
    }

    /// Adds a finding that would otherwise be repeated for each use of an item. Only the first finding with the same code and cause is
    /// reported.
    pub fn add_once(
        &mut self,
        cause: String,
        code: Code,
        place: Place,
        message: String,
        expected: String,
        hint: Option<String>,
    ) {
        if self.has(code, &cause) {
            self.joined += usize::from(code.severity() == Severity::Error);
            return;
        }
        let index = self.found.len();
        self.add(code, place, message, expected, hint);
        if self.found.len() > index {
            self.alike.insert((code, cause), index);
        }
    }

    /// Whether a finding with this code and cause has been reported.
    pub fn has(&self, code: Code, cause: &str) -> bool {
        self.alike.contains_key(&(code, cause.to_owned()))
    }

    /// Adds `about`, a finding about another file, at the place that names that file.
    pub fn add_named(&mut self, place: Place, about: Finding) {
        let Finding { code, message, expected, hint, .. } = about;
        self.add(code, place, message, expected, hint);
    }

    /// Adds a finding that involves several places, each with its explanation. The first place is the place of the finding.
    pub fn add_related(
        &mut self,
        code: Code,
        related: Vec<(Place, String)>,
        message: String,
        expected: &str,
        hint: Option<String>,
    ) {
        let Some((place, _)) = related.first().cloned() else { return };
        let before = self.found.len();
        self.add(code, place, message, expected, hint);
        self.found.iter_mut().skip(before).for_each(|found| found.related.clone_from(&related));
    }

    /// Marks the current state of the findings, for [`Self::forget`].
    pub fn mark(&self) -> FindingsMark {
        FindingsMark { found: self.found.len(), told: self.told, unset: self.unset.len() }
    }

    /// Removes all findings that were added after the mark.
    pub fn forget(&mut self, mark: &FindingsMark) {
        self.found.truncate(mark.found);
        self.alike.retain(|_, index| *index < mark.found);
        self.unset.truncate(mark.unset);
        self.told = mark.told;
    }

    /// Removes those findings from index `before` on for whose code `keep` returns false.
    pub fn keep_from(&mut self, before: usize, keep: impl Fn(Code) -> bool) {
        let since = self.found.split_off(before.min(self.found.len()));
        self.alike.retain(|_, index| *index < before);
        self.found.extend(since.into_iter().filter(|found| keep(found.code)));
    }

    /// Adds a finding that is reported only if there are no errors. Otherwise an error is its probable cause.
    pub fn add_unless_others(&mut self, follow_up: Pending) {
        if self.follow_ups.len() < FINDINGS_MAX {
            self.follow_ups.push(follow_up);
        }
    }

    /// Returns all findings. If there may be too many errors or warnings, the last one of them states the maximum number.
    pub fn finish(mut self) -> Vec<Pending> {
        if self.found.iter().all(|found| found.code.severity() == Severity::Warning) {
            for Pending { code, place, message, expected, hint, .. } in std::mem::take(&mut self.follow_ups) {
                self.add(code, place, message, expected, hint);
            }
        }
        for found in &mut self.found {
            if let Some(affected) = found.affected.take() {
                found.message = affected.message();
            }
        }
        for told in self.told.iter().filter(|told| told.count == FINDINGS_MAX) {
            let Some(last) = self.found.get(told.last).cloned() else { continue };
            // A finding may occur once for each use of an item. Equal ones are merged later.
            let equal = |found: &&mut Pending| found.place == last.place && found.message == last.message;
            self.found.iter_mut().filter(equal).for_each(|found| {
                found
                    .message
                    .push_str(&format!(" (at most {FINDINGS_MAX} findings of this severity are shown)"))
            });
        }
        self.found
    }

    /// Returns the number of errors so far, including those that were joined to earlier findings.
    pub const fn errors(&self) -> usize {
        self.told[0].count + self.told[0].more + self.joined
    }

    /// Whether the maximum number of errors is reached, so that further errors are not reported.
    pub const fn is_full(&self) -> bool {
        self.told[0].count == FINDINGS_MAX
    }

    /// Returns a hint with the known name that is most similar to `wrong`. `None` if no name is similar enough, or if too many names have
    /// been compared.
    pub fn did_you_mean<'a>(&self, wrong: &str, known: impl IntoIterator<Item = &'a str>) -> Option<String> {
        let mut left = self.comparisons.get();
        let hint = nearest(wrong, known, &mut left);
        self.comparisons.set(left);
        hint
    }

    /// Adds a finding for a node of the wrong type.
    pub fn wrong_type(&mut self, at: &At<'_>, expected: &str) {
        self.wrong_value(at, at.node, expected);
    }

    /// Like [`Self::wrong_type`], but for `value`, to which the node refers by name. If that name is a parameter of a move or a sequence,
    /// the finding is at the place that assigns the parameter.
    fn wrong_value(&mut self, at: &At<'_>, value: &Node, expected: &str) {
        if self.is_template(at, expected) {
            return;
        }
        let hint = slips::value(&self.scope, &self.units, &at.place(), value, expected);
        let place = self.given_at(at).map_or_else(|| at.place(), |given| Place::clone(&given));
        let in_block = slips::in_block(value, expected).map(str::to_owned);
        self.add_styled(place, format!("found {}", value.kind()), expected, [hint, in_block]);
    }

    /// Adds a finding about a value of the wrong type. The first hint is for values in brackets; the second one, if any, is for values in
    /// block style (without brackets).
    pub fn add_styled(
        &mut self,
        place: Place,
        message: String,
        expected: &str,
        [hint, in_block]: [Option<String>; 2],
    ) {
        let before = self.found.len();
        self.add(Code::WrongType, place, message, expected, hint);
        if let Some(found) = self.found.get_mut(before) {
            found.hint_in_block = in_block;
        }
    }

    /// Whether a node contains braces of a template language, such as `{{ x }}`. Adds a finding if it does.
    pub fn is_template(&mut self, at: &At<'_>, expected: &str) -> bool {
        let Some(inner) = slips::template(at.node) else { return false };
        let message = format!("braces around `{}`", shortened(&inner));
        let hint = Some(if is_scalar(expected) {
            format!("write `{}`, without braces", shortened(&slips::bare(&self.scope, &inner)))
        } else {
            "variables can only replace numbers, times and names: write everything else out in full"
                .to_owned()
        });
        self.add(Code::WrongType, at.place(), message, expected, hint);
        true
    }

    /// Reads the keys that `K` declares for a map. Adds findings for unknown, duplicate and missing keys. `what` is the name of the map
    /// in messages.
    pub fn keys<'a, K: Keys<'a>>(&mut self, at: &'a At<'a>, what: &str) -> Option<K> {
        self.values(at, what, K::NAMES, K::REQUIRED).map(K::of)
    }

    /// Returns the values of the known keys of a map, in the order of `known`; `None` for each missing key.
    fn values<'a>(
        &mut self,
        at: &'a At<'a>,
        what: &str,
        known: &[&'static str],
        required: &[bool],
    ) -> Option<Vec<Option<At<'a>>>> {
        let Node::Map(entries) = at.node else {
            self.wrong_type(at, &format!("{what}: a map with {}", names(known.iter().copied())));
            return None;
        };
        if self.is_template(at, &format!("{what}: a map with {}", names(known.iter().copied()))) {
            return None;
        }
        crate::known::keys(at, known);
        let mut values: Vec<Option<At<'a>>> = vec![None; known.len()];
        let mut meant = values.clone();
        let (mut open, mut skipped) = (None, 0);
        for (index, (key, node)) in entries.iter().enumerate() {
            let before = index.checked_sub(1).map(|before| &entries[before]);
            if index < skipped {
                continue;
            }
            if let Some((key, whole)) = before.and_then(|before| decimal_comma(before, key, node)) {
                let others: Vec<&str> = numbers_alone(&entries[index..]);
                skipped = index + others.len();
                self.report_decimal_comma(at, key, &whole, &others);
                continue;
            }
            if open.is_some() || before.is_some_and(|before| cut_in_brackets(before, node).is_some()) {
                let begun = before.and_then(|before| cut_in_brackets(before, node));
                if let (None, Some((key, text))) = (open, begun) {
                    self.cut_in_brackets(at, key, text);
                }
                open = open.or(begun).filter(|_| !key.contains(')'));
                continue;
            }
            match known.iter().position(|name| name == key) {
                Some(index) if values[index].is_none() => values[index] = Some(at.entry(key, 0, node)),
                Some(index) => self.duplicate(&at.entry(known[index], 1, node), key),
                None if self.is_full() => self.told[0].more += 1,
                None => {
                    let hint = match key.as_str() {
                        "<<" => Some("merge keys are not supported: write the keys out in full".to_owned()),
                        _ if syntax::without_space(key, known).is_some() => syntax::without_space(key, known),
                        _ => syntax::without_colon(key, known)
                            .filter(|_| *node == Node::Null)
                            .or_else(|| slips::key(&self.units, what, key, node))
                            .or_else(|| self.did_you_mean(key, known.iter().copied()))
                            .or_else(|| slips::word_of(key, known.iter().copied()))
                            .or_else(|| slips::parameter(what, key, node, entries, self.cue_keys)),
                    };
                    // A misspelt key is read as the key that its hint names, so that no key seems to be missing.
                    let named = |name: &&str| hint.as_ref() == Some(&did_you_mean_this(name));
                    if let Some(index) = known.iter().position(named) {
                        meant[index] = Some(at.entry(key, 0, node));
                    }
                    let message = format!("unknown key `{}` in {what}", shortened(key));
                    let place = at.entry(key, 0, node).key_place();
                    let is_read = known.iter().any(named);
                    self.add(Code::UnknownKey, place.clone(), message, one_of(known.iter().copied()), hint);
                    if is_read && !self.is_full() {
                        self.wrong.extend([Place { key: false, ..place.clone() }, place]);
                    }
                }
            }
        }
        for (value, meant) in values.iter_mut().zip(meant) {
            *value = value.or(meant);
        }
        for ((key, value), _) in known.iter().zip(&values).zip(required).filter(|(_, required)| **required) {
            if value.is_none() && !self.is_miswritten(at, key) {
                let message = match (what, *key) {
                    ("the scenario", "scenario") => "the scenario has no name".to_owned(),
                    _ => format!("{what} has no `{key}`"),
                };
                let hint = slips::missing(what, key).map(str::to_owned);
                self.add(Code::MissingKey, at.place(), message, format!("a key `{key}`"), hint);
            }
        }
        Some(values)
    }

    /// Whether `part`, a top-level key, is misspelt or its value has the wrong type, so that its contents are unknown.
    pub fn is_wrong(&self, part: &str) -> bool {
        let meant = did_you_mean_this(part);
        self.found.iter().any(|found| match (found.code, found.place.path.as_slice()) {
            (Code::WrongType, [PathStep::Key(key, _)]) => key == part,
            (Code::UnknownKey, [_]) => found.hint.as_ref() == Some(&meant),
            _ => false,
        })
    }

    /// Whether a finding about an unknown key of this map already suggests `key`.
    pub fn is_miswritten(&self, at: &At<'_>, key: &str) -> bool {
        let meant = [did_you_mean_this(key), format!("`{key}`"), format!("`{key}:")];
        let place = at.place();
        let is_here = |found: &Pending| {
            let parent = found.place.path.split_last().map(|(_, parent)| parent);
            found.place.file == place.file && parent == Some(&place.path)
        };
        let hints = self.found.iter().filter(|found| found.code == Code::UnknownKey && is_here(found));
        hints
            .filter_map(|found| found.hint.as_ref())
            .any(|hint| meant.iter().any(|meant| hint.contains(meant)))
    }

    /// Returns the entries of a map whose keys are names that the user chooses. Adds a finding for each duplicate key. `expected`
    /// describes the map: `a map from each role to its robots`.
    pub fn entries<'a>(&mut self, at: &'a At<'a>, expected: &str) -> Vec<(&'a str, At<'a>)> {
        let Node::Map(entries) = at.node else {
            self.wrong_type(at, expected);
            return Vec::new();
        };
        if self.is_template(at, expected) {
            return Vec::new();
        }
        let mut seen = std::collections::HashSet::new();
        let mut unique = Vec::with_capacity(entries.len());
        for (key, node) in entries {
            if seen.insert(key.as_str()) {
                unique.push((key.as_str(), at.entry(key, 0, node)))
            } else {
                self.duplicate(&at.entry(key, 1, node), key)
            }
        }
        unique
    }

    fn duplicate(&mut self, at: &At<'_>, key: &str) {
        let hint = Some("keep only one of them".to_owned());
        let message = format!("duplicate key `{}` in this map", shortened(key));
        self.add(Code::DuplicateKey, at.key_place(), message, "unique keys", hint);
    }

    /// Returns the items of a list. If the node is not a list, adds a finding and returns no items.
    pub fn list<'a>(&mut self, at: &'a At<'a>, expected: &str) -> Vec<At<'a>> {
        match at.node {
            Node::List(items) => items.iter().enumerate().map(|(i, node)| at.item(i, node)).collect(),
            _ => {
                self.wrong_type(at, expected);
                Vec::new()
            }
        }
    }
}

/// Whether a variable may replace the value that `expected` describes: no list and no map.
fn is_scalar(expected: &str) -> bool {
    !expected.starts_with("a list") && !expected.contains("a map")
}
