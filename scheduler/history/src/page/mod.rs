//! Creates a page for a browser from a mission or from trials. The page is a single file that needs neither a network nor this program.
//! `viewer/` contains the code of the page; this module creates its data.

mod columns;
mod compared;
mod document;
mod events;
mod planned;
mod played;
mod recorded;
mod tried;
mod written;

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use downbeat_scripts::{Choreography, Finding, Fleet, Outline};
use flate2::Compression;
use flate2::write::GzEncoder;
use serde::Serialize;

use self::columns::Columns;
use self::document::{DocumentKind, Mission, VERSION};
use self::played::Epoch;
use self::tried::Tried;
use crate::history::History;
use downbeat_rehearsal::dry_run;
use downbeat_rehearsal::trials::Results;

pub use self::compared::{OtherPlan, OtherRun};
pub use self::played::TimedProgress;
pub use self::written::{OtherScenario, Written};

/// The page without data.
const TEMPLATE: &str = include_str!("page.html");
/// The name and version of the program that wrote the page.
const PROGRAM: &str = concat!("downbeat ", env!("CARGO_PKG_VERSION"));
/// Placeholder in the template for the page's data.
const PLACE: &str = "@@MISSION@@";

/// The data of a dry run for a page.
#[derive(Debug)]
pub struct Rehearsed<'a> {
    /// The choreography that was played.
    pub choreography: &'a Choreography,
    /// The cues of the choreography as written, with their locations in its files.
    pub outline: &'a Outline,
    /// The robots of the choreography and their bodies.
    pub fleet: &'a Fleet,
    /// The mistakes that were found in the files of the choreography.
    pub findings: &'a [Finding],
    /// The result of the dry run, with the values that each robot set.
    pub played: &'a dry_run::Played,
    /// The messages to the operator with their times.
    pub told: &'a [TimedProgress],
}

/// Creates the page of a dry run. The same mission gives the same bytes.
///
/// # Errors
/// An error if the JSON cannot be written, which happens only if memory runs out.
pub fn of_dry_run(rehearsed: &Rehearsed<'_>) -> io::Result<String> {
    let mut columns = Columns::default();
    let mission = rehearsed.mission(&mut columns);
    page(&mission, &columns)
}

/// Creates the page of a dry run that is compared with another plan. The page shows the other plan in the background.
///
/// # Errors
/// The same errors as [`of_dry_run`].
pub fn of_difference(rehearsed: &Rehearsed<'_>, other: &OtherPlan<'_>) -> io::Result<String> {
    let mut columns = Columns::default();
    let mut mission = rehearsed.mission(&mut columns);
    mission.compared = Some(compared::compared(rehearsed, other, &mut columns));
    page(&mission, &columns)
}

/// Creates the page of a mission that was played. If its scenario is given, the page shows the cues and bodies.
///
/// # Errors
/// The same errors as [`of_dry_run`].
pub fn of_history(history: &History, written: Option<&Written<'_>>) -> io::Result<String> {
    let mut columns = Columns::default();
    let mission = history.mission(written, &mut columns);
    page(&mission, &columns)
}

/// Creates the page of a mission that is compared with another mission. The page shows the other mission in the background.
///
/// # Errors
/// The same errors as [`of_dry_run`].
pub fn of_run_difference(history: &History, other: &OtherRun<'_>) -> io::Result<String> {
    let mut columns = Columns::default();
    let mut mission = history.mission(None, &mut columns);
    mission.compared = Some(compared::compared_runs((history, &mission), other, &mut columns));
    page(&mission, &columns)
}

/// Creates the page of trials. `replay` contains the words of the command that replays a trial, without `--trial K`. The same results
/// give the same bytes.
///
/// # Errors
/// The same errors as [`of_dry_run`].
pub fn of_trials(results: &Results, replay: &[String]) -> io::Result<String> {
    page(&Tried::of(results, replay), &Columns::default())
}

impl Rehearsed<'_> {
    fn mission(&self, columns: &mut Columns) -> Mission {
        let Self { choreography, outline, fleet, findings, played, told } = *self;
        let report = &played.report;
        let of_mission = downbeat_runtime::fleet::robots_in(fleet, choreography);
        let places = planned::places(&of_mission);
        let epoch = Epoch(report.acts.first().map_or(dry_run::BEGIN, |act| act.start));
        let acts = played::acts(played, told, choreography, &places, epoch);
        let begins = told.first().map(|(at, _)| epoch.millis(*at));
        let ends = told.last().map(|(at, _)| epoch.millis(*at));
        let from = begins.into_iter().chain(acts.iter().filter_map(|act| act.sent)).fold(0.0, f64::min);
        let to = ends.into_iter().chain(acts.iter().map(|act| act.end)).fold(0.0, f64::max);
        Mission {
            version: VERSION,
            program: PROGRAM,
            kind: DocumentKind::DryRun,
            cut_off: None,
            scenario: choreography.scenario.clone(),
            epoch: epoch.0.to_string(),
            from,
            to,
            report: serde_json::to_value(report).ok(),
            sources: planned::sources(outline),
            robots: planned::robots(&of_mission, &places),
            groups: planned::groups(fleet, &places),
            plans: planned::plans(choreography, outline, &places, columns),
            acts,
            events: events::of_told(told, &places, epoch),
            findings: planned::findings(findings, outline),
            set: played::set(played, choreography, &places, epoch, columns),
            read: played::read(report, &places, epoch, columns),
            clocks: played::clocks(report, &places, from, to, columns),
            compared: None,
        }
    }
}

/// Writes a page to a file atomically: if writing fails, the previous content of the file is preserved.
///
/// # Errors
/// An error if the file cannot be written.
pub fn save(path: &Path, page: &str) -> io::Result<()> {
    // Resolves a symbolic link, so that its target is replaced. A pipe or a device is written directly.
    let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    if path.exists() && !path.is_file() || ["/dev", "/proc"].iter().any(|system| path.starts_with(system)) {
        return fs::write(&path, page);
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let part = folder.join(format!(".downbeat-{}.part", std::process::id()));
    let written = write_new(&part, page, &path).and_then(|()| fs::rename(&part, &path));
    if written.is_err() {
        let _may_not_be_there = fs::remove_file(&part);
    }
    written
}

/// Writes the new file `part` with the permissions of the file `replaced`, which it will replace.
fn write_new(part: &Path, page: &str, replaced: &Path) -> io::Result<()> {
    let mut file = fs::File::create_new(part)?;
    if let Ok(known) = fs::metadata(replaced) {
        file.set_permissions(known.permissions())?;
    }
    file.write_all(page.as_bytes())?;
    file.sync_all()
}

/// Inserts the page's data into the template: the length of the JSON, the JSON itself and the columns. The data is compressed with gzip
/// and encoded in Base64, so that no name in it can break the page.
fn page(mission: &impl Serialize, columns: &Columns) -> io::Result<String> {
    let json = serde_json::to_vec(mission)?;
    let length =
        u32::try_from(json.len()).map_err(|_| io::Error::other("the mission is too large for a page"))?;
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(&length.to_le_bytes())?;
    packed.write_all(&json)?;
    packed.write_all(columns.bytes())?;
    let (before, after) = TEMPLATE.split_once(PLACE).unwrap_or((TEMPLATE, ""));
    Ok([before, &STANDARD.encode(packed.finish()?), after].concat())
}
