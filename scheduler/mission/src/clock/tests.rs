use super::*;

/// Exchanges with a robot whose clock is off by `offset(t)`, `t` in seconds.
struct Path<F> {
    offset: F,
    rng: fastrand::Rng,
    /// Longest delay of the question and of the answer, in nanoseconds.
    delays: (i64, i64),
}

impl<F: Fn(f64) -> f64> Path<F> {
    fn new(seed: u64, delays: (i64, i64), offset: F) -> Self {
        Self { offset, rng: fastrand::Rng::with_seed(seed), delays }
    }

    fn offset_at(&self, now: Timestamp<Server>) -> Span {
        Span::from_millis_f64((self.offset)(now.as_nanos() as f64 / 1e9) * 1e3)
    }

    fn robot(&self, now: Timestamp<Server>) -> Timestamp<Robot> {
        now.assume_clock() + self.offset_at(now)
    }

    fn exchange(&mut self, sent: Timestamp<Server>) -> ClockSample {
        let mut way = |longest| Span::from_nanos(self.rng.i64(0..=longest));
        let (there, takes, back) = (way(self.delays.0), way(5_000_000), way(self.delays.1));
        let (arrives, leaves) = (sent + there, sent + there + takes);
        ClockSample::from_exchange(sent, self.robot(arrives), self.robot(leaves), leaves + back)
    }

    #[track_caller]
    fn assert_covered(&self, estimate: &ClockEstimate, now: Timestamp<Server>) {
        let reading = estimate.reading_at(now).unwrap();
        let error = (reading.offset - self.offset_at(now)).abs();
        assert!(error <= reading.uncertainty, "off by {error} at {now}: {reading:?}");
        assert!(
            reading.drift.is_none_or(|drift| drift.uncertainty_ppm < 50.0),
            "known too early: {reading:?}"
        );
    }
}

fn at(seconds: f64) -> Timestamp<Server> {
    Timestamp::from_nanos(0) + Span::from_millis_f64(seconds * 1e3)
}

#[test]
fn exchange_yields_midpoint_offset_and_delay_without_processing_time() {
    let robot = |nanos: i64| Timestamp::<Robot>::from_nanos(1_000_000_000 + nanos);
    // The question takes 300 us, the robot 50 us, the answer 100 us; the robot's clock is 7 ms ahead.
    let received = at(1.0) + Span::from_nanos(450_000);
    let sample = ClockSample::from_exchange(at(1.0), robot(7_300_001), robot(7_350_001), received);
    assert_eq!(sample.offset, Span::from_nanos(7_100_001));
    assert_eq!(sample.delay, Span::from_nanos(400_000));
    // The bounds are widened by 1 ns, the resolution of these timestamps.
    assert_eq!([sample.lower, sample.upper].map(Span::as_nanos), [6_900_000, 7_300_002]);
    assert_eq!((sample.sent, sample.at), (at(1.0), received));
}

#[test]
fn true_offset_is_within_the_uncertainty_at_any_delay_and_drift() {
    let mut rng = fastrand::Rng::with_seed(7);
    for seed in 0..2_000 {
        let (offset, rate) = (rng.f64() - 0.5, (rng.f64() * 2.0 - 1.0) * DRIFT_BOUND);
        let delays = (rng.i64(0..80_000_000) >> rng.u32(0..20), rng.i64(0..80_000_000) >> rng.u32(0..20));
        let mut path = Path::new(seed, delays, |t| offset + rate * t);
        let mut estimate = ClockEstimate::default();
        let pause = rng.f64() * 10.0;
        let mut now = at(rng.f64());
        for _ in 0..rng.u32(1..200) {
            let sample = path.exchange(now);
            estimate.add(sample);
            path.assert_covered(&estimate, sample.at);
            now = sample.at + Span::from_millis_f64(rng.f64() * pause * 1e3);
        }
        assert_eq!(estimate.steps(), 0);
        // The estimate also holds before and long after the exchanges.
        path.assert_covered(&estimate, at(0.0));
        path.assert_covered(&estimate, now + Span::from_millis(600_000));
    }
}

