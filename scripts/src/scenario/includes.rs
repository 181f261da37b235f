//! Included files. A plain include exists only once; an include under a name or with parameters adds a copy of the file, so that one file
//! can be included several times.

use std::sync::Arc;

use super::kinds;
use super::library::{Copy, Documents, INCLUDES_MAX, IncludedKeys, Library, Shared};
use super::nesting::{Used, arguments, with_defaults};
use crate::fields::{At, Reader};
use crate::finding::{Code, Place, Use};
use crate::node::Node;
use crate::shown::shortened;
use downbeat_reader::keys;

const EXPECTED: &str = "the path of a file, {file, as, parameters}, or a list of these";

keys! {
    /// A file under its own name, with parameters.
    pub(super) struct IncludeKeys as "included" {
        /// Its path, from the scenario's folder.
        #[required]
        file: kinds::FILE,
        /// Prefix of its names: with `left`, its move `bow` becomes `left.bow`.
        r#as: kinds::NAME,
        parameters: kinds::PARAMETERS,
    }
}

/// An entry under `include`.
pub(super) struct Included {
    pub(super) file: String,
    pub(super) place: Place,
    /// Whether the include is plain: it has no name and no parameters, and all files can use its names without a prefix.
    pub(super) is_plain: bool,
}

/// Returns the files that are listed under `include`. Skips invalid entries, which [`check`] reports.
pub(super) fn named(root: &Node, file: usize) -> Vec<Included> {
    let at = At::document(root, u16::try_from(file).unwrap_or(u16::MAX));
    let mut all = Vec::new();
    each(&at, |item| {
        let (name, is_plain) = match item.node {
            Node::Text(name) => (name, true),
            Node::Map(entries) => {
                let value = |key: &str| entries.iter().find(|(known, _)| known == key).map(|(_, node)| node);
                let Some(Node::Text(name)) = value("file") else { return };
                (name, value("as").is_none() && value("parameters").is_none())
            }
            _ => return,
        };
        all.push(Included { file: name.clone(), place: item.place(), is_plain });
    });
    all
}

/// Visits the entries under `include` of a document.
fn each(root: &At<'_>, mut take: impl FnMut(&At<'_>)) {
    let Node::Map(entries) = root.node else { return };
    let Some((_, node)) = entries.iter().find(|(key, _)| key == "include") else { return };
    let list = root.entry("include", 0, node);
    match node {
        Node::List(items) => items.iter().enumerate().for_each(|(index, item)| take(&list.item(index, item))),
        _ => take(&list),
    }
}

/// Reports errors in the entries under `include`.
pub(super) fn check(reader: &mut Reader, at: &At<'_>) {
    let items = match at.node {
        Node::List(_) => reader.list(at, EXPECTED),
        _ => vec![*at],
    };
    for item in items {
        let Node::Map(_) = item.node else {
            reader.text(&item, EXPECTED);
            continue;
        };
        let Some(keys) = reader.keys(&item, "an include") else { continue };
        let IncludeKeys { file, r#as: name, .. } = keys;
        file.and_then(|at| reader.text(&at, "the path of a file").map(drop));
        if let Some(at) = name
            && let Some(name) = reader.name(&at, "a name for this include")
            && name.contains('.')
        {
            let message = format!("`{}` contains a dot", shortened(&name));
            let expected = "a name without a dot: the dot separates it from the names in the included file";
            reader.add(Code::WrongType, at.place(), message, expected, None);
        }
    }
}

/// Sets the parameters of an included file to their defaults, for a plain include, which passes no values.
pub(super) fn set_defaults(reader: &mut Reader, parameters: Option<At<'_>>, name: &str, place: &Place) {
    let used = of_file(name, 0, &Node::Null, place.clone());
    let values = with_defaults(reader, &used, parameters.as_ref(), Vec::new());
    values.into_iter().for_each(|(name, value)| reader.scope.set(name, value));
}

fn of_file<'a>(name: &str, file: u16, node: &'a Node, place: Place) -> Used<'a> {
    Used { kind: "file", name: name.to_owned(), part: Shared { file, name: "", node, copy: 0 }, place }
}

/// The copy of a file whose own `include` entries are being processed.
struct Within<'n> {
    copy: usize,
    /// The chain of files that include each other, from the scenario or a plain include to the file of this copy.
    files: Vec<u16>,
    used: Option<&'n Arc<Use>>,
}

/// Adds to the library a copy of the included file for each include that has a name or parameters.
pub(super) fn copies<'a>(reader: &mut Reader, library: &mut Library<'a>, documents: &'a Documents<'_>) {
    for (file, plain) in (0u16..).zip(&documents.plain) {
        if plain.is_some() {
            copies_in(reader, library, documents, &Within { copy: 0, files: vec![file], used: None });
        }
    }
}

