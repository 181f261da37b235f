//! Measures how fast messages are parsed, compared with the JSON library alone. Also measures the size and speed of compact encodings.
//!
//! `cargo bench -p urrcp --bench codec`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]

use std::hint::black_box;

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use urrcp::{
    Command, ControlRequest, ControlType, Decoder, DeviceId, Encoding, Message, Millis, RequestId, Script,
    Setpoint, Step, StopCondition, Timestamp, encode, encode_as,
};

/// Number of rounds. A measurement and its baseline run alternately; each result is the median over all rounds.
const ROUNDS: usize = 15;
/// In each round, a measurement repeats its work until it has used this much CPU time, in seconds.
const ROUND_TIME: f64 = 0.02;

/// Returns a request with a script such as the compiler produces: a step every 20 ms, with values that are multiples of 0.001.
fn request(steps: u32) -> Message {
    let step = |i: u32| Step {
        offset: Millis::new(f64::from(i) * 20.0).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, f64::from(i * 7_919 % 180_000) / 1_000.0 - 90.0),
        stop_condition: None,
    };
    let script = Script::new((0..steps).map(step).collect()).unwrap();
    let command = Command::Script(script);
    Message::ControlRequest(ControlRequest {
        timestamp: Some(Timestamp::from_nanos(1_795_028_400_123_456_789)),
        time_offset_to_start: Some(Millis::new(1_500.0).unwrap()),
        stop_condition: Some(StopCondition::both(Millis::new(2_000.0).unwrap())),
        request_id: Some(RequestId::new("wave/arm-1/shoulder/0").unwrap()),
        content_hash: Some(command.content_hash()),
        ..ControlRequest::immediate(DeviceId::new("shoulder").unwrap(), command)
    })
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

type Work<'a> = Box<dyn FnMut() + 'a>;

/// Returns the CPU time of this thread in seconds. It does not depend on other load on the machine.
fn computed() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

/// Returns the mean CPU time per call of `work`, in seconds.
fn once(work: &mut dyn FnMut()) -> f64 {
    let begin = computed();
    let mut count = 0;
    while computed() - begin < ROUND_TIME {
        work();
        count += 1;
    }
    (computed() - begin) / f64::from(count)
}

