//! Tests statements, guards and lists of revoked certificates with the identities of a test authority, which are valid until 2120.
//!
//! `fixtures` contains identity files as `downbeat keys` writes them, with keys that are not used elsewhere: `anna`; `nobody`, whose
//! certificate contains no name of this protocol; `robot`; and `stranger`, an operator of another authority. It also contains lists of
//! revoked certificates.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use rustls::pki_types::ServerName;
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsConnector;

use super::*;
use urrcp::Role;

/// A folder that only one test uses. It is deleted when this value is dropped.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("downbeat-tls-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::SeqCst));
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// Copies a fixture so that only its owner can read it.
    fn copy(&self, fixture: &str, name: &str) -> PathBuf {
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/tls/fixtures").join(fixture);
        let path = self.0.join(name);
        std::fs::copy(from, &path).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        path
    }

    fn credentials(&self, name: &str) -> Credentials {
        Credentials::read(&self.copy(&format!("{name}.pem"), name)).unwrap()
    }

    /// Creates an empty list of revoked certificates.
    fn list(&self) -> Revoked {
        Revoked::in_file(&self.copy("none-revoked.pem", "revoked.pem")).unwrap()
    }

    /// Replaces the list of revoked certificates with the fixture.
    fn revoke(&self, fixture: &str) {
        self.copy(fixture, "revoked.pem");
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _never_written = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn identity_file_contains_name_and_roles_of_its_owner() {
    let folder = Folder::new();
    let anna = folder.credentials("anna");
    assert_eq!(anna.identity().name.to_string(), "operator anna");
    assert_eq!(anna.identity().roles, [Role::Observe, Role::Drive].into_iter().collect());
    assert_eq!(anna.identity().expires, 4_733_510_400, "in 2120");
    let proof = anna.identity().proof().unwrap();
    assert_eq!((proof.name.as_str(), proof.roles), ("operator anna", anna.identity().roles.clone()));
    let robot = folder.credentials("robot");
    assert_eq!(robot.identity().name, Name::Robot("r0".parse().unwrap()));
    assert_eq!(robot.identity().roles.to_string(), "no role");
}

#[test]
fn identity_is_written_as_the_uris_it_is_read_from() {
    let roles = [Role::Stop, Role::Drive].into_iter().collect();
    let uris = Identity::uris(&Name::Operator("anna ö/1".to_owned()), &roles);
    assert_eq!(uris, ["urrcp:operator:anna%20%C3%B6%2F1", "urrcp:role:drive", "urrcp:role:stop"]);
    let robot = Identity::uris(&Name::Robot("cf 1".parse().unwrap()), &[].into_iter().collect());
    assert_eq!(robot, ["urrcp:robot:cf%201"]);
}

#[test]
fn invalid_identity_file_is_rejected_with_a_specific_reason() {
    let folder = Folder::new();
    let anna = std::fs::read_to_string(folder.copy("anna.pem", "anna")).unwrap();
    let parts: Vec<&str> = anna.split_inclusive("-----\n").collect();
    let [key, certificate, authority] = [&parts[..2], &parts[2..4], &parts[4..6]].map(|part| part.concat());
    let whole = [key.as_str(), &certificate, &authority];
    assert_eq!(whole.concat(), anna);
    for (text, expected) in [
        (whole[1..].concat(), "missing private key"),
        (whole[..2].concat(), "it contains 1 certificates, expected two"),
        (
            [anna.as_str(), &authority, &authority].concat(),
            "it contains 4 certificates, expected two or three",
        ),
    ] {
        let path = folder.copy("anna.pem", "part");
        std::fs::write(&path, text).unwrap();
        let error = Credentials::read(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let nameless = Credentials::read(&folder.copy("nobody.pem", "nobody")).unwrap_err().to_string();
    assert!(nameless.contains("has 0 names"), "{nameless}");
    let list = Revoked::in_file(&folder.copy("anna.pem", "no-list")).unwrap_err().to_string();
    assert!(list.contains("missing list of revoked certificates"), "{list}");
    assert!(matches!(Identity::of_certificate(b"no certificate"), Err(IdentityError::NotACertificate)));
}

#[test]
fn statement_is_attributed_to_the_operator_that_signed_it() {
    let folder = Folder::new();
    let witness = Witness::new(folder.credentials("robot"), None).unwrap();
    assert_eq!(witness.identity().name.to_string(), "robot r0");
    let who =
        |statement: &[u8], signed: &Signed| witness.who(statement, signed).map(|who| who.name.to_string());
    let anna = folder.credentials("anna");
    let signed = anna.sign(b"stop").unwrap();
    assert_eq!(who(b"stop", &signed), Ok("operator anna".to_owned()));
    assert_eq!(who(b"start", &signed), Err("its signature does not match".to_owned()));
    let mixed = Signed { signature: folder.credentials("robot").sign(b"stop").unwrap().signature, ..signed };
    assert_eq!(who(b"stop", &mixed), Err("its signature does not match".to_owned()));
}

#[test]
fn statement_of_a_robot_or_of_another_authority_is_rejected() {
    let folder = Folder::new();
    let witness = Witness::new(folder.credentials("robot"), None).unwrap();
    let signed = |name| folder.credentials(name).sign(b"stop").unwrap();
    let refused = |name| witness.who(b"stop", &signed(name)).unwrap_err();
    assert_eq!(refused("robot"), "robot r0 is not an operator");
    assert!(refused("stranger").starts_with("its certificate is not valid here"));
    let damaged = Signed { certificate: b"no certificate".to_vec(), ..signed("anna") };
    assert!(witness.who(b"stop", &damaged).is_err());
}

#[test]
fn statement_of_revoked_operator_is_rejected_even_if_list_is_damaged() {
    let folder = Folder::new();
    let witness = Witness::new(folder.credentials("robot"), Some(folder.list())).unwrap();
    let signed = folder.credentials("anna").sign(b"stop").unwrap();
    assert!(witness.who(b"stop", &signed).is_ok());
    folder.revoke("anna-revoked.pem");
    assert!(witness.who(b"stop", &signed).is_err());
    for unusable in ["anna.pem", "of-another-authority.pem", "none-revoked.pem"] {
        folder.revoke(unusable);
        assert!(witness.who(b"stop", &signed).is_err(), "{unusable}: the last good list applies");
    }
    folder.revoke("anna-restored.pem");
    assert!(witness.who(b"stop", &signed).is_ok());
}

/// Connects to a robot with the identity `client`. Returns the name of the operator that the robot sees, or the error.
async fn meets(guard: &Guard, client: &Credentials) -> Result<String, String> {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let config = Arc::new(client_config(client, None).unwrap());
    let connecting = async {
        let stream = TcpStream::connect(address).await.unwrap();
        let name = ServerName::try_from(SERVER_NAME).unwrap();
        TlsConnector::from(config).connect(name, stream).await.map_err(|error| error.to_string())
    };
    let accepting = async { guard.accept(listener.accept().await.unwrap().0).await };
    let (connected, accepted) = tokio::join!(connecting, accepting);
    let (_stream, identity) = accepted.map_err(|error| error.to_string())?;
    connected?;
    Ok(identity.name.to_string())
}

#[tokio::test]
async fn only_operators_of_its_own_authority_are_admitted() {
    let folder = Folder::new();
    let guard = Guard::new(folder.credentials("robot"), None).unwrap();
    assert_eq!(guard.identity().name.to_string(), "robot r0");
    assert_eq!(meets(&guard, &folder.credentials("anna")).await, Ok("operator anna".to_owned()));
    assert!(meets(&guard, &folder.credentials("stranger")).await.is_err());
}

#[tokio::test]
async fn only_a_newer_list_of_the_same_authority_replaces_the_current_list() {
    let folder = Folder::new();
    let guard = Guard::new(folder.credentials("robot"), Some(folder.list())).unwrap();
    let anna = folder.credentials("anna");
    let number = || guard.list().unwrap().number();
    let modified = std::fs::metadata(folder.0.join("revoked.pem")).unwrap().modified().unwrap();
    let lists = [
        ("none-revoked.pem", 1, true),
        ("anna-revoked.pem", 2, false),
        ("anna.pem", 2, false),
        ("none-revoked.pem", 2, false),
        ("of-another-authority.pem", 2, false),
        ("forged.pem", 2, false),
        ("anna-restored.pem", 300, true),
        ("anna-revoked.pem", 300, true),
        ("overdue.pem", 301, false),
    ];
    for (list, expected, is_admitted) in lists {
        folder.revoke(list);
        // A list that is as old as the previous one is read too.
        let file = std::fs::File::options().write(true).open(folder.0.join("revoked.pem")).unwrap();
        file.set_modified(modified).unwrap();
        assert_eq!(meets(&guard, &anna).await.is_ok(), is_admitted, "{list}");
        assert_eq!(number(), Some(expected), "{list}");
    }
    std::fs::remove_file(folder.0.join("revoked.pem")).unwrap();
    assert!(meets(&guard, &anna).await.is_err(), "the last good list applies");
}

#[test]
fn revocation_list_of_another_authority_is_refused_at_the_start() {
    let folder = Folder::new();
    for foreign in ["of-another-authority.pem", "forged.pem"] {
        let list = Revoked::in_file(&folder.copy(foreign, "revoked.pem")).unwrap();
        let own = || folder.credentials("robot");
        let refused = [
            Guard::new(own(), Some(list.clone())).map(|_| ()).unwrap_err(),
            Witness::new(own(), Some(list.clone())).map(|_| ()).unwrap_err(),
            own().list(&list).map(|_| ()).unwrap_err().to_string(),
        ];
        assert!(refused.iter().all(|error| error.contains("signed by another authority")), "{refused:?}");
    }
}

#[test]
fn revocation_list_states_revoked_keys_and_when_the_next_list_is_due() {
    let folder = Folder::new();
    let anna = folder.credentials("anna").identity().serial.clone();
    let read = |name: &str| {
        let list = Revoked::in_file(&folder.copy(name, "revoked.pem")).unwrap();
        folder.credentials("robot").list(&list).unwrap()
    };
    let [none, one, overdue] = ["none-revoked.pem", "anna-revoked.pem", "overdue.pem"].map(read);
    let authority = folder.credentials("anna").identity().authority.clone();
    let excluded = |list: &List| list.exclusion(&authority, &anna);
    assert_eq!(
        [&none, &one, &overdue].map(excluded),
        [None, Some(Exclusion::Revoked), Some(Exclusion::Revoked)]
    );
    assert_eq!(one.exclusion("CN=other", "00"), Some(Exclusion::AuthorityEnded));
    assert_eq!([&none, &one, &overdue].map(List::issued), [1_577_836_800; 3], "in 2020");
    let in_2026 = 1_795_000_000;
    assert_eq!([&none, &one, &overdue].map(|list| list.is_overdue(in_2026)), [false, false, true]);
}

#[test]
fn received_list_is_stored_only_if_newer_and_of_the_same_authority() {
    let folder = Folder::new();
    let guard = Guard::new(folder.credentials("robot"), Some(folder.list())).unwrap();
    let text = |name: &str| std::fs::read_to_string(folder.copy(name, "sent")).unwrap();
    let stored = || std::fs::read_to_string(folder.0.join("revoked.pem")).unwrap();
    let none = stored();
    for refused in ["of-another-authority.pem", "forged.pem", "anna.pem"] {
        assert!(guard.replace_list(&text(refused)).is_err(), "{refused}");
        assert_eq!(stored(), none, "{refused}");
    }
    guard.replace_list(&text("anna-revoked.pem")).unwrap();
    assert_eq!((stored(), guard.list().unwrap().number()), (text("anna-revoked.pem"), Some(2)));
    guard.replace_list(&text("anna-revoked.pem")).unwrap();
    let older = guard.replace_list(&text("none-revoked.pem")).unwrap_err();
    assert_eq!((older.as_str(), stored()), ("it is older than the version in use", text("anna-revoked.pem")));
    let without = Guard::new(folder.credentials("robot"), None).unwrap();
    assert!(without.replace_list(&text("anna-revoked.pem")).unwrap_err().contains("--revoked"));
}
