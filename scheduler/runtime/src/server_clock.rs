//! The server's clock. It starts from the system clock, corrected by NTP, and then follows the monotonic clock. A step of the system
//! clock therefore does not shift the schedule. [`NtpWatch`] reports how far this clock has drifted from NTP.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use downbeat_robot::clock::HostClock;
use downbeat_scripts::{Attempt, Refusal};
use rsntp::{AsyncSntpClient, Config, SynchronizationError};
use serde::Serialize;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::MissedTickBehavior;
use urrcp::{Server, Span, Timestamp};

use downbeat_mission::clock::{ClockEstimate, ClockSample, NtpState};

/// Number of NTP exchanges in one measurement. Each exchange bounds the offset, and the measurement combines these bounds.
const NTP_SAMPLES: usize = 5;
/// Pause between two NTP exchanges.
const NTP_INTERVAL: Duration = Duration::from_millis(50);
const NTP_TIMEOUT: Duration = Duration::from_secs(2);
/// Allowance for rounding in one exchange: rsntp computes in floating point, and the system clock and the monotonic clock are not read at
/// the same instant.
const NTP_ROUNDING: Span = Span::from_micros(1);
/// Number of consecutive unanswered requests after which the NTP server is considered lost. It is more than 1, because a single datagram
/// may get lost.
const NTP_LOST_AFTER: u32 = 3;
/// Interval between two requests of an [`NtpWatch`]: the shortest steady polling interval in RFC 5905 (MINPOLL, 2^4 s).
pub const NTP_WATCH_INTERVAL: Duration = Duration::from_secs(16);

/// The server's clock. Copies always show the same time.
#[derive(Clone, Copy, Debug)]
pub struct ServerClock {
    host: HostClock,
    /// Server time minus the time of the host's clock.
    offset: Span,
}

impl ServerClock {
    /// Anchors the clock at the current system time plus `offset`.
    #[must_use]
    pub fn anchored(offset: Span) -> Self {
        Self { host: HostClock::anchored(), offset }
    }

    /// Server time minus system time, as set when the clock was anchored.
    #[must_use]
    pub const fn offset(&self) -> Span {
        self.offset
    }

    /// Returns the current server time.
    #[must_use]
    pub fn now(&self) -> Timestamp<Server> {
        self.host.now().assume_clock() + self.offset
    }

    /// Returns the monotonic instant of a timestamp. Timestamps before the anchor map to the anchor.
    #[must_use]
    pub fn instant_of(&self, timestamp: Timestamp<Server>) -> Instant {
        self.host.instant_of((timestamp - self.offset).assume_clock())
    }

    /// Returns the time by which the system clock is currently ahead of this clock. Negative if it is behind.
    fn system_ahead(&self) -> Span {
        let system = Self::anchored(Span::ZERO);
        // Compares the instants at which both clocks show the same time. Two successive readings would include the delay between them.
        // `shown` is later than both anchors, because instants are exact only after the anchor.
        let shown = system.now().max(self.now()) + Span::from_millis(1_000);
        let (by_system, by_this) = (system.instant_of(shown), self.instant_of(shown));
        Span::from(by_this.saturating_duration_since(by_system))
            - Span::from(by_system.saturating_duration_since(by_this))
    }
}

/// A comparison of the system clock with an NTP server.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NtpReading {
    /// NTP time minus system time.
    #[serde(rename = "offset_ms")]
    pub offset: Span,
    /// Maximum error of `offset` if the NTP server is right.
    #[serde(rename = "uncertainty_ms")]
    pub uncertainty: Span,
    /// The stratum of the NTP server: a server of stratum 1 is attached to a reference clock (RFC 5905, figure 11).
    pub stratum: u8,
}

/// The error for an NTP server that did not answer.
#[derive(Debug, thiserror::Error)]
#[error(
    "no NTP time from `{server}`: {reason}; check `ntp:` in the fleet file, or remove it to trust the system clock"
)]
pub struct NtpError {
    /// The server, as written in the fleet file.
    pub server: String,
    /// The reason as reported by the NTP client.
    pub reason: String,
}

