//! Relates the nodes of a tree to the declarations of their keys: which values each node may have, and which items its texts name.

use std::ops::Range;

use downbeat_reader::keys::{Declaration, Item, Key, Kind, Naming};
use downbeat_yaml::tree::{Entry, Shape, Tree};

/// Maximum depth of nodes that are related to declarations. Declared maps are much shallower.
const DEPTH_MAX: usize = 64;

/// A kind of values that a node may have, without alternatives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Typing {
    pub(crate) kind: &'static Kind,
    /// The items that a text of this kind names.
    pub(crate) naming: Option<Naming>,
    /// The items that the keys of a map of this kind name, except for declared keys.
    pub(crate) keys: Option<Naming>,
}

impl Typing {
    /// Returns the declared keys of maps of this kind.
    pub(crate) fn declared(&self) -> Option<&'static Declaration> {
        match self.kind {
            Kind::Keys(of) | Kind::KeysOf(of, _) | Kind::KeysAnd(of, _) => Some(of()),
            _ => None,
        }
    }

    /// Returns the kind of the value of a key in a map of this kind.
    fn of_value(&self, key: &str) -> Option<&'static Kind> {
        let known = self.declared().and_then(|map| map.keys.iter().find(|known| known.name == key));
        match (self.kind, known) {
            (Kind::Keys(_), known) => known.map(|known| known.kind),
            (Kind::KeysOf(_, kind), Some(_)) => Some(kind),
            (Kind::KeysAnd(_, kind), known) => Some(known.map_or(kind, |known| known.kind)),
            (Kind::Entries(kind) | Kind::SomeEntries(kind), _) => Some(kind),
            _ => None,
        }
    }

    fn is_map(&self) -> bool {
        self.declared().is_some() || matches!(self.kind, Kind::Entries(_) | Kind::SomeEntries(_))
    }

    /// The number of keys of a map that this kind declares. Maps with free keys accept all keys, but fit less than declared ones.
    fn fit(&self, tree: &Tree, entries: &[Entry]) -> usize {
        let Some(map) = self.declared() else { return 0 };
        let is_known = |entry: &&Entry| {
            tree.scalar(entry.key).is_some_and(|key| map.keys.iter().any(|known| known.name == key))
        };
        entries.iter().filter(is_known).count()
    }
}

/// A name in a text: the definition of an item, or its use.
#[derive(Clone, Debug)]
pub(crate) struct Mention {
    pub(crate) naming: Naming,
    pub(crate) name: String,
    /// The bytes of the name.
    pub(crate) span: Range<usize>,
    /// The node that contains the name.
    pub(crate) node: usize,
    /// The list of cues around a cue; the move or the sequence around a variable or a parameter; 0 for the file.
    pub(crate) scope: usize,
    /// The move or the sequence to which a parameter belongs.
    pub(crate) owner: Option<Owner>,
}

/// An item that has parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Owner {
    pub(crate) item: Item,
    pub(crate) name: String,
}

/// The nodes of a tree with their kinds, and the names in it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Typed {
    /// For each node, the kinds that it may have. For a map with declared keys only the kind that fits best.
    pub(crate) kinds: Vec<Vec<Typing>>,
    /// The names in the order of the text.
    pub(crate) mentions: Vec<Mention>,
}

/// Returns the kinds without alternatives that a kind consists of.
pub(crate) fn alternatives(kind: &'static Kind) -> Vec<Typing> {
    let mut all = Vec::new();
    add_alternatives(Typing { kind, naming: None, keys: None }, &mut all);
    all
}

fn add_alternatives(of: Typing, all: &mut Vec<Typing>) {
    match of.kind {
        Kind::Named { kind, .. } => add_alternatives(Typing { kind, ..of }, all),
        Kind::Name(naming, kind) => add_alternatives(Typing { kind, naming: Some(*naming), ..of }, all),
        Kind::NameKeys(naming, kind) => add_alternatives(Typing { kind, keys: Some(*naming), ..of }, all),
        Kind::AnyOf(kinds) => kinds.iter().for_each(|kind| add_alternatives(Typing { kind, ..of }, all)),
        _ => all.push(of),
    }
}

