//! Measures how accurately the scheduler knows a robot's clock after two seconds of timestamp exchanges. Compares this with a single SNTP
//! query on the same network path.
//!
//! The paths are poor: each direction has its own minimum delay of 1 to 5 ms. The delay has a heavy tail, Pareto in one direction and
//! lognormal in the other, and is at most 40 ms. Ten thousand paths are simulated in virtual time. A few hundred run in real time. There,
//! a UDP proxy on loopback delays every datagram to an SNTP responder, whose clock drifts and has a known offset. If `chronyd` is
//! installed, `chronyd -Q` queries the same responders through the same proxies.
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a program that measures, and stops if it cannot"
)]
#![expect(clippy::disallowed_methods, reason = "real datagrams take real time")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

use std::net::SocketAddr;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use downbeat::clock::{ClockEstimate, ClockSample, DRIFT_BOUND};
use fastrand::Rng;
use rsntp::AsyncSntpClient;
use tokio::net::UdpSocket;
use urrcp::{Robot, Server, Span, Timestamp};

const VIRTUAL_TRIALS: u64 = 10_000;
const REAL_TRIALS: u64 = 400;
const CHRONY_TRIALS: u64 = 60;
/// Number of concurrent trials. It can be large, because they mostly sleep.
const AT_ONCE: u64 = 100;
const EXCHANGES_FOR: Span = Span::from_millis(2_000);
const PAUSE: Span = Span::from_millis(30);
/// Time from the last exchange until the clock estimate is read a second time.
const LATER: Span = Span::from_millis(10_000);
const DELAY_MAX_MS: f64 = 40.0;

/// The distribution of delays in one direction of a network path.
#[derive(Clone, Copy, Debug)]
struct Way {
    least_ms: f64,
    tail: Tail,
}

#[derive(Clone, Copy, Debug)]
enum Tail {
    /// Pareto distribution (type II) with shape 1.5, hence infinite variance, and scale 2 ms.
    Pareto,
    /// Lognormal distribution with median 5 ms and sigma 1.
    Lognormal,
}

impl Way {
    fn delay(self, rng: &mut Rng) -> Span {
        // In (0, 1], because zero has no logarithm.
        let mut uniform = || 1.0 - rng.f64();
        let tail = match self.tail {
            Tail::Pareto => 2.0 * (uniform().powf(-1.0 / 1.5) - 1.0),
            Tail::Lognormal => {
                let normal = (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos();
                5.0 * normal.exp()
            }
        };
        Span::from_millis_f64((self.least_ms + tail).min(DELAY_MAX_MS))
    }
}

/// A robot's clock and the network path to the robot.
#[derive(Clone, Copy, Debug)]
struct Path {
    there: Way,
    back: Way,
    offset: Span,
    drift: f64,
    began: Timestamp<Server>,
}

impl Path {
    fn new(rng: &mut Rng, began: Timestamp<Server>, drift_bound: f64) -> Self {
        let mut way = |tail| Way { least_ms: 1.0 + 4.0 * rng.f64(), tail };
        let (mut there, mut back) = (way(Tail::Pareto), way(Tail::Lognormal));
        if rng.bool() {
            (there, back) = (back, there);
        }
        let symmetric = |rng: &mut Rng| 2.0 * rng.f64() - 1.0;
        let offset = Span::from_millis_f64(500.0 * symmetric(rng));
        Self { there, back, offset, drift: drift_bound * symmetric(rng), began }
    }

    fn offset_at(&self, now: Timestamp<Server>) -> Span {
        self.offset + Span::from_millis_f64((now - self.began).as_millis_f64() * self.drift)
    }

    fn robot(&self, now: Timestamp<Server>) -> Timestamp<Robot> {
        now.assume_clock() + self.offset_at(now)
    }
}

/// Results of one method of estimating the clock, over all trials.
#[derive(Default)]
struct Found {
    errors_ms: Vec<f64>,
    uncertainties_ms: Vec<f64>,
    covered: usize,
}

impl Found {
    fn error(&mut self, error: Span) {
        self.errors_ms.push(error.abs().as_millis_f64());
    }

    fn reading(&mut self, error: Span, uncertainty: Span) {
        self.error(error);
        self.uncertainties_ms.push(uncertainty.as_millis_f64());
        self.covered += usize::from(error.abs() <= uncertainty);
    }

    fn add(&mut self, other: Self) {
        self.errors_ms.extend(other.errors_ms);
        self.uncertainties_ms.extend(other.uncertainties_ms);
        self.covered += other.covered;
    }

