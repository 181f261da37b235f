//! Tests of keys that are made outside the authority's folder.

use rcgen::{PKCS_ECDSA_P384_SHA384, PKCS_ED25519};

use super::*;

fn terms(roles: &[Role]) -> Terms {
    Terms { roles: roles.iter().copied().collect(), from: calendar(), days: 10, is_renewal: false }
}

fn mode(path: &Path) -> u32 {
    std::fs::metadata(path).unwrap().permissions().mode() & 0o777
}

/// Makes a key in a folder of its own, has it signed and installs the certificate. Returns the complete identity.
fn certified(site: &Site, name: &Name, wished: &[Role], granted: &[Role]) -> Credentials {
    let wished = wished.iter().copied().collect();
    let own = TempDir::new().unwrap();
    let made = request(own.path(), name, &wished).unwrap();
    assert_eq!((mode(&made.key), mode(&made.request)), (0o600, 0o644));
    let asked = Request::read(&made.request).unwrap();
    assert_eq!((asked.name(), asked.wished(), asked.fingerprint()), (name, &wished, made.fingerprint));
    let signed = site.authority.sign(&asked, &terms(granted), own.path()).unwrap();
    let text = std::fs::read_to_string(&signed.certificate).unwrap();
    assert!(!text.contains("PRIVATE KEY"), "{text}");
    let installed = install(&signed.certificate, &made.key, &signed.authorities).unwrap();
    assert_eq!(mode(&made.key), 0o600);
    assert_eq!(installed.identity, signed.identity);
    Credentials::read(&installed.file).unwrap()
}

#[test]
fn requested_keys_are_equal_to_those_made_by_the_authority() {
    let site = Site::new();
    let cf1 = certified(&site, &robot("cf 1/ö"), &[], &[]);
    let anna = certified(&site, &operator(), &[Role::Observe], &[Role::Drive, Role::Stop]);
    let (by_robot, by_operator) = meet(&cf1, &anna, Some(&site.revoked()));
    assert_eq!(by_operator.unwrap().name, robot("cf 1/ö"));
    assert_eq!(
        by_robot.unwrap().roles,
        [Role::Drive, Role::Stop].into_iter().collect(),
        "not the requested roles"
    );
    // The keys are nowhere in the authority's folder.
    let keys = site.folder.path().join("keys");
    for kind in ["robots", "operators"] {
        assert_eq!(std::fs::read_dir(keys.join(kind)).unwrap().count(), 0, "{kind}");
    }
    assert_eq!(site.authority.revoke(&operator(), calendar()).unwrap(), 1);
    assert!(meet(&cf1, &anna, Some(&site.revoked())).0.unwrap_err().contains("evoked"));
}

#[test]
fn only_the_authority_grants_roles() {
    let (site, own) = (Site::new(), TempDir::new().unwrap());
    let wished = Role::ALL.into_iter().collect();
    let made = request(own.path(), &operator(), &wished).unwrap();
    let asked = Request::read(&made.request).unwrap();
    let refused = site.authority.sign(&asked, &terms(&[]), own.path()).unwrap_err().to_string();
    assert!(refused.contains("operator anna asks for the roles observe, drive, stop, seize"), "{refused}");
    assert!(refused.contains("add --role"), "{refused}");
    let cf1 = request(own.path(), &robot("cf1"), &Roles::default()).unwrap();
    let refused =
        site.authority.sign(&Request::read(&cf1.request).unwrap(), &terms(&[Role::Drive]), own.path());
    assert!(matches!(refused, Err(KeysError::RolesOfRobot)));
    assert!(site.authority.issued().unwrap().entries().is_empty(), "nothing was signed");
}

