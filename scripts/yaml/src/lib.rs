//! Reads the YAML files of Downbeat: parses text into a tree, and shows findings with the lines that they concern.
//!
//! | module | |
//! |---|---|
//! | [`node`], [`at`] | the tree; a node with the path that leads to it |
//! | [`tree`] | a tree with positions, of text that may be incomplete |
//! | [`finding`] | a mistake of a user: its code, its place, and how to fix it |
//! | [`locate`], [`render`], [`sarif`] | lines and columns of findings; findings as text and as SARIF |
//! | [`source`], [`open`], [`project`], [`files`], [`home`], [`refusal`] | files, and which of them may be read |
//! | [`formats`], [`identify`], [`syntax`], [`tags`] | files of other programs, and text that is not YAML |
//! | [`aliases`], [`budget`], [`composed`] | limits on the expansion of a file; names in Unicode |
//! | [`duration`], [`shown`] | durations as text; untrusted text, displayed safely |

pub mod aliases;
pub mod at;
pub mod budget;
pub mod composed;
pub mod duration;
mod events;
pub mod files;
pub mod finding;
pub mod formats;
pub mod home;
pub mod identify;
pub mod locate;
mod nesting;
pub mod node;
pub mod open;
pub mod project;
pub mod refusal;
pub mod render;
pub mod sarif;
pub mod shown;
pub mod source;
pub mod syntax;
pub mod tags;
pub mod tree;
