//! Generates the node's constant tables: the decimating filters' taps.

use std::fmt::Write as _;
use std::path::PathBuf;

use belfry_shared::decimation::{MAX_STAGE_RATIO, TAPS_PER_RATIO, fill_taps, tap_count};

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let mut source = String::new();
    for ratio in 2..=MAX_STAGE_RATIO {
        stage(&mut source, ratio);
    }
    dispatch(&mut source);
    let folder = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    std::fs::write(folder.join("tables.rs"), source).expect("OUT_DIR can be written");
}

/// A stage's taps, one row an input phase, in the order in which they meet the stage's accumulators.
///
/// Accumulator `i` holds output `q - 13 + i` while input `q * ratio` is added (phase 0), and output `q - 12 + i` for the
/// other phases, after the finished output has left; see `decimator.rs`.
fn stage(source: &mut String, ratio: u8) {
    let mut taps = vec![0.0; tap_count(ratio)];
    fill_taps(ratio, &mut taps);
    let accumulators = TAPS_PER_RATIO + 1;
    writeln!(source, "static TAPS_{ratio}: [[f32; {accumulators}]; {ratio}] = [").unwrap();
    for phase in 0..usize::from(ratio) {
        let newest = if phase == 0 { TAPS_PER_RATIO } else { TAPS_PER_RATIO - 1 };
        let row: Vec<f32> = (0..accumulators)
            .map(|i| newest.checked_sub(i).map_or(0.0, |j| taps[phase + j * usize::from(ratio)] as f32))
            .collect();
        writeln!(source, "{row:?},").unwrap();
    }
    writeln!(source, "];").unwrap();
}

/// The function that picks a stage's table.
fn dispatch(source: &mut String) {
    let accumulators = TAPS_PER_RATIO + 1;
    writeln!(source, "pub(crate) fn stage_taps(ratio: u8) -> &'static [[f32; {accumulators}]] {{ match ratio {{")
        .unwrap();
    for ratio in 2..=MAX_STAGE_RATIO {
        writeln!(source, "{ratio} => &TAPS_{ratio},").unwrap();
    }
    writeln!(source, "_ => &[],\n}} }}").unwrap();
}
