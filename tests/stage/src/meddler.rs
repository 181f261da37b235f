//! A tamperer between an operator and a robot, which alters, repeats or reorders messages to the robot. It has the keys of neither side.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// How a byte stream is divided into records, which depends on the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// TLS: each record starts with a type, a version, and a length of two bytes.
    Tls,
    /// HMAC with a shared secret: two lines, and after them records that start with a length of four bytes and a code of sixteen bytes.
    Hmac,
}

/// How a record is manipulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tampering {
    Pass,
    /// The second-to-last byte of the record is changed.
    Alter,
    /// The record is sent twice.
    Repeat,
    /// The record is sent after the record that follows it.
    Reorder,
}

#[derive(Default)]
struct Told {
    deed: Option<Tampering>,
    done: usize,
    /// The longest sequence of bytes that was sent to the robot on one connection.
    said: Vec<u8>,
}

/// A proxy in front of one robot that manipulates records to the robot.
pub struct Tamperer {
    /// Port on which the tamperer listens.
    pub port: u16,
    robot: u16,
    told: Arc<Mutex<Told>>,
}

/// Length in bytes above which a record counts as long. Such records contain scripts, and only they are manipulated.
const LONG: usize = 500;

impl Tamperer {
    /// Creates a tamperer for the robot at this port. On each connection, it manipulates the long record with this number, counted from
    /// 1. Long records have more than `LONG` bytes.
    pub fn to(robot: u16, wire: Wire, number: usize) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let told: Arc<Mutex<Told>> = Arc::default();
        let own = Self { port, robot, told: Arc::clone(&told) };
        // This thread ends with the process.
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let (near, far) = (stream.unwrap(), TcpStream::connect(("127.0.0.1", robot)).unwrap());
                near.set_nodelay(true).unwrap();
                far.set_nodelay(true).unwrap();
                let (mut from, mut to) = (far.try_clone().unwrap(), near.try_clone().unwrap());
                std::thread::spawn(move || {
                    let _ended = std::io::copy(&mut from, &mut to);
                    let _gone = to.shutdown(Shutdown::Both);
                });
                let told = Arc::clone(&told);
                std::thread::spawn(move || {
                    let said = carry(near, &far, wire, number, &told);
                    let mut told = told.lock().unwrap();
                    if said.len() > told.said.len() {
                        told.said = said;
                    }
                    drop(told);
                    let _gone = far.shutdown(Shutdown::Both);
                });
            }
        });
        own
    }

    pub fn does(&self, deed: Tampering) {
        let mut told = self.told.lock().unwrap();
        (told.deed, told.done) = (Some(deed), 0);
    }

    /// Returns the number of records that were manipulated since the last call of [`Self::does`].
    pub fn done(&self) -> usize {
        self.told.lock().unwrap().done
    }

    /// Repeats to the robot everything that it received on an earlier connection. Returns the robot's output after its first line.
    pub fn said_again(&self) -> Vec<u8> {
        let said = self.told.lock().unwrap().said.clone();
        assert!(said.len() > LONG);
        let mut stream = TcpStream::connect(("127.0.0.1", self.robot)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let _hung_up = stream.write_all(&said);
        let mut answer = Vec::new();
        // The robot closes the connection, possibly by a reset.
        let _hung_up = stream.read_to_end(&mut answer);
        let greeting = answer.iter().position(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        answer.split_off(greeting)
    }
}

/// Carries the bytes of one direction of a connection, and manipulates the chosen record. Returns all bytes received.
fn carry(mut from: TcpStream, mut to: &TcpStream, wire: Wire, number: usize, told: &Mutex<Told>) -> Vec<u8> {
    let (mut said, mut came, mut bytes) = (Vec::new(), Vec::new(), [0; 16 * 1024]);
    let (mut lines, mut long, mut held) = (0, 0, None::<Vec<u8>>);
    while let Ok(n @ 1..) = from.read(&mut bytes) {
        said.extend_from_slice(&bytes[..n]);
        came.extend_from_slice(&bytes[..n]);
        while let Some(end) = end_of_record(&came, wire, lines) {
            let rest = came.split_off(end);
            let mut record = std::mem::replace(&mut came, rest);
            lines += usize::from(wire == Wire::Hmac && lines < 2);
            long += usize::from(record.len() > LONG);
            let mut told = told.lock().unwrap();
            let meant = record.len() > LONG && long == number;
            let mut parts = match told.deed.filter(|_| meant).unwrap_or(Tampering::Pass) {
                Tampering::Pass => vec![record],
                Tampering::Alter => {
                    let at = record.len() - 2;
                    record[at] ^= 1;
                    vec![record]
                }
                Tampering::Repeat => vec![record.clone(), record],
                Tampering::Reorder => {
                    held = Some(record);
                    told.done += 1;
                    continue;
                }
            };
            told.done += usize::from(meant && told.deed.is_some_and(|deed| deed != Tampering::Pass));
            drop(told);
            parts.extend(held.take());
            if to.write_all(&parts.concat()).is_err() {
                return said;
            }
        }
    }
    said
}

fn end_of_record(came: &[u8], wire: Wire, lines: usize) -> Option<usize> {
    let end = match wire {
        Wire::Tls => 5 + usize::from(u16::from_be_bytes(*came.get(3..)?.first_chunk()?)),
        Wire::Hmac if lines < 2 => came.iter().position(|byte| *byte == b'\n')? + 1,
        Wire::Hmac => 20 + usize::try_from(u32::from_be_bytes(*came.first_chunk()?)).unwrap(),
    };
    (came.len() >= end).then_some(end)
}
