//! The robots' processes: which run, which stall, and which is due next.

use std::collections::BTreeSet;

use downbeat_robot::simulated::{SimulatedRobot, True};
use urrcp::{Server, Timestamp};

use super::Agenda;

/// A time before every wake-up. A process that is due even at this time is due at every event. An example is a process that polls silent
/// hardware.
const NEVER: Timestamp<True> = Timestamp::from_nanos(i64::MIN);

/// The processes of the robots in a world, by robot index.
#[derive(Debug)]
pub struct Processes {
    processes: Vec<Process>,
    /// The robots, ordered by the times at which they are due. An entry is outdated if its time differs from the process's `due`.
    agenda: Agenda<usize>,
    /// Robots that are due at every event.
    restless: BTreeSet<usize>,
}

#[derive(Debug)]
struct Process {
    /// The state machine of the robot; `None` if no process runs.
    machine: Option<SimulatedRobot>,
    stalls_until: Timestamp<Server>,
    due: Option<Timestamp<Server>>,
}

impl Processes {
    /// Creates the processes, none of which stalls. A `None` in `machines` is a robot without a running process.
    pub fn new(machines: impl IntoIterator<Item = Option<SimulatedRobot>>, begin: Timestamp<Server>) -> Self {
        let machines = machines.into_iter();
        let processes = machines.map(|machine| Process { machine, stalls_until: begin, due: None }).collect();
        let mut processes = Self { processes, agenda: Agenda::default(), restless: BTreeSet::new() };
        (0..processes.processes.len()).for_each(|robot| processes.note_due(robot));
        processes
    }

    /// Returns the state machine of a robot's process; `None` if the process does not run.
    #[must_use]
    pub fn get(&self, robot: usize) -> Option<&SimulatedRobot> {
        self.processes[robot].machine.as_ref()
    }

    /// Calls `change` with the state machine of a robot's process, and returns the result; `None` if the process does not run.
    pub fn change<R>(&mut self, robot: usize, change: impl FnOnce(&mut SimulatedRobot) -> R) -> Option<R> {
        let result = change(self.processes[robot].machine.as_mut()?);
        self.note_due(robot);
        Some(result)
    }

    /// Starts a robot's process, which replaces an older process of the same robot.
    pub fn begin(&mut self, robot: usize, machine: SimulatedRobot) {
        self.processes[robot].machine = Some(machine);
        self.note_due(robot);
    }

    /// Ends a robot's process. Returns its state machine if the process ran.
    pub fn end(&mut self, robot: usize) -> Option<SimulatedRobot> {
        let machine = self.processes[robot].machine.take();
        self.note_due(robot);
        machine
    }

    /// Stalls a robot's process until the time `until`, even if the process restarts in the meantime. Does not shorten an earlier stall.
    pub fn stall(&mut self, robot: usize, until: Timestamp<Server>) {
        let stalls_until = &mut self.processes[robot].stalls_until;
        *stalls_until = until.max(*stalls_until);
        self.note_due(robot);
    }

    /// Returns when the stall of a robot's process ends; `None` if the process does not stall at `now`.
    #[must_use]
    pub fn stalls_until(&self, robot: usize, now: Timestamp<Server>) -> Option<Timestamp<Server>> {
        Some(self.processes[robot].stalls_until).filter(|until| now < *until)
    }

    /// Returns when the next process is due; `None` if none is.
    pub fn next_instant(&mut self) -> Option<Timestamp<Server>> {
        loop {
            let (at, robot) = self.agenda.peek()?;
            if self.processes[*robot].due == Some(at) {
                return Some(at);
            }
            self.agenda.pop_due(at);
        }
    }

    /// Removes and returns the robots that are due now, in order.
    pub fn take_due(&mut self, now: Timestamp<Server>) -> Vec<usize> {
        let awake = |robot: &usize| self.stalls_until(*robot, now).is_none();
        let mut robots: Vec<usize> = self.restless.iter().copied().filter(awake).collect();
        while self.next_instant().is_some_and(|at| at <= now)
            && let Some(robot) = self.agenda.pop_due(now)
        {
            self.processes[robot].due = None;
            robots.push(robot);
        }
        robots.sort_unstable();
        robots.dedup();
        robots
    }

    fn note_due(&mut self, robot: usize) {
        let Process { machine, stalls_until, due } = &mut self.processes[robot];
        let machine = machine.as_ref();
        let next = machine.and_then(SimulatedRobot::next_wakeup).map(Timestamp::assume_clock);
        let next = next.map(|at: Timestamp<Server>| at.max(*stalls_until));
        if std::mem::replace(due, next) != next
            && let Some(at) = next
        {
            self.agenda.put(at, robot);
        }
        if machine.is_some_and(|machine| machine.is_due(NEVER)) {
            self.restless.insert(robot);
        } else {
            self.restless.remove(&robot);
        }
    }
}
