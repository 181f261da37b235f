//! Reading a journal back, as far as it is whole.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;
use urrcp::{DeviceId, Millis, RobotId, Server, Span, Timestamp};

use super::private::{self, How};
use super::{Opened, OpenedRobot};
use crate::mission::{ActFlaws, ActOver, OutOfTolerance, Promise, Rest, StepsLate};

/// What a journal says.
#[derive(Clone, Debug)]
pub struct Kept {
    /// Its first line.
    pub opened: Opened,
    /// When that was.
    pub opened_at: Timestamp<Server>,
    /// Acts that were promised and have not ended, in order: with how far they came.
    pub promises: Vec<(Promise, Progressed)>,
    /// Acts that have ended.
    pub ended_acts: u32,
    /// What became of acts that are over, in order.
    pub course: Vec<ActOver>,
    /// What of each of those that ended keeps the mission from being called done.
    pub flaws: Vec<ActFlaws>,
    /// Robots that were left out.
    pub dropped: Vec<RobotId>,
    /// Robots that do not know requests by their names.
    pub unnamed: Vec<RobotId>,
    /// Stops were being sent, and how the latest of them brings robots to rest.
    pub stopping: Option<Rest>,
    /// When they were first sent, unless something was promised after that: nothing has renewed a lease since.
    pub stopping_since: Option<Timestamp<Server>>,
    /// Robots that have confirmed their stop.
    pub stopped: Vec<RobotId>,
    /// How it ended, as it is in the report; `None` for a mission that was cut off.
    pub outcome: Option<Value>,
    /// Where it stops being whole.
    pub torn: Option<Torn>,
    /// Every robot that was ever sent anything, with its devices.
    pub touched: BTreeMap<RobotId, BTreeSet<DeviceId>>,
    /// What was last added to a timestamp for a robot's clock.
    shifts: BTreeMap<RobotId, Span>,
    /// Bytes of its whole lines at the beginning.
    pub(super) whole: usize,
}

/// What a mission left on its robots, for another process to take back.
#[derive(Clone, Debug, Default)]
pub struct Left {
    /// A robot that was sent nothing is not in it.
    pub robots: BTreeMap<RobotId, LeftOn>,
    /// What robots call themselves, where that is not their id.
    pub own_ids: BTreeMap<RobotId, RobotId>,
    /// No lease has been renewed after this; `None`: one may have been until just now.
    pub renewed_until: Option<Timestamp<Server>>,
}

/// What a mission left on a robot.
#[derive(Clone, Debug, Default)]
pub struct LeftOn {
    /// The devices that were sent anything.
    pub devices: BTreeSet<DeviceId>,
    /// What was added to timestamps for its clock.
    pub shift: Span,
    /// The running leases of scripts whose acts have not ended; `None` for one that continues without a link.
    pub leases: Vec<Option<Millis>>,
}

/// How far an act came that was promised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progressed {
    /// Its requests were sent, or were about to be.
    Prepared,
    /// All robots had accepted.
    Decided,
    /// Leases were carried over its start, or were about to be.
    Committed,
}

/// A journal that does not even say whose it is.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// The file cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// Its first line is not whole.
    #[error("{} does not begin with a whole line of a journal", path.display())]
    NoBegin {
        /// Which file.
        path: PathBuf,
    },
}

/// A journal with a line that was cut off or changed. What that line and those after it said is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Torn {
    /// Which line, counted from 1.
    pub line: usize,
    /// Bytes from there to the end of the file.
    pub bytes: usize,
    /// Whole lines behind it: the file was damaged, not only cut off.
    pub whole_after: usize,
}

/// Reads a journal of this user up to the first line that is not whole.
///
/// # Errors
/// [`Unreadable`] where not even the first line is whole.
pub fn read(path: &Path) -> Result<Kept, Unreadable> {
    let bytes = bytes_of(path).map_err(|error| Unreadable::Io { path: path.to_path_buf(), error })?;
    Kept::of_bytes(&bytes).ok_or_else(|| Unreadable::NoBegin { path: path.to_path_buf() })
}

