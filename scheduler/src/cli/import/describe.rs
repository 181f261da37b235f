//! `downbeat import urdf`: converts a robot's description into its initialization block.

use downbeat_import::{UrdfOutcome, urdf};
use downbeat_scripts::{Source, counted};
use serde::Serialize;

use super::super::{Exit, Format, console};
use super::{CommonOutput, ImportArgs, exit_of, write};

#[derive(Serialize)]
struct Done<'a> {
    devices: usize,
    #[serde(flatten)]
    told: CommonOutput<'a>,
}

pub(super) fn describe(args: &ImportArgs, format: Format) -> Exit {
    let [file] = args.files.as_slice() else {
        console::error("the format urdf takes one file at a time");
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
    let UrdfOutcome { devices, notes, findings, .. } = &outcome;
    let told = CommonOutput { notes, findings, files: &written, text };
    match format {
        Format::Json => console::print_json(&Done { devices: *devices, told }),
        Format::Text => show(*devices, &told),
    }
    exit_of(&outcome.findings)
}

fn show(devices: usize, told: &CommonOutput<'_>) {
    told.show();
    if told.text.is_some() {
        console::note("note: the speed limits belong in the fleet file, which --output DIR also writes");
    }
    if told.findings.is_empty() {
        console::note(&counted(devices, "device"));
    }
}
