//! `--approach`: asks the robots for their positions, and plans an act that moves them to their first positions.

use std::collections::BTreeMap;
use std::path::Path;

use downbeat_scripts::{Approach, Choreography, Fleet};
use urrcp::{DeviceId, RobotId, Server, Span, Timestamp};

use super::{Place, StartAt, Work, finish, parse_span};
use crate::cli::metrics::MetricsArgs;
use crate::cli::traces::TracesArgs;
use crate::cli::{Exit, choice, console};
use crate::fleet;
use crate::mission::{Check, Failure, FailureKind, Greeting, Verdict};
use crate::report::Outcome;
use crate::server_clock::ServerClock;

/// Parses the duration of an approach, from 100 ms to 600 s.
pub(super) fn parse(text: &str) -> Result<Span, String> {
    let over = parse_span(text)?;
    let fits = over >= Span::from_millis(100) && over <= Span::from_millis(600_000);
    if fits { Ok(over) } else { Err("expected a time from 100ms to 600s".to_owned()) }
}

impl Work<'_> {
    /// Adds an approach: an act that moves all devices to their first positions. Returns the choreography and the index of the act to
    /// begin with.
    pub(super) async fn approached(
        &mut self,
        over: Span,
        choreography: Choreography,
        first_act: usize,
        fleet: &Fleet,
        fleet_path: &Path,
    ) -> Result<(Choreography, usize), Exit> {
        let start = self.fix_start()?;
        let from = self.positions(choreography.clone(), first_act, fleet, fleet_path).await?;
        let approach = self.asked.approach.insert(Approach { over, from });
        let acts = choreography.acts.len();
        let (choreography, first) = choice::approached(choreography, first_act, fleet, approach)?;
        if choreography.acts.len() > acts {
            self.starts_with = Some(first_act + 1);
            self.allow_for(over, start)?;
        }
        Ok((choreography, first))
    }

    /// Converts `--at` to an instant, before the requests to the robots take time.
    fn fix_start(&mut self) -> Result<Option<Timestamp<Server>>, Exit> {
        let start = self.start(ServerClock::anchored(Span::ZERO).now()).map_err(|(message, exit)| {
            console::error(&message);
            exit
        })?;
        self.at = start.map(StartAt::Instant);
        Ok(start)
    }

    /// Rejects a start time that is before the end of the approach.
    fn allow_for(&self, over: Span, start: Option<Timestamp<Server>>) -> Result<(), Exit> {
        let left = start.map(|start| start + self.start_within - ServerClock::anchored(Span::ZERO).now());
        match left.filter(|left| *left <= over) {
            Some(_) => {
                console::error(&format!(
                    "the approach takes {over}, which is longer than the time until --at; choose a later start or a shorter approach"
                ));
                Err(Exit::Usage)
            }
            None => Ok(()),
        }
    }

    /// Asks the robots for the positions of their devices, and returns them. Nothing moves.
    async fn positions(
        &self,
        choreography: Choreography,
        first_act: usize,
        fleet: &Fleet,
        fleet_path: &Path,
    ) -> Result<BTreeMap<RobotId, BTreeMap<DeviceId, f64>>, Exit> {
        if fleet::greeting(fleet) == Greeting::Skip {
            console::error(
                "--approach requires `handshake: full`, but this fleet file contains `handshake: skip`; positions are read during the handshake",
            );
            return Err(Exit::Usage);
        }
        let asking = Work {
            metrics: MetricsArgs::default(),
            traces: TracesArgs::default(),
            verify_motion: false,
            at: None,
            approach: None,
            record: None,
            journal: false,
            preflight_only: true,
            place: Place::Asking,
            ..self.clone()
        };
        let played = asking.play(choreography, first_act, fleet, fleet_path).await;
        let report = played.map_err(|(message, exit)| {
            console::error(&message);
            exit
        })?;
        let is_position = |failure: &Failure| matches!(failure.kind, FailureKind::Position { .. });
        if !report.failures.iter().all(is_position) || report.outcome == Outcome::Stopped {
            return Err(finish(&report, self.format));
        }
        let rows: Vec<_> = report.preflight.into_iter().flat_map(|preflight| preflight.rows).collect();
        for row in &rows {
            let unknown = row.checks.iter().find(|(check, _)| *check == Check::Position);
            if let Some((_, Verdict::Warning(unknown))) = unknown {
                console::warn(&format!("{}: {unknown}", row.robot));
            }
        }
        Ok(rows.into_iter().map(|row| (row.robot, row.positions)).collect())
    }
}
