//! Tests in which robots and operators authenticate each other with issued certificates in real handshakes.

use std::collections::BTreeSet;
use std::os::unix::fs::PermissionsExt;
use std::sync::Arc;

use downbeat_robot::tls::{
    Credentials, CredentialsError, Identity, Name, Revoked, SERVER_NAME, client_config, server_config,
};
use downbeat_robot::{KeyFileError, Role, Roles};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustls::pki_types::ServerName;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_rustls::{TlsAcceptor, TlsConnector};

use super::*;

mod own_pki;
mod protected;
mod requests;
mod rotation;

fn robot(id: &str) -> Name {
    Name::Robot(id.parse().unwrap())
}

struct Site {
    folder: TempDir,
    authority: Authority,
}

impl Site {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        let authority = Authority::create(&folder.path().join("keys"), calendar()).unwrap();
        Self { folder, authority }
    }

    fn of(&self, name: &Name, roles: &[Role]) -> Credentials {
        self.until(name, roles, calendar(), 10)
    }

    fn of_secret(&self, robot: &RobotId, if_there: IfThere) -> Result<PathBuf, KeysError> {
        let made = self.authority.make_secrets(&BTreeSet::from([robot.clone()]), if_there);
        made.map(|mut files| files.remove(0))
    }

    fn until(&self, name: &Name, roles: &[Role], from: i64, days: i64) -> Credentials {
        let roles = roles.iter().copied().collect();
        let paths = self.authority.issue(&BTreeSet::from([name.clone()]), &roles, from, days).unwrap();
        Credentials::read(&paths[0]).unwrap()
    }

    fn revoked(&self) -> Revoked {
        Revoked::in_file(&self.authority.revoked()).unwrap()
    }
}

/// Performs a real handshake and exchanges one message in each direction. Returns the peers' names, or the error on each side.
fn meet(
    robot: &Credentials,
    operator: &Credentials,
    revoked: Option<&Revoked>,
) -> (Result<Identity, String>, Result<Identity, String>) {
    let list = |own: &Credentials| revoked.map(|revoked| own.list(revoked).unwrap());
    let server = Arc::new(server_config(robot, list(robot).as_ref()).unwrap());
    let client = Arc::new(client_config(operator, list(operator).as_ref()).unwrap());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let (near, far) = tokio::io::duplex(64 * 1024);
        let accepted = async {
            let mut stream = TlsAcceptor::from(server).accept(far).await.map_err(|e| e.to_string())?;
            stream.write_all(b"robot").await.map_err(|e| e.to_string())?;
            let mut word = [0; 8];
            stream.read_exact(&mut word).await.map_err(|e| e.to_string())?;
            let certificate = stream.get_ref().1.peer_certificates().unwrap()[0].clone();
            Ok(Identity::of_certificate(&certificate).unwrap())
        };
        let connected = async {
            let name = ServerName::try_from(SERVER_NAME).unwrap();
            let mut stream =
                TlsConnector::from(client).connect(name, near).await.map_err(|e| e.to_string())?;
            stream.write_all(b"operator").await.map_err(|e| e.to_string())?;
            let mut word = [0; 5];
            stream.read_exact(&mut word).await.map_err(|e| e.to_string())?;
            let certificate = stream.get_ref().1.peer_certificates().unwrap()[0].clone();
            Ok(Identity::of_certificate(&certificate).unwrap())
        };
        tokio::join!(accepted, connected)
    })
}

const OPERATOR: &str = "anna";

fn operator() -> Name {
    Name::Operator(OPERATOR.into())
}

#[test]
fn robot_and_operator_of_same_authority_authenticate_each_other() {
    let site = Site::new();
    let cf1 = site.of(&robot("cf 1/ö"), &[]);
    let anna = site.of(&operator(), &[Role::Observe, Role::Stop]);
    let (met_by_robot, met_by_operator) = meet(&cf1, &anna, Some(&site.revoked()));
    let met = met_by_robot.unwrap();
    assert_eq!((met.name, met.roles.to_string()), (operator(), "observe, stop".to_owned()));
    assert_eq!(met_by_operator.unwrap().name, robot("cf 1/ö"));
}

#[test]
fn operator_of_another_authority_is_refused() {
    let (site, other) = (Site::new(), Site::new());
    let (by_robot, by_operator) =
        meet(&site.of(&robot("cf1"), &[]), &other.of(&operator(), &Role::ALL), None);
    assert!(by_robot.is_err() && by_operator.is_err());
}

