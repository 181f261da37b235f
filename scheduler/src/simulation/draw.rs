//! What a seed stands for: a fleet, a choreography, and what goes wrong when.

use downbeat_robot::simulated::Settings;
use downbeat_scripts::{Choreography, DeviceScript, FailurePolicy, OnFailure, Plan, RobotPlan, Way};
use fastrand::Rng;
use urrcp::{
    ControlType, DeviceId, InitializationBlock, Millis, RobotId, Script, Setpoint, Span, Step, StopCondition,
};

use crate::mission::ClockMode;

/// How messages travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Network {
    /// As by TCP: in order, nothing is lost as long as the connection stands.
    Stream,
    /// As by datagrams: lost, doubled and overtaken with these probabilities.
    Datagram {
        /// Of a message to be lost.
        loss: f64,
        /// Of a message to arrive twice.
        double: f64,
    },
}

/// A robot that does not do what it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lie {
    /// It accepts, reports starts and ends, and does not move.
    NeverMoves,
    /// It states times that are off by this.
    WrongTime(Span),
    /// It accepts and forgets at once.
    Forgets,
    /// It echoes the hash of something else.
    WrongHash,
    /// It says that it has done more steps than any script has.
    TooManySteps,
}

/// Something that goes wrong at an instant, counted from the begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// A robot's process ends, and begins anew after a while or never. Its peers may be told.
    RobotCrash {
        /// Which.
        robot: usize,
        /// After how long it is back.
        back_after: Option<Span>,
        /// Its connections are closed by its system.
        told: bool,
    },
    /// A robot's process stands still for a while.
    RobotPause {
        /// Which.
        robot: usize,
        /// For how long.
        lasts: Span,
    },
    /// Nothing passes between the scheduler and a robot for a while.
    Partition {
        /// Which.
        robot: usize,
        /// For how long.
        lasts: Span,
        /// The connection is found broken at its end.
        breaks: bool,
    },
    /// A robot's clock is set.
    ClockStep {
        /// Which.
        robot: usize,
        /// By how much.
        by: Span,
    },
    /// The scheduler's process ends, and is taken up by its journal after a while or never.
    SchedulerCrash {
        /// After how long somebody says `resume`.
        resumed_after: Option<Span>,
    },
    /// The scheduler's process stands still for a while.
    SchedulerPause {
        /// For how long.
        lasts: Span,
    },
    /// The operator says stop.
    Stop,
}

/// Everything that a seed stands for.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Of which it was drawn.
    pub seed: u64,
    /// How messages travel.
    pub network: Network,
    /// Least and largest delay one way.
    pub delay: (Span, Span),
    /// The probability of a delay up to twenty times as long.
    pub tail: f64,
    /// Each robot's description, behaviour and clock.
    pub robots: Vec<DrawnRobot>,
    /// What is played.
    pub choreography: Choreography,
    /// What goes wrong, in order.
    pub faults: Vec<(Span, Fault)>,
    /// Where the scheduler keeps its journal.
    pub disk: DrawnDisk,
}

/// The disk of the scheduler's machine.
#[derive(Clone, Copy, Debug)]
pub struct DrawnDisk {
    /// How long it takes until what was written survives a loss of power.
    pub sync: Span,
    /// The journal cannot grow beyond so many bytes.
    pub capacity: Option<usize>,
    /// When the scheduler's process ends, it is because its machine loses power.
    pub loses_power: bool,
}

/// One robot.
#[derive(Clone, Debug)]
pub struct DrawnRobot {
    /// How it describes itself.
    pub block: InitializationBlock,
    /// Its clock.
    pub settings: Settings,
    /// How its time is brought to agree.
    pub clock: ClockMode,
    /// What it lies about.
    pub lie: Option<Lie>,
    /// How long it takes for every answer besides the network.
    pub slow: Span,
}

impl Drawn {
    /// The same mission if nothing goes wrong at an instant of its own; its network and its liars stay.
    #[must_use]
    pub fn without_faults(mut self) -> Self {
        self.faults.clear();
        self.disk.capacity = None;
        self
    }
}

fn millis(rng: &mut Rng, least: i64, largest: i64) -> Span {
    Span::from_micros(rng.i64(least * 1_000..=largest * 1_000))
}