/// Measures the offset of the system clock with a few requests to an NTP server (`host` or `host:port`). Each exchange bounds the offset,
/// and the result is within all these bounds.
///
/// # Errors
/// Returns [`NtpError`] if no exchange succeeded.
pub async fn ask_ntp(server: &str) -> Result<NtpReading, NtpError> {
    let clock = ServerClock::anchored(Span::ZERO);
    let failed = |reason| NtpError { server: server.to_owned(), reason };
    // One name may lead to many servers with different clocks, so only one of them is used throughout.
    let address = resolve(server).await.map_err(failed)?;
    let mut estimate = ClockEstimate::default();
    let mut stratum = None;
    let mut reason = String::new();
    for question in 0..NTP_SAMPLES {
        if question > 0 {
            tokio::time::sleep(NTP_INTERVAL).await;
        }
        match exchange(address, &clock, NTP_TIMEOUT).await {
            Ok((sample, told)) => {
                estimate.add(sample);
                stratum = Some(told);
            }
            // If the first exchange fails, the server is probably down, so no further ones are tried.
            Err(error) if question == 0 => return Err(failed(error)),
            Err(error) => reason = error,
        }
    }
    match (estimate.reading(), stratum) {
        (Some(reading), Some(stratum)) => {
            Ok(NtpReading { offset: reading.offset, uncertainty: reading.uncertainty, stratum })
        }
        _ => Err(failed(reason)),
    }
}

async fn resolve(server: &str) -> Result<SocketAddr, String> {
    const NTP_PORT: u16 = 123;
    let has_port = server.parse::<std::net::Ipv6Addr>().is_err() && server.contains(':');
    let addresses: Vec<_> = if has_port {
        tokio::net::lookup_host(server).await.map(Iterator::collect)
    } else {
        tokio::net::lookup_host((server, NTP_PORT)).await.map(Iterator::collect)
    }
    .map_err(|error| Refusal::of(Attempt::Connect, &error).reason)?;
    // IPv4 first, because many hosts still have no route over IPv6.
    let preferred = addresses.iter().find(|address| address.is_ipv4()).or(addresses.first());
    preferred.copied().ok_or_else(|| "the host name does not resolve to an address".to_owned())
}

/// Performs one NTP exchange. Returns a sample of NTP time minus the time of `clock`, and the server's stratum.
async fn exchange(
    server: SocketAddr,
    clock: &ServerClock,
    timeout: Duration,
) -> Result<(ClockSample, u8), String> {
    let any_port: SocketAddr = match server {
        SocketAddr::V4(_) => (std::net::Ipv4Addr::UNSPECIFIED, 0).into(),
        SocketAddr::V6(_) => (std::net::Ipv6Addr::UNSPECIFIED, 0).into(),
    };
    let client = AsyncSntpClient::with_config(Config::default().timeout(timeout).bind_address(any_port));
    // The client reads the system clock, which may be set between its two readings.
    let (ahead_before, sent) = (clock.system_ahead(), clock.now());
    let plain = |error| match error {
        SynchronizationError::IOError(error) => Refusal::of(Attempt::Connect, &error).reason,
        error @ SynchronizationError::ProtocolError(_) => error.to_string(),
    };
    let result = client.synchronize(server).await.map_err(plain)?;
    let (at, ahead_after) = (clock.now(), clock.system_ahead());
    let delay = Span::from_millis_f64(result.round_trip_delay().as_secs_f64() * 1e3);
    let offset = Span::from_millis_f64(result.clock_offset().as_secs_f64() * 1e3);
    let upper = offset + delay / 2 + ahead_before;
    let lower = offset - delay / 2 + ahead_after;
    let sample = ClockSample {
        offset: lower + (upper - lower) / 2,
        delay: (upper - lower).max(Span::ZERO),
        lower: lower - NTP_ROUNDING,
        upper: upper + NTP_ROUNDING,
        sent,
        at,
    };
    Ok((sample, result.stratum()))
}

/// Compares the server's clock with an NTP server at regular intervals, until this value is dropped.
#[derive(Debug)]
pub struct NtpWatch {
    states: watch::Receiver<NtpState>,
    task: JoinHandle<()>,
}

impl NtpWatch {
    /// Starts the watch. It sends the first request at once, then one every `interval`. An answer must arrive before the next request.
    /// Must be called within a tokio runtime.
    #[must_use]
    pub fn start(server: String, clock: ServerClock, interval: Duration) -> Self {
        let (tell, states) = watch::channel(NtpState::default());
        let task = tokio::spawn(async move { watch_ntp(&server, &clock, interval, &tell).await });
        Self { states, task }
    }

    /// Returns the latest state of the server's clock relative to NTP.
    #[must_use]
    pub fn state(&self) -> NtpState {
        *self.states.borrow()
    }

    /// Waits until the next request has been answered or has failed, and returns the new state.
    pub async fn next(&mut self) -> NtpState {
        if self.states.changed().await.is_err() {
            // The task lives as long as this value.
            std::future::pending::<()>().await;
        }
        *self.states.borrow_and_update()
    }
}

