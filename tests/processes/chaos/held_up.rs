//! How long the machine kept this process from running: what a robot or a scheduler does late then is not its own doing.

use std::sync::{Mutex, OnceLock};
use std::time::Duration;

use stage::epoch_nanos;

const EVERY: Duration = Duration::from_millis(5);
/// A shorter one is none.
const LEAST: i64 = 8_000_000;

/// From when to when.
static PAUSES: Mutex<Vec<(i64, i64)>> = Mutex::new(Vec::new());

/// Watches from now on, as long as the process lives.
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

/// The longest pause that reaches into this time, in nanoseconds.
pub fn longest(from: i64, until: i64) -> i64 {
    let pauses = PAUSES.lock().unwrap();
    pauses
        .iter()
        .filter(|(begin, end)| *end >= from && *begin <= until)
        .map(|(b, e)| e - b)
        .max()
        .unwrap_or(0)
}
