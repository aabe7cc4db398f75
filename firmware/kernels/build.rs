//! Generates the FFT's constant tables.

use std::f64::consts::PI;
use std::fmt::Write as _;
use std::path::PathBuf;

const LONGEST_SEGMENT: usize = 4096;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let mut source = String::new();
    sine(&mut source);
    twiddles(&mut source);
    let folder = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    std::fs::write(folder.join("tables.rs"), source).expect("OUT_DIR can be written");
}

/// A quarter of the longest segment's sine, both ends included.
fn sine(source: &mut String) {
    let quarter = LONGEST_SEGMENT / 4;
    writeln!(source, "pub(crate) static QUARTER_SINE: [f32; {}] = [", quarter + 1).unwrap();
    for n in 0..=quarter {
        // From the nearer end, so that both are exact.
        let angle = |n: usize| 2.0 * PI * n as f64 / LONGEST_SEGMENT as f64;
        let value = if n <= quarter / 2 { angle(n).sin() } else { angle(quarter - n).cos() };
        writeln!(source, "{:?},", value as f32).unwrap();
    }
    writeln!(source, "];").unwrap();
}

/// Cosine and sine of an angle, twice it, and three times it: what a radix-4 butterfly takes. A row for every other butterfly
/// of the longest transform; and what turns a row into the one between it and the next.
fn twiddles(source: &mut String) {
    let points = LONGEST_SEGMENT / 2;
    let row = |k: usize| -> Vec<f32> {
        let angles = (1..=3).map(|factor| 2.0 * PI * (factor * k) as f64 / points as f64);
        angles.flat_map(|angle| [angle.cos() as f32, angle.sin() as f32]).collect()
    };
    writeln!(source, "pub(crate) static TWIDDLES: [[f32; 6]; {}] = [", points / 8).unwrap();
    for k in (0..points / 4).step_by(2) {
        writeln!(source, "{:?},", row(k)).unwrap();
    }
    writeln!(source, "];\npub(crate) const HALF_ROW: [f32; 6] = {:?};", row(1)).unwrap();
}
