//! Tests of the estimator with simulated devices whose latency is known.

use urrcp::Span;

use super::*;

/// A simulated device and its sensor. Times are in milliseconds, and values are shares of the movement.
#[derive(Clone, Copy, Debug)]
struct Device {
    latency: f64,
    /// Standard deviation of the latency from trial to trial.
    deviation: f64,
    time_constant: f64,
    /// Number of equal lags in series: one or two. The time constant is their total.
    lags: u8,
    noise: f64,
    /// Delay of the sensor between request and response. The sensor takes the value at the request.
    delay: f64,
    /// Maximum additional random delay of the sensor.
    delay_varies: f64,
    /// Duration of the movement.
    lasts: f64,
}

const LINK: f64 = 0.8;
/// Pause between a response and the next request, in milliseconds.
const BETWEEN: f64 = 1.0;
const MOVEMENT: f64 = 2.0;
const VISIBLE: f64 = 0.02;
const REST: f64 = 30.0;

impl Device {
    fn trial(&self, rng: &mut fastrand::Rng, taken: Taken) -> (Trial, f64) {
        let latency = (self.latency + self.deviation * normal(rng)).max(0.0);
        let commanded = Commanded::ramp(Span::from_millis_f64(self.lasts));
        let interval = LINK + self.delay + BETWEEN;
        let mut asked = -(20.0 * interval).max(100.0) + rng.f64() * interval;
        let until = self.lasts + self.latency + 6.0 * self.time_constant + 10.0 * interval + 50.0;
        let mut samples = Vec::new();
        while asked < until {
            let arrived = asked + LINK / 2.0;
            let at_device = model::response(&commanded, self.lag(), arrived - latency);
            let value = REST + MOVEMENT * (at_device + self.noise * normal(rng));
            let answered = asked + LINK + self.delay + self.delay_varies * rng.f64();
            let reading = Reading {
                asked: Span::from_millis_f64(asked),
                answered: Span::from_millis_f64(answered),
                value,
            };
            let (at, uncertainty) = reading.instant(Span::from_millis_f64(LINK), taken);
            samples.push(Sample { at, uncertainty, value });
            asked = answered + BETWEEN;
        }
        (Trial { commanded, movement: MOVEMENT, samples }, latency)
    }

    fn lag(&self) -> model::Lag {
        model::Lag { constant: self.time_constant, lags: self.lags, later: 0.0 }
    }

    /// Returns the time until the device has visibly moved, minus the time that a device without latency and lag needs.
    fn visible(&self) -> f64 {
        let commanded = Commanded::ramp(Span::from_millis_f64(self.lasts));
        self.latency + model::visible_delay(&commanded, self.lag(), VISIBLE / MOVEMENT)
    }

    fn trials(&self, seed: u64, count: usize) -> Vec<Trial> {
        let mut rng = fastrand::Rng::with_seed(seed);
        (0..count).map(|_| self.trial(&mut rng, Taken::AtRequest).0).collect()
    }
}

/// Returns a normally distributed random number (Box–Muller transform).
fn normal(rng: &mut fastrand::Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.f64()).cos()
}

const READABLE: Readable = Readable { range: Some((-180.0, 180.0)), visible: VISIBLE };

/// Returns the duration that `downbeat calibrate` chooses for a movement. The duration and the interval between readings are in
/// milliseconds.
fn lasts(interval: f64) -> f64 {
    (1.5 * interval).max(40.0)
}

/// Returns the latency that 95 % of the device's movements do not exceed.
fn true_p95(device: &Device) -> f64 {
    device.visible() + 1.645 * device.deviation
}

