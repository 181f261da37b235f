//! The files of shows: those that the editor has opened, with their unsaved texts, and those on the disk to which they refer.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::SystemTime;

use downbeat_scripts::Project;

use crate::file::{Content, File};
use crate::text::Text;

/// Maximum number of files of a project that are searched for scenarios and worlds.
const FILES_MAX: usize = 2_000;
/// Maximum size in bytes of files that are searched for scenarios and worlds.
const BYTES_MAX: u64 = 4 * 1024 * 1024;
/// Maximum depth of folders that are searched.
const DEPTH_MAX: usize = 8;
/// Maximum number of files of a show.
const MEMBERS_MAX: usize = 1_000;

/// The files that the editor knows.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    open: BTreeMap<PathBuf, Open>,
    saved: RefCell<BTreeMap<PathBuf, Saved>>,
    /// The YAML files of each project, by its folder.
    listed: RefCell<BTreeMap<PathBuf, BTreeSet<PathBuf>>>,
}

/// A file that the editor has opened.
#[derive(Clone, Debug)]
struct Open {
    version: i32,
    file: Rc<File>,
}

/// A file on the disk.
#[derive(Debug)]
struct Saved {
    changed: SystemTime,
    file: Rc<File>,
}

/// A file of a show.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    pub(crate) file: Rc<File>,
    /// The prefix of its names in the show, such as `left.`.
    pub(crate) prefix: String,
}

impl Workspace {
    /// Takes the text of a file in the editor.
    pub(crate) fn set(&mut self, path: PathBuf, version: i32, text: Text) {
        let before = self.open.get(&path).map_or(Content::Other, |open| open.file.content);
        let file = Rc::new(File::edited(path.clone(), text, before));
        self.open.insert(path, Open { version, file });
    }

    pub(crate) fn close(&mut self, path: &Path) {
        self.open.remove(path);
    }

    pub(crate) fn opened(&self) -> impl Iterator<Item = &Rc<File>> {
        self.open.values().map(|open| &open.file)
    }

    /// Returns the version of a text in the editor; `None` if the file is not open.
    pub(crate) fn version(&self, path: &Path) -> Option<i32> {
        self.open.get(path).map(|open| open.version)
    }

    /// Forgets which files there are, because some may have been created or deleted.
    pub(crate) fn relist(&self) {
        self.listed.borrow_mut().clear();
    }

    /// Returns the texts of all opened files.
    pub(crate) fn unsaved(&self) -> BTreeMap<PathBuf, String> {
        self.open.iter().map(|(path, open)| (path.clone(), open.file.text.as_str().to_owned())).collect()
    }

    /// Returns a file: as in the editor, or else as on the disk. `None` if it cannot be read.
    pub(crate) fn file(&self, path: &Path) -> Option<Rc<File>> {
        self.canonical_file(path.canonicalize().unwrap_or_else(|_| path.to_path_buf()))
    }

    /// Returns the file at a canonical path.
    fn canonical_file(&self, path: PathBuf) -> Option<Rc<File>> {
        if let Some(open) = self.open.get(&path) {
            return Some(open.file.clone());
        }
        let changed = path.metadata().ok()?.modified().ok()?;
        if let Some(known) = self.saved.borrow().get(&path).filter(|known| known.changed == changed) {
            return Some(known.file.clone());
        }
        let source = Project::of(&path).read(&path).ok()?;
        let file = Rc::new(File::new(path.clone(), Text::new(source.text)));
        self.saved.borrow_mut().insert(path, Saved { changed, file: file.clone() });
        Some(file)
    }

    /// Returns the files of a show, the given file first: the files that it includes, its fleet, and its robots.
    pub(crate) fn members(&self, root: &Rc<File>) -> Vec<Member> {
        let project = Project::of(&root.path);
        let mut members = vec![Member { file: root.clone(), prefix: String::new() }];
        if root.content == Content::Scenario
            && let Some(fleet) = self.named(&project, &fleet_of(root))
        {
            members.push(Member { file: fleet, prefix: String::new() });
        }
        let mut next = 0;
        while let Some(member) = members.get(next).cloned() {
            next += 1;
            for link in member.file.links() {
                let base = base_of(root, &member.file).join(&link.name);
                let Some(file) = self.named(&project, &base) else { continue };
                let own = own_prefix(&member.file, link.node);
                let prefix = format!("{}{own}", member.prefix);
                let is_known =
                    members.iter().any(|known| known.file.path == file.path && known.prefix == prefix);
                // A file that includes itself under a name has ever longer prefixes.
                let depth = prefix.matches('.').count();
                if !is_known && depth <= DEPTH_MAX && members.len() < MEMBERS_MAX {
                    members.push(Member { file, prefix });
                }
            }
        }
        members
    }

