//! A host whose cores are all busy.

use std::sync::atomic::{AtomicBool, Ordering};

struct SetWhenDropped<'a>(&'a AtomicBool);

impl Drop for SetWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Keeps `cores` cores busy while `measure` runs, also if it panics.
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
