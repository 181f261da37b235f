//! Compiles C programs and libraries that tests need, each once per process.

use std::collections::HashMap;
use std::path::PathBuf;
use std::process::Command;
use std::sync::{LazyLock, Mutex};

use tempfile::TempDir;

/// Compiler flags for a library that a test preloads into a program.
pub const SHARED: &[&str] = &["-shared", "-fPIC"];

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| TempDir::new().unwrap());
static COMPILED: LazyLock<Mutex<HashMap<String, PathBuf>>> = LazyLock::new(Mutex::default);

/// Compiles a C source file below `tests/`, and returns the path of the result.
pub fn compiled(source: &str, flags: &[&str]) -> PathBuf {
    let mut compiled = COMPILED.lock().unwrap();
    let compile = || {
        let path = FOLDER.path().join(source.replace(['/', '.'], "-"));
        let mut compiler = Command::new("cc");
        compiler.arg("-O1").args(flags).arg("-o").arg(&path);
        compiler.arg(crate::session::root().join("tests").join(source)).arg("-ldl");
        assert!(compiler.status().unwrap().success(), "a C compiler is needed");
        path
    };
    compiled.entry(source.to_owned()).or_insert_with(compile).clone()
}
