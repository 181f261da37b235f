//! A running program: sends lines to it, and receives its answers and unsolicited reports.

use std::collections::HashSet;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use urrcp::{DeviceId, Timestamp};

use super::Pushes;
use crate::clock::SystemClock;
use crate::plans::{PlanEvent, PlanId};

/// Maximum length of an answer, in bytes.
const ANSWER_BYTES_MAX: u64 = 16_384;
/// Maximum time that a program may take to end once its input is closed.
const END_WAIT: Duration = Duration::from_secs(1);

const PLAN_WORDS: &str = "`started PLAN NS`, `step PLAN INDEX NS`, `done PLAN NS`, `failed PLAN NS REASON` or `cancelled PLAN NS`, \
                          where NS is the time in nanoseconds since 1970; add `assumed` to the first three if the hardware has not confirmed the event";

/// Parses a program's report about a script that it times by itself.
fn plan_word(word: &str, rest: &str) -> Option<(PlanId, Timestamp<SystemClock>, PlanEvent)> {
    let mut parts = rest.splitn(3, ' ');
    let plan = PlanId(parts.next()?.parse().ok()?);
    let next = parts.next()?;
    let last = parts.next().map(str::trim);
    let (at, event) = match (word, last) {
        ("step", Some(last)) => {
            let step = next.parse().ok()?;
            let assumed = last.strip_suffix(" assumed");
            assumed.map_or((last, PlanEvent::Step(step)), |at| (at, PlanEvent::AssumedRunning))
        }
        ("started", None) => (next, PlanEvent::Began),
        ("started", Some("assumed")) => (next, PlanEvent::AssumedRunning),
        ("done", None) => (next, PlanEvent::Done),
        ("done", Some("assumed")) => (next, PlanEvent::AssumedDone),
        ("cancelled", _) => (next, PlanEvent::Cancelled),
        ("failed", reason) => (next, PlanEvent::Failed(reason.unwrap_or("no reason given").to_owned())),
        _ => return None,
    };
    // Only times from 1970 to 2255 are valid, so that no time overflows later arithmetic.
    let at = at.parse().ok().filter(|at| (0..=9_000_000_000_000_000_000).contains(at))?;
    Some((plan, Timestamp::from_nanos(at), event))
}

/// Receiver of a program's unsolicited reports.
#[derive(Clone, Debug)]
pub(super) struct UnsolicitedInput {
    pub(super) pushes: Pushes,
    pub(super) sensors: Arc<HashSet<DeviceId>>,
}

impl UnsolicitedInput {
    /// Handles the line if it is an unsolicited report. Returns whether it was one.
    fn hears(&self, line: &str) -> bool {
        match line.split_once(' ') {
            Some(("fault", reason)) => self.pushes.fault(reason.trim()),
            Some(("reading", reading)) => {
                if self.hears_reading(reading).is_none() {
                    self.pushes.fault(format!(
                        "the program sent `{line}`, expected `reading SENSOR NUMBER` or `reading SENSOR NUMBER MILLISECONDS` with a sensor of this robot"
                    ));
                }
            }
            Some((word @ ("started" | "step" | "done" | "failed" | "cancelled"), rest)) => {
                match plan_word(word, rest) {
                    Some((plan, at, event)) => self.pushes.plan(plan, at, event),
                    None => self.pushes.fault(format!("the program sent `{line}`, expected {PLAN_WORDS}")),
                }
            }
            _ => return false,
        }
        true
    }

    /// Handles `SENSOR NUMBER` or `SENSOR NUMBER MILLISECONDS`. Returns `None` if the text is neither.
    fn hears_reading(&self, text: &str) -> Option<()> {
        let (sensor, reading) = text.split_once(' ')?;
        let (sensor, reading) = (self.sensors.get(sensor.trim())?, AgedReading::of(reading)?);
        match reading.age {
            Some(age) => self.pushes.reading_of_age(sensor, reading.value, age),
            None => self.pushes.reading(sensor, reading.value),
        }
        Some(())
    }
}

/// A reading, as a program writes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct AgedReading {
    pub(super) value: f64,
    /// Time since the value was taken, if the program states it.
    pub(super) age: Option<Duration>,
}

