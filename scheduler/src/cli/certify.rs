//! `dry-run --certify` writes a certificate. With `--require-certificate`, `run` and `preflight` accept only the certified plan.

use std::path::{Path, PathBuf};

use downbeat_scripts::shown::shown;
use downbeat_scripts::{Attempt, Choreography, Fleet, Refusal, counted};
use indicatif::{ProgressBar, ProgressDrawTarget};
use serde_json::json;

use super::{Exit, Format, console, load};
use crate::certificate::{self, Certificate, Subject, Trial};
use crate::journal::OperatorChoices;

/// The plan to be certified, with its fleet.
pub(super) struct Plan<'a> {
    pub(super) choreography: &'a Choreography,
    pub(super) fleet: &'a Fleet,
    pub(super) asked: &'a OperatorChoices,
    /// The index of the first act to play.
    pub(super) first_act: usize,
}

/// Plays the plan with every simulated fault. Writes the certificate if all promises were kept.
pub(super) fn certify(plan: &Plan<'_>, seed: u64, path: &Path, sources: &[&Path], format: Format) -> Exit {
    if let Some(error) = load::replaces(path, sources) {
        console::error(&error.replace("the page", "the certificate"));
        return Exit::Usage;
    }
    let trials = match played(plan, seed, format) {
        Ok(trials) => trials,
        Err(error) => {
            console::error(&error);
            return Exit::Failed;
        }
    };
    let held = trials.iter().all(|trial| trial.broken.is_empty());
    let subject = Subject::of(plan.choreography, plan.fleet, plan.asked);
    if held {
        let text = Certificate::new(seed, subject.clone(), trials.clone()).text();
        if let Err(error) = crate::page::save(path, &text) {
            let refusal = Refusal::of(Attempt::Write(path), &error);
            console::error(&format!("cannot write `{}`: {refusal}", path.display()));
            return Exit::Usage;
        }
    }
    match format {
        Format::Text => console::print(&text(plan, &subject, &trials, held.then_some(path))),
        Format::Json => console::print_json(&json!({
            "scenario": subject.scenario,
            "certified": held,
            "plan_hash": subject.plan_hash,
            "fleet_hash": subject.fleet_hash,
            "trials": trials,
        })),
    }
    if held { Exit::Done } else { Exit::Failed }
}

fn played(plan: &Plan<'_>, seed: u64, format: Format) -> Result<Vec<Trial>, String> {
    let faults = certificate::faults(plan.choreography);
    let target = match format {
        Format::Text => ProgressDrawTarget::stderr(),
        Format::Json => ProgressDrawTarget::hidden(),
    };
    let bar = ProgressBar::with_draw_target(Some(faults.len() as u64), target);
    let trials = faults
        .iter()
        .map(|fault| {
            bar.inc(1);
            certificate::play(plan.choreography, plan.fleet, plan.first_act, seed, fault)
        })
        .collect();
    bar.finish_and_clear();
    trials
}

fn text(plan: &Plan<'_>, subject: &Subject, trials: &[Trial], written: Option<&Path>) -> String {
    let name = shown(&plan.choreography.scenario);
    let mut text = format!("{name}: played against {}\n", counted(trials.len() - 1, "fault"));
    for trial in trials.iter().filter(|trial| !trial.broken.is_empty()) {
        for broken in &trial.broken {
            text.push_str(&format!("  {}: {}\n", shown(&trial.injected.text()), shown(broken)));
        }
    }
    match written {
        Some(path) => {
            text.push_str("  without a fault, the mission was completed; with each fault, every act started on all of its robots or on none, and all robots came to rest\n");
            text.push_str(&format!(
                "certified plan {} for fleet {}: `{}`\n",
                short(subject.plan_hash),
                short(subject.fleet_hash),
                path.display()
            ));
        }
        None => text.push_str("no certificate was written, because a guarantee did not hold\n"),
    }
    text
}

/// Returns the first 12 characters of a hash, for people.
fn short(hash: urrcp::ContentHash) -> String {
    hash.to_string().chars().take(12).collect()
}

/// Restrictions on the plan.
#[derive(Clone, Debug, Default, clap::Args)]
pub(super) struct CertifiedArgs {
    /// Refuse to play anything but the plan and the fleet of this certificate, which `dry-run --certify` writes.
    #[arg(long, value_name = "FILE")]
    require_certificate: Option<PathBuf>,
}

impl CertifiedArgs {
    /// Checks whether the required certificate permits this plan, and prints the reason if not.
    pub(super) fn check(
        &self,
        choreography: &Choreography,
        fleet: &Fleet,
        asked: &OperatorChoices,
        format: Format,
    ) -> Result<(), Exit> {
        let Some(path) = &self.require_certificate else { return Ok(()) };
        let certificate = Certificate::read(path).map_err(|error| {
            console::error(&error.to_string());
            Exit::Usage
        })?;
        let differences = certificate::differences(&certificate, &Subject::of(choreography, fleet, asked));
        if differences.is_empty() {
            return Ok(());
        }
        let error =
            format!("`{}` does not certify this plan and this fleet, so nothing was sent", path.display());
        match format {
            Format::Json => {
                console::print_json(&json!({ "error": error, "differences": differences }));
            }
            Format::Text => {
                console::error(&format!("{error}:"));
                differences.iter().for_each(|difference| console::note(&format!("  {difference}")));
                console::note(
                    "  to certify the current plan and fleet, run `downbeat dry-run --certify` with the same options",
                );
            }
        }
        Err(Exit::Failed)
    }
}