#[test]
fn expired_or_not_yet_valid_certificate_is_refused() {
    let site = Site::new();
    let cf1 = site.of(&robot("cf1"), &[]);
    let expired = site.until(&operator(), &Role::ALL, calendar() - 20 * DAY, 10);
    let (refused, _) = meet(&cf1, &expired, None);
    assert!(refused.unwrap_err().contains("xpired"));
    let early = site.until(&Name::Operator("early".into()), &Role::ALL, calendar() + 2 * DAY, 10);
    let (refused, _) = meet(&cf1, &early, None);
    assert!(refused.unwrap_err().contains("alid"));
    let old = site.until(&robot("old"), &[], calendar() - 20 * DAY, 10);
    let anna = site.of(&Name::Operator("late".into()), &Role::ALL);
    let (_, refused) = meet(&old, &anna, None);
    assert!(refused.unwrap_err().contains("xpired"));
}

#[test]
fn revoked_keys_are_refused_on_next_connection_and_renewed_ones_accepted() {
    let site = Site::new();
    let (cf1, cf2) = (site.of(&robot("cf1"), &[]), site.of(&robot("cf2"), &[]));
    let anna = site.of(&operator(), &Role::ALL);
    let revoked = site.revoked();
    assert!(meet(&cf1, &anna, Some(&revoked)).0.is_ok());
    assert_eq!(site.authority.revoke(&operator(), calendar()).unwrap(), 1);
    let (refused, _) = meet(&cf1, &anna, Some(&revoked));
    assert!(refused.unwrap_err().contains("evoked"));
    assert!(matches!(
        site.authority.revoke(&operator(), calendar()),
        Err(KeysError::RevokedAlready(name)) if name == operator()
    ));
    let path = site.authority.renew(&operator(), calendar(), 10).unwrap();
    let again = Credentials::read(&path).unwrap();
    assert_eq!(again.identity().roles, Role::ALL.into_iter().collect());
    assert!(meet(&cf1, &again, Some(&revoked)).0.is_ok());
    site.authority.revoke(&robot("cf2"), calendar()).unwrap();
    let (_, refused) = meet(&cf2, &again, Some(&revoked));
    assert!(refused.unwrap_err().contains("evoked"));
}

#[test]
fn one_certificate_of_an_operator_can_be_revoked() {
    let site = Site::new();
    let (cf1, old) = (site.of(&robot("cf1"), &[]), site.of(&operator(), &Role::ALL));
    let new = Credentials::read(&site.authority.renew(&operator(), calendar(), 10).unwrap()).unwrap();
    let (serial, revoked) = (old.identity().serial.clone(), site.revoked());
    let (name, certificate) = site.authority.with_serial(&serial[..11].to_uppercase()).unwrap();
    assert_eq!((&name, &certificate.serial), (&operator(), &serial));
    site.authority.revoke_certificate(&name, &certificate, calendar()).unwrap();
    assert!(meet(&cf1, &old, Some(&revoked)).0.unwrap_err().contains("evoked"));
    assert!(meet(&cf1, &new, Some(&revoked)).0.is_ok());
    let again = site.authority.revoke_certificate(&name, &certificate, calendar());
    assert!(matches!(again, Err(KeysError::RevokedAlready(owner)) if owner == name));
    assert!(matches!(site.authority.with_serial("xx"), Err(KeysError::NoSerial(_))));
    assert!(matches!(site.authority.with_serial(""), Err(KeysError::AmbiguousSerial(_))));
}

#[test]
fn folder_that_others_could_change_is_refused() {
    let folder = TempDir::new().unwrap();
    let keys = folder.path().join("keys");
    let refused = |keys: &Path| match Authority::create(keys, calendar()) {
        Err(KeysError::NotPrivate(fault)) => fault.to_string(),
        other => panic!("{other:?}"),
    };
    std::fs::create_dir(&keys).unwrap();
    std::fs::set_permissions(&keys, std::fs::Permissions::from_mode(0o777)).unwrap();
    assert!(refused(&keys).contains("is writable by other users"));
    std::fs::set_permissions(&keys, std::fs::Permissions::from_mode(0o755)).unwrap();
    let link = folder.path().join("link");
    std::os::unix::fs::symlink(&keys, &link).unwrap();
    assert!(refused(&link).contains("is a symbolic link"));
    assert_eq!(std::fs::read_dir(&keys).unwrap().count(), 0, "nothing was written");
    drop(Authority::create(&keys, calendar()).unwrap());
    assert_eq!(std::fs::metadata(&keys).unwrap().permissions().mode() & 0o777, 0o700);
    assert_eq!(
        std::fs::read_to_string(keys.join(".gitignore")).unwrap(),
        "# Keys must not be published.\n*\n"
    );
    let key = keys.join("authority.key");
    std::fs::rename(&key, keys.join("moved")).unwrap();
    std::os::unix::fs::symlink("moved", &key).unwrap();
    assert!(matches!(Authority::open(&keys), Err(KeysError::NotPrivate(_))));
    std::fs::remove_file(&key).unwrap();
    std::fs::rename(keys.join("moved"), &key).unwrap();
    std::fs::set_permissions(&key, std::fs::Permissions::from_mode(0o640)).unwrap();
    assert!(Authority::open(&keys).unwrap_err().to_string().contains("other users can read this key"));
}