#[test]
fn wandering_drift_is_tracked_for_hours() {
    for seed in 0..20 {
        let mean = (seed as f64 - 10.0) * 8e-6;
        // The rate swings by half the wander either way in a quarter of an hour.
        let omega = std::f64::consts::TAU / 900.0;
        let offset = move |t: f64| 0.1 + mean * t + DRIFT_WANDER / 2.0 / omega * (omega * t).sin();
        let mut path = Path::new(seed, (20_000_000, 60_000_000), offset);
        let mut estimate = ClockEstimate::default();
        for second in 0..3 * 3_600 {
            let sample = path.exchange(at(f64::from(second)));
            estimate.add(sample);
            path.assert_covered(&estimate, sample.at);
            path.assert_covered(&estimate, sample.at + Span::from_millis(30_000));
        }
        assert_eq!(estimate.steps(), 0);
        assert!(estimate.history.bins.len() <= BINS && estimate.history.bins.capacity() <= 2 * BINS + 2);
        let drift = estimate.reading().unwrap().drift.unwrap();
        assert!((drift.ppm - mean * 1e6).abs() <= drift.uncertainty_ppm, "{drift:?}");
        assert!(drift.uncertainty_ppm < 25.0, "{drift:?}");
    }
}

#[test]
fn drift_that_changes_over_hours_is_that_of_the_last_hour() {
    // The drift changes as on a machine that warms up: by 10 ppm per hour.
    let offset = |t: f64| -20e-6 * t + 10e-6 / 3_600.0 * t * t / 2.0;
    let mut path = Path::new(11, (2_000_000, 6_000_000), offset);
    let mut estimate = ClockEstimate::default();
    for k in 0..4 * 720 {
        let sample = path.exchange(at(f64::from(k) * 5.0));
        estimate.add(sample);
        path.assert_covered(&estimate, sample.at + Span::from_millis(30_000));
    }
    assert_eq!(estimate.steps(), 0);
    let drift = estimate.reading().unwrap().drift.unwrap();
    assert!((drift.ppm - 20.0).abs() <= drift.uncertainty_ppm, "{drift:?}");
}

#[test]
fn minimum_delays_per_direction_may_be_of_different_exchanges() {
    let mut estimate = ClockEstimate::default();
    let millis = |m: i64| Timestamp::<Server>::from_nanos(m * 1_000_000 + 1);
    let robot = |m: i64| Timestamp::<Robot>::from_nanos((m + 250) * 1_000_000 + 1);
    // The first question takes 1 ms and its answer 40 ms, the second question 40 ms and its answer 1 ms.
    estimate.add(ClockSample::from_exchange(millis(0), robot(1), robot(1), millis(41)));
    estimate.add(ClockSample::from_exchange(millis(100), robot(140), robot(140), millis(141)));
    let reading = estimate.reading().unwrap();
    assert!((reading.offset - Span::from_millis(250)).abs() < Span::from_micros(20), "{reading:?}");
    assert!(reading.uncertainty < Span::from_micros(1_020), "{reading:?}");
    assert_eq!(reading.delay_min, Span::from_millis(41));
}

#[test]
fn pause_affects_the_maximum_round_trip_and_not_the_typical_one() {
    let mut estimate = ClockEstimate::default();
    for k in 0..50 {
        let sent = at(f64::from(k) * 3.0);
        let back = if k == 20 { Span::from_millis(2_000) } else { Span::from_millis(1) };
        let robot = sent.assume_clock() + Span::from_nanos(500_001);
        estimate.add(ClockSample::from_exchange(sent, robot, robot, sent + back));
    }
    let reading = estimate.reading().unwrap();
    assert_eq!(reading.delay_max, Span::from_millis(2_000));
    assert_eq!(reading.delay_high, Span::from_millis(1));
}