fn copies_in<'a>(
    reader: &mut Reader,
    library: &mut Library<'a>,
    documents: &'a Documents<'_>,
    within: &Within<'_>,
) {
    let Some(file) = within.files.last().copied() else { return };
    let root = At::used(&documents.nodes[usize::from(file)], file, within.used);
    let mut seen: Vec<(String, String)> = Vec::new();
    each(&root, |item| {
        let Node::Map(entries) = item.node else { return };
        let value = |key: &str| entries.iter().find(|(known, _)| known == key).map(|(_, node)| node);
        let Some(Node::Text(name)) = value("file") else { return };
        let Some(index) = documents.names.iter().position(|known| known == name) else { return };
        let (own, given) = (value("as"), value("parameters"));
        if own.is_none() && given.is_none() {
            return;
        }
        let own = own.and_then(|node| reader.name(&item.entry("as", 0, node), "a name for this include"));
        let given = given.map(|node| item.entry("parameters", 0, node));
        if let Some(own) = &own {
            let both = (name.clone(), own.clone());
            if seen.contains(&both) {
                let message = format!("`{}` is included as `{}` twice", shortened(name), shortened(own));
                let hint = Some("rename one of them, or remove it".to_owned());
                reader.add(Code::NameTwice, item.place(), message, "each file at most once per name", hint);
                return;
            }
            seen.push(both);
        }
        let target = u16::try_from(index).unwrap_or(u16::MAX);
        if let Some(refused) = refused(within, library, target, name) {
            let (code, message, expected, hint) = refused;
            reader.add(code, item.place(), message, expected, Some(hint.to_owned()));
            return;
        }
        copy(reader, library, documents, within, &Wanted { item, name, own, given, target });
    });
}

fn refused(
    within: &Within<'_>,
    library: &Library<'_>,
    target: u16,
    name: &str,
) -> Option<(Code, String, String, &'static str)> {
    let name = shortened(name);
    if within.files.contains(&target) {
        let message = format!("the file `{name}` includes itself");
        let expected = "a file that does not include itself".to_owned();
        return Some((Code::PlaysItself, message, expected, "remove one of these includes"));
    }
    let hint = "include fewer files with `as` or `parameters`";
    let message =
        format!("with `{name}`, more than {INCLUDES_MAX} files are included with `as` or `parameters`");
    let expected = format!("at most {INCLUDES_MAX} such includes");
    (library.copies.len() > INCLUDES_MAX).then_some((Code::TooMuch, message, expected, hint))
}

/// An include that has a name or parameters.
struct Wanted<'n> {
    item: &'n At<'n>,
    name: &'n str,
    own: Option<String>,
    given: Option<At<'n>>,
    target: u16,
}

fn copy<'a>(
    reader: &mut Reader,
    library: &mut Library<'a>,
    documents: &'a Documents<'_>,
    within: &Within<'_>,
    wanted: &Wanted<'_>,
) {
    let &Wanted { item, name, ref own, given, target } = wanted;
    let what = match own {
        Some(own) => format!("`{}` as `{}`", shortened(name), shortened(own)),
        None => format!("`{}`", shortened(name)),
    };
    let told = Arc::new(Use { what, by: None, place: item.place() });
    let node = &documents.nodes[usize::from(target)];
    let root = At::used(node, target, Some(&told));
    let Some(keys) = reader.keys::<IncludedKeys<'_>>(&root, "an included file") else { return };
    if let Some(at) = keys.include {
        check(reader, &at);
    }
    let parameters = keys.parameters;
    let used = of_file(name, target, node, item.place());
    let arguments = arguments(reader, &used, parameters.as_ref(), given.as_ref());
    let hidden = reader.scope.hide(library.globals);
    let values = with_defaults(reader, &used, parameters.as_ref(), arguments);
    values.into_iter().for_each(|(name, value)| reader.scope.set(name, value));
    let prefix = own.as_ref().map(|own| format!("{own}.")).unwrap_or_default();
    let prefix = format!("{}{prefix}", library.copies[within.copy].prefix);
    library.copies.push(Copy { prefix, values: Vec::new(), used: Some(told.clone()) });
    let copy = library.copies.len() - 1;
    library.register(node, target, copy);
    library.add_from(reader, &keys.parts(), target, copy);
    let mut files = within.files.clone();
    files.push(target);
    copies_in(reader, library, documents, &Within { copy, files, used: Some(&told) });
    library.copies[copy].values = reader.scope.hide(library.globals);
    reader.scope.restore(hidden);
}
