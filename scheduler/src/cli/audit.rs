//! `downbeat audit`: shows the connections, claims, movements and stops in the audit trails of robots, with the operators who caused them.
//! Checks that no record was changed or removed.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use chrono::{DateTime, Local, NaiveTime, TimeDelta, TimeZone, Utc};
use downbeat_robot::audit::{Chain, Event, Record};
use downbeat_robot::audit_file;
use downbeat_scripts::shown::shown;
use downbeat_scripts::{Attempt, Refusal};
use serde::Serialize;
use serde_json::json;
use urrcp::RobotId;

use super::{Exit, Format, console};
use crate::journal::{self, private};
use crate::keys::{calendar, file_name};
use crate::show::table::Rows;

/// The folder of the trails in the state folder.
const FOLDER: &str = "audit";
/// Maximum number of full files of a trail that are read.
const FILES_MAX: u32 = 100;

/// Show who connected to, claimed, moved and stopped robots.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Robots write audit trails with `downbeat robot --audit` and `downbeat edge`, by default in the folder `audit` of \
$DOWNBEAT_STATE, or else of $XDG_STATE_HOME/downbeat, or else of ~/.local/state/downbeat. Each record contains the hash of the previous \
one. The command ends with exit code 1 if a record was changed or removed. To detect a trail that was cut at its end, keep the last hash \
and pass it to a later call with --contains.

Examples:
  downbeat audit
  downbeat audit --robot arm-2 --at 15:00
  downbeat audit arm-2.jsonl --operator anna --since 2026-11-30T14:00:00Z
  downbeat audit --contains 5f70bf18a086007016e948b04aed3b82103a36bea41755b6cddfaf10ace3c6ef"
)]
pub(super) struct AuditArgs {
    /// Audit trails; by default, all in the state folder. Name the newest file of each; older ones (`FILE.1`, ...) are read as well.
    #[arg(value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Show only this robot.
    #[arg(long, value_name = "ID")]
    robot: Option<RobotId>,
    /// Show only this operator.
    #[arg(long, value_name = "NAME")]
    operator: Option<String>,
    /// Show the state at this time: for each robot the session to which it belonged, and for each device its last movement. A time of
    /// the last 24 hours, such as 15:00, or a time with a date and a zone, such as 2026-11-30T15:00:00+01:00.
    #[arg(long, value_name = "TIME", value_parser = time, conflicts_with_all = ["since", "until"])]
    at: Option<DateTime<Utc>>,
    /// Show only records from this time on.
    #[arg(long, value_name = "TIME", value_parser = time)]
    since: Option<DateTime<Utc>>,
    /// Show only records up to this time.
    #[arg(long, value_name = "TIME", value_parser = time)]
    until: Option<DateTime<Utc>>,
    /// Also check that a trail contains the record with this hash.
    #[arg(long, value_name = "HASH")]
    contains: Option<String>,
}

/// Parses a time of the last 24 hours, or a time with a date and a zone.
fn time(text: &str) -> Result<DateTime<Utc>, String> {
    if let Ok(time) = DateTime::parse_from_rfc3339(text) {
        return Ok(time.to_utc());
    }
    let of_day =
        NaiveTime::parse_from_str(text, "%H:%M:%S").or_else(|_| NaiveTime::parse_from_str(text, "%H:%M"));
    let of_day =
        of_day.map_err(|_| "expected HH:MM, HH:MM:SS, or a time such as 2026-11-30T15:00:00+01:00")?;
    let now = DateTime::from_timestamp(calendar(), 0).unwrap_or_default().with_timezone(&Local);
    let on = |day| Local.from_local_datetime(&chrono::NaiveDate::and_time(&day, of_day)).earliest();
    let today = on(now.date_naive()).filter(|time| *time <= now);
    let time = today.or_else(|| on(now.date_naive() - TimeDelta::days(1)));
    time.map(|time| time.to_utc()).ok_or_else(|| "clocks did not show this time".to_owned())
}

/// Returns the file for the audit trail of a robot, in the state folder. Creates the folder if it does not exist.
///
/// # Errors
/// There is no state folder, other users have access to it, or another process writes the file.
pub(super) fn default_file(robot: &RobotId) -> Result<PathBuf, String> {
    let state = journal::state_folder().map_err(|error| error.to_string())?;
    let folder = state.join(FOLDER);
    let created = journal::create_state_folder(&state).and_then(|()| private::create_folder(&folder));
    created.map_err(|error| format!("{}: {error}", folder.display()))?;
    let file = folder.join(format!("{}.jsonl", file_name(robot.as_str())));
    // Another robot with this id may run on this machine, for example in a test.
    if File::open(&file).is_ok_and(|file| file.try_lock().is_err()) {
        return Err(format!("another process writes {}", file.display()));
    }
    Ok(file)
}

/// A trail that was read.
#[derive(Serialize)]
struct Trail {
    file: PathBuf,
    first: Option<u64>,
    last: Option<u64>,
    hash: Option<String>,
    faults: Vec<String>,
}

