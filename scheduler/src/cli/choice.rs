//! What of a scenario is played, and how fast: a rehearsal is a choreography with something left out or slowed down.

use downbeat_scripts::{Choreography, Fleet};
use urrcp::RobotId;

use super::{Exit, console};
use crate::journal::Asked;

/// Options that change what is played.
#[derive(Clone, Debug, Default, clap::Args)]
pub(super) struct ChoiceArgs {
    /// Play this act alone.
    #[arg(long, value_name = "NAME", conflicts_with = "from")]
    act: Option<String>,
    /// Begin with this act.
    #[arg(long, value_name = "NAME")]
    from: Option<String>,
    /// Play with these robots alone, as arm-1,arm-2.
    #[arg(long, value_name = "ROBOTS", value_delimiter = ',')]
    only: Vec<RobotId>,
    /// Play slower or faster than written, as 0.25; limits are checked again.
    #[arg(long, value_name = "FACTOR", value_parser = speed)]
    speed: Option<f64>,
}

fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse::<f64>().ok().filter(|speed| (0.001..=100.0).contains(speed));
    speed.ok_or_else(|| format!("`{text}`, expected a factor from 0.001 to 100, such as 0.25"))
}

impl ChoiceArgs {
    pub(super) fn asked(&self) -> Asked {
        Asked { act: self.act.clone(), from: self.from.clone(), only: self.only.clone(), speed: self.speed }
    }
}

/// What is left to play, and with which act it begins.
pub(super) fn choose(
    choreography: Choreography,
    fleet: &Fleet,
    asked: &Asked,
) -> Result<(Choreography, usize), Exit> {
    let mut chosen = choreography;
    let mut first = 0;
    if let Some(name) = asked.act.as_ref().or(asked.from.as_ref()) {
        let Some(index) = chosen.acts.iter().position(|act| act.is_named(name)) else {
            let named = chosen.acts.iter().filter(|act| !act.name.is_empty());
            let known: Vec<_> = named.map(|act| format!("`{}`", act.name)).collect();
            let known = if known.is_empty() { "no acts of its own".to_owned() } else { known.join(", ") };
            console::error(&format!("no act `{name}`, the scenario has {known}"));
            return Err(Exit::Usage);
        };
        match asked.act {
            Some(_) => chosen = chosen.act_alone(index),
            None => first = index,
        }
    }
    if !asked.only.is_empty() {
        chosen = chosen.only(&asked.only).map_err(|unknown| {
            let names: Vec<_> = unknown.iter().map(|name| format!("`{name}`")).collect();
            console::error(&format!("--only: nothing moves {}", names.join(", ")));
            Exit::Usage
        })?;
    }
    if let Some(speed) = asked.speed {
        chosen = chosen.at_speed(speed, fleet).map_err(|faults| {
            console::error(&format!("at {speed} times the speed this will not work:"));
            faults.iter().for_each(|fault| console::note(&format!("  {fault}")));
            Exit::Failed
        })?;
    }
    Ok((chosen, first))
}