#[test]
fn correct_clock_behind_an_uneven_link_is_not_suspected() {
    let exchange = |off: Span, there: i64, back: i64| {
        let sent = at(10.0);
        let robot = sent.assume_clock() + off + Span::from_micros(there * 1_000 + 1);
        let mut estimate = ClockEstimate::default();
        let received = sent + Span::from_millis(there + back);
        estimate.add(ClockSample::from_exchange(sent, robot, robot, received));
        estimate.reading().unwrap().doubt()
    };
    for (there, back) in [(0, 80), (80, 0), (40, 40), (1, 1)] {
        assert_eq!(exchange(Span::ZERO, there, back), ClockDoubt::Path, "{there} there, {back} back");
    }
    assert_eq!(exchange(Span::from_millis(250), 1, 80), ClockDoubt::Clock);
    assert_eq!(exchange(Span::from_millis(-250), 1, 80), ClockDoubt::Clock);
}

#[test]
fn step_is_detected_once_and_the_new_offset_is_found() {
    for (seed, step) in [0.05, -0.05, 5.0, -3_600.0].into_iter().enumerate() {
        let offset = move |t: f64| if t < 30.0 { 0.2 } else { 0.2 + step };
        let mut path = Path::new(seed as u64, (10_000_000, 30_000_000), offset);
        let mut estimate = ClockEstimate::default();
        for k in 0..600 {
            estimate.add(path.exchange(at(f64::from(k) * 0.1)));
            assert_eq!(estimate.steps(), u32::from(k >= 300), "{k}");
        }
        path.assert_covered(&estimate, at(60.0));
        assert_eq!(estimate.samples(), 600);
    }
}

#[test]
fn rate_change_within_the_bound_is_not_a_step() {
    let offset = |t: f64| if t < 300.0 { 80e-6 * t } else { 80e-6 * 300.0 - 80e-6 * (t - 300.0) };
    let mut path = Path::new(3, (500_000, 900_000), offset);
    let mut estimate = ClockEstimate::default();
    for second in 0..600 {
        estimate.add(path.exchange(at(f64::from(second))));
    }
    assert_eq!(estimate.steps(), 0);
    path.assert_covered(&estimate, at(600.0));
    let drift = estimate.reading().unwrap().drift.unwrap();
    assert!((drift.ppm + 80.0).abs() <= drift.uncertainty_ppm, "{drift:?}");
}

#[test]
fn millisecond_timestamps_of_a_robot_are_not_contradictory() {
    let mut path = Path::new(5, (100_000, 100_000), |_| 0.0123);
    let mut estimate = ClockEstimate::default();
    let whole = |t: Timestamp<Robot>| Timestamp::from_nanos(t.as_nanos() / 1_000_000 * 1_000_000);
    for k in 0..1_000 {
        let sent = at(f64::from(k) * 0.0101);
        let (there, back) = (path.rng.i64(0..100_000), path.rng.i64(0..100_000));
        let robot = whole(path.robot(sent + Span::from_nanos(there)));
        estimate.add(ClockSample::from_exchange(sent, robot, robot, sent + Span::from_nanos(there + back)));
    }
    assert_eq!(estimate.steps(), 0);
    path.assert_covered(&estimate, at(10.1));
}

#[test]
fn extreme_timestamps_do_not_overflow() {
    let mut estimate = ClockEstimate::default();
    for (a, b) in [(i64::MAX, i64::MIN), (i64::MIN, i64::MAX), (i64::MIN, i64::MIN), (0, 0), (1, -1)] {
        let (sent, received) = (Timestamp::from_nanos(b), Timestamp::from_nanos(a));
        let robot = Timestamp::from_nanos;
        estimate.add(ClockSample::from_exchange(sent, robot(a), robot(b), received));
        assert!(estimate.reading().is_some());
    }
}

