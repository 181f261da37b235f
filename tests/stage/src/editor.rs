//! An editor that speaks the Language Server Protocol with `downbeat lsp`.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use serde_json::{Value, json};

use crate::session::program;

/// Longest wait for a message of the server.
const PATIENCE: Duration = Duration::from_secs(60);

pub struct Editor {
    child: Child,
    input: ChildStdin,
    messages: Receiver<Value>,
    next_id: i64,
    versions: HashMap<String, i64>,
    /// The latest diagnostics of each file, with the version of its text if the file is open.
    pub diagnostics: HashMap<String, Published>,
}

#[derive(Clone, Debug)]
pub struct Published {
    pub version: Option<i64>,
    pub diagnostics: Vec<Value>,
}

impl Editor {
    /// Starts `downbeat lsp`.
    pub fn new() -> Self {
        Self::with(Command::new(program()).arg("lsp"))
    }

    /// Starts a server.
    pub fn with(command: &mut Command) -> Self {
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let input = child.stdin.take().unwrap();
        let mut output = BufReader::new(child.stdout.take().unwrap());
        let (sender, messages) = channel();
        std::thread::spawn(move || {
            while let Some(message) = read(&mut output) {
                if sender.send(message).is_err() {
                    return;
                }
            }
        });
        let mut editor = Self {
            child,
            input,
            messages,
            next_id: 0,
            versions: HashMap::new(),
            diagnostics: HashMap::new(),
        };
        let capabilities = json!({"workspace": {"inlayHint": {"refreshSupport": true}}});
        let about = editor.request("initialize", json!({"capabilities": capabilities}));
        assert!(about["capabilities"]["hoverProvider"].as_bool().unwrap(), "{about}");
        editor.notify("initialized", json!({}));
        editor
    }

    pub fn notify(&mut self, method: &str, params: Value) {
        self.send(&json!({"jsonrpc": "2.0", "method": method, "params": params}));
    }

    fn send(&mut self, message: &Value) {
        let text = message.to_string();
        write!(self.input, "Content-Length: {}\r\n\r\n{text}", text.len()).unwrap();
        self.input.flush().unwrap();
    }

    /// Sends a request and returns its result.
    #[track_caller]
    pub fn request(&mut self, method: &str, params: Value) -> Value {
        self.try_request(method, params).unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// Like [`Self::request`], but returns the message of an error.
    #[track_caller]
    pub fn try_request(&mut self, method: &str, params: Value) -> Result<Value, String> {
        self.next_id += 1;
        let id = self.next_id;
        self.send(&json!({"jsonrpc": "2.0", "id": id, "method": method, "params": params}));
        loop {
            let message = self.receive();
            if message["id"] == id && message.get("method").is_none() {
                return match message.get("error") {
                    Some(error) => Err(error["message"].as_str().unwrap().to_owned()),
                    None => Ok(message["result"].clone()),
                };
            }
        }
    }

    /// Returns the next message, and keeps the diagnostics in it.
    #[track_caller]
    fn receive(&mut self) -> Value {
        let message = self.messages.recv_timeout(PATIENCE).unwrap_or_else(|error| {
            panic!("the server sent nothing: {error}; its state is {:?}", self.child.try_wait())
        });
        if message["method"] == "textDocument/publishDiagnostics" {
            let params = &message["params"];
            let published = Published {
                version: params["version"].as_i64(),
                diagnostics: params["diagnostics"].as_array().unwrap().clone(),
            };
            self.diagnostics.insert(params["uri"].as_str().unwrap().to_owned(), published);
        } else if message.get("method").is_some() && message.get("id").is_some() {
            self.send(&json!({"jsonrpc": "2.0", "id": message["id"], "result": null}));
        }
        message
    }

    /// Opens a file with its text on the disk.
    pub fn open(&mut self, path: &Path) {
        let text = std::fs::read_to_string(path).unwrap();
        self.open_as(path, &text);
    }

    pub fn open_as(&mut self, path: &Path, text: &str) {
        let uri = uri(path);
        // A file that is opened again continues to count, so that no diagnostics of its earlier texts pass as those of the new one.
        let version = self.versions.entry(uri.clone()).or_insert(0);
        *version += 1;
        let document = json!({"uri": uri, "languageId": "yaml", "version": *version, "text": text});
        self.notify("textDocument/didOpen", json!({"textDocument": document}));
    }

    /// Replaces the whole text of an opened file.
    pub fn change(&mut self, path: &Path, text: &str) {
        self.edit(path, json!({"text": text}));
    }

    /// Changes an opened file by an event of the protocol.
    pub fn edit(&mut self, path: &Path, change: Value) {
        let uri = uri(path);
        let version = self.versions.get_mut(&uri).unwrap();
        *version += 1;
        let document = json!({"uri": uri, "version": *version});
        self.notify("textDocument/didChange", json!({"textDocument": document, "contentChanges": [change]}));
    }

    /// Waits for the diagnostics of the current text of a file.
    #[track_caller]
    pub fn diagnosed(&mut self, path: &Path) -> Vec<Value> {
        let uri = uri(path);
        let version = self.versions.get(&uri).copied();
        loop {
            if let Some(published) =
                self.diagnostics.get(&uri).filter(|published| published.version == version)
            {
                return published.diagnostics.clone();
            }
            self.receive();
        }
    }

    /// Waits until the server has the times of the cues of a checked scenario, which it reports by asking for a refresh.
    #[track_caller]
    pub fn refreshed(&mut self) {
        while self.receive()["method"] != "workspace/inlayHint/refresh" {}
    }

    /// Ends the server as editors do, and checks that it ends without an error.
    pub fn end(mut self) {
        self.request("shutdown", Value::Null);
        self.notify("exit", Value::Null);
        assert!(self.child.wait().unwrap().success());
    }
}

impl Drop for Editor {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

fn read(output: &mut impl BufRead) -> Option<Value> {
    let mut length = 0;
    loop {
        let mut line = String::new();
        if output.read_line(&mut line).ok()? == 0 {
            return None;
        }
        match line.trim_end().split_once(": ") {
            Some((name, value)) if name.eq_ignore_ascii_case("content-length") => {
                length = value.parse().ok()?
            }
            Some(_) => {}
            None => break,
        }
    }
    let mut text = vec![0; length];
    output.read_exact(&mut text).ok()?;
    serde_json::from_slice(&text).ok()
}

/// Returns the URI of a file, whose path contains no special characters.
pub fn uri(path: &Path) -> String {
    format!("file://{}", path.canonicalize().unwrap().display())
}

/// Returns the position after the first occurrence of a text in a file, as parameters of a request.
#[track_caller]
pub fn position(path: &Path, text: &str, before: &str) -> Value {
    let at = text.find(before).unwrap_or_else(|| panic!("no {before} in {text}")) + before.len();
    let line = text[..at].matches('\n').count();
    let column = text[..at].rsplit('\n').next().unwrap_or_default().encode_utf16().count();
    json!({"textDocument": {"uri": uri(path)}, "position": {"line": line, "character": column}})
}