#[test]
fn renewal_needs_another_request_and_consent() {
    let (site, own) = (Site::new(), TempDir::new().unwrap());
    let cf1 = robot("cf1");
    certified(&site, &cf1, &[], &[]);
    let refused = site.authority.renew(&cf1, calendar(), 10).unwrap_err().to_string();
    assert!(refused.contains("`downbeat keys request robot cf1`"), "{refused}");
    let asked = Request::read(&request(own.path(), &cf1, &Roles::default()).unwrap().request).unwrap();
    let refused = site.authority.sign(&asked, &terms(&[]), own.path()).unwrap_err().to_string();
    assert!(
        refused.contains("robot cf1 already has a certificate") && refused.contains("--renew"),
        "{refused}"
    );
    let renewal = Terms { is_renewal: true, ..terms(&[]) };
    site.authority.sign(&asked, &renewal, own.path()).unwrap();
    assert_eq!(site.authority.issued().unwrap().entries().len(), 2);
    let again = site.authority.sign(&asked, &renewal, own.path());
    assert!(matches!(again, Err(KeysError::FileExists(_))), "{again:?}");
    assert_eq!(site.authority.issued().unwrap().entries().len(), 2, "nothing was signed");
    let unknown =
        Request::read(&request(own.path(), &robot("cf2"), &Roles::default()).unwrap().request).unwrap();
    let unknown = site.authority.sign(&unknown, &renewal, own.path());
    assert!(matches!(unknown, Err(KeysError::Unknown { .. })), "{unknown:?}");
}

#[test]
fn operator_with_requested_key_has_passes_at_the_authority() {
    let (site, own) = (Site::new(), TempDir::new().unwrap());
    site.of_secret(&"mcu1".parse().unwrap(), IfThere::Keep).unwrap();
    let asked = Request::read(&request(own.path(), &operator(), &Roles::default()).unwrap().request).unwrap();
    let signed = site.authority.sign(&asked, &terms(&[Role::Drive]), own.path()).unwrap();
    let held = sealed::Passes::read(&signed.passes.unwrap()).unwrap();
    assert_eq!(held.held()[0].claim.serial, signed.identity.serial);
}

#[test]
fn key_or_request_is_never_overwritten() {
    let own = TempDir::new().unwrap();
    let made = request(own.path(), &robot("cf1"), &Roles::default()).unwrap();
    let before = (std::fs::read(&made.key).unwrap(), std::fs::read(&made.request).unwrap());
    for gone in [None, Some(&made.request), Some(&made.key)] {
        gone.map(std::fs::remove_file).transpose().unwrap();
        let again = request(own.path(), &robot("cf1"), &Roles::default());
        assert!(matches!(again, Err(KeysError::FileExists(_))), "{again:?}");
        std::fs::write(&made.key, &before.0).unwrap();
        std::fs::write(&made.request, &before.1).unwrap();
    }
    assert_eq!(std::fs::read_dir(own.path()).unwrap().count(), 2);
}

/// Returns a request with these URIs, signed by a key of this kind.
fn request_of(key: &KeyPair, uris: &[&str]) -> String {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    for uri in uris {
        params.subject_alt_names.push(SanType::URI((*uri).try_into().unwrap()));
    }
    params.serialize_request(key).unwrap().pem().unwrap()
}

#[test]
fn unusable_request_is_refused_with_its_reason() {
    let own = TempDir::new().unwrap();
    let path = own.path().join("x.csr");
    let refused = |text: &[u8]| {
        std::fs::write(&path, text).unwrap();
        let error = Request::read(&path).unwrap_err().to_string();
        assert!(error.contains("x.csr: "), "{error}");
        error
    };
    let key = KeyPair::generate().unwrap();
    let of = |uris: &[&str]| refused(request_of(&key, uris).as_bytes());
    assert!(of(&[]).contains("it has 0 names that begin with"));
    assert!(of(&["urrcp:robot:a", "urrcp:robot:b"]).contains("it has 2 names"));
    assert!(of(&["urrcp:robot:a", "urrcp:operator:a"]).contains("it has 2 names"));
    assert!(of(&["urrcp:operator:a", "urrcp:role:god"]).contains("invalid name `urrcp:role:god`"));
    assert!(of(&["urrcp:robot:"]).contains("invalid name"));
    assert!(of(&["urrcp:robot:%ff"]).contains("invalid name"));
    assert!(of(&["urrcp:operator:%0a"]).contains("without line breaks"));
    assert!(of(&[&format!("urrcp:operator:{}", "a".repeat(257))]).contains("1 to 256 characters"));
    for other in [&PKCS_ECDSA_P384_SHA384, &PKCS_ED25519] {
        let key = KeyPair::generate_for(other).unwrap();
        assert!(refused(request_of(&key, &["urrcp:robot:a"]).as_bytes()).contains("curve P-256"));
    }
    for other in ["", "cf1", "-----BEGIN CERTIFICATE REQUEST-----\nAAAA\n-----END CERTIFICATE REQUEST-----\n"]
    {
        assert!(refused(other.as_bytes()).contains("this is not a request for a certificate"));
    }
    let site = Site::new();
    let authority = std::fs::read(site.folder.path().join("keys/authority.pem")).unwrap();
    assert!(refused(&authority).contains("this is not a request"));
    assert!(refused(&vec![b'a'; 40_000]).contains("larger than 32768 bytes"));
    std::fs::remove_file(&path).unwrap();
    assert!(Request::read(&path).unwrap_err().to_string().contains("x.csr: No such file"));
    mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
    assert!(Request::read(&path).unwrap_err().to_string().contains("not a regular file"));
}

