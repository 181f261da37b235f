//! The stages of a mission. Determines at which stages faults occurred.

use std::fmt;

use urrcp::{Server, Span, Timestamp};

use super::{Fault, FaultKind, Hands, Happened, Ran};
use downbeat_mission::{ActNumber, Progress, Record};

/// A stage of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Robots are greeted (connected and described): no act has been sent yet, and none waits.
    Greeting,
    /// An act waits for the operator, a sensor or a time, and no act plays.
    Waits,
    /// An act has been promised and sent.
    Prepared,
    /// All robots have accepted the act.
    Decided,
    /// The commitment of the act has been recorded.
    Committed,
    /// The act plays.
    Plays,
    /// The act plays, and the next one has been promised.
    PlaysNext,
    /// All robots are being stopped.
    Stops,
    /// An act that was planned after a stop has been promised, or plays.
    Transfers,
    /// The scheduler's process has ended, and no other process has resumed the mission yet.
    Abandoned,
    /// Another process has resumed the mission, and has recorded nothing yet.
    Resumed,
    /// The mission has ended.
    Ended,
}

impl Stage {
    /// All stages.
    pub const ALL: [Self; 12] = [
        Self::Greeting,
        Self::Waits,
        Self::Prepared,
        Self::Decided,
        Self::Committed,
        Self::Plays,
        Self::PlaysNext,
        Self::Stops,
        Self::Transfers,
        Self::Abandoned,
        Self::Resumed,
        Self::Ended,
    ];

    /// Whether a fault of kind `kind` can occur at this stage. While no scheduler process runs, none can end, stall or receive the
    /// operator's commands. A mission that has ended needs neither its disk nor its machine's clock, and has no journal through which it
    /// could be stopped. A mission plans no act after a stop if a robot does not state its positions, for example a robot with separate
    /// hardware.
    #[must_use]
    pub const fn meets(self, kind: FaultKind) -> bool {
        use FaultKind::{
            DiskStalls, HardwareDies, Home, SchedulerCrash, SchedulerCrashAmid, SchedulerPause,
            SchedulerPauseAmid, ServerClockStep, Stop, StopByJournal,
        };
        let of_process = matches!(
            kind,
            SchedulerCrash | SchedulerCrashAmid | SchedulerPause | SchedulerPauseAmid | Stop | Home
        );
        match self {
            Self::Abandoned => !of_process,
            Self::Transfers => !matches!(kind, HardwareDies),
            Self::Ended => !(of_process || matches!(kind, DiskStalls | ServerClockStep | StopByJournal)),
            _ => true,
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Greeting => "greets",
            Self::Waits => "waits",
            Self::Prepared => "prepared",
            Self::Decided => "decided",
            Self::Committed => "committed",
            Self::Plays => "plays",
            Self::PlaysNext => "and next",
            Self::Stops => "stops",
            Self::Transfers => "transfers",
            Self::Abandoned => "abandoned",
            Self::Resumed => "resumed",
            Self::Ended => "ended",
        })
    }
}

/// An act that has been promised (recorded before it is sent) and has not ended.
struct Open {
    number: ActNumber,
    start: Timestamp<Server>,
    decided: bool,
    committed: bool,
    after_stop: bool,
}

#[derive(Default)]
struct Mission {
    open: Vec<Open>,
    has_sent: bool,
    waits: bool,
    stops: bool,
    /// Whether the act that will be promised next was planned after a stop.
    is_planned: bool,
    is_abandoned: bool,
    is_resumed: bool,
    has_ended: bool,
}

impl Mission {
    fn record(&mut self, record: &Record) {
        self.is_resumed &= matches!(record, Record::Begun);
        match record {
            Record::Prepared(promise) => {
                (self.has_sent, self.waits, self.stops) = (true, false, false);
                let after_stop = std::mem::take(&mut self.is_planned);
                let (number, start) = (promise.number, promise.start);
                self.open.push(Open { number, start, decided: false, committed: false, after_stop });
            }
            Record::Decided { number, .. } => self.of(*number, |act| act.decided = true),
            Record::Committed { number } => self.of(*number, |act| act.committed = true),
            Record::ActEnded { report, .. } => self.open.retain(|act| act.number != report.number),
            Record::Stopping { .. } => {
                self.stops = true;
                self.open.clear();
            }
            Record::Ended { .. } => self.has_ended = true,
            _ => {}
        }
    }

    fn of(&mut self, number: ActNumber, change: impl Fn(&mut Open)) {
        self.open.iter_mut().filter(|act| act.number == number).for_each(change);
    }

