//! The virtual world in which the mission of a seed is played. This file determines the next event and the part of the world that handles
//! it.
//!
//! `network` transports messages, `faults` applies faults, `scheduler` is the process that runs the main loop. `robots` are the robots'
//! processes, and `operator` is the person at the terminal.

mod faults;
mod network;
mod operator;
mod robots;
mod scheduler;
mod transfer;

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use downbeat_robot::simulated::Outgoing;
use downbeat_robot::{Input, LinkId};
use fastrand::Rng;
use urrcp::{Message, Server, SessionId, Span, Timestamp};

use self::robots::RobotSide;
pub(super) use self::robots::SEIZED_BY;
use self::scheduler::{Process, Scheduler};
use super::{Drawn, DrawnRobot, Fault, Happened, Ran};
use crate::draw::zone;
use downbeat_mission::drive::{at_once, drive};
use downbeat_mission::session::Session;
use downbeat_mission::{ActNumber, Event, Mission, MissionOptions, Participant, PlanTransfer, Record};
use downbeat_rehearsal::dry_run::BEGIN;
use downbeat_rehearsal::world::{Kernel, Virtual};

/// A mission counts as hung if it lasts longer than this plus twice the duration of its acts and waits.
const LASTS_MAX: Span = Span::from_millis(180_000);
/// Maximum number of steps of the world at one instant. It is far larger than the possible number of events.
const ROUNDS_MAX: u32 = 20_000;
/// Limits on the number of events in a mission: a basic number, and a number per robot and second of its acts and waits. Without these
/// limits, a mission with ever more events would exhaust the memory.
const HAPPENS_MAX: usize = 200_000;
const HAPPENS_A_SECOND: usize = 12;
/// Time after which a connection attempt fails.
const CONNECT_FAILS: Span = Span::from_millis(300);
/// How long the robots are observed after the end of the mission.
const AFTERMATH: Span = Span::from_millis(8_000);

/// How long the operator waits for links, greetings and confirmations of stops.
pub(super) const PATIENCE: Span = Span::from_millis(2_000);

enum Item {
    ToRobot {
        robot: usize,
        link: LinkId,
        message: Box<Message>,
    },
    ToScheduler {
        robot: usize,
        link: LinkId,
        event: Box<Event>,
    },
    RobotLinkDown {
        robot: usize,
        link: LinkId,
    },
    Connect {
        robot: usize,
        link: LinkId,
    },
    Fault(Fault),
    RobotBack(usize),
    HardwareLost(usize),
    HardwareBack(usize),
    DeadLinksEnd(usize),
    /// The connection of another session ends.
    ForeignEnd {
        robot: usize,
        link: LinkId,
    },
    /// The event that the act with the given index waits for occurs.
    Comes(usize),
    Resume,
    Answer {
        robot: usize,
        link: LinkId,
        message: Box<Message>,
    },
    /// The disk has completed a write. `life` is the number of the scheduler process that requested it.
    Synced {
        life: u32,
    },
}

/// State of the machine on which a robot's process runs or ran.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Machine {
    /// The machine runs. After the robot's process has ended, it closes the connections of that process and refuses new ones.
    Up,
    /// The machine itself is gone.
    Down,
}

struct World {
    drawn: Drawn,
    rng: Rng,
    kernel: Kernel<Item>,
    robots: Vec<RobotSide>,
    /// Buffer for the latest messages of a robot. It is empty between uses and kept to reuse its allocation.
    said: Vec<Outgoing>,
    scheduler: Scheduler,
    /// Number of steps of the world at the current instant.
    rounds: u32,
    /// Whether the mission is stuck and will never end.
    hung: bool,
    /// The number of the act whose promise ends the run. `None`: the run is played to its end.
    last_act: Option<ActNumber>,
    /// Whether the act `last_act` has been promised.
    is_promised: bool,
    records: Vec<(Timestamp<Server>, Record)>,
    history: Vec<(Timestamp<Server>, Happened)>,
    /// The instant after which the mission counts as hung.
    lasts_until: Timestamp<Server>,
    happens_max: usize,
    /// Whether to keep every message, for a trace.
    detail: HistoryDetail,
}

