//! A random mission and its faults, all derived from one seed.

use std::time::Duration;

/// Number of steps of one script.
pub const STEPS: usize = 4;
/// Number of consecutive values that are reserved for each act, so that a value identifies its act.
pub const VALUES: usize = 20;
/// Difference between the values of the two devices: half a step after `d` is set to a value, `arm` reaches that value plus this.
pub const ARM: f64 = 0.5;
/// Maximum delay that a robot adds to each message, in each direction.
pub const DELAY_MS: u64 = 20;

/// A fault of a robot.
#[derive(Clone, Copy, Debug)]
pub enum Fault {
    /// The robot is suspended by SIGSTOP.
    Frozen,
    /// The robot is killed by SIGKILL.
    Killed,
    /// The robot is killed by SIGKILL and started again on the same port.
    Restarted(Back),
    /// The robot's link is closed, and new connections are refused.
    Cut,
    /// The robot's link is closed; new connections stay open and carry nothing.
    Interrupted,
    /// The robot's link stays open and carries nothing; its messages are delivered after the fault.
    Muted,
    /// The robot's link stays open, but no message reaches the robot.
    Deaf,
    /// The robot's link stays open, but no message from the robot passes.
    Dumb,
    /// The robot's link stays open and never carries anything again; a new connection would work.
    Stranded,
    /// Each message to or from the robot is delayed by this time.
    Slow(Duration),
}

/// The identity of a restarted robot.
#[derive(Clone, Copy, Debug)]
pub enum Back {
    Same,
    /// The robot returns with another clock.
    OtherClock,
    /// Another robot, with another id, answers at the address.
    Stranger,
}

/// The commands that another process runs after the scheduler was killed, and their delays.
#[derive(Clone, Copy, Debug)]
pub enum Then {
    Nothing,
    Resume(Duration),
    Stop(Duration),
    ResumeAndStop(Duration, Duration),
}

/// A fault or command that disturbs a mission.
#[derive(Clone, Copy, Debug)]
pub enum Strike {
    Robot {
        robot: usize,
        fault: Fault,
        lasts: Option<Duration>,
    },
    SchedulerFrozen(Duration),
    SchedulerKilled(Then),
    /// An operator runs `downbeat stop`, and possibly a second `downbeat stop` after a delay.
    Stop {
        home: bool,
        again: Option<Duration>,
    },
    /// An operator runs `downbeat resume` while the scheduler is alive.
    ResumeTooSoon,
    /// An operator runs `downbeat stop` while the scheduler is frozen: the delay of the stop after the freeze begins, and the duration of
    /// the freeze.
    StopWhileFrozen(Duration, Duration),
}

#[derive(Clone, Copy, Debug)]
pub enum When {
    /// The fault begins this long after the start of the scheduler.
    After(Duration),
    /// The fault begins this many milliseconds before the start of an act; a negative number: after the start.
    Before { act: usize, millis: i64 },
}

/// A robot's clock.
#[derive(Clone, Copy, Debug)]
pub enum Clock {
    /// The clock follows NTP with an error of at most this many microseconds.
    Ntp(u64),
    /// The clock is ahead by this many milliseconds and is not corrected; the scheduler measures its offset.
    Measured(u64),
}

/// What a robot tells the scheduler about its scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tells {
    Everything,
    /// The robot answers inquiries, but sends no reports.
    WhenAsked,
    /// The robot sends reports, but answers no inquiries.
    ByItself,
    Nothing,
}

impl Tells {
    pub const fn reports(self) -> bool {
        matches!(self, Self::Everything | Self::ByItself)
    }

    pub const fn answers_inquiries(self) -> bool {
        matches!(self, Self::Everything | Self::WhenAsked)
    }
}

#[derive(Clone, Debug)]
pub struct Drawn {
    pub seed: u64,
    pub clocks: Vec<Clock>,
    pub tells: Vec<Tells>,
    pub queue: usize,
    pub on_failure: &'static str,
    pub on_doubt: &'static str,
    /// Number of scripts per device, for each act.
    pub acts: Vec<usize>,
    /// Interval between two steps, in milliseconds.
    pub every_ms: usize,
    /// Lease of the scripts in milliseconds: how long a robot plays without a message from the scheduler.
    pub lease_ms: u64,
    /// Patience of the mission (`--patience`), in milliseconds. It may be shorter than the lease, and then ends while leases may still
    /// run.
    pub patience_ms: u64,
    pub strikes: Vec<(When, Strike)>,
}

