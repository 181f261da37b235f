//! A byte that selects a format, and bytes as a formation file: PLY, STL, CSV or SVG.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Some((which, bytes)) = data.split_first() {
        downbeat_scripts::try_formation(*which, bytes);
    }
});