/// Maximum length in bytes of the signature of a request, with its algorithm.
const SIGNATURE_MAX: usize = 12 + 75;

#[test]
fn request_with_any_changed_byte_is_refused_or_means_the_same() {
    use rustls::pki_types::CertificateSigningRequestDer;
    use rustls::pki_types::pem::PemObject;

    let key = KeyPair::generate().unwrap();
    let text = request_of(&key, &["urrcp:robot:a"]);
    let der = CertificateSigningRequestDer::from_pem_slice(text.as_bytes()).unwrap().to_vec();
    let own = TempDir::new().unwrap();
    let path = own.path().join("x.csr");
    let read = |der: &[u8]| {
        use base64::Engine;
        let lines = base64::engine::general_purpose::STANDARD.encode(der);
        let text =
            format!("-----BEGIN CERTIFICATE REQUEST-----\n{lines}\n-----END CERTIFICATE REQUEST-----\n");
        std::fs::write(&path, text).unwrap();
        Request::read(&path)
    };
    let expected = (robot("a"), Fingerprint::of(&key.subject_public_key_info()));
    assert_eq!(read(&der).unwrap().name(), &expected.0);
    for at in 0..der.len() {
        let mut changed = der.clone();
        changed[at] ^= 1;
        // The signature does not cover itself and its algorithm, which have several forms.
        let is_signed = at < der.len() - SIGNATURE_MAX;
        let found = read(&changed).map(|found| (found.name().clone(), found.fingerprint()));
        assert!(found.is_err() || !is_signed && found.is_ok_and(|found| found == expected), "byte {at}");
        assert!(read(&der[..at]).is_err(), "cut off at {at}");
    }
}

#[test]
fn other_fingerprint_is_refused() {
    let own = TempDir::new().unwrap();
    let first = request(own.path(), &robot("cf1"), &Roles::default()).unwrap();
    let second = request(own.path(), &robot("cf2"), &Roles::default()).unwrap();
    let asked = Request::read(&first.request).unwrap();
    assert!(asked.check_fingerprint(&first.fingerprint).is_ok());
    let refused = asked.check_fingerprint(&second.fingerprint).unwrap_err().to_string();
    assert!(refused.contains(&first.fingerprint.to_string()), "{refused}");
}

#[test]
fn certificate_of_another_key_or_authority_is_not_installed() {
    let (site, other, own) = (Site::new(), Site::new(), TempDir::new().unwrap());
    let sign = |site: &Site, name: &Name| {
        let made = request(own.path(), name, &Roles::default()).unwrap();
        let signed = site.authority.sign(&Request::read(&made.request).unwrap(), &terms(&[]), own.path());
        (made.key, signed.unwrap())
    };
    let (key, signed) = sign(&site, &robot("cf1"));
    let (other_key, of_other) = sign(&other, &robot("cf2"));
    let before = std::fs::read(&key).unwrap();
    let refused = |certificate: &Path, key: &Path| install(certificate, key, &[]).unwrap_err().to_string();
    assert!(refused(&signed.certificate, &other_key).contains("does not belong to the key"));
    let elsewhere = install(&signed.certificate, &key, &of_other.authorities).unwrap_err().to_string();
    assert!(elsewhere.contains("has the fingerprint"), "{elsewhere}");
    let text = std::fs::read_to_string(&signed.certificate).unwrap();
    let foreign = std::fs::read_to_string(other.folder.path().join("keys/authority.pem")).unwrap();
    let own_only = text.split_inclusive("-----END CERTIFICATE-----\n").next().unwrap().to_owned();
    let path = own.path().join("x.crt");
    for wrong in ["", &own_only, &format!("{own_only}{foreign}"), &format!("{text}{text}")] {
        std::fs::write(&path, wrong).unwrap();
        assert!(refused(&path, &key).contains("this is not a certificate that"), "{wrong}");
    }
    assert!(refused(&key, &key).contains("contains a private key"));
    assert!(refused(&signed.certificate, &signed.certificate).contains("other users can read this key"));
    std::fs::write(&path, "no key").unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    assert!(refused(&signed.certificate, &path).contains("missing private key"));
    assert_eq!(std::fs::read(&key).unwrap(), before);
    install(&signed.certificate, &key, &signed.authorities).unwrap();
    // A second time, for example after the file was damaged.
    install(&signed.certificate, &key, &[]).unwrap();
    Credentials::read(&key).unwrap();
}

