//! Plays a mission with real processes, causes the faults that were chosen at random, and records all messages and actions.

use std::path::Path;
use std::sync::Mutex;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use downbeat_robot::set_log::LogEntry;
use downbeat_scripts::{Choreography, Folder, Source, compile, read_fleet};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process, waitid};
use serde_json::Value;

use super::draw::{Back, Drawn, Fault, Strike, Then, When};
use stage::{Ended, Logged, Running, Stage, Via, epoch_nanos, nanos, sleep_until};

/// Time that a program may take beyond the planned duration of the mission.
const SLACK: Duration = Duration::from_secs(25);
/// Maximum wait, from the start of the mission, until the scheduler promises an act.
const COMES: Duration = Duration::from_secs(15);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Run,
    Resume,
    Stop,
}

/// A program that was started, and its result.
#[derive(Clone)]
pub struct Told {
    pub kind: Kind,
    pub began: i64,
    /// Time at which the process ended, by the host's clock, in nanoseconds.
    pub gone: i64,
    /// Result of the process; if it hung, the output until then.
    pub ended: Result<Ended, String>,
}

impl Told {
    /// Returns the program's report about the robots; `None` if it printed none.
    pub fn report(&self) -> Option<Value> {
        let said: Value = serde_json::from_str(&self.ended.as_ref().ok()?.out).ok()?;
        Some(said).filter(|said| said["robots"].is_array())
    }

    pub fn code(&self) -> Option<i32> {
        self.ended.as_ref().ok().and_then(|ended| ended.code)
    }
}

/// A fault that occurred, its target, and its period.
#[derive(Clone, Debug)]
pub struct Struck {
    /// The faulty robot; `None` if the scheduler was faulty.
    pub robot: Option<usize>,
    pub what: What,
    pub from: i64,
    /// End of the fault, in nanoseconds; `i64::MAX` if it is permanent.
    pub until: i64,
}

#[derive(Clone, Copy, Debug)]
pub enum What {
    Robot(Fault),
    SchedulerFrozen,
    SchedulerKilled,
}

#[derive(Clone)]
pub struct Played {
    pub drawn: Drawn,
    pub struck: Vec<Struck>,
    pub told: Vec<Told>,
    /// For each robot, the values of scripts that it set.
    pub sets: Vec<Vec<Logged>>,
    /// Number of values that robots with other ids set at the addresses of the mission's robots.
    pub strangers: usize,
    /// For each robot, the log of each of its processes.
    pub logs: Vec<Vec<Vec<LogEntry>>>,
    pub journal: Vec<(i64, Value)>,
    pub choreography: Choreography,
    /// Time of the first command that requested the default state, in nanoseconds; `None` if there was none.
    pub home_from: Option<i64>,
}

/// A running program. Only this owner reaps the process, so the operating system does not reuse its id.
struct Program {
    kind: Kind,
    began: i64,
    running: Running,
    gone: JoinHandle<i64>,
}

impl Program {
    fn start(kind: Kind, stage: &Stage, drawn: &Drawn, args: &[&str]) -> Self {
        let began = epoch_nanos();
        let patience = format!("{}ms", drawn.patience_ms);
        let running = stage.start(&[args, &["--format", "json", "--patience", &patience]].concat());
        let pid = Pid::from_child(&running.process.0);
        let gone = std::thread::spawn(move || {
            let _status = waitid(WaitId::Pid(pid), WaitIdOptions::EXITED | WaitIdOptions::NOWAIT);
            epoch_nanos()
        });
        Self { kind, began, running, gone }
    }

    fn told(self, bound: Duration) -> Told {
        let ended = self.running.ended_within(bound);
        Told { kind: self.kind, began: self.began, gone: self.gone.join().unwrap(), ended }
    }
}

/// The state that the threads of one mission share.
struct Show<'a> {
    drawn: &'a Drawn,
    stage: Mutex<Stage>,
    /// The programs, in the order in which they were started.
    programs: Mutex<Vec<Program>>,
    struck: Mutex<Vec<Struck>>,
    home_from: Mutex<Option<i64>>,
    scheduler: Pid,
    began: Instant,
    state: std::path::PathBuf,
}

