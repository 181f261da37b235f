//! The names of a show: where each item is defined, and where it is used. All features that follow names share this index.

use std::collections::HashMap;
use std::ops::Range;
use std::rc::Rc;

use downbeat_reader::keys::{Item, Naming};

use crate::file::File;
use crate::typed::{Mention, Owner};
use crate::workspace::{Member, Workspace};

/// Maximum number of shows in which the uses of a name are searched.
const SHOWS_MAX: usize = 100;

/// A name in a file.
#[derive(Clone, Debug)]
pub(crate) struct Site {
    pub(crate) file: Rc<File>,
    /// The index of the name in the file's list of names.
    pub(crate) index: usize,
}

impl Site {
    pub(crate) fn mention(&self) -> &Mention {
        &self.file.typed.mentions[self.index]
    }

    pub(crate) fn span(&self) -> Range<usize> {
        self.mention().span.clone()
    }

    fn is(&self, other: &Self) -> bool {
        self.file.path == other.file.path && self.span() == other.span()
    }
}

/// The identity of an item in a show.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Id {
    item: Item,
    name: String,
    /// The file and the place to which the name is local; empty for names that the whole show knows.
    within: String,
}

/// The files of a show, with the definitions of its items.
pub(crate) struct Show {
    pub(crate) members: Vec<Member>,
    defined: HashMap<Id, Vec<Site>>,
}

impl Show {
    pub(crate) fn of(workspace: &Workspace, root: &Rc<File>) -> Self {
        let mut members = workspace.members(root);
        // World files refer to the robots of the shows in their project.
        for file in workspace.project_files(&root.path) {
            if file.content == crate::file::Content::World {
                members.push(Member { file, prefix: String::new() });
            }
        }
        let mut show = Self { members, defined: HashMap::new() };
        for member in show.members.clone() {
            for (index, mention) in member.file.typed.mentions.iter().enumerate() {
                if let Naming::Defines(item) = mention.naming {
                    let id = Id { item, ..ids(&member, mention).remove(0) };
                    show.defined.entry(id).or_default().push(Site { file: member.file.clone(), index });
                }
            }
        }
        show
    }

    /// Returns the definitions to which a name in a member refers; several if devices of several robots have the name.
    fn definitions(&self, member: &Member, mention: &Mention) -> &[Site] {
        ids(member, mention).iter().find_map(|id| self.defined.get(id)).map_or(&[], Vec::as_slice)
    }

    /// Returns the definitions of all items of a kind, each with its name as a member may write it.
    pub(crate) fn all(&self, item: Item, from: &Member) -> Vec<Named<'_>> {
        let of_kind = self.defined.iter().filter(|(id, _)| id.item == item && id.within.is_empty());
        let named = of_kind.filter_map(|(id, sites)| {
            let name = id.name.strip_prefix(&from.prefix).unwrap_or(&id.name);
            Some(Named { name: name.to_owned(), site: sites.first()? })
        });
        let mut all: Vec<_> = named.collect();
        all.sort_by(|one, other| one.name.cmp(&other.name));
        all
    }

    /// Returns the parameters of a move, a sequence or a file.
    pub(crate) fn parameters(&self, owner: &Owner, from: &Member) -> Vec<&Site> {
        let names = [format!("{}{}", from.prefix, owner.name), owner.name.clone()];
        let is_of = |within: &str| names.iter().any(|name| within == owned(owner.item, name));
        let found = self.defined.iter().filter(|(id, _)| id.item == Item::Parameter && is_of(&id.within));
        let mut sites: Vec<&Site> = found.filter_map(|(_, sites)| sites.first()).collect();
        sites.sort_by_key(|site| site.span().start);
        sites
    }

    /// Returns the member that has this path, the least nested one if there are several.
    pub(crate) fn member(&self, file: &File) -> Option<&Member> {
        self.members.iter().find(|member| member.file.path == file.path)
    }
}

/// An item with its name.
pub(crate) struct Named<'s> {
    pub(crate) name: String,
    /// Its definition.
    pub(crate) site: &'s Site,
}

fn owned(item: Item, name: &str) -> String {
    format!("{item:?} {name}")
}

