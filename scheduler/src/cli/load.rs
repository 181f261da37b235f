//! Reads a scenario with its fleet, for all commands that need them.

use std::path::{Path, PathBuf};

use downbeat_scripts::{
    Choreography, Code, Finding, Fleet, Folder, Outline, Project, Severity, Source, place_at_fleet,
};

use super::{Exit, Format, ProjectArgs, ScenarioArgs, console};

/// The result of reading a scenario, with or without errors.
pub(super) struct Loaded {
    pub(super) scenario: String,
    pub(super) fleet: Option<Fleet>,
    pub(super) fleet_path: PathBuf,
    pub(super) choreography: Option<Choreography>,
    pub(super) findings: Vec<Finding>,
    /// Whether a file could not be read at all.
    pub(super) unreadable: bool,
}

/// Reads and compiles a scenario. Collects the findings from all files.
pub(super) fn load(args: &ScenarioArgs) -> Loaded {
    let mut loaded = Loaded {
        scenario: args.scenario.display().to_string(),
        fleet: None,
        fleet_path: PathBuf::new(),
        choreography: None,
        findings: Vec::new(),
        unreadable: false,
    };
    let source = match Source::read(&args.scenario) {
        Ok(source) => source,
        Err(mut finding) => {
            finding.hint.get_or_insert_with(|| {
                "check the path; `downbeat init first-show` creates an example scenario".to_owned()
            });
            loaded.unreadable = true;
            loaded.findings.push(finding);
            return loaded;
        }
    };
    let (fleet_path, (fleet, mut findings)) = read_fleet(args, &source);
    say_how_to_name_it(&mut findings, "or name one with `--fleet FILE`");
    loaded.findings.extend(findings);
    if let Some(fleet) = &fleet {
        let compiled = downbeat_scripts::compile(&source, fleet, &folder(args));
        loaded.findings.extend(compiled.findings);
        loaded.choreography = compiled.choreography;
    }
    loaded.unreadable = loaded.findings.iter().any(Finding::is_about_access);
    loaded.fleet = fleet;
    loaded.fleet_path = fleet_path;
    loaded
}

/// Returns the outline of a scenario: where its cues are in the source. Empty if the file cannot be read.
pub(super) fn outline(args: &ScenarioArgs, fleet: &Fleet) -> Outline {
    let Ok(source) = Source::read(&args.scenario) else { return Outline::default() };
    downbeat_scripts::outline(&source, fleet, &folder(args))
}

/// Returns the reason why an output, such as a page, cannot be written to the path `page`: it would replace one of the `sources`, or it
/// is not a file. Returns `None` if it can be written.
pub(super) fn replaces(page: &Path, sources: &[&Path]) -> Option<String> {
    let whole = |path: &Path| path.canonicalize().ok();
    if page == Path::new("-") {
        return Some("`-` is not a file; expected a name such as show.html".to_owned());
    }
    let replaced = sources.iter().find(|source| whole(page).is_some() && whole(page) == whole(source))?;
    Some(format!("the output would overwrite its own source `{}`; choose another name", replaced.display()))
}

/// Returns the folder to which the paths of the scenario's includes are relative.
fn folder(args: &ScenarioArgs) -> Folder {
    Folder::within(folder_of(args).to_path_buf(), args.project.of(&args.scenario))
}

fn folder_of(args: &ScenarioArgs) -> &Path {
    args.scenario.parent().unwrap_or(Path::new(""))
}

/// Reads the fleet file of a scenario. Returns its path, its contents and the findings. If the scenario itself names the file, the file
/// must be in the project.
fn read_fleet(args: &ScenarioArgs, source: &Source) -> (PathBuf, (Option<Fleet>, Vec<Finding>)) {
    let project = args.project.of(&args.scenario);
    let named = match &args.fleet {
        Some(_) => None,
        None => downbeat_scripts::fleet_named_by(source).map(|named| folder_of(args).join(named)),
    };
    if let Some(path) = named {
        let (fleet, findings) = downbeat_scripts::read_fleet_named(&path, &project);
        let is_itself_outside = |finding: &Finding| {
            finding.code == Code::OutsideProject && finding.line == 0 && Path::new(&finding.file) == path
        };
        let place = |finding| {
            if is_itself_outside(&finding) { place_at_fleet(source, finding) } else { finding }
        };
        let findings = findings.into_iter().map(place).collect();
        return (path, (fleet, findings));
    }
    let path = args.fleet.clone().unwrap_or_else(|| PathBuf::from("fleet.yaml"));
    // A file within the scenario's project belongs to that project, even if a subfolder is a project of its own.
    let project = if project.holds(&path) { project } else { args.project.of(&path) };
    let read = downbeat_scripts::read_fleet_within(&path, &project);
    (path, read)
}

