//! A robot that is not a Downbeat process. It answers like any robot, and may start to send far more than was requested.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::{Value, json};

/// When the robot starts to flood the connection on which it received a request.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Floods {
    Never,
    /// After the first request of the mission, whatever its kind.
    AtOnce,
    /// Together with its first availability response.
    WhenAvailable,
    /// This long after the start of an accepted script.
    AfterStarting(Duration),
}

/// What the robot's flood consists of.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Flood {
    /// Lines that are not messages.
    Garbage,
    /// Reports of failures with long reasons.
    Failures,
    /// Responses to requests that were never sent.
    Responses,
    /// The robot's own description, repeatedly.
    Blocks,
    /// A single line without an end.
    Line,
    /// Responses to availability requests that were allegedly sent a minute ago. If the scheduler believed them, its leads and leases
    /// would become long.
    Answers,
}

impl Flood {
    pub const ALL: [Self; 6] =
        [Self::Garbage, Self::Failures, Self::Responses, Self::Blocks, Self::Line, Self::Answers];
}

/// A robot with the device `d` that listens on a port of its own. Its threads end with their connections.
pub struct Raw {
    pub port: u16,
    heard: Arc<Mutex<Vec<String>>>,
    said: Arc<AtomicU64>,
    asked_on: Arc<AtomicU64>,
}

#[derive(Clone)]
struct Own {
    id: String,
    floods: Floods,
    flood: Flood,
    heard: Arc<Mutex<Vec<String>>>,
    said: Arc<AtomicU64>,
    asked_on: Arc<AtomicU64>,
}

impl Raw {
    pub fn start(id: &str, floods: Floods, flood: Flood) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let (heard, said, asked_on) = (Arc::default(), Arc::default(), Arc::default());
        let own = Own {
            id: id.to_owned(),
            floods,
            flood,
            heard: Arc::clone(&heard),
            said: Arc::clone(&said),
            asked_on: Arc::clone(&asked_on),
        };
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                let own = own.clone();
                std::thread::spawn(move || own.serve(stream));
            }
        });
        Self { port, heard, said, asked_on }
    }

    /// Returns the number of connections on which the robot's description was requested. A repeated request on the same connection, as a
    /// slow robot receives it, does not count.
    pub fn connections(&self) -> u64 {
        self.asked_on.load(Ordering::Relaxed)
    }

    /// Returns the messages of this kind that the robot has received. The value under the name of the kind is returned, not the whole
    /// message.
    pub fn heard(&self, kind: &str) -> Vec<Value> {
        let lines = self.heard.lock().unwrap();
        let of_kind = |line: &String| serde_json::from_str::<Value>(line).unwrap().get(kind).cloned();
        lines.iter().filter_map(of_kind).collect()
    }

    /// Returns the number of bytes of the flood that the peer has taken.
    pub fn flooded(&self) -> u64 {
        self.said.load(Ordering::Relaxed)
    }
}

impl Own {
    fn serve(&self, stream: TcpStream) {
        let mut out = stream.try_clone().unwrap();
        let pours = Arc::new(AtomicBool::new(false));
        let mut asked_its_name = false;
        for line in BufReader::new(stream).lines() {
            let Ok(line) = line else { return };
            let Ok(message) = serde_json::from_str::<Value>(&line) else { return };
            self.heard.lock().unwrap().push(line);
            if message.get("initialization_request").is_some()
                && !std::mem::replace(&mut asked_its_name, true)
            {
                self.asked_on.fetch_add(1, Ordering::Relaxed);
            }
            // An answer would end the endless line.
            let silent = self.flood == Flood::Line && pours.load(Ordering::Relaxed);
            let answered = match message.as_object().and_then(|message| message.iter().next()) {
                Some((kind, asked)) if !silent => self.answer(kind, asked, &mut out, &pours),
                _ => Ok(()),
            };
            if answered.is_err() {
                return;
            }
        }
    }

