//! `downbeat run`: plays a mission on the fleet. The module `approach` asks robots for their positions, `opening` begins the journal, and
//! `others` finds missions that contain the same robots.

mod approach;
mod opening;
mod others;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use downbeat_robot::HostOptions;
use downbeat_robot::realtime::WakeUp;
use downbeat_scripts::{Address, Choreography, Fleet, FleetRobot, Wait, robots_named};
use tokio::sync::mpsc;
use urrcp::{Server, SessionId, Span, Timestamp};

use super::certify::CertifiedArgs;
use super::choice::{self, ChoiceArgs};
use super::console::OutputArgs;
use super::drivers::DriverArgs;
use super::fleet::ProgramArgs;
use super::live::{Live, Speaker};
use super::load;
use super::metrics::{Metrics, MetricsArgs};
use super::missions::unusable;
use super::realtime::{self, RealtimeArgs};
use super::traces::{Traces, TracesArgs};
use super::{Exit, Format, ScenarioArgs, console, detach, identity, robot};
use crate::certificate;
use crate::fleet::{self, Drivers, StartPrograms};
use crate::journal::{self, Missions, Opened, OperatorChoices};
use crate::mission::{FixedStart, FixedStarts, Greeting, Join, Mission, MissionOptions};
use crate::recording::{Recorder, Recording};
use crate::report::{HostWakeUp, Outcome, Report};
use crate::run::Keep;
use crate::run::control::Control;
use crate::run::desk::Desk;
use crate::server_clock::{self, NTP_WATCH_INTERVAL, NtpWatch, ServerClock};
use crate::session::{Session, SessionKey};
use crate::show::local::ZONE;
use crate::show::report_text;
use crate::signals::OnHangUp;
use crate::stop_lane::{Operator, StopLane};
use crate::zone::{SkippedTime, Zone};

/// Play a scenario on the fleet: all robots start together, or none does.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Ctrl-C stops the mission: every robot slows down, stays where it is, and confirms the stop. A second Ctrl-C \
exits at once and lists the robots that may still move. Closing the terminal also stops the mission, unless it runs with \
--detach. From another terminal, `downbeat stop` stops it, and `downbeat go` (or Enter here) starts an act that waits for \
the operator.

Examples:
  downbeat run show.yaml
  downbeat run show.yaml --fleet stage.yaml --at 19:30 --record show.mcap
  downbeat run show.yaml --at 19:30 --detach
  downbeat run show.yaml --speed 0.25 --only arm-1,arm-2
  downbeat run show.yaml --from finale --approach 5s
  downbeat run show.yaml --format json
  downbeat run show.yaml --seize
  downbeat run show.yaml --verify-motion
  downbeat run show.yaml --require-certificate show.cert.json"
)]
pub(super) struct RunArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    choice: ChoiceArgs,
    #[command(flatten)]
    how: HowArgs,
    #[command(flatten)]
    certified: CertifiedArgs,
    #[command(flatten)]
    realtime: RealtimeArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    traces: TracesArgs,
    #[command(flatten)]
    drivers: DriverArgs,
    /// Start at this time of day, for example 19:30 or 19:30:00.5, or at this instant in RFC 3339.
    #[arg(long, value_parser = parse_start, value_name = "TIME")]
    at: Option<StartAt>,
    /// Maximum delay of an act after `--at`, or after the time for which it waits, if it could not start otherwise: 10s, for example.
    /// Without this option, the act fails before anything moves.
    #[arg(long, value_parser = parse_span, value_name = "TIME", default_value = "0s", hide_default_value = true)]
    start_within: Span,
    /// Time from sending the scripts to the start, for example 1500ms or 3s. By default it is computed.
    #[arg(long, value_parser = parse_span, value_name = "TIME", conflicts_with = "at")]
    lead: Option<Span>,
    /// First move all robots to their first positions, in this time, for example 5s. Without this option, a start at which a device would
    /// have to jump is refused.
    #[arg(long, value_parser = approach::parse, value_name = "TIME", conflicts_with_all = ["seize", "require_certificate"])]
    approach: Option<Span>,
    /// What to do if robots do not answer at first.
    #[arg(long, value_enum, default_value_t = JoinArg::Refuse)]
    join: JoinArg,
    /// Take robots from other missions: their commands end, and they come to rest first. Your certificate or secret needs the role `seize`,
    /// and the robots need `tls://` or `hmac://` addresses.
    #[arg(long)]
    seize: bool,
    /// Read the sensors of devices with the key `calibrate` around the first movement of each act, and report when motions began.
    #[arg(long)]
    verify_motion: bool,
    /// Record all messages and movements in an MCAP file, for Foxglove and other tools.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Keep no journal. `downbeat stop`, `go`, `missions` and `resume` then cannot find the mission.
    #[arg(long)]
    no_journal: bool,
    /// Run in the background, independent of this terminal. The log is written to the mission's folder.
    #[arg(long, conflicts_with = "no_journal")]
    detach: bool,
    #[command(flatten)]
    output: OutputArgs,
}

