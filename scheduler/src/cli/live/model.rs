//! The data of the live display. The mission's events update it, and the output thread reads it. The model reads no clock.

use std::collections::HashMap;
use std::sync::Arc;

use downbeat_scripts::shown::{shown, within};
use downbeat_scripts::{Choreography, DeviceScript, Wait};
use urrcp::{RobotId, Server, Span, Timestamp};

use crate::mission::{Preflight, Progress};

/// Maximum length of a robot's stored message, in columns.
const WORD_MAX: usize = 120;

/// The state of a mission, as far as its progress reports show.
#[derive(Debug)]
pub(super) struct Model {
    pub(super) choreography: Arc<Choreography>,
    pub(super) began: Timestamp<Server>,
    /// The current and the waiting acts, in the order in which they play.
    pub(super) acts: Vec<ShownAct>,
    pub(super) phase: Phase,
    pub(super) rows: Vec<Row>,
    index: HashMap<RobotId, usize>,
    /// The index of the act whose steps the rows show. `None` before the first act.
    planned: Option<usize>,
    /// The name of the act that moves the robots to their default positions after a stop. `None` if no such act is planned.
    home: Option<String>,
}

/// The phase of the whole mission.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// The mission connects to the robots and checks them.
    Greeting,
    /// The mission waits for acts, prepares them and plays them.
    Performing,
    /// The mission stops all robots, for the contained reason.
    Stopping(String),
}

/// An act that has not ended.
#[derive(Clone, Debug)]
pub(super) struct ShownAct {
    pub(super) name: String,
    /// The act's index in the choreography. `None` if the act is not part of the choreography.
    pub(super) index: Option<usize>,
    pub(super) stage: Stage,
}

#[derive(Clone, Debug)]
pub(super) enum Stage {
    Waiting {
        awaits: String,
        /// The time at which the wait ends. `None` if the act does not wait for a time.
        until: Option<Timestamp<Server>>,
        /// When the previous act ended. `None` while the previous act still plays.
        since: Option<Timestamp<Server>>,
        /// The latest reading of the sensor that the act waits for. `None` before the first report; `Some(None)` if the sensor has no
        /// reading.
        reading: Option<Option<f64>>,
    },
    Preparing {
        start: Timestamp<Server>,
    },
    Decided(Decided),
}

/// A decided start of an act.
#[derive(Clone, Copy, Debug)]
pub(super) struct Decided {
    pub(super) start: Timestamp<Server>,
    pub(super) duration: Span,
    pub(super) no_return: Timestamp<Server>,
    /// Whether the lease of every robot extends past the start of the act.
    pub(super) committed: bool,
}

/// The row of one robot in the display.
#[derive(Clone, Debug)]
pub(super) struct Row {
    pub(super) robot: String,
    pub(super) state: RobotState,
    /// Number of steps that the robot has reported as executed in the current act.
    pub(super) steps_done: u64,
    /// Whether the robot has started in the current act.
    begun: bool,
    /// Number of planned steps in the current act. 0 if the robot does not take part in the act.
    pub(super) steps_planned: u64,
    /// When each step of the robot's scripts is due, relative to the start of the act, in ascending order.
    due: Arc<[Span]>,
    pub(super) clock: String,
    pub(super) word: String,
    /// Whether the robot has confirmed its stop, even if it had failed before.
    pub(super) stop: Confirmed,
}

/// Whether a robot has confirmed its stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Confirmed {
    NotYet,
    Yes,
}

/// The state of a robot. The variants are ordered from the worst to the best.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum RobotState {
    Failed,
    LinkLost,
    /// The robot was ordered to stop, but has not confirmed it.
    Stopping,
    LeftOut,
    Playing,
    Accepted,
    Greeting,
    Ready,
    Ended,
    AtRest,
}

impl RobotState {
    pub(super) const fn text(self) -> &'static str {
        match self {
            Self::Failed => "FAILED",
            Self::LinkLost => "LINK LOST",
            Self::Stopping => "stopping",
            Self::LeftOut => "left out",
            Self::Playing => "playing",
            Self::Accepted => "accepted",
            Self::Greeting => "connecting",
            Self::Ready => "ready",
            Self::Ended => "ended",
            Self::AtRest => "at rest",
        }
    }

    /// Whether the robot no longer takes part in the mission.
    const fn is_out(self) -> bool {
        matches!(self, Self::Failed | Self::LeftOut)
    }
}

impl Model {
    pub(super) fn new(
        choreography: Arc<Choreography>,
        robots: impl IntoIterator<Item = RobotId>,
        began: Timestamp<Server>,
    ) -> Self {
        let robots: Vec<RobotId> = robots.into_iter().collect();
        let row = |robot: &RobotId| Row {
            robot: shown(robot.as_str()).into_owned(),
            state: RobotState::Greeting,
            steps_done: 0,
            begun: false,
            steps_planned: 0,
            due: Arc::default(),
            clock: "-".to_owned(),
            word: String::new(),
            stop: Confirmed::NotYet,
        };
        Self {
            choreography,
            began,
            acts: Vec::new(),
            phase: Phase::Greeting,
            rows: robots.iter().map(row).collect(),
            index: robots.into_iter().enumerate().map(|(index, robot)| (robot, index)).collect(),
            planned: None,
            home: None,
        }
    }

