//! The loop of the server: messages of the editor, and reports of checks.

use std::rc::Rc;

use crossbeam_channel::{Receiver, Sender, select, unbounded};
use lsp_server::{Connection, ErrorCode, Message, Notification, Request, RequestId, Response};
use lsp_types::notification::{
    DidChangeTextDocument, DidChangeWatchedFiles, DidCloseTextDocument, DidOpenTextDocument,
    DidSaveTextDocument, Exit, Notification as _, PublishDiagnostics,
};
use lsp_types::request::{
    CodeActionRequest, Completion, DocumentSymbolRequest, FoldingRangeRequest, Formatting, GotoDefinition,
    HoverRequest, InlayHintRefreshRequest, InlayHintRequest, PrepareRenameRequest, References, Rename,
    Request as _, Shutdown,
};
use lsp_types::{
    CodeAction, CodeActionKind, CodeActionOptions, CodeActionOrCommand, CodeActionParams,
    CodeActionProviderCapability, CompletionOptions, CompletionParams, DidChangeTextDocumentParams,
    DidChangeWatchedFilesParams, DidCloseTextDocumentParams, DidOpenTextDocumentParams,
    DidSaveTextDocumentParams, DocumentFormattingParams, DocumentSymbolParams, FoldingRangeParams,
    FoldingRangeProviderCapability, GotoDefinitionParams, Hover, HoverContents, HoverParams,
    HoverProviderCapability, InitializeParams, InlayHintParams, Location, MarkupContent, MarkupKind, OneOf,
    PublishDiagnosticsParams, ReferenceParams, RenameOptions, RenameParams, ServerCapabilities,
    TextDocumentPositionParams, TextDocumentSyncCapability, TextDocumentSyncKind, TextEdit, Uri,
    WorkspaceEdit,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use thiserror::Error;

use crate::address::{path_of, uri_of};
use crate::check::{Job, Report, work};
use crate::complete::complete;
use crate::file::File;
use crate::format::format;
use crate::hover::hover;
use crate::names::{Site, definitions, places};
use crate::outline::{folds, hints, symbols};
use crate::rename::{prepare, rename};
use crate::state::State;
use crate::text::Text;

/// The reason why the server ended before the editor asked it to.
#[derive(Debug, Error)]
pub enum Ended {
    /// The editor violated the protocol, or closed the connection without the request `shutdown`.
    #[error("the editor broke off the protocol: {0}")]
    Protocol(String),
    /// The thread that runs the compiler ended.
    #[error(
        "the compiler ended unexpectedly; please report this as an error of Downbeat, with the file that you edited"
    )]
    Worker,
    /// Standard input or output failed.
    #[error("cannot exchange messages with the editor: {0}")]
    Transport(#[from] std::io::Error),
}

/// Runs the language server on standard input and output, until the editor ends it.
///
/// # Errors
/// Returns an error if the editor violates the protocol, or if it closes the connection without the request `shutdown`.
pub fn serve() -> Result<(), Ended> {
    let (connection, threads) = Connection::stdio();
    let served = run(&connection);
    drop(connection);
    // After an error, the thread that reads still waits for the editor.
    served?;
    Ok(threads.join()?)
}

fn run(connection: &Connection) -> Result<(), Ended> {
    let broken = |error: &dyn std::fmt::Display| Ended::Protocol(error.to_string());
    let capabilities = serde_json::to_value(capabilities()).unwrap_or_default();
    let params = connection.initialize(capabilities).map_err(|error| broken(&error))?;
    let params: InitializeParams = serde_json::from_value(params).map_err(|error| broken(&error))?;
    let (jobs, taken) = unbounded();
    let (report, reports) = unbounded();
    let worker = std::thread::spawn(move || work(&taken, &report));
    let mut server = Server {
        connection,
        jobs,
        state: State::default(),
        refreshes: refreshes(&params),
        next_id: 0,
        is_shut_down: false,
    };
    let ended = server.serve(&reports);
    drop(server);
    // The worker ends when it has finished its current job.
    drop(reports);
    drop(worker);
    ended
}

/// Whether the editor can be asked to request inlay hints again.
fn refreshes(params: &InitializeParams) -> bool {
    let workspace = params.capabilities.workspace.as_ref();
    let hints = workspace.and_then(|workspace| workspace.inlay_hint.as_ref());
    hints.and_then(|hints| hints.refresh_support) == Some(true)
}