/// Check whether every robot of a scenario is ready, without moving anything.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The command asks every robot of the scenario for its identity, its clock, the positions of its devices \
and the readings of its sensors, and prints a table with one row per robot and one column per check. It also measures how \
late this host wakes the robots of its own process. It starts the programs in the fleet file only with \
--start-programs.

Examples:
  downbeat preflight show.yaml
  downbeat preflight show.yaml --fleet stage.yaml --format json
  downbeat preflight show.yaml --require-certificate show.cert.json"
)]
pub(super) struct PreflightArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    choice: ChoiceArgs,
    #[command(flatten)]
    how: HowArgs,
    #[command(flatten)]
    certified: CertifiedArgs,
    #[command(flatten)]
    realtime: RealtimeArgs,
    #[command(flatten)]
    programs: ProgramArgs,
    #[command(flatten)]
    drivers: DriverArgs,
}

/// Options for the communication with the fleet.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct HowArgs {
    /// How long to wait for connections, greetings and stop confirmations.
    #[arg(long, value_parser = parse_span, default_value = "5s", value_name = "TIME")]
    pub(super) patience: Span,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
enum JoinArg {
    /// Do not start without them.
    Refuse,
    /// Start without them; each joins at the next act after it answers.
    NextAct,
}

/// The start time given by `--at`.
#[derive(Clone, Copy, Debug)]
enum StartAt {
    TimeOfDay(Span),
    Instant(Timestamp<Server>),
}

pub(super) fn parse_span(text: &str) -> Result<Span, String> {
    downbeat_scripts::parse_duration(text)
        .ok_or_else(|| "expected a time with its unit, such as 250ms, 3s or 1m30s".to_owned())
}

fn parse_start(text: &str) -> Result<StartAt, String> {
    match downbeat_scripts::parse_time(text) {
        Some(Wait::TimeOfDay(time)) => Ok(StartAt::TimeOfDay(time)),
        Some(Wait::Instant(at)) => Ok(StartAt::Instant(at)),
        _ => {
            Err("expected a time of day such as 19:30, or an instant such as 2026-05-01T19:30:00Z".to_owned())
        }
    }
}

pub(super) fn run(args: &RunArgs, format: Format) -> Exit {
    args.output.apply();
    if args.no_journal {
        console::warn(
            "no journal is kept: other terminals cannot stop this mission or send a go, and it cannot be resumed; Ctrl-C here stops it",
        );
    }
    let place = match (args.detach, args.detach.then(detach::detached_as).flatten()) {
        (false, _) => Place::Terminal,
        (true, None) => Place::Detaching,
        (true, Some(session)) => Place::Background(session),
    };
    let work = Work {
        scenario: &args.scenario,
        asked: args.choice.asked(),
        how: &args.how,
        certified: &args.certified,
        realtime: args.realtime,
        metrics: args.metrics,
        traces: args.traces.clone(),
        at: args.at,
        start_within: args.start_within,
        starts_with: None,
        lead: args.lead,
        join: match args.join {
            JoinArg::Refuse => Join::Refuse,
            JoinArg::NextAct => Join::NextAct,
        },
        seize: args.seize,
        verify_motion: args.verify_motion,
        approach: args.approach,
        record: args.record.as_deref(),
        journal: !args.no_journal,
        preflight_only: false,
        drivers: args.drivers.of(StartPrograms::Yes),
        place,
        format,
    };
    work.run()
}

pub(super) fn preflight(args: &PreflightArgs, format: Format) -> Exit {
    let work = Work {
        scenario: &args.scenario,
        asked: args.choice.asked(),
        how: &args.how,
        certified: &args.certified,
        realtime: args.realtime,
        metrics: MetricsArgs::default(),
        traces: TracesArgs::default(),
        at: None,
        start_within: Span::ZERO,
        starts_with: None,
        lead: None,
        join: Join::Refuse,
        seize: false,
        verify_motion: false,
        approach: None,
        record: None,
        journal: false,
        preflight_only: true,
        drivers: args.drivers.of(args.programs.asked()),
        place: Place::Terminal,
        format,
    };
    work.run()
}

