//! One cell of the matrix of stops (ways to stop × troubles). A mission in trouble is stopped, and its robots' logs show when they came
//! to rest. The test compares the operator's report with these logs. No cell is played again: each limit is ten times the duration on an
//! idle machine. Each row prints the durations of its cells.

use std::fs::File;
use std::io::Read;
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rustix::process::{Signal, kill_process};

use super::show::{ODD, STEPS, Show, Trouble, WHEELED, program};
use super::{Way, text};
use stage::{Logged, Process, Robot, epoch_nanos};

/// Number of cells that are played at the same time.
const AT_ONCE: usize = 3;
/// Time within which every robot has to be at rest: ten times 300 ms, and less than the six seconds for which the disk stalls.
pub const AT_REST_MAX: Duration = Duration::from_secs(3);
/// Time in which the robot with the wheel slows down.
const SLOWS_DOWN: Duration = Duration::from_millis(500);
/// Maximum time from a signal until the first robot reacts: ten times 50 ms.
const FIRST_BYTE_MAX: Duration = Duration::from_millis(500);
/// Time after which `downbeat stop` no longer waits for a scheduler that does not answer.
const GIVEN_UP: Duration = Duration::from_secs(1);
/// Maximum wait for the end of a process, and for the robots to come to rest.
const ENDS_WITHIN: Duration = Duration::from_secs(20);
/// Time during which a robot that came to rest must not move again. The steps of its script are 50 ms apart.
const STAYS_AT_REST: Duration = Duration::from_millis(300);
/// Minimum age of a robot's last value at the stop, in nanoseconds, from which the robot counts as at rest before the stop.
const RESTED_BEFORE_NS: i64 = 1_000_000_000;

/// The result of a stop.
pub struct Stopped {
    /// When the stop was given, in nanoseconds since the epoch.
    at: i64,
    /// Output that the operator saw; `None` if the operator could not read it.
    pub said: Option<String>,
    /// Exit code of the process that the operator waits for (the scheduler or `downbeat stop`); `None` if it hung.
    pub code: Option<i32>,
    /// Exit code of the scheduler; `None` if it was killed, was suspended or hung.
    scheduler: Option<i32>,
}

/// Times from the stop until the first and the last robot came to rest.
struct Times {
    first: Duration,
    last: Duration,
}

/// Plays cells of the matrix for one way to stop, `AT_ONCE` at a time, and prints their durations.
#[track_caller]
#[expect(clippy::print_stdout, reason = "prints the duration of each cell with --nocapture")]
pub fn check_row(way: Way, troubles: &[Trouble]) {
    let only = std::env::var("DOWNBEAT_TROUBLE").ok();
    let asked = |trouble: &&Trouble| only.as_ref().is_none_or(|only| *only == format!("{trouble:?}"));
    let troubles: Vec<Trouble> = troubles.iter().filter(asked).copied().collect();
    let (mut wrong, mut first) = (Vec::new(), Duration::ZERO);
    for cells in troubles.chunks(AT_ONCE) {
        let results: Vec<_> = std::thread::scope(|scope| {
            let playing: Vec<_> = cells.iter().map(|trouble| scope.spawn(|| play(way, *trouble))).collect();
            playing.into_iter().map(|cell| cell.join().unwrap()).collect()
        });
        for (trouble, result) in cells.iter().zip(results) {
            match result {
                Ok(times) => {
                    println!(
                        "{way:?} x {trouble:?}: first robot after {:?}, last after {:?}",
                        times.first, times.last
                    );
                    first = first.max(times.first);
                }
                Err(why) => wrong.push(format!("{way:?} x {trouble:?}: {why}")),
            }
        }
    }
    println!("{way:?}: {first:?} at most to the first robot");
    assert!(wrong.is_empty(), "{} of {} cells:\n{}", wrong.len(), troubles.len(), wrong.join("\n"));
}

fn play(way: Way, trouble: Trouble) -> Result<Times, String> {
    let mut show = Show::begin(trouble);
    show.strike();
    let process = Instant::now();
    let version = show.stage.command(&["--version"]).output().unwrap();
    let process = process.elapsed();
    assert!(version.status.success());
    let (stopped, held_up) = held_up(|| stop(&mut show, way));
    let by_command = if way.is_command() { process * 2 } else { Duration::ZERO };
    let given_up = if way == Way::WhileFrozen { GIVEN_UP } else { Duration::ZERO };
    let within = AT_REST_MAX + by_command + given_up;
    let times = at_rest(&show, &stopped, within).map_err(|why| with_all(&why, &show, &stopped))?;
    told(way, trouble, &stopped)?;
    if way.is_command() || times.first <= FIRST_BYTE_MAX + held_up * 2 {
        return Ok(times);
    }
    Err(format!("the first robot heard of it after {:?}", times.first))
}

