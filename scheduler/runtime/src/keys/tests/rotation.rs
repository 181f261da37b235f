//! Tests in which one authority replaces another. Each robot and operator has its own copy of `revoked.pem`, as on its own machine.

use downbeat_robot::tls::{Exclusion, Guard, Witness};

use super::*;

/// A site with a robot and an operator, each with a key of the old authority.
struct Rotation {
    site: Site,
    r0: Credentials,
    anna: Credentials,
}

impl Rotation {
    fn new() -> Self {
        let site = Site::new();
        let (r0, anna) = (site.of(&robot("r0"), &[]), site.of(&operator(), &Role::ALL));
        Self { site, r0, anna }
    }

    /// A site whose authority is being replaced.
    fn begun() -> Self {
        let own = Self::new();
        own.site.authority.rotate(calendar()).unwrap();
        own
    }

    /// Makes new keys for the robot and the operator.
    fn renewed(&self) -> (Credentials, Credentials) {
        let made = self.site.authority.renew_all(calendar(), 10).unwrap().made;
        let read = |name: &Name| {
            let (_, path) = made.iter().find(|(made, _)| made == name).unwrap();
            Credentials::read(path).unwrap()
        };
        (read(&robot("r0")), read(&operator()))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.site.folder.path().join("keys").join(name)
    }

    fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    fn list(&self) -> String {
        self.text("revoked.pem")
    }

    /// Writes a copy of a list.
    fn copy(&self, name: &str, text: &str) -> Revoked {
        let path = self.site.folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        Revoked::in_file(&path).unwrap()
    }

    /// Starts a robot with its own copy of a list.
    fn guard(&self, identity: Credentials, list: &str) -> Guard {
        Guard::new(identity, Some(self.copy("of-robot.pem", list))).unwrap()
    }
}

/// Whether the robot accepts the operator, and the operator the robot.
fn meets(robot: &Credentials, operator: &Credentials, list: &Revoked) -> (bool, bool) {
    let (by_robot, by_operator) = meet(robot, operator, Some(list));
    (by_robot.is_ok(), by_operator.is_ok())
}

#[test]
fn old_and_new_keys_accept_each_other_until_the_old_authority_ends() {
    let site = Rotation::new();
    let before = site.list();
    site.site.authority.rotate(calendar()).unwrap();
    let (r0, anna) = site.renewed();
    let list = site.site.revoked();
    for robot in [&site.r0, &r0] {
        for operator in [&site.anna, &anna] {
            assert_eq!(meets(robot, operator, &list), (true, true));
        }
    }
    // Without the list that introduces the new authority.
    let before = site.copy("before.pem", &before);
    assert_eq!(meets(&site.r0, &site.anna, &before), (true, true));
    let stale = anna.list(&before).unwrap_err().to_string();
    assert!(stale.contains("signed by another authority"), "{stale}");

    site.site.authority.end(End::IfRenewed, calendar()).unwrap();
    assert_eq!(meets(&r0, &anna, &list), (true, true));
    assert!(!meets(&r0, &site.anna, &list).0, "the robot refuses the old key");
    assert!(!meets(&site.r0, &anna, &list).1, "the operator refuses the old key");
    assert!(!meets(&site.r0, &site.anna, &list).0, "even a robot with an old key refuses it");
    let (_, path) = (site.site.of(&robot("r1"), &[]), site.path("robots/r1.pem"));
    assert_eq!(std::fs::read_to_string(path).unwrap().matches("BEGIN CERTIFICATE").count(), 2);
}

#[test]
fn keys_of_both_authorities_can_be_revoked_during_the_replacement() {
    let site = Rotation::begun();
    let (r0, anna) = site.renewed();
    let authority = &site.site.authority;
    for (revoked, other) in [(&site.anna, &anna), (&anna, &site.anna)] {
        let (name, entry) = authority.with_serial(&revoked.identity().serial).unwrap();
        assert!(meets(&site.r0, revoked, &site.site.revoked()).0);
        authority.revoke_certificate(&name, &entry, calendar()).unwrap();
        for robot in [&site.r0, &r0] {
            let (refused, _) = meet(robot, revoked, Some(&site.site.revoked()));
            assert!(refused.unwrap_err().contains("evoked"));
        }
        let is_first = std::ptr::eq(revoked, &site.anna);
        assert_eq!(meets(&r0, other, &site.site.revoked()).0, is_first);
    }
}

