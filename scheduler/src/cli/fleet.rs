//! `downbeat fleet`: asks the robots of a fleet for their descriptions and clocks.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use downbeat_robot::HostOptions;
use downbeat_robot::driver::describe_thrift;
use downbeat_scripts::{
    Address, ClockMode, Fleet, FleetRobot, Protection, Source, address_fault, counted, init_of, init_text,
};
use serde::Serialize;
use tokio::sync::mpsc;
use urrcp::{
    AvailabilityRequest, InitializationBlock, InitializationRequest, Message, RevocationList, RobotId, Span,
    Status,
};

use super::drivers::DriverArgs;
use super::run::parse_span;
use super::{Exit, Format, ProjectArgs, console, identity, load};
use crate::clock::{ClockEstimate, ClockReading, ClockSample};
use crate::drive::{Happened, LinkNumber, Urgency};
use crate::fleet::{self, Drivers, StartPrograms};
use crate::keys::calendar;
use crate::link::{Endpoint, Link, LinkEncoding, Security};
use crate::mission::{Event, RobotIndex};
use crate::server_clock::ServerClock;
use crate::show::table::Rows;

/// Ask the robots of a fleet for their descriptions and clocks.
#[derive(Debug, Subcommand)]
pub(super) enum FleetCommand {
    /// Check that every robot answers, and measure the error of its clock.
    #[command(
        after_help = "The command fails if a robot does not answer, if a different robot answers, or if \
the error of a clock exceeds the tolerance (except with `clock: measured`).

Examples:
  downbeat fleet ping
  downbeat fleet ping stage.yaml --tolerance 100ms
  downbeat fleet ping stage.yaml --format json"
    )]
    Ping(PingArgs),
    /// Ask every robot for its description and show its devices.
    #[command(
        after_help = "Examples:\n  downbeat fleet show\n  downbeat fleet show stage.yaml --format json"
    )]
    Show(FleetArgs),
    /// Ask one robot for its description and print it as an init file.
    #[command(after_help = "docs/edge.md explains which lines of the file to adapt.

Examples:
  downbeat fleet describe thrift://tank.local:9090 > tank.yaml
  downbeat fleet describe tcp://192.0.2.7:7401 > arm.yaml")]
    Describe(DescribeArgs),
}

#[derive(Debug, Args)]
pub(super) struct DescribeArgs {
    /// The robot's address, such as tcp://host:port or thrift://host:port.
    #[arg(value_parser = parse_address)]
    address: Address,
    /// How long to wait for an answer.
    #[arg(long, value_parser = parse_span, default_value = "5s", value_name = "TIME")]
    patience: Span,
}

#[derive(Debug, Args)]
pub(super) struct FleetArgs {
    /// The fleet file.
    #[arg(default_value = "fleet.yaml")]
    fleet: PathBuf,
    #[command(flatten)]
    project: ProjectArgs,
    #[command(flatten)]
    programs: ProgramArgs,
    #[command(flatten)]
    drivers: DriverArgs,
    /// How long to wait for answers.
    #[arg(long, value_parser = parse_span, default_value = "5s", value_name = "TIME")]
    patience: Span,
}

/// Whether the programs of the fleet file are started.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct ProgramArgs {
    /// Start the programs that the fleet file names as drivers (`address: program:COMMAND`). Otherwise their robots are not available.
    #[arg(long)]
    start_programs: bool,
}

impl ProgramArgs {
    pub(super) const fn asked(self) -> StartPrograms {
        if self.start_programs { StartPrograms::Yes } else { StartPrograms::No }
    }
}

#[derive(Debug, Args)]
pub(super) struct PingArgs {
    #[command(flatten)]
    asked: FleetArgs,
    /// Maximum clock error of a robot, beyond the uncertainty of the measurement.
    #[arg(long, value_parser = parse_span, default_value = "10ms", value_name = "TIME")]
    tolerance: Span,
}

fn parse_address(text: &str) -> Result<Address, String> {
    text.parse().map_err(|_| {
        let (fault, hint) = address_fault(text);
        format!(
            "it {fault}; {}",
            hint.unwrap_or_else(|| "write tcp://HOST:PORT or thrift://HOST:PORT".to_owned())
        )
    })
}

/// Number of exchanges that measure the clock of each robot.
const SAMPLES: u32 = 8;

/// The answer of one robot, or the reason why it is missing.
#[derive(Debug, Serialize)]
pub(super) struct Answer {
    pub(super) robot: RobotId,
    reachable: bool,
    clock: Option<ClockReading>,
    pub(super) problem: Option<String>,
    /// The list of revoked keys that the robot uses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) revocation_list: Option<RevocationList>,
    #[serde(skip_serializing_if = "Option::is_none")]
    block: Option<InitializationBlock>,
}

