//! What Belfry's sensor nodes and its host agree on: messages, framing, quantisation, time and decimation.
//!
//! The wire format lives in this crate, once; [`message`] describes it in prose.
#![no_std]

pub mod decimation;