    /// Returns a file that another file names, if it is in the project and belongs to a show.
    fn named(&self, project: &Project, path: &Path) -> Option<Rc<File>> {
        let file = project.holds(path).then(|| self.file(path))??;
        (file.content != Content::Other).then_some(file)
    }

    /// Returns the scenarios and worlds in the project of a file, on the disk and in the editor.
    pub(crate) fn project_files(&self, of: &Path) -> Vec<Rc<File>> {
        let project = Project::of(of);
        let mut listed = self.listed.borrow_mut();
        let saved = listed.entry(project.root().to_path_buf()).or_insert_with(|| files_below(project.root()));
        let opened =
            self.open.keys().filter(|path| path.starts_with(project.root()) && !saved.contains(*path));
        let paths = saved.iter().chain(opened).cloned();
        paths.filter_map(|path| self.canonical_file(path)).collect()
    }

    /// Returns the roots of the shows that contain a file: scenarios, or the file itself if no scenario uses it.
    pub(crate) fn roots_of(&self, file: &Rc<File>) -> Vec<Rc<File>> {
        if file.content == Content::Scenario {
            return vec![file.clone()];
        }
        let scenarios =
            self.project_files(&file.path).into_iter().filter(|file| file.content == Content::Scenario);
        let holds = |root: &Rc<File>| {
            file.content == Content::World
                || self.members(root).iter().any(|member| member.file.path == file.path)
        };
        let roots: Vec<_> = scenarios.filter(holds).collect();
        if roots.is_empty() { vec![file.clone()] } else { roots }
    }
}

/// Returns the path of the fleet file of a scenario: the one that it names, or else the nearest `fleet.yaml` in the project.
pub(crate) fn fleet_of(scenario: &File) -> PathBuf {
    let folder = scenario.path.parent().unwrap_or(Path::new(""));
    if let Some(named) = scenario.root_value("fleet") {
        return folder.join(named);
    }
    nearest_fleet(&scenario.path)
}

/// Returns the path of the nearest `fleet.yaml` in the project of a file. If the project has no fleet file, it is the path in the file's own folder.
pub(crate) fn nearest_fleet(path: &Path) -> PathBuf {
    let folder = path.parent().unwrap_or(Path::new(""));
    let project = Project::of(path);
    let within = folder.ancestors().take_while(|folder| folder.starts_with(project.root()));
    let nearest = within.map(|folder| folder.join("fleet.yaml")).find(|path| path.is_file());
    nearest.unwrap_or_else(|| folder.join("fleet.yaml"))
}

/// Returns the folder to which the paths in a file are relative: those in included files are relative to the scenario.
fn base_of<'f>(root: &'f File, file: &'f File) -> &'f Path {
    let from = if file.content == Content::Included { root } else { file };
    from.path.parent().unwrap_or(Path::new(""))
}

/// Returns the prefix that an include gives to the names of its file.
fn own_prefix(file: &File, node: usize) -> String {
    let name = file
        .entry_of(node)
        .filter(|entry| entry.key == "file")
        .and_then(|entry| file.tree.scalar(file.tree.value(entry.map, "as")?));
    name.map(|name| format!("{name}.")).unwrap_or_default()
}

/// Returns the YAML files in a folder and its subfolders.
pub(crate) fn files_below(folder: &Path) -> BTreeSet<PathBuf> {
    let mut paths = BTreeSet::new();
    collect(folder, 0, &mut paths);
    paths
}

/// Adds the YAML files in a folder and its subfolders, except hidden ones and those that builds create.
fn collect(folder: &Path, depth: usize, paths: &mut BTreeSet<PathBuf>) {
    let Ok(entries) = folder.read_dir() else { return };
    for entry in entries.filter_map(Result::ok) {
        let (path, Ok(kind)) = (entry.path(), entry.file_type()) else { continue };
        let name = entry.file_name();
        let is_hidden = name.to_string_lossy().starts_with('.');
        if paths.len() >= FILES_MAX || is_hidden {
            continue;
        }
        if kind.is_dir() && depth < DEPTH_MAX && name != "target" && name != "node_modules" {
            collect(&path, depth + 1, paths);
        }
        let is_yaml = path.extension().is_some_and(|extension| extension == "yaml" || extension == "yml");
        if kind.is_file() && is_yaml && entry.metadata().is_ok_and(|about| about.len() <= BYTES_MAX) {
            paths.insert(path);
        }
    }
}
