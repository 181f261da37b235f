//! The state of a mission, as restored from the records in its journal.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet, HashMap};

use serde::Deserialize;
use urrcp::{DeviceId, Millis, RequestId, RobotId, Server, Span, Timestamp};

use super::lines::{begins_with, sound, whole_length};
use super::record::{ActFlaws, ActOver, ENDED_ACT, EndedAct, Promise, Record};
use super::{ActFate, ActNumber, Cause, Failure, Outcome, Rest};

/// The state of a mission, as restored from the records in its journal.
#[derive(Clone, Debug, Default)]
pub struct Kept {
    /// Acts that were promised to robots and have not ended, in order, each with its progress.
    pub promises: Vec<(Promise, Progressed)>,
    /// Number of acts that have ended. Attempts that were withdrawn and repeated do not count.
    pub ended_acts: u32,
    /// The fates of the acts that are over, in order.
    pub course: Vec<ActOver>,
    /// The flaws of the ended acts, which rule out the outcome `done`.
    pub flaws: Vec<ActFlaws>,
    /// The failures of robots, in order.
    pub failures: Vec<Failure>,
    /// Robots that were left out.
    pub dropped: Vec<RobotId>,
    /// Robots that do not recognize requests by their ids.
    pub unnamed: Vec<RobotId>,
    /// The latest stop of all robots; `None` if there was none, or if it only withdrew an attempt that was then repeated.
    pub stopping: Option<Stopping>,
    /// The time at which the first stop after the latest promise of an act was sent; `None` if none was. No lease has been renewed since
    /// then.
    pub stopping_since: Option<Timestamp<Server>>,
    /// Robots that have confirmed their stop.
    pub stopped: Vec<RobotId>,
    /// The outcome of the mission; `None` if the mission was cut off.
    pub outcome: Option<Outcome>,
    /// The records from the first incomplete line on; `None` if all lines are complete.
    pub torn: Option<Torn>,
    /// Every robot to which anything was ever sent, with the devices to which it was sent.
    pub touched: BTreeMap<RobotId, BTreeSet<DeviceId>>,
    /// The interval of doubt before the start that was stated at the decision of each act, by the act's number.
    pub(crate) doubts: HashMap<ActNumber, Span>,
    /// For each robot: the latest offset by which timestamps were converted to its clock.
    shifts: BTreeMap<RobotId, Span>,
    /// For each script that was sent with a clock offset other than its promise states: that offset, by request id.
    translated: HashMap<RequestId, Span>,
    /// Length of the complete lines at the beginning of the journal, in bytes.
    whole: usize,
}

/// A stop that the mission was sending to its robots.
#[derive(Clone, Debug, PartialEq)]
pub struct Stopping {
    /// The outcome that the mission would have had after the stop.
    pub outcome: Outcome,
    /// How the stop brings robots to rest.
    pub rest: Rest,
}

/// The remains of a mission on its robots, which another process withdraws.
#[derive(Clone, Debug, Default)]
pub struct Left {
    /// The robots to which anything was sent.
    pub robots: BTreeMap<RobotId, LeftOn>,
    /// The ids by which robots identify themselves, if these differ from their ids in the fleet file.
    pub own_ids: BTreeMap<RobotId, RobotId>,
    /// The instant after which no lease was renewed; `None` if leases may have been renewed until now.
    pub renewed_until: Option<Timestamp<Server>>,
    /// Whether robots may have moved in the mission.
    pub moved: bool,
    /// The failures of robots.
    pub failures: Vec<Failure>,
}

/// The remains of a mission on one robot.
#[derive(Clone, Debug, Default)]
pub struct LeftOn {
    /// The devices to which anything was sent.
    pub devices: BTreeSet<DeviceId>,
    /// The offset that converts timestamps to the robot's clock.
    pub shift: Span,
    /// The running leases of scripts whose acts have not ended; `None` for a script that continues without a link.
    pub leases: Vec<Option<Millis>>,
}

/// How far an act that was promised has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progressed {
    /// The act's requests were sent, or were about to be.
    Prepared,
    /// All robots had accepted the act.
    Decided,
    /// Leases were extended beyond the act's start, or were about to be.
    Committed,
}

