//! The scenario of a mission that was played, where it is given: it has the cues, lines and bodies, which no recording has.

use std::collections::HashSet;

use downbeat_scripts::{Act, Approach, Choreography, Finding, Fleet, Outline};
use serde_json::Value;
use urrcp::Command;

use super::columns::Columns;
use super::document::Plan;
use super::planned::{self, Places};
use super::played::instant;
use crate::history::History;

/// A scenario as it compiles, next to its files.
#[derive(Clone, Copy, Debug)]
pub struct Written<'a> {
    /// What it compiles to.
    pub choreography: &'a Choreography,
    /// Where it is written.
    pub outline: &'a Outline,
    /// Its robots, and their bodies.
    pub fleet: &'a Fleet,
    /// What was found in its files.
    pub findings: &'a [Finding],
}

/// The scenario is not what was played.
#[derive(Debug, thiserror::Error)]
#[error(
    "the scenario is not what was played: the script of `{robot}/{device}` differs in every act; it may have changed since, or was \
     played at another speed"
)]
pub struct OtherScenario {
    robot: String,
    device: String,
}

impl Written<'_> {
    /// Whether every script that was promised is one of this scenario's, by the hash of its content. The act by which the mission
    /// approached is in no scenario.
    ///
    /// # Errors
    /// [`OtherScenario`] names the first script of an act that is not.
    pub fn check(&self, history: &History) -> Result<(), OtherScenario> {
        let approached = |record: &Value| {
            let number = record["number"].as_u64().and_then(|number| u32::try_from(number).ok());
            let named = number.zip(instant(&record["timestamp"]));
            named.is_some_and(|(number, at)| Approach::may_be_named(&history.name_of(number, at)))
        };
        let mut prepared = history.of_kind("prepared");
        let foreign = prepared.find(|(_, record)| self.act(record).is_none() && !approached(record));
        let Some((_, record)) = foreign else { return Ok(()) };
        let own: HashSet<_> = self.choreography.acts.iter().flat_map(scripts).collect();
        let all = promised(record);
        let other = all.iter().find(|script| !own.contains(*script)).or(all.first());
        let (robot, device, _) = other.cloned().unwrap_or_default();
        Err(OtherScenario { robot, device })
    }

    /// The act whose scripts were promised.
    fn act(&self, record: &Value) -> Option<&Act> {
        let promised = promised(record);
        self.choreography.acts.iter().find(|act| {
            let own: HashSet<_> = scripts(act).collect();
            promised.iter().all(|script| own.contains(script))
        })
    }

    pub(super) fn plan(&self, record: &Value, places: &Places, columns: &mut Columns) -> Option<Plan> {
        self.act(record).map(|act| planned::plan_of(act, self.outline, places, columns))
    }
}

/// Robot, device and the hash of its content.
type Script = (String, String, String);

fn scripts(act: &Act) -> impl Iterator<Item = Script> + '_ {
    act.plan.robots.iter().flat_map(|robot| {
        robot.scripts.iter().map(|script| {
            let hash = Command::Script(script.script.clone()).content_hash();
            (robot.robot.to_string(), script.device.to_string(), hash.to_string())
        })
    })
}

fn promised(record: &Value) -> Vec<Script> {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let scripts = record["scripts"].as_array().into_iter().flatten();
    scripts
        .map(|script| (text(&script["robot"]), text(&script["device"]), text(&script["content_hash"])))
        .collect()
}
