//! Missions of six robots while strangers attack one of them. No robot starts late, and the report is true. Neither the scheduler nor the
//! robot exceeds its memory limit.

use std::io::Write;
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::Duration;

use serde_json::json;

use stage::held_up::played;
use stage::play::{Play, SHORT, SOON};
use stage::quiet::await_that;
use stage::{Ended, Stage, Via};

/// Maximum memory of the scheduler and of the robot, in megabytes, whatever strangers send.
const MEGABYTES_MAX: u64 = 200;
const STRANGERS: usize = 14;

/// What a stranger sends. It repeats this until it is disconnected, and then connects again.
#[derive(Clone, Copy, Debug)]
enum Attack {
    /// The stranger requests the description again and again, and reads no answer.
    Unread,
    /// The stranger sends scripts of 8 MB.
    LongScripts,
    /// The stranger sends lines that are not messages.
    Noise,
    /// The stranger occupies a connection and occasionally sends a byte.
    Drip,
    /// The stranger requests more readings than a robot can remember.
    Readings,
    /// The stranger sends a command that starts in a year.
    NextYear,
    /// The stranger sends a stop with a future timestamp. If the robot accepted it, all earlier messages would be too old.
    FutureStop,
    /// The stranger names the mission's session, without its key: to claim the robot, to stop it, and to renew its leases.
    Session,
}

impl Attack {
    const ALL: [Self; 8] = [
        Self::Unread,
        Self::LongScripts,
        Self::Noise,
        Self::Drip,
        Self::Readings,
        Self::NextYear,
        Self::FutureStop,
        Self::Session,
    ];

    fn bytes(self) -> Vec<u8> {
        let line = |message: serde_json::Value| format!("{message}\n").into_bytes();
        let ahead = |by: i64| {
            let at = stage::epoch_nanos() + by * 1_000_000_000;
            serde_json::to_value(urrcp::Timestamp::<urrcp::Server>::from_nanos(at)).unwrap()
        };
        match self {
            Self::Unread => line(json!({"initialization_request": {}})).repeat(10_000),
            Self::LongScripts => {
                let step = json!({"time_offset_to_start": 0, "control_type": "position", "control_value": 45});
                let list = vec![step; 8_000_000 / 75];
                line(json!({"control_request": {"device_id": "d", "control_type": "script", "control_value": list}}))
            }
            Self::Noise => b"[{\"control_request\":1},2,\"noise\"]\n".repeat(10_000),
            Self::Drip => b" ".to_vec(),
            Self::Readings => (0..5_000)
                .flat_map(|i| line(json!({"control_request": {"device_id": "d", "control_type": "read_sensor", "request_id": format!("x{i}")}})))
                .collect(),
            Self::NextYear => line(json!({"control_request": {"device_id": "d", "control_type": "position", "control_value": 7,
                "timestamp": ahead(0), "time_offset_to_start": 31_536_000_000_u64}})),
            Self::FutureStop => line(json!({"control_request": {"device_id": "d", "control_type": "script", "control_value": [],
                "timestamp": ahead(86_000)}})),
            Self::Session => {
                let claim = json!({"availability_request": {"session": "play", "timestamp": ahead(0)}});
                let stop = json!({"control_request": {"device_id": "d", "control_type": "script", "control_value": [],
                    "timestamp": ahead(0), "session": "play"}});
                [line(claim), line(stop)].concat()
            }
        }
    }

    /// Connects and attacks until the robot disconnects or the test is over.
    fn once(self, port: u16, state: &State) -> std::io::Result<()> {
        let mut stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.set_write_timeout(Some(Duration::from_secs(1)))?;
        let bytes = self.bytes();
        while !state.over.load(Ordering::Relaxed) {
            let taken = stream.write_all(&bytes);
            state.attacks.fetch_add(1, Ordering::Relaxed);
            taken?;
            match self {
                Self::Noise | Self::LongScripts => {}
                _ => sleep(Duration::from_millis(50)),
            }
        }
        stream.shutdown(Shutdown::Both)
    }
}

#[derive(Default)]
struct State {
    over: AtomicBool,
    /// Number of attacks that were sent, completely or in part.
    attacks: AtomicUsize,
}

