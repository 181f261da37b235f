//! Programs and libraries in C that tests need, compiled once.

use std::collections::HashMap;
use std::path::PathBuf;
use std::process::Command;
use std::sync::{LazyLock, Mutex};

use tempfile::TempDir;

/// The compiler's flags for a library that is preloaded.
pub const SHARED: &[&str] = &["-shared", "-fPIC"];

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| TempDir::new().unwrap());
static COMPILED: LazyLock<Mutex<HashMap<String, PathBuf>>> = LazyLock::new(Mutex::default);

/// What this source below `tests/` is compiled to.
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