impl Way {
    const fn is_command(self) -> bool {
        matches!(self, Self::Command | Self::AfterCrash | Self::WhileFrozen)
    }
}

/// Returns the reason for a failure, extended by the output and the exit code.
fn with_all(why: &str, show: &Show, stopped: &Stopped) -> String {
    let told = text(&show.stage, "told") + &text(&show.stage, "stop-told");
    format!("{why}; exit code {:?}\n{told}{}", stopped.code, stopped.said.as_deref().unwrap_or(""))
}

/// Stops the show, and waits for the processes that must end.
pub fn stop(show: &mut Show, way: Way) -> Stopped {
    match way {
        Way::CtrlC => signalled(show, Signal::INT),
        Way::Terminate => signalled(show, Signal::TERM),
        Way::HangUp => signalled(show, Signal::HUP),
        Way::Quit => signalled(show, Signal::QUIT),
        Way::Command => {
            let stopped = commanded(show);
            Stopped { scheduler: ended(&mut show.started.0), ..stopped }
        }
        Way::AfterCrash => {
            show.kill();
            commanded(show)
        }
        Way::WhileFrozen => {
            kill_process(show.pid, Signal::STOP).unwrap();
            commanded(show)
        }
    }
}

fn signalled(show: &mut Show, signal: Signal) -> Stopped {
    let at = epoch_nanos();
    kill_process(show.pid, signal).unwrap();
    let code = ended(&mut show.started.0);
    let read = !matches!(show.trouble, Trouble::Terminal | Trouble::Pipes | Trouble::StdoutFull);
    let said = show.out.take().filter(|_| read && code.is_some()).map(|mut out| {
        let mut said = String::new();
        out.read_to_string(&mut said).unwrap();
        said
    });
    Stopped { at, said, code, scheduler: code }
}

fn commanded(show: &Show) -> Stopped {
    let full = show.trouble == Trouble::StdoutFull;
    let trouble = match show.trouble {
        // The operator has another terminal.
        Trouble::Terminal | Trouble::Pipes => Trouble::Nothing,
        trouble => trouble,
    };
    let mut command = program(&show.stage, &["stop", "--patience", "4s"], trouble);
    if full {
        command.stdout(File::options().write(true).open("/dev/full").unwrap());
    } else {
        command.stdout(Stdio::piped());
    }
    command.stderr(File::create(show.stage.path("stop-told")).unwrap());
    let at = epoch_nanos();
    let mut child = Process(command.spawn().unwrap());
    let code = ended(&mut child.0);
    let mut said = String::new();
    if let Some(out) = child.0.stdout.as_mut().filter(|_| code.is_some()) {
        out.read_to_string(&mut said).unwrap();
    }
    Stopped { at, said: (!full).then_some(said), code, scheduler: None }
}

/// Waits for the end of a process, and returns its exit code; `None` if it hangs.
pub fn ended(child: &mut Child) -> Option<i32> {
    let began = Instant::now();
    while began.elapsed() < ENDS_WITHIN {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    None
}

/// Runs `work`. Returns its result, and the longest time for which a thread of this process was prevented from running meanwhile.
fn held_up<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let (over, longest) = (AtomicBool::new(false), AtomicU64::new(0));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                let began = Instant::now();
                std::thread::sleep(Duration::from_millis(5));
                let late = u64::try_from(began.elapsed().as_millis()).unwrap().saturating_sub(5);
                longest.fetch_max(late, Ordering::Relaxed);
            }
        });
        let done = work();
        over.store(true, Ordering::Relaxed);
        (done, Duration::from_millis(longest.load(Ordering::Relaxed)))
    })
}

