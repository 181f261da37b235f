//! Reading a tree key by key, collecting every finding on the way. Variables are put in where they are used.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

pub(crate) use crate::at::At;
use crate::budget::{Budget, COMPARISONS_MAX, EVALUATIONS_MAX, FINDINGS_MAX, KNOTS_MAX, longest};
use crate::duration;
use crate::exact::{Beginning, Exact, Laps};
use crate::expression::{self, Robots};
use crate::finding::{
    Code, Finding, Part, Pending, Place, Severity, did_you_mean_this, names, nearest, one_of,
};
use crate::music::{Music, Unmusical};
use crate::node::{Node, shortened};
use crate::scenario::{Group, Nesting, Unset, is_spread};
use crate::scope::Scope;
use crate::shared_fault::{Affected, SharedFault};
use crate::slips::{self, Units};
use crate::syntax;
use urrcp::Span;

/// Reads values; keeps what has been found so far, the variables in force, and how long a beat is.
pub(crate) struct Reader {
    pub(crate) found: Vec<Pending>,
    pub(crate) scope: Scope,
    pub(crate) music: Music,
    /// For the movements of all cues.
    pub(crate) knots: Budget,
    /// Parameters without a value in the movement that is being read.
    pub(crate) unset: Vec<Unset>,
    /// For expressions.
    pub(crate) evaluations: Budget,
    /// Whose movement is being read.
    pub(crate) robots: Robots,
    /// The robots of its cue.
    pub(crate) group: Group,
    /// Which moves and sequences are being read, one within another.
    pub(crate) nesting: Nesting,
    /// Where the times of cues count from, as far as that is known.
    pub(crate) origin: Beginning,
    /// The devices of the fleet.
    pub(crate) units: Units,
    /// Whether there is a tempo that cannot be read, which is reported already.
    pub(crate) tempo_is_wrong: bool,
    /// The first time without a tempo in each file, by its finding, and all their places.
    without_tempo: HashMap<u16, (usize, String, HashSet<String>)>,
    /// Values that a decimal comma cut in two, of which that is told already.
    cut: Vec<Place>,
    /// Comparisons of names that are left.
    comparisons: Cell<usize>,
    /// By severity.
    told: [Told; 2],
    /// What is an error only if there is no other: otherwise one of the others is its cause.
    follow_ups: Vec<Pending>,
    /// Which findings others of one cause join.
    alike: HashMap<(Code, String), usize>,
    /// Errors that have joined others.
    joined: usize,
}

/// Findings of one severity.
#[derive(Clone, Copy, Default)]
struct Told {
    count: usize,
    /// The last one that is reported.
    last: usize,
    more: usize,
}

/// How many findings there were at some time.
pub(crate) struct FindingsMark {
    found: usize,
    told: [Told; 2],
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
            tempo_is_wrong: false,
            without_tempo: HashMap::new(),
            cut: Vec::new(),
            comparisons: Cell::new(COMPARISONS_MAX),
            told: [Told::default(); 2],
            follow_ups: Vec::new(),
            alike: HashMap::new(),
            joined: 0,
        }
    }
}