fn capabilities() -> ServerCapabilities {
    let triggers = [" ", "$", "/", ".", "["].map(str::to_owned);
    ServerCapabilities {
        text_document_sync: Some(TextDocumentSyncCapability::Kind(TextDocumentSyncKind::INCREMENTAL)),
        completion_provider: Some(CompletionOptions {
            trigger_characters: Some(triggers.into()),
            ..CompletionOptions::default()
        }),
        hover_provider: Some(HoverProviderCapability::Simple(true)),
        definition_provider: Some(OneOf::Left(true)),
        references_provider: Some(OneOf::Left(true)),
        rename_provider: Some(OneOf::Right(RenameOptions {
            prepare_provider: Some(true),
            work_done_progress_options: lsp_types::WorkDoneProgressOptions::default(),
        })),
        document_symbol_provider: Some(OneOf::Left(true)),
        document_formatting_provider: Some(OneOf::Left(true)),
        folding_range_provider: Some(FoldingRangeProviderCapability::Simple(true)),
        inlay_hint_provider: Some(OneOf::Left(true)),
        code_action_provider: Some(CodeActionProviderCapability::Options(CodeActionOptions {
            code_action_kinds: Some(vec![CodeActionKind::QUICKFIX]),
            ..CodeActionOptions::default()
        })),
        ..ServerCapabilities::default()
    }
}

struct Server<'c> {
    connection: &'c Connection,
    jobs: Sender<Vec<Job>>,
    state: State,
    refreshes: bool,
    next_id: i32,
    /// Whether the editor has requested `shutdown`.
    is_shut_down: bool,
}

/// The failure of a request.
struct Failure {
    code: ErrorCode,
    message: String,
}

type Answer = Result<Value, Failure>;

