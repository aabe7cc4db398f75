//! The node's program for the emulator, with an imitated accelerometer on the bus, where otherwise nothing answers.
//!
//! Everything else is the node's: its timer, interrupts, queues, loop and serial port. Only with readings are there spectra to
//! compute and lines to send while samples come, which is when samples could be late.
#![cfg_attr(target_os = "none", no_std, no_main)]
// As in the node's program, which this is.
#![cfg_attr(target_os = "none", allow(unsafe_code))]

#[cfg(target_os = "none")]
#[path = "../belfry-node/board/mod.rs"]
mod board;
#[cfg(target_os = "none")]
mod imitation;
/// What the sensor is on.
#[cfg(target_os = "none")]
use imitation::Imitation as Bus;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!(
        "error: this is the node's program with an imitated sensor, for the emulator; firmware/build.sh builds it"
    );
    std::process::ExitCode::FAILURE
}
