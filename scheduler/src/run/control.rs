//! A mission's socket: other terminals say `go` or `stop` and hear how it ended. A line of text each way.

use std::io;
use std::path::{Path, PathBuf};

use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{mpsc, watch};

use super::Operator;

/// Longest line that is listened to.
const LINE_MAX: u64 = 256;

/// The socket in a mission's folder.
#[must_use]
pub fn socket(folder: &Path) -> PathBuf {
    folder.join("control")
}

/// Listens for other terminals until the process ends. Whoever says `stop` hears the report, as JSON, once there is one.
///
/// # Errors
/// The socket cannot be made, as where its path is too long.
pub fn listen(
    folder: &Path,
    said: mpsc::Sender<Operator>,
    report: watch::Receiver<Option<String>>,
) -> io::Result<()> {
    let path = socket(folder);
    // Left behind by a process that was killed: whoever holds the journal's lock owns the folder.
    let _absent = std::fs::remove_file(&path);
    let listener = UnixListener::bind(&path)?;
    // Ends with the process.
    tokio::spawn(async move {
        while let Ok((stream, _)) = listener.accept().await {
            tokio::spawn(converse(stream, said.clone(), report.clone()));
        }
    });
    Ok(())
}

async fn converse(
    mut stream: UnixStream,
    said: mpsc::Sender<Operator>,
    mut report: watch::Receiver<Option<String>>,
) -> io::Result<()> {
    let (reader, mut writer) = stream.split();
    let mut line = String::new();
    BufReader::new(reader.take(LINE_MAX)).read_line(&mut line).await?;
    let word = match line.trim() {
        "go" => Operator::Go,
        "stop" => Operator::Stop,
        _ => return writer.write_all(b"unknown\n").await,
    };
    if said.send(word).await.is_err() {
        return writer.write_all(b"over\n").await;
    }
    writer.write_all(b"heard\n").await?;
    if word == Operator::Stop && report.wait_for(Option::is_some).await.is_ok() {
        let text = report.borrow().clone().unwrap_or_default();
        writer.write_all(text.as_bytes()).await?;
        writer.write_all(b"\n").await?;
    }
    Ok(())
}

/// Says a word to a mission that runs. Returns what it answers, to the end.
///
/// # Errors
/// Nobody listens.
pub async fn say(folder: &Path, word: &str) -> io::Result<String> {
    let mut stream = UnixStream::connect(socket(folder)).await?;
    stream.write_all(format!("{word}\n").as_bytes()).await?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await?;
    Ok(answer)
}