pub(super) fn fleet(command: &FleetCommand, format: Format) -> Exit {
    let (args, tolerance) = match command {
        FleetCommand::Describe(args) => return describe(args, format),
        FleetCommand::Ping(args) => (&args.asked, Some(args.tolerance)),
        FleetCommand::Show(args) => (args, None),
    };
    let fleet = match load::load_fleet(&args.fleet, &args.project, format) {
        Ok(fleet) => fleet,
        Err(exit) => return exit,
    };
    super::with_runtime(async {
        let robots = fleet.robots.iter().map(|robot| RobotToAsk { robot, list: None }).collect();
        let drivers = args.drivers.of(args.programs.asked());
        let mut answers = match ask_all(&fleet, robots, drivers, args.patience).await {
            Ok(answers) => answers,
            Err(message) => {
                console::error(&message);
                return Exit::Failed;
            }
        };
        for (answer, robot) in answers.iter_mut().zip(&fleet.robots) {
            answer.problem = answer.problem.take().or_else(|| wrong_with(answer, robot, tolerance));
        }
        note_older_lists(&mut answers);
        let all_well = answers.iter().all(|answer| answer.problem.is_none());
        match (format, command) {
            (Format::Json, _) => console::print_json(&answers),
            (Format::Text, FleetCommand::Ping(_)) => {
                console::print(&ping_table(&fleet, &answers));
                show_problems(&answers);
            }
            (Format::Text, _) => {
                console::print(&show_table(&answers));
                show_problems(&answers);
            }
        }
        if all_well { Exit::Done } else { Exit::Failed }
    })
}

fn show_problems(answers: &[Answer]) {
    for answer in answers {
        if let Some(problem) = &answer.problem {
            console::error(&format!("{}: {problem}", answer.robot));
        }
    }
}

/// Returns the fault, if any, of a robot that answers: it is not the expected robot, or its clock is wrong.
fn wrong_with(answer: &Answer, robot: &FleetRobot, tolerance: Option<Span>) -> Option<String> {
    let expected = robot.init.as_ref().map_or(&robot.id, |init| &init.id);
    if let Some(block) = answer.block.as_ref().filter(|block| block.id != *expected) {
        return Some(format!("a different robot answered: its id is `{}`, expected `{expected}`", block.id));
    }
    let (reading, tolerance) = (answer.clock.as_ref()?, tolerance?);
    let off = robot.mission.clock == ClockMode::Ntp && reading.offset.abs() - reading.uncertainty > tolerance;
    off.then(|| format!("its clock is off by more than {tolerance}; check its NTP synchronization"))
}

fn describe(args: &DescribeArgs, format: Format) -> Exit {
    let told = match &args.address {
        Address::Tcp { host, port, protection } => {
            let security = match protection {
                Protection::Open => Ok(Security::Plain),
                _ => identity::site_of_terminal().map(|site| site.with(*protection, None)),
            };
            let tcp = |security| Endpoint::Tcp {
                host: host.clone(),
                port: *port,
                encoding: LinkEncoding::default(),
                security,
            };
            security.and_then(|security| ask_block(tcp(security), args.patience))
        }
        Address::Zenoh { key } => {
            let network = identity::site_of_terminal().and_then(|site| site.network());
            let endpoint = network.map(|network| network.endpoint(key, LinkEncoding::default()));
            let endpoint = endpoint.and_then(|endpoint| endpoint.ok_or_else(|| "no key".to_owned()));
            endpoint.and_then(|endpoint| ask_block(endpoint, args.patience))
        }
        Address::Thrift { host, port, .. } => match describe_thrift(host, *port) {
            Ok(text) => match init_of(&Source { name: args.address.to_string(), text }) {
                Ok(block) => Ok(block),
                Err(findings) => {
                    load::show_findings(&findings);
                    return Exit::Failed;
                }
            },
            Err(error) => {
                let text = error.to_string();
                let text = text.split(" (os error").next().unwrap_or_default();
                Err(format!("{text}; check the robot's address, and that the robot is switched on"))
            }
        },
        _ => {
            console::error(&format!(
                "`{}` cannot be described; expected the address of a robot, tcp://HOST:PORT or thrift://HOST:PORT",
                args.address
            ));
            return Exit::Usage;
        }
    };
    match (told, format) {
        (Ok(block), Format::Text) => console::print(&init_text(&block)),
        (Ok(block), Format::Json) => console::print_json(&block),
        (Err(message), _) => {
            console::error(&message);
            return Exit::Failed;
        }
    }
    Exit::Done
}

