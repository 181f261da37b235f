//! Reads any bytes as a formation file. The first byte selects the format of the others: PLY, STL, CSV or SVG.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Some((which, bytes)) = data.split_first() {
        downbeat_scripts::try_formation(*which, bytes);
    }
});