/// Returns the median CPU time per call of each of `works`, in seconds. They take turns, so that other load affects all of them equally.
fn measure(works: &mut [(&str, Work<'_>)]) -> Vec<f64> {
    let mut times = vec![Vec::new(); works.len()];
    for _ in 0..ROUNDS {
        for (times, (_, work)) in times.iter_mut().zip(works.iter_mut()) {
            times.push(once(work));
        }
    }
    times.into_iter().map(median).collect()
}

fn decoding(steps: u32) {
    let message = request(steps);
    let mut line = Vec::new();
    encode(&message, &mut line);
    let mut frame = Vec::new();
    encode_as(Encoding::MessagePack, &message, &mut frame);
    let (mut lines, mut frames) = (Decoder::default(), Decoder::default());
    let mut works: Vec<(&str, Work<'_>)> = vec![
        (
            "serde_json::Value",
            Box::new(|| {
                black_box(serde_json::from_slice::<serde_json::Value>(black_box(&line)).unwrap());
            }),
        ),
        (
            "serde_json, typed",
            Box::new(|| {
                black_box(serde_json::from_slice::<Message>(black_box(&line)).unwrap());
            }),
        ),
        (
            "decoder, line",
            Box::new(|| {
                lines.push(black_box(&line));
                assert!(black_box(lines.next_message()).is_some_and(|decoded| decoded.is_ok()));
            }),
        ),
        (
            "decoder, frame",
            Box::new(|| {
                frames.push(black_box(&frame));
                assert!(black_box(frames.next_message()).is_some_and(|decoded| decoded.is_ok()));
            }),
        ),
    ];
    let times = measure(&mut works);
    println!(
        "{steps} steps, {} bytes of JSON, {} as a frame; rates in bytes of JSON (bound for 100 steps: 300 MB/s or 3 times):",
        line.len(),
        frame.len()
    );
    for ((name, _), time) in works.iter().zip(&times) {
        let rate = line.len() as f64 / time / 1e6;
        println!("  {name:<18} {rate:>7.0} MB/s  {:>5.2} times serde_json::Value", times[0] / time);
    }
}

/// An encoding that the benchmark compares with others.
struct Candidate {
    name: &'static str,
    write: fn(&Message) -> Vec<u8>,
    read: fn(&[u8]) -> Message,
}

/// Encodes `message` as MessagePack, with key names, times and hashes as in JSON.
fn write_names(message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut serializer = rmp_serde::Serializer::new(&mut bytes).with_struct_map().with_human_readable();
    message.serialize(&mut serializer).unwrap();
    bytes
}

fn read_names(bytes: &[u8]) -> Message {
    let mut deserializer = rmp_serde::Deserializer::from_read_ref(bytes).with_human_readable();
    Message::deserialize(&mut deserializer).unwrap()
}

const CANDIDATES: [Candidate; 5] = [
    Candidate {
        name: "JSON (serde_json)",
        write: |message| serde_json::to_vec(message).unwrap(),
        read: |bytes| serde_json::from_slice(bytes).unwrap(),
    },
    Candidate { name: "MessagePack as JSON (rmp-serde)", write: write_names, read: read_names },
    Candidate {
        name: "MessagePack, short steps (rmp-serde)",
        write: |message| rmp_serde::to_vec_named(message).unwrap(),
        read: |bytes| rmp_serde::from_slice(bytes).unwrap(),
    },
    Candidate {
        name: "CBOR, short steps (ciborium)",
        write: |message| {
            let mut bytes = Vec::new();
            ciborium::into_writer(message, &mut bytes).unwrap();
            bytes
        },
        read: |bytes| ciborium::from_reader(bytes).unwrap(),
    },
    Candidate {
        name: "CBOR, short steps (cbor4ii)",
        write: |message| cbor4ii::serde::to_vec(Vec::new(), message).unwrap(),
        read: |bytes| cbor4ii::serde::from_slice(bytes).unwrap(),
    },
];

/// Prints the table of sizes and times in `docs/encoding.md`.
fn encodings() {
    println!("| encoding | steps | bytes | of JSON | write, us | read, us |");
    println!("|---|--:|--:|--:|--:|--:|");
    for steps in [1, 100, 10_000] {
        let message = request(steps);
        let written: Vec<_> = CANDIDATES.iter().map(|candidate| (candidate.write)(&message)).collect();
        let mut works: Vec<(&str, Work<'_>)> = Vec::new();
        for (candidate, bytes) in CANDIDATES.iter().zip(&written) {
            assert_eq!((candidate.read)(bytes), message, "{}", candidate.name);
            let message = &message;
            works.push((
                candidate.name,
                Box::new(move || drop(black_box((candidate.write)(black_box(message))))),
            ));
            works.push((
                candidate.name,
                Box::new(move || drop(black_box((candidate.read)(black_box(bytes))))),
            ));
        }
        let times = measure(&mut works);
        for ((candidate, bytes), times) in CANDIDATES.iter().zip(&written).zip(times.chunks(2)) {
            println!(
                "| {} | {steps} | {} | {:.0} % | {:.1} | {:.1} |",
                candidate.name,
                bytes.len(),
                100.0 * bytes.len() as f64 / written[0].len() as f64,
                times[0] * 1e6,
                times[1] * 1e6,
            );
        }
    }
}

fn main() {
    let only = std::env::args().nth(1).filter(|name| !name.starts_with('-'));
    let wanted = |name: &str| only.as_ref().is_none_or(|only| only == name);
    if wanted("decoder") {
        for steps in [1, 100, 10_000] {
            decoding(steps);
        }
    }
    if wanted("encodings") {
        encodings();
    }
}