#[test]
fn requests_are_signed_by_the_new_authority_while_it_replaces_the_old_one() {
    let site = Site::new();
    let (cf1, of_requested) = (site.of(&robot("cf1"), &[]), robot("cf2"));
    certified(&site, &of_requested, &[], &[]);
    let old = site.authority.authorities().unwrap().current;
    site.authority.rotate(calendar()).unwrap();
    let Renewed { made, requested } = site.authority.renew_all(calendar(), 10).unwrap();
    assert_eq!(made.into_iter().map(|(name, _)| name).collect::<Vec<_>>(), [robot("cf1")]);
    assert_eq!(requested, std::slice::from_ref(&of_requested));
    assert_eq!(site.authority.not_renewed(calendar()).unwrap(), std::slice::from_ref(&of_requested));

    let anna = certified(&site, &operator(), &[], &[Role::Drive]);
    assert_ne!(anna.identity().authority, old);
    assert!(meet(&cf1, &anna, Some(&site.revoked())).0.is_ok());
    let own = TempDir::new().unwrap();
    let again = request(own.path(), &of_requested, &Roles::default()).unwrap();
    let renewal = Terms { is_renewal: true, ..terms(&[]) };
    let signed = site.authority.sign(&Request::read(&again.request).unwrap(), &renewal, own.path()).unwrap();
    let [new, old] = signed.authorities.as_slice() else { panic!("{:?}", signed.authorities) };
    let refused = |expected: &[Fingerprint]| {
        install(&signed.certificate, &again.key, expected).unwrap_err().to_string()
    };
    assert!(refused(std::slice::from_ref(old)).contains("has the fingerprint"));
    let refused = refused(std::slice::from_ref(new));
    assert!(
        refused.contains("also trusts an old authority") && refused.contains(&old.to_string()),
        "{refused}"
    );
    let installed = install(&signed.certificate, &again.key, &[old.clone(), new.clone()]).unwrap();
    assert_eq!(installed.authorities, signed.authorities);
    assert!(site.authority.not_renewed(calendar()).unwrap().is_empty());
    site.authority.end(End::IfRenewed, calendar()).unwrap();
    assert!(meet(&Credentials::read(&again.key).unwrap(), &anna, Some(&site.revoked())).0.is_ok());
}

#[test]
fn second_authority_in_a_certificate_file_must_not_be_a_root_or_another_certificate() {
    let (site, own) = (Site::new(), TempDir::new().unwrap());
    let made = request(own.path(), &robot("cf1"), &Roles::default()).unwrap();
    let signed =
        site.authority.sign(&Request::read(&made.request).unwrap(), &terms(&[]), own.path()).unwrap();
    let text = std::fs::read_to_string(&signed.certificate).unwrap();
    let certificates: Vec<&str> = text.split_inclusive("-----END CERTIFICATE-----\n").collect();
    let path = own.path().join("x.crt");
    for second in &certificates {
        std::fs::write(&path, format!("{text}{second}")).unwrap();
        let refused = install(&path, &made.key, &[]).unwrap_err().to_string();
        assert!(refused.contains("this is not a certificate that"), "{refused}");
    }
}
