//! The estimator against devices that are known.

use urrcp::Span;

use super::*;

/// A device and its sensor, in milliseconds and in shares of the movement.
#[derive(Clone, Copy, Debug)]
struct Device {
    latency: f64,
    /// Standard deviation of the latency from trial to trial.
    deviation: f64,
    time_constant: f64,
    noise: f64,
    /// Of the sensor, between request and answer; the value is taken at the request.
    delay: f64,
    /// Its delay varies by as much more.
    delay_varies: f64,
    /// How long the movement takes.
    lasts: f64,
}

const LINK: f64 = 0.8;
const MOVEMENT: f64 = 2.0;
const REST: f64 = 30.0;

impl Device {
    fn trial(&self, rng: &mut fastrand::Rng, taken: Taken) -> (Trial, f64) {
        let latency = (self.latency + self.deviation * normal(rng)).max(0.0);
        let commanded = Commanded::ramp(Span::from_millis_f64(self.lasts));
        let interval = LINK + self.delay;
        let mut asked = -(20.0 * interval).max(100.0) + rng.f64() * interval;
        let until = self.lasts + self.latency + 6.0 * self.time_constant + 10.0 * interval + 50.0;
        let mut samples = Vec::new();
        while asked < until {
            let arrived = asked + LINK / 2.0;
            let at_device = model::response(&commanded, self.time_constant, arrived - latency);
            let value = REST + MOVEMENT * (at_device + self.noise * normal(rng));
            let answered = asked + LINK + self.delay + self.delay_varies * rng.f64();
            let reading =
                Reading { asked: Span::from_millis_f64(asked), answered: Span::from_millis_f64(answered), value };
            let (at, uncertainty) = reading.instant(Span::from_millis_f64(LINK), taken);
            samples.push(Sample { at, uncertainty, value });
            asked = answered + 0.2;
        }
        (Trial { commanded, samples }, latency)
    }

    fn trials(&self, seed: u64, count: usize) -> Vec<Trial> {
        let mut rng = fastrand::Rng::with_seed(seed);
        (0..count).map(|_| self.trial(&mut rng, Taken::AtRequest).0).collect()
    }
}

/// By Box and Muller.
fn normal(rng: &mut fastrand::Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.f64()).cos()
}

const READABLE: Readable = Readable { range: Some((-180.0, 180.0)), movement: MOVEMENT };

#[test]
fn explore() {
    for lasts_in in [1.5, 2.0, 3.2] {
        for delay in [30.0] {
            for time_constant in [0.0, 5.0, 20.0] {
                let device = Device { latency: 40.0, deviation: 1.5, time_constant, noise: 0.01, delay, delay_varies: 0.0,
                    lasts: lasts_in * (delay + LINK) };
                let (mut worst, mut constant_worst, mut within, mut n, mut sum) = (0.0_f64, 0.0_f64, 0, 0, 0.0);
                for seed in 0..30 {
                    let trials = device.trials(seed, 20);
                    let found = estimate(&trials, READABLE);
                    let Some(l) = found.latencies else { println!("{:?}", found.onsets[0]); continue };
                    n += 1;
                    let e = l.median.as_millis_f64() - 40.0;
                    sum += e;
                    worst = worst.max(e.abs());
                    constant_worst = constant_worst.max((found.time_constant.map_or(0.0, Span::as_millis_f64) - time_constant).abs());
                    within += usize::from(l.p95.as_millis_f64() >= 40.0 + 1.645 * 1.5);
                }
                println!("lasts {lasts_in:4} x, delay {delay:4}, tau {time_constant:4}: worst {worst:.2} bias {:.2} tau worst {constant_worst:.2} p95 {within}/{n}", sum / n as f64);
            }
        }
    }
}
