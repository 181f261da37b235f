//! The Zenoh configurations of docs/zenoh with certificates: which members of the network they admit, and which they reject. The tests
//! need the program `zenohd`; the variable `ZENOHD` contains its path.

use std::process::Stdio;

use rcgen::{BasicConstraints, Certificate, CertificateParams, DnType, IsCa, Issuer, KeyPair};

use crate::network::{Router, fleet, lies, names, outcome, sets, simulated, stage_of};
use stage::{Stage, free_port};

/// Number of steps of the script, which makes it 15 KB long; `ROBOTS` robots play it.
const LONG: u32 = 200;
const ROBOTS: usize = 8;

/// Returns the file `of` of docs/zenoh with the addresses of this test, and with the certificate of `name` instead of that of `of`.
fn documented(of: &str, name: &str, port: u16, connects: &str) -> String {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../docs/zenoh/{of}.json5"));
    let text = std::fs::read_to_string(path).unwrap();
    let text = text.replace("\"tls/router-a.example:7447\"", connects).replace("hall-2/", "hall/");
    let text = text.replace("\"tls/router-b.example:7447\"", connects);
    let text = text.replace("tls/[::]:7447", &format!("tls/127.0.0.1:{port}"));
    text.replace(&format!("{of}.pem"), &format!("{name}.pem"))
        .replace(&format!("{of}.key"), &format!("{name}.key"))
}

fn authority(name: &str) -> (Certificate, Issuer<'static, KeyPair>) {
    let mut params = CertificateParams::new(Vec::<String>::new()).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.distinguished_name.push(DnType::CommonName, name);
    let key = KeyPair::generate().unwrap();
    let certificate = params.self_signed(&key).unwrap();
    (certificate, Issuer::new(params, key))
}

/// Writes a certificate that the authority has signed, and its key.
fn certify(stage: &Stage, name: &str, file: &str, authority: &Issuer<'static, KeyPair>) {
    let mut params = CertificateParams::new(vec!["127.0.0.1".to_owned(), "localhost".to_owned()]).unwrap();
    params.distinguished_name.push(DnType::CommonName, name);
    let key = KeyPair::generate().unwrap();
    let certificate = params.signed_by(&key, authority).unwrap();
    stage.file(&format!("{file}.pem"), certificate.pem()).file(&format!("{file}.key"), key.serialize_pem());
}

#[test]
#[ignore = "needs zenohd: .ci/zenoh runs it"]
fn documented_zenoh_files_admit_certified_members_only_in_their_roles() {
    let stage = stage_of("20s", "without", LONG, 10);
    let ((ca, site), (_, strange)) = (authority("site"), authority("elsewhere"));
    stage.file("ca.pem", ca.pem());
    for name in ["router", "robot", "scheduler"] {
        certify(&stage, name, name, &site);
    }
    certify(&stage, "scheduler", "stranger", &strange);
    let (a, b) = (free_port(), free_port());
    let place = |port: u16| format!("\"tls/localhost:{port}\"");
    let _a = Router::of(&stage, "router-a", a, documented("router", "router", a, ""));
    let _b = Router::of(&stage, "router-b", b, documented("router", "router", b, &place(a)));
    stage.file("robot.json5", documented("robot", "robot", 0, &place(b)));
    stage.file("scheduler.json5", documented("scheduler", "scheduler", 0, &place(a)));
    stage.file("stranger.json5", documented("scheduler", "stranger", 0, &place(a)));
    stage.file("robot-as-scheduler.json5", documented("robot", "robot", 0, &place(a)));
    stage.file("fleet.yaml", fleet(&names(0, ROBOTS), "scheduler.json5"));
    let _robots = simulated(&stage, "fleet.yaml", ROBOTS, &["--zenoh", "robot.json5"]);
    let ping_by = |file: &str| {
        let ping =
            stage.command(&["fleet", "ping", "fleet.yaml"]).env("DOWNBEAT_ZENOH", file).output().unwrap();
        (ping.status.code(), String::from_utf8(ping.stderr).unwrap())
    };
    let began = std::time::Instant::now();
    // The routers may take a while to connect to each other.
    while ping_by("scheduler.json5").0 != Some(0) {
        assert!(began.elapsed() < std::time::Duration::from_secs(30));
    }
    let ended = stage.run(&[
        "run",
        "play.yaml",
        "--format",
        "json",
        "--patience",
        "30s",
        "--log",
        "downbeat_robot=debug",
    ]);
    assert_eq!((ended.code, outcome(&ended)), (Some(0), "done".into()), "{ended}");
    assert_eq!(lies(&ended, &sets(&stage, &["fleet.yaml"])), [""; 0]);
    // The access rules have to allow publishing and querying the common script.
    assert!(!ended.told.contains("does not receive scripts that are published"), "{ended}");

    let (code, told) = ping_by("stranger.json5");
    assert!(code == Some(1) && told.contains("no Zenoh network by"), "{told}");
    let (code, told) = ping_by("robot-as-scheduler.json5");
    assert!(code == Some(1) && told.contains("no robot answers there"), "{told}");

    // A scheduler's certificate does not permit acting as a robot.
    let mut command =
        stage.command(&["robot", "--init", "robot.yaml", "--id", "r9", "--listen", "zenoh:hall/r9"]);
    let spawned = command.args(["--zenoh", "scheduler.json5"]).stdout(Stdio::null()).spawn().unwrap();
    let _false_robot = stage::Process(spawned);
    std::thread::sleep(std::time::Duration::from_secs(2));
    stage.file("fleet.yaml", fleet(&names(9, 1), "scheduler.json5"));
    let (code, told) = ping_by("scheduler.json5");
    assert!(code == Some(1) && told.contains("no robot answers there"), "{told}");
}