#[test]
fn robot_key_cannot_act_as_operator_nor_operator_key_as_robot() {
    let site = Site::new();
    let (cf1, cf2) = (site.of(&robot("cf1"), &[]), site.of(&robot("cf2"), &[]));
    let anna = site.of(&operator(), &Role::ALL);
    assert!(meet(&cf1, &cf2, None).0.is_err(), "a robot's key drives no robot");
    assert!(meet(&anna, &anna, None).1.is_err(), "an operator's key pretends to be no robot");
}

#[test]
fn keys_are_private_and_issued_only_once() {
    let site = Site::new();
    let keys = site.folder.path().join("keys");
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let issue = |names: &[&str]| {
        let names = names.iter().map(|name| robot(name)).collect();
        site.authority.issue(&names, &Roles::default(), calendar(), 10)
    };
    let path = issue(&["../cf1"]).unwrap().remove(0);
    assert_eq!(path.parent(), Some(keys.join("robots").as_path()));
    assert_eq!((mode(&keys), mode(&keys.join("authority.key")), mode(&path)), (0o700, 0o600, 0o600));
    let taken = issue(&["../cf1", "cf2"]).unwrap_err().to_string();
    assert_eq!(taken, "robot ../cf1 already has a key; create a new one with `downbeat keys renew`");
    assert_eq!(issue(&["cf2", "cf3", "cf2"]).unwrap().len(), 2, "nothing was made of what was refused");
    let taken = issue(&["cf4", "cf3", "cf2"]).unwrap_err().to_string();
    assert!(taken.starts_with("robot cf2, robot cf3 already have keys; "), "{taken}");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o640)).unwrap();
    assert!(matches!(
        Credentials::read(&path),
        Err(CredentialsError::File(KeyFileError::NotPrivate { mode: 0o640, .. }))
    ));
    let unknown = site.authority.revoke(&robot("cf9"), calendar()).unwrap_err().to_string();
    assert_eq!(unknown, "robot cf9 has no key in this folder; names with a key: ../cf1, cf2, cf3");
}

#[test]
fn authority_is_created_once_and_must_exist_to_be_opened() {
    let site = Site::new();
    let keys = site.folder.path().join("keys");
    drop(site.authority);
    assert!(matches!(Authority::create(&keys, calendar()), Err(KeysError::Exists(_))));
    assert!(Authority::open(&keys).is_ok());
    assert!(matches!(Authority::open(site.folder.path()), Err(KeysError::NoAuthority(_))));
    std::fs::write(keys.join("issued.jsonl"), "{}\n").unwrap();
    let damaged = Authority::open(&keys).unwrap().issued().unwrap_err().to_string();
    assert!(
        damaged.ends_with("line 1: invalid certificate entry, expected an entry written by `downbeat keys`"),
        "{damaged}"
    );
}

#[test]
fn pipe_in_place_of_key_file_is_refused_without_waiting() {
    let site = Site::new();
    let keys = site.folder.path().join("keys");
    for name in ["issued.jsonl", "revoked.pem"] {
        let path = keys.join(name);
        let _there_or_not = std::fs::remove_file(&path);
        mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
    }
    let record = site.authority.issued().unwrap_err().to_string();
    assert!(record.ends_with("this is a pipe, not a file"), "{record}");
    let list = Revoked::in_file(&site.authority.revoked()).unwrap_err().to_string();
    assert!(
        list.contains("this is not a regular file; expected a file that `downbeat keys` wrote"),
        "{list}"
    );
}

