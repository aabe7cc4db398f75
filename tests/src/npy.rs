//! NumPy files, written without the library that Belfry reads them with.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes samples, row by row, as 32-bit floats (NPY version 1.0).
pub(crate) fn write_npy(path: &Path, samples: &[f32], channels: usize) -> io::Result<()> {
    let rows = samples.len() / channels.max(1);
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {channels}), }}");
    // Magic, version and length take ten bytes; the whole is a multiple of 64, a line feed its last.
    let padding = 63 - (10 + header.len()) % 64;
    header.extend(std::iter::repeat_n(' ', padding));
    header.push('\n');
    let mut file = BufWriter::with_capacity(1 << 20, File::create(path)?);
    file.write_all(b"\x93NUMPY\x01\x00")?;
    file.write_all(&(header.len() as u16).to_le_bytes())?;
    file.write_all(header.as_bytes())?;
    for sample in samples {
        file.write_all(&sample.to_le_bytes())?;
    }
    file.flush()
}
