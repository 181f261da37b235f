//! The state of the server: the files, and the latest results of checks.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

use downbeat_reader::keys::{Item, Naming};
use downbeat_scripts::{Choreography, Finding, Fleet};
use lsp_types::{Diagnostic, PublishDiagnosticsParams};

use crate::address::uri_of;
use crate::check::{Checked, Job, Placed, Report};
use crate::diagnostics::{self, by_file};
use crate::file::{Content, File};
use crate::fixes::{Fix, fix};
use crate::hover::Compiled;
use crate::workspace::{Workspace, fleet_of, nearest_fleet};

/// Everything that the server knows.
#[derive(Debug, Default)]
pub(crate) struct State {
    pub(crate) workspace: Workspace,
    /// The latest results, by the file that was checked.
    results: BTreeMap<PathBuf, Latest>,
    /// The files with diagnostics in the editor.
    published: BTreeSet<PathBuf>,
    /// The files to check next.
    stale: BTreeSet<PathBuf>,
    is_checking: bool,
}

/// The latest results of checking a file.
#[derive(Debug, Default)]
struct Latest {
    findings: Vec<Finding>,
    /// The job and its result, for fixes.
    checked: Option<Box<Checked>>,
    job: Option<Job>,
    /// The last fleet and the last choreography without errors.
    fleet: Option<Rc<Fleet>>,
    choreography: Option<Rc<Choreography>>,
    compiled: Option<Compiled>,
}

/// A finding in a file with a fix.
pub(crate) struct Fixed {
    pub(crate) finding: Finding,
    pub(crate) fix: Fix,
}

impl State {
    /// Marks the files to check after a file has changed: all that depend on it. Returns the diagnostics of a file that is not checked.
    pub(crate) fn changed(&mut self, path: &Path) -> Vec<PublishDiagnosticsParams> {
        let targets: Vec<Rc<File>> = self.targets();
        self.results.retain(|path, _| targets.iter().any(|target| target.path == *path));
        for target in targets {
            let depends = target.path == path || self.depends(&target, path);
            if depends {
                self.stale.insert(target.path.clone());
            }
        }
        if self.stale.is_empty() { self.publish() } else { Vec::new() }
    }

    fn depends(&self, target: &Rc<File>, path: &Path) -> bool {
        let changed = self.workspace.file(path).map(|file| file.content);
        let by_content =
            matches!((target.content, changed), (Content::World, Some(Content::Fleet | Content::Scenario)));
        // A file with data that a scenario names is no member of its show.
        let is_known = changed.is_some_and(|content| content != Content::Other);
        by_content
            || !is_known
            || self.workspace.members(target).iter().any(|member| member.file.path == path)
    }

    /// Returns the files that are checked: those in the editor, and the scenarios to which these belong.
    fn targets(&self) -> Vec<Rc<File>> {
        let mut targets: Vec<Rc<File>> = Vec::new();
        for file in self.workspace.opened() {
            let of_file = match file.content {
                // Files that shows share are checked as parts of these shows.
                Content::Included | Content::Latency => self.workspace.roots_of(file),
                Content::Other => Vec::new(),
                // A file of another program may also have devices.
                Content::Robot if file.root_value("id").is_none() => Vec::new(),
                _ => vec![file.clone()],
            };
            for target in of_file {
                if !targets.iter().any(|known| known.path == target.path) {
                    targets.push(target);
                }
            }
        }
        targets
    }

    /// Forgets the results for files that are no longer in the editor.
    pub(crate) fn closed(&mut self, path: &Path) -> Vec<PublishDiagnosticsParams> {
        self.workspace.close(path);
        self.changed(path);
        self.publish()
    }

    /// Returns the next jobs, unless jobs are running or none is needed.
    pub(crate) fn next_jobs(&mut self) -> Option<Vec<Job>> {
        if self.is_checking || self.stale.is_empty() {
            return None;
        }
        let unsaved = Arc::new(self.workspace.unsaved());
        let versions = unsaved.keys().filter_map(|path| Some((path.clone(), self.workspace.version(path)?)));
        let versions = Arc::new(versions.collect());
        let paths = std::mem::take(&mut self.stale);
        let jobs: Vec<Job> = paths.iter().filter_map(|path| self.job(path, &unsaved, &versions)).collect();
        for job in &jobs {
            self.results.entry(job.path.clone()).or_default().job = Some(job.clone());
        }
        self.is_checking = !jobs.is_empty();
        self.is_checking.then_some(jobs)
    }

    fn job(
        &self,
        path: &Path,
        unsaved: &Arc<BTreeMap<PathBuf, String>>,
        versions: &Arc<BTreeMap<PathBuf, i32>>,
    ) -> Option<Job> {
        let file = self.workspace.file(path)?;
        let fleet = if file.content == Content::Scenario { fleet_of(&file) } else { nearest_fleet(path) };
        let is_world = file.content == Content::World;
        let acts = if is_world { self.acts(path) } else { Vec::new() };
        Some(Job {
            path: file.path.clone(),
            content: file.content,
            text: file.text.as_str().to_owned(),
            fleet: fleet.canonicalize().unwrap_or(fleet),
            acts,
            unsaved: unsaved.clone(),
            versions: versions.clone(),
        })
    }