/// The process in which a mission runs.
#[derive(Clone)]
enum Place {
    Terminal,
    /// In a background process that has not been started yet.
    Detaching,
    /// In this process, which runs in the background without a terminal. The contained name is that of the session.
    Background(SessionId),
    /// In this process, as a preparation of the actual mission: it only asks robots for the positions of their devices.
    Asking,
}

/// The reason why a mission did not begin, and the exit code of the command.
type Stopped = (String, Exit);

fn failed(message: String) -> Stopped {
    (message, Exit::Failed)
}

fn usage(message: String) -> Stopped {
    (message, Exit::Usage)
}

/// The name of a mission's session, and the key with which its scheduler proves that the session is its own.
struct KeyedSession {
    id: SessionId,
    key: SessionKey,
}

/// A fleet, and the path of the file from which it was read.
#[derive(Clone, Copy)]
struct FleetFile<'a> {
    fleet: &'a Fleet,
    path: &'a Path,
}

/// A mission whose resources, such as the journal, are ready, but whose robots have not been contacted.
struct Prepared<'a> {
    choreography: Arc<Choreography>,
    fleet: &'a Fleet,
    robots: Vec<&'a FleetRobot>,
    clock: ServerClock,
    options: MissionOptions,
    keep: Keep,
    /// The stop lane, the operator's commands and the control socket.
    with: (StopLane, mpsc::Receiver<Operator>, Option<Control>),
    metrics: Metrics,
    traces: Traces,
}

/// A mission as requested by the command's options.
#[derive(Clone)]
struct Work<'a> {
    scenario: &'a ScenarioArgs,
    asked: OperatorChoices,
    how: &'a HowArgs,
    certified: &'a CertifiedArgs,
    realtime: RealtimeArgs,
    metrics: MetricsArgs,
    traces: TracesArgs,
    at: Option<StartAt>,
    start_within: Span,
    /// The index of the act that starts at the time `at`. `None` for the first act.
    starts_with: Option<usize>,
    lead: Option<Span>,
    join: Join,
    seize: bool,
    verify_motion: bool,
    /// Duration of the movement to the first positions. `None` without `--approach`.
    approach: Option<Span>,
    record: Option<&'a Path>,
    journal: bool,
    preflight_only: bool,
    drivers: Drivers,
    place: Place,
    format: Format,
}

