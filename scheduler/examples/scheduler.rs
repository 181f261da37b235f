//! A scheduler to copy: plays a scenario on a fleet. Ctrl-C stops it.
//!
//! `cargo run --example scheduler -- fleet.yaml scripts/examples/swap.yaml`
#![expect(clippy::print_stdout, reason = "an example for a terminal")]

use std::error::Error;
use std::path::Path;

use downbeat::fleet::{self, StartPrograms};
use downbeat::link::Site;
use downbeat::mission::{Mission, MissionOptions, Rest};
use downbeat::report::Report;
use downbeat::run::run;
use downbeat::server_clock::ServerClock;
use downbeat::session::{Session, SessionKey};
use downbeat::show::{Detail, report_text};
use downbeat::stop_lane::Operator;
use downbeat_robot::HostOptions;
use downbeat_scripts::{Folder, Source, compile, read_fleet, render};
use tokio::sync::mpsc;
use urrcp::Span;

/// Plays it to its end. Messages on `operator` reach the mission while it runs.
pub async fn play(
    fleet: &Path,
    scenario: &Path,
    operator: mpsc::Receiver<Operator>,
) -> Result<Report, Box<dyn Error>> {
    let (fleet, findings) = read_fleet(fleet);
    let fleet = fleet.ok_or_else(|| render(&findings, false))?;
    let source = Source::read(scenario).map_err(|finding| render(&[finding], false))?;
    let folder = Folder::new(scenario.parent().unwrap_or(Path::new("")).to_owned());
    let compiled = compile(&source, &fleet, &folder);
    let choreography = compiled.choreography.ok_or_else(|| render(&compiled.findings, false))?;

    // The system's clock is taken as it is; `server_clock::ask_ntp` tells how far it is off.
    let clock = ServerClock::anchored(Span::ZERO);
    // The name that robots know has a random key, so that nobody else can drive them.
    let session = Some(Session::with_key("example".parse()?, &SessionKey::random()?)?);
    let options = MissionOptions { session, ..MissionOptions::default() };
    let robots = fleet::robots_in(&fleet, &choreography);
    // Simulated robots and drivers run in this process, on the host.
    let (site, options_of_host) = (Site::of(&fleet, None)?, HostOptions::default());
    let (host, endpoints) =
        fleet::endpoints(&robots, fleet.handshake, &site, options_of_host, StartPrograms::Yes.into())?;
    let mission = Mission::new(choreography, fleet::participants(&robots), options, clock.now())?;
    let report = run(mission, endpoints, clock, operator, |_, _| {}).await;
    drop(host);
    Ok(report)
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let (fleet, scenario) = words.next().zip(words.next()).ok_or("scheduler FLEET SCENARIO")?;
    let (operator, orders) = mpsc::channel(1);
    tokio::spawn(async move {
        if tokio::signal::ctrl_c().await.is_ok() {
            let _ended_meanwhile = operator.send(Operator::Stop { rest: Rest::InPlace, by: None }).await;
        }
    });
    let report = play(fleet.as_ref(), scenario.as_ref(), orders).await?;
    print!("{}", report_text(&report, Detail::Brief, 100));
    Ok(())
}
