//! Finds the files that the arguments denote, and derives robots and scenes from the file names.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use downbeat_yaml::finding::{Code, Finding};

use super::natural::{is_number, natural_order};
use super::sink::Sink;
use super::{ImportFormat, ImportOptions};

/// Maximum number of files of one import.
const FILES_MAX: usize = 10_000;

/// A file with the robot and the scene that its name denotes.
#[derive(Clone, Debug)]
pub(super) struct Input {
    pub(super) path: PathBuf,
    pub(super) robot: String,
    pub(super) scene: String,
}

/// Finds all files that the arguments denote. Returns each file with its robot and its scene.
pub(super) fn gather(
    format: ImportFormat,
    paths: &[PathBuf],
    options: &ImportOptions,
    sink: &mut Sink,
) -> Vec<Input> {
    let inputs = match format {
        ImportFormat::Crazyswarm => crazyswarm(paths, sink),
        _ => motions(format, paths, options, sink),
    };
    if inputs.len() > FILES_MAX {
        let message = format!("the import has {} files", inputs.len());
        let expected = format!("at most {FILES_MAX} files");
        sink.about(&name_of(&paths[0]), Code::ImportLimit, message, &expected, None);
        return Vec::new();
    }
    inputs
}

/// Returns the name of a file or folder, without its extension.
pub(super) fn stem(path: &Path) -> String {
    let absolute = path.file_stem().map(|_| path.to_path_buf()).or_else(|| path.canonicalize().ok());
    let stem = absolute.as_deref().and_then(Path::file_stem).map(|stem| stem.to_string_lossy().into_owned());
    stem.unwrap_or_else(|| "imported".to_owned())
}

fn name_of(path: &Path) -> String {
    path.display().to_string()
}

/// Returns the inputs of a Crazyswarm import. A file is a robot. A folder is a robot, too, and its files are the robot's scenes. However,
/// a folder that only contains folders is a set of robots. So is a single folder whose files are not named by numbers.
fn crazyswarm(paths: &[PathBuf], sink: &mut Sink) -> Vec<Input> {
    let mut robots: Vec<(PathBuf, Vec<PathBuf>)> = Vec::new();
    for path in paths {
        if !path.is_dir() {
            robots.push((path.clone(), vec![path.clone()]));
            continue;
        }
        let (files, folders) = listed(path, &["csv"], sink);
        let numbered = files.iter().all(|file| is_number(&stem(file)));
        if files.is_empty() && !folders.is_empty() {
            let of = |folder: PathBuf, sink: &mut Sink| (folder.clone(), listed(&folder, &["csv"], sink).0);
            robots.extend(
                folders.into_iter().map(|folder| of(folder, sink)).filter(|(_, files)| !files.is_empty()),
            );
        } else if numbered || paths.len() > 1 {
            robots.push((path.clone(), files));
        } else {
            robots.extend(files.into_iter().map(|file| (file.clone(), vec![file])));
        }
    }
    robots.sort_by(|a, b| natural_order(&stem(&a.0), &stem(&b.0)));
    if robots.iter().all(|(_, files)| files.is_empty()) {
        sink.about(
            &name_of(&paths[0]),
            Code::NothingToDo,
            "no CSV files found".into(),
            "files named *.csv",
            None,
        );
    }
    note_sorted(&robots, sink);
    let inputs = robots.into_iter().flat_map(|(robot, files)| {
        let scenes = files.len() > 1 || robot.is_dir();
        let robot = drone_name(&stem(&robot));
        files.into_iter().map(move |path| {
            let scene = if scenes { scene_name(&stem(&path)) } else { String::new() };
            Input { path, robot: robot.clone(), scene }
        })
    });
    inputs.collect()
}

fn note_sorted(robots: &[(PathBuf, Vec<PathBuf>)], sink: &mut Sink) {
    let scenes = robots.iter().map(|(_, files)| files.len()).max().unwrap_or(0);
    if scenes > 1 {
        sink.note(format!("{scenes} scenes for each of {} robots, sorted by number", robots.len()));
    }
}

/// Returns the name of the drone that a file belongs to. Crazyswarm names the files of drone 1 `1` or `pp1`.
pub(super) fn drone_name(stem: &str) -> String {
    match stem.strip_prefix("pp").unwrap_or(stem) {
        number if is_number(number) => format!("cf{number}"),
        _ => stem.to_owned(),
    }
}

fn scene_name(stem: &str) -> String {
    if is_number(stem) { format!("scene {stem}") } else { stem.to_owned() }
}