impl Work<'_> {
    fn run(mut self) -> Exit {
        let (choreography, fleet, fleet_path) = match load::load_choreography(self.scenario, self.format) {
            Ok(loaded) => loaded,
            Err(exit) => return exit,
        };
        let (choreography, first_act) = match choice::choose(choreography, &fleet, &self.asked) {
            Ok(chosen) => chosen,
            Err(exit) => return exit,
        };
        if let Err(exit) = self.certified.check(&choreography, &fleet, &self.asked, self.format) {
            return exit;
        }
        if self.seize && fleet::greeting(&fleet) == Greeting::Skip {
            console::error(
                "--seize requires `handshake: full`, but this fleet file contains `handshake: skip`; robots are seized during the handshake",
            );
            return Exit::Usage;
        }
        if self.verify_motion {
            let mut settings = fleet::robots_in(&fleet, &choreography).into_iter();
            if settings.all(|robot| robot.mission.calibrate.is_empty()) {
                console::error(
                    "--verify-motion reads the sensors listed under `calibrate`, but no robot of this scenario has that key; add `calibrate: {DEVICE: {sensor: SENSOR, by: AMOUNT}}` to a robot of the fleet file",
                );
                return Exit::Usage;
            }
        }
        if matches!(self.place, Place::Detaching) {
            let session = session_name(&choreography.scenario, &ServerClock::anchored(Span::ZERO));
            return match journal::state_folder() {
                Ok(state) => detach::detach(&session, &state, self.format),
                Err(error) => {
                    console::error(&error.to_string());
                    Exit::Usage
                }
            };
        }
        super::with_runtime(async {
            let (choreography, first_act) = match self.approach {
                None => (choreography, first_act),
                Some(over) => match self.approached(over, choreography, first_act, &fleet, &fleet_path).await
                {
                    Ok(approached) => approached,
                    Err(exit) => return exit,
                },
            };
            match self.play(choreography, first_act, &fleet, &fleet_path).await {
                Ok(report) => finish(&report, self.format),
                Err((message, exit)) => {
                    console::error(&message);
                    exit
                }
            }
        })
    }

    /// Plays the mission and returns its report.
    async fn play(
        &self,
        choreography: Choreography,
        first_act: usize,
        fleet: &Fleet,
        fleet_path: &Path,
    ) -> Result<Report, Stopped> {
        let metrics = self.metrics.serve(self.format).map_err(usage)?;
        let traces = self.traces.open().map_err(usage)?;
        let (clock, server_uncertainty) = server_clock(fleet, self.format).await.map_err(failed)?;
        let robots = fleet::robots_in(fleet, &choreography);
        let session = match &self.place {
            Place::Background(session) => session.clone(),
            Place::Terminal | Place::Detaching | Place::Asking => {
                session_name(&choreography.scenario, &clock)
            }
        };
        let state = if self.preflight_only { None } else { self.state(&robots)? };
        let key = SessionKey::random().map_err(|error| failed(error.to_string()))?;
        let driven_as =
            Session::with_key(session.clone(), &key).map_err(|error| failed(error.to_string()))?;
        let fixed = self.fixed(clock.now(), first_act)?;
        let options = self.options(fleet, server_uncertainty, driven_as, first_act, fixed);
        check_waits(&choreography, &options, clock.now())
            .map_err(|why| failed(format!("{}: {why}", self.scenario.scenario.display())))?;
        let mut keep = self.keep(fleet, clock)?;
        let lane = match self.place {
            // Nothing moves, so a signal may end the process. This lane must not handle signals, because they are for the mission's own
            // lane.
            Place::Asking => StopLane::deaf().map_err(|error| failed(error.to_string())),
            _ => stop_lane(self.on_hang_up()).map_err(failed),
        };
        let (lane, mut operator) = lane?;
        let mut control = None;
        if let Some(state) = state.filter(|_| self.journal) {
            let session = KeyedSession { id: session, key };
            let file = FleetFile { fleet, path: fleet_path };
            let opened = self.opened(session, &choreography, file, clock, &options, &robots);
            let folder = state.join(opened.session.as_str());
            let desk = identity::desk(&opened.keys);
            keep.journal = Some(opening::begin(state, opened, clock, &mut operator).await?);
            control = listen(&folder, &lane, desk);
        }
        let choreography = Arc::new(choreography);
        let with = (lane, operator, control);
        self.perform(Prepared { choreography, fleet, robots, clock, options, keep, with, metrics, traces })
            .await
    }

    /// Returns the folder for the state of missions. Returns an error if another mission of this machine contains one of these robots.
    /// Returns `None` if the folder is unusable and the mission keeps no journal.
    fn state(&self, robots: &[&FleetRobot]) -> Result<Option<PathBuf>, Stopped> {
        let read = journal::state_folder().map_err(|error| error.to_string()).and_then(|state| {
            let missions = Missions::of(&state).map_err(|error| unusable(&state, &error))?;
            Ok((state, missions))
        });
        match read {
            Ok((state, missions)) => {
                others::look_at(&missions, robots, self.seize).map_err(failed)?;
                Ok(Some(state))
            }
            Err(error) if self.journal => Err(usage(format!("{error}, or run with --no-journal"))),
            Err(error) => {
                console::warn(&format!("cannot check whether other missions use these robots: {error}"));
                Ok(None)
            }
        }
    }

    fn options(
        &self,
        fleet: &Fleet,
        server_uncertainty: Span,
        session: Session,
        first_act: usize,
        fixed: FixedStarts,
    ) -> MissionOptions {
        MissionOptions {
            greeting: fleet::greeting(fleet),
            lead: self.lead,
            patience: self.how.patience,
            server_uncertainty,
            session: Some(session),
            fixed,
            first_act: first_act.into(),
            acts_max: None,
            join: self.join,
            seize: self.seize,
            verify_motion: self.verify_motion,
            preflight_only: self.preflight_only,
            zone: ZONE,
            transfer: Some(fleet::transfer(fleet)),
            // Invariants are not checked, because a show must continue even if one is violated.
            check_invariants: false,
        }
    }

    fn fixed(&self, now: Timestamp<Server>, first_act: usize) -> Result<FixedStarts, Stopped> {
        let act = self.starts_with.unwrap_or(first_act);
        let operator = self.start(now)?.map(|at| FixedStart { act: act.into(), at });
        Ok(FixedStarts { operator, within: self.start_within })
    }

    /// Returns the instant that `--at` means, in the time zone of this machine. `None` without `--at`.
    fn start(&self, now: Timestamp<Server>) -> Result<Option<Timestamp<Server>>, Stopped> {
        let Some(at) = self.at else { return Ok(None) };
        let start = at.instant(now, ZONE).map_err(|skipped| usage(format!("--at: {}", refusal(skipped))))?;
        if let (Some(choice), Format::Text) = (at.choice_of_two(start, ZONE), self.format) {
            console::note(&choice);
        }
        Ok(Some(start))
    }

    /// Creates the mission's recording, if one is requested, and the watch that compares its clock with NTP. Does not create the journal
    /// and the stop lane.
    fn keep(&self, fleet: &Fleet, clock: ServerClock) -> Result<Keep, Stopped> {
        let ntp = fleet.ntp.clone().map(|server| NtpWatch::start(server, clock, NTP_WATCH_INTERVAL));
        let mut keep = Keep { ntp, ..Keep::default() };
        if let Some(path) = self.record {
            let recording = Recording::create(path).map_err(|error| usage(error.to_string()))?;
            let recorder = Recorder::start(recording);
            keep.recording = Some(
                recorder
                    .map_err(|error| failed(format!("cannot start a thread for the recording: {error}")))?,
            );
        }
        Ok(keep)
    }

    const fn on_hang_up(&self) -> OnHangUp {
        match self.place {
            Place::Background(_) => OnHangUp::Stay,
            Place::Terminal | Place::Detaching | Place::Asking => OnHangUp::End,
        }
    }

    /// Returns the contents of the journal's first line.
    fn opened(
        &self,
        session: KeyedSession,
        choreography: &Choreography,
        file: FleetFile<'_>,
        clock: ServerClock,
        options: &MissionOptions,
        robots: &[&FleetRobot],
    ) -> Opened {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        Opened {
            session: session.id,
            key: Some(session.key),
            pid: std::process::id(),
            name: Some(choreography.scenario.clone()),
            scenario: absolute(&self.scenario.scenario),
            fleet: absolute(file.path),
            folder: std::env::current_dir().ok(),
            project: self.scenario.project.folder(),
            asked: self.asked.clone(),
            plan_hash: Some(certificate::plan_hash(choreography, &self.asked)),
            fixed: options.fixed,
            greeting: options.greeting,
            clock_offset: clock.offset(),
            keys: identity::keys(file.fleet),
            robots: robots.iter().map(|robot| opening::opened_robot(robot)).collect(),
        }
    }

    /// Connects to the robots, plays the mission and releases its resources. Returns the mission's report.
    async fn perform(&self, prepared: Prepared<'_>) -> Result<Report, Stopped> {
        let Prepared { choreography, fleet, robots, clock, options, mut keep, with, metrics, traces } =
            prepared;
        let (lane, operator, control) = with;
        let (speaker, stopped) = (Speaker::of(&lane), lane.is_stopped());
        keep.stop_lane = Some(lane);
        let wake_up = if self.preflight_only { measured_wake_up(self.realtime).await } else { None };
        let host_options = HostOptions::default().with_realtime(self.realtime.realtime());
        announce_blackouts(&robots);
        let site = identity::site(fleet).map_err(|error| (error, Exit::Usage))?;
        let (host, endpoints) =
            fleet::endpoints_at_once(&robots, fleet.handshake, &site, host_options, self.drivers)
                .map_err(|error| (error.to_string(), realtime::exit_of(&error)))?;
        if let Some(host) = &host {
            tokio::select! {
                () = fleet::await_hardware(host, self.drivers) => {}
                // The mission has not sent anything yet. It handles the stop when it begins.
                () = stopped => {}
            }
        }
        let tolerance = choreography.acts.get(options.first_act.get()).map(|act| act.plan.start_tolerance);
        if let (Some(host), false) = (&host, self.preflight_only) {
            self.realtime.tell(host, self.format);
        }
        let ids = robots.iter().map(|robot| robot.id.clone()).collect();
        metrics.add_mission(clock, ids, &endpoints, host.as_ref(), &mut keep.watches);
        let participants = fleet::participants(&robots);
        let mission = Mission::new(Arc::clone(&choreography), participants, options, clock.now())
            .map_err(|error| failed(error.to_string()))?;
        traces.add_mission(clock, &mission, &mut keep.watches);
        let live = if self.preflight_only {
            // The result of a preflight is printed once, as a table.
            Live::lines(Format::Json)
        } else {
            let ids = robots.iter().map(|robot| robot.id.clone());
            Live::start(self.format, clock, choreography, ids, speaker)
        };
        let tell = |at, progress: &_| live.tell(at, progress);
        let mut report = crate::run::run_and_keep(mission, endpoints, clock, operator, tell, &mut keep).await;
        drop(live);
        if let Some(mut recorder) = keep.recording.take() {
            if let Ok(report) = serde_json::to_value(&report) {
                let ended = clock.now();
                recorder.note(move |recording| recording.report(ended, &report));
            }
            report.recording = Some(recorder.finish().await);
        }
        report.wake_up = wake_up.map(|wake_up| {
            let WakeUp { scheduling, median, p99, longest } = wake_up;
            let measured =
                HostWakeUp { median, p99, longest, scheduling: scheduling.to_string(), warning: None };
            measured.judged_by(host.as_ref().and(tolerance))
        });
        robot::stop_for(&mut report, host);
        if let Some(control) = control {
            control.end(serde_json::to_string(&report).ok()).await;
        }
        traces.end();
        Ok(report)
    }
}

