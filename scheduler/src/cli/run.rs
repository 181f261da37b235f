//! `downbeat run`: a mission on the fleet.

use std::time::Duration;

use downbeat_robot::HostOptions;
use downbeat_scripts::{Fleet, Plan, counted};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use tokio::sync::mpsc;
use urrcp::{Server, Span, Timestamp};

use super::load;
use super::{Exit, Format, ScenarioArgs, console};
use crate::fleet;
use crate::mission::{Mission, MissionOptions, Progress};
use crate::report::{Outcome, Report, StopState, report_text};
use crate::run::Operator;
use crate::server_clock::{self, ServerClock};

/// Play a scenario on the fleet: all robots start together, or none does.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Ctrl-C stops: every robot returns to its default state and confirms it. A second Ctrl-C leaves at
once and says what was left running.

Examples:
  downbeat run scripts/examples/swap.yaml
  downbeat run show.yaml --fleet stage.yaml --lead 3s --format json"
)]
pub(super) struct RunArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Play this act; needed where the scenario has several.
    #[arg(long, value_name = "NAME")]
    act: Option<String>,
    /// Time from sending to the start, instead of the computed one, as 1500ms or 3s.
    #[arg(long, value_parser = parse_span, value_name = "TIME")]
    lead: Option<Span>,
    /// How long to wait for connections, greetings and stop confirmations.
    #[arg(long, value_parser = parse_span, default_value = "5s", value_name = "TIME")]
    patience: Span,
    /// Run robots with `address: sim` under real-time scheduling (needs the right to).
    #[arg(long)]
    realtime: bool,
}

pub(super) fn parse_span(text: &str) -> Result<Span, String> {
    downbeat_scripts::parse_duration(text)
        .ok_or_else(|| format!("`{text}`, expected a time such as 250ms, 3s or 1m30s"))
}

pub(super) fn run(args: &RunArgs, format: Format) -> Exit {
    let (choreography, fleet) = match load::load_choreography(&args.scenario, format) {
        Ok(loaded) => loaded,
        Err(exit) => return exit,
    };
    let plan = match load::acts(&choreography, args.act.as_deref()).as_deref() {
        Ok([act]) if choreography.acts.len() == 1 || args.act.is_some() => act.plan.clone(),
        Ok(_) => {
            let names: Vec<_> = choreography.acts.iter().map(|act| format!("`{}`", act.name)).collect();
            console::error(&format!(
                "this scenario has {} acts, a run plays one: name it by --act, one of {}",
                names.len(),
                names.join(", ")
            ));
            return Exit::Usage;
        }
        Err(exit) => return *exit,
    };
    super::with_runtime(async {
        match play(args, format, plan, &fleet).await {
            Ok(report) => finish(&report, format),
            Err(message) => {
                console::error(&message);
                Exit::Failed
            }
        }
    })
}

async fn play(args: &RunArgs, format: Format, plan: Plan, fleet: &Fleet) -> Result<Report, String> {
    let (clock, server_uncertainty) = server_clock(fleet, format).await?;
    let robots = fleet::robots_of(fleet, &plan);
    let options = MissionOptions {
        greeting: fleet::greeting(fleet),
        lead: args.lead,
        patience: args.patience,
        server_uncertainty,
    };
    let host_options = HostOptions { realtime: args.realtime, ..HostOptions::default() };
    let (host, endpoints) = fleet::endpoints(&robots, host_options).map_err(|e| e.to_string())?;
    let duration = plan.duration();
    let mission = Mission::new(plan, fleet::participants(&robots), options, clock.now())
        .map_err(|error| error.to_string())?;
    let console = Console::new(format, clock, duration, robots.len());
    let report =
        crate::run::run(mission, endpoints, clock, operator(), |at, progress| console.tell(at, progress))
            .await;
    console.clear();
    if let Some(host) = host {
        host.stop();
    }
    Ok(report)
}

/// The server's time: by NTP when the fleet file names a server, else the system's.
async fn server_clock(fleet: &Fleet, format: Format) -> Result<(ServerClock, Span), String> {
    let Some(server) = &fleet.ntp else { return Ok((ServerClock::anchored(Span::ZERO), Span::ZERO)) };
    let reading = server_clock::ask_ntp(server).await.map_err(|error| error.to_string())?;
    if format == Format::Text {
        console::note(&format!(
            "server time by NTP from {server}: this machine is off by {} (+-{}), stratum {}",
            reading.offset, reading.uncertainty, reading.stratum
        ));
    }
    Ok((ServerClock::anchored(reading.offset), reading.uncertainty))
}

