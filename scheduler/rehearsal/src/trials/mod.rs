//! Plays many dry runs of one choreography, each with different circumstances drawn from one world. The results show how likely a
//! choreography is to start and to finish, the spread of starts, and the weakest robot and link. The same inputs and seed give the same
//! results for any number of threads.

mod figures;
mod results;
mod trial;

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;

use downbeat_robot::simulated::Settings;
use downbeat_scripts::{Choreography, ClockMode, Fleet, FleetRobot, World};
use urrcp::{RobotId, Span};

use crate::dry_run::{Audience, Circumstances, Logs, Played, Rehearsal, Stream, mixed};
use crate::world::between;
use downbeat_mission::{MissingParticipant, MissionOptions};
use downbeat_runtime::fleet::{self, NoInit};

pub use figures::{Quantiles, Share};
pub use results::{ActResult, LeadResult, Reason, Results, RobotResult};
pub use trial::{Started, Trial, Why};

/// The inputs of the trials: a choreography, a fleet, a world and a seed.
#[derive(Clone, Debug)]
pub struct Trials<'a> {
    choreography: &'a Choreography,
    fleet: &'a Fleet,
    robots: Vec<&'a FleetRobot>,
    world: &'a World,
    options: MissionOptions,
    seed: u64,
}

/// Why trials cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum NoTrials {
    /// A robot has no description, so it cannot be simulated.
    #[error(transparent)]
    NoInit(#[from] NoInit),
    /// A robot of the choreography is not in the fleet.
    #[error(transparent)]
    Missing(#[from] MissingParticipant),
}

impl<'a> Trials<'a> {
    /// Sets up trials of a choreography with the robots of a fleet. `world` must have been read for that fleet.
    #[must_use]
    pub fn new(
        choreography: &'a Choreography,
        fleet: &'a Fleet,
        world: &'a World,
        options: MissionOptions,
        seed: u64,
    ) -> Self {
        Self { choreography, fleet, robots: fleet::robots_in(fleet, choreography), world, options, seed }
    }

    /// Plays the trial with the given number, counted from 0, and reports to `audience`.
    ///
    /// # Errors
    /// [`NoTrials`]
    pub fn play_one(&self, trial: u32, logs: Logs, audience: &mut impl Audience) -> Result<Played, NoTrials> {
        let seed = mixed(self.seed ^ mixed(u64::from(trial)));
        let machines: Result<Vec<_>, NoInit> = self
            .robots
            .iter()
            .enumerate()
            .map(|(index, robot)| {
                fleet::rehearsed_with(robot, |settings| self.set_clock(settings, index, robot, seed))
            })
            .collect();
        let participants = fleet::participants(&self.robots);
        let rehearsal =
            Rehearsal::new(self.choreography.clone(), participants, self.options.clone(), machines?)?;
        let draw = |begin| Circumstances::draw(self.world, &self.fleet.robots, &self.robots, seed, begin);
        Ok(rehearsal.meets(draw).with_logs(logs).play_before(audience))
    }

    /// Plays `count` trials on `threads` threads. After each trial, the thread calls `told` with the number of finished trials. Once
    /// `told` returns `false`, no further trial starts.
    ///
    /// # Errors
    /// [`NoTrials`]
    pub fn play(
        &self,
        count: u32,
        threads: usize,
        told: impl Fn(u32) -> bool + Sync,
    ) -> Result<Results, NoTrials> {
        let (next, over, ended) = (AtomicU32::new(0), AtomicU32::new(0), AtomicBool::new(false));
        let work = || {
            let mut trials = Vec::new();
            while !ended.load(Ordering::Relaxed) {
                let trial = next.fetch_add(1, Ordering::Relaxed);
                if trial >= count {
                    break;
                }
                let mut witness = trial::Witness::new(&self.robots);
                match self.play_one(trial, Logs::Dropped, &mut witness) {
                    Ok(played) => trials.push(witness.says(trial, &played)),
                    Err(error) => {
                        ended.store(true, Ordering::Relaxed);
                        return Err(error);
                    }
                }
                if !told(over.fetch_add(1, Ordering::Relaxed) + 1) {
                    ended.store(true, Ordering::Relaxed);
                }
            }
            Ok(trials)
        };
        let played: Result<Vec<_>, NoTrials> = thread::scope(|scope| {
            let threads: Vec<_> = (1..threads.max(1)).map(|_| scope.spawn(work)).collect();
            let mine = work();
            let others = threads.into_iter().map(|thread| match thread.join() {
                Ok(trials) => trials,
                Err(panic) => std::panic::resume_unwind(panic),
            });
            std::iter::once(mine).chain(others).collect()
        });
        let mut trials: Vec<_> = played?.into_iter().flatten().collect();
        trials.sort_by_key(|(trial, _)| trial.trial);
        Ok(Results::of(self.choreography, self.world, self.ids(), self.seed, trials))
    }

    fn ids(&self) -> Vec<RobotId> {
        self.robots.iter().map(|robot| robot.id.clone()).collect()
    }

    /// Sets the seed, delay and clock of a simulated robot. The links of the world delay messages, so the robot itself must not. The
    /// clock is that of the fleet file, unless the world specifies another.
    fn set_clock(&self, settings: &mut Settings, index: usize, robot: &FleetRobot, seed: u64) {
        let mut rng = Stream::Robot(index).rng(seed);
        settings.seed = rng.u64(..);
        settings.delay = Some((Span::ZERO, Span::ZERO));
        let place = self.fleet.robots.iter().position(|known| known.id == robot.id);
        let Some(clock) = place.and_then(|place| self.world.clocks.get(place)?.as_ref()) else { return };
        if let Some(offset) = clock.offset {
            settings.clock_offset = between(&mut rng, offset);
        }
        if let Some(drift) = clock.drift_ppm {
            settings.drift_ppm = drift.least + rng.f64() * (drift.largest - drift.least);
        }
        match (clock.error, robot.mission.clock) {
            (Some(error), _) => settings.ntp_error = Some(error),
            // The robot shows a clock that NTP does not discipline.
            (None, ClockMode::Measured) => settings.ntp_error = None,
            (None, ClockMode::Ntp) => {}
        }
    }
}

#[cfg(test)]
mod tests;