impl StartAt {
    fn instant(self, now: Timestamp<Server>, zone: Zone) -> Result<Timestamp<Server>, SkippedTime> {
        match self {
            Self::Instant(at) => Ok(at),
            Self::TimeOfDay(time) => zone.next(now, time),
        }
    }

    /// Returns a sentence that states which instant `--at` means, if the clocks show its time of day twice on that date. Otherwise
    /// returns `None`.
    fn choice_of_two(self, at: Timestamp<Server>, zone: Zone) -> Option<String> {
        let other = zone.repeated(at).filter(|_| matches!(self, Self::TimeOfDay(_)))?;
        let which = if at < other { "the first" } else { "the second" };
        Some(format!(
            "clocks show {} twice that day: --at means {which} time, {}; for the other one, write --at {}",
            zone.seconds_of_day(at),
            zone.rfc3339(at),
            zone.rfc3339(other)
        ))
    }
}

/// Rejects a scenario if an act would wait for a time of day that the clocks skip on that date.
fn check_waits(
    choreography: &Choreography,
    options: &MissionOptions,
    now: Timestamp<Server>,
) -> Result<(), String> {
    let fixed = options.fixed.operator;
    let acts = choreography.acts.iter().skip(fixed.map_or(options.first_act, |fixed| fixed.act).get());
    let mut from = fixed.map_or(now, |fixed| fixed.at);
    for act in acts.skip(usize::from(fixed.is_some())) {
        from = match &act.wait {
            Wait::TimeOfDay(time) => {
                let next = options.zone.next(from, *time);
                next.map_err(|skipped| {
                    format!("act `{}` cannot wait for its time of day: {}", act.called(), refusal(skipped))
                })?
            }
            Wait::Instant(at) => from.max(*at),
            Wait::Done | Wait::Operator | Wait::Sensor { .. } => from,
        };
    }
    Ok(())
}

