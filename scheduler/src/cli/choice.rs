//! The operator's choice of which part of a scenario to play, and at which speed, for example for a rehearsal.

use downbeat_scripts::{Approach, Choreography, Fleet, add_approach, did_you_mean};
use urrcp::RobotId;

use super::{Exit, console};
use crate::journal::OperatorChoices;

/// Options that change the choreography.
#[derive(Clone, Debug, Default, clap::Args)]
pub(super) struct ChoiceArgs {
    /// Play only this act.
    #[arg(long, value_name = "NAME", conflicts_with = "from")]
    act: Option<String>,
    /// Begin with this act and play all that follow.
    #[arg(long, value_name = "NAME")]
    from: Option<String>,
    /// Play only with these robots, for example arm-1,arm-2.
    #[arg(long, value_name = "ROBOTS", value_delimiter = ',')]
    only: Vec<RobotId>,
    /// Play slower or faster than written, for example 0.25. The limits of all devices are checked again.
    #[arg(long, value_name = "FACTOR", value_parser = speed)]
    speed: Option<f64>,
}

fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse::<f64>().ok().filter(|speed| (0.001..=100.0).contains(speed));
    speed.ok_or_else(|| "expected a factor from 0.001 to 100, such as 0.25".to_owned())
}

impl ChoiceArgs {
    pub(super) fn asked(&self) -> OperatorChoices {
        let (act, from, only) = (self.act.clone(), self.from.clone(), self.only.clone());
        OperatorChoices { act, from, only, speed: self.speed, approach: None }
    }
}

fn listed(names: &[String]) -> String {
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
}

/// Returns a question that suggests a similar name, to be appended to a sentence. Empty if no name is similar.
fn meant(name: &str, names: &[String]) -> String {
    let question = did_you_mean(name, names.iter().map(String::as_str));
    question.map(|question| format!("; {question}")).unwrap_or_default()
}

fn no_act(name: &str, choreography: &Choreography, asked: &OperatorChoices) -> String {
    no_such_act(if asked.act.is_some() { "--act" } else { "--from" }, name, choreography)
}

/// Returns the error message for an unknown act that was given to `option`.
pub(super) fn no_such_act(option: &str, name: &str, choreography: &Choreography) -> String {
    let acts: Vec<String> = choreography.acts.iter().map(|act| act.name.clone()).collect();
    let acts: Vec<String> = acts.into_iter().filter(|act| !act.is_empty()).collect();
    if acts.is_empty() {
        format!(
            "unknown act `{name}`: the scenario is not divided into acts; leave out {option} to play all of it"
        )
    } else {
        format!("unknown act `{name}`: the acts are {}{}", listed(&acts), meant(name, &acts))
    }
}

fn robots_of(choreography: &Choreography) -> Vec<String> {
    let robots = choreography.acts.iter().flat_map(|act| &act.plan.robots);
    let mut robots: Vec<String> = robots.map(|robot| robot.robot.to_string()).collect();
    robots.sort();
    robots.dedup();
    robots
}

fn not_playing(unknown: &[RobotId], playing: &[String], fleet: &Fleet) -> String {
    let names: Vec<String> = unknown.iter().map(ToString::to_string).collect();
    let group = names.iter().find_map(|name| Some((name, fleet.groups.get(name)?)));
    if let Some((name, members)) = group {
        let members: Vec<_> = members.iter().map(ToString::to_string).collect();
        return format!("--only expects robots, but `{name}` is a group; write --only {}", members.join(","));
    }
    let near = names.first().map(|name| meant(name, playing)).unwrap_or_default();
    format!("--only: the scenario does not move {}; it moves {}{near}", listed(&names), listed(playing))
}

/// Applies the operator's choice. Returns the choreography to play, and the index of its first act.
pub(super) fn choose(
    choreography: Choreography,
    fleet: &Fleet,
    asked: &OperatorChoices,
) -> Result<(Choreography, usize), Exit> {
    let mut chosen = choreography;
    let mut first = 0;
    if let Some(name) = asked.act.as_ref().or(asked.from.as_ref()) {
        let Some(index) = chosen.acts.iter().position(|act| act.is_named(name)) else {
            console::error(&no_act(name, &chosen, asked));
            return Err(Exit::Usage);
        };
        match asked.act {
            Some(_) => chosen = chosen.act_alone(index),
            None => first = index,
        }
    }
    if !asked.only.is_empty() {
        let playing = robots_of(&chosen);
        chosen = chosen.only(&asked.only).map_err(|unknown| {
            console::error(&not_playing(&unknown, &playing, fleet));
            Exit::Usage
        })?;
    }
    if let Some(speed) = asked.speed {
        chosen = chosen.at_speed(speed, fleet).map_err(|faults| {
            console::error(&format!("the show cannot be played at {speed} times its speed:"));
            faults.iter().for_each(|fault| console::note(&format!("  {fault}")));
            Exit::Failed
        })?;
    }
    match &asked.approach {
        Some(approach) => approached(chosen, first, fleet, approach),
        None => Ok((chosen, first)),
    }
}

/// Adds an act that moves devices to their first positions, if any has to move. Returns the choreography and the index of the act to
/// begin with.
pub(super) fn approached(
    chosen: Choreography,
    first: usize,
    fleet: &Fleet,
    approach: &Approach,
) -> Result<(Choreography, usize), Exit> {
    add_approach(chosen, first, fleet, approach).map_err(|findings| {
        console::error(&format!("the robots cannot reach their first positions in {}:", approach.over));
        for finding in findings {
            console::note(&format!("  {}; expected {}", finding.message, finding.expected));
        }
        Exit::Failed
    })
}