impl AgedReading {
    /// Parses `NUMBER` or `NUMBER MILLISECONDS`.
    pub(super) fn of(text: &str) -> Option<Self> {
        let mut words = text.split_whitespace();
        let value = words.next()?.parse().ok()?;
        let age = match words.next() {
            Some(word) => Some(milliseconds(word)?),
            None => None,
        };
        words.next().is_none().then_some(Self { value, age })
    }
}

/// Parses a program's duration, a number of milliseconds.
pub(super) fn milliseconds(text: &str) -> Option<Duration> {
    let milliseconds: f64 = text.parse().ok().filter(|milliseconds: &f64| milliseconds.is_finite())?;
    // A program that takes timestamps from another clock may report a slightly negative duration.
    Duration::try_from_secs_f64(milliseconds.max(0.0) / 1_000.0).ok()
}

/// A running program. Dropping it ends the program.
pub(super) struct Running {
    child: Child,
    input: Option<ChildStdin>,
    /// A copy of the descriptor of the program's output, used only to detect the end of the program.
    pub(super) output: OwnedFd,
    answers: Receiver<String>,
    /// Whether the program may send unsolicited reports.
    tells: Arc<AtomicBool>,
    /// Maximum time from the moment at which a program that ends closes its input until it closes its output.
    ends_within: Duration,
}

/// The reason why a program did not answer a line, as the rest of a sentence that begins with the program.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum NoAnswer {
    #[error("has ended")]
    Ended,
    #[error("has closed its input")]
    ClosedInput,
    #[error("was stopped before it read `{0}`")]
    StoppedUnread(String),
    #[error("was stopped before it answered `{0}`")]
    StoppedUnanswered(String),
    #[error("did not read `{line}` within {} s", wait.as_secs_f64())]
    NotRead { line: String, wait: Duration },
    #[error("did not answer `{line}` within {} s", wait.as_secs_f64())]
    NotAnswered { line: String, wait: Duration },
    /// Contains the operating system's error.
    #[error("does not accept input: {0}")]
    Input(String),
}

impl Running {
    pub(super) fn start(command: &str, ear: Option<UnsolicitedInput>) -> std::io::Result<Self> {
        let mut shell = Command::new("sh");
        shell.arg("-c").arg(command).stdin(Stdio::piped()).stdout(Stdio::piped());
        // The program gets its own process group: Ctrl-C reaches only the edge, which then brings its devices to rest.
        let mut child = shell.process_group(0).spawn()?;
        let no_pipe = || std::io::Error::other("no pipe");
        let output = child.stdout.take().ok_or_else(no_pipe)?;
        let input = child.stdin.take().ok_or_else(no_pipe)?;
        // The pipe does not block: a description may exceed the pipe's buffer, and a program need not read it.
        fcntl_setfl(&input, fcntl_getfl(&input)? | OFlags::NONBLOCK)?;
        let watched = output.as_fd().try_clone_to_owned()?;
        // Each line has one answer. If a program writes more, its answers soon no longer match the lines.
        let (sender, answers) = sync_channel(1);
        let tells = Arc::new(AtomicBool::new(false));
        let ear = ear.map(|ear| (ear, Arc::clone(&tells)));
        // This thread ends with the program's output, or when the receiver is dropped.
        std::thread::Builder::new()
            .name("program".into())
            .spawn(move || hear(BufReader::new(output), ear.as_ref(), &sender))?;
        Ok(Self { child, input: Some(input), output: watched, answers, tells, ends_within: ENDS_WITHIN })
    }

    /// Permits unsolicited reports from now on.
    pub(super) fn may_tell(&self) {
        self.tells.store(true, Ordering::SeqCst);
    }

    /// Sends a line and returns the program's answer.
    pub(super) fn ask(&mut self, line: &str, wait: Duration) -> Result<String, NoAnswer> {
        self.ask_unless(line, wait, &|| false)
    }