/// The bytes of a journal in the state folder.
pub(super) fn bytes_of(path: &Path) -> io::Result<Vec<u8>> {
    let name = path.file_name().and_then(std::ffi::OsStr::to_str).ok_or(io::ErrorKind::NotFound)?;
    let mut bytes = Vec::new();
    private::file(path.parent().unwrap_or(Path::new(".")), name, How::Read)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// All that a journal says, for reports and pages.
#[derive(Clone, Debug)]
pub struct Records {
    /// Its first line.
    pub opened: Opened,
    /// Its further lines, up to where it stops being whole.
    pub all: Vec<(Timestamp<Server>, Value)>,
    /// Where that is.
    pub torn: Option<Torn>,
}

/// The lines of a journal whose bytes these are, up to the first one that is not whole. `path` is for error messages.
///
/// # Errors
/// [`Unreadable::NoBegin`] where not even the first line is whole.
pub fn records(bytes: &[u8], path: &Path) -> Result<Records, Unreadable> {
    let kept = Kept::of_bytes(bytes).ok_or_else(|| Unreadable::NoBegin { path: path.to_path_buf() })?;
    let lines = bytes[..kept.whole].split_inclusive(|byte| *byte == b'\n').skip(1).filter_map(whole);
    let dated = |line: Value| Some((Timestamp::deserialize(&line["at"]).ok()?, line));
    Ok(Records { opened: kept.opened, all: lines.filter_map(dated).collect(), torn: kept.torn })
}

/// Bytes of the whole lines at the beginning.
pub(super) fn whole_length(bytes: &[u8]) -> usize {
    let lines = bytes.split_inclusive(|byte| *byte == b'\n');
    lines.take_while(|line| sound(line).is_some()).map(<[u8]>::len).sum()
}

/// What a whole line says.
pub(super) fn whole(line: &[u8]) -> Option<Value> {
    serde_json::from_slice(sound(line)?).ok()
}

/// The JSON of a line that is as it was written.
fn sound(line: &[u8]) -> Option<&[u8]> {
    let line = line.strip_suffix(b"\n")?;
    let (sum, json) = line.split_at_checked(9)?;
    let sum = u32::from_str_radix(std::str::from_utf8(sum.strip_suffix(b" ")?).ok()?, 16).ok()?;
    (crc32fast::hash(json) == sum).then_some(json)
}

/// As much of a line as is needed of most; the reports of acts, nearly all of a long journal, are passed over.
#[derive(Deserialize)]
struct Head {
    at: Option<Timestamp<Server>>,
    record: String,
    number: Option<u32>,
    robot: Option<RobotId>,
    #[serde(default)]
    unnamed: Vec<RobotId>,
    report: Option<Numbered>,
    outcome: Option<Value>,
    #[serde(default)]
    rest: Rest,
    #[serde(default)]
    unaccounted: Vec<RobotId>,
    out_of_tolerance: Option<OutOfTolerance>,
    steps_late: Option<StepsLate>,
    #[serde(default)]
    again: bool,
}

#[derive(Deserialize)]
struct Numbered {
    number: u32,
}

/// As much of a promise as a stop needs.
#[derive(Deserialize)]
struct Touching<'a> {
    number: u32,
    #[serde(borrow)]
    scripts: Vec<Touched<'a>>,
}

#[derive(Deserialize)]
struct Touched<'a> {
    #[serde(borrow)]
    robot: Cow<'a, str>,
    #[serde(borrow)]
    device: Cow<'a, str>,
    #[serde(rename = "shift_ms")]
    shift: Span,
}

/// What becomes of a mission that was cut off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// Its acts were decided: it can be played to its end.
    Resume,
    /// What was promised has to be taken back, and why.
    Withdraw(&'static str),
}

