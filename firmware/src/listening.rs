//! A listener on a node's line, for tests: the node works, and what it says becomes messages.

use core::ops::DerefMut;
use std::vec::Vec;

use belfry_shared::frame::FrameDecoder;
use belfry_shared::time::NodeTime;

use crate::{Keeper, Memory, Node};

/// Lets a node do all that waits, and adds the messages that it then says.
pub(crate) fn listen<M: DerefMut<Target = Memory>, K: Keeper>(
    node: &mut Node<M, K>,
    now: NodeTime,
    messages: &mut Vec<Vec<u8>>,
) {
    while node.poll(now) {}
    let mut decoder = FrameDecoder::new();
    let mut bytes = [0; 64];
    loop {
        let count = node.transmit(now, &mut bytes);
        if count == 0 {
            break;
        }
        for &byte in &bytes[..count] {
            if let Some(frame) = decoder.push(byte) {
                messages.push(frame.unwrap().message.to_vec());
            }
        }
    }
}
