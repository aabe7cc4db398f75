//! The node's inner loops: everything that is done for every sample or every line, and nothing else.
//!
//! The program for the board is compiled for size, this crate for speed (`profile.firmware` of the workspace); that is why it is
//! a crate, and why nothing of it is inlined elsewhere. All of it is plain f32 arithmetic in a fixed order, without fused
//! multiply-adds, so that a node gives the same bits as a simulated one; a product and its sum are one instruction of the
//! Cortex-M4F all the same (VMLA rounds twice).
#![no_std]

#[cfg(test)]
extern crate std;

mod fft;
mod filter;
mod segment;
mod tables;

pub use fft::real_fft;
pub use filter::{ACCUMULATORS, accumulate, accumulate_and_shift};
pub use segment::{Line, add_power, apply_hann, straight_line};

/// The longest segment that can be transformed.
pub const LONGEST_SEGMENT: usize = 4096;
/// The shortest.
pub const SHORTEST_SEGMENT: usize = 256;

fn is_supported(length: usize) -> bool {
    length.is_power_of_two() && (SHORTEST_SEGMENT..=LONGEST_SEGMENT).contains(&length)
}