/// The items around a node.
#[derive(Clone, Debug, Default)]
struct Around {
    cues: usize,
    item: usize,
    owner: Option<Owner>,
    depth: usize,
}

pub(crate) fn typed(text: &str, tree: &Tree, root: &'static Declaration) -> Typed {
    let mut walk = Walk { text, tree, typed: Typed::default() };
    walk.typed.kinds = vec![Vec::new(); tree.nodes.len()];
    if !tree.nodes.is_empty() {
        walk.entries(0, root, &Around::default());
    }
    walk.typed
}

/// Returns the devices that the description of a robot defines.
pub(crate) fn devices(tree: &Tree) -> Vec<Mention> {
    let Some(list) = tree.value(0, "devices") else { return Vec::new() };
    let ids = tree.items(list).iter().filter_map(|device| tree.value(*device, "id"));
    let keys = tree.entries(list).iter().map(|entry| entry.key);
    let mention = |node: usize| {
        Some(Mention {
            naming: Naming::Defines(Item::Device),
            name: tree.scalar(node)?.to_owned(),
            span: tree.nodes[node].span.clone(),
            node,
            scope: 0,
            owner: None,
        })
    };
    ids.chain(keys).filter_map(mention).collect()
}

struct Walk<'t> {
    text: &'t str,
    tree: &'t Tree,
    typed: Typed,
}

