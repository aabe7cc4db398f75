//! Bodies of the fuzz targets in `fuzz/`, which the property tests below run as well. Each takes any bytes, and panics where something
//! is wrong: whatever comes over a line or stands in a file ends in data or in an error.

mod file;
mod frame;
mod host;
mod input;
mod node;
#[cfg(test)]
mod tests;

pub use file::{
    beam, dmig, hdf5, layout, mat, mat_matrix, mseed, mtx, npy, npy_matrix, parquet, sac, study, table, tdms, udbf,
    uff, wav, white_space,
};
pub use frame::{frame, message};
pub use host::host;
pub use node::node;

/// A target: it takes any bytes.
pub type Target = fn(&[u8]);

/// All targets by name. `fuzz/corpus` has a folder for each.
pub const TARGETS: [(&str, Target); 23] = [
    ("frame", frame),
    ("message", message),
    ("node", node),
    ("host", host),
    ("study", study),
    ("beam", beam),
    ("layout", layout),
    ("mtx", mtx),
    ("npy_matrix", npy_matrix),
    ("mat_matrix", mat_matrix),
    ("white_space", white_space),
    ("table", table),
    ("npy", npy),
    ("mat", mat),
    ("parquet", parquet),
    ("uff", uff),
    ("hdf5", hdf5),
    ("wav", wav),
    ("sac", sac),
    ("mseed", mseed),
    ("tdms", tdms),
    ("udbf", udbf),
    ("dmig", dmig),
];
