//! Writes imported files: all of them, or none. Existing files are overwritten only if the user requests it.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use downbeat_import::FilePart;
use downbeat_scripts::{Attempt, Code, Finding, Refusal, Severity};

/// Writes every file to a temporary file next to its final path first, then renames all of them.
pub(in super::super) fn write_all(
    folder: &Path,
    files: &[FilePart],
    force: bool,
) -> Result<Vec<String>, Vec<Finding>> {
    let paths: Vec<_> = files.iter().map(|file| folder.join(&file.path)).collect();
    let there: Vec<_> = paths.iter().filter(|path| !force && path.symlink_metadata().is_ok()).collect();
    if !there.is_empty() {
        return Err(there.into_iter().map(|path| already_there(path)).collect());
    }
    let mut waiting = Vec::new();
    for (path, file) in paths.iter().zip(files) {
        match write_beside(path, &file.text) {
            Ok(temporary) => waiting.push(temporary),
            Err(error) => return Err(vec![unwritable(path, &error)]),
        }
    }
    for (temporary, path) in waiting.into_iter().zip(&paths) {
        temporary.persist(path).map_err(|error| vec![unwritable(path, &error)])?;
    }
    Ok(paths.iter().map(|path| path.display().to_string()).collect())
}

/// A temporary file. It is removed on drop unless it was renamed to its final name.
struct Temporary(Option<PathBuf>);

impl Temporary {
    fn persist(mut self, path: &Path) -> std::io::Result<()> {
        if let Some(temporary) = &self.0 {
            fs::rename(temporary, path)?;
        }
        self.0 = None;
        Ok(())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if let Some(path) = &self.0 {
            // A file that is already gone needs no removal.
            let _gone = fs::remove_file(path);
        }
    }
}

fn write_beside(path: &Path, text: &str) -> std::io::Result<Temporary> {
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let temporary = folder.join(format!(".{name}.{}.tmp", std::process::id()));
    let mut file = fs::File::create_new(&temporary)?;
    let guard = Temporary(Some(temporary));
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    Ok(guard)
}

fn already_there(path: &Path) -> Finding {
    let hint = "choose another --output, or add --force to replace the file";
    about(
        Code::FileExists,
        path,
        "the file already exists".into(),
        "a path that does not exist yet",
        Some(hint),
    )
}

fn unwritable(path: &Path, error: &std::io::Error) -> Finding {
    let Refusal { reason, remedy } = Refusal::of(Attempt::Write(path), error);
    let message = format!("cannot write the file: {reason}");
    about(Code::Unreadable, path, message, "a writable folder", remedy.as_deref())
}

fn about(code: Code, path: &Path, message: String, expected: &str, hint: Option<&str>) -> Finding {
    Finding {
        code,
        severity: Severity::Error,
        file: path.display().to_string(),
        line: 0,
        column: 0,
        width: 0,
        message,
        expected: expected.to_owned(),
        hint: hint.map(str::to_owned),
        source_line: String::new(),
        related: Vec::new(),
    }
}
