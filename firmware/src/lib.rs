//! Belfry's sensor node: samples in, spectral summaries out.
//!
//! [`Node`] is a state machine that is fed with samples, bytes and the time, and asked for bytes to send; it owns all its
//! memory, never allocates, never waits, and no input makes it panic. It does not know what feeds it: an accelerometer and a
//! serial port with its [`Inbox`], a recording, or a test.
//!
//! Samples pass the decimating filter (`decimator`) into a ring of recent history (`acquisition`). Whenever the schedule says
//! that a segment is complete, `spectrum` transforms it, and its lines or averaged densities wait in the `outbox` until the host
//! acknowledges them. A [`Store`] on a memory chip keeps them over a power cut, where there is one.
#![no_std]

#[cfg(test)]
extern crate std;

mod acquisition;
pub mod adxl355;
mod decimator;
mod inbox;
mod level;
#[cfg(test)]
mod listening;
mod node;
mod outbox;
mod plan;
mod psd;
pub mod sampling;
mod schedule;
mod spectrum;
mod store;
mod tables;
mod windows;

pub use inbox::{Inbox, InboxReader, InboxWriter};
pub use node::{Identity, Memory, Node};
pub use spectrum::{SUPPORTED_SEGMENTS, welch_segment};
pub use store::{Chip, Keeper, NoStore, NoSupply, SECTOR_BYTES, STEP_BYTES, SimulatedChip, SpiChip, Store, Technology};