fn refusal(skipped: SkippedTime) -> String {
    format!("{skipped}; the nearest existing times are {}", skipped.nearest())
}

/// Creates the mission's control socket. If that fails, prints a warning and returns `None`: the mission plays without it.
pub(super) fn listen(folder: &Path, lane: &StopLane, desk: Option<Desk>) -> Option<Control> {
    let listening = Control::listen(folder, lane, desk);
    let failed = |error: &std::io::Error| {
        console::warn(&format!(
            "`downbeat go` cannot reach this mission, and `downbeat stop` can reach only its robots: {error}"
        ));
    };
    listening.inspect_err(failed).ok()
}

/// Returns a unique session name, made from the scenario, this machine, this process and the current time.
fn session_name(scenario: &str, clock: &ServerClock) -> SessionId {
    let plain: String =
        scenario.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).take(20).collect();
    let uname = rustix::system::uname();
    let host: String = uname.nodename().to_string_lossy().chars().take(12).collect();
    let now = chrono::DateTime::from_timestamp_nanos(clock.now().as_nanos()).format("%Y%m%dT%H%M%S%3f");
    let name = format!("{plain}@{host}-{}-{now}", std::process::id());
    // The name is never empty. It is short, because the path of the mission's socket may have at most 107 bytes.
    name.parse().unwrap_or_else(|_| unnamed())
}