#[test]
fn running_robot_accepts_the_lists_of_a_replacement_only_in_their_order() {
    let site = Rotation::new();
    let guard = site.guard(site.site.of(&robot("r1"), &[]), &site.list());
    let mut lists = vec![site.list()];
    site.site.authority.rotate(calendar()).unwrap();
    lists.push(site.list());
    let (_, anna) = site.renewed();
    let revoke = |serial: &str| {
        let (name, entry) = site.site.authority.with_serial(serial).unwrap();
        site.site.authority.revoke_certificate(&name, &entry, calendar()).unwrap();
    };
    revoke(&anna.identity().serial);
    lists.push(site.list());
    site.site.authority.end(End::Always, calendar()).unwrap();
    lists.push(site.list());
    revoke(&site.site.of(&robot("r2"), &[]).identity().serial);
    lists.push(site.list());
    for (index, list) in lists.iter().enumerate() {
        guard.replace_list(list).unwrap();
        for older in &lists[..index] {
            let refused = guard.replace_list(older).unwrap_err();
            assert!(refused.contains("older"), "{index}: {refused}");
        }
        // The file may be replaced without the robot.
        std::fs::write(site.site.folder.path().join("of-robot.pem"), &lists[0]).unwrap();
        let used = guard.list().unwrap().number();
        guard.replace_list(list).unwrap();
        assert_eq!(used, guard.list().unwrap().number(), "{index}");
    }
    let old = &site.anna.identity();
    let excluded = guard.list().unwrap().exclusion(&old.authority, &old.serial);
    assert_eq!(excluded, Some(Exclusion::AuthorityEnded), "for connections that are already open");
    let new = &anna.identity();
    let excluded = guard.list().unwrap().exclusion(&new.authority, &new.serial);
    assert_eq!(excluded, Some(Exclusion::Revoked));
}

/// Splits a list into its parts in PEM.
fn parts(text: &str) -> Vec<String> {
    let ends = text.split_inclusive("-----\n").collect::<Vec<_>>();
    ends.chunks(2).map(|part| part.concat()).collect()
}

#[test]
fn list_assembled_from_parts_of_different_age_is_refused() {
    let site = Rotation::begun();
    let guard = site.guard(site.site.of(&robot("r1"), &[]), &site.list());
    let first = parts(&site.list());
    assert_eq!(first.len(), 3);
    site.site.authority.renew_lists(calendar() + 300 * DAY).unwrap();
    let second = parts(&site.list());
    let number = guard.list().unwrap().number();
    // As new as the list in use for the old authority, and newer for the new one.
    guard.replace_list(&[&first[0], &first[1], &second[2]].map(String::as_str).concat()).unwrap();
    assert_eq!(guard.list().unwrap().number(), number, "the oldest list counts");
    for mixed in [
        [&second[0], &first[1], &first[2]].map(String::as_str).concat(),
        [&second[0], &second[1]].map(String::as_str).concat(),
        second[0].clone(),
        [&second[0], &second[0], &second[1], &second[2]].map(String::as_str).concat(),
        second[2].clone(),
        second[1].clone(),
    ] {
        assert!(guard.replace_list(&mixed).is_err(), "{mixed}");
    }
    guard.replace_list(&second.concat()).unwrap();
}

