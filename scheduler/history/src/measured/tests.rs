//! Tests that measurements of generated recordings come close to the true values, which are known.

use fastrand::Rng;
use urrcp::{Robot, Server, Span, Timestamp};

use super::*;
use crate::test_records::{prepared, script};
use downbeat_mission::{LeadTime, Progress, PromisedScript, Record};
use downbeat_scripts::Delay;
use urrcp::Command;

const BEGAN: Timestamp<Server> = Timestamp::from_nanos(1_800_000_000_000_000_000);

/// The true properties of the link and the clock of a robot that is queried repeatedly.
struct Truth {
    questions: i64,
    every: Span,
    /// Draws the one-way delay to the robot in milliseconds; `back` draws the delay from the robot.
    there: fn(&mut Rng) -> f64,
    back: fn(&mut Rng) -> f64,
    /// Probability that a packet is lost.
    loss: f64,
    offset: Span,
    drift_ppm: f64,
    /// Start and duration of an interruption of the link, if any.
    held: Option<(Span, Span)>,
    /// The resolution of the robot's timestamps.
    counts_in: Span,
}

fn constant(_: &mut Rng) -> f64 {
    5.0
}

/// Draws a delay from 0.5 to 1.5 ms.
fn short(rng: &mut Rng) -> f64 {
    0.5 + rng.f64()
}

/// Draws a delay from 2 to 10 ms.
fn uniform(rng: &mut Rng) -> f64 {
    2.0 + 8.0 * rng.f64()
}

impl Default for Truth {
    fn default() -> Self {
        Self {
            questions: 400,
            every: Span::from_millis(250),
            there: uniform,
            back: uniform,
            loss: 0.0,
            offset: Span::ZERO,
            drift_ppm: 0.0,
            held: None,
            counts_in: Span::from_nanos(1),
        }
    }
}

impl Truth {
    fn robot_shows(&self, at: Timestamp<Server>) -> Timestamp<Robot> {
        let ran = (at - BEGAN).as_millis_f64();
        let shows = at + self.offset + Span::from_millis_f64(ran * self.drift_ppm * 1e-6);
        let step = self.counts_in.as_nanos();
        Timestamp::from_nanos(shows.as_nanos().div_euclid(step) * step)
    }

    /// Returns when a message that is sent at `sent` arrives. It never arrives before earlier messages.
    fn arrives(
        &self,
        sent: Timestamp<Server>,
        took: f64,
        last: &mut Timestamp<Server>,
        rng: &mut Rng,
    ) -> Timestamp<Server> {
        let lost = if rng.f64() < self.loss { Span::from_millis(200) } else { Span::ZERO };
        let mut arrives = sent + Span::from_millis_f64(took) + lost;
        if let Some((from, lasts)) = self.held
            && arrives >= BEGAN + from
            && sent < BEGAN + from + lasts
        {
            arrives = arrives.max(BEGAN + from + lasts);
        }
        *last = arrives.max(*last);
        *last
    }

    fn history(&self, seed: u64) -> History {
        let mut rng = Rng::with_seed(seed);
        let mut robot = KnownRobot::new("r".parse().unwrap(), None);
        let (mut last_there, mut last_back, mut answered) = (BEGAN, BEGAN, BEGAN);
        for question in 0..self.questions {
            let sent = BEGAN + self.every * question;
            let took = (self.there)(&mut rng);
            let there = self.arrives(sent, took, &mut last_there, &mut rng);
            // The robot's processing time does not count as a delay of the link. The robot answers in order.
            answered = answered.max(there + Span::from_millis_f64(30.0 * rng.f64()));
            let took = (self.back)(&mut rng);
            let received = self.arrives(answered, took, &mut last_back, &mut rng);
            robot.exchanges.push(Exchange {
                sent,
                robot_received: self.robot_shows(there),
                robot_sent: self.robot_shows(answered),
                received,
            });
        }
        let mut history = History::default();
        history.source = HistorySource::Recording;
        history.scenario = Some("show".to_owned());
        history.robots.push(robot);
        history
    }

