//! Tests of the profile in `docs/security.md` for certificates from a site's own PKI, made without [`Authority`].

use rcgen::{Certificate, PKCS_ECDSA_P256_SHA256, PKCS_ECDSA_P384_SHA384, PKCS_ED25519, SignatureAlgorithm};

use super::*;

/// An authority of the site: its key and its certificate.
struct Pki {
    issuer: Issuer<'static, KeyPair>,
    certificate: Certificate,
}

impl Pki {
    fn root() -> Self {
        let key = KeyPair::generate().unwrap();
        let params = Self::params("Root", 1);
        let certificate = params.self_signed(&key).unwrap();
        Self { issuer: Issuer::new(params, key), certificate }
    }

    fn intermediate(&self) -> Self {
        let key = KeyPair::generate().unwrap();
        let params = Self::params("Intermediate", 0);
        let certificate = params.signed_by(&key, &self.issuer).unwrap();
        Self { issuer: Issuer::new(params, key), certificate }
    }

    fn params(name: &str, below: u8) -> CertificateParams {
        let mut params = named(name).unwrap();
        set_validity(&mut params, calendar(), 10).unwrap();
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(below));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        params
    }

    /// Returns a key of this kind, and its certificate with the fields of the profile, which `change` changes.
    fn issue(
        &self,
        algorithm: &'static SignatureAlgorithm,
        name: &Name,
        change: impl FnOnce(&mut CertificateParams),
    ) -> String {
        let roles =
            if matches!(name, Name::Robot(_)) { Roles::default() } else { Role::ALL.into_iter().collect() };
        let mut params = profile(name, &roles).unwrap();
        set_validity(&mut params, calendar(), 10).unwrap();
        change(&mut params);
        let key = KeyPair::generate_for(algorithm).unwrap();
        let certificate = params.signed_by(&key, &self.issuer).unwrap();
        format!("{}{}", key.serialize_pem(), certificate.pem())
    }
}

fn read(text: &str) -> Result<Credentials, String> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("identity.pem");
    std::fs::write(&path, text).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    Credentials::read(&path).map_err(|error| error.to_string())
}

fn unchanged(_: &mut CertificateParams) {}

#[test]
fn keys_of_each_kind_in_the_profile_are_accepted() {
    let pki = Pki::root();
    let authority = pki.certificate.pem();
    for algorithm in [&PKCS_ECDSA_P256_SHA256, &PKCS_ECDSA_P384_SHA384, &PKCS_ED25519] {
        let cf1 = read(&format!("{}{authority}", pki.issue(algorithm, &robot("cf1"), unchanged))).unwrap();
        let anna = read(&format!("{}{authority}", pki.issue(algorithm, &operator(), unchanged))).unwrap();
        let (by_robot, by_operator) = meet(&cf1, &anna, None);
        assert_eq!((by_robot.unwrap().name, by_operator.unwrap().name), (operator(), robot("cf1")));
        assert_eq!(anna.sign(b"stop").is_ok(), algorithm == &PKCS_ECDSA_P256_SHA256);
    }
}

#[test]
fn issuing_authority_may_be_an_intermediate_but_longer_chains_are_refused() {
    let root = Pki::root();
    let pki = root.intermediate();
    let (key, authority, root) = (&PKCS_ECDSA_P256_SHA256, pki.certificate.pem(), root.certificate.pem());
    let (of_robot, of_operator) =
        (pki.issue(key, &robot("cf1"), unchanged), pki.issue(key, &operator(), unchanged));
    let cf1 = read(&format!("{of_robot}{authority}")).unwrap();
    let anna = read(&format!("{of_operator}{authority}")).unwrap();
    let (by_robot, by_operator) = meet(&cf1, &anna, None);
    assert!(by_robot.is_ok() && by_operator.is_ok());
    let error = read(&format!("{of_robot}{authority}{root}")).unwrap_err();
    assert!(error.contains("it contains the root of an intermediate authority"), "{error}");
    let of_root = read(&format!("{of_robot}{root}")).unwrap();
    assert!(meet(&of_root, &anna, None).0.is_err());
}

#[test]
fn certificates_without_a_field_of_the_profile_are_refused() {
    let pki = Pki::root();
    let (key, authority) = (&PKCS_ECDSA_P256_SHA256, pki.certificate.pem());
    let of = |name: &Name, change: fn(&mut CertificateParams)| {
        read(&format!("{}{authority}", pki.issue(key, name, change)))
    };
    let (cf1, anna) = (of(&robot("cf1"), unchanged).unwrap(), of(&operator(), unchanged).unwrap());
    let no_dns = of(&robot("cf1"), |params| {
        params.subject_alt_names.retain(|name| matches!(name, SanType::URI(_)));
    });
    let refused = meet(&no_dns.unwrap(), &anna, None).1.unwrap_err();
    assert!(refused.contains("not valid for name"), "{refused}");
    let client = |params: &mut CertificateParams| {
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    };
    assert!(meet(&of(&robot("cf1"), client).unwrap(), &anna, None).1.is_err());
    let server = |params: &mut CertificateParams| {
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    };
    assert!(meet(&cf1, &of(&operator(), server).unwrap(), None).0.is_err());
    let no_uri = of(&operator(), |params| params.subject_alt_names.clear()).unwrap_err();
    assert!(no_uri.contains("has 0 names"), "{no_uri}");
    let unknown = of(&operator(), |params| {
        params.subject_alt_names.push(SanType::URI("urrcp:group:stage".try_into().unwrap()));
    });
    assert!(unknown.unwrap_err().contains("the invalid name `urrcp:group:stage`"));
    let others = of(&operator(), |params| {
        params.subject_alt_names.push(SanType::URI("spiffe://site/anna".try_into().unwrap()));
        params.subject_alt_names.push(SanType::DnsName("desk.example".try_into().unwrap()));
    });
    assert_eq!(meet(&cf1, &others.unwrap(), None).0.unwrap().name, operator());
}
