//! Paths that begin with `~/`, the user's home folder. Shells expand them on the command line, but not in files.

use std::path::{Path, PathBuf};

/// Replaces `~/` at the beginning of a path with the user's home folder, and returns any other path unchanged. A path without `~/`
/// includes `~user/`, and a `~` at another place. Returns the path unchanged also if the user has no home folder.
#[must_use]
pub fn expand_home(path: &Path) -> PathBuf {
    expanded(path, home_folder().as_deref())
}

/// Writes a path in the home folder with `~/`, the inverse of [`expand_home`]. Returns any other path unchanged.
#[must_use]
pub fn abbreviate_home(path: &Path) -> PathBuf {
    abbreviated(path, home_folder().as_deref())
}

fn home_folder() -> Option<PathBuf> {
    std::env::home_dir().filter(|home| home.is_absolute())
}

fn expanded(path: &Path, home: Option<&Path>) -> PathBuf {
    match (path.strip_prefix("~"), home) {
        (Ok(below), Some(home)) if !below.as_os_str().is_empty() => home.join(below),
        _ => path.to_path_buf(),
    }
}

fn abbreviated(path: &Path, home: Option<&Path>) -> PathBuf {
    match home.and_then(|home| path.strip_prefix(home).ok()) {
        Some(below) if !below.as_os_str().is_empty() => Path::new("~").join(below),
        _ => path.to_path_buf(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOME: &str = "/home/anna";

    fn path(text: &str) -> PathBuf {
        expanded(Path::new(text), Some(Path::new(HOME)))
    }

    #[test]
    fn only_tilde_and_slash_at_the_beginning_stand_for_the_home_folder() {
        assert_eq!(path("~/keys/anna.pem"), Path::new("/home/anna/keys/anna.pem"));
        for unchanged in ["~", "~bert/keys", "keys/~/anna.pem", "./~/anna.pem", "/~/anna.pem", "keys~/a", ""]
        {
            assert_eq!(path(unchanged), Path::new(unchanged));
        }
        assert_eq!(expanded(Path::new("~/keys"), None), Path::new("~/keys"));
    }

    #[test]
    fn abbreviated_path_expands_to_the_same_path() {
        for whole in ["/home/anna/keys", "/home/anna/a b/c", "/home/annabel/keys", "/home/anna", "keys"] {
            let short = abbreviated(Path::new(whole), Some(Path::new(HOME)));
            assert_eq!(expanded(&short, Some(Path::new(HOME))), Path::new(whole));
        }
        let short = abbreviated(Path::new("/home/anna/keys"), Some(Path::new(HOME)));
        assert_eq!(short, Path::new("~/keys"));
    }
}
