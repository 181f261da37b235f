//! The YAML of Downbeat's files: text to tree, and findings that show the lines that they concern.
//!
//! | module | |
//! |---|---|
//! | [`node`], [`at`] | the tree; a node with the way that led to it |
//! | [`finding`] | what a user did wrong: a code, a place, and how to fix it |
//! | [`locate`], [`render`], [`sarif`] | lines and columns of findings; findings as text and as SARIF |
//! | [`source`], [`open`], [`project`], [`files`], [`refusal`] | files, and which of them may be read |
//! | [`formats`], [`identify`], [`syntax`], [`tags`] | files of other programs, and what is not YAML |
//! | [`aliases`], [`budget`], [`composed`] | limits of what a file may expand to; names in Unicode |
//! | [`duration`], [`shown`] | times as they are written; text from outside, shown safely |

pub mod aliases;
pub mod at;
pub mod budget;
pub mod composed;
pub mod duration;
mod events;
pub mod files;
pub mod finding;
pub mod formats;
pub mod identify;
pub mod locate;
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