    fn coverage(&self) -> f64 {
        100.0 * self.covered as f64 / self.uncertainties_ms.len() as f64
    }

    fn row(&self, name: &str) {
        let error = |percent| rank(&self.errors_ms, percent);
        print!("{name:<38}{:>8}{:>11.3}{:>11.3}", self.errors_ms.len(), error(50), error(99));
        if self.uncertainties_ms.is_empty() {
            println!("{:>13}{:>11}", "-", "-")
        } else {
            println!("{:>13.3}{:>10.3}%", rank(&self.uncertainties_ms, 50), self.coverage())
        }
    }
}

/// Returns a percentile of `values` by the nearest-rank method.
fn rank(values: &[f64], percent: usize) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[(sorted.len() * percent).div_ceil(100) - 1]
}

#[derive(Default)]
struct Trials {
    single: Found,
    least_delay: Found,
    ours: Found,
    later: Found,
    chrony: Found,
    exchanges: usize,
}

impl Trials {
    /// Adds the results of one trial. `single` is the error of a separate single query. If it is `None`, the first exchange serves as the
    /// single query.
    fn take(&mut self, path: &Path, samples: &[ClockSample], single: Option<Span>) {
        let mut estimate = ClockEstimate::default();
        samples.iter().for_each(|&sample| estimate.add(sample));
        let (first, last) = (samples[0], samples[samples.len() - 1]);
        self.exchanges += samples.len();
        self.single.error(single.unwrap_or(first.offset - path.offset_at(first.at)));
        // Downbeat's previous method: RFC 5905's clock filter, which keeps the exchange with the least delay.
        let least = samples.iter().min_by_key(|sample| sample.delay).unwrap();
        self.least_delay
            .reading(least.offset - path.offset_at(last.at), least.delay / 2 + Span::from_nanos(1));
        let reading = estimate.reading().unwrap();
        self.ours.reading(reading.offset - path.offset_at(last.at), reading.uncertainty);
        let (later, end) = (estimate.reading_at(last.at + LATER).unwrap(), last.at + LATER);
        self.later.reading(later.offset - path.offset_at(end), later.uncertainty);
        assert_eq!(estimate.steps(), 0);
    }

    fn add(&mut self, other: Self) {
        self.single.add(other.single);
        self.least_delay.add(other.least_delay);
        self.ours.add(other.ours);
        self.later.add(other.later);
        self.chrony.add(other.chrony);
        self.exchanges += other.exchanges;
    }

    fn print(&self, title: &str) {
        let trials = self.ours.errors_ms.len();
        println!("\n{title}; {} exchanges a trial", self.exchanges / trials);
        println!(
            "{:<38}{:>8}{:>11}{:>11}{:>13}{:>11}",
            "ms", "trials", "error p50", "error p99", "stated p50", "covered"
        );
        self.single.row("single SNTP query (baseline)");
        self.least_delay.row("exchange of least delay");
        self.ours.row("all bounds together");
        self.later.row("all bounds together, 10 s later");
        if !self.chrony.errors_ms.is_empty() {
            self.chrony.row("chronyd -Q (4 exchanges in 6 s)");
        }
    }

    fn verdicts(&self, name: &str) {
        let verdict = |met| if met { "PASS" } else { "FAIL" };
        let ratio = rank(&self.ours.errors_ms, 50) / rank(&self.single.errors_ms, 50);
        println!(
            "{} {name}: median error / single SNTP query {ratio:.3}, target at most 0.5",
            verdict(ratio <= 0.5)
        );
        let coverage = self.ours.coverage().min(self.later.coverage());
        println!("{} {name}: coverage {coverage:.3} %, target at least 99.9 %", verdict(coverage >= 99.9));
    }
}

fn in_virtual_time() -> Trials {
    let mut trials = Trials::default();
    for seed in 0..VIRTUAL_TRIALS {
        let mut rng = Rng::with_seed(seed);
        let mut now = Timestamp::from_nanos(1_795_028_400_123_456_789);
        let end = now + EXCHANGES_FOR;
        let path = Path::new(&mut rng, now, DRIFT_BOUND);
        let mut samples = Vec::new();
        while now < end {
            let arrives = now + path.there.delay(&mut rng);
            let leaves = arrives + Span::from_nanos(rng.i64(10_000..200_000));
            let received = leaves + path.back.delay(&mut rng);
            samples.push(ClockSample::from_exchange(now, path.robot(arrives), path.robot(leaves), received));
            now = received + PAUSE;
        }
        trials.take(&path, &samples, None);
    }
    trials
}

