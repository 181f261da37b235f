//! Budgets of a peer for bytes, messages and reading time. If a peer exceeds its budget, its messages are read more slowly, so that the
//! network delays the remaining ones.
#![expect(clippy::disallowed_methods, reason = "budgets fill up in real time")]

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{OwnedSemaphorePermit, Semaphore, SemaphorePermit};

use crate::hardware::Standing;

/// Token bucket, refilled at a steady rate. A caller may overdraw it, and must then wait until the debt is paid.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    level: f64,
    rate: Rate,
    filled: Instant,
}

/// Refill rate of a bucket in tokens per second, and its capacity in tokens.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rate {
    per_second: f64,
    most: f64,
}

impl Bucket {
    const fn full(rate: Rate, now: Instant) -> Self {
        Self { level: rate.most, rate, filled: now }
    }

    fn fill(&mut self, now: Instant) {
        let passed = now.saturating_duration_since(self.filled).as_secs_f64();
        self.level = (self.level + passed * self.rate.per_second).min(self.rate.most);
        self.filled = now;
    }

    fn take(&mut self, now: Instant, tokens: f64) {
        self.fill(now);
        self.level -= tokens;
    }

    /// Returns the time until the debt of an overdrawn bucket is paid; otherwise zero.
    fn empty_for(&mut self, now: Instant) -> Duration {
        self.fill(now);
        Duration::from_secs_f64((-self.level).max(0.0) / self.rate.per_second)
    }
}

/// Rates of one peer's budget, which depend on whether the peer's session owns the robot.
#[derive(Clone, Copy, Debug)]
struct Share {
    bytes: Rate,
    messages: Rate,
    /// Time for reading the peer's messages, in seconds per second.
    reading: Rate,
}

const KIB: f64 = 1024.0;
const MIB: f64 = 1024.0 * KIB;

const fn rate(per_second: f64, most: f64) -> Rate {
    Rate { per_second, most }
}

const fn share_of(standing: Standing) -> Share {
    match standing {
        Standing::Owner => Share {
            bytes: rate(128.0 * MIB, 512.0 * MIB),
            messages: rate(100_000.0, 200_000.0),
            reading: rate(1.0, 60.0),
        },
        Standing::Free => Share {
            bytes: rate(16.0 * MIB, 32.0 * MIB),
            messages: rate(5_000.0, 10_000.0),
            reading: rate(0.25, 1.0),
        },
        Standing::Stranger => Share {
            bytes: rate(64.0 * KIB, 256.0 * KIB),
            messages: rate(50.0, 100.0),
            reading: rate(0.01, 0.05),
        },
    }
}

/// Budget that all strangers (peers that own no robot of the host) share: messages, and reading time in seconds. The first
/// [`FIRST_MESSAGES`] messages of each stranger are not charged to it.
const ALL_STRANGERS: (Rate, Rate) = (rate(200.0, 400.0), rate(0.05, 0.2));
/// Number of a stranger's first messages that are charged only to its own budget. A new stranger is therefore served even if many others
/// send.
const FIRST_MESSAGES: u64 = 16;

/// Remaining budget of one peer.
#[derive(Debug)]
pub(crate) struct Budget {
    standing: Standing,
    bytes: Bucket,
    messages: Bucket,
    reading: Bucket,
    heard: u64,
}

impl Budget {
    pub(crate) fn new(now: Instant, standing: Standing) -> Self {
        let share = share_of(standing);
        Self {
            standing,
            bytes: Bucket::full(share.bytes, now),
            messages: Bucket::full(share.messages, now),
            reading: Bucket::full(share.reading, now),
            heard: 0,
        }
    }

    /// Resets the budget to that of `standing` if the peer's relation to the robot (owner, free or stranger) has changed.
    pub(crate) fn follow(&mut self, now: Instant, standing: Standing) {
        if self.standing != standing {
            *self = Self { heard: self.heard, ..Self::new(now, standing) };
        }
    }

    pub(crate) fn came(&mut self, now: Instant, bytes: usize) {
        self.bytes.take(now, tokens(bytes));
    }

    /// Charges the budget for a message or an unreadable line whose reading took `took`. `answer` is the length of the answer in bytes,
    /// if it is long; sending a byte costs less than reading one.
    pub(crate) fn read(&mut self, now: Instant, strangers: &Strangers, took: Duration, answer: usize) {
        self.heard += 1;
        self.messages.take(now, 1.0);
        self.reading.take(now, took.as_secs_f64());
        self.bytes.take(now, tokens(answer) / 16.0);
        if self.shares() {
            strangers.took(now, took);
        }
    }

    /// Returns how long the host must not read from this peer. Zero if the peer is within its budget.
    pub(crate) fn pause(&mut self, now: Instant, strangers: &Strangers) -> Duration {
        let own =
            [&mut self.bytes, &mut self.messages, &mut self.reading].map(|bucket| bucket.empty_for(now));
        let shared = if self.shares() { strangers.empty_for(now) } else { Duration::ZERO };
        own.into_iter().fold(shared, Duration::max)
    }

