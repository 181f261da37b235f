//! `downbeat conformance`: checks whether a robot meets the requirements of the protocol.

use std::fmt::Write as _;
use std::io::IsTerminal;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anstyle::{AnsiColor, Style};
use clap::ValueEnum;
use downbeat_scripts::shown::shown;
use downbeat_scripts::{Address, Attempt, Protection, Refusal, address_fault};
use serde_json::json;
use urrcp::Span;

use super::outlet::Display;
use super::run::parse_span;
use super::{Exit, Format, console, identity};
use crate::conformance::{
    Examined, Judged, NotExamined, Options, Requirement, Verdict, examine, requirements,
};
use crate::link::{Security, Site};
use crate::signals::{OnHangUp, Signals};

/// Check whether a robot does what the protocol demands.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The command acts as the scheduler of one robot and prints each requirement with `pass`, `fail` or `n/a`. \
`n/a` means that the robot does not declare what the check needs. A failure says what was sent, what was received and what \
was expected.

The robot moves, but only a little: to its default value (or zero, or the middle of its range) and by a five-hundredth of \
its range. The checks send the ends of the range only in scripts that they cancel before the start. Nearly every command \
has a lease. At the end, and after Ctrl-C, the device is brought to rest. No other scheduler should use the robot during \
the checks.

Examples:
  downbeat conformance tcp://127.0.0.1:7401
  downbeat conformance tcp://robot.local:7401 --device elbow --tolerance 5ms
  downbeat conformance tcp://127.0.0.1:7401 --only late,queue --format json
  downbeat conformance tcp://lamp.local:7401 --custom 0.5
  DOWNBEAT_IDENTITY=anna.pem downbeat conformance hmac://10.0.0.14:7401
  downbeat conformance --list

Exit codes:
  0  no check failed
  1  a check failed, or the robot does not answer
  2  wrong arguments
  3  ended by the operator; the robot is at rest
  4  ended by the operator; the robot did not confirm that it is at rest
  5  no check failed, but the robot has no device that the checks can move"
)]
pub(super) struct ConformanceArgs {
    /// The address on which the robot listens: tcp://HOST:PORT, or tls:// or hmac:// with an identity in DOWNBEAT_IDENTITY.
    #[arg(value_name = "ADDRESS", required_unless_present = "list")]
    address: Option<String>,
    /// List the requirements and check nothing.
    #[arg(long)]
    list: bool,
    /// Check only these requirements, each by its name or its number.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = parse_name)]
    only: Vec<String>,
    /// The device to move. By default, the first that takes scripts, or else the first that can be moved.
    #[arg(long, value_name = "ID")]
    device: Option<String>,
    /// Move a device by its custom control type, with only this value. Choose one that is safe.
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true, value_parser = parse_value)]
    custom: Option<f64>,
    /// The identity file of another operator, with only the role `observe`: to check that it cannot move the robot.
    #[arg(long, value_name = "FILE")]
    observer: Option<PathBuf>,
    /// How long to wait for an answer.
    #[arg(long, value_parser = parse_span, default_value = "2s", value_name = "TIME")]
    patience: Span,
    /// How late or early a start, a step or the end of a lease may be.
    #[arg(long, value_parser = parse_span, default_value = "20ms", value_name = "TIME")]
    tolerance: Span,
    /// The clock by which the robot is judged.
    #[arg(long, value_enum, default_value_t = Clock::Ntp)]
    clock: Clock,
}

/// The clock by which a robot is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Clock {
    /// The clock of this machine, with which the robot's clock must agree.
    Ntp,
    /// The robot's own clock, as measured.
    Measured,
}

fn parse_name(name: &str) -> Result<String, String> {
    if requirements().any(|requirement| requirement.is_called(name)) {
        return Ok(name.to_owned());
    }
    let near = downbeat_scripts::did_you_mean(name, requirements().map(|requirement| requirement.name));
    let near = near.map(|question| format!(" {question}")).unwrap_or_default();
    Err(format!("unknown requirement `{name}`;{near} `downbeat conformance --list` lists all requirements"))
}