impl Server<'_> {
    fn serve(&mut self, reports: &Receiver<Report>) -> Result<(), Ended> {
        loop {
            select! {
                recv(self.connection.receiver) -> message => match message {
                    Ok(Message::Request(request)) => self.request(request),
                    Ok(Message::Notification(notification)) if notification.method == Exit::METHOD => {
                        return self.left();
                    }
                    Ok(Message::Notification(notification)) => self.notification(notification),
                    Ok(Message::Response(_)) => {}
                    Err(_) => return self.left(),
                },
                recv(reports) -> report => match report {
                    Ok(report) => self.report(report),
                    // The thread that checks has failed, and has printed the reason.
                    Err(_) => return Err(Ended::Worker),
                },
            }
            // Edits that arrive during a check wait for its end, so that one further check covers all of them.
            if let Some(jobs) = self.state.next_jobs() {
                self.jobs.send(jobs).ok();
            }
        }
    }

    /// Judges the end of the connection. Answers of the editor may arrive between `shutdown` and `exit`.
    fn left(&self) -> Result<(), Ended> {
        if self.is_shut_down {
            return Ok(());
        }
        Err(Ended::Protocol("it left without the request `shutdown`".to_owned()))
    }

    fn send(&self, message: impl Into<Message>) {
        // The connection is closed only if the editor has ended, which the loop notices.
        self.connection.sender.send(message.into()).ok();
    }

    fn publish(&self, all: Vec<PublishDiagnosticsParams>) {
        for params in all {
            self.send(Notification::new(PublishDiagnostics::METHOD.to_owned(), params));
        }
    }

    fn report(&mut self, report: Report) {
        let is_placed = matches!(report, Report::Placed(_));
        let published = self.state.take(report);
        self.publish(published);
        if is_placed && self.refreshes {
            self.next_id += 1;
            let id = RequestId::from(self.next_id);
            self.send(Request::new(id, InlayHintRefreshRequest::METHOD.to_owned(), Value::Null));
        }
    }

    fn notification(&mut self, notification: Notification) {
        match notification.method.as_str() {
            DidOpenTextDocument::METHOD => {
                with(notification.params, |params: DidOpenTextDocumentParams| {
                    let document = params.text_document;
                    self.state.workspace.relist();
                    self.set(&document.uri, document.version, Text::new(document.text));
                });
            }
            DidChangeTextDocument::METHOD => with(notification.params, |params| self.change(&params)),
            DidSaveTextDocument::METHOD => with(notification.params, |params: DidSaveTextDocumentParams| {
                self.touched(&params.text_document.uri);
            }),
            DidChangeWatchedFiles::METHOD => {
                with(notification.params, |params: DidChangeWatchedFilesParams| {
                    params.changes.iter().for_each(|change| self.touched(&change.uri));
                })
            }
            DidCloseTextDocument::METHOD => {
                with(notification.params, |params: DidCloseTextDocumentParams| {
                    if let Some(path) = path_of(&params.text_document.uri) {
                        let published = self.state.closed(&path);
                        self.publish(published);
                    }
                })
            }
            _ => {}
        }
    }

    fn set(&mut self, uri: &Uri, version: i32, text: Text) {
        let Some(path) = path_of(uri) else { return };
        self.state.workspace.set(path.clone(), version, text);
        let published = self.state.changed(&path);
        self.publish(published);
    }

    fn touched(&mut self, uri: &Uri) {
        self.state.workspace.relist();
        if let Some(path) = path_of(uri) {
            let published = self.state.changed(&path);
            self.publish(published);
        }
    }

    fn change(&mut self, params: &DidChangeTextDocumentParams) {
        let uri = &params.text_document.uri;
        let Some(file) = self.file(uri) else { return };
        let mut text = file.text.clone();
        for change in &params.content_changes {
            text.change(change.range, &change.text);
        }
        self.set(uri, params.text_document.version, text);
    }

    fn file(&self, uri: &Uri) -> Option<Rc<File>> {
        self.state.workspace.file(&path_of(uri)?)
    }

    fn request(&mut self, request: Request) {
        let Request { id, method, params } = request;
        let answer = match method.as_str() {
            Completion::METHOD => answer(params, |params| self.completion(&params)),
            HoverRequest::METHOD => answer(params, |params| self.hover(&params)),
            GotoDefinition::METHOD => answer(params, |params| self.definition(&params)),
            References::METHOD => answer(params, |params| self.references(&params)),
            PrepareRenameRequest::METHOD => try_answer(params, |params| self.prepare(&params)),
            Rename::METHOD => try_answer(params, |params| self.rename(&params)),
            DocumentSymbolRequest::METHOD => answer(params, |params: DocumentSymbolParams| {
                Some(symbols(&*self.file(&params.text_document.uri)?))
            }),
            FoldingRangeRequest::METHOD => answer(params, |params: FoldingRangeParams| {
                Some(folds(&*self.file(&params.text_document.uri)?))
            }),
            Formatting::METHOD => answer(params, |params: DocumentFormattingParams| {
                format(&*self.file(&params.text_document.uri)?)
            }),
            InlayHintRequest::METHOD => answer(params, |params: InlayHintParams| {
                let file = self.file(&params.text_document.uri)?;
                Some(hints(&file, self.state.compiled(&file)?, params.range))
            }),
            Shutdown::METHOD => {
                self.is_shut_down = true;
                Ok(Value::Null)
            }
            CodeActionRequest::METHOD => answer(params, |params| self.actions(&params)),
            _ => {
                let message = format!("the request `{method}` is not supported");
                Err(Failure { code: ErrorCode::MethodNotFound, message })
            }
        };
        self.send(match answer {
            Ok(value) => Response::new_ok(id, value),
            Err(Failure { code, message }) => Response::new_err(id, code as i32, message),
        });
    }

    /// Returns the file and the byte at a position.
    fn at(&self, position: &TextDocumentPositionParams) -> Option<Place> {
        let file = self.file(&position.text_document.uri)?;
        let byte = file.text.byte(position.position);
        Some(Place { file, byte })
    }

    fn completion(&self, params: &CompletionParams) -> Option<impl Serialize + use<>> {
        let Place { file, byte } = self.at(&params.text_document_position)?;
        let fleet = self.state.fleet(&file);
        Some(complete(&self.state.workspace, fleet.as_deref(), &file, byte))
    }

    fn hover(&self, params: &HoverParams) -> Option<Hover> {
        let Place { file, byte } = self.at(&params.text_document_position_params)?;
        let fleet = self.state.fleet(&file);
        let compiled = self.state.compiled(&file);
        let value = hover(&self.state.workspace, compiled, fleet.as_deref(), &file, byte)?;
        let contents = HoverContents::Markup(MarkupContent { kind: MarkupKind::Markdown, value });
        Some(Hover { contents, range: None })
    }

    fn definition(&self, params: &GotoDefinitionParams) -> Option<Vec<Location>> {
        let Place { file, byte } = self.at(&params.text_document_position_params)?;
        let mention = file.mention_at(byte)?;
        let sites = definitions(&self.state.workspace, &file, mention);
        if sites.is_empty() {
            return self.linked(&file, byte);
        }
        Some(sites.iter().filter_map(location).collect())
    }

    /// Returns the file whose path is at a byte.
    fn linked(&self, file: &File, byte: usize) -> Option<Vec<Location>> {
        let link = file.links().find(|link| link.span.start <= byte && byte <= link.span.end)?;
        let path = file.path.parent()?.join(&link.name).canonicalize().ok()?;
        Some(vec![Location { uri: uri_of(&path)?, range: lsp_types::Range::default() }])
    }

    fn references(&self, params: &ReferenceParams) -> Option<Vec<Location>> {
        let Place { file, byte } = self.at(&params.text_document_position)?;
        let mention = file.mention_at(byte)?;
        let places = places(&self.state.workspace, &file, mention);
        let definitions = places.definitions.iter().filter(|_| params.context.include_declaration);
        Some(definitions.chain(&places.uses).filter_map(location).collect())
    }

    fn prepare(&self, params: &TextDocumentPositionParams) -> Result<Option<lsp_types::Range>, String> {
        let Some(Place { file, byte }) = self.at(params) else { return Ok(None) };
        let mention = prepare(&file, byte).map_err(|refused| refused.to_string())?;
        Ok(Some(file.text.range(mention.span.clone())))
    }

    fn rename(&self, params: &RenameParams) -> Result<Option<WorkspaceEdit>, String> {
        let Some(Place { file, byte }) = self.at(&params.text_document_position) else { return Ok(None) };
        let edit = rename(&self.state.workspace, &file, byte, &params.new_name);
        edit.map(Some).map_err(|refused| refused.to_string())
    }

    #[expect(clippy::mutable_key_type, reason = "the protocol's map of edits has URIs as keys")]
    fn actions(&self, params: &CodeActionParams) -> Option<Vec<CodeActionOrCommand>> {
        let file = self.file(&params.text_document.uri)?;
        let diagnostics = &params.context.diagnostics;
        let actions = self.state.fixes(&file, params.range).into_iter().map(|fixed| {
            let edit = TextEdit { range: file.text.range(fixed.fix.span), new_text: fixed.fix.new.clone() };
            let changes = [(params.text_document.uri.clone(), vec![edit])].into();
            let code = fixed.finding.code.as_str();
            let title = match fixed.fix.new.as_str() {
                "" => format!("remove it ({code})"),
                new => format!("write `{new}` ({code})"),
            };
            let is_same = |code: &lsp_types::NumberOrString| {
                *code == lsp_types::NumberOrString::String(fixed.finding.code.as_str().to_owned())
            };
            let solved =
                diagnostics.iter().filter(|diagnostic| diagnostic.code.as_ref().is_some_and(is_same));
            CodeActionOrCommand::CodeAction(CodeAction {
                title,
                kind: Some(CodeActionKind::QUICKFIX),
                diagnostics: Some(solved.cloned().collect()),
                edit: Some(WorkspaceEdit { changes: Some(changes), ..WorkspaceEdit::default() }),
                is_preferred: Some(true),
                ..CodeAction::default()
            })
        });
        Some(actions.collect())
    }
}

/// A byte of a file.
struct Place {
    file: Rc<File>,
    byte: usize,
}

fn location(site: &Site) -> Option<Location> {
    Some(Location { uri: uri_of(&site.file.path)?, range: site.file.text.range(site.span()) })
}

/// Passes the parameters of a notification to a function. Invalid ones are ignored: a notification has no answer.
fn with<P: DeserializeOwned>(params: Value, take: impl FnOnce(P)) {
    if let Ok(params) = serde_json::from_value(params) {
        take(params);
    }
}

fn answer<P: DeserializeOwned, A: Serialize>(params: Value, answer: impl FnOnce(P) -> Option<A>) -> Answer {
    try_answer(params, |params| Ok(answer(params)))
}

fn try_answer<P: DeserializeOwned, A: Serialize>(
    params: Value,
    answer: impl FnOnce(P) -> Result<Option<A>, String>,
) -> Answer {
    let invalid =
        |error: serde_json::Error| Failure { code: ErrorCode::InvalidParams, message: error.to_string() };
    let params = serde_json::from_value(params).map_err(invalid)?;
    let answered = answer(params).map_err(|message| Failure { code: ErrorCode::RequestFailed, message })?;
    serde_json::to_value(answered).map_err(invalid)
}
