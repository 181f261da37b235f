//! Renames an item in all files that name it.

use std::collections::HashMap;
use std::rc::Rc;

use downbeat_reader::keys::{Item, Naming};
use lsp_types::{TextEdit, Uri, WorkspaceEdit};
use thiserror::Error;

use crate::address::uri_of;
use crate::file::File;
use crate::names::{Site, places};
use crate::typed::Mention;
use crate::workspace::Workspace;

/// A name that cannot be changed.
#[derive(Debug, Error, PartialEq, Eq)]
pub(crate) enum Refused {
    #[error("there is no name here; place the cursor on the name of a cue, a move, a robot or another item")]
    NoName,
    #[error("`{0}` is defined by the robot itself; expected a name that the show defines")]
    OfRobot(String),
    #[error("`{0}` is a file; rename the file, and then its path here")]
    OfFile(String),
    #[error("`{0}` is not defined in this project; define it, or correct its spelling first")]
    Undefined(String),
    #[error("`{0}` is already in use in `{1}`; choose another name")]
    Taken(String, String),
    #[error("`{0}` is not a name; expected letters, digits, `_` and `-`")]
    NotAName(String),
}

/// Returns the name at a byte, if it can be changed.
///
/// # Errors
/// Returns the reason why it cannot be changed.
pub(crate) fn prepare(file: &File, byte: usize) -> Result<&Mention, Refused> {
    let mention = file.mention_at(byte).ok_or(Refused::NoName)?;
    match mention.naming.item() {
        Item::Device | Item::RobotDevice => Err(Refused::OfRobot(mention.name.clone())),
        Item::File => Err(Refused::OfFile(mention.name.clone())),
        _ => Ok(mention),
    }
}

/// Returns the edits that change the name at a byte wherever it refers to the same item.
///
/// # Errors
/// Returns the reason why the name cannot be changed.
#[expect(clippy::mutable_key_type, reason = "the protocol's map of edits has URIs as keys")]
pub(crate) fn rename(
    workspace: &Workspace,
    file: &Rc<File>,
    byte: usize,
    new: &str,
) -> Result<WorkspaceEdit, Refused> {
    let mention = prepare(file, byte)?;
    let is_of_name = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-');
    if new.is_empty() || !new.chars().all(is_of_name) || new.starts_with('-') {
        return Err(Refused::NotAName(new.to_owned()));
    }
    let places = places(workspace, file, mention);
    if places.definitions.is_empty() {
        return Err(Refused::Undefined(mention.name.clone()));
    }
    for site in &places.definitions {
        if is_taken(site, new) {
            return Err(Refused::Taken(new.to_owned(), site.file.path.display().to_string()));
        }
    }
    let mut changes: HashMap<Uri, Vec<TextEdit>> = HashMap::new();
    for site in places.all() {
        let Some(uri) = uri_of(&site.file.path) else { continue };
        let edit = TextEdit { range: site.file.text.range(last_part(site)), new_text: new.to_owned() };
        changes.entry(uri).or_default().push(edit);
    }
    Ok(WorkspaceEdit { changes: Some(changes), ..WorkspaceEdit::default() })
}

/// Whether the file of a definition defines another item of this kind with the new name.
fn is_taken(site: &Site, new: &str) -> bool {
    let own = site.mention();
    site.file.typed.mentions.iter().any(|other| {
        other.name == new
            && matches!(other.naming, Naming::Defines(_))
            && other.naming.item() == own.naming.item()
            && other.scope == own.scope
            && other.owner == own.owner
    })
}

/// Returns the bytes of a name without the prefix of its file, and without the cue of a sequence that follows it.
fn last_part(site: &Site) -> std::ops::Range<usize> {
    let mut span = site.span();
    let written = &site.file.text.as_str()[span.clone()];
    let is_cue = site.mention().naming.item() == Item::Cue;
    match written.find('.').filter(|_| matches!(site.mention().naming, Naming::Uses(_))) {
        Some(dot) if is_cue => span.end = span.start + dot,
        Some(_) => span.start += written.rfind('.').map_or(0, |dot| dot + 1),
        None if written.starts_with(['"', '\'']) && written.len() >= 2 => {
            span = span.start + 1..span.end - 1;
        }
        None => {}
    }
    span
}
