//! Records the pauses in which the machine prevented this process from running. Delays of a robot or a scheduler in these pauses are not
//! their fault.

use std::sync::{Mutex, OnceLock};
use std::time::Duration;

use stage::epoch_nanos;

const EVERY: Duration = Duration::from_millis(5);
/// Shortest pause that is recorded, in nanoseconds.
const LEAST: i64 = 8_000_000;

/// Begin and end of each pause of this process, in nanoseconds since the epoch.
static PAUSES: Mutex<Vec<(i64, i64)>> = Mutex::new(Vec::new());

/// Starts to record the pauses of this process, until it ends.
pub fn watch() {
    static ONCE: OnceLock<()> = OnceLock::new();
    ONCE.get_or_init(|| {
        std::thread::spawn(|| {
            let mut before = epoch_nanos();
            loop {
                std::thread::sleep(EVERY);
                let now = epoch_nanos();
                if now - before - i64::try_from(EVERY.as_nanos()).unwrap() > LEAST {
                    PAUSES.lock().unwrap().push((before, now));
                }
                before = now;
            }
        });
    });
}

/// Returns the duration of the longest pause that overlaps the time from `from` to `until`, in nanoseconds; 0 without such a pause.
pub fn longest(from: i64, until: i64) -> i64 {
    let pauses = PAUSES.lock().unwrap();
    pauses
        .iter()
        .filter(|(begin, end)| *end >= from && *begin <= until)
        .map(|(b, e)| e - b)
        .max()
        .unwrap_or(0)
}
