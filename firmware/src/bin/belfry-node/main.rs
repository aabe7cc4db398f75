//! The node's program for its board, a NUCLEO-F446RE with an ADXL355.
//!
//! The same program runs in QEMU's `netduinoplus2` machine, where no sensor answers and recordings are measured instead.
#![cfg_attr(target_os = "none", no_std, no_main)]
// Interrupts, registers and the linker's symbols are outside what the compiler can check; every block says why it is sound.
#![cfg_attr(target_os = "none", allow(unsafe_code))]

#[cfg(target_os = "none")]
mod board;
/// What the sensor is on.
#[cfg(target_os = "none")]
use board::bus::SensorBus as Bus;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!("error: this program is for the sensor node's board; docs/node-in-ten-minutes.md says how to build it");
    std::process::ExitCode::FAILURE
}
