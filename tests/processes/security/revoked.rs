//! Keys that become invalid while their operators are connected.

use std::time::{Duration, Instant};

use stage::session::Ran;

use super::seize::anna_plays;

/// Time within which a mission must have ended after its operator's key was revoked. Robots check their lists once per second.
const ENDED_WITHIN: Duration = Duration::from_secs(20);

#[test]
fn a_mission_whose_operator_is_revoked_ends_and_its_robots_are_free() {
    for scheme in ["tls", "hmac"] {
        let (site, mut playing) = anna_plays(scheme);
        site.session.run(&["keys", "revoke", "--operator", "anna"]).says(0, &["revoked 1"]);
        let revoked = Instant::now();
        while playing.try_wait().unwrap().is_none() {
            assert!(revoked.elapsed() < ENDED_WITHIN, "the mission continues");
            std::thread::sleep(Duration::from_millis(20));
        }
        let ended = Ran(playing.wait_with_output().unwrap());
        let report = ended.json();
        assert_ne!(report["outcome"]["outcome"], "done", "{report}");
        assert!(report["failures"].to_string().contains("key was revoked"), "{report}");
        for robot in 0..3 {
            let log = site.logged(robot);
            assert!(log.contains("an operator whose key is no longer valid is disconnected"), "{log}");
            assert!(
                log.contains("the session of operator anna ends: the operator's key was revoked"),
                "{log}"
            );
        }
        site.fleet(&site.addresses(scheme), "cleo");
        site.run().says(0, &["test: done"]);
    }
}

/// A robot that obeyed such a list would refuse every operator, and also every stop.
#[test]
fn a_list_of_another_authority_shuts_nobody_out() {
    let (site, mut playing) = anna_plays("tls");
    let session = &site.session;
    session.run(&["keys", "init", "--keys", "others"]).says(0, &[]);
    std::fs::copy(session.path("others/revoked.pem"), session.path("keys/revoked.pem")).unwrap();
    let mut stop = session.command(&["stop", "--fleet", "fleet.yaml"]);
    stop.env("DOWNBEAT_IDENTITY", "keys/operators/dora.pem");
    Ran(stop.output().unwrap())
        .says(0, &["without a list of revoked certificates", "signed by another authority", "r0"]);
    assert!(site.logged(0).contains("signed by another authority"), "{}", site.logged(0));
    let _report = playing.wait().unwrap();
    session.run(&["run", "test.yaml"]).says(2, &["signed by another authority"]);
}