    /// Whether the current act moves robots to their default positions.
    pub(super) fn goes_home(&self) -> bool {
        self.home.is_some() && self.acts.first().map(|act| &act.name) == self.home.as_ref()
    }

    /// Whether an act waits for the operator, and no previous act plays.
    pub(super) fn awaits_go(&self) -> bool {
        self.acts.iter().any(|act| {
            let alone = matches!(act.stage, Stage::Waiting { since: Some(_), .. });
            alone && act.index.is_some_and(|index| self.choreography.acts[index].wait == Wait::Operator)
        })
    }

    pub(super) fn tell(&mut self, at: Timestamp<Server>, progress: &Progress) {
        match progress {
            Progress::Connected { .. } => self.rows.iter_mut().for_each(|row| row.be(RobotState::Ready)),
            Progress::Greeted { preflight, .. } => self.greeted(preflight),
            Progress::Waiting { act, awaits, at: until } => {
                let since = self.acts.iter().all(|shown| shown.is_waiting()).then_some(at);
                let awaits = shown(awaits).into_owned();
                self.set(act, Stage::Waiting { awaits, until: *until, since, reading: None });
            }
            Progress::Reading { act, value } => self.read(act, *value),
            Progress::Preparing { act, start, .. } => self.set(act, Stage::Preparing { start: *start }),
            Progress::Decided { act, start, duration, no_return, .. } => {
                let (start, duration, no_return) = (*start, *duration, *no_return);
                self.set(act, Stage::Decided(Decided { start, duration, no_return, committed: false }));
                self.take_over(act);
            }
            Progress::Committed { act, .. } => {
                let named = self.acts.iter_mut().find(|shown| shown.name == *act);
                if let Some(ShownAct { stage: Stage::Decided(decided), .. }) = named {
                    decided.committed = true;
                }
            }
            Progress::ActEnded { act }
            | Progress::ActSkipped { act, .. }
            | Progress::ActWithdrawn { act } => {
                self.ended(at, act);
            }
            Progress::GoingHome { act, choreography } => {
                self.home = Some(act.clone());
                self.choreography = Arc::clone(choreography);
            }
            Progress::Approaching { choreography, .. } => self.choreography = Arc::clone(choreography),
            Progress::Stopping { reason, .. } => {
                self.acts.retain(|act| !act.is_waiting());
                let again = matches!(self.phase, Phase::Stopping(_));
                self.phase = Phase::Stopping(shown(reason).into_owned());
                self.rows.iter_mut().filter(|row| again || !row.rests()).for_each(Row::stopping);
            }
            _ => self.tell_of_robot(progress),
        }
    }

    fn tell_of_robot(&mut self, progress: &Progress) {
        match progress {
            Progress::Accepted { robot } => self.say(robot, RobotState::Accepted, "accepted all"),
            Progress::Started { robot, error } => {
                let word =
                    error.map_or_else(|| "started".to_owned(), |error| format!("started {}", millis(error)));
                self.say(robot, RobotState::Playing, &word);
                if let Some(row) = self.row(robot) {
                    row.begun = true;
                }
            }
            Progress::Heard { robot, steps_done, clock_offset } => {
                if let Some(row) = self.row(robot) {
                    row.steps_done = row.steps_done.max((*steps_done).min(row.steps_planned));
                    if let Some(offset) = clock_offset {
                        row.clock = millis(*offset);
                    }
                }
            }
            Progress::Finished { robot, .. } => {
                if let Some(row) = self.row(robot) {
                    row.steps_done = row.steps_planned;
                }
                self.say(robot, RobotState::Ended, "ended all");
            }
            Progress::AtRest { robot } => {
                if let Some(row) = self.row(robot) {
                    row.stop = Confirmed::Yes;
                }
                // The reason for the failure is more useful than the fact that the robot is at rest.
                match self.row(robot).filter(|row| row.state.is_out()) {
                    Some(row) => row.word = format!("{}; {}", RobotState::AtRest.text(), row.word),
                    None => self.say(robot, RobotState::AtRest, "stop confirmed"),
                }
            }
            Progress::Failed(failure) => {
                self.say(&failure.robot, RobotState::Failed, &failure.kind.to_string());
            }
            Progress::LinkLost { robot, reason, .. } => self.say(robot, RobotState::LinkLost, reason),
            Progress::Reattached { robot } => self.say(robot, RobotState::Playing, "reconnected"),
            Progress::Dropped { robot } => {
                if let Some(row) = self.row(robot).filter(|row| row.state != RobotState::Failed) {
                    row.state = RobotState::LeftOut;
                }
            }
            _ => {}
        }
    }

    fn row(&mut self, robot: &RobotId) -> Option<&mut Row> {
        let index = *self.index.get(robot)?;
        self.rows.get_mut(index)
    }

