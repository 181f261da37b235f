//! `downbeat import urdf`: a robot's description becomes its initialization block.

use downbeat_scripts::import::{UrdfOutcome, urdf};
use downbeat_scripts::{Finding, Source, counted};
use serde::Serialize;

use super::super::load::show_findings;
use super::super::{Exit, Format, console};
use super::{ImportArgs, exit_of, write};

#[derive(Serialize)]
struct Done<'a> {
    devices: usize,
    notes: &'a [String],
    findings: &'a [Finding],
    files: &'a [String],
    /// The block itself, where it is written to no file.
    #[serde(skip_serializing_if = "Option::is_none")]
    text: Option<&'a str>,
}

pub(super) fn describe(args: &ImportArgs, format: Format) -> Exit {
    let [file] = args.files.as_slice() else {
        console::error("urdf takes one file at a time");
        return Exit::Usage;
    };
    let mut outcome = match Source::read(file) {
        Ok(source) => urdf(&source, args.kind.as_deref()),
        Err(finding) => UrdfOutcome { findings: vec![finding], ..UrdfOutcome::default() },
    };
    let mut written = Vec::new();
    if let (Some(folder), true) = (&args.output, outcome.findings.is_empty()) {
        match write::write_all(folder, &outcome.files, args.force) {
            Ok(files) => written = files,
            Err(mut findings) => outcome.findings.append(&mut findings),
        }
    }
    let block = outcome.files.first().map(|file| file.text.as_str());
    let text = block.filter(|_| args.output.is_none() && outcome.findings.is_empty());
    match format {
        Format::Json => {
            let UrdfOutcome { devices, notes, findings, .. } = &outcome;
            console::print_json(&Done { devices: *devices, notes, findings, files: &written, text });
        }
        Format::Text => show(&outcome, &written, text),
    }
    exit_of(&outcome.findings)
}

fn show(outcome: &UrdfOutcome, written: &[String], text: Option<&str>) {
    for note in &outcome.notes {
        console::note(&format!("note: {note}"));
    }
    show_findings(&outcome.findings);
    if let Some(text) = text {
        console::print(text);
        console::note("note: the limits of speeds stand in the fleet file: --output DIR writes it too");
    }
    for file in written {
        console::note(&format!("wrote {file}"));
    }
    if outcome.findings.is_empty() {
        console::note(&counted(outcome.devices, "device"));
    }
}