    fn happen(&mut self, happened: &Happened) {
        match happened {
            Happened::Fault(Fault::SchedulerCrash { .. } | Fault::SchedulerCrashAmid { .. }) => {
                self.is_abandoned = true;
            }
            Happened::TakenUp(how) => {
                (self.is_abandoned, self.is_resumed) = (false, true);
                self.stops |= *how == "withdrawn";
            }
            Happened::Told(progress) => match &**progress {
                Progress::Waiting { .. } => self.waits = true,
                Progress::ActSkipped { .. } => self.waits = false,
                Progress::GoingHome { .. } | Progress::Approaching { .. } => self.is_planned = true,
                _ => {}
            },
            _ => {}
        }
    }

    fn stage(&self, at: Timestamp<Server>) -> Stage {
        let plays = |act: &&Open| act.committed && act.start <= at;
        let next = self.open.iter().rfind(|act| !plays(act));
        let plays = self.open.iter().any(|act| plays(&act));
        match next {
            _ if self.has_ended => Stage::Ended,
            _ if self.is_abandoned => Stage::Abandoned,
            _ if self.is_resumed => Stage::Resumed,
            _ if self.stops => Stage::Stops,
            _ if self.open.iter().any(|act| act.after_stop) => Stage::Transfers,
            Some(_) if plays => Stage::PlaysNext,
            None if plays => Stage::Plays,
            Some(next) if next.committed => Stage::Committed,
            Some(next) if next.decided => Stage::Decided,
            Some(_) => Stage::Prepared,
            None if self.waits || self.has_sent => Stage::Waits,
            None => Stage::Greeting,
        }
    }
}

/// The instants at which a mission reached its stages, in order.
pub(super) fn stages(ran: &Ran) -> Vec<(Timestamp<Server>, Stage)> {
    enum Change<'a> {
        Record(&'a Record),
        Happened(&'a Happened),
        Start,
    }
    // At one instant, reports come first: an act that was planned after a stop is reported and promised at once.
    let history = ran.history.iter().map(|(at, happened)| (*at, Change::Happened(happened)));
    let mut changes: Vec<(Timestamp<Server>, Change<'_>)> = history.collect();
    for (at, record) in &ran.records {
        changes.push((*at, Change::Record(record)));
        if let Record::Prepared(promise) = record {
            changes.push((promise.start, Change::Start));
        }
    }
    changes.sort_by_key(|(at, _)| *at);
    let mut mission = Mission::default();
    let mut stages: Vec<(Timestamp<Server>, Stage)> = Vec::new();
    for (at, change) in changes {
        match change {
            Change::Record(record) => mission.record(record),
            Change::Happened(happened) => mission.happen(happened),
            Change::Start => {}
        }
        let stage = mission.stage(at);
        if stages.last().is_none_or(|(_, last)| *last != stage) {
            stages.push((at, stage));
        }
    }
    stages
}

/// Assumed duration of the last stage of a run, because no other stage ends it.
const LASTS_AFTER_END: Span = Span::from_millis(2_000);

/// Returns the intervals in which a mission was at a stage.
pub(super) fn intervals(ran: &Ran, stage: Stage) -> Vec<(Timestamp<Server>, Timestamp<Server>)> {
    let stages = stages(ran);
    let until = |index: usize| stages.get(index + 1).map(|(until, _)| *until);
    let of_stage = stages.iter().enumerate().filter(|(_, (_, of))| *of == stage);
    of_stage.map(|(index, (from, _))| (*from, until(index).unwrap_or(*from + LASTS_AFTER_END))).collect()
}

/// Returns the faults of a run, each with the stage at which it occurred. Omits the death of hardware if the robot has no separate
/// hardware.
#[must_use]
pub fn faults_met(ran: &Ran) -> Vec<(FaultKind, Stage)> {
    let faults = ran.history.iter().filter_map(|(at, happened)| match happened {
        Happened::Fault(Fault::HardwareDies { robot, .. })
            if ran.drawn.robots[*robot].hands == Hands::Own =>
        {
            None
        }
        Happened::Fault(fault) => Some((*at, FaultKind::from(fault))),
        _ => None,
    });
    let stages = stages(ran);
    let before = |at: Timestamp<Server>| {
        let index = stages.partition_point(|(from, _)| *from < at);
        index.checked_sub(1).map_or(Stage::Greeting, |index| stages[index].1)
    };
    faults.map(|(at, kind)| (kind, before(at))).collect()
}