    /// Like `ask`, but returns early once `is_over` returns true.
    pub(super) fn ask_unless(
        &mut self,
        line: &str,
        wait: Duration,
        is_over: &dyn Fn() -> bool,
    ) -> Result<String, NoAnswer> {
        let Some(input) = &mut self.input else { return Err(NoAnswer::Ended) };
        // The whole line is written at once. A program may still read it in pieces.
        let verb = line.split(' ').next().unwrap_or(line);
        let shown = if line.len() > SHOWN_MAX { verb } else { line }.to_owned();
        match write_within(input, format!("{line}\n").as_bytes(), wait, is_over) {
            Ok(true) => {}
            Ok(false) if is_over() => return Err(NoAnswer::StoppedUnread(shown)),
            Ok(false) => return Err(NoAnswer::NotRead { line: shown, wait }),
            Err(error) if error.kind() == ErrorKind::BrokenPipe => return Err(self.why_it_reads_no_more()),
            Err(error) => return Err(NoAnswer::Input(error.to_string())),
        }
        let mut left = wait;
        loop {
            let slice = left.min(LOOK_EVERY);
            match self.answers.recv_timeout(slice) {
                Ok(answer) => return Ok(answer),
                Err(RecvTimeoutError::Disconnected) => return Err(NoAnswer::Ended),
                Err(RecvTimeoutError::Timeout) => left -= slice,
            }
            if is_over() {
                return Err(NoAnswer::StoppedUnanswered(shown));
            }
            if left.is_zero() {
                return Err(NoAnswer::NotAnswered { line: shown, wait });
            }
        }
    }

    fn why_it_reads_no_more(&self) -> NoAnswer {
        // Skips answers that the program has already sent.
        let last =
            std::iter::repeat_with(|| self.answers.recv_timeout(self.ends_within)).take(LAST_WORDS_MAX);
        let ended = last.filter_map(Result::err).next() == Some(RecvTimeoutError::Disconnected);
        if ended { NoAnswer::Ended } else { NoAnswer::ClosedInput }
    }
}

/// Interval at which a waiting `ask_unless` checks whether the answer is still needed.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Maximum time from the moment at which a program that ends closes its input until it closes its output.
const ENDS_WITHIN: Duration = Duration::from_millis(200);
/// Maximum number of the program's answers that have not been read yet.
const LAST_WORDS_MAX: usize = 8;

/// Maximum length in bytes of a line that an error message shows in full. If a line is longer, the message shows only its first word.
const SHOWN_MAX: usize = 200;

/// Writes the bytes. Returns false if the program has not read for `wait`, or once `is_over` returns true.
fn write_within(
    input: &mut ChildStdin,
    mut bytes: &[u8],
    wait: Duration,
    is_over: &dyn Fn() -> bool,
) -> std::io::Result<bool> {
    let mut left = wait;
    while !bytes.is_empty() {
        match input.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(written) => bytes = &bytes[written..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                let slice = left.min(LOOK_EVERY);
                let time = Timespec::try_from(slice).map_err(std::io::Error::other)?;
                if poll(&mut [PollFd::new(&*input, PollFlags::OUT)], Some(&time))? > 0 {
                    left = wait;
                    continue;
                }
                left -= slice;
                if left.is_zero() || is_over() {
                    return Ok(false);
                }
            }
            Err(error) => return Err(error),
        }
    }
    Ok(true)
}