#[expect(clippy::expect_used, reason = "a constant below every limit")]
fn unnamed() -> SessionId {
    "downbeat".parse().expect("a constant below every limit")
}

/// Measures how late this host wakes its robots. The measurement takes a moment. Returns `None` if it fails.
async fn measured_wake_up(realtime: RealtimeArgs) -> Option<WakeUp> {
    let measure = move || WakeUp::measure(realtime.realtime());
    tokio::task::spawn_blocking(measure).await.ok()?.ok()
}

/// Creates the server's clock: by NTP if the fleet file names an NTP server, else from the system clock. Also returns the uncertainty of
/// the NTP time, or zero for the system clock.
pub(super) async fn server_clock(fleet: &Fleet, format: Format) -> Result<(ServerClock, Span), String> {
    let Some(server) = &fleet.ntp else { return Ok((ServerClock::anchored(Span::ZERO), Span::ZERO)) };
    let reading = server_clock::ask_ntp(server).await.map_err(|error| error.to_string())?;
    if format == Format::Text {
        console::note(&format!(
            "NTP time from {server}: this machine's clock is off by {} (+-{}), stratum {}",
            reading.offset, reading.uncertainty, reading.stratum
        ));
    }
    Ok((ServerClock::anchored(reading.offset), reading.uncertainty))
}

/// Starts the stop lane, which can stop the robots even if everything else is blocked. Also returns the receiver of the operator's
/// commands.
pub(super) fn stop_lane(on_hang_up: OnHangUp) -> Result<(StopLane, mpsc::Receiver<Operator>), String> {
    StopLane::start(on_hang_up).map_err(|error| format!("cannot prepare to stop the robots: {error}"))
}

pub(super) fn finish(report: &Report, format: Format) -> Exit {
    match format {
        Format::Json => console::print_json(report),
        Format::Text => console::print(&report_text(report, console::detail(), console::columns())),
    }
    exit_of(report)
}

/// Returns the exit code for a mission's report.
pub(super) fn exit_of(report: &Report) -> Exit {
    let unconfirmed = report.robots.iter().any(|robot| robot.stop.is_unconfirmed());
    if !report.not_at_rest.is_empty() {
        return Exit::Unconfirmed;
    }
    let recorded = report.recording.as_ref().is_none_or(|recording| recording.failure.is_none());
    match &report.outcome {
        Outcome::Done | Outcome::Ready if recorded => Exit::Done,
        Outcome::Done | Outcome::Ready => Exit::Unwritten,
        _ if unconfirmed => Exit::Unconfirmed,
        Outcome::DoneWithout | Outcome::DoneSkipping { .. } => Exit::DoneWithout,
        Outcome::Stopped => Exit::Stopped,
        Outcome::OutOfTolerance { .. } | Outcome::StepsLate { .. } | Outcome::Unknown => Exit::Uncertain,
        _ => Exit::Failed,
    }
}

/// Announces which fixtures go dark when this process ends, because a mission otherwise leaves devices where they are.
fn announce_blackouts(robots: &[&FleetRobot]) {
    let goes_dark =
        |robot: &&&FleetRobot| matches!(&robot.address, Address::Dmx(fixture) if fixture.blackout);
    let dark: Vec<&str> = robots.iter().filter(goes_dark).map(|robot| robot.id.as_str()).collect();
    if !dark.is_empty() {
        console::note(&format!(
            "{} will go dark at the end (`end=blackout` in the fleet file)",
            robots_named(dark.iter().copied())
        ));
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use crate::cli::Cli;

    #[test]
    fn approach_allows_act_options_but_not_seize_or_certificate_options() {
        let goes_with = |more: &[&str]| {
            let approach = ["downbeat", "run", "show.yaml", "--approach", "5s"];
            Cli::try_parse_from([&approach[..], more].concat()).is_ok()
        };
        for option in [["--act", "bow"], ["--from", "bow"], ["--only", "arm"], ["--at", "19:30"]] {
            assert!(goes_with(&option), "{option:?}");
        }
        assert!(!goes_with(&["--seize"]) && !goes_with(&["--require-certificate", "show.cert.json"]));
    }
}
