//! Checks files on a thread of its own, so that the server answers while the compiler runs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crossbeam_channel::{Receiver, Sender};
use downbeat_scripts::{
    Choreography, Code, Finding, Fleet, Folder, Outline, Project, Severity, Source, compile, init_of,
    outline, place_at_fleet, read_fleet_named, world_of,
};

use downbeat_yaml::node::parse;

use crate::file::Content;

/// A file to check, with all that its check depends on.
#[derive(Clone, Debug)]
pub(crate) struct Job {
    /// The canonical path of the file.
    pub(crate) path: PathBuf,
    pub(crate) content: Content,
    pub(crate) text: String,
    /// The path of the fleet file, for scenarios and worlds.
    pub(crate) fleet: PathBuf,
    /// The names of the acts that a world file may contain.
    pub(crate) acts: Vec<String>,
    /// The texts of opened files, by path.
    pub(crate) unsaved: Arc<BTreeMap<PathBuf, String>>,
    /// The versions of opened files, by path.
    pub(crate) versions: Arc<BTreeMap<PathBuf, i32>>,
}

/// The result of a check.
#[derive(Clone, Debug)]
pub(crate) struct Checked {
    pub(crate) path: PathBuf,
    pub(crate) findings: Vec<Finding>,
    /// The versions of the opened files that were checked.
    pub(crate) versions: Arc<BTreeMap<PathBuf, i32>>,
    /// The fleet, unless it has errors.
    pub(crate) fleet: Option<Fleet>,
    /// The compiled scenario, unless it has errors.
    pub(crate) choreography: Option<Choreography>,
}

/// The places of the cues of a compiled scenario, which take a second reading of it.
#[derive(Clone, Debug)]
pub(crate) struct Placed {
    pub(crate) path: PathBuf,
    pub(crate) outline: Outline,
}

/// A report of the thread that checks.
#[derive(Clone, Debug)]
pub(crate) enum Report {
    Checked(Box<Checked>),
    Placed(Placed),
    /// All jobs are done.
    Idle,
}

/// Runs jobs until the server drops its end of the channel.
pub(crate) fn work(jobs: &Receiver<Vec<Job>>, reports: &Sender<Report>) {
    for batch in jobs {
        for job in batch {
            let checked = check(&job);
            let placed = checked.choreography.is_some().then(|| checked.fleet.clone()).flatten();
            if reports.send(Report::Checked(Box::new(checked))).is_err() {
                return;
            }
            if let Some(fleet) = placed {
                let outline = outline(&job.source(), &fleet, &job.folder());
                let sent = reports.send(Report::Placed(Placed { path: job.path, outline }));
                if sent.is_err() {
                    return;
                }
            }
        }
        if reports.send(Report::Idle).is_err() {
            return;
        }
    }
}

impl Job {
    fn source(&self) -> Source {
        Source { name: self.path.display().to_string(), text: self.text.clone() }
    }

    fn project(&self) -> Project {
        Project::of(&self.path).with_unsaved(self.unsaved.clone())
    }

    fn folder(&self) -> Folder {
        Folder::within(self.path.parent().unwrap_or(Path::new("")).to_path_buf(), self.project())
    }
}

/// Finds the mistakes in a file.
pub(crate) fn check(job: &Job) -> Checked {
    let mut checked = Checked {
        path: job.path.clone(),
        findings: Vec::new(),
        versions: job.versions.clone(),
        fleet: None,
        choreography: None,
    };
    match job.content {
        Content::Scenario => check_scenario(job, &mut checked),
        Content::Fleet => {
            (checked.fleet, checked.findings) = read_fleet_named(&job.path, &job.project());
        }
        Content::World => {
            let Some(fleet) = read_fleet_named(&job.fleet, &job.project()).0 else { return checked };
            let acts: Vec<&str> = job.acts.iter().map(String::as_str).collect();
            checked.findings = world_of(&job.source(), &fleet, &acts).1;
        }
        Content::Robot => checked.findings = init_of(&job.source()).err().unwrap_or_default(),
        Content::Included | Content::Latency => checked.findings.extend(parse(&job.source()).err()),
        Content::Other => {}
    }
    checked
}

fn check_scenario(job: &Job, checked: &mut Checked) {
    let source = job.source();
    let (fleet, findings) = read_fleet_named(&job.fleet, &job.project());
    let file = job.fleet.display().to_string();
    let is_about_file =
        |finding: &Finding| finding.is_about_access() && finding.line == 0 && finding.file == file;
    let place = |finding: Finding| {
        if is_about_file(&finding) { placed_in(&source, finding) } else { finding }
    };
    checked.findings = findings.into_iter().map(place).collect();
    let Some(fleet) = fleet else { return };
    let compiled = compile(&source, &fleet, &job.folder());
    checked.findings.extend(compiled.findings);
    checked.choreography = compiled.choreography;
    checked.fleet = Some(fleet);
}

/// Moves a finding about the whole fleet file to the scenario: to its key `fleet`, or else to its beginning.
fn placed_in(source: &Source, finding: Finding) -> Finding {
    let about = format!("{}: {}", finding.file, finding.message);
    let placed = place_at_fleet(source, Finding { message: about, ..finding });
    Finding { file: source.name.clone(), line: placed.line.max(1), column: placed.column.max(1), ..placed }
}

impl Checked {
    /// Whether the check found an error with this code on this line of a file.
    pub(crate) fn has(&self, other: &Finding) -> bool {
        self.findings.iter().any(|finding| {
            (finding.code, &finding.file, finding.line) == (other.code, &other.file, other.line)
                && finding.message == other.message
        })
    }

    pub(crate) fn errors(&self) -> usize {
        self.findings.iter().filter(|finding| finding.severity == Severity::Error).count()
    }

    /// Whether the text is valid YAML, as far as the check knows.
    pub(crate) fn is_readable(&self) -> bool {
        self.findings.iter().all(|finding| finding.code != Code::Syntax)
    }
}