    fn answer(
        &self,
        kind: &str,
        asked: &Value,
        out: &mut TcpStream,
        pours: &Arc<AtomicBool>,
    ) -> std::io::Result<()> {
        // Ignores the connection that the scheduler keeps for stops: requests on it have no session.
        let of_mission = kind == "initialization_request" || asked.get("session").is_some();
        if self.floods == Floods::AtOnce && of_mission {
            return self.pour(out);
        }
        match kind {
            "initialization_request" => writeln!(out, "{}", block(&self.id)),
            "availability_request" => {
                let at = asked.get("timestamp").cloned().unwrap_or_else(|| json!("2026-11-20T19:00:00Z"));
                let mut answer = json!({"receive_timestamp": at, "timestamp": at, "status": "OK"});
                if asked.get("timestamp").is_some() {
                    answer["originate_timestamp"] = at;
                }
                writeln!(out, "{}", json!({"availability_response": answer}))?;
                if self.floods == Floods::WhenAvailable && of_mission { self.pour(out) } else { Ok(()) }
            }
            "control_request" => {
                let stop = asked["control_value"].as_array().is_some_and(Vec::is_empty);
                let mut answer = asked.clone();
                for key in
                    ["control_value", "control_type", "session", "stop_condition", "time_offset_to_start"]
                {
                    answer.as_object_mut().unwrap().remove(key);
                }
                answer["status"] = json!(if stop { "OK" } else { "Accepted" });
                answer["status_value"] = if stop { Value::Null } else { asked["control_value"].clone() };
                writeln!(out, "{}", json!({"control_response": answer}))?;
                if let (Floods::AfterStarting(pause), false) = (self.floods, stop) {
                    let (own, mut out, ahead) = (self.clone(), out.try_clone()?, until_start(asked));
                    let pours = Arc::clone(pours);
                    std::thread::spawn(move || {
                        std::thread::sleep(ahead + pause);
                        pours.store(true, Ordering::Relaxed);
                        own.pour(&mut out)
                    });
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Sends the flood until the connection ends.
    fn pour(&self, out: &mut TcpStream) -> std::io::Result<()> {
        let at = "2026-11-20T19:00:00Z";
        let bytes = match self.flood {
            Flood::Garbage => "x\n".repeat(8_192),
            Flood::Failures => {
                let error = json!({"code": "internal", "message": "m".repeat(100_000)});
                let failed =
                    json!({"receive_timestamp": at, "timestamp": at, "status": "Failed", "error": error});
                format!("{}\n", json!({"availability_response": failed}))
            }
            Flood::Responses => {
                let done = json!({"timestamp": at, "device_id": "d", "status": "OK", "status_value": 1, "request_id": "no"});
                format!("{}\n", json!({"control_response": done})).repeat(128)
            }
            Flood::Blocks => format!("{}\n", block(&self.id)).repeat(64),
            Flood::Line => "x".repeat(65_536),
            Flood::Answers => {
                let before = crate::epoch_nanos() - 60_000_000_000;
                let before =
                    serde_json::to_value(urrcp::Timestamp::<urrcp::Server>::from_nanos(before)).unwrap();
                let answer = json!({"originate_timestamp": before, "receive_timestamp": before, "timestamp": before, "status": "OK"});
                format!("{}\n", json!({"availability_response": answer})).repeat(128)
            }
        };
        loop {
            out.write_all(bytes.as_bytes())?;
            self.said.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        }
    }
}

/// Returns the time until the start of a script, by the clock of this machine.
fn until_start(script: &Value) -> Duration {
    let sent = crate::nanos(script["timestamp"].as_str().unwrap());
    let since = u64::try_from(crate::epoch_nanos() - sent).unwrap_or(0);
    let offset = Duration::from_secs_f64(script["time_offset_to_start"].as_f64().unwrap_or(0.0) / 1_000.0);
    offset.saturating_sub(Duration::from_nanos(since))
}

fn block(id: &str) -> Value {
    let range = json!({"min_value": 0, "max_value": 200, "granularity": 1});
    let mut script = range.clone();
    script["max_number_of_steps"] = json!(200);
    let device = json!({"id": "d", "name": "d", "script_queue": 2,
        "available_control_types": {"position": range, "script": script}});
    json!({"initialization_block": {"id": id, "api_version": "1", "devices": [device]}})
}