impl Reader {
    pub(crate) fn add(
        &mut self,
        code: Code,
        place: Place,
        message: impl Into<String>,
        expected: impl Into<String>,
        hint: Option<String>,
    ) {
        if self.cut.iter().any(|cut| cut.file == place.file && cut.path == place.path && cut.key == place.key)
        {
            return;
        }
        let message = message.into();
        let is_without_tempo = code == Code::Music && hint.as_deref() == Some(Unmusical::WithoutTempo.hint());
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

    /// Whether a time is the first of its file without a tempo; others are counted in its finding.
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
                1 => format!("{first}; 1 other time needs one, too"),
                others => format!("{first}; {others} other times need one, too"),
            };
        }
        false
    }

    /// A fault of some robots, which joins the finding of others that have it for the same reason.
    pub(crate) fn add_shared(&mut self, fault: SharedFault) {
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

    /// Adds a finding that each use of something would repeat. Only the first one is reported.
    pub(crate) fn add_once(
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

    /// Whether a finding with this cause has been reported.
    pub(crate) fn has(&self, code: Code, cause: &str) -> bool {
        self.alike.contains_key(&(code, cause.to_owned()))
    }

    /// A finding about a file, at the place at which the file is named.
    pub(crate) fn add_named(&mut self, place: Place, about: Finding) {
        let Finding { code, message, expected, hint, .. } = about;
        self.add(code, place, message, expected, hint);
    }

    /// A finding that several places make together, each with what it says; the first one is where the finding stands.
    pub(crate) fn add_related(
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

    /// How far the findings have come, for [`Self::forget`].
    pub(crate) fn mark(&self) -> FindingsMark {
        FindingsMark { found: self.found.len(), told: self.told, unset: self.unset.len() }
    }

    /// Takes back every finding after the mark.
    pub(crate) fn forget(&mut self, mark: &FindingsMark) {
        self.found.truncate(mark.found);
        self.alike.retain(|_, index| *index < mark.found);
        self.unset.truncate(mark.unset);
        self.told = mark.told;
    }

    /// Takes back some of the findings because there were too many.
    pub(crate) fn keep_from(&mut self, before: usize, keep: impl Fn(Code) -> bool) {
        let since = self.found.split_off(before.min(self.found.len()));
        self.alike.retain(|_, index| *index < before);
        self.found.extend(since.into_iter().filter(|found| keep(found.code)));
    }

    /// A finding that is kept back if anything else is wrong.
    pub(crate) fn add_unless_others(&mut self, follow_up: Pending) {
        if self.follow_ups.len() < FINDINGS_MAX {
            self.follow_ups.push(follow_up);
        }
    }

    /// Everything that is reported; the last of very many says how many more there are.
    pub(crate) fn finish(mut self) -> Vec<Pending> {
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
        for told in self.told.iter().filter(|told| told.more > 0) {
            if let Some(last) = self.found.get_mut(told.last) {
                last.message.push_str(&format!(" (and {} more findings, which are not shown)", told.more));
            }
        }
        self.found
    }

    /// How many errors there are so far, each counted by itself.
    pub(crate) const fn errors(&self) -> usize {
        self.told[0].count + self.told[0].more + self.joined
    }

    /// Whether there are so many errors already that nothing more is reported.
    pub(crate) const fn is_full(&self) -> bool {
        self.told[0].count == FINDINGS_MAX
    }

    /// The name most like a wrong one, as a hint: for as many wrong ones as can be compared in no time.
    pub(crate) fn did_you_mean<'a>(
        &self,
        wrong: &str,
        known: impl IntoIterator<Item = &'a str>,
    ) -> Option<String> {
        let mut left = self.comparisons.get();
        let hint = nearest(wrong, known, &mut left);
        self.comparisons.set(left);
        hint
    }

    pub(crate) fn wrong_type(&mut self, at: &At<'_>, expected: &str) {
        self.wrong_value(at, at.node, expected);
    }

    /// The same for a value that stands elsewhere: the parameter of a move or a sequence where it is given.
    fn wrong_value(&mut self, at: &At<'_>, value: &Node, expected: &str) {
        if self.is_template(at, expected) {
            return;
        }
        let hint = slips::value(self, &at.place(), value, expected);
        let place = self.given_at(at).map_or_else(|| at.place(), |given| Place::clone(&given));
        let in_block = slips::in_block(value, expected).map(str::to_owned);
        self.add_styled(place, format!("found {}", value.kind()), expected, [hint, in_block]);
    }

    /// Adds a finding about a value of the wrong type, with a hint for values in brackets, and one for values in lines if it
    /// differs.
    pub(crate) fn add_styled(
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

    /// Reports braces of a template language, such as `{{ x }}`. Returns whether there are any.
    pub(crate) fn is_template(&mut self, at: &At<'_>, expected: &str) -> bool {
        let Some(inner) = slips::template(at.node) else { return false };
        let message = format!("braces around `{}`", shortened(&inner));
        let hint = Some(match is_scalar(expected) {
            true => format!("write `{}`, without braces", shortened(&slips::bare(&self.scope, &inner))),
            false => "variables stand for numbers, times and names only: write the rest out".to_owned(),
        });
        self.add(Code::WrongType, at.place(), message, expected, hint);
        true
    }

    /// The value of each known key; findings for the others, for duplicates and for missing ones.
    pub(crate) fn map<'a, const N: usize>(
        &mut self,
        at: &'a At<'a>,
        what: &str,
        known: [&'static str; N],
        required: &[&str],
    ) -> Option<[Option<At<'a>>; N]> {
        let Node::Map(entries) = at.node else {
            self.wrong_type(at, &format!("{what}: a map with {}", names(known)));
            return None;
        };
        if self.is_template(at, &format!("{what}: a map with {}", names(known))) {
            return None;
        }
        #[cfg(test)]
        crate::known::keys(at, &known);
        let mut values: [Option<At<'a>>; N] = [None; N];
        let mut meant: [Option<At<'a>>; N] = [None; N];
        let (mut open, mut skipped) = (None, 0);
        for (index, (key, node)) in entries.iter().enumerate() {
            let before = index.checked_sub(1).map(|before| &entries[before]);
            if index < skipped {
                continue;
            }
            if let Some(number) = before.and_then(|before| cut_by_comma(before, key, node)) {
                let others: Vec<&str> = numbers_alone(&entries[index..]);
                skipped = index + others.len();
                self.cut_by_comma(at, number, &others);
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
                None => {
                    let hint = match key.as_str() {
                        "<<" => Some("merge keys are not supported: write the keys out".to_owned()),
                        _ if syntax::without_space(key, &known).is_some() => {
                            syntax::without_space(key, &known)
                        }
                        _ => syntax::without_colon(key, node, &known)
                            .or_else(|| slips::key(self, what, key, node))
                            .or_else(|| self.did_you_mean(key, known))
                            .or_else(|| slips::word_of(key, known))
                            .or_else(|| slips::parameter(what, key, node, entries)),
                    };
                    // A misspelt key is read as the key that its hint names, so that no key seems to be missing.
                    let named = |name: &&str| hint.as_ref() == Some(&did_you_mean_this(name));
                    if let Some(index) = known.iter().position(named) {
                        meant[index] = Some(at.entry(key, 0, node));
                    }
                    let message = format!("unknown key `{}` in {what}", shortened(key));
                    let place = at.entry(key, 0, node).key_place();
                    self.add(Code::UnknownKey, place, message, one_of(known), hint);
                }
            }
        }
        for (value, meant) in values.iter_mut().zip(meant) {
            *value = value.or(meant);
        }
        for key in required {
            let index = known.iter().position(|name| name == key)?;
            if values[index].is_none() && !self.is_miswritten(at, key) {
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

    /// Whether a part of the scenario is misspelt or of the wrong type as a whole, so that nothing in it is known.
    pub(crate) fn is_wrong(&self, part: &str) -> bool {
        let meant = did_you_mean_this(part);
        self.found.iter().any(|found| match (found.code, found.place.path.as_slice()) {
            (Code::WrongType, [Part::Key(key, _)]) => key == part,
            (Code::UnknownKey, [_]) => found.hint.as_ref() == Some(&meant),
            _ => false,
        })
    }

    /// Whether the findings say already that one of the keys here was meant to be this one.
    pub(crate) fn is_miswritten(&self, at: &At<'_>, key: &str) -> bool {
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

    /// `{at: 0,3s}` is the number 0 and a key `3s`: one fault, one finding.
    fn cut_by_comma(&mut self, at: &At<'_>, (key, whole): (&str, String), others: &[&str]) {
        let Some(rest) = others.first() else { return };
        let place = at.entry(rest, 0, &Node::Null).key_place();
        let message =
            format!("a comma ends the value of `{}`, and `{}` is left over", shortened(key), shortened(rest));
        let (expected, hint) = match others {
            [_] => ("a decimal point", format!("write a decimal point: `{whole}.{}`", shortened(rest))),
            _ => (
                "a list in brackets",
                format!("write a list: `[{whole}, {}]`", shortened(&others.join(", "))),
            ),
        };
        self.add(Code::UnknownKey, place, message, expected, Some(hint));
        self.cut.push(at.place().of_key(key));
    }

    /// `{to: max(1, 2)}` is the text `max(1` and a key `2)`: one fault, one finding.
    fn cut_in_brackets(&mut self, at: &At<'_>, key: &str, text: &str) {
        let place = at.entry(key, 0, &Node::Null).place();
        let message = format!("a comma ends the expression `{}`", shortened(text));
        let hint = Some(
            "within `{` and `[`, write an expression that has a comma in quotes: `\"max(1, 2)\"`".to_owned(),
        );
        self.add(Code::Expression, place.clone(), message, "an expression in quotes", hint);
        self.cut.push(place);
    }

    /// The entries of a map with free keys, each key once.
    pub(crate) fn entries<'a>(&mut self, at: &'a At<'a>, what: &str) -> Vec<(&'a str, At<'a>)> {
        let Node::Map(entries) = at.node else {
            self.wrong_type(at, &format!("a map from {what}"));
            return Vec::new();
        };
        if self.is_template(at, &format!("a map from {what}")) {
            return Vec::new();
        }
        let mut seen = std::collections::HashSet::new();
        let mut unique = Vec::with_capacity(entries.len());
        for (key, node) in entries {
            match seen.insert(key.as_str()) {
                true => unique.push((key.as_str(), at.entry(key, 0, node))),
                false => self.duplicate(&at.entry(key, 1, node), key),
            }
        }
        unique
    }

    fn duplicate(&mut self, at: &At<'_>, key: &str) {
        let hint = Some("keep one of them".to_owned());
        let message = format!("the key `{}` appears twice in this map", shortened(key));
        self.add(Code::DuplicateKey, at.key_place(), message, "each key once", hint);
    }

    pub(crate) fn list<'a>(&mut self, at: &'a At<'a>, expected: &str) -> Vec<At<'a>> {
        match at.node {
            Node::List(items) => items.iter().enumerate().map(|(i, node)| at.item(i, node)).collect(),
            _ => {
                self.wrong_type(at, expected);
                Vec::new()
            }
        }
    }

    /// The node itself, or the value of the variable that is there. Expressions are left as they are.
    pub(crate) fn scalar<'a>(&mut self, at: &At<'a>) -> Option<Cow<'a, Node>> {
        match at.node {
            Node::Text(text) if self.is_variable(text) => self.variable(at, text).map(Cow::Owned),
            node => Some(Cow::Borrowed(node)),
        }
    }

    /// The same where an expression has no place: whatever begins like a variable is one.
    fn plain_scalar<'a>(&mut self, at: &At<'a>) -> Option<Cow<'a, Node>> {
        match at.node {
            Node::Text(text) if text.starts_with('$') || text.starts_with("-$") => {
                self.variable(at, text).map(Cow::Owned)
            }
            node => Some(Cow::Borrowed(node)),
        }
    }

    /// Whether a text is a variable, or its negative, and nothing else.
    pub(crate) fn is_variable(&self, text: &str) -> bool {
        let Some(name) = text.strip_prefix('$').or_else(|| text.strip_prefix("-$")) else { return false };
        let is_word = !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_');
        match self.scope.get(name) {
            // A time is negated as an expression.
            Some(Node::Text(value)) if text.starts_with('-') => {
                !expression::is_one(value) && duration::parse_duration(value).is_none()
            }
            Some(_) => true,
            None => is_word && !matches!(name, "index" | "count"),
        }
    }

    /// Where the value of the parameter that stands here is given, if it is one of a move or a sequence.
    pub(crate) fn given_at(&self, at: &At<'_>) -> Option<Arc<Place>> {
        let Node::Text(text) = at.node else { return None };
        self.scope.place(text.strip_prefix('$')?).cloned()
    }

    fn variable(&mut self, at: &At<'_>, text: &str) -> Option<Node> {
        let (negated, name) = match text.strip_prefix('-') {
            Some(rest) => (true, &rest[1..]),
            None => (false, &text[1..]),
        };
        match (self.scope.get(name), negated) {
            // What is wrong with its value is told already.
            (Some(Node::Null), _) => {}
            (Some(Node::Number(value)), true) => return Some(Node::Number(-value)),
            (Some(value), false) => return Some(value.clone()),
            (Some(_), true) => {
                let message = format!("a minus needs a number, and `{}` is not a number", shortened(name));
                self.add(Code::Variable, at.place(), message, "a variable that is a number", None);
            }
            // The names as a whole have a finding already.
            (None, _) if self.is_wrong("variables") => {}
            (None, _) => {
                let (hint, expected) = match self.scope.names().next() {
                    Some(_) => (
                        self.did_you_mean(name, self.scope.names()),
                        format!("one of the variables {}", names(self.scope.names())),
                    ),
                    None => (
                        Some(format!("define it, as in `variables: {{{}: 45}}`", shortened(name))),
                        "a name under `variables`".to_owned(),
                    ),
                };
                let message = format!("no variable `{}` is known here", shortened(name));
                self.add(Code::Variable, at.place(), message, expected, hint);
            }
        }
        None
    }

    pub(crate) fn text<'a>(&mut self, at: &At<'a>, expected: &str) -> Option<Cow<'a, str>> {
        match self.plain_scalar(at)? {
            Cow::Borrowed(Node::Text(text)) => Some(Cow::Borrowed(text)),
            Cow::Owned(Node::Text(text)) => Some(Cow::Owned(text)),
            _ => {
                self.wrong_type(at, expected);
                None
            }
        }
    }

    /// A name: text, or a number that someone uses as one.
    pub(crate) fn name(&mut self, at: &At<'_>, expected: &str) -> Option<String> {
        match self.plain_scalar(at)?.as_ref() {
            Node::Number(value) => Some(value.to_string()),
            Node::Text(text) => Some(text.clone()),
            _ => {
                self.wrong_type(at, expected);
                None
            }
        }
    }

    pub(crate) fn number(&mut self, at: &At<'_>, expected: &str) -> Option<f64> {
        match self.scalar(at)?.as_ref() {
            Node::Number(value) if value.is_finite() => Some(*value),
            node if slips::template(node).is_some() => {
                self.wrong_value(at, node, expected);
                None
            }
            Node::Text(text) if expression::is_one(text) => self.number_of(at, text, expected),
            node if is_spread(node) => {
                let text = self.spread(at)?;
                self.number_of(at, &text, expected)
            }
            node => {
                self.wrong_value(at, node, expected);
                None
            }
        }
    }

    /// A number above 0.
    pub(crate) fn positive(&mut self, at: &At<'_>, expected: &str) -> Option<f64> {
        let value = self.number(at, expected)?;
        if value > 0.0 {
            return Some(value);
        }
        self.add(Code::WrongType, at.place(), format!("found the number {value}"), expected, None);
        None
    }

    /// A whole number from `least` to `most`.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked by the range")]
    pub(crate) fn count(&mut self, at: &At<'_>, least: u32, most: u32) -> Option<u32> {
        let expected = format!("a whole number from {least} to {most}");
        let value = self.number(at, &expected)?;
        if value.fract() == 0.0 && value >= f64::from(least) && value <= f64::from(most) {
            return Some(value as u32);
        }
        self.add(Code::WrongType, at.place(), format!("found the number {value}"), expected, None);
        None
    }

    pub(crate) fn truth(&mut self, at: &At<'_>) -> Option<bool> {
        match self.scalar(at)?.as_ref() {
            Node::Bool(value) => Some(*value),
            Node::Text(text) if expression::is_one(text) => self.truth_of(at, text),
            _ => {
                self.wrong_type(at, "true or false");
                None
            }
        }
    }

    /// A length of time, in seconds and their kind or in beats and bars, as it is on the clock from the cue's start on.
    pub(crate) fn duration(&mut self, at: &At<'_>) -> Option<Span> {
        self.exact(at).map(|length| self.music.start.lay(length))
    }

    /// The same before it is rounded.
    pub(crate) fn exact(&mut self, at: &At<'_>) -> Option<Exact> {
        if self.is_template(at, duration::EXPECTED) {
            return None;
        }
        let (found, hint) = match self.scalar(at)?.as_ref() {
            Node::Text(text) => return self.exact_time(at, text),
            Node::Number(value) => {
                let hint = format!("add the unit: `{value}s` or `{value}ms`");
                (format!("the time {value} has no unit"), Some(hint))
            }
            node if is_spread(node) => {
                let text = self.spread(at)?;
                return self.time_of(at, &text);
            }
            Node::Null => (
                "found nothing where a time belongs".to_owned(),
                Some("write a time, such as `0s`".to_owned()),
            ),
            other => (format!("found {} where a time belongs", other.kind()), None),
        };
        self.add(Code::BadDuration, at.place(), found, duration::EXPECTED, hint);
        None
    }

    /// So long a time again and again, from the cue's start on.
    pub(crate) fn laps(&self, length: Exact) -> Laps {
        Laps { length, from: self.music.start }
    }

    /// A length of time from a part of a text.
    pub(crate) fn time(&mut self, at: &At<'_>, text: &str) -> Option<Span> {
        self.exact_time(at, text).map(|length| self.music.start.lay(length))
    }

    /// The same before it is rounded.
    pub(crate) fn exact_time(&mut self, at: &At<'_>, text: &str) -> Option<Exact> {
        let text = text.trim();
        if let Some(name) = text.strip_prefix('$').filter(|_| self.is_variable(text)) {
            let value = self.scope.get(name).cloned();
            return match value {
                Some(node @ (Node::Text(_) | Node::Number(_))) => self.exact(&at.with(&node)),
                _ => self.variable(at, text).and(None),
            };
        }
        if let Some(span) = duration::parse_duration(text) {
            return Some(span.into());
        }
        match self.music.span(text) {
            Some(Ok(length)) => return self.no_longer(at, text, length),
            Some(Err(why)) => {
                let expected = "a `tempo`, and a fixed start where it changes";
                self.add(Code::Music, at.place(), why.message(text), expected, Some(why.hint().to_owned()));
            }
            None if expression::is_one(text) && !text.starts_with("-.") => return self.time_of(at, text),
            None => {
                let found = format!("the time `{}` cannot be read", shortened(text));
                let is_number = text.parse::<f64>().is_ok_and(|value| value >= 0.0);
                let hint = match is_number {
                    true => Some(format!("add the unit: `{text}s` or `{text}ms`")),
                    false if self.scope.get(text).is_some() => {
                        Some(format!("the variable is written `${text}`"))
                    }
                    false => duration::hint(text),
                };
                self.add(Code::BadDuration, at.place(), found, duration::EXPECTED, hint);
            }
        }
        None
    }

    /// Beats and bars may be more than a time can hold.
    pub(crate) fn no_longer(&mut self, at: &At<'_>, text: &str, length: Exact) -> Option<Exact> {
        if length.rounded_down() <= longest() {
            return Some(length);
        }
        let message = format!("`{}` is too long a time", shortened(text));
        let hint = Some("write less, or a faster `tempo`".to_owned());
        self.add(Code::BadDuration, at.place(), message, format!("at most {}", longest()), hint);
        None
    }

    pub(crate) fn signed_duration(&mut self, at: &At<'_>) -> Option<Span> {
        if let Node::Text(text) = at.node
            && let Some(span) = duration::parse_signed(text)
        {
            return Some(span);
        }
        self.duration(at)
    }

    /// One of a few words.
    pub(crate) fn word<T: Copy>(&mut self, at: &At<'_>, words: &[(&'static str, T)]) -> Option<T> {
        self.word_or(at, words, |_| None)
    }

    /// The same, with a hint of its own for some words that are none.
    pub(crate) fn word_or<T: Copy>(
        &mut self,
        at: &At<'_>,
        words: &[(&'static str, T)],
        hint: impl FnOnce(&str) -> Option<String>,
    ) -> Option<T> {
        let known = || words.iter().map(|(word, _)| *word);
        #[cfg(test)]
        crate::known::words(at, known());
        let text = self.text(at, &one_of(known()))?;
        if let Some((_, value)) = words.iter().find(|(word, _)| *word == text) {
            return Some(*value);
        }
        let message = format!("unknown word `{}`", shortened(&text));
        let expected = one_of(known());
        let hint =
            hint(&text).or_else(|| slips::word(&text, known())).or_else(|| self.did_you_mean(&text, known()));
        self.add(Code::UnknownWord, at.place(), message, expected, hint);
        None
    }
}

/// Whether a variable can be used where this is expected.
fn is_scalar(expected: &str) -> bool {
    !expected.starts_with("a list") && !expected.contains("a map")
}

/// The entry and its number if a decimal comma made this key of its decimals.
fn cut_by_comma<'a>((key, value): &'a (String, Node), rest: &str, node: &Node) -> Option<(&'a str, String)> {
    let decimals = rest.starts_with(|c: char| c.is_ascii_digit()) && *node == Node::Null;
    match value {
        Node::Number(whole) if decimals && whole.fract() == 0.0 => Some((key, whole.to_string())),
        // `00:01:30,5` and `$a * 1,5`.
        Node::Text(text) if decimals && is_open(text) == 0 => {
            let begins = text.rfind(|c: char| !c.is_ascii_digit() && c != ':').map_or(0, |at| at + 1);
            let whole = &text[begins..];
            (whole.ends_with(|c: char| c.is_ascii_digit()) && (begins == 0 || expression::is_one(text)))
                .then(|| (key.as_str(), whole.to_owned()))
        }
        _ => None,
    }
}

/// The keys at the beginning that are numbers without a value: at least the first.
fn numbers_alone(entries: &[(String, Node)]) -> Vec<&str> {
    let is_number = |(key, node): &&(String, Node)| *node == Node::Null && key.parse::<f64>().is_ok();
    let count = entries.iter().take_while(is_number).count().max(1);
    entries.iter().take(count).map(|(key, _)| key.as_str()).collect()
}

/// How many brackets are open at the end of a text.
fn is_open(text: &str) -> usize {
    text.chars().fold(0, |open: usize, c| match c {
        '(' => open + 1,
        ')' => open.saturating_sub(1),
        _ => open,
    })
}

/// Whether a comma within the brackets of an expression ended the value, which leaves the rest as a key.
fn cut_in_brackets<'a>((key, value): &'a (String, Node), node: &Node) -> Option<(&'a str, &'a str)> {
    match value {
        Node::Text(text) if *node == Node::Null && is_open(text) > 0 && expression::is_one(text) => {
            Some((key, text))
        }
        _ => None,
    }
}