impl Drawn {
    pub fn of(seed: u64) -> Self {
        let mut rng = fastrand::Rng::with_seed(seed);
        let queue = rng.usize(1..=3);
        // A chain needs a device that holds two scripts.
        let (acts, scripts) = if queue == 1 { (2..=3, 1..=1) } else { (2..=3, 2..=3) };
        let acts: Vec<usize> = (0..rng.usize(acts)).map(|_| rng.usize(scripts.clone())).collect();
        // A device that receives a chain in parts needs scripts of one second.
        let every_ms = if queue > 1 && acts.iter().all(|scripts| *scripts <= queue) { 150 } else { 260 };
        let robots = rng.usize(2..=4);
        let clock = |rng: &mut fastrand::Rng| match rng.u8(0..4) {
            0 => Clock::Measured(rng.u64(700..3_000)),
            _ => Clock::Ntp(rng.u64(0..4_000)),
        };
        let clocks: Vec<Clock> = (0..robots).map(|_| clock(&mut rng)).collect();
        let on_failure = *rng.choice(&["stop", "stop", "without", "home"]).unwrap_or(&"stop");
        let on_doubt = if rng.u8(0..3) == 0 { "withdraw" } else { "start" };
        let mut drawn = Self {
            seed,
            tells: vec![Tells::Everything; clocks.len()],
            clocks,
            queue,
            on_failure,
            on_doubt,
            acts,
            every_ms,
            lease_ms: if rng.u8(0..3) == 0 { 1_500 } else { 700 },
            patience_ms: if rng.u8(0..3) == 0 { 600 } else { 2_000 },
            strikes: Vec::new(),
        };
        drawn.strikes = drawn.draw_strikes(&mut rng);
        if rng.u8(0..3) == 0 {
            let odd = rng.usize(0..robots);
            drawn.tells[odd] = *rng.choice(&[Tells::WhenAsked, Tells::ByItself, Tells::Nothing]).unwrap();
        }
        drawn
    }

    fn draw_strikes(&self, rng: &mut fastrand::Rng) -> Vec<(When, Strike)> {
        let mut strikes = Vec::new();
        let first = rng.usize(0..self.robots());
        for next in 0..*rng.choice(&[0, 1, 1, 1, 2]).unwrap_or(&1) {
            let robot = (first + next) % self.robots();
            let fault = draw_fault(rng);
            let ends = matches!(fault, Fault::Restarted(_) | Fault::Slow(_)) || rng.u8(0..3) > 0;
            let lasts = ends.then(|| millis(rng, 20..1_500));
            strikes.push((self.draw_when(rng), Strike::Robot { robot, fault, lasts }));
        }
        if rng.u8(0..5) < 3 {
            strikes.push((self.draw_when(rng), draw_scheduler(rng)));
        }
        strikes
    }

    fn draw_when(&self, rng: &mut fastrand::Rng) -> When {
        if rng.bool() {
            When::Before { act: rng.usize(0..self.acts.len()), millis: rng.i64(-80..320) }
        } else {
            When::After(millis(rng, 0..900 + self.plays_ms() as u64))
        }
    }

    pub const fn robots(&self) -> usize {
        self.clocks.len()
    }

    /// Returns the duration of the mission without faults, in milliseconds, including the time before the first act.
    pub fn plays_ms(&self) -> usize {
        let steps: usize = self.acts.iter().map(|scripts| scripts * STEPS).sum();
        900 + 300 * self.acts.len() + steps * self.every_ms
    }

    /// Returns the planned values of a robot's devices, in chronological order.
    pub fn values(&self) -> Vec<f64> {
        let of_step = |act, step| [value(act, step), value(act, step) + ARM];
        let of_act =
            |(act, scripts): (usize, &usize)| (0..scripts * STEPS).flat_map(move |step| of_step(act, step));
        self.acts.iter().enumerate().flat_map(of_act).collect()
    }