    fn measured(&self, seed: u64) -> RobotMeasured {
        Measured::of(&self.history(seed)).unwrap().robots.remove(0)
    }
}

#[track_caller]
fn near(measured: Span, truth_ms: f64, within_ms: f64) {
    let off = (measured.as_millis_f64() - truth_ms).abs();
    assert!(off <= within_ms, "{measured} is not {truth_ms} ms to within {within_ms} ms");
}

#[test]
fn constant_delay_is_measured_at_any_clock_offset_and_drift() {
    for (offset, drift_ppm) in [(0, 0.0), (120, 12.0), (-3_600_000, -80.0)] {
        let offset = Span::from_millis(offset);
        let truth = Truth { there: constant, back: constant, offset, drift_ppm, ..Truth::default() };
        let link = truth.measured(1).link.unwrap();
        assert_eq!(link.method, Method::EachWay);
        assert_eq!(link.samples, 800);
        // While a message is in transit, the clock gains 5 ms * 80 ppm = 0.4 us.
        near(link.delay.least, 5.0, 1e-3);
        near(link.delay.largest, 5.0, 1e-3);
    }
}

/// The standard error of the quantile p of n samples is sqrt(p (1 - p) / n) / density. Here, the density is 1 / (8 ms) and n is 800. So
/// the error is 0.14 ms for the median, and 0.085 ms for the 90th percentile.
///
/// The tolerance is four standard errors plus the error of the line. The minimum of 400 delays exceeds the true minimum by 8 ms / 400 =
/// 0.02 ms on average.
#[test]
fn delay_quantiles_are_of_one_direction_and_not_of_half_round_trips() {
    for seed in 0..20 {
        let offset = Span::from_millis(40);
        let link = Truth { offset, drift_ppm: 25.0, ..Truth::default() }.measured(seed).link.unwrap();
        near(link.delay.least, 2.0, 0.15);
        near(link.delay.p50, 6.0, 0.6 + 0.1);
        // Half of the sum of two delays would yield 8.2 ms.
        near(link.delay.p90, 9.2, 0.34 + 0.1);
        near(link.delay.largest, 10.0, 0.3);
    }
}

#[test]
fn offset_and_drift_of_a_robot_clock_are_measured() {
    for (seed, drift_ppm) in (0..).zip([0.0, 12.0, -45.0, 300.0, 2_000.0]) {
        let truth = Truth { offset: Span::from_millis(120), drift_ppm, questions: 1_200, ..Truth::default() };
        let clock = truth.measured(seed).clock.unwrap();
        // The minimum delays of both directions agree to about 8 ms / 1,200 at either end of 300 s.
        near(clock.offset, 120.0, 0.2);
        assert!(clock.uncertainty.unwrap() >= Span::from_millis_f64(1.9), "{clock:?}");
        let drift = clock.drift.unwrap();
        assert!((drift.ppm - drift_ppm).abs() < 1.0, "{drift:?}");
        assert!(drift.least <= drift_ppm && drift_ppm <= drift.most, "{drift:?}");
        let moved = drift_ppm.abs() * 1e-6 * 300_000.0;
        // The result is reduced by the uncertainty of the exchange, which is at most 10 ms.
        let most = if drift_ppm < 0.0 { 120.0 } else { 120.0 + moved };
        near(clock.surely_off.unwrap(), most - 5.0, 5.5);
    }
}

/// The number of lost packets is binomially distributed. For 4,000 packets and a loss of 2 %, four standard deviations of the measured
/// loss are 0.9 percentage points.
#[test]
fn losses_are_counted_per_packet_and_not_as_delays() {
    let truth = Truth { loss: 0.02, questions: 2_000, ..Truth::default() };
    let link = truth.measured(3).link.unwrap();
    assert!((link.loss.share - 0.02).abs() < 0.009, "{:?}", link.loss);
    near(link.loss.resent_after.unwrap(), 200.0, 4.1);
    near(link.delay.largest, 10.0, 0.3);
    assert_eq!(link.interruptions, []);
}

