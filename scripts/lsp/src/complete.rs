//! Completion: the keys, words and names that are possible at the cursor, in a text that is not yet valid YAML.

use std::rc::Rc;

use downbeat_reader::keys::{Item, Key, Kind, Naming};
use downbeat_scripts::Fleet;
use lsp_types::{
    CompletionItem, CompletionItemKind, CompletionTextEdit, Documentation, MarkupContent, MarkupKind,
    TextEdit,
};

use crate::about;
use crate::file::File;
use crate::names::{Show, Site};
use crate::text::Text;
use crate::typed::{Typing, alternatives};
use crate::workspace::Workspace;

/// Replaces the prefix before the cursor while the text is parsed. No name contains this character of Unicode's private area.
const MARK: &str = "\u{f8ff}";
/// Maximum number of scenarios from which names are offered in a file that they share.
const SHOWS_MAX: usize = 4;

/// The prefix before the cursor.
struct Cursor<'f> {
    file: &'f File,
    /// First byte of the prefix. A completion replaces the bytes up to `end`.
    start: usize,
    /// Byte of the cursor.
    end: usize,
}

/// A text with the mark at the cursor.
struct Marked {
    file: File,
    node: usize,
    is_key: bool,
    /// Whether only blanks and dashes precede the cursor in its line.
    begins_line: bool,
}

/// Returns the completions at a byte of a file.
pub(crate) fn complete(
    workspace: &Workspace,
    fleet: Option<&Fleet>,
    file: &Rc<File>,
    byte: usize,
) -> Vec<CompletionItem> {
    let cursor = Cursor { file, start: word_start(file.text.as_str(), byte), end: byte };
    if cursor.is_in_comment() {
        return Vec::new();
    }
    let Some(marked) = cursor.marked() else { return Vec::new() };
    let known = Known { workspace, fleet, file, marked: &marked };
    let mut items: Vec<CompletionItem> = Vec::new();
    for item in known.items() {
        if !items.iter().any(|other| other.label == item.label) {
            items.push(item);
        }
    }
    let range = file.text.range(cursor.start..cursor.end);
    for (index, item) in items.iter_mut().enumerate() {
        let text = item.insert_text.take().unwrap_or_else(|| item.label.clone());
        item.text_edit = Some(CompletionTextEdit::Edit(TextEdit { range, new_text: text }));
        item.sort_text = Some(format!("{index:04}"));
    }
    items
}

/// Returns the first byte of the prefix that ends at `byte`.
fn word_start(text: &str, byte: usize) -> usize {
    let is_of_word = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.' | '$');
    let line = text[..byte].rfind('\n').map_or(0, |end| end + 1);
    let start = text[line..byte].rfind(|c| !is_of_word(c));
    let start =
        start.map_or(line, |at| line + at + text[line + at..].chars().next().map_or(1, char::len_utf8));
    // A dash before a blank begins an item of a list.
    start.min(byte)
}

impl Cursor<'_> {
    fn is_in_comment(&self) -> bool {
        let text = self.file.text.as_str();
        let line = text[..self.start].rfind('\n').map_or(0, |end| end + 1);
        let before = &text[line..self.start];
        before.starts_with('#') || before.contains(" #")
    }

    /// Parses the text up to the cursor with the mark in place of the prefix: as a value, or else as a key.
    fn marked(&self) -> Option<Marked> {
        let before = &self.file.text.as_str()[..self.start];
        let closers = closers(before);
        let of = |end: &str| {
            let text = format!("{before}{MARK}{end}{closers}\n");
            let file = File::new(self.file.path.clone(), Text::new(text));
            let node = file.tree.nodes.iter().position(|node| match &node.shape {
                downbeat_yaml::tree::Shape::Scalar(text) => text.contains(MARK),
                _ => false,
            })?;
            let is_key = file.tree.nodes[node]
                .parent
                .is_some_and(|parent| file.tree.entries(parent).iter().any(|entry| entry.key == node));
            let line = before.rsplit('\n').next().unwrap_or_default();
            let begins_line = line.chars().all(|c| matches!(c, ' ' | '-'));
            Some(Marked { file, node, is_key, begins_line })
        };
        // Without a value, the mark in a block is no key yet.
        of("").or_else(|| of(": "))
    }
}

