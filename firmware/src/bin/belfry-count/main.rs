//! Counts instructions: what a segment's spectrum and the whole node cost, in QEMU, where one instruction takes 1 ns.
//!
//! `firmware/count.sh` builds and runs it. TIM5 counts the emulator's nanoseconds, so counts repeat exactly.
#![cfg_attr(target_os = "none", no_std, no_main)]
#![cfg_attr(target_os = "none", allow(unsafe_code))]

#[cfg(target_os = "none")]
mod count;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!("error: this program counts instructions in the emulator; run firmware/count.sh");
    std::process::ExitCode::FAILURE
}
