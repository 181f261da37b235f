//! `downbeat lsp`: the language server for editors.

use super::{Exit, console};

/// Serve an editor that speaks the Language Server Protocol: findings, completion and the times of cues while you write.
#[derive(Debug, clap::Args)]
#[command(after_help = "docs/editors.md says how to set up an editor, which then starts this command itself.

Example:
  downbeat lsp")]
pub(super) struct LspArgs {}

pub(super) fn lsp(_: &LspArgs) -> Exit {
    match downbeat_lsp::serve() {
        Ok(()) => Exit::Done,
        Err(error) => {
            console::error(&error.to_string());
            Exit::Failed
        }
    }
}