fn session() -> Option<SessionId> {
    SessionId::new("soak").ok()
}

fn options(drawn: &Drawn) -> MissionOptions {
    MissionOptions {
        patience: PATIENCE,
        session: session().map(Session::named),
        join: drawn.join,
        acts_max: drawn.acts_max,
        zone: zone(drawn.clock_change),
        transfer: drawn
            .plans_transfers
            .then(|| Arc::new(transfer::Planner::of(drawn)) as Arc<dyn PlanTransfer>),
        check_invariants: true,
        ..MissionOptions::default()
    }
}

fn participants(drawn: &Drawn) -> Vec<Participant> {
    let participant = |robot: &DrawnRobot| {
        let mut participant = Participant::new(robot.block.id.clone(), Some(robot.block.clone()));
        participant.settings.clock = robot.clock;
        participant
    };
    drawn.robots.iter().map(participant).collect()
}

/// The events that a history contains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HistoryDetail {
    /// The events that the checks need.
    Checks,
    /// All events, for a trace.
    Trace,
}

/// Plays a drawn mission to its end.
pub(super) fn play(drawn: Drawn, history: HistoryDetail) -> Ran {
    play_world(World::new(drawn, history))
}

/// Plays a drawn mission until the act with the number `act` is promised.
pub(super) fn play_up_to(drawn: Drawn, act: ActNumber) -> Ran {
    play_world(World { last_act: Some(act), ..World::new(drawn, HistoryDetail::Checks) })
}

fn play_world(mut world: World) -> Ran {
    let drawn = &world.drawn;
    let mission = Mission::new(drawn.choreography.clone(), participants(drawn), options(drawn), BEGIN).ok();
    let mut report = None;
    let mut next = mission;
    let mut broken = None;
    while let Some(mut mission) = next.take() {
        // If an assertion fails, the mission is not used again.
        let driven = catch_unwind(AssertUnwindSafe(|| at_once(drive(&mut mission, &mut world))));
        match driven {
            Ok(reported) => report = reported,
            Err(panic) => {
                broken = Some(text_of(&*panic));
                break;
            }
        }
        if world.hung {
            let (wakeup, due) = (mission.next_wakeup(), mission.due());
            let wakes = |robot| world.kernel.robots.get(robot)?.next_wakeup();
            let robots: Vec<_> = (0..world.robots.len()).map(wakes).collect();
            world.note(Happened::Stuck(format!("robots {robots:?}, mission {wakeup:?}: {due}")));
        } else if !world.scheduler.is_running() {
            // A process that dies with its last record reports nothing.
            report = None;
            next = world.taken_up();
        }
    }
    if !world.is_promised && broken.is_none() {
        world.aftermath();
    }
    (0..world.robots.len()).for_each(|robot| world.collect(robot));
    let starts_of_dead = world.robots.iter_mut().map(|robot| std::mem::take(&mut robot.starts_of_dead));
    let starts_of_dead = starts_of_dead.collect();
    let brakings = world.robots.iter_mut().map(|robot| std::mem::take(&mut robot.brakings)).collect();
    let (logs, logs_of_strangers) =
        world.robots.into_iter().map(|robot| (robot.log, robot.log_of_stranger)).unzip();
    Ran {
        report,
        records: world.records,
        logs,
        brakings,
        logs_of_strangers,
        starts_of_dead,
        server_ahead: world.scheduler.ahead,
        history: world.history,
        watched_until: world.kernel.now,
        hung: world.hung,
        broken,
        drawn: world.drawn,
    }
}

fn text_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref().copied());
    text.unwrap_or("an assertion failed").to_owned()
}