impl Kept {
    /// What the bytes of a journal say; `None` where not even the first line is whole.
    pub(crate) fn of_bytes(bytes: &[u8]) -> Option<Self> {
        let (believed, rest) = bytes.split_at(whole_length(bytes));
        let mut lines = believed.split_inclusive(|byte| *byte == b'\n').filter_map(sound);
        let first: Value = serde_json::from_slice(lines.next()?).ok()?;
        let opened = Opened::deserialize(&first).ok()?;
        let mut kept = Self::new(opened, Timestamp::deserialize(&first["at"]).ok()?);
        let mut count = 1;
        kept.whole = believed.len();
        let mut under_way = Vec::new();
        for json in lines {
            kept.take(json, &mut under_way);
            count += 1;
        }
        let promise = |(_, json, progressed)| Some((serde_json::from_slice(json).ok()?, progressed));
        kept.promises = under_way.into_iter().filter_map(promise).collect();
        if !rest.is_empty() {
            let after: Vec<_> = rest.split_inclusive(|byte| *byte == b'\n').filter_map(sound).collect();
            // Only this is believed of records behind damage: these robots may hold something.
            let promises = after.iter().filter_map(|json| serde_json::from_slice::<Touching<'_>>(json).ok());
            promises.for_each(|promise| kept.touch(&promise));
            kept.torn = Some(Torn { line: count + 1, bytes: rest.len(), whole_after: after.len() });
        }
        Some(kept)
    }

    /// The state of a mission of which only its first line is known.
    fn new(opened: Opened, opened_at: Timestamp<Server>) -> Self {
        Self {
            opened,
            opened_at,
            promises: Vec::new(),
            ended_acts: 0,
            course: Vec::new(),
            flaws: Vec::new(),
            dropped: Vec::new(),
            unnamed: Vec::new(),
            stopping: None,
            stopping_since: None,
            stopped: Vec::new(),
            outcome: None,
            torn: None,
            touched: BTreeMap::new(),
            shifts: BTreeMap::new(),
            whole: 0,
        }
    }

    /// Bytes of its whole lines at the beginning.
    pub(crate) const fn whole(&self) -> usize {
        self.whole
    }

    /// What becomes of it, if it was cut off here.
    #[must_use]
    pub fn fate(&self) -> Fate {
        if self.stopping.is_some() {
            return Fate::Withdraw("it was being stopped");
        }
        if self.torn.is_some_and(|torn| torn.whole_after > 0) {
            return Fate::Withdraw("its journal is damaged");
        }
        if self.promises.iter().any(|(_, progressed)| *progressed == Progressed::Prepared) {
            return Fate::Withdraw("an act was sent and not decided");
        }
        match self.promises.is_empty() {
            true => Fate::Withdraw("no act was under way"),
            false => Fate::Resume,
        }
    }

    /// What it left on its robots.
    #[must_use]
    pub fn left(&self) -> Left {
        let own_id = |opened: &OpenedRobot| Some((opened.robot.clone(), opened.own_id.clone()?));
        let own_ids = self.opened.robots.iter().filter_map(own_id).collect();
        let mut left = Left { own_ids, renewed_until: self.stopping_since, ..Left::default() };
        for (robot, devices) in &self.touched {
            let shift = self.shifts.get(robot).copied().unwrap_or_default();
            let on = LeftOn { devices: devices.clone(), shift, leases: Vec::new() };
            left.robots.insert(robot.clone(), on);
        }
        for script in self.promises.iter().flat_map(|(promise, _)| &promise.scripts) {
            if let Some(on) = left.robots.get_mut(&script.robot) {
                on.leases.push(script.running);
            }
        }
        left
    }

    fn touch(&mut self, promise: &Touching<'_>) {
        for script in &promise.scripts {
            let (Ok(robot), Ok(device)) = (script.robot.parse::<RobotId>(), script.device.parse()) else {
                continue;
            };
            self.shifts.insert(robot.clone(), script.shift);
            self.touched.entry(robot).or_default().insert(device);
        }
    }

    /// Takes a line; what was promised is read whole only of acts that have not ended.
    fn take<'a>(&mut self, json: &'a [u8], under_way: &mut Vec<UnderWay<'a>>) {
        if is_promise(json) {
            let Ok(promise) = serde_json::from_slice::<Touching<'_>>(json) else { return };
            self.touch(&promise);
            self.stopping_since = None;
            return under_way.push((promise.number, json, Progressed::Prepared));
        }
        let Ok(head) = serde_json::from_slice::<Head>(json) else { return };
        let mut came_to = |reached| {
            let of_number = under_way.iter_mut().find(|(number, ..)| Some(*number) == head.number);
            of_number.into_iter().for_each(|(.., progressed)| *progressed = reached);
        };
        match head.record.as_str() {
            "decided" => {
                came_to(Progressed::Decided);
                self.unnamed.extend(head.unnamed);
            }
            "committed" => came_to(Progressed::Committed),
            "act_ended" => {
                let ended = head.report.map(|report| report.number);
                under_way.retain(|(number, ..)| Some(*number) != ended);
                if head.again {
                    // All robots have confirmed the stop of this attempt, and the mission goes on.
                    (self.stopping, self.stopping_since) = (None, None);
                    return;
                }
                self.ended_acts += 1;
                self.course.extend(serde_json::from_slice::<ActOver>(json));
                let Head { unaccounted, out_of_tolerance, steps_late, .. } = head;
                let flaws = ActFlaws { unaccounted, out_of_tolerance, steps_late };
                self.flaws.extend(Some(flaws).filter(|flaws| *flaws != ActFlaws::default()));
            }
            "act_skipped" => self.course.extend(serde_json::from_slice::<ActOver>(json)),
            "dropped" => {
                // What it confirmed before was another stop.
                self.stopped.retain(|robot| head.robot.as_ref() != Some(robot));
                self.dropped.extend(head.robot);
            }
            "stopping" => {
                self.stopping = Some(head.rest);
                self.stopping_since = self.stopping_since.or(head.at);
            }
            "stop_confirmed" => self.stopped.extend(head.robot),
            "ended" => self.outcome = head.outcome.or(Some(Value::Null)),
            _ => {}
        }
    }
}

/// A promise that has not ended: its number, its line, and how far it came.
type UnderWay<'a> = (u32, &'a [u8], Progressed);

/// Whether a line is a promise: its kind stands behind its time.
fn is_promise(json: &[u8]) -> bool {
    let begin = &json[..json.len().min(128)];
    let kind = br#","record":"prepared","#;
    begin.windows(kind.len()).any(|bytes| bytes == kind)
}