/// A part of the journal that begins with a line that was cut off or changed. The contents of this line and of the following ones are
/// unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Torn {
    /// The number of the first damaged line, counted from 1.
    pub line: usize,
    /// Number of bytes from the damaged line to the end of the journal.
    pub bytes: usize,
    /// Number of complete lines after the damaged one. If there are any, the file was damaged, not only cut off.
    pub whole_after: usize,
}

/// A record in a line of the journal, with its time.
#[derive(Deserialize)]
struct Dated {
    at: Timestamp<Server>,
    #[serde(flatten)]
    record: Record,
}

/// The only field of an act's report that is read here. The other fields, which fill most of a long journal, are skipped.
#[derive(Deserialize)]
struct Numbered {
    number: ActNumber,
}

/// The fields of a promise that are needed to stop its robots.
#[derive(Deserialize)]
struct Touching<'a> {
    number: ActNumber,
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

/// What `resume` does with a mission that was cut off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// `resume` plays the mission to its end, because the promised acts were decided.
    Resume,
    /// `resume` withdraws the promised acts. Contains the reason.
    Withdraw(&'static str),
}

impl Kept {
    /// Reads the state from the bytes of a journal. Lines that are not records, such as the first one, are ignored.
    #[must_use]
    pub fn of_bytes(bytes: &[u8]) -> Self {
        let (believed, rest) = bytes.split_at(whole_length(bytes));
        let (mut kept, mut under_way, mut count) = (Self::default(), Vec::new(), 0);
        kept.whole = believed.len();
        for json in believed.split_inclusive(|byte| *byte == b'\n').filter_map(sound) {
            kept.take(json, &mut under_way);
            count += 1;
        }
        let promise = |(_, json, progressed)| Some((kept.promise(json)?, progressed));
        kept.promises = under_way.into_iter().filter_map(promise).collect();
        if !rest.is_empty() {
            let after: Vec<_> = rest.split_inclusive(|byte| *byte == b'\n').filter_map(sound).collect();
            // Of the records after the damage, only the promises are used: their robots may hold scripts.
            let promises = after.iter().filter_map(|json| serde_json::from_slice::<Touching<'_>>(json).ok());
            promises.for_each(|promise| kept.touch(&promise));
            kept.torn = Some(Torn { line: count + 1, bytes: rest.len(), whole_after: after.len() });
        }
        kept
    }

    /// Returns the length of the complete lines at the beginning of the journal, in bytes.
    #[must_use]
    pub const fn whole(&self) -> usize {
        self.whole
    }

    /// What `resume` does with the mission, if the mission was cut off after these records.
    #[must_use]
    pub fn fate(&self) -> Fate {
        if self.stopping.is_some() {
            return Fate::Withdraw("the mission was being stopped");
        }
        if self.torn.is_some_and(|torn| torn.whole_after > 0) {
            return Fate::Withdraw("its journal is damaged");
        }
        if self.promises.iter().any(|(_, progressed)| *progressed == Progressed::Prepared) {
            return Fate::Withdraw("an act was sent, but its start was not decided");
        }
        if self.promises.is_empty() { Fate::Withdraw("no act was under way") } else { Fate::Resume }
    }

    /// Returns the outcome of the mission if `resume` withdraws it, and the reason for users. If a stop was being sent, the outcome is
    /// that of the stop, otherwise a failure. `why` is the reason of [`Fate::Withdraw`].
    #[must_use]
    pub fn ending(&self, why: &str) -> Cause {
        let outcome = self.stopping.as_ref().map_or(Outcome::Failed, |stopping| stopping.outcome.clone());
        let reason = match outcome {
            Outcome::Stopped => outcome.to_string(),
            _ => format!("the process of the mission died: {why}"),
        };
        Cause { outcome, reason }
    }

    /// Whether robots may have moved. Only an act whose commitment is on disk can start, but damage to the journal may hide a commitment.
    fn may_have_moved(&self) -> bool {
        let in_act =
            |over: &ActOver| matches!(over.fate, ActFate::Played | ActFate::Stopped | ActFate::Unknown);
        self.course.iter().any(in_act)
            || self.promises.iter().any(|(_, progressed)| *progressed == Progressed::Committed)
            || self.torn.is_some_and(|torn| torn.whole_after > 0)
    }

    /// Returns the remains of the mission on its robots.
    #[must_use]
    pub fn left(&self) -> Left {
        let mut left = Left {
            renewed_until: self.stopping_since,
            moved: self.may_have_moved(),
            failures: self.failures.clone(),
            ..Left::default()
        };
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

    /// Parses a promise, and replaces the offsets of its scripts with those that were actually sent.
    fn promise(&self, json: &[u8]) -> Option<Promise> {
        let mut promise: Promise = serde_json::from_slice(json).ok()?;
        for script in &mut promise.scripts {
            script.shift = self.translated.get(&script.request_id).copied().unwrap_or(script.shift);
        }
        Some(promise)
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

    /// Processes a line of the journal. A promise is parsed in full only later, if its act has not ended.
    fn take<'a>(&mut self, json: &'a [u8], under_way: &mut Vec<UnderWay<'a>>) {
        if is_promise(json) {
            let Ok(promise) = serde_json::from_slice::<Touching<'_>>(json) else { return };
            self.touch(&promise);
            self.stopping_since = None;
            return under_way.push((promise.number, json, Progressed::Prepared));
        }
        if begins_with(json, ENDED_ACT) {
            let Ok(ended) = serde_json::from_slice::<EndedAct<Numbered>>(json) else { return };
            under_way.retain(|(number, ..)| *number != ended.report.number);
            return self.act_ended(ended);
        }
        let Ok(Dated { at, record }) = serde_json::from_slice(json) else { return };
        let mut came_to = |reached, act: ActNumber| {
            let of_number = under_way.iter_mut().find(|(number, ..)| *number == act);
            of_number.into_iter().for_each(|(.., progressed)| *progressed = reached);
        };
        match record {
            Record::Decided { number, unnamed, doubt } => {
                came_to(Progressed::Decided, number);
                self.doubts.insert(number, doubt);
                self.unnamed.extend(unnamed);
            }
            Record::Committed { number } => came_to(Progressed::Committed, number),
            // The robots of a lapsing act drop it. If another act continues to play, the lapsing act is prepared again after that one has
            // ended.
            Record::Lapsing { number } => came_to(Progressed::Prepared, number),
            Record::ActSkipped(over) => self.course.push(over),
            Record::Failed(failure) => self.failures.push(failure),
            Record::Dropped { robot } => {
                // An earlier confirmation belongs to an earlier stop.
                self.stopped.retain(|stopped| *stopped != robot);
                self.dropped.push(robot);
            }
            Record::Stopping { outcome, rest, .. } => {
                self.stopping = Some(Stopping { outcome, rest });
                self.stopping_since = self.stopping_since.or(Some(at));
            }
            Record::Translated { request_id, shift } => {
                self.translated.insert(request_id, shift);
            }
            Record::StopConfirmed { robot } => self.stopped.push(robot),
            Record::Ended { outcome } => self.outcome = Some(outcome),
            Record::Begun
            | Record::Checked
            | Record::Go { .. }
            | Record::Prepared(_)
            | Record::ActEnded { .. } => {}
        }
    }

    fn act_ended(&mut self, ended: EndedAct<Numbered>) {
        if ended.again {
            // All robots have confirmed the stop of this attempt, and the mission continues.
            (self.stopping, self.stopping_since) = (None, None);
            return;
        }
        self.ended_acts += 1;
        self.course.push(ended.over);
        self.flaws.extend(Some(ended.flaws).filter(|flaws| *flaws != ActFlaws::default()));
    }
}

/// A promise whose act has not ended: the act's number, the line of the promise, and the act's progress.
type UnderWay<'a> = (ActNumber, &'a [u8], Progressed);

fn is_promise(json: &[u8]) -> bool {
    begins_with(json, br#","record":"prepared","#)
}