#[test]
fn kept_bounds_are_as_tight_as_those_of_the_whole_window() {
    for seed in 0..20 {
        // The rate reverses after a quarter of an hour, so that bounds are kept for many rates in turn.
        let offset = |t: f64| if t < 900.0 { 20e-6 * t } else { 20e-6 * (1_800.0 - t) };
        let mut path = Path::new(seed, (20_000_000, 60_000_000), offset);
        let mut estimate = ClockEstimate::default();
        for k in 0..900 {
            let sample = path.exchange(at(f64::from(k) * 2.0));
            estimate.add(sample);
            let all = estimate.bounds.unwrap().interval(sample.at, Rates::ANY);
            let kept = estimate.history.narrow(all, sample.at);
            let whole = History { narrowest: None, ..estimate.history.clone() }.narrow(all, sample.at);
            // Products are rounded to nanoseconds.
            let grain = Span::from_nanos(2);
            assert!(
                kept.lower + grain >= whole.lower && kept.upper - grain <= whole.upper,
                "after {k} exchanges {kept:?}, by all bins {whole:?}"
            );
        }
    }
}

#[test]
fn drift_is_reported_once_it_is_known_to_half_its_bound() {
    // The means are known to `half`; the wander is added.
    let told = |half: f64| {
        let means = Rates { least: 10e-6 - half, most: 10e-6 + half };
        History { means, ..History::default() }.drift()
    };
    let known = told(34e-6).unwrap();
    assert!((known.ppm - 10.0).abs() < 1e-6 && (known.uncertainty_ppm - 49.0).abs() < 1e-6, "{known:?}");
    assert_eq!(told(36e-6), None);
    assert_eq!(told(f64::INFINITY), None);
}

#[test]
fn clock_at_the_limit_of_uncertainty_is_not_suspected() {
    let micros = Span::from_micros;
    assert_eq!(ClockDoubt::of(micros(5), micros(5)), ClockDoubt::Path);
    assert_eq!(ClockDoubt::of(micros(-6), micros(5)), ClockDoubt::Clock);
}

/// Returns the number of bins that measure the drift, and how often their width was doubled.
fn remembered(estimate: &ClockEstimate) -> (usize, u32) {
    (estimate.history.bins.len(), estimate.history.doublings)
}

#[test]
fn drift_history_becomes_coarser_only_when_it_is_full() {
    let mut path = Path::new(13, (1_000_000, 1_000_000), |_| 0.2);
    let mut estimate = ClockEstimate::default();
    for bin in 0..64 {
        estimate.add(path.exchange(Timestamp::from_nanos(bin * FIRST_BIN_NANOS)));
        assert_eq!(remembered(&estimate), (usize::try_from(bin).unwrap() + 1, 0));
    }
    estimate.add(path.exchange(Timestamp::from_nanos(64 * FIRST_BIN_NANOS)));
    assert_eq!(remembered(&estimate), (33, 1));
    let indices: Vec<_> = estimate.history.bins.iter().map(|bin| bin.index).collect();
    assert_eq!(indices, (0..=32).collect::<Vec<_>>());
}

#[test]
fn drift_history_is_no_coarser_than_one_hour_requires() {
    let mut path = Path::new(17, (1_000_000, 1_000_000), |_| 0.2);
    let mut estimate = ClockEstimate::default();
    let mut most = 0;
    for k in 0..1_440 {
        estimate.add(path.exchange(at(f64::from(k) * 10.0)));
        most = most.max(remembered(&estimate).0);
    }
    assert_eq!((most, remembered(&estimate)), (BINS, (BINS, DOUBLINGS_MAX)));
}

#[test]
fn nothing_is_kept_for_more_than_an_hour_even_with_rare_exchanges() {
    let mut path = Path::new(19, (1_000_000, 1_000_000), |_| 0.2);
    let mut estimate = ClockEstimate::default();
    for k in 0..30 {
        let sample = path.exchange(at(f64::from(k) * 390.0));
        estimate.add(sample);
        let oldest = estimate.history.bins.front().unwrap().bounds.lower.at;
        assert!(sample.at - oldest <= WINDOW, "{oldest} at {}", sample.at);
    }
    assert_eq!(estimate.history.bins.len(), 10);
}