/// Forwards each line of the program's output, as an answer or as an unsolicited report.
fn hear(
    mut output: impl BufRead,
    ear: Option<&(UnsolicitedInput, Arc<AtomicBool>)>,
    answers: &SyncSender<String>,
) {
    loop {
        let mut line = Vec::new();
        match output.by_ref().take(ANSWER_BYTES_MAX).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let line = String::from_utf8_lossy(&line).trim().to_owned();
        let told = ear.is_some_and(|(ear, tells)| tells.load(Ordering::SeqCst) && ear.hears(&line));
        if !told && answers.send(line).is_err() {
            return;
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Otherwise reports of this program could be attributed to the next one.
        self.tells.store(false, Ordering::SeqCst);
        self.input = None;
        // The output ends with the program. Its remaining lines are not needed; if there are too many, the program does not count as
        // ended.
        let last = (0..16).find_map(|_| self.answers.recv_timeout(END_WAIT).err());
        let ended = last == Some(RecvTimeoutError::Disconnected);
        if !ended
            && let Some(group) = i32::try_from(self.child.id()).ok().and_then(rustix::process::Pid::from_raw)
        {
            let _already_gone = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
        }
        let _already_gone = self.child.kill();
        let _reaped = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(line: &str, expected: Option<(u64, i64, PlanEvent)>) {
        let (word, rest) = line.split_once(' ').unwrap();
        let expected = expected.map(|(plan, at, event)| (PlanId(plan), Timestamp::from_nanos(at), event));
        assert_eq!(plan_word(word, rest), expected, "{line}");
    }

    #[test]
    fn plan_reports_of_a_program_are_parsed() {
        check("started 7 1790000000000000001", Some((7, 1_790_000_000_000_000_001, PlanEvent::Began)));
        check("step 7 2 5", Some((7, 5, PlanEvent::Step(2))));
        check("done 7 5", Some((7, 5, PlanEvent::Done)));
        check("started 7 5 assumed", Some((7, 5, PlanEvent::AssumedRunning)));
        check("step 7 2 5 assumed", Some((7, 5, PlanEvent::AssumedRunning)));
        check("done 7 5 assumed", Some((7, 5, PlanEvent::AssumedDone)));
        check("failed 7 5 too much torque", Some((7, 5, PlanEvent::Failed("too much torque".to_owned()))));
        check("failed 7 5", Some((7, 5, PlanEvent::Failed("no reason given".to_owned()))));
        check("cancelled 7 5", Some((7, 5, PlanEvent::Cancelled)));
    }

    #[test]
    fn malformed_plan_report_is_not_parsed() {
        for line in [
            "started 7",
            "started x 5",
            "started 7 5 6",
            "step 7 5",
            "step 7 -1 5",
            "step 7 x 5 assumed",
            "step 7 2 5 assumed so",
            "done 7 assumed",
            "done 7 1.5",
            "done 7 -5",
        ] {
            check(line, None);
        }
        check("done 7 9223372036854775807", None);
    }

    /// Starts `command`, a program that soon stops reading, and returns the error that `ask` then reports.
    fn said_of(command: &str, ends_within: Duration) -> String {
        let mut running = Running::start(command, None).unwrap();
        running.ends_within = ends_within;
        let wait = Duration::from_secs(60);
        assert_eq!(running.ask("hello", wait), Ok("ok".to_owned()));
        // Until its input is closed, the program may still take a line without ever answering it.
        (0..1_000)
            .find_map(|_| {
                running
                    .ask("ping", Duration::from_millis(20))
                    .err()
                    .filter(|why| !why.to_string().contains("ping"))
            })
            .unwrap()
            .to_string()
    }

    #[test]
    fn ended_program_is_distinguished_from_one_with_closed_input() {
        let stays = "read line; echo ok; exec <&-; sleep 60";
        assert_eq!(said_of(stays, ENDS_WITHIN), "has closed its input");
        // The result does not depend on how long a slow machine takes to end the program.
        let ends = "read line; echo ok; exec <&-; sleep 0.1";
        assert_eq!(said_of(ends, Duration::from_secs(50)), "has ended");
    }

    /// Returns a receiver of unsolicited reports about the sensor `eye`, and its mailbox, which is connected.
    fn ear() -> (UnsolicitedInput, Arc<crate::driver::Mailbox>) {
        let mailbox = Arc::new(crate::driver::Mailbox::default());
        let ping_period = Duration::from_millis(25);
        let manners = crate::driver::mailbox::DriverTraits {
            acknowledges: true,
            takes_frames: false,
            ping_period,
            silence_max: None,
        };
        mailbox.connected(1, manners);
        let sensors = Arc::new(HashSet::from([DeviceId::new("eye").unwrap()]));
        (UnsolicitedInput { pushes: Pushes::into(Arc::clone(&mailbox)), sensors }, mailbox)
    }

    #[expect(clippy::disallowed_methods, reason = "asks what waits now")]
    fn fault(mailbox: &crate::driver::Mailbox) -> Option<String> {
        match mailbox.next(std::time::Instant::now()) {
            crate::driver::mailbox::Work::Fault(reason) => Some(reason),
            _ => None,
        }
    }

    #[test]
    fn unrequested_reports_are_not_taken_as_answers() {
        let (ear, mailbox) = ear();
        assert!(ear.hears("reading eye  4.5 30"));
        let reading = mailbox.pushed(&DeviceId::new("eye").unwrap(), Duration::from_secs(600)).unwrap();
        assert!(reading.value == 4.5 && mailbox.now() - reading.taken.unwrap() >= Duration::from_millis(30));
        assert!(ear.hears("reading eye  4.5"));
        assert_eq!(
            mailbox.pushed(&DeviceId::new("eye").unwrap(), Duration::from_secs(600)).unwrap().value,
            4.5
        );
        for word in ["started 1 5", "step 1 0 5", "done 1 5", "failed 1 5 torque", "cancelled 1 5"] {
            assert!(ear.hears(word), "{word}");
            assert_eq!(mailbox.words().len(), 1, "{word}");
        }
        assert_eq!(fault(&mailbox), None);
        assert!(ear.hears("fault  torque "));
        assert_eq!(fault(&mailbox).as_deref(), Some("torque"));
        for answer in ["ok", "4.5", "error fault", "fault", "readings eye 4.5"] {
            assert!(!ear.hears(answer), "{answer}");
        }
        assert_eq!(fault(&mailbox), None);
    }

    #[test]
    fn malformed_report_is_a_fault_of_the_program() {
        let (ear, mailbox) = ear();
        for (line, expected) in [
            ("reading ear 4.5", "with a sensor of this robot"),
            ("reading eye", "expected `reading SENSOR NUMBER`"),
            ("reading eye high", "expected `reading SENSOR NUMBER`"),
            ("reading eye 4.5 late", "or `reading SENSOR NUMBER MILLISECONDS`"),
            ("reading eye 4.5 3 2", "or `reading SENSOR NUMBER MILLISECONDS`"),
            ("done x 5", "expected `started PLAN NS`"),
        ] {
            assert!(ear.hears(line), "{line}");
            let told = fault(&mailbox).unwrap();
            assert!(
                told.starts_with(&format!("the program sent `{line}`, ")) && told.contains(expected),
                "{told}"
            );
        }
    }

    #[test]
    fn unrequested_lines_count_as_answers_until_they_are_permitted() {
        let (ear, mailbox) = ear();
        let mut running = Running::start("while read -r line; do echo \"$line\"; done", Some(ear)).unwrap();
        let wait = Duration::from_secs(60);
        assert_eq!(running.ask("reading eye 1", wait).as_deref(), Ok("reading eye 1"));
        running.may_tell();
        running.input.as_mut().unwrap().write_all(b"reading eye 2\n").unwrap();
        assert_eq!(running.ask("ping", wait).as_deref(), Ok("ping"), "an earlier line is not an answer");
        assert_eq!(
            mailbox.pushed(&DeviceId::new("eye").unwrap(), Duration::from_secs(600)).unwrap().value,
            2.0
        );
    }

    #[test]
    fn error_about_a_long_line_names_only_its_first_word() {
        let mut running = Running::start("sleep 60", None).unwrap();
        let mut reason = |line: &str| running.ask(line, Duration::from_millis(10)).unwrap_err().to_string();
        let short = format!("init {}", "x".repeat(SHOWN_MAX - 5));
        assert_eq!(reason(&short), format!("did not answer `{short}` within 0.01 s"));
        assert_eq!(reason(&format!("{short}x")), "did not answer `init` within 0.01 s");
        let beyond_a_pipe = "x".repeat(1 << 20);
        assert_eq!(reason(&format!("init {beyond_a_pipe}")), "did not read `init` within 0.01 s");
    }

    #[test]
    fn program_that_does_not_exit_is_killed() {
        let running = Running::start("trap '' TERM; while true; do sleep 1; done", None).unwrap();
        let process = format!("/proc/{}", running.child.id());
        assert!(std::path::Path::new(&process).exists());
        drop(running);
        assert!(!std::path::Path::new(&process).exists());
    }
}