/// Returns the brackets that close those that are open at the end of a text.
fn closers(text: &str) -> String {
    let mut open: Vec<char> = Vec::new();
    let mut quote: Option<char> = None;
    let mut before = '\n';
    for line in text.split_inclusive('\n') {
        let mut is_comment = false;
        for c in line.chars() {
            let begins = matches!(before, '\n' | ' ' | '\t' | '[' | '{' | ',' | ':' | '-');
            match (quote, c) {
                (Some(mark), c) if c == mark => quote = None,
                (Some(_), _) => {}
                (None, '#') if matches!(before, '\n' | ' ' | '\t') => is_comment = true,
                _ if is_comment => {}
                (None, '"' | '\'') if begins => quote = Some(c),
                (None, '[') if begins => open.push(']'),
                (None, '{') if begins => open.push('}'),
                (None, ']' | '}') => {
                    open.pop();
                }
                _ => {}
            }
            before = c;
        }
    }
    open.iter().rev().collect()
}

/// The knowledge from which completions are made.
struct Known<'w> {
    workspace: &'w Workspace,
    fleet: Option<&'w Fleet>,
    file: &'w Rc<File>,
    marked: &'w Marked,
}

impl Known<'_> {
    fn items(&self) -> Vec<CompletionItem> {
        let Marked { file, node, is_key, .. } = self.marked;
        let parent = file.tree.nodes[*node].parent;
        match parent.filter(|_| *is_key) {
            Some(map) => self.keys(map),
            None if file.tree.nodes[*node].parent.is_none() => self.root_keys(),
            None => self.values(*node),
        }
    }

    fn root_keys(&self) -> Vec<CompletionItem> {
        let keys = self.file.content.keys().or_else(|| self.marked.file.content.keys());
        let keys = keys.unwrap_or_else(downbeat_scripts::scenario_keys);
        keys.keys.iter().map(key_item).collect()
    }

    /// Offers keys for a map.
    fn keys(&self, map: usize) -> Vec<CompletionItem> {
        let file = &self.marked.file;
        if map == 0 {
            let known = |key: &&Key| file.tree.value(0, key.name).is_none();
            let keys = self.file.content.keys().or_else(|| file.content.keys());
            let keys = keys.unwrap_or_else(downbeat_scripts::scenario_keys);
            return keys.keys.iter().filter(known).map(key_item).collect();
        }
        let kinds = file.typed.kinds.get(map).cloned().unwrap_or_default();
        self.keys_of(&kinds, map)
    }

    fn keys_of(&self, kinds: &[Typing], map: usize) -> Vec<CompletionItem> {
        let tree = &self.marked.file.tree;
        let mut items = Vec::new();
        for typing in kinds {
            let declared = typing.declared().map(|map| map.keys).unwrap_or_default();
            items.extend(declared.iter().filter(|key| tree.value(map, key.name).is_none()).map(key_item));
            let names = typing.keys.map(|naming| self.names(naming)).unwrap_or_default();
            let unused = names.into_iter().filter(|item| tree.value(map, &item.label).is_none());
            items.extend(
                unused.map(|item| CompletionItem { insert_text: Some(format!("{}: ", item.label)), ..item }),
            );
        }
        items
    }

    /// Offers values for a node; keys, if the value may be a map.
    fn values(&self, node: usize) -> Vec<CompletionItem> {
        let file = &self.marked.file;
        let kinds = file.typed.kinds.get(node).cloned().unwrap_or_default();
        let mut items = Vec::new();
        for typing in &kinds {
            match typing.kind {
                Kind::Words(words) => items.extend(words.iter().map(|word| word_item(word))),
                Kind::Schema(schema) => items.extend(constants(schema).iter().map(|word| word_item(word))),
                // The items of a list may begin with a dash or with a bracket, which the user has yet to write.
                Kind::List(kind, _) => items.extend(self.listed(kind)),
                _ => {}
            }
            items.extend(typing.naming.map(|naming| self.names(naming)).unwrap_or_default());
        }
        if kinds.iter().any(|typing| is_value(typing.kind))
            && kinds.iter().all(|typing| typing.naming.is_none())
        {
            items.extend(self.variables());
            items.extend(times(file, &kinds));
        }
        // The keys of a map begin on a line of their own.
        if self.marked.begins_line {
            items.extend(self.keys_of(&kinds, node));
        }
        items
    }

    fn listed(&self, kind: &'static Kind) -> Vec<CompletionItem> {
        let named = alternatives(kind).into_iter().filter_map(|typing| typing.naming);
        named.flat_map(|naming| self.names(naming)).collect()
    }

    fn shows(&self) -> Vec<Show> {
        let roots = self.workspace.roots_of(self.file);
        roots.iter().take(SHOWS_MAX).map(|root| Show::of(self.workspace, root)).collect()
    }

    /// Offers the names of items for a use; none for a definition.
    fn names(&self, naming: Naming) -> Vec<CompletionItem> {
        let Naming::Uses(item) = naming else { return Vec::new() };
        match item {
            Item::Cue => self.cues(),
            Item::Zone => self.zones(),
            Item::File => self.files(),
            Item::Parameter => self.parameters(),
            Item::Device => self.devices(),
            Item::RobotDevice => self.robot_devices(),
            _ => self.items_of(item),
        }
    }

    fn items_of(&self, item: Item) -> Vec<CompletionItem> {
        let mut items = Vec::new();
        for show in self.shows() {
            let Some(member) = show.member(self.file) else { continue };
            items.extend(show.all(item, member).into_iter().map(|named| {
                item_of(&named.name, CompletionItemKind::REFERENCE, about::summary(named.site, self.fleet))
            }));
        }
        if item == Item::Act {
            items.push(word_item("end"));
        }
        items
    }

    /// Offers the cues of the same list. Those after the cursor are taken from the whole text.
    fn cues(&self) -> Vec<CompletionItem> {
        let marked = &self.marked.file;
        let own = marked.typed.mentions.iter().filter(|name| name.naming == Naming::Defines(Item::Cue));
        let list = marked.ancestors(self.marked.node).find(|node| {
            own.clone().any(|cue| cue.scope == *node)
                || marked.entry_of(*node).is_some_and(|entry| entry.key == "cues")
        });
        let begin = list.map(|list| marked.tree.nodes[list].span.start);
        let is_here = |name: &&crate::typed::Mention| {
            name.naming == Naming::Defines(Item::Cue)
                && self.file.tree.nodes.get(name.scope).map(|list| list.span.start) == begin
        };
        let whole = self.file.typed.mentions.iter().filter(is_here);
        let before = own.filter(|cue| Some(cue.scope) == list);
        before.chain(whole).map(|cue| item_of(&cue.name, CompletionItemKind::EVENT, None)).collect()
    }

    fn zones(&self) -> Vec<CompletionItem> {
        let all = self.file.typed.mentions.iter().chain(&self.marked.file.typed.mentions);
        let zones = all.filter(|name| name.naming == Naming::Defines(Item::Zone));
        zones.map(|zone| item_of(&zone.name, CompletionItemKind::REFERENCE, None)).collect()
    }

    fn parameters(&self) -> Vec<CompletionItem> {
        let marked = &self.marked.file;
        let maps = marked.ancestors(self.marked.node);
        let called = maps.into_iter().find_map(|map| {
            let of = |key, item| {
                let name = marked.tree.scalar(marked.tree.value(map, key)?)?;
                Some(crate::typed::Owner { item, name: name.to_owned() })
            };
            of("move", Item::Move).or_else(|| of("sequence", Item::Sequence))
        });
        let Some(owner) = called else { return Vec::new() };
        let mut items = Vec::new();
        for show in self.shows() {
            let Some(member) = show.member(self.file) else { continue };
            let parameter = |site: &&Site| {
                item_of(&site.mention().name, CompletionItemKind::VARIABLE, about::summary(site, self.fleet))
            };
            items.extend(show.parameters(&owner, member).iter().map(parameter));
        }
        items
    }

    fn variables(&self) -> Vec<CompletionItem> {
        let marked = &self.marked.file;
        let owner = marked.ancestors(self.marked.node).find_map(|node| marked.owner_at(node));
        let mut items = Vec::new();
        for show in self.shows() {
            let Some(member) = show.member(self.file) else { continue };
            let own = owner
                .iter()
                .flat_map(|owner| show.parameters(owner, member))
                .map(|site| site.mention().name.clone());
            let all = show.all(Item::Variable, member).into_iter().map(|named| named.name);
            items.extend(
                own.chain(all).map(|name| item_of(&format!("${name}"), CompletionItemKind::VARIABLE, None)),
            );
        }
        items
    }

    /// Offers the devices of the robots of the cue at the cursor, or of all robots.
    fn devices(&self) -> Vec<CompletionItem> {
        let Some(fleet) = self.fleet else { return self.items_of(Item::Device) };
        let robots = about::robots_at(&self.marked.file, self.marked.node, fleet);
        let items = about::devices(fleet, &robots).into_iter();
        items.map(|device| item_of(&device.id, CompletionItemKind::FIELD, Some(device.summary))).collect()
    }

    fn robot_devices(&self) -> Vec<CompletionItem> {
        let Some(fleet) = self.fleet else { return Vec::new() };
        let robots = fleet.robots.iter();
        let names = robots.flat_map(|robot| {
            let devices = about::devices(fleet, &[robot.id.as_str().to_owned()]);
            devices.into_iter().map(|device| {
                item_of(
                    &format!("{}/{}", robot.id, device.id),
                    CompletionItemKind::FIELD,
                    Some(device.summary),
                )
            })
        });
        names.collect()
    }

    /// Offers the YAML and JSON files in the folder of this file and in its subfolders.
    fn files(&self) -> Vec<CompletionItem> {
        let Some(folder) = self.file.path.parent() else { return Vec::new() };
        let mut paths = crate::workspace::files_below(folder);
        paths.remove(&self.file.path);
        let names = paths.iter().filter_map(|path| path.strip_prefix(folder).ok()?.to_str());
        names.map(|name| item_of(name, CompletionItemKind::FILE, None)).collect()
    }
}