    /// Returns the names of the acts of all scenarios in the project of a world file. A scenario without acts is an act of its own name.
    fn acts(&self, path: &Path) -> Vec<String> {
        let files = self.workspace.project_files(path);
        let names = files.iter().flat_map(|file| &file.typed.mentions);
        let acts =
            names.filter(|name| name.naming == Naming::Defines(Item::Act)).map(|name| name.name.as_str());
        let whole = files.iter().filter_map(|file| file.root_value("scenario"));
        acts.chain(whole).map(str::to_owned).collect()
    }

    /// Takes a report of the checks. Returns the diagnostics to publish.
    pub(crate) fn take(&mut self, report: Report) -> Vec<PublishDiagnosticsParams> {
        match report {
            Report::Checked(mut checked) => {
                let latest = self.results.entry(checked.path.clone()).or_default();
                latest.findings = std::mem::take(&mut checked.findings);
                let choreography = checked.choreography.take();
                latest.choreography = choreography.map(Rc::new);
                latest.fleet = checked.fleet.take().map(Rc::new).or(latest.fleet.take());
                checked.findings.clone_from(&latest.findings);
                latest.checked = Some(checked);
                self.publish()
            }
            Report::Placed(placed) => {
                self.place(placed);
                Vec::new()
            }
            Report::Idle => {
                self.is_checking = false;
                Vec::new()
            }
        }
    }

    fn place(&mut self, placed: Placed) {
        let Some(latest) = self.results.get_mut(&placed.path) else { return };
        if let Some(choreography) = latest.choreography.clone() {
            latest.compiled = Some(Compiled { choreography, placed: Rc::new(placed) });
        }
    }

    /// Returns the diagnostics of all files with findings, and of those that no longer have any.
    fn publish(&mut self) -> Vec<PublishDiagnosticsParams> {
        let mut all: BTreeMap<PathBuf, Vec<Diagnostic>> = BTreeMap::new();
        for latest in self.results.values() {
            for (path, diagnostics) in by_file(&latest.findings, &self.workspace) {
                let of_file = all.entry(path).or_default();
                // A fleet has the same findings in each scenario that uses it.
                let is_new = |diagnostic: &Diagnostic| !of_file.contains(diagnostic);
                let new: Vec<_> = diagnostics.into_iter().filter(is_new).collect();
                of_file.extend(new);
            }
        }
        let now: BTreeSet<PathBuf> = all.keys().cloned().collect();
        let opened = self.workspace.opened().map(|file| file.path.clone());
        let cleared: Vec<PathBuf> = self.published.difference(&now).cloned().chain(opened).collect();
        for path in cleared {
            all.entry(path).or_default();
        }
        self.published = now;
        let params = all.into_iter().filter_map(|(path, diagnostics)| {
            let version = self.version(&path);
            Some(PublishDiagnosticsParams { uri: uri_of(&path)?, diagnostics, version })
        });
        params.collect()
    }

    /// Returns the version of the text of a file to which its diagnostics belong; `None` if the file is not open.
    fn version(&self, path: &Path) -> Option<i32> {
        let current = self.workspace.version(path)?;
        let depends = |target: &Path| {
            target == path || self.workspace.file(target).is_some_and(|target| self.depends(&target, path))
        };
        let of_path = self.results.iter().filter(|(target, _)| depends(target));
        let checked = of_path.filter_map(|(_, latest)| latest.checked.as_ref()?.versions.get(path).copied());
        Some(checked.min().unwrap_or(current))
    }

    /// Returns the latest compiled scenario that a file belongs to.
    pub(crate) fn compiled(&self, file: &File) -> Option<&Compiled> {
        let own = self.results.get(&file.path).and_then(|latest| latest.compiled.as_ref());
        let others = self.results.values().filter_map(|latest| latest.compiled.as_ref());
        own.or_else(|| others.into_iter().find(|compiled| compiled.cues_in(&file.path).next().is_some()))
    }

    /// Returns the latest fleet of a file.
    pub(crate) fn fleet(&self, file: &File) -> Option<Rc<Fleet>> {
        let own = self.results.get(&file.path).and_then(|latest| latest.fleet.clone());
        own.or_else(|| self.results.values().find_map(|latest| latest.fleet.clone()))
    }

    /// Returns the findings in a range of a file that have a fix.
    pub(crate) fn fixes(&self, file: &Rc<File>, range: lsp_types::Range) -> Vec<Fixed> {
        let mut fixes: Vec<Fixed> = Vec::new();
        for latest in self.results.values() {
            let (Some(job), Some(checked)) = (&latest.job, &latest.checked) else { continue };
            // The places of findings in an older text are unknown.
            if checked.versions.get(&file.path).copied() != self.workspace.version(&file.path) {
                continue;
            }
            for finding in latest.findings.iter().filter(|finding| diagnostics::path_of(finding) == file.path)
            {
                let at = diagnostics::range_of(finding, &file.text);
                let is_here = at.start <= range.end && range.start <= at.end;
                let is_known = fixes.iter().any(|known| known.finding == *finding);
                if is_here
                    && !is_known
                    && let Some(fix) = fix(finding, file, job, checked)
                {
                    fixes.push(Fixed { finding: finding.clone(), fix });
                }
            }
        }
        fixes
    }
}