    fn say(&mut self, robot: &RobotId, state: RobotState, word: &str) {
        let stopping = matches!(self.phase, Phase::Stopping(_));
        let Some(row) = self.row(robot) else { return };
        // A late message from a robot that is being stopped must not make it appear to play again.
        let late = stopping && matches!(state, RobotState::Playing | RobotState::Accepted);
        if !late && (!row.state.is_out() || state.is_out()) {
            row.state = state;
        }
        row.word = within(word, WORD_MAX).into_owned();
    }

    fn greeted(&mut self, preflight: &Preflight) {
        self.phase = Phase::Performing;
        for checked in &preflight.rows {
            let Some(row) = self.row(&checked.robot) else { continue };
            if let Some(offset) = checked.clock_offset {
                row.clock = millis(offset);
            }
            row.be(RobotState::Ready);
        }
    }

    /// Sets the stage of an act, and adds the act if necessary. Removes all other acts that are still waiting.
    fn set(&mut self, name: &str, stage: Stage) {
        self.phase = Phase::Performing;
        self.acts.retain(|act| act.name == name || !act.is_waiting());
        if let Some(act) = self.acts.iter_mut().rev().find(|act| act.name == name && !act.plays()) {
            act.stage = stage;
        } else {
            let index = self.choreography.acts.iter().position(|act| act.is_named(name));
            self.acts.push(ShownAct { name: name.to_owned(), index, stage });
        }
        self.plan_rows();
    }

    /// Updates the rows to the planned steps of the first act, unless that act still waits.
    fn plan_rows(&mut self) {
        let Some(front) = self.acts.first().filter(|act| !act.is_waiting()) else { return };
        if front.index.is_none() || front.index == self.planned {
            return;
        }
        self.planned = front.index;
        let choreography = Arc::clone(&self.choreography);
        for row in &mut self.rows {
            (row.steps_done, row.steps_planned, row.begun) = (0, 0, false);
        }
        for robot in self.planned.into_iter().flat_map(|index| &choreography.acts[index].plan.robots) {
            let script_steps = |script: &DeviceScript| {
                let start = script.start.span();
                script.script.steps().iter().map(|step| start + step.offset.span()).collect::<Vec<_>>()
            };
            let mut due: Vec<Span> = robot.scripts.iter().flat_map(script_steps).collect();
            due.sort_unstable();
            if let Some(row) = self.row(&robot.robot) {
                (row.steps_planned, row.due) = (due.len() as u64, due.into());
            }
        }
    }

    /// Shows the act's robots as `accepted` when the start of the act is decided. If the previous act still plays, the rows change only
    /// when that act has ended.
    fn take_over(&mut self, name: &str) {
        if self.acts.first().is_some_and(|act| act.name == name) {
            for row in self.rows.iter_mut().filter(|row| row.steps_planned > 0) {
                row.be(RobotState::Accepted);
            }
        }
    }

    fn read(&mut self, name: &str, value: Option<f64>) {
        for act in self.acts.iter_mut().filter(|act| act.name == name) {
            if let Stage::Waiting { reading, .. } = &mut act.stage {
                *reading = Some(value);
            }
        }
    }

    fn ended(&mut self, at: Timestamp<Server>, name: &str) {
        let Some(place) = self.acts.iter().position(|act| act.name == name) else { return };
        self.acts.remove(place);
        if place == 0 {
            // The same act may be played again.
            self.planned = None;
        }
        if let Some(ShownAct { stage: Stage::Waiting { since, .. }, .. }) = self.acts.first_mut() {
            since.get_or_insert(at);
        }
        if !matches!(self.phase, Phase::Stopping(_)) {
            self.plan_rows();
        }
    }
}

impl ShownAct {
    pub(super) const fn is_waiting(&self) -> bool {
        matches!(self.stage, Stage::Waiting { .. })
    }

    const fn plays(&self) -> bool {
        matches!(self.stage, Stage::Decided(_))
    }
}

/// Formats a time in milliseconds with two decimals, so that the digits of a column stay aligned.
fn millis(span: Span) -> String {
    format!("{:+.2} ms", span.as_millis_f64())
}

impl Row {
    /// Returns the number of steps that the robot has reported, or that it should have executed according to the plan, whichever is
    /// larger.
    pub(super) fn steps_by(&self, played: Span) -> u64 {
        let due = self.due.partition_point(|due| *due <= played);
        self.steps_done.max(due as u64)
    }

    /// Whether the robot may have executed more steps than it has reported. Robots report their steps at the end of a script.
    pub(super) fn may_have_done_more(&self) -> bool {
        let open = matches!(self.state, RobotState::Failed | RobotState::LinkLost | RobotState::Stopping);
        let silent = self.state == RobotState::AtRest && self.steps_done == 0;
        self.begun && (open || silent)
    }

    fn be(&mut self, state: RobotState) {
        if !self.state.is_out() {
            self.state = state;
        }
    }

    const fn rests(&self) -> bool {
        matches!(self.state, RobotState::AtRest)
    }

    fn stopping(&mut self) {
        let moves = matches!(self.state, RobotState::Playing | RobotState::Accepted | RobotState::LinkLost);
        if moves || self.rests() {
            self.state = RobotState::Stopping;
        }
    }
}
