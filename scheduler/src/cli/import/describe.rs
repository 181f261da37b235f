//! `downbeat import urdf` and `import fixture`: convert a robot's description into its initialization block.

use downbeat_import::{DescriptionOutcome, fixture, urdf};
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

/// A format that describes robots.
#[derive(Clone, Copy, Debug)]
pub(super) enum Described {
    Urdf,
    Fixture,
}

impl Described {
    /// All formats that describe robots, in the order in which the help lists them.
    pub(super) const ALL: [Self; 2] = [Self::Urdf, Self::Fixture];

    /// Returns the name of the format on the command line.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Urdf => "urdf",
            Self::Fixture => "fixture",
        }
    }

    /// Returns a short description of the files.
    pub(super) const fn about(self) -> &'static str {
        match self {
            Self::Urdf => "a robot description",
            Self::Fixture => "a light of the Open Fixture Library",
        }
    }
}

pub(super) fn describe(from: Described, args: &ImportArgs, format: Format) -> Exit {
    let [file] = args.files.as_slice() else {
        console::error(&format!("the format {} takes one file at a time", from.word()));
        return Exit::Usage;
    };
    let mut outcome = match (Source::read(file), from) {
        (Ok(source), Described::Urdf) => urdf(&source, args.kind.as_deref()),
        (Ok(source), Described::Fixture) => fixture(&source, args.mode.as_deref(), args.kind.as_deref()),
        (Err(finding), _) => DescriptionOutcome { findings: vec![finding], ..DescriptionOutcome::default() },
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
    let DescriptionOutcome { devices, notes, findings, .. } = &outcome;
    let told = CommonOutput { notes, findings, files: &written, text };
    match format {
        Format::Json => console::print_json(&Done { devices: *devices, told }),
        Format::Text => show(from, *devices, &told),
    }
    exit_of(&outcome.findings)
}

fn show(from: Described, devices: usize, told: &CommonOutput<'_>) {
    told.show();
    if told.text.is_some() {
        console::note(match from {
            Described::Urdf => {
                "note: the speed limits belong in the fleet file, which --output DIR also writes"
            }
            Described::Fixture => {
                "note: the address belongs in the fleet file, which --output DIR also writes"
            }
        });
    }
    if told.findings.is_empty() {
        console::note(&counted(devices, "device"));
    }
}