fn parse_value(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
    value.ok_or_else(|| "expected a number".to_owned())
}

pub(super) fn conformance(args: &ConformanceArgs, format: Format) -> Exit {
    let Some(address) = args.address.as_ref().filter(|_| !args.list) else {
        list(format);
        return Exit::Done;
    };
    let (address, security, observer) = match reach(address, args.observer.as_deref()) {
        Ok(reached) => reached,
        Err((message, exit)) => {
            console::error(&message);
            return exit;
        }
    };
    let options = Options {
        patience: args.patience,
        tolerance: args.tolerance,
        device: args.device.clone(),
        custom: args.custom,
        clock_measured: args.clock == Clock::Measured,
        only: args.only.clone(),
        security,
        observer,
    };
    let interrupted = Arc::new(AtomicBool::new(false));
    super::with_runtime(async {
        let told = Arc::clone(&interrupted);
        // The task ends with the process. On a signal, it makes the checks stop and bring the robot to rest.
        tokio::spawn(async move {
            if let Ok(mut signals) = Signals::listen(OnHangUp::End) {
                signals.next().await;
                told.store(true, Ordering::Relaxed);
            }
        });
        let checking = tokio::task::spawn_blocking(move || {
            let live = Live::new(format);
            examine(address, options, interrupted, &mut |requirement, judged| live.tell(requirement, judged))
        });
        match checking.await {
            Ok(Ok(examined)) => finish(&examined, format),
            Ok(Err(error)) => {
                console::error(&error.to_string());
                match error {
                    NotExamined::Unreachable(_) => Exit::Failed,
                    NotExamined::NoDevice(_) => Exit::Usage,
                }
            }
            Err(error) => {
                console::error(&error.to_string());
                Exit::Failed
            }
        }
    })
}

/// Returns the robot's address, and how the conformance test and the observer authenticate.
fn reach(
    text: &str,
    observer: Option<&Path>,
) -> Result<(SocketAddr, Security, Option<Security>), (String, Exit)> {
    let address = text.parse::<Address>();
    if let Ok(Address::Zenoh { .. }) = address {
        let message = format!(
            "`{text}` is not supported: conformance is checked over TCP; let the robot listen on tcp://HOST:PORT"
        );
        return Err((message, Exit::Usage));
    }
    let Ok(Address::Tcp { host, port, protection }) = address else {
        let (fault, hint) = address_fault(text);
        let hint = hint.unwrap_or_else(|| "write tcp://HOST:PORT".to_owned());
        return Err((format!("the address `{text}` {fault}; {hint}"), Exit::Usage));
    };
    let usage = |message: String| (message, Exit::Usage);
    let security = match protection {
        Protection::Open => Security::Plain,
        _ => identity::site_of_terminal().map_err(usage)?.with(protection, None),
    };
    if matches!(security, Security::Nameless) {
        let scheme = protection.scheme();
        return Err(usage(format!(
            "{scheme}:// requires your identity; set DOWNBEAT_IDENTITY to your identity file"
        )));
    }
    let observer = observer.map(|path| Site::of_files(Some(path), None)).transpose().map_err(usage)?;
    Ok((resolve(&host, port)?, security, observer.map(|site| site.with(protection, None))))
}

fn resolve(host: &str, port: u16) -> Result<SocketAddr, (String, Exit)> {
    let unknown = |error: std::io::Error| {
        let refusal = Refusal::of(Attempt::Connect, &error);
        (format!("no connection to {host}:{port}: {refusal}"), Exit::Failed)
    };
    let mut found = (host, port).to_socket_addrs().map_err(unknown)?;
    found.next().ok_or_else(|| {
        (format!("the host name `{host}` does not resolve to an address; check the name"), Exit::Failed)
    })
}

