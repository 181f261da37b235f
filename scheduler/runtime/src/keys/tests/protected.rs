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
    let open = || Authority::open_with(&keys, sesame).unwrap();
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

/// Something that needs the key of the authority.
type Action<'a> = &'a dyn Fn(&Authority) -> Option<KeysError>;

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
        let open = || Authority::open_with(&keys, ask).unwrap();
        let new = |_: &Path| Passphrase::new("new".to_owned());
        // Each action has the folder for itself.
        let actions: [Action<'_>; 6] = [
            &|own| own.issue(&BTreeSet::from([robot("cf2")]), &Roles::default(), calendar(), 10).err(),
            &|own| own.renew(&robot("cf1"), calendar(), 10).err(),
            &|own| own.revoke(&robot("cf1"), calendar()).err(),
            &|own| own.renew_lists(calendar() + 300 * DAY).err(),
            &|own| own.set_passphrase(new).err(),
            &|own| own.remove_passphrase().err(),
        ];
        for action in actions {
            let refused = action(&open()).unwrap().to_string();
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
    let set = |ask: Ask, text| Authority::open_with(&keys, ask).unwrap().set_passphrase(new(text));
    assert_eq!(asked(|| drop(set(sesame, "barley").unwrap())), 0, "the key had no passphrase");
    let path = keys.join("authority.key");
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    assert!(matches!(set(sesame, "x"), Err(KeysError::Passphrase(PassphraseError::Wrong(_)))));
    set(wrong, "sesame").unwrap();
    let authority = Authority::open_with(&keys, sesame).unwrap();
    // It is still the same authority.
    let path = authority.renew(&operator(), calendar(), 10).unwrap();
    assert!(meet(&cf1, &Credentials::read(&path).unwrap(), None).0.is_ok());
    assert!(meet(&cf1, &anna, None).0.is_ok());
    drop(authority);
    let authority = Authority::open_with(&keys, sesame).unwrap();
    authority.remove_passphrase().unwrap();
    assert!(!authority.has_passphrase().unwrap());
    drop(authority);
    assert_eq!(
        asked(|| drop(Authority::open_with(&keys, wrong).unwrap().revoke(&operator(), calendar()))),
        0
    );
}

/// A site with a robot and an operator, whose authority has the passphrase `sesame`.
fn protected(folder: &Path) -> PathBuf {
    let keys = folder.join("keys");
    let authority = Authority::create_with(&keys, calendar(), Some(sesame)).unwrap();
    authority.issue(&BTreeSet::from([robot("cf1"), operator()]), &Roles::default(), calendar(), 10).unwrap();
    keys
}

fn barley(path: &Path) -> Result<Passphrase, PassphraseError> {
    wrong(path)
}

fn is_encrypted(keys: &Path, name: &str) -> bool {
    std::fs::read_to_string(keys.join(name)).unwrap().starts_with("-----BEGIN ENCRYPTED PRIVATE KEY-----")
}

#[test]
fn replacement_asks_once_per_command_and_protects_the_new_key() {
    let folder = TempDir::new().unwrap();
    let keys = protected(folder.path());
    let open = || Authority::open_with(&keys, sesame).unwrap();
    let before = contents(&keys);
    assert!(Authority::open_with(&keys, wrong).unwrap().rotate(calendar()).is_err());
    assert_eq!(contents(&keys), before);
    assert_eq!(asked(|| open().rotate(calendar()).unwrap()), 1);
    for key in ["authority.key", "successor.key"] {
        assert!(is_encrypted(&keys, key), "{key}");
    }
    assert_eq!(asked(|| assert_eq!(open().not_renewed(calendar()).unwrap().len(), 2)), 0);
    assert_eq!(asked(|| assert_eq!(open().renew_all(calendar(), 10).unwrap().made.len(), 2)), 1);
    assert_eq!(asked(|| assert_eq!(open().revoke(&robot("cf1"), calendar()).unwrap(), 2)), 1);
    assert_eq!(asked(|| open().renew_lists(calendar() + 300 * DAY).unwrap()), 1);
    assert_eq!(asked(|| open().end(End::IfRenewed, calendar()).unwrap()), 1);
    assert!(is_encrypted(&keys, "authority.key") && !keys.join("successor.key").exists());
    assert_eq!(asked(|| drop(open().renew(&operator(), calendar(), 10).unwrap())), 1);
}

#[test]
fn passphrase_of_both_keys_changes_even_if_interrupted() {
    let folder = TempDir::new().unwrap();
    let keys = protected(folder.path());
    Authority::open_with(&keys, sesame).unwrap().rotate(calendar()).unwrap();
    let (mut present, mut next): (Ask, Ask) = (sesame, barley);
    for count in 0.. {
        let authority = Authority::open_with(&keys, present).unwrap();
        let done = files::interruption::after(count, || authority.set_passphrase(next));
        drop(authority);
        // Without the first write, nothing has changed.
        let valid = if count == 0 { present } else { next };
        Authority::open_with(&keys, valid).unwrap().renew_lists(calendar() + 300 * DAY).unwrap();
        assert!(!keys.join("changed.key").exists());
        if let Ok(changed) = done {
            assert_eq!(changed, [keys.join("authority.key"), keys.join("successor.key")]);
            assert_eq!(count, 4, "the number of writes");
            break;
        }
        if count > 0 {
            (present, next) = (next, present);
        }
    }
    Authority::open_with(&keys, next).unwrap().remove_passphrase().unwrap();
    assert!(!is_encrypted(&keys, "authority.key") && !is_encrypted(&keys, "successor.key"));
    let authority = Authority::open_with(&keys, next).unwrap();
    assert_eq!(asked(|| authority.end(End::Always, calendar()).unwrap()), 0);
}

#[test]
fn interrupted_replacement_with_a_passphrase_continues() {
    for is_end in [false, true] {
        let take_step = |authority: &Authority| {
            if is_end { authority.end(End::Always, calendar()) } else { authority.rotate(calendar()) }
        };
        for count in 0.. {
            let folder = TempDir::new().unwrap();
            let keys = protected(folder.path());
            let open = || Authority::open_with(&keys, sesame).unwrap();
            if is_end {
                open().rotate(calendar()).unwrap();
            }
            let done = files::interruption::after(count, || take_step(&open()));
            assert!(asked(|| drop(open())) <= 1, "{count}");
            let again = take_step(&open());
            let is_done = matches!(again, Err(KeysError::Rotating(_) | KeysError::NotRotating(_)));
            assert!(again.is_ok() || is_done, "{count}: {again:?}");
            assert!(is_encrypted(&keys, "authority.key"));
            assert_eq!(keys.join("successor.key").exists(), !is_end);
            open().renew(&robot("cf1"), calendar(), 10).unwrap();
            if done.is_ok() {
                break;
            }
        }
    }
}