fn key_item(key: &Key) -> CompletionItem {
    let text = about::key(key);
    CompletionItem {
        label: key.name.to_owned(),
        kind: Some(CompletionItemKind::PROPERTY),
        detail: key.required.then(|| "required".to_owned()),
        documentation: (!text.is_empty()).then(|| markdown(text)),
        insert_text: Some(format!("{}: ", key.name)),
        ..CompletionItem::default()
    }
}

fn word_item(word: &str) -> CompletionItem {
    item_of(word, CompletionItemKind::KEYWORD, None)
}

fn item_of(name: &str, kind: CompletionItemKind, summary: Option<String>) -> CompletionItem {
    CompletionItem { label: name.to_owned(), kind: Some(kind), detail: summary, ..CompletionItem::default() }
}

fn markdown(value: String) -> Documentation {
    Documentation::MarkupContent(MarkupContent { kind: MarkupKind::Markdown, value })
}

/// Whether values of a kind are numbers or times, for which variables may stand.
fn is_value(kind: &Kind) -> bool {
    matches!(kind, Kind::Schema(schema) if schema.contains("number") || schema.contains("\\\\$"))
}

/// Returns the words that a JSON schema accepts.
fn constants(schema: &str) -> Vec<String> {
    let Ok(schema) = serde_json::from_str::<serde_json::Value>(schema) else { return Vec::new() };
    let is_boolean = schema["type"] == "boolean";
    let booleans = ["true", "false"].iter().filter(|_| is_boolean).map(|word| (*word).to_owned());
    booleans.chain(schema["const"].as_str().map(str::to_owned)).collect()
}

/// Offers times: in beats and bars, if the file has a tempo.
fn times(file: &File, kinds: &[Typing]) -> Vec<CompletionItem> {
    let accepts = |part: &str| {
        kinds.iter().any(|typing| matches!(typing.kind, Kind::Schema(schema) if schema.contains(part)))
    };
    let has_tempo = file
        .tree
        .nodes
        .iter()
        .any(|node| matches!(&node.shape, downbeat_yaml::tree::Shape::Scalar(text) if text == "tempo"));
    let mut times = Vec::new();
    if accepts("ms|us") {
        times.extend(["1s", "500ms"]);
    }
    if has_tempo && accepts("beats?") {
        times.extend(["1 beat", "1 bar"]);
    }
    if has_tempo && accepts("^\\\\s*bar") {
        times.push("bar 1");
    }
    times.into_iter().map(word_item).collect()
}