pub fn play(drawn: Drawn) -> Played {
    let mut stage = Stage::new();
    stage.file("chaos.yaml", drawn.scenario());
    for robot in 0..drawn.robots() {
        let (args, keys) = drawn.setup(robot, false);
        let init = format!("robot-{robot}.yaml");
        stage.file(&init, drawn.init(robot));
        stage.robot_with(&init, Via::Proxy, args, keys);
        let link = stage.robots[robot].link.as_ref().unwrap();
        if !drawn.tells[robot].answers_inquiries() && link.reads() {
            link.leave_out(&["inquiry"]);
        }
    }
    let began = Instant::now();
    let run = Program::start(Kind::Run, &stage, &drawn, &["run", "chaos.yaml"]);
    let scheduler = Pid::from_child(&run.running.process.0);
    let state = stage.path("state");
    let mut show = Show {
        drawn: &drawn,
        stage: Mutex::new(stage),
        programs: Mutex::new(vec![run]),
        struck: Mutex::new(Vec::new()),
        home_from: Mutex::new(None),
        scheduler,
        began,
        state,
    };
    std::thread::scope(|scope| {
        for (when, strike) in &drawn.strikes {
            let show = &show;
            scope.spawn(move || {
                if show.awaits(*when) {
                    show.strike(*strike);
                }
            });
        }
    });
    let bound = Duration::from_millis(drawn.plays_ms() as u64) + SLACK;
    let programs = std::mem::take(show.programs.get_mut().unwrap());
    let told: Vec<Told> = programs.into_iter().map(|program| program.told(bound)).collect();
    show.end_all_faults();
    // After this, every lease has ended.
    std::thread::sleep(Duration::from_millis(drawn.lease_ms + 300));
    let stage = show.stage.into_inner().unwrap();
    let (mut sets, mut strangers, mut logs) = (Vec::new(), 0, Vec::new());
    for robot in &stage.robots {
        let (own, foreign): (Vec<_>, Vec<_>) =
            robot.sets().into_iter().partition(|set| set.robot == robot.id);
        sets.push(own);
        strangers += foreign.len();
        let entries =
            |text: String| text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        logs.push(robot.logs().map(entries).collect());
    }
    let journal = journal(&show.state);
    let struck = show.struck.into_inner().unwrap();
    let home_from = show.home_from.into_inner().unwrap();
    let choreography = compiled(&stage);
    Played { drawn, struck, told, sets, strangers, logs, journal, choreography, home_from }
}

fn compiled(stage: &Stage) -> Choreography {
    let (fleet, findings) = read_fleet(&stage.path("fleet.yaml"));
    let fleet = fleet.unwrap_or_else(|| panic!("{findings:?}"));
    let source = Source::read(&stage.path("chaos.yaml")).unwrap();
    let compiled = compile(&source, &fleet, &Folder::new(stage.path("")));
    compiled.choreography.unwrap_or_else(|| panic!("{:?}", compiled.findings))
}