impl Walk<'_> {
    /// Relates the entries of the root, which have the given keys.
    fn entries(&mut self, node: usize, map: &'static Declaration, around: &Around) {
        for entry in self.tree.entries(node) {
            let key = self.tree.scalar(entry.key).unwrap_or_default();
            let known: Option<&'static Key> = map.keys.iter().find(|known| known.name == key);
            let kinds = known.map(|known| alternatives(known.kind)).unwrap_or_default();
            self.value(entry.value, kinds, around);
        }
    }

    fn value(&mut self, node: usize, kinds: Vec<Typing>, around: &Around) {
        let around = &Around { depth: around.depth + 1, ..around.clone() };
        if around.depth > DEPTH_MAX {
            return;
        }
        match &self.tree.nodes[node].shape {
            Shape::Scalar(text) => self.scalar(node, text, &kinds, around),
            Shape::List(items) => self.list(node, items, &kinds, around),
            Shape::Map(entries) => {
                self.map(node, entries, kinds, around);
                return;
            }
            Shape::Alias => {}
        }
        self.typed.kinds[node] = kinds;
    }

    fn list(&mut self, node: usize, items: &[usize], kinds: &[Typing], around: &Around) {
        let is_cues = kinds.iter().any(|typing| is_list_of_cues(typing.kind));
        let around = &if is_cues { Around { cues: node, ..around.clone() } } else { around.clone() };
        for (index, item) in items.iter().enumerate() {
            let of_item = |typing: &Typing| {
                let kind = match typing.kind {
                    Kind::List(kind, _) => kind,
                    Kind::Tuple(kinds) => kinds.get(index)?,
                    _ => return None,
                };
                let mut all = Vec::new();
                add_alternatives(Typing { kind, keys: None, ..*typing }, &mut all);
                Some(all)
            };
            let of_item = kinds.iter().filter_map(of_item).flatten().collect();
            self.value(*item, of_item, around);
        }
    }

    fn map(&mut self, node: usize, entries: &[Entry], kinds: Vec<Typing>, around: &Around) {
        let maps: Vec<Typing> = kinds.into_iter().filter(Typing::is_map).collect();
        let best = maps.iter().rev().max_by_key(|typing| typing.fit(self.tree, entries)).copied();
        self.typed.kinds[node] = maps;
        let Some(best) = best else {
            entries.iter().for_each(|entry| self.value(entry.value, Vec::new(), around));
            return;
        };
        if best.fit(self.tree, entries) > 0 {
            self.typed.kinds[node] = vec![best];
        }
        let called = self.called(node);
        for entry in entries {
            let Some(key) = self.tree.scalar(entry.key) else { continue };
            let is_declared =
                best.declared().is_some_and(|map| map.keys.iter().any(|known| known.name == key));
            let mut inner = around.clone();
            if let Some(naming) = best.keys.filter(|_| !is_declared) {
                if matches!(naming, Naming::Defines(Item::Move | Item::Sequence)) {
                    inner.item = entry.value;
                    inner.owner = Some(Owner { item: naming.item(), name: key.to_owned() });
                }
                self.mention(entry.key, key, naming, around);
            }
            if key == "parameters" && called.is_some() {
                inner.owner.clone_from(&called);
            }
            let kinds = best.of_value(key).map(alternatives).unwrap_or_default();
            self.value(entry.value, kinds, &inner);
        }
    }

    /// Returns the move or the sequence that a map uses, whose parameters the map may contain.
    fn called(&self, map: usize) -> Option<Owner> {
        let of = |key, item| {
            let name = self.tree.scalar(self.tree.value(map, key)?)?;
            Some(Owner { item, name: name.to_owned() })
        };
        let called = of("move", Item::Move).or_else(|| of("sequence", Item::Sequence));
        called.or_else(|| of("file", Item::File))
    }

    fn scalar(&mut self, node: usize, text: &str, kinds: &[Typing], around: &Around) {
        if let Some(naming) = kinds.iter().find_map(|typing| typing.naming) {
            self.mention(node, text, naming, around);
        }
        self.variables(node, text, around);
    }

    fn variables(&mut self, node: usize, text: &str, around: &Around) {
        let begin = self.tree.nodes[node].span.start;
        if !text.contains('$') {
            return;
        }
        let source = &self.text[self.tree.nodes[node].span.clone()];
        for (at, _) in source.match_indices('$') {
            let name = &source[at + 1..];
            let is_of_name = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-');
            let end = name.find(|c| !is_of_name(c)).unwrap_or(name.len());
            // A sign that nothing follows belongs to a calculation, as in `$a -1`.
            let name = name[..end].trim_end_matches('-');
            if !name.is_empty() {
                let start = begin + at + 1;
                self.add(node, name, start..start + name.len(), Naming::Uses(Item::Variable), around);
            }
        }
    }

    fn mention(&mut self, node: usize, text: &str, naming: Naming, around: &Around) {
        if text.is_empty() || text.contains('$') {
            return;
        }
        match naming {
            Naming::Uses(Item::Cue) => self.part(node, cue_in(text), naming, around),
            Naming::Uses(Item::RobotDevice) => {
                let Some((robot, device)) = text.split_once('/') else { return };
                self.part(node, robot, Naming::Uses(Item::Robot), around);
                self.part(node, device, Naming::Uses(Item::Device), around);
            }
            _ => self.part(node, text, naming, around),
        }
    }

    /// Adds a name that is a part of a text.
    fn part(&mut self, node: usize, name: &str, naming: Naming, around: &Around) {
        let span = self.tree.nodes[node].span.clone();
        let source = &self.text[span.clone()];
        // A name with escapes differs from its spelling: the whole text stands for it.
        let found = match naming.item() {
            Item::Device => source.rfind(name),
            _ => source.find(name),
        };
        let span = found.map_or(span.clone(), |at| span.start + at..span.start + at + name.len());
        self.add(node, name, span, naming, around);
    }

    fn add(&mut self, node: usize, name: &str, span: Range<usize>, naming: Naming, around: &Around) {
        let scope = match naming.item() {
            Item::Cue => around.cues,
            Item::Parameter | Item::Variable => around.item,
            _ => 0,
        };
        let owner = around.owner.clone().filter(|_| naming.item() == Item::Parameter);
        self.typed.mentions.push(Mention { naming, name: name.to_owned(), span, node, scope, owner });
    }
}

fn is_list_of_cues(kind: &Kind) -> bool {
    match kind {
        Kind::List(Kind::Keys(of), _) => of().definition == Some("cue"),
        _ => false,
    }
}

/// Returns the name of the cue in a relation such as `start of raise + 500ms`.
pub(crate) fn cue_in(text: &str) -> &str {
    let gap = [" + ", " - "].iter().filter_map(|sign| text.rfind(sign)).max();
    let is_time = |at: &usize| {
        let rest = text[at + 3..].trim_start_matches(['-', '+']);
        rest.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '$' | '.'))
    };
    let name = gap.filter(is_time).map_or(text, |at| &text[..at]);
    let name = name.strip_prefix("start of ").or_else(|| name.strip_prefix("end of ")).unwrap_or(name);
    name.trim()
}
