//! The keys of an authority's folder without their passphrase, for as long as the folder is open. While the authority is replaced, there are
//! two keys, which have the same passphrase.

use std::cell::RefCell;
use std::fmt;
use std::path::Path;

use pkcs8::der::zeroize::Zeroizing;

use super::{Ask, KeysError, Passphrase, PassphraseError, files, passphrase};

/// A key as it is stored, and without its passphrase. Both are in PEM.
type Decrypted = (Zeroizing<String>, Zeroizing<String>);

/// Reads and writes keys. Asks for their passphrase at most once.
pub(super) struct Unlocked {
    ask: Ask,
    /// The passphrase, once a key was decrypted with it, or if new keys shall have it.
    passphrase: RefCell<Option<Passphrase>>,
    /// Keys that were decrypted, because this takes long by intention.
    keys: RefCell<Vec<Decrypted>>,
}

impl Unlocked {
    pub(super) const fn new(ask: Ask) -> Self {
        Self { ask, passphrase: RefCell::new(None), keys: RefCell::new(Vec::new()) }
    }

    /// Returns the key in this file, in PEM. Asks for its passphrase if that is necessary.
    pub(super) fn read(&self, path: &Path) -> Result<Zeroizing<String>, KeysError> {
        let stored = Zeroizing::new(files::read(path)?);
        if !passphrase::is_encrypted(&stored) {
            return Ok(stored);
        }
        if let Some((_, key)) = self.keys.borrow().iter().find(|(known, _)| *known == stored) {
            return Ok(key.clone());
        }
        let passphrase = self.passphrase(path)?;
        let key = passphrase::decrypt(&stored, &passphrase, path)?;
        self.protect_with(Some(passphrase));
        self.keys.borrow_mut().push((stored, key.clone()));
        Ok(key)
    }

    fn passphrase(&self, path: &Path) -> Result<Passphrase, PassphraseError> {
        let known = self.passphrase.borrow().clone();
        known.map_or_else(|| (self.ask)(path), Ok)
    }

    /// Determines the passphrase of the keys that are written from now on.
    pub(super) fn protect_with(&self, passphrase: Option<Passphrase>) {
        *self.passphrase.borrow_mut() = passphrase;
    }

    /// Returns a key in PEM in the form in which it is stored: with the passphrase of the other keys, if they have one.
    pub(super) fn stored(&self, key: &Zeroizing<String>) -> Result<Zeroizing<String>, KeysError> {
        let passphrase = self.passphrase.borrow();
        let Some(passphrase) = passphrase.as_ref() else { return Ok(key.clone()) };
        let stored = passphrase::encrypt(key, passphrase)?;
        self.keys.borrow_mut().push((stored.clone(), key.clone()));
        Ok(stored)
    }
}

impl fmt::Debug for Unlocked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Unlocked")
    }
}