struct Attackers {
    state: Arc<State>,
    threads: Vec<JoinHandle<()>>,
}

impl Attackers {
    fn start(attack: Attack, port: u16) -> Self {
        let state = Arc::<State>::default();
        let stranger = |_| {
            let state = Arc::clone(&state);
            spawn(move || {
                while !state.over.load(Ordering::Relaxed) {
                    let _hung_up = attack.once(port, &state);
                    sleep(Duration::from_millis(20));
                }
            })
        };
        let threads = (0..STRANGERS).map(stranger).collect();
        Self { state, threads }
    }

    /// Waits until the strangers have made as many attacks as there are strangers.
    fn are_under_way(&self) {
        await_that("the attack", || self.state.attacks.load(Ordering::Relaxed) >= STRANGERS);
    }

    fn end(self) {
        self.state.over.store(true, Ordering::Relaxed);
        self.threads.into_iter().for_each(|thread| thread.join().unwrap());
    }
}

const PLAY: Play = Play { steps: 20, on_failure: "without", ..SHORT };

#[expect(clippy::print_stdout, reason = "prints its figures with --nocapture")]
fn is_played_next_to(attack: Attack, stage: impl Fn() -> Stage) {
    // A new stage per attempt: otherwise the logs of an attempt for which this machine was too slow would affect the next one.
    let play = || {
        let stage = stage();
        let (ended, peak) = next_to(attack, &stage);
        (stage, ended, peak)
    };
    let (stage, ended, peak) = played(play, |(_, ended, _)| ended.said());
    let robot = stage.robots[0].memory();
    assert!(peak > 0 && robot > 0, "memory was not measured");
    assert!(peak < MEGABYTES_MAX && robot < MEGABYTES_MAX, "{attack:?}: {peak} MB and {robot} MB");
    let report = ended.report();
    assert_eq!(report["outcome"], "done", "{attack:?}: {ended}");
    assert_eq!(report["failures"], json!([]), "{attack:?}: {ended}");
    stage.robots.iter().for_each(|robot| PLAY.was_played_by(robot));
    let starts = || stage.robots.iter().map(|robot| robot.sets()[0].at);
    let spread = starts().max().unwrap() - starts().min().unwrap();
    println!("{attack:?}: scheduler {peak} MB, robot {robot} MB, starts within {} us", spread / 1_000);
    // A mission with the outcome `done` has started within its tolerance of a second, by the robots' own reports.
    assert!(spread < 2_000_000_000, "{attack:?}: {spread} ns");
}

/// Plays the mission during an attack. Returns its result, and the peak memory usage of the scheduler in megabytes.
fn next_to(attack: Attack, stage: &Stage) -> (Ended, u64) {
    let attackers = || Attackers::start(attack, stage.robots[0].port());
    // Anyone may claim a free robot without keys, and then the mission does not begin.
    let before = (!matches!(attack, Attack::Session)).then(attackers);
    before.iter().for_each(Attackers::are_under_way);
    let mut run = stage.start(&["run", "play.yaml", "--format", "json"]);
    let attackers = before.unwrap_or_else(|| {
        stage.robots[0].await_sets(1, SOON);
        attackers()
    });
    let mut peak = 0;
    while run.process.0.try_wait().unwrap().is_none() {
        // The last reading: before it becomes the program, the process is a copy of this one.
        peak = Some(run.process.memory()).filter(|now| *now > 0).unwrap_or(peak);
        sleep(Duration::from_millis(10));
    }
    let ended = run.ended();
    attackers.end();
    (ended, peak)
}

#[test]
fn attacks_on_a_robot_delay_no_mission_and_use_bounded_memory() {
    for attack in Attack::ALL {
        is_played_next_to(attack, || PLAY.stage(&[Via::Direct; 6]));
    }
}

#[test]
fn attacks_on_a_robot_with_keys_delay_no_mission_and_use_bounded_memory() {
    for attack in [Attack::Unread, Attack::Noise, Attack::Drip] {
        is_played_next_to(attack, || PLAY.stage_with_keys(&[Via::Direct; 6]));
    }
}