/// The world of a seed.
#[must_use]
pub fn draw(seed: u64) -> Drawn {
    let mut rng = Rng::with_seed(seed);
    let rng = &mut rng;
    let count = rng.usize(2..=5);
    let network = match rng.u8(0..10) {
        0..=5 => Network::Stream,
        _ => Network::Datagram { loss: rng.f64() * rng.f64() * 0.2, double: rng.f64() * 0.1 },
    };
    let least = millis(rng, 0, 5);
    let delay = (least, least + millis(rng, 0, 20));
    let tail = if rng.u8(0..4) == 0 { rng.f64() * 0.02 } else { 0.0 };
    let mut robots: Vec<DrawnRobot> = (0..count).map(|index| draw_robot(rng, index)).collect();
    draw_claim(seed, &mut robots);
    let choreography = draw_choreography(rng, &robots);
    let duration: Span = choreography.acts.iter().fold(Span::ZERO, |sum, act| sum + act.plan.duration());
    let within = duration + Span::from_millis(1_500) * i64::try_from(choreography.acts.len()).unwrap_or(1);
    let mut faults: Vec<(Span, Fault)> = (0..rng.usize(0..=3))
        .map(|_| {
            let at = Span::from_nanos(rng.i64(0..=within.as_nanos()));
            (at, draw_fault(rng, count))
        })
        .collect();
    faults.sort_by_key(|(at, _)| *at);
    let disk = draw_disk(seed);
    Drawn { seed, network, delay, tail, robots, choreography, faults, disk }
}

/// From a generator of its own, so that what a seed stands for besides is what it was.
fn draw_disk(seed: u64) -> DrawnDisk {
    let mut rng = Rng::with_seed(seed ^ 0xd15c);
    let sync = match rng.u8(0..3) {
        0 => Span::ZERO,
        1 => millis(&mut rng, 0, 10),
        _ => millis(&mut rng, 10, 300),
    };
    let capacity = (rng.u8(0..20) == 0).then(|| rng.usize(1_000..12_000));
    DrawnDisk { sync, capacity, loses_power: rng.bool() }
}

/// From a generator of its own as well.
fn draw_claim(seed: u64, robots: &mut [DrawnRobot]) {
    let mut rng = Rng::with_seed(seed ^ 0xc1a1);
    let claims = rng.u8(0..20) == 0;
    let robot = rng.usize(0..robots.len());
    if claims {
        robots[robot].lie.get_or_insert(Lie::TooManySteps);
    }
}

fn draw_robot(rng: &mut Rng, index: usize) -> DrawnRobot {
    let queue = rng.u32(1..=3);
    let linear = rng.bool();
    let default = if rng.bool() { r#""default_value": 0, "# } else { "" };
    let device = |name: &str| {
        format!(
            r#"{{"id": "{name}", "name": "{name}", {default}"interpolation": "{}", "script_queue": {queue},
              "available_control_types": {{
                "position": {{"min_value": 0, "max_value": 90, "granularity": 1}},
                "script": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 16}}}}}}"#,
            if linear { "linear" } else { "hold" }
        )
    };
    let devices: Vec<_> = ["a", "b"][..rng.usize(1..=2)].iter().map(|name| device(name)).collect();
    let reports = rng.u8(0..8) > 0;
    let json = format!(
        r#"{{"id": "r{index}", "api_version": "1", "reports": {reports}, "devices": [{}]}}"#,
        devices.join(",")
    );
    let measured = rng.u8(0..5) == 0;
    let settings = Settings {
        clock_offset: if measured { millis(rng, -2_000, 2_000) } else { millis(rng, -2, 2) },
        drift_ppm: (rng.f64() - 0.5) * if measured { 100.0 } else { 10.0 },
        ntp_error: None,
        seed: rng.u64(..),
        ..Settings::default()
    };
    let lie = (rng.u8(0..12) == 0).then(|| match rng.u8(0..4) {
        0 => Lie::NeverMoves,
        1 => Lie::WrongTime(millis(rng, -100, 100)),
        2 => Lie::Forgets,
        _ => Lie::WrongHash,
    });
    DrawnRobot {
        // Written above: it is one.
        block: serde_json::from_str(&json).unwrap_or_else(|_| unreachable_block()),
        settings,
        clock: if measured { ClockMode::Measured } else { ClockMode::Ntp },
        lie,
        slow: if rng.u8(0..8) == 0 { millis(rng, 0, 60) } else { Span::ZERO },
    }
}

#[expect(clippy::expect_used, reason = "a constant that a test reads")]
fn unreachable_block() -> InitializationBlock {
    let json = r#"{"id": "r", "api_version": "1", "devices": [{"id": "a", "name": "a", "available_control_types": {}}]}"#;
    serde_json::from_str(json).expect("a constant that a test reads")
}

