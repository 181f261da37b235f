//! What strangers do to a robot and its owner: how late it starts, how long it takes to answer, how much memory it takes.
//!
//! `cargo run --release --example strangers`, or with the name of one attack. The robot is a process of its own with 8,000
//! devices. Its owner asks every 20 ms and plays a script of 100 steps each second, while 14 strangers attack.
#![expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "an example for a terminal that measures"
)]

use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Child, Command as Process, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use downbeat_robot::simulated::{Settings, SimulatedRobot};
use downbeat_robot::urrcp::{
    Command, ControlRequest, ControlType, Device, DeviceId, InitializationBlock, Limits, Message, Millis,
    Robot, Script, ScriptParameters, Server, Setpoint, Step, StopCondition, Timestamp, encode,
};
use downbeat_robot::{Host, HostOptions, serve};

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

const DEVICES: usize = 8_000;
const STRANGERS: usize = 14;
const SECONDS: u64 = 8;
const ATTACKS: &[&str] = &["none", "descriptions-unread", "descriptions", "scripts-of-8-mb", "noise", "drip"];

fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    match (arguments.next().as_deref(), arguments.next()) {
        (Some("--robot"), Some(log)) => robot(log.into()),
        (Some(attack), _) => measure(attack),
        (None, _) => ATTACKS.iter().try_for_each(|attack| measure(attack)),
    }
}

fn description() -> Outcome<InitializationBlock> {
    let degrees = Limits::new(0.0, 90.0, 1.0)?;
    let device = |i| {
        let device = Device::new(DeviceId::new(format!("device-{i}"))?).with_position(degrees.clone());
        Ok(device.with_scripts(ScriptParameters::new(degrees.clone(), 1_000)))
    };
    let devices = (0..DEVICES).map(device).collect::<Outcome<Vec<_>>>()?;
    let mut block = InitializationBlock::new("besieged".parse()?, devices)?;
    block.reports = true;
    Ok(block)
}

/// The robot's process: says where it listens, and serves until it is killed.
fn robot(log: std::path::PathBuf) -> Outcome<()> {
    let robot = SimulatedRobot::new(description()?, Settings::default());
    let host = Host::start(vec![robot], HostOptions::default().with_log(log))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await?;
        println!("{}", listener.local_addr()?);
        serve(listener, host.handle(), 0).await?;
        Ok(())
    })
}

struct Besieged(Child);

impl Drop for Besieged {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}

fn measure(attack: &str) -> Outcome<()> {
    let log = std::env::temp_dir().join(format!("downbeat-strangers-{}.jsonl", std::process::id()));
    let mut process = Process::new(std::env::current_exe()?);
    let mut child = Besieged(process.arg("--robot").arg(&log).stdout(Stdio::piped()).spawn()?);
    let mut address = String::new();
    BufReader::new(child.0.stdout.take().ok_or("no output")?).read_line(&mut address)?;
    let address: SocketAddr = address.trim().parse()?;

    let over = Arc::new(AtomicBool::new(false));
    let mut owner = Owner::connected(address)?;
    owner.round_trip()?;
    let strangers: Vec<_> = (0..STRANGERS)
        .map(|_| {
            let (over, attack) = (Arc::clone(&over), attack.to_owned());
            thread::spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    // A stranger that was hung up on comes again.
                    let _hung_up = stranger(address, &attack, &over);
                    thread::sleep(Duration::from_millis(20));
                }
            })
        })
        .collect();
    let told = owner.play(Duration::from_secs(SECONDS));
    let memory = memory_mib(&child)?;
    over.store(true, Ordering::Relaxed);
    drop(child);
    let _ended: Vec<_> = strangers.into_iter().map(thread::JoinHandle::join).collect();

    let late = percentiles(start_errors(&log)?);
    std::fs::remove_file(&log)?;
    let trips = percentiles(owner.trips);
    println!("{attack}: {told:?}; the robot's process took {memory} MiB at most");
    println!(
        "  set late by (us)      p50 {:9.1}  p90 {:9.1}  p99 {:9.1}  max {:9.1}  of {}",
        late[0], late[1], late[2], late[3], late[4]
    );
    println!(
        "  owner's round trip(us) p50 {:8.1}  p90 {:9.1}  p99 {:9.1}  max {:9.1}  of {}",
        trips[0], trips[1], trips[2], trips[3], trips[4]
    );
    Ok(())
}

/// The largest memory of the robot's process.
fn memory_mib(child: &Besieged) -> Outcome<u64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", child.0.id()))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).ok_or("no VmHWM")?;
    Ok(line.trim().trim_end_matches(" kB").parse::<u64>()? / 1024)
}

#[derive(serde::Deserialize)]
struct Set {
    due: Timestamp<Robot>,
    set_at: Timestamp<Robot>,
}

fn start_errors(log: &std::path::Path) -> Outcome<Vec<f64>> {
    let text = std::fs::read_to_string(log)?;
    let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    let late = |line| {
        let Set { due, set_at } = serde_json::from_str(line)?;
        Ok((set_at - due).as_millis_f64() * 1_000.0)
    };
    whole.lines().map(late).collect()
}

#[expect(clippy::cast_precision_loss, reason = "a count of some thousands")]
fn percentiles(mut values: Vec<f64>) -> [f64; 5] {
    values.sort_unstable_by(f64::total_cmp);
    let rank = |percent: usize| {
        let index = (values.len() * percent).div_ceil(100).saturating_sub(1);
        values.get(index).copied().unwrap_or(f64::NAN)
    };
    [rank(50), rank(90), rank(99), rank(100), values.len() as f64]
}