#[test]
#[expect(clippy::print_stdout, reason = "figures for docs/latency.md")]
fn latency_is_within_two_ms_for_any_lag_noise_and_sensor_delay() {
    let mut rng = fastrand::Rng::with_seed(19);
    let devices =
        std::env::var("DOWNBEAT_DEVICES").ok().and_then(|devices| devices.parse().ok()).unwrap_or(20);
    let (mut worst, mut covered, mut within) = (0.0_f64, 0, 0);
    for seed in 0..devices {
        let delay = 30.0 * rng.f64();
        let device = Device {
            latency: 5.0 + 195.0 * rng.f64(),
            deviation: 0.3 + 2.0 * rng.f64(),
            time_constant: if seed % 2 == 0 { 0.0 } else { 5.0 + 35.0 * rng.f64() },
            lags: if seed % 4 == 1 { 2 } else { 1 },
            noise: 0.01,
            delay,
            delay_varies: 0.1 * delay,
            lasts: lasts(LINK + delay + BETWEEN),
        };
        let found = estimate(&device.trials(seed, 20), READABLE);
        let latencies = found.latencies.unwrap_or_else(|| panic!("{device:?}: {:?}", found.onsets));
        let error = (latencies.median.as_millis_f64() - device.visible()).abs();
        assert!(error < 2.0, "off by {error} ms: {device:?}, {found:?}");
        worst = worst.max(error);
        covered += u64::from(latencies.p95.as_millis_f64() >= true_p95(&device));
        within += u64::from(latencies.spread.as_millis_f64() >= 1.96 * device.deviation);
    }
    println!("largest error {worst:.2} ms; p95 holds in {covered} of {devices}, spread in {within}");
    assert!(100 * covered >= 95 * devices, "the stated p95 holds in {covered} of {devices}");
    assert!(100 * within >= 90 * devices, "the stated spread holds in {within} of {devices}");
}

#[test]
fn time_constant_and_tracking_lag_are_reported() {
    for lags in [1, 2] {
        let device = Device { time_constant: 20.0, lags, lasts: 120.0, ..DEVICE };
        let found = estimate(&device.trials(7, 20), READABLE);
        assert_eq!(found.lag.unwrap().lags, lags);
        let constant = found.lag.unwrap().time_constant.as_millis_f64();
        let lag = found.tracking_lag.unwrap().as_millis_f64();
        assert!((constant - 20.0).abs() < 2.0 && (lag - 60.0).abs() < 2.0, "{constant}, {lag}");
    }
    let none = estimate(&DEVICE.trials(7, 20), READABLE);
    assert_eq!(none.lag, None);
}

#[test]
fn unknown_sampling_time_is_assumed_at_half_the_sensor_delay() {
    let reading = Reading { asked: Span::ZERO, answered: Span::from_millis(31), value: 0.0 };
    let link = Span::from_millis(1);
    let half = Span::from_millis_f64(0.5);
    assert_eq!(reading.instant(link, Taken::AtRequest), (half, half));
    assert_eq!(reading.instant(link, Taken::AtAnswer), (Span::from_millis_f64(30.5), half));
    assert_eq!(
        reading.instant(link, Taken::Between),
        (Span::from_millis_f64(15.5), Span::from_millis_f64(15.5))
    );
    // The device takes its values at the request, so the assumed middle is 15 ms late. The reported uncertainty covers this.
    let device = Device { delay: 30.0, lasts: lasts(31.0), ..DEVICE };
    let mut rng = fastrand::Rng::with_seed(3);
    let trials: Vec<Trial> = (0..20).map(|_| device.trial(&mut rng, Taken::Between).0).collect();
    let found = estimate(&trials, READABLE);
    let latency = found.latencies.unwrap().median.as_millis_f64();
    let systematic = found.onsets[0].unwrap().uncertainty.as_millis_f64();
    assert!((latency - 55.0).abs() < 2.0 && systematic >= 15.0, "{latency} +-{systematic}");
}

const DEVICE: Device = Device {
    latency: 40.0,
    deviation: 1.0,
    time_constant: 0.0,
    lags: 1,
    noise: 0.01,
    delay: 2.0,
    delay_varies: 0.0,
    lasts: 40.0,
};