impl World {
    fn new(drawn: Drawn, detail: HistoryDetail) -> Self {
        let lasts = drawn.lasts();
        let seconds = usize::try_from(lasts.as_nanos() / 1_000_000_000).unwrap_or(0);
        let mut rng = Rng::with_seed(drawn.seed ^ 0x5eed);
        let side = |robot| RobotSide::new(network::path(&drawn, robot, &mut rng));
        let machines = drawn.robots.iter().map(|robot| {
            (robot.there_from == Span::ZERO).then(|| robots::machine(robot, robot.block.clone(), BEGIN))
        });
        // The process of a robot whose twin answers has a separate index, after the indices of all robots.
        let machines = machines.chain(drawn.robots.iter().map(|_| None));
        let mut world = Self {
            robots: drawn.robots.iter().map(side).collect(),
            rng,
            kernel: Kernel::new(machines, BEGIN),
            said: Vec::new(),
            scheduler: Scheduler::new(&drawn),
            rounds: 0,
            hung: false,
            last_act: None,
            is_promised: false,
            records: Vec::new(),
            history: Vec::new(),
            lasts_until: BEGIN + LASTS_MAX + lasts * 2,
            happens_max: HAPPENS_MAX + seconds * drawn.robots.len() * HAPPENS_A_SECOND,
            detail,
            drawn,
        };
        for (at, fault) in world.drawn.faults.clone() {
            world.kernel.put(BEGIN + at, Item::Fault(fault));
        }
        if let Some(ends_at) = world.drawn.ends_at {
            world.kernel.put(BEGIN + ends_at, Item::Fault(Fault::Stop));
        }
        for robot in 0..world.robots.len() {
            let there_from = world.drawn.robots[robot].there_from;
            if there_from > Span::ZERO {
                world.kernel.put(BEGIN + there_from, Item::RobotBack(robot));
            }
        }
        world
    }

    fn note(&mut self, happened: Happened) {
        self.history.push((self.kernel.now, happened));
        self.hung |= self.history.len() > self.happens_max;
    }

    /// Observes the robots for a while after the last scheduler process has ended.
    fn aftermath(&mut self) {
        self.scheduler.process = Process::Gone;
        let until = self.kernel.now + AFTERMATH;
        while let Some(next) = self.next_instant().filter(|next| *next <= until && !self.hung) {
            self.step(next);
        }
        self.kernel.now = until;
    }
}

impl Virtual for World {
    type Item = Item;

    fn kernel(&mut self) -> &mut Kernel<Item> {
        &mut self.kernel
    }

    fn advance(&mut self, robot: usize) {
        match robot.checked_sub(self.robots.len()) {
            None => self.advance_robot(robot),
            Some(robot) => self.advance_hidden(robot),
        }
    }

    fn happen(&mut self, item: Item) {
        match item {
            Item::ToRobot { robot, link, message } => self.arrive_at_robot(robot, link, *message),
            Item::Answer { robot, link, message } => self.answer(robot, link, *message),
            Item::ToScheduler { robot, link, event } => self.arrive_at_scheduler(robot, link, event),
            Item::RobotLinkDown { robot, link } => self.robot_link_down(robot, link),
            Item::Connect { robot, link } => self.connect(robot, link),
            Item::Fault(fault) => self.go_wrong(fault),
            Item::RobotBack(robot) => self.robot_back(robot),
            Item::HardwareLost(robot) => self.hardware_lost(robot),
            Item::HardwareBack(robot) => self.hardware_back(robot),
            Item::DeadLinksEnd(robot) => self.dead_links_end(robot),
            Item::ForeignEnd { robot, link } => self.receive(robot, link, Input::LinkDown),
            Item::Comes(act) => self.comes(act),
            Item::Resume => self.resume(),
            Item::Synced { life } => self.synced(life),
        }
    }

    fn wakes(&self) -> Option<Timestamp<Server>> {
        self.scheduler.wakes()
    }

    /// Advances the time. If the world takes too many steps at one instant, an event is due but never performed, so the mission counts as
    /// hung.
    fn pass(&mut self, at: Timestamp<Server>) {
        let now = &mut self.kernel.now;
        self.rounds = if at > *now { 0 } else { self.rounds + 1 };
        *now = at.max(*now);
        self.hung |= self.rounds > ROUNDS_MAX;
    }
}