#[test]
fn authority_certificate_is_not_accepted_as_revocation_list() {
    let site = Site::new();
    let authority = site.folder.path().join("keys/authority.pem");
    let no_list = Revoked::in_file(&authority).unwrap_err().to_string();
    assert!(no_list.ends_with("expected the file `revoked.pem` that `downbeat keys` wrote"), "{no_list}");
}

fn passes(site: &Site, operator: &str) -> Option<String> {
    std::fs::read_to_string(site.folder.path().join(format!("keys/operators/{operator}.passes"))).ok()
}

#[test]
fn operator_has_pass_for_each_robot_with_secret_until_either_is_revoked() {
    let site = Site::new();
    site.of(&operator(), &[Role::Drive]);
    assert!(passes(&site, OPERATOR).is_none());
    let (cf1, cf2) = ("cf 1/ö".parse().unwrap(), "cf2".parse().unwrap());
    let secret = site.of_secret(&cf1, IfThere::Keep).unwrap();
    site.of_secret(&cf2, IfThere::Keep).unwrap();
    // An operator who is added later has passes as well.
    site.of(&Name::Operator("bert".into()), &[Role::Observe]);
    let path = site.folder.path().join("keys/operators/anna.passes");
    for private in [&secret, &path] {
        assert_eq!(std::fs::metadata(private).unwrap().permissions().mode() & 0o777, 0o600);
    }
    let read = sealed::Passes::read(&path).unwrap();
    assert_eq!(read.held().len(), 2);
    let held = read.of(&cf1).unwrap();
    let certificate = site.authority.issued().unwrap().latest(&operator()).unwrap().clone();
    assert_eq!((held.claim.expires, &held.claim.serial), (certificate.expires, &certificate.serial));
    assert_eq!(held.claim.to_string().split(' ').nth(2), Some("drive"));
    assert_eq!(site.authority.robots_with_secret().unwrap(), [cf1.clone(), cf2.clone()]);

    let cf3: RobotId = "cf3".parse().unwrap();
    let both = [cf1.clone(), cf3].into();
    let taken = site.authority.make_secrets(&both, IfThere::Keep).unwrap_err().to_string();
    assert!(taken.starts_with("robot cf 1/ö already has a secret; "), "{taken}");
    assert_eq!(site.authority.robots_with_secret().unwrap(), [cf1.clone(), cf2.clone()], "none of them");
    let (before, anna) = (std::fs::read(&secret).unwrap(), passes(&site, OPERATOR));
    site.of_secret(&cf1, IfThere::Replace).unwrap();
    assert!(std::fs::read(&secret).unwrap() != before && passes(&site, OPERATOR) != anna);

    assert_eq!(site.authority.revoke(&Name::Robot(cf1), calendar()).unwrap(), 1);
    assert!(!secret.exists());
    assert_eq!(sealed::Passes::read(&path).unwrap().held().len(), 1);

    let serials = || std::fs::read_to_string(site.authority.revoked_serials()).unwrap();
    assert!(!serials().contains(&certificate.serial));
    site.authority.revoke(&operator(), calendar()).unwrap();
    assert!(serials().contains(&format!("\n{}\n", certificate.serial)));
    assert!(passes(&site, OPERATOR).is_none() && passes(&site, "bert").is_some());
    site.authority.renew(&operator(), calendar(), 10).unwrap();
    assert!(passes(&site, OPERATOR).is_some_and(|passes| !passes.contains(&certificate.serial)));
}

#[test]
fn passes_for_a_thousand_robots_are_all_read() {
    let site = Site::new();
    site.of(&operator(), &[Role::Drive]);
    site.of_secret(&"r0".parse().unwrap(), IfThere::Keep).unwrap();
    let path = site.folder.path().join("keys/operators/anna.passes");
    let text = std::fs::read_to_string(&path).unwrap();
    let line = text.lines().find(|line| line.starts_with("r0 ")).unwrap();
    let lines: String =
        (0..1_000).map(|i| format!("{}\n", line.replacen("r0 ", &format!("r{i} "), 1))).collect();
    std::fs::write(&path, lines).unwrap();
    assert_eq!(sealed::Passes::read(&path).unwrap().held().len(), 1_000);
    std::fs::write(&path, "#".repeat(17 * 1024 * 1024)).unwrap();
    let too_long = sealed::Passes::read(&path).unwrap_err().to_string();
    assert!(too_long.contains("the file is larger than 16777216 bytes"), "{too_long}");
}