fn list(format: Format) {
    match format {
        Format::Json => {
            let all: Vec<_> = requirements()
                .map(|r| json!({"requirement": r.name, "number": r.number, "demands": r.demands, "section": r.section}))
                .collect();
            console::print_json(&all);
        }
        Format::Text => {
            let width = width();
            let lines = requirements()
                .map(|r| format!("{:10}  {:width$}  {} ({})\n", r.number, r.name, r.demands, r.section));
            console::print(&lines.collect::<String>());
        }
    }
}

fn width() -> usize {
    requirements().map(|requirement| requirement.name.len()).max().unwrap_or(0)
}

/// The progress display. On a terminal, it shows the current requirement and the failures so far; elsewhere, it shows nothing.
struct Live {
    checked: Arc<Mutex<&'static str>>,
    on_terminal: bool,
}

impl Live {
    fn new(format: Format) -> Self {
        let on_terminal = format == Format::Text && std::io::stderr().is_terminal();
        let checked = Arc::new(Mutex::new(""));
        if on_terminal {
            console::begin_display(Box::new(Checked(Arc::clone(&checked))));
        }
        Self { checked, on_terminal }
    }

    fn tell(&self, requirement: &Requirement, judged: Option<&Judged>) {
        match judged {
            None => *self.checked.lock().unwrap_or_else(PoisonError::into_inner) = requirement.name,
            Some(judged) if judged.verdict == Verdict::Fail && self.on_terminal => {
                console::note(&format!("{}: fail", judged.requirement));
            }
            Some(_) => {}
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        console::end_display();
    }
}

/// The last line of the terminal, which shows the current requirement.
struct Checked(Arc<Mutex<&'static str>>);

impl Display for Checked {
    fn lift(&mut self) -> Vec<u8> {
        b"\r\x1b[K".to_vec()
    }

    fn draw(&mut self) -> Vec<u8> {
        let name = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        format!("\r\x1b[Kchecking {name}").into_bytes()
    }
}

fn finish(examined: &Examined, format: Format) -> Exit {
    match format {
        Format::Json => console::print_json(&examined.judged),
        Format::Text => console::print(&text(examined)),
    }
    if !examined.at_rest {
        console::warn(
            "the robot did not confirm that it is at rest; it drops its commands when its lease expires",
        );
    }
    let has = |verdict| examined.judged.iter().any(|judged| judged.verdict == verdict);
    let failed = has(Verdict::Fail);
    let unmoved = !examined.moves && has(Verdict::NotApplicable);
    if unmoved {
        console::warn(
            "nothing was moved, so most requirements were not checked: no device has a position, speed or acceleration; to check custom control types, state a value that is safe by `--custom VALUE`",
        );
    }
    match (examined.interrupted, examined.at_rest) {
        (true, true) => Exit::Stopped,
        (true, false) => Exit::Unconfirmed,
        (false, _) if failed => Exit::Failed,
        (false, _) if unmoved => Exit::DoneWithout,
        (false, _) => Exit::Done,
    }
}

fn text(examined: &Examined) -> String {
    let (names, mut text) = (width(), String::new());
    for judged in &examined.judged {
        let style = match judged.verdict {
            Verdict::Pass => AnsiColor::Green.on_default(),
            Verdict::Fail => AnsiColor::Red.on_default().bold(),
            Verdict::NotApplicable => Style::new().dimmed(),
        };
        let Judged { requirement, number, verdict, why, millis } = judged;
        let verdict = verdict.as_str();
        let line = format!(
            "{number:10}  {requirement:names$}  {style}{verdict:4}{style:#}  {millis:>5} ms  {}",
            shown(why)
        );
        let _written = writeln!(text, "{}", line.trim_end());
    }
    let count = |verdict| examined.judged.iter().filter(|judged| judged.verdict == verdict).count();
    let _written = writeln!(
        text,
        "\n{} passed, {} failed, {} not applicable{}",
        count(Verdict::Pass),
        count(Verdict::Fail),
        count(Verdict::NotApplicable),
        if examined.interrupted { "; ended by the operator" } else { "" }
    );
    text
}