    /// Returns the initialization block of a robot: the device `d` holds each value until the next one, and `arm` moves linearly.
    pub fn init(&self, robot: usize) -> String {
        let queue = self.queue;
        let slows_down =
            ["", "\n      acceleration: {min_value: -900, max_value: 900, granularity: 1}"][robot % 2];
        let arm = format!(
            "  - id: arm
    name: arm
    script_queue: {queue}
    interpolation: linear
    default_value: 0
    available_control_types:
      position: {{min_value: 0, max_value: 90, granularity: 0.5}}
      script: {{min_value: 0, max_value: 90, granularity: 0.5, max_number_of_steps: {STEPS}}}{slows_down}
"
        );
        let init = stage::one_device(queue, 90, STEPS) + &arm;
        init.replace("reports: true", &format!("reports: {}", self.tells[robot].reports()))
    }

    pub fn scenario(&self) -> String {
        let Self { on_failure, on_doubt, every_ms, lease_ms, .. } = self;
        let act = |(act, scripts): (usize, &usize)| {
            let track = |later: usize, higher: f64| {
                let keyframe = |step| {
                    format!("{{at: {}ms, to: {}}}", step * every_ms + later, value(act, step) + higher)
                };
                (0..scripts * STEPS).map(keyframe).collect::<Vec<_>>().join(", ")
            };
            let (d, arm) = (track(0, 0.0), track(every_ms / 2, ARM));
            format!(
                "  - act: act-{act}\n    cues:\n      - {{at: 0s, robots: all, tracks: {{d: [{d}], arm: [{arm}]}}}}\n"
            )
        };
        let acts: String = self.acts.iter().enumerate().map(act).collect();
        format!(
            "scenario: chaos\nstart_tolerance: 1s\non_failure: {on_failure}\non_doubt: {on_doubt}\nstop_condition: {{running: {lease_ms}ms}}\nacts:\n{acts}"
        )
    }

    /// Returns the arguments of a robot's process, and its keys in the fleet file. If `other`, its clock differs from the one that was
    /// drawn.
    pub fn setup(&self, robot: usize, other: bool) -> (Vec<String>, &'static str) {
        let seed = self.seed * 8 + robot as u64;
        let (clock, keys) = match self.clocks[robot] {
            Clock::Ntp(micros) => {
                let micros = if other { micros + 30_000 } else { micros };
                (format!("--ntp-error {micros}us"), "")
            }
            Clock::Measured(millis) => {
                let millis = if other { (millis + 1_000) % 3_000 } else { millis };
                (format!("--no-ntp --clock-offset {millis}ms"), ", clock: measured")
            }
        };
        let args = format!("{clock} --delay-max {DELAY_MS}ms --seed {seed}");
        (args.split(' ').map(str::to_owned).collect(), keys)
    }
}

fn millis(rng: &mut fastrand::Rng, range: std::ops::Range<u64>) -> Duration {
    Duration::from_millis(rng.u64(range))
}

fn draw_fault(rng: &mut fastrand::Rng) -> Fault {
    match rng.u8(0..12) {
        0 | 1 => Fault::Frozen,
        2 => Fault::Killed,
        3 => Fault::Restarted(Back::Same),
        4 => Fault::Restarted(Back::OtherClock),
        5 => Fault::Restarted(Back::Stranger),
        6 => Fault::Cut,
        7 => Fault::Interrupted,
        8 => Fault::Muted,
        9 => *rng.choice(&[Fault::Deaf, Fault::Dumb]).unwrap_or(&Fault::Deaf),
        10 => Fault::Stranded,
        _ => Fault::Slow(millis(rng, 20..500)),
    }
}

fn draw_scheduler(rng: &mut fastrand::Rng) -> Strike {
    let soon = |rng: &mut fastrand::Rng| millis(rng, 0..600);
    match rng.u8(0..9) {
        0 | 1 => Strike::SchedulerFrozen(millis(rng, 50..1_500)),
        2 => Strike::SchedulerKilled(Then::Nothing),
        3 => Strike::SchedulerKilled(Then::Resume(soon(rng))),
        4 => Strike::SchedulerKilled(Then::Stop(soon(rng))),
        5 => Strike::SchedulerKilled(Then::ResumeAndStop(soon(rng), millis(rng, 100..2_000))),
        6 => Strike::StopWhileFrozen(soon(rng), millis(rng, 500..3_500)),
        7 => Strike::ResumeTooSoon,
        _ => Strike::Stop { home: rng.u8(0..3) == 0, again: rng.bool().then(|| soon(rng)) },
    }
}

pub fn value(act: usize, step: usize) -> f64 {
    (1 + VALUES * act + step) as f64
}
