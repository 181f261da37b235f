//! Checks that the crates' examples, which users copy, work: each is compiled and run here.

use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, mpsc};

use downbeat::conformance::{Options, Verdict, examine};
use downbeat::report::Outcome;
use downbeat::show::{Detail, report_text};
use downbeat_robot::{Host, HostOptions, serve};
use tokio::net::TcpListener;
use urrcp::{
    Command as Signal, ControlRequest, ControlType, Decoder, Message, Setpoint, Span, Status, encode,
};

use stage::held_up::played;
use stage::quiet::await_that;
use stage::session::root;
use stage::standstill::undisturbed;

#[expect(dead_code, reason = "its main is not called")]
#[path = "../../../robot/examples/driver.rs"]
mod driver;
#[expect(dead_code, reason = "its main is not called")]
#[path = "../../../robot/examples/machine.rs"]
mod machine;
#[expect(dead_code, reason = "its main is not called")]
#[path = "../../../robot/examples/robot.rs"]
mod robot;
#[expect(dead_code, reason = "its main is not called")]
#[path = "../../../scheduler/examples/scheduler.rs"]
mod scheduler;

/// Runs a server on a free port in a thread that ends with the test process. Returns the address.
fn served<F: Future>(serve: impl FnOnce(TcpListener) -> F + Send + 'static) -> SocketAddr {
    let (tell, told) = mpsc::channel();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Runtime::new().unwrap();
        runtime.block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            tell.send(listener.local_addr().unwrap()).unwrap();
            serve(listener).await
        });
    });
    told.recv().unwrap()
}

#[test]
fn example_robot_conforms_to_the_protocol() {
    let host = Host::start(vec![robot::arm().unwrap()], HostOptions::default()).unwrap();
    let handle = host.handle();
    let address = served(async |listener| serve(listener, handle, 0).await.unwrap());
    let device = Some("elbow".parse().unwrap());
    let options = Options { device, tolerance: Span::from_millis(150), ..Options::default() };
    let failed = || {
        let stop = Arc::new(AtomicBool::new(false));
        let examined = examine(address, options.clone(), stop, &mut |_, _| {}).unwrap();
        let failed = examined.judged.iter().filter(|judged| judged.verdict == Verdict::Fail);
        failed.map(|judged| format!("{}: {}", judged.requirement, judged.why)).collect::<Vec<_>>()
    };
    let failed = undisturbed(failed, Vec::is_empty);
    assert!(failed.is_empty(), "{failed:#?}");
}

/// Starts simulated hardware that receives command lines. Returns its address, and a channel with the values that it was set to.
fn hardware() -> (SocketAddr, mpsc::Receiver<(String, f64)>) {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let (tell, told) = mpsc::channel();
    std::thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        let mut answers = stream.try_clone().unwrap();
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            let words: Vec<_> = line.split(' ').collect();
            let answer = match words.as_slice() {
                ["read", _] => "21.5",
                ["set", device, value] => {
                    tell.send(((*device).to_owned(), value.parse().unwrap())).unwrap();
                    "ok"
                }
                _ => "ok",
            };
            writeln!(answers, "{answer}").unwrap();
        }
    });
    (address, told)
}

/// Sends a request and returns the first answer to it.
fn answer(stream: &mut TcpStream, request: ControlRequest) -> Status {
    use std::io::Read;
    let (mut bytes, mut decoder, mut buffer) = (Vec::new(), Decoder::default(), [0; 4_096]);
    encode(&request.into(), &mut bytes);
    stream.write_all(&bytes).unwrap();
    loop {
        match decoder.next_message() {
            Some(Ok(Message::ControlResponse(response))) => return response.status,
            Some(other) => panic!("{other:?}"),
            None => {
                let count = stream.read(&mut buffer).unwrap();
                assert_ne!(count, 0, "the robot has closed the connection");
                decoder.push(&buffer[..count]);
            }
        }
    }
}

#[test]
fn example_driver_sets_and_reads_its_hardware() {
    let description = r#"{"id": "hall", "api_version": "1", "devices": [
        {"id": "fan", "available_control_types": {"speed": {"min_value": 0, "max_value": 9, "granularity": 1}}},
        {"id": "warmth", "available_control_types": {"sensor": {"min_value": -40, "max_value": 80}}}]}"#;
    let (hardware, set) = hardware();
    let robot = driver::robot(description, hardware.to_string()).unwrap();
    let host = Host::start(vec![robot], HostOptions::default()).unwrap();
    let handle = host.handle();
    let address = served(async |listener| serve(listener, handle, 0).await.unwrap());
    let mut stream = TcpStream::connect(address).unwrap();
    let fan = || {
        ControlRequest::immediate("fan".parse().unwrap(), Signal::Set(Setpoint::new(ControlType::Speed, 7.0)))
    };
    // Until the driver has connected, the robot refuses.
    await_that("the driver's connection", || answer(&mut stream, fan()) == Status::Accepted);
    assert_eq!(set.recv().unwrap(), ("fan".to_owned(), 7.0));
    let warmth = ControlRequest::immediate("warmth".parse().unwrap(), Signal::ReadSensor);
    let mut other = TcpStream::connect(address).unwrap();
    assert_eq!(answer(&mut other, warmth), Status::Provide);
}

#[test]
fn example_machine_sets_each_step_at_its_time() {
    let told = machine::play().unwrap();
    let set: Vec<_> = told.iter().filter(|line| line.contains("set lamp")).collect();
    assert_eq!(set.len(), 3, "{told:#?}");
    assert!(set[0].starts_with("1000") || set[0].starts_with("1 s"), "{told:#?}");
    assert!(told.last().unwrap().ends_with("says OK"), "{told:#?}");
}

#[test]
fn example_scheduler_plays_a_show() {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let (fleet, scenario) = (root().join("fleet.yaml"), root().join("scripts/examples/swap.yaml"));
    let play = || {
        let (_operator, orders) = tokio::sync::mpsc::channel(1);
        runtime.block_on(scheduler::play(&fleet, &scenario, orders)).unwrap()
    };
    let report = played(play, |report| report_text(report, Detail::Full, 100));
    let is_whole = matches!(report.outcome, Outcome::Done | Outcome::OutOfTolerance { .. });
    assert!(is_whole && report.robots.iter().all(|robot| robot.steps_done > 0), "{report:#?}");
}
