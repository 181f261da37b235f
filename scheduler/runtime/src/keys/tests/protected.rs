//! Tests of an authority whose key has a passphrase.

use std::cell::Cell;

use super::*;

thread_local! {
    static ASKED: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    ASKED.set(ASKED.get() + 1);
}

fn sesame(_: &Path) -> Result<Passphrase, PassphraseError> {
    count();
    Passphrase::new("sesame".to_owned())
}

fn wrong(_: &Path) -> Result<Passphrase, PassphraseError> {
    count();
    Passphrase::new("barley".to_owned())
}

/// Returns the number of times that `action` asked for a passphrase.
fn asked(action: impl FnOnce()) -> usize {
    ASKED.set(0);
    action();
    ASKED.get()
}

/// Returns the content of every file in a folder.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(contents(&path))
        } else {
            found.push((path.clone(), std::fs::read(&path).unwrap()))
        }
    }
    found.sort();
    found
}

#[test]
fn passphrase_is_asked_once_and_only_to_sign() {
    let folder = TempDir::new().unwrap();
    let keys = folder.path().join("keys");
    assert_eq!(asked(|| drop(Authority::create_with(&keys, calendar(), Some(sesame)).unwrap())), 1);
    let key = std::fs::read_to_string(keys.join("authority.key")).unwrap();
    assert!(key.starts_with("-----BEGIN ENCRYPTED PRIVATE KEY-----"), "{key}");
    let open = || Authority::open(&keys).unwrap().with_passphrase(sesame);
    assert!(open().has_passphrase().unwrap());
    let names = BTreeSet::from([robot("cf1"), robot("cf2"), operator()]);
    let issue = || drop(open().issue(&names, &Roles::default(), calendar(), 10).unwrap());
    assert_eq!(asked(issue), 1);
    assert_eq!(asked(|| assert!(open().issue(&names, &Roles::default(), calendar(), 10).is_err())), 0);
    assert_eq!(
        asked(|| drop(
            open().make_secrets(&BTreeSet::from(["mcu1".parse().unwrap()]), IfThere::Keep).unwrap()
        )),
        0
    );
    assert_eq!(asked(|| assert!(open().revoke(&robot("cf9"), calendar()).is_err())), 0);
    assert_eq!(asked(|| assert_eq!(open().revoke(&robot("cf2"), calendar()).unwrap(), 1)), 1);
    assert_eq!(asked(|| drop(open().renew(&robot("cf1"), calendar(), 10).unwrap())), 1);
    // The current lists are sent as they are.
    let push = || {
        let authority = open();
        authority.renew_lists(calendar()).unwrap();
        authority.list_for(&"cf1".parse().unwrap(), Protection::Tls).unwrap();
        assert_eq!(authority.issued().unwrap().entries().len(), 4);
    };
    assert_eq!(asked(push), 0);
    assert_eq!(asked(|| open().renew_lists(calendar() + 300 * DAY).unwrap()), 1);
}

#[test]
fn wrong_or_unknown_passphrase_changes_nothing() {
    let folder = TempDir::new().unwrap();
    let keys = folder.path().join("keys");
    let authority = Authority::create_with(&keys, calendar(), Some(sesame)).unwrap();
    authority.issue(&BTreeSet::from([robot("cf1")]), &Roles::default(), calendar(), 10).unwrap();
    authority.make_secrets(&BTreeSet::from(["cf1".parse().unwrap()]), IfThere::Keep).unwrap();
    drop(authority);
    let before = contents(&keys);
    let unknown: Ask = |path| Err(PassphraseError::Unknown(path.into()));
    for (ask, says) in [(wrong as Ask, "wrong passphrase for "), (unknown, "set DOWNBEAT_PASSPHRASE_FILE")] {
        let open = || Authority::open(&keys).unwrap().with_passphrase(ask);
        let new = |_: &Path| Passphrase::new("new".to_owned());
        for refused in [
            open().issue(&BTreeSet::from([robot("cf2")]), &Roles::default(), calendar(), 10).err(),
            open().renew(&robot("cf1"), calendar(), 10).err(),
            open().revoke(&robot("cf1"), calendar()).err(),
            open().renew_lists(calendar() + 300 * DAY).err(),
            open().set_passphrase(new).err(),
            open().remove_passphrase().err(),
        ] {
            let refused = refused.unwrap().to_string();
            assert!(refused.contains(says), "{refused}");
        }
        assert_eq!(contents(&keys), before);
    }
}

#[test]
fn passphrase_can_be_set_changed_and_removed() {
    let site = Site::new();
    let keys = site.folder.path().join("keys");
    let cf1 = site.of(&robot("cf1"), &[]);
    let anna = site.of(&operator(), &Role::ALL);
    drop(site.authority);
    let new = |text: &'static str| move |_: &Path| Passphrase::new(text.to_owned());
    let set = |ask: Ask, text| Authority::open(&keys).unwrap().with_passphrase(ask).set_passphrase(new(text));
    assert_eq!(asked(|| drop(set(sesame, "barley").unwrap())), 0, "the key had no passphrase");
    let path = keys.join("authority.key");
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    assert!(matches!(set(sesame, "x"), Err(KeysError::Passphrase(PassphraseError::Wrong(_)))));
    set(wrong, "sesame").unwrap();
    let authority = Authority::open(&keys).unwrap().with_passphrase(sesame);
    // It is still the same authority.
    let path = authority.renew(&operator(), calendar(), 10).unwrap();
    assert!(meet(&cf1, &Credentials::read(&path).unwrap(), None).0.is_ok());
    assert!(meet(&cf1, &anna, None).0.is_ok());
    drop(authority);
    let authority = Authority::open(&keys).unwrap().with_passphrase(sesame);
    authority.remove_passphrase().unwrap();
    assert!(!authority.has_passphrase().unwrap());
    drop(authority);
    assert_eq!(
        asked(|| drop(
            Authority::open(&keys).unwrap().with_passphrase(wrong).revoke(&operator(), calendar())
        )),
        0
    );
}
