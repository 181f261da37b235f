//! Functions that wait for events in other processes, or check that nothing happens for some time.

use std::fmt::Debug;
use std::time::{Duration, Instant};

use crate::{Robot, Stage, epoch_nanos};

/// Maximum wait for an event, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(60);
const LOOK_AGAIN: Duration = Duration::from_millis(5);

/// Waits until `holds` returns true. Panics after a minute.
#[track_caller]
pub fn await_that(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < PATIENCE, "{what} never came");
        std::thread::sleep(LOOK_AGAIN);
    }
}

/// Panics if the value that `what` returns changes within `window`; otherwise returns the value. Any activity that may change the value
/// must be over before the call.
#[track_caller]
pub fn stays<T: PartialEq + Debug>(window: Duration, what: impl Fn() -> T) -> T {
    let before = what();
    std::thread::sleep(window);
    let after = what();
    assert_eq!(before, after, "it changed within {window:?}");
    after
}

impl Robot {
    /// Whether the robot has not moved for half a second.
    pub fn rests(&self) -> bool {
        const HALF_A_SECOND: i64 = 500_000_000;
        self.log().last().is_none_or(|entry| entry.at + HALF_A_SECOND < epoch_nanos())
    }

    /// Returns the number of open connections that the robot has accepted on its own port.
    pub fn connections(&self) -> usize {
        let table = std::fs::read_to_string("/proc/net/tcp").unwrap();
        let own = format!("0100007F:{:04X}", self.port());
        // A connection that the robot has not accepted yet has no inode.
        let accepted = |line: &&str| {
            let fields: Vec<_> = line.split_whitespace().collect();
            fields.get(1) == Some(&own.as_str()) && fields[3] == "01" && fields[9] != "0"
        };
        table.lines().filter(accepted).count()
    }
}

impl Stage {
    /// Returns the journals of all missions in the state folder, one after the other.
    pub fn journals(&self) -> String {
        let Ok(missions) = std::fs::read_dir(self.path("state")) else { return String::new() };
        let journals =
            missions.flatten().map(|mission| std::fs::read_to_string(mission.path().join("journal")));
        journals.flatten().collect()
    }

    /// Waits until the journal of a mission contains `text`.
    #[track_caller]
    pub fn await_record(&self, text: &str) {
        await_that(text, || self.journals().contains(text));
    }

    /// Waits until every robot [rests](Robot::rests).
    #[track_caller]
    pub fn await_rest(&self) {
        await_that("the robots' rest", || self.robots.iter().all(Robot::rests));
    }
}

#[test]
fn stays_panics_if_the_value_changes() {
    let count = std::cell::Cell::new(0);
    let counted = || count.replace(count.get() + 1);
    assert_eq!(stays(Duration::ZERO, || 7), 7);
    assert!(
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| stays(Duration::ZERO, counted))).is_err()
    );
}