impl ProjectArgs {
    /// Returns the project to which a file belongs: the one that the operator has named, or else the one that contains the file.
    pub(super) fn of(&self, file: &Path) -> Project {
        self.project.clone().unwrap_or_else(|| Project::of(file))
    }

    /// Restores the project from its folder, which the journal contains.
    pub(super) fn remembered(folder: Option<&Path>) -> Self {
        Self { project: folder.and_then(|folder| Project::within(folder).ok()) }
    }

    /// Returns the project folder that the operator has named. `None` if the operator named none.
    pub(super) fn folder(&self) -> Option<PathBuf> {
        self.project.as_ref().map(|project| project.root().to_path_buf())
    }
}

/// Like [`load`], for commands that need the compiled scenario, its fleet and the path of the fleet file. Prints warnings. After an
/// error, returns the exit code of the command.
pub(super) fn load_choreography(
    args: &ScenarioArgs,
    format: Format,
) -> Result<(Choreography, Fleet, PathBuf), Exit> {
    load_whole(args, format).map(|(choreography, fleet, fleet_path, _)| (choreography, fleet, fleet_path))
}

/// Like [`load_choreography`], but also returns the warnings.
pub(super) fn load_whole(
    args: &ScenarioArgs,
    format: Format,
) -> Result<(Choreography, Fleet, PathBuf, Vec<Finding>), Exit> {
    let loaded = load(args);
    match format {
        Format::Text => show_findings(&loaded.findings),
        Format::Json if loaded.choreography.is_none() => {
            console::print_json(&serde_json::json!({ "findings": loaded.findings }));
        }
        Format::Json => {}
    }
    match (loaded.choreography, loaded.fleet) {
        (Some(choreography), Some(fleet)) => Ok((choreography, fleet, loaded.fleet_path, loaded.findings)),
        _ if loaded.unreadable => Err(Exit::Usage),
        _ => Err(Exit::Failed),
    }
}

/// If the fleet file does not exist, adds to the finding's hint how to name another fleet file.
fn say_how_to_name_it(findings: &mut [Finding], how: &str) {
    for hint in findings.iter_mut().filter_map(|finding| finding.hint.as_mut()) {
        if hint.starts_with("a fleet file lists your robots") {
            *hint += &format!(", {how}");
        }
    }
}

/// Reads a fleet file without a scenario.
pub(super) fn load_fleet(path: &Path, project: &ProjectArgs, format: Format) -> Result<Fleet, Exit> {
    let (fleet, findings) = downbeat_scripts::read_fleet_within(path, &project.of(path));
    shown_fleet(fleet, findings, format)
}

/// Like [`load_fleet`], but for a fleet whose latencies are yet to be measured.
pub(super) fn load_fleet_to_measure(
    path: &Path,
    project: &ProjectArgs,
    format: Format,
) -> Result<Fleet, Exit> {
    let (fleet, findings) = downbeat_scripts::read_fleet_to_measure(path, &project.of(path));
    shown_fleet(fleet, findings, format)
}

fn shown_fleet(fleet: Option<Fleet>, mut findings: Vec<Finding>, format: Format) -> Result<Fleet, Exit> {
    say_how_to_name_it(&mut findings, "or name one as the argument of this command");
    match format {
        Format::Text => show_findings(&findings),
        Format::Json if fleet.is_none() => {
            console::print_json(&serde_json::json!({ "findings": findings }));
        }
        Format::Json => {}
    }
    let unreadable = findings.iter().any(Finding::is_about_access);
    fleet.ok_or(if unreadable { Exit::Usage } else { Exit::Failed })
}

pub(super) fn show_findings(findings: &[Finding]) {
    for finding in findings.iter().filter(|finding| finding.severity == Severity::Error) {
        let Finding { code, file, line, column, message, .. } = finding;
        console::remember_error(&format!("{file}:{line}:{column}: {}: {message}", code.as_str()));
    }
    if !findings.is_empty() {
        console::note_block(&downbeat_scripts::render(findings, console::stderr_has_colour()));
    }
}