#[test]
fn loss_is_only_bounded_if_no_packet_was_lost() {
    let link = Truth::default().measured(1).link.unwrap();
    assert_eq!((link.loss.lost, link.loss.packets, link.loss.below), (0, 800, Some(3.0 / 800.0)));
    let text = text(&Truth::default());
    assert!(text.contains("# lost: none of 800 packets, so below 0.375% with 95 % confidence\n"), "{text}");
    assert!(!text.contains(" loss:"), "{text}");
}

#[test]
fn pause_with_many_waiting_requests_is_one_interruption_and_no_loss() {
    let held = Some((Span::from_millis(10_100), Span::from_millis(3_000)));
    let truth = Truth { held, every: Span::from_millis(50), ..Truth::default() };
    let link = truth.measured(5).link.unwrap();
    assert_eq!(link.loss.lost, 0, "{link:?}");
    assert_eq!(link.interruptions.len(), 1, "{link:?}");
    // The first delayed question departed up to 50 ms plus one delay before or after the start of the interruption.
    near(link.interruptions[0].lasted, 3_000.0, 70.0);
    near(link.delay.largest, 10.0, 0.3);
}

#[test]
fn delays_are_half_round_trips_if_the_clock_was_set() {
    let truth = Truth { there: constant, back: constant, ..Truth::default() };
    let mut history = truth.history(1);
    for exchange in history.robots[0].exchanges.iter_mut().skip(200) {
        exchange.robot_received = exchange.robot_received + Span::from_millis(500);
        exchange.robot_sent = exchange.robot_sent + Span::from_millis(500);
    }
    let robot = Measured::of(&history).unwrap().robots.remove(0);
    // A line that rises by 0.5 s over 100 s (5,000 ppm) does not fit between bounds that are 10 ms apart.
    let link = robot.link.unwrap();
    assert_eq!(link.method, Method::HalfRoundTrip);
    near(link.delay.p50, 5.0, 1e-5);
    assert_eq!(link.loss.packets, 800);
    assert_eq!(robot.clock.unwrap().steps, 1);
}

#[test]
fn losses_are_counted_per_packet_even_if_only_round_trips_are_known() {
    let truth = Truth {
        counts_in: Span::from_millis(1),
        loss: 0.02,
        questions: 2_000,
        there: short,
        back: short,
        ..Truth::default()
    };
    let link = truth.measured(3).link.unwrap();
    assert_eq!(link.method, Method::HalfRoundTrip);
    assert!((link.loss.share - 0.02).abs() < 0.009, "{:?}", link.loss);
    near(link.delay.p50, 1.0, 0.5);
}

#[test]
fn every_kind_of_measurement_yields_a_readable_world() {
    let held = Some((Span::from_millis(10_100), Span::from_millis(3_000)));
    let worlds = [
        Truth { loss: 0.02, ..Truth::default() },
        Truth { held, every: Span::from_millis(50), ..Truth::default() },
        Truth { counts_in: Span::from_millis(1), there: short, back: short, ..Truth::default() },
        Truth { questions: 1, ..Truth::default() },
        Truth { offset: Span::from_millis(-7_200_000), drift_ppm: -80.0, ..Truth::default() },
        // A clock that starts in 1970.
        Truth { offset: BEGAN - Timestamp::from_nanos(0), ..Truth::default() },
    ];
    for truth in worlds {
        let mut history = truth.history(7);
        text_of(&history, "show.mcap");
        history.records.push((BEGAN, shifted(&[1.0])));
        assert_eq!(text_of(&history, "show.mcap"), text_of(&history.clone(), "show.mcap"));
    }
}

#[test]
fn few_exchanges_yield_no_drift() {
    let truth = Truth { questions: 5, offset: Span::from_millis(7), ..Truth::default() };
    let clock = truth.measured(2).clock.unwrap();
    assert_eq!(clock.drift, None);
    near(clock.offset, 7.0, 4.0);
}

