//! Real-time scheduling: it is used if the system permits it. If not, this is reported; if it is required, nothing moves.

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};

use rustix::process::{Pid, Signal};

use stage::session::{Ran, Session, arm_at, program};

const SCENARIO: &str = "scenario: test
start_tolerance: 1s
cues: [{at: 0s, robots: arms, tracks: {shoulder: [{at: 0s, to: 10}, {at: 100ms, to: 0}]}}]
";

/// Parts of the messages if the permission for real-time scheduling or locked memory is missing.
const REFUSED: [&str; 5] = [
    "no real-time scheduling (Operation not permitted",
    "LimitRTPRIO=50",
    "LimitMEMLOCK=infinity",
    "setcap cap_sys_nice,cap_ipc_lock+ep",
    "/etc/security/limits.conf",
];

fn session() -> Session {
    let session = Session::new();
    session.file("arm.yaml", arm_at(10)).file("test.yaml", SCENARIO);
    session.file(
        "tcp.yaml",
        "robots:\n  left: {init: arm.yaml, address: 'tcp://127.0.0.1:9'}\ngroups: {arms: [left]}\n",
    );
    session
}

/// Returns a command that runs the program without permission for real-time scheduling and locked memory, even if root runs the tests.
fn without_permission(session: &Session, args: &[&str]) -> Command {
    let mut command = Command::new("prlimit");
    command.args(["--rtprio=0:0", "--memlock=65536:65536"]);
    if rustix::process::geteuid().is_root() {
        command.args(["setpriv", "--bounding-set=-sys_nice,-ipc_lock"]);
    }
    command
        .arg(program())
        .args(args)
        .current_dir(session.path("."))
        .env("DOWNBEAT_STATE", session.path("state"));
    command
}

/// The process of a listening robot, which is killed when this is dropped.
struct Robot {
    child: Child,
}

impl Robot {
    fn start(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert!(line.contains("listens on"), "{line}");
        Self { child }
    }

    /// Returns the kernel's number of the scheduling policy of the thread that wakes robots, and the process's locked memory in kB.
    fn granted(&self) -> (u32, u64) {
        let of = |path: &str| std::fs::read_to_string(format!("/proc/{}/{path}", self.child.id())).unwrap();
        let locked = of("status");
        let locked = locked.lines().find_map(|line| line.strip_prefix("VmLck:")).unwrap();
        let locked = locked.trim().trim_end_matches(" kB").parse().unwrap();
        let tasks = std::fs::read_dir(format!("/proc/{}/task", self.child.id())).unwrap();
        let policy = tasks.into_iter().find_map(|task| {
            let stat = of(&format!("task/{}/stat", task.unwrap().file_name().display()));
            // The name in parentheses is the second word, the policy the 41st.
            let rest = stat.split_once("(robots) ")?.1;
            rest.split(' ').nth(38)?.parse().ok()
        });
        (policy.unwrap(), locked)
    }

    /// Terminates the robot as a service manager does, by SIGTERM, and returns its standard error output.
    fn said(mut self) -> String {
        rustix::process::kill_process(Pid::from_child(&self.child), Signal::TERM).unwrap();
        let mut said = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        said
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _gone = self.child.kill();
        let _reaped = self.child.wait();
    }
}

const ROBOT: [&str; 5] = ["robot", "--init", "arm.yaml", "--listen", "127.0.0.1:0"];

#[test]
fn robot_without_permission_reports_remedy_in_one_line_and_continues() {
    let session = session();
    for format in ["text", "json"] {
        let mut command = without_permission(&session, &ROBOT);
        command.args(["--format", format]);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let robot = Robot { child };
        let (policy, locked) = robot.granted();
        assert_eq!((policy, locked), (0, 0));
        let said = robot.said();
        assert_eq!(said.lines().count(), 1, "{said}");
        REFUSED.iter().for_each(|part| assert!(said.contains(part), "no `{part}`: {said}"));
    }
}

#[test]
fn robot_uses_and_reports_permitted_real_time_scheduling() {
    let permitted = Command::new("chrt").args(["-f", "50", "true"]).stderr(Stdio::null()).status();
    let permitted = permitted.is_ok_and(|status| status.success());
    let session = session();
    let robot = Robot::start(session.command(&ROBOT));
    let (policy, locked) = robot.granted();
    let said = robot.said();
    assert_eq!(said.lines().count(), 1, "{said}");
    assert_eq!(policy == 1, permitted, "{said}");
    assert_eq!(said.contains("real-time scheduling (SCHED_FIFO, priority 50)"), permitted, "{said}");
    assert_eq!(said.contains(", memory locked"), locked > 0, "{locked} kB: {said}");
}

#[test]
fn disabled_real_time_scheduling_is_neither_requested_nor_reported() {
    let session = session();
    let mut command = session.command(&ROBOT);
    command.args(["--realtime", "off"]);
    let robot = Robot::start(command);
    assert_eq!(robot.granted(), (0, 0));
    assert_eq!(robot.said(), "");
}

#[test]
fn missing_required_real_time_scheduling_is_reported_and_prevents_start() {
    let session = session();
    session.file("edge.sh", "touch moved; cat > /dev/null");
    let edge = ["edge", "--init", "arm.yaml", "--listen", "127.0.0.1:0", "--driver", "program:sh edge.sh"];
    let commands: [&[&str]; 5] =
        [&ROBOT, &edge, &["sim", "tcp.yaml"], &["run", "test.yaml"], &["preflight", "test.yaml"]];
    for command in commands {
        let mut refused = without_permission(&session, command);
        let ran = Ran(refused.args(["--realtime", "required"]).output().unwrap());
        ran.says(2, &REFUSED);
        assert!(!ran.out().contains("listens on"), "{}", ran.text());
    }
    assert!(!session.path("moved").exists(), "the driver was started");
}

#[test]
fn mission_reports_denied_real_time_scheduling_and_still_plays() {
    let session = session();
    let ran = Ran(without_permission(&session, &["run", "test.yaml"]).output().unwrap());
    ran.says(0, &REFUSED);
    let ran = session.run(&["run", "test.yaml", "--realtime", "off"]);
    assert!(!ran.text().contains("real-time"), "{}", ran.text());
}

#[test]
fn invalid_realtime_option_is_rejected_with_valid_choices() {
    let session = session();
    session.run(&["robot", "--init", "arm.yaml", "--realtime", "on"]).says(2, &["auto, off, required"]);
}

#[test]
fn preflight_reports_wake_up_delay_and_granted_scheduling() {
    let session = session();
    let ran = Ran(without_permission(&session, &["preflight", "test.yaml"]).output().unwrap());
    ran.says(0, &["this host wakes up", "(median)", "(p99)", "no real-time scheduling", "LimitRTPRIO=50"]);
    let report = session.run(&["preflight", "test.yaml", "--realtime", "off", "--format", "json"]).json();
    let figure = |name: &str| report["wake_up"][name].as_f64().unwrap();
    assert!(figure("median_ms") <= figure("p99_ms") && figure("p99_ms") <= figure("longest_ms"), "{report}");
    assert_eq!(report["wake_up"]["scheduling"], "ordinary scheduling");
}