/// Returns the inputs of an import in a format other than Crazyswarm. The files are scenes of the same robots. If the user specifies as
/// many robot names as files, each file is a separate robot instead.
fn motions(format: ImportFormat, paths: &[PathBuf], options: &ImportOptions, sink: &mut Sink) -> Vec<Input> {
    let extensions = format.facts().ends;
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() {
            let (found, _) = listed(path, extensions, sink);
            if found.is_empty() {
                let expected = format!("files named *.{}", extensions.join(", *."));
                sink.about(
                    &name_of(path),
                    Code::NothingToDo,
                    "no files to import in this folder".into(),
                    &expected,
                    None,
                );
            }
            files.extend(found);
        } else {
            files.push(path.clone())
        }
    }
    if format.facts().is_mapped && robot_a_file(options) {
        return robots_apart(files, sink);
    }
    if files.len() > 1 && files.iter().all(|file| is_number(&stem(file))) {
        files.sort_by(|a, b| natural_order(&stem(a), &stem(b)));
        sink.note(format!("{} scenes, sorted by number", files.len()));
    }
    let kind = options.kind.clone().unwrap_or_else(|| format.facts().kind.to_owned());
    let apart = format.facts().is_single && files.len() > 1 && files.len() == options.robots.len();
    let alone = files.len() == 1;
    let scenes = scene_names(&files);
    let inputs = files.into_iter().zip(scenes).enumerate().map(|(index, (path, scene))| {
        let scene = if alone || apart { String::new() } else { scene };
        let robot = if apart { options.robots[index].clone() } else { kind.clone() };
        Input { path, robot, scene }
    });
    inputs.collect()
}

/// Returns one robot per file, named after the file. If files have equal names and each file has its own folder, robots are named after
/// the folders. If several files share a folder, each folder becomes a scene instead.
fn robots_apart(mut files: Vec<PathBuf>, sink: &mut Sink) -> Vec<Input> {
    files.sort_by(|a, b| natural_order(&stem(a), &stem(b)));
    let folders = folder_names(&files);
    let (by_name, by_folder) =
        (are_distinct(files.iter().map(|file| stem(file))), are_distinct(folders.iter().cloned()));
    if files.len() > 1 {
        let names = if by_name || !by_folder { "the files" } else { "their folders" };
        sink.note(format!("imported {} files as one robot each, named after {names}", files.len()));
    }
    let input = |(path, folder): (PathBuf, String)| match (by_name, by_folder) {
        (true, _) => Input { robot: stem(&path), path, scene: String::new() },
        (false, true) => Input { robot: folder, path, scene: String::new() },
        (false, false) => Input { robot: stem(&path), path, scene: folder },
    };
    let mut inputs: Vec<Input> = files.into_iter().zip(folders).map(input).collect();
    inputs.sort_by(|a, b| natural_order(&a.scene, &b.scene));
    inputs
}

/// Returns a scene name for each file: the file name. If the file names are not distinct, returns the folder names; if these are not
/// distinct either, returns both together.
fn scene_names(files: &[PathBuf]) -> Vec<String> {
    let stems: Vec<String> = files.iter().map(|file| stem(file)).collect();
    let folders = folder_names(files);
    if are_distinct(stems.iter().cloned()) {
        stems.iter().map(|stem| scene_name(stem)).collect()
    } else if are_distinct(folders.iter().cloned()) {
        folders
    } else {
        folders.iter().zip(&stems).map(|(folder, stem)| format!("{folder}/{stem}")).collect()
    }
}

/// Returns the name of each file's folder. If two folders have the same name, returns the whole paths of the folders.
fn folder_names(files: &[PathBuf]) -> Vec<String> {
    let of = |file: &PathBuf| file.parent().map(Path::to_path_buf).unwrap_or_default();
    let name = |folder: &PathBuf| {
        folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    };
    let mut folders: Vec<PathBuf> = files.iter().map(of).collect();
    let names: Vec<String> = folders.iter().map(name).collect();
    let paths: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
    folders.sort();
    folders.dedup();
    if are_distinct(folders.iter().map(name)) { names } else { paths }
}

fn are_distinct(names: impl Iterator<Item = String>) -> bool {
    let mut seen = HashSet::new();
    names.into_iter().all(|name| seen.insert(name))
}

/// Whether each file moves a separate robot, because there are `--map` options but none of them names a robot.
fn robot_a_file(options: &ImportOptions) -> bool {
    !options.columns.is_empty() && options.columns.iter().all(|(to, _)| !to.contains('/'))
}

/// Returns the files of a folder that have one of the extensions, and the folder's subfolders. Both are in natural order: `2` comes
/// before `10`.
fn listed(folder: &Path, extensions: &[&str], sink: &mut Sink) -> (Vec<PathBuf>, Vec<PathBuf>) {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) => {
            let (file, message) = (name_of(folder), error.to_string());
            let finding = Finding::about_file(Code::Unreadable, &file, message, "a readable folder", None);
            sink.findings.push(finding);
            return (Vec::new(), Vec::new());
        }
    };
    let mut paths: Vec<_> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| !is_hidden(path)).collect();
    paths.sort_by(|a, b| natural_order(&stem(a), &stem(b)));
    let (folders, files): (Vec<_>, Vec<_>) = paths.into_iter().partition(|path| path.is_dir());
    let wanted = |path: &PathBuf| {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_lowercase();
        extensions.contains(&extension.as_str())
    };
    (files.into_iter().filter(wanted).collect(), folders)
}

fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'))
}