/// Creates the record of an act whose scripts are shifted in time by `millis`, in milliseconds.
fn shifted(millis: &[f64]) -> Record {
    let hash = Command::ReadSensor.content_hash();
    let shifted = |millis| PromisedScript { shift: Span::from_millis_f64(millis), ..script("s", hash) };
    prepared(0, millis.iter().copied().map(shifted).collect())
}

/// Adds the decisions of a mission and its messages to the operator.
fn told(history: &mut History) {
    let at = |ms| BEGAN + Span::from_millis(ms);
    history.records.push((at(0), shifted(&[120.0, 120.1])));
    let robot = || "r".parse().unwrap();
    let waiting = |act: &str, awaits: &str| Progress::Waiting {
        act: act.to_owned(),
        awaits: awaits.to_owned(),
        at: None,
    };
    let preparing = |act: &str| Progress::Preparing {
        act: act.to_owned(),
        timestamp: BEGAN,
        start: BEGAN,
        lead: LeadTime { prepare: Span::ZERO, lease: Span::ZERO, margin: Span::ZERO },
        skew: None,
        slowest: None,
    };
    let lost = || Progress::LinkLost { robot: robot(), reason: "reset".to_owned(), until: None };
    let told = [
        (0, waiting("one", "the operator's go, for 1 min at most")),
        (2_500, preparing("one")),
        (4_000, lost()),
        (4_800, Progress::Reattached { robot: robot() }),
        (5_000, waiting("two", "`r/range` above 1")),
        (5_500, preparing("two")),
        (6_000, waiting("three", "the operator's go")),
        (9_000, lost()),
        (10_500, Progress::AtHome),
    ];
    history.told.extend(told.map(|(ms, value)| (at(ms), value)));
    let readings = [(1_000, 2.0), (2_000, 2.0), (3_000, 0.4)].map(|(ms, value)| (at(ms), value));
    history.robots[0].readings.insert("range".to_owned(), readings.to_vec());
}

fn text(truth: &Truth) -> String {
    text_of(&truth.history(1), "show.mcap")
}

/// Writes the world file, reads it back, and checks it. Returns its text.
#[track_caller]
fn text_of(history: &History, file: &str) -> String {
    let text = world_text(&Measured::of(history).unwrap(), file);
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("fleet.yaml"), "robots:\n  r: {init: r.yaml, address: sim}\n").unwrap();
    std::fs::write(path("r.yaml"), ROBOT).unwrap();
    std::fs::write(path("world.yaml"), &text).unwrap();
    let (fleet, findings) = downbeat_scripts::read_fleet(&path("fleet.yaml"));
    let fleet = fleet.unwrap_or_else(|| panic!("{findings:?}"));
    let (world, findings) = downbeat_scripts::read_world(&path("world.yaml"), &fleet, &[]);
    let world = world.unwrap_or_else(|| panic!("{text}\n{findings:?}"));
    let measured = Measured::of(history).unwrap();
    assert_eq!(world.links[0].is_some(), measured.robots[0].link.is_some(), "{text}");
    assert_eq!(world.sensors.len(), measured.sensors.len(), "{text}");
    assert_eq!(world.incidents.len(), measured.robots[0].breaks.len(), "{text}");
    if let (Some(read), Some(link)) = (&world.links[0], &measured.robots[0].link) {
        assert!((read.loss - link.loss.share).abs() <= 0.005 * link.loss.share, "{text}");
        assert_eq!(read.interruptions.len(), usize::from(!link.interruptions.is_empty()), "{text}");
        let Delay::Quantiles([least, .., largest]) = read.delay else { panic!("{text}") };
        near(least, link.delay.least.as_millis_f64(), 0.000_51);
        near(largest, link.delay.largest.as_millis_f64(), 0.000_51);
    }
    text
}