/// Changes the readings of one movement and checks that the estimator returns the expected error.
#[track_caller]
fn refused(device: Device, change: impl Fn(&mut Sample), expected: fn(&Unclear) -> bool) {
    let mut trial = device.trials(5, 1).remove(0);
    trial.samples.iter_mut().for_each(change);
    let found = onset(&trial, READABLE, None);
    assert!(found.as_ref().is_err_and(expected), "{found:?}");
}

#[test]
fn unusable_readings_are_refused_with_the_reason() {
    refused(Device { noise: 0.4, ..DEVICE }, |_| {}, |why| matches!(why, Unclear::Noisy { .. }));
    refused(DEVICE, |sample| sample.value = REST, |why| matches!(why, Unclear::NothingMoved { .. }));
    let saturated = |sample: &mut Sample| sample.value = sample.value.max(180.0);
    refused(DEVICE, saturated, |why| matches!(why, Unclear::Saturated { .. }));
    let early = |sample: &mut Sample| sample.at = sample.at - Span::from_millis(70);
    refused(DEVICE, early, |why| matches!(why, Unclear::MovedBefore { .. }));
    // A reading with a delayed response may actually be from after the command.
    let delayed = |sample: &mut Sample| {
        early(sample);
        sample.uncertainty = Span::from_millis(70);
    };
    refused(DEVICE, delayed, |why| matches!(why, Unclear::LateReading { .. }));
    refused(
        Device { delay: 400.0, ..DEVICE },
        |sample| sample.at = sample.at.max(Span::ZERO),
        |why| matches!(why, Unclear::TooSparse { before: 0, .. }),
    );
}

#[test]
fn device_still_moving_at_the_last_reading_is_refused() {
    let mut trial = Device { time_constant: 200.0, ..DEVICE }.trials(5, 1).remove(0);
    trial.samples.retain(|sample| sample.at < Span::from_millis(250));
    let found = onset(
        &trial,
        READABLE,
        Some(downbeat_fleet::fleet::Lag {
            time_constant: Span::from_millis(200),
            lags: 1,
            later: Span::ZERO,
        }),
    );
    assert!(matches!(found, Err(Unclear::NotSettled { .. })), "{found:?}");
}

#[test]
fn bounds_match_the_published_tables() {
    // By hand from Natrella's formula with z = 1.645 and 1.960 for 20 trials: a = 0.89891, b = 2.51347. Howe's factor is 2.752
    // (NIST/SEMATECH e-Handbook, section 7.2.6.3).
    assert!((quantile_bound(20, 0.0, 1.0) - 2.5729).abs() < 0.0005, "{}", quantile_bound(20, 0.0, 1.0));
    assert!((spread_bound(20, 1.0) - 2.752).abs() < 0.02, "{}", spread_bound(20, 1.0));
    assert_eq!(Latencies::of(&[1.0, 2.0]), None);
}

#[test]
fn device_begins_visibly_once_it_has_moved_by_the_visible_amount() {
    let ramp = Commanded::ramp(Span::from_millis(100));
    let delay = |lag: model::Lag, share: f64| model::visible_delay(&ramp, lag, share);
    assert!(delay(model::Lag::NONE, 0.1).abs() < 1e-9);
    // Without a lag, a hundredth of the movement needs at least 1 ms. With one lag of 20 ms: t - 20 (1 - exp(-t / 20)) = 1; with two of
    // 10 ms: t - 20 + (t + 20) exp(-t / 10) = 1.
    for (lags, t) in [(1, 6.676), (2, 9.861)] {
        let lag = model::Lag { constant: 20.0, lags, later: 0.0 };
        assert!((delay(lag, 0.01) - (t - 1.0)).abs() < 0.01, "{lags}: {}", delay(lag, 0.01));
    }
    // A step reaches half of its size after ln 2 time constants.
    let step = Commanded::ramp(Span::ZERO);
    let lag = model::Lag { constant: 20.0, lags: 1, later: 0.0 };
    assert!((model::visible_delay(&step, lag, 0.5) - 20.0 * 2.0_f64.ln()).abs() < 1e-6);
}