#[test]
fn ended_authority_cannot_be_restored_by_a_list_that_it_signs_later() {
    let site = Rotation::begun();
    let key = site.text("authority.key");
    let certificate = site.text("authority.pem");
    let (r0, _) = site.renewed();
    let guard = site.guard(r0, &site.list());
    site.site.authority.end(End::Always, calendar()).unwrap();
    guard.replace_list(&site.list()).unwrap();
    assert_ne!(site.text("authority.key"), key, "the old key is deleted");
    assert!(!site.path("successor.key").exists());
    let old = Signer {
        issuer: Issuer::from_ca_cert_pem(&certificate, KeyPair::from_pem(&key).unwrap()).unwrap(),
        authority: tls::Authority::of_pem(&certificate).unwrap(),
        pem: certificate,
    };
    let now = calendar();
    let restored = old.list(Vec::new(), u64::MAX, now, now + DAY).unwrap();
    let parts = parts(&site.list());
    let later = format!("{restored}{}{}", parts[1], parts[2]);
    assert!(guard.replace_list(&later).unwrap_err().contains("older"));
    // A list may omit the authority that has ended. This does not restore it either.
    guard.replace_list(&parts[2]).unwrap();
    assert!(guard.replace_list(&later).unwrap_err().contains("older"));
    let old = site.anna.identity();
    let excluded = guard.list().unwrap().exclusion(&old.authority, &old.serial);
    assert_eq!(excluded, Some(Exclusion::AuthorityEnded));
}

/// Another authority that the old one introduces with a certificate that `change` modifies.
fn introduced(
    by: &Signer,
    change: impl FnOnce(&mut CertificateParams),
) -> (String, KeyPair, CertificateParams) {
    let key = KeyPair::generate().unwrap();
    let mut params = authority_params(&key, calendar()).unwrap();
    change(&mut params);
    (params.signed_by(&key, &by.issuer).unwrap().pem(), key, params)
}

#[test]
fn invalid_introduction_of_an_authority_is_refused_and_the_list_in_use_remains() {
    let site = Rotation::new();
    let guard = site.guard(site.site.of(&robot("r1"), &[]), &site.list());
    let number = guard.list().unwrap().number();
    let old = site.site.authority.signer(AUTHORITY_KEY, AUTHORITY).unwrap();
    let other = Site::new();
    let stranger = other.authority.signer(AUTHORITY_KEY, AUTHORITY).unwrap();
    let now = calendar();
    let lists = |key: KeyPair, params: &CertificateParams| {
        let pem = params.self_signed(&key).unwrap().pem();
        let authority = tls::Authority::of_pem(&pem).unwrap();
        let new = Signer { issuer: Issuer::from_ca_cert_pem(&pem, key).unwrap(), authority, pem };
        let list = |signer: &Signer| signer.list(Vec::new(), u64::MAX - 1, now, now + DAY).unwrap();
        (list(&old), list(&new))
    };
    let expired = |params: &mut CertificateParams| params.not_after = instant(now - 10).unwrap();
    let no_authority = |params: &mut CertificateParams| params.is_ca = IsCa::ExplicitNoCa;
    let no_usage =
        |params: &mut CertificateParams| params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    for (introduction, expected) in [
        (introduced(&stranger, |_| ()), "no trusted authority has signed"),
        (introduced(&old, expired), "has expired"),
        (introduced(&old, no_authority), "CA:TRUE"),
        (introduced(&old, no_usage), "CA:TRUE"),
    ] {
        let (cross, key, mut params) = introduction;
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let (of_old, of_new) = lists(key, &params);
        let refused = guard.replace_list(&format!("{of_old}{cross}{of_new}")).unwrap_err();
        assert!(refused.contains(expected), "{refused}");
        assert_eq!(guard.list().unwrap().number(), number, "{expected}");
    }
    let (cross, key, params) = introduced(&old, |_| ());
    let (of_old, of_new) = lists(key, &params);
    let refused = guard.replace_list(&format!("{of_old}{cross}")).unwrap_err();
    assert!(refused.contains("without a list of this authority"), "{refused}");
    let self_signed = format!("{of_old}{}", stranger.pem);
    assert!(guard.replace_list(&self_signed).unwrap_err().contains("no trusted authority has signed"));
    guard.replace_list(&format!("{of_old}{cross}{of_new}")).unwrap();
}

