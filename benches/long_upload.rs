//! Measures how late a robot's steps are while another robot of the same host (a process that runs several robots) receives long scripts
//! over TCP. The baseline is a host that receives none. The long scripts carry a `content_hash`, which the robot has to check. The thread
//! that runs the robots requests real-time scheduling. If the kernel grants it, other load on the machine does not affect the figures.
//!
//! `cargo bench --bench long_upload`
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a program that measures, and stops if it cannot"
)]
#![expect(clippy::disallowed_methods, reason = "real sockets take real time")]

use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use downbeat_robot::realtime::Realtime;
use downbeat_robot::simulated::{Settings, SimulatedRobot};
use downbeat_robot::{Host, HostOptions, LinkEvent, RobotLink};
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use urrcp::{
    Command, ControlRequest, ControlType, Decoder, DeviceId, InitializationBlock, Message, Millis, RequestId,
    Script, Server, Setpoint, Status, Step, Timestamp, encode,
};

/// Number of steps of each uploaded script.
const LONG: u32 = 10_000;
/// Number of steps of the script whose lateness is measured.
const WATCHED: u32 = 2_000;
/// Time between two steps of a script, in milliseconds.
const BEAT: f64 = 5.0;
/// Pause between two uploads.
const PAUSE: Duration = Duration::from_millis(50);

fn block(id: usize) -> InitializationBlock {
    let json = format!(
        r#"{{"id": "r{id}", "api_version": "1", "reports": true, "devices": [{{"id": "d", "name": "d", "available_control_types": {{
        "position": {{"min_value": 0, "max_value": 90, "granularity": 0.001}},
        "script": {{"min_value": 0, "max_value": 90, "granularity": 0.001, "max_number_of_steps": 10000}}}}}}]}}"#
    );
    serde_json::from_str(&json).unwrap()
}

fn request(steps: u32, id: String) -> ControlRequest {
    let step = |i: u32| Step {
        offset: Millis::new(f64::from(i) * BEAT).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, f64::from(i % 90_000) / 1_000.0),
        stop_condition: None,
    };
    let command = Command::Script(Script::new((0..steps).map(step).collect()).unwrap());
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
    let now = Timestamp::<Server>::from_nanos(i64::try_from(now.as_nanos()).unwrap());
    ControlRequest {
        timestamp: Some(now),
        time_offset_to_start: Some(Millis::new(500.0).unwrap()),
        request_id: Some(RequestId::new(id).unwrap()),
        content_hash: Some(command.content_hash()),
        ..ControlRequest::immediate(DeviceId::new("d").unwrap(), command)
    }
}

fn cancel() -> Message {
    let command = Command::Script(Script::cancel());
    Message::ControlRequest(ControlRequest::immediate(DeviceId::new("d").unwrap(), command))
}

/// Sends long scripts until the future is dropped. Cancels each script after the robot has accepted it.
async fn upload(address: std::net::SocketAddr) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let mut decoder = Decoder::new(urrcp::LINE_BYTES_MAX);
    for round in 0.. {
        let mut bytes = Vec::new();
        encode(&Message::ControlRequest(request(LONG, format!("long/{round}"))), &mut bytes);
        stream.write_all(&bytes).await.unwrap();
        heard(&mut stream, &mut decoder, Status::Accepted).await;
        bytes.clear();
        encode(&cancel(), &mut bytes);
        stream.write_all(&bytes).await.unwrap();
        heard(&mut stream, &mut decoder, Status::Ok).await;
        tokio::time::sleep(PAUSE).await;
    }
}

async fn heard(stream: &mut TcpStream, decoder: &mut Decoder, status: Status) {
    let mut bytes = vec![0; 64 * 1024];
    loop {
        while let Some(message) = decoder.next_message() {
            if matches!(message.unwrap(), Message::ControlResponse(response) if response.status == status) {
                return;
            }
        }
        let n = tokio::io::AsyncReadExt::read(stream, &mut bytes).await.unwrap();
        decoder.push(&bytes[..n]);
    }
}

async fn play(link: &mut RobotLink) {
    link.send(Message::ControlRequest(request(WATCHED, "watched".to_owned())));
    while let Some(event) = link.recv().await {
        if matches!(event, LinkEvent::Message(Message::ControlResponse(response)) if response.status == Status::Ok)
        {
            return;
        }
    }
}

/// Returns the lateness of each step of the measured script, in microseconds, in ascending order.
fn lateness(log: &PathBuf) -> Vec<f64> {
    let text = std::fs::read_to_string(log).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let time = |value: &serde_json::Value| {
        let time: Timestamp<Server> = serde_json::from_value(value.clone()).unwrap();
        time
    };
    let watched = lines.filter(|line| line["request_id"] == "watched");
    let mut late: Vec<f64> =
        watched.map(|line| (time(&line["set_at"]) - time(&line["due"])).as_millis_f64() * 1_000.0).collect();
    late.sort_by(f64::total_cmp);
    late
}

async fn measure(name: &str, uploads: bool) {
    let log = std::env::temp_dir().join(format!("downbeat-long-upload-{}.jsonl", std::process::id()));
    let robots = (0..2).map(|id| SimulatedRobot::new(block(id), Settings::default())).collect();
    let host =
        Host::start(robots, HostOptions::default().with_realtime(Realtime::Auto).with_log(log.clone()))
            .unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let serving = tokio::spawn(downbeat_robot::serve(listener, host.handle(), 0));
    let uploading = uploads.then(|| tokio::spawn(upload(address)));
    let mut link = host.handle().connect(1).unwrap();
    play(&mut link).await;
    uploading.inspect(tokio::task::JoinHandle::abort);
    serving.abort();
    host.stop();
    let late = lateness(&log);
    let _gone = std::fs::remove_file(&log);
    let at = |percent: usize| late[(late.len() - 1) * percent / 100];
    println!(
        "{name:<20} p50 {:>8.1} us   p90 {:>8.1} us   p99 {:>8.1} us   largest {:>8.1} us",
        at(50),
        at(90),
        at(99),
        at(100)
    );
}

fn main() {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    println!("how late {WATCHED} steps of one robot are, {BEAT} ms apart");
    for _ in 0..3 {
        runtime.block_on(measure("no uploads", false));
        runtime.block_on(measure("10,000-step scripts", true));
    }
}
