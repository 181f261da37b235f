//! The scenario of a past mission. It provides the cues, lines and bodies, which recordings lack.

use std::collections::HashSet;

use downbeat_mission::Promise;
use downbeat_scripts::{Act, Approach, Choreography, Finding, Fleet, Outline};
use urrcp::{Command, ContentHash, DeviceId, RobotId};

use super::columns::Columns;
use super::document::Plan;
use super::planned::{self, Places};
use crate::history::History;

/// A compiled scenario and its files.
#[derive(Clone, Copy, Debug)]
pub struct Written<'a> {
    /// The compiled choreography.
    pub choreography: &'a Choreography,
    /// The source locations of the choreography.
    pub outline: &'a Outline,
    /// The robots of the choreography and their bodies.
    pub fleet: &'a Fleet,
    /// The findings in the files of the choreography.
    pub findings: &'a [Finding],
}

/// The error that the given scenario is not the one that was played.
#[derive(Debug, thiserror::Error)]
#[error(
    "the scenario is not the one that was played: the script of `{robot}/{device}` differs in every act; the scenario may have changed since, or \
     was played at a different speed"
)]
pub struct OtherScenario {
    robot: RobotId,
    device: DeviceId,
}

impl Written<'_> {
    /// Checks by content hash that every promised script belongs to this scenario. The approach act is exempt, because no scenario
    /// contains it.
    ///
    /// # Errors
    /// [`OtherScenario`] names the first script of an act that does not belong to this scenario.
    pub fn check(&self, history: &History) -> Result<(), OtherScenario> {
        let approached = |promise: &Promise| Approach::may_be_named(&history.name_of(promise));
        let mut promises = history.promises().map(|(_, promise)| promise);
        let Some(foreign) = promises.find(|promise| self.act(promise).is_none() && !approached(promise))
        else {
            return Ok(());
        };
        let own: HashSet<_> = self.choreography.acts.iter().flat_map(scripts).collect();
        let all = promised(foreign);
        let other = all.iter().find(|script| !own.contains(*script)).or(all.first());
        other.map_or(Ok(()), |(robot, device, _)| {
            Err(OtherScenario { robot: robot.clone(), device: device.clone() })
        })
    }

    /// Returns the act of this scenario that has all promised scripts; `None` if no act has them.
    fn act(&self, promise: &Promise) -> Option<&Act> {
        let promised = promised(promise);
        self.choreography.acts.iter().find(|act| {
            let own: HashSet<_> = scripts(act).collect();
            promised.iter().all(|script| own.contains(script))
        })
    }

    pub(super) fn plan(&self, promise: &Promise, places: &Places, columns: &mut Columns) -> Option<Plan> {
        self.act(promise).map(|act| planned::plan_of(act, self.outline, places, columns))
    }
}

/// A script, identified by its robot, its device and its content hash.
type Script = (RobotId, DeviceId, ContentHash);

fn scripts(act: &Act) -> impl Iterator<Item = Script> + '_ {
    act.plan.robots.iter().flat_map(|robot| {
        robot.scripts.iter().map(|script| {
            let hash = Command::Script(script.script.clone()).content_hash();
            (robot.robot.clone(), script.device.clone(), hash)
        })
    })
}

fn promised(promise: &Promise) -> Vec<Script> {
    let scripts = promise.scripts.iter();
    scripts.map(|script| (script.robot.clone(), script.device.clone(), script.content_hash)).collect()
}
