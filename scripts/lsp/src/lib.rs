//! A language server for the YAML files of Downbeat. [`serve`] runs it on standard input and output.
//!
//! | module | |
//! |---|---|
//! | `text`, `address` | lines and positions; paths as URIs |
//! | `typed`, `file` | the nodes of a file with the declarations of their keys, and the names in it |
//! | `workspace`, `names` | the files of shows; where each item is defined and used |
//! | `check` | the compiler, on a thread of its own |
//! | `diagnostics`, `fixes` | findings, and edits that fix them |
//! | `about`, `complete`, `format`, `hover`, `outline`, `rename` | the features of the editor |
//! | `state`, `server` | the state of the server, and its loop |
//!
//! The server answers requests from the texts in the editor at once. Checks follow behind: while one runs, further edits are collected.

mod about;
mod address;
mod check;
mod complete;
mod diagnostics;
mod file;
mod fixes;
mod format;
mod hover;
mod names;
mod outline;
mod rename;
mod server;
mod state;
mod text;
mod typed;
mod workspace;

pub use server::{Ended, serve};