pub(super) fn audit(args: &AuditArgs, format: Format) -> Exit {
    let files = match files(args) {
        Ok(files) => files,
        Err(exit) => return exit,
    };
    let (mut records, mut trails, mut contains) = (Vec::new(), Vec::new(), args.contains.is_none());
    let mut robots = BTreeSet::new();
    for file in files {
        let mut chain = Chain::default();
        let mut keep = |record: Record, hash: &str| {
            robots.insert(record.robot.clone());
            contains |= args.contains.as_deref() == Some(hash);
            if args.selects(&record) {
                records.push(record);
            }
        };
        if let Err(exit) = read(&file, &mut chain, &mut keep) {
            return exit;
        }
        let Chain { first, last, hash, mut faults, further_faults, .. } = chain;
        if first.is_none() {
            // A trail begins when its robot starts.
            faults = vec![format!("{} contains no records of an audit trail", file.display())];
        } else if further_faults > 0 {
            faults.push(format!("{}: {further_faults} faults more", file.display()));
        }
        trails.push(Trail { file, first, last, hash, faults });
    }
    if let Some(unknown) = args.robot.as_ref().filter(|robot| !robots.contains(robot.as_str())) {
        let known: Vec<_> = robots.iter().map(String::as_str).collect();
        console::error(&format!(
            "no record is about the robot `{unknown}`; robots with records: {}",
            if known.is_empty() { "none".to_owned() } else { shown(&known.join(", ")).to_string() }
        ));
        return Exit::Usage;
    }
    if args.at.is_some() {
        records = state(records);
    }
    records.sort_by_key(|record| record.at);
    match format {
        Format::Json => {
            console::print_json(&json!({ "records": records, "trails": trails, "contains": contains }))
        }
        Format::Text => show(&records, &trails),
    }
    if !contains {
        console::error(
            "no trail contains the record with this hash: the records after it, and it itself, were removed",
        );
    }
    let is_whole = trails.iter().all(|trail| trail.faults.is_empty());
    if is_whole && contains { Exit::Done } else { Exit::Failed }
}

impl AuditArgs {
    fn selects(&self, record: &Record) -> bool {
        let at = DateTime::from_timestamp_nanos(record.at.as_nanos());
        let robot = self.robot.as_ref().is_none_or(|robot| robot.as_str() == record.robot);
        let operator = self.operator.is_none() || self.operator == record.operator;
        let since = self.since.is_none_or(|since| at >= since);
        let until = self.until.or(self.at).is_none_or(|until| at <= until);
        robot && operator && since && until
    }
}

/// Returns the newest files of the trails to read.
fn files(args: &AuditArgs) -> Result<Vec<PathBuf>, Exit> {
    if !args.files.is_empty() {
        return Ok(args.files.clone());
    }
    let usage = |message: String| {
        console::error(&message);
        Exit::Usage
    };
    let state = journal::state_folder().map_err(|error| usage(error.to_string()))?;
    let folder = state.join(FOLDER);
    let entries = match private::folder(&folder).and_then(|_own| std::fs::read_dir(&folder)) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(usage(format!(
                "no robot of this machine has written an audit trail to {}; name the files of other robots",
                folder.display()
            )));
        }
        Err(error) => return Err(usage(format!("{}: {error}", folder.display()))),
    };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut paths: Vec<_> = paths.filter(|path| path.extension() == Some(OsStr::new("jsonl"))).collect();
    paths.sort();
    Ok(paths)
}

/// Reads all files of a trail, from the oldest to the newest.
fn read(newest: &Path, chain: &mut Chain, keep: &mut impl FnMut(Record, &str)) -> Result<(), Exit> {
    let full = (1..=FILES_MAX).map(|number| audit_file(newest, number)).take_while(|path| path.exists());
    let mut paths: Vec<_> = full.collect();
    paths.reverse();
    paths.push(newest.to_owned());
    for path in paths {
        let refuse = |error: &std::io::Error| {
            let refusal = Refusal::of(Attempt::Read(&path), error);
            console::error(&format!("cannot read {}: {refusal}", shown(&path.display().to_string())));
            Exit::Usage
        };
        let file: File = downbeat_scripts::open(&path).map_err(|error| refuse(&error))?;
        let name = path.display().to_string();
        chain.check(&name, BufReader::new(file), &mut *keep).map_err(|error| refuse(&error))?;
    }
    Ok(())
}

/// Reduces records to those that determine the state after the last one: the owner of each robot, and the last movement of each device.
fn state(records: Vec<Record>) -> Vec<Record> {
    let mut last: BTreeMap<(String, Option<String>), Record> = BTreeMap::new();
    for record in records {
        let about = match record.event {
            Event::Claimed | Event::Released => None,
            Event::Moved | Event::Rested => record.device.clone(),
            _ => continue,
        };
        last.insert((record.robot.clone(), about), record);
    }
    last.into_values().collect()
}

fn show(records: &[Record], trails: &[Trail]) {
    let mut rows = Rows::new(&["at", "robot", "event", "operator", "device", "session", "from", "reason"], 8);
    for record in records {
        let at = DateTime::from_timestamp_nanos(record.at.as_nanos()).with_timezone(&Local);
        let or_not = |part: &Option<String>| part.clone().unwrap_or_default();
        rows.add([
            at.format("%F %T%.3f").to_string(),
            record.robot.clone(),
            record.event.to_string(),
            or_not(&record.operator),
            or_not(&record.device),
            or_not(&record.session),
            or_not(&record.peer),
            or_not(&record.reason),
        ]);
    }
    if records.is_empty() {
        console::print("no records\n");
    } else {
        console::print(&rows.text(console::columns()));
    }
    for trail in trails {
        let file = trail.file.display().to_string();
        let file = shown(&file);
        if let (Some(first), Some(last), Some(hash), true) =
            (trail.first, trail.last, &trail.hash, trail.faults.is_empty())
        {
            console::print(&format!("{file}: records {first} to {last}, complete; last hash {hash}\n"));
        }
        for fault in &trail.faults {
            console::error(&shown(fault));
        }
    }
}