/// Waits until the logs show all robots at rest, for at most `ENDS_WITHIN`. Later, [`at_rest`] reports a robot that still moves.
fn await_rest(show: &Show) {
    let stands = |(index, robot): (usize, &Robot)| {
        robot.rests() && (index != WHEELED || robot.log().last().is_some_and(|last| last.value == 0.0))
    };
    let living = |(index, _): &(usize, &Robot)| show.trouble != Trouble::Dead || *index != ODD;
    let began = Instant::now();
    while !show.stage.robots.iter().enumerate().filter(living).all(stands) && began.elapsed() < ENDS_WITHIN {
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Returns how long after the stop the first and the last robot came to rest, by their own logs. Fails if a robot took longer than
/// `within`.
fn at_rest(show: &Show, stopped: &Stopped, within: Duration) -> Result<Times, String> {
    await_rest(show);
    // Detects a robot that moves again, too.
    std::thread::sleep(STAYS_AT_REST);
    let dead = |index| show.trouble == Trouble::Dead && index == ODD;
    let mut times = Times { first: Duration::MAX, last: Duration::ZERO };
    for (index, robot) in show.stage.robots.iter().enumerate().filter(|(index, _)| !dead(*index)) {
        let log = robot.log();
        let rested =
            if index == WHEELED { slowed(robot, &log, stopped) } else { last_step(robot, &log, stopped) };
        let Some(after) = rested? else {
            // A robot that floods has failed: the mission has stopped it by itself.
            if show.trouble == Trouble::Flood && index == ODD {
                continue;
            }
            return Err(format!("{} was at rest before the stop", robot.id));
        };
        (times.first, times.last) = (times.first.min(after), times.last.max(after));
        if after > within {
            return Err(format!("{} still moved {after:?} after the stop, {within:?} allowed", robot.id));
        }
        if index == WHEELED {
            stands(&log, stopped, within + SLOWS_DOWN)?;
        }
    }
    Ok(times)
}

fn since(stopped: &Stopped, entry: &Logged) -> Duration {
    Duration::from_nanos(u64::try_from(entry.at - stopped.at).unwrap_or(0))
}

/// Returns the time from the stop to the last value of the script, because the stop itself leaves no entry in the log. `None` if the
/// robot was at rest before the stop.
fn last_step(robot: &Robot, log: &[Logged], stopped: &Stopped) -> Result<Option<Duration>, String> {
    let Some(last) = log.last() else { return Err(format!("{} never moved", robot.id)) };
    if last.motion != "set" {
        return Err(format!("the stop moved {}: {last:?}", robot.id));
    }
    if last.value >= f64::from(STEPS) {
        return Err(format!("{} played its script to its end", robot.id));
    }
    let before = stopped.at - last.at;
    Ok((before < RESTED_BEFORE_NS).then(|| since(stopped, last)))
}

/// Returns the time from the stop to the wheel's first log entry that no script caused. `None` if this entry precedes the stop.
fn slowed(robot: &Robot, log: &[Logged], stopped: &Stopped) -> Result<Option<Duration>, String> {
    let after = log.iter().rev().take_while(|entry| entry.motion != "set").last();
    let Some(after) = after else {
        let last = log.last().map_or(f64::NAN, |last| last.value);
        return Err(format!("{} is not at rest: its last value is {last}", robot.id));
    };
    Ok((after.at >= stopped.at).then(|| since(stopped, after)))
}

/// Checks that the wheel has slowed down to zero within this time after the stop.
fn stands(log: &[Logged], stopped: &Stopped, within: Duration) -> Result<(), String> {
    let Some(stands) = log.iter().rev().take_while(|entry| entry.value == 0.0).last() else {
        let last = log.last().map_or(f64::NAN, |last| last.value);
        return Err(format!("the wheel still turns at {last}"));
    };
    let after = since(stopped, stands);
    if after <= within {
        Ok(())
    } else {
        Err(format!("the wheel stood {after:?} after the stop, {within:?} allowed"))
    }
}

/// Checks that the output that the operator saw, and the exit codes, agree with what happened.
fn told(way: Way, trouble: Trouble, stopped: &Stopped) -> Result<(), String> {
    let dead = (trouble == Trouble::Dead).then_some(ODD);
    let said = stopped.said.as_deref().unwrap_or("");
    for robot in (0..6).filter(|_| stopped.said.is_some()) {
        let of_robot = |line: &&str| line.trim_start().starts_with(&format!("r{robot}"));
        let confirmed = said.lines().filter(of_robot).any(|line| line.contains("stop confirmed"));
        let named = said.contains(&format!("r{robot}"));
        if confirmed == (dead == Some(robot)) || !named {
            let told = if confirmed { "confirmed" } else { "not confirmed" };
            return Err(format!("r{robot} is reported as {told}; exit code {:?}\n{said}", stopped.code));
        }
    }
    let of_mission = if dead.is_some() { Some(4) } else { Some(3) };
    let (code, scheduler) = match (way.is_command(), dead, trouble) {
        (false, ..) => (of_mission, of_mission),
        (true, Some(_), _) => (Some(4), of_mission),
        // Output that cannot be written turns success into failure.
        (true, None, Trouble::StdoutFull) => (Some(7), of_mission),
        (true, None, _) => (Some(0), of_mission),
    };
    let scheduler = if way == Way::Command || !way.is_command() { scheduler } else { None };
    if (stopped.code, stopped.scheduler) == (code, scheduler) {
        Ok(())
    } else {
        Err(format!(
            "exit codes {:?} and, of the scheduler, {:?}, expected {code:?} and {scheduler:?}\n{said}",
            stopped.code, stopped.scheduler
        ))
    }
}