impl Show<'_> {
    /// Waits for a moment; returns `false` if it does not occur.
    fn awaits(&self, when: When) -> bool {
        match when {
            When::After(after) => std::thread::sleep(after.saturating_sub(self.began.elapsed())),
            When::Before { act, millis } => {
                let Some(start) = self.start_of(act) else { return false };
                sleep_until(start - millis * 1_000_000);
            }
        }
        true
    }

    /// Waits until the scheduler promises an act, and returns the act's start in nanoseconds. `None` if the mission ends without this
    /// promise, or after `COMES`.
    fn start_of(&self, act: usize) -> Option<i64> {
        while self.began.elapsed() < COMES {
            let journal = journal(&self.state);
            let of_act =
                |(_, record): &&(i64, Value)| record["record"] == "prepared" && record["number"] == act;
            if let Some((_, promise)) = journal.iter().find(of_act) {
                return promise["start"].as_str().map(nanos);
            }
            if journal.iter().any(|(_, record)| record["record"] == "ended") {
                return None;
            }
            std::thread::sleep(Duration::from_millis(15));
        }
        None
    }

    fn note(&self, robot: Option<usize>, what: What, from: i64, until: i64) {
        self.struck.lock().unwrap().push(Struck { robot, what, from, until });
    }

    fn begin(&self, kind: Kind, words: &[&str]) {
        let program = Program::start(kind, &self.stage.lock().unwrap(), self.drawn, words);
        self.programs.lock().unwrap().push(program);
    }

    fn signal(&self, signal: Signal) {
        // It is not reaped before all faults are over.
        let _gone = kill_process(self.scheduler, signal);
    }

    fn strike(&self, strike: Strike) {
        match strike {
            Strike::Robot { robot, fault, lasts } => self.befall(robot, fault, lasts),
            Strike::SchedulerFrozen(lasts) => self.freeze(lasts, |_| {}),
            Strike::StopWhileFrozen(after, lasts) => self.freeze(lasts, |show| {
                std::thread::sleep(after);
                show.begin(Kind::Stop, &["stop"]);
            }),
            Strike::SchedulerKilled(then) => {
                let at = epoch_nanos();
                self.signal(Signal::KILL);
                self.note(None, What::SchedulerKilled, at, i64::MAX);
                self.follow(then);
            }
            Strike::ResumeTooSoon => self.begin(Kind::Resume, &["resume"]),
            Strike::Stop { home, again } => {
                if home {
                    self.home_from.lock().unwrap().get_or_insert(epoch_nanos());
                    self.begin(Kind::Stop, &["stop", "--home"]);
                } else {
                    self.begin(Kind::Stop, &["stop"]);
                }
                if let Some(after) = again {
                    std::thread::sleep(after);
                    self.begin(Kind::Stop, &["stop"]);
                }
            }
        }
    }

    fn freeze(&self, lasts: Duration, meanwhile: impl FnOnce(&Self)) {
        let from = epoch_nanos();
        self.signal(Signal::STOP);
        meanwhile(self);
        std::thread::sleep(lasts);
        self.signal(Signal::CONT);
        self.note(None, What::SchedulerFrozen, from, epoch_nanos());
    }

    fn follow(&self, then: Then) {
        match then {
            Then::Nothing => {}
            Then::Resume(after) => {
                std::thread::sleep(after);
                self.begin(Kind::Resume, &["resume"]);
            }
            Then::Stop(after) => {
                std::thread::sleep(after);
                self.begin(Kind::Stop, &["stop"]);
            }
            Then::ResumeAndStop(after, later) => {
                std::thread::sleep(after);
                self.begin(Kind::Resume, &["resume"]);
                std::thread::sleep(later);
                self.begin(Kind::Stop, &["stop"]);
            }
        }
    }

    fn befall(&self, robot: usize, fault: Fault, lasts: Option<Duration>) {
        let from = epoch_nanos();
        self.fault_begins(robot, fault);
        let until = match lasts {
            Some(lasts) => {
                std::thread::sleep(lasts);
                self.fault_ends(robot, fault);
                let still = if let Fault::Slow(delay) = fault { delay } else { Duration::ZERO };
                epoch_nanos() + i64::try_from(still.as_nanos()).unwrap()
            }
            None => i64::MAX,
        };
        let until = if matches!(fault, Fault::Killed | Fault::Stranded) { i64::MAX } else { until };
        self.note(Some(robot), What::Robot(fault), from, until);
    }

    /// Ends the permanent faults of links and of frozen robots, after all programs have reported. These robots then do whatever they are
    /// still permitted to do.
    fn end_all_faults(&mut self) {
        let lasting = |struck: &Struck| match struck.what {
            What::Robot(fault) if struck.until == i64::MAX => Some((struck.robot?, fault)),
            _ => None,
        };
        let lasting: Vec<_> = self.struck.get_mut().unwrap().iter().filter_map(lasting).collect();
        lasting.into_iter().for_each(|(robot, fault)| self.fault_ends(robot, fault));
        let now = epoch_nanos();
        let ends = |struck: &&mut Struck| {
            struck.until == i64::MAX
                && !matches!(
                    struck.what,
                    What::Robot(Fault::Killed | Fault::Stranded) | What::SchedulerKilled
                )
        };
        self.struck.get_mut().unwrap().iter_mut().filter(ends).for_each(|struck| struck.until = now);
    }

    fn fault_begins(&self, robot: usize, fault: Fault) {
        let robot = &mut self.stage.lock().unwrap().robots[robot];
        let link = robot.link.as_ref().unwrap();
        match fault {
            Fault::Frozen => robot.freeze(),
            Fault::Killed | Fault::Restarted(_) => robot.kill(),
            Fault::Cut => link.cut(),
            Fault::Interrupted => link.interrupt(),
            Fault::Muted => link.freeze(),
            Fault::Deaf => link.deafen(),
            Fault::Dumb => link.silence(),
            Fault::Stranded => link.strand(),
            Fault::Slow(delay) => link.delay(delay),
        }
    }

    fn fault_ends(&self, robot: usize, fault: Fault) {
        let mut stage = self.stage.lock().unwrap();
        match fault {
            Fault::Frozen => stage.robots[robot].thaw(),
            Fault::Slow(_) => stage.robots[robot].link.as_ref().unwrap().delay(Duration::ZERO),
            Fault::Killed | Fault::Stranded => {}
            Fault::Restarted(back) => {
                let id = match back {
                    Back::Same | Back::OtherClock => stage.robots[robot].id.clone(),
                    Back::Stranger => "stranger".to_owned(),
                };
                let (args, _) = self.drawn.setup(robot, matches!(back, Back::OtherClock));
                stage.replace_with(robot, &id, args);
            }
            _ => stage.robots[robot].link.as_ref().unwrap().open(),
        }
    }
}

/// Returns every record of the mission's journal with its time, in nanoseconds.
fn journal(state: &Path) -> Vec<(i64, Value)> {
    let entries = std::fs::read_dir(state).into_iter().flatten().flatten();
    let texts = entries.filter_map(|entry| std::fs::read_to_string(entry.path().join("journal")).ok());
    let record = |line: &str| {
        let record: Value = serde_json::from_str(line.get(9..)?).ok()?;
        Some((nanos(record["at"].as_str()?), record))
    };
    texts.flat_map(|text| text.lines().filter_map(record).collect::<Vec<_>>()).collect()
}