fn draw_choreography(rng: &mut Rng, robots: &[DrawnRobot]) -> Choreography {
    let count = if rng.u8(0..10) < 6 { 1 } else { rng.usize(2..=3) };
    let running = match rng.u8(0..8) {
        0 => None,
        _ => Millis::new(f64::from(rng.u32(300..2_500))).ok(),
    };
    let stop_condition = StopCondition { pending: None, running };
    let mut acts = Vec::with_capacity(count);
    for index in 0..count {
        let mut planned = Vec::new();
        for robot in robots {
            if index > 0 && rng.u8(0..5) == 0 {
                continue;
            }
            let devices = robot.block.devices.iter().map(|device| device.id.clone());
            let scripts = devices.flat_map(|device| draw_scripts(rng, &device, stop_condition)).collect();
            planned.push(RobotPlan { robot: robot.block.id.clone(), scripts });
        }
        let plan = Plan {
            scenario: "soak".to_owned(),
            start_tolerance: Span::from_millis(60),
            lead: None,
            stop_condition,
            robots: planned,
        };
        let mut act = Choreography::of_plan(plan).acts.swap_remove(0);
        act.name = format!("act {index}");
        act.next = if index + 1 < count { Way::Act(index + 1) } else { Way::End };
        act.on_failure = draw_policy(rng, robots, index, count);
        acts.push(act);
    }
    Choreography { scenario: "soak".to_owned(), acts }
}

fn draw_policy(rng: &mut Rng, robots: &[DrawnRobot], act: usize, acts: usize) -> FailurePolicy {
    let mut policy = || match rng.u8(0..10) {
        0..=5 => OnFailure::Abort,
        6..=8 => OnFailure::Without,
        _ => OnFailure::Hold,
    };
    let default = policy();
    let own: Vec<(RobotId, OnFailure)> = vec![(robots[0].block.id.clone(), policy())];
    // Only forward, so that no mission goes on for ever.
    let then = (act + 1 < acts && rng.u8(0..6) == 0).then_some(acts - 1);
    FailurePolicy { default, robots: if rng.u8(0..5) == 0 { own } else { Vec::new() }, then }
}

/// One script, or two after each other.
fn draw_scripts(rng: &mut Rng, device: &DeviceId, stop_condition: StopCondition) -> Vec<DeviceScript> {
    let mut scripts = Vec::new();
    let mut start = if rng.u8(0..4) == 0 { f64::from(rng.u32(0..600)) } else { 0.0 };
    for _ in 0..if rng.u8(0..5) == 0 { 2 } else { 1 } {
        let mut offset = 0.0;
        let steps = (0..rng.usize(2..=5)).map(|_| {
            let at = offset;
            offset += f64::from(rng.u32(100..=400));
            Some(Step {
                offset: Millis::new(at).ok()?,
                setpoint: Setpoint::new(ControlType::Position, f64::from(rng.u32(0..=90))),
                stop_condition: None,
            })
        });
        let steps: Vec<Step> = steps.collect::<Vec<_>>().into_iter().flatten().collect();
        let last = steps.last().map_or(0.0, |step| step.offset.get());
        if let (Ok(script), Ok(at)) = (Script::new(steps), Millis::new(start)) {
            scripts.push(DeviceScript { device: device.clone(), start: at, stop_condition, script });
        }
        start += last + f64::from(rng.u32(0..200));
    }
    scripts
}

fn draw_fault(rng: &mut Rng, robots: usize) -> Fault {
    let robot = rng.usize(0..robots);
    match rng.u8(0..16) {
        0..=3 => {
            let back_after = (rng.u8(0..3) > 0).then(|| millis(rng, 20, 1_500));
            Fault::RobotCrash { robot, back_after, told: rng.u8(0..3) > 0 }
        }
        4 => Fault::RobotPause { robot, lasts: millis(rng, 1, 1_500) },
        5..=9 => Fault::Partition { robot, lasts: millis(rng, 1, 3_000), breaks: rng.bool() },
        10 => Fault::ClockStep { robot, by: millis(rng, -3_000, 3_000) },
        11..=13 => {
            let resumed_after = (rng.u8(0..3) > 0).then(|| millis(rng, 50, 2_000));
            Fault::SchedulerCrash { resumed_after }
        }
        14 => Fault::SchedulerPause { lasts: millis(rng, 1, 1_500) },
        _ => Fault::Stop,
    }
}