const ROBOT: &str = "id: r
api_version: '1'
devices:
  - id: range
    available_control_types: {sensor: {min_value: 0, max_value: 5}}
";

#[test]
fn world_file_states_measurements_and_their_method() {
    let truth = Truth {
        there: constant,
        back: constant,
        questions: 41,
        offset: Span::from_millis(120),
        ..Truth::default()
    };
    let mut history = truth.history(1);
    told(&mut history);
    let written = text_of(&history, "show.mcap");
    let (_, written) = written.split_once("\nworld: ").unwrap();
    let clock = written.lines().find(|line| line.starts_with("  # offset")).unwrap();
    assert!(clock.starts_with("  # offset 120ms ±5ms, 41 exchanges, drift "), "{clock}");
    let written: String =
        written.lines().filter(|line| *line != clock).map(|line| format!("{line}\n")).collect();
    assert_eq!(
        written,
        "show-2027-01-15
links:
  # 82 delays of 41 exchanges, each direction separately; p99 is based on few samples
  r:
    delay: {least: 5ms, p50: 5ms, p90: 5ms, p99: 5ms, largest: 5ms}
    # lost: none of 82 packets, so below 3.66% with 95 % confidence
clocks:
  r: {offset: 120ms}
sensors:
  # 3 readings; the first one applies from the beginning
  r/range: [[0s, 2], [3s, 0.4]]
# 1 wait for the operator's go, and 1 that received none
operator: {go_after: 2.5s}
incidents:
  - {robot: r, what: link_down, at: 4s, lasts: 800ms}
  # The connection was not restored by the end of the file: the robot may have failed.
  - {robot: r, what: link_down, at: 9s, lasts: 1.5s}
"
    );
}

#[test]
fn names_are_escaped_in_comments_and_keys() {
    let mut history = Truth::default().history(1);
    history.scenario = Some("a\nb: {".to_owned());
    let text = text_of(&history, "x\ny.mcap");
    assert!(text.starts_with("# Measured in \"x\\u000ay.mcap\" by"), "{text}");
    assert!(text.contains("\nworld: \"a\\u000ab: {-2027-01-15\"\n"), "{text}");
}

#[test]
fn ntp_clock_has_the_detected_error_or_the_detection_limit() {
    let ntp = |offset| {
        let truth =
            Truth { there: constant, back: constant, offset: Span::from_millis(offset), ..Truth::default() };
        let mut history = truth.history(1);
        history.records.push((BEGAN, shifted(&[0.0])));
        text_of(&history, "show.mcap")
    };
    assert!(
        ntp(3).contains(
            "no error was detected, but an error of this size cannot be ruled out\n  r: {error: 5ms}\n"
        ),
        "{}",
        ntp(3)
    );
    assert!(
        ntp(-20).contains("the clock was certainly off, by about this much\n  r: {error: 20ms}\n"),
        "{}",
        ntp(-20)
    );
}

/// The recording covers 5 s of fast exchanges, as on one host. The system delays some of them, so the line that fits best has a drift
/// although the clock has none.
#[test]
fn best_fit_drift_of_a_short_recording_implies_no_clock_error() {
    let quick = |rng: &mut Rng| 0.02 + 0.1 / (rng.f64() + 0.07);
    for seed in 0..50 {
        let every = Span::from_millis(70);
        let truth = Truth { there: quick, back: quick, questions: 70, every, ..Truth::default() };
        let clock = truth.measured(seed).clock.unwrap();
        assert_eq!(clock.surely_off, None, "{clock:?}");
    }
}

#[test]
fn no_world_is_created_without_measurements() {
    let mut history = History::default();
    history.robots.push(KnownRobot::new("r".parse().unwrap(), None));
    assert_eq!(Measured::of(&history).unwrap_err(), NothingMeasured::Journal);
    assert!(NothingMeasured::Journal.to_string().contains("run --record FILE"));
    history.source = HistorySource::Recording;
    assert_eq!(Measured::of(&history).unwrap_err(), NothingMeasured::Recording);
}