    fn shares(&self) -> bool {
        self.standing == Standing::Stranger && self.heard > FIRST_MESSAGES
    }
}

#[expect(clippy::cast_precision_loss, reason = "a count of bytes in memory")]
fn tokens(bytes: usize) -> f64 {
    bytes as f64
}

/// Maximum number of long lines that a host reads at a time for robots that belong to no session. A limit is necessary because each line
/// occupies memory until its last byte is read.
const LONG_LINES: usize = 2;

/// Budget shared by all peers that own none of the host's robots. Their messages are read one at a time.
#[derive(Debug)]
pub(crate) struct Strangers {
    turn: Semaphore,
    long_lines: Arc<Semaphore>,
    /// Buckets for messages and for reading time.
    budget: Mutex<(Bucket, Bucket)>,
}

impl Default for Strangers {
    fn default() -> Self {
        Self::at(Instant::now())
    }
}

impl Strangers {
    fn at(now: Instant) -> Self {
        let (messages, reading) = ALL_STRANGERS;
        let budget = Mutex::new((Bucket::full(messages, now), Bucket::full(reading, now)));
        Self { turn: Semaphore::new(1), long_lines: Arc::new(Semaphore::new(LONG_LINES)), budget }
    }

    /// Waits until no other stranger's message is being read.
    pub(crate) async fn turn(&self) -> Option<SemaphorePermit<'_>> {
        // The semaphore is never closed.
        self.turn.acquire().await.ok()
    }

    /// Returns how many long lines may be read in addition to those that are being read.
    #[cfg(test)]
    pub(crate) fn long_lines_left(&self) -> usize {
        self.long_lines.available_permits()
    }

    /// Waits until a long line may be read for a robot that belongs to no session. Returns `None` if this takes longer than `patience`.
    pub(crate) async fn long_line(&self, patience: Duration) -> Option<OwnedSemaphorePermit> {
        let leave = Arc::clone(&self.long_lines).acquire_owned();
        tokio::time::timeout(patience, leave).await.ok()?.ok()
    }

    fn took(&self, now: Instant, took: Duration) {
        let mut budget = self.budget.lock().unwrap_or_else(PoisonError::into_inner);
        budget.0.take(now, 1.0);
        budget.1.take(now, took.as_secs_f64());
    }

    fn empty_for(&self, now: Instant) -> Duration {
        let mut budget = self.budget.lock().unwrap_or_else(PoisonError::into_inner);
        let (messages, reading) = &mut *budget;
        messages.empty_for(now).max(reading.empty_for(now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bucket_grants_its_burst_then_its_rate_and_waits_for_its_debt() {
        let begin = Instant::now();
        let after = |millis| begin + Duration::from_millis(millis);
        let mut bucket = Bucket::full(rate(10.0, 5.0), begin);
        bucket.take(begin, 5.0);
        assert_eq!(bucket.empty_for(begin), Duration::ZERO);
        bucket.take(begin, 20.0);
        assert_eq!(bucket.empty_for(begin), Duration::from_secs(2));
        assert_eq!(bucket.empty_for(after(1_500)), Duration::from_millis(500));
        bucket.take(after(60_000), 5.0);
        assert_eq!(
            bucket.empty_for(after(60_000)),
            Duration::ZERO,
            "it holds its burst, however long it filled"
        );
        bucket.take(after(60_000), 1.0);
        assert_eq!(bucket.empty_for(after(60_000)), Duration::from_millis(100));
    }

    /// Returns how many messages a peer with this standing can send before it has to pause.
    fn messages_until_pause(now: Instant, strangers: &Strangers, standing: Standing) -> usize {
        let mut budget = Budget::new(now, standing);
        (0..1_000_000)
            .take_while(|_| {
                budget.read(now, strangers, Duration::ZERO, 0);
                budget.pause(now, strangers).is_zero()
            })
            .count()
    }

    #[test]
    fn strangers_pause_early_and_jointly_and_the_owner_late() {
        let now = Instant::now();
        let strangers = Strangers::at(now);
        let until_pause = |standing| messages_until_pause(now, &strangers, standing);
        let counts: Vec<_> = (0..20).map(|_| until_pause(Standing::Stranger)).collect();
        assert!(counts[0] >= 100 && counts[0] < 120, "{counts:?}");
        assert!(counts[19] >= 15 && counts[19] < 40, "a newcomer has its first messages: {counts:?}");
        assert!(until_pause(Standing::Owner) >= 200_000);
    }

    #[test]
    fn requests_with_long_responses_cost_more() {
        let now = Instant::now();
        let strangers = Strangers::at(now);
        let mut budget = Budget::new(now, Standing::Stranger);
        let block = 2 * 1024 * 1024;
        let asked = (0..100).take_while(|_| {
            budget.read(now, &strangers, Duration::ZERO, block);
            budget.pause(now, &strangers).is_zero()
        });
        assert!((2..=4).contains(&asked.count()));
    }

    const STANDINGS: [Standing; 3] = [Standing::Owner, Standing::Free, Standing::Stranger];

    /// Returns the number of tokens that empties a full bucket and overdraws it by the tokens of ten seconds.
    fn beyond(rate: Rate) -> f64 {
        rate.most + 10.0 * rate.per_second
    }

    /// Checks that a peer must pause for ten seconds after `send` has charged its budget.
    #[track_caller]
    fn check_pause(standing: Standing, send: impl FnOnce(Instant, &mut Budget, &Share)) {
        let now = Instant::now();
        let mut budget = Budget::new(now, standing);
        send(now, &mut budget, &share_of(standing));
        let pause = budget.pause(now, &Strangers::at(now)).as_secs_f64();
        assert!(pause > 9.9 && pause <= 10.0, "{standing:?}: {pause} s");
    }

    #[test]
    fn bytes_messages_and_reading_time_each_slow_a_peer_by_its_rates() {
        for standing in STANDINGS {
            check_pause(standing, |now, budget, share| budget.came(now, beyond(share.bytes) as usize));
            check_pause(standing, |now, budget, share| budget.messages.take(now, beyond(share.messages)));
            check_pause(standing, |now, budget, share| {
                let took = Duration::from_secs_f64(beyond(share.reading));
                budget.read(now, &Strangers::at(now), took, 0);
            });
        }
    }

    #[test]
    fn owner_may_send_most_and_stranger_least() {
        let bytes = STANDINGS.map(|standing| share_of(standing).bytes);
        assert_eq!(bytes.map(|rate| rate.most / KIB), [512.0 * 1024.0, 32.0 * 1024.0, 256.0]);
        assert_eq!(bytes.map(|rate| rate.per_second / KIB), [128.0 * 1024.0, 16.0 * 1024.0, 64.0]);
    }

    #[test]
    fn new_owner_of_the_robot_immediately_has_the_budget_of_an_owner() {
        let now = Instant::now();
        let strangers = Strangers::at(now);
        let mut budget = Budget::new(now, Standing::Stranger);
        budget.came(now, 10 * 1024 * 1024);
        budget.follow(now, Standing::Stranger);
        assert!(!budget.pause(now, &strangers).is_zero(), "nothing has changed");
        budget.follow(now, Standing::Owner);
        assert!(budget.pause(now, &strangers).is_zero());
    }

    #[test]
    fn shared_budget_slows_strangers_except_newcomers_and_no_other_peer() {
        let now = Instant::now();
        let strangers = Strangers::at(now);
        strangers.took(now, Duration::from_secs(10));
        let pauses = |standing, heard| {
            let mut budget = Budget { heard, ..Budget::new(now, standing) };
            !budget.pause(now, &strangers).is_zero()
        };
        assert!(pauses(Standing::Stranger, FIRST_MESSAGES + 1));
        assert!(!pauses(Standing::Stranger, FIRST_MESSAGES));
        assert!(!pauses(Standing::Free, FIRST_MESSAGES + 1) && !pauses(Standing::Owner, FIRST_MESSAGES + 1));
        let many = Strangers::at(now);
        (0..4_400).for_each(|_| many.took(now, Duration::ZERO));
        // // 4,000 messages beyond the capacity, at 200 per second.
        let pause = many.empty_for(now).as_secs_f64();
        assert!(pause > 19.9 && pause <= 20.0, "{pause}");
    }

    #[test]
    fn first_messages_of_a_stranger_use_no_shared_budget() {
        let now = Instant::now();
        let strangers = Strangers::at(now);
        let mut budget = Budget::new(now, Standing::Stranger);
        for _ in 0..FIRST_MESSAGES {
            budget.read(now, &strangers, Duration::from_secs(1), 0);
        }
        assert!(strangers.empty_for(now).is_zero());
        budget.read(now, &strangers, Duration::from_secs(1), 0);
        assert!(!strangers.empty_for(now).is_zero());
    }

    #[tokio::test]
    async fn slots_for_long_lines_and_turns_are_released() {
        let strangers = Strangers::default();
        let soon = Duration::from_millis(1);
        let both = [strangers.long_line(soon).await.unwrap(), strangers.long_line(soon).await.unwrap()];
        assert!(strangers.long_line(soon).await.is_none());
        drop(both);
        assert!(strangers.long_line(soon).await.is_some());
        let turn = strangers.turn().await;
        assert!(tokio::time::timeout(soon, strangers.turn()).await.is_err());
        drop(turn);
        assert!(strangers.turn().await.is_some());
    }
}