impl Drop for NtpWatch {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn watch_ntp(server: &str, clock: &ServerClock, interval: Duration, tell: &watch::Sender<NtpState>) {
    let timeout = interval.min(NTP_TIMEOUT);
    let mut estimate = ClockEstimate::default();
    let mut address = None;
    let (mut answered, mut unanswered) = (clock.now(), 0);
    let mut ticks = tokio::time::interval(interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let outcome = match address {
            Some(address) => Ok(address),
            None => resolve(server).await,
        };
        let outcome = match outcome {
            Ok(found) => {
                address = Some(found);
                exchange(found, clock, timeout).await
            }
            Err(reason) => Err(reason),
        };
        match outcome {
            Ok((sample, _)) => {
                estimate.add(sample);
                (answered, unanswered) = (sample.at, 0);
            }
            Err(reason) => {
                unanswered += 1;
                tracing::debug!(server, reason, unanswered, "no time received from the NTP server");
            }
        }
        let lost = unanswered >= NTP_LOST_AFTER;
        if lost {
            // The name is resolved again, because it may lead to another server meanwhile. If its clock differs, the difference is
            // treated as a step.
            address = None;
        }
        let reading = estimate.reading_at(clock.now());
        tell.send_replace(NtpState {
            offset_change: reading.map_or(Span::ZERO, |reading| reading.offset),
            uncertainty: reading.map(|reading| reading.uncertainty),
            drift: reading.and_then(|reading| reading.drift),
            steps: estimate.steps(),
            lost_since: lost.then_some(answered),
        });
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "an NTP server tells the real time")]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, AtomicI64, AtomicUsize, Ordering};
    use std::time::SystemTime;

    use tokio::net::UdpSocket;

    use super::*;

    /// An SNTP server (RFC 5905, figure 8) with a known offset, which can be silenced.
    #[derive(Clone, Default)]
    struct Responder {
        offset_nanos: Arc<AtomicI64>,
        is_silent: Arc<AtomicBool>,
        /// Indices of the requests that this server refuses, counted from 0.
        refuses: Vec<usize>,
        questions: Arc<AtomicUsize>,
    }

    impl Responder {
        async fn start(&self) -> String {
            let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
            let address = socket.local_addr().unwrap().to_string();
            let responder = self.clone();
            tokio::spawn(async move {
                let mut question = [0; 48];
                loop {
                    let (_, peer) = socket.recv_from(&mut question).await.unwrap();
                    let mut answer = [0; 48];
                    answer[..4].copy_from_slice(&[0b00_100_100, 1, 0, 0xe9]);
                    answer[12..16].copy_from_slice(b"LOCL");
                    answer[24..32].copy_from_slice(&question[40..48]);
                    answer[32..40].copy_from_slice(&responder.now());
                    answer[40..48].copy_from_slice(&responder.now());
                    if responder.refuses.contains(&responder.questions.fetch_add(1, Ordering::Relaxed)) {
                        // The answer of a server that receives too many requests (RFC 5905, section 7.4).
                        answer[1] = 0;
                        answer[12..16].copy_from_slice(b"RATE");
                    }
                    if !responder.is_silent.load(Ordering::Relaxed) {
                        socket.send_to(&answer, peer).await.unwrap();
                    }
                }
            });
            address
        }

        fn now(&self) -> [u8; 8] {
            let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos();
            let offset = i128::from(self.offset_nanos.load(Ordering::Relaxed));
            let nanos = i128::try_from(now).unwrap() + offset;
            let seconds = nanos / 1_000_000_000 + 2_208_988_800;
            let fraction = ((nanos % 1_000_000_000) << 32) / 1_000_000_000;
            u64::try_from((seconds << 32) | fraction).unwrap().to_be_bytes()
        }

        fn set_offset(&self, offset: Span) {
            self.offset_nanos.store(offset.as_nanos(), Ordering::Relaxed);
        }
    }

    #[track_caller]
    fn assert_is(state: NtpState, change: Span) {
        // Anchoring reads two clocks one after the other, which causes a small error.
        let error = (state.offset_change - change).abs();
        assert!(error <= state.uncertainty.unwrap() + Span::from_micros(5), "{state:?}");
    }

    const INTERVAL: Duration = Duration::from_millis(100);

    #[tokio::test]
    async fn watch_follows_ntp_time_and_reports_steps_loss_and_return() {
        let responder = Responder::default();
        responder.set_offset(Span::from_millis(250));
        let server = responder.start().await;
        let clock = ServerClock::anchored(Span::from_millis(250));
        let mut watch = NtpWatch::start(server, clock, INTERVAL);
        while watch.next().await.uncertainty.is_none() {}
        assert_is(watch.next().await, Span::ZERO);
        assert_eq!(watch.state().steps, 0);

        responder.set_offset(Span::from_millis(1_250));
        while watch.next().await.steps == 0 {}
        assert_is(watch.next().await, Span::from_millis(1_000));

        responder.is_silent.store(true, Ordering::Relaxed);
        // One state may wait to be read, and one answer may be in transit.
        watch.next().await;
        let mut lost = watch.next().await;
        let unanswered_since = clock.now();
        let known = lost.uncertainty.unwrap();
        while lost.lost_since.is_none() {
            lost = watch.next().await;
        }
        assert!(lost.lost_since.unwrap() <= unanswered_since, "{lost:?}");
        assert_is(lost, Span::from_millis(1_000));
        assert!(lost.uncertainty.unwrap() > known, "it must grow: {lost:?}");

        responder.is_silent.store(false, Ordering::Relaxed);
        while watch.next().await.lost_since.is_some() {}
        assert_is(watch.state(), Span::from_millis(1_000));
    }

    #[tokio::test]
    async fn watch_without_any_answer_reports_server_lost_since_it_began() {
        let silent = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let clock = ServerClock::anchored(Span::ZERO);
        let began = clock.now();
        let address = silent.local_addr().unwrap().to_string();
        let mut watch = NtpWatch::start(address, clock, Duration::from_millis(20));
        let mut state = watch.next().await;
        let asked = clock.now();
        while state.lost_since.is_none() {
            assert_eq!(state.uncertainty, None);
            state = watch.next().await;
        }
        let lost_since = state.lost_since.unwrap();
        assert!(lost_since >= began && lost_since < asked, "{state:?}, not from {began} to {asked}");
    }

    #[tokio::test]
    async fn dropped_watch_stops_querying() {
        let server = Responder::default().start().await;
        let watch = NtpWatch::start(server, ServerClock::anchored(Span::ZERO), Duration::from_millis(20));
        let mut states = watch.states.clone();
        states.changed().await.unwrap();
        drop(watch);
        let ends = async { while states.changed().await.is_ok() {} };
        tokio::time::timeout(Duration::from_secs(60), ends).await.expect("nobody tells anything any more");
    }

    #[test]
    fn lead_of_system_clock_is_computed_for_any_offset() {
        for millis in [0, 250, -250, 3_600_000, -3_600_000] {
            let offset = Span::from_millis(millis);
            // On a busy machine, a thread may lose its core between two readings, but not every time.
            let error = |_| (ServerClock::anchored(offset).system_ahead() + offset).abs();
            let least = (0..100).map(error).min().unwrap();
            assert!(least < Span::from_micros(50), "{millis}: {least}");
        }
    }

    #[tokio::test]
    async fn server_without_a_port_uses_the_ntp_port() {
        for (server, address) in [
            ("127.0.0.1", "127.0.0.1:123"),
            ("127.0.0.1:1123", "127.0.0.1:1123"),
            ("::1", "[::1]:123"),
            ("[::1]:5", "[::1]:5"),
        ] {
            assert_eq!(resolve(server).await, Ok(address.parse().unwrap()));
        }
    }

    #[tokio::test]
    async fn ntp_offset_is_measured_within_its_uncertainty() {
        let responder = Responder::default();
        responder.set_offset(Span::from_millis(250));
        let reading = ask_ntp(&responder.start().await).await.unwrap();
        let error = (reading.offset - Span::from_millis(250)).abs();
        assert!(error <= reading.uncertainty + Span::from_micros(5), "{reading:?}");
        assert_eq!(reading.stratum, 1);
    }

    #[tokio::test]
    async fn server_may_refuse_some_requests_but_not_the_first() {
        for (refuses, asked, believed) in [(vec![1, 4], 5, true), (vec![0], 1, false)] {
            let responder = Responder { refuses: refuses.clone(), ..Responder::default() };
            responder.set_offset(Span::from_millis(250));
            let reading = ask_ntp(&responder.start().await).await;
            assert_eq!(reading.is_ok(), believed, "{refuses:?}: {reading:?}");
            assert_eq!(responder.questions.load(Ordering::Relaxed), asked, "{refuses:?}");
        }
    }

    #[tokio::test]
    async fn answer_bounds_allow_for_network_delay_and_timestamp_rounding() {
        let responder = Responder::default();
        responder.set_offset(Span::from_millis(250));
        let server = responder.start().await.parse().unwrap();
        let clock = ServerClock::anchored(Span::from_millis(250));
        let (sample, stratum) = exchange(server, &clock, Duration::from_secs(60)).await.unwrap();
        assert_eq!(stratum, 1);
        let took = sample.at - sample.sent;
        assert!(sample.delay > Span::ZERO && sample.delay <= took + NTP_ROUNDING * 2, "{sample:?}");
        assert_eq!(sample.upper - sample.lower, sample.delay + NTP_ROUNDING * 2);
        let middle = sample.lower + (sample.upper - sample.lower) / 2;
        assert!((sample.offset - middle).abs() <= Span::from_nanos(1), "{sample:?}");
        assert!(
            sample.offset.abs() <= took + NTP_ROUNDING * 2,
            "both clocks are ahead by as much: {sample:?}"
        );
    }
}
