//! The server's clock: the system's, corrected by NTP, and from then on carried by the monotonic clock, so that a step of
//! the system's clock does not move what is scheduled.

use std::time::{Duration, Instant};

use downbeat_robot::clock::HostClock;
use rsntp::{AsyncSntpClient, Config};
use serde::Serialize;
use urrcp::{Server, Span, Timestamp};

/// NTP exchanges asked for; the one of least delay decides.
const NTP_SAMPLES: usize = 5;
/// Between two NTP exchanges.
const NTP_INTERVAL: Duration = Duration::from_millis(50);
const NTP_TIMEOUT: Duration = Duration::from_secs(2);

/// Reads the server's time. Copies agree for ever.
#[derive(Clone, Copy, Debug)]
pub struct ServerClock {
    host: HostClock,
    /// Server time minus the host's.
    offset: Span,
}

impl ServerClock {
    /// Anchored now: system clock plus `offset`.
    #[must_use]
    pub fn anchored(offset: Span) -> Self {
        Self { host: HostClock::anchored(), offset }
    }

    /// The time now.
    #[must_use]
    pub fn now(&self) -> Timestamp<Server> {
        self.host.now().assume_clock() + self.offset
    }

    /// The monotonic instant of a timestamp; instants before the anchor become the anchor.
    #[must_use]
    pub fn instant_of(&self, timestamp: Timestamp<Server>) -> Instant {
        self.host.instant_of((timestamp - self.offset).assume_clock())
    }
}

/// What an NTP server says of the system's clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NtpReading {
    /// NTP time minus system time.
    #[serde(rename = "offset_ms")]
    pub offset: Span,
    /// Half the round trip of the best exchange.
    #[serde(rename = "uncertainty_ms")]
    pub uncertainty: Span,
    /// Of the NTP server: 1 is attached to a reference clock (RFC 5905, figure 11).
    pub stratum: u8,
}

/// The NTP server could not be asked.
#[derive(Debug, thiserror::Error)]
#[error(
    "no NTP time from `{server}`: {reason}; check `ntp:` in the fleet file, or leave it out to trust the system clock"
)]
pub struct NtpError {
    /// As in the fleet file.
    pub server: String,
    /// What the client says.
    pub reason: String,
}

/// Asks an NTP server (`host` or `host:port`) a few times; the exchange of least delay decides.
///
/// # Errors
/// [`NtpError`] when no exchange came through.
pub async fn ask_ntp(server: &str) -> Result<NtpReading, NtpError> {
    let client = AsyncSntpClient::with_config(Config::default().timeout(NTP_TIMEOUT));
    let mut best: Option<(Span, NtpReading)> = None;
    let mut reason = String::new();
    for exchange in 0..NTP_SAMPLES {
        if exchange > 0 {
            tokio::time::sleep(NTP_INTERVAL).await;
        }
        match client.synchronize(server).await {
            Ok(result) => {
                let delay = Span::from_millis_f64(result.round_trip_delay().as_secs_f64() * 1e3);
                let offset = Span::from_millis_f64(result.clock_offset().as_secs_f64() * 1e3);
                let reading = NtpReading { offset, uncertainty: delay.abs() / 2, stratum: result.stratum() };
                if best.is_none_or(|(least, _)| delay < least) {
                    best = Some((delay, reading));
                }
            }
            // A server that is off stays off: the first exchange decides.
            Err(error) if exchange == 0 => {
                return Err(NtpError { server: server.to_owned(), reason: error.to_string() });
            }
            Err(error) => reason = error.to_string(),
        }
    }
    best.map(|(_, reading)| reading).ok_or_else(|| NtpError { server: server.to_owned(), reason })
}