fn host_now() -> Timestamp<Server> {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
    Timestamp::from_nanos(i64::try_from(now.as_nanos()).unwrap())
}

/// Converts nanoseconds since 1970 to an NTP timestamp (RFC 5905, figure 3): seconds since 1900 and a 32-bit fraction.
fn to_ntp(nanos: i64) -> [u8; 8] {
    let nanos = u64::try_from(nanos).unwrap();
    let fraction = ((nanos % 1_000_000_000) << 32) / 1_000_000_000;
    (((nanos / 1_000_000_000 + 2_208_988_800) << 32) | fraction).to_be_bytes()
}

fn from_ntp(bytes: &[u8]) -> Timestamp<Robot> {
    let ntp = u64::from_be_bytes(bytes.try_into().unwrap());
    let nanos = ((ntp & 0xffff_ffff) * 1_000_000_000 + (1 << 31)) >> 32;
    Timestamp::from_nanos(i64::try_from(((ntp >> 32) - 2_208_988_800) * 1_000_000_000 + nanos).unwrap())
}

/// Answers SNTP queries (RFC 5905, figure 8) with readings of the robot's clock.
async fn respond(socket: UdpSocket, path: Path) {
    let mut question = [0; 512];
    while let Ok((_, peer)) = socket.recv_from(&mut question).await {
        let received = to_ntp(path.robot(host_now()).as_nanos());
        let mut answer = [0; 48];
        // Version as in the query, mode server, stratum 1, precision 2^-23 s.
        answer[..4].copy_from_slice(&[question[0] & 0b00_111_000 | 0b100, 1, 0, 0xe9]);
        answer[12..16].copy_from_slice(b"LOCL");
        answer[16..24].copy_from_slice(&received);
        answer[24..32].copy_from_slice(&question[40..48]);
        answer[32..40].copy_from_slice(&received);
        answer[40..48].copy_from_slice(&to_ntp(path.robot(host_now()).as_nanos()));
        socket.send_to(&answer, peer).await.unwrap();
    }
}

/// Forwards queries to `responder` and answers back, each after a delay of its direction. Like a NAT, it sends each query from a separate
/// port.
async fn proxy(front: Arc<UdpSocket>, responder: SocketAddr, path: Path, mut rng: Rng) {
    let mut datagram = [0; 512];
    while let Ok((length, peer)) = front.recv_from(&mut datagram).await {
        let (there, back) = (path.there.delay(&mut rng), path.back.delay(&mut rng));
        let (front, question) = (front.clone(), datagram[..length].to_vec());
        tokio::spawn(async move {
            tokio::time::sleep(there.to_duration()).await;
            let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
            socket.send_to(&question, responder).await.unwrap();
            let mut answer = [0; 512];
            let (length, _) = socket.recv_from(&mut answer).await.unwrap();
            tokio::time::sleep(back.to_duration()).await;
            let _asker_may_be_gone = front.send_to(&answer[..length], peer).await;
        });
    }
}

async fn exchange(socket: &UdpSocket) -> Option<ClockSample> {
    let sent = host_now();
    let mut question = [0; 48];
    question[0] = 0b00_100_011;
    question[40..].copy_from_slice(&to_ntp(sent.as_nanos()));
    socket.send(&question).await.unwrap();
    let mut answer = [0; 512];
    loop {
        let answered = tokio::time::timeout(Duration::from_secs(1), socket.recv(&mut answer)).await;
        let received = host_now();
        answered.ok()?.unwrap();
        // An answer to an earlier query would make the robot's clock look wrong.
        if answer[24..32] == question[40..] {
            let (robot_received, robot_sent) = (from_ntp(&answer[32..40]), from_ntp(&answer[40..48]));
            return Some(ClockSample::from_exchange(sent, robot_received, robot_sent, received));
        }
    }
}

async fn real_trial(seed: u64, chrony: bool) -> Trials {
    let mut rng = Rng::with_seed(1_000_000 + seed);
    // chronyd's offset refers to an unknown instant within six seconds, so a drifting clock would count as an error of chronyd.
    let path = Path::new(&mut rng, host_now(), if chrony { 0.0 } else { DRIFT_BOUND });
    let responder = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let front = Arc::new(UdpSocket::bind("127.0.0.1:0").await.unwrap());
    let (behind, address) = (responder.local_addr().unwrap(), front.local_addr().unwrap());
    let responding = tokio::spawn(respond(responder, path));
    let proxying = tokio::spawn(proxy(front, behind, path, rng));

    let result = AsyncSntpClient::new().synchronize(address).await.unwrap();
    let found = Span::from_millis_f64(result.clock_offset().as_secs_f64() * 1e3);
    let single = found - path.offset_at(host_now());

    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    socket.connect(address).await.unwrap();
    let (end, mut samples) = (host_now() + EXCHANGES_FOR, Vec::new());
    while host_now() < end {
        samples.extend(exchange(&socket).await);
        tokio::time::sleep(PAUSE.to_duration()).await;
    }
    let mut trials = Trials::default();
    trials.take(&path, &samples, Some(single));
    if chrony {
        let asked = tokio::task::spawn_blocking(move || ask_chronyd(address.port())).await.unwrap();
        match asked {
            Ok(offset) => trials.chrony.error(offset - path.offset),
            Err(said) => println!("chronyd found nothing: {said}"),
        }
    }
    proxying.abort();
    responding.abort();
    trials
}