/// Simulates a trial of a device with Coulomb friction. It rests until its deviation exceeds `friction` (a share of the movement), and
/// then follows with one lag.
fn with_friction(rng: &mut fastrand::Rng, friction: f64, noise: f64, sensor: f64) -> Trial {
    const TAU: f64 = 30.0;
    const LASTS: f64 = 250.0;
    const DEAD_TIME: f64 = 8.0;
    const TICK: f64 = 0.05;
    let (mut samples, mut place, mut at) = (Vec::new(), 0.0, -200.0);
    let mut asked = at + rng.f64() * sensor;
    while at < 700.0 {
        let wanted = ((at - DEAD_TIME) / LASTS).clamp(0.0, 1.0);
        let pull = f64::max(wanted - place - friction, 0.0);
        place += pull / TAU * TICK;
        at += TICK;
        if at >= asked {
            let value = REST + MOVEMENT * (place + noise * normal(rng));
            samples.push(Sample { at: Span::from_millis_f64(at), uncertainty: Span::ZERO, value });
            asked += sensor;
        }
    }
    let commanded = Commanded::ramp(Span::from_millis_f64(LASTS));
    Trial { commanded, movement: MOVEMENT, samples }
}

/// Returns the time that the device with friction needs to move by the visible amount, minus the time that a device without latency and
/// lag needs.
fn true_begin(friction: f64) -> f64 {
    let trial = with_friction(&mut fastrand::Rng::with_seed(1), friction, 0.0, 0.05);
    let moved = |sample: &&Sample| sample.value >= REST + VISIBLE;
    let crossed = trial.samples.iter().find(moved).unwrap().at.as_millis_f64();
    crossed - trial.commanded.lasts().as_millis_f64() * VISIBLE / MOVEMENT
}

#[test]
fn device_with_static_friction_begins_when_its_readings_show_it() {
    for (noise, sensor) in [(0.0, 21.7), (0.0005, 21.7), (0.001, 5.0), (0.002, 2.0)] {
        let mut rng = fastrand::Rng::with_seed(31);
        let trials: Vec<Trial> = (0..20).map(|_| with_friction(&mut rng, 0.06, noise, sensor)).collect();
        let found = estimate(&trials, READABLE);
        let latency = found.latencies.unwrap().median.as_millis_f64();
        let truth = true_begin(0.06);
        assert!(
            (latency - truth).abs() < 1.5,
            "noise {noise}, every {sensor} ms: {latency} is not {truth}, {:?}",
            found.lag
        );
        let lag = found.lag.unwrap();
        assert!(lag.later > Span::from_millis(2), "the fit alone would do: {lag:?}");
        // The latency of a single motion, with the lag from all trials.
        let one = onset(&trials[0], READABLE, Some(lag)).unwrap().latency.as_millis_f64();
        assert!((one - truth).abs() < 2.5, "{one} is not {truth}");
    }
}

#[test]
fn sensor_showing_the_opposite_movement_is_refused() {
    let mirrored = |sample: &mut Sample| sample.value = 2.0 * REST - sample.value;
    refused(
        DEVICE,
        mirrored,
        |why| matches!(why, Unclear::WrongWay { seen, movement } if seen * movement < 0.0),
    );
}

#[test]
fn device_too_slow_for_the_fit_is_refused() {
    let slow = Device { time_constant: 900.0, lasts: 40.0, ..DEVICE };
    let trial = slow.trials(5, 1).remove(0);
    let found = onset(&trial, READABLE, None);
    assert!(matches!(found, Err(Unclear::TooSlow { .. })), "{found:?}");
}

#[test]
fn noiseless_readings_of_a_device_without_lag_show_no_lag() {
    let exact = Device { noise: 0.0, deviation: 0.0, ..DEVICE };
    let found = estimate(&exact.trials(9, 20), READABLE);
    assert_eq!(found.lag, None);
    assert!((found.latencies.unwrap().median.as_millis_f64() - 40.0).abs() < 0.1);
}