#[test]
fn combined_list_of_a_stranger_is_refused() {
    let (site, stranger) = (Rotation::new(), Rotation::begun());
    let guard = site.guard(site.site.of(&robot("r1"), &[]), &site.list());
    let number = guard.list().unwrap().number();
    for foreign in [stranger.list(), parts(&stranger.list())[2].clone()] {
        assert!(guard.replace_list(&foreign).is_err());
        let refused = Guard::new(site.site.of(&robot("r2"), &[]), Some(site.copy("foreign", &foreign)));
        assert!(refused.is_err());
        site.site.authority.revoke(&robot("r2"), calendar()).unwrap();
    }
    // A list of a stranger next to the own one has no effect.
    let beside = format!("{}{}", site.list(), parts(&stranger.list())[0]);
    guard.replace_list(&beside).unwrap();
    assert!(guard.list().unwrap().number() > number);
    let foreign = stranger.anna.identity();
    let excluded = guard.list().unwrap().exclusion(&foreign.authority, &foreign.serial);
    assert_eq!(excluded, Some(Exclusion::AuthorityEnded));
    assert!(meet(&site.r0, &stranger.anna, None).0.is_err());
}

#[test]
fn signed_statements_of_both_authorities_are_accepted_until_the_old_one_ends() {
    let site = Rotation::begun();
    let (_, anna) = site.renewed();
    let both = [&site.anna, &anna];
    let signed = both.map(|operator| operator.sign(b"stop").unwrap());
    // The mission began with either key.
    let Rotation { site, anna: old, .. } = site;
    let new = site.of(&Name::Operator("eve".into()), &[]);
    let witnesses = [old, new].map(|own| Witness::new(own, Some(site.revoked())).unwrap());
    let accepted = || {
        let of = |witness: &Witness| {
            signed.iter().map(|signed| witness.who(b"stop", signed).is_ok()).collect::<Vec<_>>()
        };
        witnesses.iter().map(of).collect::<Vec<_>>()
    };
    assert_eq!(accepted(), [[true, true], [true, true]]);
    site.authority.end(End::Always, calendar()).unwrap();
    assert_eq!(accepted(), [[false, true], [false, true]]);
}

#[test]
fn authority_ends_only_when_all_names_have_a_new_key() {
    let site = Rotation::new();
    let authority = &site.site.authority;
    assert!(matches!(authority.end(End::Always, calendar()), Err(KeysError::NotRotating(_))));
    // An expired and a revoked key need no new one.
    site.site.until(&robot("expired"), &[], calendar() - 20 * DAY, 10);
    site.site.of(&robot("revoked"), &[]);
    authority.revoke(&robot("revoked"), calendar()).unwrap();
    authority.rotate(calendar()).unwrap();
    assert!(matches!(authority.rotate(calendar()), Err(KeysError::Rotating(_))));
    let refused = authority.end(End::IfRenewed, calendar()).unwrap_err().to_string();
    assert!(refused.starts_with("robot r0, operator anna have only a key of the old authority"), "{refused}");
    authority.renew(&robot("r0"), calendar(), 10).unwrap();
    let refused = authority.end(End::IfRenewed, calendar()).unwrap_err().to_string();
    assert!(refused.starts_with("operator anna has only a key of the old authority"), "{refused}");
    let made = authority.renew_all(calendar(), 10).unwrap().made;
    assert_eq!(made.iter().map(|(name, _)| name).collect::<Vec<_>>(), [&operator()]);
    let (issued, authorities) = (authority.issued().unwrap(), authority.authorities().unwrap());
    let issuing = |entry: &Entry| authorities.issuing(entry.authority.as_deref());
    let all: Vec<Issuing> = issued.entries().iter().map(issuing).collect();
    assert_eq!(all, [vec![Issuing::Old; 4], vec![Issuing::Current; 2]].concat());
    authority.end(End::IfRenewed, calendar()).unwrap();
    let authorities = authority.authorities().unwrap();
    assert_eq!(authorities.issuing(issued.entries()[0].authority.as_deref()), Issuing::Ended);
}

#[test]
fn secrets_and_passes_are_the_same_after_a_replacement() {
    let site = Rotation::new();
    let authority = &site.site.authority;
    site.site.of_secret(&"cf1".parse().unwrap(), IfThere::Keep).unwrap();
    let files = ["secrets/cf1.secret", "operators/anna.passes"].map(|file| (file, site.text(file)));
    let serials = |text: String| text.lines().filter(|line| !line.starts_with('#')).count();
    authority.rotate(calendar()).unwrap();
    authority.end(End::Always, calendar()).unwrap();
    for (file, before) in files {
        assert_eq!(site.text(file), before, "{file}");
    }
    assert_eq!(serials(site.text("revoked.serials")), 0, "no pass is revoked");
}