/// Who has claimed the robot.
struct Owner {
    stream: BufReader<TcpStream>,
    trips: Vec<f64>,
}

/// What became of the owner's scripts.
#[derive(Debug, Default)]
struct Played {
    sent: usize,
    completed: usize,
    failed: Vec<String>,
    lost: Option<String>,
}

impl Owner {
    fn connected(address: SocketAddr) -> Outcome<Self> {
        let stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(Duration::from_secs(10)))?;
        Ok(Self { stream: BufReader::new(stream), trips: Vec::new() })
    }

    fn next(&mut self) -> Outcome<Message> {
        let mut line = String::new();
        match self.stream.read_line(&mut line)? {
            0 => Err("the robot has hung up on its owner".into()),
            _ => Ok(serde_json::from_str(&line)?),
        }
    }

    /// Asks for availability; what else comes is returned.
    fn round_trip(&mut self) -> Outcome<Vec<Message>> {
        let begun = Instant::now();
        self.stream.get_mut().write_all(b"{\"availability_request\":{\"session\":\"show\"}}\n")?;
        let mut others = Vec::new();
        loop {
            match self.next()? {
                Message::AvailabilityResponse(_) => break,
                other => others.push(other),
            }
        }
        self.trips.push(begun.elapsed().as_secs_f64() * 1e6);
        Ok(others)
    }

    fn play(&mut self, time: Duration) -> Played {
        let (begun, mut played) = (Instant::now(), Played::default());
        let lost = loop {
            if begun.elapsed() >= time + Duration::from_secs(2) {
                break None;
            }
            let due = Duration::from_secs(u64::try_from(played.sent).unwrap_or(u64::MAX));
            if begun.elapsed() >= due && begun.elapsed() < time {
                if let Err(error) = self.send_script(played.sent) {
                    break Some(error);
                }
                played.sent += 1;
            }
            match self.round_trip() {
                Ok(others) => others.iter().for_each(|message| {
                    let Message::ControlResponse(response) = message else { return };
                    match (&response.error, response.steps_done) {
                        (Some(error), _) => played.failed.push(error.to_string()),
                        (None, Some(_)) => played.completed += 1,
                        _ => {}
                    }
                }),
                Err(error) => break Some(error),
            }
            thread::sleep(Duration::from_millis(20));
        };
        played.lost = lost.map(|error| error.to_string());
        played
    }

    /// 100 steps, 8 ms apart, from 150 ms from now on, under a lease of 500 ms.
    fn send_script(&mut self, number: usize) -> Outcome<()> {
        let step = |i: u32| {
            let value = if i.is_multiple_of(2) { 10.0 } else { 20.0 };
            Ok(Step::new(Millis::new(f64::from(i) * 8.0)?, Setpoint::new(ControlType::Position, value)))
        };
        let script = Script::new((0..100).map(step).collect::<Outcome<Vec<_>>>()?)?;
        let wall = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?;
        let now: Timestamp<Server> = Timestamp::from_nanos(i64::try_from(wall.as_nanos())?);
        let device = DeviceId::new(format!("device-{}", number % DEVICES))?;
        let lease = Millis::new(500.0)?;
        let mut request = ControlRequest::deferred(now, Millis::new(150.0)?, device, Command::Script(script))
            .with_request_id(format!("script-{number}").parse()?)
            .with_stop_condition(StopCondition { pending: Some(lease), running: Some(lease) });
        request.session = Some("show".parse()?);
        let mut bytes = Vec::new();
        encode(&request.into(), &mut bytes);
        self.stream.get_mut().write_all(&bytes)?;
        Ok(())
    }
}

/// Attacks until it is hung up on.
fn stranger(address: SocketAddr, attack: &str, over: &AtomicBool) -> Outcome<()> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_write_timeout(Some(Duration::from_secs(1)))?;
    let questions = b"{\"initialization_request\":{}}\n".repeat(2 * 1024 * 1024 / 30);
    match attack {
        "descriptions-unread" => stream.write_all(&questions)?,
        "descriptions" => {
            let mut reader = stream.try_clone()?;
            let reading = thread::spawn(move || {
                let mut bytes = vec![0; 65_536];
                while reader.read(&mut bytes).is_ok_and(|n| n > 0) {}
            });
            let asked = stream.write_all(&questions);
            stream.shutdown(std::net::Shutdown::Both)?;
            let _ended = reading.join();
            asked?;
        }
        "scripts-of-8-mb" => {
            let step = br#"{"time_offset_to_start":0,"control_type":"position","control_value":45}"#;
            let list = vec![step.as_slice(); 8_000_000 / step.len()].join(&b',');
            let mut line =
                br#"{"control_request":{"device_id":"device-0","control_type":"script","control_value":["#
                    .to_vec();
            line.extend(list);
            line.extend_from_slice(b"]}}\n");
            while !over.load(Ordering::Relaxed) {
                stream.write_all(&line)?;
            }
        }
        "noise" => {
            let noise = b"[{\"control_request\":1},2,\"noise\"]\n".repeat(10_000);
            while !over.load(Ordering::Relaxed) {
                stream.write_all(&noise)?;
            }
        }
        "drip" => {
            stream.write_all(b"{\"availability_request\":{}}\n")?;
            while !over.load(Ordering::Relaxed) {
                stream.write_all(b" ")?;
                thread::sleep(Duration::from_millis(100));
            }
        }
        _ => {}
    }
    while !over.load(Ordering::Relaxed) {
        thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}