/// Returns the identities to which a name may refer, the most likely one first.
fn ids(member: &Member, mention: &Mention) -> Vec<Id> {
    let item = mention.naming.item();
    let Mention { name, scope, owner, .. } = mention;
    let path = member.file.path.display();
    let id = |item, name: &str, within: String| Id { item, name: name.to_owned(), within };
    let global = |item| {
        let own = format!("{}{name}", member.prefix);
        vec![id(item, &own, String::new()), id(item, name, String::new())]
    };
    match item {
        Item::Cue => cue_ids(&id(item, name, format!("{path} {scope}"))),
        // Zones and acts belong to one scenario; world files name its acts.
        Item::Zone => vec![id(item, name, path.to_string())],
        Item::Device | Item::Act => vec![id(item, name, String::new())],
        Item::Parameter => {
            let file = Owner { item: Item::File, name: file_name(member) };
            let of = owner.clone().unwrap_or(file);
            let owners = [format!("{}{}", member.prefix, of.name), of.name.clone()];
            owners.map(|owner| id(item, name, owned(of.item, &owner))).into()
        }
        // A parameter hides a variable of the same name.
        Item::Variable if matches!(mention.naming, Naming::Uses(_)) => {
            let mut all = Vec::new();
            if let Some(of) = member.file.owner_at(*scope) {
                all.push(id(Item::Parameter, name, owned(of.item, &format!("{}{}", member.prefix, of.name))));
            }
            all.push(id(Item::Parameter, name, owned(Item::File, &file_name(member))));
            all.extend(global(Item::Variable));
            all
        }
        Item::File | Item::RobotDevice => vec![id(item, name, path.to_string())],
        _ => global(item),
    }
}

/// Returns the identities of a cue: the cue itself, or the one that plays the sequence with the cue `sequence.cue`.
fn cue_ids(own: &Id) -> Vec<Id> {
    let whole = own.name.split_once('.').map(|(whole, _)| Id { name: whole.to_owned(), ..own.clone() });
    std::iter::once(own.clone()).chain(whole).collect()
}

/// Returns the name by which scenarios include a file, as far as the file itself knows it.
fn file_name(member: &Member) -> String {
    member.file.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

impl File {
    /// Returns the move or the sequence that is defined by a node.
    pub(crate) fn owner_at(&self, node: usize) -> Option<Owner> {
        let entry = self.entry_of(node).filter(|_| node > 0)?;
        let map = self.entry_of(entry.map)?;
        let item = match map.key {
            "moves" => Item::Move,
            "sequences" => Item::Sequence,
            _ => return None,
        };
        Some(Owner { item, name: entry.key.to_owned() })
    }
}

/// The places of an item.
#[derive(Debug, Default)]
pub(crate) struct Places {
    pub(crate) definitions: Vec<Site>,
    /// The uses, without the definitions.
    pub(crate) uses: Vec<Site>,
}

impl Places {
    pub(crate) fn all(&self) -> impl Iterator<Item = &Site> {
        self.definitions.iter().chain(&self.uses)
    }
}

/// Returns the definitions of the item that a name refers to.
pub(crate) fn definitions(workspace: &Workspace, file: &Rc<File>, mention: &Mention) -> Vec<Site> {
    let mut found = Vec::new();
    for root in workspace.roots_of(file).iter().take(SHOWS_MAX) {
        let show = Show::of(workspace, root);
        for member in show.members.iter().filter(|member| member.file.path == file.path) {
            add_new(&mut found, show.definitions(member, mention));
        }
    }
    found
}

/// Returns all places of the item that a name refers to, in all shows that know the item.
pub(crate) fn places(workspace: &Workspace, file: &Rc<File>, mention: &Mention) -> Places {
    let mut places = Places { definitions: definitions(workspace, file, mention), uses: Vec::new() };
    let mut roots: Vec<Rc<File>> = Vec::new();
    for site in &places.definitions {
        for root in workspace.roots_of(&site.file) {
            if !roots.iter().any(|known| known.path == root.path) {
                roots.push(root);
            }
        }
    }
    for root in roots.iter().take(SHOWS_MAX) {
        let show = Show::of(workspace, root);
        for member in &show.members {
            for (index, other) in member.file.typed.mentions.iter().enumerate() {
                let is_meant = || {
                    let of_other = show.definitions(member, other);
                    of_other.iter().any(|site| places.definitions.iter().any(|known| known.is(site)))
                };
                if is_like(mention, other) && matches!(other.naming, Naming::Uses(_)) && is_meant() {
                    add_new(&mut places.uses, &[Site { file: member.file.clone(), index }]);
                }
            }
        }
    }
    places
}

/// Whether two names may refer to the same item: they are equal, except for prefixes.
fn is_like(one: &Mention, other: &Mention) -> bool {
    let last = |name: &str| name.rsplit('.').next().unwrap_or(name).to_owned();
    let first = |name: &str| name.split('.').next().unwrap_or(name).to_owned();
    last(&one.name) == last(&other.name)
        || one.naming.item() == Item::Cue && first(&one.name) == first(&other.name)
}

fn add_new(known: &mut Vec<Site>, sites: &[Site]) {
    for site in sites {
        if !known.iter().any(|known| known.is(site)) {
            known.push(site.clone());
        }
    }
}