fn ask_block(endpoint: Endpoint, patience: Span) -> Result<InitializationBlock, String> {
    let mut told = Err("no answer".to_owned());
    super::with_runtime(async {
        told = description(endpoint, patience).await;
        Exit::Done
    });
    told
}

/// Asks the robot at an endpoint for its description. Returns the reason if it sends none.
pub(super) async fn description(endpoint: Endpoint, patience: Span) -> Result<InitializationBlock, String> {
    let clock = ServerClock::anchored(Span::ZERO);
    let (events, happened) = mpsc::channel(64);
    let link =
        Link::open((RobotIndex::new(0), LinkNumber(0)), endpoint, clock, events, std::time::Duration::ZERO);
    let answer = ask(unnamed(), None, link, happened, clock, patience).await;
    let problem = answer.problem.unwrap_or_else(|| "the robot did not describe itself".to_owned());
    answer.block.ok_or(problem)
}

#[expect(clippy::expect_used, reason = "a constant, read by every test of this command")]
fn unnamed() -> RobotId {
    "robot".parse().expect("a constant below every limit")
}

/// A robot to ask for its description and its clock.
pub(super) struct RobotToAsk<'a> {
    pub(super) robot: &'a FleetRobot,
    /// The list of revoked keys to send to the robot, if any.
    pub(super) list: Option<String>,
}

/// Asks robots of a fleet for their descriptions and clocks. Sends each robot its list of revoked keys, if any.
pub(super) async fn ask_all(
    fleet: &Fleet,
    asked: Vec<RobotToAsk<'_>>,
    drivers: Drivers,
    patience: Span,
) -> Result<Vec<Answer>, String> {
    let clock = ServerClock::anchored(Span::ZERO);
    let (robots, lists): (Vec<&FleetRobot>, Vec<Option<String>>) =
        asked.into_iter().map(|asked| (asked.robot, asked.list)).unzip();
    let site = identity::site(fleet)?;
    let (host, endpoints) =
        fleet::endpoints(&robots, fleet.handshake, &site, HostOptions::default(), drivers)
            .map_err(|error| error.to_string())?;
    let asked = robots.iter().zip(lists).zip(endpoints).map(|((robot, list), endpoint)| {
        let (events, happened) = mpsc::channel(64);
        let link = Link::open(
            (RobotIndex::new(0), LinkNumber(0)),
            endpoint,
            clock,
            events,
            std::time::Duration::ZERO,
        );
        let id = robot.id.clone();
        // Each robot has its own task, so that a silent robot does not delay others. The task ends after `patience`.
        tokio::spawn(ask(id, list, link, happened, clock, patience))
    });
    let mut answers = Vec::new();
    for task in asked.collect::<Vec<_>>() {
        answers.push(task.await.map_err(|error| error.to_string())?);
    }
    if let Some(host) = host {
        host.stop();
    }
    Ok(answers)
}

async fn ask(
    robot: RobotId,
    mut list: Option<String>,
    link: Link,
    mut happened: mpsc::Receiver<Happened>,
    clock: ServerClock,
    patience: Span,
) -> Answer {
    let mut answer =
        Answer { robot, reachable: false, clock: None, problem: None, revocation_list: None, block: None };
    let mut estimate = ClockEstimate::default();
    let talk = async {
        while let Some(Happened::OnLink { at, event, .. }) = happened.recv().await {
            match *event {
                Event::LinkUp { .. } => {
                    answer.reachable = true;
                    let request = InitializationRequest { timestamp: Some(clock.now()) };
                    let _never_full = link.send(Message::InitializationRequest(request), Urgency::InOrder);
                    ping(&link, &clock, list.take());
                }
                Event::Received { message: Message::AvailabilityResponse(response), .. } => {
                    answer.revocation_list = response.revocation_list;
                    if response.status == Status::Failed {
                        return Some(
                            response.error.map_or("not available".to_owned(), |error| error.to_string()),
                        );
                    }
                    if let Some(sent) = response.originate_timestamp {
                        let sample = ClockSample::from_exchange(
                            sent,
                            response.receive_timestamp,
                            response.timestamp,
                            at,
                        );
                        estimate.add(sample);
                    }
                    match estimate.samples() < SAMPLES {
                        true => ping(&link, &clock, None),
                        false if answer.block.is_some() => return None,
                        false => {}
                    }
                }
                Event::Received { message: Message::InitializationBlock(block), .. } => {
                    answer.block = Some(block);
                    if estimate.samples() >= SAMPLES {
                        return None;
                    }
                }
                Event::LinkDown { reason, .. } | Event::Garbled { reason, .. } => return Some(reason),
                _ => {}
            }
        }
        Some("the link was closed".to_owned())
    };
    let problem = tokio::time::timeout(patience.to_duration(), talk).await;
    let silent = || format!("no answer within {patience}; check that the program at this address is a robot");
    answer.problem = problem.unwrap_or_else(|_| Some(silent()));
    answer.clock = estimate.reading();
    answer
}

