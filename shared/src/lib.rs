//! What Belfry's sensor nodes and its host agree on: messages, framing, quantisation, time, and the filters that
//! samples pass.
//!
//! The wire format lives in this crate, once; [`message`] describes it in prose, from the byte on the line to the
//! number in m/s². Nothing here allocates, and no function panics on any input.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod adxl355;
pub mod decimation;
pub mod division;
pub mod frame;
pub mod message;
pub mod quantise;
pub mod seal;
pub mod time;
