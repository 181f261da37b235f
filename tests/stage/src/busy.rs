//! Keeps the cores of a host busy for a test.

use std::sync::atomic::{AtomicBool, Ordering};

struct SetWhenDropped<'a>(&'a AtomicBool);

impl Drop for SetWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Keeps `cores` cores busy while `measure` runs. They are released even if `measure` panics.
pub fn with_cores_busy<T>(cores: usize, measure: impl FnOnce() -> T) -> T {
    let enough = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(|| {
                while !enough.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        let _enough = SetWhenDropped(&enough);
        measure()
    })
}