fn ping(link: &Link, clock: &ServerClock, revocation_list: Option<String>) {
    let timestamp = Some(clock.now());
    let request = AvailabilityRequest { timestamp, session: None, seize: false, revocation_list };
    let _never_full = link.send(Message::AvailabilityRequest(request), Urgency::InOrder);
}

fn ping_table(fleet: &Fleet, answers: &[Answer]) -> String {
    let has_lists = answers.iter().any(|answer| answer.revocation_list.is_some());
    let mut header = vec!["robot", "address", "answers", "least delay", "clock offset", "uncertainty"];
    header.extend(has_lists.then_some("list of revoked keys"));
    let mut table = Rows::new(&header, 3);
    for (answer, robot) in answers.iter().zip(&fleet.robots) {
        let state = match (answer.reachable, &answer.problem) {
            (true, None) => "yes",
            (true, Some(_)) => "yes, but see below",
            (false, _) => "no",
        };
        let clock = |value: fn(&ClockReading) -> Span| {
            answer.clock.as_ref().map_or_else(|| "-".to_owned(), |reading| value(reading).to_string())
        };
        let mut row = vec![
            answer.robot.to_string(),
            robot.address.to_string(),
            state.to_owned(),
            clock(|reading| reading.delay_min),
            clock(|reading| reading.offset),
            clock(|reading| reading.uncertainty),
        ];
        row.extend(has_lists.then(|| {
            answer.revocation_list.as_ref().map_or_else(|| "none".to_owned(), |list| shown_list(list.number))
        }));
        table.add(row);
    }
    let wrong = |row: usize| answers[row].problem.is_some();
    table.painted(console::columns(), |row, line| if wrong(row) { console::red(&line) } else { line })
}

/// Returns the number of a list of revoked keys. If `downbeat keys` made the list, the number is its creation time in seconds since 1970,
/// UTC, and the text includes the age of the list.
pub(super) fn shown_list(number: u64) -> String {
    const OLDEST: u64 = 1_700_000_000;
    const DAY: u64 = 24 * 3_600;
    let now = u64::try_from(calendar()).unwrap_or_default();
    if !(OLDEST..=now + DAY).contains(&number) {
        return number.to_string();
    }
    match now.saturating_sub(number) / DAY {
        0 => format!("{number}, less than a day old"),
        days => format!("{number}, {} old", counted(usize::try_from(days).unwrap_or(usize::MAX), "day")),
    }
}

/// Adds a problem to each robot whose list of revoked keys is older than that of another robot.
fn note_older_lists(answers: &mut [Answer]) {
    let number = |answer: &Answer| answer.revocation_list.as_ref().map(|list| list.number);
    let Some(newest) = answers.iter().filter_map(number).max() else { return };
    for answer in answers.iter_mut().filter(|answer| answer.problem.is_none()) {
        if number(answer).is_some_and(|number| number < newest) {
            answer.problem = Some(format!(
                "its list of revoked keys is older than list {newest} of another robot; send it the latest list with `downbeat keys push`"
            ));
        }
    }
}

fn show_table(answers: &[Answer]) -> String {
    let header = ["robot", "device", "unit", "control type", "from", "to", "granularity", "steps"];
    let mut table = Rows::new(&header, 4);
    for answer in answers {
        let Some(block) = answer.block.as_ref().filter(|_| answer.problem.is_none()) else { continue };
        for device in &block.devices {
            for (control_type, parameters) in device.available_control_types.iter() {
                let json = serde_json::to_value(parameters).unwrap_or_default();
                let cell = |key: &str| json.get(key).map_or_else(|| "-".to_owned(), ToString::to_string);
                table.add([
                    answer.robot.to_string(),
                    device.id.to_string(),
                    device.unit.as_ref().map_or_else(|| "-".to_owned(), ToString::to_string),
                    control_type.to_string(),
                    cell("min_value"),
                    cell("max_value"),
                    cell("granularity"),
                    cell("max_number_of_steps"),
                ]);
            }
        }
    }
    if table.is_empty() { String::new() } else { table.text(console::columns()) }
}