/// Ctrl-C as the operator's word: the first stops, the second leaves. The task ends with the process.
fn operator() -> mpsc::Receiver<Operator> {
    let (said, heard) = mpsc::channel(2);
    tokio::spawn(async move {
        for word in [Operator::Stop, Operator::Leave] {
            // Without a handler the system's own Ctrl-C ends the process; the sender must live on either way.
            if interrupted().await.is_err() {
                std::future::pending::<()>().await;
            }
            let _ended = said.send(word).await;
        }
        std::future::pending::<()>().await;
    });
    heard
}

/// Ctrl-C, or a supervisor's SIGTERM.
pub(super) async fn interrupted() -> std::io::Result<()> {
    let mut terminate = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate())?;
    tokio::select! {
        pressed = tokio::signal::ctrl_c() => pressed,
        _ = terminate.recv() => Ok(()),
    }
}

pub(super) fn finish(report: &Report, format: Format) -> Exit {
    match format {
        Format::Json => console::print_json(report),
        Format::Text => console::print(&report_text(report)),
    }
    exit_of(report)
}

/// How a mission ended, as scripts see it.
pub(super) fn exit_of(report: &Report) -> Exit {
    let unconfirmed = report.robots.iter().any(|robot| matches!(robot.stop, StopState::Unconfirmed { .. }));
    match &report.outcome {
        Outcome::Done => Exit::Done,
        _ if unconfirmed => Exit::Unconfirmed,
        Outcome::Stopped => Exit::Stopped,
        _ => Exit::Failed,
    }
}

/// Live progress: a bar on a terminal, lines elsewhere, nothing with JSON.
struct Console {
    format: Format,
    clock: ServerClock,
    duration: Span,
    robots: usize,
    bar: ProgressBar,
    counts: std::cell::Cell<(usize, usize)>,
}

impl Console {
    fn new(format: Format, clock: ServerClock, duration: Span, robots: usize) -> Self {
        let target = match format {
            Format::Text => ProgressDrawTarget::stderr(),
            Format::Json => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(None, target);
        bar.set_style(ProgressStyle::default_spinner());
        Self { format, clock, duration, robots, bar, counts: std::cell::Cell::new((0, 0)) }
    }

    fn clear(&self) {
        self.bar.finish_and_clear();
    }

    fn line(&self, text: &str) {
        if self.format == Format::Text {
            self.bar.suspend(|| console::note(text));
        }
    }

    fn tell(&self, at: Timestamp<Server>, progress: &Progress) {
        let (accepted, finished) = self.counts.get();
        match progress {
            Progress::Connected { robots } => self.line(&format!("{} connected", counted(*robots, "robot"))),
            Progress::Greeted { clock_offset_max: Some(offset) } => {
                self.line(&format!("clocks agree to {offset}"));
            }
            Progress::Greeted { clock_offset_max: None } => {}
            Progress::Preparing { start, lead, .. } => {
                self.line(&format!("preparing, start at {start} (lead {})", lead.total()));
            }
            Progress::Accepted { .. } => {
                self.counts.set((accepted + 1, finished));
                self.bar.set_message(format!("{}/{} robots have accepted", accepted + 1, self.robots));
                self.bar.tick();
            }
            Progress::Decided { start } => self.decided(at, *start),
            Progress::Started { .. } => self.bar.tick(),
            Progress::Finished { .. } => {
                self.counts.set((accepted, finished + 1));
                self.bar.set_message(format!("{}/{} robots have finished", finished + 1, self.robots));
            }
            Progress::Failed(failure) => self.line(&format!("{}: {}", failure.robot, failure.kind)),
            Progress::Stopping { reason } => self.line(&format!("stopping all robots: {reason}")),
        }
    }

    fn decided(&self, at: Timestamp<Server>, start: Timestamp<Server>) {
        self.line(&format!(
            "all {} have accepted: starting in {}",
            counted(self.robots, "robot"),
            start - at
        ));
        let total = self.duration.to_duration();
        self.bar.set_length(u64::try_from(total.as_millis()).unwrap_or(u64::MAX));
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos:>6}/{len} ms  {msg}") {
            self.bar.set_style(style);
        }
        let (bar, clock) = (self.bar.clone(), self.clock);
        // Moves the bar with the show; ends when the bar is cleared.
        tokio::spawn(async move {
            while !bar.is_finished() {
                let played = (clock.now() - start).to_duration().min(total);
                bar.set_position(u64::try_from(played.as_millis()).unwrap_or(u64::MAX));
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        });
    }
}
