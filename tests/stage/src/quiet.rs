//! Waiting for what another process does, and seeing that nothing happens afterwards.

use std::fmt::Debug;
use std::time::{Duration, Instant};

use crate::{Robot, Stage};

/// Within which what a test waits for comes, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(60);
const LOOK_AGAIN: Duration = Duration::from_millis(5);

/// Waits until this holds, a minute at most.
#[track_caller]
pub fn await_that(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < PATIENCE, "{what} never came");
        std::thread::sleep(LOOK_AGAIN);
    }
}

/// Sees that a value stays as it is for so long, and returns it. What may change it has to be over when this begins.
#[track_caller]
pub fn stays<T: PartialEq + Debug>(window: Duration, what: impl Fn() -> T) -> T {
    let before = what();
    std::thread::sleep(window);
    let after = what();
    assert_eq!(before, after, "it changed within {window:?}");
    after
}

impl Robot {
    /// Whether its log ends with something else than a value of a script, or is empty.
    pub fn rests(&self) -> bool {
        self.log().last().is_none_or(|entry| entry.motion != "set")
    }

    /// How many connections it has accepted that stand, of all those to its own port.
    pub fn connections(&self) -> usize {
        let table = std::fs::read_to_string("/proc/net/tcp").unwrap();
        let own = format!("0100007F:{:04X}", self.port());
        // A connection that the system has made and the robot has not accepted yet has no inode.
        let accepted = |line: &&str| {
            let fields: Vec<_> = line.split_whitespace().collect();
            fields.get(1) == Some(&own.as_str()) && fields[3] == "01" && fields[9] != "0"
        };
        table.lines().filter(accepted).count()
    }
}

impl Stage {
    /// The journals of all missions that were begun here, one after another.
    pub fn journals(&self) -> String {
        let Ok(missions) = std::fs::read_dir(self.path("state")) else { return String::new() };
        let journals =
            missions.flatten().map(|mission| std::fs::read_to_string(mission.path().join("journal")));
        journals.flatten().collect()
    }

    /// Waits until a mission has written this down.
    #[track_caller]
    pub fn await_record(&self, text: &str) {
        await_that(text, || self.journals().contains(text));
    }

    /// Waits until no robot's log ends with a value of a script.
    #[track_caller]
    pub fn await_rest(&self) {
        await_that("the robots' rest", || self.robots.iter().all(Robot::rests));
    }
}

#[test]
fn a_value_that_changes_does_not_stay() {
    let count = std::cell::Cell::new(0);
    let counted = || count.replace(count.get() + 1);
    assert_eq!(stays(Duration::ZERO, || 7), 7);
    assert!(
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| stays(Duration::ZERO, counted))).is_err()
    );
}
