//! Calibration by the tumble test: a sensor of three axes is laid on each of its six faces, and local gravity is what its axes should read.
//!
//! Means over a second or so ([`Cell`]) flow in, from a node's heartbeats ([`Tumble`]) or from a recording ([`cells_of`]). What stood still
//! ([`still`]) on a face becomes gains and offsets with standard deviations ([`fit`]). They are applied once, by the host: a node keeps its own
//! for other studies to ask, and measures as without.

mod fit;
mod gravity;
mod known;
mod recording;
mod still;
mod tumble;

#[cfg(test)]
mod simulated;

pub use fit::{AXES, Axis, Calibrated, fit};
pub use gravity::Gravity;
pub use known::{differs, entries, from_node, to_node};
pub use recording::cells_of;
pub use still::{Cell, Face, Still, faces_of, still};
pub use tumble::{Step, Tumble, TumbleError};

use thiserror::Error;

/// Why there is no calibration.
#[derive(Debug, Error)]
pub enum CalibrationError {
    /// Some faces were not up for long enough.
    #[error(
        "no still time of {least_s} s with {faces} up: lay the sensor on all six faces, and leave it on each for ten seconds without touching the table"
    )]
    MissingFaces {
        /// The faces, in words.
        faces: String,
        /// The least time.
        least_s: f64,
    },
    /// Gravity is not what the axes read, by far.
    #[error(
        "{axis} would need a gain of {gain:.3}: is the unit right, and are these the three axes of one sensor, in the order X, Y, Z?"
    )]
    Gain {
        /// The axis.
        axis: &'static str,
        /// Its gain.
        gain: f64,
    },
}
