use std::collections::BTreeMap;

use serde_json::json;

use super::subject::{CertifiedAct, Options, Subject};
use super::*;

fn subject() -> Subject {
    let act = |name: &str| CertifiedAct {
        act: name.to_owned(),
        settings: BTreeMap::from([("next".to_owned(), json!("end"))]),
        scripts: BTreeMap::from([("left/shoulder".to_owned(), ContentHash::of(name.as_bytes()))]),
    };
    Subject {
        scenario: "show".to_owned(),
        options: Options { act: None, from: None, only: Vec::new(), speed: 1.0 },
        plan_hash: ContentHash::of(b"plan"),
        fleet_hash: ContentHash::of(b"fleet"),
        acts: vec![act("one"), act("two")],
        fleet: BTreeMap::new(),
        robots: BTreeMap::new(),
    }
}

fn certificate() -> Certificate {
    Certificate::new(7, subject(), Vec::new())
}

fn read(text: &str) -> Result<Certificate, CertificateError> {
    Certificate::parsed(text.as_bytes(), "show.cert.json".to_owned())
}

#[test]
fn written_certificate_is_read_back_with_identical_bytes() {
    let text = certificate().text();
    let read = read(&text).unwrap();
    assert_eq!((read.text(), differences(&read, &subject())), (text, Vec::new()));
}

#[test]
fn certificate_truncated_anywhere_is_refused() {
    let text = certificate().text();
    let whole = text.trim_end().len();
    for end in 0..whole {
        assert!(matches!(read(&text[..end]), Err(CertificateError::Damaged { .. })), "up to byte {end}");
    }
}

#[test]
fn certificate_changed_anywhere_is_refused() {
    let text = certificate().text();
    let changes = [
        ("\"seed\": 7", "\"seed\": 8"),
        ("\"speed\": 1.0", "\"speed\": 2.0"),
        ("\"next\": \"end\"", "\"next\": \"one\""),
        ("\"scenario\": \"show\"", "\"scenario\": \"shop\""),
    ];
    for (from, to) in changes {
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{from}");
        assert!(matches!(read(&changed), Err(CertificateError::Seal { .. })), "{from}");
    }
}

#[test]
fn another_document_version_is_refused_before_the_rest_is_read() {
    let error = read(r#"{"certificate": 2, "new": "keys"}"#).unwrap_err();
    assert!(matches!(error, CertificateError::Version { version: 2, .. }), "{error}");
    for text in ["[]", "{}", r#"{"certificate": "1"}"#, r#"{"certificate": 1}"#] {
        assert!(matches!(read(text), Err(CertificateError::Damaged { .. })), "{text}");
    }
    let unknown = certificate().text().replacen('{', "{\"more\": 1,", 1);
    assert!(matches!(read(&unknown), Err(CertificateError::Damaged { .. })));
}

#[test]
fn certificate_of_another_version_does_not_certify_this_one() {
    let mut certificate = certificate();
    certificate.downbeat = "0.0.1".to_owned();
    let found = differences(&certificate, &subject());
    assert!(found[0].contains("made by downbeat 0.0.1"), "{found:?}");
}

#[test]
fn every_difference_is_named() {
    let check = |change: fn(&mut Subject), says: &str| {
        let mut now = subject();
        change(&mut now);
        let found = differences(&certificate(), &now);
        assert!(found.iter().any(|sentence| sentence.contains(says)), "`{says}` is not in {found:?}");
    };
    check(|now| now.acts.reverse(), "the order of the acts is now `two`, `one`");
    check(|now| drop(now.acts.pop()), "act `two` was certified but no longer exists");
    check(|now| now.options.speed = 0.5, "--speed: 0.5, but certified with 1");
    check(|now| now.options.act = Some("one".to_owned()), "--act: `one`, but certified with all acts");
    check(
        |now| drop(now.acts[0].settings.insert("next".to_owned(), json!({"act": "two"}))),
        r#"act `one`: next is {"act":"two"}, but "end" was certified"#,
    );
    check(|now| now.acts[1].scripts.clear(), "act `two`: `left/shoulder` moved when it was certified");
    check(|now| now.plan_hash = ContentHash::of(b"other"), "its hashes do not match this plan");
}
