//! The location of an authority's folder. By default, it is in the user's data folder: a folder within a project is copied, archived and
//! published together with the project.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::{AUTHORITY_KEY, Ask, Authority, KeysError};

/// The default folder of earlier versions, relative to the current folder.
const FORMER_DEFAULT: &str = "keys";

/// The folder of an authority, and whether the user named it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    folder: PathBuf,
    is_named: bool,
}

impl Location {
    /// Returns the location of the authority: the named folder, else `$DOWNBEAT_KEYS`, else `$XDG_DATA_HOME/downbeat/keys`, else
    /// `~/.local/share/downbeat/keys`.
    ///
    /// # Errors
    /// Returns [`KeysError::NoFolder`] if nothing names a folder. Except in `DOWNBEAT_KEYS`, a path that is not absolute is ignored.
    pub fn of(named: Option<&Path>) -> Result<Self, KeysError> {
        Self::with_variables(named, |name| std::env::var_os(name))
    }

    fn with_variables(
        named: Option<&Path>,
        value: impl Fn(&str) -> Option<OsString>,
    ) -> Result<Self, KeysError> {
        let from = |name: &str| value(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let absolute = |name: &str| from(name).filter(|path| path.is_absolute());
        let in_variable = || from("DOWNBEAT_KEYS").map(|path| downbeat_scripts::expand_home(&path));
        if let Some(folder) = named.map(Path::to_path_buf).or_else(in_variable) {
            return Ok(Self { folder, is_named: true });
        }
        let data = absolute("XDG_DATA_HOME")
            .or_else(|| absolute("HOME").map(|home| home.join(".local/share")))
            .ok_or(KeysError::NoFolder)?;
        Ok(Self { folder: data.join("downbeat/keys"), is_named: false })
    }

    /// The path of the folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Opens the existing authority, as [`Authority::open_with`] does.
    ///
    /// # Errors
    /// Those of [`Authority::open_with`]; also [`KeysError::FormerDefault`].
    pub fn open(&self, ask: Ask) -> Result<Authority, KeysError> {
        self.reject_former_default(Path::new(FORMER_DEFAULT))?;
        Authority::open_with(&self.folder, ask)
    }

    /// Creates a new authority, as [`Authority::create_with`] does.
    ///
    /// # Errors
    /// Those of [`Authority::create_with`]; also [`KeysError::FormerDefault`], so that nobody creates a second authority by accident.
    pub fn create(&self, now: i64, new_passphrase: Option<Ask>) -> Result<Authority, KeysError> {
        self.reject_former_default(Path::new(FORMER_DEFAULT))?;
        Authority::create_with(&self.folder, now, new_passphrase)
    }

    fn reject_former_default(&self, former: &Path) -> Result<(), KeysError> {
        let has_authority = |folder: &Path| folder.join(AUTHORITY_KEY).exists();
        if self.is_named || has_authority(&self.folder) || !has_authority(former) {
            return Ok(());
        }
        Err(KeysError::FormerDefault(self.folder.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn located(named: Option<&str>, variables: &[(&str, &str)]) -> Result<(String, bool), String> {
        let value = |wanted: &str| {
            variables.iter().find(|(name, _)| *name == wanted).map(|(_, value)| OsString::from(value))
        };
        let location = Location::with_variables(named.map(Path::new), value);
        let location = location.map_err(|error| error.to_string())?;
        Ok((location.folder.display().to_string(), location.is_named))
    }

    #[test]
    fn option_precedes_variable_and_variable_precedes_data_folder() {
        let all = [("DOWNBEAT_KEYS", "safe/keys"), ("XDG_DATA_HOME", "/data"), ("HOME", "/home/anna")];
        assert_eq!(located(Some("keys"), &all), Ok(("keys".into(), true)));
        assert_eq!(located(None, &all), Ok(("safe/keys".into(), true)));
        assert_eq!(located(None, &all[1..]), Ok(("/data/downbeat/keys".into(), false)));
        let home = ("/home/anna/.local/share/downbeat/keys".into(), false);
        assert_eq!(located(None, &all[2..]), Ok(home));
    }

    #[test]
    fn relative_and_empty_data_folders_are_ignored() {
        let home = Ok(("/home/anna/.local/share/downbeat/keys".to_owned(), false));
        for ignored in ["", "data", "./data"] {
            let variables = [("DOWNBEAT_KEYS", ""), ("XDG_DATA_HOME", ignored), ("HOME", "/home/anna")];
            assert_eq!(located(None, &variables), home);
        }
        for home in ["", "home/anna"] {
            let error = located(None, &[("HOME", home)]).unwrap_err();
            assert_eq!(
                error,
                "no folder for keys: HOME is not set; set HOME, set DOWNBEAT_KEYS to a folder of your own, or name a folder with --keys"
            );
        }
    }

    #[test]
    fn authority_in_former_default_folder_is_reported_instead_of_ignored() {
        let place = tempfile::tempdir().unwrap();
        let (former, folder) = (place.path().join("keys"), place.path().join("data"));
        let location = Location { folder: folder.clone(), is_named: false };
        assert!(location.reject_former_default(&former).is_ok(), "there is no other authority");
        drop(Authority::create(&former, super::super::calendar()).unwrap());
        let error = location.reject_former_default(&former).unwrap_err().to_string();
        assert!(error.contains("`--keys keys`"), "{error}");
        let named = Location { is_named: true, ..location.clone() };
        assert!(named.reject_former_default(&former).is_ok());
        drop(Authority::create(&folder, super::super::calendar()).unwrap());
        assert!(location.reject_former_default(&former).is_ok(), "the default folder has an authority");
    }
}