/// Returns the clock offset that `chronyd -Q` reports. With `-Q`, chronyd only queries the server on `port` and exits; it sets no clock.
fn ask_chronyd(port: u16) -> Result<Span, String> {
    let folder = tempfile::tempdir().unwrap();
    let (config, pid) = (folder.path().join("chrony.conf"), folder.path().join("pid"));
    let lines = format!(
        "server 127.0.0.1 port {port} iburst\ncmdport 0\nbindcmdaddress /\npidfile {}\n",
        pid.display()
    );
    std::fs::write(&config, lines).unwrap();
    let mut command = Command::new("chronyd");
    command.args(["-Q", "-U", "-x", "-u", "root", "-t", "30", "-f"]).arg(&config);
    let output = command.output().map_err(|error| error.to_string())?;
    let said = String::from_utf8_lossy(&output.stderr) + String::from_utf8_lossy(&output.stdout);
    let told = said.split_once("System clock wrong by ").and_then(|(_, rest)| rest.split(' ').next());
    let seconds: f64 = told.and_then(|number| number.parse().ok()).ok_or_else(|| said.trim().to_owned())?;
    Ok(Span::from_millis_f64(seconds * 1e3))
}

async fn in_real_time(count: u64, first_seed: u64, chrony: bool) -> Trials {
    let mut all = Trials::default();
    let mut seeds = first_seed..first_seed + count;
    loop {
        let batch: Vec<_> = seeds
            .by_ref()
            .take(AT_ONCE as usize)
            .map(|seed| tokio::spawn(real_trial(seed, chrony)))
            .collect();
        if batch.is_empty() {
            return all;
        }
        for trial in batch {
            all.add(trial.await.unwrap());
        }
    }
}

/// Returns the mean computing time to add an exchange to the clock estimate and read it. Exchanges are `pause` apart.
fn cost(pause: Span) -> Duration {
    const EXCHANGES: u32 = 100_000;
    let mut rng = Rng::with_seed(1);
    let mut now = Timestamp::from_nanos(1_795_028_400_123_456_789);
    let path = Path::new(&mut rng, now, DRIFT_BOUND);
    let samples: Vec<_> = (0..EXCHANGES)
        .map(|_| {
            let arrives = now + path.there.delay(&mut rng);
            let received = arrives + path.back.delay(&mut rng);
            let sample = ClockSample::from_exchange(now, path.robot(arrives), path.robot(arrives), received);
            now = received + pause;
            sample
        })
        .collect();
    let mut estimate = ClockEstimate::default();
    let began = Instant::now();
    for sample in samples {
        estimate.add(sample);
        std::hint::black_box(estimate.reading());
    }
    began.elapsed() / EXCHANGES
}

fn main() {
    for (every, pause) in [("50 ms", 50), ("s", 1_000), ("minute", 60_000)] {
        println!("an exchange every {every} and its reading take {:?}", cost(Span::from_millis(pause)));
    }
    let in_virtual_time = in_virtual_time();
    in_virtual_time.print("in virtual time, clocks drifting up to 100 ppm");
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let real = runtime.block_on(in_real_time(REAL_TRIALS, 0, false));
    real.print("in real time through the UDP proxy, clocks drifting up to 100 ppm");
    match Command::new("chronyd").arg("-v").output() {
        Ok(version) => {
            let beside = runtime.block_on(in_real_time(CHRONY_TRIALS, REAL_TRIALS, true));
            let version = String::from_utf8_lossy(&version.stdout);
            let version = version.split(" (+").next().unwrap();
            beside.print(&format!("in real time next to {version}, clocks that do not drift"));
        }
        Err(error) => println!("\nno comparison with chronyd, which cannot be started: {error}"),
    }
    println!();
    in_virtual_time.verdicts("in virtual time");
    real.verdicts("in real time");
}