impl Rotation {
    /// Opens the folder again, as the next process does.
    fn reopened(self) -> Self {
        let Self { site: Site { folder, authority }, r0, anna } = self;
        // The lock ends with the process.
        drop(authority);
        let authority = Authority::open(&folder.path().join("keys")).unwrap();
        Self { site: Site { folder, authority }, r0, anna }
    }

    /// Checks that new keys, made under this name, meet those of the old authority unless it has ended.
    #[track_caller]
    fn works(&self, name: &str) {
        let (new, bert) = (self.site.of(&robot(name), &[]), self.site.of(&Name::Operator(name.into()), &[]));
        let list = self.site.revoked();
        assert_eq!(meets(&new, &bert, &list), (true, true));
        let authorities = self.site.authority.authorities().unwrap();
        let is_old_accepted = authorities.issuing(Some(&self.anna.identity().authority)) != Issuing::Ended;
        assert_eq!(meets(&new, &self.anna, &list).0, is_old_accepted);
        assert_eq!(meets(&self.r0, &bert, &list).1, is_old_accepted);
        assert_eq!(list.unverified_number(), Some(self.site.authority.list_number()));
    }
}

#[test]
fn replacement_interrupted_between_any_two_writes_continues() {
    for (step, least) in [("rotate", 5), ("end", 8)] {
        let take_step = |site: &Rotation| match step {
            "rotate" => site.site.authority.rotate(calendar()),
            _ => site.site.authority.end(End::Always, calendar()),
        };
        for count in 0.. {
            let site = if step == "rotate" { Rotation::new() } else { Rotation::begun() };
            let robot = site.guard(site.site.of(&robot("r1"), &[]), &site.list());
            let done = files::interruption::after(count, || take_step(&site));
            let site = site.reopened();
            site.works("first");
            let again = take_step(&site);
            let is_done = matches!(again, Err(KeysError::Rotating(_) | KeysError::NotRotating(_)));
            assert!(again.is_ok() || is_done, "{step}, {count}: {again:?}");
            let site = site.reopened();
            site.works("second");
            robot.replace_list(&site.list()).unwrap();
            let left = ["successor.key", "successor.pem", "cross.pem"].map(|name| site.path(name).exists());
            assert_eq!(left, [step == "rotate"; 3], "{count}");
            if done.is_ok() {
                assert!(count >= least, "{step} has {count} writes");
                break;
            }
        }
    }
}

#[test]
fn authority_can_be_replaced_again() {
    let site = Rotation::begun();
    let authority = &site.site.authority;
    let (first, _) = site.renewed();
    let guard = site.guard(first, &site.list());
    let push = || guard.replace_list(&site.list()).unwrap();
    authority.end(End::IfRenewed, calendar()).unwrap();
    push();
    authority.rotate(calendar()).unwrap();
    push();
    let (r0, anna) = site.renewed();
    assert_eq!(meets(&r0, &anna, &site.site.revoked()), (true, true));
    authority.end(End::IfRenewed, calendar()).unwrap();
    push();
    assert_eq!(meets(&r0, &anna, &site.site.revoked()), (true, true));
    assert_eq!(parts(&site.list()).len(), 3, "the authority before the previous one is not listed");
    let old = site.anna.identity();
    let excluded = guard.list().unwrap().exclusion(&old.authority, &old.serial);
    assert_eq!(excluded, Some(Exclusion::AuthorityEnded));
}

#[test]
fn lists_of_a_replacement_are_renewed_and_differ_little_in_size_from_one_list() {
    let site = Rotation::new();
    let one = site.list().len();
    site.site.authority.rotate(calendar()).unwrap();
    let both = site.list().len();
    site.site.authority.end(End::Always, calendar()).unwrap();
    let ended = site.list().len();
    // `keys push` sends at most 64 KiB to a robot that plays in another operator's mission.
    assert!(one < 1_000 && both < 3_000 && ended < 3_000, "{one}, {both}, {ended} bytes");
}
