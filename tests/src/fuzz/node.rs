//! The node: well-formed messages of hosts in any order, samples, noise and time.

use belfry_firmware::{Identity, Memory, Node};
use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES};
use belfry_shared::message::{self, Conversation, Greeting, HostMessage, InConversation, NodeMessage};
use belfry_shared::time::NodeTime;

use super::input::Input;

/// Rows that are sampled at most.
const MOST_ROWS: u64 = 4096;
/// Times at which the node is to be right: a century.
const LATEST_US: u64 = 3_200_000_000_000_000;

struct Bench {
    node: Node<Box<Memory>>,
    time: NodeTime,
    heard: FrameDecoder,
    channels: u8,
}

impl Bench {
    fn hear(&mut self, conversation: u8, message: HostMessage) {
        let message = InConversation { conversation: Conversation([conversation; 4]), message };
        let mut frame = [0; MAX_FRAME_BYTES];
        // Rows of a recording may take more than a frame has.
        let Ok(length) = message::encode(&message, &mut frame) else { return };
        frame[..length].iter().for_each(|&byte| self.node.receive(self.time, byte));
    }

    fn sample(&mut self, rows: u64, reading: u64) {
        let period_us = self.node.sampling_rate_uhz().map_or(1000, |rate_uhz| 1_000_000_000_000 / rate_uhz.max(1));
        for row in 0..rows {
            self.time = NodeTime((self.time.0 + period_us).min(LATEST_US));
            let value = match reading % 4 {
                0 => f32::from_bits((reading >> 2) as u32),
                1 => (row as f32 * 0.37).sin(),
                2 => 25.0,
                _ => 0.0,
            };
            self.node.sample(self.time, &[value; 4][..usize::from(self.channels)]);
            while self.node.poll(self.time) {}
        }
    }

    /// Has the node say what it has to say; all of it can be read.
    fn listen(&mut self, most: usize) {
        let mut out = [0; MAX_FRAME_BYTES];
        for _ in 0..most {
            let count = self.node.transmit(self.time, &mut out);
            if count == 0 {
                assert!(!self.node.has_bytes(), "the node has something to say and says nothing");
                return;
            }
            for &byte in &out[..count] {
                match self.heard.push(byte) {
                    None => {}
                    Some(Ok(frame)) => {
                        let read = message::decode::<NodeMessage<'_>>(frame.message);
                        assert!(read.is_ok(), "a message that cannot be read");
                    }
                    Some(Err(error)) => panic!("a frame that cannot be read: {error}"),
                }
            }
        }
    }
}

/// A node is told and shown what the bytes say.
///
/// # Panics
/// Where the node does, or says what cannot be read.
pub fn node(bytes: &[u8]) {
    let mut input = Input(bytes);
    let channels = 1 + (input.number::<1>() % 4) as u8;
    let identity = Identity { node: 3, boot: 7, channels, full_scale_m_s2: 20.0, highest_rate_mhz: 4_000_000 };
    let node = Node::new(identity, Box::new(Memory::new()));
    let mut bench = Bench { node, time: NodeTime(1), heard: FrameDecoder::new(), channels };
    let mut rows_left = MOST_ROWS;
    bench.hear(1, HostMessage::Greet(Greeting::OF_HOSTS));
    while let Some(choice) = input.byte() {
        match choice % 8 {
            0..=2 => {
                if let Some(said) = input.message::<InConversation>() {
                    bench.hear(if choice < 0xE0 { 1 } else { 2 }, said.message);
                }
            }
            3 => bench.time = NodeTime(bench.time.0.saturating_add(input.number::<5>()).min(LATEST_US)),
            4 | 5 => {
                let rows = input.number::<2>().min(rows_left);
                rows_left -= rows;
                bench.sample(rows, input.number::<4>());
            }
            6 => {
                let noise = input.byte().unwrap_or(0);
                bench.node.receive(bench.time, noise);
            }
            _ => {
                while bench.node.poll(bench.time) {}
                bench.listen(usize::from(choice));
            }
        }
    }
    while bench.node.poll(bench.time) {}
    bench.listen(1024);
}
